"""Law 1 has exceptions: they are listed field by field, with a reason, and there are no more than these."""

from __future__ import annotations

import struct

import pytest
from construct import Byte, Construct, Float16l, Float32l, Struct, VarInt

from aces_bus.protocol import Message, Protocol, SignMagnitude
from aces_bus.testing import laws
from aces_bus.testing.exemptions import KINDS, Kind, are_excused
from tests.laws.wires import REGISTERED
from tests.specs.catalogue import SPECS

#: Sentences of NMEA 0183 that receivers of satellites send.
POSITIONS = ("GGA", "RMC", "GSA", "GSV", "VTG", "GLL", "GNS", "GST", "ZDA")
#: Modes and registers of Damiao motors are single-precision floats.
DAMIAO = {
    "signalling NaN": {
        "PositionVelocity.position",
        "PositionVelocity.velocity_limit",
        "Velocity.velocity",
        "ForcePosition.position",
        "ReadFloatReply.value",
        "WriteFloat.value",
        "WriteFloatReply.value",
    }
}
#: Protocol → kind → fields whose bytes do not all survive. A new entry needs the source that makes it so.
LISTED: dict[str, dict[str, set[str]]] = {
    "database_like": {
        "NaN of half precision": {"Beside.r2"},
        "signalling NaN": {"Floats.aligned", "Nested.ratio"},
    },
    "damiao": DAMIAO,
    "damiao_fd": DAMIAO,
    "hubo": {
        # The boards' set-points and duties are sign and magnitude (hubo-ach, hubo-daemon.c).
        "negative zero": {
            "Reference.position",
            "ReferenceHand.position",
            "ReferenceHand.finger",
            "ReferenceHandPosition.position",
            "HomeD08.offset",
            "HomeD08X.offset",
            "PwmFingersD08.duty",
            "PwmFine.duty",
            "Pwm3.duty",
            "PwmFingers.duty",
        }
    },
    "mavlink1": {
        # MAVLink's float is IEEE 754 single precision.
        "signalling NaN": {
            "ParamValue.value",
            "Attitude.roll",
            "Attitude.pitch",
            "Attitude.yaw",
            "Attitude.roll_rate",
            "Attitude.pitch_rate",
            "Attitude.yaw_rate",
            "AttitudeQuaternion.quaternion",
            "AttitudeQuaternion.rates",
            "CommandLong.params",
        }
    },
    "mit_motor": {
        # Damiao's modes and registers are single-precision floats.
        "signalling NaN": {
            "PositionVelocity.position",
            "PositionVelocity.velocity_limit",
            "Velocity.velocity",
            "ForcePosition.position",
            "ReadFloatReply.value",
            "WriteFloat.value",
            "WriteFloatReply.value",
        }
    },
    "nmea0183": {
        # The standard writes upper case; receivers write either.
        "case of a check": {f"{name}.check" for name in (*POSITIONS, "HDT", "HDM", "HDG", "ROT")}
    },
    "dronecan_like": {
        # DSDL has numbers of half precision.
        "NaN of half precision": {"EscStatus.voltage", "EscStatus.current", "EscStatus.temperature"},
    },
    "odrive": {
        # CAN Simple's numbers are single-precision floats.
        "signalling NaN": {
            "SetInputPosition.position",
            "SetInputVelocity.velocity",
            "SetInputVelocity.torque",
            "SetInputTorque.torque",
            "SetLimits.velocity",
            "SetLimits.current",
            "SetTrajectoryVelocity.velocity",
            "SetTrajectoryAcceleration.acceleration",
            "SetTrajectoryAcceleration.deceleration",
            "SetTrajectoryInertia.inertia",
            "SetPositionGain.gain",
            "SetVelocityGains.gain",
            "SetVelocityGains.integrator",
            "SetAbsolutePosition.position",
            "EncoderEstimates.position",
            "EncoderEstimates.velocity",
            "Iq.setpoint",
            "Iq.measured",
            "SensorlessEstimates.position",
            "SensorlessEstimates.velocity",
            "Temperature.inverter",
            "Temperature.motor",
            "BusVoltageCurrent.voltage",
            "BusVoltageCurrent.current",
            "AdcVoltage.voltage",
            "Torques.target",
            "Torques.estimate",
            "Powers.electrical",
            "Powers.mechanical",
        }
    },
    "odrive_like": {
        "signalling NaN": {
            "EncoderEstimates.position",
            "EncoderEstimates.velocity",
            "SetInputPosition.position",
        }
    },
    "rmdx": {
        # Gains of protocol V4.2 are single-precision floats.
        "signalling NaN": {
            f"{name}.value" for name in ("Gain", "SetGain", "SetGainDone", "StoreGain", "StoreGainDone")
        }
    },
    "robstride": {
        # Parameters are single-precision floats.
        "signalling NaN": {
            "FloatParameter.value",
            "WriteFloat.value",
        }
    },
}

