"""Ctrl-C while a command waits for more: the work in hand is finished, and no Ctrl-C is lost."""

from __future__ import annotations

import signal
from collections.abc import Generator, Iterator
from contextlib import contextmanager

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
