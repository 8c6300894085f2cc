"""The status of motor boards, identifier 0x150 + board: switches, errors, and how home searches go.

1. Every bit with a meaning has a name; the others are kept (`reserved`, `unknown`).
"""

from __future__ import annotations

from construct import Array, Byte, Bytes, Struct

from aces_bus.protocol import BitLayout, Enumeration, Flags, bits

from .base import Board, Rest, channels, hubo
from .commands import SendStatus

_MOTOR = BitLayout(
    4,
    "drive" / Flags(bits(4), driver_on=0, control_on=1, current_mode=2, limit_switch=3),
    # 6 ends a search well, 2 that of a wrist roll; RoboWorld2018 has other values during the search.
    "home" / Enumeration(bits(4), wrist_roll_homed=2, homed=6),
    "errors"
    / Flags(
        bits(16),
        jam=0,
        saturated=1,
        big_error=2,
        encoder_error=3,
        driver_fault=4,
        motor_fail_0=5,
        motor_fail_1=6,
        below_minimum=8,
        above_maximum=9,
        velocity_error=10,
        acceleration_error=11,
        temperature_error=12,
    ),
)
_MOTOR_FLAGS = Flags(
    Byte,
    driver_on=0,
    control_on=1,
    current_mode=2,
    limit_switch=3,
    jam=4,
    saturated=5,
    big_error=6,
    encoder_error=7,
)
Status = hubo.message(
    "Status",
    id=0x150 + Board,
    direction="from device",
    dialect="D12",
    when=channels(1, 2),
    reply_to=SendStatus,
    payload=Struct("motor" / Array(2, _MOTOR)),
    doc="State and errors of both motors.",
    source="hubo-ach; HuboCan",
    examples=[
        (
            "150#63 04 00 00 00 00 00 00",
            {
                "board": 0,
                "motor": [
                    {
                        "drive": ["driver_on", "control_on"],
                        "home": "homed",
                        "errors": ["big_error"],
                        "reserved": 0,
                    },
                    {"drive": [], "home": 0, "errors": [], "reserved": 0},
                ],
            },
        )
    ],
)
StatusShort = hubo.message(
    "StatusShort",
    id=0x150 + Board,
    direction="from device",
    dialect="D12",
    when=channels(1),
    length=range(4, 8),
    reply_to=SendStatus,
    payload=Struct("motor" / Array(1, _MOTOR), "rest" / Rest),
    doc="State and errors of a one-channel board that leaves the second motor out.",
    source="hubo-ach; HuboCan",
    examples=[
        (
            "151#63 04 01 00",
            {
                "board": 1,
                "motor": [
                    {
                        "drive": ["driver_on", "control_on"],
                        "home": "homed",
                        "errors": ["big_error", "below_minimum"],
                    }
                ],
            },
        )
    ],
)
Status3 = hubo.message(
    "Status3",
    id=0x150 + Board,
    direction="from device",
    dialect="D12",
    when=channels(3, "hand"),
    length=range(3, 9),
    reply_to=SendStatus,
    payload=Struct("motor" / Array(3, _MOTOR_FLAGS), "rest" / Rest),
    doc="State and errors of three motors; the home flag is not there.",
    source="hubo-ach; HuboCan",
    examples=[
        (
            "174#03 43 83",
            {
                "board": 0x24,
                "motor": [
                    ["driver_on", "control_on"],
                    ["driver_on", "control_on", "big_error"],
                    ["driver_on", "control_on", "encoder_error"],
                ],
            },
        )
    ],
)
Status5 = hubo.message(
    "Status5",
    id=0x150 + Board,
    direction="from device",
    dialect="D12",
    when=channels(5),
    length=range(5, 9),
    reply_to=SendStatus,
    payload=Struct("motor" / Array(5, _MOTOR_FLAGS), "rest" / Rest),
    doc="State and errors of five motors.",
    source="hubo-ach; HuboCan",
    examples=[
        (
            "174#03 04 43 83 10",
            {
                "board": 0x24,
                "motor": [
                    ["driver_on", "control_on"],
                    ["current_mode"],
                    ["driver_on", "control_on", "big_error"],
                    ["driver_on", "control_on", "encoder_error"],
                    ["jam"],
                ],
            },
        )
    ],
)

