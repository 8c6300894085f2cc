"""A radio-control receiver by SBUS: sticks and switches as signals, unknown while the radio is not heard.

1. A stick is 0 in the middle (1500 µs), ±1 at 512 µs from it, as OpenTX's ±100 % and Betaflight have it.
2. In failsafe a receiver sends what it was told to: these positions are nobody's, and the channels become unknown. A single
   lost frame repeats the one before.
3. There is no check but first and last byte: noise on the line can move a stick. A line with parity (8E2) sees most of it.

Sources: as the spec's.
"""

from __future__ import annotations

from typing import Any

from aces_bus.device import Device, Driver, HostLoss
from aces_protocols.sbus.spec import CHANNELS, LAST

from .twin import FRAME_S, SbusTwin

#: Middle and half of a stick's way (µs).
MIDDLE_US, HALF_US = 1500.0, 512.0
#: Frames that may be missing before a value is stale: two of the slowest receivers', every 14 ms, and some.
STALE_S = 0.1
SWITCHES = ("channel_17", "channel_18", "frame_lost", "failsafe")


class Sbus(Device):
    """Signals: channel_1 … channel_16 (−1 … 1), and 0 or 1: channel_17, channel_18, frame_lost, failsafe."""

    protocol = "sbus"
    when_host_is_lost = HostLoss("nothing moves", "a receiver; it is not asked and not set")

    @property
    def sends_every_s(self) -> float | None:
        """Seconds from one of its messages to the next."""
        return FRAME_S

    def setup(self) -> None:
        """Add a signal a channel, and those of the flags."""
        known: dict[str, Any] = {"read_from": list(LAST), "stale_s": STALE_S, "source": "rx/sbus_channels.c"}
        self._alarms: set[str] = set()
        self._channels = [
            self.add_signal(
                f"channel_{number + 1}", doc="a stick or switch, -1 … 1; unknown in failsafe", **known
            )
            for number in range(CHANNELS)
        ]
        self._switches = {name: self.add_signal(name, doc="0 or 1", **known) for name in SWITCHES}

    def received(self, record: Any, instant: int) -> None:
        """Take a frame."""
        flags = set(record.flags)
        for name, switch in self._switches.items():
            if "failsafe" in flags and name.startswith("channel"):
                switch.forget()
            else:
                switch.update(int(name in flags), instant)
        for channel, pulse in zip(self._channels, record.channels, strict=True):
            if "failsafe" in flags:
                channel.forget()
            else:
                channel.update((pulse - MIDDLE_US) / HALF_US, instant)
        alarms = flags & {"failsafe"}
        self.emit_alarms(alarms, self._alarms)
        self._alarms = alarms


EXAMPLE = """
name = "sbus"
rate_hz = 50

[buses]
line = { link = "serial", protocol = "sbus", baud = 100_000 }

[devices]
RC = { driver = "sbus", bus = "line" }
"""

driver = Driver(
    "sbus",
    device=Sbus,
    twin=SbusTwin,
    example=EXAMPLE,
    doc="Receivers of radio control by SBUS, SBUS2.",
    source="Betaflight rx/sbus_channels.c, PX4 lib/rc/sbus.cpp",
)

__all__ = ["EXAMPLE", "Sbus", "driver"]
