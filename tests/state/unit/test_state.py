"""Derived states: units, and how many there may be."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from aces_bus.device import UNKNOWN
from aces_bus.runtime import RealClock, VirtualClock
from aces_bus.state import (
    State,
    StateError,
    derived,
)
from aces_bus.state.units import are_same, multiplied, raise_unit
from tests.state.feeding import accumulated, made
from tests.state.test_derived import pair as pair


@pytest.mark.parametrize(
    ("make", "value", "unit"),
    [
        (lambda a, b: a + a, 6.0, "N·m"),
        (lambda a, b: a - 1, 2.0, "N·m"),
        (lambda a, b: 1 - a, -2.0, "N·m"),
        (lambda a, b: 1 + a, 4.0, "N·m"),
        (lambda a, b: 2 * b, 8.0, "rad/s"),
        (lambda a, b: -b, -4.0, "rad/s"),
        (lambda a, b: abs(-b), 4.0, "rad/s"),
        (lambda a, b: b / 2, 2.0, "rad/s"),
        (lambda a, b: 8 / b, 2.0, "s/rad"),
        (lambda a, b: a / b, 0.75, "N·m·s/rad"),
        (lambda a, b: b**2, 16.0, "rad²/s²"),
        (lambda a, b: (b**2) ** 0.5, 4.0, "rad/s"),
        (lambda a, b: a * b / a, 4.0, "rad/s"),
    ],
)
def test_operators(make: Any, value: float, unit: str) -> None:
    """Each operator works with states and numbers on either side, and derives the unit."""
    torque, omega = pair()
    torque.push(3.0, 0)
    omega.push(4.0, 0)
    made_of = make(torque, omega)
    assert made_of[0] == pytest.approx(value)
    assert are_same(made_of.unit, unit), made_of.unit


def test_what_does_not_add_up_is_refused() -> None:
    """Adding different units, states of different clocks or things that are not quantities fails, and says what."""
    torque, omega = pair()
    with pytest.raises(StateError, match=r"\(torque \+ omega\): N·m and rad/s do not add up"):
        _ = torque + omega
    with pytest.raises(StateError, match="different clocks"):
        _ = torque * State("other", clock=VirtualClock())
    with pytest.raises(StateError, match="neither a state nor a number"):
        _ = torque + "1"  # type: ignore[operator]
    with pytest.raises(StateError, match="give the quantities"):
        derived("nothing", math.sin)
    with pytest.raises(StateError, match="give the quantities"):
        derived("nothing", math.sin, 3)  # type: ignore[arg-type]
    assert (State("a", clock=RealClock()) * State("b", clock=RealClock())).unit == ""


def test_no_finite_value_is_unknown() -> None:
    """A division by zero, a logarithm or root of a negative number are unknown, not an exception in a control loop."""
    x = made("x", unit="")
    x.push(-1.0, 0)
    assert (x / (x + 1))[0] is UNKNOWN
    assert (x**0.5)[0] is UNKNOWN
    assert derived("log", math.log, x)[0] is UNKNOWN
    assert derived("exp", lambda value: math.exp(-1e6 * value), x)[0] is UNKNOWN


SYMBOLS = st.sampled_from(["m", "kg", "s", "N", "rad", "°", "%"])


UNITS = st.dictionaries(SYMBOLS, st.integers(-3, 3).filter(bool), max_size=3).map(
    lambda powers: "·".join(f"{symbol}^{power}" for symbol, power in powers.items())
)


@given(UNITS, UNITS)
def test_units_multiply_and_divide_back(left: str, right: str) -> None:
    """What is multiplied and divided by the same is the same; what is printed is read again."""
    product = multiplied(left, right)
    assert are_same(multiplied(product, right, -1), left)
    assert are_same(product, multiplied(right, left))
    assert are_same(raise_unit(raise_unit(left, 2), 0.5), left)
    assert multiplied(product, "") == product or are_same(product, multiplied(product, ""))


def test_odd_units_are_symbols() -> None:
    """Text that is not a product of symbols is kept whole; None spreads."""
    assert multiplied("counts per turn", "s", -1) is not None
    assert are_same("°C", "°C")
    assert not are_same("deg", "rad")
    assert multiplied(None, "s") is None
    assert raise_unit(None, 2) is None
    assert multiplied("m/s²", "s²") == "m"
    assert accumulated([1, 2]) == [1, 3]


def test_a_function_that_raises_does_not_stop_its_inputs() -> None:
    """Whoever subscribes to a computed quantity gets unknown where its function raised; the reader gets the exception."""
    omega = made()
    odd = derived("odd", lambda value: [][0], omega)
    out = odd.integral()
    omega.push(1.0, 0)
    assert out[0] is UNKNOWN
    assert isinstance(odd.failure, IndexError)
    with pytest.raises(IndexError):
        _ = odd[0]
