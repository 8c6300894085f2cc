"""Every worked example of the sources of Hubo's CAN protocol, both ways.

Bytes of an example are written out here, never made by the code under test.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from aces_bus import as_dict
from aces_protocols.hubo.spec import hubo
from tests.protocols.hubo_frames import (
    DEFAULT,
    DRC,
    HUBO2,
    SHEET,
    frame,
    names,
    read,
    same,
    written,
)

Example = tuple[str, str, str, str, dict[str, Any]]

#: The variant, the frame, its message, what it is, its fields.
# fmt: off
COMMANDS: list[Example] = [
    (HUBO2, "001#24 0D 00 00 00 00 00 00", "PwmFingersD08", "right hand off, as recorded",
     {"board": 0x24, "mode": "off", "duty": [0, 0, 0, 0, 0], "reserved": 0}),
    (HUBO2, "001#00 07 C8 00 00 00 F4 01", "PositionGainA", "gains of a leg",
     {"board": 0, "kp": 200, "ki": 0, "kd": 500}),
    (HUBO2, "001#00 11 11 48 A8 00 00 08", "HomeD08", "home RHY −18600 counter-clockwise, high byte first",
     {"board": 0, "direction": "ccw", "motor": "motor_1", "offset": [-18600, 0], "reserved": 0}),
    (SHEET, "001#00 11 11 A8 48 00 00 08", "HomeD08X", "home RHY −18600 counter-clockwise, low byte first",
     {"board": 0, "direction": "ccw", "motor": "motor_1", "offset": [-18600, 0], "reserved": 0}),
    (HUBO2, "001#00 11 20 00 00 3A 98 00", "HomeD08", "home RHR +15000 clockwise, high byte first",
     {"board": 0, "direction": "cw", "motor": "motor_2", "offset": [0, 15000], "reserved": 0}),
    (SHEET, "001#00 11 20 00 00 98 3A 00", "HomeD08X", "home RHR +15000 clockwise, low byte first",
     {"board": 0, "direction": "cw", "motor": "motor_2", "offset": [0, 15000], "reserved": 0}),
    (HUBO2, "001#09 11 20 00 00 38 80 10", "HomeD08", "home REB +80000 clockwise, an offset of 17 bits",
     {"board": 9, "direction": "cw", "motor": "motor_2", "offset": [0, 80000], "reserved": 0}),
    (HUBO2, "001#20 11 11 19 40 32 32", "Home3D08", "home RWY, 16 bits of −72000 and five turns",
     {"board": 0x20, "direction": "ccw", "motor": "motor_1", "pulses": 72000 % 65536,
      "revolutions": [5.0, 5.0], "reserved": 0}),
    (SHEET, "001#20 11 11 40 19 0A 0A", "Home3D08X", "home RWY in the sheet's byte order, one turn",
     {"board": 0x20, "direction": "ccw", "motor": "motor_1", "pulses": 0x1940, "revolutions": [1.0, 1.0],
      "reserved": 0}),
    (HUBO2, "001#24 11 04 04 04 04 04", "Home5D08", "drive the fingers home",
     {"board": 0x24, "power": [4, 4, 4, 4, 4]}),
    (DEFAULT, "001#05 11 12 00 00 00 00 00", "Home", "home of motor 1",
     {"board": 5, "stored": 1, "motor": "motor_1", "reserved": 0}),
    (DEFAULT, "001#00 11 22 00 00 00 00 00", "Home", "home of motor 2",
     {"board": 0, "stored": 1, "motor": "motor_2", "reserved": 0}),
    (DEFAULT, "001#00 11 F2 00 00 00 00 00", "Home", "home of all motors",
     {"board": 0, "stored": 1, "motor": "all", "reserved": 0}),
    (HUBO2, "001#00 0D 01 00 05 01 06", "PwmD08", "drive two motors of Hubo 2",
     {"board": 0, "mode": "on", "direction": ["plus", "minus"], "duty": [5, 6]}),
    (HUBO2, "001#20 0D 01 01 05 10 06 07", "Pwm3D08", "drive three motors: the last two share a byte",
     {"board": 0x20, "mode": "on", "direction": ["minus", "plus", "minus"], "duty": [5, 6, 7]}),
    (HUBO2, "001#24 0D 01 04 14 0F 1F 00", "PwmFingersD08", "fingers, five bits each",
     {"board": 0x24, "mode": "on", "duty": [4, -4, 15, -15, 0], "reserved": 0}),
    (DEFAULT, "001#24 0D 01 00 19 99 64 E4", "PwmFingers", "fingers, eight bits each",
     {"board": 0x24, "mode": "on", "duty": [0, 25, -25, 100, -100]}),
    (DEFAULT, "001#00 0D 01 00 05 01 64 00", "Pwm", "drive two motors in percent",
     {"board": 0, "mode": "on", "direction": ["cw", "ccw"], "duty": [5, 100], "reserved": 0}),
    (DRC, "001#24 0D 01 19 99 00", "Pwm3", "drive three motors in percent",
     {"board": 0x24, "mode": "on", "duty": [25, -25, 0]}),
    (DEFAULT, "001#30 81 00", "NullSensor", "null the right foot", {"board": 0x30, "what": "force_torque"}),
    (DEFAULT, "001#30 81 04", "NullSensor", "null the right foot's tilt", {"board": 0x30, "what": "tilt"}),
    (DEFAULT, "001#32 81", "NullImu", "null the IMU", {"board": 0x32}),
    (DEFAULT, "001#30 FA AA", "InitSensor", "initialise a foot", {"board": 0x30}),
    (DEFAULT, "001#03 FA", "InitBoard", "initialise a motor board", {"board": 3}),
    (DEFAULT, "001#0E E0", "PowerQuery", "ask for power", {"board": 0x0E}),
    (DEFAULT, "001#24 23 07", "DeadZone", "dead zone of channel 3",
     {"board": 0x24, "channel": 3, "dead_zone": 7}),
    (DRC, "001#0A 30 14 00 14 05 00 00", "HomeSearch", "home search of LSP, as saved from a robot",
     {"board": 0x0A, "channel": 0, "limit": 20, "direction": "cw", "offset": 1300}),
    (DEFAULT, "001#00 39 A0 CF", "EncoderResolution", "encoder word",
     {"board": 0, "channel": 1, "resolution": 4000, "auto_scale": 1, "direction": "cw"}),
    (DRC, "001#23 50 03 F1 67 FD FF", "LowerLimit", "lower limit of WST, as saved from a robot",
     {"board": 0x23, "channel": 0, "options": ["enable", "update"], "limit": -169999}),
    (DEFAULT, "001#23 56 00 10 98 02 00", "UpperLimit", "upper limit, switched off",
     {"board": 0x23, "channel": 0, "options": [], "limit": 170000}),
    (DEFAULT, "001#00 F2 E8 03 F4 01 32 14", "JamLimits", "jam limits",
     {"board": 0, "jam_time": 1000, "saturation_time": 500, "limit_duty": 50, "jam_duty": 20}),
    (DEFAULT, "001#00 61 96 0A 05 02 1E", "HomingSpeed", "homing speed",
     {"board": 0, "channel": 1, "acceleration": 1.5, "velocity_to_switch": 10, "velocity_to_offset": 5,
      "mode": "mechanical_stop", "duty": 30}),
    (DEFAULT, "001#0E 83 03", "Beep", "beep for 0.3 s", {"board": 0x0E, "time": 0.3}),
]

REFERENCES: list[Example] = [
    (DEFAULT, "010#56 7C 00 E0 3E 80", "Reference", "RHY +0.2 rad, RHR −0.05 rad",
     {"board": 0, "position": [31830, -16096]}),
    (DEFAULT, "011#BC 31 80 BC 31 80", "Reference", "RHP −0.1 rad, repeated in the empty slot",
     {"board": 1, "position": [-12732, -12732]}),
    (HUBO2, "030#FF FF 2E FB 00 00", "Reference3D08", "wrists of Hubo 2",
     {"board": 0x20, "position": [-1, -1234, 0]}),
    (DRC, "034#BC 31 80 05 85", "ReferenceHand", "a hand of DRC-Hubo, fingers ±0.05 A",
     {"board": 0x24, "position": -12732, "finger": [0.05, -0.05]}),
]

REPLIES: list[Example] = [
    (DEFAULT, "060#BC 31 00 00 44 CE FF FF", "Encoder", "encoders of a leg",
     {"board": 0, "position": [12732, -12732]}),
    (DEFAULT, "062#44 CE FF FF", "EncoderShort", "encoder of a knee in four bytes",
     {"board": 2, "position": [-12732], "rest": b""}),
    (HUBO2, "080#FF FF 2E FB 00 00 00 00", "Encoder3", "encoders of a wrist in eight bytes",
     {"board": 0x20, "position": [-1, -1234, 0], "rest": b"\0\0"}),
    (DEFAULT, "084#FF FF 2E FB 01 00", "Encoder5", "encoders of the first fingers",
     {"board": 0x24, "position": [-1, -1234, 1]}),
    (DEFAULT, "084#FF FF 2E FB", "Encoder5Upper", "encoders of the last fingers",
     {"board": 0x24, "position": [-1, -1234]}),
    (DEFAULT, "06E#C0 12 D2 04 57 17", "Power", "power board",
     {"board": 0x0E, "voltage": 48.0, "current": 12.34, "power": 597.5, "rest": b""}),
    (DEFAULT, "150#63 04 00 00 00 00 00 00", "Status", "running, homed, big error",
     {"board": 0,
      "motor": [{"drive": ["driver_on", "control_on"], "home": "homed", "errors": ["big_error"], "reserved": 0},
                {"drive": [], "home": 0, "errors": [], "reserved": 0}]}),
    (DRC, "174#03 43 83", "Status3", "three motors",
     {"board": 0x24,
      "motor": [["driver_on", "control_on"], ["driver_on", "control_on", "big_error"],
                ["driver_on", "control_on", "encoder_error"]],
      "rest": b""}),
    (HUBO2, "150#00 00 00 00 00 05 0A", "StatusD08", "home search done and failed, where acesHubo reads it",
     {"board": 0, "board_state": 0, "motor_state": [0, 0], "motor_control": [0, 0],
      "motor": [{"origin": "ok", "limit_switch": "ok", "encoder": "none", "reserved": 0},
                {"origin": "fail", "limit_switch": "fail", "encoder": "none", "reserved": 0}],
      "rest": b""}),
    (SHEET, "150#00 00 00 00 00 00 15 0A", "StatusD08X", "home search done and failed, where the sheet has it",
     {"board": 0, "state": bytes(6),
      "motor": [{"origin": "ok", "limit_switch": "ok", "encoder": "ok", "reserved": 0},
                {"origin": "fail", "limit_switch": "fail", "encoder": "none", "reserved": 0}]}),
    (HUBO2, "120#84 0D 00 00 45 0F 00 00", "Pm", "z-phase values",
     {"board": 0, "z_phase": [3460, 3909], "reserved": 0}),
    (HUBO2, "190#0A 0A 0A", "NameInfoReply", "answer of a leg board to NameInfo",
     {"board": 0, "period": 10, "limit": [10, 10]}),
    (HUBO2, "1B0#0A 0A 05 05", "NameInfoReply", "answer of a wrist board to NameInfo",
     {"board": 0x20, "period": 10, "limit": [10, 5, 5]}),
    (DEFAULT, "240#05 00 01", "SensorBoardInfo", "answer of a foot to GetBoardInfo",
     {"board": 0x30, "period": 5, "rest": b"\0\1"}),
    (DEFAULT, "1C0#22 00 29 09", "Current", "current 1.37 A and 0.02 A, 41 °C",
     {"board": 0, "current": [1.37, 0.02], "temperature": 41, "reserved": 0}),
    (DRC, "1E4#FA 7D 29 19", "Current3", "currents of a three-channel board",
     {"board": 0x24, "current": [1.0, 0.5, 0.1], "temperature": 41}),
    (DEFAULT, "1E4#01 02 03 00 04 FF", "Current5", "currents of five fingers",
     {"board": 0x24, "current": [0.001, 0.002, 0.003, 0.004, 0.255], "reserved": 0}),
]

SENSORS: list[Example] = [
    (HUBO2, "002#00", "SensorRequestD08", "every sensor, D08", {"mode": "all"}),
    (DEFAULT, "002#01 12", "ForceTorqueRequest", "force/torque of the right foot",
     {"sensor": 1, "mode": "ft_scaled"}),
    (DEFAULT, "002#02 22", "TiltRequest", "tilt of the left foot", {"sensor": 2, "mode": "tilt_scaled"}),
    (DEFAULT, "002#FF 02", "SensorRequest", "all of all sensors", {"sensor": 0xFF, "mode": "scaled"}),
    (DEFAULT, "002#03 00 01", "ImuRequest", "the pelvis IMU", {"sensor": 3, "select": "imu"}),
    (DEFAULT, "053#6A FF 4B 00 2E FB 2C 01", "Imu", "IMU −1.5°, 0.75°, −12.34 °/s, 3 °/s",
     {"sensor": 3, "roll": -1.5, "pitch": 0.75, "roll_rate": -12.34, "pitch_rate": 3.0}),
    (HUBO2, "041#85 FF C8 01 C9 09", "ForceTorqueD08", "force/torque of Hubo 2, in digits",
     {"sensor": 1, "mx": -123, "my": 456, "fz": 2505}),
    (HUBO2, "053#6A FF 4B 00 2E FB 2C 01", "ImuD08", "acceleration and rotation of Hubo 2, in digits",
     {"sensor": 3, "acceleration": [-150, 75], "gyro": [-1234, 300]}),
    (HUBO2, "321#01 00 FF FF 02 00", "AdOffset", "A/D offsets", {"sensor": 1, "mx": 1, "my": -1, "fz": 2}),
    (HUBO2, "311#01 00 FF FF 02 00", "DaOffset", "D/A offsets", {"sensor": 1, "mx": 1, "my": -1, "fz": 2}),
    (HUBO2, "331#01 00 FF FF", "OffsetPair", "offset pair", {"sensor": 1, "ad": 1, "da": -1}),
]
# fmt: on

EXAMPLES = COMMANDS + REFERENCES + REPLIES + SENSORS


@pytest.mark.parametrize(
    ("label", "text", "message", "what", "fields"), EXAMPLES, ids=[e[3] for e in EXAMPLES]
)
def test_a_worked_example_reads_and_writes_as_its_source_has_it(
    label: str, text: str, message: str, what: str, fields: dict[str, Any]
) -> None:
    """A frame of the sources gives its message and fields; the fields give the frame back, bit for bit."""
    (found,) = read(label, text)
    assert names([found]) == [message]
    assert same(as_dict(found), fields), found
    given = {name: value for name, value in fields.items() if name not in ("reserved", "rest") or value}
    assert written(label, message, given) == text


#: Board and data of the 20 set-up commands that were sent to a Hubo 2, with limits and z-phase references.
NAME_INFO: list[tuple[str, str, dict[str, Any]]] = [
    ("00 01 0A 0A 0A 84 45 FD", "NameInfo", {"limit": [10, 10], "z_phase": [3460, 3909]}),
    ("01 01 0A 0A 00 01 00 0A", "NameInfo", {"limit": [10, 0], "z_phase": [2561, 0]}),
    ("02 01 0A 14 00 B3 00 0C", "NameInfo", {"limit": [20, 0], "z_phase": [3251, 0]}),
    ("03 01 0A 0A 0A A6 A7 DA", "NameInfo", {"limit": [10, 10], "z_phase": [2726, 3495]}),
    ("04 01 0A 0A 0A 05 76 B0", "NameInfo", {"limit": [10, 10], "z_phase": [5, 2934]}),
    ("05 01 0A 0A 00 33 00 0C", "NameInfo", {"limit": [10, 0], "z_phase": [3123, 0]}),
    ("06 01 0A 14 00 E8 00 0B", "NameInfo", {"limit": [20, 0], "z_phase": [3048, 0]}),
    ("07 01 0A 0A 0A B3 95 60", "NameInfo", {"limit": [10, 10], "z_phase": [179, 1685]}),
    ("08 01 0A 0F 05 D2 D8 5A", "NameInfo", {"limit": [15, 5], "z_phase": [2770, 1496]}),
    ("09 01 0A 05 14 A2 20 C4", "NameInfo", {"limit": [5, 20], "z_phase": [1186, 3104]}),
    ("0A 01 0A 14 05 CD 49 43", "NameInfo", {"limit": [20, 5], "z_phase": [973, 1097]}),
    ("0B 01 0A 05 14 29 1E 97", "NameInfo", {"limit": [5, 20], "z_phase": [1833, 2334]}),
    ("20 01 0A 0A 0A 0A 00", "NameInfo3", {"limit": [10, 10, 10], "unused": b"\0"}),
    ("21 01 0A 0A 05 05 00", "NameInfo3", {"limit": [10, 5, 5], "unused": b"\0"}),
    ("22 01 0A 05 05 05 00", "NameInfo3", {"limit": [5, 5, 5], "unused": b"\0"}),
    ("23 01 0A 0A 00 9F 00 0A", "NameInfo", {"limit": [10, 0], "z_phase": [2719, 0]}),
    ("24 01 0A", "NameInfo5", {}),
    ("25 01 0A", "NameInfo5", {}),
    ("35 01 0A 00 38 72 12 00", "NameInfoSensor", {"tail": bytes.fromhex("0038721200")}),
    ("36 01 0A 00 38 72 12 00", "NameInfoSensor", {"tail": bytes.fromhex("0038721200")}),
]


@pytest.mark.parametrize("label", [HUBO2, SHEET])
@pytest.mark.parametrize(("data", "message", "rest"), NAME_INFO, ids=[row[0][:2] for row in NAME_INFO])
def test_each_set_up_command_of_a_robot_reads_and_writes(
    label: str, data: str, message: str, rest: dict[str, Any]
) -> None:
    """The 20 genuine NameInfo frames give board, period, limits and z-phase references, and come back from them."""
    (found,) = read(label, f"001#{data}")
    fields = {"board": int(data[:2], 16), "period": 10, **rest}
    assert names([found]) == [message]
    assert as_dict(found) == fields
    assert written(label, message, fields) == f"001#{data}"
    assert all(z < 4000 for z in rest.get("z_phase", ())), "an encoder turn has 4000 counts"


def test_the_recorded_set_up_program_is_read_whole(shared_captures: Path) -> None:
    """All frames of the shared recording are NameInfo, with the values that another program found in them."""
    known = json.loads((shared_captures / "expected.json").read_text(encoding="utf-8"))
    name = "hubo-can/nameinfo_commands.candump"
    lines = [line.split() for line in (shared_captures / name).read_text(encoding="utf-8").splitlines()]
    frames = [frame(text, time=float(time[1:-1]), channel=bus) for time, bus, text in lines]
    scanner = hubo.scanner(dialect="D08", configuration="hubo2", include_unknown=True)
    found = scanner.feed(frames)
    expected = known[name]["frames"]
    assert (scanner.counts.decoded, scanner.counts.total) == (len(expected), len(expected))
    for record, wanted in zip(found, expected, strict=True):
        assert type(record).__name__.startswith("NameInfo")
        assert record.meta.channel == f"can{wanted['bus']}"
        assert record.meta.identifier == wanted["can_id"]
        assert record.meta.raw == bytes.fromhex(wanted["data"])
        assert (record.board, record.period) == (wanted["board"], wanted["interp_ms"])
        if "ref_z_ch0" in wanted:
            assert record.limit == (wanted["limit_ch0"], wanted["limit_ch1"])
            assert record.z_phase == (wanted["ref_z_ch0"], wanted["ref_z_ch1"])
        if "limits" in wanted:
            assert list(record.limit) == wanted["limits"]
