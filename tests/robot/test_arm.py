"""The arm of examples/arm.py in virtual time: four makers' devices, each end, each limit, an e-stop, a killed program."""

from __future__ import annotations

import importlib.util
from typing import Any

import pytest

from aces_bus.controller import Controller
from aces_bus.robot import Runner, run_virtual
from tests.robot.arm import DEVICE_OF, FILE, MS, Truth, arm, is_driving, kill, ways_of

JOINTS = tuple(DEVICE_OF)
#: What each device does without its host, and after how long (s), as its driver declares it.
ALONE = {
    "M1": ("brakes", 0.1),
    "M2": ("brakes", 0.1),
    "O3": ("goes on", None),
    "D4": ("limp", 0.5),
    "X5": ("holds", 0.5),
    "X6": ("holds", 0.5),
}


@pytest.fixture(scope="module")
def example() -> Any:
    spec = importlib.util.spec_from_file_location("arm_example", FILE.with_suffix(".py"))
    assert spec is not None
    assert spec.loader is not None
    made = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(made)
    return made


def waving(example: Any, during: Any = None, at_ms: int = 1000, seconds: float = 2.0, **options: Any) -> Any:
    """Wave; gives how it ended, the run, and where the joints truly were."""
    run = run_virtual(arm(), [example.wave], **options)
    with run:
        run.do("enable")
        truth = Truth(run.world)
        if during is not None:
            run.clock.call_in(at_ms * MS, lambda: during(run))
        ended = run.run(seconds)
        at = truth.now()
        run.world.clock.advance(600 * MS)
        after = truth.now()
    return ended, run, truth, at, after


def driving(run: Runner) -> set[str]:
    return {name for name in DEVICE_OF.values() if is_driving(run.world.twins[name])}


# ---------------------------------------------------------------------- its ends


def test_it_is_led_to_its_pose_and_is_then_off(example: Any) -> None:
    """All six joints, of four makers, from where they waved."""
    ended, run, truth, at, _ = waving(example, at_end="park")
    assert sorted(ended.parked) == sorted(JOINTS)
    assert (ended.not_parked, ended.not_stopped, ended.tripped) == ({}, {}, {})
    assert run.rig.robot.park is not None
    for joint, angle in run.rig.robot.park.pose.items():
        assert at[joint] == pytest.approx(angle, abs=0.03), joint
    assert driving(run) == set()
    assert truth.beyond() == {}


def test_what_holds_is_left_and_what_would_fall_is_named(example: Any) -> None:
    """The ODrive and the servos stay where they are; moteus and Damiao are off, each with its reason."""
    ended, run, _, at, after = waving(example, at_end="hold")
    assert ended.held == ["O3", "X5", "X6"]
    assert set(ended.let_go) == {"M1", "M2", "D4"}
    assert "0.1 s after its host is gone" in ended.let_go["M1"]
    assert driving(run) <= {"O3"}
    for joint in ("elbow", "wrist", "hand"):
        assert after[joint] == pytest.approx(at[joint], abs=0.05)  # what it lags behind its last set-point
    assert run.world.twins["O3"].state == "closed_loop"


def test_the_usual_end_leaves_nothing_on(example: Any) -> None:
    """Off, confirmed, and not moved any more."""
    ended, run, _, at, after = waving(example)
    assert (ended.held, ended.not_stopped, ended.failed) == ([], {}, [])
    assert driving(run) == set()
    assert after == pytest.approx(at, abs=0.1)  # they coast


def test_a_trip_parks(example: Any) -> None:
    """`on_trip="park"`: a servo that is too hot is named, the rest of the arm folds."""
    ended, run, *_ = waving(
        example, lambda run: run.world.twins["X6"].fault("overload"), on_trip="park", seconds=5.0
    )
    assert "X6" in ended.tripped["wave"]
    assert sorted({*ended.parked, *ended.not_parked}) == sorted(JOINTS)
    assert set(ended.parked) >= {"base", "shoulder", "elbow", "forearm", "wrist"}
    assert driving(run) == set()


# ---------------------------------------------------------------------- without its program


