"""What a control loop pays for its states, beside deque, np.interp and scipy, and for its controllers.

1. Everything is measured as a controller would call it, in a plain `for` loop, whose own cost is counted in.
2. Ratios are given where the peer does the same work on the same samples; where it is not installed, its row is missing.
"""

from __future__ import annotations

import math
import re
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from itertools import count, repeat
from time import perf_counter
from typing import Any

import numpy as np

from aces_bus.controller import (
    PID,
    Bounds,
    Guard,
    Phase,
    Player,
    StateMachine,
    Trajectory,
)
from aces_bus.controller import (
    Transition as Transition,
)
from aces_bus.runtime import RealClock
from aces_bus.state import Kalman, LowPass, Median, MovingAverage, RateLimit, Sos, State
from aces_bus.state.filters import Filter

from .rows import BenchRow, fastest, optional

#: A thousand samples at 200 Hz.
HISTORY, PERIOD_NS = 1_000, 5_000_000
#: What a control loop may spend (ns): a value, one between two samples, taking a sample, a filter's step.
VALUE_NS, BETWEEN_NS, PUSH_NS, FILTER_NS = 300, 3_000, 1_000, 2_000
#: The same of a step of controllers: of 21 joints with their limits, of one controller.
JOINTS, JOINTS_NS, STEP_NS = 21, 40_000, 3_000
#: Butterworth, 5 Hz of 200 Hz: second order, and the same four times over.
SECTION = (
    0.005542717210280681,
    0.011085434420561363,
    0.005542717210280681,
    1.0,
    -1.778631777824585,
    0.8008026466657076,
)
WHEN_S = -1.2345
#: What a round of one contender should take at most.
ROUND_S = 0.005
#: What no peer of the same subject does.
UNLIKE = re.compile("Kalman|eighth|average|median|limit|low pass")

Contenders = Mapping[str, Callable[[], Any]]


def run(*, quick: bool = False) -> Iterable[BenchRow]:
    """All rows; `quick` takes some two seconds and is rougher."""
    rounds, calls = (8, 2_000) if quick else (20, 5_000)  # short and many: some are left alone by others
    for subject, peer, target, contenders in (
        values(),
        control_between(),
        made_of(),
        samples(),
        filters(),
        trajectories(),
        laws(),
    ):
        turns = {name: _turns(call, calls) for name, call in contenders.items()}
        loops = {name: _loop(call, turns[name]) for name, call in contenders.items()}
        best = {name: s / turns[name] * 1e9 for name, s in fastest(loops, rounds=rounds).items()}
        beside = best.get(peer)
        for name, ns in best.items():
            is_ours = name != peer
            yield BenchRow(
                subject,
                name,
                ns,
                "ns",
                beside / ns if is_ours and beside is not None and not UNLIKE.search(name) else None,
                f"≤ {target:,} ns" if is_ours and target is not None else "",
                ns <= target if is_ours and target is not None else None,
            )


def _turns(call: Callable[[], Any], most: int) -> int:
    """How often to call in a round: slow ones not as often, as they need it less."""
    call()  # the first one imports and prepares
    start = perf_counter()
    for _ in range(5):
        call()
    return max(20, min(most, round(5 * ROUND_S / (perf_counter() - start))))


def _loop(call: Callable[[], Any], calls: int) -> Callable[[], None]:
    def run() -> None:
        for _ in repeat(None, calls):
            call()

    return run


def sine_state(samples: int = HISTORY, **options: Any) -> State:
    """A state with samples of a sine, the last of them now."""
    clock = RealClock()
    state = State("omega", unit="rad/s", clock=clock, history=HISTORY, **options)
    start = clock.now() - samples * PERIOD_NS
    for i in range(1, samples + 1):
        state.push(math.sin(0.03 * i), start + i * PERIOD_NS)
    return state


def values() -> tuple[str, str, int | None, Contenders]:
    """The newest value."""
    plain, aged = sine_state(), sine_state(stale_after_s=3600)
    recent = deque([(i * PERIOD_NS, math.sin(0.03 * i)) for i in range(1, HISTORY + 1)], HISTORY)
    return (
        "the newest value",
        "deque[-1][1]",
        VALUE_NS,
        {
            "deque[-1][1]": lambda: recent[-1][1],
            "omega[0]": lambda: plain[0],
            "omega[0], unknown when stale": lambda: aged[0],
        },
    )


def control_between() -> tuple[str, str, int | None, Contenders]:
    """A value between two samples."""
    linear, cubic = sine_state(), sine_state(interpolation="cubic")
    ahead = sine_state(estimator=Kalman(0.01, 1.0))
    recent = deque([(i * PERIOD_NS, math.sin(0.03 * i)) for i in range(1, HISTORY + 1)], HISTORY)

    def interpolated() -> float:
        instants, numbers = zip(*recent, strict=True)
        return float(np.interp(instants[-1] + WHEN_S * 1e9, instants, numbers))

    return (
        f"between two of {HISTORY:,} samples",
        "deque and np.interp",
        BETWEEN_NS,
        {
            "deque and np.interp": interpolated,
            "omega[-1.2345], linear": lambda: linear[WHEN_S],
            "omega[-1.2345], cubic": lambda: cubic[WHEN_S],
            "omega[0], Kalman filter": lambda: ahead[0],
        },
    )


