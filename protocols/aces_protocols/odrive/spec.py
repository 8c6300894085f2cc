"""ODrive's CAN Simple, firmware 0.5 (3.x boards) and 0.6 (Pro, S1, Micro).

1. The identifier is node << 5 | command. What a drive tells is asked for by a remote frame, or by a data frame without data.
2. The firmwares give some commands other meanings, and the bytes do not tell which: each is a dialect.
3. A setting of four bytes may come with four more, as ODrive's own database file has all of them.

Sources: odriverobotics/ODrive `docs/can-protocol.rst`, `Firmware/communication/can/can_simple.cpp`,
`tools/odrive-cansimple.dbc` (0.5); odriverobotics/ODriveArduino `src/can_simple_messages.hpp`, `src/ODriveEnums.h` (0.6);
odriverobotics/ODriveResources `examples/can_*.py` (addresses, parameters, 0.6).
"""

from __future__ import annotations

from typing import Any

from construct import (
    Byte,
    BytesInteger,
    Construct,
    Default,
    Float32l,
    GreedyBytes,
    Int16sl,
    Int16ul,
    Int32sl,
    Int32ul,
    Int64ul,
    Struct,
)

from aces_bus.protocol import BitLayout, Enumeration, Flags, IdField, Protocol, Quantity, Reserved, bits

odrive = Protocol(
    "odrive",
    link="can",
    bitrate=250_000,
    dialects={"0.5": "firmware 0.5.6 (0.5.3 and later: see the README)", "0.6": "firmware 0.6"},
    dialect="0.6",
    doc="ODrive motor controllers, CAN Simple.",
    source="ODrive can-protocol.rst; ODriveArduino can_simple_messages.hpp",
)

OLD, NEW = "ODrive can-protocol.rst, can_simple.cpp", "ODriveArduino can_simple_messages.hpp"
RESOURCES = "ODriveResources examples/can_simple_utils"

Node = IdField("node", range(0x3F), doc="the axis; 0x3F is everybody, or has no address yet")
#: Where drives are asked for their addresses, and given them: node 0x3F, command 6.
ADDRESSES = 0x7E6

STATES = {
    "undefined": 0, "idle": 1, "startup_sequence": 2, "full_calibration": 3, "motor_calibration": 4, "index_search": 6,
    "offset_calibration": 7, "closed_loop": 8, "lockin_spin": 9, "direction_find": 10, "homing": 11,
    "hall_polarity_calibration": 12, "hall_phase_calibration": 13, "anticogging_calibration": 14,
    "harmonic_calibration": 15, "harmonic_commutation_calibration": 16,
}  # fmt: skip
#: Error bits of an axis, firmware 0.5.
AXIS_ERRORS = {
    "invalid_state": 0, "motor_failed": 6, "sensorless_failed": 7, "encoder_failed": 8, "controller_failed": 9,
    "watchdog": 11, "min_endstop": 12, "max_endstop": 13, "estop": 14, "homing_without_endstop": 17, "over_temperature": 18,
    "unknown_position": 19,
}  # fmt: skip
#: Error bits of firmware 0.6.
ERRORS = {
    "initializing": 0, "system": 1, "timing": 2, "missing_estimate": 3, "bad_config": 4, "driver": 5, "missing_input": 6,
    "over_voltage": 8, "under_voltage": 9, "over_current": 10, "regen_over_current": 11, "current_limit": 12,
    "motor_over_temperature": 13, "inverter_over_temperature": 14, "velocity_limit": 15, "position_limit": 16,
    "watchdog": 24, "estop": 25, "spinout": 26, "brake_resistor": 27, "thermistor": 28, "calibration": 30,
}  # fmt: skip
RESULTS = {
    "success": 0, "busy": 1, "cancelled": 2, "disarmed": 3, "no_response": 4, "pole_pairs_mismatch": 5,
    "resistance_out_of_range": 6, "inductance_out_of_range": 7, "unbalanced_phases": 8, "invalid_motor_type": 9,
    "illegal_hall_state": 10, "timeout": 11, "homing_without_endstop": 12, "invalid_state": 13, "not_calibrated": 14,
    "not_converging": 15,
}  # fmt: skip

REV, REV_S = Quantity(Float32l, unit="rev"), Quantity(Float32l, unit="rev/s")
AMPERE, VOLT, WATT = (Quantity(Float32l, unit=unit) for unit in ("A", "V", "W"))
NEWTON_METRE, CELSIUS = Quantity(Float32l, unit="N·m"), Quantity(Float32l, unit="°C")


