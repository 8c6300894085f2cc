"""`aces decode` in a pipeline: lines as they come, and clean ends."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

FRAME = b"(%d.000000) can0 060#0000000000000000\n"
TIMEOUT_S = 60

pytestmark = pytest.mark.skipif(os.name != "posix", reason="pipes and signals of a Unix shell")


class Running:
    """A running `aces`, killed at the end of a test that hangs."""

    def __init__(self, *arguments: str) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-m", "aces_tools", *arguments],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
        )
        self.alarm = threading.Timer(TIMEOUT_S, self.process.kill)
        self.alarm.start()

    def write(self, data: bytes) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(data)
        self.process.stdin.flush()

    def line(self) -> bytes:
        assert self.process.stdout is not None
        return self.process.stdout.readline()

    def end(self) -> tuple[int, str]:
        """Status and what was said, with the input still open."""
        assert self.process.stderr is not None
        said = self.process.stderr.read().decode()
        return self.process.wait(), said

    def close(self) -> None:
        self.alarm.cancel()
        self.process.kill()
        self.process.wait()
        for file in (self.process.stdin, self.process.stdout, self.process.stderr):
            if file is not None:
                try:
                    file.close()
                except BrokenPipeError:
                    pass


@pytest.fixture
def live(arm: str) -> Iterator[Running]:
    """`… | aces decode -p arm --format jsonl -`."""
    running = Running("decode", "-p", arm, "--format", "jsonl", "-")
    yield running
    running.close()


@pytest.mark.slow
def test_lines_come_as_the_frames_do(live: Running) -> None:
    """Each frame of a pipe is printed at once, not when a block is full; the end of the pipe is the end."""
    for number in range(3):
        live.write(FRAME % number)
        assert json.loads(live.line())["time"] == number
    assert live.process.stdin is not None
    live.process.stdin.close()
    status, said = live.end()
    assert (status, said) == (
        0,
        "frames=3 decoded=3 unknown=0 malformed=0 filtered=0 errors=0 lines_unreadable=0\n",
    )


@pytest.mark.slow
def test_ctrl_c_ends_with_the_summary(live: Running) -> None:
    """Ctrl-C while waiting for a live source is the usual end: summary, status 0, no traceback."""
    live.write(FRAME % 1 + b"rubbish\n" + FRAME % 2)
    live.line()
    live.line()
    live.process.send_signal(signal.SIGINT)
    status, said = live.end()
    assert status == 0
    assert "Traceback" not in said
    assert said.splitlines()[-1].startswith("frames=2 decoded=2 ")
    assert said.splitlines()[-1].endswith("lines_unreadable=1")


@pytest.mark.slow
def test_a_reader_that_leaves_ends_it(live: Running) -> None:
    """`| head -1`: no traceback, the summary of what was read."""
    live.write(FRAME % 1)
    live.line()
    assert live.process.stdout is not None
    live.process.stdout.close()
    try:
        for number in range(2000):
            live.write(FRAME % number)
    except BrokenPipeError:
        pass
    status, said = live.end()
    assert status == 0
    assert "Traceback" not in said
    assert "BrokenPipe" not in said
    assert said.count("\n") == 1
    assert said.startswith("frames=")


@pytest.mark.slow
def test_a_silent_line_ends_what_is_incomplete(tmp_path: Path) -> None:
    """Half a packet is shown after the protocol's gap, though the pipe stays open and nothing follows."""
    live = Running("decode", "-", "-p", "robotis", "--direction", "from", "--format", "jsonl")
    live.write(bytes.fromhex("FFFF0105"))
    lost = [json.loads(live.line()) for _ in range(2)]
    live.write(bytes.fromhex("FFFF010200FC"))
    found = json.loads(live.line())
    live.close()
    assert [(one["reason"], one["size"]) for one in lost] == [("malformed: incomplete", 1), ("skipped", 3)]
    assert (found["message"], found["offset"]) == ("Status", 4)


@pytest.mark.slow
def test_head_on_a_file(arm: str, tmp_path: Path) -> None:
    """So does `aces decode big.log … | head -2`."""
    log = tmp_path / "big.log"
    log.write_bytes(b"".join(FRAME % n for n in range(20_000)))
    running = Running("decode", str(log), "-p", arm)
    assert running.line() == b"%s\n" % os.fsencode(log)
    assert running.process.stdout is not None
    running.process.stdout.close()
    status, said = running.end()
    running.close()
    assert status == 0
    assert said.startswith("frames=")
    assert said.count("\n") == 1


@pytest.mark.slow
def test_ctrl_c_on_a_file_is_told_by_the_status(arm: str, tmp_path: Path) -> None:
    """A file that was not read to its end gives status 130 and the summary of what was."""
    fifo = tmp_path / "x.log"
    fifo.write_bytes(b"".join(FRAME % n for n in range(400_000)))
    running = Running("decode", str(fifo), "-p", arm, "--format", "jsonl")
    running.line()
    running.process.send_signal(signal.SIGINT)
    assert running.process.stdout is not None
    drain = threading.Thread(target=running.process.stdout.read)
    drain.start()
    status, said = running.end()
    drain.join()
    running.close()
    assert status == 130
    assert "Traceback" not in said
    assert said.startswith("frames=")


@pytest.mark.slow
def test_a_full_disk_is_one_line(arm: str, tmp_path: Path) -> None:
    """An output that takes no more is said, with the summary, and status 2."""
    if not os.path.exists("/dev/full"):
        pytest.skip("no /dev/full here")
    log = tmp_path / "a.log"
    log.write_bytes(b"".join(FRAME % n for n in range(5000)))
    with open("/dev/full", "wb") as full:
        done = subprocess.run(
            [sys.executable, "-m", "aces_tools", "decode", str(log), "-p", arm],
            stdout=full,
            stderr=subprocess.PIPE,
            timeout=TIMEOUT_S,
        )
    assert done.returncode == 2
    assert b"Traceback" not in done.stderr
    assert done.stderr.count(b"writing stopped") == 1
