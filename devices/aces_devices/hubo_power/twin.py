"""The twin of the power board: a battery that the robot's motion draws on.

1. Current = idle + a share for all joints' speeds together; voltage = that of the charge − resistance × current.
2. The charge is spent as time passes between two questions. All numbers are choices; no sheet has them.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar

from aces_bus.device import Twin, on
from aces_bus.protocol import Record

#: A full and an empty battery (V), its resistance (ohm), its charge (A·h).
FULL, EMPTY, RESISTANCE, CAPACITY = 50.4, 43.2, 0.05, 20.0
#: What the robot draws at rest (A), and more for each rad/s of its joints together.
IDLE, A_SPEED = 2.5, 0.4
#: Joint speeds are taken over at least this (ns).
SPAN_NS = 10_000_000
#: The standard deviation of a reading: V, A.
NOISE = (0.02, 0.05)
#: The end of a field of 16 bits in hundredths.
END = 655.35


class PowerTwin(Twin):
    """A battery. `feed(now)`, when it is set, gives (voltage, current) in V and A in place of the model.

    `sound` is the alarm that is on ("off" for none), `beeping_until` the instant (ns) at which the beep ends.
    """

    protocol = "hubo"
    faults: ClassVar = {"low_battery": "2 % of the charge is left (or as many as said)"}
    amounts: ClassVar = {"low_battery": 2.0}
    feed: Callable[[int], tuple[float, float]] | None = None

    def setup(self) -> None:
        """Begin with a full battery: a robot that is switched off gets charged."""
        self.charge = 1.0
        self.sound = "off"
        self.beeping_until = 0
        self.current = IDLE
        self._at = self.clock.now()
        self._places: list[float] | None = None

    def measured(self, now: int) -> tuple[float, float]:
        """Return voltage (V) and current (A) at an instant (ns), without noise."""
        if self.feed is not None:
            return self.feed(now)
        passed = now - self._at
        if passed >= SPAN_NS:
            places = [joint.position(now) for joint in self.world.joints.values()]
            moved = 0.0
            if self._places is not None and len(places) == len(self._places):
                moved = sum(abs(a - b) for a, b in zip(places, self._places, strict=True))
            self.current = IDLE + A_SPEED * moved * 1e9 / passed
            self.charge = max(0.0, self.charge - self.current * passed / 3600e9 / CAPACITY)
            self._places, self._at = places, now
        charge = self.charge
        if "low_battery" in self.active_faults:
            charge = min(charge, self.active_faults["low_battery"] / 100)
        return EMPTY + (FULL - EMPTY) * charge - RESISTANCE * self.current, self.current

    @on("PowerQuery")
    def answer(self, request: Record) -> None:
        """Send voltage, current, and their product."""
        voltage, current = self.measured(self.clock.now())
        gauss = self.random.gauss
        voltage = min(END, max(0.0, voltage + gauss(0.0, NOISE[0])))
        current = min(END, max(0.0, current + gauss(0.0, NOISE[1])))
        self.reply("Power", voltage=voltage, current=current, power=min(6553.5, voltage * current))

    @on("Alarm")
    def take_alarm(self, request: Record) -> None:
        """Sound, or be quiet."""
        self.sound = str(request.sound)

    @on("Beep")
    def take_beep(self, request: Record) -> None:
        """Beep from now on."""
        self.beeping_until = self.clock.now() + round(request.time * 1e9)
