"""Which signals a plot shows: patterns such as `Encoder[board=3].position.*:r--`, matched against what is declared.

1. All of this is decided from the protocols alone, before anything is read: a misspelt name is found at once.
2. `*` and `?` are the only wildcards, and case does not count, as users of cantools have it.
3. A pattern with wildcards never takes what only distinguishes devices (a board's number), nor bits that belong to no
   field; by their full names they can be had.

A field that says whose values a message carries splits its signals into one line a device: what the protocol captures
from the identifier, and integers that are named like it (`is_device_column`). Any other field does so where a pattern
names it in brackets: `Get[selector=*].value`.

`:FMT` behind a signal is a colour, marker and line style, as matplotlib and `cantools plot` write them; it means the same in
a file and in the terminal:

    r--   red, dashed        C2    the third colour        .k   black points
    o-    circles on a line  |     stems, from zero to the value
"""

from __future__ import annotations

import difflib
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

from aces_bus.errors import CallerError
from aces_bus.protocol import Variant
from aces_bus.protocol.columns.table import ColumnKind, kinds_of
from aces_bus.protocol.plan import nodes as p

from ..reading.device_columns import is_device_column

#: The pseudo field by which a pattern names the bus.
CHANNEL = "channel"
NEAR = 5

_PATTERN = re.compile(
    r"(?P<head>[^\[\]:]*)(?:\[(?P<where>[^\[\]]*)\](?P<rest>[^\[\]:]*))?(?::(?P<format>.*))?", re.DOTALL
)


# ---------------------------------------------------------------------- formats

_LINES = ("--", "-.", "-", ":")
_MARKERS = ".,ov^<>12348spP*hH+xXDd|_"
_COLOURS = "bgrcmykw"


@dataclass(frozen=True)
class ImageFormat:
    """What is not said is None, and left to the drawing."""

    colour: str | None = None
    marker: str | None = None
    line: str | None = None
    is_stem: bool = False


def parse_format(text: str, where: str) -> ImageFormat:
    """Return a format as it was typed behind the signal `where`; raises `CallerError` for what is none."""
    colour = marker = line = None
    is_stem = text.startswith("|")
    rest = text[1:] if is_stem else text
    while rest:
        style = next((style for style in _LINES if rest.startswith(style)), None)
        numbered = re.match(r"C\d", rest)
        if style is not None and line is None:
            line, rest = style, rest[len(style) :]
        elif numbered and colour is None:
            colour, rest = numbered[0], rest[2:]
        elif rest[0] in _COLOURS and colour is None:
            colour, rest = rest[0], rest[1:]
        elif rest[0] in _MARKERS and marker is None:
            marker, rest = rest[0], rest[1:]
        else:
            raise CallerError(
                f"{where!r}: {text!r} is not a format; it is made of a colour (b g r c m y k w C0…C9), a line"
                " (- -- -. :) and a marker (. o s x + D …), such as r-- or .k; | in front draws stems"
            )
    return ImageFormat(colour, marker, line, is_stem)


# ---------------------------------------------------------------------- signals


@dataclass(frozen=True)
class PlotSignal:
    """One number of a message over time. `column` is the table's column; of a flag, `bit` is its bit in that column.

    `conditional` says that other messages of the kind do not carry it (multiplexing): its absence is not a gap.
    """

    protocol: str
    message: str
    path: str
    column: str
    kind: ColumnKind = field(compare=False)
    conditional: bool = False
    bit: int | None = None
    is_number: bool = True
    #: Nothing that a wildcard means: a device's number, or unclaimed bits.
    is_quiet: bool = False
    #: Whether a message carries several values of it, each a point.
    is_list: bool = False

    @property
    def name(self) -> str:
        """As it is asked for."""
        return f"{self.message}.{self.path}"

    @property
    def owner(self) -> tuple[str, str]:
        """The protocol and message that it belongs to."""
        return self.protocol, self.message


@dataclass(frozen=True)
class Declared:
    """A message: its signals, and the columns that say whose they are."""

    signals: tuple[PlotSignal, ...]
    devices: tuple[str, ...]
    columns: frozenset[str]


