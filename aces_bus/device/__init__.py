"""The device floor: devices on a bus, their twins, and robots as data.

A robot's file is read by `load_robot`; docs/robots.md describes its content.
"""

from __future__ import annotations

from .client import Client
from .coalesce import CoalescingRule, OutgoingMessage, Setpoint, per_device, uncoalesced
from .config import Bus, Compliance, DeviceConfig, Gains, Home, Joint, Robot, Sensor
from .declared import Poll, signal
from .device import Device
from .drivers import Driver, list_drivers, load_driver, use_driver_file
from .events import DeviceEvent, EventLog
from .host import Host
from .host_loss import HostLoss
from .motor import MotorDevice
from .packet_sender import PacketSender
from .port import Port
from .reading import UNKNOWN, Reading
from .signals import Signal
from .single_motor import JointScale, SingleMotor
from .stopping import stop_devices, wait_stopped
from .ticket import Job, Steps, Ticket, together
from .twin import JointModel, Twin, Twins, World, on

__all__ = [
    "UNKNOWN",
    "Bus",
    "Client",
    "CoalescingRule",
    "Compliance",
    "Device",
    "DeviceConfig",
    "DeviceEvent",
    "Driver",
    "EventLog",
    "Gains",
    "Home",
    "Host",
    "HostLoss",
    "Job",
    "Joint",
    "JointModel",
    "JointScale",
    "MotorDevice",
    "OutgoingMessage",
    "PacketSender",
    "Poll",
    "Port",
    "Reading",
    "Robot",
    "Sensor",
    "Setpoint",
    "Signal",
    "SingleMotor",
    "Steps",
    "Ticket",
    "Twin",
    "Twins",
    "World",
    "list_drivers",
    "load_driver",
    "on",
    "per_device",
    "signal",
    "stop_devices",
    "together",
    "uncoalesced",
    "use_driver_file",
    "wait_stopped",
]
