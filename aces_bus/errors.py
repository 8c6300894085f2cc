"""Everything aces-bus raises on purpose, as one tree.

    AcesError
    ├── CallerError            the call is wrong: fix the call
    │   ├── UnknownNameError   no such protocol, message, dialect, field: lists the names that exist
    │   ├── FieldError         a value does not fit its field: says field, value and range
    │   ├── CaptureError       a file cannot be used as a capture: says file and what would work
    │   ├── StateError         a state was asked for what it cannot know (aces_bus.state)
    │   ├── EquationError      an equation is wrong: says line and column (aces_bus.controller)
    │   ├── MachineError       a state machine's table is wrong: says phase and row (aces_bus.controller)
    │   ├── TrajectoryError    a file of set-points is wrong: says file:line (aces_bus.controller)
    │   └── RobotError         a robot file is wrong: says file:line of everything that is (aces_bus.device)
    ├── SpecError              a protocol's declaration is wrong: says file:line and both places
    └── DeviceError            a device did not do what its protocol promises
        ├── NoReplyError       it did not answer in time
        └── NotStoppedError    it was asked to stop, and may still move: says which, and why

1. A message says who, where and what next.
2. Bytes from a wire never raise: they are counted (see `aces_bus.protocol.live`).
"""

from __future__ import annotations

from collections.abc import Iterable

__all__ = [
    "AcesError",
    "CallerError",
    "CaptureError",
    "DeviceError",
    "FieldError",
    "NoReplyError",
    "NotStoppedError",
    "SpecError",
    "UnknownNameError",
]


class AcesError(Exception):
    """The root of the tree."""


class CallerError(AcesError):
    """The call is wrong."""


#: Names that a message lists.
NAMED = 5


def first_names(names: Iterable[str]) -> str:
    """Return the first names of many, and how many more there are.

    >>> first_names("abcdefgh"), first_names("ab"), first_names("")
    ('a, b, c, d, e and 3 more', 'a, b', 'none')
    """
    known = list(names)
    more = f" and {len(known) - NAMED} more" if len(known) > NAMED else ""
    return ", ".join(known[:NAMED]) + more if known else "none"


class UnknownNameError(CallerError):
    """A name that does not exist; the message lists those that do, the nearest first where there are many."""

    def __init__(self, kind: str, name: str, known: Iterable[str]) -> None:
        from difflib import get_close_matches

        names = sorted(known)
        name = str(name)  # a caller may give anything
        near = get_close_matches(name, names, n=NAMED)
        if not near:  # the same in another case, or a part of it
            near = [candidate for candidate in names if name and name.lower() in candidate.lower()][:NAMED]
        hint = f"; did you mean {near[0]!r}?" if near else ""
        shown = (
            [*near, *(candidate for candidate in names if candidate not in near)]
            if len(names) > NAMED
            else names
        )
        super().__init__(f"no {kind} named {name!r}{hint} (there are: {first_names(shown)})")
        self.kind, self.name, self.known = kind, name, tuple(names)


class FieldError(CallerError):
    """A value does not fit its field."""


class CaptureError(CallerError):
    """A file or stream that cannot be used as a capture."""


class SpecError(AcesError):
    """A protocol's declaration is wrong; the message begins with `file:line:`."""


class DeviceError(AcesError):
    """A device did not do what its protocol promises."""


class NoReplyError(DeviceError):
    """A device that did not answer in time."""


class NotStoppedError(DeviceError):
    """Devices that have not stopped: `devices`, name → why."""

    def __init__(self, devices: dict[str, str]) -> None:
        many = len(devices) > 1
        reasons = "; ".join(f"{name}: {why}" if many else why for name, why in devices.items())
        super().__init__(f"NOT switched off: {', '.join(devices)} ({reasons})")
        self.devices = devices
