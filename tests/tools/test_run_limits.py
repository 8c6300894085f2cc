"""`aces run`: what is said of set-points that limits have changed."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.tools.conftest import Aces
from tests.tools.test_run import FANS


@pytest.mark.parametrize("is_often", [True, False])
def test_joints_that_are_led_by_their_limits_are_named(aces: Aces, tmp_path: Path, is_often: bool) -> None:
    """The end says whose set-points were changed again and again, how often and by which limit; not a clip now and then."""
    since, knee = (0.5, "0.5 * (t * 50 % 2 // 1)") if is_often else (0.95, "0.0")
    fast = tmp_path / "fast.py"
    fast.write_text(
        "from aces_bus.controller import controller\n\n"
        '@controller(rate_hz=100, writes=["RHP", "RKP"])\n'
        "def fast(t):\n"
        f'    return {{"RHP": 9.0 * (t > {since}), "RKP": {knee}}}\n'
    )
    robot = tmp_path / "boards.toml"
    robot.write_text(FANS.replace("max_speed = 7.0\naliases", "aliases"))
    result = aces("run", "-r", robot, fast, "--virtual", "--for", "1s")
    assert result.summary["clipped"] > 0
    said = [one for one in result.messages if "clipped again" in one]
    assert len(said) == is_often
    assert not is_often or re.search(
        r"RKP \d+ times in 101 cycles \(at most 1 rad/s, as its file states no max_speed\)"
        r".* RHP \d+ times in 101 cycles \(limits -1\.57 … 1\.57 rad\)",
        said[0],
    )
