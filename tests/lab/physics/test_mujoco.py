"""MuJoCo models as bodies of twins: gravity, a quadruped that walks and falls, the same each time."""

from __future__ import annotations

import math
import sys
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace

from aces_bus import load_robot
from aces_bus.device.physics import MovedBody
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


#: An attitude board and four boards of force on a bus of their own, on the quadruped.
SENSORS = """
[buses]
sensors = { link = "can", protocol = "hubo", dialect = "D12" }
[devices]
IMU = { driver = "hubo_imu", bus = "sensors", credentials = { board = 0x32, sensor = 3 }, kind = "imu" }
FT_1 = { driver = "hubo_ft", bus = "sensors", credentials = { board = 0x30, sensor = 1 }, kind = "foot" }
FT_2 = { driver = "hubo_ft", bus = "sensors", credentials = { board = 0x31, sensor = 2 }, kind = "foot" }
FT_5 = { driver = "hubo_ft", bus = "sensors", credentials = { board = 0x35, sensor = 6 }, kind = "ft" }
FT_6 = { driver = "hubo_ft", bus = "sensors", credentials = { board = 0x36, sensor = 7 }, kind = "ft" }
[sensors]
imu = { kind = "imu", device = "IMU" }
LF_foot = { kind = "force_torque", device = "FT_1" }
RF_foot = { kind = "force_torque", device = "FT_2" }
LH_foot = { kind = "force_torque", device = "FT_5" }
RH_foot = { kind = "force_torque", device = "FT_6" }
TILT = { kind = "tilt", device = "FT_1" }
"""


def sensing(**more: Any) -> tuple[VirtualRobot, Any]:
    """The quadruped with boards that feel its body."""
    extra, problems = parse_robot('name = "s"\nrate_hz = 100\n' + SENSORS)
    assert extra is not None, problems
    quadruped = load_robot("quadruped")
    robot = replace(
        quadruped,
        buses={**quadruped.buses, **extra.buses},
        devices={**quadruped.devices, **extra.devices},
        sensors=extra.sensors,
    )
    body: Any = physics_of("mujoco", robot)
    return VirtualRobot(robot, physics=body, **more), body


@pytest.mark.slow
def test_boards_feel_the_body() -> None:
    """Standing, the feet carry the weight but that of the shanks beyond the knees; the attitude is the trunk's."""
    robot, body = sensing()
    feet = ("LF_foot", "RF_foot", "LH_foot", "RH_foot")
    with robot:
        robot.rig.each("enable").wait(5)
        for name in robot.rig.robot.joints:
            robot[f"{name}.position"].set(robot[f"{name}.position"].last)
        robot.advance(2.0)
        weight = 9.81 * (
            body.model.body_mass.sum() - sum(body.model.body(f"{foot[:2]}_shank").mass[0] for foot in feet)
        )
        assert sum(contact.force for contact in body.contacts) > 0.9 * weight
        along = sum(robot[f"{foot}.fz"].last * body.data.site(foot).xmat[8] for foot in feet)
        assert along == pytest.approx(weight, rel=0.15)
        for leg in ("LF", "RF"):  # it kneels down in front
            robot[f"{leg}_HFE.position"].set(robot[f"{leg}_HFE.position"].last + 0.5)
            robot[f"{leg}_KFE.position"].set(robot[f"{leg}_KFE.position"].last - 1.0)
        robot.advance(0.02)
        rates: list[float] = []
        for place in range(100):
            robot.advance(0.01)
            turned = body.pose_of("trunk")[1]
            assert robot["imu.pitch"].last == pytest.approx(math.asin(-turned[2, 0]), abs=0.03), place
            rates.append(robot["imu.pitch_rate"].last)
        assert robot["imu.pitch"].last > 0.05
        assert sum(rates) / 100 == pytest.approx(robot["imu.pitch"].last, abs=0.03)
        robot.rig.stop_motion().wait(5)
        robot.advance(0.12)
        assert max(abs(robot[f"{foot}.fz"].last) for foot in feet) < 0.5 * weight


def test_a_part_is_measured_as_physics_has_it(tmp_path: Path) -> None:
    """A rod that is held feels its weight and 1 g upwards; one that falls freely feels nothing."""
    path = tmp_path / "rod.xml"
    path.write_text(
        MODEL.replace('<body name="rod">', '<body name="rod"><site name="end" pos="0.5 0 0" euler="0 90 0"/>')
    )
    _, body = rod(path)
    body.model.dof_damping[0] = 1e6  # it is held
    for _ in range(50):
        body.step([0.0])
    felt, now = MovedBody(body, 0), 0
    motion, wrench = felt.motion_of("rod", now), felt.wrench_on("rod", now)
    assert motion is not None
    assert wrench is not None
    assert motion.acceleration == pytest.approx((0, 0, 9.81), abs=0.01)
    assert wrench.force == pytest.approx((0, 0, -0.51 * 9.81), abs=0.01)
    assert wrench.torque == pytest.approx((0, 9.81 * (0.5 * 0.25 + 0.01 * 0.5), 0), abs=0.01)
    turned = felt.motion_of("end", now)
    assert turned is not None
    assert (turned.pitch, turned.acceleration[0]) == pytest.approx((math.pi / 2, -9.81), abs=0.01)
    assert body.wrench_on("end")[0] == pytest.approx((0.51 * 9.81, 0, 0), abs=0.01)
    assert felt.motion_of("nothing", now) is None
    assert felt.wrench_on("nothing", now) is None


@pytest.mark.slow
def test_who_asks_changes_nothing() -> None:
    """A run with sensors that are read is the same, bit by bit, as one whose body is never asked."""
    ends: list[Any] = []
    for asks in (False, True):
        robot, body = sensing()
        with robot:
            for _ in range(20):
                robot.advance(0.01)
                if asks:
                    body.motion_of("imu")
                    body.wrench_on("LF_foot")
            ends.append((body.positions, body.velocities))
    assert ends[0] == ends[1]
