"""Ctrl-C while a command waits for more: the work in hand is finished, and no Ctrl-C is lost."""

from __future__ import annotations

import signal
from collections.abc import Generator, Iterator
from contextlib import contextmanager

import pytest

from aces_tools.patience import Patience


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
