"""The twin of an RPLIDAR in a rectangular room: it turns at 5.5 Hz and measures 2,000 times a second.

1. Measurements leave in bursts of eight, as an adapter hands them over; a request ends the scan.
2. The room, noise and quality are choices; rates and identity are those of an A1 (SLAMTEC's data sheet and examples).
"""

from __future__ import annotations

import math
from typing import Any, ClassVar

from aces_bus.device import Twin, on

#: Rounds a second; measurements a second; measurements in a burst.
ROUNDS_HZ, SAMPLES_HZ, BURST = 5.5, 2000, 8
#: The time of a measurement, standard and express (µs): 2,000 and 4,000 a second.
SAMPLE_US, EXPRESS_US = 500, 250
#: Walls in front of, right of, behind and left of the scanner (m); a choice. What is farther away is not measured (m).
WALLS, FARTHEST = (3.0, 2.0, 1.5, 2.5), 12.0
NOISE, QUALITY = 0.003, 15
SERIAL = bytes.fromhex("64E699F3C7E59AF0A2E69DF8F1373500")


class RplidarTwin(Twin):
    """One scanner. `walls` are the distances of the walls; `blocked` gives a nearer distance (m) by angle (rad), or None."""

    protocol = "rplidar"
    faults: ClassVar = {
        "protection": "its health is `error`, and it does not measure",
        "dark": "nothing is measured: all distances are 0",
        "quiet": "its scan breaks off",
    }

    def setup(self) -> None:
        """Begin as switched on: no scan, the motor turns."""
        self.walls = WALLS
        self.is_scanning, self.duty = False, 660
        self.angle = 0.0
        self._is_first = True
        self.every(BURST / SAMPLES_HZ, self._measure)

    def distance(self, angle: float) -> float:
        """Return the distance of the room's wall at an angle clockwise from the front (rad)."""
        x, y = math.cos(angle), math.sin(angle)
        front, right, back, left = self.walls
        ways = [(front if x > 0 else back) / abs(x)] if abs(x) > 1e-9 else []
        ways += [(right if y > 0 else left) / abs(y)] if abs(y) > 1e-9 else []
        return min(ways)

    def _measure(self) -> None:
        if "quiet" in self.active_faults:
            self.is_scanning = False
        if not self.is_scanning or not self.duty or "silent" in self.active_faults:
            return
        packets = b""
        for _ in range(BURST):
            found = self.distance(self.angle) + self.random.gauss(0, NOISE)
            is_seen = found <= FARTHEST and "dark" not in self.active_faults
            packets += self._packet(round(4000 * found) if is_seen else 0)
            self.angle += math.tau * ROUNDS_HZ / SAMPLES_HZ
            if self.angle >= math.tau:
                self.angle -= math.tau
                self._is_first = True
        self.replies += 1
        self.send_raw(packets)

    def _packet(self, quarters: int) -> bytes:
        fields: dict[str, Any] = {
            "turn": "begins" if self._is_first else "goes_on",
            "quality": QUALITY if quarters else 0,
            "angle": round(math.degrees(self.angle) * 64) % (360 * 64) / 64,
            "distance": quarters / 4,
        }
        self._is_first = False
        return bytes(self.twins.packet(self, "Measurement", fields))

    @on("Scan", "ForceScan")
    def begins(self, request: Any) -> None:
        """Measure, unless it protects itself."""
        if "protection" in self.active_faults:
            return
        self.reply("ScanStarted")
        self.is_scanning, self._is_first = True, True

    @on("Stop", "Reset")
    def ends(self, request: Any) -> None:
        """End the scan."""
        self.is_scanning = False

    @on("SetMotor")
    def turns(self, request: Any) -> None:
        """Turn the motor, or stop it."""
        self.duty = request.duty

    @on("GetInfo")
    def tells(self, request: Any) -> None:
        """Answer with the identity of an A1; the scan ends."""
        self.is_scanning = False
        self.reply("Info", model=24, firmware_minor=29, firmware_major=1, hardware=7, serial=SERIAL)

    @on("GetHealth")
    def is_well(self, request: Any) -> None:
        """Answer with the health; the scan ends."""
        self.is_scanning = False
        broken = "protection" in self.active_faults
        self.reply("Health", status="error" if broken else "good", error=0x8001 if broken else 0)

    @on("GetSampleRate")
    def rates(self, request: Any) -> None:
        """Answer with the times of measurements; the scan ends."""
        self.is_scanning = False
        self.reply("SampleRate", standard=SAMPLE_US, express=EXPRESS_US)