def declared_signals(variants: Sequence[Variant]) -> dict[tuple[str, str], Declared]:
    """Return all that these protocols declare, by protocol and message."""
    found = {
        (variant.name, name): _declared(variant.name, name, message.plan)
        for variant in variants
        for name, message in variant.messages.items()
    }
    return found


def _declared(protocol: str, message: str, plan: p.MessagePlan) -> Declared:
    signals: list[PlotSignal] = []
    devices: list[str] = []
    for kind, leaf in zip(kinds_of(plan), plan.columns, strict=True):
        path, node = leaf.path, leaf.node
        is_device = is_device_column(leaf)
        if is_device:
            devices.append(path)
        conditional = bool(leaf.whens) or leaf.is_inside
        if kind.flags:
            signals += [
                PlotSignal(protocol, message, f"{path}.{flag}", path, kind, conditional, bit)
                for flag, bit in kind.flags.items()
            ]
            continue
        signals.append(
            PlotSignal(
                protocol,
                message,
                path,
                path,
                kind,
                conditional,
                is_number=node.has_numbers,
                is_quiet=is_device or node.is_unclaimed,
                is_list=node.repeats,
            )
        )
    return Declared(tuple(signals), tuple(devices), frozenset(kind.name for kind in kinds_of(plan)))


def glob(text: str) -> re.Pattern[str]:
    """Return a pattern in which `*` is any number of characters, `?` one; case does not count."""
    parts = (".*" if c == "*" else "." if c == "?" else re.escape(c) for c in text)
    return re.compile("".join(parts), re.IGNORECASE | re.DOTALL)


@dataclass(frozen=True)
class SignalPattern:
    """One SIGNAL of the command line. `where` are the conditions in brackets: (field, glob)."""

    text: str
    name: str
    where: tuple[tuple[str, str], ...] = ()
    #: What follows the brackets, if anything does: then `name` is the message alone.
    rest: str | None = None
    format: ImageFormat = field(default_factory=ImageFormat)

    @cached_property
    def _globs(self) -> tuple[re.Pattern[str], re.Pattern[str] | None]:
        return glob(self.name), None if self.rest is None else glob(self.rest)

    @property
    def is_wild(self) -> bool:
        """True if the pattern may match several signals."""
        return any(c in self.name + (self.rest or "") for c in "*?")

    def takes(self, signal: PlotSignal) -> bool:
        """Return whether it means this signal, devices apart."""
        name, rest = self._globs
        if rest is not None:
            return bool(name.fullmatch(signal.message)) and self._is_one(rest, signal.path, signal)
        if self._is_one(name, signal.name, signal) or self._is_one(name, signal.path, signal):
            return True
        return not self.is_wild and bool(name.fullmatch(signal.message)) and not signal.is_quiet

    def _is_one(self, wanted: re.Pattern[str], name: str, signal: PlotSignal) -> bool:
        if wanted.fullmatch(name):
            return not (self.is_wild and signal.is_quiet)
        if self.is_wild:
            return False
        parts = name.split(".")  # an array or a nested record by its name: all of it
        return any(
            wanted.fullmatch(".".join(parts[:end])) for end in range(1, len(parts)) if "." in name
        ) and (not signal.is_quiet)

    def holds(self, key: Sequence[tuple[str, str]]) -> bool:
        """Return whether the values of a device's fields are those in brackets."""
        values = dict(key)
        return all(name in values and _is_value(wanted, values[name]) for name, wanted in self.where)


def _is_value(wanted: str, value: str) -> bool:
    if glob(wanted).fullmatch(value):
        return True
    try:
        return int(wanted, 0) == int(value, 0)
    except ValueError:
        return False


