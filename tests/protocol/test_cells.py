"""Cells of tables that hold what has no column of its own, and booleans with gaps."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from aces_bus.protocol.columns.arrow import (
    _series,  # pyright: ignore[reportPrivateUsage]  # no protocol has a switch that is absent in some frames
)
from aces_bus.protocol.columns.layout import Labels, plain_json


@pytest.mark.parametrize(
    ("value", "found"),
    [
        (None, None),
        (True, True),
        (False, False),
        (0.1, 0.1),
        (-1, -1),
        ((1 << 64) - 1, (1 << 64) - 1),
        (1 << 64, "18446744073709551616"),
        (-(1 << 63), -(1 << 63)),
        (-(1 << 63) - 1, "-9223372036854775809"),
        (b"\x01\xff", "01ff"),
        (bytearray(b"\x02"), "02"),
        ("text", "text"),
        ({"a": (1, None, True), 2: [0.5]}, {"a": [1, None, True], "2": [0.5]}),
    ],
)
def test_a_value_of_any_shape_has_its_json(value: Any, found: Any) -> None:
    """Nothing, switches and floats stay what they are, bytes become digits, and what JSON's numbers do not hold a text."""
    made = plain_json(value)
    assert (made, type(made)) == (found, type(found))


def test_booleans_with_gaps_stay_booleans_in_pandas() -> None:
    """A switch that is absent in some rows is pandas' own boolean there, and a number its own integer."""
    pandas = pytest.importorskip("pandas")
    absent = np.array([True, False, False])
    for values, kind in (
        (np.array([True, True, False]), "boolean"),
        (np.array([0, 1, 0], np.uint8), "UInt8"),
    ):
        piece: Any = (values, absent)
        slot: Any = SimpleNamespace(holds="value", kind=None)
        made = _series(pandas, slot, piece, Labels([]), absolute=False, names=False)
        assert str(made.dtype) == kind
        assert [None if one is pandas.NA else int(one) for one in made] == [None, 1, 0]
