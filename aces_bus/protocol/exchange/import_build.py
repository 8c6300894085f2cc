"""From a cantools database to a `Protocol`.

1. A signal's value is what cantools' `decode` gives: same arithmetic, so that floats agree to the last bit, and integers
   where factor and offset are whole numbers.
2. What our language does not hold is left out and listed, one problem each; the rest of the message stays.
3. Ranges (minimum, maximum) bind only what is sent. `0|0` means none.

How a message is recognised: by its identifier and its length, exact or longer. Bytes behind the declared ones are kept in
`trailing`. A message of up to 8 bytes is it in both formats, classic and CAN FD: most databases do not say which it is.

J1939 messages of more than 8 bytes are carried by its transport (BAM, RTS/CTS); as others they may be longer than declared.
J1939 messages are recognised by their parameter group (SAE J1939-21): `priority` and `source` are captured, and
`destination` where the group is addressed (PDU format below 240). Where a group has several messages, each has its
declared identifier's source address (and destination, and priority, where that does not tell them apart). Frames of other
sources are the first message where all are laid out alike, else unknown. A message that is not a parameter group goes before
one that is.

Differences to cantools, on purpose: a multiplexer value that no signal is for leaves those signals None, where cantools
raises; names that a value table has twice get their number; signals that share bits all decode.
"""

from __future__ import annotations

import copy
import math
import re
from collections.abc import Callable, Collection, Hashable, Mapping, Sequence
from sys import float_info
from typing import TYPE_CHECKING, Any

import construct as c
import msgspec

from ...errors import AcesError
from ...frames import EXTENDED, FD_LENGTHS
from ...plain_text import without_controls
from ..declare.bits import BitLayout, bits, float_bits
from ..declare.fields import Enumeration, Multiplexed, Quantity
from ..declare.j1939 import J1939Transport
from ..declare.pattern import IdField, IdPattern
from ..declare.place import SourceLine
from ..protocol import Protocol
from .names import PythonNames
from .problems import ImportProblem, ProblemText

if TYPE_CHECKING:
    from cantools.database.can import Database
    from cantools.database.can import Message as DbcMessage
    from cantools.database.can import Signal as DbcSignal

#: The field of the bytes behind the declared ones.
TRAILING = "trailing"
#: The attribute of messages whose frames have several lengths (see `printers.dbc`): these, by blanks.
LENGTHS = "AcesLengths"
#: A selector of so many bits is searched for the raw values that mean an identifier; a wider one is solved for them.
SEARCHED = 12

#: (message, signal or None) to the line it was declared on; 0 where unknown.
Lines = Callable[["DbcMessage", "DbcSignal | None"], int]


def build(database: Database, name: str, path: str, lines: Lines) -> tuple[Protocol, list[ImportProblem]]:
    """Return the protocol of a loaded database, and what could not be taken over."""
    return _Builder(database, name, path, lines).build()


#: What carries J1939 messages of more than 8 bytes.
CARRIER = J1939Transport()


class _LeftOut(Exception):
    """This signal or message cannot be taken over; the argument says why."""


class _Taken(msgspec.Struct):
    """A message that is taken over: where it was declared, and what is decided about it."""

    message: DbcMessage
    line: int
    name: str
    identifier: IdPattern
    is_j1939: bool
    fd: bool
    #: What carries it in several frames.
    transport: J1939Transport | None = None
    any_format: bool = False
    overrides: tuple[str, ...] = ()


