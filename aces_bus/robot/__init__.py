"""Floors put together: a robot's file becomes hosts, twins, states and controllers, in virtual time or on real buses."""

from __future__ import annotations

from typing import TYPE_CHECKING

from .._lazy import lazy_names

if TYPE_CHECKING:
    from .buses import gate_of, open_gates, port_for
    from .ending import Ended
    from .file import is_robot, make_robot, parse_robot
    from .installed import check_robot, is_robot_path, list_robots, load_robot, robot_text
    from .problem import RobotError, RobotFileProblem
    from .replay import Replay
    from .rig import Rig, Simulation, connect, simulate
    from .runner import Runner
    from .states import States
    from .text import print_robot
    from .virtual import VirtualRobot, wire_of
    from .worlds import run_real, run_replay, run_virtual

__all__ = [
    "Ended",
    "Replay",
    "Rig",
    "RobotError",
    "RobotFileProblem",
    "Runner",
    "Simulation",
    "States",
    "VirtualRobot",
    "check_robot",
    "connect",
    "gate_of",
    "is_robot",
    "is_robot_path",
    "list_robots",
    "load_robot",
    "make_robot",
    "open_gates",
    "parse_robot",
    "port_for",
    "print_robot",
    "robot_text",
    "run_real",
    "run_replay",
    "run_virtual",
    "simulate",
    "wire_of",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        ".buses": "gate_of open_gates port_for",
        ".ending": "Ended",
        ".file": "is_robot make_robot parse_robot",
        ".installed": "check_robot is_robot_path list_robots load_robot robot_text",
        ".problem": "RobotError RobotFileProblem",
        ".replay": "Replay",
        ".rig": "Rig Simulation connect simulate",
        ".runner": "Runner",
        ".states": "States",
        ".text": "print_robot",
        ".virtual": "VirtualRobot wire_of",
        ".worlds": "run_real run_replay run_virtual",
    },
)
