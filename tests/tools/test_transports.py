"""The command and messages in several frames: every frame is accounted for, whichever way it is decoded."""

from __future__ import annotations

import runpy
from pathlib import Path

import numpy as np
import pytest

from aces_bus import Frame
from aces_bus.recordings import open as parts
from aces_tools import decode_jobs
from aces_tools.screen.model import Model
from tests.tools.conftest import Aces
from tests.tools.live import WAIT_S, Node, Opened
from tests.tools.screening import heard

SPEC = Path(__file__).parents[2] / "examples" / "fast_packet_device.py"
FIRST, LAST = "0DF80505#000A01C0855D2040", "0DF80505#0123050609FFFFFF"


def log(folder: Path, count: int) -> Path:
    """So many packets, of which each tenth has lost its last frame; wind between the frames."""
    path = folder / "boat.log"
    lines = []
    for number in range(count):
        lines += [FIRST, "0DFD0205#01EE02E02E020000"] + [LAST] * (number % 10 != 9)
    path.write_text("".join(f"({0.01 * n:.6f}) can0 {line}\n" for n, line in enumerate(lines)))
    return path


def test_records_losses_and_pending_frames_are_shown(aces: Aces, tmp_path: Path) -> None:
    """One line a packet, with the time of its last frame; frames of what is not whole one by one; the bins sum up."""
    result = aces("decode", log(tmp_path, 10), "-p", SPEC, "--unknown", "show")
    assert result.out.count("Position") == 9
    assert result.out.count("pending") == 1
    assert "    0.020000  can0  0DF80505 " in result.out
    summary = result.summary
    assert (summary["decoded"], summary["pending"], summary["frames"]) == (28, 1, 29)


def test_filters_and_windows_take_whole_packets(aces: Aces, tmp_path: Path) -> None:
    """What is filtered is counted in frames, in lines as in tables."""
    path = log(tmp_path, 10)
    for more in ((), ("-o", tmp_path / "boat.npz")):
        result = aces("decode", path, "-p", SPEC, "--filter", "0DF80505:1FFFFFFF", *more)
        assert (result.summary["decoded"], result.summary["filtered"]) == (18, 10)
        result = aces("decode", path, "-p", SPEC, "--from", "0.1", *more)
        assert sum(result.summary[name] for name in ("decoded", "filtered", "pending")) == 29


