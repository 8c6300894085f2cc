"""What a run of scenes has reached of a protocol: messages, fields, named values, templates; and what never.

1. Expected is what the spec declares, over all variants that are scanned; reached is what a scanner gave.
2. A template is reached in every way that it can end: accepted, and refused for each reason that it has.
3. A field has been reached when it had a value; an optional one, when it also had none.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import Any

from ..protocol import Record
from ..protocol.declare.bits import BitLayout
from ..protocol.declare.delimited import Delimited
from ..protocol.declare.fields import Multiplexed
from ..protocol.declare.framing import Framing
from ..protocol.declare.head import enumeration_of
from ..protocol.declare.message import Message
from ..protocol.record import FieldValue, Unknown
from .bench import Bench
from .trial import Trial

#: (protocol, kind, name): kind is "message", "field", "value" or "template".
Feature = tuple[str, str, str]


def expected(bench: Bench) -> set[Feature]:
    """Return what scenes of this wire should reach."""
    found: set[Feature] = set()
    for (protocol, name), message in bench.by_name.items():
        found.add((protocol, "message", name))
        for field, optional in _fields(message).items():
            found.add((protocol, "field", f"{name}.{field}"))
            if optional:
                found.add((protocol, "field", f"{name}.{field} (absent)"))
        for field, names in _named(message).items():
            found |= {(protocol, "value", f"{name}.{field}={value}") for value in names.values()}
        if message.framing is None:
            found.add((protocol, "template", f"{name}: accepted"))
            if message.lengths is None or len(message.lengths) < (16 if message.fd else 9):
                if not message.remote:
                    found.add((protocol, "template", f"{name}: other length"))
            if message.check is not None:
                found.add((protocol, "template", f"{name}: wrong check"))
    for variant, framing, _ in bench.framings:
        found |= {(variant.name, "template", f"{_label(framing)}: {end}") for end in _ends(framing)}
    return found


def _ends(framing: Framing) -> list[str]:
    ends = ["accepted"]
    if framing.check is not None:
        ends.append("wrong check")
    if framing.affine is not None:
        if framing.affine.largest > framing.max_size or framing.affine.constant < framing.min_size:
            ends.append("impossible length")
    if framing.end:
        ends.append("no end")
    if framing.head_end and not framing.is_silent:
        ends.append("cut off")
    return ends


def _label(framing: Framing) -> str:
    return f"framing {framing.name}"


def _declared(message: Message) -> list[tuple[str, Any, bool]]:
    """Return the payload's own fields: name, construct, and whether it may be absent."""
    payload: Any = message.payload
    if isinstance(payload, BitLayout):
        return [(slot.name, slot.field, slot.mux is not None) for slot in payload.slots]
    if isinstance(payload, Delimited):
        return [(item.name, item, n >= payload.least) for n, item in enumerate(payload.fields)]
    items = [(item.name, item.subcon) for item in payload.subcons if item.name]
    return [(name, con, isinstance(con, Multiplexed)) for name, con in items]


def _fields(message: Message) -> dict[str, bool]:
    """Return names of a record's fields, and whether each may be absent."""
    optional = {name for name, _, may_be_absent in _declared(message) if may_be_absent}
    return {name: name in optional for name in message.fields if name not in message.request_fields}


def _named(message: Message) -> dict[str, Mapping[int, str]]:
    """Return the named values of top-level fields."""
    found = {name: enumeration_of(con) for name, con, _ in _declared(message) if name in message.fields}
    return {
        name: found_part.values
        for name, found_part in found.items()
        if found_part is not None and len(found_part.values) <= 64
    }


