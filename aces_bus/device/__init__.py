"""The device floor: what stands on a bus, and robots as data.

A robot's file is read by `load_robot`; see docs/robots.md for what stands in it.
"""

from __future__ import annotations

from .coalesce import Outgoing as Outgoing
from .coalesce import Rule as Rule
from .coalesce import Want as Want
from .coalesce import a_device as a_device
from .coalesce import one_each as one_each
from .device import Device as Device
from .device import Poll as Poll
from .device import signal as signal
from .events import DeviceEvent as DeviceEvent
from .events import EventLog as EventLog
from .host import Host as Host
from .port import Port as Port
from .problem import Problem as Problem
from .problem import RobotError as RobotError
from .registry import Driver as Driver
from .registry import list_drivers as list_drivers
from .registry import load_driver as load_driver
from .rig import Rig as Rig
from .rig import Simulation as Simulation
from .rig import connect as connect
from .rig import simulate as simulate
from .robot import Bus as Bus
from .robot import Compliance as Compliance
from .robot import DeviceConfig as DeviceConfig
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
from .signals import UNKNOWN as UNKNOWN
from .signals import Reading as Reading
from .signals import Signal as Signal
from .stopping import stop_devices as stop_devices
from .stopping import wait_stopped as wait_stopped
from .ticket import Job as Job
from .ticket import Steps as Steps
from .ticket import Ticket as Ticket
from .ticket import together as together
from .twin import JointModel as JointModel
from .twin import Twin as Twin
from .twin import Twins as Twins
from .twin import World as World
from .twin import on as on
