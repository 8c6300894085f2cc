"""`aces decode` without a protocol: what a recording holds, and what to type next."""

from __future__ import annotations

import gzip
import io
import sys
from pathlib import Path

import pytest

from tests.tools.conftest import Aces

#: So many identifiers have a line each.
MOST = 4096
CAPTURES = Path(__file__).resolve().parents[2] / "examples" / "captures"
LOG = """\
(1000.000) can0 123#0011
(1000.010) can0 123#0012
(1000.020) can0 123#001233
(1000.020) can1 123#0012
(1000.025) can0 00000123#
(1000.030) can0 123#0013
(1000.031) can0 20000004#0000000000000000
"""


@pytest.mark.slow
def test_frames_by_identifier(aces: Aces, tmp_path: Path) -> None:
    """Channel, identifier, number, period, lengths, and which bytes change; nothing fits, and that is said."""
    log = tmp_path / "a.log"
    log.write_text(LOG)
    result = aces("decode", log)
    assert result.status == 0
    lines = result.out.splitlines()
    assert lines[0] == f"{log}: 7 frames in 0.031 s on can0, can1"
    assert [line.split() for line in lines[2:7]] == [
        ["channel", "id", "frames", "period", "bytes", "changes"],
        ["can0", "004", "error", "1", "8", "........"],
        ["can0", "123", "4", "10", "ms", "2-3", ".xx"],
        ["can0", "00000123", "1", "0"],
        ["can1", "123", "1", "2", ".."],
    ]
    assert "no installed protocol fits" in lines[-1]


def test_as_json(aces: Aces, tmp_path: Path) -> None:
    """One object an identifier, for programs."""
    log = tmp_path / "a.log"
    log.write_text(LOG)
    first = aces("decode", log, "--format", "jsonl").objects[1]
    assert first == {
        "channel": "can0",
        "identifier": 0x123,
        "extended": False,
        "frames": 4,
        "period_ms": 10.0,
        "length": [2, 3],
        "changes": ".xx",
    }


@pytest.mark.slow
@pytest.mark.parametrize(
    ("file", "advice"),
    [
        ("hubo2plus.log", "100% is hubo@hubo2plus:"),
        ("adc.bin", "100% is minihubo_adc:"),
        ("robotis_session.dxconf.txt", "98% is robotis:"),
    ],
)
def test_what_fits_is_named(aces: Aces, file: str, advice: str) -> None:
    """The installed protocol that decodes most, and the call that does it, which works."""
    result = aces("decode", CAPTURES / file)
    advised = next(line for line in result.out.splitlines() if advice in line)
    call = advised.partition(":")[2].split()
    assert call[:2] == ["aces", "decode"]
    assert aces(*call[1:], "-q", "--direction", "both").status == 0


@pytest.mark.slow
def test_of_a_pipe(aces: Aces, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without a file standard input is read, with a protocol or without."""
    data = (CAPTURES / "hubo2plus.log").read_bytes()
    for options, head in ([], "channel"), (["-p", "hubo@hubo2plus", "-n", "3"], "0.000000"):
        monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(data)))
        result = aces("decode", *options)
        assert result.status == 0
        assert result.out.startswith("standard input")
        assert head in result.out
        assert not options or len(result.out.splitlines()) == 4
    monkeypatch.setattr(sys.stdin, "isatty", lambda: True, raising=False)
    result = aces("decode")
    assert result.status == 2
    assert "name a recording" in result.err


def test_filtered(aces: Aces) -> None:
    """`--filter` chooses frames here, too; what needs to know messages is refused."""
    result = aces("decode", CAPTURES / "hubo2plus.log", "--filter", "060:7FF")
    assert "100 frames" not in result.out
    assert "50 frames" in result.out
    result = aces("decode", CAPTURES / "hubo2plus.log", "--where", "a=1")
    assert (result.status, "--where needs a protocol" in result.err) == (2, True)


@pytest.mark.slow
def test_what_came_before_damage_is_shown(aces: Aces, tmp_path: Path) -> None:
    """Of a packed file that ends too early there is what could be read, beside the complaint."""
    log = tmp_path / "a.log.gz"
    log.write_bytes(gzip.compress(LOG.encode())[:-1])
    result = aces("decode", log, "--filter", "can1,123:7FF")
    assert (result.status, result.out.splitlines()[0]) == (2, f"{log}: 1 frame on can1")
    assert "the gzip data ends too early" in result.err


@pytest.mark.slow
def test_many_identifiers(aces: Aces, tmp_path: Path) -> None:
    """Only so many have a row; the frames of the others are counted."""
    log = tmp_path / "many.log"
    log.write_text("".join(f"(1.0) can0 {number:08X}#00\n" for number in range(MOST + 7)))
    result = aces("decode", log, "--format", "text")
    assert "and 7 frames of more than 4096 identifiers" in result.out


def test_no_recording(aces: Aces, tmp_path: Path) -> None:
    """What cannot be read is said, and the next file is read all the same."""
    log = tmp_path / "a.log"
    log.write_text(LOG)
    result = aces("decode", tmp_path / "nosuch.log", log)
    assert result.status == 2
    assert "nosuch.log" in result.err
    assert "7 frames" in result.out
