"""The number that a construct reads off the wire: its kind, size, byte order and limits."""

from __future__ import annotations

import numbers
from typing import Any, Literal, NamedTuple

from construct import Adapter, BytesInteger, Construct, FormatField, Subconstruct


def plain_number(value: Any) -> Any:
    """Return a number of any kind (NumPy's, a fraction) as Python's int or float; None for what is none."""
    if isinstance(value, (int, float)):
        return value
    if isinstance(value, numbers.Integral):
        return int(value)
    return float(value) if isinstance(value, numbers.Real) else None


def innermost(subcon: Construct) -> Construct:
    """Return the construct that touches the bytes, below all names and adapters."""
    while hasattr(subcon, "subcon"):
        subcon = subcon.subcon
    return subcon


class WireNumber(NamedTuple):
    """What a number is on the wire; `size` in bytes."""

    kind: Literal["uint", "int", "float"]
    size: int
    order: Literal["little", "big"]

    @property
    def limits(self) -> tuple[int, int]:
        """The least and the greatest integer of this size."""
        top = 1 << 8 * self.size - 1
        return (-top, top - 1) if self.kind == "int" else (0, 2 * top - 1)


def wire_number(inner: Any) -> WireNumber | None:
    """Return what number an innermost construct reads; None where it is none, or of a size that is not fixed."""
    if isinstance(inner, FormatField) and inner.fmtstr[-1:] in "efdBbHhLlQq":
        mark = inner.fmtstr[-1:]
        order: Literal["little", "big"] = "little" if inner.fmtstr.startswith("<") else "big"
        return WireNumber(
            "float" if mark in "efd" else "int" if mark.islower() else "uint", inner.length, order
        )
    if isinstance(inner, BytesInteger) and isinstance(inner.length, int) and isinstance(inner.swapped, bool):
        return WireNumber(
            "int" if inner.signed else "uint", inner.length, "little" if inner.swapped else "big"
        )
    return None


def is_float(subcon: Construct) -> bool:
    inner = innermost(subcon)
    fmt = getattr(inner, "fmtstr", "")
    return fmt[-1:] in ("e", "f", "d") or bool(getattr(inner, "is_float", False))


def integer_width(subcon: Construct) -> int:
    """Width in bits of an integer construct."""
    inner = innermost(subcon)
    width = getattr(inner, "width", None)
    return width if isinstance(width, int) else int(inner.sizeof()) * 8


def raw_limits(con: Any) -> tuple[int, int] | None:
    """Return the least and the greatest number that a construct gives; None where it is no integer of fixed size."""
    while isinstance(con, Subconstruct) and not isinstance(con, Adapter):
        con = con.subcon
    wire = wire_number(con)
    if wire is not None:
        return wire.limits if wire.kind != "float" else None
    found: tuple[int, int] | None = getattr(con, "raw_limits", None)
    return found
