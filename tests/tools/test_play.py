"""`aces play`: a recording onto a bus, in its order and at its pace; only with --tx."""

from __future__ import annotations

import itertools
import os
import socket
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import can
import pytest

from aces_bus.hardware.gate_events import BusEvent
from aces_tools.patience import Patience
from tests.tools.live import WAIT_S, Node, Opened, interrupt

Aces = Callable[..., Any]

LOG = """\
(1.000000) can0 700#01
(1.010000) can0 123#DEADBEEF
(1.020000) can0 20000004#0004000000000000
(1.020000) can1 12345678#00
(1.050000) can0 400#R3
"""


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    path = tmp_path / "play.log"
    path.write_text(LOG)
    return path


@pytest.fixture
def due(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The instants (ns) that were waited for; nothing is."""
    found: list[int] = []

    def wait_until(patience: Patience, instant: int) -> bool:
        found.append(instant)
        return True

    monkeypatch.setattr(Patience, "wait_until", wait_until)
    return found


def sent(node: Node) -> list[tuple[int, str]]:
    return [(m.arbitration_id, bytes(m.data).hex()) for m in node.received(WAIT_S)]


EVERYTHING = [(0x700, "01"), (0x123, "deadbeef"), (0x12345678, "00"), (0x400, "")]


def test_without_tx_it_says_what_would_be_sent(
    aces: Aces, node: Node, recording: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Frames, identifiers, channels, duration; no bus is opened."""

    def never(*_: Any, **__: Any) -> Any:
        raise AssertionError("a bus was opened")

    monkeypatch.setattr(can, "Bus", never)
    found = aces("play", recording)
    assert found.status == 0
    assert found.out.splitlines()[0] == f"{recording}: 4 frames in 0.050 s, channels can0, can1"
    assert [line.split()[:2] for line in found.out.splitlines()[1:]] == [
        ["123", "1"], ["12345678", "1"], ["400", "1"], ["700", "1"],
    ]  # fmt: skip
    assert found.messages == ["nothing was sent: add --tx and a bus"]
    assert found.summary == {"frames": 5, "sent": 0, "failed": 0, "filtered": 0, "skipped": 1}


def test_frames_come_in_order_and_as_they_were(aces: Aces, node: Node, recording: Path) -> None:
    """Identifiers, data and flags; error frames are skipped and counted."""
    found = aces("play", recording, *node.options, "--tx")
    assert found.status == 0
    messages = node.received(WAIT_S)
    assert [(m.arbitration_id, bytes(m.data).hex()) for m in messages] == EVERYTHING
    assert [m.is_extended_id for m in messages] == [False, False, True, False]
    assert (messages[3].is_remote_frame, messages[3].dlc) == (True, 3)
    assert found.summary == {"frames": 5, "sent": 4, "failed": 0, "filtered": 0, "skipped": 1}


@pytest.mark.parametrize(
    ("options", "expected"),
    [([], [10, 20, 50]), (["--speed", "0.5"], [20, 40, 100]), (["--speed", "max"], []), (["--gap", "20ms"], [10, 20, 40])],
)  # fmt: skip
def test_the_pace(
    aces: Aces, node: Node, recording: Path, due: list[int], options: list[str], expected: list[int]
) -> None:
    """Deadlines are those of the recording, scaled, with long silences cut."""
    aces("play", recording, *node.options, "--tx", *options)
    assert sent(node) == EVERYTHING
    lingering = due.pop()
    assert lingering > 0
    if expected:
        assert [round((instant - due[0]) / 1e6) for instant in due] == [0, *expected]
    else:
        assert max(due, default=0) <= time.monotonic_ns()  # nothing is waited for


def test_more_frames_than_a_queue_holds_keep_their_order(aces: Aces, node: Node, tmp_path: Path) -> None:
    """At full speed nothing is lost, reordered or refused, also with identifiers that would win."""
    path = tmp_path / "many.log"
    path.write_text("".join(f"({n}.0) can0 {0x7FF - n % 0x700:03X}#{n:04X}\n" for n in range(6000)))
    found = aces("play", path, *node.options, "--tx", "--speed", "max")
    assert [bytes(m.data) for m in node.received(WAIT_S)] == [n.to_bytes(2, "big") for n in range(6000)]
    assert found.summary["sent"] == 6000


def test_loops_and_several_files(aces: Aces, node: Node, recording: Path) -> None:
    """All files, so many times."""
    found = aces("play", recording, recording, *node.options, "--tx", "--speed", "max", "--loop", 3)
    assert sent(node) == EVERYTHING * 6
    assert found.summary["frames"] == 30
    assert found.summary["skipped"] == 6


def test_filters(aces: Aces, node: Node, recording: Path) -> None:
    """candump's filters, by the recording's channels."""
    found = aces("play", recording, *node.options, "--tx", "--filter", "can0,700:700", "--filter", "can1")
    assert sent(node) == [(0x700, "01"), (0x12345678, "00")]
    assert found.summary == {"frames": 5, "sent": 2, "failed": 0, "filtered": 2, "skipped": 1}


@pytest.mark.slow
def test_channels_onto_several_buses(aces: Aces, node: Node, recording: Path) -> None:
    """`--map` sends each channel to its bus; what has none is filtered."""
    other = Node()
    try:
        options = ["-i", "aces", "--bus-kwargs", "physics=false"]
        maps = ["--map", f"can0={node.channel}", "--map", f"can1={other.channel}"]
        found = aces("play", recording, *options, *maps, "--tx")
        assert sent(node) == [one for one in EVERYTHING if one[0] != 0x12345678]
        assert sent(other) == [(0x12345678, "00")]
        assert found.summary["sent"] == 4
        found = aces("play", recording, *options, "--map", f"can1={other.channel}", "--tx")
        assert sent(other) == [(0x12345678, "00")]
        assert (found.summary["sent"], found.summary["filtered"]) == (1, 3)
        found = aces("play", recording, *node.options, "--map", f"can1={other.channel}", "--tx")
        assert len(sent(node)) == 3
        assert sent(other) == [(0x12345678, "00")]
    finally:
        other.close()


def test_ctrl_c_ends_it_and_everything_is_accounted_for(
    aces: Aces, node: Node, opened: Opened, recording: Path
) -> None:
    """Status 0, and the parts sum to what was read."""

    def work() -> None:
        assert node.bus.recv(WAIT_S) is not None
        interrupt()

    opened.then(work)
    found = aces("play", recording, *node.options, "--tx", "--loop", 0)
    assert found.status == 0
    parts = found.summary
    total = parts.pop("frames")
    assert total == sum(parts.values())
    assert parts["sent"] >= 1


def test_what_the_bus_refuses_is_counted(aces: Aces, node: Node, tmp_path: Path) -> None:
    """FD frames on a bus without FD: status 1."""
    path = tmp_path / "fd.log"
    path.write_text("(1.0) can0 123##1AA\n(1.0) can0 123#AA\n")
    found = aces("play", path, *node.options, "--tx")
    assert found.status == 1
    assert (found.summary["sent"], found.summary["failed"]) == (1, 1)


def test_a_file_that_cannot_be_read_does_not_stop_the_others(aces: Aces, node: Node, recording: Path) -> None:
    """Status 2, and the rest is played."""
    found = aces("play", "nothing.log", recording, *node.options, "--tx", "--speed", "max")
    assert found.status == 2
    assert "nothing.log: no such file" in found.err
    assert sent(node) == EVERYTHING


SERIAL = """\
# aces serial capture 1
(1.000000000) > [2] 0102
(1.010000000) < [2] 0304
(1.020000000) > [1] 05
"""


@pytest.mark.parametrize(
    ("direction", "expected", "filtered"), [([], "0102030405", 0), (["--direction", "to"], "010205", 2)]
)
def test_bytes_onto_a_line(
    aces: Aces, pty: tuple[int, str], tmp_path: Path, direction: list[str], expected: str, filtered: int
) -> None:
    """A serial recording, both ways or one."""
    far, near = pty
    path = tmp_path / "line.slog"
    path.write_text(SERIAL)
    found = aces("play", path, "--serial", near, "--tx", *direction)
    assert os.read(far, 100).hex() == expected
    assert found.summary == {"bytes": 5, "sent": 5 - filtered, "failed": 0, "filtered": filtered}


def test_bytes_without_times_go_as_fast_as_the_line(
    aces: Aces, pty: tuple[int, str], tmp_path: Path, due: list[int]
) -> None:
    """A raw recording is paced by the baud rate: ten bits a byte."""
    far, near = pty
    path = tmp_path / "line.bin"
    path.write_bytes(bytes(1024 + 512))
    found = aces("play", path, "--serial", near, "--baud", 9600, "--tx")
    assert found.summary["sent"] == 1536
    assert len(os.read(far, 4096)) == 1536
    steps = [second - first for first, second in itertools.pairwise(due)]
    assert round(steps[0] / 1e6) == round(512 * 10 / 9600 * 1000)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--speed", "0"], "write 1, 0.5, 10 or max"),
        (["--speed", "fast"], "write 1, 0.5, 10 or max"),
        (["--loop", "-1"], "is not a whole number from 0 on"),
        (["--gap", "x"], "not a duration"),
        (["--rate", "0"], "is not a number above 0"),
        (["--map", "can0"], "write OLD=NEW"),
        (["--map", "a=b", "--map", "a=c", "-i", "aces"], "a is named twice"),
        (["--serial", "x", "--map", "a=b"], "--map is for CAN"),
        (["--serial", "x", "--filter", "060:7F0"], "--filter is for CAN"),
        (["-i", "aces", "-c", "x", "--direction", "to"], "this is a CAN bus"),
    ],
)
def test_wrong_calls(aces: Aces, recording: Path, arguments: list[str], said: str) -> None:
    """One line says what is wrong and what would work."""
    found = aces("play", recording, *arguments)
    assert found.status == 2
    assert said in found.err
    assert len(found.err.splitlines()) == 1


