"""Bounds and ranges at their edges: identifiers too many to list, bounds of which one is infinite, sizes that cannot be."""

from __future__ import annotations

import math
from typing import Any

import pytest
from construct import Byte, Int16sl, Struct

from aces_bus.errors import FieldError, SpecError
from aces_bus.protocol import BitLayout, Protocol, Quantity, bits


@pytest.mark.parametrize(
    ("bounds", "sent", "refused"),
    [((-math.inf, 5), (-3.0, 2.5), 4.0), ((5, math.inf), (2.5, 900.0), -3.0), ((5, 7), (2.5, 3.5), 4.0)],
)
def test_a_bound_holds_where_the_other_is_infinite(
    bounds: tuple[int, int], sent: tuple[float, ...], refused: float
) -> None:
    """The encoder, its printed functions and a device's writer refuse what is beyond the one bound that there is."""
    spec = Protocol("bounded", link="can")
    field = Quantity(Int16sl, unit="V", scale=0.5, raw_range=bounds)
    message = spec.message("M", id=1, payload=Struct("a" / field, "b" / Byte))
    write: Any = spec.variant().encoder.writer(message, {})
    for value in sent:
        assert spec.encode("M", a=value, b=0).data == write({"a": value, "b": 0}).data
    with pytest.raises(FieldError, match="outside"):
        spec.encode("M", a=refused, b=0)
    with pytest.raises(FieldError, match="outside"):
        write({"a": refused, "b": 0})


@pytest.mark.parametrize("size", [-1, 4_097])
def test_a_layout_of_a_size_that_cannot_be_is_refused(size: int) -> None:
    """A BitLayout has 0 to 4096 bytes; the error has its line."""
    with pytest.raises(SpecError, match=rf"test_ranges\.py:\d+: a BitLayout has 0 to 4096 bytes, not {size}"):
        BitLayout(size)
    assert BitLayout(4_096, "a" / bits(8)).size == 4_096
