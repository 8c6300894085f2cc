"""What holds for every format that can be read: told by content, everything counted, nothing but `CaptureError` raised."""

from __future__ import annotations

import gzip
import io
from pathlib import Path
from typing import Any
from unittest import mock

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from aces_bus import Frame, FrameTable, open_recording
from aces_bus.errors import CallerError, CaptureError, UnknownNameError
from aces_bus.recordings.base import CanRecording, SerialRecording
from aces_bus.recordings.open import formats
from aces_bus.recordings.text import rows as _rows
from tests.recordings.formats import ELSEWHERE, SAMPLES, Sample, accounted

IS_LONG = settings().max_examples > 100
BOM = b"\xef\xbb\xbf"
IDS = [f"{sample.format}{number}" for number, sample in enumerate(SAMPLES)]
TEXTS = [sample for sample in SAMPLES if sample.kind == "lines"]
TEXT_IDS = [name for name, sample in zip(IDS, SAMPLES, strict=True) if sample.kind == "lines"]
every = pytest.mark.parametrize("sample", SAMPLES, ids=IDS)
every_text = pytest.mark.parametrize("sample", TEXTS, ids=TEXT_IDS)


class Pieces(io.RawIOBase):
    """A file that comes in small pieces."""

    def __init__(self, content: bytes, size: int) -> None:
        self.content, self.size = content, size

    def readable(self) -> bool:
        return True

    def read(self, size: int = -1) -> bytes:
        data, self.content = self.content[: self.size], self.content[self.size :]
        return data


def opened(content: bytes, form: str | None = None) -> CanRecording | SerialRecording:
    """A recording in memory."""
    return open_recording(io.BytesIO(content), format=form)


def items(capture: CanRecording | SerialRecording) -> list[Any]:
    """All frames or chunks; everything is counted then."""
    found: list[Any] = list(capture)
    accounted(capture)
    return found


def in_one_line(error: CaptureError) -> None:
    """A message is one line."""
    assert "\n" not in str(error)


def whatever(content: bytes, form: str) -> list[Any]:
    """What a damaged recording gives, which may be a message."""
    try:
        capture = opened(content, form)
    except CaptureError as error:
        in_one_line(error)
        return []
    found: list[Any] = []
    try:
        for item in capture:
            found.append(item)
    except CaptureError as error:
        in_one_line(error)
    accounted(capture)
    return found


def line_count(content: bytes) -> int:
    """Lines of a text, the last one with or without its end."""
    return content.count(b"\n") + (not content.endswith(b"\n") and content != b"")


def test_every_format_has_a_recording() -> None:
    """A format that is added is tested with all others, or says why not."""
    assert {sample.format for sample in SAMPLES} | set(ELSEWHERE) >= set(formats())


@every
def test_content_tells_the_format(sample: Sample, tmp_path: Path) -> None:
    """Whatever the suffix says; and the format's name gives the same."""
    path = tmp_path / "recording.mp3"
    path.write_bytes(sample.content)
    with open_recording(path) as capture, opened(sample.content, sample.format) as named:
        assert type(capture) is type(named)
        found = items(capture)
        assert found == items(named)
    if isinstance(capture, CanRecording):
        assert capture.frames == len(found) == sample.frames
    if sample.kind == "lines":
        assert capture.lines == line_count(sample.content)


@every
def test_the_other_link_is_refused(sample: Sample) -> None:
    """A CAN recording is not a serial one and the reverse; the message says what it is."""
    with opened(sample.content) as capture:
        link: Any = "serial" if capture.link == "can" else "can"
    with pytest.raises(CaptureError, match=r"name a (CAN|serial) protocol"):
        open_recording(io.BytesIO(sample.content), link=link)
    with pytest.raises(CallerError, match="link"):
        open_recording(io.BytesIO(sample.content), link=link, format=sample.format)


@every
def test_frames_and_tables_are_the_same(sample: Sample) -> None:
    """As objects, as columns and in small pieces: the same frames, and the same counters."""
    if opened(sample.content).link != "can":
        pytest.skip("bytes of a serial line have no frames")
    capture, columns = opened(sample.content), opened(sample.content)
    source: Any = Pieces(sample.content, 7)
    pieces = open_recording(source, format=sample.format)
    assert isinstance(columns, CanRecording)
    found = items(capture)
    tables = list(columns.tables())
    assert [frame for table in tables for frame in table] == found
    assert all(table.channels is columns.channels for table in tables)
    assert set(columns.channels.names) == {frame.channel for frame in found}
    assert items(pieces) == found
    for other in (columns, pieces):
        assert (other.lines, other.others, other.problems) == (
            capture.lines,
            capture.others,
            capture.problems,
        )


