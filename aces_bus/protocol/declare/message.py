"""One message: a template (which frames or packets are it) and a payload (what they mean).

1. A message is complete and checked when its declaration returns; nothing about it changes afterwards.
2. `narrowed` gives the same message over fewer identifiers (a dialect, a configuration); it never widens.
"""

from __future__ import annotations

import copy
import keyword
from collections.abc import Collection, Iterable, Mapping, Sequence
from functools import cache, cached_property
from typing import TYPE_CHECKING, Any, Literal

import construct as c
import msgspec
from msgspec.structs import replace

from ...errors import CallerError, FieldError, SpecError, UnknownNameError
from ..record import FieldValue
from .bits import BitLayout, whole_bits
from .checks import Check, Covered, DataIds, Extra
from .delimited import Delimited
from .fields import Counter, Enumeration, innermost, wire_number
from .framing import Framing
from .head import Head, enumeration_of, heads_of
from .normalise import check_name, check_selectors, normalised, sizes
from .packet import PacketStruct
from .pattern import IdPattern, describe_values
from .place import SourceLine
from .shapes import Shapes, has_shapes
from .transport import Transport

if TYPE_CHECKING:
    from ..plan.nodes import MessagePlan
    from .examples import Example
    from .protocol import DeclaredProtocol
from typing import TYPE_CHECKING

from ...frames import FD_LENGTHS
from .fields import Multiplexed, Present

# ---------------------------------------------------------------------- lengths of frames and packets


def lengths_of(message: Message, length: int | Collection[int] | None) -> Collection[int] | None:
    """Return the numbers of data bytes that a message's frames or packets may have, of those that its spec states as
    `length`.

    None on streams; raises `SpecError` where its fields do not go with them.
    """
    low, high = sizes(message.payload)
    low += message.payload_start
    if message.framing is not None:
        if length is not None:
            raise SpecError(
                f"{message.place}: length is for CAN; a stream's packets end as their framing says"
            )
        return None
    if message.transport is not None:
        return _packet_lengths(message, message.transport, length, low, high)
    top = 64 if message.fd else 8
    high = top if high is None else high + message.payload_start
    if message.remote and high:
        raise SpecError(
            f"{message.place}: a remote frame carries no data, so {message.name} can have no fields in it"
        )
    if low > top:
        raise SpecError(
            f"{message.place}: {message.name} has {low} bytes of fields;"
            f" a {'CAN FD' if message.fd else 'classic CAN'} frame has {top}"
        )
    possible = [n for n in (FD_LENGTHS if message.fd else range(9)) if low <= n <= high]
    if length is None:
        if not possible:
            raise SpecError(
                f"{message.place}: {message.name} has {low} bytes of fields, which no CAN FD frame has; add Reserved bytes"
            )
        return (
            range(possible[0], possible[-1] + 1) if not message.fd and len(possible) > 1 else tuple(possible)
        )
    wanted = (length,) if isinstance(length, int) else tuple(sorted(length))
    for number in wanted:
        if not low <= number <= high:
            raise SpecError(
                f"{message.place}: length {number} does not go with the fields of {message.name}, which take {low}"
                + (f"…{high}" if high > low else "")
                + " bytes"
            )
        if number not in (FD_LENGTHS if message.fd else range(9)):
            raise SpecError(
                f"{message.place}: no {'CAN FD' if message.fd else 'classic CAN'} frame has {number} bytes"
            )
    return wanted


