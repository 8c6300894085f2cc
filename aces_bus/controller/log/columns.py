"""What a log's columns are called, and how one is read from a state.

1. Reading a column never raises: what is unknown, stale or outside of what can be known is NaN.
2. Integrals and derivatives are made when the logger is bound, not when it first samples.

*Facts*: the original's logger links a state and an attribute, and its header says `Name(attribute)`; its attributes are
`value`, `diff` and `integral` (acesHubo, logger.*). `diff` is what we call `rate`; both words are read.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable
from typing import Any

import msgspec

from ...errors import CallerError, UnknownNameError

#: Attribute → what it is.
ATTRIBUTES = {
    "value": "the value",
    "rate": "its derivative, per second",
    "integral": "its integral over time, from the start of the log",
    "setpoint": "the last set-point",
    "age": "how old the value is, in seconds",
}
#: What the original calls them.
ORIGINAL = {"rate": "diff"}
SYNONYMS = {"diff": "rate", "": "value"}
#: A column more than SQLite can hold beside the time is refused everywhere.
MOST_COLUMNS = 1_999
LONGEST_NAME, LONGEST_ATTRIBUTE = 200, 12

_COLUMN = re.compile(r"(?P<state>.+?)(?:\((?P<attribute>[A-Za-z]*)\))?")
NAN = math.nan
_INFINITY = math.inf

Read = Callable[[], float]


class LogColumn(msgspec.Struct, frozen=True):
    """A column: of which state, which attribute, in which unit ("" for a plain number or one that is not stated)."""

    state: str
    attribute: str = "value"
    unit: str = ""

    @property
    def name(self) -> str:
        """As it is asked for: `RHY`, `RHY(rate)`."""
        return self.state if self.attribute == "value" else f"{self.state}({self.attribute})"

    @property
    def original(self) -> str:
        """As the original's header has it: `RHY(value)`, `RHY(diff)`; blanks would part it in two."""
        state = "_".join(self.state.split())
        return f"{state}({ORIGINAL.get(self.attribute, self.attribute)})"


def parse_column(text: str) -> LogColumn:
    """Return a column of its name; raises `CallerError`, for an attribute that does not exist `UnknownNameError`.

    >>> parse_column("RHY(diff)").name, parse_column("RHY.velocity").original
    ('RHY(rate)', 'RHY.velocity(value)')
    """
    found = _COLUMN.fullmatch(text)
    if found is None or not text.strip() or len(text) > LONGEST_NAME or not text.isprintable():
        raise CallerError(f"{text[:80]!r} is not a column of a log; say RHY, RHY.velocity or RHY(rate)")
    attribute = (found["attribute"] or "").lower()
    attribute = SYNONYMS.get(attribute, attribute)
    if attribute not in ATTRIBUTES:
        raise UnknownNameError(f"attribute of a state (column {text!r})", attribute, ATTRIBUTES)
    return LogColumn(found["state"], attribute)


def check_log_columns(where: str, names: Iterable[str]) -> None:
    """Raise `CallerError` for no columns, too many, or two of one name."""
    listed = list(names)
    if not listed:
        raise CallerError(f"{where}: a log needs at least one state")
    if len(listed) > MOST_COLUMNS:
        raise CallerError(f"{where}: {len(listed)} columns; a log has at most {MOST_COLUMNS}")
    seen: set[str] = set()
    for name in listed:
        if not name.isprintable() or len(name) > LONGEST_NAME + LONGEST_ATTRIBUTE:
            raise CallerError(
                f"{where}: {name[:80]!r} cannot be the name of a column; give the state another"
            )
        # As SQLite compares them.
        key = name.casefold()
        if key in seen or key == "time":
            what = "is the column of seconds" if key == "time" else "is there twice (case does not count)"
            raise CallerError(f"{where}: the column {name!r} {what}")
        seen.add(key)


def finite_number(value: Any) -> float:
    """Return a value as a float, NaN when it is none that is finite."""
    if value.__class__ is float:
        return value if -_INFINITY < value < _INFINITY else NAN
    if value is None:
        return NAN
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        return NAN
    return number if -_INFINITY < number < _INFINITY else NAN


def attribute_reader(column: LogColumn, state: Any) -> tuple[Read, str]:
    """Return how the column is read from its state, and its unit; raises `CallerError` when the state has no such
    attribute.
    """
    attribute, unit = column.attribute, "s"
    owner = state
    try:
        if attribute == "age":
            owner.age_s  # noqa: B018 — there is one
        else:
            if attribute == "rate":
                owner = state.rate()
            elif attribute == "integral":
                owner = state.integral()
            elif attribute == "setpoint":
                owner = state.setpoint
            unit = getattr(owner, "unit", None) or ""
    except AttributeError:
        raise CallerError(
            f"column {column.name!r}: this state ({type(state).__name__}) has no {attribute}"
        ) from None

    def read_age() -> float:
        try:
            return finite_number(state.age_s)
        except Exception:  # a derived quantity is the user's own function: rule 1
            return NAN

    def read() -> float:
        try:
            value = owner[0]
            if value.__class__ is float and -_INFINITY < value < _INFINITY:  # nearly always
                return value
            return finite_number(value)
        except Exception:
            return NAN

    return read_age if attribute == "age" else read, unit
