# An interrupt is planted in a private part.
# pyright: reportPrivateUsage=false
"""`aces sniff`: what is heard is shown, filtered, recorded and counted; nothing is ever sent."""

from __future__ import annotations

import ast
import io
import re
import threading
from argparse import ArgumentTypeError
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

import aces_tools.live_text
import aces_tools.recorder
import aces_tools.sniff
from aces_bus import Frame, open_recording
from aces_bus.errors import CallerError
from aces_bus.frames import FD_LENGTHS
from aces_bus.hardware import CanGate
from aces_bus.hardware.gate import Received
from aces_bus.hardware.gate_events import BusEvent
from aces_bus.hardware.simulated.backend import AcesBus
from aces_tools.live import BusEventLines
from aces_tools.live_text import CandumpLines
from aces_tools.options import duration
from aces_tools.output.text import Times
from tests.limits import small_disk
from tests.tools.live import WAIT_S, Node, Opened, interrupt

Aces = Callable[..., Any]
pytestmark = pytest.mark.usefixtures("quick")


# ---------------------------------------------------------------------- what is shown


def test_live_lines_are_those_of_decode(
    aces: Aces, node: Node, opened: Opened, arm: str, tmp_path: Path
) -> None:
    """Record lines of a live bus equal those of `aces decode` of the recording that was made meanwhile."""
    opened.then(node.walk)
    record = tmp_path / "walk.log"
    live = aces("sniff", *node.options, "-p", arm, "--format", "jsonl", "-n", 5, "--record", record)
    assert live.status == 0
    again = aces("decode", record, "-p", arm, "--format", "jsonl")
    expected = [{**one, "source": node.channel} for one in again.objects]
    assert live.objects == expected
    assert [one["message"] for one in live.objects] == ["Encoder", "State", None, None, "Encoder"]
    assert live.objects[1]["fields"]["mode"] == "torque"
    # times with all their digits
    assert all(one["time"] > 1.7e9 for one in live.objects)


def test_the_summary_is_that_of_decode_and_what_was_lost(
    aces: Aces, node: Node, opened: Opened, arm: str
) -> None:
    """The bins sum to the frames, and the losses stand behind them."""
    opened.then(node.walk)
    found = aces("sniff", *node.options, "-p", arm, "-n", 5)
    assert found.summary == {
        "frames": 5,
        "decoded": 3,
        "unknown": 1,
        "malformed": 1,
        "filtered": 0,
        "errors": 0,
        "lines_unreadable": 0,
        "dropped": 0,
        "kernel_dropped": 0,
        "bad_input": 0,
        "reopened": 0,
    }
    assert "Encoder  board=0  position=[10, -10] count" in found.out


def test_without_a_protocol_the_lines_are_candumps(aces: Aces, opened: Opened, tmp_path: Path) -> None:
    """Frames of each kind are shown so that a reader of candump's lines reads the same frames."""
    node = Node(fd=True)
    try:

        def send() -> None:
            node.send(0x123, "DEADBEEF")
            node.send(0x12345678, "00")
            node.send(0x7FF, "", is_remote_frame=True, dlc=4)
            node.send(0x100, "00" * 12, is_fd=True)
            node.send(0x001)

        opened.then(send)
        found = aces("sniff", *node.options, "-t", "absolute", "-n", 5)
    finally:
        node.close()
    frames = list(open_recording(io.BytesIO(found.out.encode()), link="can"))
    assert [(f.arbitration_id, f.data, f.is_extended_id, f.is_remote_frame, f.is_fd) for f in frames] == [
        (0x123, b"\xde\xad\xbe\xef", False, False, False),
        (0x12345678, b"\0", True, False, False),
        (0x7FF, b"", False, True, False),
        (0x100, bytes(12), False, False, True),
        (0x001, b"", False, False, False),
    ]
    assert frames[2].dlc == 4
    assert {frame.channel for frame in frames} == {node.channel}
    assert found.summary["unknown"] == 5