class _Builder:
    def __init__(self, database: Any, name: str, path: str, lines: Lines) -> None:
        self.database, self.path, self.lines = database, path, lines
        self.problems: list[ImportProblem] = []
        self.taken = set(PythonNames.TAKEN_BY_CODE)
        buses = [bus for bus in database.buses if bus.baudrate]
        version = f"version {ProblemText.clean(database.version)}" if database.version else ""
        self.protocol = Protocol(
            name,
            link="can",
            bitrate=int(buses[0].baudrate) if buses else None,
            doc=version,
            source=path,
        )
        self.protocol.place = SourceLine(path, 1)
        self.is_j1939 = self._is_j1939()

    def _is_j1939(self) -> bool:
        """Return whether the database as a whole says so, and has no attribute by which each message does."""
        attributes = getattr(self.database.dbc, "attributes", None) or {}
        definitions = getattr(self.database.dbc, "attribute_definitions", None) or {}
        kind = attributes.get("ProtocolType")
        return kind is not None and str(kind.value).upper() == "J1939" and "VFrameFormat" not in definitions

    def build(self) -> tuple[Protocol, list[ImportProblem]]:
        # Of several messages with the same identifier and length cantools takes the last.
        last = {_key(message): message for message in self.database.messages}
        found: list[_Taken] = []
        for message in self.database.messages:
            line = self.lines(message, None)
            same = last[_key(message)]
            if same is not message:
                name, other = ProblemText.clean(message.name), ProblemText.clean(same.name)
                text = f"message {name} has the identifier of {other} further down"
                self.problems.append(ImportProblem(line, f"{text}: left out"))
                continue
            try:
                found.append(self._taken(message, line))
            except _LeftOut as left:
                self._leave_out(message, line, str(left))
        if any(taken.transport is not None for taken in found):
            found = self._without_carriers(found)
        self._distinguish(found)
        for taken in found:
            message, line = taken.message, taken.line
            try:
                self._message(taken)
            except _LeftOut as left:
                self._leave_out(message, line, str(left))
            except (TypeError, ValueError, AttributeError, LookupError, ArithmeticError) as error:
                # A database that contradicts itself in a way that cantools lets pass.
                name, why = ProblemText.clean(str(message.name)), ProblemText.clean(str(error))
                self.problems.append(
                    ImportProblem(line, f"message {name}: it cannot be used ({why}): left out")
                )
        return self.protocol, self.problems

    def _without_carriers(self, found: Sequence[_Taken]) -> list[_Taken]:
        """Return the messages but for the frames that carry the longer ones, which some databases have as messages."""
        own = {
            id(taken)
            for taken in found
            if taken.is_j1939 and CARRIER.is_own(taken.message.frame_id | EXTENDED)
        }
        for taken in found:
            if id(taken) in own:
                self._leave_out(
                    taken.message,
                    taken.line,
                    "its frames carry the messages of more than 8 bytes",
                )
        return [taken for taken in found if id(taken) not in own]

    def _leave_out(self, message: DbcMessage, line: int, reason: str) -> None:
        self.problems.append(
            ImportProblem(line, f"message {ProblemText.clean(message.name)}: {reason}: left out")
        )

    def _note(self, line: int, text: str) -> None:
        self.problems.append(ImportProblem(line, text, is_note=True))

    # ------------------------------------------------------------------ messages

    def _taken(self, message: DbcMessage, line: int) -> _Taken:
        """Return what a message is called and of what kind its frames are."""
        if message.is_container:
            raise _LeftOut("a container of other messages")
        size = message.length
        is_j1939 = message.is_extended_frame and (
            message.protocol == "j1939" or (self.is_j1939 and not message.is_fd)
        )
        longest = CARRIER.max_size if is_j1939 else 64
        if size > longest:
            what = "a packet of J1939" if is_j1939 else "a frame"
            raise _LeftOut(f"{size} bytes are more than {what} has")
        name = PythonNames.unused(message.name, self.taken)
        fd = not is_j1939 and (bool(message.is_fd) or size > 8)
        transport = CARRIER if is_j1939 and size > 8 else None
        return _Taken(
            message, line, name, IdPattern(message.frame_id), is_j1939=is_j1939, fd=fd, transport=transport
        )

    def _distinguish(self, found: Sequence[_Taken]) -> None:
        """Decide identifiers, formats and order of trial, each message seen beside the others."""
        alike: dict[tuple[int, bool], list[_Taken]] = {}
        groups: dict[int, list[_Taken]] = {}
        for taken in found:
            if taken.is_j1939:
                groups.setdefault(_group(taken.message.frame_id), []).append(taken)
            else:
                alike.setdefault((taken.message.frame_id, taken.message.is_extended_frame), []).append(taken)
        for (identifier, is_extended), some in alike.items():
            some[0].any_format = len(some) == 1 and some[0].message.length <= 8
            for taken in some if is_extended else ():
                taken.overrides = tuple(other.name for other in groups.get(_group(identifier), ()))
        for group, some in groups.items():
            for taken, pattern in zip(some, _patterns_of([taken.message for taken in some]), strict=True):
                taken.identifier = pattern
            if len(some) > 1:
                names = ", ".join(ProblemText.clean(taken.message.name) for taken in some)
                text = f"messages of one parameter group ({group >> 8:05X}h): {names}: distinguished by source address"
                self._note(some[0].line, text)

    def _message(self, taken: _Taken) -> None:
        message, name = taken.message, taken.name
        self._declare(taken, name, message.signals, message.length)
        if name != message.name:
            self._note(taken.line, f"message {ProblemText.clean(message.name)} is called {name} here")
        shorter = [n for n in _lengths_of(message) if n < message.length]
        for size in shorter:
            known = len(self.problems)
            short = PythonNames.unused(f"{message.name}_{size}", self.taken)
            self._declare(taken, short, _fitting(message.signals, size), size)
            del self.problems[known:]  # said of the whole message
        if shorter:
            text = f"message {ProblemText.clean(message.name)} has shorter frames, too, which are messages of their own here"
            self._note(taken.line, f"{text} ({', '.join(f'{name}_{size}' for size in shorter)})")

    def _declare(self, taken: _Taken, name: str, signals: Sequence[Any], size: int) -> None:
        message, fd = taken.message, taken.fd
        known = len(self.problems)
        lengths: list[int] | None = [size] if size < message.length else None
        if lengths is None and fd:
            lengths = [n for n in FD_LENGTHS if n >= size]
        longest = 64 if fd else taken.transport.max_size if taken.transport is not None else 8
        most = longest if lengths is None or len(lengths) > 1 else size
        captured = (capture.name for capture in taken.identifier.captures)
        names = {"reserved", TRAILING, *PythonNames.TAKEN_BY_RECORDS, *captured}
        layout = self._layout(message, signals, size, most, names)
        try:
            made = self.protocol.message(
                name,
                id=taken.identifier,
                payload=layout,
                extended=bool(message.is_extended_frame),
                fd=fd,
                any_format=taken.any_format,
                length=lengths,
                transport=taken.transport,
                overrides=taken.overrides,
                doc=_doc_of(message),
            )
        except AcesError as error:
            del self.problems[known:]
            raise _LeftOut(ProblemText.of_error(error)) from None
        made.place = SourceLine(self.path, taken.line or 1)

    def _layout(
        self, message: DbcMessage, signals: Sequence[DbcSignal], size: int, most: int, taken: set[str]
    ) -> BitLayout:
        names: dict[str, str] = {}
        fields: list[c.Construct] = []
        masks = 0
        overlapping = False
        by_name: dict[str, DbcSignal] = {}
        for signal in signals:
            by_name.setdefault(signal.name, signal)
        for signal in _selectors_first(signals, by_name):
            line = self.lines(message, signal)
            try:
                at = _place(signal, size)
                field = _value(signal, at)
                if signal.multiplexer_signal is not None:
                    field = self._multiplexed(signal, field, by_name, names)
            except (_LeftOut, AcesError) as reason:
                shown = f"signal {ProblemText.clean(message.name)}.{ProblemText.clean(signal.name)}"
                self.problems.append(
                    ImportProblem(line, f"{shown}: {ProblemText.of_error(reason)}: left out")
                )
                continue
            name = PythonNames.unused(signal.name, taken)
            if by_name[signal.name] is signal:
                names[signal.name] = name
            if name != signal.name:
                shown = f"signal {ProblemText.clean(message.name)}.{ProblemText.clean(signal.name)}"
                self._note(line, f"{shown} is called {name} here")
            mask = _mask(signal, at)
            overlapping = overlapping or bool(mask & masks)
            masks |= mask
            fields.append(c.Renamed(field, newname=name, newdocs=ProblemText.clean(signal.comment or "")))
        trailing = TRAILING if size < most else ""
        if overlapping:
            # Most share bits only with what excludes them.
            try:
                return BitLayout(size, *fields, trailing=trailing)
            except AcesError as error:
                text = re.sub(r" \([^()]*:\d+\)", "", ProblemText.of_error(error).partition("; if that")[0])
                text = f"message {ProblemText.clean(message.name)}: {text}: all are decoded, and what is sent must agree"
                self._note(self.lines(message, None), text)
        return BitLayout(size, *fields, overlapping=overlapping, trailing=trailing)

    def _multiplexed(
        self,
        signal: Any,
        field: c.Construct,
        by_name: Mapping[str, Any],
        names: Mapping[str, str],
    ) -> Multiplexed:
        selector = by_name.get(signal.multiplexer_signal)
        if selector is None or signal.multiplexer_signal not in names:
            raise _LeftOut(f"its multiplexer {ProblemText.clean(signal.multiplexer_signal)} is not there")
        if not selector.is_multiplexer:
            raise _LeftOut(f"its multiplexer {ProblemText.clean(selector.name)} is not declared as one")
        if not signal.multiplexer_ids:
            raise _LeftOut(f"no value of its multiplexer {ProblemText.clean(selector.name)} is given")
        when = _raw_values(selector, signal.multiplexer_ids)
        if not when:
            raise _LeftOut(f"its multiplexer {ProblemText.clean(selector.name)} never has the value it wants")
        return Multiplexed(names[selector.name], when, field)


