"""State machines: the table is checked, walked and drawn."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from aces_bus.controller import ControlEvent, Phase, StateMachine, Transition
from aces_bus.errors import CallerError, UnknownNameError
from tests.controller.fakes import Fake, fakes

MS = 1_000_000
LEGS = [f"{side}{joint}" for side in "LR" for joint in ("HP", "KP", "AP")]
CROUCH = "\n".join(f"{leg}[0] = {'2*a' if 'K' in leg else 'a'}" for leg in LEGS)


def crouching() -> StateMachine:
    """The original framework's demonstration: wait, crouch and rise, until RSP is moved."""
    return StateMachine(
        "crouch",
        rate_hz=15,
        memory={"a": 0.0},
        parameters={"step": 0.02},
        phases=[
            Phase("wait"),
            Phase("down", each="a += step\n" + CROUCH),
            Phase("up", each="a -= step\n" + CROUCH),
            Phase("over", entry="\n".join(f"{leg}[0] = 0" for leg in LEGS), final=True),
        ],
        table=[
            Transition("wait", "down", after_s=5.0),
            Transition("down", "up", "LHP[0] > 1.205"),
            Transition("up", "down", "LHP[0] < 0.01"),
            Transition("*", "over", "RSP[0] > 0"),
            Transition("*", "over", on="bus-off"),
        ],
    )


def run(
    machine: StateMachine, states: Mapping[str, Fake], start: int, steps: int
) -> list[Mapping[str, float]]:
    """Steps at 15 Hz; what is set is there at the next step."""
    out: list[Mapping[str, float]] = []
    for n in range(start, start + steps):
        setpoints = machine.step(n * 66_666_667)
        for name, value in setpoints.items():
            if name in states:
                states[name].value = value
        out.append(setpoints)
    return out


def test_the_crouching_machine_crouches() -> None:
    """Five seconds of nothing, 61 steps down to 1.22, up to below 0.01, down again; then all to 0 and the end."""
    machine, states = crouching(), fakes(LHP=0.0, RSP=0.0)
    machine.bind(states)
    machine.start(0)
    assert not any(run(machine, states, 0, 75))
    down = run(machine, states, 75, 61)
    assert machine.phase == "down"
    assert down[0]["LKP"] == pytest.approx(0.04)
    assert down[-1]["LHP"] == pytest.approx(1.22)
    up = run(machine, states, 136, 61)
    assert machine.phase == "up"
    assert up[-1]["RAP"] == pytest.approx(0.0)
    run(machine, states, 197, 1)
    assert machine.phase == "down"
    states["RSP"].value = 0.1
    assert run(machine, states, 198, 1) == [dict.fromkeys(LEGS, 0.0)]
    assert (machine.phase, machine.mode, machine.transitions) == ("over", "done", 4)
    assert run(machine, states, 199, 2) == [{}, {}]
    assert [(source, target) for _, source, target in machine.trail][-1] == ("down", "over")


def test_an_event_takes_its_row_at_the_next_step() -> None:
    """The shortcut: from any phase, whatever its guards say; other kinds pass."""
    machine, states = crouching(), fakes(LHP=0.0, RSP=0.0)
    machine.bind(states)
    machine.start(0)
    run(machine, states, 0, 80)
    machine.handle(ControlEvent("reopened", 0, "can0"))
    run(machine, states, 80, 1)
    assert machine.phase == "down"
    machine.handle(ControlEvent("bus-off", 0, "can0"))
    for _ in range(1_000):
        machine.handle(ControlEvent("limited", 0, "can0"))
    run(machine, states, 81, 1)
    assert machine.phase == "over"


