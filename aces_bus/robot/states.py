"""A rig's signals as states.

1. A state is made once, when it is first asked for: an unread signal costs nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import cached_property
from itertools import islice
from typing import Any

import msgspec

from ..controller.door import Door
from ..device.config import KalmanConfig, StateConfig
from ..device.reading import UNKNOWN
from ..errors import CallerError, UnknownNameError
from ..plain_text import MOST_ROWS, html_table
from ..state import ConstantAcceleration, ConstantVelocity, Hold, Kalman, State
from .rig import Rig

#: What a robot's file calls estimators.
ESTIMATORS = {"hold": Hold(), "velocity": ConstantVelocity(), "acceleration": ConstantAcceleration()}
#: The suffix of what was set, as a state.
SETPOINT = ".setpoint"
#: What a run may say of a state: keywords of `State`.
DECLARED = ("estimator", "interpolation", "history", "history_s", "period_s", "stale_after_s")


def _options_of(config: StateConfig) -> dict[str, Any]:
    """Return what a robot's file says of a state, as keywords of `State`."""
    options = {key: getattr(config, key) for key in DECLARED if getattr(config, key) is not None}
    if config.estimator is not None:
        options["estimator"] = ESTIMATORS[config.estimator]
    elif config.kalman is not None:
        kalman = config.kalman
        options["estimator"] = Kalman(kalman.measurement_std, kalman.process_density, kalman.model)
    return options


def _as_in_files(name: str, options: Mapping[str, Any]) -> dict[str, Any]:
    """Return options of a state with its estimator made of what a robot's file has: a word, or a table `kalman`."""
    found = dict(options)
    if isinstance(word := found.get("estimator"), str):
        if word not in ESTIMATORS:
            raise UnknownNameError(f"estimator of state {name}", word, ESTIMATORS)
        found["estimator"] = ESTIMATORS[word]
    if "kalman" in found:
        if found.get("estimator") is not None:
            raise CallerError(f"state {name}: give estimator or kalman, not both")
        try:
            config = msgspec.convert(found.pop("kalman"), KalmanConfig, from_attributes=True)
        except msgspec.ValidationError as error:
            raise CallerError(f"state {name}: kalman: {error}") from error
        found["estimator"] = Kalman(config.measurement_std, config.process_density, config.model)
    return found


class States(Mapping[str, State]):
    """The states of a rig by name, see `Rig.whole`, and of set-points: "RHY.setpoint".

    Each keeps `history` samples, and is what the robot's file says of it; `declared` (name → keywords of `State`) has
    precedence, such as `{"RHY": {"estimator": Kalman(0.01, 1.0), "history_s": 2.0}}`, or as the file has it: `{"kalman":
    {"measurement_std": 0.01, "process_density": 1.0}}`. Raises `UnknownNameError` for a name
    or keyword that is none, `CallerError` as `Device.refresh_every`, and for a state that is declared twice.
    """

    def __init__(
        self, rig: Rig, *, history: int = 512, declared: Mapping[str, Mapping[str, Any]] | None = None
    ) -> None:
        self.rig, self.history = rig, history
        self._made: dict[str, State] = {}
        self._declared: dict[str, dict[str, Any]] = {}
        for name, config in rig.robot.states.items():
            if rig.is_there(name):
                self._declared[rig.whole(name)] = _options_of(config)
        names: dict[str, str] = {}
        for name, options in (declared or {}).items():
            whole = rig.whole(name)
            if (other := names.setdefault(whole, name)) != name:
                raise CallerError(f"states: {name} and {other} are one state, {whole}")
            for key in options:
                if key not in (*DECLARED, "kalman"):
                    raise UnknownNameError(f"option of state {name}", key, (*DECLARED, "kalman"))
            options = _as_in_files(name, options)
            if options.get("period_s") is not None:
                rig.refresh_every(whole, options["period_s"])
            known = self._declared.get(whole, {})
            if "history" in options or "history_s" in options:
                known = {key: value for key, value in known.items() if key not in ("history", "history_s")}
            self._declared[whole] = {**known, **options}

    def __repr__(self) -> str:
        return f"<states of {self.rig.robot.name}: {len(self)}>"

    def _repr_html_(self) -> str:
        rows: list[list[str]] = []
        for name in islice(self, MOST_ROWS):
            state = self[name]
            age = "" if state.age_s is None else f"{state.age_s:.3g}"
            rows.append([name, f"{state.last!r}", state.unit or "", age])
        return html_table(repr(self)[1:-1], ["state", "value", "", "age (s)"], rows, len(self))

    def whole(self, name: str) -> str:
        """Return the full name of a state; raises `UnknownNameError` with those that exist."""
        base = name.removesuffix(SETPOINT)
        return self.rig.whole(base) + name[len(base) :]

    def __getitem__(self, name: str) -> State:
        state = self._made.get(name)
        if state is None:
            whole = self.whole(name)
            state = self._made.get(whole)
            if state is None:
                base = whole.removesuffix(SETPOINT)
                state = self._of_signal(whole) if base == whole else self[base].setpoint
            self._made[whole] = self._made[name] = state
        return state

    @property
    def door(self) -> Door:
        """Door through which set-points leave."""
        return self.rig.door

    def writer(self, name: str, owner: str) -> Callable[[float], None]:
        """Return what `owner` alone gives this state's set-points to from now on; raises as `Door.claim`."""
        self.door.claim(self.whole(name), owner)
        return self.door.writer(self.whole(name))

    def _of_signal(self, whole: str) -> State:
        source: Any = self.rig.signals[whole]
        # What is only set has its set-points for values; all else has what was received.
        is_received = whole in self._readable or not source.is_writable
        options = dict(self._declared.get(whole, ()))
        if options.get("history_s") is None:
            options.setdefault("history", self.history)
        else:
            options.setdefault("period_s", self._period_s(whole))
        return State.of(source, sampled=is_received, **options)

    def _period_s(self, whole: str) -> float | None:
        """Return how often a signal is asked for."""
        device = next(owner for owner in self.rig.devices.values() if whole in owner.signals)
        tick = 1 / device.host.rate_hz if device.host.rate_hz else None
        return min((poll.every_s or tick or 0.0 for poll in device.polls_of(whole)), default=None) or tick

    @cached_property
    def _readable(self) -> set[str]:
        return {name for device in self.rig.devices.values() for name in device.readable}

    @property
    def unknown(self) -> list[str]:
        """The states in use that have no fresh value."""
        return [name for name, state in self._made.items() if state[0] is UNKNOWN]

    def __contains__(self, name: object) -> bool:
        try:
            return isinstance(name, str) and bool(self.whole(name))
        except UnknownNameError:
            return False

    def __iter__(self) -> Iterator[str]:
        return iter(self.rig.signals)

    def __len__(self) -> int:
        return len(self.rig.signals)
