"""What is made once to judge many scenes of one wire: scanners, the reference, what construct said before.

1. A scanner is made once and reset for each scene: making one costs more than a scene.
2. With `remembers`, what construct says of one image is asked once. Nothing that a scanner says is ever remembered.
3. A bench belongs to who made it: a fault that is planted afterwards is not hidden by what an earlier bench knows.
"""

from __future__ import annotations

from functools import cached_property, lru_cache
from typing import Any

from construct import ConstructError

from ..errors import AcesError
from ..protocol.declare.ambiguity import needing_context, unmarked_answers
from ..protocol.declare.framing import Framing
from ..protocol.declare.message import Message
from ..protocol.declare.protocol import Variant
from ..protocol.declare.transport import Transport
from ..protocol.encoder import Encoder
from ..protocol.live.scanner import Scanner, make_scanner
from ..protocol.reference import Reference, ReferenceItem
from .packets import draw_packet
from .scenes import Cast, Scene, Way, Wire, wire_variants
from .source import Dice

#: Bytes of a usual packet.
USUAL = 8
#: Images that are remembered at most, so that a run of hours stays small.
REMEMBERED = 20_000


class Bench:
    """The tools for judging scenes of a wire in a direction."""

    def __init__(self, wire: Wire, direction: Way, *, remembers: bool = False) -> None:
        self.wire = wire
        self.variants = wire_variants(wire)
        self.direction: Way = direction
        self.remembers = remembers
        self.is_can = self.variants[0].link == "can"
        self._scanners: dict[tuple[bool, bool], Scanner] = {}
        self._encoders: dict[Message, Encoder] = {}
        self._said: dict[Any, Any] = {}

    @property
    def label(self) -> str:
        """As the command line names it."""
        return " + ".join(v.label for v in self.variants)

    def scanner(self, *, include_unknown: bool = True, raw: bool = True) -> Scanner:
        """Return a scanner as if just made."""
        made = self._scanners.get((include_unknown, raw))
        if made is None:
            made = make_scanner(
                self.variants, direction=self.direction, include_unknown=include_unknown, raw=raw
            )
            self._scanners[include_unknown, raw] = made
        made.reset()
        return made

    def reference(self, *, raw: bool = True) -> Reference:
        """Return the slow truth."""
        kind = _Remembering if self.remembers else Reference
        made = kind(self.variants, direction=self.direction, raw=raw)
        if isinstance(made, _Remembering):
            made.said = self._said
        return made

    def encoder(self, message: Message) -> Encoder:
        """Return the encoder of a message's variant."""
        made = self._encoders.get(message)
        if made is None:
            # `variant.encoder` is shared and kept for ever; a bench has its own.
            variant = next(v for v in self.variants if v.messages.get(message.name) is message)
            made = Encoder(variant)
            self._encoders.update((m, made) for m in variant.messages.values())
        return made

    def once(self, key: Any, ask: Any) -> Any:
        """Return what `ask()` gives; with `remembers`, asked once for a key."""
        if not self.remembers:
            return ask()
        try:
            return self._said[key]
        except KeyError:
            pass
        if len(self._said) > REMEMBERED:
            self._said.clear()
        self._said[key] = answer = ask()
        return answer

    @cached_property
    def share(self) -> float:
        """Length of the usual packet of this wire in units of `USUAL` bytes; 1 at most."""
        if self.is_can:
            return 1.0
        dice = Dice(0)
        sizes = [
            len(draw_packet(m, dice, v).image)
            for v, m in Cast.of(self.wire, self.direction).messages
            for _ in range(4)
        ]
        return min(1.0, sum(sizes) / len(sizes) / USUAL)

    @cached_property
    def has_transports(self) -> bool:
        """True if some messages are carried in several frames."""
        return any(m.transport is not None for _, m in Cast.of(self.wire, self.direction).messages)

    @cached_property
    def by_name(self) -> dict[tuple[str, str], Message]:
        """The messages of the wire by the names of protocol and message."""
        return {(v.name, m.name): m for v, m in Cast.of(self.wire, self.direction).messages}

    @cached_property
    def contextual(self) -> frozenset[tuple[str, str]]:
        """The names of messages that hang on others."""
        return frozenset(
            (v.name, name) for v in self.variants for name in needing_context(v.messages_for(self.direction))
        )

    @cached_property
    def answering(self) -> frozenset[Framing | None]:
        """The framings of answers that only a pending request tells from other bytes."""
        every = [v.messages_for(self.direction) for v in self.variants]
        return frozenset(m.framing for some in every for m in unmarked_answers(some, needing_context(some)))

    @cached_property
    def framings(self) -> list[tuple[Variant, Framing, tuple[Message, ...]]]:
        """Each framing of the wire with its messages."""
        found: dict[tuple[Variant, Framing], list[Message]] = {}
        for variant, message in Cast.of(self.wire, self.direction).messages:
            if message.framing is not None:
                found.setdefault((variant, message.framing), []).append(message)
        return [(variant, framing, tuple(messages)) for (variant, framing), messages in found.items()]

    @cached_property
    def extras(self) -> list[dict[int, bytes] | None]:
        """For each framing the bytes that seed its check."""
        found: list[dict[int, bytes] | None] = []
        for _, _, messages in self.framings:
            extras: dict[int, bytes] = {}
            for message in messages:
                extras.update(message.extras or {})
            found.append(extras or None)
        return found

    def reads(self, message: Message, image: bytes) -> bool:
        """Return whether construct reads an image as `message`."""
        return bool(self.once(("reads", message, image), lambda: reads(message, image)))