def tells(name: str, command: int, payload: Construct, **more: Any) -> None:
    """Declare a message that a drive sends by itself or when asked: `Get…` by a remote frame, `Get…Empty` by
    a data frame without data.

    The first example's identifier is that of the requests' examples, too.
    """
    shared: dict[str, Any] = {"dialect": more.get("dialect"), "source": more["source"]}
    answer, values = more["examples"][0]
    identifier = answer.partition("#")[0]
    odrive.message(name, id=Node << 5 | command, direction="from device", payload=payload, **more)
    for suffix, remote in (("", True), ("Empty", False)):
        odrive.message(
            f"Get{name}{suffix}",
            id=Node << 5 | command,
            remote=remote,
            direction="to device",
            doc=f"Ask for {name}, by a {'remote frame' if remote else 'data frame without data'}.",
            examples=[(f"{identifier}#{'R' if remote else ''}", {"node": values["node"]})],
            **shared,
        )


def takes(name: str, command: int, payload: Construct | None = None, **more: Any) -> None:
    """Declare a message that the host sends to a drive."""
    if payload is not None:
        more["payload"] = payload
    odrive.message(name, id=Node << 5 | command, direction="to device", **more)


def four(name: str, field: Construct) -> dict[str, Any]:
    """Return a setting of four bytes, with four more that mean nothing or without."""
    return {"payload": Struct(name / field, "more" / Default(GreedyBytes, b"")), "length": (4, 8)}


# ---------------------------------------------------------------------- state and errors

odrive.message(
    "Heartbeat",
    id=Node << 5 | 0x01,
    direction="from device",
    dialect="0.5",
    payload=Struct(
        "error" / Flags(Int32ul, AXIS_ERRORS),
        "state" / Enumeration(Byte, STATES),
        "motor" / Flags(Byte, error=0),
        "encoder" / Flags(Byte, error=0),
        "controller" / Flags(Byte, error=0, trajectory_done=7),
    ),
    doc="State and errors, every 100 ms. The flags of motor, encoder and controller are 0.5.6's.",
    source=OLD,
    examples=[
        (
            "061#00 02 00 00 08 00 01 81",
            {
                "node": 3, "error": ["controller_failed"], "state": "closed_loop", "motor": [], "encoder": ["error"],
                "controller": ["error", "trajectory_done"],
            },
        )
    ],
)  # fmt: skip
odrive.message(
    "Heartbeat",
    id=Node << 5 | 0x01,
    direction="from device",
    dialect="0.6",
    payload=BitLayout(
        8,
        "error" / Flags(bits(32), ERRORS),
        "state" / Enumeration(bits(8), STATES),
        "result" / Enumeration(bits(8), RESULTS),
        "trajectory_done" / bits(1),
    ),
    doc="State, errors and the result of the last procedure, every 100 ms.",
    source=NEW,
    examples=[
        (
            "061#00 00 00 04 01 01 01 00",
            {"node": 3, "error": ["spinout"], "state": "idle", "result": "busy", "trajectory_done": 1},
        )
    ],
)
takes(
    "Estop",
    0x02,
    doc="Disarm the axis, with an error that has to be cleared.",
    source=OLD,
    examples=[("062#", {"node": 3}), ("7C2#", {"node": 0x3E})],
)
tells(
    "MotorError",
    0x03,
    Struct("error" / Int64ul),
    dialect="0.5",
    doc="Error bits of the motor.",
    source=OLD,
    examples=[("063#10 00 00 00 02 00 00 00", {"node": 3, "error": 0x2_0000_0010})],
)
tells(
    "Errors",
    0x03,
    Struct("active" / Flags(Int32ul, ERRORS), "disarm_reason" / Flags(Int32ul, ERRORS)),
    dialect="0.6",
    doc="Errors that are there, and those that disarmed the axis.",
    source=NEW,
    examples=[
        (
            "063#00 02 00 00 00 02 00 04",
            {"node": 3, "active": ["under_voltage"], "disarm_reason": ["under_voltage", "spinout"]},
        )
    ],
)
for name, command, part, example in (
    ("EncoderError", 0x04, "encoder", ("064#04 01 00 00 00 00 00 00", {"node": 3, "error": 0x104})),
    ("SensorlessError", 0x05, "sensorless estimator", ("065#01 02 00 00 00 00 00 00", {"node": 3, "error": 0x201})),
    ("ControllerError", 0x1D, "controller", ("07D#01 00 00 80 00 00 00 00", {"node": 3, "error": 0x8000_0001})),
):  # fmt: skip
    tells(
        name,
        command,
        Struct("error" / Int32ul, "padding" / Reserved(4)),
        dialect="0.5",
        doc=f"Error bits of the {part}.",
        source=OLD,
        examples=[example],
    )
