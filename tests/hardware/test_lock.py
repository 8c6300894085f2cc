"""One program of a machine drives a bus."""

from __future__ import annotations

import os
import signal
import socket
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from aces_bus import Frame
from aces_bus.errors import CallerError
from aces_bus.hardware import CanGate
from aces_bus.hardware.bell import StopRequest, program_of
from aces_bus.hardware.lock import BusLock, lock_folder
from aces_bus.recordings.filters import parse_filter
from aces_bus.runtime.loop import Loop

pytestmark = pytest.mark.skipif(os.name != "posix", reason="locks are flock's")

HOLDER = """
import sys
from aces_bus.hardware.lock import BusLock
lock = BusLock(sys.argv[2], "lower")
lock.take()
print("taken", flush=True)
sys.stdin.read()
"""


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Temporary files of this test's own."""
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    return tmp_path


def test_the_second_is_refused_by_the_firsts_name(monkeypatch: pytest.MonkeyPatch) -> None:
    """With program and process; when the first lets go, the second has it. Other channels are free."""
    monkeypatch.setattr("sys.argv", ["/usr/bin/aces", "run", "walk.py"])
    first, second = BusLock("can0", "lower"), BusLock("can0", "legs")
    first.take()
    first.take()
    other = BusLock("can1", "upper")
    other.take()
    with pytest.raises(CallerError) as refused:
        second.take()
    assert str(refused.value).startswith(
        f"bus legs (can0) is driven by aces run (pid {os.getpid()}): two programs"
    )
    first.release()
    first.release()
    second.take()
    second.release()
    other.release()


def test_one_line_has_one_name(folder: Path) -> None:
    """A link to a serial port is that port; a served bus is its path."""
    (folder / "ttyUSB0").touch()
    (folder / "by-id").symlink_to(folder / "ttyUSB0")
    lock = BusLock(str(folder / "by-id"), "servos")
    lock.take()
    with pytest.raises(CallerError, match="is driven by"):
        BusLock(str(folder / "ttyUSB0"), "servos").take()
    BusLock("tcp:localhost:29536/can0" + "x" * 300, "far").take()


def test_all_users_have_one_folder() -> None:
    """Whoever made folder and file, others may take the lock: as in /tmp, nobody can remove another's file."""
    BusLock("can0", "lower").take()
    assert stat.S_IMODE(lock_folder().stat().st_mode) == 0o1777
    assert {stat.S_IMODE(file.stat().st_mode) for file in lock_folder().iterdir()} == {0o666}


def test_a_link_in_the_folder_is_not_followed(folder: Path) -> None:
    """What somebody has put there leads nowhere."""
    (folder / "precious").write_text("keep")
    (lock_folder() / "can0").symlink_to(folder / "precious")
    with pytest.raises(CallerError, match="cannot be opened"):
        BusLock("can0", "lower").take()
    assert (folder / "precious").read_text() == "keep"


@pytest.mark.slow
def test_a_killed_program_holds_nothing(folder: Path) -> None:
    """kill -9 of who drives frees the bus."""
    words = [sys.executable, "-c", HOLDER, "drive", "can0"]
    process = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        assert process.stdout.readline() == "taken\n"
        lock = BusLock("can0", "lower")
        with pytest.raises(CallerError, match=rf"is driven by drive \(pid {process.pid}\)"):
            lock.take()
    finally:
        process.send_signal(signal.SIGKILL)
        process.communicate(timeout=60)
    lock.take()


def test_a_gate_has_it_from_its_start_to_its_end(folder: Path) -> None:
    """A second gate is refused before its bus is opened; a bus that cannot be opened keeps no lock."""
    options = {"interface": "aces", "channel": str(folder)}
    first, second = CanGate(options), CanGate(options)
    first.lock, second.lock = BusLock("can0", "lower"), BusLock("can0", "lower")
    with first, pytest.raises(CallerError, match="is driven by"):
        second.start()
    broken = CanGate({"interface": "aces", "channel": "unix:" + str(folder / "no.sock")})
    broken.lock = BusLock("can0", "lower")
    with pytest.raises(Exception, match="no server answers"):
        broken.start()
    with second:
        pass
    BusLock("can0", "lower").take()


@pytest.mark.slow
def test_only_what_is_allowed_leaves(folder: Path) -> None:
    """An identifier that is not on the list is refused by its number, and is an event."""
    options = {"interface": "aces", "channel": str(folder)}
    events: list[tuple[str, str]] = []
    with CanGate(options, name="lower", allow=parse_filter("010:7F0", "123:7FF")) as gate:
        gate.on_event(lambda event: events.append((event.kind, event.detail)))
        assert gate.send(Frame(0x01F, b""))
        assert gate.send(Frame(0x123, b""))
        with pytest.raises(CallerError, match=r"lower: 0x124 is not among the identifiers that may be sent"):
            gate.send(Frame(0x124, b""))
        assert gate.counters.given == 2
    assert events[0] == ("not sent", "0x124 is not among the identifiers that may be sent here (allow)")


# ---------------------------------------------------------------------- the bell


def test_who_has_the_lock_can_be_asked_to_stop() -> None:
    """The request has the other program's name; answers come back in their order; without a lock nobody is there."""
    lock, other = BusLock("can0", "lower"), BusLock("can0", "legs")
    assert other.ring() is None
    heard: list[StopRequest] = []
    lock.on_stop = heard.append
    with Loop() as loop:
        lock.take()
        lock.listen(loop)
        ringing = other.ring()
        assert ringing is not None
        with ringing:
            assert loop.wait(lambda: bool(heard), 10_000_000_000)
            assert f"(pid {os.getpid()})" in heard[0].who
            heard[0].answer(is_stopping=True)
            heard[0].answer(devices=[])
            assert ringing.wait(10) == {"is_stopping": True}
            assert ringing.wait(10) == {"devices": []}
            assert ringing.wait(0) is None
        lock.release()
    assert other.ring() is None


@pytest.mark.parametrize(
    ("who", "said"),
    [
        ("aces stop (pid 7)", "aces stop (pid 7)"),
        ("\x1b[2J" + "a" * 500, "\\x1b[2J" + "a" * 76),
        ("", "another program"),
        (["a"], "another program"),
        (None, "another program"),
    ],
)
def test_a_program_s_name_is_safe_to_print(who: object, said: str) -> None:
    """Whoever reaches the bell says what it likes: control characters are spelt out, and a long name is cut."""
    assert program_of({"who": who}) == said


def test_a_bell_stays_out_of_the_way(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What a killed program left is replaced, requests that are not JSON stop all the same, long folders have no bell."""
    lock = BusLock("can0", "lower")
    lock.take()
    bell = next(lock_folder().glob("*.stop"))
    lock.release()
    bell.touch()
    heard: list[StopRequest] = []
    lock.on_stop = heard.append
    with Loop() as loop:
        lock.take()
        lock.listen(loop)
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as other:
            other.sendto(b"stop!", str(bell))
            assert loop.wait(lambda: bool(heard), 10_000_000_000)
        heard[0].answer(devices=[])  # to nobody
        lock.release()
    deep = folder / ("deep" * 40)
    deep.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(deep))
    lock = BusLock("can0", "lower")
    lock.take()
    assert lock.ring() is None
    lock.release()


def test_asking_who_drives_loads_no_backend() -> None:
    """A stop asks first: it waits neither for python-can with all its file formats, nor for NumPy."""
    code = "import sys, aces_bus.hardware.lock; print([m for m in ('can', 'numpy', 'serial') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"
