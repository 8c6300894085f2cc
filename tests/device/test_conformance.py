"""The conformance tests themselves: good drivers pass on CAN and on a half-duplex line, planted faults do not."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from aces_bus.device import Driver, Poll
from aces_bus.testing import driver_tests, run_check
from tests.device.fan import FAN, SERIAL_FAN, Fan, FanTwin

test_fan = driver_tests(FAN)
test_serial_fan = driver_tests(SERIAL_FAN)


class Deaf(Fan):
    """Forgets to poll."""

    polls = ()


class Careless(Fan):
    """Waits for an answer for ever and a day."""

    polls = (Poll("Ask", reply="State", timeout_s=1e6),)


class Unlimited(Fan):
    """Passes on whatever it is given."""

    def _limited(self, of: Any, value: Any) -> Any:
        return value


class Eager(Fan):
    """Moves when the bus is opened."""

    def start(self) -> None:
        self.send("Set", left=100, right=100)


class Spinning(FanTwin):
    """A twin whose joint others can see."""

    def setup(self) -> None:
        super().setup()
        self.world.joints[self.name] = self

    def position(self, now: int) -> float:
        return self.left * now / 1e9


class Random(FanTwin):
    """A twin with chance of its own."""

    counter = 0

    def setup(self) -> None:
        super().setup()
        type(self).counter += 1

    @property
    def left(self) -> int:
        return type(self).counter

    @left.setter
    def left(self, value: int) -> None:
        pass


class Fragile(FanTwin):
    """A twin that never answers again after a fault or without power."""

    def fault(self, name: str, amount: float | None = None, *, on: bool = True) -> None:
        super().fault(name if on else "silent", amount if on else None)

    def power(self, on: bool) -> None:
        super().power(on)
        if on:
            super().fault("silent")


@pytest.mark.parametrize(
    ("check", "broken"),
    [
        ("received", replace(FAN, device=Deaf)),
        ("silence", replace(FAN, device=Careless)),
        ("silence", replace(FAN, twin=Fragile)),
        ("misbehaviour", replace(FAN, device=Careless)),
        ("misbehaviour", replace(FAN, twin=Fragile)),
        ("reboot", replace(FAN, twin=Fragile)),
        ("limits", replace(FAN, device=Unlimited)),
        ("quiet_before", replace(FAN, device=Eager, twin=Spinning)),
        ("same_again", replace(FAN, twin=Random)),
        (
            "set",
            replace(
                FAN, twin=type("Lazy", (FanTwin,), {"change": lambda self, request: None, "_hearing": {}})
            ),
        ),
        ("declared", replace(FAN, source="")),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_a_fault_is_found(check: str, broken: Driver) -> None:
    """Each check fails on a driver or twin that breaks its sentence."""
    with pytest.raises(AssertionError):
        run_check(check, broken)


def test_an_excuse_is_for_one_check() -> None:
    """What a driver is excused from is not looked at, the rest is."""
    run_check("limits", replace(FAN, device=Unlimited), excused={"limits: *": "the bus limits"})


def test_tests_are_one_line() -> None:
    """`driver_tests` gives a test that pytest finds, with one case a check."""
    test: Callable[[str], None] = driver_tests(FAN)
    marks: Any = getattr(test, "pytestmark", [])
    assert [mark.name for mark in marks] == ["parametrize"]
