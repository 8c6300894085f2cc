"""What the numbers of an MF4 file mean: our readers say what python-can's and asammdf say, or refuse by name.

A process with asammdf takes seconds to start; one therefore reads the files of all tests.
"""

from __future__ import annotations

import importlib
import importlib.util
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from aces_bus import Frame
from aces_bus.frames import FD_LENGTHS
from aces_lab.formats.mf4 import arrays as mdf4
from aces_lab.formats.mf4 import data as _mdf_data
from aces_lab.formats.mf4.blocks import HD_AT
from tests.recordings.mdf_files import (
    FIELDS,
    RECORDS,
    converted_file,
    long_values,
    plain_file,
    plain_records,
    variable_file,
)
from tests.recordings.test_mdf4 import Said, read, through_asammdf

if importlib.util.find_spec("asammdf") is None:  # it is not imported: python-can must be first
    pytest.skip("asammdf is not installed", allow_module_level=True)
can = pytest.importorskip("can")

Row = tuple[Any, ...]
LENGTHS = (5, [x for pair in enumerate(FD_LENGTHS) for x in pair], ())


def rows_of(frames: Sequence[Frame]) -> list[Row]:
    """All that a frame says, with its time in microseconds."""
    return [
        (
            round((frame.timestamp or 0) * 1e6),
            frame.arbitration_id,
            (frame.is_extended_id, frame.is_remote_frame, frame.is_error_frame, frame.is_fd),
            (frame.bitrate_switch, frame.error_state_indicator, frame.channel, frame.is_rx is not False),
            frame.length if frame.is_remote_frame else frame.data,
        )
        for frame in frames
    ]


def rows_of_python_can(path: Path) -> list[Row]:
    return [
        (
            round(message.timestamp * 1e6),
            message.arbitration_id,
            (
                message.is_extended_id and not message.is_error_frame,
                message.is_remote_frame,
                message.is_error_frame,
                message.is_fd,
            ),
            (
                message.is_fd and message.bitrate_switch,
                message.is_fd and message.error_state_indicator,
                None if message.channel is None else str(message.channel),
                message.is_rx,
            ),
            message.dlc if message.is_remote_frame else bytes(message.data),
        )
        for message in can.MF4Reader(str(path))
    ]


def read_both(files: Mapping[str, bytes]) -> dict[str, Said]:
    """What both readers of ours say of each file, which is the same."""
    found = {name: read(content) for name, content in files.items()}
    for name, theirs in zip(files, through_asammdf([*files.values()]), strict=True):
        assert found[name] == theirs, name
    return found


@pytest.fixture(scope="module")
def found() -> dict[str, Said]:
    """What both readers of ours say of the files of all tests."""
    return read_both({**understood(), **by_definition(), **refused(), **marked(), **variable()})


# ---- recordings ----------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.shared
def test_every_frame_of_real_recordings(shared_captures: Path) -> None:
    """Identifier, kind, channel, direction, data and time of every frame are those of python-can's reader.

    But for lengths in fd-lengths.mf4: where asammdf reads all channels at once, as python-can has it do, it converts none.
    """
    asammdf: Any = importlib.import_module("asammdf")
    paths = [shared_captures / "mf4" / name for name in ("canedge-virtual-channels.mf4", "fd-lengths.mf4")]
    both = read_both({path.name: path.read_bytes() for path in paths})
    for path, count in zip(paths, (4024, 8), strict=True):
        theirs = rows_of_python_can(path)
        ours = rows_of(both[path.name][0])
        if path.name == "fd-lengths.mf4":
            lengths = asammdf.MDF(path).get("CAN_DataFrame.DataLength").samples
            assert [len(row[-1]) for row in ours] == lengths.tolist() == list(FD_LENGTHS[8:])
            ours = [(*row[:-1], row[-1][: len(twin[-1])]) for row, twin in zip(ours, theirs, strict=True)]
        assert ours == theirs
        assert len(theirs) == count
        assert both[path.name][2] == 0


# ---- conversions ---------------------------------------------------------------------------------------------------

LINEAR, RATIONAL, INTERPOLATED, NEAREST, RANGES, TEXTS, TEXT_RANGES = 1, 2, 4, 5, 6, 7, 8
VIRTUAL = {"kind": 6, "bits": 0}
N = 40


def short(**columns: Any) -> np.ndarray[Any, Any]:
    rows = plain_records(N)
    for name, values in columns.items():
        rows[name] = values
    return rows


