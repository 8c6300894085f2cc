"""A controller as equations, near the paper's notation (its section III-B).

1. The text is checked at definition (`aces_bus.controller.language`); what it may say is listed there.
2. It is not evaluated before every state it reads has a value.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from .base import LawController, StateLike
from .language import Program, Scope, as_states, equations


class Equations(LawController):
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
        scope = Scope(name, as_states(states), dict(parameters or {}), dict(memory or {}))
        block = equations(scope, "equations", text)
        self._program = Program(scope, {"step": block})
        super().__init__(
            name,
            rate_hz=rate_hz,
            states=scope.used,
            writes=block.setpoints,
            parameters=scope.parameters,
            memory=scope.memory,
        )
        if not self.states:
            self.bind({})

    @property
    def source(self) -> str:
        """The Python that the equations became."""
        return self._program.source

    def bind(self, states: Mapping[str, StateLike]) -> None:
        """Take the states it reads."""
        super().bind(states)
        self._law = self._program.bind(self.bound, self.values)["step"]
