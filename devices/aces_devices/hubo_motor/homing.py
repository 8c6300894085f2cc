"""Homing: searching a joint's switch and index, and what follows from it.

1. Home commands are sent, then watched: progress, success, failure by status, by a stop, or by time.
2. No board of the bus is sent references for 3 s after a home command, and the board itself none while it searches.

D12: the settings are stored in the board (0x11 with bit 1). Success: home flag 6 (2 for wrist rolls) and |position| at most
0.0075 rad (hubo-ach). Boards of three and more channels have no home flag: there a joint that has moved or met its switch,
then rests near zero, is homed. D08: offset and direction are sent, the status byte says 5 (done) or 10 (failed), masked
with 0x0F; each joint is tried 2 times, arms 3 times (acesHubo).
"""

from __future__ import annotations

from typing import Any

from aces_bus.device import Job, Steps
from aces_bus.device.ticket import Awaited
from aces_bus.errors import CallerError

from .board import ARRIVED, MotorAxis, MotorBoard, search_state
from .switching import PAUSE_NS, Switching

#: Between two looks at a search (ns).
LOOK_NS = 50_000_000
#: A joint without a home flag must have rested for so long (ns).
REST_NS = 300_000_000


class Homing(Switching):
    """Home searches and zeros."""

    def home(self, joint: str | None = None) -> Job:
        """Search the home of one joint, or of all of this board. It moves, whether enabled or not.

        The job's `progress` says how far it is; it fails with a `DeviceError` that says why. Its result are the names of
        the joints that were homed. Raises `UnknownNameError` for a joint that is not here, `CallerError` for a board that
        cannot home or a robot file without the joint's home (D08).
        """
        message = self.shape.home
        if message is None:
            raise CallerError(f"{self.name} (kind {self.kind}) has no home search")
        if self.homing:
            raise CallerError(f"{self.name}: a home search is under way")
        axes = self.axes_of(joint)
        self.is_driven = True
        if message == "Home":
            return self._start(axes, lambda job: self._home_d12(job, axes, joint is None))
        if message == "Home5D08":
            fields: dict[str, Any] = {"power": [self._power(axes)] * 5}
            return self._start(axes, lambda job: self._home_blind(job, axes, message, fields))
        if self.shape.channels == 3:
            axes = [self._only_switch(joint)]
        for axis in axes:
            self._home_of(axis)
        return self._start(axes, lambda job: self._home_d08(job, axes))

    def _start(self, axes: list[MotorAxis], steps: Any) -> Job:
        self.homing = {axis.channel for axis in axes}
        search = self.lead("home", steps)
        search.then(self._search_is_over)  # also where it was refused, or ended before its first step
        return search

    def _search_is_over(self, search: Awaited) -> None:
        self.homing = set()

    def _announce(self) -> None:
        """Hold off references on this bus while a home command goes out (hubo-ach)."""
        duration = self.settings.hold_home_s
        for device in self.host.devices.values():
            if isinstance(device, MotorBoard):
                device.hold_off(duration)

    def _timeout(self) -> int:
        return round(self.settings.home_timeout_s * 1e9)

    def _arrived(self, axes: list[MotorAxis]) -> None:
        """Set-points are zero now."""
        self.epoch += 1
        for axis in axes:
            if self.takes_set_points and axis.joint is not None and self.follows:
                self.give(axis, axis.to_counts(0.0))

    # ------------------------------------------------------------------ D12

    def _home_d12(self, job: Job, axes: list[MotorAxis], whole: bool) -> Steps:
        if self.shape.has_driver_switch and not self.is_enabled:
            yield self.send("DriverSwitch", state="on")
        began = self.clock.now()
        for axis in axes[:1] if whole else axes:
            self._announce()
            yield self.send("Home", motor="all" if whole else f"motor_{axis.channel + 1}")
        if self.kind == "hand":
            for _ in range(2):
                yield self.send("ControlMode", mode=self.hand_mode)
        first = {axis.channel: axis.count for axis in axes}
        moved: set[int] = set()
        waiting, rested = list(axes), dict.fromkeys((axis.channel for axis in axes), began)
        status = self.shape.status
        assert status is not None
        while waiting:
            yield LOOK_NS
            now = self.clock.now()
            yield self.ask("SendStatus", reply=status.reply)
            yield from self.reading_positions()
            for axis in list(waiting):
                if axis.count != first[axis.channel]:
                    moved.add(axis.channel)
                    rested[axis.channel] = now
                    first[axis.channel] = axis.count
                if "limit_switch" in (axis.shown("status") or ()):
                    moved.add(axis.channel)
                near = axis.count is not None and abs(axis.to_rad(axis.count)) <= ARRIVED
                if self.shape.has_home_flag:
                    over = near and bool(axis.shown("homed"))
                else:
                    over = near and axis.channel in moved and now - rested[axis.channel] >= REST_NS
                if over:
                    waiting.remove(axis)
            job.progress = max(1 - len(waiting) / len(axes), min(0.9, (now - began) / self._timeout()))
            job.text = f"searching {', '.join(axis.name for axis in waiting)}" if waiting else "home"
            if waiting and now - began >= self._timeout():
                raise self.fail(f"no home within {self._timeout() / 1e9:g} s: {self._why(waiting)}")
            self._keep_off(now)
        self._arrived(axes)
        return [axis.name for axis in axes]

    def _keep_off(self, now: int) -> None:
        """While a board searches, its own references stay away."""
        if self._held_until < now + 4 * LOOK_NS:
            self.hold_off(4 * LOOK_NS / 1e9)

    def _why(self, axes: list[MotorAxis]) -> str:
        """Return what is known of joints that found no home."""
        said: list[str] = []
        for axis in axes:
            parts = [f"home flag {axis.shown('home')}"] if "home" in axis.signals else []
            parts += axis.shown("errors") or ()
            if axis.count is not None:
                parts.append(f"at {axis.to_rad(axis.count):.4f} rad")
            said.append(f"{axis.name} ({', '.join(parts)})")
        return "; ".join(said)

    # ------------------------------------------------------------------ D08

    def _home_of(self, axis: MotorAxis) -> Any:
        home = axis.joint.home if axis.joint is not None else None
        if home is None or home.offset is None or home.direction is None:
            raise CallerError(
                f"{self.name}: {axis.name} needs home = {{ offset, direction }} in the robot's file"
            )
        return home

    def _only_switch(self, joint: str | None) -> MotorAxis:
        """Return the one motor of three that has a limit switch."""
        axis = self.axes[0]
        if joint is not None and self.axes_of(joint) != [axis]:
            raise CallerError(f"{self.name}: only {axis.name} has a limit switch; it homes the board")
        return axis

    def _power(self, axes: list[MotorAxis]) -> int:
        powers = {
            axis.joint.home.power for axis in axes if axis.joint is not None and axis.joint.home is not None
        }
        power = next(iter(powers), None)
        if power is None or len(powers) > 1:
            raise CallerError(f"{self.name}: its joints need one home = {{ power }} in the robot's file")
        return power

    def tries(self) -> int:
        """Return how often a joint's search is tried: 3 for arms and wrists, 2 for legs and waist (acesHubo)."""
        arm = self.credentials["board"] in (0x08, 0x09, 0x0A, 0x0B, 0x20, 0x21, 0x22)
        return int(self.settings.home_tries or (3 if arm else 2))

    def home_fields(self, axis: MotorAxis) -> dict[str, Any]:
        """Return the home command of a channel of D08, from the robot's file.

        A board of three channels has 16 bits for the pulses: higher bits and the sign do not fit and are left out, and the
        other motors get 5 turns, as acesHubo sent both.
        """
        home = self._home_of(axis)
        fields: dict[str, Any] = {"direction": home.direction, "motor": f"motor_{axis.channel + 1}"}
        if self.shape.channels == 3:
            return {**fields, "pulses": abs(home.offset) & 0xFFFF, "revolutions": [5.0, 5.0]}
        offset = [0, 0]
        offset[axis.channel] = home.offset
        return {**fields, "offset": offset}

    def _home_d08(self, job: Job, axes: list[MotorAxis]) -> Steps:
        if not self.is_enabled:
            yield self.send("DriverSwitch", state="on")
            yield self.send("ControlOn")
        status = self.shape.status
        assert status is not None
        assert self.shape.home is not None
        for done, axis in enumerate(axes):
            tries = self.tries()
            for attempt in range(1, tries + 1):
                job.text = f"searching {axis.name}, try {attempt} of {tries}"
                self._announce()
                began = self.clock.now()
                yield self.send(self.shape.home, **self.home_fields(axis))
                state = "searching"
                while state == "searching":
                    yield LOOK_NS
                    record = yield self.ask("SendStatus", reply=status.reply)
                    state = search_state(record.motor[axis.channel])
                    passed = self.clock.now() - began
                    job.progress = (done + min(0.9, passed / self._timeout())) / len(axes)
                    if passed >= self._timeout():
                        state = "failed"
                    self._keep_off(self.clock.now())
                if state == "done":
                    break
            else:
                raise self.fail(f"{axis.name} found no home in {tries} tries")
            self._arrived([axis])
        yield from self.reading_positions()
        return [axis.name for axis in axes]

    def _home_blind(self, job: Job, axes: list[MotorAxis], message: str, fields: dict[str, Any]) -> Steps:
        """Fingers of D08 are driven against their stop; no status says when they are there."""
        self._announce()
        yield self.send(message, **fields)
        yield round(self.settings.hold_home_s * 1e9)
        return [axis.name for axis in axes]

    # ------------------------------------------------------------------ zeros and errors

    def zero_encoder(self, joint: str | None = None) -> Job:
        """Make the present position of a joint, or of all, the encoder's zero. Errors are cleared too (D12)."""
        axes = self.axes_of(joint)
        if self.kind == "neck" or not self.shape.encoders:
            raise CallerError(f"{self.name} (kind {self.kind}) has no encoder to set to zero")

        def steps(job: Job) -> Steps:
            self.homing = {axis.channel for axis in axes}
            try:
                number = axes[0].channel
                if self.dialect == "D12":
                    yield self.send("EncoderZero", channel="all" if joint is None else f"channel_{number}")
                else:
                    yield self.send("EncoderZeroD08", motor="all" if joint is None else f"motor_{number + 1}")
                # The old set-points mean other places now.
                self.epoch += 1
                for axis in axes:
                    if (
                        self.takes_set_points
                        and axis.joint is not None
                        and self.set_message == self.shape.reference
                    ):
                        self.give(axis, 0)
                yield 2 * PAUSE_NS
                yield from self.reading_positions()
            finally:
                self.homing = set()

        return self.job("zero encoder", steps)

    def clear_errors(self, joint: str | None = None, *, zero: bool = False) -> Job:
        """Clear error bits (D12). The command sets the encoder to zero too, so a joint that is not at zero needs `zero`.

        The job fails with a `DeviceError` when the joint is farther than 0.0075 rad from zero and `zero` is False.
        """
        self.only_d12_errors()
        axes = self.axes_of(joint)

        def steps(job: Job) -> Steps:
            yield from self.reading_positions()
            away = [
                a
                for a in axes
                if a.joint is not None and a.count is not None and abs(a.to_rad(a.count)) > ARRIVED
            ]
            if away and not zero:
                names = ", ".join(f"{a.name} at {a.to_rad(a.count or 0):.4f} rad" for a in away)
                raise self.fail(
                    f"clearing errors sets encoders to zero, and {names}; home it, or say zero=True"
                )
            yield self.zero_encoder(joint)

        return self.job("clear errors", steps)

    def only_d12_errors(self) -> None:
        """Raise `CallerError` on a board whose errors cannot be cleared."""
        if self.dialect != "D12" or self.shape.status is None:
            raise CallerError(
                f"{self.name} speaks {self.dialect} and is of kind {self.kind}: it reports no errors"
            )
