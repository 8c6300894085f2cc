"""Hubo's CAN protocol: every worked example of its sources, both ways, and what bytes alone do not say.

1. Bytes of an example are written out here, never made by the code under test.
2. A frame is written `ID#DATA`, as candump writes it; a variant `D12@hubo2plus`, as the command line takes it.
"""

from __future__ import annotations

import doctest
import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pytest
from construct import Byte, Struct

from aces_bus.errors import FieldError, SpecError, UnknownNameError
from aces_bus.frames import Frame
from aces_bus.protocol import FlagSet, IdField, Protocol, Scanner, Unknown, Variant, as_dict, make_scanner
from aces_protocols.hubo import spec
from aces_protocols.hubo.parameters import selectors
from aces_protocols.hubo.spec import hubo

README = Path(spec.__file__).with_name("README.md").read_text(encoding="utf-8")
DEFAULT = "D12@hubo2plus"
HUBO2 = "D08@hubo2"
SHEET = "D08X@hubo2"
DRC = "D12@drc_hubo"


def frame(text: str, *, time: float | None = None, channel: str | None = None) -> Frame:
    identifier, _, data = text.partition("#")
    return Frame(int(identifier, 16), bytes.fromhex(data), timestamp=time, channel=channel)


def variant(label: str) -> Variant:
    dialect, _, configuration = label.partition("@")
    return hubo.variant(dialect, configuration)


def opened(label: str = DEFAULT) -> Scanner:
    return make_scanner([variant(label)], include_unknown=True)


def read(label: str, *frames: str) -> list[Any]:
    """What each frame is, read in one go."""
    scanner = opened(label)
    found = scanner.feed([frame(text) for text in frames])
    assert len(found) == len(frames)
    assert scanner.counts.balance == 0
    return found


def written(label: str, message: str, fields: dict[str, Any]) -> str:
    made = variant(label).encoder.encode(message, **fields)
    return f"{made.arbitration_id:03X}#{bytes(made.data).hex(' ').upper()}"


def names(found: Iterable[Any]) -> list[str]:
    return [f.reason if isinstance(f, Unknown) else type(f).__name__ for f in found]


def same(one: Any, other: Any) -> bool:
    """Equal, floats up to rounding."""
    if isinstance(one, dict) and isinstance(other, dict):
        return one.keys() == other.keys() and all(same(value, other[name]) for name, value in one.items())
    if isinstance(one, list) and isinstance(other, list):
        return len(one) == len(other) and all(map(same, one, other))
    if isinstance(one, FlagSet) and isinstance(other, list):
        return list(one) == other and not one.unknown
    return bool(one == pytest.approx(other)) if isinstance(other, float) else bool(one == other)


# ---------------------------------------------------------------------- worked examples

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


# ---------------------------------------------------------------------- numbers


@pytest.mark.parametrize(
    ("value", "data"),
    [
        (0, "00 00 00"),
        (1, "01 00 00"),
        (-1, "01 00 80"),
        (12732, "BC 31 00"),
        (-12732, "BC 31 80"),
        (123456, "40 E2 01"),
        (-123456, "40 E2 81"),
        (8388607, "FF FF 7F"),
        (-8388607, "FF FF FF"),
    ],
)
def test_references_are_sign_and_magnitude(value: int, data: str) -> None:
    """Three bytes, the top bit being the sign, in each slot."""
    text = f"013#{data} {data}"
    (found,) = read(DEFAULT, text)
    assert found.position == (value, value)
    assert written(DEFAULT, "Reference", {"board": 3, "position": [value, value]}) == text


def test_negative_zero_is_zero() -> None:
    """A reference of minus nothing reads as 0, and 0 is written without a sign."""
    (found,) = read(DEFAULT, "013#00 00 80 00 00 80")
    assert found.position == (0, 0)
    assert written(DEFAULT, "Reference", {"board": 3, "position": [0, 0]}) == "013#00 00 00 00 00 00"