def _key(message: DbcMessage) -> tuple[int, bool, int, bool]:
    return message.frame_id, bool(message.is_extended_frame), message.length, bool(message.is_fd)


def _group(identifier: int) -> int:
    """Return the bits of an identifier that say its parameter group (SAE J1939-21)."""
    return identifier & (0x3FF_0000 if identifier >> 16 & 0xFF < 240 else 0x3FF_FF00)


def _patterns_of(messages: Sequence[DbcMessage]) -> list[IdPattern]:
    """Return the identifiers of the messages of one parameter group: alone any priority, source and destination."""
    identifiers = [message.frame_id for message in messages]
    group = _group(identifiers[0])
    is_addressed = identifiers[0] >> 16 & 0xFF < 240
    parts = {"source": (0, 8), "destination": (8, 8), "priority": (26, 3)}
    if not is_addressed:
        del parts["destination"]
    masks = {name: ((1 << width) - 1) << shift for name, (shift, width) in parts.items()}
    # As few parts as tell all of them apart: the rest may be anything.
    telling: list[str] = []
    for name in parts:
        mask = sum(masks[bit] for bit in telling)
        if len({identifier & mask for identifier in identifiers}) == len(identifiers):
            break
        telling.append(name)
    is_for_others = telling == ["source"] and len({_shape(message) for message in messages}) == 1
    sources = {identifier & 0xFF for identifier in identifiers}
    found = []
    for number, identifier in enumerate(identifiers):
        pattern: IdPattern | int = group
        for name in reversed(parts):
            shift, width = parts[name]
            values: Collection[int] = range(1 << width)
            if name in telling:
                own = identifier >> shift & ((1 << width) - 1)
                values = (own,)
                if is_for_others and number == 0:
                    values = tuple(n for n in range(256) if n == own or n not in sources)
            pattern = IdField(name, values) << shift | pattern
        assert isinstance(pattern, IdPattern)
        found.append(pattern)
    return found


