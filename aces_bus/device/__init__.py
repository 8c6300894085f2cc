"""The device floor: what stands on a bus, and robots as data.

A robot's file is read by `load_robot`; see docs/robots.md for what stands in it.
"""

from __future__ import annotations

from .problem import Problem as Problem
from .problem import RobotError as RobotError
from .robot import Bus as Bus
from .robot import Compliance as Compliance
from .robot import Device as Device
from .robot import Gains as Gains
from .robot import Home as Home
from .robot import Joint as Joint
from .robot import Robot as Robot
from .robot import Sensor as Sensor
from .robot import tables_of as tables_of
from .robot_file import check_robot as check_robot
from .robot_file import is_robot as is_robot
from .robot_file import load_robot as load_robot
from .robot_file import make_robot as make_robot
from .robot_file import parse_robot as parse_robot
from .robot_text import print_robot as print_robot
