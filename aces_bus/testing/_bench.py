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
from ..protocol.codegen.encoder import Encoder
from ..protocol.scan.reference import Found, Reference
from ..protocol.scan.scanner import Scanner, make_scanner
from ..protocol.spec.ambiguity import needing_context
from ..protocol.spec.framing import Framing
from ..protocol.spec.message import Message
from ..protocol.spec.protocol import Variant
from ._scenes import Scene, Way, Wire, cast, variants_of

#: Images that are remembered at most, so that a run of hours stays small.
REMEMBERED = 20_000


class Bench:
    """The tools for judging scenes of a wire in a direction."""

    def __init__(self, wire: Wire, direction: Way, *, remembers: bool = False) -> None:
        self.wire = wire
        self.variants = variants_of(wire)
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

    def scanner(self, *, everything: bool = True, raw: bool = True) -> Scanner:
        """A scanner as if just made."""
        made = self._scanners.get((everything, raw))
        if made is None:
            made = make_scanner(self.variants, direction=self.direction, everything=everything, raw=raw)
            self._scanners[everything, raw] = made
        made.reset()
        return made

    def reference(self, *, raw: bool = True) -> Reference:
        """The slow truth."""
        kind = _Remembering if self.remembers else Reference
        made = kind(self.variants, direction=self.direction, raw=raw)
        if isinstance(made, _Remembering):
            made.said = self._said
        return made

    def encoder(self, message: Message) -> Encoder:
        """The encoder of a message's variant."""
        made = self._encoders.get(message)
        if made is None:
            # `variant.encoder` is shared and kept for ever; a bench has its own.
            variant = next(v for v in self.variants if v.messages.get(message.name) is message)
            made = Encoder(variant)
            self._encoders.update((m, made) for m in variant.messages.values())
        return made

    def once(self, key: Any, ask: Any) -> Any:
        """What `ask()` gives; with `remembers`, asked once for a key."""
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
    def by_name(self) -> dict[tuple[str, str], Message]:
        """The messages of the wire by the names of protocol and message."""
        return {(v.name, m.name): m for v, m in cast(self.wire, self.direction).messages}

    @cached_property
    def contextual(self) -> frozenset[tuple[str, str]]:
        """The names of messages that hang on others."""
        return frozenset(
            (v.name, name) for v in self.variants for name in needing_context(v.facing(self.direction))
        )

    @cached_property
    def framings(self) -> list[tuple[Variant, Framing, tuple[Message, ...]]]:
        """Each framing of the wire with its messages."""
        found: dict[tuple[Variant, Framing], list[Message]] = {}
        for variant, message in cast(self.wire, self.direction).messages:
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
        """Whether construct reads an image as `message`."""
        return bool(self.once(("reads", message, image), lambda: reads(message, image)))


def reads(message: Message, image: bytes) -> bool:
    """Whether construct reads an image as `message`."""
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

    def _decode(
        self, image: bytes, channel: Any, time: float | None, framing: Framing | None
    ) -> tuple[str, Message | None, Any]:
        sides = self.sides
        self.sides = [
            (variant, self._possible(variant, messages, image, framing), names, context)
            for variant, messages, names, context in sides
        ]
        try:
            if any(contextual for _, _, contextual, _ in sides):
                return super()._decode(image, channel, time, framing)
            key = (self.raw, image, framing, tuple(side[0] for side in sides))
            answer = self.said.get(key)
            if answer is None:
                answer = super()._decode(image, channel, time, framing)
                self._keep(key, answer)
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
        identifier = int.from_bytes(image[:4], "big") & 0x1FFF_FFFF
        known: list[Message] | None = self.said.get((variant, identifier))
        if known is None:
            known = [m for m in messages if m.identifier.match(identifier) is not None]
            self._keep((variant, identifier), known)
        return known

    def _keep(self, key: Any, answer: Any) -> None:
        if len(self.said) > REMEMBERED:
            self.said.clear()
        self.said[key] = answer


def _may_be(message: Message, data: bytes, end: int) -> bool:
    """Whether heads and constants are those of a message, as far as the packet goes."""
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
    """A bench that is kept; it remembers scanners and nothing else."""
    return _bench(variants_of(wire), direction)


__all__ = ["Bench", "Found", "Scene", "bench_of", "reads"]
