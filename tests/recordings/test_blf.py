"""Vector BLF logs: python-can as second witness, objects built by hand, and damage that costs only what it hits."""

from __future__ import annotations

import io
import random
import struct
import zlib
from pathlib import Path
from typing import Any

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

from aces_bus import Frame, FrameTable, open_recording
from aces_bus.errors import CaptureError
from aces_bus.frame_table import NO_TIME
from aces_bus.frames import FD_LENGTHS
from aces_bus.recordings.base import CanRecording
from aces_bus.recordings.write import open_writer
from aces_lab.formats.blf import reader as blf
from aces_lab.formats.blf.reader import BlfCapture

START = 1436509052_250_000_000  # ns; 2015-07-10 06:17:32.250 UTC
STAMP = 1_000_001


def header(when: tuple[int, ...] = (2015, 7, 5, 10, 6, 17, 32, 250), objects: int = 0) -> bytes:
    """A file header with this start of the measurement and number of objects."""
    head = (b"LOGG" + struct.pack("<L", 144)).ljust(32, b"\0") + struct.pack("<LL", objects, 0)
    return head + struct.pack("<8H", *when) + bytes(88)


def thing(
    kind: int, payload: bytes, *, stamp: int = STAMP, unit: int = 2, version: int = 1, size: int | None = None
) -> bytes:
    """An object, padded as Vector's are."""
    head = struct.pack("<LHHQ", unit, 0, 0, stamp) + (bytes(8) if version == 2 else b"")
    length = 16 + len(head) + len(payload) if size is None else size
    whole = struct.pack("<4sHHLL", b"LOBJ", 16 + len(head), version, length, kind) + head + payload
    return whole + bytes(len(whole) % 4)


def container(data: bytes, *, method: int = 2, claimed: int | None = None) -> bytes:
    """A container around these objects."""
    packed = zlib.compress(data) if method == 2 else data
    whole = struct.pack("<4sHHLLH6xL4x", b"LOBJ", 16, 1, 32 + len(packed), 10, method, claimed or len(data))
    return whole + packed + bytes(len(packed) % 4)


def message(
    identifier: int = 0x123, data: bytes = b"\x01\x02", flags: int = 0, code: int | None = None
) -> bytes:
    """The payload of a CAN_MESSAGE on channel 1."""
    return struct.pack("<HBBL8s", 1, flags, len(data) if code is None else code, identifier, data)


def read(content: bytes) -> tuple[list[Frame], CanRecording]:
    """All frames and the capture; every object is counted."""
    capture = BlfCapture(blf_source(content))
    frames = [frame for table in capture.tables() for frame in table.frames()]
    assert len(frames) == capture.frames
    assert capture.lines == capture.frames + capture.lines_unreadable + sum(capture.others.values())
    assert len(capture.problems) == min(5, capture.lines_unreadable)
    return frames, capture


def blf_source(content: bytes) -> Any:
    """A source of these bytes."""
    from aces_bus.recordings.source import ByteSource

    return ByteSource(io.BytesIO(content), "walk.blf")


def log(*objects: bytes) -> bytes:
    """A log of one container."""
    return header() + container(b"".join(objects))


def fd_64(identifier: int, data: bytes, flags: int, sent: int = 0, further: int = 0) -> bytes:
    """The payload of a CAN_FD_MESSAGE_64 on channel 3."""
    code = FD_LENGTHS.index(len(data))
    head = struct.pack(
        "<BBBBLLL4LHBBL", 3, code, len(data), 0, identifier, 0, flags, *[0] * 4, 0, sent, further, 0
    )
    return head + data


def fd_error_64(identifier: int, data: bytes) -> bytes:
    """The payload of a CAN_FD_ERROR_64 on channel 4."""
    return (
        struct.pack("<BBBBHHHBBL6LHH", 4, 8, len(data), 0, 0, 0, 0, 0, 0, identifier, *[0] * 6, 0, 0) + data
    )


