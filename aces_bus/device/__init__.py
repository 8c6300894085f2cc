"""The device floor: devices on a bus, their twins, and robots as data.

A robot's file is read by `load_robot`; docs/robots.md describes its content.
"""

from __future__ import annotations

from .client import Client
from .coalesce import OutgoingMessage, uncoalesced
from .config import Robot
from .declared import Poll, signal
from .device import Device
from .drivers import Driver, load_driver
from .host_loss import HostLoss
from .motor import MotorDevice
from .packet_sender import PacketSender
from .reading import UNKNOWN
from .single_motor import SingleMotor
from .ticket import Job, Steps, Ticket, together
from .twin import Twin, on

__all__ = [
    "UNKNOWN",
    "Client",
    "Device",
    "Driver",
    "HostLoss",
    "Job",
    "MotorDevice",
    "OutgoingMessage",
    "PacketSender",
    "Poll",
    "Robot",
    "SingleMotor",
    "Steps",
    "Ticket",
    "Twin",
    "load_driver",
    "on",
    "signal",
    "together",
    "uncoalesced",
]
