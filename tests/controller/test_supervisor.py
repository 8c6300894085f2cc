"""The supervisor: events and exceptions become declared reactions, within one cycle."""

from __future__ import annotations

import re
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from aces_bus.controller import (
    IGNORE,
    Bounds,
    ControlEvent,
    Controller,
    Guard,
    Phase,
    Player,
    StateMachine,
    Supervisor,
    Trajectory,
    Transition,
    degrade,
    stop,
)
from aces_bus.controller.events import EventLike
from aces_bus.device.events import DeviceEvent
from aces_bus.errors import CallerError
from tests.controller.fakes import fakes

MS = 1_000_000


class Walk(Controller):
    """Gives a growing set-point; raises what a test puts into `fault`."""

    def __init__(self) -> None:
        super().__init__("walk", rate_hz=100, states=["A"])
        self.fault: Exception | None = None
        self.deaf: Exception | None = None
        self.received: list[str] = []
        self.n = 0

    def step(self, now_ns: int) -> Mapping[str, float]:
        if self.fault is not None:
            raise self.fault
        self.n += 1
        return {"A": self.n * 0.01}

    def handle(self, event: EventLike) -> None:
        if self.deaf is not None:
            raise self.deaf
        self.received.append(event.kind)


def supervised(reactions: Mapping[str, Any] | None = None) -> tuple[Supervisor, Walk]:
    walk = Walk()
    supervisor = Supervisor(walk, Guard({"A": Bounds(rate=2.0)}, period_s=0.01, dead_man_s=0.05), reactions)
    supervisor.bind(fakes(A=0.0))
    supervisor.start(0)
    return supervisor, walk


def event(kind: str, source: str = "can0", detail: str = "") -> ControlEvent:
    return ControlEvent(kind, 0, source, detail)


def test_it_is_a_controller_itself() -> None:
    """Name, rate and states are those of the controller inside; set-points go through the guard."""
    supervisor, _ = supervised()
    assert (supervisor.name, supervisor.rate_hz, supervisor.states) == ("walk", 100.0, ("A",))
    assert [supervisor.step(n * 10 * MS)["A"] for n in range(3)] == pytest.approx([0.01, 0.02, 0.03])
    assert supervisor.reason == ""


@pytest.mark.parametrize("kind", ["bus-off", "lost", "silent", "malformed", "never heard of"])
def test_what_is_not_declared_stops_motion_at_the_next_step(kind: str) -> None:
    """The reason is there, and in the controller's own handler before; the set-point stays where it was."""
    supervisor, walk = supervised()
    supervisor.step(0)
    supervisor.handle(event(kind, "can1", "why"))
    assert walk.received == [kind]
    assert supervisor.step(10 * MS) == {"A": 0.01}
    assert supervisor.step(20 * MS) == {"A": 0.01}
    assert supervisor.reason == f"can1: {kind}: why"
    assert supervisor.counts[kind] == 1
    supervisor.release()
    assert supervisor.step(30 * MS)["A"] == pytest.approx(0.03)


@pytest.mark.parametrize("kind", ["opened", "reopened", "error-active", "answers", "clipped"])
def test_what_is_harmless_goes_by(kind: str) -> None:
    """It is counted, and that is all."""
    supervisor, _ = supervised()
    supervisor.handle(event(kind))
    assert supervisor.step(0) == {"A": 0.01}
    assert (supervisor.reason, supervisor.counts[kind]) == ("", 1)


def test_a_degradation_is_an_event_of_the_controller() -> None:
    """It has the fault's instant, the controller as its source, and says what is given up and why."""
    supervisor, _ = supervised({"silent": degrade("no compliance")})
    heard: list[Any] = []
    supervisor.listeners.add(heard.append)
    fault = ControlEvent("silent", 5 * MS, "FT", "")
    supervisor.handle(fault)
    supervisor.step(10 * MS)
    assert [(one.kind, one.instant, one.source, one.detail) for one in heard] == [
        ("degraded", fault.instant, "walk", "no compliance (FT: silent)")
    ]


