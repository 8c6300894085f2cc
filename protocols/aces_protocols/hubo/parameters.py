"""What boards of D12 answer at 0x1C0: parameter blocks and currents.

1. Nothing in a frame distinguishes these: the request that is open does, so a reply without its request stays unknown.
2. A block's number n is the same for all channels; the record's `selector` says which channel it was.
3. Numbers that the board cuts across blocks stay in halves here. The halves are in counts and add up.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from construct import Byte, Bytes, Construct, Int16sl, Int16ul, Struct

from aces_bus.protocol import BitLayout, Enumeration, Message, Quantity, Reserved, Split, Tuple, bits

from .base import CW_CCW, HOMING_MODES, Board, Percent, channels, hubo
from .commands import GetParameters, SendCurrent

# ---------------------------------------------------------------------- parameter blocks


def selectors(block: int) -> tuple[int, ...]:
    """Return a block's selectors, channel by channel: 6 × channel + block, and 5 more from channel 3 on: 20–22 stay free."""
    return tuple(6 * channel + block + (5 if channel >= 3 else 0) for channel in range(5))


def _block(
    name: str,
    selector: Iterable[int],
    payload: Construct,
    doc: str,
    source: str = "hubo-ach",
    examples: Sequence[Any] = (),
) -> Message:
    return hubo.message(
        name,
        id=0x1C0 + Board,
        direction="from device",
        dialect="D12",
        reply_to=GetParameters.where(selector=selector),
        payload=payload,
        doc=doc,
        source=source,
        examples=examples,
    )


