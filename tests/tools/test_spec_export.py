"""`aces spec export`: what is printed, what is said of losses, and what is refused."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from aces_bus import Frame
from aces_bus.protocol.exchange import load_database
from tests.tools.conftest import Aces


def test_dbc_is_printed_and_losses_are_said(arm: str, aces: Aces) -> None:
    """The text on stdout, each loss on a line of stderr with message, field and reason; status 0."""
    pytest.importorskip("cantools")
    result = aces("spec", "export", arm, "--format", "dbc")
    assert result.status == 0
    assert result.out.startswith('VERSION "arm:new@two"')
    assert (
        "arm.Pages.split: one number in several places: its pieces are kept as raw" in result.err.splitlines()
    )
    assert "arm.Ask: a remote frame: left out" in result.err.splitlines()
    assert "arm.Limits: differs from Gains in its request alone: left out" in result.err.splitlines()
    assert result.messages[-1].startswith("arm:new@two: ")
    assert aces("spec", "export", arm, "--format", "dbc", "--strict").status == 1


def test_dbc_loads_as_a_protocol(arm: str, tmp_path: Path, aces: Aces) -> None:
    """With -o the file is Windows-1252, as other tools read it, and our own reader takes it without a complaint."""
    pytest.importorskip("cantools")
    path = tmp_path / "arm.dbc"
    assert aces("spec", "export", arm, "--format", "dbc", "-o", path).out == ""
    assert "°".encode("cp1252") in path.read_bytes()
    imported = load_database(path)
    assert not imported.losses
    (record,) = imported.protocol.scanner().feed([Frame(0x301, bytes.fromhex("0201009600000040"))])
    assert (record.mode, record.error_hot, record.angle, record.load) == ("torque", 1, 1.5, 2.0)


def test_dialect_and_configuration_choose(spec: Path, aces: Aces) -> None:
    """NAME:DIALECT@CONFIGURATION, as -p takes it."""
    pytest.importorskip("cantools")
    text = aces("spec", "export", f"{spec}:arm:old@three", "--format", "dbc").out
    assert "BO_ 96 Encoder3_0:" in text
    assert "State" not in text


def test_json_has_text_and_losses(arm: str, aces: Aces) -> None:
    """One object on stdout, nothing on stderr."""
    result = aces("spec", "export", arm, "--format", "wireshark", "--json")
    about = json.loads(result.out)
    assert result.err == ""
    assert about["protocol"] == "arm:new@two"
    assert about["text"].startswith("-- arm:new@two as a Wireshark dissector")
    assert isinstance(about["losses"], list)


def test_dissector_of_a_stream_begins_with_what_is_asked(line: str, tmp_path: Path, aces: Aces) -> None:
    """Port and direction are what its preferences begin with."""
    path = tmp_path / "line.lua"
    result = aces(
        "spec", "export", line, "--format", "wireshark", "--port", "5000", "--direction", "from", "-o", path
    )
    assert result.messages == [f"wrote {path}"]
    text = path.read_text(encoding="utf-8")
    assert "  direction = 2,\n  port = 5000," in text


def test_markdown_is_a_page(arm: str, aces: Aces) -> None:
    """Overview, map, messages with pictures, fields and values."""
    text = aces("spec", "export", arm, "--format", "markdown").out
    assert text.startswith("# arm\n\nAn arm for tests.\n")
    assert "| `0x060 + board` | [Encoder](#encoder) |" in text
    assert "| `angle` | byte 2…3 | int16 be | ° | 0.01 |" in text


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("{line}", "--format", "dbc"), "a DBC is for CAN"),
        (("{arm}", "--format", "dbc", "-m", "Nothing"), "no message of arm:new@two named 'Nothing'"),
        (("{arm}", "--format", "markdown", "-m", "State"), "-m is for --format dbc and c"),
        (("{arm}", "--format", "c"), "name the source: -o FILE.c"),
        (("{arm}", "--format", "c", "-o", "x.h"), "name it .c"),
        (("obd2", "--format", "c", "-o", "x.c"), "none of its messages can be said in C; first: "),
        (("{arm}", "--format", "wireshark", "--port", "5000"), "for streams"),
        (("{line}", "--format", "wireshark", "--port", "70000"), "ports are 1…65535"),
        (("{arm}", "--format", "xml"), "no --format named 'xml' (there are: c, dbc, markdown, wireshark)"),
        (("{arm}", "--format", "dbc", "-o", "/nonexistent/x.dbc"), "cannot be written"),
        (("nothing", "--format", "dbc"), "no protocol named 'nothing'"),
        (("{arm}",), "--format"),
    ],
)
def test_wrong_calls(arguments: tuple[str, ...], said: str, arm: str, line: str, aces: Aces) -> None:
    """One line that says what, status 2."""
    pytest.importorskip("cantools")
    result = aces("spec", "export", *(one.format(arm=arm, line=line) for one in arguments))
    assert result.status == 2
    assert said in result.err
    assert result.out == ""


def test_c_is_a_source_and_its_header(arm: str, tmp_path: Path, aces: Aces) -> None:
    """Two files of one name; what is left out is said, and is in the header."""
    path = tmp_path / "arm_can.c"
    result = aces("spec", "export", arm, "--format", "c", "-o", path)
    assert result.status == 0
    assert '#include "arm_can.h"' in path.read_text(encoding="utf-8")
    header = (tmp_path / "arm_can.h").read_text(encoding="utf-8")
    assert "#ifndef ARM_CAN_H" in header
    assert "int arm_state_unpack(" in header
    assert "arm.Gains: shows fields of its request: left out" in result.err
    assert "arm.Ask: a remote frame: left out" in result.err
    assert " *   Ask: a remote frame: left out" in header
    assert aces("spec", "export", arm, "--format", "c", "-o", path, "--strict").status == 1
    shown = aces("spec", "export", arm, "--format", "c", "--json", "-m", "State")
    assert "arm_state_pack" in json.loads(shown.out)["text"]
    assert "arm_pages" not in json.loads(shown.out)["header"]
