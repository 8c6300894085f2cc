"""Bounds and ranges at their edges: identifiers too many to list, bounds of which one is infinite, sizes that cannot be."""

from __future__ import annotations

import math
from typing import Any

import pytest
from construct import Byte, Int16sl, Struct

from aces_bus import Frame, Unknown
from aces_bus.errors import FieldError, SpecError
from aces_bus.protocol import BitLayout, IdField, Protocol, Quantity, bits
from aces_bus.protocol.plan.flatten import _numbers  # pyright: ignore[reportPrivateUsage]  # a plan of a stream's head
from aces_bus.testing import Scene
from tests.laws.drawn import ORACLE


def test_a_long_range_of_shifted_identifiers_is_met_exactly() -> None:
    """Of 5,000 identifiers, 32 apart, each is the message's, and none between, before or behind them is."""
    spec = Protocol("wide", link="can")
    node = IdField("node", range(0, 10_000, 2))
    message = spec.message("M", id=(node << 4) | 5, extended=True, payload=Struct("a" / Byte))
    numbers: Any = _numbers(message.identifier)
    assert numbers == range(5, 9_998 * 16 + 6, 32)
    assert [*numbers] == sorted(message.identifier)
    scanner = spec.scanner(include_unknown=True)
    for identifier, found in (
        *((5, 0), (5 | 2 << 4, 2), (5 | 5_000 << 4, 5_000), (5 | 9_998 << 4, 9_998)),
        *((5 | 1 << 4, None), (5 | 10_000 << 4, None), (4, None), (6 | 2 << 4, None), (0, None)),
    ):
        frame = Frame(identifier, b"\1", is_extended_id=True)
        (item,) = scanner.feed([frame])
        assert (None if isinstance(item, Unknown) else item.node) == found, hex(identifier)
        ORACLE(spec.variant(), None, Scene((frame,)))


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
