"""Our readers beside python-can's, on the same files, written by python-can and by us, with any frames.

1. Frame for frame everything is equal; what is not is in `WRONG_THERE`, each with its reason.
"""

from __future__ import annotations

import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import can
import pytest

from aces_bus import Frame, FrameTable, open_recording
from aces_bus.frames import FD_LENGTHS
from aces_bus.recordings.write import open_writer

#: Suffix, python-can's writer and reader, and the reader's options.
FORMATS: dict[str, tuple[str, Any, Any, dict[str, Any]]] = {
    "candump": (".log", can.CanutilsLogWriter, can.CanutilsLogReader, {}),
    "asc": (".asc", can.ASCWriter, can.ASCReader, {"relative_timestamp": False}),
    "trc": (".trc", can.TRCWriter, can.TRCReader, {}),
    "blf": (".blf", can.BLFWriter, can.BLFReader, {}),
    "csv": (".csv", can.CSVWriter, can.CSVReader, {}),
    "sqlite": (".db", can.SqliteWriter, can.SqliteReader, {}),
}
ATTRIBUTES = (
    *("arbitration_id", "is_extended_id", "is_remote_frame", "is_error_frame", "is_fd", "bitrate_switch"),
    *("error_state_indicator", "is_rx", "channel", "data", "dlc"),
)
Test = Callable[[can.Message], bool]


def is_error(message: can.Message) -> bool:
    """Of an error frame."""
    return message.is_error_frame


def always(_: can.Message) -> bool:
    """Of every frame."""
    return True


#: Format, of which frames, attributes that python-can gives otherwise, and why.
WRONG_THERE: tuple[tuple[str, Test, tuple[str, ...], str], ...] = (
    ("candump", is_error, ATTRIBUTES, "an error frame loses all but its time, or comes back as a data frame"),
    ("asc", is_error, ("is_extended_id", "is_rx"), "defaults of can.Message: the line says neither"),
    (
        "asc",
        lambda m: m.is_fd and m.dlc == 0,
        ("is_remote_frame", "is_fd", "bitrate_switch", "error_state_indicator"),
        "no data are taken for a remote frame",
    ),
    ("trc", always, ("channel",), "buses count from 1"),
    ("trc", lambda m: m.is_fd, ("dlc",), "the length code is taken for the length"),
    ("blf", is_error, ("is_rx", "is_extended_id"), "a default of can.Message: the object does not say it"),
    ("csv", is_error, ("is_extended_id",), "an error frame has a class, and no identifier of 11 or 29 bits"),
    ("sqlite", is_error, ("is_extended_id",), "the same"),
    ("csv", always, ("is_rx",), "a default of can.Message: there is no column for it"),
    ("sqlite", always, ("is_rx",), "the same"),
    ("csv", lambda m: len(m.data) > 8, ("is_fd",), "more than 8 bytes are not taken for CAN FD"),
    ("sqlite", lambda m: len(m.data) > 8, ("is_fd",), "the same"),
)


def drawn(dice: random.Random, kinds: tuple[str, ...]) -> list[can.Message]:
    """Messages of any kinds, flags, channels and directions, in order of time."""
    messages: list[can.Message] = []
    for number in range(dice.choice([1, 2, 40])):
        extended, kind = dice.random() < 0.4, dice.choice(kinds)
        size = dice.choice(FD_LENGTHS) if kind == "fd" else dice.randint(0, 8)
        messages.append(
            can.Message(
                timestamp=1436509052.5 + number / 1024,
                arbitration_id=dice.getrandbits(29 if extended else 11),
                is_extended_id=extended,
                is_remote_frame=kind == "remote",
                is_error_frame=kind == "error",
                is_fd=kind == "fd",
                bitrate_switch=kind == "fd" and dice.random() < 0.5,
                error_state_indicator=kind == "fd" and dice.random() < 0.5,
                is_rx=dice.random() < 0.5,
                channel=dice.randint(0, 3),
                dlc=size,
                data=None if kind == "remote" else dice.randbytes(size),
            )
        )
    return messages


def compare(form: str, path: Path, messages: list[can.Message]) -> None:
    """Both readers give all messages, and all attributes the same but for `WRONG_THERE`."""
    _, _, reader, options = FORMATS[form]
    with open_recording(path, link="can") as capture:
        ours = list(capture)
        assert capture.problems == []
        assert capture.others in ({}, {"measurement events": 1})  # which python-can puts into ASC
    theirs = list(reader(path, **options))
    assert len(ours) == len(theirs) == len(messages)
    for frame, other, message in zip(ours, theirs, messages, strict=True):
        assert frame.timestamp == pytest.approx(other.timestamp, abs=1e-6)
        excused = {
            name for of, test, names, _ in WRONG_THERE if of == form and test(message) for name in names
        }
        for name in ATTRIBUTES:
            if name not in excused:
                assert attribute(frame, name) == attribute(other, name), (name, frame, other)


def attribute(frame: Any, name: str) -> Any:
    """One attribute of our frame or of their message, in one form."""
    value = frame.length if name == "dlc" and isinstance(frame, Frame) else getattr(frame, name)
    if name == "data":
        return bytes(value or b"")
    return str(value) if name == "channel" and value is not None else value


#: python-can's SQLite writer takes half a second to stop: one file is enough.
FILES = [(form, seed) for form in FORMATS for seed in range(1 if form == "sqlite" else 8)]


@pytest.mark.parametrize(("form", "seed"), FILES)
def test_what_python_can_writes_is_read_as_by_python_can(form: str, seed: int, tmp_path: Path) -> None:
    """Any frames that its writer takes: TRC only classic data frames, the others all."""
    suffix, writer, _, _ = FORMATS[form]
    path = tmp_path / f"walk{suffix}"
    kinds = ("data",) if form == "trc" else ("data", "data", "remote", "fd", "error")
    messages = drawn(random.Random(seed), kinds)
    with writer(path) as out:
        for message in messages:
            out(message)
    compare(form, path, messages)


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("form", ["candump", "asc", "trc", "blf"])
def test_what_we_write_is_read_as_by_python_can(form: str, seed: int, tmp_path: Path) -> None:
    """Any frames; in TRC without error frames and error states, which its reader does not know."""
    path = tmp_path / f"walk{FORMATS[form][0]}"
    messages = drawn(random.Random(100 + seed), ("data", "data", "remote", "fd", "error"))
    if form == "trc":
        messages = [one for one in messages if not one.is_error_frame and not one.error_state_indicator]
        messages = messages or drawn(random.Random(seed), ("data",))
    frames = [
        Frame(
            one.arbitration_id,
            b"" if one.is_remote_frame else bytes(one.data),
            one.timestamp,
            f"can{one.channel}",
            one.is_extended_id,
            one.is_remote_frame,
            one.is_error_frame,
            one.is_fd,
            one.bitrate_switch,
            one.error_state_indicator,
            one.is_rx,
            one.dlc if one.is_remote_frame else None,
        )
        for one in messages
    ]
    with open_writer(path) as writer:
        writer.write(FrameTable.from_frames(frames))
    compare(form, path, messages)