STAMPED = [
    Frame(0x123, b"\x01\x02", 1436509052.25, "can0"),
    Frame(0x123, b"", 1436509052.5, "can0"),
    Frame(4, bytes(8), 1436509054.0, "can1", is_error_frame=True),
]


@pytest.mark.parametrize(
    ("mode", "shown"),
    [
        ("absolute", ["1436509052.250000", "1436509052.500000", "1436509054.000000"]),
        ("delta", ["000.000000", "000.250000", "001.500000"]),
        ("relative", ["000.000000", "000.250000", "001.750000"]),
    ],
)
def test_times_are_candumps(mode: str, shown: list[str]) -> None:
    """Absolute, delta to the line before, and from the first on: with candump's digits."""
    lines = CandumpLines(Times(mode)).frames(STAMPED).decode().splitlines()
    assert [re.findall(r"^ \(([0-9.]+)\)  can", line)[0] for line in lines] == shown
    assert lines[0].endswith("  can0  123   [2]  01 02")
    assert lines[2].endswith("  can1  20000004   [8]  00 00 00 00 00 00 00 00   ERRORFRAME")


@st.composite
def frames(draw: st.DrawFn) -> Frame:
    """Any frame that candump's screen can show."""
    kind = draw(st.sampled_from(["data", "fd", "remote", "error"]))
    is_wide = draw(st.booleans()) and kind != "error"
    identifier = draw(st.integers(0, 0x1FFF_FFFF if is_wide or kind == "error" else 0x7FF))
    size = (
        draw(st.sampled_from(FD_LENGTHS))
        if kind == "fd"
        else 8
        if kind == "error"
        else draw(st.integers(0, 8))
    )
    data = b"" if kind == "remote" else draw(st.binary(min_size=size, max_size=size))
    return Frame(
        identifier,
        data,
        draw(st.integers(0, 2 * 10**15)) / 1e6,
        draw(st.sampled_from(["can0", "vcan12", "unix:can0"])),
        is_wide,
        kind == "remote",
        kind == "error",
        kind == "fd",
        dlc=size if kind == "remote" else None,
    )


@given(st.lists(frames(), min_size=1, max_size=8))
def test_lines_are_read_back_as_the_same_frames(sent: list[Frame]) -> None:
    """Whatever is shown, candump's reader reads as it was, but for the flags that candump hides too."""
    lines = CandumpLines(Times("absolute")).frames(sent)
    read = list(open_recording(io.BytesIO(lines), link="can"))
    assert len(read) == len(sent)
    for mine, other in zip(sent, read, strict=True):
        assert (mine.arbitration_id, mine.data, mine.channel) == (
            other.arbitration_id,
            other.data,
            other.channel,
        )
        assert (mine.is_extended_id, mine.is_remote_frame, mine.is_error_frame, mine.is_fd, mine.dlc) == (
            (other.is_extended_id, other.is_remote_frame, other.is_error_frame, other.is_fd, other.dlc)
        )
        assert mine.timestamp is not None
        assert abs(mine.timestamp - (other.timestamp or 0)) < 1e-6


def test_dates_are_read_back_as_the_same_instant() -> None:
    """`-t date` is local time, as candump writes and our reader reads it."""
    lines = CandumpLines(Times("date")).frames(STAMPED)
    assert [frame.timestamp for frame in open_recording(io.BytesIO(lines), link="can")] == [
        frame.timestamp for frame in STAMPED
    ]


def test_decoded_lines_have_the_time_that_is_asked_for(
    aces: Aces, node: Node, opened: Opened, arm: str
) -> None:
    """`-t delta` counts from the line before, `-t date` gives a date."""
    opened.then(node.walk)
    found = aces("sniff", *node.options, "-p", arm, "-t", "delta", "-n", 5)
    assert found.out.splitlines()[1].split()[0] == "0.000000"
    opened.event.clear()
    opened.then(node.walk)
    found = aces("sniff", *node.options, "-p", arm, "-t", "date", "-n", 5)
    assert re.match(r" *[0-9]{4}-[0-9]{2}-[0-9]{2} [0-9:]{8}\.[0-9]{6} ", found.out.splitlines()[1])


