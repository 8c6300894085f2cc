"""Tests of plug-ins, one line each: what every reader, writer, exporter, log, database, verb, backend and store must do.

    from aces_bus.testing.plug_ins import reader_tests
    test_theirs = reader_tests("theirs", b"THEIR 123 0a0b\n", frames=1)

1. A suite tests what is installed under a name, through the public door that its users have; nothing is imported of it.
2. Each check is one sentence. A suite returns them as one parametrised pytest test, whose cases are named after the checks.

Drivers have `driver_tests`, protocols `law_tests`.
"""

from __future__ import annotations

import contextlib
import io
import os
from collections.abc import Callable, Mapping
from importlib import import_module
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

from construct import Int16sl, Struct

from ..controller.log.base import About, Log
from ..controller.log.columns import LogColumn
from ..controller.log.formats import log_format, log_formats, open_sink, read_log, recover
from ..errors import CallerError, CaptureError
from ..export.open import export_format, open_export, table_formats
from ..frame_table import FrameTable
from ..frames import Frame
from ..hardware import CanGate
from ..plugins import installed_points
from ..protocol import Protocol, Quantity
from ..protocol.columns.scanner import make_column_scanner
from ..protocol.exchange import database_suffixes, load_database
from ..recordings.base import CanRecording, Chunk, SerialRecording
from ..recordings.open import formats, open_recording
from ..recordings.write import open_writer, writer_format, writer_formats

#: Frames that writers are tested with.
FRAMES = [
    Frame(0x123, bytes(range(8)), 1_500_000_000.5, "0", is_rx=True),
    Frame(0x18FEF100, b"\x01\x02", 1_500_000_001.25, "0", is_extended_id=True, is_rx=True),
    Frame(0x7FF, b"", 1_500_000_002.0, "0", is_rx=True),
]
CHUNKS = [Chunk(b"\xff\xff\x01\x02", 1.5, "to device"), Chunk(b"\x01\xfb", 1.5, "to device")]
_PLUGIN = Protocol("plug_in_tests", link="can", source="made up for tests of plug-ins")
_PLUGIN.message(
    "Sample", id=0x123, payload=Struct("x" / Quantity(Int16sl, unit="V", scale=0.5)), source="made up"
)

Check = Callable[[Path], None]


def _suite(checks: Mapping[str, Check]) -> Callable[[str, Path], None]:
    import pytest

    @pytest.mark.parametrize("check", list(checks))
    def test(check: str, tmp_path: Path) -> None:
        checks[check](tmp_path)

    return test


# ---------------------------------------------------------------------- recordings


def _read(content: bytes, format: str | None = None) -> tuple[CanRecording | SerialRecording, list[Any]]:
    with open_recording(io.BytesIO(content), name="sample", format=format) as recording:
        return recording, list(recording)


