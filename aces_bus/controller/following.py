"""Following error: a joint that does not go where it was sent trips.

Theory. Where a joint lags (a filter, a slow loop), it is where it was sent a moment ago. So the error is the distance to the
nearest set-point of the last `time_s`, not to the newest: a shorter lag counts as no error. A joint that takes its own time
on a long way (a servo with a speed of its own) comes nearer meanwhile; one that is held up does not.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ..device.reading import UNKNOWN

if TYPE_CHECKING:
    from ..device.config import Joint, Robot
    from ..device.device import Device
    from ..device.signals import Signal

#: Following error of a revolute joint whose file says nothing: rad, s. Boards that report jams and reboots do so within
#: 1.3 s (jam_time and period of the status, Hubo D12): they know better what it is, and are first.
USUAL_ERROR_RAD, USUAL_TIME_S = 0.2, 1.5
#: So much of the bound nearer, within the time, is on its way.
PROGRESS = 0.1


@dataclass(frozen=True)
class Following:
    """When a joint does not follow: it is further than `error` (rad, m) from all that it was set to in the last `time_s`,
    and has come no nearer meanwhile.
    """

    error: float
    time_s: float = USUAL_TIME_S


def following_of(robot: Robot) -> dict[str, Following]:
    """Return by joint what the file says: `following_error` (0: never) and `following_time_s`.

    Only joints that are set by position are in it.

    A revolute joint whose file says nothing has 0.2 rad and 1.5 s: boards of some firmwares never report a jam, and what
    stays 11° from where it was sent is held up, whatever its gains. Others have none: no bound fits all wheels and slides.
    """
    return {joint.name: found for joint in robot.joints.values() if (found := _following(joint)) is not None}


def _following(joint: Joint) -> Following | None:
    if joint.command != "position" or not joint.active:
        return None
    error = joint.following_error
    if error is None:
        error = USUAL_ERROR_RAD if joint.type == "revolute" else 0.0
    return Following(error, joint.following_time_s or USUAL_TIME_S) if error else None


class Follower:
    """The last set-points of one joint, and where it was then."""

    __slots__ = ("_bound", "_device", "_recent", "_signal")

    def __init__(self, bound: Following, device: Device, signal: Signal) -> None:
        self._bound, self._device, self._signal = bound, device, signal
        #: What left and where it was then, with the instants (ns), as far back as is looked.
        self._recent: deque[tuple[int, float, Any]] = deque()

    def forget(self) -> None:
        """Begin anew: what was sent before is no measure any more."""
        self._recent.clear()

    def look(self, now: int, given: float) -> str:
        """Return why the joint does not follow, where `given` was sent last; "" where it does, or cannot be judged."""
        bound, recent, actual = self._bound, self._recent, self._signal.last
        recent.append((now, given, actual))
        since = now - round(bound.time_s * 1e9)
        if len(recent) > 1 and recent[1][0] <= since:
            recent.popleft()
        if actual is not UNKNOWN and -bound.error <= given - actual <= bound.error:
            return ""
        if not self._device.is_followed(self._signal) or self._signal.is_stale:
            recent.clear()
            return ""
        error = min(abs(value - actual) for _, value, _ in recent)
        then = recent[0][2]
        nearer = 0.0 if then is UNKNOWN else abs(given - then) - abs(given - actual)
        if error <= bound.error or recent[0][0] > since or nearer >= PROGRESS * bound.error:
            return ""
        recent.clear()
        return (
            f"{self._signal.name} stays at {actual:.3g} {self._signal.unit}, {error:.2g} from all that it was set to in"
            f" the last {bound.time_s:g} s (now {given:.3g})"
        )
