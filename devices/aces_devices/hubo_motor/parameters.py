"""What a board of D12 stores without power, and how it cuts that into blocks: for the driver, and for its twin.

A block is asked for by a number (`selector`), a command writes several parameters at once (`WRITES`).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import msgspec


class ChannelParameters(msgspec.Struct, kw_only=True):
    """What a board has stored of one motor. Counts are the encoder's; gains, speeds, currents in the board's numbers.

    `search_limit` is in motor turns; `home_offset` from index (or switch) to zero, in counts; limits count while they are
    enabled. `sums` are bytes of unknown meaning. Defaults are a board's as it comes.
    """

    kp: int = 200
    ki: int = 0
    kd: int = 500
    resolution: int = 4000
    auto_scale: bool = False
    direction: str = "ccw"
    dead_zone: int = 0
    search_direction: str = "cw"
    search_mode: str | int = "switch_and_index"
    search_limit: int = 60
    home_offset: int = 0
    lower_limit: int = 0
    lower_limit_enabled: bool = False
    upper_limit: int = 0
    upper_limit_enabled: bool = False
    max_acceleration: int = 0
    max_velocity: int = 0
    max_pwm: int = 100
    max_current: int = 1000
    kpt: int = 10
    kdt: int = 10
    kft: int = 10
    sums: bytes = bytes(6)


class BoardParameters(msgspec.Struct, kw_only=True):
    """What a board has stored, `channels` by joint or `BOARD.n`. `period`, `jam_time`, `saturation_time` are in ms.

    0 in an error bound: no bound.
    """

    channels: dict[str, ChannelParameters] = msgspec.field(default_factory=dict[str, ChannelParameters])
    number: int = 0
    period: int = 5
    board_type: int = 0
    homing_acceleration: float = 1.5
    velocity_to_switch: int = 10
    velocity_to_offset: int = 10
    jam_time: int = 1000
    saturation_time: int = 500
    limit_duty: int = 50
    jam_duty: int = 20
    max_step: int = 0
    max_error: int = 0
    max_encoder_error: int = 10


#: Block of a channel → what is in it; likewise the board's own. Offsets and limits are cut into halves.
CHANNEL_BLOCKS: Final[Mapping[int, tuple[str, ...]]] = {
    1: ("kp", "ki", "kd", "resolution", "auto_scale", "direction"),
    2: ("dead_zone", "search_direction", "search_mode", "search_limit", "home_offset_low"),
    3: ("home_offset_high", "lower_limit", "lower_limit_enabled", "upper_limit_enabled", "upper_limit_low"),
    4: ("upper_limit_high", "max_acceleration", "max_velocity", "max_pwm"),
    5: ("max_current", "kpt", "kdt"),
    6: ("kft", "sums"),
}
BOARD_BLOCKS: Final[Mapping[int, tuple[str, ...]]] = {
    20: ("number", "period", "board_type", "homing_acceleration"),
    21: ("velocity_to_switch", "velocity_to_offset", "jam_time", "saturation_time"),
    22: ("limit_duty", "jam_duty", "max_step", "max_error", "max_encoder_error"),
}
#: Command → the parameters that it writes: our name, its field.
WRITES: Final[Mapping[str, Mapping[str, str]]] = {
    "DeadZone": {"dead_zone": "dead_zone"},
    "HomeSearch": {"search_limit": "limit", "search_direction": "direction", "home_offset": "offset"},
    "EncoderResolution": {
        "resolution": "resolution",
        "auto_scale": "auto_scale",
        "direction": "direction",
    },
    "MaxSpeed": {"max_acceleration": "acceleration", "max_velocity": "velocity"},
    "HomingSpeed": {
        "homing_acceleration": "acceleration",
        "velocity_to_switch": "velocity_to_switch",
        "velocity_to_offset": "velocity_to_offset",
        "search_mode": "mode",
        "homing_duty": "duty",
    },
    "JamLimits": {
        "jam_time": "jam_time",
        "saturation_time": "saturation_time",
        "limit_duty": "limit_duty",
        "jam_duty": "jam_duty",
    },
    "ErrorBounds": {"max_step": "max_step", "max_error": "max_error", "temperature_warning": "temperature"},
}
#: Those that are for the board, not for a channel.
OF_BOARD: Final = ("JamLimits", "ErrorBounds")


def selector(channel: int, block: int) -> int:
    """Return which number asks for block 1–6 of a channel: 20–22 stay free for the board's blocks (hubo-ach)."""
    return 6 * channel + block + (5 if channel >= 3 else 0)


def channel_parameters(blocks: Mapping[int, Any]) -> ChannelParameters:
    """Return the six blocks of a channel put together."""
    found = {name: getattr(blocks[n], name) for n, names in CHANNEL_BLOCKS.items() for name in names}
    for whole in ("home_offset", "upper_limit"):
        found[whole] = found.pop(f"{whole}_low") + found.pop(f"{whole}_high")
    for flag in ("auto_scale", "lower_limit_enabled", "upper_limit_enabled"):
        found[flag] = bool(found[flag])
    return ChannelParameters(**found)


def block_fields(stored: ChannelParameters, block: int) -> dict[str, Any]:
    """Return the fields of a block of a channel."""
    offset, upper = stored.home_offset, stored.upper_limit
    cut = {
        "home_offset_low": offset & 0xFFFF,
        "home_offset_high": offset - (offset & 0xFFFF),
        "lower_limit": stored.lower_limit & ~1,
        "upper_limit_low": upper & 0xFFFE,
        "upper_limit_high": upper - (upper & 0xFFFF),
    }
    return {name: cut[name] if name in cut else getattr(stored, name) for name in CHANNEL_BLOCKS[block]}


class StoredChannel(ChannelParameters, kw_only=True):
    """What a board keeps of a motor without power, also what it does not report."""

    homing_duty: int = 30


class StoredBoard(BoardParameters, kw_only=True):
    """What a board keeps of itself without power, also what it does not report."""

    temperature_warning: int = 80


def board_defaults(kind: int | str) -> StoredBoard:
    """Return what a board comes with. Fingers have far to go to their stop."""
    return StoredBoard(velocity_to_switch=40, velocity_to_offset=40) if kind == 5 else StoredBoard()