def _packet_lengths(
    message: Message, transport: Transport, length: int | Collection[int] | None, low: int, high: int | None
) -> Collection[int]:
    """Return how long packets are that a transport carries."""
    if message.fd or message.remote or message.any_format:
        raise SpecError(
            f"{message.place}: fd, remote and any_format are of frames; those of {message.name} are made by its transport"
        )
    ways = [way for way in message.ways if way is not None]
    most = max(way.longest for way in ways)
    low = max(low, min(way.min_size for way in ways))
    top = most if high is None else min(most, high + message.payload_start)
    wanted = range(low, top + 1) if length is None else (length,) if isinstance(length, int) else length
    if not wanted or min(wanted) < low or max(wanted) > top:
        end = None if high is None else high + message.payload_start
        more = "…" if end is None else f"…{end}" if end > low else ""
        given = (
            "" if length is None else f"length {describe_values(wanted)} does not go with {message.name}: "
        )
        raise SpecError(
            f"{message.place}: {given}its fields take {low}{more} bytes, and packets of {ways[-1].title} have"
            f" {most} at most"
        )
    if any(type(way).carries is Transport.carries for way in ways):
        return wanted if isinstance(wanted, range) else tuple(sorted(wanted))
    fitting = [size for size in wanted if any(way.carries(size) for way in ways)]
    if not fitting:
        near = next((n for n in range(min(wanted), most + 1) if transport.carries(n)), None)
        more = "" if near is None else f"; {near} would: end its fields with Reserved({near - min(wanted)})"
        raise SpecError(
            f"{message.place}: {describe_values(wanted)} bytes, as {message.name} has them, fill no frames of"
            f" {transport.title}{more}"
        )
    if len(fitting) < len(wanted):
        return tuple(sorted(fitting))
    return wanted if isinstance(wanted, range) else tuple(sorted(wanted))


def check_room(message: Message) -> None:
    """Raise `SpecError` where no packet would be read, or a multiplexed field has no room in any frame."""
    framing = message.framing
    if framing is not None and framing.end and message.payload_start == len(framing.sync):
        if not framing.check_size and sizes(message.payload)[1] == 0:
            raise SpecError(
                f"{message.place}: with nothing before its end a packet of {message.name} is none"
            )
    if message.lengths is None or not isinstance(message.payload, c.Struct):
        return
    most = max(message.lengths)
    items = [(i.name, i.subcon if isinstance(i, c.Renamed) else i) for i in message.payload.subcons]
    always = message.payload_start + sum(sizes(body)[0] for _, body in items)
    for name, body in items:
        if not isinstance(body, Multiplexed) or isinstance(body, Present):
            continue
        beside = [o for _, o in items if isinstance(o, Multiplexed) and o.selector == body.selector]
        least = min(
            (
                always + sum(sizes(field.body)[0] for field in beside if value in field.when)
                for value in body.when
            ),
            default=always,
        )
        if least > most:
            raise SpecError(
                f"{message.place.of_field(name or '')}: with field {name!r} {message.name} has {least} bytes of data,"
                f" and its frames have {most} at most: the field would never be there"
            )


# ---------------------------------------------------------------------- messages


Direction = Literal["to device", "from device"]
DIRECTIONS: tuple[Direction, ...] = ("to device", "from device")
#: Which way traffic goes; "both" pairs requests and replies.
Way = Direction | Literal["both"]
#: The same as callers may write it, with the short words of the command line.
GivenWay = Way | Literal["to", "from"]
_WAYS: dict[str, Way] = {"to": "to device", "from": "from device", "both": "both"}


def way_of(word: GivenWay | None) -> Way | None:
    """Return which way a caller means; raises `CallerError` for a word that says no direction."""
    way = _WAYS.get(word, word) if isinstance(word, str) else word
    if way is not None and way != "both" and way not in DIRECTIONS:
        words = ", ".join(map(repr, (*DIRECTIONS, "both")))
        raise CallerError(f"{word!r} is not a direction: write {words}, or in short 'to' and 'from'")
    return way


class ConfigurationCondition(msgspec.Struct, frozen=True):
    """`when=`: holds for the values of the field `capture` whose entry in the configuration table `key` is in `values`."""

    key: str
    capture: str
    values: frozenset[Any]

    def allowed(self, table: Mapping[int, Any]) -> frozenset[int]:
        return frozenset(number for number, entry in table.items() if entry in self.values)

    def excludes(self, other: ConfigurationCondition) -> bool:
        """Return whether no configuration can make both true for one device."""
        return (self.key, self.capture) == (other.key, other.capture) and not self.values & other.values


#: So many requests of a kind and device are remembered, answered or not: a reply to an earlier one is unknown.
REQUESTS = 8
#: So many requests' packets are kept, for the checks of their answers.
QUESTIONS = 4096


