"""A rover drives from place to place: four wheels on VESC controllers, a satellite receiver, and nothing else.

The receiver says where it is, and while it moves its course; the wheels say how far it has turned since. Where the receiver
has no fix, or is not sure of it, the rover stands. Simulated wheels roll without slip, and move the simulated antenna.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import atan2, cos, hypot, pi, sin, tau
from typing import Any

from aces_bus import load_robot
from aces_bus.controller import Controller
from aces_bus.robot import run_virtual
from aces_devices.gnss.antenna import AntennaMotion

LEFT, RIGHT = ("FL", "RL"), ("FR", "RR")
#: Radius of a wheel, and between the wheels' middles (m).
RADIUS, TRACK = 0.1, 0.6
#: How fast it drives (m/s) and turns (rad/s); from where on a course is one (m/s); what is near, and what is sure (m).
SPEED, TURN, MOVING, NEAR, SURE = 1.0, 1.0, 0.5, 0.4, 3.0
#: For how long it looks for its heading (s): a rover whose receiver does not move with it stands then.
SEEK_S = 5.0
#: The places (m: north, east of the origin).
PLACES = [(4.0, 0.0), (4.0, 4.0), (0.0, 4.0), (0.0, 0.0)]


def turned(angle: float) -> float:
    """Return an angle within −π…π."""
    return (angle + pi) % tau - pi


class Tour(Controller):
    """Drives to each place in turn: reads the receiver and the wheels, gives the speeds of the wheels."""

    def __init__(self, places: list[tuple[float, float]]) -> None:
        self.places = places
        self.heading: float | None = None
        self.near: list[float] = []
        #: How long it has driven without having found its heading.
        self.sought_s = 0.0
        reads = ("GNSS.north", "GNSS.east", "GNSS.horizontal_accuracy", "GNSS.speed", "GNSS.course")
        wheels = (*LEFT, *RIGHT)
        positions = tuple(f"{wheel}.position" for wheel in wheels)
        super().__init__(
            "tour", rate_hz=20, states=(*reads, *positions), writes=[f"{w}.velocity" for w in wheels]
        )

    def _known(self, *names: str) -> list[float] | None:
        """Return the values of these states; None where any is unknown."""
        values = [value for name in names if (value := self.known(name)) is not None]
        return values if len(values) == len(names) else None

    def step(self, now_ns: int) -> Mapping[str, float]:
        """Speeds of the wheels; all stand while it is not known where it is."""
        place = self._known("GNSS.north", "GNSS.east", "GNSS.horizontal_accuracy")
        wheels = self._known(*(f"{wheel}.position" for wheel in (*LEFT, *RIGHT)))
        moving = self._known("GNSS.speed", "GNSS.course")
        if place is None or wheels is None or place[2] > SURE or not self.places:
            return self.drive(0.0, 0.0)
        north, east, _ = place
        left, right = RADIUS * sum(wheels[:2]) / 2, RADIUS * sum(wheels[2:]) / 2
        by_wheels = (left - right) / TRACK
        if moving is not None and moving[0] > MOVING:
            looks = moving[1] - by_wheels
            self.heading = (
                looks if self.heading is None else self.heading + 0.1 * turned(looks - self.heading)
            )
        if self.heading is None:  # straight on: moving shows where it looks
            self.sought_s += 1 / self.rate_hz
            return self.drive(SPEED if self.sought_s < SEEK_S else 0.0, 0.0)
        to_north, to_east = self.places[0][0] - north, self.places[0][1] - east
        distance = hypot(to_north, to_east)
        if distance < NEAR:
            self.near.append(distance)
            del self.places[0]
        aside = turned(atan2(to_east, to_north) - by_wheels - self.heading)
        return self.drive(SPEED * max(0.0, cos(aside)), max(-TURN, min(TURN, 2.0 * aside)))

    def drive(self, speed: float, turn: float) -> dict[str, float]:
        """Return the speeds of the wheels (rad/s) for a speed (m/s) and a turn to the right (rad/s)."""
        half = turn * TRACK / 2
        sides = {**dict.fromkeys(LEFT, speed + half), **dict.fromkeys(RIGHT, speed - half)}
        return {f"{wheel}.velocity": value / RADIUS for wheel, value in sides.items()}


#: What `aces run -r rover examples/rover.py` runs.
tour = Tour(list(PLACES))


class Ground:
    """Where the simulated wheels have rolled the antenna; it looks north-east at first."""

    def __init__(self, joints: Mapping[str, Any]) -> None:
        self.joints = joints
        self.at, self.heading = 0, pi / 4
        self.motion = AntennaMotion()
        self.rolled = (0.0, 0.0)

    def __call__(self, now: int) -> AntennaMotion:
        sides = [RADIUS * sum(self.joints[w].position(now) for w in side) / 2 for side in (LEFT, RIGHT)]
        left, right = (new - old for new, old in zip(sides, self.rolled, strict=True))
        seconds = (now - self.at) / 1e9
        if seconds > 0:
            turn, way, was = (left - right) / TRACK, (left + right) / 2, self.motion
            north, east = way * cos(self.heading + turn / 2), way * sin(self.heading + turn / 2)
            self.motion = AntennaMotion(
                was.north + north, was.east + east, 0.0, north / seconds, east / seconds, 0.0
            )
            self.at, self.heading, self.rolled = now, self.heading + turn, (sides[0], sides[1])
        return self.motion


def main(places: Sequence[tuple[float, float]] = PLACES, lost_s: float = 2.0) -> tuple[list[float], float]:
    """Drive the tour; halfway the receiver has no fix for a while. How near it came to each place, and how far it
    went without a fix (m)."""
    trip = Tour(list(places))
    with run_virtual(load_robot("rover"), [trip]) as run:
        world = run.world.simulation.world
        ground = world.shared["place"] = Ground(world.joints)
        run.do("enable")
        run.start()
        while len(trip.places) > len(places) / 2:
            run.world.advance(0.5)
        receiver = run.world.simulation.twins["GNSS"]
        receiver.fault("no_fix")
        run.world.advance(1.5)
        before = ground(run.clock.now())
        run.world.advance(lost_s)
        after = ground(run.clock.now())
        blind = hypot(after.north - before.north, after.east - before.east)
        print(f"without a fix it went {blind:.2f} m")
        receiver.fault("no_fix", on=False)
        for _ in range(120):
            if not trip.places:
                break
            run.world.advance(0.5)
        seconds = run.clock.now() / 1e9
        ended = run.stop()
    came = ", ".join(f"{distance:.2f}" for distance in trip.near)
    print(f"{len(trip.near)} of {len(places)} places in {seconds:.0f} s, to within {came} m;", end=" ")
    print(f"{run.set_points} set-points, {', '.join(ended.tripped.values()) or 'nothing went wrong'}")
    return trip.near, blind


if __name__ == "__main__":
    main()
