"""Ctrl-C while a command waits for more: the work in hand is finished, and no Ctrl-C is lost."""

from __future__ import annotations

import ctypes
import os
import random
import signal
import threading
import time
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from functools import partial
from itertools import starmap
from operator import call

import pytest

from aces_tools.patience import ENDING, Patience


class _Hasty(Patience):
    """A Ctrl-C comes just before the waiting begins."""

    @contextmanager
    def waiting(self) -> Generator[None, None, None]:
        signal.raise_signal(signal.SIGINT)
        with super().waiting():
            yield


def test_a_ctrl_c_just_before_the_waiting_ends_it() -> None:
    """Nobody waits for an item then: without end where none comes."""

    def endless() -> Iterator[int]:
        pytest.fail("it waits for ever")
        yield 0

    with _Hasty() as patience:
        assert list(patience.each(endless())) == []
    assert patience.is_over


@contextmanager
def silent_pipe() -> Generator[int, None, None]:
    """A pipe that stays silent; after a minute a byte ends the waiting of a test that fails."""
    reading, writing = os.pipe()
    late = threading.Timer(60.0, os.write, (writing, b"!"))
    late.start()
    try:
        yield reading
    finally:
        late.cancel()
        late.join()
        os.close(reading)
        os.close(writing)


def test_a_ctrl_c_just_before_a_read_blocks_ends_it() -> None:
    """Python has looked for signals, and looks again when the read is over: a silent pipe would never end it."""
    send = ctypes.PyDLL(None)["raise"]  # as the system delivers it: Python does not look
    with silent_pipe() as pipe, Patience() as patience:
        blocked = starmap(call, [(send, int(signal.SIGINT)), (os.read, pipe, 1)])
        assert list(patience.each(iter(partial(list, blocked), None))) == []
    assert patience.is_over


@pytest.mark.parametrize("seed", range(3))
def test_no_ctrl_c_is_lost_in_a_read(seed: int) -> None:
    """At whatever instant it comes, a hundred times: before, at the beginning of, or in a read of a silent pipe."""
    dice = random.Random(seed)
    with silent_pipe() as pipe:
        for _ in range(100):
            pause = dice.uniform(0.0, 1e-3)

            def interrupt(pause: float = pause) -> None:
                time.sleep(pause)
                os.kill(os.getpid(), signal.SIGINT)

            with Patience() as patience:
                sender = threading.Thread(target=interrupt)
                sender.start()
                assert list(patience.each(iter(partial(os.read, pipe, 1), b""))) == []
                sender.join()
            assert patience.is_over


class _Late(Patience):
    """A Ctrl-C comes when an item is there, and the waiting is not over."""

    @contextmanager
    def waiting(self) -> Generator[None, None, None]:
        with super().waiting():
            yield
            signal.raise_signal(signal.SIGINT)


def test_an_item_that_has_come_is_not_dropped() -> None:
    """A Ctrl-C behind it ends the run, and it is the last."""
    with _Late() as patience:
        assert list(patience.each(range(5))) == [0]


def test_nothing_of_it_stays() -> None:
    """Threads, files and handlers are as before."""
    told = signal.set_wakeup_fd(-1)
    signal.set_wakeup_fd(told)
    before = threading.active_count(), len(os.listdir("/proc/self/fd")), signal.getsignal(signal.SIGURG)
    with Patience():
        assert threading.active_count() == before[0] + 1
    assert (
        threading.active_count(),
        len(os.listdir("/proc/self/fd")),
        signal.getsignal(signal.SIGURG),
    ) == before
    assert signal.set_wakeup_fd(told) == told


def test_what_is_in_hand_is_finished() -> None:
    """A Ctrl-C while an item is worked on ends the run behind it."""
    done = []
    with Patience() as patience:
        for item in patience.each(range(5)):
            if item == 2:
                signal.raise_signal(signal.SIGINT)
            done.append(item)
    assert done == [0, 1, 2]


def test_a_second_ctrl_c_interrupts() -> None:
    """Whatever is in hand."""
    with Patience() as patience:
        signal.raise_signal(signal.SIGINT)
        assert patience.is_over
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)


def test_ctrl_z_ends_what_drives(capfd: pytest.CaptureFixture[str]) -> None:
    """It is not a pause where motors are on: it ends the waiting, and says why; elsewhere it suspends as ever."""
    with Patience(is_driving=True) as patience:
        signal.raise_signal(signal.SIGTSTP)
        assert patience.is_over
        assert signal.getsignal(signal.SIGTTOU) is signal.SIG_IGN
    assert "Ctrl-Z ends this" in capfd.readouterr().err
    with Patience():
        assert signal.getsignal(signal.SIGTSTP) is signal.SIG_DFL
    assert signal.getsignal(signal.SIGTTOU) is signal.SIG_DFL


@pytest.mark.parametrize("name", ENDING)
def test_no_signal_ends_a_command_without_its_end(name: str) -> None:
    """Whatever would kill it by default ends the waiting, as Ctrl-C does."""
    number = getattr(signal, f"SIG{name}", None)
    if number is None:
        pytest.skip("this system has no such signal")
    before = signal.signal(number, signal.SIG_DFL)  # pytest or a plug-in may have one of its own
    try:
        with Patience() as patience:
            signal.raise_signal(number)
            assert patience.is_over
        assert signal.getsignal(number) is signal.SIG_DFL
    finally:
        signal.signal(number, before)
