"""Replies of Hubo's boards and sensors, which only the request before them tells apart."""

from __future__ import annotations

from typing import Any

import pytest

from aces_bus import as_dict
from aces_protocols.hubo.parameters import selectors
from tests.protocols.hubo_frames import (
    DEFAULT,
    DRC,
    frame,
    names,
    opened,
    read,
    same,
    variant,
    written,
)

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
