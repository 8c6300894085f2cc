"""Hubo 2 stands with compliant ankles: what its feet feel goes into the ankles' set-points, 100 times a second.

A player has the robot stand with bent knees. The moments of a foot (N·m: digits, times the sensor's matrix in the robot's
file) are the errors of pitch and roll; error → P·e + D·Δe → saturation → moving average of five → added to what the player
wants. Somebody pushes the same way three times: the controller is bypassed; on; at ten times its gains, where it saturates.

Signs, gains, limits: acesHubo ankleController. There P and D were multiplied, almost certainly by a slip; here they add up.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from math import degrees, radians, sin, tau
from typing import Any

from aces_bus import load_robot
from aces_bus.controller import Controller, Limits, Player, Trajectory
from aces_bus.robot import run_virtual

RATE = 100.0


@dataclass
class Ankle:
    """One axis of one ankle: which moment, its sign, gains (rad/(N·m), and for its change), limit (rad)."""

    joint: str
    moment: str
    sign: int
    p: float
    d: float
    limit: float
    low: float = 0.0
    error: float = 0.0
    last: deque[float] = field(default_factory=lambda: deque([0.0] * 5, maxlen=5))

    def correction(self, moment: float, gain: float) -> float:
        """Return the angle to add to the trajectory (rad)."""
        self.low = 0.6 * self.low + moment
        error = self.sign * 0.4 * self.low
        wanted = gain * (self.p * error + self.d * (error - self.error))
        self.error = error
        self.last.append(min(self.limit, max(-self.limit, wanted)))
        return sum(self.last) / len(self.last)


class AnkleCompliance(Controller):
    """A player with a correction of the four ankle joints. `gain` 0 is the original's bypass."""

    def __init__(self, player: Player, gain: float = 0.0) -> None:
        self.player, self.gain = player, gain
        pitch, roll = radians(3.0), radians(4.0)
        self.ankles = [
            Ankle("LAP", "LFFT.mx", +1, -0.0002, -0.00007, pitch),
            Ankle("LAR", "LFFT.my", -1, -0.0001, +0.0001, roll),
            Ankle("RAP", "RFFT.mx", -1, -0.0003, -0.00007, pitch),
            Ankle("RAR", "RFFT.my", -1, -0.0005, +0.0005, roll),
        ]
        moments = [ankle.moment for ankle in self.ankles]
        super().__init__(
            "ankles", rate_hz=player.rate_hz, states=[*player.states, *moments], writes=player.writes
        )

    def bind(self, states: Mapping[str, Any]) -> None:
        super().bind(states)
        self.player.bind(states)

    def start(self, now: int) -> None:
        super().start(now)
        self.player.start(now)

    def step(self, now_ns: int) -> Mapping[str, float]:
        wanted = dict(self.player.step(now_ns))
        for ankle in self.ankles if wanted else ():
            moment = self.known(ankle.moment) or 0.0  # who feels nothing stays where it is
            wanted[ankle.joint] += ankle.correction(moment, self.gain)
        return wanted


def push(seconds: float) -> float:
    """Return the share of the greatest force that somebody pushes with: once a second, for half a second."""
    return max(0.0, sin(tau * (seconds % 1.0 - 0.5))) if seconds > 0 and seconds % 1.0 > 0.5 else 0.0


def main() -> dict[float, dict[str, float]]:
    legs = {
        f"{side}{joint}": angle for side in "LR" for joint, angle in (("HP", -0.3), ("KP", 0.6), ("AP", -0.3))
    }
    pose = {**legs, "LAR": 0.0, "RAR": 0.0}
    stand = Trajectory(pose, [list(pose.values())] * 2, rate_hz=RATE, source="stand")
    compliant = AnkleCompliance(Player("stand", stand, rate_hz=RATE, gentle=Limits(1.5, 6.0)))
    run = run_virtual(load_robot("hubo2").part(*pose, "LFFT", "RFFT"), [compliant])
    given: dict[float, dict[str, float]] = {}
    with run:
        run.do("home")
        run.do("enable")
        began = run.clock.now() + 1_000_000_000  # it bends its knees first

        def feel(now: int) -> tuple[float, float, float]:
            """Moments (N·m) and force (N) on either foot."""
            share = push((now - began) / 1e9)
            return 50.0 * share, 30.0 * share, 220.0

        run.world.twins["FT_LF"].feed = run.world.twins["FT_RF"].feed = feel
        run.start()
        run.world.advance(1.0)
        for gain in (0.0, 1.0, 10.0):
            compliant.gain = gain
            run.world.advance(1.0)
            moved = {ankle.joint: run.states[ankle.joint].window(-0.9, 0) for ankle in compliant.ankles}
            given[gain] = {
                name: max((value - pose[name] for value in window.values), key=abs)
                for name, window in moved.items()
            }
            angles = ", ".join(f"{name} {degrees(angle):+.2f}°" for name, angle in given[gain].items())
            print(f"gains × {gain:<4g}  the ankles give way by {angles}")
        ended = run.stop()
    print(", ".join(ended.tripped.values()) or "nothing went wrong")
    return given


if __name__ == "__main__":
    main()