@pytest.mark.parametrize(
    ("label", "message", "fields"),
    [
        (DEFAULT, "Reference", {"board": 3, "position": [8388608, 0]}),
        (DEFAULT, "Reference", {"board": 3, "position": [0, -8388608]}),
        (DRC, "ReferenceHand", {"board": 0x24, "position": 0, "finger": [0.11, 0]}),
        (DRC, "ReferenceNeck", {"board": 0x22, "position": [3.15, 0, 0]}),
        (DEFAULT, "PwmFingers", {"board": 0x24, "mode": "on", "duty": [101, 0, 0, 0, 0]}),
        (DEFAULT, "PwmFine", {"board": 0, "duty": [100.1, 0]}),
        (HUBO2, "PwmFingersD08", {"board": 0x24, "mode": "on", "duty": [16, 0, 0, 0, 0]}),
        (HUBO2, "HomeD08", {"board": 0, "direction": "cw", "motor": "motor_1", "offset": [0x80000, 0]}),
    ],
)
def test_a_value_too_large_is_refused(label: str, message: str, fields: dict[str, Any]) -> None:
    """Nothing is cut to fit: the programs that drove the robots did that, and sent something else."""
    with pytest.raises(FieldError, match=message):
        written(label, message, fields)


@pytest.mark.parametrize(
    ("percent", "data"),
    [
        (5.0, "00 32"),
        (-5.0, "01 32"),
        (30.0, "10 2C"),
        (-30.0, "11 2C"),
        (100.0, "30 E8"),
        (-100.0, "31 E8"),
    ],
)
def test_fine_duties_have_their_sign_beside_their_high_bits(percent: float, data: str) -> None:
    """A tenth of a percent in twelve bits over two bytes, clockwise being negative, on either channel."""
    text = f"001#00 0D 03 {data} {data}"
    (found,) = read(DEFAULT, text)
    assert type(found).__name__ == "PwmFine"
    assert found.duty == pytest.approx((percent, percent))
    assert written(DEFAULT, "PwmFine", {"board": 0, "duty": [percent, percent]}) == text


def test_a_hand_reads_within_a_count_of_what_is_meant_by_a_scale_of_4095() -> None:
    """hubo-ach writes neck angles in 4095ths of a turn; read in 4096ths they are less than two counts off."""
    for count, angle in ((2047, 0.0), (2373, 0.5), (1721, -0.5)):
        data = count.to_bytes(2, "little").hex() * 3
        (found,) = read(DRC, f"032#{data}")
        assert type(found).__name__ == "ReferenceNeck"
        assert found.position == pytest.approx((angle,) * 3, abs=2 * 6.2832 / 4096)
        (reply,) = read(DRC, f"082#{data}")
        assert type(reply).__name__ == "EncoderNeck"
        assert reply.position == found.position
    assert written(DRC, "ReferenceNeck", {"board": 0x22, "position": [0, 0, 0]}) == "032#00 08 00 08 00 08"


# ---------------------------------------------------------------------- opcodes

#: The opcodes of the sources, by dialect; 0x24 is not the dead zone of channel 4, so that has four.
_BOTH = {
    0x02,
    0x03,
    0x04,
    0x06,
    0x07,
    0x08,
    0x09,
    0x0A,
    0x0B,
    0x0D,
    0x0E,
    0x0F,
    0x10,
    0x11,
    0x01,
    0x81,
    0x82,
    0x83,
}
_OLD = {0x05, 0x0C, 0x12, 0x84, 0x85, 0x86, 0x87, 0x88, 0x89}
_BY_CHANNEL = {base + channel for base in (0x30, 0x38, 0x40, 0x50, 0x56, 0x60) for channel in range(5)}
_NEW = {0x13, 0x24, 0x6F, 0xE0, 0xF0, 0xF2, 0xF3, 0xFA, *range(0x20, 0x24)} | _BY_CHANNEL
OPCODES = {"D08": _BOTH | _OLD, "D08X": _BOTH | _OLD, "D12": _BOTH | _NEW}