class Request(msgspec.Struct, frozen=True):
    """A message, perhaps with values that its fields must have: what `reply_to` and `after` refer to."""

    message: Message
    values: tuple[tuple[str, frozenset[int]], ...] = ()

    def accepts(self, raw: Mapping[str, FieldValue]) -> bool:
        for name, wanted in self.values:  # noqa: SIM110 - once a reply: a generator costs more than it says
            if raw.get(name) not in wanted:
                return False
        return True

    def excludes(self, other: Request) -> bool:
        """Return whether no request satisfies both."""
        if self.message.name != other.message.name:
            return True
        mine = dict(self.values)
        return any(name in mine and not mine[name] & wanted for name, wanted in other.values)

    def __str__(self) -> str:
        if not self.values:
            return self.message.name
        return f"{self.message.name}({', '.join(f'{n}={describe_values(v)}' for n, v in self.values)})"


class Message:
    """A declared message; made by `Protocol.message`, by a framing or by a family."""

    def __init__(
        self,
        protocol: DeclaredProtocol,
        name: str,
        *,
        place: SourceLine,
        identifier: IdPattern | None,
        framing: Framing | None,
        transport: Transport | None,
        prefix: c.Struct | None,
        payload: c.Construct | None,
        payload_from: str | None,
        match: Mapping[str, FieldValue],
        length: int | Collection[int] | None,
        extended: bool,
        remote: bool,
        fd: bool,
        any_format: bool,
        direction: Direction | None,
        dialects: frozenset[str] | None,
        when: tuple[ConfigurationCondition, ...],
        reply_to: tuple[Request, ...],
        after: tuple[Request, ...],
        within: float | None,
        overrides: tuple[str, ...],
        check: Check | None,
        check_extra: bytes,
        doc: str,
        source: str,
        examples: tuple[Example, ...] = (),
    ) -> None:
        self.protocol = protocol
        self.name = name
        self.place = place
        self.framing = framing
        #: What carries its packets in several frames; None where a frame is the message.
        self.transport = transport
        #: All that carry its packets, its own first; (None,) where a frame is the message.
        self.ways: tuple[Transport | None, ...] = (transport,)
        if transport is not None and transport.also is not None:
            self.ways = (transport, transport.also)
        self.identifier = identifier if identifier is not None else IdPattern(0)
        self.extended, self.remote, self.fd = extended, remote, fd
        #: Whether frames of up to 8 bytes are it in both formats, classic and CAN FD; `fd` is then how it is sent.
        self.any_format = any_format
        self.direction: Direction | None = direction
        self.dialects = dialects
        self.when = when
        self.reply_to, self.after, self.within, self.overrides = reply_to, after, within, overrides
        self.check, self.check_extra = check, check_extra
        self.doc, self.source = doc, source
        self.examples = examples
        if not isinstance(name, str):  # pyright: ignore[reportUnnecessaryIsInstance]
            raise SpecError(f"{place}: a message has a name, not {name!r}")
        if not name.isidentifier() or name.startswith("_") or keyword.iskeyword(name):
            raise SpecError(f"{place}: message name {name!r} is not a plain Python name")
        start = 0
        heads: list[Head] = []
        if framing is not None:
            heads += framing.heads
            start = framing.head_end
        own = heads_of(prefix, start, place, "prefix")
        self.heads_written = self._matched([*heads, *own], dict(match))
        self.payload_start = start + sum(h.size for h in own)
        derived = framing.affine.length.name if framing is not None and framing.affine is not None else None
        computed = framing.derived if framing is not None else frozenset[str | None]()
        if framing is not None and framing.check_head is not None and framing.check_head.name in match:
            raise SpecError(
                f"{place}: {framing.check_head.name} of {name} is the packet's check; it is not matched"
            )
        #: Header fields whose bytes are the payload's, too: templates match them, records have what the payload has.
        self.overlaid = self._overlaid(payload_from, computed, own) if payload_from is not None else ()
        if self.overlaid:
            self.payload_start = self.overlaid[0].offset
        shown = [h for h in self.heads_written if h not in self.overlaid]
        self.heads = tuple(h for h in shown if h.name is None or h.name not in computed)
        length_head = next((h for h in self.heads_written if derived is not None and h.name == derived), None)
        #: What `match` says of the framing's length field, which records do not have.
        self.length_pattern = length_head.pattern if length_head is not None else None
        if length_head is not None and not length_head.is_own and not length_head.is_constant:
            raise SpecError(
                f"{place}: {derived} of {name} is the length of the packet; match it with numbers, not with captures"
            )
        escape = framing.affine.escape if framing is not None and framing.affine is not None else None
        if (
            self.length_pattern is not None
            and escape is not None
            and self.length_pattern.match(escape) is not None
        ):
            raise SpecError(f"{place}: {derived} {escape} of {name} is not a length: a wider one follows")
        self.request_fields = self._request_fields()
        #: What its check covers of the request, by the raw values of the request's fields.
        self._questions: dict[tuple[Any, ...], bytes] = {}
        if framing is not None and framing.covers_request:
            self._check_question()
        numbers = [h.name for h in self.heads_written if h.name is not None and not h.is_text]
        self.payload = normalised(payload, place, self._enumerations(), numbers)
        check_selectors(self.payload, place)
        if has_shapes(self):
            Shapes(self)  # what is wrong with it is found here, and a check without a fixed place, too
            if self.check is not None:
                _ = self.check_span
        self.lengths = lengths_of(self, length)
        self._check_fields()
        check_room(self)
        if self.extras is not None and not check_extra:
            raise SpecError(
                f"{place}: the check of every packet ends with bytes of its message; give {name} its check_extra"
            )
        if framing is not None:
            framing.known(self, self.selecting)

    # ------------------------------------------------------------------ declaration checks

    def _overlaid(
        self, first: str, computed: Collection[str | None], own: Sequence[Head]
    ) -> tuple[Head, ...]:
        """Return the header fields from `first` on, at which the payload begins."""
        framed = self.framing.heads if self.framing is not None else ()
        start = next((head.offset for head in framed if head.name == first), None)
        if start is None:
            names = ", ".join(head.name for head in framed if head.name) or "none"
            raise SpecError(
                f"{self.place}: payload_from={first!r} is not a field of the framing's header (there are: {names})"
            )
        found = tuple(head for head in self.heads_written if head.offset >= start)
        odd = next(
            (head.name or "a constant" for head in found if head.name in computed or head.name is None), None
        )
        if own or odd is not None:
            what = f"{odd}, which is computed or constant" if odd is not None else "a family's prefix"
            raise SpecError(f"{self.place}: the payload of {self.name} would begin in front of {what}")
        return found

    def _matched(self, heads: list[Head], match: dict[str, Any]) -> tuple[Head, ...]:
        found = []
        framed = {} if self.framing is None else {head.name: numbers for head, numbers in self.framing.match}
        for head in heads:
            numbers = framed.get(head.name)
            if head.name is not None and head.name in match:
                head = head.matched(match.pop(head.name), self.place)
                if numbers is not None:
                    self._check_framed(head, numbers)
            elif numbers is not None:  # what its framing reads is all that it can be
                head = head.matched(next(iter(numbers)) if len(numbers) == 1 else numbers, self.place)
            found.append(head)
        if match:
            names = ", ".join(h.name for h in heads if h.name) or "none"
            raise SpecError(
                f"{self.place}: match names {next(iter(match))!r}, which is not a head field (there are: {names})"
            )
        return tuple(found)

    def _check_framed(self, head: Head, numbers: Collection[int]) -> None:
        """Raise `SpecError` where a one-byte head field is matched with numbers that its framing does not read."""
        assert head.pattern is not None
        outside = [n for n in range(256) if n not in numbers and head.pattern.match(n) is not None]
        if outside:
            raise SpecError(
                f"{self.place}: {self.name} has {head.name} {describe_values(outside)}, but its framing reads"
                f" {describe_values(numbers)} alone"
            )

    def _enumerations(self) -> dict[tuple[str, ...], Enumeration]:
        """Return the enumerations outside the payload that it may choose by, as `this._.name`."""
        found: dict[str, Any] = {
            name: enumeration_of(field)
            for request in (*self.reply_to, *self.after)
            for name, _ in request.values
            for field in request.message._field_constructs(name)
        }
        for head in self.heads_written:
            if head.name is not None:
                found[head.name] = enumeration_of(head.field)
        for pattern in (self.identifier, *(h.pattern for h in self.heads_written if h.pattern is not None)):
            for capture in pattern.captures:
                found[capture.name] = capture.quantity or found.get(capture.name)
        return {(name,): field for name, field in found.items() if isinstance(field, Enumeration)}

    def _request_fields(self) -> tuple[str, ...]:
        """Return the request's constrained fields that the message does not carry itself: its record has them too."""
        own = self.outer_names
        asked = (name for request in (*self.reply_to, *self.after) for name, _ in request.values)
        return tuple(dict.fromkeys(name for name in asked if name not in own))

    def _check_question(self) -> None:
        """Raise `SpecError` where the fields of a record do not say the request, which its framing's check covers."""
        asked = self.reply_to[0].message if len(self.reply_to) == 1 and not self.after else None
        if asked is None or not asked.fields or not set(asked.fields) <= set(self.request_fields):
            fields = ", ".join(f"{name}=…" for name in asked.fields) if asked is not None else "FIELD=…"
            raise SpecError(
                f"{self.place}: the check of {self.name} covers its request, which its record must say: it answers one"
                f" message, reply_to={asked.name if asked else 'Ask'}.where({fields}); of a request without fields its"
                " bytes are covered: over=(b'…', …)"
            )

    def _check_fields(self) -> None:
        places: dict[str, str] = {}

        def claim(name: str, what: str) -> None:
            check_name(name, self.place)
            if name in places:
                raise SpecError(
                    f"{self.place.of_field(name)}: field {name!r} of {self.name} is declared twice:"
                    f" in its {what} and in its {places[name]}"
                )
            places[name] = what

        for capture in self.identifier.captures:
            claim(capture.name, "identifier")
        for name in self._head_names():
            claim(name, "head")
        for name in self.request_fields:
            claim(name, "request")
        for name in self.payload_names:
            claim(name, "payload")
        self.identifier.check()
        if self.any_format and (self.remote or self.framing is not None or self.identifier.captures):
            raise SpecError(
                f"{self.place}: any_format is for data frames of one identifier, which {self.name} has not"
            )
        limit = 0x1FFF_FFFF if self.extended else 0x7FF
        if self.identifier.largest > limit:
            raise SpecError(
                f"{self.place}: {self.name} reaches identifier {self.identifier.largest:#x}, past {limit:#x}"
                + ("" if self.extended else "; is it extended=True?")
            )
        if self.check is not None and self.check.field is None:
            raise SpecError(
                f"{self.place}: a message's own check names its field; the check of all packets belongs to the framing"
            )
        if self.check is not None and self.check.covers_request:
            raise SpecError(
                f"{self.place}: the request is covered by the check of a framing, not by a message's own"
            )
        if self.check is not None and self.check.field not in places:
            raise SpecError(f"{self.place}: check field {self.check.field!r} is not a field of {self.name}")
        if self.check is not None and not has_shapes(self):
            _ = self.check_over

    @cached_property
    def payload_names(self) -> tuple[str, ...]:
        """The names of the payload's own fields, in order."""
        payload = self.payload
        if isinstance(payload, c.Struct):
            return tuple(item.name for item in payload.subcons if item.name)
        if isinstance(payload, Delimited):
            return (*(f.name for f in payload.fields), *(["more"] if payload.more else []))
        assert isinstance(payload, BitLayout)
        more = [payload.trailing] if payload.trailing else []
        return (*payload.names, *(["reserved"] if payload.has_reserved else []), *more)

    # ------------------------------------------------------------------ the whole packet

    @cached_property
    def struct(self) -> PacketStruct:
        """The whole packet as one construct (see `packet`): parse and build agree with scanner and encoder."""
        return PacketStruct(self)

    @property
    def plan(self) -> MessagePlan:
        """The layout: every field with its place, unit, names and conditions (see `aces_bus.protocol.plan`)."""
        from ..plan.flatten import flatten

        return flatten(self)

    @property
    def fields(self) -> tuple[str, ...]:
        """Names of a record's fields, in order."""
        captures = (capture.name for capture in self.identifier.captures)
        check = self.check.field if self.check is not None else None
        payload = (name for name in self.payload_names if name != check)
        return (*captures, *self.request_fields, *self._head_names(), *payload)

    def _head_names(self) -> list[str]:
        """Return the fields of the head that records have: captured parts, and fields that no pattern takes apart."""
        names: list[str] = []
        for head in self.heads:
            if head.pattern is not None:
                names += [capture.name for capture in head.pattern.captures]
            elif head.name is not None:
                names.append(head.name)
        return names

    @cached_property
    def counters(self) -> dict[str, int]:
        """Rolling counters of head and payload, with their modulus."""
        payload = self.payload
        fields: list[tuple[str | None, c.Construct | None]] = [
            (head.name, head.field) for head in self.heads if head.pattern is None
        ]
        if isinstance(payload, BitLayout):
            fields += [(slot.name, slot.field) for slot in payload.slots]
        elif isinstance(payload, c.Struct):
            fields += [(item.name, getattr(item, "subcon", None)) for item in payload.subcons]
        return {name: field.modulo for name, field in fields if name and isinstance(field, Counter)}

    def counter_key(self, name: str, values: Mapping[str, FieldValue]) -> tuple[Any, ...]:
        """Return what the rolling counter `name` counts, by the raw fields of a packet: packets of one device, of this
        message, or of one direction of its framing where the counter is in the framing's header.
        """
        pattern_of = (
            [self.identifier] if self.framing is None else [h.pattern for h in self.heads if h.pattern]
        )
        device = [values.get(capture.name) for pattern in pattern_of for capture in pattern.captures]
        if self.framing is not None and any(head.name == name for head in self.framing.heads):
            return (self.framing.name, self.direction, name, *device)
        return (self.name, name, *device)

    @cached_property
    def constants(self) -> tuple[tuple[int, bytes], ...]:
        """The payload's own constants that have a fixed place: (offset, bytes)."""
        found: list[tuple[int, bytes]] = []
        offset = self.payload_start
        for item in self.payload.subcons if isinstance(self.payload, c.Struct) else ():
            body = item.subcon if isinstance(item, c.Renamed) else item
            least, most = sizes(body)
            if least != most:
                break
            if isinstance(body, c.Const):
                found.append((offset, bytes(body.build(None))))
            offset += least
        return tuple(found)

    @property
    def extras(self) -> dict[int, bytes] | None:
        """`check_extra` by the number that selects it, for framings whose check is seeded per message."""
        framing = self.framing
        if (
            framing is None
            or framing.check is None
            or not any(isinstance(p, Extra) for p in framing.check.over or ())
        ):
            return None
        if self.selecting is not None:
            return dict.fromkeys(self.selecting, self.check_extra)
        head = framing.extra_head
        raise SpecError(
            f"{self.place}: the check of {framing.name} is seeded by {head.name if head else '?'}; match it"
        )

    @property
    def selecting(self) -> IdPattern | None:
        """The numbers by which the header selects this message; None where it does not."""
        head = self.framing.extra_head if self.framing is not None else None
        return next((own.pattern for own in self.heads_written if head and own.name == head.name), None)

    @cached_property
    def least(self) -> int:
        """The bytes of the payload, at least."""
        return sizes(self.payload)[0]

    @cached_property
    def check_span(self) -> tuple[int, int, Literal["little", "big"]]:
        """Offset, size and byte order of the field that holds this message's own check."""
        assert self.check is not None
        assert self.check.field is not None
        name, size = self.check.field, self.check.bytes
        payload = self.payload
        if isinstance(payload, BitLayout):
            slot = next(s for s in payload.slots if s.name == name)
            low = min(slot.positions)
            for order in ("little", "big"):
                if low % 8 == 0 and slot.positions == whole_bits(low // 8, size, order):
                    return self.payload_start + low // 8, size, "little" if order == "little" else "big"
            raise SpecError(f"{self.place.of_field(name)}: check field {name!r} is not {size} whole bytes")
        offset = self.payload_start
        assert isinstance(payload, c.Struct)
        for item in payload.subcons:
            least, most = sizes(item)
            if item.name == name:
                if least != size:
                    raise SpecError(
                        f"{self.place.of_field(name)}: check field {name!r} has {least} bytes, its check {size}"
                    )
                wire = wire_number(innermost(item))
                return offset, size, wire.order if wire is not None else "big"
            if least != most:
                raise SpecError(f"{self.place.of_field(name)}: check field {name!r} has no fixed place")
            offset += least
        raise SpecError(f"{self.place}: check field {name!r} is not in the payload itself")

    @cached_property
    def check_over(self) -> tuple[Covered, ...]:
        """Bytes that this message's own check covers, of a frame's data or of a packet (without stuffing) up
        to its framing's check and end; by default all behind the sync bytes but checks.
        """
        assert self.check is not None
        if self.check.over is not None:
            return tuple(
                self._placed(part) if isinstance(part, DataIds) else part for part in self.check.over
            )
        start, size, _ = self.check_span
        first, head = (len(self.framing.sync), self.framing.check_head) if self.framing else (0, None)
        gaps = [*([(head.offset, head.size)] if head is not None else []), (start, size)]
        found: list[Covered] = []
        for at, width in gaps:
            found += [slice(first, at)] if at > first else []
            first = at + width
        return (*found, slice(first, None))

    def _placed(self, ids: DataIds) -> DataIds:
        """Return data ids with the place of the field that chooses among them."""
        payload, offset, bits = self.payload, 0, tuple[int, ...]()
        if isinstance(payload, BitLayout):
            bits = next((tuple(s.positions) for s in payload.slots if s.name == ids.field), ())
        for item in payload.subcons if isinstance(payload, c.Struct) else ():
            least, most = sizes(item)
            if item.name == ids.field and least == 1:
                bits = tuple(range(8 * offset, 8 * offset + 8))
            if least != most:
                break
            offset += least
        if (
            not bits
            or bits[0] // 8 != bits[-1] // 8
            or list(bits) != list(range(bits[0], bits[0] + len(bits)))
        ):
            raise SpecError(
                f"{self.place}: {ids.field!r}, which chooses the data id of {self.name}, is not a field of the payload in"
                " one byte at a fixed place"
            )
        place = (self.payload_start + bits[0] // 8, bits[0] % 8, (1 << len(bits)) - 1)
        return replace(ids, place=place)

    @property
    def behind(self) -> int:
        """Bytes of a packet behind the payload: its framing's check and end."""
        return self.framing.check_size + len(self.framing.end) if self.framing is not None else 0

    def covered(self, data: bytes, identifier: int) -> bytes:
        """Return the bytes that this message's own check covers, in order."""
        data = data[: len(data) - self.behind]
        return Check.joined(data, self.check_over, identifier=identifier, extra=self.check_extra)

    def question(self, fields: Mapping[str, FieldValue] | None) -> bytes:
        """Return the packet of the request that this message answers, by its raw fields: what its framing's check covers;
        empty where it covers no request.

        Raises `FieldError` when there is no request, or a field of it is not given.
        """
        if self.framing is None or not self.framing.covers_request:
            return b""
        asked = self.reply_to[0].message
        missing = [name for name in asked.fields if fields is None or name not in fields]
        if fields is None or missing:
            raise FieldError(
                f"{self.name}: its check covers its request; no value given for {', '.join(missing)}"
            )
        values = tuple(fields[name] for name in asked.fields)
        found = self._questions.get(values)
        if found is None:
            found = bytes(asked.struct.build(dict(zip(asked.fields, values, strict=True)), raw=True))
            if len(self._questions) < QUESTIONS:
                self._questions[values] = found
        return found

    def outer(self, data: bytes, identifier: int) -> dict[str, int] | None:
        """Return the raw captures and head fields of a packet, its payload unread; None when they are not this message's."""
        found = self.identifier.match(identifier) if self.framing is None else {}
        if found is None or len(data) < self.payload_start:
            return None
        for head in self.heads:
            number = head.number(data)
            captures = head.pattern.match(number) if head.pattern is not None else {}
            if captures is None:
                return None
            found.update(captures)
            if head.name is not None and head.is_own:
                found[head.name] = number
        return found

    # ------------------------------------------------------------------ relations

    @property
    def formats(self) -> tuple[bool, ...]:
        """The formats of its frames, as `is_fd` has them; first that in which it is sent."""
        return (self.fd, not self.fd) if self.any_format else (self.fd,)

    def where(self, **values: Any) -> Request:
        """Return a request for `reply_to` and `after`: this message with field values (numbers, sets of
        numbers or names).
        """
        found = []
        for name, value in values.items():
            if name not in self.fields and not any(h.name == name for h in self.heads_written):
                raise UnknownNameError(f"field of {self.name}", name, self.fields)
            if isinstance(value, range):
                found.append((name, _numbers(value)))
                continue
            wanted = value if isinstance(value, Iterable) and not isinstance(value, str) else (value,)
            found.append((name, frozenset(self._raw_of(name, v) for v in wanted)))
        return Request(self, tuple(found))

    def _raw_of(self, name: str, value: Any) -> int:
        if not isinstance(value, str):
            return int(value)
        for field in self._field_constructs(name):
            names = enumeration_of(field)
            if names is not None and value in names.names:
                return names.names[value]
        raise SpecError(f"{self.place}: field {name!r} of {self.name} has no value named {value!r}")

    def _field_constructs(self, name: str) -> list[c.Construct]:
        found = [h.field for h in self.heads_written if h.name == name]
        if isinstance(self.payload, BitLayout):
            found += [s.field for s in self.payload.slots if s.name == name]
        elif isinstance(self.payload, c.Struct):
            found += [s.subcon for s in self.payload.subcons if s.name == name]
        return found

    def with_payload(self, payload: c.Struct) -> Message:
        """Return this message with other fields: one of the shapes of a message whose fields are there by bits."""
        made = copy.copy(self)
        for name in ("struct", "payload_names", "counters", "constants", "least", "check_span", "check_over"):
            made.__dict__.pop(name, None)
        made.payload = payload
        low, high = sizes(payload)
        if self.lengths is not None:
            room = [length - self.payload_start for length in self.lengths]
            fitting = [size for size in room if low <= size and (high is None or size <= high)]
            made.lengths = tuple(size + self.payload_start for size in fitting)
        return made

    def narrowed(self, allowed: Mapping[str, Collection[int]]) -> Message | None:
        """Return this message with captures limited to `allowed`; None when no value is left."""
        made = copy.copy(self)
        made.__dict__.pop("struct", None)
        for name, values in allowed.items():
            if any(capture.name == name for capture in made.identifier.captures):
                pattern = made.identifier.only(name, values)
                if pattern is None:
                    return None
                made.identifier = pattern
                continue
            heads = []
            for head in made.heads_written:
                if head.pattern is not None and any(
                    capture.name == name for capture in head.pattern.captures
                ):
                    narrow = head.pattern.only(name, values)
                    if narrow is None:
                        return None
                    head = replace(head, pattern=narrow)
                elif head.name == name:
                    if not values:
                        return None
                    head = head.matched(sorted(values), self.place)
                heads.append(head)
            kept = {h.name for h in self.heads}
            made.heads_written = tuple(heads)
            made.overlaid = tuple(h for h in heads if any(h.offset == over.offset for over in self.overlaid))
            made.heads = tuple(h for h in heads if h.name in kept)
        return made

    @property
    def describe_lengths(self) -> str:
        return "" if self.lengths is None else f"{describe_values(self.lengths)} bytes"

    @property
    def outer_names(self) -> frozenset[str]:
        """The fields outside the payload, captures and head fields: what a reply and its request may share."""
        return frozenset([*(capture.name for capture in self.identifier.captures), *self._head_names()])

    def __repr__(self) -> str:
        return f"<message {self.protocol.name}.{self.name}>"


@cache
def _numbers(values: range) -> frozenset[int]:
    """Return a range as a set: where it is long, requests share it."""
    return frozenset(values)


def as_requests(given: Any, protocol: DeclaredProtocol, place: SourceLine) -> tuple[Request, ...]:
    """Return what a spec may write for `reply_to` and `after`: a message, a request, a name, or several of them."""
    if given is None:
        return ()
    if isinstance(given, (Message, Request, str)):
        given = (given,)
    if not isinstance(given, Sequence):
        raise SpecError(
            f"{place}: a request is a message, message.where(…) or a message's name, not {given!r}"
        )
    found = []
    for request in given:
        if isinstance(request, str):
            if request not in protocol.messages:
                raise SpecError(
                    f"{place}: no message named {request!r} before this line (there are: {', '.join(protocol.messages)})"
                )
            request = protocol.messages[request]
        if isinstance(request, Message):
            request = Request(request)
        if not isinstance(request, Request):
            raise SpecError(
                f"{place}: a request is a message, message.where(…) or a message's name, not {request!r}"
            )
        found.append(request)
    return tuple(found)


def share_dialect(one: Message, other: Message) -> bool:
    """Return whether some dialect has both messages."""
    return one.dialects is None or other.dialects is None or bool(one.dialects & other.dialects)


def may_coexist(one: Message, other: Message) -> bool:
    """Return whether some dialect and configuration has both messages for one device."""
    return share_dialect(one, other) and not any(a.excludes(b) for a in one.when for b in other.when)
