"""SocketCAN's frames without SocketCAN: what the kernel gives, through a pair of datagram sockets.

The kernel itself is in `tests/socketcan`.
"""

from __future__ import annotations

import socket
import struct
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from aces_bus import Frame
from aces_bus.frames import FD_LENGTHS
from aces_bus.hardware.backends import SocketcanReader

if not hasattr(socket, "CMSG_SPACE") or not hasattr(socket, "AF_UNIX"):
    pytest.skip("no SocketCAN on this system", allow_module_level=True)

SO_TIMESTAMPNS, SO_RXQ_OVFL = 35, 40


class Scripted(socket.socket):
    """A socket that says, beside each datagram, what the test tells it to."""

    beside: list[Any]

    def recvmsg(self, *arguments: Any) -> Any:
        data, _, flags, address = super().recvmsg(*arguments)
        return data, self.beside.pop(0) if self.beside else [], flags, address


@pytest.fixture
def pair() -> Iterator[tuple[socket.socket, Scripted]]:
    near, far = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    made = Scripted(socket.AF_UNIX, socket.SOCK_DGRAM, 0, far.detach())
    made.beside = []
    with near, made:
        yield near, made


def bus(wanted: Any = None) -> Any:
    return SimpleNamespace(channel="can0", _is_filtered=wanted is None, _matches_filters=wanted)


def kernel_bytes(frame: Frame) -> bytes:
    """The frame as the kernel hands it over (linux/can.h)."""
    word = (
        frame.arbitration_id
        | frame.is_extended_id << 31
        | frame.is_remote_frame << 30
        | frame.is_error_frame << 29
    )
    size = 64 if frame.is_fd else 8
    flags = frame.bitrate_switch | frame.error_state_indicator << 1
    return struct.pack("=IBBxx", word, frame.length, flags) + frame.data.ljust(size, b"\0")


@st.composite
def frames(draw: st.DrawFn) -> Frame:
    kind = draw(st.sampled_from(["data", "remote", "error", "fd"]))
    is_extended = kind != "error" and draw(st.booleans())
    identifier = draw(st.integers(0, 0x1FFF_FFFF if is_extended or kind == "error" else 0x7FF))
    size = draw(st.sampled_from(FD_LENGTHS if kind == "fd" else FD_LENGTHS[:9]))
    return Frame(
        identifier,
        b"" if kind == "remote" else draw(st.binary(min_size=size, max_size=size)),
        None,
        "can0",
        is_extended,
        kind == "remote",
        kind == "error",
        kind == "fd",
        kind == "fd" and draw(st.booleans()),
        kind == "fd" and draw(st.booleans()),
        True,
        size if kind == "remote" else None,
    )


@given(st.lists(frames(), max_size=8))
def test_every_frame_is_what_the_kernel_said(sent: list[Frame]) -> None:
    """Of all kinds, in order; then nothing."""
    near, far = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    with near, far:
        reader = SocketcanReader(bus(), far)
        for frame in sent:
            near.send(kernel_bytes(frame))
        assert [reader(0) for _ in sent] == sent
        assert reader(0) is None


def test_times_and_drops_beside_the_frames(pair: tuple[socket.socket, Scripted]) -> None:
    """The count is the kernel's of all time, of 32 bits: it may begin anew."""
    near, far = pair
    reader = SocketcanReader(bus(), far)
    counts = [0xFFFF_FFF0, 0xFFFF_FFF0, 4]
    far.beside = [
        [
            (socket.SOL_SOCKET, SO_TIMESTAMPNS, struct.pack("@ll", 5 + n, 250_000_000)),
            (socket.SOL_SOCKET, SO_RXQ_OVFL, struct.pack("=I", count)),
        ]
        for n, count in enumerate(counts)
    ]
    found = []
    for _ in counts:
        near.send(kernel_bytes(Frame(1)))
        frame = reader(0)
        assert frame is not None
        found.append((frame.timestamp, reader.take_dropped()))
    assert found == [(5.25, 0xFFFF_FFF0), (6.25, 0), (7.25, 20)]


def test_waiting_and_what_wakes(pair: tuple[socket.socket, Scripted]) -> None:
    """It waits as long as told, and a frame ends that; a filter that the kernel has not is applied here."""
    near, far = pair
    reader = SocketcanReader(bus(lambda frame: frame.arbitration_id > 1), far)
    assert reader(0.001) is None
    near.send(kernel_bytes(Frame(1)))
    near.send(kernel_bytes(Frame(2)))
    frame = reader(5)
    assert frame is not None
    assert frame.arbitration_id == 2


@pytest.mark.parametrize("size", [0, 15, 40, 71])
def test_what_is_no_frame(pair: tuple[socket.socket, Scripted], size: int) -> None:
    """CAN XL, or something else: not understood, and not taken for a frame."""
    near, far = pair
    reader = SocketcanReader(bus(), far)
    near.send(bytes(size))
    with pytest.raises(ValueError, match="neither classic CAN nor CAN FD"):
        reader(0)


@pytest.mark.parametrize(
    ("said", "state"),
    [
        ([(0x04, b"\0\x30")], "error-passive"),
        ([(0x04, b"\0\x10"), (0x04, b"\0\x08")], "error-active"),
        ([(0x40, b""), (0x02, bytes(8))], "bus-off"),
        ([(0x40, b""), (0x100, b"")], "error-active"),
        ([(0x04, b"\0\x20"), (0x04, b"\0\x40")], "error-active"),
        ([(0x04, b"")], "error-active"),
    ],
)
def test_the_controllers_state(
    pair: tuple[socket.socket, Scripted], said: list[tuple[int, bytes]], state: str
) -> None:
    """As error frames tell it (linux/can/error.h); others change nothing."""
    near, far = pair
    reader = SocketcanReader(bus(), far)
    for kinds, data in said:
        near.send(kernel_bytes(msgspec.structs.replace(Frame(kinds, data), is_error_frame=True)))
        reader(0)
    assert (reader.state, reader.overflows) == (state, 0)
