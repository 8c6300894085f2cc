# A layout's columns are tested without a file.
# pyright: reportPrivateUsage=false
"""What holds for every export: one schema, bounded memory, few open files, all or nothing, names that no system refuses."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from construct import Byte, Float32l, GreedyBytes, Int16sl, Struct

from aces_bus import Frame, FrameTable, make_column_scanner
from aces_bus.errors import CallerError, UnknownNameError
from aces_bus.export import open_export
from aces_bus.export.base import Export
from aces_bus.export.open import export_format, table_formats
from aces_bus.frame_table import Channels
from aces_bus.protocol import Enumeration, Protocol, Quantity, Variant
from aces_bus.protocol.columns.layout import DatasetLayout
from aces_bus.protocol.columns.table import MessageTable
from tests.limits import small_disk

pq = pytest.importorskip("pyarrow.parquet")
pa = pytest.importorskip("pyarrow")

arm = Protocol("shelf", link="can")
arm.message(
    "State",
    id=0x100,
    direction="from device",
    payload=Struct("mode" / Enumeration(Byte, off=0, on=1), "angle" / Quantity(Int16sl, scale=0.1, unit="°")),
    doc="How it stands.",
)
arm.message("Raw", id=0x101, length=range(9), payload=Struct("data" / GreedyBytes))
ARM = arm.variant()
other = Protocol("other", link="can")
other.message("State", id=0x200, payload=Struct("load" / Float32l))
OTHER = other.variant()

PLACES = {
    "parquet": "out.parquet",
    "arrow": "out.arrow",
    "feather": "out.feather",
    "csv": "out.csv/",
    "npz": "out.npz",
    "sqlite": "out.sqlite",
    "mcap": "out.mcap",
}
each_format = pytest.mark.parametrize("form", table_formats())


def state(mode: int, angle: int, time: float | None = 1.5e9, channel: str | None = "can0") -> Frame:
    return Frame(0x100, bytes([mode]) + angle.to_bytes(2, "little", signed=True), time, channel)


def tables(*frames: Frame, variants: list[Variant] | None = None) -> list[MessageTable]:
    """The tables of frames."""
    return make_column_scanner(variants or [ARM], include_unknown=True).feed(FrameTable.from_frames(frames))


def many(rows: int, *, first: int = 0) -> list[MessageTable]:
    """A table of many states."""
    data = np.zeros((rows, 8), np.uint8)
    data[:, 1:3] = np.arange(first, first + rows).astype("<i2").view(np.uint8).reshape(rows, 2)
    table = FrameTable(
        np.arange(first, first + rows) * 1_000_000 + 1_500_000_000_000_000_000,
        np.zeros(rows, np.uint16),
        np.full(rows, 0x100, np.uint32),
        np.zeros(rows, np.uint8),
        np.full(rows, 3, np.uint8),
        data,
        Channels(["can0"]),
    )
    return make_column_scanner([ARM]).feed(table)


# ---------------------------------------------------------------------- schema


def test_a_schema_has_all_that_is_known_of_a_message(tmp_path: Path) -> None:
    """Units, enumerations, flags and docs in the fields' metadata; protocol, message and version in the schema's."""
    with open_export(tmp_path / "out.parquet", variants=[ARM]) as export:
        export.write(tables(state(1, 5)))
    schema = pq.read_schema(tmp_path / "out.parquet" / "State.parquet")
    assert [(field.name, str(field.type)) for field in schema] == [
        ("time", "timestamp[ns, tz=UTC]"),
        ("channel", "dictionary<values=string, indices=int32, ordered=0>"),
        ("id", "uint32"),
        ("extended", "bool"),
        ("rx", "bool"),
        ("mode", "uint8"),
        ("angle", "double"),
    ]
    assert schema.field("angle").metadata == {b"unit": "°".encode()}
    assert json.loads(schema.field("mode").metadata[b"names"]) == {"0": "off", "1": "on"}
    known = {key.decode(): value.decode() for key, value in schema.metadata.items() if b"ARROW" not in key}
    assert known.pop("aces_bus")
    assert known == {
        "protocol": "shelf",
        "message": "State",
        "direction": "from device",
        "doc": "How it stands.",
        "time": "since 1970-01-01 UTC",
    }


@pytest.mark.slow
@pytest.mark.parametrize("suffix", [".parquet", ".arrow"])
def test_a_schema_does_not_hang_on_values(suffix: str, tmp_path: Path) -> None:
    """Pieces without a channel, with another, with unnamed numbers, with no bytes: one file, one schema."""
    first = tables(state(0, 1, 1.5e9, None), Frame(0x101, b"", None))
    later = tables(state(7, 2, 1.5e9, "can1"), state(9, 3, 1.5e9, "can2"), Frame(0x101, b"x", 1.5e9, "can1"))
    schemas = []
    for pieces in ([first, later], [later, first], [first], [later]):
        path = tmp_path / f"out{suffix}"
        with open_export(path, variants=[ARM], names=True) as export:
            monkey: Any = export
            monkey.rows_at_once = 1
            for piece in [*pieces, *pieces]:
                export.write(piece)
        name = path / f"State{suffix}"
        table = pq.read_table(name) if suffix == ".parquet" else pa.ipc.open_file(name).read_all()
        schemas.append(table.schema.remove_metadata())
        wanted = {id(first): ["off"], id(later): ["7", "9"]}
        assert table["mode"].to_pylist() == [m for piece in [*pieces, *pieces] for m in wanted[id(piece)]]
    assert all(schema.equals(schemas[0]) for schema in schemas)


def test_times_that_nobody_knows(tmp_path: Path) -> None:
    """Where no time is known at all, times are null durations."""
    with open_export(tmp_path / "out.parquet", variants=[ARM]) as export:
        export.write(tables(state(0, 1, None)))
    table = pq.read_table(tmp_path / "out.parquet" / "State.parquet")
    assert str(table.schema.field("time").type) == "duration[ns]"
    assert table["time"].to_pylist() == [None]


def test_relative_times_are_durations(tmp_path: Path) -> None:
    """A recording that counts from its start has no dates, and all its datasets agree on that."""
    with open_export(tmp_path / "out.parquet", variants=[ARM]) as export:
        export.write(tables(state(1, 1, 0.25), Frame(0x101, b"", 0.5)))
    table: Any = None
    for name in ("State", "Raw"):
        table = pq.read_table(tmp_path / "out.parquet" / f"{name}.parquet")
        assert str(table.schema.field("time").type) == "duration[ns]"
        assert table.schema.metadata[b"time"] == b"as the recording counts it"
    assert table["time"].cast(pa.int64()).to_pylist() == [500_000_000]


def test_names_and_float32_are_choices(tmp_path: Path) -> None:
    """Enumerations as dictionaries of names, physical values in half the size."""
    path = tmp_path / "one.parquet"
    with open_export(path, variants=[ARM], only="State", names=True, float32=True) as export:
        export.write(tables(state(1, 5), state(3, -7)))
    table = pq.read_table(path)
    assert table["mode"].to_pylist() == ["on", "3"]
    assert str(table.schema.field("mode").type).startswith("dictionary")
    assert str(table.schema.field("angle").type) == "float"
    assert table["angle"].to_pylist() == pytest.approx([0.5, -0.7])


def test_other_readers_understand_it(tmp_path: Path) -> None:
    """polars and pandas see dates, categories and numbers."""
    polars, pandas = pytest.importorskip("polars"), pytest.importorskip("pandas")
    for suffix in (".parquet", ".arrow"):
        path = tmp_path / f"one{suffix}"
        with open_export(path, variants=[ARM], only="State") as export:
            monkey: Any = export
            monkey.rows_at_once = 1
            export.write(tables(state(1, 5), state(0, 6, 1.5e9 + 1, "can1")))
        frame = (
            polars.read_parquet(path)
            if suffix == ".parquet"
            else polars.from_arrow(pa.ipc.open_file(path).read_all())
        )
        assert frame["channel"].to_list() == ["can0", "can1"]
        assert frame["time"].dtype == polars.Datetime("ns", "UTC")
        assert frame["angle"].to_list() == [0.5, pytest.approx(0.6)]
    read = pandas.read_parquet(tmp_path / "one.parquet")
    assert str(read["time"].dtype) == "datetime64[ns, UTC]"
    assert read["mode"].tolist() == [1, 0]


def test_several_captures_are_told_apart(tmp_path: Path) -> None:
    """With `sources` a column says which recording a row is from."""
    with open_export(tmp_path / "out.parquet", variants=[ARM], sources=True) as export:
        export.write(tables(state(1, 1)), source="a.log")
        export.write(tables(state(1, 2)), source="b.log")
    assert pq.read_table(tmp_path / "out.parquet" / "State.parquet")["source"].to_pylist() == [
        "a.log",
        "b.log",
    ]


def test_what_was_not_decoded_is_a_dataset(tmp_path: Path) -> None:
    """`_lost` has the reason and the bytes, and all that tells frames apart."""
    with open_export(tmp_path / "out.parquet", variants=[ARM]) as export:
        export.write(tables(Frame(0x7FF, b"\xde\xad", 1.5e9, "can0", is_fd=True), Frame(0x100, b"\x01")))
    lost = pq.read_table(tmp_path / "out.parquet" / "_lost.parquet").to_pylist()
    assert [(row["id"], row["fd"], row["remote"], row["raw"]) for row in lost] == [
        (0x7FF, True, False, b"\xde\xad"),
        (0x100, False, False, b"\x01"),
    ]
    assert lost[0]["reason"] == "unknown"
    assert lost[1]["reason"].startswith("malformed: length 1")


def test_integers_beyond_64_bits_are_said(tmp_path: Path) -> None:
    """A number that no column can hold is left empty, counted and named; it never stops an export."""
    table = tables(Frame(0x101, b"\x01"))[0]
    layout = DatasetLayout.of(table, {"data": "integer"})
    slot = layout.slots[-1]
    values, absent = layout._objects(slot, [1, 1 << 70, None, -(1 << 63)], None)
    assert values.tolist() == [1, 0, 0, -(1 << 63)]
    assert absent is not None
    assert absent.tolist() == [False, True, True, False]
    assert layout.too_wide == {"data": 1}


def test_csv_describes_its_columns(tmp_path: Path) -> None:
    """`_columns.csv` has what CSV cannot say: units and names."""
    with open_export(f"{tmp_path}/out.csv/", variants=[ARM]) as export:
        export.write(tables(state(1, 5)))
    with open(tmp_path / "out.csv" / "_columns.csv", newline="", encoding="utf-8") as file:
        rows = {row["column"]: row for row in csv.DictReader(file)}
    assert rows["angle"]["unit"] == "°"
    assert rows["time"]["unit"] == "s"
    assert json.loads(rows["mode"]["names"]) == {"0": "off", "1": "on"}


# ---------------------------------------------------------------------- memory and files


def test_row_groups_are_full(tmp_path: Path) -> None:
    """Pieces are gathered into row groups, and a large table is cut into them."""
    with open_export(tmp_path / "out.parquet", variants=[ARM]) as export:
        monkey: Any = export
        monkey.rows_at_once = 1000
        for number in range(5):
            export.write(many(300, first=300 * number))
        export.write(many(2500, first=1500))
    found = pq.read_metadata(tmp_path / "out.parquet" / "State.parquet")
    sizes = [found.row_group(place).num_rows for place in range(found.num_row_groups)]
    assert sum(sizes) == 4000
    assert max(sizes) == 1000 + 200 - 200
    assert len(sizes) <= 5


def test_an_export_keeps_no_table_alive(tmp_path: Path) -> None:
    """Values are copied out of what a scanner gave: no view holds a whole piece of a capture."""
    export: Any = open_export(tmp_path / "out.parquet", variants=[ARM])
    export.write(many(10))
    for (dataset,) in export._datasets.values():
        for block in dataset.pieces:
            assert all(values.base is None or values.base.nbytes <= 2 * values.nbytes for values, _ in block)
    export.abandon()


# ---------------------------------------------------------------------- all or nothing


@each_format
def test_nothing_stands_before_it_is_whole(form: str, tmp_path: Path) -> None:
    """Until `close` the name is free; after it there is nothing else in the folder."""
    path = tmp_path / PLACES[form].rstrip("/")
    export = open_export(f"{tmp_path}/{PLACES[form]}", variants=[ARM])
    export.write(tables(state(1, 1)))
    assert not path.exists()
    export.close()
    assert list(tmp_path.iterdir()) == [path]
    export.close()
    with pytest.raises(CallerError, match="closed"):
        export.write(tables(state(1, 1)))


@each_format
def test_a_full_disk_leaves_nothing(form: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What cannot be written to its end is one clear error, and no file."""

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    export = open_export(f"{tmp_path}/{PLACES[form]}", variants=[ARM])
    export.write(tables(state(1, 1)))
    monkeypatch.setattr(type(export), "_finish", full)
    with pytest.raises(CallerError, match="cannot be written: No space left"):
        export.close()
    assert list(tmp_path.iterdir()) == []


