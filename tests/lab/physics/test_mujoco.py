"""MuJoCo models as bodies of twins: gravity, a quadruped that walks and falls, the same each time."""

from __future__ import annotations

import math
import sys
from pathlib import Path
from typing import Any

import pytest

from aces_bus import load_robot
from aces_bus.errors import CallerError
from aces_bus.robot import VirtualRobot, parse_robot
from aces_bus.robot.physics import physics_of
from aces_tools.main import main

pytest.importorskip("mujoco", reason="needs MuJoCo: pip install 'aces-bus[physics]'")

ARM = """
name = "pendulum"
rate_hz = 50
[buses]
can = { link = "can", protocol = "odrive", bitrate = 500_000 }
[devices]
O = { driver = "odrive", bus = "can", credentials = { node = 3 } }
[joints]
J = { device = "O", lower = -3, upper = 3, max_speed = 5 }
"""
#: A rod of 0.5 m that lies flat: 0.5 kg hold 1.23 N·m. A second joint moves freely.
MODEL = """
<mujoco>
  <worldbody>
    <body name="rod">
      <joint name="J" axis="0 -1 0"/>
      <geom type="capsule" fromto="0 0 0 0.5 0 0" size="0.01" mass="0.5"/>
      <body name="loose" pos="0.5 0 0"><joint name="other"/><geom size="0.01" mass="0.01"/></body>
    </body>
  </worldbody>
</mujoco>
"""


@pytest.fixture
def model(tmp_path: Path) -> Path:
    path = tmp_path / "rod.xml"
    path.write_text(MODEL)
    return path


def rod(model: Path, **more: Any) -> tuple[VirtualRobot, Any]:
    robot, problems = parse_robot(ARM)
    assert robot is not None, problems
    body: Any = physics_of(f"mujoco:{model}", robot)
    return VirtualRobot(robot, physics=body, **more), body


def test_gravity_is_held_and_felt_and_falls_when_switched_off(model: Path) -> None:
    """Enabled, the drive holds the rod with its weight's torque; disabled, the rod falls."""
    robot, body = rod(model)
    with robot:
        assert body.joints == ["J"]
        robot.rig.each("enable").wait(5)
        robot.advance(1.0)
        held = robot["J.position"].last
        assert held == pytest.approx(body.positions[0], abs=1e-3)
        robot.advance(0.5)
        assert robot["J.position"].last == pytest.approx(held, abs=1e-3)
        assert robot.twins["O"].motor.torque == pytest.approx(1.28 * math.cos(held), rel=0.1)
        robot.rig.stop_motion().wait(5)
        robot.advance(0.5)
        assert robot["J.position"].last < held - 0.5


def test_the_same_run_twice(model: Path) -> None:
    """Bit by bit the same, with contacts, too."""
    ends: list[Any] = []
    for _ in range(2):
        robot, body = rod(model, pose={"J": 0.4})
        with robot:
            robot.advance(0.7)
            ends.append((body.positions, body.velocities, robot.clock.now()))
    assert ends[0] == ends[1]


def test_what_the_model_says_of_a_joint_stands(tmp_path: Path) -> None:
    """An armature and a friction of the model are kept; else they are the motor's."""
    path = tmp_path / "rod.xml"
    path.write_text(MODEL.replace('name="J"', 'name="J" armature="0.5" frictionloss="0.25"'))
    _, said = rod(path)
    assert (said.model.dof_armature[0], said.model.dof_frictionloss[0]) == (0.5, 0.25)
    path.write_text(MODEL)
    robot, found = rod(path)
    motor = robot.twins["O"].motor.motor
    assert found.model.dof_armature[0] == pytest.approx(motor.inertia)
    assert found.model.dof_frictionloss[0] == pytest.approx(motor.friction * motor.stall_torque)


def test_what_cannot_be_simulated_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No file, no model that ships, XML that MuJoCo does not read, none of the robot's joints, no MuJoCo, no renderer."""
    robot, _ = parse_robot(ARM)
    assert robot is not None
    with pytest.raises(CallerError, match="no such file"):
        physics_of("mujoco:nowhere.xml", robot)
    with pytest.raises(CallerError, match=r"no MuJoCo model ships for pendulum.*quadruped"):
        physics_of("mujoco", robot)
    path = tmp_path / "bad.xml"
    path.write_text("<mujoco><nothing/></mujoco>")
    with pytest.raises(CallerError, match="MuJoCo cannot read it"):
        physics_of(f"mujoco:{path}", robot)
    path.write_text(MODEL.replace('"J"', '"K"'))
    with pytest.raises(CallerError, match="none of the joints of pendulum"):
        physics_of(f"mujoco:{path}", robot)
    monkeypatch.setitem(sys.modules, "mujoco", None)
    path.write_text(MODEL)
    with pytest.raises(CallerError, match=r"aces-bus\[physics\]"):
        physics_of(f"mujoco:{path}", robot)


def test_the_command_line_takes_it(model: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """`aces run --virtual --physics`; without `--virtual` it is refused."""
    robot = tmp_path / "pendulum.toml"
    robot.write_text(ARM)
    log = tmp_path / "log.csv"
    call = [
        "run",
        "-r",
        str(robot),
        "--log",
        f"{log}:J.position",
        "--for",
        "1s",
        "--physics",
        f"mujoco:{model}",
    ]
    assert main([*call, "--virtual", "--no-enable"]) == 0
    assert float(log.read_text().splitlines()[-1].split(",")[-1]) < -0.5  # it fell
    assert main(call) == 2
    assert "--physics is for twins" in capsys.readouterr().err


def test_the_quadruped_touches_the_ground() -> None:
    """Four feet carry its weight; where its trunk is can be asked."""
    robot = load_robot("quadruped")
    body: Any = physics_of("mujoco", robot)
    assert set(body.joints) == set(robot.joints)
    for _ in range(300):
        body.step([0.0] * len(body.joints))
    assert body.pose_of("trunk")[0][2] < 0.42  # it sinks: nothing is driven
    assert {contact.parts[0] for contact in body.contacts} == {"world"}
    with pytest.raises(CallerError, match="no body 'head'"):
        body.pose_of("head")