T = (START + STAMP) / 1_000_000_000
OBJECTS = {
    "CAN_MESSAGE": (thing(1, message()), Frame(0x123, b"\x01\x02", T, "0", is_rx=True)),
    "CAN_MESSAGE, sent": (thing(1, message(flags=1)), Frame(0x123, b"\x01\x02", T, "0", is_rx=False)),
    "CAN_MESSAGE, 29 bits": (
        thing(1, message(0x8000_0123)),
        Frame(0x123, b"\x01\x02", T, "0", is_extended_id=True, is_rx=True),
    ),
    "CAN_MESSAGE, remote": (
        thing(1, message(data=b"\xff" * 8, flags=0x80, code=5)),
        Frame(0x123, b"", T, "0", is_remote_frame=True, is_rx=True, dlc=5),
    ),
    "CAN_MESSAGE, length code 12": (
        thing(1, message(data=b"12345678", code=12)),
        Frame(0x123, b"12345678", T, "0", is_rx=True),
    ),
    "CAN_MESSAGE, header version 2": (
        thing(1, message(), version=2),
        Frame(0x123, b"\x01\x02", T, "0", is_rx=True),
    ),
    "CAN_MESSAGE, header version 3": (
        thing(1, message(), version=3),
        Frame(0x123, b"\x01\x02", T, "0", is_rx=True),
    ),
    "CAN_MESSAGE, in 10 µs": (
        thing(1, message(), unit=1, stamp=7),
        Frame(0x123, b"\x01\x02", (START + 70_000) / 1_000_000_000, "0", is_rx=True),
    ),
    "CAN_MESSAGE2": (
        thing(86, message() + bytes(8)),
        Frame(0x123, b"\x01\x02", T, "0", is_rx=True),
    ),
    "CAN_ERROR": (thing(2, struct.pack("<HHL", 2, 0, 0)), Frame(0, b"", T, "1", is_error_frame=True)),
    "CAN_ERROR_EXT": (
        thing(73, struct.pack("<HHLBBBxLLH2x8s", 2, 0, 0, 0, 0, 2, 0, 0x456, 0, b"\xaa\xbb")),
        Frame(0x456, b"\xaa\xbb", T, "1", is_error_frame=True),
    ),
    "CAN_FD_MESSAGE": (
        thing(100, struct.pack("<HBBLLBBB5x64s", 1, 0, 9, 0x123, 0, 0, 7, 12, bytes(range(12)))),
        Frame(0x123, bytes(range(12)), T, "0", False, False, False, True, True, True, True),
    ),
    "CAN_FD_MESSAGE, a classic frame": (
        thing(100, struct.pack("<HBBLLBBB5x64s", 1, 1, 3, 0x123, 0, 0, 6, 3, b"abc")),
        Frame(0x123, b"abc", T, "0", is_rx=False),
    ),
    "CAN_FD_MESSAGE, remote": (
        thing(100, struct.pack("<HBBLLBBB5x64s", 1, 0x80, 3, 0x123, 0, 0, 0, 0, b"")),
        Frame(0x123, b"", T, "0", is_remote_frame=True, is_rx=True, dlc=3),
    ),
    "CAN_FD_MESSAGE_64": (
        thing(101, fd_64(0x9FFF_FFFF, bytes(range(64)), 0x7000)),
        Frame(0x1FFF_FFFF, bytes(range(64)), T, "2", True, False, False, True, True, True, True),
    ),
    "CAN_FD_MESSAGE_64, classic, sent": (
        thing(101, fd_64(0x123, b"abc", 0, sent=1)),
        Frame(0x123, b"abc", T, "2", is_rx=False),
    ),
    "CAN_FD_MESSAGE_64, fewer bytes than announced": (
        thing(101, fd_64(0x123, b"12345678", 0x1000)[:-3], size=16 + 16 + 45),
        Frame(0x123, b"12345\0\0\0", T, "2", is_fd=True, is_rx=True),
    ),
    "CAN_FD_MESSAGE_64, further data behind": (
        thing(101, fd_64(0x123, b"12345678", 0x1000, further=16 + 16 + 40 + 4)),
        Frame(0x123, b"1234\0\0\0\0", T, "2", is_fd=True, is_rx=True),
    ),
    "CAN_FD_ERROR_64": (
        thing(104, fd_error_64(0x77, b"ab")),
        Frame(0x77, b"ab", T, "3", is_error_frame=True),
    ),
    "CAN_FD_ERROR_64, long": (
        thing(104, fd_error_64(0x77, bytes(12))),
        Frame(0x77, bytes(12), T, "3", is_error_frame=True, is_fd=True),
    ),
}


