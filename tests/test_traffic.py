"""Frames counted by identifier: rows as plain sets have them, gaps as NumPy's quantiles."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from aces_bus.frame_table import NO_TIME
from aces_bus.traffic import ArrivalCount, rows_of_each


@given(st.lists(st.sampled_from([0, 1, 7, 0x7FF, 1 << 31, 1 << 40 | 7]), max_size=40))
def test_each_value_has_its_rows_in_order(values: list[int]) -> None:
    """Those of the lowest value first, whatever their size."""
    rows = rows_of_each(np.array(values, np.uint64))
    assert [one.tolist() for one in rows] == [
        [row for row, value in enumerate(values) if value == one] for one in sorted(set(values))
    ]


def test_what_has_no_time_and_what_is_another_window_has_no_gap() -> None:
    """And frames of one instant have none."""
    count = ArrivalCount()
    follows = count.arrive(np.array([5, 5, NO_TIME, 9]), np.array([0, 0, 0, 0]))
    assert follows.tolist() == [False, True, True, True]
    assert count.gaps.count == 0
    assert count.arrive(np.array([19, 29]), np.array([0, 1])).tolist() == [True, False]
    assert (count.gaps.count, count.frames) == (1, 6)
    alone = ArrivalCount()
    assert alone.arrive(np.array([1, 2])).tolist() == [False, True]
    assert alone.arrive(np.array([3])).tolist() == [True]
