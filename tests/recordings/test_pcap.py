"""pcap and pcapng: frames out of packets, in either byte order, and nothing lost in silence."""

from __future__ import annotations

import io
import struct
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from aces_bus import Frame, FrameTable, open_recording
from aces_bus.errors import CaptureError
from aces_bus.frame_table import NO_TIME, Channels
from aces_bus.frames import FD_LENGTHS
from aces_bus.recordings.base import CanRecording
from aces_lab.formats.pcap.writer import PcapngWriter

BIG_ENDIAN, LITTLE_ENDIAN = ">", "<"
ORDERS = pytest.mark.parametrize("order", [LITTLE_ENDIAN, BIG_ENDIAN], ids=["little", "big"])


def packet(identifier: int, data: bytes, *, flags: int = 0, size: int = 16, order: str = ">") -> bytes:
    """A Linux CAN frame as it stands in a packet."""
    head = struct.pack(order + "I", identifier) + bytes([len(data), flags, 0, 0])
    return (head + data).ljust(size, b"\0")


def pcap(
    packets: list[bytes], *, order: str = "<", link: int = 227, nano: bool = False, second: int = 7
) -> bytes:
    magic = 0xA1B23C4D if nano else 0xA1B2C3D4
    out = struct.pack(order + "IHHiIII", magic, 2, 4, 0, 0, 65535, link)
    for number, body in enumerate(packets):
        out += struct.pack(order + "IIII", second, number, len(body), len(body)) + body
    return out


def block(order: str, kind: int, body: bytes) -> bytes:
    body += bytes(-len(body) % 4)
    size = struct.pack(order + "I", len(body) + 12)
    return struct.pack(order + "I", kind) + size + body + size


def section(order: str) -> bytes:
    return block(order, 0x0A0D0D0A, struct.pack(order + "IHHq", 0x1A2B3C4D, 1, 0, -1))


def option(order: str, code: int, value: bytes) -> bytes:
    return struct.pack(order + "HH", code, len(value)) + value + bytes(-len(value) % 4)


def interface(order: str, *options: tuple[int, bytes], link: int = 227, cut: int = 0) -> bytes:
    body = struct.pack(order + "HHI", link, 0, cut)
    return block(order, 1, body + b"".join(option(order, *one) for one in options) + bytes(4))


def enhanced(order: str, number: int, ticks: int, body: bytes, *options: tuple[int, bytes]) -> bytes:
    head = struct.pack(order + "IIIII", number, ticks >> 32, ticks & 0xFFFFFFFF, len(body), len(body))
    padding = bytes(-len(body) % 4)
    tail = b"".join(option(order, *one) for one in options) + (bytes(4) if options else b"")
    return block(order, 6, head + body + padding + tail)


def read(content: bytes) -> tuple[list[Frame], CanRecording]:
    """All frames; checks that everything is counted."""
    capture = open_recording(io.BytesIO(content), link="can")
    frames = list(capture)
    check(capture, frames)
    return frames, capture


def check(capture: CanRecording, frames: list[Frame]) -> None:
    assert len(frames) == capture.frames
    others = sum(capture.others.values())
    assert (
        capture.lines
        == capture.frames + capture.lines_unreadable + capture.lines_comment + capture.lines_blank + others
    )


def reasons(capture: CanRecording) -> list[str]:
    return [problem.reason for problem in capture.problems]


@st.composite
def frames(draw: st.DrawFn) -> Frame:
    """Any frame that a bus can carry, timed to the microsecond or not at all."""
    kind = draw(st.sampled_from(["classic", "fd", "remote", "error"]))
    extended = draw(st.booleans()) and kind != "error"
    wide = extended or kind == "error"
    size = draw(st.sampled_from(FD_LENGTHS) if kind == "fd" else st.integers(0, 8))
    micro = draw(st.integers(0, 4 * 10**15))
    return Frame(
        draw(st.integers(0, 0x1FFFFFFF if wide else 0x7FF)),
        b"" if kind == "remote" else draw(st.binary(min_size=size, max_size=size)),
        float(f"{micro // 10**6}.{micro % 10**6:06}"),
        draw(st.sampled_from(["can0", "vcan 7", "ÿ", "slcan0"])),
        extended,
        kind == "remote",
        kind == "error",
        kind == "fd",
        kind == "fd" and draw(st.booleans()),
        kind == "fd" and draw(st.booleans()),
        draw(st.sampled_from([None, True, False])),
        size if kind == "remote" else None,
    )


def written(*tables: FrameTable) -> tuple[bytes, PcapngWriter]:
    file = io.BytesIO()
    writer = PcapngWriter(file, "out.pcapng")
    for table in tables:
        writer.write(table)
    writer.close()
    return file.getvalue(), writer


