"""Logs in virtual time: what is sampled is what is read back, in every format, the same for the same run."""

from __future__ import annotations

import json
import math
import sqlite3
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from aces_bus.controller import controller
from aces_bus.controller.log import Logger, read_log, recover
from aces_bus.controller.log.base import Log, LogError
from aces_bus.errors import CallerError, UnknownNameError
from aces_bus.robot import run_virtual
from aces_bus.runtime import RealClock, VirtualClock
from aces_bus.state import State
from tests.device.fan import ROBOT, drivers, robot_of

MS = 1_000_000
SUFFIXES = ["txt", "csv", "db", "parquet", "mcap"]
COLUMNS = ["hip", "hip(rate)", "hip(integral)", "hip(setpoint)", "hip(age)", "power"]
every_format = pytest.mark.parametrize("suffix", SUFFIXES)


@pytest.fixture(autouse=True)
def _libraries(request: pytest.FixtureRequest) -> None:
    """Parquet needs its library; the other formats need nothing."""
    spec: Any = getattr(request.node, "callspec", None)
    if spec is not None and spec.params.get("suffix") == "parquet":
        pytest.importorskip("pyarrow")


def swing(path: Path, seconds: float = 3.0, **options: Any) -> Logger:
    """A hip that swings, is sampled at a third of the log's rate, and falls silent."""
    clock = VirtualClock(1_000_000_000)
    hip = State("hip", unit="rad", clock=clock, sampled=False, stale_after_s=0.5)
    load = State("load", unit="N", clock=clock)
    logger = Logger(path, [*COLUMNS[:-1], (hip * load).named("power")], rate_hz=100, **options)
    logger.bind({"hip": hip})
    logger.start(clock.now())
    for i in range(round(100 * seconds)):
        logger.step(clock.now())
        if i % 3 == 0 and i < 200:
            hip.set(math.sin(i / 10))
        if i == 50:
            load.push(2.0, clock.now())
        clock.advance(10 * MS)
    logger.stop(clock.now())
    assert not logger.events
    assert logger.written == round(100 * seconds)
    return logger


@every_format
def test_a_log_reads_back_as_it_was_sampled(tmp_path: Path, suffix: str) -> None:
    """Time, values, derivative, integral, set-point, age and derived quantities come back; unknown is NaN."""
    path = tmp_path / f"swing.{suffix}"
    swing(path)
    log = read_log(path)
    assert log.names == COLUMNS
    assert log.time_s.tolist() == [i / 100 for i in range(300)]
    assert log.notes == []
    hip = log["hip"]
    assert np.isnan(hip[0])
    assert hip[1] == 0
    assert hip[4] == math.sin(0.3)
    assert hip[100] == math.sin(9.9)
    assert np.isnan(hip[270:]).all()  # stale
    assert log["hip(rate)"][4] == pytest.approx(math.sin(0.3) / 0.03)
    assert log["hip(integral)"][4] == pytest.approx(math.sin(0.3) * 0.03 / 2)
    assert log["hip(setpoint)"][-1] == math.sin(19.8)
    assert log["hip(age)"][6] == pytest.approx(0.03)
    assert log["hip(age)"][-1] == pytest.approx(1.01)
    assert np.isnan(log["power"][:51]).all()
    assert log["power"][53] == 2 * hip[53]
    assert [path.name] == [one.name for one in tmp_path.iterdir()]


@every_format
def test_the_same_run_gives_the_same_log(tmp_path: Path, suffix: str) -> None:
    """In virtual time two runs give one log: text, CSV, MCAP and Parquet byte for byte, SQLite by content."""
    contents: list[Any] = []
    for name in ("a", "b"):
        path = tmp_path / f"{name}.{suffix}"
        swing(path, 1.0)
        if suffix == "db":
            with sqlite3.connect(path) as database:
                contents.append(list(database.iterdump()))
            database.close()
        else:
            contents.append(path.read_bytes())
    assert contents[0] == contents[1]


