"""Files that are written: by which suffix, packed, into pipes, whole or absent; and bytes of serial lines."""

from __future__ import annotations

import gzip
import io
import os
import stat
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from aces_bus import Frame, FrameTable, open_recording
from aces_bus.errors import CallerError, UnknownNameError
from aces_bus.recordings.base import Chunk
from aces_bus.recordings.open import formats
from aces_bus.recordings.write import open_writer, writer_format, writer_formats


def written(form: str) -> bytes:
    """The bytes of a file of the one frame."""
    file = io.BytesIO()
    with open_writer(file, form) as writer:
        writer.write(FRAMES)
    return file.getvalue()


# ---- files ---------------------------------------------------------------------------------------------------------

FRAMES = FrameTable.from_frames([Frame(1, b"\x01", 1.0, "can0")])


def test_the_suffix_chooses_the_format(tmp_path: Path) -> None:
    """Each suffix, of either case and with one for packing behind, opens its writer; another is refused with a list."""
    assert sorted(
        writer_format(f"x.{end}").name
        for end in ("log", "ASC", "blf.gz", "trc.ZST", "pcapng", "csv", "db", "mf4", "gvret.csv")
    ) == sorted(form.name for form in writer_formats().values() if form.link == "can")
    assert writer_format("x.dxconf.txt").name == "dxconf"
    with pytest.raises(CallerError, match=r"names no format; there are \.log"):
        open_writer(tmp_path / "walk.xyz")
    with pytest.raises(UnknownNameError, match="candump"):
        open_writer(tmp_path / "walk.log", "candunp")
    with pytest.raises(CallerError, match="name the format"):
        open_writer(io.BytesIO())
    with pytest.raises(CallerError, match="holds bytes of a serial line, and these are CAN frames"):
        open_writer(tmp_path / "walk.bin", link="can")
    assert list(tmp_path.iterdir()) == []


def test_gzip_and_zstd(tmp_path: Path) -> None:
    """A packed file unpacks to what is written unpacked, a BLF file's second header included."""
    zstandard = pytest.importorskip("zstandard")
    for form in ("log", "blf"):
        plain = written(writer_format(f"x.{form}").name)
        for packed in ("gz", "zst"):
            path = tmp_path / f"walk.{form}.{packed}"
            with open_writer(path) as writer:
                writer.write(FRAMES)
            content = path.read_bytes()
            unpacked = (
                gzip.decompress(content)
                if packed == "gz"
                else zstandard.ZstdDecompressor().stream_reader(io.BytesIO(content)).read()
            )
            assert unpacked == plain


def interrupted(path: Path) -> None:
    """Ctrl-C while a file is written."""
    with open_writer(path) as writer:
        writer.write(FRAMES)
        assert not path.exists() or path.read_bytes() == b"precious"
        raise KeyboardInterrupt


@pytest.mark.parametrize("suffix", ["log", "blf", "asc.gz", "log.zst"])
def test_a_file_is_whole_or_absent(tmp_path: Path, suffix: str) -> None:
    """An exception leaves nothing behind and an older file as it was; before the end there is no file of the name."""
    path = tmp_path / f"walk.{suffix}"
    for before in (None, b"precious"):
        if before is not None:
            path.write_bytes(before)
        with pytest.raises(KeyboardInterrupt):
            interrupted(path)
        assert [p.name for p in tmp_path.iterdir()] == ([] if before is None else [path.name])
    assert path.read_bytes() == b"precious"
    with open_writer(path) as writer:
        writer.write(FRAMES)
    assert path.read_bytes() != b"precious"
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


def test_files_that_must_not_be_written(tmp_path: Path) -> None:
    """An input, also by another name of it, a folder, and a place that does not exist are refused in one line."""
    source = tmp_path / "walk.log"
    source.write_bytes(b"(1.0) can0 001#\n")
    (tmp_path / "other.log").symlink_to(source)
    with pytest.raises(CallerError, match="is one of the files to read"):
        open_writer(tmp_path / "other.log", inputs=[str(source)])
    (tmp_path / "folder.log").mkdir()
    with pytest.raises(CallerError, match="this is a folder"):
        open_writer(tmp_path / "folder.log")
    with pytest.raises(CallerError, match="cannot be written"):
        open_writer(tmp_path / "nowhere" / "walk.log")
    assert source.read_bytes() == b"(1.0) can0 001#\n"