_FOUND = {"none": 0, "ok": 1, "fail": 2}
#: A search is over when origin or switch say ok, and has failed when either says fail.
_SEARCH = BitLayout(
    1,
    "origin" / Enumeration(bits(2), _FOUND),
    "limit_switch" / Enumeration(bits(2), _FOUND),
    "encoder" / Enumeration(bits(2), _FOUND),
)
StatusD08 = hubo.message(
    "StatusD08",
    id=0x150 + Board,
    direction="from device",
    dialect="D08",
    length=(7, 8),
    reply_to=SendStatus,
    payload=Struct(
        "board_state" / Byte,
        "motor_state" / Array(2, Byte),
        "motor_control" / Array(2, Byte),
        "motor" / Array(2, _SEARCH),
        "rest" / Rest,
    ),
    doc="How the home searches of two motors went.",
    source="acesHubo (bytes 5 and 6, as it ran on the robot); X1 for the bits",
    examples=[
        (
            "150#00 00 00 00 00 05 0A",
            {
                "board": 0,
                "board_state": 0,
                "motor_state": [0, 0],
                "motor_control": [0, 0],
                "motor": [
                    {"origin": "ok", "limit_switch": "ok", "encoder": "none", "reserved": 0},
                    {"origin": "fail", "limit_switch": "fail", "encoder": "none", "reserved": 0},
                ],
            },
        ),
        (
            "150#01 02 03 04 05 05 0A",
            {
                "board": 0,
                "board_state": 1,
                "motor_state": [2, 3],
                "motor_control": [4, 5],
                "motor": [
                    {"origin": "ok", "limit_switch": "ok", "encoder": "none", "reserved": 0},
                    {"origin": "fail", "limit_switch": "fail", "encoder": "none", "reserved": 0},
                ],
            },
        ),
    ],
)
StatusD08X = hubo.message(
    "StatusD08X",
    id=0x150 + Board,
    direction="from device",
    dialect="D08X",
    when=channels(1, 2),
    reply_to=SendStatus,
    payload=Struct("state" / Bytes(6), "motor" / Array(2, _SEARCH)),
    doc="How the home searches of two motors went, in bytes 6 and 7.",
    source="X1; X2",
    examples=[
        (
            "150#00 00 00 00 00 00 15 0A",
            {
                "board": 0,
                "state": bytes(6),
                "motor": [
                    {"origin": "ok", "limit_switch": "ok", "encoder": "ok", "reserved": 0},
                    {"origin": "fail", "limit_switch": "fail", "encoder": "none", "reserved": 0},
                ],
            },
        ),
        (
            "150#00 00 00 00 00 00 6A 0A",
            {
                "board": 0,
                "motor": [
                    {"origin": "fail", "limit_switch": "fail", "encoder": "fail"},
                    {"origin": "fail", "limit_switch": "fail", "encoder": "none"},
                ],
            },
        ),
    ],
)
Status3D08X = hubo.message(
    "Status3D08X",
    id=0x150 + Board,
    direction="from device",
    dialect="D08X",
    when=channels(3),
    reply_to=SendStatus,
    payload=Struct("state" / Bytes(5), "motor" / Array(3, _SEARCH)),
    doc="How the home searches of three motors went, in bytes 5 to 7.",
    source="X1; X2",
    examples=[
        (
            "170#00 00 00 00 00 05 0A 15",
            {
                "board": 0x20,
                "state": bytes(5),
                "motor": [
                    {"origin": "ok", "limit_switch": "ok", "encoder": "none"},
                    {"origin": "fail", "limit_switch": "fail", "encoder": "none"},
                    {"origin": "ok", "limit_switch": "ok", "encoder": "ok"},
                ],
            },
        )
    ],
)