@pytest.mark.parametrize("suffix", ["db", "parquet", "mcap"])
def test_formats_with_a_place_say_what_they_are_about(tmp_path: Path, suffix: str) -> None:
    """Units, robot, rate, clock and start stand in the file where the format has a place for them."""
    path = tmp_path / f"swing.{suffix}"
    swing(path, 0.1, robot="leg")
    log = read_log(path)
    assert log.units["hip(rate)"] == "rad/s"
    assert log.units["power"] == "rad·N"
    assert log.units["hip(age)"] == "s"
    about = log.about
    assert (about.robot, about.rate_hz, about.clock) == ("leg", 100.0, "virtual")
    assert (about.start_ns, about.wall_ns) == (1_000_000_000, None)


def test_the_text_is_the_originals(tmp_path: Path) -> None:
    """The first line is `0 Name(attribute) `, the others seconds and values, each with a blank behind it."""
    path = tmp_path / "swing.txt"
    swing(path, 0.1, digits=6)
    lines = path.read_text().split("\n")
    assert lines[0] == "0 hip(value) hip(diff) hip(integral) hip(setpoint) hip(age) power(value) "
    assert lines[1] == "0 nan nan nan nan nan nan "
    assert lines[5] == "0.04 0.29552 9.85067 0.0044328 0.29552 0.01 nan "
    assert lines[-1] == ""


def test_an_mcap_is_one_for_others_too(tmp_path: Path) -> None:
    """An independent reader finds chunks, checksums, statistics, the schema with units, and every row as JSON."""
    reader = pytest.importorskip("mcap.reader")
    path = tmp_path / "swing.mcap"
    swing(path)
    with path.open("rb") as stream:
        found = reader.make_reader(stream, validate_crcs=True)
        summary = found.get_summary()
        rows = list(found.iter_messages(topics="/states"))
    assert summary.statistics.message_count == 300
    assert summary.statistics.message_start_time == 1_000_000_000
    assert len(summary.chunk_indexes) == 12
    schema, channel, message = rows[4]
    assert json.loads(schema.data)["properties"]["hip"]["unit"] == "rad"
    assert channel.message_encoding == "json"
    assert json.loads(message.data)["hip"] == math.sin(0.3)
    assert json.loads(message.data)["power"] is None
    assert message.log_time == 1_040_000_000


def test_parquet_and_sqlite_are_ones_for_others_too(tmp_path: Path) -> None:
    """pyarrow and sqlite3 read named columns with nulls."""
    pq = pytest.importorskip("pyarrow.parquet")
    swing(tmp_path / "a.parquet", 0.2)
    table = pq.read_table(tmp_path / "a.parquet")
    assert table.column_names == ["time", *COLUMNS]
    assert table["power"].null_count == 20
    assert table.schema.field("hip").metadata[b"unit"] == b"rad"
    swing(tmp_path / "a.db", 0.2)
    database = sqlite3.connect(tmp_path / "a.db")
    assert database.execute('SELECT count(*), count("power"), max(time) FROM log').fetchone() == (20, 0, 0.19)
    assert database.execute("SELECT unit FROM columns WHERE name = 'hip(rate)'").fetchone() == ("rad/s",)
    database.close()


def test_a_logger_runs_beside_a_controller(tmp_path: Path) -> None:
    """A runner takes loggers: the robot's name and units are known by it, and its end closes them."""
    path = tmp_path / "fans.db"
    logger = Logger(path, ["A.left", "A.left(setpoint)", "B.temperature"], rate_hz=50)

    @controller(rate_hz=50, writes=["A.left", "A.right"])
    def spin() -> Mapping[str, float]:
        return {"A.left": 100.0, "A.right": 100.0}

    with run_virtual(robot_of(ROBOT), [spin], loggers=[logger], load=drivers) as run:
        run.run(0.5)
    log = read_log(path)
    assert (log.about.robot, len(log)) == ("fans", logger.written)
    assert log["A.left"][-1] == pytest.approx(100, abs=0.1)
    assert log["A.left(setpoint)"][-1] == 100
    assert log["B.temperature"][-1] == pytest.approx(313.15)
    assert log.units == {"A.left": "rad/s", "A.left(setpoint)": "rad/s", "B.temperature": "K"}