def test_declared_reactions_by_kind_and_source() -> None:
    """The first reaction whose sources fit is taken; degrading is told once, and its function carried out."""
    done: list[str] = []
    heard: list[str] = []
    supervisor, _ = supervised(
        {
            "silent": (
                degrade("no compliance", lambda one: done.append(one.source), sources=["FT"]),
                stop("disable"),
            ),
            "*": IGNORE,
        }
    )
    supervisor.listeners.add(lambda one: heard.append(one.kind))
    for _ in range(2):
        supervisor.handle(event("silent", "FT"))
        supervisor.handle(event("malformed"))
        assert supervisor.step(0) != {}
    assert supervisor.degraded == {"no compliance": "FT: silent"}
    assert (done, heard) == (["FT"], ["degraded"])
    supervisor.handle(event("silent", "JMC6"))
    assert supervisor.step(10 * MS) == {}
    assert supervisor.reason == "JMC6: silent"
    supervisor.start(20 * MS)
    assert (supervisor.degraded, supervisor.reason) == ({}, "")


def test_a_controller_that_raises_is_stopped() -> None:
    """Its exception does not get out of `step`; the same cycle holds, and says what was raised."""
    supervisor, walk = supervised()
    supervisor.step(0)
    walk.fault = ZeroDivisionError("by zero")
    assert supervisor.step(10 * MS) == {"A": 0.01}
    place = rf"\({re.escape(str(Path('tests/controller/test_supervisor.py')))}:\d+\)"
    assert re.fullmatch(rf"walk: raised: ZeroDivisionError: by zero {place}", supervisor.reason)
    assert supervisor.error is walk.fault
    walk.fault = None
    assert supervisor.step(20 * MS) == {"A": 0.01}


def test_a_fault_that_is_ignored_leaves_it_to_the_dead_man() -> None:
    """Declared harmless, an exception gives no set-points; after 50 ms of them the dead-man holds."""
    supervisor, walk = supervised({"raised": IGNORE})
    supervisor.step(0)
    walk.fault = KeyError("x")
    assert [supervisor.step(n * 10 * MS) for n in range(1, 6)] == [{}] * 5
    assert supervisor.step(60 * MS) == {"A": 0.01}
    assert supervisor.reason == "no set-points for 60 ms"
    walk.fault = None
    assert supervisor.step(70 * MS)["A"] == pytest.approx(0.02)
    assert supervisor.counts["raised"] == 6


def test_a_handler_or_a_reaction_that_raises_stops_too() -> None:
    """Neither gets out, and neither is overlooked."""
    supervisor, walk = supervised({"odd": degrade("x", lambda one: 1 / 0)})
    walk.deaf = ValueError("deaf")
    supervisor.handle(event("opened"))
    supervisor.step(0)
    assert supervisor.reason.startswith("walk: raised: its handler ValueError: deaf (")
    supervisor.start(0)
    walk.deaf = None
    supervisor.handle(event("odd"))
    supervisor.step(10 * MS)
    assert "reaction to odd raised ZeroDivisionError" in supervisor.reason


def test_what_a_controller_tells_counts_like_an_event_from_below() -> None:
    """A player that cannot find its joints says "failed", and that stops motion, at the next step, with the reason."""
    player = Player("p", Trajectory(["A"], [[0.0], [1.0]], rate_hz=10), rate_hz=10, patience_s=0.1)
    supervisor = Supervisor(player, Guard({"A": Bounds()}, period_s=0.1, dead_man_s=0.3))
    supervisor.bind(fakes(A=float("nan")))
    supervisor.start(0)
    assert [supervisor.step(n * 100 * MS) for n in range(4)] == [{}] * 4
    assert supervisor.reason == "p: failed: the present position of A is unknown"
    assert supervisor.writes == ("A",)


