"""Players: from wherever the joints are, at any rate, without a jump."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from aces_bus.controller import ControlEvent, Limits, Player, Trajectory, ViaPath
from aces_bus.errors import CallerError, UnknownNameError
from aces_devices.kinematics.minihubo import read_walk
from tests.controller.fakes import fakes

MS = 1_000_000
RAMP = Trajectory(["A", "B"], [[0.0, 1.0], [0.1, 1.2], [0.2, 1.4], [0.3, 1.6]], rate_hz=10)


def play(player: Player, steps: int, start: int = 0, period_ms: int = 50) -> list[float]:
    """The set-points of A, step by step."""
    return [round(player.step((start + n) * period_ms * MS).get("A", np.nan), 9) for n in range(steps)]


def test_it_plays_once_and_stays() -> None:
    """Every row at its time, rows between interpolated, the last row for ever after."""
    player = Player("p", RAMP, rate_hz=20, approach=None)
    player.start(0)
    assert play(player, 8) == [0.0, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.3]
    assert (player.mode, player.progress, player.rounds_done) == ("ended", 1.0, 1)
    assert player.step(10**9) == {"A": 0.3, "B": 1.6}


@pytest.mark.shared
@pytest.mark.parametrize("name", ["02_50_HA13", "test9"])
def test_a_walk_at_its_own_rate_is_its_rows(shared_captures: Path, name: str) -> None:
    """At 50 Hz each step gives a row, to the last bit; at 200 Hz every fourth one does."""
    walk = read_walk(shared_captures / "walk22" / f"{name}.txt")
    setpoints: Mapping[str, float] = {}
    for rate in (50, 200):
        player = Player("walk", walk, rate_hz=rate, approach=None)
        player.start(7)
        every = rate // 50
        for n, row in enumerate(walk.rows):
            for k in range(every):
                setpoints = player.step(7 + (n * every + k) * 1_000_000_000 // rate)
                if k == 0:
                    assert list(setpoints.values()) == row.tolist()
    assert tuple(setpoints) == walk.names


def test_it_goes_to_the_first_row_before_it_plays() -> None:
    """From where the states are, gently, then the rows from the first on; no step is larger than the limits allow."""
    states = fakes(A=1.0, B=0.0)
    player = Player("p", RAMP, rate_hz=20, gentle=Limits(0.5, 2.0))
    assert player.states == ("A", "B")
    player.bind(states)
    player.start(0)
    values = play(player, 90)
    assert values[0] == 1.0
    assert player.mode == "ended"
    steps = np.abs(np.diff(values)) / 0.05
    arrived = values.index(0.0)
    assert steps[:arrived].max() <= 0.5
    assert np.abs(np.diff(values[:arrived], 2)).max() / 0.05**2 <= 2.0
    # 1 rad at 0.5 rad/s takes 3.75 s: the cycle at 3.75 s is the first row.
    assert arrived == 75
    assert values[75:82] == [0.0, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3]


def test_blending_plays_at_once_and_fades_the_offset() -> None:
    """The first set-point is the present position, the last the trajectory's."""
    player = Player("p", RAMP, rate_hz=20, approach="blend", gentle=Limits(10.0, 1e3))
    player.bind(fakes(A=0.5, B=1.0))
    player.start(0)
    values = play(player, 8)
    assert values[0] == 0.5
    assert values[1] < 0.5
    assert values[2:] == [0.1, 0.15, 0.2, 0.25, 0.3, 0.3]


def test_unknown_positions_are_waited_for_and_then_refused() -> None:
    """Nothing is given while one is unknown; after `patience_s` it fails, and says for whom."""
    heard: list[ControlEvent] = []
    states = fakes(A=float("nan"), B=1.0)
    player = Player("p", RAMP, rate_hz=20, patience_s=0.2)
    player.listeners.add(heard.append)
    player.bind(states)
    player.start(0)
    assert player.step(0) == {}
    assert str(player.mode) == "waiting"
    states["A"].value = 0.0
    assert player.step(50 * MS) == {"A": 0.0, "B": 1.0}
    states["A"].value = float("nan")
    player.start(0)
    assert [player.step(n * 50 * MS) for n in range(7)] == [{}] * 7
    assert player.mode == "failed"
    assert player.reason == "the present position of A is unknown"
    assert [event.kind for event in heard] == ["failed"]


def test_halt_and_run_ramp_the_speed() -> None:
    """Halting takes `halt_s` and half of that way; going on does the same; no row is skipped."""
    long = Trajectory(["A"], [[0.01 * n] for n in range(101)], rate_hz=10)
    player = Player("p", long, rate_hz=20, approach=None, halt_s=0.2)
    player.start(0)
    play(player, 10)
    player.halt()
    values = play(player, 10, 10)
    assert str(player.mode) == "halted"
    assert values[-1] == pytest.approx(0.045 + 0.1 * 0.1)
    assert values[-1] == values[-2]
    player.run()
    values = [values[-1], *play(player, 20, 20)]
    assert player.mode == "running"
    steps = np.diff(values)
    assert steps.min() >= 0
    assert steps.max() == pytest.approx(0.005)
    assert np.diff(steps).max() <= 0.0013


def test_advance_plays_rows() -> None:
    """The original's step: one row, then halt; the first is the first row; at the end it stays."""
    player = Player("p", RAMP, rate_hz=20, approach=None, autorun=False)
    player.start(0)
    assert player.step(0) == {}
    seen: list[float] = []
    for n in range(1, 6):
        player.advance()
        seen += play(player, 3, n * 10)
    assert seen == [0.0] * 3 + [0.1] * 3 + [0.2] * 3 + [0.3] * 6
    player.start(0)
    player.advance(3)
    assert play(player, 5) == [0.0, 0.1, 0.2, 0.2, 0.2]
    with pytest.raises(CallerError, match="rows = 0"):
        player.advance(0)


