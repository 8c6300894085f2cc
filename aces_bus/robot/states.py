"""A robot's signals as states, made when they are asked for.

1. A joint's name alone ("RHY", or an alias) is its main quantity: what its set-points are. The rest is `RHY.velocity`.
2. A state is made once; what nobody reads costs nothing.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cached_property
from typing import Any

from ..errors import UnknownNameError
from ..state import State
from .rig import Rig

#: What a joint's name alone means, by the joint's `command`.
MAIN = {"position": "position", "speed": "velocity", "current": "current", "duty": "duty"}
#: The suffix of what was set, as a state.
SETPOINT = ".setpoint"


class States(Mapping[str, State]):
    """The states of a rig by name. `history` counts the samples that each keeps."""

    def __init__(self, rig: Rig, *, history: int = 512) -> None:
        self.rig, self.history = rig, history
        self._made: dict[str, State] = {}
        self._names: dict[str, str] = {}

    def whole(self, name: str) -> str:
        """The signal's full name; raises `UnknownNameError` with those that exist."""
        found = self._names.get(name)
        if found is not None:
            return found
        rig = self.rig
        if name.endswith(SETPOINT):
            found = self.whole(name.removesuffix(SETPOINT)) + SETPOINT
        else:
            owner, _, rest = name.partition(".")
            owner = rig.aliases.get(owner, owner)
            if not rest and owner in rig.robot.joints:
                joint = rig.robot.joints[owner]
                first = f"{owner}.{MAIN[joint.command]}"
                found = first if first in rig.signals else f"{owner}.position"
            else:
                found = f"{owner}.{rest}"
            if found not in rig.signals:
                raise self._unknown(name, owner)
        self._names[name] = found
        return found

    def _unknown(self, name: str, owner: str) -> UnknownNameError:
        """What there is near a name that is none: hundreds of names help nobody."""
        rig = self.rig
        device = rig.devices.get(owner)
        near = list(device.signals) if device is not None else []
        near = [whole for whole in rig.signals if whole.partition(".")[0] == owner] or near
        if near:
            return UnknownNameError(f"state of {owner}", name, near)
        owners = {whole.partition(".")[0] for whole in rig.signals}
        return UnknownNameError(f"joint, sensor or device with states in {rig.robot.name}", owner, owners)

    def __getitem__(self, name: str) -> State:
        state = self._made.get(name)
        if state is None:
            whole = self.whole(name)
            if whole.endswith(SETPOINT):
                made = self[whole.removesuffix(SETPOINT)].setpoint
            else:
                made = self._made.get(whole) or self._state(whole)
            state = self._made[whole] = self._made[name] = made
        return state

    def _state(self, whole: str) -> State:
        source: Any = self.rig.signals[whole]
        # What is only set has its set-points for values; all else has what was heard.
        is_heard = source.name in self._readable or not source.is_writable
        return State.of(source, history=self.history, sampled=is_heard)

    @cached_property
    def _readable(self) -> set[str]:
        return {name for device in self.rig.devices.values() for name in device.readable}

    def __contains__(self, name: object) -> bool:
        try:
            return isinstance(name, str) and bool(self.whole(name))
        except UnknownNameError:
            return False

    def __iter__(self) -> Iterator[str]:
        return iter(self.rig.signals)

    def __len__(self) -> int:
        return len(self.rig.signals)
