"""Floors put together: a robot's file becomes hosts, twins, states and controllers, in virtual time or on real buses."""

from __future__ import annotations

from typing import TYPE_CHECKING

from .._lazy import lazy_names

if TYPE_CHECKING:
    from .act_log import ActLog
    from .buses import VirtualRobot, open_gates
    from .file import parse_robot
    from .rig import connect
    from .runner import Ended, Runner
    from .stops import stop_robot
    from .worlds import run_real, run_replay, run_virtual

__all__ = [
    "ActLog",
    "Ended",
    "Runner",
    "VirtualRobot",
    "connect",
    "open_gates",
    "parse_robot",
    "run_real",
    "run_replay",
    "run_virtual",
    "stop_robot",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        ".act_log": "ActLog",
        ".buses": "VirtualRobot open_gates",
        ".file": "parse_robot",
        ".rig": "connect",
        ".runner": "Ended Runner",
        ".stops": "stop_robot",
        ".worlds": "run_real run_replay run_virtual",
    },
)
