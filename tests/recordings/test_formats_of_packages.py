"""Formats of recordings that installed packages bring: recognized, read, written; a bad one costs only itself."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from aces_bus import open_recording
from aces_bus.errors import CaptureError
from aces_bus.plugins import installed_items
from aces_bus.recordings.open import formats
from aces_bus.recordings.write import open_writer, writer_formats

THEIRS = """
from aces_bus.recordings.base import CanRecording
from aces_bus.frames import Frame
from aces_bus.recordings.open import RecordingFormat
from aces_bus.recordings.write import FormatOut
from aces_bus.recordings.write.candump import CandumpWriter


class TheirCapture(CanRecording):
    format = "theirs"

    def _lists(self):
        number, data = self._source.head().split()[1:]
        yield [Frame(int(number, 16), bytes.fromhex(data.decode()))]


READER = RecordingFormat("theirs", "THEIR log", "can", lambda head: head.startswith(b"THEIR"), "their_format:TheirCapture")
WRITER = FormatOut("theirs", (".their",), "THEIR log", "can", "their_format", "CandumpWriter", is_text=True)
SAME = RecordingFormat("mf4", "another MF4", "can", lambda head: False, "their_format:TheirCapture")
"""


@pytest.fixture
def their_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A distribution on the path; the test writes its entry points."""
    monkeypatch.setattr(sys, "path", [*sys.path, str(tmp_path)])
    info = tmp_path / "their_format-1.0.dist-info"
    info.mkdir()
    (tmp_path / "their_format.py").write_text(THEIRS, encoding="utf-8")
    installed_items.cache_clear()
    yield info / "entry_points.txt"
    sys.modules.pop("their_format", None)
    installed_items.cache_clear()


def test_a_format_of_another_package(their_package: Path, tmp_path: Path) -> None:
    """It is listed, chosen by content and by suffix."""
    their_package.write_text(
        "[aces_bus.readers]\ntheirs = their_format:READER\n\n[aces_bus.writers]\ntheirs = their_format:WRITER\n"
    )
    assert formats()["theirs"] == "THEIR log"
    assert writer_formats()["theirs"].suffixes == (".their",)
    log = tmp_path / "walk.any"
    log.write_bytes(b"THEIR 123 0a0b\n")
    with open_recording(log, link="can") as recording:
        assert [(frame.arbitration_id, frame.data.hex()) for frame in recording] == [(0x123, "0a0b")]
    with open_writer(tmp_path / "walk.their") as writer:
        assert writer.format == "theirs"


@pytest.mark.parametrize(
    ("points", "said"),
    [
        ("theirs = their_format:MISSING", "module 'their_format' has no attribute 'MISSING'"),
        ("theirs = their_nothing:READER", "No module named 'their_nothing'"),
        ("theirs = their_format:WRITER", "is left out"),
        ("theirs = their_format:SAME", "'mf4' is left out: another package has that name"),
    ],
)
def test_a_bad_format_costs_only_itself(their_package: Path, tmp_path: Path, points: str, said: str) -> None:
    """It is left out with a warning that names its package; the others are read."""
    their_package.write_text(f"[aces_bus.readers]\n{points}\n")
    log = tmp_path / "walk.log"
    log.write_text("no recording at all\n")
    with (
        pytest.warns(UserWarning, match="their-format: aces_bus.readers") as warned,
        pytest.raises(CaptureError),
    ):
        open_recording(log, link="can")
    assert said in str(warned[0].message)
    assert formats()["mf4"] == "ASAM MDF 4 bus log"
    assert "theirs" not in formats()
