"""Requests and commands of a motor board of each kind and dialect, and its settings: the tables that driver and twin read.

1. A board is a row of `SHAPES`; nothing else in the driver asks for a dialect or a kind, except where firmware behaves
   differently with the same messages.
2. A row names messages of the spec only; their fields are the spec's.

A board of kind "hand" or "neck" is DRC-Hubo's. `reference` None: the board follows no positions (facts, section 9).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, Final

import msgspec
from msgspec import Meta

from aces_bus.device import Device, Twin
from aces_bus.errors import UnknownNameError

Kind = int | str


def _number(text: str, least: float, most: float) -> Meta:
    return Meta(ge=least, le=most, description=text)


class BoardSettings(msgspec.Struct, frozen=True, kw_only=True):
    """The driver's own keys in a robot file."""

    period_ms: (
        Annotated[
            float,
            _number(
                "what NameInfo (D08) and GetBoardInfo (D12) set on the board: ms between two references",
                1,
                255,
            ),
        ]
        | None
    ) = None
    status_s: Annotated[float, _number("how often the status is asked for (s, default 0.1)", 0, 3600)] = 0.1
    current_s: Annotated[
        float, _number("how often currents and temperature are asked for (s, default 0.1)", 0, 3600)
    ] = 0.1
    filter: Annotated[
        float, _number("length of hubo-ach's reference filter (40 there; default 1: none)", 1, 100_000)
    ] = 1
    neck_counts: Annotated[
        float,
        _number(
            "what a neck servo's turn is divided by in references: 4096 (default) or hubo-ach's 4095",
            4095,
            4096,
        ),
    ] = 4096
    home_timeout_s: Annotated[
        float, _number("how long a home search may take (s, default 30)", 0.1, 3600)
    ] = 30
    home_tries: (
        Annotated[
            float,
            _number("how often a D08 home search is tried (default 3 for arms, 2 for others)", 1, 100),
        ]
        | None
    ) = None
    hold_start_s: Annotated[
        float, _number("no references for this time after the start (s, default 0.8)", 0, 3600)
    ] = 0.8
    hold_home_s: Annotated[
        float,
        _number(
            "no references of any board on the bus for this time after a home command (s, default 3)", 0, 3600
        ),
    ] = 3
    trigger: Annotated[
        bool,
        Meta(
            description=(
                "true: set-points go out when all channels of the board have a new one (acesHubo); default false"
            )
        ),
    ] = False


@dataclass(frozen=True)
class Ask:
    """A request, its fields, the messages that answer it, and the channel that comes first in them."""

    message: str
    reply: tuple[str, ...]
    fields: Mapping[str, Any] = field(default_factory=dict[str, Any])
    first: int = 0


@dataclass(frozen=True)
class Shape:
    """One kind of board.

    `references`: which field of `reference` is each channel's set-point; `pwm` likewise in its field `duty`. `pwm_signed`:
    duties carry their sign, otherwise the message has a `direction` beside them. `positive`: the sign on the wire of a duty
    that drives a joint of direction 1 upwards. `largest_duty` is in the board's unit. `gains`: the messages that set the
    position gains of each channel; `torque_gains` likewise. `has_home_flag`: its status says what is homed; `has_switches`:
    it takes ControlOn and ControlOff; `reports_drive`: its status says whether drivers and control are on.
    """

    channels: int
    encoders: tuple[Ask, ...] = ()
    status: Ask | None = None
    current: Ask | None = None
    current_unit: str = "A"
    reference: str | None = None
    references: tuple[str, ...] = ()
    pwm: str | None = None
    pwm_off: str | None = None
    pwm_mode: str | None = None
    pwm_signed: bool = True
    directions: tuple[str, str] = ("plus", "minus")
    positive: int = 1
    largest_duty: float = 100
    duty_unit: str = "%"
    gains: tuple[str, ...] = ()
    torque_gains: tuple[str, ...] = ()
    home: str | None = None
    name_info: str | None = None
    has_home_flag: bool = False
    has_switches: bool = True
    has_driver_switch: bool = True
    reports_drive: bool = True
    position_bits: int = 24

    def encoder_reply(self, channel: int) -> tuple[str, ...]:
        """Return the messages that have a channel's position."""
        asks = [ask for ask in self.encoders if ask.first <= channel]
        return max(asks, key=lambda ask: ask.first).reply if asks else ()


_A, _AB = ("PositionGainA",), ("PositionGainA", "PositionGainB")
_TA, _TAB = ("TorqueGainA",), ("TorqueGainA", "TorqueGainB")
_TWO = ("position.0", "position.1")
_THREE = ("position.0", "position.1", "position.2")


def _d12(channels: int, encoder: tuple[str, ...], status: tuple[str, ...]) -> Shape:
    """Return the shape of one or two channels of D12."""
    return Shape(
        channels,
        encoders=(Ask("SendEncoder", encoder, {"selector": "normal"}),),
        status=Ask("SendStatus", status),
        current=Ask("SendCurrent", ("Current", "CurrentPadded")),
        reference="Reference",
        references=_TWO[:channels],
        pwm="PwmFine",
        pwm_off="Pwm",
        # Clockwise is negative here and drives upwards: hubo-ach sends its effort negated.
        positive=-1,
        directions=("cw", "ccw"),
        gains=_AB[:channels],
        torque_gains=_TAB[:channels],
        home="Home",
        has_home_flag=True,
    )