def long_frames() -> np.ndarray[Any, Any]:
    """CAN FD frames of all lengths, with codes for them."""
    code = np.arange(N) % 16
    return short(EDL=1, DLC=code, DataLength=code, BRS=code % 2, ESI=code % 3 == 0)


def understood() -> dict[str, bytes]:
    """Files with conversions of which python-can's reader and ours make the same frames."""
    numbers = np.arange(N)
    whole = {"bits": 8}  # asammdf takes a frame's channels one by one, and converts them
    cases: dict[str, tuple[np.ndarray[Any, Any], dict[str, Any], dict[str, Any]]] = {
        "none": (short(), {}, {}),
        "identity": (short(), {"ID": (0, (), ()), "Dir": (0, (), ())}, {}),
        "linear": (
            short(BusChannel=numbers % 5),
            {"BusChannel": (LINEAR, (3, 2), ()), "ID": (LINEAR, (-16, 2), ()), "Dir": (LINEAR, (1, 0), ())},
            {},
        ),
        "rational": (
            short(),
            {"BusChannel": (RATIONAL, (0, 4, 2, 0, 0, 2), ()), "ID": (RATIONAL, (0, 1, 0, 0, 0, 0.5), ())},
            {},
        ),
        "squares": (short(BusChannel=numbers % 9), {"BusChannel": (RATIONAL, (1, 0, 1, 0, 0, 1), ())}, {}),
        "lengths of FD": (long_frames(), {"DataLength": LENGTHS}, {}),
        "by interpolation": (
            short(BusChannel=numbers),
            {"BusChannel": (INTERPOLATED, (0, 0, 10, 20, 60, 70), ())},
            {},
        ),
        "by the nearest": (
            short(BusChannel=numbers),
            {"BusChannel": (NEAREST, (2, 7, 10, 8, 31, 9), ())},
            {},
        ),
        "directions": (
            short(Dir=numbers % 3 % 2),
            {"Dir": (TEXTS, (0, 1), ("Rx", "Tx", ""))},
            {},
        ),
        "directions by default": (short(Dir=numbers % 4), {"Dir": (TEXTS, (0,), ("Rx", "Tx"))}, {}),
        "virtual": (
            long_frames(),
            {
                "BusChannel": (LINEAR, (9, 0), ()),
                "IDE": (LINEAR, (1, 0), ()),
                "Dir": (LINEAR, (1, 0), ()),
                "EDL": (LINEAR, (1, 0), ()),
                "DataLength": LENGTHS,
            },
            dict.fromkeys(("BusChannel", "IDE", "Dir", "EDL"), VIRTUAL),
        ),
        "times": (short(), {"t": (LINEAR, (100.25, 0.5), ())}, {}),
        "times by a table": (short(), {"t": (INTERPOLATED, (0, 0, 2, 1, 9, 11), ())}, {}),
        "times by the record": (short(), {"t": (LINEAR, (5, 0.25), ())}, {"t": {"kind": 3, "bits": 0}}),
    }
    return {
        name: converted_file(rows, conversions, whole=whole, **changes)
        for name, (rows, conversions, changes) in cases.items()
    }


@pytest.mark.slow
def test_conversions_are_those_of_python_can(tmp_path: Path, found: dict[str, Said]) -> None:
    """Linear, rational, tables, texts, virtual channels and times: every frame as python-can's reader gives it."""
    for name, content in understood().items():
        path = tmp_path / "x.mf4"
        path.write_bytes(content)
        frames, _, unreadable, *_ = found[name]
        assert rows_of(frames) == rows_of_python_can(path), name
        assert len(frames) == N
        assert unreadable == 0


RANGED = ((1, 3, 40), (5, 5, 50), (10, 20, 60))
WORDED = ((0, 4, "Rx"), (6, 7, "Tx"), (8, 50, "Rx"))


def by_definition() -> dict[str, bytes]:
    numbers = np.arange(N)
    parameters = [number for each in RANGED for number in each]
    limits = [limit for each in WORDED for limit in each[:2]]
    return {
        "by range": converted_file(
            short(BusChannel=numbers), {"BusChannel": (RANGES, (*parameters, 99), ())}
        ),
        "by text": converted_file(
            short(Dir=numbers), {"Dir": (TEXT_RANGES, limits, ("Rx", "Tx", "Rx", "Tx"))}
        ),
    }


