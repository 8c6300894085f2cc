"""The twin of an RPLIDAR in a rectangular room: it turns at 5.5 Hz and measures 2,000 times a second.

1. Measurements leave in bursts of eight, as an adapter hands them over; an express scan is packets of 32, measured twice
   as often, each a little beside its nominal angle, as its compensation says. A request ends the scan.
2. The room, noise and quality are choices; rates and identity are those of an A1 (SLAMTEC's data sheet and examples).
"""

from __future__ import annotations

import math
from typing import ClassVar

from aces_bus.device import Twin, on
from aces_bus.protocol import Record
from aces_bus.protocol.record import FieldValue
from aces_protocols.rplidar.spec import EXPRESS

from ..laser import WALLS, distance_in_room

#: Rounds a second; measurements a second; measurements in a burst.
ROUNDS_HZ, SAMPLES_HZ, BURST = 5.5, 2000, 8
#: The time of a measurement, standard and express (µs): 2,000 and 4,000 a second.
SAMPLE_US, EXPRESS_US = 500, 250
#: What is farther away is not measured (m).
FARTHEST = 12.0
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
        self.is_scanning, self.is_express, self.duty = False, False, 660
        self.angle = 0.0
        self._is_first = True
        self.every(BURST / SAMPLES_HZ, self._measure)
        self.every(EXPRESS * EXPRESS_US * 1e-6, self._measure_express)

    def distance(self, angle: float) -> float:
        """Return the distance of the room's wall at an angle clockwise from the front (rad)."""
        return distance_in_room(self.walls, angle)

    def _is_measuring(self, *, is_express: bool) -> bool:
        if "quiet" in self.active_faults:
            self.is_scanning = False
        is_wanted = self.is_scanning and self.is_express == is_express
        return is_wanted and bool(self.duty) and "silent" not in self.active_faults

    def _measure_express(self) -> None:
        if not self._is_measuring(is_express=True):
            return
        step = math.tau * ROUNDS_HZ * EXPRESS_US * 1e-6
        compensations = [self.random.randrange(-8, 9) / 8 for _ in range(EXPRESS)]
        distances = []
        for number, compensation in enumerate(compensations):
            found = self.distance(self.angle + number * step - math.radians(compensation))
            found += self.random.gauss(0, NOISE)
            is_seen = found <= FARTHEST and "dark" not in self.active_faults
            distances.append(round(1000 * found) if is_seen else 0)
        fields = {
            "angle": round(math.degrees(self.angle) * 64) % (360 * 64) / 64,
            "begins": int(self._is_first),
            "distances": distances,
            "compensations": compensations,
        }
        self._is_first = False
        self.angle = (self.angle + EXPRESS * step) % math.tau
        self.replies += 1
        self.send_raw(bytes(self.twins.packet(self, "ExpressMeasurements", fields)))

    def _measure(self) -> None:
        if not self._is_measuring(is_express=False):
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
        fields: dict[str, FieldValue] = {
            "turn": "begins" if self._is_first else "goes_on",
            "quality": QUALITY if quarters else 0,
            "angle": round(math.degrees(self.angle) * 64) % (360 * 64) / 64,
            "distance": quarters / 4,
        }
        self._is_first = False
        return bytes(self.twins.packet(self, "Measurement", fields))

    @on("Scan", "ForceScan")
    def begins(self, request: Record) -> None:
        """Measure, unless it protects itself."""
        if "protection" in self.active_faults:
            return
        self.reply("ScanStarted")
        self.is_scanning, self.is_express, self._is_first = True, False, True

    @on("ExpressScan")
    def begins_express(self, request: Record) -> None:
        """Measure in packets, unless it protects itself; the dialect `standard` has no such packets."""
        if "protection" in self.active_faults or "ExpressMeasurements" not in self.variant.messages:
            return
        self.reply("ExpressStarted")
        self.is_scanning, self.is_express, self._is_first = True, True, True

    @on("Stop", "Reset")
    def ends(self, request: Record) -> None:
        """End the scan."""
        self.is_scanning = False

    @on("SetMotor")
    def turns(self, request: Record) -> None:
        """Turn the motor, or stop it."""
        self.duty = request.duty

    @on("GetInfo")
    def tells(self, request: Record) -> None:
        """Answer with the identity of an A1; the scan ends."""
        self.is_scanning = False
        self.reply("Info", model=24, firmware_minor=29, firmware_major=1, hardware=7, serial=SERIAL)

    @on("GetHealth")
    def is_well(self, request: Record) -> None:
        """Answer with the health; the scan ends."""
        self.is_scanning = False
        broken = "protection" in self.active_faults
        self.reply("Health", status="error" if broken else "good", error=0x8001 if broken else 0)

    @on("GetSampleRate")
    def rates(self, request: Record) -> None:
        """Answer with the times of measurements; the scan ends."""
        self.is_scanning = False
        self.reply("SampleRate", standard=SAMPLE_US, express=EXPRESS_US)
