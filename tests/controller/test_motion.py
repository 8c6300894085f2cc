"""Trajectories as tables and as files: all formats of the originals, and whatever else may lie on a disk."""

from __future__ import annotations

import io
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from aces_bus.controller import Trajectory, read_trajectory
from aces_bus.controller.motion import Interpolation
from aces_bus.errors import CallerError
from aces_devices.kinematics.minihubo import read_walk, walk_columns

HEADED = ["100hz", "50hz", "fivedeg", "zero", "handwave_100hz_deg"]
FILES = [*(f"trajectory/{name}.txt" for name in HEADED), "trajectory/testscript.scp"]
WALKS = ["walk21/IKscript1.txt", "walk22/02_50_HA13.txt", "walk22/test9.txt"]
numbers = st.floats(-100, 100)
tables = st.lists(st.tuples(numbers, numbers), min_size=1, max_size=12)


def read(text: str | bytes, **options: Any) -> Trajectory:
    """From memory, at 10 Hz unless said otherwise."""
    data = text.encode() if isinstance(text, str) else text
    merged: dict[str, Any] = {"rate_hz": 10, **options}
    return read_trajectory(io.BytesIO(data), **merged)


# ---- files ------------------------------------------------------------------------------------------------------------


@pytest.mark.shared
@pytest.mark.parametrize("name", [*FILES, *WALKS])
def test_every_recorded_file_gives_what_is_in_it(shared_captures: Path, name: str) -> None:
    """Names, rows, first and last row, extremes and sums of every column, whatever line ends and blanks."""
    known = json.loads((shared_captures / "expected.json").read_text(encoding="utf-8"))[name]["table"]
    path = shared_captures / name
    table = read_trajectory(
        path, rate_hz=50, columns=None if known["header"] else lambda n: [f"c{i}" for i in range(n)]
    )
    assert table.rows.shape == (known["rows"], known["columns"])
    if known["header"]:
        assert list(table.names) == known["header"]
    assert table.rows[0].tolist() == known["first_row"]
    assert table.rows[-1].tolist() == known["last_row"]
    for found, expected in (
        (table.rows.min(axis=0), known["col_min"]),
        (table.rows.max(axis=0), known["col_max"]),
        (table.rows.sum(axis=0), known["col_sum"]),
        (np.abs(np.diff(table.rows, axis=0)).max(axis=0), known["max_abs_step"]),
    ):
        assert np.allclose(found, expected, atol=1e-6)


@pytest.mark.shared
def test_walks_have_the_robots_names(shared_captures: Path) -> None:
    """22 columns are 21 joints and one that is passed over; rate and names come from the robot."""
    walk = read_walk(shared_captures / WALKS[1])
    assert (len(walk), len(walk.names), walk.rate_hz) == (1311, 21, 50.0)
    assert walk.names[-1] == "REP"
    assert "" not in walk.names
    assert walk.source == "02_50_HA13.txt"
    legs = read_trajectory(shared_captures / WALKS[2], rate_hz=50, columns=walk_columns(13))
    assert legs.names == tuple(walk_columns(13))


@pytest.mark.parametrize(
    "text",
    [
        "A B\n1 2\n3 4\n",
        "A B \r\n1 2 \r\n3 4 \r\n",
        "\n\nA\tB\n\n 1  2\n3 4",
        "\ufeffA B\n1.0 2e0\n+3. 4",
        "A B\n1 2\n3 4\n\n\n",
    ],
)
def test_line_ends_blanks_and_a_last_row_without_an_end(text: str) -> None:
    """All the same table."""
    table = read(text)
    assert table.names == ("A", "B")
    assert table.rows.tolist() == [[1, 2], [3, 4]]


# ---- tables -----------------------------------------------------------------------------------------------------------


@given(tables, st.sampled_from(["hold", "linear", "cubic"]))
def test_rows_are_met_exactly(rows: Sequence[tuple[float, float]], how: Interpolation) -> None:
    """At the instant of a row, and up to some ns beside it, its numbers to the last bit; outside it stands still."""
    table = Trajectory("AB", rows, rate_hz=50, interpolation=how)
    for n, row in enumerate(rows):
        assert table.at(n / 50) == list(row)
        assert table.at(n / 50 + 1e-9) == list(row)
    assert table.at(math.nan) == list(rows[0])
    assert (table.at(-1), table.at(math.inf)) == (list(rows[0]), list(rows[-1]))


@given(st.floats(0, 1))
def test_between_rows(part: float) -> None:
    """Hold keeps the last row, linear is a line, cubic is exact for a parabola away from the ends."""
    line = Trajectory("A", [[0.0], [2.0], [4.0], [6.0]], rate_hz=1)
    parabola = Trajectory("A", [[0.0], [1.0], [4.0], [9.0]], rate_hz=1, interpolation="cubic")
    x = 1 + part
    assert line.at(x)[0] == pytest.approx(2 * x)
    assert line.interpolated("cubic").at(x)[0] == pytest.approx(2 * x)
    assert parabola.at(x)[0] == pytest.approx(x * x, abs=1e-4)
    if 1e-4 < part < 1 - 1e-4:
        assert parabola.interpolated("hold").at(x) == [1.0]


def test_cubic_slopes_at_the_ends() -> None:
    """In the first and last interval the slope at the end is that of one row, inside that of two: worked by hand."""
    table = Trajectory(["a"], [[0.0], [1.0], [4.0], [0.0]], rate_hz=1, interpolation="cubic")
    # value at u = 1/2: (b + c) / 2 + (slope at b - slope at c) / 8
    assert table.at(0.5) == [0.5 + (1.0 - 2.0) / 8]
    assert table.at(1.5) == [2.5 + (2.0 - -0.5) / 8]
    assert table.at(2.5) == [2.0 + (-0.5 - -4.0) / 8]


def test_cubic_has_no_corners() -> None:
    """The velocity before a row is that after it, also at the second and the last but one."""
    table = Trajectory("A", [[0.0], [1.0], [0.5], [2.0], [2.0]], rate_hz=1, interpolation="cubic")
    for n in (1, 2, 3):
        before, here, after = (table.at(n + d)[0] for d in (-1e-3, 0.0, 1e-3))
        assert here - before == pytest.approx(after - here, abs=1e-4)


@pytest.mark.parametrize(
    ("names", "rows", "rate", "message"),
    [
        ("A", [[1.0, 2.0]], 10, "1 names need rows"),
        ("A", np.zeros((0, 1)), 10, "need rows"),
        ("AA", [[1.0, 2.0]], 10, "named twice"),
        ("A", [[1.0], [math.nan]], 10, "row 2 of A is not finite"),
        ("A", [[1.0]], 0, "not a rate"),
        ("A", [[1.0]], math.nan, "not a rate"),
    ],
)
def test_a_table_is_valid_or_not_made(names: str, rows: Any, rate: float, message: str) -> None:
    """Shape, names, numbers and rate."""
    with pytest.raises(CallerError, match=message):
        Trajectory(names, rows, rate_hz=rate)