def test_filters_apply_to_what_is_shown_and_not_to_what_is_recorded(
    aces: Aces, node: Node, opened: Opened, arm: str, tmp_path: Path
) -> None:
    """candump's filters, by identifier and interface; the recording has everything."""
    record = tmp_path / "all.log"
    opened.then(node.walk)
    wanted = f"{node.channel},060:7F0"
    found = aces("sniff", *node.options, "-p", arm, "--filter", wanted, "-n", 3, "--record", record)
    assert len([line for line in found.out.splitlines() if "rx  06" in line]) == 3
    assert found.summary["filtered"] == 2
    assert len(list(open_recording(record, link="can"))) == 5
    opened.event.clear()
    opened.then(node.walk)
    found = aces("sniff", *node.options, "--filter", "060~7F0", "-n", 2)
    assert [line.split()[2] for line in found.out.splitlines()] == ["300", "7FE"]
    assert found.summary["filtered"] == 2


def test_messages_and_conditions_select(aces: Aces, node: Node, opened: Opened, arm: str) -> None:
    """`--message` and `--where` as of decode; with them losses are not shown."""
    opened.then(node.walk)
    found = aces(
        "sniff", *node.options, "-p", arm, "--message", "Encoder", "--where", "board=1", "--format", "jsonl", "-n", 1
    )  # fmt: skip
    (one,) = found.objects
    assert one["fields"] == {"board": 1, "position": [11, -11]}
    assert found.summary["filtered"] == 2
    assert found.summary["unknown"] == 1


def test_several_protocols_each_claim_theirs(aces: Aces, node: Node, opened: Opened, arm: str) -> None:
    """Two protocols on one bus; the first named wins, which is said."""
    opened.then(node.walk)
    found = aces("sniff", *node.options, "-p", arm, "-p", "hubo", "-n", 5, "--format", "jsonl")
    assert {one["protocol"] for one in found.objects if one["message"]} == {"arm"}
    assert any("both claim identifier 0x060" in said for said in found.messages)


@pytest.fixture
def two() -> Iterator[tuple[Node, Node]]:
    """Nodes of two buses."""
    nodes = Node(), Node()
    yield nodes
    for node in nodes:
        node.close()


def test_several_buses_are_one_listing(
    aces: Aces, two: tuple[Node, Node], opened: Opened, arm: str, tmp_path: Path
) -> None:
    """Lines, protocols by channel and the recording go by the names of the buses; the summary is of all."""
    first, second = two
    opened.wait_for(2)

    def work() -> None:
        first.walk()
        second.walk()

    opened.then(work)
    record = tmp_path / "both.log"
    options = [first.channel, second.channel, "-i", "aces", "--bus-kwargs", "physics=false"]
    found = aces(
        "sniff",
        *options,
        "-p",
        f"{first.channel}={arm}",
        "-n",
        10,
        "--format",
        "jsonl",
        "--record",
        record,
    )
    assert found.status == 0, found.err
    read = {(one["channel"], one["message"]) for one in found.objects}
    assert read == {
        *((first.channel, name) for name in ("Encoder", "State", None)),
        (second.channel, None),
    }
    summed = {"frames": 10, "decoded": 3, "unknown": 6, "dropped": 0}
    assert {name: found.summary[name] for name in summed} == summed
    with open_recording(record) as recording:
        assert {frame.channel for frame in recording if isinstance(frame, Frame)} == {
            first.channel,
            second.channel,
        }


def test_a_bus_of_several_that_does_not_open_ends_it(aces: Aces, node: Node, opened: Opened) -> None:
    """The bus that cannot be opened is named; the one that was open is closed."""
    found = aces("sniff", node.channel, "unix:nowhere", "-i", "aces", "--bus-kwargs", "physics=false")
    assert (found.status, found.out) == (2, "")
    assert "unix:nowhere" in found.err
    assert [gate.state for gate in opened.gates] == ["closed"]


