"""What stands between twins and their bus: it notes all that passes, and does to answers what a fault says.

1. Faults are drawn from a seed and done to answers by number, so that the same run has the same faults.
2. What is noted is what is on the wire; what a fault has done to it stands beside it.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import msgspec

from aces_bus import Frame, Unknown, as_dict, make_scanner
from aces_bus.device.port import Left, Packet, Port, UpperPort
from aces_bus.device.twin import Twins, with_data
from aces_bus.errors import AcesError
from aces_bus.frames import FD_LENGTHS
from aces_bus.protocol import Record, Variant
from aces_bus.protocol.record import FieldValue, PlainValue

#: What comes so long behind a request (ns) is not an answer to it.
ASKED_NS = 50_000_000
#: What a fault makes of an answer: each packet with its delay (ns).
Sendings = Sequence[tuple[int, Any]]


class Passed(NamedTuple):
    """A frame or bytes that passed: when (ns), whether a twin sent it, and what a fault did to it."""

    instant: int
    is_answer: bool
    packet: Any
    note: str = ""


class TwinTap(UpperPort):
    """The port of a bus's twins. `alter(number, packet)` says what becomes of the answer of this number; None: nothing.

    What a twin sends of its own accord is not counted, and has the number -1: what comes when nothing was asked for a while,
    and from then on all of its kind.
    """

    def __init__(self, port: Port) -> None:
        super().__init__(port)
        self.passed: list[Passed] = []
        self.answers = 0
        self._asked_at = -ASKED_NS
        self._unasked: set[object] = set()
        self.alter: Callable[[int, Any], tuple[str, Sendings] | None] | None = None

    def open(self, received: Callable[[Frame | bytes, int], object]) -> None:
        """Start receiving."""
        note = self.passed.append

        def both(packet: Frame | bytes, instant: int) -> None:
            self._asked_at = instant
            note(Passed(instant, False, packet))
            received(packet, instant)

        self.port.open(both)

    def send(
        self,
        packet: Frame | bytes,
        age_ns: int = 0,
        *,
        urgent: bool = False,
        topic: object = None,
        report: Left | None = None,
    ) -> bool:
        """Send on the port below, as the fault says."""
        number = self._number(packet)
        altered = None if self.alter is None else self.alter(number, packet)
        if altered is None:
            return self._give("", packet, report)
        name, sendings = altered
        clock = self.port.clock
        if not sendings:
            self.passed.append(Passed(clock.now(), True, packet, f"{name}: not sent"))
        for delay, made in sendings:
            said = name if made is not packet or delay else ""
            if delay:
                clock.post(clock.now() + delay, partial(self._give, said, made, None))
            else:
                self._give(said, made, None)
        if report is not None:
            clock.call_soon(lambda: report("sent", ""))
        return True

    def _number(self, packet: Frame | bytes) -> int:
        kind = packet.arbitration_id if isinstance(packet, Frame) else bytes(packet[:4])
        if self.port.clock.now() - self._asked_at > ASKED_NS:
            self._unasked.add(kind)
        if kind in self._unasked:
            return -1
        self.answers += 1
        return self.answers - 1

    def _give(self, note: str, packet: Frame | bytes, report: Left | None) -> bool:
        is_taken = self.port.send(packet) if report is None else self.port.send(packet, report=report)
        self.passed.append(
            Passed(self.port.clock.now(), True, packet, note if is_taken else "the bus did not take it")
        )
        return is_taken


# ---------------------------------------------------------------------- what can be made of an answer


class Answers:
    """What the spec makes of answers: others' numbers, other values."""

    def __init__(self, twins: Twins) -> None:
        self._variants: dict[str, Variant] = dict(twins.variants)
        self._twins = twins
        #: Fields that requests and answers share: whom an answer is for, and what it is about.
        self._addresses = _shared_fields(twins)
        self._credentials = {name for twin in twins.members.values() for name in twin.credentials}

    def record(self, packet: Packet) -> Any:
        """Return the record that a packet is by itself; None: it is none, or one of several frames."""
        if isinstance(packet, tuple):
            if len(packet) != 1:
                return None
            packet = packet[0]
        scanner = make_scanner(list(self._variants.values()), direction="from device")
        found = [*scanner.feed([packet] if isinstance(packet, Frame) else packet), *scanner.close()]
        return found[0] if len(found) == 1 and not isinstance(found[0], Unknown) else None

    def built(self, record: Record, changed: dict[str, Any]) -> Any:
        """Return the packet of a record with other values; None: it cannot be."""
        protocol = next(v for v in self._variants.values() if type(record).__name__ in v.messages)
        fields = {**_plain(as_dict(record)), **changed}
        try:
            return protocol.encoder.packet(protocol[type(record).__name__], fields)
        except (AcesError, ValueError, TypeError):
            return None

    def of_another(self, packet: Frame | bytes) -> Any:
        """Return the answer as another device's, whose number is one more, or one less; None: it cannot be."""
        record = self.record(packet)
        names = self._credentials.intersection(getattr(record, "__struct_fields__", ()))
        mine = {tuple(sorted(twin.credentials.items())) for twin in self._twins.members.values()}
        for step in (1, -1, 2, -2, 3):
            numbers = {name: getattr(record, name) + step for name in names}
            if not names or tuple(sorted(numbers.items())) in mine:
                continue
            if (made := self.built(record, numbers)) is not None and made != packet:
                return made
        return None

    def with_other_values(self, packet: Frame | bytes) -> Any:
        """Return the answer with other numbers in it, its kind and its credentials as they are; None: it has none."""
        record = self.record(packet)
        if record is None:
            return None
        changed: dict[str, PlainValue] = {}
        for name, value in as_dict(record).items():
            if name in self._credentials or name in self._addresses:
                continue
            for other in _others(value):
                if (made := self.built(record, {**changed, name: other})) is not None and made != packet:
                    changed[name] = other
                    break
        return self.built(record, changed) if changed else None


