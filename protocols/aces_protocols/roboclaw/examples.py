"""Worked examples by message, as `examples=` takes them.

1. Requests are the bytes that tcr-roboclaw 0.1.5 writes, with what it was asked to write; of `GoBothWithSpeedTo`, which it
   writes as another command, the manual's.
2. Answers, to address 80, are made of the manual's tables with Python's `struct`, their CRC with `binascii.crc_hqx`; the
   text is the manual's.
"""

from __future__ import annotations

from typing import Any

EXAMPLES: dict[str, list[tuple[Any, ...]]] = {
    "ForwardM1": [("83 00 40 2A CE", {"address": 0x83, "speed": 64})],
    "BackwardM1": [("83 01 7F DE 43", {"address": 0x83, "speed": 127})],
    "ForwardM2": [("83 04 01 BE EF", {"address": 0x83, "speed": 1})],
    "BackwardM2": [("83 05 00 9D FF", {"address": 0x83, "speed": 0})],
    "BothWaysM1": [("83 06 60 A4 0A", {"address": 0x83, "speed": 96})],
    "BothWaysM2": [("83 07 20 DF FF", {"address": 0x83, "speed": 32})],
    "MixedForward": [("83 08 05 BB 06", {"address": 0x83, "speed": 5})],
    "MixedBackward": [("83 09 06 B8 54", {"address": 0x83, "speed": 6})],
    "MixedRight": [("83 0A 07 FD 26", {"address": 0x83, "speed": 7})],
    "MixedLeft": [("83 0B 08 3F F8", {"address": 0x83, "speed": 8})],
    "MixedBothWays": [("83 0C 09 B6 4E", {"address": 0x83, "speed": 9})],
    "MixedTurn": [("83 0D 0A B5 1C", {"address": 0x83, "speed": 10})],
    "SetSerialTimeout": [("83 0E 0F B0 EA", {"address": 0x83, "timeout": 1.5})],
    "ResetEncoders": [("83 14 1C 7E", {"address": 0x83})],
    "SetEncoderM1": [("83 16 FF FF FF F9 2A 16", {"address": 0x83, "position": -7})],
    "SetEncoderM2": [("83 17 00 01 11 70 00 AB", {"address": 0x83, "position": 70000})],
    "SetSpeedGainsM1": [
        (
            "83 1C 00 00 20 00 00 01 80 00 00 00 40 00 00 00 AB E0 CA FC",
            {"address": 0x83, "p": 1.5, "i": 0.25, "d": 0.125, "full_speed": 44000},
        )
    ],
    "SetSpeedGainsM2": [
        (
            "83 1D 00 04 00 00 00 02 00 00 00 00 00 00 00 00 00 09 87 3E",
            {"address": 0x83, "p": 2.0, "i": 0.0, "d": 4.0, "full_speed": 9},
        )
    ],
    "DriveDutyM1": [("83 20 C0 00 D6 76", {"address": 0x83, "duty": -16384 / 32767})],
    "DriveDutyM2": [("83 21 7F FF F1 85", {"address": 0x83, "duty": 1.0})],
    "DriveDuties": [("83 22 00 01 FF FF 7C C8", {"address": 0x83, "m1": 1 / 32767, "m2": -1 / 32767})],
    "DriveSpeedM1": [("83 23 FF FF FF FB 25 ED", {"address": 0x83, "speed": -5})],
    "DriveSpeedM2": [("83 24 00 00 2E E0 43 B5", {"address": 0x83, "speed": 12000})],
    "DriveSpeeds": [("83 25 00 00 00 01 FF FF FF FE A6 74", {"address": 0x83, "m1": 1, "m2": -2})],
    "RampSpeedM1": [
        ("83 26 00 00 00 03 FF FF FF FC EF F1", {"address": 0x83, "acceleration": 3, "speed": -4})
    ],
    "RampSpeedM2": [
        ("83 27 00 00 00 05 00 00 00 06 00 3D", {"address": 0x83, "acceleration": 5, "speed": 6})
    ],
    "RampSpeeds": [
        (
            "83 28 00 00 00 07 00 00 00 08 FF FF FF F7 57 AE",
            {"address": 0x83, "acceleration": 7, "m1": 8, "m2": -9},
        )
    ],
    "GoDistanceM1": [
        (
            "83 29 FF FF FF F6 00 00 00 0B 01 80 D6",
            {"address": 0x83, "speed": -10, "distance": 11, "at_once": 1},
        )
    ],
    "GoDistanceM2": [
        (
            "83 2A 00 00 00 0C 00 00 00 0D 00 21 23",
            {"address": 0x83, "speed": 12, "distance": 13, "at_once": 0},
        )
    ],
    "RampDistanceM1": [
        (
            "83 2C 00 00 00 01 FF FF FF FE 00 00 00 03 01 BA 1D",
            {"address": 0x83, "acceleration": 1, "speed": -2, "distance": 3, "at_once": 1},
        )
    ],
    "RampDistanceM2": [
        (
            "83 2D 00 00 00 04 00 00 00 05 00 00 00 06 00 03 C5",
            {"address": 0x83, "acceleration": 4, "speed": 5, "distance": 6, "at_once": 0},
        )
    ],
    "SetMainVoltageLimits": [("83 39 00 3C 01 54 27 D6", {"address": 0x83, "lowest": 6.0, "highest": 34.0})],
    "SetLogicVoltageLimits": [("83 3A 00 37 00 78 EF 2A", {"address": 0x83, "lowest": 5.5, "highest": 12.0})],
    "SetPositionGainsM1": [
        (
            "83 3D 00 00 20 00 00 00 08 00 00 00 02 00 00 00 00 64 00 00 00 05 FF FF FC 18 00 00 03 E8 D1 B1",
            {
                "address": 0x83,
                "p": 2.0,
                "i": 0.5,
                "d": 8.0,
                "most_integral": 100,
                "deadzone": 5,
                "lowest": -1000,
                "highest": 1000,
            },
        )
    ],
    "RampToM1": [
        (
            "83 41 00 00 00 01 00 00 00 02 00 00 00 03 FF FF FF FC 01 18 8E",
            {"address": 0x83, "acceleration": 1, "speed": 2, "deceleration": 3, "position": -4, "at_once": 1},
        )
    ],
    "RampToM2": [
        (
            "83 42 00 00 00 05 00 00 00 06 00 00 00 07 00 00 00 08 00 5F 86",
            {"address": 0x83, "acceleration": 5, "speed": 6, "deceleration": 7, "position": 8, "at_once": 0},
        )
    ],
    "SetDutyAccelerationM1": [("83 44 00 09 FF FF 01 30", {"address": 0x83, "acceleration": 655359})],
    "SetDutyAccelerationM2": [("83 45 00 00 00 01 38 DE", {"address": 0x83, "acceleration": 1})],
    "SetDefaultSpeedM1": [("83 46 7F FF EF 7E", {"address": 0x83, "speed": 1.0})],
    "SetDefaultSpeedM2": [("83 47 00 00 DE D9", {"address": 0x83, "speed": 0.0})],
    "SetDeadband": [("83 4C 19 32 81 D2", {"address": 0x83, "backward": 2.5, "forward": 5.0})],
    "SetEncoderModeM1": [("83 5C 81 A8 71", {"address": 0x83, "mode": ["absolute", "for_rc_and_analog"]})],
    "SetEncoderModeM2": [("83 5D 20 3E 8B", {"address": 0x83, "mode": ["motor_reversed"]})],
    "SetSpeedErrorLimits": [("83 6D 00 00 00 01 00 00 00 02 79 FE", {"address": 0x83, "m1": 1, "m2": 2})],
    "SetPositionErrorLimits": [("83 70 00 00 00 03 00 00 00 04 50 76", {"address": 0x83, "m1": 3, "m2": 4})],
    "GoToM1": [("83 77 FF FF FF FB 01 FF D3", {"address": 0x83, "position": -5, "at_once": 1})],
    "GoToM2": [("83 78 00 00 00 06 00 91 03", {"address": 0x83, "position": 6, "at_once": 0})],
    "GoBothTo": [
        ("83 79 00 00 00 07 FF FF FF F8 01 97 B8", {"address": 0x83, "m1": 7, "m2": -8, "at_once": 1})
    ],
    "GoWithSpeedToM1": [
        (
            "83 7A 00 00 00 09 FF FF FF F6 01 85 DB",
            {"address": 0x83, "speed": 9, "position": -10, "at_once": 1},
        )
    ],
    "GoWithSpeedToM2": [
        (
            "83 7B 00 00 00 0B 00 00 00 0C 00 53 9A",
            {"address": 0x83, "speed": 11, "position": 12, "at_once": 0},
        )
    ],
    "SetPositionGainsM2": [
        (
            "83 3E 00 00 10 00 00 00 04 00 00 00 00 00 00 00 00 09 00 00 00 08 00 00 00 07 00 00 00 06 91 9B",
            {
                "address": 0x83,
                "p": 1.0,
                "i": 0.0,
                "d": 4.0,
                "most_integral": 9,
                "deadzone": 8,
                "lowest": 7,
                "highest": 6,
            },
        )
    ],
    "GoDistances": [
        (
            "83 2B FF FF FF FF 00 00 00 02 00 00 00 03 00 00 00 04 01 A1 AB",
            {
                "address": 0x83,
                "speed_m1": -1,
                "distance_m1": 2,
                "speed_m2": 3,
                "distance_m2": 4,
                "at_once": 1,
            },
        )
    ],
    "RampDistances": [
        (
            "83 2E 00 00 00 09 00 00 00 01 00 00 00 02 FF FF FF FD 00 00 00 04 00 7E FE",
            {
                "address": 0x83,
                "acceleration": 9,
                "speed_m1": 1,
                "distance_m1": 2,
                "speed_m2": -3,
                "distance_m2": 4,
                "at_once": 0,
            },
        )
    ],
    "RampSpeedsApart": [
        (
            "83 32 00 00 00 01 FF FF FF FE 00 00 00 03 00 00 00 04 81 7C",
            {"address": 0x83, "acceleration_m1": 1, "speed_m1": -2, "acceleration_m2": 3, "speed_m2": 4},
        )
    ],
    "RampDistancesApart": [
        (
            "83 33 00 00 00 01 00 00 00 02 00 00 00 03 00 00 00 04 FF FF FF FB 00 00 00 06 01 88 1B",
            {
                "address": 0x83,
                "acceleration_m1": 1,
                "speed_m1": 2,
                "distance_m1": 3,
                "acceleration_m2": 4,
                "speed_m2": -5,
                "distance_m2": 6,
                "at_once": 1,
            },
        )
    ],
    "RampDutyM1": [
        ("83 34 FF FE 00 00 03 E8 20 8B", {"address": 0x83, "duty": -2 / 32767, "acceleration": 1000})
    ],
    "RampDutyM2": [("83 35 7F FF 00 09 FF FF 4C 70", {"address": 0x83, "duty": 1.0, "acceleration": 655359})],
    "RampDuties": [
        (
            "83 36 FF FE 00 00 00 01 00 04 00 00 00 03 33 DE",
            {
                "address": 0x83,
                "acceleration_m1": 1,
                "duty_m1": -2 / 32767,
                "acceleration_m2": 3,
                "duty_m2": 4 / 32767,
            },
        )
    ],
    "RampBothTo": [
        (
            "83 43 00 00 00 01 00 00 00 02 00 00 00 03 FF FF FF FC 00 00 00 05 00 00 00 06 00 00 00 07 00 00 00 08 01 0B 88",
            {
                "address": 0x83,
                "acceleration_m1": 1,
                "speed_m1": 2,
                "deceleration_m1": 3,
                "position_m1": -4,
                "acceleration_m2": 5,
                "speed_m2": 6,
                "deceleration_m2": 7,
                "position_m2": 8,
                "at_once": 1,
            },
        )
    ],
    "GoBothWithSpeedTo": [
        (
            "83 7C 00 00 00 01 FF FF FF FE 00 00 00 03 00 00 00 04 00 F7 BD",
            {
                "address": 0x83,
                "speed_m1": 1,
                "position_m1": -2,
                "speed_m2": 3,
                "position_m2": 4,
                "at_once": 0,
            },
        )
    ],
    "SetCurrentLimitM1": [("83 85 00 00 05 DC 00 00 00 00 62 4D", {"address": 0x83, "highest": 15.0})],
    "SetCurrentLimitM2": [("83 86 00 00 00 01 00 00 00 00 1A 90", {"address": 0x83, "highest": 0.01})],
    "SerialTimeout": [("05 7B C1", {"timeout": 0.5}, "80 0F")],
    "MainVoltage": [("01 2C E1 25", {"voltage": 30.0}, "80 18")],
    "LogicVoltage": [("00 32 16 DB", {"voltage": 5.0}, "80 19")],
    "Duties": [("80 01 40 00 3F 0A", {"m1": -1.0, "m2": 16384 / 32767}, "80 30")],
    "Currents": [("00 7B FF 9C 1B AC", {"m1": 1.23, "m2": -1.0}, "80 31")],
    "MainVoltageLimits": [("00 3C 01 54 AD B5", {"lowest": 6.0, "highest": 34.0}, "80 3B")],
    "LogicVoltageLimits": [("00 37 00 78 EC 4F", {"lowest": 5.5, "highest": 12.0}, "80 3C")],
    "DefaultSpeeds": [("7F FF 00 00 9E 9D", {"m1": 1.0, "m2": 0.0}, "80 48")],
    "Deadband": [("19 32 2D 3E", {"backward": 2.5, "forward": 5.0}, "80 4D")],
    "DutyAccelerations": [("00 09 FF FF 00 00 00 01 36 CD", {"m1": 655359, "m2": 1}, "80 51")],
    "Temperature": [("00 FB B3 E2", {"temperature": 25.1}, "80 52")],
    "Temperature2": [("FF F1 26 67", {"temperature": -1.5}, "80 53")],
    "Status": [("00 01 00 40 F8 48", {"status": ["driver_m1", "warning_current_m1"]}, "80 5A")],
    "EncoderModes": [
        (
            "81 60 37 08",
            {"m1": ["absolute", "for_rc_and_analog"], "m2": ["motor_reversed", "encoder_reversed"]},
            "80 5B",
        )
    ],
    "SpeedErrorLimits": [("00 00 00 01 00 00 00 02 E5 75", {"m1": 1, "m2": 2}, "80 6E")],
    "PositionErrorLimits": [("00 00 00 03 00 00 00 04 0A 9A", {"m1": 3, "m2": 4}, "80 71")],
    "CurrentLimitM1": [("00 00 05 DC 00 00 00 00 15 E5", {"highest": 15.0, "lowest": 0.0}, "80 87")],
    "CurrentLimitM2": [("00 00 00 01 00 00 00 00 D8 28", {"highest": 0.01, "lowest": 0.0}, "80 88")],
    "EncoderM1": [("FF FF FF FE 03 6F BF", {"position": -2, "status": ["underflow", "backward"]}, "80 10")],
    "EncoderM2": [("00 01 11 70 04 BE E7", {"position": 70000, "status": ["overflow"]}, "80 11")],
    "SpeedM1": [("FF FF 54 20 01 BF F8", {"speed": -44000, "backward": 1}, "80 12")],
    "SpeedM2": [("00 00 00 01 00 4C AC", {"speed": 1, "backward": 0}, "80 13")],
    "RawSpeedM1": [("00 00 01 2C 00 45 65", {"speed": 300, "backward": 0}, "80 1E")],
    "RawSpeedM2": [("FF FF FE D4 01 54 E3", {"speed": -300, "backward": 1}, "80 1F")],
    "Encoders": [("80 10 00 00 00 00 00 01 12 41", {"m1": -2146435072, "m2": 1}, "80 4E")],
    "RawSpeeds": [("00 00 01 2C FF FF FD A8 30 39", {"m1": 300, "m2": -600}, "80 4F")],
    "MeanSpeeds": [("00 00 01 2D FF FF FD A9 00 F1", {"m1": 301, "m2": -599}, "80 6C")],
    "SpeedErrors": [("FF FF FF FF 00 00 00 02 9B 29", {"m1": -1, "m2": 2}, "80 6F")],
    "PositionErrors": [("00 00 00 03 FF FF FF FC CE F6", {"m1": 3, "m2": -4}, "80 72")],
    "Buffers": [("80 00 6C 57", {"m1": 128, "m2": 0}, "80 2F")],
    "SpeedGainsM1": [
        (
            "00 01 00 00 00 00 80 00 00 00 40 00 00 00 AB E0 AB C0",
            {"p": 1.0, "i": 0.5, "d": 0.25, "full_speed": 44000},
            "80 37",
        )
    ],
    "SpeedGainsM2": [
        (
            "00 02 00 00 00 00 00 00 00 04 00 00 00 00 00 09 5F 3A",
            {"p": 2.0, "i": 0.0, "d": 4.0, "full_speed": 9},
            "80 38",
        )
    ],
    "PositionGainsM1": [
        (
            "00 00 08 00 00 00 02 00 00 00 20 00 00 00 00 64 00 00 00 05 FF FF FC 18 00 00 03 E8 46 EB",
            {
                "p": 2.0,
                "i": 0.5,
                "d": 8.0,
                "most_integral": 100,
                "deadzone": 5,
                "lowest": -1000,
                "highest": 1000,
            },
            "80 3F",
        )
    ],
    "PositionGainsM2": [
        (
            "00 00 04 00 00 00 00 00 00 00 10 00 00 00 00 09 00 00 00 08 00 00 00 07 00 00 00 06 02 B6",
            {"p": 1.0, "i": 0.0, "d": 4.0, "most_integral": 9, "deadzone": 8, "lowest": 7, "highest": 6},
            "80 40",
        )
    ],
    "Version": [
        (
            "52 6F 62 6F 43 6C 61 77 20 31 30 2E 32 41 20 76 34 2E 31 2E 31 31 0A 00 3A D5",
            {"version": "RoboClaw 10.2A v4.1.11"},
            "80 15",
        )
    ],
}
