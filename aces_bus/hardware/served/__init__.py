"""The virtual bus across processes: a server of paced wires, and python-can clients of it."""

from __future__ import annotations

from .address import ServedAddress, is_served, parse_address
from .channel import ServedChannel
from .remote import ServedBus
from .server import BusServer
from .stream import ask, served_channels, servers

__all__ = [
    "BusServer",
    "ServedAddress",
    "ServedBus",
    "ServedChannel",
    "ask",
    "is_served",
    "parse_address",
    "served_channels",
    "servers",
]
