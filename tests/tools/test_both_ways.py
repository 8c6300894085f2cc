"""A serial recording that says which way bytes went: two streams, and replies that find their requests."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from aces_bus.recordings.base import Chunk
from aces_bus.recordings.write import open_writer
from tests.tools.conftest import Aces

SPEC = """
from construct import Byte, Int16ul, Struct
from aces_bus.protocol import InvertedSum, Protocol
probe = Protocol("probe", link="serial")
packet = probe.framing(sync=b"\\xaa", header=Struct("kind" / Byte), size=5, check=InvertedSum())
ask = packet("Ask", match={"kind": 1}, payload=Struct("what" / Byte, "rest" / Byte), direction="to device")
for what, name in ((1, "Speed"), (2, "Angle")):
    packet(name, match={"kind": 2}, payload=Struct(name.lower() / Int16ul), direction="from device",
           reply_to=ask.where(what=what))
"""


def packet(kind: int, *rest: int) -> bytes:
    """A packet of the invented probe."""
    body = bytes([kind, *rest])
    return b"\xaa" + body + bytes([~sum(body) & 0xFF])


@pytest.fixture
def session(tmp_path: Path) -> tuple[Path, Path]:
    """Two questions, each with its answer, the bytes of both ways cut anywhere; and one answer that nobody asked for."""
    spec = tmp_path / "probe.py"
    spec.write_text(SPEC)
    path = tmp_path / "session.slog"
    with open_writer(str(path)) as log:
        for number, what in enumerate((2, 1)):
            ask, answer = packet(1, what, 0), packet(2, number + 5, 0)
            log.write(Chunk(ask[:2], 10.0 + number, "to device"))
            log.write(Chunk(ask[2:], 10.1 + number, "to device"))
            log.write(Chunk(answer[:3], 10.2 + number, "from device"))
            log.write(Chunk(answer[3:], 10.3 + number, "from device"))
        log.write(Chunk(packet(2, 9, 0), 12.0, "from device"))
    return path, spec


EXPECTED = [
    ("Ask", {"what": 2, "rest": 0}),
    ("Angle", {"what": 2, "angle": 5}),
    ("Ask", {"what": 1, "rest": 0}),
    ("Speed", {"what": 1, "speed": 6}),
]


def test_an_answer_finds_its_question_on_the_other_way(session: tuple[Path, Path], aces: Aces) -> None:
    """No --direction is needed; what only the question tells is told, and what nobody asked for says so."""
    path, spec = session
    done = aces("decode", path, "-p", spec, "--format", "jsonl")
    rows = [json.loads(line) for line in done.out.splitlines()]
    assert [(row["message"], row["fields"]) for row in rows[:4]] == EXPECTED
    assert [row["direction"] for row in rows[:4]] == ["to device", "from device"] * 2
    assert rows[4]["reason"] == "unknown: needs request Ask"
    assert done.summary == {
        "bytes": 25, "decoded": 20, "unknown": 5, "malformed": 0, "skipped": 0, "filtered": 0, "pending": 0, "records": 4,
    }  # fmt: skip


def test_tables_say_the_same(session: tuple[Path, Path], tmp_path: Path, aces: Aces) -> None:
    """The columnar way pairs them too."""
    sqlite3 = pytest.importorskip("sqlite3")
    path, spec = session
    out = tmp_path / "session.sqlite"
    done = aces("decode", path, "-p", spec, "-o", out)
    assert done.summary["records"] == 4
    assert done.summary["unknown"] == 5
    with sqlite3.connect(out) as database:
        for message, fields in EXPECTED:
            name, value = list(fields.items())[-1]
            assert value in {row[0] for row in database.execute(f"select {name} from {message}")}


def test_a_plot_has_answers_and_times(session: tuple[Path, Path], aces: Aces) -> None:
    """Each packet at the time of the chunk that completed it, each answer as its question says."""
    path, spec = session
    done = aces("plot", path, "-p", spec, "--list")
    rows = {line.split()[0]: line.split()[1:4] for line in done.out.splitlines()[1:]}
    assert rows["Angle.angle"] == ["1", "5", "5"]
    assert rows["Speed.speed"] == ["1", "6", "6"]
    late = aces("plot", path, "-p", spec, "--list", "--from", "1.05")
    shown = {line.split(".")[0] for line in late.out.splitlines()[1:]}
    assert shown == {"Ask", "Speed"}
    drawn = aces("plot", path, "-p", spec, "Ask.what", "-", "Speed.speed", "Angle.angle")
    assert drawn.out.splitlines()[-2].split()[0] == "0.2"  # zero is the first chunk: 0.1 s to 1.3 s
