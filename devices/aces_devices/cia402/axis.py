"""One axis of a drive: its objects as signals in SI, its set-points as objects, its place in the state machine.

1. Values cross into counts here and in `units`, nowhere else.
2. Only what the present mode takes can be set; a set-point for an axis that is not enabled is dropped and reported.
3. A set-point of profile position is one handshake: target, bit 4 up, taken, bit 4 down. A newer one waits for that.

Objects are named as those of axis 0; those of axis n are 0x800 × n higher (ros2_canopen).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

from aces_bus.device.config import Joint
from aces_bus.device.signals import Signal
from aces_bus.errors import CallerError

from .states import (
    AT_ONCE,
    ENABLE,
    LIMITED,
    MODE_NAMES,
    MODES,
    REACHED,
    START,
    TAKEN,
    TARGETS,
    USUAL,
    WARNING,
    drive_state,
)
from .units import units_of

if TYPE_CHECKING:
    from .driver import Cia402

CONTROLWORD, STATUSWORD, MODE, MODE_SHOWN = 0x6040, 0x6041, 0x6060, 0x6061
POSITION, VELOCITY, TORQUE = 0x6064, 0x606C, 0x6077
#: An axis that has not taken a set-point for so long does not (ns).
TAKES_NS = 1_000_000_000

READ = {
    POSITION: "position",
    VELOCITY: "velocity",
    TORQUE: "torque",
    STATUSWORD: "status",
    MODE_SHOWN: "mode",
}


class DriveAxis:
    """One joint of a drive."""

    def __init__(self, device: Cia402, joint: Joint) -> None:
        self.device, self.joint, self.name, self.channel = device, joint, joint.name, joint.channel
        self.offset = 0x800 * joint.channel
        self.units = units_of(device.name, joint, device.settings)
        #: What is sent, by object.
        self.outputs: dict[int, int] = {CONTROLWORD: 0, MODE: 0}
        self.statusword: int | None = None
        self.position_raw: int | None = None
        self.mode_shown: int | None = None
        self.wanted = device.settings.mode or USUAL.get(joint.command, "profile_position")
        if self.wanted not in TARGETS:
            raise CallerError(
                f"{device.name}: settings mode is one of {', '.join(TARGETS)}, not {self.wanted!r}"
            )
        #: How many statuswords were received.
        self.received = 0
        self._is_fresh = False
        self._raised_at = 0
        #: A set-point that came before the drive's first message.
        self._early: int | None = None
        self._declare("N·m" if self.units.is_rated else "")

    # ------------------------------------------------------------------ signals

    def _declare(self, torque_unit: str) -> None:
        joint, add, units = self.joint, self._add, self.units
        speed = joint.max_speed
        low = None if speed is None else -speed
        torque = "torque" if torque_unit else "torque, as a share of the rated one"
        #: What is measured and set: its name, raw numbers a SI unit, raw number at 0.
        self.scales: dict[int, tuple[str, float, float]] = {
            POSITION: ("position", units.per_rad, units.zero),
            VELOCITY: ("velocity", units.per_speed, 0.0),
            TORQUE: ("torque", units.per_torque, 0.0),
        }
        give = {name: partial(self._set, scale, zero) for name, scale, zero in self.scales.values()}
        self.signals: dict[str, Signal] = {
            "position": add(
                "position", "rad", give["position"], joint.lower, joint.upper, "position", "object 6064"
            ),
            "velocity": add("velocity", "rad/s", give["velocity"], low, speed, "velocity", "object 606C"),
            "torque": add("torque", torque_unit, give["torque"], None, None, torque, "object 6077"),
            "status": add("status", doc="the statusword", source="object 6041"),
            "state": add("state", doc="where it is in the state machine", source="object 6041"),
            "mode": add("mode", doc="mode of operation", source="object 6061"),
            "reached": add("reached", doc="whether the target is reached", source="object 6041, bit 10"),
            "limited": add("limited", doc="whether a limit inside is active", source="object 6041, bit 11"),
            "warning": add("warning", doc="whether the drive warns", source="object 6041, bit 7"),
        }
        self._setters = {name: self.signals[name].setter for name in give}
        self.choose(self.wanted)

    def _add(
        self,
        name: str,
        unit: str = "",
        setter: Callable[[Any], None] | None = None,
        lower: float | None = None,
        upper: float | None = None,
        doc: str = "",
        source: str = "",
    ) -> Signal:
        return self.device.add_signal(
            name,
            owner=self.joint.name,
            unit=unit,
            setter=setter,
            lower=lower,
            upper=upper,
            stale_s=self.device.pdo_stale_s,
            doc=doc,
            source=f"CiA 402, {source}",
        )

    def choose(self, mode: str) -> None:
        """Choose a mode: from now on only its target can be set."""
        self.wanted = mode
        target = TARGETS[mode][0]
        for name, setter in self._setters.items():
            self.signals[name].setter = setter if name == target else None
        self._is_fresh = False

    # ------------------------------------------------------------------ up

    def update(self, index: int, value: int, instant: int) -> None:
        """Update signals from an object of the drive; `index` is that of axis 0."""
        signals = self.signals
        if index in self.scales:
            name, scale, zero = self.scales[index]
            if index == POSITION:
                self.position_raw = value
            signals[name].update((value - zero) / scale + 0.0, instant)
        elif index == MODE_SHOWN:
            self.mode_shown = value
            signals["mode"].update(MODE_NAMES.get(value, str(value)), instant)
        elif index == STATUSWORD:
            self._status(value, instant)
        if self._early is not None and self.statusword is not None and self.mode_shown is not None:
            early, self._early = self._early, None
            self._give(early)

    def _status(self, word: int, instant: int) -> None:
        signals = self.signals
        self.received += 1
        if word != self.statusword:
            self.statusword = word
            self.state = drive_state(word)
        signals["status"].update(word, instant)
        signals["state"].update(self.state, instant)
        signals["reached"].update(word & REACHED != 0, instant)
        signals["limited"].update(word & LIMITED != 0, instant)
        signals["warning"].update(word & WARNING != 0, instant)
        if self._is_fresh or self.outputs[CONTROLWORD] & START:
            self.hand_over(instant)

    state = "unknown"

    def forget(self) -> None:
        """Forget everything known of the drive, which has lost its settings."""
        self.statusword = self.position_raw = self.mode_shown = None
        self.state = "unknown"
        self.outputs = {CONTROLWORD: 0, MODE: 0}
        self._is_fresh = False
        self._early = None

    # ------------------------------------------------------------------ down

    def hold(self) -> None:
        """Set targets that move nothing: the present position, no speed, no torque."""
        for index in (0x60FF, 0x6042, 0x6071):
            self.outputs[index] = 0
        self.outputs[0x607A] = self.position_raw or 0
        self._is_fresh = False

    @property
    def takes(self) -> bool | None:
        """True if the drive is enabled and in its mode; None while nothing is known of it."""
        if self.statusword is None or self.mode_shown is None:
            return None
        return self.state == "operation enabled" and self.mode_shown == MODES[self.wanted]

    def _set(self, scale: float, zero: float, value: Any) -> None:
        self._give(round(float(value) * scale + zero))

    def _give(self, raw: int) -> None:
        if self.statusword is None or self.mode_shown is None:
            self._early = raw  # nothing is known of the drive yet
            return
        if self.state == "operation enabled" and not self.outputs[CONTROLWORD]:
            # Enabled before we came: what we send must not disable it.
            self.hold()
            self.outputs[CONTROLWORD], self.outputs[MODE] = ENABLE, self.mode_shown
        if not self.takes:
            self.device.emit_event(
                "not sent", f"{self.joint.name} is {self._why()}: the set-point is dropped"
            )
            return
        index = TARGETS[self.wanted][1]
        self.outputs[index] = raw
        if self.wanted == "profile_position":
            self._is_fresh = True
            self.hand_over(self.device.clock.now())
        else:
            self.device.put(self, index)

    def _why(self) -> str:
        if self.state != "operation enabled":
            return f"not enabled but {self.state}"
        return f"in mode {MODE_NAMES.get(self.mode_shown or 0, self.mode_shown)}, not in {self.wanted}"

    def hand_over(self, now: int) -> None:
        """Take the next step in the handshake of profile position."""
        if self.wanted != "profile_position" or self.state != "operation enabled" or self.statusword is None:
            return
        is_taken = bool(self.statusword & TAKEN)
        word = self.outputs[CONTROLWORD]
        if word & START:
            if is_taken:
                self.outputs[CONTROLWORD] = word & ~(START | AT_ONCE)
                self.device.put(self, CONTROLWORD)
            elif now - self._raised_at > TAKES_NS:
                self._raised_at = now
                self.device.emit_event("alarm", f"{self.joint.name} does not take its set-point")
        elif self._is_fresh and not is_taken:
            self._is_fresh = False
            self._raised_at = now
            self.outputs[CONTROLWORD] = word | START | AT_ONCE
            self.device.put(self, 0x607A, CONTROLWORD)
