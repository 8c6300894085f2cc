"""A served bus in an asyncio program: one frame is taken for each time that its file is readable, as python-can does it."""

from __future__ import annotations

import asyncio
import os
import select
from collections.abc import Generator
from contextlib import contextmanager

import can
import pytest

from aces_bus import Frame
from aces_bus.hardware.served.channel import ServedChannel
from aces_bus.hardware.served.readable import ReadableFile
from aces_bus.hardware.served.remote import ServedBus

from .serving import PATIENCE, Open, serve, until, with_unix_sockets

pytestmark = [
    *with_unix_sockets,
    pytest.mark.skipif(not hasattr(select, "epoll"), reason="no epoll on this system"),
]


def is_readable(bus: can.BusABC) -> bool:
    """Return whether a selector sees the bus's file as readable now."""
    return bool(select.select([bus.fileno()], [], [], 0)[0])


def send_together(bus: can.BusABC, count: int) -> None:
    """Give frames to the server in one packet, so that they also reach the other clients together."""
    assert isinstance(bus, ServedBus)
    assert bus.offer([Frame(0x100 + number, b"") for number in range(count)]) == count


@contextmanager
def two_clients(opened: Open) -> Generator[tuple[ServedBus, ServedBus]]:
    """Two clients of a bus without physics, where frames that were given together arrive together."""
    with serve(ServedChannel(bitrate=1_000_000, physics=False)), opened() as left, opened() as right:
        yield left, right


def test_the_file_is_readable_while_frames_wait(opened: Open) -> None:
    """The file stays readable until `recv(0)` has returned the last frame of a packet, and no longer."""
    with two_clients(opened) as (left, right):
        assert not is_readable(right)
        send_together(left, 3)
        for number in range(3):
            until(lambda: is_readable(right))
            got = right.recv(PATIENCE if not number else 0)
            assert got is not None
            assert got.arbitration_id == 0x100 + number
        until(lambda: right.recv(0) is None and not is_readable(right))


def test_frames_that_another_call_read_are_shown(opened: Open) -> None:
    """Frames that came while the state was read make the file readable, although the socket is empty."""
    with two_clients(opened) as (left, right):
        assert not is_readable(right)
        send_together(left, 2)
        until(lambda: bool(right.state) and is_readable(right))
        assert not select.select([right.socket_fileno()], [], [], 0)[0]
        assert [right.recv(0) is None for _ in range(3)] == [False, False, True]
        assert not is_readable(right)


def test_the_file_is_gone_with_the_bus(opened: Open) -> None:
    """Closing the bus closes what `fileno` opened, and `fileno` says so as a closed socket does."""
    with two_clients(opened) as (_, right):
        number = right.fileno()
        before = len(os.listdir("/proc/self/fd"))
        right.shutdown()
        assert right.fileno() == -1
        assert number not in map(int, os.listdir("/proc/self/fd"))
        until(lambda: len(os.listdir("/proc/self/fd")) == before - 4)  # socket, its peer, epoll, flag


def test_without_epoll_there_is_no_file(opened: Open, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the system has no epoll, python-can is referred to its threads, as by its own buses without a file."""
    monkeypatch.delattr(select, "epoll")
    with two_clients(opened) as (_, right), pytest.raises(NotImplementedError):
        right.fileno()
    with pytest.raises(NotImplementedError):
        ReadableFile(0)


def late_rounds(left: ServedBus, right: ServedBus, rounds: int) -> int:
    """Count rounds of three frames of which one does not reach an asyncio Notifier before the next round is sent."""

    async def run() -> int:
        late = 0
        seen: list[int] = []
        complete = asyncio.Event()

        def listen(got: can.Message) -> None:
            seen.append(got.arbitration_id)
            if len(seen) == 3:
                complete.set()

        notifier = can.Notifier(right, [listen], loop=asyncio.get_running_loop())
        try:
            for _ in range(rounds):
                send_together(left, 3)
                try:
                    await asyncio.wait_for(complete.wait(), PATIENCE if not late else 0.02)
                except TimeoutError:
                    late += 1
                assert seen == sorted(seen)
                seen.clear()
                complete.clear()
        finally:
            notifier.stop()
        return late

    return asyncio.run(run())


def test_an_asyncio_notifier_is_never_a_frame_behind(opened: Open) -> None:
    """Of rounds of three frames in one packet, none waits for the next round to be complete."""
    with two_clients(opened) as (left, right):
        assert late_rounds(left, right, 30) == 0


@pytest.mark.slow
def test_two_thousand_rounds_of_an_asyncio_notifier(opened: Open) -> None:
    """Of 2,000 rounds of three frames, none is late by a frame."""
    with two_clients(opened) as (left, right):
        assert late_rounds(left, right, 2000) == 0