@pytest.mark.parametrize("dialect", OPCODES)
def test_every_opcode_of_the_sources_is_a_command(dialect: str) -> None:
    """Each dialect has the opcodes that its sources list with a meaning, and no other."""
    found = set()
    for message in hubo.declared:
        if message.dialects is None or dialect in message.dialects:
            for head in message.heads_written:
                if head.name == "opcode" and head.pattern is not None:
                    found |= set(head.pattern)
    assert found == OPCODES[dialect]


def test_a_channel_in_an_opcode_is_a_field() -> None:
    """Opcodes 0x30…0x34 are one message whose record says the channel; 0x35 is none."""
    for channel in range(5):
        (found,) = read(DEFAULT, f"001#24 {0x30 + channel:02X} 14 01 00 00 00 00")
        assert (type(found).__name__, found.channel) == ("HomeSearch", channel)
    assert names(read(DEFAULT, "001#24 35 14 01 00 00 00 00")) == ["unknown"]
    with pytest.raises(FieldError, match="channel"):
        written(
            DEFAULT, "HomeSearch", {"board": 0x24, "channel": 5, "limit": 20, "direction": "cw", "offset": 0}
        )


def test_the_dead_zone_of_channel_4_cannot_be_said() -> None:
    """Its opcode would be 0x24, which asks for parameters."""
    assert names(read(DEFAULT, "001#24 24 07")) == ["GetParameters"]
    with pytest.raises(FieldError, match="channel"):
        written(DEFAULT, "DeadZone", {"board": 0x24, "channel": 4, "dead_zone": 7})


def test_what_hubo_ach_sends_is_read_as_it_is() -> None:
    """A status request with a stray third byte and a switching mode without its mode are known."""
    status, switching = read(DEFAULT, "001#00 02 11", "001#00 13")
    assert (type(status).__name__, status.rest) == ("SendStatus", b"\x11")
    assert type(switching).__name__ == "SwitchingModeShort"
    assert written(DEFAULT, "SendStatus", {"board": 0}) == "001#00 02"


# ---------------------------------------------------------------------- status

DRIVE = {0: "driver_on", 1: "control_on", 2: "current_mode", 3: "limit_switch"}
ERRORS = {
    8: "jam",
    9: "saturated",
    10: "big_error",
    11: "encoder_error",
    12: "driver_fault",
    13: "motor_fail_0",
    14: "motor_fail_1",
    16: "below_minimum",
    17: "above_maximum",
    18: "velocity_error",
    19: "acceleration_error",
    20: "temperature_error",
}


@pytest.mark.parametrize("motor", [0, 1])
def test_every_bit_of_a_status_has_its_name(motor: int) -> None:
    """One bit at a time: its name and no other, in the motor whose four bytes hold it; nameless bits are kept."""
    for bit in range(32):
        data = (1 << 32 * motor + bit).to_bytes(8, "little")
        (found,) = read(DEFAULT, f"150#{data.hex()}")
        told, silent = found.motor[motor], found.motor[1 - motor]
        assert (list(silent.drive), silent.home, list(silent.errors)) == ([], 0, [])
        assert list(told.drive) == ([DRIVE[bit]] if bit in DRIVE else [])
        assert list(told.errors) == ([ERRORS[bit]] if bit in ERRORS else [])
        if 4 <= bit < 8:
            assert told.home == {5: "wrist_roll_homed"}.get(bit, 1 << bit - 4)
        if bit in (15, 21, 22, 23):
            assert told.errors.unknown == 1 << bit - 8
        if bit >= 24:
            assert told.reserved == 1 << bit


def test_one_channel_boards_may_leave_the_second_motor_out() -> None:
    """Four bytes are a status of a knee; of a hip with two motors they are too short."""
    knee, hip = read(DEFAULT, "152#63 04 00 00", "150#63 04 00 00")
    assert (type(knee).__name__, knee.motor[0].home) == ("StatusShort", "homed")
    assert hip.reason == "malformed: length 4, Status has 8 bytes"


