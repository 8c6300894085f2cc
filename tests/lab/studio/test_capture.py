"""What the studio keeps of frames: counts, periods, flips of bits, bytes; and its pictures."""

from __future__ import annotations

import zlib
from typing import Any

import numpy as np
import pytest

from aces_bus import Frame, FrameTable
from aces_bus.errors import CallerError
from aces_lab.studio.capture import Capture
from aces_lab.studio.images import row_pictures
from aces_lab.studio.pictures import png, thinned


def frames(count: int, identifier: int = 0x123, start_s: float = 10.0) -> FrameTable:
    """Frames every 10 ms whose first byte counts."""
    return FrameTable.from_frames(
        [
            Frame(identifier, bytes((number % 256, 0xAA)), start_s + number / 100, "can0")
            for number in range(count)
        ]
    )


def test_a_row_counts_frames_periods_and_flips() -> None:
    """Counts are the same however frames are cut into pieces."""
    whole, pieces = Capture(), Capture()
    table = frames(300)
    whole.add_frames(table)
    for start in range(0, 300, 7):
        pieces.add_frames(table.take(slice(start, start + 7)))
    for capture in (whole, pieces):
        (row,) = capture.rows
        assert (capture.frames, row.frames, row.kept) == (300, 300, 300)
        assert row.label == "123"
        assert row.pace_ms == pytest.approx((10.0, 0.0), abs=1e-6)
        assert row.flips.tolist() == [299, 149, 74, 37, 18, 9, 4, 2] + [0] * 8
        assert row.flipped_ns[0] == table.time[-1]
        assert row.flipped_ns[1] == table.time[298]
        assert row.data == bytes((299 % 256, 0xAA))
        assert row.newest() == table.frames()[-1]
        columns = row.columns()
        assert columns.times.tolist() == table.time.tolist()
        assert columns.data[:, 0].tolist() == [number % 256 for number in range(300)]
    assert (whole.first_ns, whole.last_ns) == (table.time[0], table.time[-1])


def test_the_oldest_bytes_are_left_out_and_counted() -> None:
    """Memory is bounded: counts go on, the oldest bytes go."""
    capture = Capture(kept=100)
    for start in range(5):
        capture.add_frames(frames(60, start_s=10.0 + start))
    (row,) = capture.rows
    assert row.frames == 300
    assert row.kept <= 100
    assert row.kept + capture.left_out == 300
    assert int(row.columns().times[-1]) == capture.last_ns


def test_packets_of_a_kind_are_a_row() -> None:
    """Packets of different lengths are rows of the same columns, padded with zeros."""
    capture = Capture()
    capture.add_packets("Status", "line", [(1, b"\x01\x02", "first"), (2, b"\x01", "second")])
    capture.add_packets("Status", "line", [(3, bytes(70), "third")])
    (row,) = capture.rows
    assert (row.label, row.frames, row.record) == ("Status", 3, "third")
    assert row.columns().lengths.tolist() == [2, 1, 70]
    assert row.newest() is None


def test_columns_between_two_instants() -> None:
    """A stretch has the frames of its time, and at least one."""
    capture = Capture()
    capture.add_frames(frames(100))
    columns = capture.rows[0].columns()
    assert columns.between(10.1, 10.2).data[:, 0].tolist() == list(range(10, 20))
    assert len(columns.between(10.101, 10.102)) == 1


def test_bits_of_rows_are_the_pictures_of_plot() -> None:
    """A picture has the images of `aces plot --bits`, by the names of the rows; none is an error."""
    capture = Capture()
    capture.add_frames(frames(100))
    capture.add_frames(frames(100, 0x18FEF100 & 0x7FF))
    picture = row_pictures(capture.rows)
    assert picture.names() == ["123", "100"]
    assert int(picture.chosen[0].flips[:, 0].sum()) == 99
    with pytest.raises(CallerError, match="nothing to draw"):
        row_pictures([])


def test_a_png_holds_its_pixels() -> None:
    """A PNG is unpacked to the same pixels."""
    pixels = np.random.default_rng(1).integers(0, 256, (3, 5, 4), np.uint8)
    data = png(pixels)
    assert data.startswith(b"\x89PNG\r\n\x1a\n")
    begin = data.index(b"IDAT") + 4
    size = int.from_bytes(data[begin - 8 : begin - 4], "big")
    lines = np.frombuffer(zlib.decompress(data[begin : begin + size]), np.uint8).reshape(3, 21)
    assert (lines[:, 1:].reshape(3, 5, 4) == pixels).all()


def test_a_thinned_curve_keeps_its_extremes() -> None:
    """Each pixel has the least and the greatest of its samples, and gaps stay gaps."""
    x: Any = np.linspace(0, 1, 100_000)
    y: Any = np.sin(40 * x)
    y[5_000] = 7.0
    y[50_000:60_000] = np.nan
    thin_x, thin_y = thinned(x, y, 500)
    assert len(thin_x) <= 1000
    assert np.nanmax(thin_y) == 7.0
    assert np.isnan(thin_y).sum() >= 90
