"""The twin of an LD06 in a rectangular room: it turns at 10 Hz and measures 4,500 times a second, twelve to a packet.

1. It obeys the motor commands of the LD14P; the rate of its measurements stays.
2. Rates are those of the manual (chapter 1); room, noise and intensity are choices.
"""

from __future__ import annotations

import math
from typing import Any, ClassVar

from aces_bus.device import Twin, on
from aces_protocols.ld06.spec import POINTS

from ..laser import WALLS, distance_in_room

#: Rounds a second, measurements a second (manual, chapter 1).
ROUNDS_HZ, SAMPLES_HZ = 10.0, 4500
#: What is farther away is not measured (m).
FARTHEST = 12.0
NOISE, INTENSITY = 0.005, 200
#: The time of a packet begins again (ms).
AGAIN_MS = 30_000


class Ld06Twin(Twin):
    """One scanner. `walls` are the distances of the walls (m)."""

    protocol = "ld06"
    faults: ClassVar = {
        "dark": "nothing is measured: all distances are 0",
        "jam": "the motor stands still, and nothing is sent",
    }

    def setup(self) -> None:
        """Power up: it turns and measures."""
        self.walls = WALLS
        self.is_turning, self.rounds_hz, self.angle = True, ROUNDS_HZ, 0.0
        self.every(POINTS / SAMPLES_HZ, self._measure)

    def distance(self, angle: float) -> float:
        """Return the distance of the room's wall at an angle clockwise from the front (rad)."""
        return distance_in_room(self.walls, angle)

    def _measure(self) -> None:
        if not self.is_turning or "jam" in self.active_faults:
            return
        step = 360 * self.rounds_hz / SAMPLES_HZ
        points: list[dict[str, int]] = []
        for number in range(POINTS):
            found = self.distance(math.radians(self.angle + number * step)) + self.random.gauss(0, NOISE)
            is_seen = found <= FARTHEST and "dark" not in self.active_faults
            points.append(
                {"distance": round(1000 * found), "intensity": INTENSITY}
                if is_seen
                else {"distance": 0, "intensity": 0}
            )
        start, end = (
            round(100 * angle) % 36_000 / 100 for angle in (self.angle, self.angle + (POINTS - 1) * step)
        )
        self.angle = (self.angle + POINTS * step) % 360
        self.reply(
            "Measurements",
            delay_ns=0,
            speed=round(360 * self.rounds_hz),
            start_angle=start,
            points=points,
            end_angle=end,
            time=self.clock.now() // 1_000_000 % AGAIN_MS,
        )

    @on("Start")
    def turn(self, request: Any) -> None:
        """Turn, and measure."""
        self.is_turning = True

    @on("Stop")
    def stand(self, request: Any) -> None:
        """Stand still."""
        self.is_turning = False

    @on("SetSpeed")
    def change(self, request: Any) -> None:
        """Turn at another speed."""
        self.rounds_hz = request.speed / 360