def test_five_motors_share_one_form_of_status_byte() -> None:
    """Bits 0–7 of each byte, for each finger; bytes behind them are kept."""
    (found,) = read(DEFAULT, "174#01 02 04 08 F0 00 AA")
    assert [list(m) for m in found.motor] == [
        ["driver_on"],
        ["control_on"],
        ["current_mode"],
        ["limit_switch"],
        ["jam", "saturated", "big_error", "encoder_error"],
    ]
    assert found.rest == b"\x00\xaa"


# ---------------------------------------------------------------------- parameters and currents at 0x1C0

#: Reply and fields of each block, but board and selector.
BLOCKS: dict[int, tuple[str, dict[str, Any]]] = {
    1: (
        "C8 00 01 00 F4 01 A0 4F",
        {"kp": 200, "ki": 1, "kd": 500, "resolution": 4000, "auto_scale": 1, "direction": "ccw"},
    ),
    2: (
        "05 00 01 02 14 00 2C CF",
        {
            "dead_zone": 5,
            "search_direction": "ccw",
            "search_mode": "mechanical_stop",
            "search_limit": 20,
            "home_offset_low": 53036,
        },
    ),
    3: (
        "FF FF F1 67 FD FF 11 98",
        {
            "home_offset_high": -65536,
            "lower_limit_enabled": 1,
            "lower_limit": -170000,
            "upper_limit_enabled": 1,
            "upper_limit_low": 170000 - 2 * 65536,
        },
    ),
    4: (
        "02 00 D0 07 E8 03 64 00",
        {"upper_limit_high": 2 * 65536, "max_acceleration": 2000, "max_velocity": 1000, "max_pwm": 100},
    ),
    5: ("64 00 00 00 0A 00 0B 00", {"max_current": 100, "unused": b"\0\0", "kpt": 10, "kdt": 11}),
    6: ("0C 00 01 02 03 04 05 06", {"kft": 12, "sums": bytes([1, 2, 3, 4, 5, 6])}),
    20: (
        "03 00 05 00 02 00 96 00",
        {"number": 3, "period": 5, "board_type": 2, "unused": b"\0", "homing_acceleration": 1.5},
    ),
    21: (
        "0A 00 05 00 E8 03 F4 01",
        {"velocity_to_switch": 10, "velocity_to_offset": 5, "jam_time": 1000, "saturation_time": 500},
    ),
    22: (
        "32 14 D0 07 20 4E 0A 00",
        {"limit_duty": 50, "jam_duty": 20, "max_step": 2000, "max_error": 20000, "max_encoder_error": 10},
    ),
}


def asked(block: int) -> tuple[int, ...]:
    return (block,) if block >= 20 else selectors(block)


@pytest.mark.parametrize("block", BLOCKS)
def test_a_parameter_block_is_known_by_its_request(block: int) -> None:
    """Request and reply give the block's fields and the selector, for every channel; the fields give the reply back."""
    data, fields = BLOCKS[block]
    for selector in asked(block):
        request, reply = read(DEFAULT, f"001#24 24 {selector:02X}", f"1E4#{data}")
        assert (type(request).__name__, request.selector) == ("GetParameters", selector)
        assert type(reply).__name__ == f"Parameters{block}"
        assert same(as_dict(reply), {"board": 0x24, "selector": selector, **fields})
        assert written(DEFAULT, f"Parameters{block}", {"board": 0x24, **fields}) == f"1E4#{data}"


def test_selectors_count_six_a_channel_and_leave_20_to_22_to_the_board() -> None:
    """Channel 2 ends at 18, channel 3 begins at 24; no selector means two blocks."""
    every = [s for block in range(1, 7) for s in selectors(block)]
    assert sorted(every) == [*range(1, 19), *range(24, 36)]
    assert selectors(1) == (1, 7, 13, 24, 30)


def test_halves_of_a_number_add_up_over_blocks() -> None:
    """A home offset of −12500 and an upper limit of 170000, switched on, come back from blocks 2, 3 and 4."""
    found = read(
        DEFAULT,
        *("001#23 24 02", f"1E3#{BLOCKS[2][0]}"),
        *("001#23 24 03", f"1E3#{BLOCKS[3][0]}"),
        *("001#23 24 04", f"1E3#{BLOCKS[4][0]}"),
    )
    two, three, four = found[1::2]
    assert three.home_offset_high + two.home_offset_low == -12500
    assert four.upper_limit_high + three.upper_limit_low == 170000
    assert (three.lower_limit, three.lower_limit_enabled, three.upper_limit_enabled) == (-170000, 1, 1)


