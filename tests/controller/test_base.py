"""Controllers as classes and as functions."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pytest

import aces_bus.controller
from aces_bus.controller import Controller, controller
from aces_bus.controller.base import known_value
from aces_bus.device import UNKNOWN
from aces_bus.errors import CallerError, UnknownNameError
from aces_bus.runtime import VirtualClock
from aces_bus.state import State
from tests.controller.fakes import Fake, fakes

MS = 1_000_000


def test_the_public_names_exist() -> None:
    """`__all__` is sorted as it stands, and every name of it can be had."""
    for name in aces_bus.controller.__all__:
        assert getattr(aces_bus.controller, name) is not None


def test_a_class_is_a_controller() -> None:
    """Name, rate and states are said once; `bound` has the states, and no others."""

    class Follow(Controller):
        def step(self, now_ns: int) -> Mapping[str, float]:
            return {"RKP": self.bound["LKP"][0]}

    follow = Follow("follow", rate_hz=100, states=["LKP", "LKP"], writes=["RKP"])
    follow.bind(fakes(LKP=0.5, LHP=0.1))
    assert follow.states == ("LKP",)
    assert list(follow.bound) == ["LKP"]
    assert follow.step(0) == {"RKP": 0.5}


def test_a_state_that_does_not_exist_is_named() -> None:
    """With the controller that reads it, and those that exist."""
    with pytest.raises(UnknownNameError, match=r"'c' reads it.*did you mean 'LKP'"):
        Controller("c", rate_hz=10, states=["LPK"]).bind(fakes(LKP=0.0))


@pytest.mark.parametrize("rate", [0.0, -1.0, float("nan"), float("inf"), 1e7])
def test_a_rate_that_is_none_is_refused(rate: float) -> None:
    """Zero, negative, endless or absurd."""
    with pytest.raises(CallerError, match="not a rate"):
        Controller("c", rate_hz=rate)


@pytest.mark.parametrize("value", [UNKNOWN, None, "high", float("nan"), float("inf")])
def test_unknown_has_many_faces(value: Any) -> None:
    """Whatever is not a finite number is unknown, and so is a state that raises or is absent."""
    state = Fake()
    state.value = value
    assert known_value(state) is None
    assert known_value(None) is None
    assert known_value(Fake(0.25)) == 0.25


def test_a_function_gets_its_states_time_and_gains() -> None:
    """Positional parameters are states, t and dt; keyword-only ones are gains, which can be set."""

    @controller(rate_hz=50)
    def law(LKP: Any, t: float, dt: float, *, kp: float = 2.0) -> Mapping[str, float]:
        return {"LKP": kp * LKP[0], "t": t, "dt": dt}

    assert (law.name, law.states, law.rate_hz) == ("law", ("LKP",), 50.0)
    law.bind(fakes(LKP=0.25))
    law.start(1_000 * MS)
    assert law.step(1_000 * MS) == {"LKP": 0.5, "t": 0.0, "dt": 0.02}
    law.set(kp=4.0)
    assert law.step(1_030 * MS) == {"LKP": 1.0, "t": 0.03, "dt": 0.03}
    with pytest.raises(UnknownNameError, match="there are: kp"):
        law.set(kd=1.0)


def test_a_functions_memory_lasts_a_run() -> None:
    """It begins empty with each start; `states` gives those whose names are not identifiers."""

    @controller(rate_hz=50, states=["left.AP"])
    def count(states: Any, memory: Any) -> Mapping[str, float]:
        memory.n = getattr(memory, "n", 0) + 1
        return {"left.AP": memory.n + states["left.AP"][0]}

    count.bind({"left.AP": Fake(0.5)})
    for _ in range(2):
        count.start(0)
        assert [count.step(n)["left.AP"] for n in range(3)] == [1.5, 2.5, 3.5]


def test_a_wrong_signature_is_found_at_definition() -> None:
    """Defaults on positional parameters, star arguments, gains without a value, states that were not declared."""

    def positional(LKP: Any, kp: float = 1.0) -> None: ...
    def star(*states: Any) -> None: ...
    def bare(LKP: Any, *, kp: float) -> None: ...
    def other(LPK: Any) -> None: ...

    for law, message in (
        (positional, "not keyword-only"),
        (star, "neither a state"),
        (bare, "needs a default"),
    ):
        with pytest.raises(CallerError, match=message):
            controller(rate_hz=10)(law)
    with pytest.raises(UnknownNameError, match="did you mean 'LKP'"):
        controller(rate_hz=10, states=["LKP"])(other)


def test_a_function_is_not_called_before_its_states_are_known() -> None:
    """Unknown is not zero: no set-points, and `waiting` says for whom; the same when a state goes stale."""
    clock = VirtualClock()
    state = State("LKP", clock=clock, stale_after_s=0.1)

    @controller(rate_hz=50)
    def law(LKP: Any) -> Mapping[str, float]:
        return {"LKP": 2 * LKP[0] + 1}

    law.bind({"LKP": state})
    law.start(0)
    assert law.step(0) == {}
    assert law.waiting == "LKP"
    state.push(0.5, clock.now())
    assert law.step(1) == {"LKP": 2.0}
    clock.advance(500 * MS)
    assert law.step(2) == {}
    assert law.waiting == "LKP"
    state.push(1.0, clock.now())
    assert law.step(3) == {"LKP": 3.0}
    assert law.waiting == ""


def test_a_law_going_stale_in_the_middle_waits() -> None:
    """Arithmetic with an unknown value is not a fault of the law; any other TypeError is."""
    late = Fake()

    @controller(rate_hz=50)
    def law(LKP: Any) -> Mapping[str, float]:
        return {"LKP": 1 + LKP[0]}

    law.bind({"LKP": late})
    assert law.step(0) == {"LKP": 1.0}
    late.value = UNKNOWN  # type: ignore[assignment]
    assert law.step(1) == {}


def test_a_fault_of_the_law_is_no_excuse() -> None:
    """A TypeError that does not come from an unknown value gets out, to the supervisor."""

    @controller(rate_hz=50)
    def law(LKP: Any) -> Mapping[str, float]:
        return {"LKP": LKP[0] + "x"}

    law.bind(fakes(LKP=0.5))
    with pytest.raises(TypeError):
        law.step(0)
