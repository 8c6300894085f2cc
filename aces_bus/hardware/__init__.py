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
    from .serial import SerialGate
    from .simulated.backend import virtual_clock
    from .simulated.bus import Faults, ListeningNode, SimulatedBus
    from .simulated.serial_line import Noise

__all__ = [
    "CanGate",
    "DatagramGate",
    "Faults",
    "ListeningNode",
    "Noise",
    "SerialGate",
    "SimulatedBus",
    "virtual_clock",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        ".can": "CanGate",
        ".datagram": "DatagramGate",
        ".serial": "SerialGate",
        ".simulated.backend": "virtual_clock",
        ".simulated.bus": "Faults ListeningNode SimulatedBus",
        ".simulated.serial_line": "Noise",
    },
)