def made_of() -> tuple[str, str, int | None, Contenders]:
    """What is computed when it is read."""
    torque, omega = sine_state(), sine_state()
    power = torque * omega
    return (
        "computed from states",
        "",
        None,
        {
            "omega.rate()[0]": lambda: omega.rate()[0],
            "power = torque * omega, power[0]": lambda: power[0],
            "power[-1.2345]": lambda: power[WHEN_S],
        },
    )


def samples() -> tuple[str, str, int | None, Contenders]:
    """Taking a sample."""
    instants = count(1 << 61, PERIOD_NS)
    plain = sine_state(samples=0)
    recent: deque[tuple[int, float]] = deque(maxlen=HISTORY)
    return (
        "a sample comes in",
        "deque.append",
        PUSH_NS,
        {
            "deque.append": lambda: recent.append((next(instants), 0.5)),
            "push": lambda: plain.push(0.5, next(instants)),
        },
    )


def filters() -> tuple[str, str, int | None, Contenders]:
    """One sample through a filter; the last row is all that a filtered state costs, beside the first push."""
    instants = count(1 << 61, PERIOD_NS)
    kinds: Mapping[str, Filter] = {
        "second order": Sos((SECTION,), 200),
        "eighth order": Sos((SECTION,) * 4, 200),
        "three moving averages": MovingAverage((10, 5, 2)),
        "median of 15": Median(15),
        "rate limit": RateLimit(1.0),
        "low pass by real time": LowPass(0.1),
        "Kalman, velocity": Kalman(0.01, 1.0),
        "Kalman, acceleration": Kalman(0.01, 1.0, "acceleration"),
    }
    contenders: dict[str, Callable[[], Any]] = {}
    signal = optional("scipy.signal")
    if signal is not None:
        rows, one, state = np.array([SECTION]), np.array([0.5]), np.zeros((1, 2))
        contenders["scipy sosfilt, second order"] = lambda: signal.sosfilt(rows, one, zi=state)
    for name, kind in kinds.items():
        contenders[name] = _step(kind.start_filter(0.5), instants)
    whole = Sos((SECTION,), 200)
    for name, uneven in (("even samples", "resample"), ("samples as they come", "accept")):
        fed = sine_state(samples=0)
        out: Any = fed.filtered(whole, uneven=uneven)  # type: ignore[arg-type]
        contenders[f"omega.filtered(second order), {name}"] = _taken(out, instants)
    return "a sample through a filter", "scipy sosfilt, second order", FILTER_NS, contenders


def trajectories() -> tuple[str, str, int | None, Contenders]:
    """A step of a motion of many joints."""
    joints = [f"J{number}" for number in range(JOINTS)]
    rows = np.sin(np.arange(3_000)[:, None] / 50 + np.arange(JOINTS))
    wave = Trajectory(joints, rows, rate_hz=50, interpolation="cubic")
    bounds = {joint: Bounds(-2, 2, 5.0, 500.0) for joint in joints}

    def moving(*, is_guarded: bool) -> Callable[[], Any]:
        player = Player("wave", wave, rate_hz=200, approach=None)
        guard = Guard(bounds, period_s=PERIOD_NS / 1e9)
        period = count(0, PERIOD_NS)

        def step() -> object:
            now = next(period)
            if now % 50_000_000_000 == 0:  # before its end: once more
                player.start(now)
            points = player.step(now)
            return guard.apply(now, points) if is_guarded else points

        return step

    return (
        f"a step of a motion of {JOINTS} joints",
        "",
        JOINTS_NS,
        {
            "Player, cubic": moving(is_guarded=False),
            "Player, cubic, and Guard": moving(is_guarded=True),
        },
    )


def laws() -> tuple[str, str, int | None, Contenders]:
    """A step of a controller of one joint, and of a state machine that changes its phase."""
    pid = PID(2.0, 1.0, 0.1, limits=(-1, 1), derivative_filter_s=0.01, setpoint=0.5)
    machine = StateMachine(
        "machine",
        rate_hz=200,
        memory={"n": 0},
        phases=[Phase("a"), Phase("b")],
        table=[Transition("a", "b", "n < 1"), Transition("b", "a", "n < 1")],
    )
    machine.start(0)
    instants = count(PERIOD_NS, PERIOD_NS)
    return (
        "a step of a controller",
        "",
        STEP_NS,
        {
            "PID with limits and filter": lambda: pid.update(0.4, 0.005),
            "StateMachine, a transition": lambda: machine.step(next(instants)),
        },
    )


def _step(step: Callable[[float, int], float], instants: count[int]) -> Callable[[], Any]:
    return lambda: step(0.5, next(instants))


def _taken(out: Any, instants: count[int]) -> Callable[[], Any]:
    own = count(1 << 61, PERIOD_NS)  # even, whatever else takes instants
    return lambda: out._take(0.5, next(own))