@each_format
def test_a_disk_that_fills_while_writing(
    form: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """The one error names the export and not its temporary files, no library says more beside it, and no file stays."""
    path = f"{tmp_path}/{PLACES[form]}"
    export = open_export(path, variants=[ARM])
    several = [table for number in range(50) for table in tables(state(number, number))]

    def write() -> None:
        for _ in range(40):
            export.write(several)
        export.close()

    try:
        with small_disk(2000), pytest.raises(CallerError) as raised:
            write()
    finally:
        export.abandon()
    assert str(raised.value).startswith(f"{path.rstrip('/')}: cannot be written: ")
    assert capfd.readouterr() == ("", "")
    assert list(tmp_path.iterdir()) == []


def test_a_folder_takes_the_place_of_a_file(tmp_path: Path) -> None:
    """One message, then all: the file of the first export makes room for the folder of the second, and back."""
    path = tmp_path / "out.parquet"
    for only in ("State", None, "State"):
        with open_export(path, variants=[ARM], only=only) as export:
            export.write(tables(state(1, 1)))
        assert path.is_dir() is (only is None)
        assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("suffix", [".parquet", ".arrow"])
def test_a_single_message_that_did_not_occur(suffix: str, tmp_path: Path) -> None:
    """A file with its columns and without rows."""
    path = tmp_path / f"one{suffix}"
    open_export(path, variants=[ARM], only="State").close()
    table = pq.read_table(path) if suffix == ".parquet" else pa.ipc.open_file(path).read_all()
    assert table.num_rows == 0
    assert table.schema.names[-2:] == ["mode", "angle"]


def test_a_file_for_one_message_takes_no_other(tmp_path: Path) -> None:
    """Two messages never end up in one file."""
    export = open_export(tmp_path / "one.parquet", variants=[ARM], only="State")
    with pytest.raises(CallerError, match="for State alone, and Raw came too"):
        export.write(tables(state(1, 1), Frame(0x101, b"")))
    export.abandon()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("path", "complaint"),
    [
        ("nowhere/out.parquet", "no folder"),
        ("out.xlsx", "suffix says no format"),
        ("taken.npz", "is a folder"),
    ],
)
def test_wrong_places(path: str, complaint: str, tmp_path: Path) -> None:
    """What cannot be written is refused before anything is decoded."""
    (tmp_path / "taken.npz").mkdir()
    with pytest.raises(CallerError, match=complaint):
        open_export(tmp_path / path)
    assert [entry.name for entry in tmp_path.iterdir()] == ["taken.npz"]


