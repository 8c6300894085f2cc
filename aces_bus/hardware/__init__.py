"""The hardware floor: one bus, its words, its time. Nothing here knows a protocol.

Gatekeepers own a bus and let many listen: `CanGate`, `SerialGate`, `DatagramGate`. The virtual bus has physics (`Wire`)
and is a python-can backend, `can.Bus(interface="aces")`. Names are imported on use: python-can is not loaded before it is
needed.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .can import CanGate as CanGate
    from .can import Received as Received
    from .datagram import Datagram as Datagram
    from .datagram import DatagramGate as DatagramGate
    from .datagram_wire import DatagramWire as DatagramWire
    from .events import BusEvent as BusEvent
    from .faults import Faults as Faults
    from .frame_time import FrameBits as FrameBits
    from .frame_time import frame_bits as frame_bits
    from .ports import CanPort as CanPort
    from .ports import DatagramPort as DatagramPort
    from .ports import SerialPort as SerialPort
    from .ports import port_of as port_of
    from .serial import Heard as Heard
    from .serial import SerialGate as SerialGate
    from .serial_wire import SerialWire as SerialWire
    from .virtual import AcesBus as AcesBus
    from .virtual import virtual_clock as virtual_clock
    from .wire import Babbler as Babbler
    from .wire import Node as Node
    from .wire import Recorder as Recorder
    from .wire import Wire as Wire
    from .wire import WireEvent as WireEvent

_PLACES = {
    "AcesBus": "virtual",
    "Babbler": "wire",
    "BusEvent": "events",
    "CanGate": "can",
    "CanPort": "ports",
    "Datagram": "datagram",
    "DatagramGate": "datagram",
    "DatagramPort": "ports",
    "DatagramWire": "datagram_wire",
    "Faults": "faults",
    "FrameBits": "frame_time",
    "Heard": "serial",
    "Node": "wire",
    "Received": "can",
    "Recorder": "wire",
    "SerialGate": "serial",
    "SerialPort": "ports",
    "SerialWire": "serial_wire",
    "Wire": "wire",
    "WireEvent": "wire",
    "frame_bits": "frame_time",
    "port_of": "ports",
    "virtual_clock": "virtual",
}

__all__ = [
    "AcesBus",
    "Babbler",
    "BusEvent",
    "CanGate",
    "CanPort",
    "Datagram",
    "DatagramGate",
    "DatagramPort",
    "DatagramWire",
    "Faults",
    "FrameBits",
    "Heard",
    "Node",
    "Received",
    "Recorder",
    "SerialGate",
    "SerialPort",
    "SerialWire",
    "Wire",
    "WireEvent",
    "frame_bits",
    "port_of",
    "virtual_clock",
]


def __getattr__(name: str) -> Any:
    if name in _PLACES:
        from importlib import import_module

        return getattr(import_module(f".{_PLACES[name]}", __name__), name)
    raise AttributeError(f"module 'aces_bus.hardware' has no attribute {name!r}")
