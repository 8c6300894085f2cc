"""Messages on a host's bus that belong to none of its devices: each is reported by name, and stops nothing.

1. A malformed packet is laid to the device that may have sent it, an answer without a request to the device asked last.
   What a serial line has garbled is an answer lost: CAN sends such frames again by itself, and says nothing.
2. A second answer to one request is a fault of the bus; several within a short time are a second device with one number.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from typing import Literal

from ..protocol import Record, Variant
from ..protocol.record import Unknown as UnknownRecord
from .device import Device
from .events import Kind
from .half_duplex import HalfDuplexLine
from .station import credential_text

#: So many second answers within so long (ns), or within so many rounds of polls, are another device's: a receiver gets a
#: frame twice now and then (an error in its last bit).
DUPLICATES, DUPLICATES_NS, DUPLICATES_ROUNDS = 3, 1_000_000_000, 5
#: What comes so soon (ns) after the bus was opened may answer the program before: it waited for somebody to acknowledge it.
OPENING_NS = 100_000_000
#: What noise makes of packets, and a late answer that meets the next request or whose end comes after its time.
GARBLED = frozenset(("malformed: checksum", "malformed: incomplete"))
#: At most so many unknown devices are reported one by one; a bus may claim millions.
UNKNOWN_DEVICES = 10_000


class UnknownTraffic:
    """The unknown traffic of one bus, counted and reported.

    `emit` reports an event: its kind, a device's name, details. `period_ns` is the duration of a tick (ns).
    """

    def __init__(
        self,
        emit: Callable[[Kind, str, str], None],
        link: Literal["can", "serial", "datagram"],
        variants: Mapping[str, Variant],
        members: Mapping[str, Device],
        period_ns: int,
    ) -> None:
        self._emit, self._link, self._variants = emit, link, variants
        self._members, self._period_ns = members, period_ns
        #: When the bus was opened (ns).
        self.opened_at = 0
        #: Packets that were not understood, by reason; records of unknown devices, by message and credentials.
        self.reasons: Counter[str] = Counter()
        self.devices: Counter[str] = Counter()
        #: Called with each packet that was not understood.
        self.handlers: list[Callable[[UnknownRecord, int], None]] = []

    def not_understood(self, unknown: UnknownRecord, instant: int, line: HalfDuplexLine | None) -> None:
        """Count a packet that is unknown, malformed or, on a half-duplex line, a late answer."""
        self.reasons[unknown.reason] += 1
        for handler in self.handlers:
            handler(unknown, instant)
        if not unknown.reason.startswith("malformed"):
            if unknown.reason.startswith("unknown: needs request") and line is not None:
                self._answered_twice(line.spoke_last, unknown, instant)
            return
        device = self._suspect(unknown, line)
        is_garbled = self._link == "serial" and unknown.reason in GARBLED
        raw = unknown.meta.raw.hex(" ") + " …" * is_garbled
        where = f"{unknown.meta.identifier:#05x} " if unknown.meta.identifier is not None else ""
        kind: Kind = "garbled" if is_garbled else "malformed"
        self._emit(kind, device.name if device is not None else "", f"{where}{raw}: {unknown.reason[11:]}")
        if device is not None:
            device.malformed(unknown.reason, instant)

    def _answered_twice(self, device: Device | None, unknown: UnknownRecord, instant: int) -> None:
        """Report an unrequested answer on a half-duplex line: it is late, or a second device answers to
        `device`'s number.
        """
        detail = f"{unknown.meta.raw.hex(' ')}: was not requested"
        if device is None:
            self._emit("duplicate reply", "", detail)
        else:
            self.duplicate(device, detail, instant)

    def duplicate(self, device: Device, detail: str, instant: int) -> None:
        """Count a second answer to one request: once it is a fault of the bus, again and again a second device."""
        self._emit("duplicate reply", device.name, detail)
        if instant - self.opened_at < OPENING_NS:
            return
        device.duplicates = came = [*device.duplicates, instant][-DUPLICATES:]
        tick_s = self._period_ns / 1e9
        round_s = min((poll.every_s or tick_s for poll in device.all_polls), default=0.0)
        lately = instant - max(DUPLICATES_NS, round(DUPLICATES_ROUNDS * round_s * 1e9))
        if len(came) == DUPLICATES and came[0] > lately:
            device.duplicates = []
            who = credential_text(device.credentials)
            device.report_double(
                f"{detail}; are there two devices with {who}, or does another program ask it, too?"
            )

    def _suspect(self, unknown: UnknownRecord, line: HalfDuplexLine | None) -> Device | None:
        """Return the device that may have sent it: by its identifier, or the one that has the line."""
        identifier = unknown.meta.identifier
        if identifier is None:
            return line.speaker if line is not None else None
        for variant in self._variants.values():
            for message in variant.messages_for("from device"):
                captures = message.identifier.match(identifier) or {}
                for device in self._members.values():
                    if device.variant is variant and any(
                        device.credentials.get(name) == value for name, value in captures.items()
                    ):
                        return device
        return None

    def unaddressed(self, record: Record) -> None:
        """Count a record of a device that is not in the robot's file."""
        kind = type(record)
        names = {name for device in self._members.values() for name in device.credentials}
        who = ", ".join(
            f"{n} {getattr(record, n):#04x}"
            for n in sorted(names)
            if isinstance(getattr(record, n, None), int)
        )
        name = f"{kind.__name__} {who}"
        if name in self.devices or len(self.devices) < UNKNOWN_DEVICES:
            self.devices[name] += 1
        self._emit(
            "unknown device",
            "",
            f"{kind.__name__} of {who or 'an unknown device'}, which is not on this bus in the robot's file",
        )
