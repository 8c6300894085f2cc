"""Tables on disk: how files are named, grow, are set aside and are written behind a decoder."""

from __future__ import annotations

import os
import sqlite3
from functools import partial
from pathlib import Path
from threading import Event
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from construct import Byte, Int32ul, Struct

from aces_bus import Frame, FrameTable, make_column_scanner
from aces_bus.errors import CallerError
from aces_bus.export import base as export_base
from aces_bus.export import files as export_files
from aces_bus.export import folder, open_export
from aces_bus.export.base import Naming
from aces_bus.export.behind import UNDER_WAY, Behind
from aces_bus.export.files import ExportFile, FilePool
from aces_bus.export.open import table_formats
from aces_bus.export.parquet import ParquetJournal
from aces_bus.export.sqlite import SqliteExport
from aces_bus.protocol import Protocol
from aces_bus.protocol.columns.arrow import (
    _series,  # pyright: ignore[reportPrivateUsage]  # no protocol has a switch that is absent in some frames
)
from aces_bus.protocol.columns.layout import Labels
from aces_lab.tables.mcap_file import McapWriter
from tests.export.test_exports import PLACES as PLACES
from tests.export.test_exports import many as many
from tests.export.test_exports import state as state
from tests.export.test_exports import tables as tables

pq = pytest.importorskip("pyarrow.parquet")
pa = pytest.importorskip("pyarrow")
arm = Protocol("shelf", link="can")
ARM = arm.variant()
each_format = pytest.mark.parametrize("form", table_formats())


