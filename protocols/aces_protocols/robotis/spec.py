"""Dynamixel protocol 1.0, as the RX-10, RX-28 and RX-64 servos of MiniHubo speak it.

Source: Robotis RX-28 manual, checked against recordings of two servos. Deviations from both are in the README beside.
"""

from __future__ import annotations

from aces_bus.protocol import Protocol

from .control_table import ERRORS, add_registers
from .packets import BROADCAST, SERVOS, declare_packets

robotis = Protocol(
    "robotis",
    link="serial",
    baud=1_000_000,  # MiniHubo; a servo leaves the factory at 57 600 (see the register `baud_rate`)
    half_duplex=True,
    broadcast={"id": BROADCAST},
    doc="Dynamixel protocol 1.0: half-duplex RS-485, several servos on one line.",
    source="Robotis RX-28 manual; recordings of two servos",
)

declare_packets(
    robotis,
    source="RX-28 manual",
    errors=ERRORS,
    reset=0x06,
    reads_together=False,
    examples={
        "Ping": [("FF FF 01 02 01 FB", {"id": 1})],
        "Read": [
            ("FF FF 01 04 02 00 32 C6", {"id": 1, "start": 0, "count": 50}),
            ("FF FF 01 04 02 2B 01 CC", {"id": 1, "start": 0x2B, "count": 1}),
        ],
        "Write": [
            ("FF FF 01 05 03 1E F6 01 E1", {"id": 1, "start": 0x1E, "data": b"\xf6\x01"}),
            ("FF FF FE 04 03 03 01 F6", {"id": BROADCAST, "start": 3, "data": b"\x01"}),
        ],
        "RegWrite": [("FF FF 00 05 04 1E 00 00 D8", {"id": 0, "start": 0x1E, "data": bytes(2)})],
        "Action": [("FF FF FE 02 05 FA", {"id": BROADCAST})],
        "Reset": [("FF FF 00 02 06 F7", {"id": 0})],
        "SyncWrite": [
            (
                "FF FF FE 0A 83 1E 02 47 10 02 60 00 02 99",
                {
                    "start": 0x1E,
                    "size": 2,
                    "servos": [{"id": 71, "data": b"\x10\x02"}, {"id": 96, "data": b"\x00\x02"}],
                },
            )
        ],
        "Status": [
            (
                "FF FF 01 03 00 20 DB",
                {"id": 1, "error": [], "parameters": b"\x20"},
                "FF FF 01 04 02 2B 01 CC",
            ),
            ("FF FF 01 02 24 D8", {"id": 1, "error": ["overheating", "overload"], "parameters": b""}),
        ],
    },
)

# ---------------------------------------------------------------------- control table

control_table = robotis.registers(
    read="Read",
    write="Write",
    sync="SyncWrite",
    reply="Status.parameters",
    doc="Control table of RX-10, RX-28 and RX-64: EEPROM 0x00–0x17, RAM 0x18–0x31; words are little-endian.",
)
add_registers(control_table)

__all__ = ["BROADCAST", "SERVOS", "control_table", "robotis"]
