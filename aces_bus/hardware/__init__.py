"""The hardware floor: one bus, what it carries, its time. Nothing here knows a protocol.

Gatekeepers own a bus and let many listen: `CanGate`, `SerialGate`, `DatagramGate`. The virtual bus has physics
(`SimulatedBus`) and is a python-can backend, `can.Bus(interface="aces")`. Names are imported on use: python-can is not
loaded before it is needed.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from .._lazy import lazy_names

if TYPE_CHECKING:
    from .can import CanGate
    from .datagram import DatagramGate
    from .gate import Received
    from .gate_events import BusEvent
    from .lock import BusLock
    from .ports import CanPort, DatagramPort, SerialPort, port_of
    from .serial import SerialGate
    from .simulated.backend import AcesBus, virtual_clock
    from .simulated.bus import Babbler, BusNode, Faults, ListeningNode, SimulatedBus
    from .simulated.bus_event import SimulatedBusEvent
    from .simulated.datagrams import SimulatedDatagrams
    from .simulated.frame_time import FrameBits, frame_bits
    from .simulated.serial_line import SimulatedSerialLine

__all__ = [
    "AcesBus",
    "Babbler",
    "BusEvent",
    "BusLock",
    "BusNode",
    "CanGate",
    "CanPort",
    "DatagramGate",
    "DatagramPort",
    "Faults",
    "FrameBits",
    "ListeningNode",
    "Received",
    "SerialGate",
    "SerialPort",
    "SimulatedBus",
    "SimulatedBusEvent",
    "SimulatedDatagrams",
    "SimulatedSerialLine",
    "frame_bits",
    "port_of",
    "virtual_clock",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        ".can": "CanGate",
        ".datagram": "DatagramGate",
        ".gate": "Received",
        ".gate_events": "BusEvent",
        ".lock": "BusLock",
        ".ports": "CanPort DatagramPort SerialPort port_of",
        ".serial": "SerialGate",
        ".simulated.backend": "AcesBus virtual_clock",
        ".simulated.bus": "Babbler BusNode Faults ListeningNode SimulatedBus",
        ".simulated.bus_event": "SimulatedBusEvent",
        ".simulated.datagrams": "SimulatedDatagrams",
        ".simulated.frame_time": "FrameBits frame_bits",
        ".simulated.serial_line": "SimulatedSerialLine",
    },
)
