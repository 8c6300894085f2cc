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
from aces_bus.controller.motion import Interpolation, sampled, smooth_step
from aces_bus.controller.motion_file import TrajectoryError
from aces_bus.errors import CallerError, UnknownNameError
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


@pytest.mark.shared
def test_degrees_and_rates_in_names(shared_captures: Path) -> None:
    """The hand wave is in degrees, at the rate its name says; the test script's name says none."""
    wave = read_trajectory(shared_captures / "trajectory/handwave_100hz_deg.txt", unit="deg")
    assert wave.rate_hz == 100.0
    assert wave.rows[0, 1] == pytest.approx(math.radians(-21.101257))
    with pytest.raises(TrajectoryError, match="give rate_hz"):
        read_trajectory(shared_captures / "trajectory/testscript.scp")


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


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "empty"),
        ("\n \r\n", "empty"),
        ("A B\n", "no row of numbers"),
        ("A B\n1 2\n3\n", ":3: 1 numbers where the lines before have 2"),
        ("A B\n1 2 3\n", ":2: 3 numbers"),
        ("A B\n1 2\n3 x\n", ":3: column 2: 'x' is not a number"),
        ("A B\n1 nan\n", ":2: column 2: 'nan' is not a number"),
        ("A B\n1 inf\n", "'inf' is not a number"),
        ("A B\n1 1e999\n", "'1e999' is not a number"),
        ("A B\n1 1_0\n", "'1_0' is not a number"),
        ("A B\n1,5 2\n", "'1,5' is not a number"),
        ("A 1\n1 2\n", ":1: names and numbers in one line: 'A 1'"),
        ("A A\n1 2\n", ":1: A named twice"),
        ("1 2\n3 4\n", "2 columns without names"),
        (b"\xff\xfe\x00\n1 2\n", "text file"),
        (b"A\x01 B\n1 2\n", "text file"),
        ("A\n" + "1" * 40_000, ":2: more than 32768 characters"),
        (" ".join("1" for _ in range(1001)), "more than 1000 columns"),
    ],
)
def test_a_file_that_is_none_says_where_and_why(text: str | bytes, message: str) -> None:
    """File, line, and what stands there."""
    with pytest.raises(TrajectoryError, match=message):
        read(text)


def test_names_for_columns() -> None:
    """Given ones name a file without; "" passes over, the rest is passed over, too many are refused."""
    assert read("1 2 3\n4 5 6\n", columns=["A", "", "C"]).rows.tolist() == [[1, 3], [4, 6]]
    assert read("1 2 3\n", columns=["A"]).names == ("A",)
    assert read("X Y\n1 2\n", columns=["A", "B"]).names == ("A", "B")
    for columns, message in ((["A", "B", "C"], "3 names for 2"), (["", ""], "none of its 2")):
        with pytest.raises(TrajectoryError, match=message):
            read("1 2\n", columns=columns)


def test_what_is_too_large_or_absent_is_an_error() -> None:
    """More numbers than may be, a file that is not there, a folder, a unit that is none."""
    with pytest.raises(TrajectoryError, match=":2: more than 3 numbers"):
        read("1 2\n1 2\n1 2\n", columns=["A", "B"], most_numbers=3)
    with pytest.raises(TrajectoryError, match="No such file"):
        read_trajectory("absent.txt", rate_hz=10)
    with pytest.raises(TrajectoryError, match="tests: "):
        read_trajectory("tests", rate_hz=10)
    with pytest.raises(CallerError, match="'rad' or 'deg'"):
        read("A\n1\n", unit="grad")


@given(st.binary(max_size=200))
def test_no_bytes_do_anything_but_read_or_complain(data: bytes) -> None:
    """A trajectory or a TrajectoryError, whatever is in the file."""
    try:
        table = read(data, columns=lambda n: [f"c{i}" for i in range(n)])
    except TrajectoryError:
        return
    assert np.isfinite(table.rows).all()


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


def test_tables_of_a_table() -> None:
    """Renamed, chosen, scaled, shifted, mirrored, resampled; each a new one."""
    table = Trajectory(["LKP", "RKP", "HY"], [[0.0, 1.0, 2.0], [1.0, 3.0, 4.0]], rate_hz=10)
    assert table.renamed({"HY": "WST", "LEB": "LEP"}).names == ("LKP", "RKP", "WST")
    assert table.only(["HY", "LKP"]).rows.tolist() == [[2, 0], [4, 1]]
    assert table.without(["HY"]).names == ("LKP", "RKP")
    assert table.scaled({"HY": -1}).rows[1].tolist() == [1, 3, -4]
    assert table.shifted({"HY": 0.5}).rows[1].tolist() == [1, 3, 4.5]
    other = table.mirrored({"LKP": "RKP"}, ["HY"])
    assert dict(zip(other.names, other.rows[1].tolist(), strict=True)) == {"RKP": 1, "LKP": 3, "HY": -4}
    assert table.resampled(20).rows[:, 0].tolist() == [0, 0.5, 1]
    assert sampled(table, 40).rows[:, 0].tolist() == [0, 0.25, 0.5, 0.75, 1]
    assert table.rates()[0].tolist() == [10, 20, 20]
    with pytest.raises(UnknownNameError, match="there are: HY, LKP, RKP"):
        table.only(["X"])
    for change in (table.scaled, table.shifted):
        with pytest.raises(UnknownNameError, match="there are: HY, LKP, RKP"):
            change({"X": 1.0})
    with pytest.raises(ValueError, match="read-only"):
        table.rows[0, 0] = 1.0


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


def test_the_smooth_step_has_no_corners() -> None:
    """0 to 1, still at both ends, symmetric."""
    assert [smooth_step(u) for u in (-1, 0, 0.5, 1, 2)] == [0, 0, 0.5, 1, 1]
    assert smooth_step(1e-3) < 1e-8
