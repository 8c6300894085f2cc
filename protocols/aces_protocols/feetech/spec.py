"""Feetech's STS, SMS and SCS servos: the packets of Dynamixel protocol 1.0, control tables of their own.

1. STS and SMS have their words little-endian, SCS big-endian; packets carry bytes, so they are the same for both.
2. SCS servos do not answer SyncRead.

Source: Feetech's FTServo_Python and LeRobot's tables, as facts; worked examples from feetech-servo-sdk and LeRobot.
"""

from __future__ import annotations

from aces_bus.protocol import Protocol
from aces_protocols.robotis.packets import BROADCAST, SERVOS, declare_packets

from .control_table import ERRORS, add_scs_registers, add_sts_registers

feetech = Protocol(
    "feetech",
    link="serial",
    baud=1_000_000,
    half_duplex=True,
    broadcast={"id": BROADCAST},
    doc="Feetech STS, SMS and SCS servos: half-duplex TTL or RS-485, several servos on one line.",
    source="Feetech FTServo_Python; LeRobot motors/feetech",
)

declare_packets(
    feetech,
    source="FTServo_Python",
    errors=ERRORS,
    reset=0x0A,
    reads_together=True,
    examples={
        "Ping": [("FF FF 01 02 01 FB", {"id": 1})],
        "Read": [("FF FF 01 04 02 38 02 BE", {"id": 1, "start": 56, "count": 2})],
        "Write": [
            (
                "FF FF 01 0A 03 29 32 00 08 00 00 E8 03 A3",
                {"start": 41, "data": bytes.fromhex("32 0008 0000 E803")},
            ),
            ("FF FF 02 05 03 1F 5B 09 72", {"id": 2, "start": 31, "data": b"\x5b\x09"}),
            (
                "FF FF 01 09 03 2A 02 00 00 00 03 E8 DB",
                {"start": 42, "data": bytes.fromhex("0200 0000 03E8")},
            ),
        ],
        "RegWrite": [("FF FF 01 05 04 2A 00 08 C3", {"id": 1, "start": 42, "data": b"\x00\x08"})],
        "Action": [("FF FF FE 02 05 FA", {"id": BROADCAST})],
        "Reset": [("FF FF 01 02 0A F2", {"id": 1})],
        "SyncRead": [
            ("FF FF FE 06 82 38 04 01 02 3A", {"id": BROADCAST, "start": 56, "count": 4, "ids": [1, 2]}),
            (
                "FF FF FE 0A 82 38 02 01 02 03 04 05 06 26",
                {"start": 56, "count": 2, "ids": [1, 2, 3, 4, 5, 6]},
            ),
        ],
        "SyncWrite": [
            (
                "FF FF FE 0A 83 2A 02 01 00 04 02 00 0C 35",
                {
                    "start": 42,
                    "size": 2,
                    "servos": [{"id": 1, "data": b"\x00\x04"}, {"id": 2, "data": b"\x00\x0c"}],
                },
            )
        ],
        "Status": [
            (
                "FF FF 01 04 00 00 08 F2",
                {"id": 1, "error": [], "parameters": b"\x00\x08"},
                "FF FF 01 04 02 38 02 BE",
            ),
            ("FF FF 01 04 00 09 03 EE", {"id": 1, "parameters": b"\x09\x03"}, "FF FF 01 04 02 03 02 F3"),
        ],
    },
)

# ---------------------------------------------------------------------- control tables

scs_table = feetech.registers(
    read="Read",
    write="Write",
    sync="SyncWrite",
    reply="Status.parameters",
    doc="Control table of SCS servos; words are big-endian.",
)
add_scs_registers(scs_table)
sts_table = feetech.registers(
    read="Read",
    write="Write",
    sync="SyncWrite",
    reply="Status.parameters",
    doc="Control table of STS and SMS servos; words are little-endian. SCS servos have one of their own, `scs_table`.",
)
add_sts_registers(sts_table)

__all__ = ["BROADCAST", "SERVOS", "feetech", "scs_table", "sts_table"]
