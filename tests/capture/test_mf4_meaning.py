"""What the numbers of an MF4 file mean: both readers of ours, python-can's and asammdf's say the same, or ours refuse by name."""

from __future__ import annotations

import importlib
import importlib.util
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from aces_bus.capture import open_capture
from aces_bus.frame import FD_LENGTHS, Frame
from tests.capture.mdf_files import converted_file, plain_records
from tests.capture.test_mdf4 import Said, read, through_asammdf

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


def read_both(contents: Sequence[bytes]) -> list[Said]:
    """What both readers of ours say of each file, which is the same."""
    found = [read(content) for content in contents]
    for number, theirs in enumerate(through_asammdf(contents)):
        assert found[number] == theirs, number
    return found


# ---- recordings ----------------------------------------------------------------------------------------------------


@pytest.mark.shared
@pytest.mark.parametrize(("name", "count"), [("canedge-virtual-channels.mf4", 4024), ("fd-lengths.mf4", 8)])
def test_every_frame_of_real_recordings(shared_captures: Path, name: str, count: int) -> None:
    """Identifier, kind, channel, direction, data and time of every frame are those of python-can's reader.

    But for lengths in fd-lengths.mf4: where asammdf reads all channels at once, as python-can has it do, it converts none.
    """
    path = shared_captures / "mf4" / name
    theirs = rows_of_python_can(path)
    (found,) = read_both([path.read_bytes()])
    ours = rows_of(found[0])
    if name == "fd-lengths.mf4":
        asammdf: Any = importlib.import_module("asammdf")
        lengths = asammdf.MDF(path).get("CAN_DataFrame.DataLength").samples
        assert [len(row[-1]) for row in ours] == lengths.tolist() == list(FD_LENGTHS[8:])
        ours = [(*row[:-1], row[-1][: len(twin[-1])]) for row, twin in zip(ours, theirs, strict=True)]
    assert ours == theirs
    assert len(theirs) == count
    assert found[2] == 0
    with open_capture(path, link="can") as capture:
        assert sum(map(len, capture.tables())) == capture.lines == count


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
        "by ranges of one": (
            short(BusChannel=numbers % 7),
            {"BusChannel": (RANGES, (1, 1, 40, 2, 2, 50, 5, 5, 60, 99), ())},
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


def test_conversions_are_those_of_python_can(tmp_path: Path) -> None:
    """Linear, rational, tables, ranges, texts, virtual channels and times: every frame as python-can's reader gives it."""
    files = understood()
    for (name, content), found in zip(files.items(), read_both([*files.values()]), strict=True):
        path = tmp_path / "x.mf4"
        path.write_bytes(content)
        assert rows_of(found[0]) == rows_of_python_can(path), name
        assert len(found[0]) == N
        assert found[2] == 0