def test_links_permissions_and_devices_stay(tmp_path: Path) -> None:
    """A link goes on naming its file, a replaced file keeps its permissions, and a device is not replaced."""
    real, link = tmp_path / "real.log", tmp_path / "link.log"
    real.write_bytes(b"")
    real.chmod(0o640)
    link.symlink_to(real)
    with open_writer(link) as writer:
        writer.write(FRAMES)
    assert link.is_symlink()
    assert real.read_bytes() == b"(0000000001.000000) can0 001#01\n"
    assert stat.S_IMODE(real.stat().st_mode) == 0o640
    if Path(os.devnull).is_char_device():
        with open_writer(os.devnull, "blf") as writer:
            writer.write(FRAMES)
        assert Path(os.devnull).is_char_device()


class Pipe(io.BytesIO):
    """A pipe."""

    def seekable(self) -> bool:
        return False

    def seek(self, *_: Any) -> int:
        raise io.UnsupportedOperation("seek")


def test_a_header_that_is_written_last_reaches_pipes(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """BLF through a pipe, standard output, or at the end of a file of the caller, is what it is in a file of its own."""
    plain = written("blf")
    pipe = Pipe()
    with open_writer(pipe, "blf") as writer:
        writer.write(FRAMES)
    assert pipe.getvalue() == plain
    stdout = io.TextIOWrapper(io.BytesIO())
    monkeypatch.setattr("sys.stdout", stdout)
    with open_writer("-", "blf") as writer:
        writer.write(FRAMES)
    monkeypatch.undo()
    assert stdout.buffer.getvalue() == plain
    path = tmp_path / "several"
    for mode in ("wb", "ab", "r+b"):
        with path.open(mode) as file:
            file.seek(0, 2)
            with open_writer(file, "blf") as writer:
                writer.write(FRAMES)
    assert path.read_bytes() == plain * 3


class Full(io.BytesIO):
    """A disk without room."""

    def write(self, data: Any) -> int:
        raise OSError(28, "No space left on device")


def test_a_full_disk_is_one_line() -> None:
    """What the system refuses while writing is a CallerError that names the file."""
    writer = open_writer(Full(), "candump")
    with pytest.raises(CallerError, match="<stream>: writing stopped: No space left"):
        writer.write(FRAMES)


# ---- serial lines --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("form", ["raw", "dxconf", "slog"])
@given(chunks=st.lists(st.binary(min_size=1, max_size=40), max_size=8))
def test_serial_bytes_come_back(form: str, chunks: list[bytes]) -> None:
    """The bytes of all chunks come back in order, from raw bytes, from rows of sixteen, and from our own log."""
    file = io.BytesIO()
    with open_writer(file, form) as writer:
        for number, data in enumerate(chunks):
            writer.write(Chunk(data, number / 8, "to device"))
    if form != "slog":
        assert writer.lossy == (
            {"times of chunks": len(chunks), "directions of chunks": len(chunks)} if chunks else {}
        )
    elif form not in formats():
        pytest.skip("no reader of slog")
    name = "raw" if form == "raw" else None  # bytes alone do not say what they are
    with open_recording(io.BytesIO(file.getvalue()), link="serial", format=name) as capture:
        assert b"".join(chunk.data for chunk in capture) == b"".join(chunks)
        assert capture.lines_unreadable == 0


def test_rows_of_a_hex_dump() -> None:
    """A row has sixteen bytes and their characters, whatever the chunks were."""
    file = io.BytesIO()
    with open_writer(file, "dxconf") as writer:
        writer.write(Chunk(b"\xff\xff\x01ABC"))
        writer.write(Chunk(bytes(range(0x44, 0x4F))))
    assert file.getvalue().decode() == (
        'Port opened by process "aces"\n\n'
        " FF FF 01 41 42 43 44 45 46 47 48 49 4A 4B 4C 4D   ...ABCDEFGHIJKLM\n"
        " 4E                                                N\n"
        "\nPort closed\n"
    )


def test_a_writer_that_cannot_be_made_leaves_no_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What was opened for it is gone, and what had the name is as it was."""

    def refuse(form: object, file: object) -> None:
        raise MemoryError("no room")

    monkeypatch.setattr("aces_bus.recordings.write.OpenWriter", refuse)
    kept = tmp_path / "kept.log"
    kept.write_text("as it was")
    for path in (tmp_path / "new.log", tmp_path / "new.log.gz", kept):
        with pytest.raises(MemoryError):
            open_writer(path)
    assert [one.name for one in tmp_path.iterdir()] == ["kept.log"]
    assert kept.read_text() == "as it was"