def test_it_ends_after_a_time(aces: Aces, node: Node) -> None:
    """`--for` ends it where nothing comes."""
    found = aces("sniff", *node.options, "--for", "20ms")
    assert found.status == 0
    assert found.summary["frames"] == 0


def test_it_ends_on_ctrl_c_with_everything_that_was_heard(
    aces: Aces, node: Node, opened: Opened, arm: str
) -> None:
    """Ctrl-C is an end and no fault: what was heard is shown, and the status is 0."""

    def work() -> None:
        node.walk()
        interrupt()

    opened.then(work)
    found = aces("sniff", *node.options, "-p", arm)
    assert found.status == 0
    assert found.summary["frames"] == 5
    assert len(found.out.splitlines()) == 1 + 5


def test_quiet_prints_the_summary_only(aces: Aces, node: Node, opened: Opened) -> None:
    """`-q` shows nothing and counts everything."""

    def work() -> None:
        node.walk()
        interrupt()

    opened.then(work)
    found = aces("sniff", *node.options, "-q")
    assert found.out == ""
    assert found.summary["frames"] == 5


@pytest.mark.parametrize("size", [0, 1 << 20])
def test_a_second_interrupt_loses_nothing_in_silence(
    aces: Aces, node: Node, opened: Opened, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, size: int
) -> None:
    """Interrupted at once, what was shown is written; where that fails it is said, once, with status 2."""
    hear = aces_tools.sniff.Sniffing._hear

    def interrupted(sniffing: Any, items: Any) -> None:
        hear(sniffing, items)
        raise KeyboardInterrupt

    monkeypatch.setattr(aces_tools.sniff.Sniffing, "_hear", interrupted)
    opened.then(lambda: node.send(0x060, "0A"))
    lines = tmp_path / "lines.txt"
    with small_disk(size):
        found = aces("sniff", *node.options, "-o", lines)
    first, *messages = found.messages
    assert first == f"{node.channel}: runs until Ctrl-C"
    if size:
        assert (found.status, messages) == (0, [])
        assert lines.read_text().endswith("  060   [1]  0A\n")
    else:
        assert found.status == 2
        assert messages == [f"{lines}: writing stopped: File too large"]


# ---------------------------------------------------------------------- it cannot send


