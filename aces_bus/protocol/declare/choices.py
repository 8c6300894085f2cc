"""What a payload chooses by: enumerations before a choice, which records show by name and raw mode by number.

1. A choice comes out the same in both modes, whichever of the two its author wrote: a `Switch` gets its cases under both,
   an expression is given values that equal both.
2. An enumeration is known by the way an expression reaches it: `("kind",)`, `("id", "kind")` inside a nested record,
   `("_", "kind")` around one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import construct as c

from .bits import BitLayout
from .fields import Enumeration
from .head import enumeration_of

Known = Mapping[tuple[str, ...], Enumeration]


class _Asked(dict[str, Any]):
    """Stands for a context, and notes which enumerations an expression asks it for."""

    def __init__(self, known: Known, found: dict[tuple[str, ...], Any], path: tuple[str, ...] = ()) -> None:
        super().__init__()
        self._known, self._found, self._path = known, found, path

    def __getitem__(self, name: str) -> Any:
        path = (*self._path, name)
        inner = _Asked(self._known, self._found, path)
        return self._found.setdefault(path, inner) if path in self._known else inner

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return self[name]


class _Both(int):
    """A number of an enumeration, equal to its name too."""

    names: Enumeration

    def __eq__(self, other: object) -> bool:
        return self.names.names.get(other) == int(self) if isinstance(other, str) else int(self) == other

    __hash__ = int.__hash__


def enumerations_asked(expression: Any, known: Known) -> tuple[dict[tuple[str, ...], Any], Any]:
    """Return which enumerations an expression asks for, and what it gives when it is handed stand-ins for them."""
    found: dict[tuple[str, ...], Any] = {}
    if not callable(expression) or not known:
        return found, None
    try:
        return found, expression(_Asked(known, found))
    except Exception:  # it computes with what is only a stand-in
        return found, None


def switch_by_both(switch: c.Switch, known: Known) -> c.Switch:
    """Return a `Switch` over an enumeration, its cases under the names that records show and the numbers of raw mode."""
    found, answer = enumerations_asked(switch.keyfunc, known)
    for path, marker in found.items():
        if answer is not marker:
            continue
        enumeration = known[path]
        names, values = enumeration.names, enumeration.values
        numbers = {names[key]: case for key, case in switch.cases.items() if key in names}
        named = {values[key]: case for key, case in switch.cases.items() if key in values}
        return c.Switch(switch.keyfunc, {**numbers, **named, **switch.cases}, switch.default)
    return c.Switch(equal_in_both(switch.keyfunc, known), switch.cases, switch.default)


def equal_in_both(expression: Any, known: Known) -> Any:
    """Return an expression that gives the same answer in both modes: enumerations are numbers to it that equal their
    names.
    """
    found, _ = enumerations_asked(expression, known)
    return _Expression(expression, {path: known[path] for path in found}) if found else expression


class _Expression:
    """An expression over a view of its context."""

    def __init__(self, expression: Callable[[Any], Any], known: Known) -> None:
        self.expression, self.known = expression, known

    def __call__(self, context: Any) -> Any:
        return self.expression(_view(context, self.known))

    def __repr__(self) -> str:
        return repr(self.expression)


def _view(context: Any, known: Known) -> Any:
    """Return a context in which some enumerations equal number and name."""
    made = c.Container(context)
    below: dict[str, dict[tuple[str, ...], Enumeration]] = {}
    for (name, *rest), enumeration in known.items():
        if rest:
            below.setdefault(name, {})[tuple(rest)] = enumeration
            continue
        value = context.get(name)
        if isinstance(value, str):
            value = enumeration.names.get(value, value)
        if isinstance(value, int):
            made[name] = _Both(value)
            made[name].names = enumeration
    for name, inner in below.items():
        if isinstance(context.get(name), dict):
            made[name] = _view(context[name], inner)
    return made


def enumerations_of(name: str | None, con: c.Construct) -> dict[tuple[str, ...], Enumeration]:
    """Return the enumerations that a field brings, by the way to them from beside it."""
    if name is None:
        return {}
    while isinstance(con, (c.Renamed, c.Default, c.Prefixed, c.FixedSized)):
        con = con.subcon
    found: dict[tuple[str, ...], Enumeration] = {}
    if isinstance(con, c.Struct):
        for item in con.subcons:
            found |= enumerations_of(item.name, item)
    elif isinstance(con, BitLayout):
        for slot in con.slots:
            found |= enumerations_of(slot.name, slot.field) if slot.name not in con.many else {}
    elif not isinstance(con, (c.Array, c.GreedyRange, c.RepeatUntil)):
        own = enumeration_of(con)
        return {(name,): own} if own is not None else {}
    return {(name, *path): enumeration for path, enumeration in found.items()}


def enumerations_around(known: Known) -> dict[tuple[str, ...], Enumeration]:
    """Return the same enumerations seen from inside a nested record."""
    return {("_", *path): enumeration for path, enumeration in known.items()}
