"""Cells of tables that hold what has no column of its own, and booleans with gaps."""

from __future__ import annotations

from typing import Any

import pytest

from aces_bus.protocol.columns.layout import plain_json


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