def reader_tests(name: str, sample: bytes, *, frames: int) -> Callable[[str, Path], None]:
    """Return the tests of an installed reader. `sample` is a recording of `frames` frames (or chunks of a serial line)."""

    def recognised(_: Path) -> None:
        """Check that the sample is recognized by its content, and all of its frames are read."""
        recording, items = _read(sample)
        assert len(items) == frames
        assert name in formats()
        assert type(recording) is type(_read(sample, name)[0])

    def columns(_: Path) -> None:
        """Check that as columns the frames are the same."""
        recording, items = _read(sample)
        if isinstance(recording, CanRecording):
            with open_recording(io.BytesIO(sample), link="can") as again:
                rows = [frame for table in again.tables() for frame in table.frames()]
            assert [(frame.arbitration_id, frame.data) for frame in rows] == [
                (frame.arbitration_id, frame.data) for frame in items
            ]

    def accounts(_: Path) -> None:
        """Check that each line or object that was read is a frame, or is counted as something else."""
        recording, _items = _read(sample)
        if isinstance(recording, CanRecording):
            parts = recording.lines_unreadable + recording.lines_comment + recording.lines_blank
            assert recording.lines == recording.frames + parts + sum(recording.others.values())
        assert len(recording.problems) == min(5, recording.lines_unreadable)

    def damaged(_: Path) -> None:
        """Check that whatever is cut off or changed, what is wrong is counted, or a `CaptureError` says it."""
        step = max(1, len(sample) // 64)
        cut = [sample[:size] for size in range(0, len(sample), step)]
        for content in cut + [
            sample[:at] + bytes([sample[at] ^ 0x55]) + sample[at + 1 :] for at in range(0, len(sample), step)
        ]:
            with contextlib.suppress(CaptureError):
                _read(content, name)

    return _suite({"recognised": recognised, "columns": columns, "accounts": accounts, "damaged": damaged})


def writer_tests(name: str) -> Callable[[str, Path], None]:
    """Return the tests of an installed writer, whose recordings an installed reader reads."""
    form = writer_formats()[name]

    def items() -> list[Any]:
        return [FrameTable.from_frames(FRAMES)] if form.link == "can" else list(CHUNKS)

    def chosen(folder: Path) -> None:
        """Check that one of its suffixes chooses it."""
        assert name in {writer_format(f"walk{suffix}").name for suffix in form.suffixes}

    def read_back(folder: Path) -> None:
        """Check that what was written is read back; what the format cannot hold is in `lossy`."""
        path = folder / f"walk{form.suffixes[0]}"
        with open_writer(path, name) as writer:
            for item in items():
                writer.write(item)
        assert all(count > 0 for count in writer.lossy.values())
        with open_recording(
            path, link=form.link, format=name if form.link == "serial" else None
        ) as recording:
            found: list[Any] = list(recording)
        if form.link == "can":
            assert [(frame.arbitration_id, frame.data) for frame in found] == [
                (frame.arbitration_id, frame.data) for frame in FRAMES
            ]
        else:
            assert b"".join(chunk.data for chunk in found) == b"".join(chunk.data for chunk in CHUNKS)

    def whole(folder: Path) -> None:
        """Check that a recording that is not finished leaves no file, and another that has the name stays."""
        path = folder / f"walk{form.suffixes[0]}"
        path.write_bytes(b"before")
        with contextlib.suppress(KeyboardInterrupt), open_writer(path, name) as writer:
            writer.write(items()[0])
            raise KeyboardInterrupt
        assert path.read_bytes() == b"before"
        assert [file.name for file in folder.iterdir()] == [path.name]

    return _suite({"chosen": chosen, "read_back": read_back, "whole": whole})


# ---------------------------------------------------------------------- tables, logs, databases


def exporter_tests(name: str) -> Callable[[str, Path], None]:
    """Return the tests of an installed format of decoded tables."""
    form = table_formats()[name]

    def place(folder: Path) -> str:
        return f"{folder}/walk{form.suffixes[0]}" if form.suffixes else f"{folder}/walk.{name}/"

    def tables() -> list[Any]:
        frames = FrameTable.from_frames([Frame(0x123, bytes([i, 0]), 1.5e9 + i, "can0") for i in range(5)])
        return make_column_scanner([_PLUGIN.variant()]).feed(frames)

    def chosen(folder: Path) -> None:
        """Check that its suffixes choose it."""
        assert {export_format(f"walk{suffix}") for suffix in form.suffixes} <= {name}
        assert export_format(place(folder)) == name

    def whole(folder: Path) -> None:
        """Check that what is not finished leaves nothing behind; what is, has all rows."""
        with (
            contextlib.suppress(KeyboardInterrupt),
            open_export(place(folder), name, variants=[_PLUGIN.variant()]) as export,
        ):
            export.write(tables())
            raise KeyboardInterrupt
        assert list(folder.iterdir()) == []
        with open_export(place(folder), name, variants=[_PLUGIN.variant()]) as export:
            export.write(tables())
        assert export.rows == {"Sample": 5}
        assert len(list(folder.iterdir())) == 1

    def grows(folder: Path) -> None:
        """Check that it is refused live, or has its place, and more bytes, after each commit."""
        if not form.growing:
            with contextlib.suppress(CallerError):
                open_export(place(folder), name, live=True)
                raise AssertionError(f"{name} is opened live, and does not grow")
            return
        sizes = [0]
        with open_export(place(folder), name, variants=[_PLUGIN.variant()], live=True) as export:
            for _ in range(2):
                export.write(tables())
                export.commit()
                assert os.path.exists(place(folder))
                sizes.append(export.size)
        assert 0 < sizes[1] <= sizes[2]

    return _suite({"chosen": chosen, "whole": whole, "grows": grows})


def log_tests(name: str) -> Callable[[str, Path], None]:
    """Return the tests of an installed format of logs."""
    form = log_formats()[name]
    rows = [(0, [1.0, float("nan")]), (5_000_000, [2.5, -1.0])]

    def write(path: str, *, ends: bool) -> None:
        columns = (LogColumn("RHY", "", "rad"), LogColumn("RHR", "", "rad"))
        sink = open_sink(path, name, About(columns, rate_hz=200.0))
        sink.append(rows)
        sink.sync()
        if ends:
            sink.close()

    def check(log: Log) -> None:
        assert log.time_s.tolist() == [0.0, 0.005]
        assert log.values.tolist()[1] == [2.5, -1.0]
        assert log.values[0, 0] == 1.0
        assert log.values[0, 1] != log.values[0, 1], "unknown is NaN"

    def read_back(folder: Path) -> None:
        """Check that a suffix chooses it, and what was written is read back; unknown is NaN."""
        path = f"{folder}/walk{form.suffixes[0]}"
        assert log_format(path) == name
        write(path, ends=True)
        check(read_log(path))
        assert len(list(folder.iterdir())) == 1

    def killed(folder: Path) -> None:
        """Check that a log whose writer was killed has all rows, and that `recover` closes it where that is needed."""
        path = f"{folder}/walk{form.suffixes[0]}"
        write(path, ends=False)
        check(read_log(path))
        if form.recovery:
            assert recover(path) == len(rows)
            check(read_log(path))

    return _suite({"read_back": read_back, "killed": killed})


def database_tests(file: str, sample: bytes) -> Callable[[str, Path], None]:
    """Return the tests of an installed kind of database: `sample` is what a file of this name holds."""

    def loaded(folder: Path) -> None:
        """Check that its suffix is listed; the sample is a protocol with messages, whose scanner can be made."""
        assert file.lower().endswith(database_suffixes())
        (folder / file).write_bytes(sample)
        imported = load_database(folder / file)
        variant = imported.protocol.variant()
        assert variant.messages
        make_column_scanner([variant])

    def damaged(folder: Path) -> None:
        """Check that what is no such file is refused with a `CallerError` that names it, whatever was cut off."""
        for size in range(0, len(sample), max(1, len(sample) // 16)):
            (folder / file).write_bytes(sample[:size])
            said = file
            try:
                load_database(folder / file)
            except CallerError as error:
                said = str(error)
            assert file in said

    return _suite({"loaded": loaded, "damaged": damaged})


# ---------------------------------------------------------------------- verbs, buses, stores


def verb_tests(name: str) -> Callable[[str, Path], None]:
    """Return the tests of an installed verb of `aces`, or of an action: "spec check"."""

    def aces(*words: str) -> tuple[int, str, str]:
        (command,) = entry_points(group="console_scripts", name="aces")
        out, err = io.StringIO(), io.StringIO()
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            status = command.load()([*name.split(), *words])
        return status, out.getvalue(), err.getvalue()

    def whole(_: Path) -> None:
        """Check that its module has a docstring, a SUMMARY that fits on a line, ARGUMENTS and `run`."""
        points = {point.name: point for point in installed_points("aces_bus.verbs")}
        module = points[name.replace(" ", ".")].load()
        assert module.__doc__
        assert module.SUMMARY.strip() == module.SUMMARY
        assert 0 < len(module.SUMMARY) <= 72
        assert "\n" not in module.SUMMARY
        list(module.ARGUMENTS)
        assert callable(module.run)

    def explains(_: Path) -> None:
        """Check that `--help` ends with status 0, and says what its docstring says first."""
        status, out, err = aces("--help")
        assert (status, err) == (0, "")
        assert "usage:" in out

    def refuses(_: Path) -> None:
        """Check that an option that does not exist is one line on stderr, with status 2."""
        status, out, err = aces("--no-such-option-here")
        assert (status, out, err.count("\n")) == (2, "", 1)

    return _suite({"whole": whole, "explains": explains, "refuses": refuses})


def backend_tests(*ends: Mapping[str, Any]) -> Callable[[str, Path], None]:
    """Return the tests of a backend of python-can. `ends` are the keywords of two buses on one wire."""
    one, other = ends

    def passed(folder: Path) -> None:
        """Check that a frame that a gate sends comes out of another, as it was; what was sent does not come back."""
        with CanGate(one) as sender, CanGate(other) as receiver:
            inbox, own = receiver.subscribe(), sender.subscribe()
            sender.send(Frame(0x123, b"\x01\x02"))
            sender.send(Frame(0x18FEF100, b"", is_extended_id=True))
            found: list[Frame] = []
            for _ in range(50):
                found += [item.content for item in inbox.get(0.1)]
                if len(found) == 2:
                    break
            assert [(frame.arbitration_id, frame.data) for frame in found] == [
                (0x123, b"\x01\x02"),
                (0x18FEF100, b""),
            ]
            assert list(own.get(0.0)) == []

    def reopened(folder: Path) -> None:
        """Check that a bus that was closed can be opened again."""
        for _ in range(2):
            with CanGate(one), CanGate(other, listen_only=True) as listener:
                assert listener.listen_only

    return _suite({"passed": passed, "reopened": reopened})


def store_tests(uri: str) -> Callable[[str, Path], None]:
    """Return the tests of a store of fsspec (its group is `fsspec.specs`) as fleets use it; `uri` is an empty folder."""

    def opened() -> tuple[Any, str]:
        return import_module("fsspec.core").url_to_fs(uri)  # type: ignore[no-any-return]

    def kept(folder: Path) -> None:
        """Check that a file that is put is read back, whole or in part, and is listed with its size."""
        store, path = opened()
        (folder / "a").write_bytes(b"0123456789")
        store.makedirs(path, exist_ok=True)
        store.put_file(str(folder / "a"), f"{path}/a.log")
        assert store.cat_file(f"{path}/a.log") == b"0123456789"
        with store.open(f"{path}/a.log", "rb") as file:
            file.seek(3)
            assert file.read(4) == b"3456"
        store.invalidate_cache()
        found = store.glob(f"{path}/*.log", detail=True)
        assert [info["size"] for info in found.values()] == [10]
        store.rm_file(f"{path}/a.log")

    def moved(_: Path) -> None:
        """Check that a file that is written beside its place and renamed is there under its name alone."""
        store, path = opened()
        store.makedirs(path, exist_ok=True)
        store.pipe_file(f"{path}/.b.part", b"whole")
        store.mv(f"{path}/.b.part", f"{path}/b")
        store.invalidate_cache()
        assert store.cat_file(f"{path}/b") == b"whole"
        assert not store.exists(f"{path}/.b.part")
        store.rm_file(f"{path}/b")

    def missing(_: Path) -> None:
        """Check that what is not there is a `FileNotFoundError`."""
        store, path = opened()
        for call in (store.info, store.cat_file, store.rm_file):
            with contextlib.suppress(FileNotFoundError):
                call(f"{path}/nothing")
                raise AssertionError(f"{call.__name__} of a file that is not there raises nothing")

    return _suite({"kept": kept, "moved": moved, "missing": missing})


__all__ = [
    "backend_tests",
    "database_tests",
    "exporter_tests",
    "log_tests",
    "reader_tests",
    "store_tests",
    "verb_tests",
    "writer_tests",
]