takes(
    "ClearErrors",
    0x18,
    dialect="0.5",
    doc="Clear all errors.",
    source=OLD,
    examples=[("078#", {"node": 3})],
)
takes(
    "ClearErrors",
    0x18,
    Struct("identify" / Byte),
    dialect="0.6",
    doc="Clear all errors; identify 1: blink.",
    source=NEW,
    examples=[("078#01", {"node": 3, "identify": 1})],
)

# ---------------------------------------------------------------------- control

takes(
    "SetAxisState",
    0x07,
    **four("state", Enumeration(Int32ul, STATES)),
    doc="Bring the axis into another state.",
    source=OLD,
    examples=[("067#08 00 00 00", {"node": 3, "state": "closed_loop"})],
)
takes(
    "SetControllerModes",
    0x0B,
    Struct(
        "control" / Enumeration(Int32ul, voltage=0, torque=1, velocity=2, position=3),
        "input"
        / Enumeration(
            Int32ul, inactive=0, passthrough=1, velocity_ramp=2, position_filter=3, mix=4, trapezoid=5, torque_ramp=6,
            mirror=7, tuning=8,
        ),
    ),
    doc="What is controlled, and how set-points are taken.",
    source=OLD,
    examples=[("06B#02 00 00 00 02 00 00 00", {"node": 3, "control": "velocity", "input": "velocity_ramp"})],
)  # fmt: skip
takes(
    "SetInputPosition",
    0x0C,
    Struct(
        "position" / REV,
        "velocity" / Quantity(Int16sl, scale=0.001, unit="rev/s"),
        "torque" / Quantity(Int16sl, scale=0.001, unit="N·m"),
    ),
    doc="Where to go, with what is fed forward (0.6: in units that can be configured; these are the usual ones).",
    source=OLD,
    examples=[
        ("06C#00 00 C0 3F FA 00 83 FF", {"node": 3, "position": 1.5, "velocity": 0.25, "torque": -0.125})
    ],
)
takes(
    "SetInputVelocity",
    0x0D,
    Struct("velocity" / REV_S, "torque" / NEWTON_METRE),
    doc="How fast to turn, with the torque that is fed forward.",
    source=OLD,
    examples=[("06D#00 00 20 C0 00 00 00 3E", {"node": 3, "velocity": -2.5, "torque": 0.125})],
)
takes(
    "SetInputTorque",
    0x0E,
    **four("torque", NEWTON_METRE),
    doc="Which torque to give.",
    source=OLD,
    examples=[
        ("06E#00 00 00 BF", {"node": 3, "torque": -0.5, "more": b""}),
        ("06E#00 00 00 BF 00 00 00 00", {"node": 3, "torque": -0.5, "more": bytes(4)}),
    ],
)
takes(
    "SetLimits",
    0x0F,
    Struct("velocity" / REV_S, "current" / AMPERE),
    doc="The greatest velocity and current.",
    source=OLD,
    examples=[("06F#00 00 A0 41 00 00 28 41", {"node": 3, "velocity": 20.0, "current": 10.5})],
)
takes(
    "StartAnticogging",
    0x10,
    dialect="0.5",
    doc="Calibrate against cogging: it moves.",
    source=OLD,
    examples=[("070#", {"node": 3})],
)
takes(
    "SetTrajectoryVelocity",
    0x11,
    **four("velocity", REV_S),
    doc="Speed of trapezoids.",
    source=OLD,
    examples=[("071#00 00 48 41", {"node": 3, "velocity": 12.5})],
)
takes(
    "SetTrajectoryAcceleration",
    0x12,
    Struct(
        "acceleration" / Quantity(Float32l, unit="rev/s²"),
        "deceleration" / Quantity(Float32l, unit="rev/s²"),
    ),
    doc="Acceleration and deceleration of trapezoids.",
    source=OLD,
    examples=[("072#00 00 20 40 00 00 80 40", {"node": 3, "acceleration": 2.5, "deceleration": 4.0})],
)
takes(
    "SetTrajectoryInertia",
    0x13,
    **four("inertia", Quantity(Float32l, unit="N·m/(rev/s²)")),
    doc="Torque that is fed forward for an acceleration.",
    source=OLD,
    examples=[("073#00 00 80 3E", {"node": 3, "inertia": 0.25})],
)
takes(
    "SetPositionGain",
    0x1A,
    **four("gain", Quantity(Float32l, unit="(rev/s)/rev")),
    doc="The position controller's gain.",
    source=OLD,
    examples=[("07A#00 00 A0 41", {"node": 3, "gain": 20.0})],
)
takes(
    "SetVelocityGains",
    0x1B,
    Struct(
        "gain" / Quantity(Float32l, unit="N·m/(rev/s)"), "integrator" / Quantity(Float32l, unit="N·m/rev")
    ),
    doc="The velocity controller's gains.",
    source=OLD,
    examples=[("07B#00 00 40 3E 00 00 A0 3E", {"node": 3, "gain": 0.1875, "integrator": 0.3125})],
)
takes(
    "SetLinearCount",
    0x19,
    dialect="0.5",
    **four("count", Int32sl),
    doc="The present position, in counts of the encoder.",
    source=OLD,
    examples=[("079#18 FC FF FF", {"node": 3, "count": -1000})],
)
takes(
    "SetAbsolutePosition",
    0x19,
    dialect="0.6",
    **four("position", REV),
    doc="The present position.",
    source=NEW,
    examples=[("079#00 00 A0 BF", {"node": 3, "position": -1.25})],
)