PARAMETERS = BLOCKS[1][0]
NEEDS = "unknown: needs request GetParameters|SendCurrent"


def test_a_reply_without_its_request_stays_unknown() -> None:
    """Eight bytes at 0x1C0 are nothing by themselves, and their record says which request was missed."""
    (lost,) = read(DEFAULT, f"1C0#{PARAMETERS}")
    assert lost.reason == NEEDS
    assert lost.meta.raw == bytes.fromhex(PARAMETERS)


def test_a_request_is_answered_once() -> None:
    """The second reply to one request is unknown again."""
    found = read(DEFAULT, "001#00 24 01", f"1C0#{PARAMETERS}", f"1C0#{PARAMETERS}")
    assert names(found) == ["GetParameters", "Parameters1", NEEDS]


def test_a_request_to_another_board_or_bus_does_not_count() -> None:
    """Requests are told apart by board and by channel."""
    assert names(read(DEFAULT, "001#01 24 01", f"1C0#{PARAMETERS}"))[1] == NEEDS
    scanner = opened()
    asked_on, answered_on = frame("001#00 24 01", channel="can0"), frame(f"1C0#{PARAMETERS}", channel="can1")
    assert names(scanner.feed([asked_on, answered_on]))[1] == NEEDS


def test_a_selector_that_nobody_knows_answers_nothing() -> None:
    """Selector 23 is free: its reply is unknown, not some block."""
    assert names(read(DEFAULT, "001#00 24 17", f"1C0#{PARAMETERS}"))[1].startswith("unknown")


def test_the_same_bytes_are_currents_or_parameters_as_asked() -> None:
    """One reply, two meanings: the last open request of its board decides."""
    data = "22 00 29 09 00 00 00 00"
    found = read(DEFAULT, "001#00 04", f"1C0#{data}", "001#00 24 05", f"1C0#{data}")
    assert names(found) == ["SendCurrent", "CurrentPadded", "GetParameters", "Parameters5"]
    assert found[1].current == pytest.approx((1.37, 0.02))
    assert found[1].temperature == 41
    assert found[3].max_current == 0x22


def test_our_own_request_opens_a_reply() -> None:
    """A request that we send (and that no adapter echoes) counts as one that was seen."""
    scanner = opened()
    scanner.sent(frame("001#00 24 01"))
    assert names(scanner.feed([frame(f"1C0#{PARAMETERS}")])) == ["Parameters1"]


@pytest.mark.parametrize(
    ("text", "label", "request_", "expected"),
    [
        ("1C0#22 00 29 09 FF FF FF FF", DEFAULT, "001#00 04", (1.37, 0.02)),
        ("1E4#FA 7D 29 19 00 00 00 00", DRC, "001#24 04", (1.0, 0.5, 0.1)),
        ("1E4#01 02 03 00 04 FF 00 00", DEFAULT, "001#24 04", (0.001, 0.002, 0.003, 0.004, 0.255)),
    ],
)
def test_currents_may_stand_in_a_frame_of_eight(text: str, label: str, request_: str, expected: Any) -> None:
    """Bytes behind the currents change nothing and are kept."""
    _, found = read(label, request_, text)
    assert type(found).__name__.endswith("Padded")
    assert found.current == pytest.approx(expected)
    again = variant(label).encoder.encode(type(found).__name__, **as_dict(found))
    assert bytes(again.data) == found.meta.raw


# ---------------------------------------------------------------------- sensors: what was asked last

FORCE = "041#85 FF C8 01 C9 09"
TILT = "051#7D 00 CE FF EE 02"