def test_standard_input_is_played_once(aces: Aces) -> None:
    """It cannot be read again."""
    found = aces("play", "-", "--loop", 2)
    assert found.status == 2
    assert "played once only" in found.err


def test_bytes_as_datagrams(aces: Aces, tmp_path: Path) -> None:
    """Each piece of a serial recording is a datagram, and is counted as one."""
    path = tmp_path / "line.slog"
    path.write_text(SERIAL)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as device:
        device.bind(("127.0.0.1", 0))
        device.settimeout(WAIT_S)
        found = aces("play", path, "--udp", device.getsockname()[1], "--tx")
        assert [device.recv(100).hex() for _ in range(3)] == ["0102", "0304", "05"]
    assert found.summary == {"datagrams": 3, "sent": 3, "failed": 0, "filtered": 0}


def test_unreadable_lines_are_named_once(aces: Aces, node: Node, tmp_path: Path) -> None:
    """What is not a frame is said, however often the file is played."""
    path = tmp_path / "bad.log"
    path.write_text("(1.0) can0 123#AA\noops\n")
    found = aces("play", path, *node.options, "--tx", "--loop", 3)
    assert found.summary["sent"] == 3
    assert found.messages == [f"{path}:2: not a line of candump: 'oops'"]


@pytest.mark.slow
def test_an_outage_is_said_and_not_made_up_for(
    aces: Aces, node: Node, opened: Opened, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What falls due while the bus is lost does not go out when it is back: it is said and counted, and status 1."""
    path = tmp_path / "long.log"
    path.write_text("".join(f"({number}.0) can0 {number:03X}#\n" for number in range(30)))
    waits = itertools.count(1)
    events: list[BusEvent] = []
    changed = threading.Condition()

    def told(event: BusEvent) -> None:
        with changed:
            events.append(event)
            changed.notify_all()

    def until(kind: str) -> None:
        with changed:
            assert changed.wait_for(lambda: any(event.kind == kind for event in events), WAIT_S)

    def gone(*_: Any) -> Any:
        raise can.CanOperationError("unplugged")

    def wait_until(patience: Patience, instant: int) -> bool:
        number, (gate,) = next(waits), opened.gates
        if number == 11:
            while gate.counters.sent < 10:
                time.sleep(0)
            gate.on_event(told)
            gate.open_before, gate._open, gate._read = gate._open, gone, gone
            until("lost")
        elif number == 21:
            gate._open = gate.open_before
            until("reopened")
        return True

    monkeypatch.setattr(Patience, "wait_until", wait_until)
    found = aces("play", path, *node.options, "--tx")
    assert found.status == 1
    assert [identifier for identifier, _ in sent(node)] == [*range(10), *range(20, 30)]
    assert found.summary == {
        "frames": 30, "sent": 20, "failed": 0, "filtered": 0, "skipped": 0, "unsent": 10,
    }  # fmt: skip
    assert any("10 frames were given while the bus was lost" in line for line in found.messages)