@pytest.mark.slow
def test_jobs_find_packets_across_their_pieces(
    aces: Aces, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Several processes decode what one does: frames of packets are left to one of them."""
    pytest.importorskip("pyarrow")
    from pyarrow import parquet

    monkeypatch.setattr(decode_jobs, "PIECE", 5_000)
    monkeypatch.setattr(decode_jobs, "WORTH", 0)
    monkeypatch.setattr(parts, "LEAST", 1_000)
    path = log(tmp_path, 400)
    one = aces("decode", path, "-p", SPEC, "-o", tmp_path / "one.parquet")
    many = aces("decode", path, "-p", SPEC, "-o", tmp_path / "many.parquet", "--jobs", 2)
    assert one.summary == many.summary
    assert one.summary["malformed"] == 39
    tables = [
        parquet.read_table(tmp_path / name / "Position.parquet") for name in ("one.parquet", "many.parquet")
    ]
    assert [table.num_rows for table in tables] == [360, 360]
    times = [np.sort(table.column("time").to_numpy()) for table in tables]
    assert (times[0] == times[1]).all()


def test_what_would_be_sent_is_shown(aces: Aces) -> None:
    """All frames of a message, and what a receiver makes of the last."""
    given = ("source=5", "sid=1", "latitude=54.3", "longitude=10.1", "satellites=9")
    result = aces("send", "Position", *given, "-p", SPEC)
    lines = result.out.splitlines()
    assert [line.split()[-1] for line in lines[:2]] == [FIRST, LAST]
    assert "Position" in lines[2]
    assert result.status == 0


def test_what_carries_a_message_is_said(aces: Aces) -> None:
    """`aces spec show` and `aces spec explain` know the transport."""
    assert (
        "carried by     fast packet, packets of up to 223 bytes" in aces("spec", "show", SPEC, "Position").out
    )
    explained = aces("spec", "explain", SPEC, f"{FIRST},{LAST},{LAST}").out
    assert "Position(source=5, sid=1, latitude=54.3" in explained
    assert "malformed: no first frame" in explained


def test_the_screen_has_rows_of_packets() -> None:
    """A packet is one repetition of its row, with its fields; frames that open one are none."""
    scanner = runpy.run_path(str(SPEC))["fast_packet_device"].scanner(include_unknown=True)
    made = Model(scanner, name="can0")
    first, last = (
        Frame(int(text[:8], 16), bytes.fromhex(text[9:]), is_extended_id=True) for text in (FIRST, LAST)
    )
    made.feed(heard(first))
    assert made.rows == {}
    made.feed(heard(last, first, last, last))
    assert sorted((row.name, row.count) for row in made.rows.values()) == [("Position", 2), ("malformed", 1)]


ECU = """
from construct import Byte, Const, GreedyBytes, Struct
from aces_bus.protocol import IsoTp, Protocol

ecu = Protocol("ecu", link="can")
carrier = IsoTp(to_device=0x7E0, from_device=0x7E8, timeout_s={timeout_s})
Write = ecu.message("Write", transport=carrier, direction="to device",
    payload=Struct(Const(0x2E, Byte), "data" / GreedyBytes))
ecu.message("Written", transport=carrier, direction="from device", reply_to=Write,
    payload=Struct(Const(0x6E, Byte), "data" / GreedyBytes))
"""


def spec_of(folder: Path, timeout_s: float) -> Path:
    """The spec, with so much time between two frames."""
    path = folder / "ecu.py"
    path.write_text(ECU.format(timeout_s=timeout_s), encoding="utf-8")
    return path


WRITE = ("send", "Write", "data=" + "AB" * 30)


@pytest.mark.slow
def test_a_packet_waits_for_flow_control_and_obeys_it(
    aces: Aces, node: Node, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Its first frame; then as many as the receiver says; with --reply a long answer is let go on, and printed."""
    seen: list[str] = []

    def until(count: int) -> None:
        while len(seen) < count:
            seen.extend(bytes(m.data).hex()[:2] for m in node.received(WAIT_S))

    def receive() -> None:
        until(1)
        assert node.received(0.2) == []  # it waits
        node.send(0x7E8, "31 00 00")  # patience
        node.send(0x7E8, "30 02 00")
        until(3)
        assert node.received(0.2) == []
        node.send(0x7E8, "30 00 00")
        until(5)
        node.send(0x7E8, "10 0A 6E 01 02 03 04 05")
        until(6)
        node.send(0x7E8, "21 06 07 08 09")

    opened = Opened(monkeypatch)
    opened.then(receive)
    result = aces(*WRITE, "-p", spec_of(tmp_path, 60), *node.options, "--tx", "--reply", "60s")
    opened.join()
    assert seen == ["10", "21", "22", "23", "24", "30"]
    assert "data=01 02 03 04 05 06 07 08 09" in result.out
    assert (result.status, result.summary["sent"], result.summary["replies"]) == (0, 6, 1)


@pytest.mark.parametrize(
    ("answer", "said"), [("", "gave no go-ahead in time"), ("32 00 00", "its receiver cannot take it")]
)
def test_a_packet_that_may_not_go_on_is_status_1(
    aces: Aces, node: Node, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, answer: str, said: str
) -> None:
    """Why is said, and nothing but the first frame has left."""

    def receive() -> None:
        node.received(WAIT_S)
        if answer:
            node.send(0x7E8, answer)

    opened = Opened(monkeypatch)
    opened.then(receive)
    result = aces(*WRITE, "-p", spec_of(tmp_path, 60 if answer else 0.1), *node.options, "--tx")
    opened.join()
    assert (result.status, result.summary["sent"]) == (1, 1)
    assert any(said in one for one in result.messages)
