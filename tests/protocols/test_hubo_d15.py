"""Dialect D15 of hubo, against what the facts have of it, worked by hand."""

from __future__ import annotations

from typing import Any

import pytest

from aces_bus import Frame, as_dict
from aces_bus.errors import FieldError, UnknownNameError
from aces_protocols.hubo.records import EncoderD15, ForceTorqueD15, StatusD15, StatusShortD15
from aces_protocols.hubo.spec import hubo

D15 = hubo.variant("D15")


def _frame(text: str) -> Frame:
    identifier, _, data = text.partition("#")
    return Frame(int(identifier, 16), bytes.fromhex(data))


def _read(*texts: str, direction: Any = None) -> list[Any]:
    return hubo.scanner(dialect="D15", direction=direction, include_unknown=True).feed(
        [_frame(text) for text in texts]
    )


#: Frame, message, fields: each a line of the facts' section 13.
WORKED: list[tuple[str, str, dict[str, Any]]] = [
    ("010#40 E2 01 00 C0 1D FE FF", "ReferenceD15", {"board": 0, "position": [123456, -123456]}),
    ("210#03 01", "SendEncoderD15", {"board": 0, "mode": "continuous"}),
    ("239#03 00", "SendEncoderD15", {"board": 41, "mode": "once"}),
    ("215#0B 02 01", "DriverSwitchD15", {"board": 5, "channel": 2, "state": "on"}),
    ("215#0E 01 01", "ControlD15", {"board": 5, "channel": 1, "state": "on"}),
    ("215#11 02", "HomeD15", {"board": 5, "channel": 2}),
    ("215#75 01", "ClearErrorD15", {"board": 5, "channel": 1}),
    ("215#14 01 00", "PositionModeD15", {"board": 5, "channel": 1, "mode": "absolute"}),
    ("215#41 0A 00 14 00", "MaxSpeedD15", {"board": 5, "channel": 1, "acceleration": 10, "velocity": 20}),
    (
        "215#0D 01 F6 FF 03 E8 03",
        "PwmD15",
        {
            "board": 5,
            "motor": [{"mode": "percent", "duty": -10}, {"mode": "feed_forward_per_mille", "duty": 1000}],
        },
    ),
    ("215#A1", "SendTemperatureD15", {"board": 5}),
    ("228#18 E0", "PowerQueryD15", {"board": 0x18, "opcode": 0xE0}),
    ("003#FF 12", "SensorRequestD15", {"sensor": 0xFF, "mode": 0x12}),
]
ANSWERS: list[tuple[str, str, dict[str, Any]]] = [
    ("089#BC 31 00 00 44 CE FF FF", "EncoderD15", {"board": 41, "position": [12732, -12732]}),
    (
        "1C5#90 01 F4 01 FF FF",
        "TemperatureD15",
        {"board": 5, "board_temperature": 40.0, "motor": [50.0, 6553.5]},
    ),
    ("078#C0 12 D2 04", "PowerD15", {"board": 0x18, "voltage": 48.0, "current": 12.34}),
    ("195#05 AA BB 01 00 00 00", "BoardInfoD15", {"board": 5, "period": 5, "version": 1}),
    ("046#00 7B 00 38 FE 37 F6", "ForceTorqueD15", {"sensor": 6, "mx": -1.23, "my": 4.56, "fz": 250.5}),
    (
        "048#00 9C FF 64 00 7B 00",
        "ForceTorqueLateralD15",
        {"sensor": 6, "fx": 10.0, "fy": -10.0, "mz": -1.23},
    ),
]


@pytest.mark.parametrize(("text", "name", "fields"), [*WORKED, *ANSWERS])
def test_worked_frames(text: str, name: str, fields: dict[str, Any]) -> None:
    """Each is read as the facts say, and written again with the same bytes."""
    (record,) = _read(text)
    assert type(record).__name__ == name
    found = as_dict(record)
    for key, value in fields.items():
        assert found[key] == (
            pytest.approx(value) if isinstance(value, float | list) and key != "motor" else value
        )
    assert D15.encoder.encode(name, **found).data == _frame(text).data


def test_every_status_bit_has_the_place_that_the_facts_give_it() -> None:
    """Byte 0 as D12; bit 3 of byte 1 is the input, bit 5 the encoder; byte 2 are limits and modes."""
    errors = ["jam", "saturated", "big_error", "input_error", "driver_fault", "encoder_fail"]
    errors += ["current_difference", "temperature_error"]
    modes = ["limit_1", "limit_2", "complementary", "gain_override", "friction_compensation", "incremental"]
    modes += ["can_recovered", "reply_ok"]
    drive = ["driver_on", "control_on", "current_mode", "limit_switch"]
    for byte, names in enumerate((drive, errors, modes)):
        for bit, name in enumerate(names):
            data = bytearray(6)
            data[3 + byte] = 1 << bit
            (record,) = hubo.scanner(dialect="D15").feed([Frame(0x150, bytes(data))])
            assert isinstance(record, StatusD15)
            first, second = record.motor
            field = (second.drive, second.errors, second.modes)[byte]
            assert list(field) == [name]
            assert [*first.drive, *first.errors, *first.modes] == []
    (homed,) = _read("150#60 00 00 00 00 00")
    assert homed.motor[0].home == "homed"


def test_a_short_status_is_one_motor_s() -> None:
    """Three to five bytes have room for one motor; the rest is kept."""
    (record,) = _read("152#03 04 80 AA BB")
    assert isinstance(record, StatusShortD15)
    assert record.rest == b"\xaa\xbb"
    assert list(record.motor[0].errors) == ["big_error"]


def test_the_power_board_is_no_motor_board() -> None:
    """0x078 has volts, not counts; a reference for it cannot be made, and its own commands begin with its number."""
    assert type(_read("078#C0 12 D2 04 00 00 00 00")[0]).__name__ == "PowerD15"
    assert type(_read("228#17 E0")[0]).__name__ == "Unknown"
    with pytest.raises(FieldError, match="board"):
        D15.encoder.encode("ReferenceD15", board=0x18, position=[0, 0])


def test_old_commands_mean_nothing_here() -> None:
    """Identifier 0x001 is not spoken, and dialect D12 does not know 0x210 + board."""
    assert type(_read("001#03 0E")[0]).__name__ == "Unknown"
    with pytest.raises(UnknownNameError, match="ControlOn"):
        D15.encoder.encode("ControlOn", board=3)
    (record,) = hubo.scanner(include_unknown=True).feed([_frame("215#0E 01 01")])
    assert type(record).__name__ == "Unknown"


def test_channels_count_from_one() -> None:
    """0x41 and 0x42 are channels 1 and 2; 0x40 is none."""
    assert [_read(f"215#{opcode:02X} 01 00 02 00")[0] for opcode in (0x41, 0x42)][1].channel == 2
    assert type(_read("215#40 01 00 02 00")[0]).__name__ == "Unknown"


def test_no_table_is_needed() -> None:
    """Every board number is understood, whichever robot's tables are named."""
    for configuration in hubo.configurations:
        scanner = hubo.scanner(dialect="D15", configuration=configuration)
        for board in range(42):
            found = scanner.feed([Frame(0x060 + board, bytes(8))])
            assert isinstance(found[0], EncoderD15) or board == 0x18
    assert isinstance(_read("041#00 00 00 00 00 00 00")[0], ForceTorqueD15)