@pytest.mark.parametrize("count", [1, 3, 200])
def test_every_can_object_gives_its_frame(count: int) -> None:
    """All kinds, alone and many at once, also beside each other."""
    other = thing(1, message(0x7FF, b""))
    for name, (one, frame) in OBJECTS.items():
        frames, capture = read(log(*[one] * count))
        assert frames == [frame] * count, name
        frames, capture = read(log(*[one, other] * count))
        assert [found for found in frames if found.arbitration_id != 0x7FF] == [frame] * count, name
        assert capture.frames == 2 * count, name


@pytest.mark.parametrize(
    ("one", "reason"),
    [
        (thing(1, message(0x800)), "identifier 0x800 has more than 11 bits"),
        (thing(1, message(code=16)), "length code 16 does not exist"),
        (thing(1, message()[:15]), "CAN_MESSAGE object of 47 bytes; it needs 48"),
        (thing(1, message(), version=4), "header version 4 is not known"),
        (
            thing(100, struct.pack("<HBBLLBBB5x64s", 1, 0, 9, 1, 0, 0, 1, 9, b"")),
            "a CAN FD frame cannot carry 9 data bytes",
        ),
        (
            thing(100, struct.pack("<HBBLLBBB5x64s", 1, 0, 9, 1, 0, 0, 0, 12, b"")),
            "a classic frame cannot carry 12 data bytes",
        ),
        (thing(101, fd_64(1, b"", 0x1010)), "a remote frame exists only in classic CAN"),
        (thing(1, message(0x4000_0123)), "identifier 0x40000123 has bits that mean nothing"),
        (thing(101, fd_64(0xA000_0123, b"", 0x1000)), "identifier 0xa0000123 has bits that mean nothing"),
        (
            thing(100, struct.pack("<HBBLLBBB5x64s", 1, 0, 15, 1, 0, 0, 1, 12, b"")),
            "length code 15 means 64 bytes, and 12 are announced",
        ),
        (
            thing(100, struct.pack("<HBBLLBBB5x64s", 1, 0, 8, 1, 0, 0, 0, 3, b"")),
            "length code 8 means 8 bytes, and 3 are announced",
        ),
    ],
)
def test_what_no_bus_carries_is_unreadable(one: bytes, reason: str) -> None:
    """An impossible frame is counted with its reason and its number, and costs no other."""
    good = thing(1, message())
    frames, capture = read(log(good, one, good))
    assert (len(frames), capture.lines_unreadable) == (2, 1)
    assert (capture.problems[0].line, capture.problems[0].reason) == (2, reason)


def test_other_objects_are_counted_by_name() -> None:
    """Nothing is dropped in silence, and unknown types cannot fill the memory."""
    kinds = [11, 57, 65, 96, 4, 200, 300, 70_000]
    frames, capture = read(
        log(*(thing(kind, b"?" * kind.bit_length()) for kind in kinds), thing(1, message()))
    )
    assert len(frames) == 1
    assert capture.others == {
        "LIN frames": 2,
        "texts": 1,
        "markers": 1,
        "CAN statistics": 1,
        "objects of type 200": 1,
        "objects of unknown types": 2,
    }


@pytest.mark.parametrize(
    ("when", "start"), [((2015, 7, 5, 10, 6, 17, 32, 250), START), ((0,) * 8, 0), ((2015, 13) + (1,) * 6, 0)]
)
def test_times_count_from_the_start_of_the_measurement(when: tuple[int, ...], start: int) -> None:
    """In nanoseconds, exactly; without a valid start they count from zero, and what is too far has no time."""
    things = [thing(1, message(), stamp=stamp) for stamp in (0, 123_456_789_123, 1 << 63)]
    things.append(thing(1, message(), unit=1, stamp=1 << 60))
    capture = BlfCapture(blf_source(header(when) + container(b"".join(things))))
    (table,) = capture.tables()
    assert table.time.tolist() == [start, start + 123_456_789_123, NO_TIME, NO_TIME]


