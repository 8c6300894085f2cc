"""Examples in the pages of devices: each robot's file, saved as it stands, is one, and runs with its twins."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest

from aces_bus.robot import VirtualRobot
from aces_bus.robot.installed import check_robot

#: What the pages call the vendor's file, for which ours stands in.
EDS = {"cia401": "module.eds", "cia402": "drive.eds"}
ROOT = Path(__file__).resolve().parents[2]
BLOCKS = [
    pytest.param(page.parent, text, id=f"{page.parent.name}-{number}")
    for page in sorted(ROOT.glob("devices/aces_devices/*/README.md"))
    for number, text in enumerate(
        re.findall(r"```toml\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)
    )
]


@pytest.mark.parametrize(("device", "text"), BLOCKS)
def test_a_robot_of_a_device_s_page_runs(device: Path, text: str, tmp_path: Path) -> None:
    """Saved under a name of its own, it is a robot of that name, without a fault, and its twins answer."""
    (tmp_path / "mine.toml").write_text(text, encoding="utf-8")
    if device.name in EDS:
        shutil.copy(device / EDS[device.name], tmp_path / "maker.eds")
    robot, problems = check_robot(tmp_path / "mine.toml")
    assert robot is not None, problems
    assert robot.name == "mine"
    assert not problems
    with VirtualRobot(robot) as running:
        running.advance(0.5)
        assert running.devices