def _shape(message: DbcMessage) -> tuple[Hashable, ...]:
    """Return how a message is laid out: equal for messages that give the same values of the same bytes."""
    return message.length, *(
        (
            *(signal.name, signal.start, signal.length, signal.byte_order, signal.is_signed, signal.unit),
            *(signal.conversion.is_float, signal.conversion.scale, signal.conversion.offset),
            *(signal.multiplexer_signal, str(signal.multiplexer_ids), str(signal.conversion.choices)),
        )
        for signal in message.signals
    )


def _doc_of(message: DbcMessage) -> str:
    facts = []
    senders = [str(sender) for sender in message.senders or () if sender]
    if senders:
        facts.append(f"sent by {', '.join(senders)}")
    receivers = sorted(
        {str(receiver) for signal in message.signals for receiver in signal.receivers or () if receiver}
    )
    if receivers:
        facts.append(f"to {', '.join(receivers)}")
    if message.cycle_time:
        facts.append(f"every {message.cycle_time} ms")
    said = ProblemText.clean(message.comment or "")
    return ProblemText.clean("\n".join(filter(None, [said, "; ".join(facts)])))


# ---------------------------------------------------------------------- signals


def _lengths_of(message: DbcMessage) -> list[int]:
    """Return the lengths that the attribute `LENGTHS` gives a message; none where it has none or none that can be read."""
    attributes = getattr(message.dbc, "attributes", None) or {}
    words = str(attributes[LENGTHS].value).split() if LENGTHS in attributes else []
    return sorted({int(word) for word in words if re.fullmatch(r"\d{1,2}", word, re.ASCII)})


