"""Law 1 has exceptions: they are listed field by field, with a reason, and there are no more than these."""

from __future__ import annotations

from aces_protocols.vectornav_text.spec import vectornav_text

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
    # DroneCAN's float16 is IEEE 754's.
    "dronecan": {
        "NaN of half precision": {"EscStatus.voltage", "EscStatus.current", "EscStatus.temperature"}
    },
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
    "vectornav_text": {"case of a check": {f"{name}.check" for name in vectornav_text.messages}},
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
    "robstride_mit": {
        # Positions, speeds and limits of these modes are single-precision floats.
        "signalling NaN": {
            "Position.position",
            "Position.velocity_limit",
            "Velocity.velocity",
            "Velocity.current_limit",
        }
    },
}


def test_exceptions_are_few() -> None:
    """Counted, so that the list does not grow unseen; those of a protocol in two formats once."""
    once = {id(kinds): kinds for kinds in LISTED.values()}
    assert sum(len(fields) for kinds in once.values() for fields in kinds.values()) == 128