#: Protocols all of whose single-precision floats are such fields, by their guides: kind → how many.
COUNTED: dict[str, dict[str, int]] = {"sbf": {"signalling NaN": 200}, "vectornav": {"signalling NaN": 64}}


@pytest.mark.parametrize("name", [*REGISTERED, *SPECS])
def test_exceptions_are_listed(name: str) -> None:
    """No field of a protocol loses bytes that this list does not name."""
    protocol = {**REGISTERED, **SPECS}[name]
    found: dict[str, set[str]] = {}
    for message in protocol.declared:
        for exemption in laws.exemptions(message):
            found.setdefault(exemption.kind.name, set()).add(f"{message.name}.{exemption.field}")
    if name in COUNTED:
        assert {kind: len(fields) for kind, fields in found.items()} == COUNTED[name]
    else:
        assert found == LISTED.get(name, {})


def test_exceptions_are_few() -> None:
    """Counted, so that the list does not grow unseen; those of a protocol in two formats once."""
    once = {id(kinds): kinds for kinds in LISTED.values()}
    assert sum(len(fields) for kinds in once.values() for fields in kinds.values()) == 92


#: Of each kind: a field, bytes that do not survive, and what comes back.
SHOWN: dict[str, tuple[Construct, bytes, bytes]] = {
    "negative zero": (SignMagnitude(16), b"\x00\x80", b"\x00\x00"),
    "signalling NaN": (Float32l, struct.pack("<I", 0x7F80_0001), struct.pack("<I", 0x7FC0_0001)),
    "NaN of half precision": (Float16l, b"\x01\x7e", b"\x00\x7e"),
    "overlong number": (VarInt, b"\x85\x00", b"\x05"),
}


def _message(field: Construct) -> Message:
    made = Protocol("shown", link="can")
    return made.message("Shown", id=1, payload=Struct("field" / field, "other" / Byte))


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_each_exception_is_needed(kind: Kind) -> None:
    """The bytes shown really do not survive, and what comes back reads the same."""
    field, before, after = SHOWN[kind.name]
    message = _message(field)
    head = bytes((0, 0, 0, 1, 0))
    image, rebuilt = head + before + b"\x2a", head + after + b"\x2a"
    assert [e.kind.name for e in laws.exemptions(message)] == [kind.name]
    parsed = message.struct.parse(image, raw=True)
    assert message.struct.build(parsed, raw=True) == rebuilt
    assert are_excused(message, image, rebuilt)


def test_the_case_of_a_check_is_excused() -> None:
    """A check in lower-case hexadecimal is read and written back in upper case; no other byte may differ."""
    message = REGISTERED["nmea0183"]["ZDA"]
    sentence = b"$GNZDA,103607.00,06,03,2021,00,00*%b\r\n"
    lower, upper = sentence % b"7f", sentence % b"7F"
    assert message.struct.build(message.struct.parse(lower, raw=True), raw=True) == upper
    assert are_excused(message, lower, upper)
    assert not are_excused(message, lower, upper.replace(b"2021", b"2022"))


def test_nothing_else_is_excused() -> None:
    """A difference outside the listed bits is a fault, also in a message that has an exception."""
    message = _message(SignMagnitude(16))
    head = bytes((0, 0, 0, 1, 0))
    assert are_excused(message, head + b"\x00\x80\x2a", head + b"\x00\x00\x2a")
    assert not are_excused(message, head + b"\x00\x80\x2a", head + b"\x00\x00\x2b")
    assert not are_excused(message, head + b"\x00\x80\x2a", head + b"\x00\x00")
    assert not are_excused(_message(Byte), head + b"\x00\x2a", head + b"\x01\x2a")
