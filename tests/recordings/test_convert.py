"""`convert(source, target)`: the same recording in another format; what is lost is told."""

from __future__ import annotations

import os
from pathlib import Path

import can
import pytest

from aces_bus import convert, decode, open_recording
from aces_bus.errors import AcesError, CallerError

WALK = Path("examples/captures/hubo2plus.log")


def test_the_same_frames_in_another_format(tmp_path: Path) -> None:
    """python-can reads what was written, and it decodes to the same counts."""
    target = tmp_path / "walk.blf"
    convert(WALK, target)
    theirs = list(can.BLFReader(target))
    with open_recording(WALK, link="can") as ours:
        assert [(m.arbitration_id, bytes(m.data)) for m in theirs] == [
            (f.arbitration_id, bytes(f.data)) for f in ours
        ]
    assert decode(target, "hubo").counts == decode(WALK, "hubo").counts


def test_what_is_lost_is_told(tmp_path: Path) -> None:
    """What the format does not hold and lines that cannot be read are warnings, at the caller's line."""
    with pytest.warns(UserWarning, match=r"walk\.csv: csv does not hold 2 channel names") as told:
        convert(WALK, tmp_path / "walk.csv")
    assert told[0].filename == __file__
    source = tmp_path / "odd.log"
    source.write_text("(1.0) can0 123#00\nodd\n")
    with pytest.warns(UserWarning, match=r"odd\.log: 1 lines cannot be read: 2: "):
        convert(source, tmp_path / "new.log")


def test_a_wrong_target_costs_nothing(tmp_path: Path) -> None:
    """A target of no format, of other traffic, or the source itself is refused, and nothing is written."""
    source = tmp_path / "walk.log"
    source.write_bytes(WALK.read_bytes())
    for target, words in (
        ("walk.xyz", "suffix names no format"),
        ("walk.slog", "serial"),
        ("walk.log", "walk.log"),
    ):
        with pytest.raises(AcesError, match=words):
            convert(source, tmp_path / target)
    with pytest.raises(CallerError, match="standard output"):
        convert(source, "-")
    assert os.listdir(tmp_path) == ["walk.log"]
    assert source.read_bytes() == WALK.read_bytes()