@pytest.mark.parametrize("form", ["parquet", "npz", "sqlite"])
def test_what_waits_is_bounded(form: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """However much is written, no more than the budget waits; nothing is lost by it."""
    monkeypatch.setattr(export_base.Buffered, "budget", 100_000)
    most = 0
    with open_export(tmp_path / PLACES[form], variants=[ARM]) as export:
        assert isinstance(export, export_base.Buffered)
        for number in range(40):
            export.write(many(500, first=500 * number))
            most = max(most, export.waiting)
        assert export.rows == {"State": 20_000}
    assert 0 < most <= 100_000
    assert count(form, tmp_path / PLACES[form]) == 20_000


def count(form: str, path: Path) -> int:
    """Rows of `State`."""
    if form == "parquet":
        return int(pq.read_metadata(path / "State.parquet").num_rows)
    if form == "npz":
        with np.load(path) as arrays:
            assert np.all(np.diff(arrays["State/time"].astype(np.int64)) == 1_000_000)
            return len(arrays["State/angle"])
    base = sqlite3.connect(path)
    try:
        return int(base.execute('SELECT count(*) FROM "State"').fetchone()[0])
    finally:
        base.close()


def test_many_messages_need_few_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """However many messages are being written, few files are open."""
    monkeypatch.setattr(export_files, "OPEN", 8)
    monkeypatch.setattr(folder, "BUFFER", 1)
    wide = Protocol("wide", link="can")
    for number in range(60):
        wide.message(f"M{number}", id=number, payload=Struct("value" / Int32ul))
    variant = wide.variant()
    frames = [Frame(number, number.to_bytes(4, "little"), 1.5e9) for number in range(60)]
    with open_export(tmp_path / "out.parquet", variants=[variant]) as export:
        monkey: Any = export
        monkey.rows_at_once = 1
        scanner = make_column_scanner([variant])
        for _ in range(2):
            export.write(scanner.feed(FrameTable.from_frames(frames)))
            monkey._behind.wait()
            assert len(monkey._pool._open) == 8
    assert len(list((tmp_path / "out.parquet").iterdir())) == 60
    for number in (0, 7, 59):
        values = pq.read_table(tmp_path / "out.parquet" / f"M{number}.parquet")["value"].to_pylist()
        assert values == [number, number]


def test_a_pool_reopens_what_it_closed(tmp_path: Path) -> None:
    """A file goes on where it was, however many others were written in between."""
    pool = FilePool("out")
    sinks = [ExportFile(pool, str(tmp_path / str(number))) for number in range(100)]
    for piece in (b"a", b"b", b"c"):
        for sink in sinks:
            sink.write(piece)
    pool.close()
    assert {path.read_bytes() for path in tmp_path.iterdir()} == {b"abc"}
    assert sinks[0].tell() == 3


def test_an_abandoned_pool_writes_nothing(tmp_path: Path) -> None:
    """What a library still writes when it is freed makes no file again that was removed."""
    pool = FilePool("out")
    sink = ExportFile(pool, str(tmp_path / "one"))
    sink.write(b"a")
    pool.abandon()
    (tmp_path / "one").unlink()
    assert sink.write(b"b") == 1
    assert list(tmp_path.iterdir()) == []


def test_work_behind_is_in_order_for_each_file() -> None:
    """Two threads; of each file one piece of work is done behind the other."""
    behind, done = Behind(), dict[str, list[int]]()
    for number in range(200):
        name = f"file {number % 5}"
        behind.do(name, partial(done.setdefault(name, []).append, number))
    behind.wait()
    behind.stop()
    assert done == {f"file {first}": list(range(first, 200, 5)) for first in range(5)}


def test_what_fails_behind_is_raised_by_the_next_call() -> None:
    """By the next work, or where it is waited for; what waits then is left undone by `stop`."""
    behind, done = Behind(), list[int]()
    gate = Event()

    def fail() -> None:
        raise CallerError("out: cannot be written: disk full")

    behind.do("a", fail)
    with pytest.raises(CallerError, match="disk full"):
        behind.wait()
    behind.do("a", lambda: gate.wait(10))
    behind.do("a", lambda: done.append(1))
    gate.set()
    behind.wait()
    behind.stop()
    assert done == [1]
    for _ in range(UNDER_WAY):
        behind.do("b", fail)
    with pytest.raises(CallerError, match="disk full"):
        behind.do("b", fail)
    behind.stop()


@each_format
def test_a_failed_export_leaves_what_was_there(form: str, tmp_path: Path) -> None:
    """An exception inside `with` removes every trace; an export that was there before still stands."""
    path = f"{tmp_path}/{PLACES[form]}"
    with open_export(path, variants=[ARM]) as export:
        export.write(tables(state(1, 1)))
    before = listing(tmp_path)

    def fail() -> None:
        with open_export(path, variants=[ARM]) as export:
            export.write(tables(state(1, 1), Frame(0x101, b"abc")))
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fail()
    assert listing(tmp_path) == before
    with open_export(path, variants=[ARM]) as export:  # and a whole one takes its place
        export.write(tables(Frame(0x101, b"abc", 1.5e9)))
    assert listing(tmp_path) != before
    assert len(list(tmp_path.iterdir())) == 1


def listing(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_a_folder_of_other_files_is_not_replaced(tmp_path: Path) -> None:
    """Only a folder that an export made is replaced by one."""
    folder = tmp_path / "out.parquet"
    folder.mkdir()
    (folder / "diary.txt").write_text("dear")
    with pytest.raises(CallerError, match=r"holds other files \(diary.txt\)"):
        open_export(folder)
    assert listing(tmp_path) == {"out.parquet/diary.txt": b"dear"}


def test_names_are_safe_and_unique() -> None:
    """Names that differ in case alone, paths, devices of Windows and very long ones become files of their own."""
    naming = Naming()
    names = [
        naming.name("p", message) for message in ("Ab", "aB", "../x", "CON", "a" * 300, "é", "", "_lost")
    ]
    assert names[:4] == ["Ab", "aB.2", "_x", "_CON"]
    assert len({name.casefold() for name in names}) == len(names)
    assert all(len(name) < 130 and os.path.basename(name) == name for name in names)
    assert names[6:] == ["_lost", "_lost_"]


def test_sqlite_quotes_foreign_names(tmp_path: Path) -> None:
    """No name can break a statement, and columns that differ in case alone are two."""
    odd = Protocol("odd", link="can")
    odd.message("Select", id=0x100, payload=Struct("from_" / Byte, "Order" / Byte, "order" / Byte))
    variant = odd.variant()
    path = tmp_path / "out.db"
    with open_export(path, variants=[variant]) as export:
        assert isinstance(export, SqliteExport)
        export.write(tables(Frame(0x100, b"\x01\x02\x03", 1.5e9), variants=[variant]))
    base = sqlite3.connect(path)
    assert base.execute('SELECT "from_", "Order", "order.2", time_ns FROM "Select"').fetchall() == [
        (1, 2, 3, 1_500_000_000_000_000_000)
    ]
    assert base.execute('SELECT "path" FROM "_columns" WHERE "column" = \'order.2\'').fetchone() == ("order",)
    base.close()


def test_what_grows_is_brought_to_the_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A journal of Parquet and an MCAP wait for the disk when they are asked to."""
    pa = pytest.importorskip("pyarrow")
    synced: list[int] = []
    monkeypatch.setattr("aces_bus.export.files.os.fsync", synced.append)
    journal = ParquetJournal(str(tmp_path / "a.parquet"), pa.schema([("a", pa.int64())]))
    journal.sync()
    assert len(synced) == 1
    mcap = McapWriter(str(tmp_path / "a.mcap"))
    mcap.sync()
    assert len(synced) == 2
    mcap.close()
    journal.close()


def test_booleans_with_gaps_stay_booleans_in_pandas() -> None:
    """A switch that is absent in some rows is pandas' own boolean there, and a number its own integer."""
    pandas = pytest.importorskip("pandas")
    absent = np.array([True, False, False])
    for values, kind in (
        (np.array([True, True, False]), "boolean"),
        (np.array([0, 1, 0], np.uint8), "UInt8"),
    ):
        piece: Any = (values, absent)
        slot: Any = SimpleNamespace(holds="value", kind=None)
        made = _series(pandas, slot, piece, Labels([]), absolute=False, names=False)
        assert str(made.dtype) == kind
        assert [None if one is pandas.NA else int(one) for one in made] == [None, 1, 0]
