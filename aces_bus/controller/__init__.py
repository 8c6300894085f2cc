"""Controllers: algorithms at a rate, from states to set-points. They touch no frame and no byte.

`@controller` makes one of a function, `Equations` of a text near the paper's notation, `StateMachine` of a table; `Player`
plays trajectories and via paths, `PIDController` regulates. `Guard` is below
each of them, `Supervisor` around both.
"""

from __future__ import annotations

from .base import Controller
from .equation import Equations
from .events import ControlEvent
from .function import controller
from .guard import Guard
from .limiter import Bounds, bounds_of
from .machine import Phase, StateMachine, Transition
from .motion import Trajectory
from .motion_file import read_trajectory
from .pid import PID, PIDController
from .player import Player
from .reactions import IGNORE, degrade, stop
from .supervisor import Supervisor
from .via import Limits, ViaPath

__all__ = [
    "IGNORE",
    "PID",
    "Bounds",
    "ControlEvent",
    "Controller",
    "Equations",
    "Guard",
    "Limits",
    "PIDController",
    "Phase",
    "Player",
    "StateMachine",
    "Supervisor",
    "Trajectory",
    "Transition",
    "ViaPath",
    "bounds_of",
    "controller",
    "degrade",
    "read_trajectory",
    "stop",
]