@every
def test_a_packed_recording_is_told_by_what_is_in_it(sample: Sample) -> None:
    """gzip around any format: the same frames and counters."""
    capture, packed = opened(sample.content), opened(gzip.compress(sample.content))
    assert type(packed) is type(capture)
    assert items(packed) == items(capture)
    assert (packed.lines, packed.others) == (capture.lines, capture.others)


@every_text
def test_line_ends_and_byte_order_marks_do_not_matter(sample: Sample) -> None:
    """CR LF, a byte order mark, no end of the last line: the same frames."""
    found = items(opened(sample.content))
    for content in (
        sample.content.replace(b"\r", b"").replace(b"\n", b"\r\n"),
        BOM + sample.content,
        sample.content.rstrip(b"\r\n"),
        sample.content + b"\n\n",
    ):
        capture = opened(content)
        assert capture.format == opened(sample.content).format
        assert items(capture) == found
        assert capture.lines == line_count(content)


CUT_BYTES = {
    "asc": "1.0 1 123 Rx d 2 11 2",
    "trc": ";$FILEVERSION=2.1\n1 1500.0 DT 1 0300 Rx - 2 11 2",
    "busmaster": "***BUSMASTER Ver 2.4.0***\n***HEX***\n00:00:01:5000 Rx 1 0x023 s 2 11 2",
    "crtd": "1.5 1R11 7E8 11 2",
    "gvret": "Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2\n1,5F4,false,Rx,0,2,11,2",
    "microchip": "1500;RX;0x21A;2;0x11;0x2",
    "id-csv": "time;id;dlc;d0;d1\n1;123;2;11;2",
}


@pytest.mark.parametrize("form", CUT_BYTES)
def test_half_a_byte_at_the_end_is_no_byte(form: str) -> None:
    """A file that was cut within its last byte has no other byte there; with the line's end it is taken as written."""
    for rest, unreadable in (("", 1), ("\n", 0), ("2", 0)):
        with open_recording(
            io.BytesIO((CUT_BYTES[form] + rest).encode()), link="can", format=form
        ) as capture:
            tables = list(capture.tables()) if unreadable == 0 else whatever_of(capture)
        assert (capture.lines_unreadable, sum(map(len, tables))) == (unreadable, 1 - unreadable)


def whatever_of(capture: CanRecording) -> list[Any]:
    """The tables of a recording that may hold no frame, and then is none."""
    try:
        return list(capture.tables())
    except CaptureError:
        return []


@every
def test_lines_that_end_with_a_carriage_return_alone_are_unreadable(sample: Sample) -> None:
    """They are one line, whose beginning may look like a header: it is not taken for an empty recording."""
    content = sample.content.replace(b"\r\n", b"\n")
    if sample.kind != "lines" or sample.format in ("candump", "dxconf", "id-csv"):
        pytest.skip("has no headers, or is refused")
    capture = opened(content.replace(b"\n", b"\r"), sample.format)
    assert isinstance(capture, CanRecording)
    whatever_of(capture)
    assert (capture.frames, capture.lines_unreadable) == (0, 1)


@every
def test_a_cut_recording_gives_what_was_whole(sample: Sample) -> None:
    """Cut at any byte: no exception but ours, everything counted, and the frames before the cut as they were."""
    content = sample.content
    capture = opened(content)
    found = items(capture)
    # The short profile cuts long ones at every third byte.
    for end in range(0, len(content), 1 if IS_LONG or len(content) < 300 else 3):
        some = whatever(content[:end], sample.format)
        whole = len(some) - 1 if sample.kind == "lines" else len(some)
        if not isinstance(capture, CanRecording):
            continue
        assert some[: max(whole, 0)] == found[: max(whole, 0)]


