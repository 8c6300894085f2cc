"""`aces spec explain`: captures of every kind, places in them, text, JSON and pictures."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from aces_bus import load_protocol
from aces_tools.console import Output, terminal_width

from .conftest import Aces

READ = "FF FF 01 04 02 00 32 C6"
STATUS = "FF FF 01 03 00 20 DB"


def test_a_packet_from_the_command_line(aces: Aces) -> None:
    """Part by part: what it is, what was read, who died of it, what is left, and the verdict."""
    result = aces("spec", "explain", "robotis", f"hex:{READ}", "--direction", "to")
    assert result.status == 0
    lines = result.out.splitlines()
    assert lines[0] == f"offset 0…7  {READ}"
    assert "  3  04  length       ✗ Ping, Action, Reset: length 6 bytes, not 8" in lines
    assert "                      ○ possible: Read, Write, RegWrite" in lines
    assert "  6  32  count        count = 50" in lines
    assert "  → robotis.Read(id=1, start=0, count=50)" in lines
    assert lines[-1] == "    the search goes on at offset 8"


def test_a_failure_says_where_the_search_goes_on(aces: Aces) -> None:
    """A wrong check costs one byte; what was wanted and what came are both named."""
    result = aces("spec", "explain", "robotis", f"hex:{READ[:-2]}C7", "--direction", "to")
    assert result.status == 1
    assert "✗ Read: check C6, not C7" in result.out
    assert "→ malformed: checksum; the search goes on at offset 1" in result.out
    assert "FF 01 04 02 00 32 C7: no packet begins here" in result.out


def test_frames_from_the_command_line(aces: Aces) -> None:
    """Several frames, a request first: the reply is told by it."""
    frames = "001#05 24 07; 1C5#C8 00 01 00 F4 01 A0 4F"
    result = aces("spec", "explain", "hubo", frames)
    assert result.status == 0
    assert "frame 0  001#05 24 07" in result.out
    assert "    answers GetParameters(board=5, selector=7)" in result.out
    assert "what was asked last, GetParameters, gives Parameters1" in result.out
    alone = aces("spec", "explain", "hubo", frames.partition("; ")[2])
    assert alone.status == 1
    assert "unknown: needs request GetParameters|SendCurrent" in alone.out


@pytest.mark.slow
def test_a_place_in_a_recording(aces: Aces, tmp_path: Path) -> None:
    """`--at` takes the decision that has this byte; what was asked before it still counts."""
    file = tmp_path / "wire.bin"
    good = bytes.fromhex(READ), bytes.fromhex(STATUS)
    file.write_bytes(good[0] + good[1] + b"\x00" + (good[0] + good[1]) * 200)
    end = file.stat().st_size
    result = aces("spec", "explain", "robotis", file, "--direction", "both", "--at", str(end - 2))
    assert result.status == 0
    assert result.out.startswith(f"offset {end - 7}…{end - 1}")
    assert "answers Read(id=1, start=0, count=50)" in result.out
    skipped = aces("spec", "explain", "robotis", file, "--direction", "both", "--at", "0xF")
    assert "→ skipped; the search goes on at offset 16" in skipped.out
    beyond = aces("spec", "explain", "robotis", file, "--direction", "both", "--at", str(end))
    assert beyond.status == 2
    assert f"has {end} bytes" in beyond.err


def test_a_frame_of_a_recording(aces: Aces, tmp_path: Path) -> None:
    """`--at` counts frames from 0; requests among those before are remembered."""
    file = tmp_path / "walk.log"
    lines = ["(0.0) can0 063#78000000FCFFFFFF"] * 50 + [
        "(0.1) can0 001#052407",
        "(0.2) can0 1C5#C8000100F401A04F",
    ]
    file.write_text("\n".join(lines) + "\n")
    result = aces("spec", "explain", "hubo", file, "--at", "51")
    assert result.status == 0
    assert "frame 51  1C5#C8 00 01 00 F4 01 A0 4F" in result.out
    assert "answers GetParameters(board=5, selector=7)" in result.out
    several = aces("spec", "explain", "hubo", file, "--at", "0", "--count", "3").out
    assert several.count("→ hubo.Encoder(board=3, position=[120, -4])") == 3
    assert "has 52 frames" in aces("spec", "explain", "hubo", file, "--at", "52").err


def test_a_frame_far_into_a_recording(aces: Aces, tmp_path: Path) -> None:
    """Frames are read one by one, whatever the recording's size; standard input and packed files too."""
    import gzip

    file = tmp_path / "long.log.gz"
    line = "(0.0) can0 063#78000000FCFFFFFF\n"
    file.write_bytes(gzip.compress((line * 60_000 + "(0.1) can0 064#01000000FCFFFFFF\n").encode(), 1))
    result = aces("spec", "explain", "hubo", file, "--at", "60000")
    assert result.status == 0
    assert "→ hubo.Encoder(board=4, position=[1, -4])" in result.out