def test_tables_by_their_definition(found: dict[str, Said]) -> None:
    """Ranges against what ASAM says of them; asammdf 8.8.28 reads those of integers otherwise."""
    by_range, by_text = found["by range"][0], found["by text"][0]
    for number in range(N):
        channel = next((value for low, high, value in RANGED if low <= number <= high), 99)
        assert by_range[number].channel == str(channel)
        word = next((word for low, high, word in WORDED if low <= number <= high), "Tx")
        assert by_text[number].is_rx == (word == "Rx")


def refused() -> dict[str, bytes]:
    return {
        "a formula": converted_file(short(), {"ID": (3, (), ("X1 * 2",))}),
        "a damaged table": converted_file(short(), {"DataLength": (NEAREST, (3, 1, 2, 1), ())}),
        "times by a formula": converted_file(short(), {"t": (3, (), ("X + 1",))}),
        "angles": converted_file(short(), t={"sync": 2}),
        "bytes": converted_file(short(), IDE={"data_type": 10}),
        "nothing": converted_file(short(), BusChannel=VIRTUAL),
        "another length": variable_file(LONG, lengths=[8] * len(LONG)),
        "elsewhere": variable_file(LONG, offsets=[1 << 40, *[0] * (len(LONG) - 1)]),
    }


def test_what_is_refused_is_refused_by_both_readers(found: dict[str, Said]) -> None:
    """Whatever way a file goes, the same records are refused with the same words."""
    says = {
        "a formula": "CAN_DataFrame.ID has a formula",
        "a damaged table": "CAN_DataFrame.DataLength has a damaged conversion",
        "times by a formula": "t has a formula",
        "angles": "t is not a time",
        "bytes": "CAN_DataFrame.IDE has data type 10, and is not a number",
        "nothing": "CAN_DataFrame.BusChannel is virtual, and has no conversion with its value",
        "another length": "a length that is not that of its data bytes",
        "elsewhere": "data bytes that are not in the file",
    }
    for name, reason in says.items():
        frames, lines, unreadable, _, _, problems = found[name]
        assert lines == len(frames) + unreadable
        assert problems[0].reason.startswith(f"CAN_DataFrame group 0: {reason}")


@pytest.mark.parametrize(
    ("field", "conversion", "says"),
    [
        ("ID", (3, (), ("X1 * 2",)), "CAN_DataFrame.ID has a formula as its conversion, which is not read"),
        ("Dir", (9, (0, 1, 2), ("Rx", "Tx")), "CAN_DataFrame.Dir has a conversion from text to numbers"),
        ("IDE", (10, (), ("a", "b", "c")), "CAN_DataFrame.IDE has a conversion from text to text"),
        ("EDL", (11, (1,), ("a",)), "CAN_DataFrame.EDL has a bit field with texts"),
        ("BRS", (77, (1, 2), ()), "CAN_DataFrame.BRS has a conversion of kind 77"),
        ("DLC", (LINEAR, (1,), ()), "CAN_DataFrame.DLC has a damaged conversion"),
        ("DataLength", (NEAREST, (3, 1, 2, 1), ()), "CAN_DataFrame.DataLength has a damaged conversion"),
        (
            "BusChannel",
            (RANGES, (1, 9, 0, 5, 6, 0, 0), ()),
            "CAN_DataFrame.BusChannel has a damaged conversion",
        ),
        ("DataBytes", (LINEAR, (1, 1), ()), "CAN_DataFrame.DataBytes has a conversion"),
        ("t", (3, (), ("X + 1",)), "t has a formula as its conversion"),
    ],
)
def test_a_conversion_that_is_not_read_refuses_the_group(
    field: str, conversion: tuple[int, Sequence[float], Sequence[str]], says: str
) -> None:
    """Formulas, conversions of texts, unknown and damaged ones: no frame, each record counted, with channel and reason."""
    frames, lines, unreadable, _, _, problems = read(converted_file(short(), {field: conversion}))
    assert (frames, lines, unreadable) == ([], N, N)
    assert problems[0].reason.startswith(f"CAN_DataFrame group 0: {says}")


