"""Floors put together: a robot's file becomes hosts, twins, states and controllers, in virtual time or on real buses."""

from __future__ import annotations

from typing import TYPE_CHECKING

from .._lazy import lazy_names

if TYPE_CHECKING:
    from .act_log import ActLog
    from .buses import VirtualRobot, gate_of, open_gates, port_for, wire_of
    from .file import (
        RobotError,
        RobotFileProblem,
        is_robot,
        make_robot,
        parse_robot,
        print_robot,
    )
    from .installed import check_robot, is_robot_path, list_robots, load_robot, robot_text
    from .rig import Rig, Simulation, connect, simulate
    from .runner import Ended, Runner
    from .states import States
    from .stops import Stopped, stop_robot
    from .worlds import Replay, run_real, run_replay, run_virtual

__all__ = [
    "ActLog",
    "Ended",
    "Replay",
    "Rig",
    "RobotError",
    "RobotFileProblem",
    "Runner",
    "Simulation",
    "States",
    "Stopped",
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
    "stop_robot",
    "wire_of",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        ".act_log": "ActLog",
        ".buses": "VirtualRobot gate_of open_gates port_for wire_of",
        ".file": "RobotError RobotFileProblem is_robot make_robot parse_robot print_robot",
        ".installed": "check_robot is_robot_path list_robots load_robot robot_text",
        ".rig": "Rig Simulation connect simulate",
        ".runner": "Ended Runner",
        ".states": "States",
        ".stops": "Stopped stop_robot",
        ".worlds": "Replay run_real run_replay run_virtual",
    },
)
