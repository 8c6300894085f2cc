# pyright: reportPrivateUsage=false
"""Guards, logs and motions, in parts that only the floor itself calls."""

from __future__ import annotations

import math
import os
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from aces_bus import load_robot
from aces_bus.controller import (
    Bounds,
    ControlEvent,
    Guard,
    Trajectory,
    bounds_of,
    read_trajectory,
)
from aces_bus.controller.limiter import (
    NOT_FINITE_TRIPS,
    USUAL_SPEED,
    _reach,  # pyright: ignore[reportPrivateUsage]  # its far end is out of any guard's reach
)
from aces_bus.controller.log import Logger, logger, read_log, recover
from aces_bus.controller.log.base import About, LogSink, Row
from aces_bus.controller.log.columns import LogColumn, parse_column
from aces_bus.controller.log.formats import log_format, open_sink
from aces_bus.controller.motion import sampled, smooth_step
from aces_bus.controller.motion_file import TrajectoryError
from aces_bus.errors import CallerError, UnknownNameError
from aces_bus.runtime import RealClock, VirtualClock
from tests.controller.test_log_real import of_60_kb as of_60_kb
from tests.controller.test_motion import read as read

MS = 1_000_000
SUFFIXES = ["txt", "csv", "db", "parquet", "mcap"]
every_format = pytest.mark.parametrize("suffix", SUFFIXES)


def test_a_distance_without_bound_is_no_division_by_zero() -> None:
    """What is 10¹² quanta away is as good as infinitely far: any step may be taken; nothing is, behind the limit."""
    assert _reach(1e9, 1e-7) == math.inf
    assert _reach(0.0, 1e-7) == _reach(-1.0, 1e-7) == 0.0
    assert _reach(0.5, 1.0) == 0.5  # less than one quantum: all of it
    assert _reach(3.0, 1.0) == 2.0  # 2 + 1


def test_five_in_a_row_that_are_not_finite_trip() -> None:
    """At the fifth, at once, whatever other states get; and they alone feed no dead-man."""
    guard = Guard({"A": Bounds(), "B": Bounds()}, period_s=0.01, action="disable")
    out = [guard.apply(n * 10 * MS, {"A": math.nan, "B": 1.0}) for n in range(NOT_FINITE_TRIPS)]
    assert out == [{"B": 1.0}] * 4 + [{}]
    assert guard.tripped is not None
    assert (guard.tripped.action, guard.tripped.reason) == (
        "disable",
        "A: 5 set-points in a row were not finite numbers",
    )
    fed = Guard({name: Bounds() for name in "ABCDEFGH"}, period_s=0.01, dead_man_s=0.05)
    for n in range(7):
        fed.apply(n * 10 * MS, {"ABCDEFGH"[n]: math.inf})
    assert fed.tick(70 * MS) == {}
    assert fed.tripped is not None
    assert fed.tripped.reason == "no set-points for 70 ms"


def test_bounds_of_a_robot() -> None:
    """Limits as the file states them; where it states no speed, a joint is led as no file has to say."""
    robot = load_robot("hubo2plus")
    bounds = bounds_of(robot)
    knee = robot.joint("LKP")
    assert set(bounds) == {joint.name for joint in robot.joints.values() if joint.active}
    assert (bounds[knee.name].lower, bounds[knee.name].upper) == (knee.lower, knee.upper)
    assert (bounds[knee.name].rate, bounds[knee.name].acceleration) == (knee.max_speed, math.inf)
    gentle = bounds_of(robot, nominal=True, acceleration=True)[knee.name]
    assert (gentle.rate, gentle.acceleration) == (knee.nominal_speed, knee.nominal_acceleration)
    assert bounds_of(load_robot("hubo2"))["LW1"] == Bounds(rate=USUAL_SPEED["rad"])
    rail = replace(knee, max_speed=None, nominal_speed=None, type="prismatic")
    assert bounds_of(replace(robot, joints={rail.name: rail}))[rail.name].rate == USUAL_SPEED["m"]


@given(
    st.lists(
        st.tuples(
            st.integers(0, 10**15),
            st.lists(st.floats(allow_infinity=False), min_size=2, max_size=2),
        ),
        max_size=30,
    )
)
@every_format
def test_any_number_survives(
    tmp_path_factory: pytest.TempPathFactory, suffix: str, rows: list[tuple[int, list[float]]]
) -> None:
    """Every float and instant comes back bit for bit, from every format; names may be anything printable."""
    path = str(tmp_path_factory.mktemp("any") / f"a.{suffix}")
    about = About((LogColumn("Ä,b.x"), LogColumn('q"(x', "rate", "rad/s")))
    sink = open_sink(path, log_format(path), about)
    for row in rows:
        sink.append([row])
    sink.close()
    log = read_log(path)
    assert log.names == about.names
    assert log.time_s.tolist() == [ns / 1e9 for ns, _ in rows]
    given_values = np.array([values for _, values in rows]).reshape(-1, 2)
    assert np.array_equal(log.values, given_values, equal_nan=True)
    known = ~np.isnan(given_values)
    if suffix != "db":  # SQLite keeps -0.0 as 0
        assert (np.signbit(log.values) == np.signbit(given_values))[known].all()


def test_columns_are_read_of_their_names() -> None:
    """An attribute stands in brackets; without one, and for an unknown word in a quantity's own name, it is the value."""
    assert parse_column("RHY") == LogColumn("RHY")
    assert parse_column("RHY.velocity(AGE)") == LogColumn("RHY.velocity", "age")
    assert parse_column("d(hip)/dt").name == "d(hip)/dt"
    assert parse_column("d(hip)/dt(diff)").original == "d(hip)/dt(diff)"