def test_open_takes_another_motion(tmp_path: Path) -> None:
    """A table or a file; it begins halted, at its beginning."""
    path = tmp_path / "other_10hz.txt"
    path.write_text("C\n5\n6\n")
    player = Player("p", RAMP, rate_hz=10, approach=None)
    player.start(0)
    play(player, 2)
    player.open(path)
    assert (player.mode, player.names, player.step(0)) == ("halted", ("C",), {})
    player.run()
    assert [dict(player.step(n * 100 * MS)) for n in range(2)] == [{"C": 5.0}, {"C": 6.0}]
    other = Player("q", RAMP, rate_hz=10)
    other.bind(fakes(A=0.0, B=0.0, C=1.0))
    other.open(path)
    assert other.states == ("C",)
    other.bind(fakes(C=1.0))
    with pytest.raises(UnknownNameError, match="there are: C"):
        other.open(RAMP)


def test_rounds_approach_the_beginning_again() -> None:
    """Twice: at the end it goes back to the first row gently, and plays once more."""
    player = Player("p", RAMP, rate_hz=20, approach="first", rounds=2, gentle=Limits(1.0, 100.0))
    player.bind(fakes(A=0.0, B=1.0))
    player.start(0)
    values = play(player, 60)
    assert (player.mode, player.rounds_done) == ("ended", 2)
    assert values.count(0.3) >= 2
    assert np.abs(np.diff(values)).max() <= 0.0501
    assert values[-1] == 0.3


def test_when_time_jumps_it_goes_on_from_where_it_was() -> None:
    """A second forwards or back in one cycle leaves out no row, and is counted and told; 200 ms are a late cycle."""
    heard: list[str] = []
    long = Trajectory(["A"], [[0.01 * n] for n in range(101)], rate_hz=10)
    player = Player("p", long, rate_hz=10, approach=None)
    player.listeners.add(lambda event: heard.append(event.kind))
    player.start(0)
    instants = [0, 100, 300, 1_300, 1_400, 400, 500]
    assert [round(player.step(ms * MS)["A"], 9) for ms in instants] == [
        0.0,
        0.01,
        0.03,
        0.04,
        0.05,
        0.06,
        0.07,
    ]
    assert (player.gaps, heard) == (2, ["late", "late"])


def test_names_and_rows_may_be_changed_on_the_way() -> None:
    """`rename` maps to states; the hook sees each row's set-points and may change, replace or add."""
    seen: list[dict[str, float]] = []

    def hook(setpoints: dict[str, float]) -> Mapping[str, float] | None:
        seen.append(dict(setpoints))
        setpoints["X"] += 10
        return {"Y": 1.0} if len(seen) == 2 else None

    player = Player("p", RAMP, rate_hz=10, approach=None, rename={"A": "X"}, hook=hook)
    assert player.writes == ("X", "B")
    player.start(0)
    assert player.step(0) == {"X": 10.0, "B": 1.0}
    assert player.step(100 * MS) == {"Y": 1.0}
    assert seen[1] == {"X": 0.1, "B": 1.2}
    with pytest.raises(CallerError, match="B would be set twice"):
        Player("p", RAMP, rate_hz=10, rename={"A": "B"})


def test_speed_and_via_paths() -> None:
    """Half speed takes twice the time; a via path is a motion like any other."""
    player = Player("p", RAMP, rate_hz=20, approach=None, speed=0.5)
    player.start(0)
    assert play(player, 5) == [0.0, 0.025, 0.05, 0.075, 0.1]
    path = ViaPath(["A"], [[0.0], [1.0]], Limits(1.0, 2.0))
    player = Player("p", path, rate_hz=20, approach=None)
    player.start(0)
    values = play(player, 32)
    assert (values[0], values[15], values[-1], player.mode) == (0.0, 0.5, 1.0, "ended")


def test_degrees_taken_for_radians_are_refused() -> None:
    """94 rad is not a joint angle; who means it says so."""
    wave = Trajectory(["A"], [[0.0], [94.0]], rate_hz=10)
    with pytest.raises(CallerError, match="unit='deg'"):
        Player("p", wave, rate_hz=10)
    assert Player("p", wave, rate_hz=10, largest=100).names == ("A",)


@pytest.mark.parametrize("options", [{"speed": 0.0}, {"approach": "jump"}, {"rounds": 0}, {"rate_hz": 0}])
def test_wrong_options_are_refused(options: dict[str, float]) -> None:
    """Each with its name."""
    with pytest.raises(CallerError, match=next(iter(options))):
        Player("p", RAMP, **{"rate_hz": 10, **options})  # type: ignore[arg-type]


commands = st.lists(st.sampled_from(["run", "halt", "advance", "wait", "long"]), max_size=15)


@given(commands, st.floats(-1, 1), st.sampled_from(["first", "blend"]))
def test_whatever_is_commanded_nothing_jumps(what: list[str], start: float, approach: str) -> None:
    """Run, halt and step in any order: from cycle to cycle no more than the fastest of motion and approach."""
    wave = Trajectory(["A"], [[0.5 * np.sin(n / 5)] for n in range(50)], rate_hz=10)
    player = Player("p", wave, rate_hz=20, approach=approach)  # type: ignore[arg-type]
    player.bind(fakes(A=start))
    player.start(0)
    last, now = start, 0
    for command in what:
        if command in ("run", "halt", "advance"):
            getattr(player, command)()
        for _ in range(40 if command == "long" else 2):
            now += 50 * MS
            value = player.step(now).get("A", last)
            assert abs(value - last) <= 0.1 + 0.06  # a whole row in `advance`, and a blend on top
            last = value