@every
@given(data=st.data())
def test_a_damaged_recording_raises_nothing_unforeseen(sample: Sample, data: st.DataObject) -> None:
    """Bytes changed at random: counted losses or one message, never another exception."""
    content = bytearray(sample.content)
    for _ in range(data.draw(st.integers(1, 8))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    whatever(bytes(content), sample.format)
    try:
        capture = opened(bytes(content))
        for _ in capture:
            pass
    except CaptureError:
        return
    accounted(capture)


@every_text
@given(junk=st.lists(st.binary(max_size=60), max_size=12))
def test_lines_of_junk_are_counted(sample: Sample, junk: list[bytes]) -> None:
    """Junk between the lines adds lines, and takes no frame away unless it is a header that says otherwise."""
    lines = sample.content.split(b"\n")
    for number, line in enumerate(junk):
        lines.insert(3 + 2 * number, line)
    content = b"\n".join(lines)
    capture = opened(content, sample.format)
    try:
        for _ in capture:
            pass
    except CaptureError:
        return
    accounted(capture)
    assert capture.lines == line_count(content)


#: Formats that are commonly large, and so have a quick way of `_rows`.
QUICK = [sample for sample in TEXTS if sample.format in ("asc", "trc", "gvret", "csv")]


@pytest.mark.parametrize("sample", QUICK, ids=[sample.format for sample in QUICK])
@given(data=st.data())
def test_the_quick_way_is_the_slow_way(sample: Sample, data: st.DataObject) -> None:
    """Many lines at once and each for itself give the same columns and counters, whatever faults are among them."""
    lines = [line for line in sample.content.split(b"\n") if line]
    many = bytearray(b"\n".join(lines + lines[-9:] * 30 + lines + lines[3:] * 5) + b"\n")
    for _ in range(data.draw(st.integers(0, 6))):
        place = data.draw(st.integers(0, len(many) - 1))
        some = bytes(many[place : place + 20])
        change = data.draw(
            st.sampled_from([some[1:], b" " + some, b"0" + some, some[::-1], some.lower(), some * 2])
        )
        many[place : place + 20] = change
    quick, slow = opened(bytes(many), sample.format), opened(bytes(many), sample.format)
    assert isinstance(quick, CanRecording)
    assert isinstance(slow, CanRecording)
    found = rows(quick)
    with mock.patch.object(_rows, "_TRIES", 0):
        assert rows(slow) == found
    accounted(slow)
    counters = "lines", "frames", "lines_unreadable", "lines_comment", "lines_blank", "others", "problems"
    assert [getattr(quick, name) for name in counters] == [getattr(slow, name) for name in counters]


def rows(capture: CanRecording) -> list[tuple[int, Frame]]:
    """Instants in ns, which are finer than seconds as floats, and frames."""
    table = FrameTable.concat(list(capture.tables()))
    return list(zip(table.time.tolist(), table.frames(), strict=True))


@every_text
def test_an_empty_recording_has_no_frames(sample: Sample) -> None:
    """Nothing, or nothing but blank lines, is an empty recording of any format of lines."""
    for content in (b"", b"\n\r\n \n", BOM):
        capture = opened(content, sample.format)
        assert items(capture) == []
        assert capture.lines == capture.lines_blank == line_count(content.removeprefix(BOM))


@every_text
def test_what_is_no_such_recording_is_refused(sample: Sample) -> None:
    """A format that was named wrongly is told by its lines, none of which can be read."""
    junk = b"dear diary\n" * 300
    capture_of_bytes = opened(sample.content).link == "serial"
    if capture_of_bytes:
        pytest.skip("any bytes may be")
    with pytest.raises(CaptureError, match=r"not a|no column"):
        list(opened(junk, sample.format))


@every_text
def test_a_line_without_end_needs_no_memory(sample: Sample) -> None:
    """A megabyte without a line end is one unreadable line, and what follows is read."""
    content = sample.content + b"1" * 1_000_000 + b"\n" + b"\n"
    capture = opened(content, sample.format)
    found = list(capture)
    accounted(capture)
    assert found == list(opened(sample.content))
    assert capture.lines == line_count(content)
    assert capture.lines_unreadable == opened_unreadable(sample) + 1


def opened_unreadable(sample: Sample) -> int:
    """How many lines of a recording cannot be read as it is."""
    capture = opened(sample.content)
    for _ in capture:
        pass
    return capture.lines_unreadable


def test_an_unknown_format_lists_those_that_exist() -> None:
    """A slip of the finger is met with the name that was meant."""
    with pytest.raises(UnknownNameError, match=r"did you mean 'gvret'\? \(there are: gvret, "):
        open_recording(io.BytesIO(b""), format="gvrt")
