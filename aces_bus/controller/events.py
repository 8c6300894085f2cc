"""Events: what a controller receives besides values, and what it reports: the upper end of the paper's shortcut.

1. An event is a value; emitting one never waits and never raises.
2. Instants are integer ns of the clock that the runtime steps the controller with.
"""

from __future__ import annotations

import sysconfig
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Protocol

import msgspec

from ..tracebacks import innermost_line, shown_path


class EventLike(Protocol):
    """What every event has, on all floors."""

    @property
    def kind(self) -> str:
        """Kind of the event, in a word or two ("bus-off", "lost", "trip")."""
        ...

    @property
    def instant(self) -> int:
        """When, in ns."""
        ...

    @property
    def source(self) -> str:
        """Source: a bus, a device, a controller."""
        ...

    @property
    def detail(self) -> str:
        """The rest, for people."""
        ...


class ControlEvent(msgspec.Struct, frozen=True):
    """Something that a controller, a guard or a supervisor has to say.

    `kind` is one of "trip" (motion was stopped), "recovered", "degraded", "raised" (a controller's exception), "clipped",
    "not finite", "unnamed" (a state that was given is not any more), "late" (set-points came again after a trip), "let go"
    (an end that holds stops what would not stay), "failed" (a player or a path cannot go on).
    """

    kind: str
    instant: int
    source: str
    detail: str = ""

    def __str__(self) -> str:
        return f"{self.source}: {self.kind}" + (f": {self.detail}" if self.detail else "")


#: Called with each event.
Listener = Callable[[ControlEvent], None]


class Listeners:
    """The listeners of events; `failures` counts what they raised (rule 1)."""

    __slots__ = ("_all", "failures")

    def __init__(self) -> None:
        self._all: tuple[Listener, ...] = ()
        self.failures = 0

    def add(self, listener: Listener) -> None:
        """Call `listener` with every event from now on."""
        self._all += (listener,)

    def emit(self, event: ControlEvent) -> None:
        """Call all, whatever they do."""
        for listener in self._all:
            try:
                listener(event)
            except Exception:
                self.failures += 1


#: How much of what an exception says is repeated.
TEXT_LENGTH = 500


def raised_text(error: BaseException) -> str:
    """Return what an exception says, and the innermost line of the user's own code that it came from: `… (walk.py:12)`."""
    text = f"{type(error).__name__}: {error}"[:TEXT_LENGTH]
    at = innermost_line(error, lambda file: not _is_library(file))
    return f"{text} ({shown_path(at.filename)}:{at.lineno})" if at is not None else text


@cache
def _is_library(file: str) -> bool:
    """Return whether a file is this package's, Python's or an installed one's."""
    if file.startswith("<"):
        return not file.startswith(_TYPED)
    return any(Path(file).is_relative_to(folder) for folder in _LIBRARIES)


#: What code is called that is no file's and the user's all the same: equations, and what is typed into Python.
_TYPED = ("<equations", "<string>", "<stdin>", "<doctest", "<ipython")
_LIBRARIES = (
    Path(__file__).parents[1],
    *(Path(sysconfig.get_path(name)) for name in ("stdlib", "platstdlib", "purelib", "platlib")),
)