def test_nothing_is_ever_sent(
    aces: Aces, node: Node, opened: Opened, arm: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The bus is opened to listen only, no thread sends, `send` refuses, and python-can's `send` is not called."""
    sent: list[Any] = []
    made: list[dict[str, Any]] = []
    others = AcesBus.send
    create = can.Bus

    def bus(*arguments: Any, **options: Any) -> Any:
        found = create(*arguments, **options)
        made.append(options)
        monkeypatch.setattr(found, "send", sent.append)
        return found

    monkeypatch.setattr(can, "Bus", bus)
    names: list[str] = []

    def work() -> None:
        (gate,) = opened.gates
        names.extend(thread.name for thread in threading.enumerate())
        with pytest.raises(CallerError, match="only listens"):
            gate.send(Frame(1))
        node.walk()

    opened.then(work)
    record = tmp_path / "all.log"
    found = aces("sniff", *node.options, "-p", arm, "-n", 5, "--record", record, "--direction", "both")
    assert found.summary["frames"] == 5
    assert sent == []
    assert AcesBus.send is others
    assert [options["listen_only"] for options in made] == [True]
    (gate,) = opened.gates
    assert isinstance(gate, CanGate)
    assert gate.listen_only
    assert gate.counters.sent == gate.counters.send_failed == 0
    assert f"{node.channel} receive" in names
    assert f"{node.channel} send" not in names
    assert node.received() == []


@pytest.mark.parametrize("module", [aces_tools.sniff, aces_tools.recorder, aces_tools.live_text])
def test_no_line_of_it_sends(module: Any) -> None:
    """Nowhere in the command is anything called `send`, and a gate is made in one place: to listen only."""
    tree = ast.parse(Path(module.__file__).read_text(encoding="utf-8"))
    calls = [
        call for call in ast.walk(tree) if isinstance(call, ast.Call) and isinstance(call.func, ast.Attribute)
    ]
    names = [call.func.attr for call in calls if isinstance(call.func, ast.Attribute)]
    assert not [name for name in names if "send" in name or name in ("write_port", "sendto")]
    gates = [call for call in calls if isinstance(call.func, ast.Attribute) and call.func.attr == "gate"]
    for call in gates:
        assert [(k.arg, ast.literal_eval(k.value)) for k in call.keywords] == [("listen_only", True)]


# ---------------------------------------------------------------------- what happens to a bus


def test_a_bus_that_is_lost_comes_back(
    aces: Aces, node: Node, opened: Opened, arm: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Unplugged and back: both are said when they happen, and what comes after is shown."""
    original = AcesBus.recv
    failures = iter([True])

    def recv(bus: AcesBus, timeout: float | None = None) -> Any:
        if bus is not node.bus and next(failures, False):
            raise can.CanOperationError("the adapter is gone")
        return original(bus, timeout)

    monkeypatch.setattr(AcesBus, "recv", recv)

    def work() -> None:
        (gate,) = opened.gates
        back = threading.Event()
        gate.on_event(lambda event: back.set() if event.kind == "reopened" else None)
        if gate.counters.reopened or back.wait(WAIT_S):
            node.walk()

    opened.then(work)
    found = aces("sniff", *node.options, "-p", arm, "-n", 5)
    assert any("lost: CanOperationError: the adapter is gone" in said for said in found.messages)
    assert any("reopened" in said for said in found.messages)
    assert found.summary["decoded"] == 3
    assert found.summary["reopened"] == 1


def test_what_comes_too_fast_is_counted(
    aces: Aces, node: Node, opened: Opened, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A full queue drops the oldest frames; the summary and a line on stderr say how many."""
    subscribed: Any = CanGate.subscribe

    def subscribe(gate: CanGate, **options: Any) -> Any:
        return subscribed(gate, **{**options, "limit": 2})

    monkeypatch.setattr(CanGate, "subscribe", subscribe)

    def work() -> None:
        (gate,) = opened.gates
        frames = [can.Message(arbitration_id=n, is_extended_id=False, timestamp=1.0) for n in range(10)]
        received = [gate._frame(frame) for frame in frames]
        gate._put([Received(frame, 1) for frame in received])
        interrupt()

    opened.then(work)
    found = aces("sniff", *node.options)
    assert found.summary["frames"] == 2
    assert found.summary["dropped"] == 8
    assert any("8 frames came faster" in said for said in found.messages)


def test_a_flood_of_events_is_counted_and_not_printed(capsys: pytest.CaptureFixture[str]) -> None:
    """Of a thousand events of one kind three are printed, and then one line."""
    gate = CanGate({}, name="can0", listen_only=True)
    told = BusEventLines(gate)
    for _ in range(1000):
        gate.events.emit(BusEvent("bad input", 0, "can0", "oops"))
    told.report()
    told.report(last=True)
    lines = capsys.readouterr().err.splitlines()
    assert lines == ["aces: can0: bad input: oops"] * 3 + ["aces: can0: bad input: 997 more times"]
    assert told.counts == {"bad input": 1000}


def test_who_sends_is_told_what_to_look_at(capsys: pytest.CaptureFixture[str]) -> None:
    """An error-passive sender is alone or at another bit rate; who only listens is told the bare fact."""
    for listen_only in (True, False):
        gate = CanGate({}, name="can0", listen_only=listen_only)
        told = BusEventLines(gate)
        gate.events.emit(BusEvent("error-passive", 0, "can0"))
        told.report(last=True)
    bare, hinted = capsys.readouterr().err.splitlines()
    assert bare == "aces: can0: error-passive"
    assert hinted.startswith("aces: can0: error-passive; is another node there")


# ---------------------------------------------------------------------- wrong calls


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["-i", "aces", "-c", "x", "-p", "robotis"], "robotis is not spoken on CAN"),
        (["--serial", "/dev/none", "-p", "hubo"], "hubo is spoken on CAN; name a CAN bus"),
        (["--serial", "/dev/none", "-c", "can0"], "--channel is for CAN and --serial is not"),
        (["--serial", "a", "--udp", "1"], "two buses; name one"),
        (["--udp", "x:y"], "write PORT or HOST:PORT"),
        (["-i", "aces", "--baud", "9600"], "--baud is for serial lines"),
        (["-i", "aces", "-n", "0"], "'0' is not a whole number from 1 on"),
        (["-i", "aces", "--for", "soon"], "not a duration; write 10ms"),
        (["-i", "aces", "--message", "Encoder"], "name a protocol: -p NAME"),
        (["-i", "aces", "-p", "hubo", "--message", "Encode"], "did you mean 'Encoder'"),
        (["--serial", "a", "--filter", "060:7F0"], "this is not a CAN bus"),
        (["-i", "aces", "--filter", "060"], "060:7FF"),
        (["--serial", "a", "-p", "robotis"], "--direction"),
        (["-i", "aces", "--record", "x.foo"], "the suffix names no format"),
        (["-i", "aces", "--record", "x.slog"], "does not hold CAN frames; there are .log .csv"),
        (["-i", "aces", "--record", "-"], "standard output is for the lines"),
        (["-i", "aces", "--record", "/nowhere/x.log"], "cannot be written"),
        (["--serial", "/dev/nothing-here"], "/dev/nothing-here cannot be opened"),
        (["a", "b", "a", "-i", "aces"], "a is named twice"),
        (["a", "/dev/ttyS0"], "is not a network interface"),
        (["a", "b", "-i", "aces", "--screen"], "--screen shows one bus"),
    ],
)
def test_wrong_calls(
    aces: Aces, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, arguments: list[str], said: str
) -> None:
    """One line says what is wrong and what would work; nothing is opened or written."""
    monkeypatch.chdir(tmp_path)
    found = aces("sniff", *arguments)
    assert found.status == 2
    assert said in found.err
    assert len(found.err.splitlines()) == 1
    assert list(tmp_path.iterdir()) == []


