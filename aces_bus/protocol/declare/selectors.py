"""What fields are multiplexed by.

1. A multiplexed field goes by the raw number of its selector. In a `BitLayout` that is at hand; a `Struct` knows its
   fields only as records show them, so that there the two must be one.
"""

from __future__ import annotations

import construct as c

from ...errors import SpecError
from .fields import Field, Multiplexed, Quantity, SignMagnitude
from .place import SourceLine


def check_selectors(con: c.Construct, place: SourceLine, path: str = "payload") -> None:
    """Raise `SpecError` for a `Multiplexed` that is no field of its own, or goes by what is not the raw number."""
    if isinstance(con, Multiplexed):
        raise SpecError(f"{con.place}: {path}: Multiplexed makes a named field of a Struct or BitLayout")
    if isinstance(con, c.Struct):
        by_name = {item.name: item for item in con.subcons if item.name}
        for item in con.subcons:
            body = item.subcon if isinstance(item, c.Renamed) else item
            if isinstance(body, Multiplexed):
                _check(by_name[body.selector], body.selector, place)
                body = body.body
            check_selectors(body, place, f"{path}.{item.name}" if item.name else path)
        return
    inside = [con.thensubcon, con.elsesubcon] if isinstance(con, c.IfThenElse) else []
    if isinstance(con, c.Switch):
        inside = [*con.cases.values(), con.default]
    elif isinstance(con, (c.Sequence, c.FocusedSeq)):
        inside = list(con.subcons)
    elif isinstance(con, c.Subconstruct):
        inside = [con.subcon]
    for one in inside:
        check_selectors(one, place, path)


def _check(field: c.Construct, name: str, place: SourceLine) -> None:
    while isinstance(field, (c.Renamed, c.Default, Field)):
        if isinstance(field, SignMagnitude) or (
            isinstance(field, Quantity) and (field.scale != 1 or field.offset or field.unknown or field.names)
        ):
            raise SpecError(
                f"{place.of_field(name)}: selector {name!r} is a {type(field).__name__}; a field of a Struct is"
                " multiplexed by a plain number, an Enumeration or Flags"
            )
        field = field.subcon


__all__ = ["check_selectors"]
