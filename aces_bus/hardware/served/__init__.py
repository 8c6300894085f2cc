"""The virtual bus across processes: a server of paced wires, and python-can clients of it."""

from __future__ import annotations

from .address import Address, is_served, parse_address
from .channel import ServedChannel
from .remote import ServedBus, ask, served_channels, servers
from .server import BusServer

__all__ = [
    "Address",
    "BusServer",
    "ServedBus",
    "ServedChannel",
    "ask",
    "is_served",
    "parse_address",
    "served_channels",
    "servers",
]
