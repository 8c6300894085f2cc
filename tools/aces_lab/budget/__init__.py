"""Whether a bus can carry what is sent on it: utilisation, worst-case response times, cycles of requests and answers.

`response_times` is of any set of CAN messages, `round_times` of what a host's tick brings about, `robot_traffic` and
`robot_budget` of a whole robot: `aces bus budget`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from aces_bus._lazy import lazy_names

if TYPE_CHECKING:
    from .messages import BusMessage, ErrorModel, MessageSet, can_message, frame_ns
    from .response import ResponseTime, response_times
    from .robot import Assumptions, BusBudget, MessageBudget, RobotBudget, robot_budget
    from .rounds import RoundFrame, RoundTimes, round_times
    from .traffic import BusTraffic, RobotTraffic, SentMessage, robot_traffic

__all__ = [
    "Assumptions",
    "BusBudget",
    "BusMessage",
    "BusTraffic",
    "ErrorModel",
    "MessageBudget",
    "MessageSet",
    "ResponseTime",
    "RobotBudget",
    "RobotTraffic",
    "RoundFrame",
    "RoundTimes",
    "SentMessage",
    "can_message",
    "frame_ns",
    "response_times",
    "robot_budget",
    "robot_traffic",
    "round_times",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        ".messages": "BusMessage ErrorModel MessageSet can_message frame_ns",
        ".response": "ResponseTime response_times",
        ".robot": "Assumptions BusBudget MessageBudget RobotBudget robot_budget",
        ".rounds": "RoundFrame RoundTimes round_times",
        ".traffic": "BusTraffic RobotTraffic SentMessage robot_traffic",
    },
)