class Coverage:
    """What was reached, how often, over any number of wires. Two can be added: processes report theirs."""

    def __init__(self) -> None:
        self.reached: Counter[Feature] = Counter()
        self.expected: set[Feature] = set()
        self._named: dict[Message, dict[str, Mapping[int, str]]] = {}

    def expects(self, bench: Bench) -> None:
        """Reckon with what this wire can reach."""
        self.expected |= expected(bench)

    def add(self, other: Coverage) -> None:
        """Take over what another run has reached."""
        self.reached += other.reached
        self.expected |= other.expected

    def note(self, trial: Trial) -> bool:
        """Count what a trial reached; whether some of it is new."""
        before = len(self.reached)
        reached = self.reached
        names = trial.bench.by_name
        for number, item in enumerate(trial.given):
            if isinstance(item, Unknown):
                if item.reason.startswith(("malformed", "pending")):
                    self._refused(trial, number, item)
                continue
            name = type(item).__name__
            protocol = item._protocol
            reached[protocol, "message", name] += 1
            message = names.get((protocol, name))
            if message is None:
                continue
            where = f"{name}: accepted" if message.framing is None else f"{_label(message.framing)}: accepted"
            reached[protocol, "template", where] += 1
            if reached[protocol, "message", name] & 7 < 5:
                self._fields(protocol, message, item)
        return len(reached) > before

    def _fields(self, protocol: str, message: Message, record: Record) -> None:
        named = self._named.get(message)
        if named is None:
            named = self._named[message] = _named(message)
        for field in message.fields:
            value: FieldValue = getattr(record, field, None)
            what = f"{message.name}.{field}" if value is not None else f"{message.name}.{field} (absent)"
            self.reached[protocol, "field", what] += 1
            if field in named:
                values: Any = value if isinstance(value, (list, tuple)) else (value,)
                for single in values:
                    if (text := named[field].get(single)) is not None:
                        self.reached[protocol, "value", f"{message.name}.{field}={text}"] += 1

    def _refused(self, trial: Trial, number: int, item: Unknown) -> None:
        """Count a loss at the template that it belongs to."""
        bench = trial.bench
        if bench.is_can:
            frame = trial.scene.traffic[number] if number < len(trial.scene.traffic) else None
            if frame is None:
                return
            end = "wrong check" if "checksum" in item.reason else "other length"
            for (protocol, name), message in bench.by_name.items():
                if message.identifier.match(frame.arbitration_id) is not None:
                    if message.extended == frame.is_extended_id:
                        self.reached[protocol, "template", f"{name}: {end}"] += 1
            return
        end = next(
            (text for part, text in _WHY if part in item.reason),
            "cut off" if item.reason == "pending" else "",
        )
        if end:
            for variant, framing, _ in bench.framings:
                if item.meta.raw.startswith(framing.sync[:1]):
                    self.reached[variant.name, "template", f"{_label(framing)}: {end}"] += 1

    def never(self, protocol: str | None = None) -> list[Feature]:
        """Return what was expected and never reached, in the order of `KINDS`."""
        left = [f for f in self.expected if f not in self.reached and protocol in (None, f[0])]
        return sorted(left, key=lambda f: (f[0], Coverage.KINDS.index(f[1]), f[2]))

    def parts(self, protocol: str, kind: str) -> tuple[int, int]:
        """Return how many features of a kind were reached, and how many there are."""
        wanted = [f for f in self.expected if f[0] == protocol and f[1] == kind]
        return sum(f in self.reached for f in wanted), len(wanted)

    def of_message(self, protocol: str, message: str, kind: str) -> tuple[int, int]:
        """Return the same of one message."""
        start = f"{message}." if kind in ("field", "value") else f"{message}:"
        wanted = [f for f in self.expected if f[0] == protocol and f[1] == kind and f[2].startswith(start)]
        return sum(f in self.reached for f in wanted), len(wanted)

    @property
    def protocols(self) -> list[str]:
        """The names of the protocols, sorted."""
        return sorted({f[0] for f in self.expected})

    KINDS = ("message", "field", "value", "template")


#: What a reason for a loss says about the template.
_WHY = (
    ("checksum", "wrong check"),
    ("malformed: length", "impossible length"),
    ("no end", "no end"),
    ("incomplete", "cut off"),
)


__all__ = ["Coverage", "Feature", "expected"]
