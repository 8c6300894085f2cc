"""Players: a motion as a controller.

1. Nothing jumps: a run begins at the present positions ("first": it goes to the first row and then plays; "blend": it plays
   at once and the offset fades). `approach=None` says that this is not wanted.
2. A player that stands still (halted, at the end, failed) repeats its last set-points, so that a dead-man below it sees that
   the controller lives.
3. Time is the runtime's: a late cycle plays what belongs to its instant. When time jumps (`largest_gap_s`, or back), it goes
   on from where it was instead, and counts (`gaps`): half a step of a walk is not left out.

Operations as in the original framework's `Script`: `run`, `halt`, `open`, and its `step` as `advance` (one row, then halt);
its "User trajectory" is `hook`, a function that sees and may change each row's set-points.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping
from typing import Any, Literal

from ..errors import CallerError
from ..state.errors import raise_first
from .base import NOTHING, Controller, StateLike, known_value
from .events import ControlEvent
from .motion import Motion, interpolate, smooth_step
from .motion_file import MOST_RAD, read_trajectory
from .via import QUINTIC_PEAKS, Limits

#: "halted": stands still; "waiting": for present positions; "approaching": on its way to the first row; "ended"; "failed".
Mode = Literal["halted", "waiting", "approaching", "running", "ended", "failed"]
#: Sees a row's set-points; may change them, or return others.
Hook = Callable[[dict[str, float]], Mapping[str, float] | None]
#: Where `run` after `halt` goes on, and how gently the approach goes: half a radian a second is slow for any joint.
GENTLE = Limits(velocity=0.5, acceleration=2.0)


class Player(Controller):
    """Plays a motion, by default once, from the present positions.

    >>> from aces_bus.controller import Trajectory
    >>> wave = Trajectory(["RSP"], [[0.0], [0.2], [0.4]], rate_hz=10)
    >>> player = Player("wave", wave, rate_hz=20, approach=None)
    >>> player.start(0)
    >>> [round(player.step(n * 50_000_000)["RSP"], 3) for n in range(6)], player.mode
    ([0.0, 0.1, 0.2, 0.3, 0.4, 0.4], 'ended')

    `rename` maps the motion's names to states; `rounds` None repeats for ever, approaching its first row anew each time;
    `speed` plays faster or slower; `halt_s` is how long halting and going on take (s); `largest` is the largest magnitude
    that is believed (a file in degrees, read as rad, is refused); `patience_s` how long present positions may be unknown.
    """

    def __init__(
        self,
        name: str,
        motion: Motion,
        *,
        rate_hz: float,
        approach: Literal["first", "blend"] | None = "first",
        gentle: Limits = GENTLE,
        rename: Mapping[str, str] | None = None,
        hook: Hook | None = None,
        rounds: int | None = 1,
        speed: float = 1.0,
        halt_s: float = 0.2,
        patience_s: float = 1.0,
        largest: float = MOST_RAD,
        largest_gap_s: float = 0.25,
        autorun: bool = True,
    ) -> None:
        who = f"player {name!r}"
        raise_first(
            CallerError,
            (not (math.isfinite(speed) and speed > 0), f"{who}: speed = {speed!r} must be above 0"),
            (
                approach not in ("first", "blend", None),
                f"{who}: approach is 'first', 'blend' or None, not {approach!r}",
            ),
            (
                rounds is not None and rounds < 1,
                f"{who}: rounds = {rounds!r} must be 1 or more, or None for no end",
            ),
        )
        self._rename, self._largest = dict(rename or {}), largest
        self.motion, self.names = motion, self._checked(name, motion)
        super().__init__(name, rate_hz=rate_hz, states=self.names if approach else (), writes=self.names)
        self.approach, self.gentle, self.hook = approach, gentle, hook
        self.rounds, self.speed, self.halt_s, self.autorun = rounds, speed, max(0.0, halt_s), autorun
        self.mode: Mode = "halted"
        self.reason = ""
        self.rounds_done = 0
        self.gaps = 0
        self._largest_gap_s = largest_gap_s
        self._gap_ns = self._longest_gap()
        self._patience_ns = round(patience_s * 1e9)
        self._all: Mapping[str, StateLike] = {}
        self._wish: Literal["run", "halt"] | None = None
        self._rows = 0  # still to go before it halts; 0: no count
        self._rewind()

    def _checked(self, name: str, motion: Motion) -> tuple[str, ...]:
        names = tuple(self._rename.get(column, column) for column in motion.names)
        double = [column for column in dict.fromkeys(names) if names.count(column) > 1]
        if double:
            raise CallerError(f"player {name!r}: {', '.join(double)} would be set twice; see rename")
        rows = getattr(motion, "rows", None)
        if rows is not None and len(rows):
            most = float(abs(rows).max())
            if most > self._largest:
                raise CallerError(
                    f"player {name!r}: values up to {most:g} where {self._largest:.4g} is the most that is believed: "
                    "in degrees? then read it with unit='deg'; else say largest=math.inf"
                )
        return names

    def _longest_gap(self) -> int:
        """Return the time between two steps (ns) that is not a gap."""
        return round(max(self._largest_gap_s, 2 / self.rate_hz) * 1e9)

    def _rewind(self) -> None:
        self._values: list[float] | None = None  # the last set-points
        self._at_s = 0.0  # seconds of the motion
        self._fresh = True  # the next run begins with an approach
        self._from: list[float] = []
        self._began = 0  # ns: of waiting, of the approach, of the blend
        self._approach_s = 0.0
        self._base_s, self._base_ns = 0.0, 0
        self._ramp = 0  # +1: getting faster, -1: coming to a stand, 0: neither
        self._offsets: list[float] | None = None
        self._fade_s = 0.0
        self._begun = False  # a value of the motion itself has been given
        self._stepped: int | None = None

    # ---- operations -------------------------------------------------------------------------------------------------

    def run(self) -> None:
        """Play: from the beginning, or on from where it was halted."""
        self._wish, self._rows = "run", 0

    def halt(self) -> None:
        """Come to a stand within `halt_s`."""
        self._wish, self._rows = "halt", 0

    def advance(self, rows: int = 1) -> None:
        """Play `rows` rows, then halt; the first of a motion is the one that it approaches."""
        if rows < 1:
            raise CallerError(f"player {self.name!r}: rows = {rows!r} must be 1 or more")
        self._wish, self._rows = "run", rows

    def open(self, motion: Motion | str | os.PathLike[str], **options: Any) -> None:
        """Play another motion, or a file (`options` are `read_trajectory`'s); it begins halted."""
        if isinstance(motion, (str, os.PathLike)):
            motion = read_trajectory(motion, **options)
        names = self._checked(self.name, motion)
        self.motion, self.names, self.writes = motion, names, names
        if self.approach:
            self.states = names
            if self._all:
                self.bind(self._all)
        self._rewind()
        self.mode, self._wish, self._rows, self.rounds_done, self.reason = "halted", None, 0, 0, ""

    @property
    def progress(self) -> float:
        """Played share of the motion, 0 … 1."""
        duration = self.motion.duration_s
        return min(1.0, self._at_s / duration) if duration > 0 else float(self.mode == "ended")

    # ---- as a controller --------------------------------------------------------------------------------------------

    def bind(self, states: Mapping[str, StateLike]) -> None:
        """Take the states it begins from."""
        super().bind(states)
        self._all = states

    def start(self, now: int) -> None:
        """Begin a run at the motion's beginning; play unless `autorun` is off."""
        super().start(now)
        self._rewind()
        self._gap_ns = self._longest_gap()
        self.mode, self.reason, self.rounds_done = "halted", "", 0
        self._wish = "run" if self.autorun else None

    def step(self, now_ns: int) -> Mapping[str, float]:
        """Return the set-points of this cycle."""
        if self._stepped is not None and not 0 <= now_ns - self._stepped <= self._gap_ns:
            self._skip(now_ns)
        self._stepped = now_ns
        if self._wish is not None:
            self._obey(now_ns)
        mode = self.mode
        if mode == "running":
            values = self._faded(now_ns, self._play(now_ns))
        elif mode == "waiting" or mode == "approaching":
            waited = self._wait(now_ns) if mode == "waiting" else self._go(now_ns)
            if waited is None:
                return NOTHING
            values = waited
        elif self._values is None:
            return NOTHING
        else:
            values = self._values
        setpoints = dict(zip(self.names, values, strict=True))
        self._values = values
        if self.hook is not None and mode != "failed":
            changed = self.hook(setpoints)
            if changed is not None:
                return changed
        return setpoints

    def _skip(self, now: int) -> None:
        """Time has jumped: go on from where it was, as if one period had passed (rule 3)."""
        assert self._stepped is not None
        gap = now - self._stepped
        shift = gap - round(1e9 / self.rate_hz)
        self._base_ns += shift
        self._began += shift
        self.gaps += 1
        self.listeners.emit(ControlEvent("late", now, self.name, f"{gap / 1e9:.3f} s passed in one cycle"))

    def _obey(self, now: int) -> None:
        wish, self._wish = self._wish, None
        if wish == "halt":
            if self.mode == "running" and self.halt_s > 0:
                self._base_s, self._base_ns, self._ramp = self._at_s, now, -1
            elif self.mode in ("running", "waiting", "approaching"):
                self._fresh = self._fresh or self.mode != "running"
                self.mode = "halted"
            return
        if self.mode == "ended":
            self._fresh, self._at_s = True, 0.0
            self.rounds_done = 0
        if self.mode in ("halted", "ended", "failed"):
            if self._fresh:
                self.mode, self._began = "waiting", now
            else:
                self.mode = "running"
                self._base_s, self._base_ns = self._at_s, now
                self._ramp = 1 if self.halt_s > 0 and not self._rows else 0
        elif self.mode == "running" and self._ramp < 0:
            self._base_s, self._base_ns, self._ramp = self._at_s, now, 1

    def _wait(self, now: int) -> list[float] | None:
        """Find where it stands, and go on from there."""
        first = self.motion.at(0.0)
        present = self._values
        if present is None and self.approach is not None:
            found = [known_value(self.bound.get(name)) for name in self.names]
            if any(value is None for value in found):
                if now - self._began > self._patience_ns:
                    missing = [name for name, value in zip(self.names, found, strict=True) if value is None]
                    self._fail(now, f"the present position of {', '.join(missing)} is unknown")
                return None
            present = [value for value in found if value is not None]
        self._began, self._base_s, self._base_ns, self._ramp = now, 0.0, now, 0
        self._offsets, self._fade_s, self._fresh, self._at_s = None, 0.0, False, 0.0
        self._begun = False
        if present is not None and self.approach is not None:
            self._from = present
            most = max((abs(a - b) for a, b in zip(present, first, strict=True)), default=0.0)
            peak_v, peak_a, peak_j = QUINTIC_PEAKS
            gentle = self.gentle
            self._approach_s = max(
                peak_v * most / gentle.velocity,
                math.sqrt(peak_a * most / gentle.acceleration),
                (peak_j * most / gentle.jerk) ** (1 / 3),
            )
            if most > 1e-9:
                if self.approach == "first":
                    self.mode = "approaching"
                    return self._go(now)
                self._offsets = [a - b for a, b in zip(present, first, strict=True)]
        self.mode = "running"
        return self._faded(now, self._play(now))

    def _go(self, now: int) -> list[float]:
        """Lead the joints to the first row."""
        first = self.motion.at(0.0)
        done = (now - self._began) / 1e9
        if done < self._approach_s:
            return interpolate(self._from, first, smooth_step(done / self._approach_s))
        self.mode, self._base_s = "running", 0.0
        # What the cycle is late belongs to the motion.
        self._base_ns = self._began + round(self._approach_s * 1e9)
        return self._play(now)

    def _play(self, now: int) -> list[float]:
        if self._rows:
            return self._play_row()
        self._begun = True
        elapsed = (now - self._base_ns) / 1e9
        if self._ramp:
            span = self.halt_s
            within = min(elapsed, span)
            way = within * within / (2 * span)
            if self._ramp < 0:
                way = within - way
            self._at_s = self._base_s + self.speed * way
            if elapsed >= span:
                if self._ramp < 0:
                    self.mode = "halted"
                else:
                    self._base_s, self._base_ns = self._at_s, self._base_ns + round(span * 1e9)
                    self._ramp = 0
                    return self._play(now)
        else:
            self._at_s = self._base_s + self.speed * elapsed
        duration = self.motion.duration_s
        # Instants are whole ns: what is that near the end is the end.
        if self._at_s >= duration - 1e-9:
            self._at_s = duration
            self._finish(now)
        return self.motion.at(self._at_s)

    def _faded(self, now: int, values: list[float]) -> list[float]:
        """Add the rest of the offset that blending began with; it fades while the motion plays, not while it
        is halted.
        """
        if self._offsets is not None:
            self._fade_s += min(max(now - self._began, 0) / 1e9, 2.0 / self.rate_hz)
            self._began = now
            fade = 1.0 - smooth_step(self._fade_s / self._approach_s)
            if fade > 0.0:
                return [a + b * fade for a, b in zip(values, self._offsets, strict=True)]
            self._offsets = None
        return values

    def _play_row(self) -> list[float]:
        """Return a counted row: by rows, not by the clock."""
        if self._begun:
            self._at_s = min(self._at_s + self.motion.row_s, self.motion.duration_s)
        self._begun = True
        self._rows -= 1
        if not self._rows:
            self.mode = "halted"
        return self.motion.at(self._at_s)

    def _finish(self, now: int) -> None:
        self.rounds_done += 1
        if self.rounds is not None and self.rounds_done >= self.rounds:
            self.mode = "ended"
        else:
            self.mode, self._began, self._fresh = "waiting", now, True

    def _fail(self, now: int, reason: str) -> None:
        self.mode, self.reason = "failed", reason
        self.listeners.emit(ControlEvent("failed", now, self.name, reason))