def test_force_and_torque_are_in_the_units_that_were_asked_for() -> None:
    """Scaled after a scaled request, digits after one for digits, again and again; unknown before any."""
    found = read(DEFAULT, FORCE, "002#01 12", FORCE, FORCE, "002#01 11", FORCE)
    assert names(found) == [
        "unknown: needs request SensorRequest|ForceTorqueRequest",
        "ForceTorqueRequest",
        "ForceTorque",
        "ForceTorque",
        "ForceTorqueRequest",
        "ForceTorqueDigits",
    ]
    assert (found[2].mx, found[2].my, found[2].fz) == pytest.approx((-1.23, 4.56, 250.5))
    assert (found[5].mx, found[5].my, found[5].fz) == (-123, 456, 2505)
    assert (found[2].mode, found[5].mode) == (0x12, 0x11)
    assert written(DEFAULT, "ForceTorque", {"sensor": 1, "mx": -1.23, "my": 4.56, "fz": 250.5}) == FORCE


def test_asking_for_tilt_does_not_change_force_and_torque() -> None:
    """A foot is asked for both, one after the other, as hubo-ach does; both replies are known."""
    found = read(DEFAULT, "002#01 12", "002#01 22", FORCE, TILT, FORCE)
    assert names(found)[2:] == ["ForceTorque", "Tilt", "ForceTorque"]
    assert (found[3].ax, found[3].ay, found[3].az) == pytest.approx((1.25, -0.5, 1.0))
    assert written(DEFAULT, "Tilt", {"sensor": 1, "ax": 1.25, "ay": -0.5, "az": 1.0}) == TILT


@pytest.mark.parametrize(
    ("mode", "force", "tilt"),
    [
        (0x00, "ForceTorqueDigits", "TiltDigits"),
        (0x02, "ForceTorque", "Tilt"),
        (0x03, "ForceTorque", "TiltDigits"),
        (0x04, "ForceTorqueDigits", "Tilt"),
    ],
)
@pytest.mark.parametrize("sensor", [1, 0xFF])
def test_a_common_request_rules_both_and_may_go_to_all(mode: int, force: str, tilt: str, sensor: int) -> None:
    """Modes 0, 2, 3, 4 say how each of the two comes; sensor 0xFF is every sensor."""
    found = read(DEFAULT, f"002#{sensor:02X} {mode:02X}", FORCE, TILT)
    assert names(found) == ["SensorRequest", force, tilt]


def test_another_sensor_s_request_does_not_count() -> None:
    """What the left foot was asked says nothing about the right one."""
    assert names(read(DEFAULT, "002#02 12", FORCE))[1].startswith("unknown: needs request")


# ---------------------------------------------------------------------- configurations, dialects, modes


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("080#01 00 02 00 03 00 04 00", {"hubo2": "Encoder3", "hubo2plus": "Encoder", "drc_hubo": "Encoder"}),
        ("084#01 00 02 00 03 00", {"hubo2": "Encoder5", "hubo2plus": "Encoder5", "drc_hubo": "Encoder3"}),
        ("082#00 08 00 08 00 08", {"hubo2": "Encoder3", "hubo2plus": "Encoder3", "drc_hubo": "EncoderNeck"}),
        ("06E#C0 12 D2 04 57 17", {"hubo2": "unknown", "hubo2plus": "Power", "drc_hubo": "Power"}),
        ("174#03 03 03 03 03", {"hubo2": "Status5", "hubo2plus": "Status5", "drc_hubo": "Status3"}),
        ("034#BC 31 80 05 85", {"hubo2": "unknown", "hubo2plus": "unknown", "drc_hubo": "ReferenceHand"}),
    ],
)
def test_a_frame_reads_as_its_robot_s_board_sends_it(text: str, expected: dict[str, str]) -> None:
    """The same identifier is another message on another robot: the table of boards decides."""
    assert {robot: names(read(f"D12@{robot}", text))[0] for robot in expected} == expected


def test_a_robot_may_have_its_own_table() -> None:
    """A table given by the caller replaces the shipped ones, whole."""
    mine = {"channels": {0x05: 3}, "sensors": {}}
    scanner = make_scanner([hubo.variant("D12", mine)], include_unknown=True)
    assert names(scanner.feed([frame("065#01 00 02 00 03 00"), frame("060#00 00 00 00 00 00 00 00")])) == [
        "Encoder3",
        "unknown",
    ]