Parameters1 = _block(
    "Parameters1",
    selectors(1),
    BitLayout(
        8,
        "kp" / bits(16),
        "ki" / bits(16),
        "kd" / bits(16),
        "resolution" / Quantity(bits(14), unit="count"),
        "auto_scale" / bits(1),
        "direction" / Enumeration(bits(1), ccw=0, cw=1),
    ),
    "Block 1 of a channel: position gains and the encoder word.",
    examples=[
        (
            "1E4#C8 00 01 00 F4 01 A0 4F",
            {
                "board": 0x24,
                "selector": 7,
                "kp": 200,
                "ki": 1,
                "kd": 500,
                "resolution": 4000,
                "auto_scale": 1,
                "direction": "ccw",
            },
            "001#24 24 07",
        ),
        (
            "1E4#FF FF FE FF FD FF FF FF",
            {"kp": 65535, "ki": 65534, "kd": 65533, "resolution": 16383, "auto_scale": 1, "direction": "cw"},
            "001#24 24 07",
        ),
    ],
)
Parameters2 = _block(
    "Parameters2",
    selectors(2),
    Struct(
        "dead_zone" / Int16ul,
        "search_direction" / Enumeration(Byte, CW_CCW),
        "search_mode" / Enumeration(Byte, HOMING_MODES),
        "search_limit" / Quantity(Int16ul, unit="turn"),
        "home_offset_low" / Quantity(Int16ul, unit="count"),
    ),
    "Block 2 of a channel: dead zone, home search, and bits 0–15 of the home offset.",
    examples=[
        (
            "1E4#05 00 01 02 14 00 2C CF",
            {
                "board": 0x24,
                "selector": 8,
                "dead_zone": 5,
                "search_direction": "ccw",
                "search_mode": "mechanical_stop",
                "search_limit": 20,
                "home_offset_low": 53036,
            },
            "001#24 24 08",
        ),
        (
            "1E4#FF FF 00 00 FE FF FD FF",
            {"dead_zone": 65535, "search_direction": "cw", "search_limit": 65534, "home_offset_low": 65533},
            "001#24 24 08",
        ),
    ],
)
Parameters3 = _block(
    "Parameters3",
    selectors(3),
    BitLayout(
        8,
        "home_offset_high" / Quantity(bits(16, signed=True), scale=65536, unit="count"),
        "lower_limit_enabled" / bits(1),
        "lower_limit" / Quantity(bits(31, signed=True), scale=2, unit="count"),
        "upper_limit_enabled" / bits(1),
        "upper_limit_low" / Quantity(bits(15), scale=2, unit="count"),
    ),
    "Block 3 of a channel: bits 16–31 of the home offset, the lower limit, bits 0–15 of the upper one.",
    "hubo-ach; RoboWorld2018 (bit 0 of a limit switches it on)",
    examples=[
        (
            "1E4#FF FF F1 67 FD FF 11 98",
            {
                "board": 0x24,
                "selector": 9,
                "home_offset_high": -65536,
                "lower_limit_enabled": 1,
                "lower_limit": -170000,
                "upper_limit_enabled": 1,
                "upper_limit_low": 38928,
            },
            "001#24 24 09",
        )
    ],
)
Parameters4 = _block(
    "Parameters4",
    selectors(4),
    Struct(
        "upper_limit_high" / Quantity(Int16sl, scale=65536, unit="count"),
        "max_acceleration" / Int16ul,
        "max_velocity" / Int16ul,
        "max_pwm" / Int16ul,
    ),
    "Block 4 of a channel: bits 16–31 of the upper limit, largest acceleration, velocity and PWM.",
    examples=[
        (
            "1E4#02 00 D0 07 E8 03 64 00",
            {
                "board": 0x24,
                "selector": 10,
                "upper_limit_high": 131072,
                "max_acceleration": 2000,
                "max_velocity": 1000,
                "max_pwm": 100,
            },
            "001#24 24 0A",
        ),
        (
            "1E4#FF FF FE FF FD FF FC FF",
            {"upper_limit_high": -65536, "max_acceleration": 65534, "max_velocity": 65533, "max_pwm": 65532},
            "001#24 24 0A",
        ),
    ],
)
Parameters5 = _block(
    "Parameters5",
    selectors(5),
    Struct("max_current" / Int16ul, "unused" / Reserved(2), "kpt" / Int16ul, "kdt" / Int16ul),
    "Block 5 of a channel: largest current, torque gains.",
    examples=[
        (
            "1E4#64 00 00 00 0A 00 0B 00",
            {"board": 0x24, "selector": 11, "max_current": 100, "unused": bytes(2), "kpt": 10, "kdt": 11},
            "001#24 24 0B",
        ),
        ("1E4#FF FF 00 00 FE FF FD FF", {"max_current": 65535, "kpt": 65534, "kdt": 65533}, "001#24 24 0B"),
    ],
)
Parameters6 = _block(
    "Parameters6",
    selectors(6),
    Struct("kft" / Int16ul, "sums" / Bytes(6)),
    "Block 6 of a channel: a torque gain; the rest may be sums of blocks 1–5.",
    "hubo-ach; RoboWorld2018 (compares the sums, and only logs it when they differ)",
    examples=[
        (
            "1E4#0C 00 01 02 03 04 05 06",
            {"board": 0x24, "selector": 12, "kft": 12, "sums": b"\x01\x02\x03\x04\x05\x06"},
            "001#24 24 0C",
        ),
        ("1E4#FF FF 00 00 00 00 00 00", {"kft": 65535, "sums": bytes(6)}, "001#24 24 0C"),
    ],
)
Parameters20 = _block(
    "Parameters20",
    (20,),
    Struct(
        "number" / Int16ul,
        "period" / Quantity(Int16ul, unit="ms"),
        "board_type" / Byte,
        "unused" / Reserved(1),
        "homing_acceleration" / Quantity(Int16ul, scale=0.01),
    ),
    "Block 20 of a board: its number, its period, its type, its acceleration in a home search.",
    "hubo-ach; RoboWorld2018 (for the number)",
    examples=[
        (
            "1E4#03 00 05 00 02 00 96 00",
            {
                "board": 0x24,
                "selector": 20,
                "number": 3,
                "period": 5,
                "board_type": 2,
                "unused": b"\x00",
                "homing_acceleration": 1.5,
            },
            "001#24 24 14",
        ),
        (
            "1E4#FF FF FE FF 02 00 FD FF",
            {"number": 65535, "period": 65534, "board_type": 2, "homing_acceleration": 655.33},
            "001#24 24 14",
        ),
    ],
)
Parameters21 = _block(
    "Parameters21",
    (21,),
    Struct(
        "velocity_to_switch" / Int16ul,
        "velocity_to_offset" / Int16ul,
        "jam_time" / Quantity(Int16ul, unit="ms"),
        "saturation_time" / Quantity(Int16ul, unit="ms"),
    ),
    "Block 21 of a board: velocities of a home search, times until a jam and until saturation.",
    "hubo-ach (it reads the times as 0.1 s, and doubts it; JamLimits writes them in ms)",
    examples=[
        (
            "1E4#0A 00 05 00 E8 03 F4 01",
            {
                "board": 0x24,
                "selector": 21,
                "velocity_to_switch": 10,
                "velocity_to_offset": 5,
                "jam_time": 1000,
                "saturation_time": 500,
            },
            "001#24 24 15",
        ),
        (
            "1E4#FF FF FE FF FD FF FC FF",
            {
                "velocity_to_switch": 65535,
                "velocity_to_offset": 65534,
                "jam_time": 65533,
                "saturation_time": 65532,
            },
            "001#24 24 15",
        ),
    ],
)
Parameters22 = _block(
    "Parameters22",
    (22,),
    Struct(
        "limit_duty" / Percent,
        "jam_duty" / Percent,
        "max_step" / Int16ul,
        "max_error" / Int16ul,
        "max_encoder_error" / Int16ul,
    ),
    "Block 22 of a board: duties of the limit and jam detection, largest step, error and encoder error.",
    examples=[
        (
            "1E4#32 14 D0 07 20 4E 0A 00",
            {
                "board": 0x24,
                "selector": 22,
                "limit_duty": 50,
                "jam_duty": 20,
                "max_step": 2000,
                "max_error": 20000,
                "max_encoder_error": 10,
            },
            "001#24 24 16",
        ),
        (
            "1E4#32 14 FF FF FE FF FD FF",
            {"max_step": 65535, "max_error": 65534, "max_encoder_error": 65533},
            "001#24 24 16",
        ),
    ],
)

