"""Hubo's CAN protocol: numbers, opcodes, status bits, configurations, what its README says."""

from __future__ import annotations

import doctest
from pathlib import Path
from typing import Any

import pytest
from construct import Byte, Struct

from aces_bus import make_scanner
from aces_bus.errors import FieldError, SpecError, UnknownNameError
from aces_bus.protocol import IdField, Protocol, Variant
from aces_protocols.hubo import spec
from aces_protocols.hubo.spec import hubo
from tests.protocols.hubo_frames import (
    DEFAULT,
    DRC,
    HUBO2,
    SHEET,
    frame,
    names,
    read,
    written,
)
from tests.protocols.test_hubo_replies import BLOCKS

README = Path(spec.__file__).with_name("README.md").read_text(encoding="utf-8")


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
        payload: Any = hubo[message].payload
        (found,) = [item.subcon for item in payload.subcons if item.name == field]
        assert found.unit == unit, (message, field)
    current: Any = hubo["Current"].payload
    temperature = next(s.field for s in current.slots if s.name == "temperature")
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