def test_entry_exit_and_each_come_in_order() -> None:
    """A transition runs the old exit, the new entry and the new phase's equations; the last set-point wins."""
    machine = StateMachine(
        "order",
        rate_hz=10,
        memory={"n": 0},
        phases=[
            Phase("one", entry="A[0] = 1", each="n += 1\nB[0] = n", exit="A[0] = 2\nC[0] = 2"),
            Phase("two", entry="C[0] = 3\nD[0] = 3", each="D[0] = 4"),
        ],
        table=[Transition("one", "two", "n >= 2"), Transition("two", "one", after_s=0.2)],
    )
    machine.start(0)
    assert machine.step(0) == {"A": 1.0, "B": 1.0}
    assert machine.step(100 * MS) == {"B": 2.0}
    assert machine.step(200 * MS) == {"A": 2.0, "C": 3.0, "D": 4.0}
    assert machine.step(300 * MS) == {"D": 4.0}
    assert machine.step(400 * MS) == {"A": 1.0, "B": 3.0}
    machine.start(0)
    assert machine.step(0) == {"A": 1.0, "B": 1.0}


def test_functions_stand_where_texts_do() -> None:
    """A guard and equations may be functions of the machine; the diagram shows their names."""

    def ready(machine: StateMachine) -> bool:
        return machine.phase_s > 0.25

    def ramp(machine: StateMachine) -> Mapping[str, float]:
        return {"X": machine.bound["X"][0] + machine.phase_s}

    machine = StateMachine(
        "f",
        rate_hz=10,
        states=["X"],
        phases=[Phase("a", each=ramp), Phase("b", final=True)],
        table=[Transition("a", "b", ready)],
    )
    machine.bind(fakes(X=1.0))
    machine.start(0)
    assert [dict(machine.step(n * 100 * MS)) for n in range(3)] == [{"X": 1.0}, {"X": 1.1}, {"X": 1.2}]
    machine.step(300 * MS)
    assert machine.mode == "done"
    assert "a --> b: ready" in machine.mermaid()


def test_at_most_one_transition_a_step() -> None:
    """Guards that always hold make no endless loop; the first row of the table wins."""
    machine = StateMachine(
        "loop",
        rate_hz=10,
        phases=[Phase("a"), Phase("b"), Phase("c")],
        table=[
            Transition("a", "b", "true"),
            Transition("a", "c", "true"),
            Transition("b", "a", "true"),
            Transition("c", "a", "true"),
        ],
    )
    machine.start(0)
    phases = [(machine.step(n), machine.phase)[1] for n in range(4)]
    assert phases == ["a", "b", "a", "b"]


def test_pause_single_resume_stop() -> None:
    """Paused it gives nothing, but for single steps; stopped it stands still."""
    machine = StateMachine(
        "one", rate_hz=10, memory={"n": 0}, phases=[Phase("a", each="n += 1\nX[0] = n")], table=[]
    )
    machine.start(0)
    assert machine.step(0) == {"X": 1.0}
    machine.pause()
    assert [machine.step(1), machine.step(2)] == [{}, {}]
    machine.single()
    assert [machine.step(3), machine.step(4)] == [{"X": 2.0}, {}]
    machine.resume()
    assert machine.step(5) == {"X": 3.0}
    machine.stop(6)
    assert (machine.step(7), machine.mode) == ({}, "stopped")


def test_it_waits_for_its_states() -> None:
    """Nothing is evaluated while a state is unknown; the phase begins when all are known."""
    machine = StateMachine(
        "w",
        rate_hz=10,
        phases=[Phase("a", each="X[0] = Y[0]"), Phase("b", final=True)],
        table=[Transition("a", "b", after_s=1)],
    )
    y = Fake(float("nan"))
    machine.bind({"Y": y})
    machine.start(0)
    assert machine.step(0) == {}
    assert machine.waiting == "Y"
    y.value = 0.5
    assert machine.step(2_000 * MS) == {"X": 0.5}
    assert machine.phase == "a"
    machine.set()
    with pytest.raises(UnknownNameError):
        machine.set(kp=1)


