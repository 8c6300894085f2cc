"""Messages on a host's bus that belong to none of its devices: each is reported by name, and stops nothing.

1. A malformed word is laid to the device that may have sent it; an answer that nothing asked for, to who was asked last.
2. A second answer to one request is a fault of the bus; several within a short time are a second device with one number.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from ..protocol import Unknown as UnknownWord
from .device import DUPLICATES, Device
from .half_duplex import HalfDuplexLine
from .station import shown

if TYPE_CHECKING:
    from .host import Host

#: Second answers that come within so long (ns) are not a receiver's, who may get a frame twice (an error in its last bit).
DUPLICATES_NS = 1_000_000_000
#: At most so many unknown devices are reported one by one; a bus may claim millions.
UNKNOWN_DEVICES = 10_000


class Strangers:
    """Made by `Host`, for its bus."""

    def __init__(self, host: Host) -> None:
        self.host = host
        #: Words that were not understood, by reason; records of unknown devices, by message and credentials.
        self.words: Counter[str] = Counter()
        self.devices: Counter[str] = Counter()
        #: Who is shown the words that were not understood.
        self.handlers: list[Callable[[UnknownWord, int], None]] = []

    def not_understood(self, word: UnknownWord, instant: int, line: HalfDuplexLine | None) -> None:
        """A word that is no message of the bus's protocols, a malformed one, or, on a line, an answer that is late."""
        self.words[word.reason] += 1
        for handler in self.handlers:
            handler(word, instant)
        if not word.reason.startswith("malformed"):
            if word.reason.startswith("unknown: needs request") and line is not None:
                self._answered_twice(line.spoke_last, word, instant)
            return
        device = self._suspect(word, line)
        raw = word.meta.raw.hex(" ")
        where = f"{word.meta.identifier:#05x} " if word.meta.identifier is not None else ""
        self.host.tell(
            "malformed", device.name if device is not None else "", f"{where}{raw}: {word.reason[11:]}"
        )
        if device is not None:
            device.malformed(word.reason, instant)

    def _answered_twice(self, device: Device | None, word: UnknownWord, instant: int) -> None:
        """An unrequested answer on a half-duplex line: it is late, or two devices answer to what `device` was asked last."""
        detail = f"{word.meta.raw.hex(' ')}: was not requested"
        if device is None:
            self.host.tell("duplicate reply", "", detail)
        else:
            self.duplicate(device, detail, instant)

    def duplicate(self, device: Device, detail: str, instant: int) -> None:
        """A second answer to one request: once it is a fault of the bus, again and again a second device."""
        self.host.tell("duplicate reply", device.name, detail)
        device.duplicates.append(instant)
        if len(device.duplicates) == DUPLICATES and instant - device.duplicates[0] < DUPLICATES_NS:
            device.duplicates.clear()
            who = shown(device.credentials)
            self.host.tell("two devices", device.name, f"{detail}; are there two devices with {who}?")

    def _suspect(self, word: UnknownWord, line: HalfDuplexLine | None) -> Device | None:
        """The device that may have sent it: by its identifier, or the one that has the line."""
        identifier = word.meta.identifier
        if identifier is None:
            return line.speaker if line is not None else None
        for variant in self.host.variants.values():
            for message in variant.messages_for("from device"):
                captures = message.identifier.match(identifier) or {}
                for device in self.host.members.values():
                    if device.variant is variant and any(
                        device.credentials.get(name) == value for name, value in captures.items()
                    ):
                        return device
        return None

    def unaddressed(self, record: Any) -> None:
        """A record of a device that is not in the robot's file."""
        kind = type(record)
        names = {name for device in self.host.members.values() for name in device.credentials}
        who = ", ".join(
            f"{n} {getattr(record, n):#04x}"
            for n in sorted(names)
            if isinstance(getattr(record, n, None), int)
        )
        name = f"{kind.__name__} {who}"
        if name in self.devices or len(self.devices) < UNKNOWN_DEVICES:
            self.devices[name] += 1
        self.host.tell(
            "unknown device",
            "",
            f"{kind.__name__} of {who or 'an unknown device'}, which is not on this bus in the robot's file",
        )