def test_wrong_formats() -> None:
    """A format that does not exist is named with those that do; none goes to standard output."""
    with pytest.raises(UnknownNameError, match="parquet"):
        open_export("x", "parkett")
    with pytest.raises(CallerError, match="standard output"):
        open_export("-", "mcap")
    assert export_format("a/b.SQLITE3") == "sqlite"
    assert export_format("walk.csv/") == "csv"
    assert export_format("walk.csv") is None


# ---------------------------------------------------------------------- names


def test_the_protocol_stands_in_front_where_two_have_a_message(tmp_path: Path) -> None:
    """Messages of one name of two protocols are two datasets, whichever comes first."""
    both = [ARM, OTHER]
    scanner = make_column_scanner(both)
    with open_export(tmp_path / "out.parquet", variants=both) as export:
        export.write(scanner.feed(FrameTable.from_frames([Frame(0x101, b""), Frame(0x200, bytes(4))])))
        export.write(scanner.feed(FrameTable.from_frames([state(1, 1)])))
    assert {path.name for path in (tmp_path / "out.parquet").iterdir()} == {
        "Raw.parquet",
        "other.State.parquet",
        "shelf.State.parquet",
    }


@pytest.fixture
def mcap_file(tmp_path: Path) -> Path:

    path = tmp_path / "out.mcap"
    with open_export(path, variants=[ARM]) as export:
        export.write(tables(state(1, 5, 1.5e9), state(7, 6, None), state(0, 7, 1.5e9 + 0.25)))
        assert export.notes == ["1 messages have no time; in the MCAP they have the time of the one before"]
    return path


