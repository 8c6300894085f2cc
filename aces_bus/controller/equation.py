"""A controller as equations, near the paper's notation (its section III-B).

1. The text is checked at definition (`aces_bus.controller.language`); what it may say is listed there.
2. It is not evaluated before every state it reads has a value.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from types import SimpleNamespace

from ..errors import AcesError, UnknownNameError
from .base import NOTHING, Controller, StateLike
from .language import Compiled, Program, Scope, as_states, equations


class Equations(Controller):
    """Lines of equations, evaluated together at a rate.

    >>> knee = Equations(
    ...     "knee", '''
    ...     error  = goal - LKP[0]
    ...     LKP[0] = LKP[0] + kp*error
    ...     RKP[0] = LKP[-0.02]
    ...     ''', rate_hz=200, parameters={"kp": 0.5, "goal": 1.0})
    >>> knee.states, knee.writes
    (('LKP',), ('LKP', 'RKP'))
    >>> knee.bind({"LKP": {0: 0.5, -0.02: 0.1}})
    >>> knee.step(0)
    {'LKP': 0.75, 'RKP': 0.1}

    `parameters` are changed with `set`; `memory` keeps its value from step to step, and begins anew with `start`.
    `states` declares which there are, so that a misspelt one is found at definition.
    `EquationError` says line and what there is.
    """

    def __init__(
        self,
        name: str,
        text: str,
        *,
        rate_hz: float,
        states: Iterable[str] | None = None,
        parameters: Mapping[str, float] | None = None,
        memory: Mapping[str, float] | None = None,
    ) -> None:
        self.text = text
        self._scope = Scope(name, as_states(states), dict(parameters or {}), dict(memory or {}))
        block = equations(self._scope, "equations", text)
        self._program = Program(self._scope, {"step": block})
        super().__init__(name, rate_hz=rate_hz, states=self._scope.used, writes=block.setpoints)
        self.values = SimpleNamespace(**self._scope.parameters, **self._scope.memory)
        self._evaluate: Compiled | None = None
        self._last: int | None = None
        self._ready = False

    @property
    def source(self) -> str:
        """The Python that the equations became."""
        return self._program.source

    def set(self, **parameters: float) -> None:
        """Change parameters, from the next step on."""
        for parameter, value in parameters.items():
            if parameter not in self._scope.parameters:
                raise UnknownNameError(f"parameter of {self.name!r}", parameter, self._scope.parameters)
            setattr(self.values, parameter, float(value))

    def bind(self, states: Mapping[str, StateLike]) -> None:
        """Take the states it reads."""
        super().bind(states)
        self._evaluate = self._program.bind(self.bound, self.values)["step"]
        self._ready = False

    def start(self, now: int) -> None:
        """A run begins: memory has its first values."""
        super().start(now)
        self.values.__dict__.update(self._scope.memory)
        self._last, self._ready = None, False

    def step(self, now_ns: int) -> Mapping[str, float]:
        """The set-points; nothing while a state that it reads is unknown."""
        if not self._ready:
            if self._evaluate is None:
                self.bind({})
            self.waiting = ", ".join(self.unknown_states())
            if self.waiting:
                return NOTHING
            self._ready = True
        assert self._evaluate is not None
        if self.started_ns is None:
            self.started_ns = now_ns
        dt = 1.0 / self.rate_hz if self._last is None else (now_ns - self._last) / 1e9
        self._last = now_ns
        try:
            setpoints: Mapping[str, float] = self._evaluate((now_ns - self.started_ns) / 1e9, dt)
        except (TypeError, AcesError) as error:
            if not self.excuses(error):
                raise
            self._ready = False
            return NOTHING
        self._has_given = True
        return setpoints
