"""A quadruped with weight: it stands, trots forward, and falls when it is switched off; its body is a MuJoCo model.

The same robot file and the same controllers as without a body: the twins' motors pull, MuJoCo says where the joints go.

    python examples/quadruped_walk.py [SECONDS] [PICTURE.png]
    aces run -r quadruped examples/quadruped_walk.py --virtual --physics mujoco --for 5s
"""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping
from math import acos, atan2, cos, hypot, pi, sin
from typing import Any

from aces_bus import load_robot
from aces_bus.controller import controller
from aces_bus.device import Robot
from aces_bus.errors import CallerError
from aces_bus.robot import run_virtual
from aces_lab.gym import Sticks
from aces_lab.physics import MujocoBody, mujoco_body
from aces_lab.urdf import model_of_robot

LEGS = ("LF", "RF", "LH", "RH")
JOINTS = [f"{leg}_{part}" for leg in LEGS for part in ("HAA", "HFE", "KFE")]
#: Each link of a leg (m); how high it stands, how far a foot is lifted, how long a step is.
LINK, HEIGHT, LIFT, STRIDE = 0.2, 0.32, 0.05, 0.06
#: Until it stands, then stands still; a step (s).
RISE_S, STAND_S, STEP_S = 1.0, 1.5, 0.16


def leg_angles(x: float, height: float) -> tuple[float, float]:
    """Return hip and knee (rad) of a foot that is `x` before its hip and `height` below it (m).

    >>> [round(angle, 3) for angle in leg_angles(0.0, 2 * LINK)]
    [0.0, 0.0]
    """
    half = acos(min(1.0, hypot(x, height) / (2 * LINK)))
    return atan2(x, height) + half, -2 * half


def foot(leg: str, t: float) -> tuple[float, float]:
    """Return where a foot is before and below its hip (m): diagonal legs swing together, in turn."""
    if t < STAND_S:
        share = 0.5 - 0.5 * cos(pi * min(t, RISE_S) / RISE_S)
        return 0.0, 2 * LINK + (HEIGHT - 2 * LINK) * share
    begun = t - STAND_S
    phase = (begun / STEP_S + (leg in ("RF", "LH"))) % 2
    stride = STRIDE * min(1.0, begun / 1.0)
    if phase < 1:  # swings forward
        return stride * (phase - 0.5), HEIGHT - LIFT * sin(pi * phase)
    return stride * (1.5 - phase), HEIGHT


@controller(rate_hz=500, writes=JOINTS)
def walk(t: float) -> Mapping[str, float]:
    """Angles of all joints."""
    wanted: dict[str, float] = {}
    for leg in LEGS:
        for part, angle in zip(("HAA", "HFE", "KFE"), (0.0, *leg_angles(*foot(leg, t))), strict=True):
            wanted[f"{leg}_{part}"] = angle
    return wanted


def main(seconds: float = 5.0, picture: str = "") -> dict[str, Any]:
    """Return where the trunk was (m): standing, after the walk, after the fall; the real-time factor; what tripped."""
    robot = load_robot("quadruped")
    body = mujoco_body(robot, "")
    heights: dict[str, Any] = {}
    with run_virtual(robot, [walk], physics=body) as run:
        run.do("enable")
        run.start()
        spent = time.process_time()
        run.world.advance(STAND_S)
        heights["standing"] = body.pose_of("trunk")[0].tolist()
        run.world.advance(seconds - STAND_S)
        heights["ratio"] = seconds / (time.process_time() - spent)
        heights["walked"] = body.pose_of("trunk")[0].tolist()
        heights["upright"] = float(body.pose_of("trunk")[1][2, 2])
        if picture:
            save(picture, pixels_of(robot, body))
        heights["tripped"] = dict(run.stop().tripped)
        run.world.simulation.open()  # the run has ended: the twins are switched off, and their body goes on
        run.world.advance(2.0)
        heights["fallen"] = body.pose_of("trunk")[0].tolist()
        run.world.simulation.close()
    for name in ("standing", "walked", "fallen"):
        x, _, z = heights[name]
        print(f"{name}: trunk {x:+.3f} m along, {z:.3f} m high")
    print(
        f"{heights['ratio']:.2f} × real time; {', '.join(heights['tripped'].values()) or 'nothing went wrong'}"
    )
    return heights


def pixels_of(robot: Robot, body: MujocoBody) -> Any:
    """Return what MuJoCo sees; where it finds no renderer, sticks of its joints' angles."""
    try:
        return body.picture(960, 640, "side")
    except CallerError:
        return Sticks(model_of_robot(robot), (960, 640)).picture(
            dict(zip(body.joints, body.positions, strict=True))
        )


def save(path: str, image: Any) -> None:
    """Write an image as a file (matplotlib)."""
    from matplotlib.image import imsave

    imsave(path, image)


if __name__ == "__main__":
    main(float(sys.argv[1]) if len(sys.argv) > 1 else 5.0, sys.argv[2] if len(sys.argv) > 2 else "")