def reads(message: Message, image: bytes) -> bool:
    """Return whether construct reads an image as `message`."""
    try:
        message.struct.parse(image, raw=True)
    except (ConstructError, AcesError):
        return False
    return True


class _Remembering(Reference):
    """The same rule, quicker: what follows from bytes alone is kept, and construct is not asked what it cannot be.

    Where no message hangs on another, what a packet is follows from its bytes. Elsewhere messages of another identifier,
    head or constant are left out by the tests that construct itself begins with (`Packet._parse`).
    """

    said: dict[Any, Any]

    @cached_property
    def _first(self) -> frozenset[int] | None:
        """The bytes that packets begin with; None where some begin with any."""
        framings = [m.framing for _, messages, _, _ in self.sides for m in messages if m.framing is not None]
        return frozenset(f.sync[0] for f in framings) if all(f.sync for f in framings) else None

    def _at(self, data: bytes, start: int, *, silent: bool) -> ReferenceItem | None:
        first = self._first
        if first is not None and data[start] not in first:
            return ReferenceItem(start, 1, None, None, "skipped")  # no template outlives this byte
        return super()._at(data, start, silent=silent)

    def _decode(
        self,
        image: bytes,
        channel: Any,
        time: float | None,
        framing: Framing | None,
        transport: Transport | None = None,
    ) -> tuple[str, Message | None, Any]:
        sides = self.sides
        self.sides = [
            (variant, self._possible(variant, messages, image, framing), names, context)
            for variant, messages, names, context in sides
        ]
        try:
            if any(contextual for _, _, contextual, _ in sides):
                if framing is not None:  # frames are seldom the same twice
                    for _, messages, _, _ in self.sides:
                        messages[:] = map(self._known, messages)
                return super()._decode(image, channel, time, framing, transport)
            key = (self.raw, image, framing, transport, tuple(side[0] for side in sides))
            answer = self.said.get(key)
            if answer is None:
                answer = super()._decode(image, channel, time, framing, transport)
                self.keep(key, answer)
            found: tuple[str, Message | None, Any] = answer
            return found
        finally:
            self.sides = sides

    def _possible(
        self, variant: Variant, messages: list[Message], image: bytes, framing: Framing | None
    ) -> list[Message]:
        if framing is not None:
            data = framing.logical(image)
            end = len(data) - framing.check_size - len(framing.end)
            return [m for m in messages if m.framing is framing and _may_be(m, data, end)]
        data = image[5:]
        return [m for m in self._of_identifier(variant, messages, image) if _may_be(m, data, len(data))]

    def _of_identifier(self, variant: Variant, messages: list[Message], image: bytes) -> list[Message]:
        identifier = int.from_bytes(image[:4], "big") & 0x1FFF_FFFF
        known: list[Message] | None = self.said.get((variant, identifier))
        if known is None:
            known = [m for m in messages if m.identifier.match(identifier) is not None]
            self.keep((variant, identifier), known)
        return known

    def _known(self, message: Message) -> Any:
        """Return the message, with a construct that remembers."""
        known = self._stand_ins.get(message)
        if known is None:
            known = self._stand_ins[message] = _StandIn(message, self)
        return known

    @cached_property
    def _stand_ins(self) -> dict[Message, _StandIn]:
        return {}

    def keep(self, key: Any, answer: Any) -> None:
        if len(self.said) > REMEMBERED:
            self.said.clear()
        self.said[key] = answer


class _StandIn:
    """A message for the reference: everything that it asks of one, and a construct that reads an image once."""

    def __init__(self, message: Message, reference: _Remembering) -> None:
        self.message, self.reference = message, reference
        self.struct = self
        self.name, self.framing, self.protocol = message.name, message.framing, message.protocol
        self.transport, self.ways = message.transport, message.ways
        self.within, self.request_fields, self.outer = message.within, message.request_fields, message.outer

    @property
    def describe_lengths(self) -> str:
        return self.message.describe_lengths

    def parse(self, image: bytes, *, raw: bool, request: Any = None) -> Any:
        """Return what `message.struct.parse` gives or raises."""
        asked = None if request is None else tuple(map(str, request.items()))
        key = (self.message, image, raw, asked)
        try:
            answer, error = self.reference.said[key]
        except KeyError:
            try:
                answer, error = self.message.struct.parse(image, raw=raw, request=request), None
            except (ConstructError, AcesError) as refusal:
                answer, error = None, refusal
            self.reference.keep(key, (answer, error))
        if error is not None:
            raise error.with_traceback(None)
        return answer


def _may_be(message: Message, data: bytes, end: int) -> bool:
    """Return whether heads and constants are those of a message, as far as the packet goes."""
    for head in message.heads:
        if head.pattern is not None and head.offset + head.size <= end:
            if head.pattern.match(head.number(data)) is None:
                return False
    return all(
        data[offset : min(offset + len(wanted), end)] == wanted[: max(0, end - offset)]
        for offset, wanted in message.constants
    )


@lru_cache(maxsize=256)
def _bench(variants: tuple[Variant, ...], direction: Way) -> Bench:
    return Bench(variants, direction)


def bench_of(wire: Wire, direction: Way) -> Bench:
    """Return a bench that is kept; it remembers scanners and nothing else."""
    return _bench(wire_variants(wire), direction)


__all__ = ["Bench", "ReferenceItem", "Scene", "bench_of", "reads"]