@pytest.mark.parametrize(
    ("field", "conversion", "bad"),
    [
        ("ID", (LINEAR, (0, 0.5), ()), lambda n: n % 2),
        ("ID", (LINEAR, (-0x102, 1), ()), lambda n: n < 2),
        ("ID", (LINEAR, (0, 1e8), ()), lambda n: True),
        ("BusChannel", (RATIONAL, (0, 0, 1, 0, 1, -3), ()), lambda n: n not in (2, 4)),
        ("Dir", (TEXTS, (1, 2), ("Rx", "Tx", "sideways")), lambda n: n not in (1, 2)),
        ("Dir", (TEXTS, (1, 2), ("Rx", "Tx", "")), lambda n: n not in (1, 2)),
        ("BusChannel", (TEXTS, (1, 2), ("7", "CAN 2")), lambda n: n != 1),
        ("IDE", (TEXTS, (1, 2, 3), ("Standard", "extended", "1", "false")), lambda n: False),
        ("BRS", (TEXTS, (1, 2), ("?", "!", "x")), lambda n: False),
    ],
)
def test_a_number_that_means_nothing_costs_its_record(field: str, conversion: Any, bad: Any) -> None:
    """Fractions, infinities, negative identifiers, unknown texts: the record is unreadable by name, and others stand.

    Of a classic frame nobody asks whether the bit rate was switched.
    """
    numbers = np.arange(N)
    rows = short(**({} if field == "ID" else {field: numbers}))
    frames, lines, unreadable, _, _, problems = read(converted_file(rows, {field: conversion}))
    wrong = [n for n in range(N) if bad(n)]
    assert (lines, unreadable, len(frames)) == (N, len(wrong), N - len(wrong))
    assert [problem.line - 1 for problem in problems] == wrong[:5]
    for problem in problems:
        assert f"CAN_DataFrame.{field}" in problem.reason or "identifier" in problem.reason


# ---- what a file says of itself ------------------------------------------------------------------------------------


def test_a_start_in_local_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A file that begins at a local time, without its zone: that of this machine, as python-can's reader takes it."""
    content = bytearray(converted_file(short()))
    content[HD_AT + 24 + 48 + 12] = 1
    path = tmp_path / "local.mf4"
    path.write_bytes(content)
    monkeypatch.setenv("TZ", "EST5EDT,M3.2.0,M11.1.0")
    time.tzset()
    try:
        frames = read(bytes(content))[0]
        assert rows_of(frames) == rows_of_python_can(path)
    finally:
        monkeypatch.undo()
        time.tzset()
    assert frames[0].timestamp == 1e9 + 4 * 3600


def test_more_records_than_announced() -> None:
    """Records behind those that are announced are not given, and that is counted and said."""
    frames, lines, unreadable, _, _, problems = read(plain_file(RECORDS, 5))
    assert (len(frames), lines, unreadable) == (5, 6, 1)
    assert problems[0].line == 6
    assert problems[0].reason == "CAN_DataFrame group 0: 5 records are announced, 9 are there"


def test_error_frames_without_data() -> None:
    """An error frame whose data bytes are not recorded has none, whatever length it has."""
    content = converted_file(short(), kind="CAN_ErrorFrame")
    frames = read(content.replace(b"CAN_ErrorFrame.DataBytes", b"CAN_ErrorFrame.NoMatters"))[0]
    assert [(frame.is_error_frame, frame.data) for frame in frames] == [(True, b"")] * N


def test_lengths_that_are_not_said() -> None:
    """Codes above 15, converted ones, and no lengths at all are never lengths by default."""
    none, code = b"CAN_DataFrame.NoMatters!", b"CAN_DataFrame.NNN"
    codes = np.arange(N)
    alone = converted_file(short(DLC=codes, EDL=1)).replace(b"CAN_DataFrame.DataLength", none)
    frames, _, unreadable, _, _, problems = read(alone)
    assert [len(frame.data) for frame in frames] == list(FD_LENGTHS)
    assert (unreadable, problems[0].reason) == (N - 16, "CAN_DataFrame group 0: a DLC above 15")
    as_table = converted_file(short(), {"DLC": LENGTHS}).replace(b"CAN_DataFrame.DataLength", none)
    for content, says in (
        (as_table, "CAN_DataFrame.DLC has a conversion, and there is no DataLength"),
        (alone.replace(b"CAN_DataFrame.DLC", code), "it has no lengths"),
    ):
        frames, _, unreadable, _, _, problems = read(content)
        assert (frames, unreadable) == ([], N)
        assert problems[0].reason == f"CAN_DataFrame group 0: {says}"