@given(st.data())
def test_python_can_writes_what_we_read(data: st.DataObject) -> None:
    """Any messages, in containers of any size, compressed or not: frame for frame what python-can reads."""
    dice = random.Random(data.draw(st.integers(0, 1 << 32)))
    sent: list[can.Message] = []
    for number in range(dice.choice([1, 5, 200])):
        extended, kind = dice.random() < 0.4, dice.choice(["data", "data", "remote", "fd", "error"])
        size = dice.choice(FD_LENGTHS) if kind == "fd" else dice.randint(0, 8)
        sent.append(
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
                channel=dice.randint(0, 5),
                dlc=size,
                data=None if kind == "remote" else dice.randbytes(size),
            )
        )
    file: Any = io.BytesIO()
    file.close = lambda: None
    writer = can.BLFWriter(
        file, compression_level=dice.choice([-1, 0]), max_container_size=dice.choice([50, 1000, 131072])
    )
    for one in sent:
        writer.on_message_received(one)
    if dice.random() < 0.3:
        writer.log_event("a remark")
    rest: Any = writer
    while (
        rest._buffer_size > rest.max_container_size
    ):  # `stop` writes one container more and leaves the rest out
        rest._flush()
    writer.stop()
    frames, capture = read(file.getvalue())
    assert capture.problems == []
    theirs = list(can.BLFReader(io.BytesIO(file.getvalue())))
    assert len(frames) == len(theirs) == len(sent)
    for ours, other in zip(frames, theirs, strict=True):
        assert ours.channel == str(other.channel)
        assert ours.timestamp == pytest.approx(other.timestamp, abs=1e-6)
        for name in ("arbitration_id", "is_extended_id", "is_remote_frame", "is_error_frame", "is_fd"):
            assert getattr(ours, name) == getattr(other, name)
        assert (ours.bitrate_switch, ours.error_state_indicator) == (
            other.bitrate_switch,
            other.error_state_indicator,
        )
        assert ours.length == other.dlc
        assert ours.is_rx == (None if other.is_error_frame else other.is_rx)
        assert ours.data == (b"" if other.is_remote_frame else bytes(other.data))


def numbered(count: int) -> list[bytes]:
    """Messages whose data are their number."""
    return [thing(1, message(number % 0x7FF, number.to_bytes(8, "big"))) for number in range(count)]


def numbers(frames: list[Frame]) -> list[int]:
    """The numbers of such messages."""
    return [int.from_bytes(frame.data, "big") for frame in frames]


@pytest.mark.parametrize("cut", [1, 7, 16, 47, 48, 49, 100, 1000])
def test_objects_may_cross_from_container_to_container(cut: int) -> None:
    """Wherever the stream of objects is cut."""
    data = b"".join(numbered(60))
    parts = b"".join(container(data[start : start + cut]) for start in range(0, len(data), cut))
    frames, capture = read(header() + parts)
    assert numbers(frames) == list(range(60))
    assert capture.lines_unreadable == 0


def test_objects_may_stand_outside_containers() -> None:
    """Some programs write a few objects before the first container."""
    one = numbered(3)
    frames, capture = read(header() + thing(65, b"text") + one[0] + container(one[1]) + one[2])
    assert (numbers(frames), capture.others) == ([0, 1, 2], {"texts": 1})


@pytest.mark.parametrize("count", [9, 300])
def test_a_flipped_byte_costs_few_frames(count: int) -> None:
    """Damage in one object costs that one, or is not to be seen; what is lost is counted."""
    sevens = range(0, 7 * count, 7)
    data = bytearray(b"".join(thing(1, message(5, number.to_bytes(8, "big"))) for number in sevens))
    for place in range(48):
        data[4 * 48 + place] ^= 0x41
        frames, capture = read(header() + container(bytes(data)))
        data[4 * 48 + place] ^= 0x41
        kept = [number for number in numbers(frames) if number in sevens and number != 28]
        assert kept == [number for number in sevens if number != 28], place
        assert capture.lines == count, place


def test_a_wrong_size_swallows_no_other_object() -> None:
    """Larger than it is, also where the log ends before: the objects that follow are found."""
    for count in (12, 300):
        for size in (100, 200, 5000, 1 << 20, 1 << 31):
            for kind in (1, 65):
                things = numbered(count)
                things[count - 9] = thing(kind, message(), size=size)
                frames, capture = read(log(*things))
                left = [number for number in range(count) if number != count - 9]
                assert [number for number in numbers(frames) if number < count] == left
                assert capture.lines_unreadable >= (kind == 65)


