"""The slow, obvious truth: what every scanner must give, through construct alone.

*At the lowest undecided offset try the templates in declared order, protocols in the order they were given. One that is
complete and whose check holds: accept, consume. All dead: skip one byte. Any still incomplete: wait.*

1. Nothing here is generated, cached or fast; nothing here is shared with the generated scanners except the spec.
2. It works on whole inputs; that a scanner may be fed in pieces is the scanner's business.
3. It remembers every request; scanners keep the last few of each kind and device.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from construct import ConstructError

from ..errors import AcesError
from ..frames import EXTENDED, AnyFrame
from .declare.ambiguity import framings_in_order, needing_context, ordered, request_names, unmarked_answers
from .declare.framing import Framing, Verdict
from .declare.message import REQUESTS, GivenWay, Message, Request
from .declare.packet import ContentError, LengthError, NotThisError, WrongCheckError, frame_image
from .declare.packet_rule import DecidedFrames, PacketRule, packet_image
from .declare.protocol import Variant
from .declare.transport import Transport
from .record import FieldValue


@dataclass(frozen=True)
class ReferenceItem:
    """One thing in the input: a message with its fields, or a loss with its reason.

    `offset` and `size` are in bytes (streams), or the frame's number and 1 (CAN); of a packet that a transport carried its
    last frame's number and how many it came in, with `packet`, its image; `transport` is whose frames they are, `frame` the
    last one.
    """

    offset: int
    size: int
    message: str | None
    fields: Mapping[str, Any] | None
    reason: str = ""
    protocol: str | None = None
    #: What decided: the request that it answers; how many bytes had come, and whether the line was silent behind them.
    request: PastRequest | None = field(default=None, compare=False, repr=False)
    known: int = field(default=0, compare=False, repr=False)
    is_silent: bool = field(default=False, compare=False, repr=False)
    packet: bytes = field(default=b"", compare=False, repr=False)
    transport: Transport | None = field(default=None, compare=False, repr=False)
    frame: AnyFrame | None = field(default=None, compare=False, repr=False)


@dataclass(eq=False)
class PastRequest:
    """A request that was received or sent, with its raw fields."""

    name: str
    channel: str | int | None
    time: float | None
    values: Mapping[str, FieldValue]
    #: Of a request to everyone: the devices that have answered it.
    answered: set[tuple[Any, ...]] = field(default_factory=set)
    #: Whether a reply has used it up: it goes on as a mode.
    is_answered: bool = False


class RequestRule:
    """Which request a reply answers: the latest of the same channel that agrees in all fields that both have, is not used
    up, not too old and among the last `REQUESTS`. A mode stays; what was asked of everyone, each device answers once.
    Before a request that is too old there is none: the time of an earlier one may only be unknown."""

    def __init__(
        self, messages: Sequence[Message], contextual: frozenset[str], broadcast: Mapping[str, int]
    ) -> None:
        self.broadcast = broadcast
        #: Answers that only a pending request tells from other bytes.
        self.unmarked = unmarked_answers(messages, contextual)
        self.requests, self.answers = request_names(messages, contextual)
        #: All requests in order.
        self.passed: list[PastRequest] = []
        #: By message, what it may hang on: the request, whether it is a mode, and the fields that both have.
        self.links: dict[str, list[tuple[Request, bool, list[str]]]] = {}
        for message in messages:
            modes = [(request, True) for request in message.after] if message.name in contextual else []
            self.links[message.name] = [
                (request, is_mode, sorted(message.outer_names & request.message.outer_names))
                for request, is_mode in [*((request, False) for request in message.reply_to), *modes]
                if request.message.name in self.requests
            ]

    def note(self, past: PastRequest) -> None:
        """Note a request that was received or sent."""
        self.passed.append(past)

    def awaited(self, time: float | None) -> dict[Message, PastRequest]:
        """Return the answers without a mark that are awaited, each with its request: the latest that such answers hang on,
        while it is pending."""
        asking = {r.message.name for m in self.unmarked for r in (*m.reply_to, *m.after)}
        past = next((past for past in reversed(self.passed) if past.name in asking), None)
        if past is None:
            return {}
        return {
            message: past
            for message in self.unmarked
            for request, is_mode, _ in self.links[message.name]
            if request.message.name == past.name
            and request.accepts(past.values)
            and (is_mode or not past.is_answered)
            and (None in (message.within, time, past.time) or time - past.time <= message.within)  # type: ignore[operator]
        }

    def of(
        self, fitting: Sequence[tuple[Message, Mapping[str, Any]]], channel: Any, time: float | None
    ) -> tuple[Message, PastRequest] | None:
        """Return which of some messages, given with their raw fields, is an answer, and to what; the request is used up."""
        for past in reversed(self.passed):
            links = [
                (message, values, *link)
                for message, values in fitting
                for link in self.links[message.name]
                if self.agrees(past, message, link, values, channel, time)
            ]
            for message, values, request, is_mode, shared in links:
                if request.accepts(past.values):
                    own = _those(shared, values)
                    if not is_mode and own != _those(shared, past.values):
                        past.answered.add(own)
                    elif not is_mode:
                        past.is_answered = True
                    return message, past
            if links:
                return None
        return None

    def pending(
        self,
        message: Message,
        values: Mapping[str, FieldValue],
        channel: str | int | None,
        time: float | None,
    ) -> PastRequest | None:
        """Return the request that a reply with these outer fields would answer."""
        for past in reversed(self.passed):
            for link in self.links[message.name]:
                if self.agrees(past, message, link, values, channel, time) and link[0].accepts(past.values):
                    return past
        return None

    def agrees(
        self,
        past: PastRequest,
        message: Message,
        link: tuple[Request, bool, list[str]],
        values: Mapping[str, FieldValue],
        channel: str | int | None,
        time: float | None,
    ) -> bool:
        """Return whether a message with these fields may be an answer to a request."""
        request, is_mode, shared = link
        if past.name != request.message.name or past.channel != channel:
            return False
        if past.is_answered and not is_mode:
            return False
        own, everyone = _those(shared, values), _those(shared, {**values, **self.broadcast})
        if _those(shared, past.values) not in (own, everyone) or (own in past.answered and not is_mode):
            return False
        if not self.is_remembered(past, shared):
            return False
        if message.within is None or time is None:
            return True
        asked = _those(shared, past.values)
        return all(
            later.time is None or time - later.time <= message.within
            for later in self.passed[self.passed.index(past) :]
            if (later.name, later.channel) == (past.name, past.channel)
            and _those(shared, later.values) == asked
            and (is_mode or not (later.is_answered or own in later.answered))
        )

    def is_remembered(self, past: PastRequest, shared: Sequence[str]) -> bool:
        """Return whether it is among the last `REQUESTS` of its kind and channel that are as it is in the `shared`
        fields.
        """
        asked, later = _those(shared, past.values), 0
        for request in reversed(self.passed):
            if request is past or later >= REQUESTS:
                break
            later += (request.name, request.channel, _those(shared, request.values)) == (
                past.name,
                past.channel,
                asked,
            )
        return later < REQUESTS

    def needs(self, messages: Sequence[Message]) -> str:
        """Return the reason for messages whose request was not there."""
        names = dict.fromkeys(link.message.name for m in messages for link, *_ in self.links[m.name])
        return f"unknown: needs request {'|'.join(names)}"


def _those(names: Sequence[str], values: Mapping[str, FieldValue]) -> tuple[Any, ...]:
    return tuple(values.get(name) for name in names)


@dataclass(frozen=True)
class _Carrier:
    """A transport, with the rules of the packets under way that were received, and that we sent."""

    transport: Transport
    received: PacketRule
    sent: PacketRule


class Reference:
    """Reads whole inputs by the reference rule."""

    def __init__(
        self,
        variants: Sequence[Variant],
        *,
        direction: GivenWay | None = None,
        raw: bool = False,
    ) -> None:
        self.raw = raw
        #: The request that decided about the item that is being read.
        self._request: PastRequest | None = None
        self.sides = []
        for variant in variants:
            messages = ordered(variant.readable(direction))
            contextual = needing_context(messages)
            context = RequestRule(messages, contextual, variant.protocol.broadcast)
            self.sides.append((variant, messages, contextual, context))
        #: Transports with the rule of their packets under way: received, and sent by us.
        self.transports: list[_Carrier] = []
        for _, messages, _, _ in self.sides:
            for message in messages:
                for way in message.ways:
                    if way is not None and all(way != known.transport for known in self.transports):
                        self.transports.append(_Carrier(way, PacketRule(way), PacketRule(way)))

    # ------------------------------------------------------------------ one packet

    def _decode(
        self,
        image: bytes,
        channel: Any,
        time: float | None,
        framing: Framing | None,
        transport: Transport | None = None,
    ) -> tuple[str, Message | None, Any]:
        """Return (reason, message, fields) of a whole packet: each variant's messages are tried in turn.

        A reply that its request tells apart goes before a message that needs no request.
        """
        lost = "unknown"
        for _, messages, contextual, context in self.sides:
            fitting = []
            plain = None
            problem = ""
            for message in messages:
                if message.framing is not framing or transport not in message.ways:
                    continue
                is_contextual = message.name in contextual
                values, why = self._read(context, message, is_contextual, image, channel, time)
                if values is None:
                    problem = problem or why
                    continue
                if message.name in contextual:
                    fitting.append((message, values))
                elif plain is None:
                    plain = (message, values)
            if fitting:
                others = {m.name for m in context.unmarked} - {m.name for m in context.awaited(time)}
                likely = [(m, values) for m, values in fitting if m.name not in others]
                chosen = context.of(likely, channel, time)
                if chosen is not None:
                    return self._accepted(context, chosen[0], image, channel, time, chosen[1])
            if plain is not None:
                return self._accepted(context, plain[0], image, channel, time, None)
            if fitting:
                problem = context.needs([m for m, _ in fitting])
            if framing is not None and problem.startswith("malformed"):
                problem = ""
            if lost == "unknown" and problem:
                lost = problem
        return lost, None, None

    def _read(
        self,
        context: RequestRule,
        message: Message,
        is_contextual: bool,
        image: bytes,
        channel: str | int | None,
        time: float | None,
    ) -> tuple[Any, str]:
        """Return the raw fields of a packet as a message, or None and what is malformed ("" where that is not known)."""
        try:
            return message.struct.parse(image, raw=True), ""
        except NotThisError:
            return None, ""
        except LengthError as error:
            return None, f"malformed: length {len(image) - 5}, {error.what}"
        except WrongCheckError:
            return None, "malformed: checksum"
        except (ConstructError, AcesError) as error:
            values = self._by_request(context, message, image, channel, time) if is_contextual else None
            what = error.what if isinstance(error, ContentError) and not message.request_fields else ""
            return values, f"malformed: {what}" if what else ""

    @staticmethod
    def _by_request(
        context: RequestRule, message: Message, image: bytes, channel: str | int | None, time: float | None
    ) -> Any:
        """Return a reply whose layout is in its request, read with the request that is waiting for it; None when it is
        not one.
        """
        if message.framing is None:
            outer = message.outer(image[5:], int.from_bytes(image[:4], "big") & 0x1FFF_FFFF)
        else:
            outer = message.outer(message.framing.logical(image), 0)
        if outer is None or not message.request_fields:
            return None
        past = context.pending(message, outer, channel, time)
        try:
            return message.struct.parse(image, raw=True, request=past.values) if past is not None else None
        except (ConstructError, AcesError):
            return None

    def _accepted(
        self,
        context: RequestRule,
        message: Message,
        image: bytes,
        channel: str | int | None,
        time: float | None,
        past: PastRequest | None,
    ) -> tuple[str, Message, Any]:
        self._request = past
        request = past.values if past is not None else None
        if message.name in context.answers or message.name in context.requests:
            values = message.struct.parse(image, raw=True, request=request)
            if message.name in context.answers:
                context.of([(message, values)], channel, time)
            if message.name in context.requests:
                context.note(PastRequest(message.name, channel, time, values))
        return "", message, message.struct.parse(image, raw=self.raw, request=request)

    def sent_frame(self, frame: AnyFrame) -> None:
        """Note our own transmission of a CAN frame."""
        carrier = self._carrier_of(frame)
        if carrier is None:
            self.sent(frame_image(frame), frame.channel, frame.timestamp)
            return
        transport = carrier.transport
        key = frame.arbitration_id | (EXTENDED if frame.is_extended_id else 0)
        for decided in carrier.sent.decide(frame, 0, key, bytes(frame.data)):
            if decided.reason:
                continue
            image = packet_image(transport, decided, self._extra_of(transport, decided.key))
            if image is not None:
                self.sent(image, frame.channel, frame.timestamp, transport)

    def sent(
        self, image: bytes, channel: Any = None, time: float | None = None, transport: Transport | None = None
    ) -> None:
        """Note our own transmission (on CAN its image): a request that replies may need."""
        for variant, _, _, context in self.sides:
            for message in ordered(variant.messages.values()):
                if message.name in context.requests and transport in message.ways:
                    try:
                        values = message.struct.parse(image, raw=True)
                    except (ConstructError, AcesError):
                        continue
                    context.note(PastRequest(message.name, channel, time, values))
                    return

    # ------------------------------------------------------------------ frames

    def frames(self, frames: Iterable[AnyFrame], first: int = 0) -> list[ReferenceItem]:
        """Return what the frames are, of which the first one is number `first`; frames of packets under way are left
        for later.
        """
        found: list[ReferenceItem] = []
        for number, frame in enumerate(frames, first):
            if frame.is_error_frame:
                found.append(ReferenceItem(number, 1, None, None, "error frame"))
                continue
            carrier = self._carrier_of(frame)
            if carrier is not None:
                key = frame.arbitration_id | (EXTENDED if frame.is_extended_id else 0)
                for decided in carrier.received.decide(frame, number, key, bytes(frame.data)):
                    found += self._packet(carrier.transport, decided)
                continue
            self._request = None
            reason, message, fields = self._decode(frame_image(frame), frame.channel, frame.timestamp, None)
            names = (message.name, message.protocol.name) if message is not None else (None, None)
            found.append(ReferenceItem(number, 1, names[0], fields, reason, names[1], self._request))
        return found

    def end(self) -> list[ReferenceItem]:
        """End the input; return the frames that are pending."""
        return [
            ReferenceItem(
                frame.number, 1, None, None, "pending", transport=carrier.transport, frame=frame.frame
            )
            for carrier in self.transports
            for decided in carrier.received.end()
            for frame in decided.frames
        ]

    def _carrier_of(self, frame: AnyFrame) -> _Carrier | None:
        """Return the transport of the first message, or with the first identifiers, that a frame fits."""
        key = frame.arbitration_id | (EXTENDED if frame.is_extended_id else 0)
        for _, messages, _, _ in self.sides:
            for transport in dict.fromkeys(way for m in messages for way in m.ways):
                if transport is None or frame.is_remote_frame:
                    continue
                named = any(
                    m.transport == transport
                    and m.extended == frame.is_extended_id
                    and m.identifier.match(frame.arbitration_id) is not None
                    for m in messages
                )
                if named or transport.is_own(key):
                    known = next(carrier for carrier in self.transports if carrier.transport == transport)
                    return known if transport.fd or not frame.is_fd else None
        return None

    def _extra_of(self, transport: Transport, key: int) -> bytes:
        """Return the `check_extra` of the first message that an identifier of a packet may be of."""
        for _, messages, _, _ in self.sides:
            for message in messages:
                is_its = transport in message.ways and message.extended == bool(key & EXTENDED)
                if is_its and message.identifier.match(key & 0x1FFF_FFFF) is not None:
                    return message.check_extra
        return b""

    def _packet(self, transport: Transport, decided: DecidedFrames) -> list[ReferenceItem]:
        """Return what the frames are of which a transport has decided."""
        reason, message, fields = decided.reason, None, None
        last = decided.frames[-1]
        image = b""
        self._request = None
        if not reason:
            image = packet_image(transport, decided, self._extra_of(transport, decided.key)) or b""
            reason = "" if image else "malformed: checksum"
        if not reason:
            reason, message, fields = self._decode(
                image, last.frame.channel, last.frame.timestamp, None, transport
            )
        if message is not None:
            size = len(decided.frames)
            return [
                ReferenceItem(
                    last.number,
                    size,
                    message.name,
                    fields,
                    "",
                    message.protocol.name,
                    self._request,
                    packet=image,
                    transport=transport,
                    frame=last.frame,
                )
            ]
        return [
            ReferenceItem(
                frame.number,
                1,
                None,
                None,
                reason,
                packet=image if frame is last else b"",
                transport=transport,
                frame=frame.frame,
            )
            for frame in decided.frames
        ]

    # ------------------------------------------------------------------ bytes

    def stream(
        self, data: bytes, *, idle_at: Sequence[int] = (), sent_at: Sequence[tuple[int, bytes]] = ()
    ) -> list[ReferenceItem]:
        """Return what each byte is, the stream being closed at its end and falling silent after `idle_at` bytes.

        `sent_at` are our own transmissions: how many bytes had come before, and the packet. At the same place silence
        comes first.
        """
        found: list[ReferenceItem] = []
        start = 0
        events: list[tuple[int, bytes | None]] = [(offset, None) for offset in idle_at]
        reached = 0
        for offset, packet in sorted([*events, *sent_at], key=lambda e: (e[0], e[1] is not None)):
            if offset > reached or packet is None:  # what we send decides about bytes that come behind it
                start = self._until(data[:offset], start, found, silent=packet is None)
            reached = offset
            if packet is not None:
                self.sent(packet)
        start = self._until(data, start, found, silent=True)
        for index, item in enumerate(found):
            behind = found[index:]
            if item.reason == "malformed: incomplete" and not any(
                f.message or f.reason.startswith("unknown") for f in behind
            ):
                if item.offset >= (max(idle_at) if idle_at else 0) or not idle_at:
                    pending = replace(item, size=len(data) - item.offset, reason="pending")
                    return [*found[:index], pending]
        return found

    def _until(self, data: bytes, start: int, found: list[ReferenceItem], *, silent: bool) -> int:
        """Decide what can be decided of `data`: all of it when the line falls silent behind it."""
        while start < len(data):
            self._request = None
            item = self._at(data, start, silent=silent)
            if item is None:
                break
            found.append(replace(item, request=self._request, known=len(data), is_silent=silent))
            start += item.size
        return start

    def _at(self, data: bytes, start: int, *, silent: bool) -> ReferenceItem | None:
        bad = ""
        unclaimed: ReferenceItem | None = None
        for variant, messages, _, context in self.sides:
            answering = {m.framing for m in context.unmarked}
            for framing in framings_in_order(messages, context.unmarked):
                request = None
                if framing in answering:
                    awaited = context.awaited(None)
                    asked = [(m, past) for m, past in awaited.items() if m.framing is framing]
                    if not asked:
                        if not (awaited or framing.sync or framing.match):
                            bad = bad or context.needs(context.unmarked)
                        continue
                    request, self._request = asked[0][0].question(asked[0][1].values), asked[0][1]
                extras = framing.extras_of(messages)
                judged = framing.judge(data, start, silent=silent, extras=extras, request=request)
                if judged.verdict is Verdict.MORE:
                    if not silent:
                        return None
                    bad = bad or "malformed: incomplete"
                elif judged.verdict is Verdict.BAD:
                    bad = bad or f"malformed: {judged.reason}"
                elif judged.verdict is Verdict.WHOLE:
                    packet = data[start : start + judged.size]
                    side = [s for s in self.sides if s[0] is variant]
                    reason, decoded, fields = self._of_side(side, packet, framing)
                    if decoded is not None:
                        return ReferenceItem(start, judged.size, decoded.name, fields, "", variant.name)
                    if unclaimed is None:
                        unclaimed = ReferenceItem(start, judged.size, None, None, reason)
                    elif unclaimed.reason == "unknown":
                        unclaimed = replace(unclaimed, reason=reason)
        if unclaimed is not None:
            return unclaimed
        return ReferenceItem(start, 1, None, None, bad or "skipped")

    def _of_side(self, side: list[Any], packet: bytes, framing: Framing) -> tuple[str, Message | None, Any]:
        sides, self.sides = self.sides, side
        try:
            return self._decode(packet, None, None, framing)
        finally:
            self.sides = sides
