# The log's queue is waited for.
# pyright: reportPrivateUsage=false
"""Logs in real time: threads, slow and full disks, and writers that are killed."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

import pytest

from aces_bus.controller import controller
from aces_bus.controller.log import Logger, read_log
from aces_bus.export.files import AppendFile
from aces_bus.robot import run_virtual
from aces_bus.runtime import VirtualClock
from tests.device.fan import ROBOT, drivers, robot_of
from tests.limits import small_disk

MS = 1_000_000
SUFFIXES = ["txt", "csv", "db", "parquet", "mcap"]

#: Logs the row's number at 200 Hz for ever, and says when each was sampled.
WRITER = """
import sys
from aces_bus.controller.log import Logger
from aces_bus.runtime import RealClock
clock, value = RealClock(), [0.0]
loggers = [Logger(path, ["X", "Y"], rate_hz=200) for path in sys.argv[1:]]
for one in loggers:
    one.bind({"X": value, "Y": [float("nan")]})
    one.start(clock.now())
while True:
    due = clock.now() + 5_000_000
    value[0] += 1
    for one in loggers:
        one.step(clock.now())
    print(due - 5_000_000, flush=True)
    clock.sleep_until(due)
"""


@pytest.mark.slow
def test_a_killed_writer_loses_less_than_a_second(tmp_path: Path) -> None:
    """After SIGKILL every format reads back, whole rows in order, and no more than the last second is missing."""
    suffixes = list(SUFFIXES)
    if find_spec("pyarrow") is None:
        suffixes.remove("parquet")
    paths = [tmp_path / f"a.{suffix}" for suffix in suffixes]
    sampled: list[int] = []
    with subprocess.Popen(
        [sys.executable, "-c", WRITER, *map(str, paths)], stdout=subprocess.PIPE, text=True
    ) as writer:
        assert writer.stdout is not None
        for line in writer.stdout:
            sampled.append(int(line))
            if sampled[-1] - sampled[0] > 1_100 * MS:
                break
        writer.send_signal(signal.SIGKILL)
        killed = time.monotonic_ns()
    old = sum(1 for instant in sampled if instant < killed - 1000 * MS)
    assert old > 0
    for path in paths:
        log = read_log(path)
        found = log["X"].tolist()
        assert found == [float(i) for i in range(1, len(found) + 1)], path
        assert len(found) >= old, path
        if path.suffix in (".parquet", ".mcap"):
            assert "was not closed" in log.notes[0]


@pytest.fixture(name="small_disk")
def of_60_kb() -> Iterator[int]:
    """No file may grow beyond 60 kB."""
    with small_disk(60_000):
        yield 60_000


@pytest.mark.slow
def test_a_robot_goes_on_when_the_disk_is_full(tmp_path: Path, small_disk: int) -> None:
    """Beside a controller a full disk is an event of the run, and nothing else: set-points go on to the end."""

    @controller(rate_hz=100, writes=["A.left", "A.right"])
    def spin() -> dict[str, float]:
        return {"A.left": 100.0, "A.right": 50.0}

    log = Logger(tmp_path / "a.csv", ["A.left", "A.right", "A.left(age)"], rate_hz=1000)
    run = run_virtual(robot_of(ROBOT), [spin], loggers=[log], load=drivers)
    ended = run.run(3.0)
    assert (ended.reason, ended.tripped) == ("", {})
    assert run.set_points >= 2 * 300
    assert [event.kind for event in run.events if event.source == log.name] == ["log-failed"]
    assert log.written + log.lost >= 3000
    assert len(read_log(log.path)) == log.written > 0


def test_a_disk_that_is_free_again_is_written_to(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What could not be written is a gap, and the log goes on; trouble is told again when it had been well for a while."""
    path = tmp_path / "a.csv"
    clock = VirtualClock()
    log = Logger(path, ["X"], rate_hz=100, clock=clock)
    log.bind({"X": [1.0]})
    log.start(0)
    is_full = False
    write = os.write

    def limited(file: int, data: bytes) -> int:
        if is_full:
            write(file, data[:3])  # a part of it, as disks do
            raise OSError(28, "No space left on device")
        return write(file, data)

    monkeypatch.setattr(os, "write", limited)
    for i in range(1200):
        is_full = 100 <= i < 150 or 200 <= i < 250 or 1000 <= i < 1050
        log.step(i * 10 * MS)
    log.stop(0)
    monkeypatch.undo()
    assert [event.kind for event in log.events] == ["log-failed", "log-failed"]
    assert "No space left on device" in log.events[0].detail
    assert log.lost > 100
    assert len(read_log(path)) == log.written == 1200 - log.lost


def test_a_file_grows_by_whole_pieces(tmp_path: Path, small_disk: int) -> None:
    """A piece that does not fit leaves nothing behind."""
    file = AppendFile(str(tmp_path / "a"))
    file.write(b"x" * (small_disk - 10))
    with pytest.raises(OSError, match="too large"):
        file.write(b"y" * 20)
    file.write(b"z" * 10)
    file.close()
    file.close()
    data = (tmp_path / "a").read_bytes()
    assert len(data) == small_disk
    assert b"y" not in data


def test_a_device_that_takes_nothing_says_why() -> None:
    """What cannot be taken back either still has the reason why it was not written."""
    if not os.path.exists("/dev/full"):
        pytest.skip("no /dev/full here")
    file = AppendFile("/dev/full")
    with pytest.raises(OSError, match="No space left"):
        file.write(b"x")
    file.close()


def test_a_writer_that_was_stopped_twice_does_nothing(tmp_path: Path) -> None:
    """`stop` may come again, steps after it are nothing, and a log is started once."""
    log = Logger(tmp_path / "a.csv", ["X"], clock=VirtualClock())
    log.bind({"X": [1.0]})
    log.start(0)
    with pytest.raises(Exception, match="started before"):
        log.start(0)
    log.step(0)
    log.stop(0)
    log.stop(0)
    log.step(1)
    assert len(read_log(log.path)) == 1
    assert str(log) == "log a.csv: 100 Hz, 1 rows written, 0 dropped, 0 lost"
