"""Frames counted by identifier: rows as plain sets have them, gaps as NumPy's quantiles."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from aces_bus.frame_table import NO_TIME
from aces_tools.reading.traffic import EXACT, ArrivalCount, FrameCount, GapCounts, rows_of_each


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


@pytest.mark.parametrize("number", [2, EXACT, EXACT + 1, 5 * EXACT])
def test_quantiles_are_those_of_numpy(number: int) -> None:
    """Exact while gaps are kept as they are, within a bin of 2 % beyond, however they are cut."""
    gaps = np.random.default_rng(number).integers(5_000_000, 20_000_000, number)
    shares = (0.1, 0.5, 0.9)
    expected = np.quantile(gaps, shares)
    for cut in (1 + number // 3, number):
        counts = GapCounts()
        for start in range(0, number, cut):
            counts.add(gaps[start : start + cut])
        assert counts.quantiles_ns(shares) == pytest.approx(expected, rel=1e-12 if number <= EXACT else 0.02)
    every = GapCounts(exact=number)
    every.add(gaps)
    assert every.quantiles_ns(shares) == pytest.approx(expected, rel=1e-12)


def test_a_period_is_exact_however_long() -> None:
    """A bin knows its mean."""
    number = 3 * EXACT
    count = FrameCount()
    count.count(np.arange(number) * 10_000_000, np.full(number, 8))
    assert count.period_ms == 10.0
    assert (count.frames, count.lengths_seen) == (number, (8,))
