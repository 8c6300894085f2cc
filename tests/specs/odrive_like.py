"""A part of ODrive's CAN Simple.

What it asks of the language: node and command in one identifier; a request that differs from its answer by the
frame's kind (remote) or by its length (none) only; firmware versions.

Sources: odriverobotics/ODrive `docs/can-protocol.rst`, `tools/odrive-cansimple.dbc`; odriverobotics/ODriveArduino
`src/can_simple_messages.hpp`; odriverobotics/ODriveResources `examples/can_*.py`.
"""

from __future__ import annotations

from construct import (
    Byte,
    Bytes,
    BytesInteger,
    Const,
    Float32l,
    GreedyBytes,
    Int16sl,
    Int16ul,
    Int32sl,
    Int32ul,
    Struct,
)

from aces_bus.protocol import BitLayout, Enumeration, Flags, IdField, Protocol, Quantity, Reserved, bits

odrive_like = Protocol(
    "odrive_like",
    link="can",
    bitrate=250_000,
    dialects={"0.5": "firmware 0.5.6", "0.6": "firmware 0.6"},
    dialect="0.6",
    doc="ODrive motor controllers.",
    source="ODrive can-protocol.rst",
)

Node = IdField("node", range(0x3F))  # 0x3F is everyone, or no address yet
STATES = {
    "undefined": 0, "idle": 1, "startup": 2, "full_calibration": 3, "motor_calibration": 4, "index_search": 6,
    "offset_calibration": 7, "closed_loop": 8, "lockin_spin": 9, "find_direction": 10, "homing": 11,
}  # fmt: skip
TURN, TURN_S = Quantity(Float32l, unit="rev"), Quantity(Float32l, unit="rev/s")


def ask(name: str, command: int) -> None:
    """What a device tells it can be asked for: by a remote frame or by a data frame of length 0."""
    for suffix, remote in (("Request", True), ("Poll", False)):
        odrive_like.message(
            f"{name}{suffix}",
            id=Node << 5 | command,
            remote=remote,
            direction="to device",
            doc=f"Ask for {name}.",
            source="can-protocol.rst",
        )


odrive_like.message(
    "Heartbeat",
    id=Node << 5 | 0x01,
    direction="from device",
    dialect="0.5",
    payload=Struct(
        "error"
        / Flags(
            Int32ul, invalid_state=0, motor=6, sensorless=7, encoder=8, controller=9, watchdog=11, min_endstop=12,
            max_endstop=13, estop=14, over_temperature=18, unknown_position=19,
        ),
        "state" / Enumeration(Byte, STATES),
        "motor" / Flags(Byte, error=0),
        "encoder" / Flags(Byte, error=0),
        "controller" / Flags(Byte, error=0, trajectory_done=7),
    ),
    doc="State and errors, every 100 ms.",
    source="odrive-cansimple.dbc",
)  # fmt: skip
odrive_like.message(
    "Heartbeat",
    id=Node << 5 | 0x01,
    direction="from device",
    dialect="0.6",
    payload=BitLayout(
        8,
        "error"
        / Flags(
            bits(32), initializing=0, system=1, timing=2, bad_config=4, driver=5, over_voltage=8, under_voltage=9,
            over_current=10, velocity_limit=14, position_limit=15, watchdog=24, estop=25, spinout=26, brake_resistor=27,
            thermistor=28, calibration=30,
        ),
        "state" / Enumeration(bits(8), STATES),
        "result" / Enumeration(bits(8), success=0, busy=1, cancelled=2, disarmed=3, no_response=4, timeout=11),
        "trajectory_done" / bits(1),
    ),
    doc="State and errors, every 100 ms.",
    source="can_simple_messages.hpp",
)  # fmt: skip