@pytest.mark.shared
@pytest.mark.parametrize("name", ["webots_joints_2010-08-12", "webots_feet", "webots_gps_1", "testsuite_1"])
def test_the_originals_logs_read_back(shared_captures: Path, name: str) -> None:
    """Real logs of the original framework give the rows, extremes and sums that are known of them."""
    known = json.loads((shared_captures / "expected.json").read_text(encoding="utf-8"))
    table = known[f"logs/{name}.txt"]["table"]
    log = read_log(shared_captures / "logs" / f"{name}.txt")
    whole = np.column_stack([log.time_s, log.values])
    assert ["0", *log.names] == table["header"]
    assert whole.shape == (table["rows"], table["columns"])
    assert whole[0].tolist() == table["first_row"]
    assert whole[-1].tolist() == table["last_row"]
    assert whole.min(0).tolist() == table["col_min"]
    assert whole.max(0).tolist() == table["col_max"]
    assert whole.sum(0) == pytest.approx(table["col_sum"], abs=1e-5)


def test_a_name_in_csv_is_no_formula(tmp_path: Path) -> None:
    """A column's name that a spreadsheet would compute is written as text, and read back as the name that it is."""
    names = ("=1+1", "@cmd", "-x", "'quoted", "plain")
    path = tmp_path / "log.csv"
    clock = VirtualClock()
    logger = Logger(path, names, clock=clock)
    logger.bind({name: [1.0] for name in names})
    logger.start(0)
    logger.step(0)
    logger.stop(1)
    assert path.read_text().splitlines()[0] == "time,'=1+1,'@cmd,'-x,'quoted,plain"
    assert tuple(read_log(path).names) == names


def test_names_with_and_without_attributes_are_one(tmp_path: Path) -> None:
    """`X(value)` is `X`, `X(diff)` is `X(rate)`; blanks may trail, lines may end in CR LF, numbers may be nan."""
    path = tmp_path / "old.txt"
    path.write_bytes(
        b"0 X(value) X(diff) X(integral) Y(banana) \r\n0.1 1 -2e-3 nan 4  \r\n\r\n0.2 2 0 1 5\r\n"
    )
    log = read_log(path)
    assert log.names == ["X", "X(rate)", "X(integral)", "Y(banana)"]
    assert log["X(diff)"].tolist() == [-0.002, 0]
    assert log["X(value)"].tolist() == [1, 2]
    assert np.isnan(log["X(integral)"][0])
    assert "X" in log
    assert "Z" not in log
    with pytest.raises(UnknownNameError, match=r"X\(rate\)"):
        log["Z"]


def test_a_line_that_is_cut_is_left_out_and_noted(tmp_path: Path) -> None:
    """What a killed writer left at the end is not a row, and the reader says so."""
    for text, rows in (
        (b"0 X Y \n1 2 3 \n2 5", 1),
        (b"0 X Y \n1 2 3 \n2 5 -", 1),
        (b"0 X Y \n1 2 3 \n2 5 7", 2),
    ):
        path = tmp_path / "cut.txt"
        path.write_bytes(text)
        log = read_log(path)
        assert len(log) == rows
        assert len(log.notes) == 1
        assert ":3: the last line" in log.notes[0]