def test_no_bus_named(aces: Aces, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Without options, configuration and variables it is said how to name one."""
    monkeypatch.setenv("HOME", str(tmp_path))
    for name in ("CAN_INTERFACE", "CAN_CHANNEL", "CAN_CONFIG"):
        monkeypatch.delenv(name, raising=False)
    found = aces("sniff")
    assert found.status == 2
    assert "no bus is named; name it with -i INTERFACE -c CHANNEL" in found.err


def test_python_cans_variables_name_the_bus(
    aces: Aces, node: Node, opened: Opened, monkeypatch: pytest.MonkeyPatch
) -> None:
    """CAN_INTERFACE and CAN_CHANNEL, as with every program that uses python-can."""
    monkeypatch.setenv("CAN_INTERFACE", "aces")
    monkeypatch.setenv("CAN_CHANNEL", node.channel)
    opened.then(node.walk)
    found = aces("sniff", "--bus-kwargs", "physics=false", "-n", 5)
    assert found.summary["frames"] == 5
    assert node.channel in found.out


@pytest.mark.parametrize(
    ("text", "ns"),
    [
        ("10ms", 10_000_000),
        ("0.5s", 500_000_000),
        ("2min", 120 * 10**9),
        ("3", 3 * 10**9),
        ("100us", 100_000),
    ],
)
def test_durations(text: str, ns: int) -> None:
    """Durations are written with a unit, or in seconds."""
    assert duration(text) == ns


@pytest.mark.parametrize("text", ["", "0", "-1s", "1 fortnight", "nan", "inf", "1e9h"])
def test_no_durations(text: str) -> None:
    """What is not a duration is refused with what is."""
    with pytest.raises(ArgumentTypeError, match="10ms"):
        duration(text)