# ---------------------------------------------------------------------- currents


def _current(
    name: str,
    kinds: tuple[Any, ...],
    size: int,
    fields: tuple[Any, ...],
    doc: str,
    example: tuple[str, dict[str, Any], str],
) -> Message:
    """Declare currents in `size` bytes, and the same in a frame of 8 as `NamePadded`."""
    data, values, request = example
    long = data + " 00" * (8 - size)
    shared: dict[str, Any] = {
        "id": 0x1C0 + Board,
        "direction": "from device",
        "dialect": "D12",
        "when": channels(*kinds),
        "reply_to": SendCurrent,
        "source": "hubo-ach",
    }
    padded = f"{doc} In a frame of 8 bytes."
    hubo.message(
        f"{name}Padded",
        payload=BitLayout(8, *fields),
        doc=padded,
        examples=[(long, values, request)],
        **shared,
    )
    return hubo.message(name, payload=BitLayout(size, *fields), doc=doc, examples=[example], **shared)


#: hubo-ach has this byte as "to be checked"; RoboWorld2018 has, switched off, two more bits and 0.1 °C.
_TEMPERATURE = "temperature" / Quantity(bits(8, 16), unit="°C")


def _amps(width: int, at: int, per_amp: int) -> Quantity:
    return Quantity(bits(width, at), scale=1 / per_amp, unit="A")


Current = _current(
    "Current",
    (1, 2),
    4,
    (
        # Bits 0 and 1 of each current are in d[3], what is above them in d[0] and d[1].
        "current"
        / Tuple(
            Quantity(Split((24, 2), (0, 8)), scale=0.01, unit="A"),
            Quantity(Split((26, 2), (8, 8)), scale=0.01, unit="A"),
        ),
        _TEMPERATURE,
    ),
    "Magnitudes of both motor currents, and a temperature.",
    example=("1C0#22 00 29 09", {"board": 0, "current": [1.37, 0.02], "temperature": 41}, "001#00 04"),
)
Current3 = _current(
    "Current3",
    (3, "hand"),
    4,
    ("current" / Tuple(_amps(8, 0, 250), _amps(8, 8, 250), _amps(8, 24, 250)), _TEMPERATURE),
    "Magnitudes of three motor currents, and a temperature.",
    example=("1E4#FA 7D 29 19", {"board": 0x24, "current": [1.0, 0.5, 0.1], "temperature": 41}, "001#24 04"),
)
Current5 = _current(
    "Current5",
    (5,),
    6,
    ("current" / Tuple(*(_amps(8, 8 * byte, 1000) for byte in (0, 1, 2, 4, 5))),),
    "Magnitudes of five finger currents.",
    example=(
        "1E4#01 02 03 00 04 FF",
        {"board": 0x24, "current": [0.001, 0.002, 0.003, 0.004, 0.255]},
        "001#24 04",
    ),
)
