"""Servo drives of CiA 402 on CANopen; their twin."""

from __future__ import annotations

from aces_bus.device import Driver

from .driver import Cia402
from .example import EXAMPLE
from .scan import scan_nodes
from .twin import Cia402Twin

driver = Driver(
    "cia402",
    device=Cia402,
    twin=Cia402Twin,
    example=EXAMPLE,
    doc="Servo drive of CiA 402 on CANopen: position, velocity and torque, profile and cyclic; homing.",
    source="CiA 301, CiA 402 (christiansandberg/canopen; ros-industrial/ros2_canopen)",
    scan=scan_nodes,
    settings={
        "eds": "the drive's EDS or DCF file; our own drive's when absent",
        "pdo": '"read": as the drive has them (when absent); "file": as its file says; "write": as the driver wants them',
        "sync": 'true: SYNC in each tick; when absent as the drive\'s file says, true with pdo = "write"',
        "event_ms": 'without SYNC and with pdo = "write": how often the drive sends (ms), 20 when absent',
        "mode": "mode of operation; when absent profile_position, or what the joint's command says",
        "counts_per_turn": "counts a turn of the joint, where it has no gear, harmonic and encoder",
        "velocity_scale": "the drive's units of velocity in counts/s, 1 when absent: v = counts/s × this",
        "rated_torque": "the rated torque (N·m, of the joint); when absent torques are shares of it",
        "heartbeat_ms": "the drive's heartbeat (ms), 500 when absent; 0 leaves it as it is",
        "sdo_timeout_s": "how long an SDO answer may take (s), 0.3 when absent",
    },
)

__all__ = ["driver"]