# ---------------------------------------------------------------------- what is measured

tells(
    "EncoderEstimates",
    0x09,
    Struct("position" / REV, "velocity" / REV_S),
    doc="Position and velocity, every 10 ms.",
    source=OLD,
    examples=[("069#00 00 80 BE 00 00 00 40", {"node": 3, "position": -0.25, "velocity": 2.0})],
)
tells(
    "EncoderCount",
    0x0A,
    Struct("shadow" / Int32sl, "in_cpr" / Int32sl),
    dialect="0.5",
    doc="Counts of the encoder: over all turns, and within one.",
    source=OLD,
    examples=[("06A#18 FC FF FF 18 1C 00 00", {"node": 3, "shadow": -1000, "in_cpr": 7192})],
)
tells(
    "Iq",
    0x14,
    Struct("setpoint" / AMPERE, "measured" / AMPERE),
    doc="The current that makes torque.",
    source=OLD,
    examples=[("074#00 00 C0 3F 00 00 A0 BF", {"node": 3, "setpoint": 1.5, "measured": -1.25})],
)
tells(
    "SensorlessEstimates",
    0x15,
    Struct("position" / REV, "velocity" / REV_S),
    dialect="0.5",
    doc="What is estimated without an encoder.",
    source=OLD,
    examples=[("075#00 00 40 3F 00 00 20 C0", {"node": 3, "position": 0.75, "velocity": -2.5})],
)
tells(
    "Temperature",
    0x15,
    Struct("inverter" / CELSIUS, "motor" / CELSIUS),
    dialect="0.6",
    doc="Temperatures of the transistors and of the motor.",
    source=NEW,
    examples=[("075#00 00 FC 41 00 00 80 C0", {"node": 3, "inverter": 31.5, "motor": -4.0})],
)
tells(
    "BusVoltageCurrent",
    0x17,
    Struct("voltage" / VOLT, "current" / AMPERE),
    doc="Voltage and current of the supply (up to 0.5.5 the voltage alone, current 0).",
    source=OLD,
    examples=[("077#00 00 C4 41 00 00 40 BF", {"node": 3, "voltage": 24.5, "current": -0.75})],
)
odrive.message(
    "GetAdcVoltage",
    id=Node << 5 | 0x1C,
    direction="to device",
    dialect="0.5",
    payload=Struct("gpio" / Byte),
    doc="Ask for the voltage at a pin (0.5.6).",
    source=OLD,
    examples=[("07C#04", {"node": 3, "gpio": 4})],
)
odrive.message(
    "AdcVoltage",
    id=Node << 5 | 0x1C,
    direction="from device",
    dialect="0.5",
    payload=Struct("voltage" / VOLT, "padding" / Reserved(4)),
    doc="The voltage at a pin.",
    source=OLD,
    examples=[("07C#00 00 50 40 00 00 00 00", {"node": 3, "voltage": 3.25})],
)
tells(
    "Torques",
    0x1C,
    Struct("target" / NEWTON_METRE, "estimate" / NEWTON_METRE),
    dialect="0.6",
    doc="Torque: wanted, and estimated from the current.",
    source=NEW,
    examples=[("07C#00 00 00 BF 00 00 E0 BE", {"node": 3, "target": -0.5, "estimate": -0.4375})],
)
tells(
    "Powers",
    0x1D,
    Struct("electrical" / WATT, "mechanical" / WATT),
    dialect="0.6",
    doc="Power: from the supply, and at the shaft.",
    source=NEW,
    examples=[("07D#00 00 40 C2 00 00 80 C2", {"node": 3, "electrical": -48.0, "mechanical": -64.0})],
)