EncoderEstimates = odrive_like.message(
    "EncoderEstimates",
    id=Node << 5 | 0x09,
    direction="from device",
    payload=Struct("position" / TURN, "velocity" / TURN_S),
    doc="Position and velocity, every 10 ms or when asked.",
    source="can-protocol.rst",
)
ask("EncoderEstimates", 0x09)
odrive_like.message(
    "EncoderCount",
    id=Node << 5 | 0x0A,
    direction="from device",
    dialect="0.5",
    payload=Struct("shadow" / Int32sl, "count_in_cpr" / Int32sl),
    doc="Raw counts.",
    source="can-protocol.rst",
)
odrive_like.message(
    "Estop", id=Node << 5 | 0x02, direction="to device", doc="Stop now.", source="can-protocol.rst"
)
odrive_like.message(
    "SetAxisState",
    id=Node << 5 | 0x07,
    direction="to device",
    payload=Struct("state" / Enumeration(Int32ul, STATES)),
    doc="Change the state.",
    source="can-protocol.rst",
)
odrive_like.message(
    "SetControllerModes",
    id=Node << 5 | 0x0B,
    direction="to device",
    payload=Struct(
        "control" / Enumeration(Int32ul, voltage=0, torque=1, velocity=2, position=3),
        "input"
        / Enumeration(
            Int32ul,
            inactive=0,
            passthrough=1,
            velocity_ramp=2,
            position_filter=3,
            mix=4,
            trapezoid=5,
            torque_ramp=6,
            mirror=7,
        ),
    ),
    doc="How the motor is controlled.",
    source="can-protocol.rst",
)
odrive_like.message(
    "SetInputPosition",
    id=Node << 5 | 0x0C,
    direction="to device",
    payload=Struct(
        "position" / TURN,
        "velocity" / Quantity(Int16sl, scale=0.001, unit="rev/s"),
        "torque" / Quantity(Int16sl, scale=0.001, unit="N·m"),
    ),
    doc="Position with feed-forwards.",
    source="can-protocol.rst",
)

# ---------------------------------------------------------------------- parameters and addresses, firmware 0.6

odrive_like.message(
    "RxSdo",
    id=Node << 5 | 0x04,
    direction="to device",
    dialect="0.6",
    payload=Struct(
        "opcode" / Enumeration(Byte, read=0, write=1),
        "endpoint" / Int16ul,
        "reserved0" / Reserved(1),
        "value" / GreedyBytes,
    ),
    doc="Read or write any parameter; the value's type is the endpoint's.",
    source="ODriveResources can_simple.py",
)
odrive_like.message(
    "TxSdo",
    id=Node << 5 | 0x05,
    direction="from device",
    dialect="0.6",
    payload=Struct("opcode" / Byte, "endpoint" / Int16ul, "reserved0" / Reserved(1), "value" / GreedyBytes),
    doc="The answer to RxSdo.",
    source="ODriveResources can_simple.py",
)
odrive_like.message(
    "SetAddress",
    id=0x7E6,
    direction="to device",
    dialect="0.6",
    length=(7, 8),
    payload=Struct(
        "address" / Byte, "serial_number" / BytesInteger(6, swapped=True), "connection" / GreedyBytes
    ),
    doc="Give the device with this serial number an address; the connection id came with 0.6.11.",
    source="can_simple_messages.hpp",
)
odrive_like.message(
    "Discover", id=0x7E6, remote=True, direction="to device", dialect="0.6", doc="Ask everyone for its address.",
    source="ODriveResources can_enumerate.py",
)  # fmt: skip
odrive_like.message(
    "Address",
    id=Node << 5 | 0x06,
    direction="from device",
    dialect="0.6",
    length=(7, 8),
    payload=Struct(
        "address" / Byte, "serial_number" / BytesInteger(6, swapped=True), "connection" / GreedyBytes
    ),
    doc="The answer to Discover.",
    source="can_simple_messages.hpp",
)
odrive_like.message(
    "Version",
    id=Node << 5 | 0x00,
    direction="from device",
    dialect="0.6",
    payload=Struct(Const(2, Byte), "hardware" / Bytes(3), "firmware" / Bytes(4)),
    doc="Protocol version 2, versions of hardware and firmware.",
    source="can_simple_messages.hpp",
)
ask("Version", 0x00)
