"""MiniHubo's chains against the reference vectors and the walking patterns."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from aces_bus import load_robot
from aces_bus.errors import CallerError
from aces_devices.kinematics.minihubo import (
    JOINTS,
    MINIHUBO,
    minihubo,
    mirrored,
    read_walk,
    walk_columns,
)
from aces_lab.cartesian import Goal, solve

TIPS = ("LF", "RF", "LW", "RW")


@pytest.fixture(scope="module")
def vectors(shared_captures: Path) -> Any:
    """The reference vectors, mm and rad."""
    return json.loads((shared_captures / "ik" / "minihubo_fk_ik_vectors.json").read_text(encoding="utf-8"))


def outputs(angles: Any) -> Any:
    """The 18 numbers of the reference: four positions in mm, and three terms of each sole's rotation."""
    poses = MINIHUBO.forward(angles)
    numbers = [1000 * x for tip in TIPS for x in poses[tip].position.tolist()]
    for tip in ("LF", "RF"):
        r = poses[tip].rotation
        numbers += [r[2, 0], r[2, 1], r[1, 0]]
    return np.array(numbers)


@pytest.mark.parametrize(
    ("angles", "foot", "wrist"),
    [
        ({}, (0, 0.0379, -0.25439), (0, 0.0865, -0.02)),
        (
            {"HP": 0.5, "KP": 1, "AP": 0.5, "EP": 0.8, "SR": 0.2},
            (0.000149, 0.0379, -0.253018),
            (0.035868, 0.115135, -0.001962),
        ),
    ],
)
def test_feet_and_wrists_are_where_the_facts_say(
    angles: dict[str, float], foot: tuple[float, ...], wrist: tuple[float, ...]
) -> None:
    """The two poses that the source's description gives, to a micrometre, on both sides."""
    poses = MINIHUBO.forward({joint: angles.get(joint[1:], 0.0) for joint in JOINTS})
    for side, s in (("L", 1), ("R", -1)):
        assert np.allclose(poses[f"{side}F"].position, np.array(foot) * (1, s, 1), atol=1e-6)
        assert np.allclose(poses[f"{side}W"].position, np.array(wrist) * (1, s, 1), atol=1e-6)


@pytest.mark.shared
def test_forward_kinematics_equals_the_vectors(vectors: Any) -> None:
    """All twelve poses, to 1e-6 (mm, and terms of rotation matrices)."""
    assert len(vectors["fk"]) == 12
    for case in vectors["fk"]:
        assert np.abs(outputs(case["q"]) - np.array(case["out"])).max() < 1e-6


@pytest.mark.slow
@pytest.mark.shared
def test_inverse_kinematics_solves_what_can_be_solved(vectors: Any) -> None:
    """By residual: where the original converged, so do we, soles level and straight; elsewhere the error is told truly."""
    solved = 0
    for case in vectors["ik"]:
        goal = np.array(case["goal"]).reshape(4, 3) / 1000
        goals = [Goal(tip, goal[i], np.eye(3) if tip[1] == "F" else None) for i, tip in enumerate(TIPS)]
        found = solve(MINIHUBO, goals, case["initial"])
        residual = outputs(found.vector) - np.array([*case["goal"], *[0.0] * 6])
        if case["solved"]:
            assert found.converged
            assert np.abs(residual).max() < 5e-4
            solved += 1
        elif not found.converged:
            largest = np.linalg.norm(residual[:12].reshape(4, 3), axis=1).max() / 1000
            assert largest == pytest.approx(found.position_error)
            assert found.reason
    assert solved == 6


@pytest.mark.shared
@pytest.mark.parametrize(("name", "rows"), [("02_50_HA13", 1311), ("test9", 861)])
def test_soles_are_level_in_every_row_of_a_walk(shared_captures: Path, name: str, rows: int) -> None:
    """Column order and signs are right: soles level and straight to 1e-5 in every row, feet as high as is known."""
    walk = read_walk(shared_captures / "walk22" / f"{name}.txt")
    known = json.loads((shared_captures / "expected.json").read_text(encoding="utf-8"))
    known = known[f"walk22/{name}.txt"]["minihubo_fk"]
    tips = MINIHUBO.forward_many(walk.rows)
    assert len(walk) == rows
    for tip in ("LF", "RF"):
        rotation = tips[tip][1]
        assert max(np.abs(rotation[:, r, c]).max() for r, c in ((2, 0), (2, 1), (1, 0))) < 1e-5
    low = np.concatenate([tips[tip][0].min(axis=0) for tip in TIPS]) * 1000
    high = np.concatenate([tips[tip][0].max(axis=0) for tip in TIPS]) * 1000
    assert np.allclose(low, known["output_min"], atol=1e-3)
    assert np.allclose(high, known["output_max"], atol=1e-3)


@pytest.mark.shared
def test_the_hand_made_trajectory_is_level_where_it_is_known_to_be(shared_captures: Path) -> None:
    """IKscript1 has 308 rows with level soles (1e-4): no more, no fewer."""
    tips = MINIHUBO.forward_many(read_walk(shared_captures / "walk21" / "IKscript1.txt").rows)
    terms = [tips[tip][1][:, r, c] for tip in ("LF", "RF") for r, c in ((2, 0), (2, 1), (1, 0))]
    assert int((np.abs(terms).max(axis=0) < 1e-4).sum()) == 308


@pytest.mark.shared
def test_a_mirrored_walk_has_mirrored_feet(shared_captures: Path) -> None:
    """Left and right exchanged in the joints is y turned round at the tips."""
    walk = read_walk(shared_captures / "walk22" / "test9.txt")
    other = mirrored(walk).only(JOINTS)
    here, there = MINIHUBO.forward_many(walk.rows), MINIHUBO.forward_many(other.rows)
    for tip, pair in (("LF", "RF"), ("LW", "RW")):
        assert np.allclose(here[tip][0] * (1, -1, 1), there[pair][0], atol=1e-12)
    assert np.allclose(mirrored(other).only(JOINTS).rows, walk.rows)


def test_a_knee_with_limits_bends_forwards() -> None:
    """From straight legs, with knees that bend one way, a raised foot is reached and the sole is level."""
    body = minihubo({f"{side}KP": (0.0, 2.6) for side in "LR"})
    goals = [Goal("LF", [0.0, 0.0379, -0.2244], level=True), Goal("RF", [0.0, -0.0379, -0.2344], level=True)]
    found = solve(body, goals, dict.fromkeys(JOINTS, 0.0))
    assert found.converged, found
    assert found.angles["LKP"] > 0.9
    assert found.angles["RKP"] > 0.5


def test_joints_are_the_robots() -> None:
    """Every joint of the chains is a joint of the robot file, by its own name."""
    assert set(JOINTS) == set(load_robot("minihubo_1").joints)
    assert MINIHUBO.joints == JOINTS


def test_columns_of_patterns() -> None:
    """13, 21 and 22 columns are known, and nothing else is guessed."""
    assert walk_columns(22)[-1] == ""
    assert list(walk_columns(13)) == list(JOINTS[:13])
    with pytest.raises(CallerError, match="13, 21 or 22"):
        walk_columns(20)