BAD: list[tuple[bytes, str]] = [
    (b"", "empty"),
    (b"1 2 3\n4 5 6\n", ":1: a log's line of names begins with '0'"),
    (b"0 1 2\n", ":1: numbers where"),
    (b"0\n", ":1: no column"),
    (b"0 X X(value)\n", ":1: X named twice"),
    (b"0 X\n1 2\n3 4 5\n", ":3: 3 numbers where the line of names has 2"),
    (b"0 X\n1 2\n3 x\n", ":3: column 2: 'x' is not a number"),
    (b"0 X\n1 1_0\n", ":2: column 2: '1_0' is not a number"),
    (b"0 X\nnan 1\n", ":2: no time"),
    (b"time,X\n1,2\n1,2,3\n", ":3: 3 numbers"),
    (b'time,"X\n1,2\n', ":1: no line of names"),
    (b"\xff\xfe\x00\x01", ":1: not a text"),
    (b"0 " + b"X" * 600_000, ":1: more than 524288 characters"),
    (b"0 " + b" ".join(b"X%d" % i for i in range(3000)), ":1: more than 1999 columns"),
    (b"PAR1 and nothing else", "a Parquet file that cannot be read"),
    (b"SQLite format 3\0 and nothing else", "cannot be read"),
    (b"\x89MCAP0\r\n", "without a channel of a logger"),
    (b"\x89MCAP0\r\n\x06" + b"\xff" * 8, "a record of 18446744073709551615 bytes at byte 8"),
    (b"\x89MCAP0\r\n\x06\x04\0\0\0\0\0\0\0abcd", "a broken record at byte 8"),
    (b"\xff\xff\xff\xff\x10\0\0\0garbage", "no journal"),
]


@pytest.mark.parametrize(("data", "message"), BAD)
def test_what_is_no_log_is_said_with_its_line(tmp_path: Path, data: bytes, message: str) -> None:
    """Whatever a file holds, the error names the file, the line where there are lines, and what is wrong."""
    if data.startswith((b"PAR1", b"\xff\xff\xff\xff")):
        pytest.importorskip("pyarrow")
    path = tmp_path / "bad.txt"
    path.write_bytes(data)
    with pytest.raises(LogError) as caught:
        read_log(path)
    assert str(caught.value).startswith(str(path))
    assert message in str(caught.value)


def test_files_that_are_not_there_are_said(tmp_path: Path) -> None:
    """No file, and a folder, are errors of the call."""
    with pytest.raises(LogError, match="no such file"):
        read_log(tmp_path / "none.csv")
    with pytest.raises(LogError, match="not a file"):
        read_log(tmp_path)


@every_format
def test_reading_is_bounded(tmp_path: Path, suffix: str) -> None:
    """A log of more numbers than asked for is refused, not read into memory."""
    path = tmp_path / f"a.{suffix}"
    swing(path, 0.5)
    with pytest.raises(LogError, match="more than 100 numbers"):
        read_log(path, most_numbers=100)


@every_format
@given(data=st.data())
def test_damage_never_raises_anything_else(
    tmp_path_factory: pytest.TempPathFactory, suffix: str, data: st.DataObject
) -> None:
    """A log that is cut or has bytes changed gives a log or a `LogError`, whatever its format."""
    path = tmp_path_factory.mktemp("damage") / f"a.{suffix}"
    swing(path, 0.3)
    whole = bytearray(path.read_bytes())
    for _ in range(data.draw(st.integers(0, 3))):
        whole[data.draw(st.integers(0, len(whole) - 1))] = data.draw(st.integers(0, 255))
    path.write_bytes(whole[: data.draw(st.integers(0, len(whole)))])
    try:
        assert isinstance(read_log(path), Log)
    except LogError:
        pass


def test_a_database_that_is_a_trap_is_no_log(tmp_path: Path) -> None:
    """A view, a computed column or texts where numbers belong are refused, and endless work is cut short."""
    endless = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) SELECT i, i FROM n"
    for script, message in (
        (f"CREATE VIEW log(time, X) AS {endless}", "without a table `log`"),
        ("CREATE TABLE log(time REAL, X REAL AS (time * 2))", "computes"),
        ("CREATE TABLE log(time REAL, X); INSERT INTO log VALUES (1, 'two')", "row 1 of the table"),
        ("CREATE TABLE log(X, time)", "does not begin with `time`"),
    ):
        path = tmp_path / "trap.db"
        path.unlink(missing_ok=True)
        database = sqlite3.connect(path)
        database.executescript(script)
        database.close()
        with pytest.raises(LogError, match=message):
            read_log(path)


