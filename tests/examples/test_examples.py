"""Each example runs and prints what its comments promise."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

FOLDER = Path(__file__).resolve().parents[2] / "examples"
Run = Callable[..., list[str]]


def test_every_example_is_run_here() -> None:
    """No example is left to rot."""
    tests = FOLDER.parent / "tests"
    tested = " ".join(path.read_text(encoding="utf-8") for path in tests.rglob("test_*.py"))
    missing = {path.name for path in FOLDER.glob("*.py") if f'"{path.name}"' not in tested}
    assert missing == set()


def test_a_spec_of_ones_own(run: Run) -> None:
    """A spec of ten lines encodes, decodes, says why a frame is none of its messages, and refuses what does not fit."""
    frame, *records = run("own_spec.py")
    assert frame.split()[-1] == "a5"
    assert records == [
        "Weight(node=3, weight=12.5, state={stable}) stable",
        "malformed: length 2, Weight has 5 bytes d430",
        "unknown ",
        "total=3 decoded=1 unknown=1 malformed=1 records=1",
        "Tare: node: 16 is not one of 1…15",
    ]


def test_a_fast_packet_device(run: Run) -> None:
    """A message of two frames, one of one frame between them, and the first frame of a packet that goes on no more."""
    assert run("fast_packet_device.py") == [
        r"Wind(source=5, sid=1, speed=7.5, angle=1.2, reference=2, reserved=b'\x00\x00') 1",
        "Position(source=5, sid=1, latitude=54.3, longitude=10.1, satellites=9) 2",
        "Unknown(reason='pending', raw=200a02c0855d2040) 1",
        "total=4 decoded=3 pending=1 records=2",
    ]


def test_encoding(run: Run) -> None:
    """The three ways of sending a goal give the bytes of the manual's layout."""
    assert run("encode_packet.py") == [
        "FF FF 01 05 03 1E F6 01 E1",
        "FF FF 01 05 03 1E F6 01 E1",
        "FF FF FE 0A 83 1E 02 47 10 02 60 00 02 99",
        "register goal_position: 301 ° is outside 0…300 °",
    ]


def test_decoding_a_capture(run: Run) -> None:
    """A servo's answers come out in degrees and rpm, an overload by its name; either file format will do."""
    *lines, counts = run("decode_capture.py")
    assert lines[0].split() == ["119", "88.0", "°", "0.0", "rpm"]
    assert len(lines) == 31
    assert [line.split()[-1] for line in lines if not line.endswith("rpm")] == ["overload"]
    assert counts == "total=1627 decoded=1601 unknown=6 malformed=1 skipped=14 pending=5 records=144"
    raw = str(FOLDER / "captures" / "robotis_session.bin")
    assert run("decode_capture.py", raw) == [*lines, counts]
    assert len(run("decode_capture.py", raw, "1")) == 32