# ---------------------------------------------------------------------- addresses, versions, parameters

takes(
    "SetNodeId",
    0x06,
    dialect="0.5",
    **four("new_node", Int32ul),
    doc="Another number.",
    source=OLD,
    examples=[("066#3E 00 00 00", {"node": 3, "new_node": 0x3E})],
)
ADDRESS: dict[str, Any] = {
    "payload": Struct(
        "address" / Byte,
        "serial_number" / BytesInteger(6, swapped=True),
        "connection" / Default(GreedyBytes, b""),
    ),
    "length": (7, 8),
    "dialect": "0.6",
    "source": NEW,
}
odrive.message(
    "SetAddress",
    id=ADDRESSES,
    direction="to device",
    doc="Give the drive with this serial number a node; the connection (a byte) came with 0.6.11.",
    examples=[
        ("7E6#05 31 33 6B 39 68 30", {"address": 5, "serial_number": 0x3068396B3331, "connection": b""})
    ],
    **ADDRESS,
)
odrive.message(
    "Discover",
    id=ADDRESSES,
    remote=True,
    direction="to device",
    dialect="0.6",
    doc="Ask everybody for node and serial number.",
    source=RESOURCES,
    examples=[("7E6#R", {})],
)
odrive.message(
    "Address",
    id=Node << 5 | 0x06,
    direction="from device",
    doc="Node and serial number.",
    examples=[
        (
            "0A6#05 31 33 6B 39 68 30 02",
            {"node": 5, "address": 5, "serial_number": 0x3068396B3331, "connection": b"\x02"},
        )
    ],
    **ADDRESS,
)
tells(
    "Version",
    0x00,
    Struct(
        "protocol_version" / Byte, "hardware_line" / Byte, "hardware_version" / Byte, "hardware_variant" / Byte,
        "major" / Byte, "minor" / Byte, "revision" / Byte, "unreleased" / Byte,
    ),
    dialect="0.6",
    doc="Versions of the protocol, the hardware and the firmware.",
    source=NEW,
    examples=[
        (
            "060#02 04 05 3A 00 06 0B 01",
            {
                "node": 3, "protocol_version": 2, "hardware_line": 4, "hardware_version": 5, "hardware_variant": 58,
                "major": 0, "minor": 6, "revision": 11, "unreleased": 1,
            },
        )
    ],
)  # fmt: skip
PARAMETER = ("endpoint" / Int16ul, "reserved_byte" / Reserved(1), "value" / Default(GreedyBytes, b""))
takes(
    "RxSdo",
    0x04,
    Struct("opcode" / Enumeration(Byte, read=0, write=1), *PARAMETER),
    dialect="0.6",
    doc="Read or write a parameter (or call a function) by the number that this very firmware gives it.",
    source=RESOURCES,
    examples=[
        ("064#00 23 01 00", {"node": 3, "opcode": "read", "endpoint": 0x123, "value": b""}),
        ("064#01 23 01 00 00 00 A0 3F", {"node": 3, "opcode": "write", "value": bytes.fromhex("0000A03F")}),
    ],
)
odrive.message(
    "TxSdo",
    id=Node << 5 | 0x05,
    direction="from device",
    dialect="0.6",
    payload=Struct("opcode" / Byte, *PARAMETER),
    doc="The parameter's value (from 0.6.11 on writes are confirmed, too).",
    source=RESOURCES,
    examples=[
        (
            "065#00 23 01 00 00 00 A0 3F",
            {"node": 3, "opcode": 0, "endpoint": 0x123, "value": bytes.fromhex("0000A03F")},
        )
    ],
)
takes("Reboot", 0x16, dialect="0.5", doc="Boot anew.", source=OLD, examples=[("076#", {"node": 3})])
takes(
    "Reboot",
    0x16,
    Struct("action" / Enumeration(Byte, reboot=0, save=1, erase=2)),
    dialect="0.6",
    doc="Boot anew; save: with the present configuration, erase: as from the factory.",
    source=RESOURCES,
    examples=[("076#02", {"node": 3, "action": "erase"})],
)
takes(
    "EnterDfu",
    0x1F,
    dialect="0.6",
    doc="Wait for a new firmware.",
    source=NEW,
    examples=[("07F#", {"node": 3})],
)