@pytest.mark.parametrize(
    ("text", "old", "new"),
    [
        ("001#0E 82 02", "SetPeriod", "Alarm"),
        ("001#00 10 01", "ControlModeD08", "ControlMode"),
        ("001#00 06 01", "EncoderZeroD08", "EncoderZero"),
        ("1C0#0A 0A 0A", "NameInfoReply", "malformed: length 3, Parameters1 has 8 bytes"),
        ("091#01 00 00 00 02 00 00 00", "CurrentD08", "unknown"),
        (
            "041#85 FF C8 01 C9 09",
            "ForceTorqueD08",
            "unknown: needs request SensorRequest|ForceTorqueRequest",
        ),
    ],
)
def test_a_frame_reads_as_its_firmware_sends_it(text: str, old: str, new: str) -> None:
    """What D08 says with some bytes, D12 says with others or not at all."""
    assert names(read(HUBO2, text)) == [old]
    assert names(read(DEFAULT, text)) == [new]


def test_a_status_of_hubo_2_is_read_where_the_dialect_says() -> None:
    """acesHubo's places by default, the sheet's in D08X."""
    text = "150#00 00 00 00 00 05 0A 05"
    (default,), (sheet,) = read(HUBO2, text), read(SHEET, text)
    assert [m.origin for m in default.motor] == ["ok", "fail"]
    assert [m.origin for m in sheet.motor] == ["fail", "ok"]


def test_a_hand_s_fingers_are_currents_unless_its_mode_is_position() -> None:
    """The last byte is −0.05 A by default, and −123 after ControlMode has set position control."""
    text = "034#BC 31 80 05 85"
    found = read(DRC, text, "001#24 10 00", text, "001#24 10 02", text)
    assert names(found)[::2] == ["ReferenceHand", "ReferenceHandPosition", "ReferenceHand"]
    assert found[0].finger == pytest.approx((0.05, -0.05))
    assert found[2].finger == (5, -123)
    assert found[2].position == found[4].position == -12732


# ---------------------------------------------------------------------- the declaration itself


def test_the_protocol_says_what_it_is() -> None:
    """1 Mbit/s CAN; D12 and Hubo 2+ unless said otherwise."""
    assert (hubo.link, hubo.bitrate, hubo.dialect, hubo.configuration) == (
        "can",
        1_000_000,
        "D12",
        "hubo2plus",
    )
    assert set(hubo.configurations) == {"hubo2", "hubo2plus", "drc_hubo"}


@pytest.mark.parametrize("one", hubo.variants(), ids=lambda v: v.label)
def test_every_dialect_goes_with_every_configuration(one: Variant) -> None:
    """Each combination makes a scanner and an encoder, and none is empty."""
    scanner = make_scanner([one], include_unknown=True)
    assert names(scanner.feed([frame("7FF#00")])) == ["unknown"]
    name, identifier = ("SendStatusD15", 0x213) if one.dialect == "D15" else ("ControlOn", 1)
    assert one.encoder.encode(name, board=3).arbitration_id == identifier


def test_every_message_says_what_it_is_and_who_says_so() -> None:
    """Doc, source and direction are everywhere; a name is one layout in all dialects."""
    for message in hubo.declared:
        assert message.doc.endswith("."), message
        assert message.source, message
        assert message.direction is not None, message
    every = [message.name for message in hubo.declared]
    assert len(every) == len(set(every))


