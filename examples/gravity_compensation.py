"""An arm of MIT motors that carries its own weight: it is pushed with a finger and stays; then springs lead it back.

The arm is a URDF file, its motors a choice; its twins move the file's masses. Each torque comes from the file's inertias, so
that nothing has to be tuned. Somebody pushes the elbow: without springs it stays where it was led to; with springs in the
motors (stiffness and damping of MIT's law, on top of the weight) it comes back. Switched off it falls.

    python examples/gravity_compensation.py
"""

from __future__ import annotations

from collections.abc import Mapping
from math import degrees
from pathlib import Path
from typing import Any

from aces_bus.controller import controller
from aces_bus.robot import run_virtual
from aces_devices.robots import import_robot
from aces_lab.urdf import Dynamics, read_urdf, urdf_physics

BODY = str(Path(__file__).with_name("arm.urdf"))
JOINTS = ("base", "shoulder", "elbow", "forearm", "wrist", "hand")
POSE = {"shoulder": 0.6, "elbow": 0.5, "wrist": 0.4}
RATE_HZ = 200
#: The springs: N·m/rad, N·m·s/rad.
STIFFNESS, DAMPING = 8.0, 0.8
#: How hard, and how long, somebody pushes the elbow (N·m, s).
PUSH, PUSH_S = 1.0, 0.3

dynamics = Dynamics(read_urdf(BODY))


@controller(rate_hz=RATE_HZ, states=JOINTS, writes=[f"{joint}.torque" for joint in JOINTS])
def weightless(states: Mapping[str, Any]) -> dict[str, float]:
    """Carry the arm's own weight, and nothing else."""
    torques = dynamics.gravity_torques([states[joint][0] for joint in JOINTS])
    return {f"{joint}.torque": torque for joint, torque in zip(JOINTS, torques.tolist(), strict=True)}


@controller(rate_hz=RATE_HZ, writes=[f"{joint}{part}" for joint in JOINTS for part in ("", ".kp", ".kd")])
def springs(t: float, *, stiffness: float = 0.0) -> dict[str, float]:
    """Draw each joint back to the pose; without stiffness only damp it."""
    wanted = {joint: POSE.get(joint, 0.0) for joint in JOINTS}
    gains = {"kp": stiffness, "kd": DAMPING}
    return wanted | {f"{joint}.{name}": gain for joint in JOINTS for name, gain in gains.items()}


def main() -> dict[str, tuple[float, float]]:
    """Return the elbow's angle (rad) and the hand's height (m): at first, after a second, pushed, let go, led back, off."""
    robot = import_robot([BODY], device="damiao").robot
    body = urdf_physics(robot)
    found: dict[str, tuple[float, float]] = {}
    with run_virtual(robot, [weightless, springs], rate_hz=RATE_HZ, pose=POSE, physics=body) as run:

        def after(what: str, seconds: float) -> None:
            run.world.advance(seconds)
            elbow = body.positions[body.joints.index("elbow")]
            height = float(dynamics.frames(body.positions)["flange"][2, 3])
            found[what] = elbow, height
            print(f"{what}: the elbow is at {degrees(elbow):.1f}°, the hand {height:.2f} m high")

        springs.set(stiffness=0.0)
        run.do("enable")
        run.start()
        after("at first", 0.0)
        after("a second later", 1.0)
        body.push["elbow"] = PUSH
        after("pushed", PUSH_S)
        body.push["elbow"] = 0.0
        after("let go", 1.0)
        springs.set(stiffness=STIFFNESS)
        after("with springs", 2.0)
        ended = run.stop()
        run.world.simulation.open()  # the run has ended: the twins are switched off, and their body goes on
        after("switched off", 1.0)
        run.world.simulation.close()
    print(", ".join(ended.tripped.values()) or "nothing went wrong")
    return found


if __name__ == "__main__":
    main()