def _three(**changes: Any) -> Shape:
    """Return the shape of three channels of D12."""
    return Shape(
        3,
        encoders=(Ask("SendEncoder", ("Encoder3",), {"selector": "normal"}),),
        status=Ask("SendStatus", ("Status3",)),
        current=Ask("SendCurrent", ("Current3", "Current3Padded")),
        pwm="Pwm3",
        pwm_off="Pwm3",
        pwm_mode="on",
        gains=_A * 3,
        torque_gains=_TA * 3,
        home="Home",
        position_bits=16,
        **changes,
    )


def _d08(channels: int, encoder: tuple[str, ...], status: str, home: str) -> Shape:
    """Return the shape of one or two channels of D08."""
    return Shape(
        channels,
        encoders=(Ask("SendEncoderD08", encoder),),
        status=Ask("SendStatus", (status,)),
        current=Ask("SendCurrent", ("CurrentD08",)),
        current_unit="",
        reference="Reference",
        references=_TWO[:channels],
        pwm="PwmD08",
        pwm_off="PwmD08",
        pwm_mode="on",
        pwm_signed=False,
        largest_duty=255,
        duty_unit="",
        gains=_AB[:channels],
        torque_gains=_TAB[:channels],
        home=home,
        name_info="NameInfo",
        reports_drive=False,
    )


def _three_d08(status: str, home: str) -> Shape:
    """Return the shape of three channels of D08: roll has gains A, pitch and yaw share B."""
    return Shape(
        3,
        encoders=(Ask("SendEncoderD08", ("Encoder3",)),),
        status=Ask("SendStatus", (status,)),
        reference="Reference3D08",
        references=_THREE,
        pwm="Pwm3D08",
        pwm_off="Pwm3D08",
        pwm_mode="on",
        pwm_signed=False,
        largest_duty=255,
        duty_unit="",
        gains=("PositionGainA", "PositionGainB", "PositionGainB"),
        torque_gains=("TorqueGainA", "TorqueGainB", "TorqueGainB"),
        home=home,
        name_info="NameInfo3",
        reports_drive=False,
        position_bits=16,
    )


def _fingers_d08(status: Ask | None) -> Shape:
    """Return the shape of five fingers of D08: a duty is all they know; no encoder answers."""
    return Shape(
        5,
        status=status,
        pwm="PwmFingersD08",
        pwm_off="PwmFingersD08",
        pwm_mode="on",
        largest_duty=15,
        duty_unit="",
        gains=_A * 5,
        torque_gains=_TA * 5,
        home="Home5D08",
        name_info="NameInfo5",
        has_switches=False,
        reports_drive=False,
    )


SHAPES: Final[Mapping[tuple[str, Kind], Shape]] = {
    ("D12", 1): _d12(1, ("Encoder", "EncoderShort"), ("Status", "StatusShort")),
    ("D12", 2): _d12(2, ("Encoder",), ("Status",)),
    ("D12", 3): _three(),
    ("D12", "hand"): _three(reference="ReferenceHand", references=("position", "finger.0", "finger.1")),
    ("D12", "neck"): Shape(
        3,
        encoders=(Ask("SendEncoder", ("EncoderNeck",), {"selector": "normal"}),),
        reference="ReferenceNeck",
        references=_THREE,
        has_switches=False,
        has_driver_switch=False,
        reports_drive=False,
        position_bits=12,
    ),
    ("D12", 5): Shape(
        5,
        encoders=(
            Ask("SendEncoder", ("Encoder5",), {"selector": "normal"}),
            Ask("SendEncoder", ("Encoder5Upper",), {"selector": "upper"}, first=3),
        ),
        status=Ask("SendStatus", ("Status5",)),
        current=Ask("SendCurrent", ("Current5", "Current5Padded")),
        pwm="PwmFingers",
        pwm_off="PwmFingers",
        pwm_mode="on",
        gains=_A * 5,
        torque_gains=_TA * 5,
        home="Home",
        has_switches=False,  # hubo-ach leaves hands out of control on and off
        position_bits=16,
    ),
    ("D08", 1): _d08(1, ("Encoder", "EncoderShort"), "StatusD08", "HomeD08"),
    ("D08", 2): _d08(2, ("Encoder",), "StatusD08", "HomeD08"),
    ("D08", 3): _three_d08("StatusD08", "Home3D08"),
    ("D08", 5): _fingers_d08(Ask("SendStatus", ("StatusD08",))),
    ("D08X", 1): _d08(1, ("Encoder", "EncoderShort"), "StatusD08X", "HomeD08X"),
    ("D08X", 2): _d08(2, ("Encoder",), "StatusD08X", "HomeD08X"),
    ("D08X", 3): _three_d08("Status3D08X", "Home3D08X"),
    ("D08X", 5): _fingers_d08(None),
}


def shape_of(board: Device | Twin) -> tuple[str, Kind, Shape]:
    """Return dialect, kind and row of a board. Raises `UnknownNameError` with the kinds that its dialect has."""
    dialect, own = board.variant.dialect or "D12", board.config.kind
    kind = own if isinstance(own, (int, str)) else board.config.channels
    found = None if kind is None else SHAPES.get((dialect, kind))
    if found is None or kind is None:
        raise UnknownNameError(
            f"kind of Hubo motor board of {dialect} ({board.name})",
            str(kind),
            [str(k) for d, k in SHAPES if d == dialect],
        )
    return dialect, kind, found
