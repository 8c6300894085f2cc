"""A controller as a function.

1. Everything is read off the signature, once, at definition: positional parameters are states (or `t`, `dt`, `states`,
   `memory`), keyword-only parameters with defaults are gains.
2. It is not called before every state has a value: unknown is not zero.

`t` is seconds since the start, `dt` seconds since the last step, `memory` a namespace that lives as long as a run.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from ..errors import CallerError, UnknownNameError
from .base import LawController, StateLike

#: Parameters that are not states.
SPECIAL = ("t", "dt", "states", "memory")
Law = Callable[..., Mapping[str, float] | None]


class FunctionController(LawController):
    """What `@controller` makes of a function; calling it calls the function."""

    def __init__(
        self,
        law: Law,
        *,
        rate_hz: float,
        states: Iterable[str] | None = None,
        writes: Iterable[str] = (),
        name: str = "",
    ) -> None:
        name = name or getattr(law, "__name__", "controller")
        given = None if states is None else tuple(dict.fromkeys(states))
        self._names: list[str] = []
        self.gains: dict[str, float] = {}
        for parameter in inspect.signature(law).parameters.values():
            if parameter.kind in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD):
                raise CallerError(f"controller {name!r}: *{parameter.name} is neither a state nor a gain")
            if parameter.kind is parameter.KEYWORD_ONLY:
                if parameter.default is parameter.empty:
                    raise CallerError(f"controller {name!r}: the gain {parameter.name!r} needs a default")
                self.gains[parameter.name] = parameter.default
            elif parameter.default is not parameter.empty:
                raise CallerError(
                    f"controller {name!r}: {parameter.name!r} has a default but is not keyword-only; "
                    f"write (…, *, {parameter.name}=…) for a gain"
                )
            else:
                if given is not None and parameter.name not in (*given, *SPECIAL):
                    raise UnknownNameError(
                        f"state of controller {name!r}", parameter.name, (*given, *SPECIAL)
                    )
                self._names.append(parameter.name)
        inferred = tuple(argument for argument in self._names if argument not in SPECIAL)
        super().__init__(
            name,
            rate_hz=rate_hz,
            states=inferred if given is None else given,
            writes=writes,
            parameters={},
            memory={},
        )
        self.law = law
        self.memory = self.values
        self._arguments: list[Any] = []
        self._timed = [(i, argument) for i, argument in enumerate(self._names) if argument in ("t", "dt")]
        self.__doc__ = law.__doc__

    def __call__(self, *arguments: Any, **gains: Any) -> Mapping[str, float] | None:
        """Call the function itself."""
        return self.law(*arguments, **gains)

    def set(self, **gains: float) -> None:
        """Change gains, from the next step on."""
        for gain in gains:
            if gain not in self.gains:
                raise UnknownNameError(f"gain of controller {self.name!r}", gain, self.gains)
        self.gains = {**self.gains, **gains}  # a new mapping: a step that runs keeps the old one

    def bind(self, states: Mapping[str, StateLike]) -> None:
        """Take the states it reads."""
        super().bind(states)
        special = {"states": self.bound, "memory": self.memory, "t": 0.0, "dt": 0.0}
        self._arguments = [
            special[argument] if argument in special else self.bound[argument] for argument in self._names
        ]

    def start(self, now: int) -> None:
        """Begin a run with empty memory."""
        self.memory.__dict__.clear()
        super().start(now)

    def _law(self, t: float, dt: float) -> Mapping[str, float] | None:
        for index, name in self._timed:
            self._arguments[index] = t if name == "t" else dt
        return self.law(*self._arguments, **self.gains)


def controller(
    *, rate_hz: float, states: Iterable[str] | None = None, writes: Iterable[str] = (), name: str = ""
) -> Callable[[Law], FunctionController]:
    """Make a controller of a function.

    Its positional parameters are the states it reads, by name; `states=[…]` says them where a name is not an identifier, and
    the function then takes them as the mapping `states`; `writes` those it gives set-points for. Keyword-only parameters
    are gains, which `set` changes.

    >>> @controller(rate_hz=200)
    ... def hold(LKP, *, kp=0.5, goal=1.0):
    ...     return {"LKP": LKP[0] + kp * (goal - LKP[0])}
    >>> hold.states, hold.gains
    (('LKP',), {'kp': 0.5, 'goal': 1.0})
    >>> hold.bind({"LKP": [0.0]})
    >>> hold.step(0)
    {'LKP': 0.5}
    >>> hold.set(kp=0.25)
    >>> hold.step(5_000_000)
    {'LKP': 0.25}
    """

    def make(law: Law) -> FunctionController:
        return FunctionController(law, rate_hz=rate_hz, states=states, writes=writes, name=name)

    return make
