"""Set-points that come from outside a run, at any time: a controller that passes on the newest, with a dead-man.

1. Set-points are checked when they are given, as a whole: joints that it writes, finite numbers.
2. When none come for `dead_man_s`, what moves stands still: positions are held where they are measured, other set-points
   become 0. The next ones are taken again.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Iterable, Mapping

from aces_bus.controller import Controller
from aces_bus.controller.base import NOTHING
from aces_bus.device import Robot
from aces_bus.errors import CallerError, UnknownNameError

#: Silence (s) after which joints stand still.
DEAD_MAN_S = 0.5
#: What joints are commanded by: the signal that takes it.
SIGNALS = {"position": "", "speed": ".velocity", "current": ".current", "duty": ".duty"}


def commanded(robot: Robot, joints: Iterable[str] | None = None) -> dict[str, str]:
    """Return by joint the state that its set-points are for: "RHP" where it takes positions, else "LW.velocity".

    `joints` None: all that are active. Raises `UnknownNameError`.
    """
    active = {joint.name: joint for joint in robot.joints.values() if joint.active}
    wanted = list(active if joints is None else joints)
    for name in wanted:
        if name not in active:
            raise UnknownNameError(f"joint of {robot.name}", name, active)
    return {name: name + SIGNALS[active[name].command] for name in wanted}


class GivenSetpoints(Controller):
    """Passes on what `give` was called with last. `writes` are the states that it takes (see `commanded`)."""

    def __init__(
        self, name: str, writes: Iterable[str], *, rate_hz: float, dead_man_s: float = DEAD_MAN_S
    ) -> None:
        writes = list(writes)
        super().__init__(name, rate_hz=rate_hz, states=[w for w in writes if "." not in w], writes=writes)
        self.dead_man_s = dead_man_s
        self._lock = threading.Lock()
        self._wanted: dict[str, float] = {}
        self._is_new = False
        self._until: int | None = None
        #: How often the dead-man has ended motion.
        self.lapses = 0

    @property
    def is_idle(self) -> bool:
        """True while nothing is given."""
        return self._until is None

    def check(self, values: Mapping[str, float]) -> None:
        """Raise `UnknownNameError` for a state that it does not write, `CallerError` for what is not a finite number."""
        for name, value in values.items():
            if name not in self.writes:
                raise UnknownNameError(f"joint that {self.name} gives set-points to", name, self.writes)
            if not math.isfinite(value):
                raise CallerError(f"{self.name}: {name}: {value!r} is not a finite number")

    def give(self, values: Mapping[str, float]) -> None:
        """Take set-points, on any thread; others keep theirs. Raises as `check`; then nothing is taken."""
        self.check(values)
        with self._lock:
            self._wanted.update(values)
            self._is_new = True

    def release(self) -> None:
        """End the motion at the next step, as the dead-man does."""
        with self._lock:
            self._until = self._until and 0
            self._is_new = False

    def stop(self, now: int) -> None:
        """End: nothing is wanted."""
        super().stop(now)
        with self._lock:
            self._wanted, self._is_new, self._until = {}, False, None

    def step(self, now_ns: int) -> Mapping[str, float]:
        """Return the newest set-points; once, where it stands still, when they stop coming."""
        with self._lock:
            if self._is_new:
                self._is_new, self._until = False, now_ns + round(self.dead_man_s * 1e9)
            if self._until is None:
                return NOTHING
            if now_ns <= self._until:
                return dict(self._wanted)
            wanted, self._wanted, self._until = self._wanted, {}, None
            self.lapses += 1
        return {name: self._standing(name, value) for name, value in wanted.items()}

    def _standing(self, name: str, wanted: float) -> float:
        """Return the set-point at which a joint stands still."""
        if "." in name:
            return 0.0
        known = self.known(name)
        return wanted if known is None else known