def test_wrong_calls_are_said_before_anything_runs(tmp_path: Path) -> None:
    """Suffixes, attributes, double and missing columns, rates and digits that cannot be are refused when they are said."""
    cases: list[tuple[Callable[[], Any], str]] = [
        (lambda: Logger("a.xyz", ["X"]), "says no format"),
        (lambda: Logger("a.csv", []), "at least one state"),
        (lambda: Logger("a.csv", "RHY"), "a list of columns"),
        (lambda: Logger("a.csv", ["X", "x"]), "there twice"),
        (lambda: Logger("a.csv", ["time"]), "column of seconds"),
        (lambda: Logger("a.csv", ["X(speed)"]), "no attribute of a state"),
        (lambda: Logger("a.csv", ["X\n"]), "not a column"),
        (lambda: Logger("a.csv", ["X"], rate_hz=0), "not a rate"),
        (lambda: Logger("a.csv", ["X"], digits=6), "is for text"),
        (lambda: Logger("a.csv", ["X"], queue_s=-1), "queue_s"),
        (lambda: Logger("a.csv", ["X"], format="xlsx"), "no format of logs"),
        (lambda: Logger(tmp_path / "a.csv", ["X"]).start(0), "bind"),
        (lambda: Logger("a.csv", ["X"]).bind({"Y": [0.0]}), "no state"),
        (lambda: Logger("a.csv", ["X(rate)"]).bind({"X": [0.0]}), "has no rate"),
    ]
    for call, message in cases:
        with pytest.raises(CallerError, match=message):
            call()
    logger = Logger(tmp_path / "none" / "a.csv", ["X"], clock=VirtualClock())
    logger.bind({"X": [0.0]})
    with pytest.raises(CallerError, match="cannot be written: No such file"):
        logger.start(0)


def test_a_file_may_be_protected(tmp_path: Path) -> None:
    """With `replace=False` a file that is there stays as it is."""
    path = tmp_path / "a.csv"
    path.write_text("precious")
    logger = Logger(path, ["X"], replace=False, clock=VirtualClock())
    logger.bind({"X": [0.0]})
    with pytest.raises(CallerError, match="there is a file already"):
        logger.start(0)
    assert path.read_text() == "precious"


def test_an_mcap_that_was_never_closed_is_closed(tmp_path: Path) -> None:
    """A cut file reads up to its last whole chunk; recovered it has that, and the index that readers want."""
    path = tmp_path / "a.mcap"
    swing(path)
    whole = read_log(path)
    with pytest.raises(CallerError, match="was closed"):
        recover(path)
    path.write_bytes(path.read_bytes()[:9000])
    cut = read_log(path)
    assert 0 < len(cut) < len(whole)
    assert "was not closed" in cut.notes[0]
    assert recover(path) == len(cut)
    log = read_log(path)
    assert log.notes == []
    assert log.about == whole.about
    assert np.array_equal(log.time_s, whole.time_s[: len(log)])
    assert np.array_equal(log.values, whole.values[: len(log)], equal_nan=True)
    with pytest.raises(CallerError, match="need no recovery"):
        recover(tmp_path / "a.csv")


def test_without_a_clock_of_states_it_is_the_real_one(tmp_path: Path) -> None:
    """States without a clock, such as a list, are logged in real time, with the wall clock's date."""
    path = tmp_path / "a.db"
    logger = Logger(path, ["X"])
    logger.bind({"X": [2.5]})
    with logger:
        logger.step(RealClock().now())
    log = read_log(path)
    assert log["X"].tolist() == [2.5]
    assert log.about.wall_ns is not None
    assert log.about.wall_ns > 1_600_000_000 * 10**9