def _shared_fields(twins: Twins) -> set[str]:
    """Return the names of whole numbers and bytes that messages of both ways have."""
    ways: dict[str, set[str]] = {"to device": set(), "from device": set()}
    for variant in twins.variants.values():
        for message in variant.messages.values():
            if message.direction in ways:
                ways[message.direction].update(capture.name for capture in _captures(message))
    return ways["to device"] & ways["from device"]


def _captures(message: Any) -> Any:
    return getattr(message.identifier, "captures", ()) if message.identifier is not None else ()


def _plain(values: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in values.items() if name != "reserved"}


def _others(value: FieldValue) -> list[Any]:
    """Return values that are not this one, the likeliest to fit first."""
    if isinstance(value, bool):
        return [not value]
    if isinstance(value, float):
        return [value * 0.5 + 1.0, value * 0.5, value - 1.0, -value]
    if isinstance(value, int):
        return [value ^ 3, value + 1, value - 1]
    if isinstance(value, bytes) and value:
        return [bytes(byte ^ 0x11 for byte in value)]
    if isinstance(value, (list, tuple)) and value and all(isinstance(part, (int, float)) for part in value):
        return [type(value)(_others(part)[0] for part in value)]
    return []


def flipped(packet: bytes, dice: random.Random) -> Any:
    """Return bytes of a line with one bit wrong."""
    at, bit = dice.randrange(len(packet)), dice.randrange(8)
    return with_data(packet, lambda data: data[:at] + bytes((data[at] ^ 1 << bit,)) + data[at + 1 :])


def shortened(packet: Frame | bytes) -> Any:
    """Return a frame or packet that ends a byte early."""
    if not isinstance(packet, Frame):
        return with_data(packet, lambda data: data[:-1])
    size = max((n for n in FD_LENGTHS if n < len(packet.data)), default=0)
    return msgspec.structs.replace(packet, data=packet.data[:size])


__all__ = ["Answers", "Passed", "Sendings", "TwinTap", "flipped", "shortened"]
