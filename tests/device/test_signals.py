"""Signals: unknown, fresh, stale, set."""

from __future__ import annotations

import copy
import pickle

import pytest

from aces_bus.device import UNKNOWN
from aces_bus.device.signals import Signal
from aces_bus.errors import CallerError
from aces_bus.runtime import VirtualClock


def test_unknown_fresh_stale_and_unknown_again() -> None:
    """A signal is unknown until it is heard, fresh for its time, then stale with its last value, and can be forgotten."""
    clock = VirtualClock()
    signal = Signal("A.speed", clock, unit="rad/s", stale_after_ns=1_000)
    assert (signal.value, signal.is_stale, signal.age_ns) == (UNKNOWN, True, None)
    signal.update(0.0, clock.now())
    assert repr(signal) == "<A.speed = 0.0 rad/s>"
    clock.advance(1_000)
    assert signal.value == 0.0
    clock.advance(1)
    assert signal.value is UNKNOWN
    assert (signal.last, signal.age_ns) == (0.0, 1_001)
    signal.forget()
    assert signal.read().value is UNKNOWN


def test_listeners_hear_each_value_with_its_instant() -> None:
    """What is heard is handed on with the instant it was measured at."""
    signal = Signal("A.speed", VirtualClock())
    heard: list[tuple[float, int]] = []
    signal.listeners.append(lambda value, instant: heard.append((value, instant)))
    signal.update(1.0, 5)
    signal.update(2.0, 7)
    assert heard == [(1.0, 5), (2.0, 7)]


def test_listeners_are_told_that_a_signal_is_forgotten() -> None:
    """What is forgotten is unknown to its listeners too, at that instant; what was never known is not forgotten."""
    clock = VirtualClock()
    signal = Signal("A.speed", clock)
    heard: list[tuple[object, int]] = []
    signal.listeners.append(lambda value, instant: heard.append((value, instant)))
    signal.forget()
    assert heard == []
    signal.update(1.0, 5)
    clock.advance(9)
    signal.forget()
    signal.forget()
    assert heard == [(1.0, 5), (UNKNOWN, 9)]
    assert (signal.last, signal.instant, signal.age_ns) == (UNKNOWN, None, None)


def test_read_only_signals_refuse() -> None:
    """Setting a signal calls its setter; without one it is refused by name."""
    given: list[float] = []
    Signal("A.speed", VirtualClock(), setter=given.append).set(3.0)
    assert given == [3.0]
    with pytest.raises(CallerError, match=r"A\.speed is read-only"):
        Signal("A.speed", VirtualClock()).set(3.0)


def test_there_is_one_unknown() -> None:
    """UNKNOWN is false, and itself after copying and pickling."""
    assert not UNKNOWN
    assert copy.deepcopy(UNKNOWN) is UNKNOWN
    assert pickle.loads(pickle.dumps(UNKNOWN)) is UNKNOWN