@pytest.mark.parametrize(
    ("phases", "table", "message"),
    [
        ([], [], "no phase"),
        (["a", "a"], [], "'a' is there twice"),
        (["a", "*"], [], r"cannot be called '\*'"),
        (["a", "b"], [("a", "c", "true")], r"row 1 \('a' → 'c'\): there is no phase 'c' \(there are: a, b\)"),
        (["a", "b"], [("c", "a", "true")], "there is no phase 'c'"),
        (["a", "b"], [("a", "b", "")], "neither when, on nor after_s"),
        (
            ["a", "b", "c"],
            [("a", "b", "true"), ("b", "a", "true"), ("c", "a", "true")],
            "no way leads from 'a' to 'c'",
        ),
        (["a", "b"], [("a", "b", "true")], "no way leads out of 'b'; say final=True"),
    ],
)
def test_a_wrong_table_is_refused(
    phases: Sequence[str], table: Sequence[tuple[str, str, str]], message: str
) -> None:
    """Missing and unreachable phases, dead ends and empty conditions, by name."""
    with pytest.raises(CallerError, match=message):
        StateMachine(
            "m", rate_hz=10, phases=[Phase(one) for one in phases], table=[Transition(*row) for row in table]
        )


def test_what_is_final_has_no_way_out_and_times_are_times() -> None:
    """The rest of what can be wrong with rows; several faults come together."""
    with pytest.raises(CallerError, match=r"'b' is final; row 2.*after_s = -1"):
        StateMachine(
            "m",
            rate_hz=10,
            phases=[Phase("a"), Phase("b", final=True)],
            table=[Transition("b", "a", "true"), Transition("a", "b", after_s=-1)],
        )


def test_equations_in_a_table_say_where_they_are_wrong() -> None:
    """The phase or the transition is named."""
    for phases, table, message in (
        ([Phase("a", each="X[0] = kp")], [], "m: phase 'a', each, line 1"),
        (
            [Phase("a"), Phase("b", final=True)],
            [Transition("a", "b", "kp > 1")],
            "m: transition 'a' → 'b', line 1",
        ),
    ):
        with pytest.raises(Exception, match=message):
            StateMachine("m", rate_hz=10, phases=phases, table=table)


def test_the_table_draws_itself() -> None:
    """Mermaid and Graphviz, each row and phase in them, odd names quoted."""
    machine = StateMachine(
        "odd",
        rate_hz=10,
        phases=[Phase("left leg"), Phase('a "b"', final=True)],
        table=[Transition("left leg", 'a "b"', "LHP[0] > 1", on="lost", after_s=2)],
    )
    assert machine.mermaid().splitlines() == [
        "stateDiagram-v2",
        '    state "left leg" as phase_0',
        '    state "a \\"b\\"" as phase_1',
        "    [*] --> phase_0",
        "    phase_0 --> phase_1: on lost and after 2 s and LHP[0] > 1",
        "    phase_1 --> [*]",
    ]
    assert '"left leg" -> "a \\"b\\"" [label="on lost and after 2 s and LHP[0] > 1"];' in machine.dot()
    assert crouching().mermaid().count("--> over") == 6


@given(
    st.lists(st.tuples(st.sampled_from("abcd"), st.sampled_from("abcd"), st.integers(0, 3)), max_size=8),
    st.data(),
)
def test_the_interpreter_equals_the_rule(rows: list[tuple[str, str, int]], data: Any) -> None:
    """For random tables and inputs the phase is what reading the table row by row gives."""
    phases = [Phase(name, final=False) for name in "abcd"]
    table = [Transition(source, target, f"X[0] == {n}") for source, target, n in rows]
    table += [Transition(one, "abcd"[(i + 1) % 4], "X[0] == 9") for i, one in enumerate("abcd")]
    machine, x = StateMachine("m", rate_hz=10, phases=phases, table=table), Fake()
    machine.bind({"X": x})
    machine.start(0)
    machine.step(0)
    here = "a"
    for step, value in enumerate(data.draw(st.lists(st.sampled_from([0, 1, 2, 3, 9]), max_size=12)), 1):
        x.value = value
        machine.step(step)
        fits = [row.target for row in table if row.source == here and row.when == f"X[0] == {value}"]
        here = fits[0] if fits else here
        assert machine.phase == here