def test_mcap_has_schemas_and_times(mcap_file: Path) -> None:
    """A JSON schema a message with units and numbers' names, log times in ns, the transport under `meta`."""
    reader = pytest.importorskip("mcap.reader")
    with mcap_file.open("rb") as file:
        found = list(reader.make_reader(file).iter_messages())
    schema, channel, _ = found[0]
    assert (channel.topic, channel.message_encoding, schema.encoding) == (
        "/shelf/State",
        "json",
        "jsonschema",
    )
    assert channel.metadata["protocol"] == "shelf"
    fields = json.loads(schema.data)["properties"]
    assert fields["angle"] == {"type": "number", "description": "in °", "unit": "°"}
    assert fields["mode"] == {"type": "integer", "description": "0 = off, 1 = on"}
    assert [message.log_time for _, _, message in found] == [
        1_500_000_000_000_000_000,
        1_500_000_000_000_000_000,
        1_500_000_000_250_000_000,
    ]
    assert json.loads(found[0][2].data) == {
        "mode": 1,
        "angle": 0.5,
        "meta": {"channel": "can0", "id": 256, "extended": False, "rx": None},
    }


def test_a_missing_library_is_named_with_its_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without pyarrow the message says what to install, and nothing is left behind."""
    import sys

    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(CallerError, match=r"aces-bus\[columns\]"):
        open_export(tmp_path / "a.parquet", variants=[ARM])
    assert list(tmp_path.iterdir()) == []


def test_exports_are_contexts(tmp_path: Path) -> None:
    """`with` gives the export itself."""
    with open_export(tmp_path / "out.npz") as export:
        assert isinstance(export, Export)
