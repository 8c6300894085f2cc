"""Recordings of a truck that differ from one another, in five formats; and what a dataset holds of them."""

from __future__ import annotations

import random
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from aces_bus import Frame, FrameTable
from aces_bus.recordings.write import open_writer
from aces_tools.main import main

FORMS = (".log", ".blf", ".asc", ".mf4", ".pcapng")
#: 2026-11-22 23:59:58 UTC: recordings of a few seconds go over midnight.
LATE_S = 1_795_391_998

TRUCK = """\
VERSION ""
BS_:
BU_: Truck
BO_ 100 Speed: 8 Truck
 SG_ speed : 0|16@1+ (0.01,0) [0|655.35] "km/h" Truck
 SG_ load : 16|16@1- (0.1,-20) [-3296.8|3256.7] "kg" Truck
 SG_ gear : 32|4@1+ (1,0) [0|15] "" Truck
BO_ 200 Brake: 4 Truck
 SG_ pressure : 0|16@1+ (1,0) [0|65535] "kPa" Truck
 SG_ count : 16|8@1+ (1,0) [0|255] "" Truck
VAL_ 100 gear 0 "neutral" 1 "low" 2 "high" ;
"""


def frames_of(number: int, count: int) -> Iterator[Frame]:
    """The frames of recording `number`; some are of no message."""
    chance = random.Random(number)
    start = LATE_S + number % 7 - 3
    for place in range(count):
        identifier = chance.choice((100, 100, 200, 300))
        data = chance.randbytes(4 if identifier == 200 else 8)
        yield Frame(identifier, data, start + place * 0.02, str(number % 2), is_rx=True)


def record(folder: Path, number: int, count: int = 60, form: str = "") -> Path:
    """Recording `number`, in one of five formats unless `form` is its suffix."""
    path = folder / f"drive-{number:03}{form or FORMS[number % len(FORMS)]}"
    with open_writer(path) as writer:
        writer.write(FrameTable.from_frames(list(frames_of(number, count))))
    return path


def truck(folder: Path) -> str:
    """The truck's database."""
    path = folder / "truck.dbc"
    path.write_text(TRUCK)
    return str(path)


def dataset_rows(dataset: Path) -> dict[str, list[dict[str, Any]]]:
    """All rows of a fleet's dataset by message, in the order of their recordings."""
    import pyarrow.dataset as ds

    found: dict[str, list[dict[str, Any]]] = {}
    for folder in sorted(dataset.iterdir()):
        if folder.name == "_fleet":
            continue
        table = ds.dataset(folder, partitioning="hive").to_table()
        rows = table.to_pylist()
        for row in rows:
            day = row.pop("utc_day", None)
            assert day is None or str(row["time"])[:10] == str(day)
        if rows:
            found[folder.name] = _sorted(rows)
    return found


def rows_of_one_process(
    inputs: list[Path], protocol: str, folder: Path, *options: str
) -> dict[str, list[dict[str, Any]]]:
    """What `aces decode` writes of the recordings, in one process."""
    from pyarrow import parquet

    out = folder / "one.parquet"
    assert main(["decode", *map(str, inputs), "-p", protocol, "-o", str(out), "-q", *options]) in (0, 2)
    found: dict[str, list[dict[str, Any]]] = {}
    for file in sorted(out.iterdir()):
        if file.stem == "_lost":
            continue
        rows = [{"source": str(inputs[0]), **row} for row in parquet.read_table(file).to_pylist()]
        found[file.stem] = _sorted(rows)
    return found


def _sorted(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    return sorted(rows, key=lambda row: (row["source"], row["time"]))


def needs_fleet() -> None:
    """Skip the module where the extra [fleet] is not installed."""
    for name in ("pyarrow", "fsspec", "cantools"):
        pytest.importorskip(name)