def test_a_killed_program_leaves_what_the_drivers_declare(example: Any) -> None:
    """kill -9: moteus brakes, Damiao is limp, the servos stay, and the ODrive follows its last set-point."""
    run = run_virtual(arm(), [example.wave])
    with run:
        run.do("enable")
        run.start()
        run.world.clock.advance(1_000 * MS)
        for name, (does, after_s) in ALONE.items():
            loss = run.rig.devices[name].host_loss
            assert (loss.does, loss.after_s) == (does, after_s), name
        truth = Truth(run.world)
        kill(run)
        run.world.clock.advance(700 * MS)
        at = truth.now()
        twins = run.world.twins
        assert [twins[name].mode for name in ("M1", "M2")] == ["position_timeout"] * 2
        assert twins["D4"].status == "lost_communication"
        assert twins["O3"].state == "closed_loop"
        assert twins["X5"].motion.is_driven
        run.world.clock.advance(500 * MS)
        assert truth.now() == pytest.approx(at, abs=0.005)
        ended = run.stop()
    assert set(ended.not_stopped) >= {"O3", "D4"}  # nothing comes to them any more: it is said


# ---------------------------------------------------------------------- an e-stop

PANEL = """
[estop]
panel = { signal = "IO.di1", clear = true, stale_after_s = 0.2 }
"""
MODULE = """
[buses.io]
link = "can"
protocol = "canopen"
bitrate = 500_000
[devices.IO]
driver = "cia401"
bus = "io"
credentials = { node = 17 }
settings = { every_s = 0.05 }
"""


@pytest.mark.parametrize(
    ("what", "at_end"),
    [("pressed", "disable"), ("pressed", "hold"), ("pressed", "park"), ("power off", "park")],
)
def test_an_e_stop_stops_all_of_them_whatever_the_end_is(example: Any, at_end: Any, what: str) -> None:
    """Pressed, or its module gone: nobody holds or parks, nothing moves."""
    run = run_virtual(arm(more=MODULE + PANEL), [example.wave], at_end=at_end)
    run.world.twins["IO"].put("di1", True)
    with run:
        run.clock.wait(lambda: not run.rig.chain.pressed, 1_000 * MS)
        run.do("enable")
        truth = Truth(run.world)
        io = run.world.twins["IO"]
        press = (lambda: io.put("di1", False)) if what == "pressed" else (lambda: io.power(False))
        run.clock.call_in(800 * MS, press)
        ended = run.run(3.0)
        assert ended.seconds < 1.1
        assert "panel" in ended.tripped["wave"]
        assert (ended.held, ended.parked, ended.not_stopped) == ([], [], {})
        assert driving(run) == set()
        run.world.clock.advance(300 * MS)
        at = truth.now()
        run.world.clock.advance(300 * MS)
        assert truth.now() == pytest.approx(at, abs=0.002)


# ---------------------------------------------------------------------- its limits

SIGNALS = list(dict.fromkeys(way.signal for joint in JOINTS for way in ways_of(joint)))


@pytest.mark.parametrize(
    ("signal", "sign"),
    [
        # In turn one direction of each is quick.
        pytest.param(signal, sign, marks=[] if sign == (-1) ** number else [pytest.mark.slow])
        for number, signal in enumerate(SIGNALS)
        for sign in (1, -1)
    ],
)
def test_no_joint_gets_past_its_limits_in_any_mode(signal: str, sign: int) -> None:
    """Pushed outward for two seconds by position, speed, torque, current or duty: v·(poll + reply + tick) + v²/2a.

    What cannot be set by that signal is pushed by position.
    """
    ways = {
        joint: next((way for way in ways_of(joint) if way.signal == signal), ways_of(joint)[0])
        for joint in JOINTS
    }
    pushed = {f"{joint}.{way.signal}": sign * way.large for joint, way in ways.items()}

    class Push(Controller):
        def step(self, now_ns: int) -> dict[str, float]:
            return pushed

    run = run_virtual(
        arm(*(way.command for way in ways.values())), [Push("push", rate_hz=100, writes=[*pushed])]
    )
    with run:
        run.do("enable")
        truth = Truth(run.world)
        run.run(2.0)
    assert truth.beyond() == {}
    short = [joint for joint in JOINTS if ways[joint].signal == signal and truth.past[joint] <= -0.2]
    assert not short, "not come to their bounds"
    assert driving(run) == set()