def test_both_directions_of_a_recording(aces: Aces, tmp_path: Path) -> None:
    """A log that says which way bytes went has a stream each way; what was asked is not a part of the replies' offsets."""
    file = tmp_path / "session.slog"
    lines = [f"(0.0) > [8] {READ.replace(' ', '')}", f"(0.001) < [7] {STATUS.replace(' ', '')}"]
    file.write_text("# aces serial capture 1\n" + "\n".join(lines) + "\n")
    result = aces("spec", "explain", "robotis", file)
    assert result.status == 0
    assert result.out.startswith("to device:\n")
    assert "from device:\noffset 0…6" in result.out
    assert result.out.count("→ robotis.") == 2


def test_json_holds_everything(aces: Aces) -> None:
    """Each attempt with its parts, deaths, readings, the record and where the search goes on."""
    out = aces("spec", "explain", "robotis", f"hex:{STATUS}", "--direction", "from", "--json").out
    (attempt,) = json.loads(out)
    assert (attempt["message"], attempt["resumes"], attempt["raw"]) == ("Status", 7, "ffff01030020db")
    assert attempt["fields"] == {"id": 1, "error": [], "parameters": "20"}
    assert [step["part"] for step in attempt["steps"]] == STATUS.split()
    assert all(set(step) == {"place", "part", "what", "read", "died", "alive"} for step in attempt["steps"])
    (frame,) = json.loads(aces("spec", "explain", "hubo", "063#78000000FCFFFFFF", "--json").out)
    assert (frame["frame"], frame["id"], frame["fields"]) == (0, 0x63, {"board": 3, "position": [120, -4]})
    assert len(frame["steps"][0]["died"]) == len(load_protocol("hubo").variant().messages) - 1


def test_a_picture_is_svg(aces: Aces, tmp_path: Path) -> None:
    """Well-formed, with every part and the verdict in it; never over a file that is read."""
    file = tmp_path / "why.svg"
    result = aces("spec", "explain", "robotis", f"hex:00{READ}", "--direction", "to", "--svg", file)
    assert result.status == 1
    texts = [one.text or one[0].tail for one in ET.parse(file).iter("{http://www.w3.org/2000/svg}text")]
    assert None not in texts
    assert {"32", "C6", "Read", "SyncWrite"} <= set(texts)
    assert any("✗" in str(text) for text in texts)
    assert "→ Read(id=1, start=0, count=50)" in texts


def test_narrow_terminals(aces: Aces, monkeypatch: pytest.MonkeyPatch) -> None:
    """No line is wider than the terminal, down to forty columns."""
    monkeypatch.setenv("COLUMNS", "44")
    monkeypatch.setattr(Output, "is_terminal", property(lambda _: True))
    monkeypatch.setenv("NO_COLOR", "1")
    assert terminal_width() == 44
    for arguments in (
        ["robotis", f"hex:{READ}", "--direction", "to"],
        ["hubo", "1C5#C8 00 01 00 F4 01 A0 4F"],
    ):
        out = aces("spec", "explain", *arguments).out
        assert "\x1b[" not in out
        assert max(map(len, out.splitlines())) <= 44


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["robotis", "hex:FF"], "say which way they went: --direction"),
        (["robotis", "hex:XY", "--direction", "to"], "not hexadecimal bytes"),
        (["robotis", "001#00"], "no protocol that was named is for CAN"),
        (["hubo", "hex:00"], "hex: is for bytes of a stream"),
        (["hubo", "001#0"], "an odd number of digits"),
        (["hubo", "nofile.log"], "no such file"),
        (["nix", "001#00"], "no protocol named 'nix'"),
        (["hubo", "001#00", "--count", "0"], "is not a whole number from 1 on"),
        (["hubo", "001#00", "--at", "-1"], "is not a whole number from 0 on"),
    ],
)
def test_wrong_calls(aces: Aces, arguments: list[str], says: str) -> None:
    """One line that says what would have worked; status 2."""
    result = aces("spec", "explain", *arguments)
    assert result.status == 2
    assert says in result.err


def test_nothing_is_nothing(aces: Aces) -> None:
    """No bytes, no parts, no fault."""
    result = aces("spec", "explain", "robotis", "hex:", "--direction", "to")
    assert (result.status, result.out) == (0, "")
    assert "nothing to explain" in result.err
