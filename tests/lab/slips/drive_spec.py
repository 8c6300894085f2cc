"""A drive on CAN that tells by itself: node and command in the identifier, floats, flags in a layout."""

from __future__ import annotations

from construct import Float32l, Int16sl, Int32ul, Struct

from aces_bus.protocol import BitLayout, Counter, Enumeration, Flags, IdField, Protocol, Quantity, bits

drive = Protocol("drive", link="can", bitrate=250_000, source="CAN Simple 0.6")
Node = IdField("node", range(0x3F))
ERRORS = {"initializing": 0, "system": 1, "missing_input": 6, "over_current": 10, "watchdog": 24, "estop": 25}
STATES = {"undefined": 0, "idle": 1, "calibration": 3, "closed_loop": 8}

drive.message(
    "Heartbeat",
    id=Node << 5 | 0x01,
    direction="from device",
    payload=BitLayout(
        8,
        "error" / Flags(bits(32), ERRORS),
        "state" / Enumeration(bits(8), STATES),
        "result" / Enumeration(bits(8), success=0, busy=1),
        "trajectory_done" / bits(1),
        "life" / Counter(bits(7)),
    ),
    examples=[
        (
            "061#00 00 00 02 01 01 01 00",
            {"node": 3, "error": ["estop"], "state": "idle", "trajectory_done": 1},
        )
    ],
)
drive.message(
    "Estimates",
    id=Node << 5 | 0x09,
    direction="from device",
    payload=Struct(
        "position" / Quantity(Float32l, unit="rev"), "velocity" / Quantity(Float32l, unit="rev/s")
    ),
    examples=[("069#00 00 80 3F 00 00 00 40", {"node": 3, "position": 1.0, "velocity": 2.0})],
)
drive.message(
    "Currents",
    id=Node << 5 | 0x14,
    direction="from device",
    payload=Struct("set" / Quantity(Float32l, unit="A"), "measured" / Quantity(Float32l, unit="A")),
)
drive.message(
    "Supply",
    id=Node << 5 | 0x17,
    direction="from device",
    payload=Struct("voltage" / Quantity(Float32l, unit="V"), "current" / Quantity(Float32l, unit="A")),
)
drive.message(
    "SetPosition",
    id=Node << 5 | 0x0C,
    direction="to device",
    payload=Struct(
        "position" / Quantity(Float32l, unit="rev"),
        "velocity" / Quantity(Int16sl, scale=0.001, unit="rev/s"),
        "torque" / Quantity(Int16sl, scale=0.001, unit="N·m"),
    ),
    examples=[
        ("06C#00 00 C0 3F FA 00 83 FF", {"node": 3, "position": 1.5, "velocity": 0.25, "torque": -0.125})
    ],
)
drive.message(
    "SetState",
    id=Node << 5 | 0x07,
    direction="to device",
    payload=Struct("state" / Enumeration(Int32ul, STATES)),
)