# ---- invalidation bits ---------------------------------------------------------------------------------------------


REASONS = {
    "ID": "CAN_DataFrame.ID is marked invalid",
    "Dir": "CAN_DataFrame.Dir is marked invalid",
    "t": "a time that is marked invalid",
    "whole": "CAN_DataFrame is marked invalid",
}


def marked() -> dict[str, bytes]:
    marks = bytes(1 << n % 8 for n in range(N))
    files: dict[str, bytes] = {}
    for name in (*REASONS, "ESI"):
        changes: dict[str, Any] = {name: {"flags": 2, "invalid_bit": 3}}
        files[f"invalid {name}"] = converted_file(short(), None, invalid=marks, **changes)
    files["invalid always"] = converted_file(short(), None, Dir={"flags": 1})
    files["invalid nowhere"] = converted_file(
        short(), None, invalid=marks, Dir={"flags": 2, "invalid_bit": 8}
    )
    return files


def test_what_is_marked_invalid_has_no_value(found: dict[str, Said]) -> None:
    """A field, the time or the whole frame that is marked invalid costs the record; what a frame does not need, nothing."""
    for name, reason in REASONS.items():
        frames, _, unreadable, _, _, problems = found[f"invalid {name}"]
        assert unreadable == N // 8
        assert [frame.arbitration_id for frame in frames] == [0x100 + n for n in range(N) if n % 8 != 3]
        assert [problem.reason for problem in problems] == [f"CAN_DataFrame group 0: {reason}"] * 5
    assert found["invalid ESI"][2] == 0
    assert found["invalid always"][2] == found["invalid nowhere"][2] == N
    assert "an invalidation bit that its records do not have" in found["invalid nowhere"][-1][0].reason


# ---- data bytes of variable length ---------------------------------------------------------------------------------

LONG = long_values()


def variable() -> dict[str, bytes]:
    return {way: variable_file(LONG, way) for way in ("block", "packed", "records")}


@pytest.mark.parametrize("way", ["block", "packed", "records"])
def test_data_of_variable_length(tmp_path: Path, found: dict[str, Said], way: str) -> None:
    """In a block, in packed ones, in records of their own: the bytes that python-can's reader gives."""
    path = tmp_path / "x.mf4"
    path.write_bytes(variable()[way])
    frames, _, unreadable, *_ = found[way]
    assert rows_of(frames) == rows_of_python_can(path)
    assert [frame.data for frame in frames] == LONG
    assert unreadable == 0


def test_data_of_variable_length_in_small_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    """Values and records go over the borders of what is at hand at once."""
    monkeypatch.setattr(_mdf_data, "_PIECE", 150)
    monkeypatch.setattr(mdf4, "_ROWS", 3)
    for name, content in variable().items():
        assert [frame.data for frame in read(content)[0]] == LONG, name
    values = [*LONG[:3], bytes(5000), *LONG[3:]]
    frames, _, _, _, _, problems = read(
        variable_file(values, "records", [len(value) % 65 for value in values])
    )
    assert [frame.data for frame in frames] == LONG[:3]
    assert "data bytes that are not in the file" in problems[0].reason
    assert "a record of more than" in problems[1].reason


def test_scattered_data_of_variable_length(monkeypatch: pytest.MonkeyPatch) -> None:
    """A file that would be read over and over is not: the rest of the group is refused."""
    monkeypatch.setattr(_mdf_data, "_WINDOW", 200)
    size = sum(4 + len(value) for value in LONG)
    offsets = [(size - 8) * (n % 2) for n in range(len(LONG))]
    frames, _, unreadable, _, _, problems = read(variable_file(LONG, offsets=offsets))
    assert (frames, unreadable) == ([], 1)
    assert "scattered too far" in problems[0].reason


# ---- files that asammdf writes -------------------------------------------------------------------------------------


