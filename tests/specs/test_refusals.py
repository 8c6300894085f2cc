"""The specs without one of their words: ambiguity is found when the message is declared, with a witness."""

from __future__ import annotations

import importlib
import re
import shutil
import sys
from pathlib import Path

import pytest

from aces_bus.errors import SpecError

FOLDER = Path(__file__).parent
SHIPPED = FOLDER.parents[1] / "protocols" / "aces_protocols"


def declare(spec: str, word: str, instead: str, where: Path) -> None:
    """Run a spec with one word of its source changed, in whichever of its files it is."""
    package = where / f"{spec}_without"
    file = FOLDER / f"{spec}.py"
    if file.exists():
        package.mkdir()
        shutil.copy(file, package / "spec.py")
    else:
        shutil.copytree(SHIPPED / spec, package)
    sources = {path: path.read_text(encoding="utf-8") for path in package.glob("*.py")}
    changed = next(path for path, source in sources.items() if word in source)
    changed.write_text(sources[changed].replace(word, instead, 1), encoding="utf-8")
    try:
        with pytest.MonkeyPatch.context() as patch:
            patch.syspath_prepend(where)
            importlib.import_module(f"{package.name}.spec")
    finally:
        for name in [one for one in sys.modules if one.partition(".")[0] == package.name]:
            del sys.modules[name]


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
    assert re.match(r".*_without.\w+\.py:\d+: ", text)


def test_an_unchanged_spec_is_declared_again(tmp_path: Path) -> None:
    """What the tests above change is what makes the difference."""
    for spec in ("mit_motor", "ubx", "automotive"):
        declare(spec, "from", "from", tmp_path)
