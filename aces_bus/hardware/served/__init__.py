"""The virtual bus across processes: a server of paced wires, and python-can clients of it.

Names are imported on use: who asks where a bus is, as a stop does, loads neither python-can nor a server.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..._lazy import lazy_names

if TYPE_CHECKING:
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

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        ".address": "ServedAddress is_served parse_address",
        ".channel": "ServedChannel",
        ".remote": "ServedBus",
        ".server": "BusServer",
        ".stream": "ask served_channels servers",
    },
)