def parse_pattern(text: str) -> SignalPattern:
    """Return a SIGNAL as it was typed; raises `CallerError` with how it is written."""
    found = _PATTERN.fullmatch(text)
    if found is None or not (found["head"] or found["where"]):
        raise CallerError(
            f"{text!r} is not a signal; write Message.signal, Message[board=3].signal or signal, with * and ?,"
            " and :FMT behind it such as :r--"
        )
    where: list[tuple[str, str]] = []
    for condition in (found["where"] or "").split(","):
        name, equals, value = condition.partition("=")
        if condition.strip() and not (equals and name.strip() and value.strip()):
            raise CallerError(
                f"{text!r}: {condition.strip()!r} is not a condition; write [board=3] or [board=*]"
            )
        if equals:
            where.append((name.strip(), value.strip()))
    rest = found["rest"]
    shape = parse_format(found["format"] or "", text)
    if rest:
        return SignalPattern(text, found["head"] or "*", tuple(where), rest.removeprefix("."), shape)
    return SignalPattern(text, found["head"] or "*", tuple(where), None, shape)


def parse_groups(texts: Sequence[str]) -> list[list[list[SignalPattern]]]:
    """Parse subplots, divided by `-`; in each its vertical axes, divided by `,`; in each the patterns."""
    groups: list[list[list[SignalPattern]]] = [[[]]]
    for text in texts:
        if text == "-":
            groups.append([[]])
        elif text == ",":
            groups[-1].append([])
        else:
            groups[-1][-1].append(parse_pattern(text))
    kept = [[axis for axis in group if axis] for group in groups]
    return [group for group in kept if group]


@dataclass(frozen=True)
class Wanted:
    """What is to be collected of one message."""

    signals: tuple[tuple[PlotSignal, tuple[SignalPattern, ...]], ...]
    #: Columns that split signals into lines.
    keys: tuple[str, ...]


def select(
    patterns: Sequence[SignalPattern], messages: dict[tuple[str, str], Declared]
) -> dict[tuple[str, str], Wanted]:
    """Return the signals that patterns mean, by message. Raises `CallerError` for a pattern that means none, with near
    names.
    """
    hit: set[SignalPattern] = set()
    found: dict[tuple[str, str], Wanted] = {}
    for owner, message in messages.items():
        signals: list[tuple[PlotSignal, tuple[SignalPattern, ...]]] = []
        keys = dict.fromkeys(message.devices)
        for signal in message.signals:
            takers: list[SignalPattern] = []
            for pattern in patterns:
                if (
                    signal.is_number
                    and pattern.takes(signal)
                    and {name for name, _ in pattern.where} <= {CHANNEL, *message.columns}
                ):
                    takers.append(pattern)
                    hit.add(pattern)
                    keys.update(dict.fromkeys(name for name, _ in pattern.where if name in message.columns))
            if takers:
                signals.append((signal, tuple(takers)))
        if signals:
            found[owner] = Wanted(tuple(signals), tuple(keys))
    for pattern in patterns:
        if pattern not in hit:
            raise CallerError(_missing(pattern, messages))
    return found


def _missing(pattern: SignalPattern, messages: dict[tuple[str, str], Declared]) -> str:
    every = [signal for message in messages.values() for signal in message.signals]
    meant = [signal for signal in every if pattern.takes(signal)]
    if any(signal.is_number for signal in meant):
        fields = ", ".join(
            sorted({key for s in meant for key in messages[s.owner].columns if "." not in key})
        )
        return f"{pattern.text!r}: no such message has a field {pattern.where[0][0]!r} (there are: {fields}, {CHANNEL})"
    if meant:
        return f"{meant[0].name} holds text or bytes, which no line can show; `aces decode` prints them"
    wanted = pattern.name if pattern.rest is None else f"{pattern.name}.{pattern.rest}"
    names = {signal.name: signal.name for signal in every}
    names.update({signal.path: signal.name for signal in every})
    names.update({message: f"{message}.*" for _, message in messages})
    lower = {name.lower(): full for name, full in names.items()}
    bare = wanted.replace("*", "").replace("?", "").lower()
    close = difflib.get_close_matches(bare, lower, n=NEAR, cutoff=0.5)
    near = list(dict.fromkeys(lower[name] for name in close))[:NEAR]
    hint = f"; near: {', '.join(near)}" if near else ""
    also = ", and no file has that name" if pattern.text == wanted and not pattern.is_wild else ""
    if os.path.isfile(pattern.text):
        also, hint = "; if the file is meant: captures come first, signals after them", ""
    return f"no signal matches {pattern.text!r}{also}{hint}; --list shows those that occur"