def _fitting(signals: Sequence[DbcSignal], size: int) -> list[DbcSignal]:
    """Return the signals of frames of `size` bytes: of those that a multiplexer value has, all or none."""

    def fits(signal: DbcSignal) -> bool:
        try:
            _place(signal, size)
        except _LeftOut:
            return False
        return True

    gone = {
        (signal.multiplexer_signal, value)
        for signal in signals
        if signal.multiplexer_ids and not fits(signal)
        for value in signal.multiplexer_ids
    }
    found: list[DbcSignal] = []
    for signal in signals:
        if not fits(signal):
            continue
        if signal.multiplexer_ids:
            left = [n for n in signal.multiplexer_ids if (signal.multiplexer_signal, n) not in gone]
            if not left:
                continue
            signal = copy.copy(signal)
            signal.multiplexer_ids = left
        found.append(signal)
    return found


def _selectors_first(signals: Sequence[Any], by_name: Mapping[str, Any]) -> list[Any]:
    """Return the signals in their order, but each behind its multiplexer."""
    done: dict[int, Any] = {}

    for signal in signals:
        way: list[Any] = []
        one = signal
        # A chain of multiplexers that ends in itself stops where it comes round; it is found wrong later.
        while one is not None and id(one) not in done and not any(one is seen for seen in way):
            way.append(one)
            one = by_name.get(one.multiplexer_signal) if one.multiplexer_signal is not None else None
        for signal in reversed(way):
            done.setdefault(id(signal), signal)
    return list(done.values())