def test_what_was_never_closed_is_recovered(tmp_path: Path) -> None:
    """A journal that stands alone is read in place of its Parquet file, and becomes one."""
    pytest.importorskip("pyarrow")
    path = tmp_path / "a.parquet"
    sink = open_sink(str(path), "parquet", About((LogColumn("X", unit="m"),)))
    sink.append([(0, [1.0]), (5 * MS, [math.nan])])
    log = read_log(path)
    assert len(log) == 2
    assert "was not closed" in log.notes[0]
    assert recover(path) == 2
    log = read_log(path)
    assert (log.notes, log.units) == ([], {"X": "m"})
    with pytest.raises(CallerError, match=r"no a\.parquet\.journal"):
        recover(path)


class Slow(LogSink):
    """A disk that takes its time: until `goes` is set nothing is written. `asked` is set when it was asked to."""

    format = "slow"
    goes = threading.Event()
    rows: list[Row]

    def __init__(self, path: str, about: About) -> None:
        super().__init__(path, about)
        self.rows = []
        self.asked = threading.Event()

    def append(self, rows: Sequence[Row]) -> None:
        self.asked.set()
        assert self.goes.wait(60)
        self.rows += rows

    def close(self) -> None:
        pass


def test_a_slow_disk_never_holds_control_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """While a disk does not answer, steps return at once; what does not fit is dropped, counted and told once."""
    made: list[Slow] = []

    def open_slow(path: str, format: str, about: About, digits: int | None) -> Slow:
        made.append(Slow(path, about))
        return made[0]

    monkeypatch.setattr(logger, "open_sink", open_slow)
    monkeypatch.setattr(logger, "KEPT_S", 0.01)
    Slow.goes.clear()
    told: list[ControlEvent] = []
    log = Logger(tmp_path / "a.csv", ["X"], rate_hz=100, queue_s=1.0)
    log.listeners.add(told.append)
    log.bind({"X": [1.0]})
    log.start(RealClock().now())
    log.step(0)
    assert made[0].asked.wait(60)  # the writer takes nothing out of the queue any more
    for i in range(1, 10_000):
        log.step(i * 10 * MS)
    assert made[0].rows == []  # the disk has not answered once: no step waited for it
    assert log.dropped >= 10_000 - 2 * log.capacity
    assert [event.kind for event in told] == ["log-dropped"]
    assert told[0].source == "log a.csv"
    Slow.goes.set()
    log.stop(0)
    assert log.written == len(made[0].rows)
    assert log.written + log.dropped == 10_000
    assert f"{log.dropped} dropped" in told[-1].detail
    assert threading.active_count() == 1 or not any(t.name == log.name for t in threading.enumerate())


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("is_real", [False, True])
def test_a_full_disk_is_told_once_and_nothing_stops(
    tmp_path: Path, small_disk: int, suffix: str, is_real: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Steps go on, one event says which file and why, every row is written or counted, and what is there reads back."""
    if suffix == "parquet":
        pytest.importorskip("pyarrow")
    monkeypatch.setattr(logger, "KEPT_S", 0.01)
    path = tmp_path / f"a.{suffix}"
    value = [0.0]
    clock: Any = RealClock() if is_real else VirtualClock()
    log = Logger(path, [f"X{i}" for i in range(40)], rate_hz=100, clock=clock, queue_s=30)
    log.bind({f"X{i}": value for i in range(40)})
    log.start(clock.now())
    for i in range(1000):
        value[0] = i / 7
        log.step(i * 10 * MS)
        if is_real and i % 100 == 99:
            wait_until_idle(log)
    log.stop(clock.now())
    failures = [event for event in log.events if "log-failed" in event.kind]
    # One while it ran; formats with an index at the end say that there is none, too.
    assert len(failures) <= 2
    assert str(path) in failures[0].detail
    assert log.dropped == 0
    assert log.lost > 0
    assert log.written + log.lost == 1000
    assert log.failure
    found = read_log(path)
    # A smaller piece may fit where a larger did not: what is there is whole rows in order, with gaps.
    rows = found["X3"].tolist()
    assert len(rows) == log.written
    assert rows == sorted({i / 7 for i in range(1000)} & set(rows))
    assert all(os.path.getsize(one) <= small_disk for one in tmp_path.iterdir())


def wait_until_idle(log: Logger) -> None:
    """Until the writer has taken all that waits."""
    end = time.monotonic() + 5
    while log._queue and time.monotonic() < end:
        threading.Event().wait(0.002)


@pytest.mark.shared
def test_degrees_and_rates_in_names(shared_captures: Path) -> None:
    """The hand wave is in degrees, at the rate its name says; the test script's name says none."""
    wave = read_trajectory(shared_captures / "trajectory/handwave_100hz_deg.txt", unit="deg")
    assert wave.rate_hz == 100.0
    assert wave.rows[0, 1] == pytest.approx(math.radians(-21.101257))
    with pytest.raises(TrajectoryError, match="give rate_hz"):
        read_trajectory(shared_captures / "trajectory/testscript.scp")


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


def test_the_smooth_step_has_no_corners() -> None:
    """0 to 1, still at both ends, symmetric."""
    assert [smooth_step(u) for u in (-1, 0, 0.5, 1, 2)] == [0, 0, 0.5, 1, 1]
    assert smooth_step(1e-3) < 1e-8
