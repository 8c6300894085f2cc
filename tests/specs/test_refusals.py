"""The specs without one of their words: ambiguity is found when the message is declared, with a witness."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path

import pytest

from aces_bus.errors import SpecError

FOLDER = Path(__file__).parent
SHIPPED = FOLDER.parents[1] / "protocols" / "aces_protocols"


def declare(spec: str, word: str, instead: str, where: Path) -> None:
    """Run a spec's source with one word changed."""
    file = FOLDER / f"{spec}.py"
    source = (file if file.exists() else SHIPPED / spec / "spec.py").read_text(encoding="utf-8")
    assert word in source
    path = where / f"{spec}_without.py"
    path.write_text(source.replace(word, instead, 1), encoding="utf-8")
    found = importlib.util.spec_from_file_location(path.stem, path)
    assert found is not None
    assert found.loader is not None
    found.loader.exec_module(importlib.util.module_from_spec(found))


@pytest.mark.parametrize(
    ("spec", "word", "instead", "message"),
    [
        (
            "mit_motor",
            'overrides="Command",  # firmware',
            "# firmware",
            r"'Enable' is ambiguous with 'Command' .*both accept 001#FFFFFFFFFFFFFFFC",
        ),
        (
            "mit_motor",
            'overrides="Feedback",',
            "",
            r"'ReadFloatReply' is ambiguous with 'Feedback' .*both accept 000#",
        ),
        ("odrive_like", "remote=remote,", "", r"message 'EncoderEstimatesPoll' is declared twice|ambiguous"),
        (
            "odrive_like",
            'dialect="0.6",\n    payload=BitLayout',
            "payload=BitLayout",
            r"message 'Heartbeat' is declared twice",
        ),
        (
            "j1939_like",
            'overrides="ParameterGroup",',
            "",
            r"'Request' is ambiguous with 'ParameterGroup' .*both accept",
        ),
        (
            "dynamixel2",
            'overrides="Status",',
            "",
            r"'PingStatus' is ambiguous with 'Status' .*both accept FF FF FD 00",
        ),
        ("modbus_like", 'overrides="ReadAnswer",', "", r"'ReadForceTorque' is ambiguous with 'ReadAnswer'"),
        (
            "ubx",
            '"message_number" / Byte, "rate" / Byte)',
            '"message_number" / Byte)',
            r"'CfgMsgPoll' is ambiguous with 'CfgMsg' .*both accept B5 62",
        ),
        ("mavlink1", 'match={"message": number},', "", r"is seeded by message; match it"),
        ("mavlink1", "check_extra=bytes([extra]),", "", r"give Heartbeat its check_extra"),
        (
            "automotive",
            '"slip" / Quantity(bits(8, at=56,',
            '"slip" / Quantity(bits(8, at=48,',
            r"'slip' overlaps 'rear' .* at byte 6 bit",
        ),
        (
            "automotive",
            'Crc("CRC8-SAE-J1850"',
            'Crc("CRC8-SAE-J1580"',
            r"no CRC named 'CRC8-SAE-J1580' .*near: .*CRC8-SAE-J1850",
        ),
        ("nmea0183", "type=name,", 'type=b"GGA",', r"'RMC' is ambiguous with 'GGA' .*both accept 24 "),
    ],
)
def test_a_missing_word_is_found(spec: str, word: str, instead: str, message: str, tmp_path: Path) -> None:
    """The error says file and line, both messages and a witness."""
    with pytest.raises(SpecError) as caught:
        declare(spec, word, instead, tmp_path)
    text = str(caught.value)
    assert re.search(message, text, re.DOTALL), text
    assert re.match(r".*_without\.py:\d+: ", text)


def test_an_unchanged_spec_is_declared_again(tmp_path: Path) -> None:
    """What the tests above change is what makes the difference."""
    for spec in ("mit_motor", "ubx", "automotive"):
        declare(spec, "from", "from", tmp_path)
