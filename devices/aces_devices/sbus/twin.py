"""The twin of a receiver: a frame every 9 ms, of sticks that a person or a test moves."""

from __future__ import annotations

from typing import ClassVar

from aces_bus.device import Twin
from aces_protocols.sbus.spec import CHANNELS, LAST

#: A frame's period (s): FrSky's receivers; Futaba's send every 7 or 14 ms.
FRAME_S = 0.009
#: What a stick can be: 11 bits (µs).
LEAST_US, MOST_US = 880.0, 2159.375


class SbusTwin(Twin):
    """One receiver. `sticks` are its channels (−1 … 1), `switches` the names of the flags that are on."""

    protocol = "sbus"
    faults: ClassVar = {
        "radio": "the transmitter is off: frames say failsafe, with the sticks where they are",
        "sbus2": "the last byte is that of SBUS2, of four groups of slots in turn",
    }

    def setup(self) -> None:
        """Power up: sticks in the middle."""
        self.sticks = [0.0] * CHANNELS
        self.switches: set[str] = set()
        self.frames = 0
        self.every(FRAME_S, self._send)

    def _send(self) -> None:
        flags = self.switches | ({"frame_lost", "failsafe"} if "radio" in self.active_faults else set())
        names = list(LAST)
        name = names[1 + self.frames % 4] if "sbus2" in self.active_faults else names[0]
        self.frames += 1
        pulses = [min(MOST_US, max(LEAST_US, 1500.0 + 512.0 * stick)) for stick in self.sticks]
        self.reply(name, delay_ns=0, channels=pulses, flags=sorted(flags))