def _place(signal: DbcSignal, size: int) -> int:
    """Return the number of the signal's first bit in its own bit order; raises where it ends past the message."""
    at, width = int(signal.start), int(signal.length)
    if signal.byte_order == "big_endian":
        at = 8 * (at // 8) + 7 - at % 8
    if width < 1:
        raise _LeftOut(f"{width} bits")
    if at < 0 or at + width > 8 * size:
        raise _LeftOut(f"it ends at bit {at + width - 1}, past the {size} bytes of its message")
    return at


def _mask(signal: DbcSignal, at: int) -> int:
    """Return the bits of a signal in the little-endian word of its message."""
    if signal.byte_order != "big_endian":
        return ((1 << int(signal.length)) - 1) << at
    return sum(1 << (position ^ 7) for position in range(at, at + signal.length))


def _value(signal: DbcSignal, at: int) -> c.Construct:
    """Return the field of a signal: its bits, what they mean, and how."""
    conversion = signal.conversion
    order = "msb" if signal.byte_order == "big_endian" else "lsb"
    choices = _names(signal)
    if conversion.is_float:
        if signal.length not in (16, 32, 64):
            raise _LeftOut(f"a float of {signal.length} bits")
        if choices:
            raise _LeftOut("a float with a value table")
        place: c.Construct = float_bits(signal.length, at, order=order)
    else:
        place = bits(signal.length, at, signed=bool(signal.is_signed), order=order)
    scale, offset = conversion.scale, conversion.offset
    if scale == 0:
        raise _LeftOut("a factor of 0")
    if not math.isfinite(scale) or not math.isfinite(offset):
        raise _LeftOut(f"the factor {scale}, the offset {offset}")
    if float(scale).is_integer() and float(offset).is_integer():
        if not conversion.is_float or (scale == 1 and offset == 0):
            scale, offset = int(scale), int(offset)
    unit = ProblemText.clean(signal.unit or "")
    if choices and scale == 1 and not offset and not unit:
        return Enumeration(place, choices)
    span = _range(signal)
    if scale == 1 and not offset and not unit and span is None:
        return place
    if choices and not _are_distinct(choices, signal, scale, offset):
        raise _LeftOut("its value table names numbers that its factor makes equal")
    return Quantity(place, unit=unit, scale=scale, offset=offset, range=span, names=choices)


def _names(signal: DbcSignal) -> dict[str, int]:
    """Return the value table, without numbers that the signal cannot have; a name that is there twice gets its number."""
    low, high = _limits(signal)
    names: dict[str, int] = {}
    for value, text in (signal.conversion.choices or {}).items():
        if low <= value <= high:
            name = without_controls(str(text))
            names[name if name not in names else f"{name}_{value}"] = int(value)
    return names


def _limits(signal: DbcSignal) -> tuple[int, int]:
    low = -(1 << signal.length - 1) if signal.is_signed else 0
    return low, low + (1 << signal.length) - 1


def _are_distinct(names: Mapping[str, int], signal: DbcSignal, scale: float, offset: float) -> bool:
    """Return whether each named number is, scaled, unlike its neighbours: then the scaled number shows whether it is
    named.
    """
    low, high = _limits(signal)
    for raw in names.values():
        for other in (raw - 1, raw + 1):
            if low <= other <= high and raw * scale + offset == other * scale + offset:
                return False
    return True


def _range(signal: DbcSignal) -> tuple[float, float] | None:
    low, high = signal.minimum, signal.maximum
    if low is None and high is None:
        return None
    ends = (
        [-float_info.max, float_info.max]
        if signal.conversion.is_float
        else sorted(raw * signal.conversion.scale + signal.conversion.offset for raw in _limits(signal))
    )
    low = ends[0] if low is None else _plain(low)
    high = ends[1] if high is None else _plain(high)
    is_span = math.isfinite(low) and math.isfinite(high) and low <= high and not low == high == 0
    return (low, high) if is_span else None


def _plain(number: Any) -> float:
    return number if isinstance(number, (int, float)) else float(number)


def _raw_values(selector: DbcSignal, wanted: Any) -> frozenset[int]:
    """Return the raw values of a multiplexer that mean one of `wanted`.

    cantools compares the scaled number, cut off to a whole one, or the number of the name; factors are rare here.
    """
    low, high = _limits(selector)
    conversion = selector.conversion
    if conversion.is_float:
        return frozenset()
    if conversion.scale == 1 and conversion.offset == 0:
        return frozenset(value for value in wanted if low <= value <= high)
    among = range(low, high + 1)
    if selector.length > SEARCHED:
        near = {round((value - conversion.offset) / conversion.scale) for value in wanted}
        among_near = {n + step for n in near for step in (-1, 0, 1)} | set(conversion.choices or ())
        return frozenset(n for n in among_near if n in among and _number(conversion, n) in set(wanted))
    ids = set(wanted)
    return frozenset(raw for raw in among if _number(conversion, raw) in ids)


def _number(conversion: Any, raw: int) -> int:
    if conversion.choices and raw in conversion.choices:
        return raw
    return int(raw * conversion.scale + conversion.offset)