@given(st.lists(frames(), max_size=40), st.integers(1, 40))
def test_what_is_written_is_read_back(some: list[Frame], split: int) -> None:
    """Any frames survive pcapng: identifiers, flags, data, directions, names, times."""
    content, writer = written(FrameTable.from_frames(some[:split]), FrameTable.from_frames(some[split:]))
    got, capture = read(content)
    assert got == some
    assert writer.lossy == {}
    assert capture.lines_comment == 1 + len({frame.channel for frame in some})


def test_a_long_run_is_read_as_it_was_written() -> None:
    """Tens of thousands of packets, of one size and then of two, with nanoseconds."""
    n = 30_000
    numbers = np.arange(n)
    table = FrameTable(
        numbers * 7 + 10**18,
        (numbers % 2).astype(np.uint16),
        (numbers % 0x800).astype(np.uint32),
        np.where((numbers > n // 2) & (numbers % 3 == 0), 4, 64).astype(np.uint8),
        np.full(n, 8, np.uint8),
        np.frombuffer(np.arange(n, dtype="<u8").tobytes(), np.uint8).reshape(n, 8),
        Channels(["can0", None]),
    )
    capture = open_recording(io.BytesIO(written(table)[0]), link="can")
    got = FrameTable.concat(list(capture.tables()))
    for name in ("time", "id", "flags", "length"):
        assert (getattr(got, name) == getattr(table, name)).all(), name
    assert (got.data == table.data).all()
    assert [capture.channels.names[number] for number in got.channel[:4]] == ["can0", "interface 1"] * 2


def test_what_pcapng_cannot_hold_is_counted() -> None:
    """Frames without a time or from before 1970 get the time 0, and it is said."""
    some = [Frame(1, b"", None, "a"), Frame(2, b"", -1.0, "a"), Frame(3, b"", 1.0, None)]
    content, writer = written(FrameTable.from_frames(some))
    assert [frame.timestamp for frame in read(content)[0]] == [0.0, 0.0, 1.0]
    assert writer.lossy == {
        "unknown times (written as 0)": 1,
        "times before 1970 (written as 0)": 1,
        "channel names": 1,
    }


@ORDERS
@pytest.mark.parametrize("nano", [False, True], ids=["µs", "ns"])
def test_pcap_in_either_byte_order(order: str, nano: bool) -> None:
    """The magic number tells byte order and unit; the frames' own identifiers are always big-endian."""
    packets = [
        packet(0x123, b"\x01\x02"),
        packet(0x9ABCDEF0 & 0x1FFFFFFF | 1 << 31, bytes(8)),
        packet(0x40000077, b"")[:4] + b"\x05" + bytes(11),
        packet(0x20000080, b"\0\4".ljust(8, b"\0")),
        packet(0x10, bytes(range(48)), flags=1 | 4, size=72),
    ]
    got, capture = read(pcap(packets, order=order, nano=nano))
    assert [frame.timestamp for frame in got] == [float(f"7.{n:0{9 if nano else 6}}") for n in range(5)]
    assert [frame.arbitration_id for frame in got] == [0x123, 0x1ABCDEF0, 0x77, 0x80, 0x10]
    assert [frame.length for frame in got] == [2, 8, 5, 8, 48]
    assert (got[1].is_extended_id, got[2].is_remote_frame, got[3].is_error_frame) == (True, True, True)
    assert (got[4].is_fd, got[4].bitrate_switch, got[4].error_state_indicator) == (True, True, False)
    assert (got[0].channel, capture.format) == (None, "pcap")


def test_old_fd_packets_are_known_by_their_size() -> None:
    """Before the FDF flag, 72 bytes told CAN FD, however few of them are data."""
    got, _ = read(pcap([packet(1, b"ab", size=72), packet(1, b"ab", size=16), packet(1, b"ab", size=10)]))
    assert [(frame.is_fd, frame.data) for frame in got] == [(True, b"ab"), (False, b"ab"), (False, b"ab")]


@ORDERS
def test_cooked_captures(order: str) -> None:
    """Linux' `any` interface: who sent it, what it is, and an identifier in the recorder's byte order."""
    frame = packet(0x123, b"\x07", order=order)
    fd = packet(0x124, b"\x08", order=order, size=72)
    sll = [struct.pack(">HHHQH", kind, 280, 0, 0, 0x0C) + frame for kind in (1, 4)]
    sll.append(struct.pack(">HHHQH", 0, 280, 0, 0, 0x0D) + fd)
    sll.append(struct.pack(">HHHQH", 0, 1, 0, 0, 0x0800) + bytes(40))
    got, capture = read(pcap(sll, order=order, link=113))
    assert [(f.arbitration_id, f.data, f.is_rx, f.is_fd) for f in got] == [
        (0x123, b"\x07", True, False),
        (0x123, b"\x07", False, False),
        (0x124, b"\x08", True, True),
    ]
    assert capture.others == {"packets of protocol 0x0800": 1}
    sll2 = [struct.pack(">HHIHBBQ", 0x0C, 0, 3, 280, 4, 0, 0) + frame]
    got, _ = read(pcap(sll2, order=order, link=276))
    assert (got[0].arbitration_id, got[0].is_rx, got[0].channel) == (0x123, False, "if3")


def test_what_is_no_frame_is_named() -> None:
    """CAN XL is readable and no frame; wrong packets are unreadable, each with its reason and number."""
    wrong = [
        (packet(0x1, b"")[:7], "shorter than the header of a CAN frame"),
        (packet(0x1, bytes(8))[:12], "the data are cut short"),
        (packet(0x800, b""), "an 11-bit identifier above 0x7FF"),
        (packet(0x1, bytes(9), size=72), "a length that CAN FD does not have"),
        (packet(0x40000001, b"", flags=4), "a remote frame in CAN FD"),
    ]
    xl = struct.pack(">IBBHI", 1, 0x80, 0, 4, 0) + bytes(4)
    good = packet(0x7, b"\x01")
    got, capture = read(pcap([good, xl, *(body for body, _ in wrong), good]))
    assert [frame.arbitration_id for frame in got] == [7, 7]
    assert capture.others == {"CAN XL frames": 1}
    assert [(problem.line, problem.reason) for problem in capture.problems] == [
        (number, reason) for number, (_, reason) in enumerate(wrong, 3)
    ]


@ORDERS
def test_pcapng_interfaces(order: str) -> None:
    """Names, time units and offsets are of the interface; other links, unknown blocks and lost frames are counted."""
    frame = packet(0x55, b"\x01")
    parts = [
        section(order),
        interface(order, (2, b"can0"), (9, b"\x09")),
        interface(order, (9, bytes([0x80 | 10])), (14, struct.pack(order + "q", 100))),
        interface(order, link=1),
        enhanced(order, 0, 1_000_000_001, frame, (2, struct.pack(order + "I", 1))),
        enhanced(order, 0, 1_000_000_002, frame, (1, b"a note"), (2, struct.pack(order + "I", 2))),
        enhanced(order, 1, 512, frame),
        enhanced(order, 2, 0, bytes(60)),
        enhanced(order, 9, 0, frame),
        block(order, 3, struct.pack(order + "I", len(frame)) + frame),
        block(order, 2, struct.pack(order + "HHIIII", 1, 5, 0, 1024, len(frame), len(frame)) + frame),
        block(order, 0xBAD, bytes(8)),
        block(order, 0x77, bytes(8)),
        block(order, 5, struct.pack(order + "III", 0, 0, 0) + option(order, 5, struct.pack(order + "Q", 3))),
    ]
    got, capture = read(b"".join(parts))
    table = FrameTable.from_frames(got)
    assert table.time.tolist() == [1_000_000_001, 1_000_000_002, 100_500_000_000, NO_TIME, 101_000_000_000]
    assert [frame.channel for frame in got] == ["can0", "can0", "interface 1", "can0", "interface 1"]
    assert [frame.is_rx for frame in got] == [True, False, None, None, None]
    assert capture.others == {
        "packets of link type 1 (Ethernet)": 1,
        "custom blocks": 1,
        "blocks of type 0x77": 1,
    }
    assert reasons(capture) == ["a packet of an interface that is not described"]
    assert (capture.lines, capture.lines_comment, capture.frames_dropped) == (14, 5, 8)


def test_sections_of_two_byte_orders() -> None:
    """Files that were joined: each section has its own byte order, and interfaces are numbered anew."""
    content = b""
    for order, name in (("<", b"can0"), (">", b"can7")):
        content += section(order) + interface(order, (2, name)) + enhanced(order, 0, 5, packet(1, b"\x02"))
    got, _ = read(content)
    assert [(frame.channel, frame.timestamp) for frame in got] == [("can0", 5e-6), ("can7", 5e-6)]


@pytest.mark.parametrize(("base", "bit"), [(2, 0x80), (10, 0)])
def test_every_time_unit(base: int, bit: int) -> None:
    """Whatever unit an interface claims, an instant is the rounded-down one, or none."""
    all_ticks = (0, 1, 12345678901234567, (1 << 64) - 1)
    for exponent in range(128):
        content = section("<") + interface("<", (9, bytes([exponent | bit])))
        content += b"".join(enhanced("<", 0, ticks, packet(1, b"")) for ticks in all_ticks)
        capture = open_recording(io.BytesIO(content), link="can")
        times = FrameTable.concat(list(capture.tables())).time.tolist()
        for ticks, got in zip(all_ticks, times, strict=True):
            exact = ticks * 10**9 // base**exponent
            if got == NO_TIME:
                assert exact >= 9_000_000_000 * 10**9 or exact >= (1 << 63) - 10**10
            else:
                assert abs(got - exact) <= 1


def test_other_links_are_refused() -> None:
    """A pcap file has one link; when that is not CAN, it is said at once."""
    with pytest.raises(CaptureError, match=r"packets of link type 1 \(Ethernet\), and no CAN frames"):
        read(pcap([bytes(60)], link=1))


def samples() -> list[tuple[str, bytes]]:
    good = packet(0x123, b"\x01\x02\x03")
    fd = packet(0x124, bytes(12), flags=4, size=72)
    cooked = struct.pack(">HHHQH", 1, 280, 0, 0, 0x0C) + good
    ng = b"".join(
        [
            section("<"),
            interface("<", (2, b"can0"), (9, b"\x09")),
            *(enhanced("<", 0, n, good, (2, b"\1\0\0\0")) for n in range(12)),
            enhanced("<", 0, 3, fd),
            block("<", 3, struct.pack("<I", len(good)) + good),
        ]
    )
    return [
        ("pcap", pcap([good] * 12 + [fd, good], order=">")),
        ("cooked", pcap([cooked] * 3, link=113)),
        ("pcapng", ng),
    ]


@pytest.mark.parametrize("content", [pytest.param(content, id=name) for name, content in samples()])
def test_every_truncation(content: bytes) -> None:
    """A file that ends anywhere gives its whole packets, and one unreadable one where it ends within one."""
    whole, _ = read(content)
    for size in range(len(content)):
        try:
            got, capture = read(content[:size])
        except CaptureError:
            assert size < 48
        else:
            assert got == whole[: len(got)]
            assert capture.lines_unreadable <= 1


@pytest.mark.parametrize("content", [pytest.param(content, id=name) for name, content in samples()])
@given(flips=st.lists(st.tuples(st.floats(0, 0.999), st.integers(1, 255)), min_size=1, max_size=3))
def test_flipped_bytes_do_no_harm(content: bytes, flips: list[tuple[float, int]]) -> None:
    """Whatever bytes are wrong, everything read is counted, and only a `CaptureError` is raised."""
    damaged = bytearray(content)
    for place, bits in flips:
        damaged[int(place * len(damaged))] ^= bits
    try:
        read(bytes(damaged))
    except CaptureError:
        pass


@given(st.sampled_from([b"\xd4\xc3\xb2\xa1", section("<"), pcap([])]), st.binary(max_size=300))
def test_no_junk_does_harm(start: bytes, junk: bytes) -> None:
    """Whatever follows a right beginning is counted or refused."""
    try:
        read(start + junk)
    except CaptureError:
        pass


BAD = struct.pack("<IIII", 1, 1, 1 << 30, 1 << 30)
CUT = struct.pack("<IIII", 7, 3, 48, 16) + packet(0x123, b"\x01")


@pytest.mark.parametrize(
    ("bad", "reason"),
    [
        (BAD, f"a packet of {1 << 30} bytes captured at offset 120; 16 bytes are not a packet"),
        (CUT, "a packet of 48 bytes of 16 in all at offset 120; 32 bytes are not a packet"),
        (
            BAD + bytes(5000),
            f"a packet of {1 << 30} bytes captured at offset 120; 5016 bytes are not a packet",
        ),
    ],
)
@pytest.mark.parametrize("before", [0, 30])
@pytest.mark.parametrize("after", [1, 2, 30])
@pytest.mark.parametrize("step", [1, 37, 1 << 20])
def test_a_wrong_length_costs_its_packet(bad: bytes, reason: str, before: int, after: int, step: int) -> None:
    """A captured length above the original one, or above a frame's, is unreadable; the next packet is found again."""
    first = [packet(number, bytes([number])) for number in range(1, before + 1)]
    last = [packet(number, bytes([number])) for number in range(101, 101 + after)]
    content = pcap(first) + bad + pcap(last)[24:]

    class Slow(io.BytesIO):
        def read1(self, size: int | None = -1, /) -> bytes:
            return super().read(step)

    capture = open_recording(Slow(content), link="can")
    got = list(capture)
    check(capture, got)
    assert [frame.arbitration_id for frame in got] == [*range(1, before + 1), *range(101, 101 + after)]
    assert reasons(capture) == [reason.replace("120", str(24 + 32 * before))]
    assert capture.problems[0].line == before + 1


def test_a_long_run_ends_at_a_wrong_length() -> None:
    """Also where many packets of one size are looked at together."""
    content = bytearray(pcap([packet(1, b"\x01")] * 60))
    struct.pack_into("<I", content, 24 + 32 * 40 + 12, 15)
    got, capture = read(bytes(content))
    assert len(got) == 59
    assert reasons(capture) == [
        f"a packet of 16 bytes of 15 in all at offset {24 + 32 * 40}; 32 bytes are not a packet"
    ]


def test_what_follows_damage_to_the_end_is_one_unreadable() -> None:
    """Where no packet is found any more, the rest counts once."""
    got, capture = read(pcap([packet(1, b"")] * 3) + BAD + b"\xff" * 1000)
    assert len(got) == 3
    assert reasons(capture) == [
        f"a packet of {1 << 30} bytes captured at offset 120; 1016 bytes are not a packet"
    ]


def test_files_may_be_joined() -> None:
    """Each with its own byte order, unit and link type; one that holds no CAN frames is unreadable."""
    one = pcap([packet(1, b"a")], order="<")
    two = pcap([packet(2, b"b")], order=">", nano=True, second=8)
    got, capture = read(one + two + one)
    assert [(frame.arbitration_id, frame.timestamp) for frame in got] == [(1, 7.0), (2, 8.0), (1, 7.0)]
    assert capture.lines_unreadable == 0
    got, capture = read(one + pcap([b"\0" * 60], link=1) + one)
    assert len(got) == 1
    assert "link type 1 (Ethernet)" in reasons(capture)[0]


@pytest.mark.parametrize(("link", "header"), [(227, b""), (113, bytes(14) + b"\0\x0c")])
def test_identifiers_in_the_wrong_byte_order_have_a_hint(link: int, header: bytes) -> None:
    """What is unreadable and would be an identifier the other way round says so; what would not says nothing."""
    order = "<" if link == 227 else ">"
    wrong = header + packet(0x102, b"", order=order)
    never = header + packet(0x04030201, b"", order=order)
    _, capture = read(pcap([wrong, never], link=link))
    assert reasons(capture) == [
        "an 11-bit identifier above 0x7FF; with its bytes in the other order it is 0x102: the recorder may have"
        " written the wrong one",
        "an 11-bit identifier above 0x7FF",
    ]


@ORDERS
def test_more_captured_than_there_was_is_unreadable(order: str) -> None:
    """A pcapng packet whose captured length is above the original one costs itself."""
    wrong = bytearray(enhanced(order, 0, 0, packet(1, b"a")))
    struct.pack_into(order + "I", wrong, 24, 15)
    good = enhanced(order, 0, 0, packet(2, b"b"))
    got, capture = read(section(order) + interface(order) + good + bytes(wrong) + good)
    assert [frame.arbitration_id for frame in got] == [2, 2]
    assert reasons(capture) == ["a packet of which more is captured than there was"]


@ORDERS
@pytest.mark.parametrize("is_last", [True, False])
def test_a_section_that_is_shorter_than_it_says_is_counted(order: str, is_last: bool) -> None:
    """A file that was cut between two blocks is known by the length of its section, where it states one."""
    blocks = interface(order) + enhanced(order, 0, 0, packet(1, b"a"))
    for missing in (0, 64):
        head = block(order, 0x0A0D0D0A, struct.pack(order + "IHHq", 0x1A2B3C4D, 1, 0, len(blocks) + missing))
        got, capture = read(head + blocks + (b"" if is_last else section(order)))
        assert len(got) == 1
        assert reasons(capture) == (
            [f"the section states {len(blocks) + 64} bytes, {len(blocks)} are there"] if missing else []
        )


def test_a_pipe_gives_packets_as_they_come() -> None:
    """From a live source a packet is there as soon as its last byte is."""
    import os

    reader, writer = os.pipe()
    with open(reader, "rb", buffering=0) as file:
        content = pcap([packet(1, b"\x01"), packet(2, b"\x02")])
        os.write(writer, content[:-10])
        capture: Any = open_recording(file, link="can")
        stream = iter(capture)
        assert next(stream).arbitration_id == 1
        os.write(writer, content[-10:])
        assert next(stream).arbitration_id == 2
        os.close(writer)
        assert list(stream) == []