def test_units_are_the_sheet_s() -> None:
    """A number that has a unit in the sources has it in the protocol."""
    units = {
        ("ForceTorque", "mx"): "N·m",
        ("ForceTorque", "fz"): "N",
        ("Tilt", "ax"): "deg",
        ("Tilt", "az"): "g",
        ("Imu", "roll_rate"): "deg/s",
        ("Power", "voltage"): "V",
        ("Power", "current"): "A",
        ("Power", "power"): "W",
        ("GainOverride", "time"): "ms",
        ("JamLimits", "jam_duty"): "%",
        ("Beep", "time"): "s",
        ("HomeSearch", "limit"): "turn",
    }
    for (message, field), unit in units.items():
        (found,) = [item.subcon for item in hubo[message].payload.subcons if item.name == field]
        assert found.unit == unit, (message, field)
    temperature = next(s.field for s in hubo["Current"].payload.slots if s.name == "temperature")
    assert temperature.unit == "°C"


def test_an_unknown_name_lists_those_that_exist() -> None:
    """A message of another dialect is not there, and the error says what is."""
    with pytest.raises(UnknownNameError, match=r"NameInfo.*there are: .* more"):
        written(DEFAULT, "NameInfo", {"board": 0})


def test_a_name_is_given_once_even_to_boards_of_two_kinds() -> None:
    """Two messages of one name would hide each other in a robot that has boards of both kinds."""
    made = Protocol("made", link="can", configurations={"one": {"kinds": {0: "a", 1: "b"}}})
    kinds = made.configured("kinds", by="board")
    made.message("Data", id=0x10 + IdField("board", range(2)), when=kinds("a"), payload=Struct("x" / Byte))
    with pytest.raises(SpecError, match="'Data' is declared twice"):
        made.message(
            "Data", id=0x10 + IdField("board", range(2)), when=kinds("b"), payload=Struct("y" / Byte)
        )


# ---------------------------------------------------------------------- the README


def test_the_readme_shows_every_message() -> None:
    """Each message's name stands in the README."""
    missing = [m.name for m in hubo.declared if f"`{m.name}`" not in README]
    assert not missing


@pytest.mark.parametrize("block", BLOCKS)
def test_the_readme_shows_the_nine_parameter_blocks(block: int) -> None:
    """Each block has a section, with every field of the record."""
    section = README.split(f"### `Parameters{block}`")[1].split("###")[0]
    for field in hubo[f"Parameters{block}"].fields:
        if field not in ("board", "selector"):
            assert f"`{field}`" in section, field


def test_the_readme_shows_the_boards() -> None:
    """Every board of a configuration stands in the README's table with its kind."""
    rows = [line.strip("| ").split("|") for line in README.splitlines() if line.startswith("| 0x")]
    shown = {int(row[0], 16): [cell.strip().strip('"') for cell in row[3:6]] for row in rows if len(row) == 6}
    for position, robot in enumerate(("hubo2", "hubo2plus", "drc_hubo")):
        table = hubo.configurations[robot]["channels"]
        assert {board: cells[position] for board, cells in shown.items() if cells[position] != "–"} == {
            board: str(kind) for board, kind in table.items()
        }


def test_the_readme_s_session_is_true() -> None:
    """What the README shows at the prompt is what Python answers."""
    session = doctest.DocTestParser().get_doctest(README.replace("```", ""), {}, "README.md", None, 0)
    assert len(session.examples) >= 4
    assert doctest.DocTestRunner().run(session).failed == 0


@pytest.mark.parametrize(
    ("label", "message", "field"),
    [
        (DEFAULT, "Home", "motor"),
        (DEFAULT, "EncoderZero", "channel"),
        (HUBO2, "EncoderZeroD08", "motor"),
        (HUBO2, "GoHome", "motor"),
    ],
)
def test_a_number_means_the_joint_that_its_name_says(label: str, message: str, field: str) -> None:
    """`motor` counts from 1 and `channel` from 0, in every message: a number is never another joint than its name, and the
    word of the other count is refused.
    """
    more: dict[str, Any] = {"direction": "cw"} if message == "GoHome" else {}
    by_number = written(label, message, {"board": 0, field: 1, **more})
    assert by_number == written(label, message, {"board": 0, field: f"{field}_1", **more})
    other = {"motor": "channel", "channel": "motor"}[field]
    with pytest.raises((UnknownNameError, FieldError), match=rf"{other}.*{field}"):
        written(label, message, {"board": 0, other: 1, **more})