def files_of_asammdf(folder: Path) -> Iterator[Path]:
    """Groups of data, remote and error frames with conversions and invalidation bits; plain, packed, transposed."""
    asammdf: Any = importlib.import_module("asammdf")
    blocks: Any = importlib.import_module("asammdf.blocks.v4_blocks")
    made: Any = importlib.import_module("asammdf.blocks.conversion_utils").from_dict
    table = {
        f"{way}_{n}": (n, length)[way == "phys"]
        for n, length in enumerate(FD_LENGTHS)
        for way in ("raw", "phys")
    }
    texts = {"val_0": 0, "val_1": 1, "text_0": b"Rx", "text_1": b"Tx"}
    conversions = {
        "BusChannel": {"a": 2.0, "b": 1.0},
        "Dir": texts,
        "DataLength": table | {"mode": 5},
        "ID": {"a": 1.0, "b": 0.0},
    }
    bus = asammdf.MDF(version="4.11")
    numbers = np.arange(300)
    for kind in ("CAN_DataFrame", "CAN_RemoteFrame", "CAN_ErrorFrame"):
        rows = np.zeros(
            len(numbers),
            [
                (f"{kind}.ID", "<u4"),
                *((f"{kind}.{name}", "u1") for name in FIELDS),
                (f"{kind}.DataBytes", "u1", (64,)),
            ],
        )
        rows[f"{kind}.ID"], rows[f"{kind}.IDE"] = numbers * 5, numbers * 5 > 0x7FF
        rows[f"{kind}.BusChannel"], rows[f"{kind}.Dir"] = numbers % 3, numbers % 2
        is_fd = (numbers % 3 == 0) & (kind != "CAN_RemoteFrame")
        rows[f"{kind}.DLC"] = rows[f"{kind}.DataLength"] = np.where(is_fd, numbers % 16, numbers % 9)
        rows[f"{kind}.EDL"], rows[f"{kind}.BRS"], rows[f"{kind}.ESI"] = (
            is_fd,
            is_fd & (numbers % 5 == 0),
            is_fd,
        )
        rows[f"{kind}.DataBytes"] = numbers[:, None] % 251
        bus.append(
            asammdf.Signal(
                rows,
                numbers * 0.001 + len(kind) / 1e5,
                name=kind,
                source=blocks.SourceInformation(source_type=2, bus_type=2),
                invalidation_bits=numbers % 10 == 7,
            ),
            common_timebase=True,
        )
        group = bus.groups[-1]
        group.channel_group.flags = 2
        for channel in group.channels:
            if (part := channel.name.rpartition(".")[2]) in conversions:
                channel.conversion = made(conversions[part])
    for compression in (0, 1, 2):
        yield Path(bus.save(folder / f"{compression}.mf4", compression=compression, overwrite=True))
    bus.close()


def rows_of_asammdf(path: Path) -> list[Row]:
    """The frames as asammdf gives the channels, one by one, converted and without what is invalid."""
    asammdf: Any = importlib.import_module("asammdf")
    found: list[Row] = []
    with asammdf.MDF(path, process_bus_logging=False) as mdf:
        start = mdf.start_time.timestamp()
        for index, kind in enumerate(("CAN_DataFrame", "CAN_RemoteFrame", "CAN_ErrorFrame")):
            frame = mdf.get(kind, group=index, ignore_invalidation_bits=True)
            of = {
                name: mdf.get(f"{kind}.{name}", group=index, ignore_invalidation_bits=True).samples
                for name in ("ID", *FIELDS, "DataBytes")
            }
            for n, seconds in enumerate(frame.timestamps.tolist()):
                if frame.invalidation_bits is not None and frame.invalidation_bits[n]:
                    continue
                is_fd, length = bool(of["EDL"][n]), int(of["DataLength"][n])
                is_remote, is_error = kind == "CAN_RemoteFrame", kind == "CAN_ErrorFrame"
                row = (
                    round((start + seconds) * 1e6),
                    int(of["ID"][n]),
                    (bool(of["IDE"][n]) and not is_error, is_remote, is_error, is_fd),
                    (
                        bool(of["BRS"][n]),
                        bool(of["ESI"][n]),
                        str(int(of["BusChannel"][n])),
                        of["Dir"][n] == b"Rx",
                    ),
                    length if is_remote else of["DataBytes"][n][:length].tobytes(),
                )
                found.append(row)
    return sorted(found)


@pytest.mark.slow
def test_files_of_asammdf(tmp_path: Path) -> None:
    """Data, remote and error frames, conversions, invalidation bits, packed or not: what asammdf says of each channel."""
    paths = list(files_of_asammdf(tmp_path))
    both = read_both({path.name: path.read_bytes() for path in paths})
    for path in paths:
        frames, lines, unreadable, *_ = both[path.name]
        assert sorted(rows_of(frames)) == rows_of_asammdf(path)
        assert (lines, unreadable) == (900, 90)
