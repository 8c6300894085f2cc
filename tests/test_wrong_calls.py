"""Wrong calls from Python say what would work, not a bare TypeError or KeyError; what is printed stays short."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import can
import pytest

from aces_bus import decode, load_protocol, make_scanner
from aces_bus.errors import CallerError, FieldError, UnknownNameError
from aces_bus.protocol import BitLayout, Protocol, bits
from aces_tools.output import SpeltOut


def test_one_frame_is_not_several() -> None:
    """`scanner.feed(message)` says how several are given."""
    message: Any = can.Message(arbitration_id=1)
    with pytest.raises(CallerError, match=r"feed takes several frames, not one Message: feed\(\[frame\]\)"):
        load_protocol("odrive").scanner().feed(message)


def test_a_protocol_is_not_its_variants() -> None:
    """`make_scanner` says what it takes to whoever gives it a protocol, a name or a single variant."""
    odrive: Any = load_protocol("odrive")
    calls: list[tuple[Any, str]] = [
        ([odrive], "Protocol"),
        ("odrive", "str"),
        (odrive.variant(), "Variant"),
        (["odrive"], "str"),
    ]
    for given, what in calls:
        with pytest.raises(CallerError, match=f"make_scanner takes a list of variants, not {what}: "):
            make_scanner(given)


def test_a_column_s_name_is_proposed(tmp_path: Path) -> None:
    """A misspelt column raises with the nearest; a table's text is one line."""
    log = tmp_path / "walk.log"
    log.write_text("(1.0) can0 063#78000000FCFFFFFF\n")
    tables: Any = decode(str(log), "hubo", configuration="hubo2plus")
    with pytest.raises(UnknownNameError, match="no message of hubo"):
        tables[3]
    table = tables["Encoder"]
    with pytest.raises(
        UnknownNameError, match=r"no column of Encoder named 'postion.0'; did you mean 'position.0'"
    ):
        table["postion.0"]
    assert repr(table) == "<hubo Encoder: 1 rows of 3 columns (board, position.0, position.1)>"


def test_reserved_bits_are_no_missing_value() -> None:
    """An encoder asks for the fields that a caller gives, and for no reserved bits."""
    spec = Protocol("wrong_calls", link="can")
    spec.message("Lamp", id=0x10, payload=BitLayout(1, "level" / bits(3), "hue" / bits(2)))
    with pytest.raises(FieldError, match=r"no value given for hue$"):
        spec.encode("Lamp", level=1)


def test_a_terminal_gets_no_control_characters() -> None:
    """Lines for programs keep every byte in a file; on a terminal escape sequences of a payload are spelt out."""

    class Lines:
        def begin(self, source: str, link: str, start: float | None = None) -> bytes:
            return b"head\n"

        def items(self, items: Any) -> bytes:
            return "a,\x1b[2J\x9b,é\n".encode()

    writer = SpeltOut(Lines(), "\\x{:02x}")
    assert writer.begin("walk.log", "can") == b"head\n"
    assert writer.items([]).decode() == "a,\\x1b[2J\\x9b,é\n"