def test_a_damaged_container_costs_itself() -> None:
    """Its readable part is given, the containers around it too, and the loss is counted with the offset."""
    one = numbered(900)
    parts = [container(b"".join(one[start : start + 300])) for start in (0, 300, 600)]
    broken = bytearray(parts[1])
    broken[len(broken) // 2] ^= 0xFF
    frames, capture = read(header() + parts[0] + bytes(broken) + parts[2])
    found = [number for number in numbers(frames) if number < 300 or number >= 600]
    assert found == [*range(300), *range(600, 900)]
    assert capture.lines_unreadable >= 1
    checksum = bytearray(parts[1])
    checksum[int.from_bytes(parts[1][8:12], "little") - 1] ^= 1
    frames, capture = read(header() + parts[0] + bytes(checksum) + parts[2])
    assert numbers(frames) == list(range(900))
    assert capture.lines_unreadable == 1
    assert capture.problems[0].line == 601
    assert f"container at offset {144 + len(parts[0]):,} is damaged" in capture.problems[0].reason


@pytest.mark.parametrize("junk", [b"\0" * 3, b"LOB", b"junk" * 999, b"LOBJ" + bytes(40), b"\xff" * 200_000])
def test_reading_goes_on_behind_junk(junk: bytes) -> None:
    """Between containers and within them."""
    one = numbered(200)
    whole = header() + container(b"".join(one[:100])) + junk + container(b"".join(one[100:]))
    frames, capture = read(whole)
    assert numbers(frames) == list(range(200))
    assert capture.lines_unreadable == (len(junk) > 3)
    frames, capture = read(log(*one[:100], junk, *one[100:]))
    assert numbers(frames) == list(range(200))
    assert capture.lines_unreadable == (len(junk) > 3)


@pytest.mark.parametrize("parts", [1, 2, 3])
def test_what_the_header_states_is_compared(parts: int) -> None:
    """Objects that the header states and that are not there are one unreadable thing, wherever the log was cut."""
    one = numbered(300)
    pieces = [container(b"".join(one[start : start + 100])) for start in range(0, 100 * parts, 100)]
    frames, capture = read(header(objects=300) + b"".join(pieces))
    assert len(frames) == 100 * parts
    missing = f"the header states 300 objects, {100 * parts} are there: {300 - 100 * parts} are missing"
    assert [problem.reason for problem in capture.problems] == ([missing] if parts < 3 else [])
    _, capture = read(header(objects=20) + pieces[0])  # a log that was not closed may state fewer
    assert capture.problems == []


@pytest.mark.parametrize("zeros", [1, 4, 8, 24, 25, 1000, 3 << 20])
def test_zeros_at_the_end_are_padding(zeros: int) -> None:
    """In the file, in its last container, and in both: nothing is missing, and nothing unreadable."""
    one = b"".join(numbered(100))
    for inside, outside in ((0, zeros), (zeros, 0), (zeros, zeros)):
        whole = header(objects=100) + container(one + bytes(inside), method=0) + bytes(outside)
        for times in (1, 2):  # zeros in front of a header, too
            frames, capture = read(whole * times)
            assert (len(frames), capture.problems) == (100 * times, [])
    frames, capture = read(header() + container(one) + bytes(zeros) + container(one))
    assert (len(frames), capture.lines_unreadable) == (200, zeros > 4)


def test_logs_may_be_joined() -> None:
    """Another header begins another log, with a start and a number of objects of its own."""
    start = (2015, 7, 5, 10, 6, 17, 33, 250)
    first = header(objects=12) + container(b"".join(numbered(10)))
    frames, capture = read(first + header(start, objects=3) + container(b"".join(numbered(3))))
    assert numbers(frames) == [*range(10), *range(3)]
    assert [frame.timestamp for frame in frames] == [T] * 10 + [T + 1] * 3
    assert [problem.reason for problem in capture.problems] == [
        "the header states 12 objects, 10 are there: 2 are missing"
    ]


def test_a_log_that_ends_within_its_header_is_counted() -> None:
    """As soon as the header can be told; before, it is refused."""
    for end in range(72, 144):
        frames, capture = read(header(objects=3)[:end])
        assert (frames, len(capture.problems)) == ([], 1)
        assert capture.problems[0].reason == "the file ends within its header of 144 bytes"


def test_channel_0_comes_back() -> None:
    """It is not a channel, and written as channel 0 again, beside the others."""
    things = [thing(1, struct.pack("<HBBL8s", channel, 0, 1, 1, b"a")) for channel in (0, 1, 2, 0)]
    frames, _ = read(log(*things))
    assert [frame.channel for frame in frames] == [None, "0", "1", None]
    file = io.BytesIO()
    with open_writer(file, "blf") as writer:
        writer.write(FrameTable.from_frames(frames))
    assert writer.lossy == {}
    assert read(file.getvalue())[0] == frames
    theirs: Any = can.BLFReader(io.BytesIO(file.getvalue()))
    assert [message.channel for message in theirs] == [-1, 0, 1, -1]


@pytest.mark.slow
def test_a_cut_log_gives_what_it_holds() -> None:
    """Cut anywhere: the frames before it, and the loss counted; a log without even its header is refused."""
    one = numbered(200)
    whole = header() + container(b"".join(one[:100])) + container(b"".join(one[100:]), method=0)
    for end in range(0, len(whole), 13):
        if end < 72:
            with pytest.raises(CaptureError, match=r"walk\.blf: no Vector BLF log, or one that ends within"):
                read(whole[:end])
            continue
        frames, _ = read(whole[:end])
        assert numbers(frames) == list(range(len(frames)))
    second = 144 + len(container(b"".join(one[:100])))
    frames, capture = read(whole[: second + 32 + 48 * 10 + 20])
    assert len(frames) == 110
    assert any("ends within" in problem.reason for problem in capture.problems)


@given(st.integers(0, 1 << 32))
def test_no_damage_stops_the_reader(seed: int) -> None:
    """Bytes flipped, removed and put in anywhere: frames that can exist, everything else counted, no exception."""
    dice = random.Random(seed)
    pool = [one for one, _ in OBJECTS.values()] + [thing(65, b"LOBJ" * 9), thing(96, b"x" * 13)]
    data = bytearray(b"".join(dice.choices(pool, k=150)))
    whole = bytearray(header())

    def damage(target: bytearray, first: int) -> None:
        for _ in range(dice.randint(0, 4)):
            place = dice.randint(first, len(target))
            target[place : place + dice.choice([0, 1, 1, 5])] = dice.randbytes(dice.choice([0, 1, 1, 9]))

    damage(data, 0)
    while data:
        size = dice.choice([100, 5000, 20_000])
        whole += container(bytes(data[:size]), method=dice.choice([0, 2]))
        del data[:size]
    if dice.random() < 0.5:
        damage(whole, 72)
    read(bytes(whole))


def test_a_bomb_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a container unpacks to has a limit, whatever it claims, and what comes behind it is read."""
    monkeypatch.setattr(blf, "_CONTAINER", 1 << 22)
    monkeypatch.setattr(blf, "_SMALL", 100)
    good = numbered(3)
    bomb = container(bytes(1 << 24), claimed=100)
    frames, capture = read(header() + container(good[0]) + bomb + container(b"".join(good[1:])))
    assert numbers(frames) == [0, 1, 2]
    assert any("more than 4,194,304 bytes" in problem.reason for problem in capture.problems)


@pytest.mark.slow
def test_much_damage_takes_no_more_time_a_byte() -> None:
    """A good object and an impossible one by turns, sizes that swallow the next: a fraction of a second, all counted."""
    good = thing(65, b"")
    impossible = struct.pack("<4sHHLL", b"LOBJ", 16, 1, 1 << 31, 65)
    _, capture = read(log(*[good + impossible] * 30_000))
    assert (capture.others, capture.lines_unreadable) == ({"texts": 30_000}, 30_000)
    _, capture = read(log(*[thing(65, b"abcd", size=1000)] * 30_000))
    assert capture.lines_unreadable > 29_000
    _, capture = read(header() + impossible * 30_000 + container(good))
    assert (capture.others, capture.lines_unreadable) == ({"texts": 1}, 1)


def test_wrong_containers_are_counted() -> None:
    """An unknown packing, a size that cannot be."""
    good = container(b"".join(numbered(2)))
    unknown = container(b"abcd", method=7)
    frames, capture = read(header() + unknown + good)
    assert (numbers(frames), capture.lines_unreadable) == ([0, 1], 1)
    assert "packing method 7 is not known" in capture.problems[0].reason
    huge = bytearray(good)
    huge[8:12] = b"\xff" * 4
    frames, capture = read(header() + bytes(huge) + good)
    assert numbers(frames) == [0, 1]
    assert "an object of 4,294,967,295 bytes" in capture.problems[0].reason


def test_a_log_is_found_by_its_content(tmp_path: Path) -> None:
    """Also packed, also from a pipe of small pieces."""
    path = tmp_path / "walk.dat"
    path.write_bytes(log(*numbered(70_000)))
    with open_recording(path, link="can") as capture:
        assert capture.format == "Vector BLF"
        tables = list(capture.tables())
    assert [len(table) >= 65_536 for table in tables] == [True, *[False] * (len(tables) - 1)]
    assert sum(map(len, tables)) == capture.frames == 70_000