def test_events_come_from_other_threads() -> None:
    """Thousands from four threads while it steps: none is lost up to the queue's bound, and it ends up stopped."""
    supervisor, walk = supervised({"tick": IGNORE})

    def burst() -> None:
        for _ in range(200):
            supervisor.handle(event("tick"))

    threads = [threading.Thread(target=burst) for _ in range(4)]
    for thread in threads:
        thread.start()
    for n in range(20):
        supervisor.step(n * 10 * MS)
    for thread in threads:
        thread.join()
    supervisor.handle(event("bus-off"))
    supervisor.step(300 * MS)
    assert supervisor.counts["tick"] == len(walk.received) - 1 == 800
    assert supervisor.reason == "can0: bus-off"


def test_a_flood_of_harmless_events_hides_no_other() -> None:
    """Thousands of them in one cycle: what stops motion is neither pushed out by those after it nor lost behind them."""
    for first in (True, False):
        supervisor, _ = supervised()
        supervisor.step(0)
        for kind in ["bus-off"] * first + ["limited"] * 5_000 + ["bus-off"] * (not first):
            supervisor.handle(event(kind))
        assert supervisor.step(10 * MS) == {"A": 0.01}
        assert supervisor.reason.startswith("can0: bus-off")
        assert (supervisor.dropped, supervisor.counts.total()) == (4_001, 1_000)  # a thousand are kept


def test_a_state_machine_hears_what_the_supervisor_ignores() -> None:
    """The shortcut to a row of the table, with reactions that leave it to the machine."""
    machine = StateMachine(
        "m",
        rate_hz=100,
        phases=[Phase("go", each="A[0] = 1"), Phase("safe", each="A[0] = 0")],
        table=[Transition("go", "safe", on="silent"), Transition("safe", "go", on="answers")],
    )
    supervisor = Supervisor(machine, Guard({"A": Bounds()}, period_s=0.01), {"silent": IGNORE})
    supervisor.bind({})
    supervisor.start(0)
    assert supervisor.step(0) == {"A": 1.0}
    supervisor.handle(event("silent"))
    assert supervisor.step(10 * MS) == {"A": 0.0}
    supervisor.handle(event("answers"))
    assert supervisor.step(20 * MS) == {"A": 1.0}


def test_an_unknown_action_is_refused_when_it_is_declared() -> None:
    """Not when it is needed."""
    with pytest.raises(CallerError, match="hold, park, zero duty, disable"):
        stop("explode")  # type: ignore[arg-type]
    assert str(event("lost", detail="gone")) == "can0: lost: gone"
    assert DeviceEvent("silent", 0, "can0", "JMC6").kind == "silent"


@pytest.mark.parametrize(
    ("reaction", "tripped", "degraded"),
    [
        (stop("hold"), "walk: not finite: A: 5 set-points in a row were not finite numbers", []),
        (degrade("no A"), "", ["no A"]),
        (IGNORE, "", []),
    ],
)
def test_what_numbers_that_are_none_lead_to_is_declared(
    reaction: Any, tripped: str, degraded: list[str]
) -> None:
    """Five in a row for one state are the fault "not finite"; whatever is declared, they leave in no case."""

    class Half(Controller):
        def step(self, now_ns: int) -> Mapping[str, float]:
            return {"A": float("nan"), "B": 0.0}

    guard = Guard({"A": Bounds(), "B": Bounds()}, period_s=0.01, dead_man_s=0.05)
    supervisor = Supervisor(Half("walk", rate_hz=100, states=[]), guard, {"not finite": reaction})
    supervisor.start(0)
    given = [supervisor.step(n * 10 * MS) for n in range(8)]
    assert given[:4] == [{"B": 0.0}] * 4
    assert not any("A" in one for one in given)
    assert supervisor.reason == tripped
    assert list(supervisor.degraded) == degraded
