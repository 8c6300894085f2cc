"""Equations: what can be said, what is refused and how, what comes out."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from aces_bus.controller import Equations
from aces_bus.errors import CallerError, UnknownNameError
from aces_bus.runtime import VirtualClock
from aces_bus.state import State
from tests.controller.fakes import Fake, close, fakes

MS = 1_000_000
value = st.floats(-1e3, 1e3)


class Bare:
    """A state with a value and nothing else."""

    def __getitem__(self, when: float) -> float:
        return 0.0


def made(text: str, **options: Any) -> Equations:
    return Equations("law", text, rate_hz=100, **options)


def test_the_papers_notation() -> None:
    """Values now and before, derivatives and integrals, time and parameters, one set-point a line."""
    law = made(
        """
        # a comment, and a blank line

        e       = goal - LKP[0]
        LKP[0]  = kp*e - kd*d(LKP) + ki*integral(LKP)[0]
        theta["left.AP"][0] = (LKP[0] +
                               LKP[-3/(2*100)]) / 2
        RAP[0]  = sin(2*pi*t) if t > 0.1 else 0
        """,
        parameters={"goal": 1.0, "kp": 2.0, "kd": 0.5, "ki": 0.1},
    )
    assert law.states == ("LKP",)
    assert law.writes == ("LKP", "left.AP", "RAP")
    state = Fake(0.2, rate=0.4, integral=3.0)
    state.past[-0.015] = 0.4
    law.bind({"LKP": state})
    law.start(0)
    assert close(law.step(0), **{"LKP": 1.6 - 0.2 + 0.3, "left.AP": 0.3, "RAP": 0.0})
    law.set(kp=0.0)
    assert close(law.step(125 * MS), **{"LKP": 0.1, "left.AP": 0.3, "RAP": math.sin(0.25 * math.pi)})
    with pytest.raises(UnknownNameError, match="there are: goal, kd, ki, kp"):
        law.set(k=1)


def test_the_measured_value_stays_through_all_lines() -> None:
    """A set-point for a state does not change what the state reads."""
    law = made("LKP[0] = LKP[0] + 1\nRKP[0] = LKP[0]")
    law.bind(fakes(LKP=0.5))
    assert law.step(0) == {"LKP": 1.5, "RKP": 0.5}


def test_memory_keeps_its_value_until_the_next_start() -> None:
    """A counter in memory counts steps."""
    law = made("n += 1\nX[0] = n", memory={"n": 0})
    for _ in range(2):
        law.start(0)
        assert [law.step(n)["X"] for n in range(3)] == [1.0, 2.0, 3.0]


@given(value, value, st.floats(0.1, 50))
def test_arithmetic_is_pythons(a: float, b: float, c: float) -> None:
    """Precedence, chains of comparisons, conditions and functions give what Python gives."""
    law = made(
        "X[0] = -a**2 + b*c - a/c % 3 + (a if 0 < b <= 5 and not a > b else min(a, b)) + sat(a, -c, c) + quantize(b, c)",
        parameters={"a": a, "b": b, "c": c},
    )
    expected = -(a**2) + b * c - a / c % 3 + (a if 0 < b <= 5 and not a > b else min(a, b))
    expected += max(-c, min(c, a)) + c * round(b / c)
    assert math.isclose(law.step(0)["X"], expected, rel_tol=1e-12, abs_tol=1e-9)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("X[0] = kq*2", r"line 1 .X.0. = kq.2.: nothing is called 'kq'.*parameters: kp"),
        ("\n\nX[0] = 1 +", "line 3"),
        ("X[1] = 2", "only the present"),
        ("X[0] = 1\nX[0] = 2", "line 2 .*set twice"),
        ("X[0] = Y[0]", "no state is called 'Y'.*states: X"),
        ("X[0] = X", r"X is a state: write X\[0\]"),
        ("X = 3", "X is a state"),
        ("kp = 3", "kp is a parameter"),
        ("X[0] = kp[0]", "kp is a number"),
        ("X[0] = later\nlater = 1", "nothing is called 'later'"),
        ("X[0] = foo(1)", "no function 'foo'"),
        ("X[0] = d(X, 2)", "takes one state"),
        ("X[0] = d(kp)", "kp is a number"),
        ("X[0] = sin", "nothing is called 'sin'"),
        ("sin = 1", "cannot be assigned"),
        ("_x = 1", "cannot be assigned"),
        ("X[0] = X.__class__", "not part of an equation"),
        ("X[0] = ().__class__.__bases__", "not part of an equation"),
        ("X[0] = __import__('os')", "no function"),
        ("X[0] = 'text'", "not part of an equation"),
        ("X[0] = [1 for _ in X]", "not part of an equation"),
        ("X[0] = (lambda: 1)()", "not part of an equation"),
        ("X[0] = sin(x=1)", "not part of an equation"),
        ("import os", "an equation is"),
        ("while 1: pass", "an equation is"),
        ("X[0], kp = 1, 2", "an equation is"),
        ("X[0] = 1e999", "too large"),
        ("X[0] = 1" + "0" * 400, "too large"),
        ("X[0] = " + "(" * 500 + "1" + ")" * 500, "nested|parenthes"),
        ("X[0] = " + "-" * 5000 + "1", "nested|cannot be read|maximum"),
        ("X[0] = " + "1+" * 15_000 + "1", "more than 20000"),
        ("X[0] = 1\x00", "law: equations"),
    ],
)
def test_what_is_wrong_is_found_at_definition(text: str, message: str) -> None:
    """With the line, and the names that exist; nothing of Python gets through."""
    with pytest.raises(CallerError, match=message):
        made(text, states=["X"], parameters={"kp": 1.0})


def test_names_are_checked_too() -> None:
    """Parameters cannot take the names of functions, nor be memory as well."""
    for options in ({"parameters": {"sin": 1}}, {"memory": {"t": 1}}, {"parameters": {"a.b": 1}}):
        with pytest.raises(CallerError, match="cannot be the name"):
            made("X[0] = 1", **options)
    with pytest.raises(CallerError, match="both"):
        made("X[0] = 1", parameters={"a": 1}, memory={"a": 1})


@pytest.mark.slow
@given(st.text(max_size=60))
def test_no_text_does_anything_but_compile_or_complain(text: str) -> None:
    """Whatever the text, it is equations or an CallerError."""
    try:
        made(text)
    except CallerError:
        return


@given(st.text(alphabet="X[0]=+-*/().,d sin\n\"'_aifelsntk12#:", max_size=80))
def test_nor_does_text_that_looks_like_equations(text: str) -> None:
    """The same for text made of what equations are made of."""
    try:
        made(text, parameters={"a": 1.0})
    except CallerError:
        return


def test_powers_of_large_numbers_do_not_hang() -> None:
    """Numbers are floats: too large is an error at once."""
    law = made("X[0] = 9**9**9**9")
    with pytest.raises(OverflowError):
        law.step(0)


def test_real_states_wait_until_they_can_be_read() -> None:
    """Unknown at first, then too short a history, then numbers; a derivative of one sample is unknown."""
    clock = VirtualClock()
    state = State("LKP", clock=clock)
    law = made("X[0] = LKP[-0.01] + d(LKP)")
    law.bind({"LKP": state})
    law.start(0)
    assert law.step(0) == {}
    assert law.waiting == "LKP"
    state.push(1.0, 0)
    assert law.step(0) == {}
    assert "LKP" in law.waiting
    state.push(1.5, 10 * MS)
    assert close(law.step(10 * MS), X=51.0)
    assert law.waiting == ""


def test_a_state_without_a_rate_is_named() -> None:
    """Who asks for a derivative of what has none is told at binding."""
    with pytest.raises(CallerError, match="'LKP' has no rate"):
        made("X[0] = d(LKP)").bind({"LKP": Bare()})


def test_the_printed_python_shows_in_tracebacks() -> None:
    """A division by zero shows its line."""
    law = made("X[0] = 1 / (LKP[0] - LKP[0])")
    law.bind(fakes(LKP=0.5))
    with pytest.raises(ZeroDivisionError) as caught:
        law.step(0)
    assert "S0[0] - S0[0]" in str(caught.traceback[-1].statement)
