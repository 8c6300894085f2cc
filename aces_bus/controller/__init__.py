"""Controllers: algorithms at a rate, from states to set-points. They touch no frame and no byte.

`@controller` makes one of a function, `Equations` of a text near the paper's notation, `StateMachine` of a table; `Player`
plays trajectories and via paths, `PIDController` regulates. `Guard` is below
each of them, `Supervisor` around both.
"""

from __future__ import annotations

from .base import NOTHING, Controller, ControllerLike, StateLike, known_value
from .equation import Equations
from .events import ControlEvent, EventLike
from .function import FunctionController, controller
from .guard import Bounds, Guard, bounds_of
from .language import EquationError
from .machine import MachineError, Phase, StateMachine, Transition
from .motion import Motion, Trajectory, sampled
from .motion_file import TrajectoryError, read_trajectory
from .pid import PID, PIDController
from .player import Player
from .reactions import DEFAULT_REACTIONS, IGNORE, Reaction, degrade, parse_reactions, stop
from .supervisor import Supervisor
from .trip import Clipped, Trip
from .via import Limits, ViaPath

__all__ = [
    "DEFAULT_REACTIONS",
    "IGNORE",
    "NOTHING",
    "PID",
    "Bounds",
    "Clipped",
    "ControlEvent",
    "Controller",
    "ControllerLike",
    "EquationError",
    "Equations",
    "EventLike",
    "FunctionController",
    "Guard",
    "Limits",
    "MachineError",
    "Motion",
    "PIDController",
    "Phase",
    "Player",
    "Reaction",
    "StateLike",
    "StateMachine",
    "Supervisor",
    "Trajectory",
    "TrajectoryError",
    "Transition",
    "Trip",
    "ViaPath",
    "bounds_of",
    "controller",
    "degrade",
    "known_value",
    "parse_reactions",
    "read_trajectory",
    "sampled",
    "stop",
]
