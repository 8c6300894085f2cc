"""Basicmicro RoboClaw motor controllers in packet serial mode: two motors each, up to eight controllers on one line.

1. A request is address, command, data and CRC-16; a question is address and command alone. Numbers are big-endian.
2. An answer has no head: the request says what it is, how long it is and whose. Its CRC covers address and command of the
   request, then the answer's own bytes. What writes is answered by one byte, FF.
3. Counters and speeds of 32 bits are read as two's complement, as the maker's libraries do; the manual has them unsigned.

Sources: RoboClaw Series User Manual, Basicmicro, pages 57 to 99 (the numbers below are its pages); the scale of position
gains and the width of the status (since firmware 4.1.29), Basicmicro's Python library and its forum, topic 806.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any

from construct import Byte, Const, Construct, Int16sb, Int16ub, Int32sb, Int32ub, Struct

from aces_bus.protocol import Crc, Flags, Message, Protocol, Quantity, RequestBytes, Text

from .examples import EXAMPLES

#: Modes 7 to 14 (page 57).
ADDRESSES = range(0x80, 0x88)
#: A longer pause inside a packet discards it (page 58).
GAP = 0.01
#: An answer comes at once, up to 38,400 baud 1 ms later (page 60); the rest is for adapters that collect bytes.
WITHIN = 0.1
#: The largest duty, 100 % (page 90).
FULL_DUTY = 32767

roboclaw = Protocol(
    "roboclaw",
    link="serial",
    baud=38_400,
    doc="Basicmicro RoboClaw dual motor controllers, packet serial: up to eight on one line.",
    source="RoboClaw Series User Manual, Basicmicro",
)

_HEAD = Struct("address" / Byte, "command" / Byte)
_OVER = (RequestBytes(), slice(None, -2))
#: The commands that ask, and those that write, by their bytes of data.
_ASKING = (
    15, 16, 17, 18, 19, 21, 24, 25, 30, 31, 47, 48, 49, 55, 56, 59, 60, 63, 64, 72, 77, 78, 79, 81, 82, 83, 90, 91,
    108, 110, 111, 113, 114, 135, 136,
)  # fmt: skip
_WRITING: Mapping[int, tuple[int, ...]] = {
    0: (20,),
    1: (0, 1, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 92, 93),
    2: (32, 33, 70, 71, 76),
    4: (22, 23, 34, 35, 36, 57, 58, 68, 69),
    5: (119, 120),
    6: (52, 53),
    8: (37, 38, 39, 109, 112, 133, 134),
    9: (41, 42, 121, 122, 123),
    12: (40, 54),
    13: (44, 45),
    16: (28, 29, 50),
    17: (43, 65, 66, 124),
    21: (46,),
    25: (51,),
    28: (61, 62),
    33: (67,),
}
_ask = roboclaw.framing(
    name="question", header=_HEAD, match={"address": ADDRESSES, "command": _ASKING}, size=2, gap=GAP
)
_written: list[Message] = []


@cache
def _writing(size: int) -> Any:
    return roboclaw.framing(
        name=f"request of {size}",
        header=_HEAD,
        match={"address": ADDRESSES, "command": _WRITING[size]},
        size=size + 4,
        gap=GAP,
        check=Crc("CRC16-XMODEM", order="big"),
    )


@cache
def _answer(size: int) -> Any:
    return roboclaw.framing(
        name=f"answer of {size}",
        size=size + 2,
        gap=GAP,
        check=Crc("CRC16-XMODEM", order="big", over=_OVER),
    )


_text = roboclaw.framing(
    name="text",
    end=b"\n\0",
    max_size=50,
    gap=GAP,
    check=Crc("CRC16-XMODEM", order="big", over=_OVER, after_end=True),
)
_acknowledgement = roboclaw.framing(name="acknowledgement", size=1, gap=GAP)


def _writes(name: str, command: int, page: int, doc: str, *fields: Construct) -> None:
    """Declare what sets or moves something."""
    payload = Struct(*fields)
    _written.append(
        _writing(payload.sizeof())(
            name,
            direction="to device",
            match={"command": command},
            payload=payload,
            doc=doc,
            source=f"page {page}",
            examples=EXAMPLES[name],
        )
    )


def _reads(name: str, command: int, page: int, doc: str, *fields: Construct, framing: Any = None) -> None:
    """Declare a question, `Get` before its name, and its answer."""
    payload = Struct(*fields)
    asked = _ask(
        f"Get{name}",
        direction="to device",
        match={"command": command},
        doc=f"Ask for: {doc}",
        source=f"page {page}",
        examples=[(f"80 {command:02X}", {"address": 0x80})],
    )
    (framing or _answer(payload.sizeof()))(
        name,
        direction="from device",
        reply_to=asked.where(address=ADDRESSES),
        within=WITHIN,
        payload=payload,
        doc=doc,
        source=f"page {page}",
        examples=EXAMPLES[name],
    )


def _number(name: str, body: Construct, unit: str, scale: float = 1.0, **more: Any) -> Construct:
    return name / Quantity(body, unit=unit, scale=scale, **more)


def _count(name: str) -> Construct:
    return _number(name, Int32sb, "count")


def _speed(name: str) -> Construct:
    return _number(name, Int32sb, "count/s")


def _rate(name: str) -> Construct:
    return _number(name, Int32ub, "count/s²")


def _distance(name: str) -> Construct:
    return _number(name, Int32ub, "count")


def _duty(name: str) -> Construct:
    """Declare a share of the supply."""
    return _number(name, Int16sb, "", 1 / FULL_DUTY)


def _volts(name: str) -> Construct:
    return _number(name, Int16ub, "V", 0.1)


def _share(name: str) -> Construct:
    return name / Quantity(Byte, raw_range=(0, 127))


#: 1: instead of what is under way and what waits; 0: behind it (page 93).
_BUFFER = "at_once" / Quantity(Byte, raw_range=(0, 1))
_M1M2 = (1, 2)

# ---------------------------------------------------------------------- commands of a byte (pages 62 to 65)

_writes("ForwardM1", 0, 62, "Drive motor 1 forward: 127 is full speed.", _share("speed"))
_writes("BackwardM1", 1, 62, "Drive motor 1 backward: 127 is full speed.", _share("speed"))
_writes("ForwardM2", 4, 63, "Drive motor 2 forward: 127 is full speed.", _share("speed"))
_writes("BackwardM2", 5, 63, "Drive motor 2 backward: 127 is full speed.", _share("speed"))
for _motor in _M1M2:
    _writes(
        f"BothWaysM{_motor}",
        5 + _motor,
        63,
        f"Drive motor {_motor}: 0 is full speed backward, 64 stops, 127 is full speed forward.",
        _share("speed"),
    )
_writes("MixedForward", 8, 64, "Drive forward, both motors mixed: 127 is full speed.", _share("speed"))
_writes("MixedBackward", 9, 64, "Drive backward, both motors mixed: 127 is full speed.", _share("speed"))
_writes("MixedRight", 10, 64, "Turn right, both motors mixed: 127 is full speed.", _share("speed"))
_writes("MixedLeft", 11, 64, "Turn left, both motors mixed: 127 is full speed.", _share("speed"))
_writes("MixedBothWays", 12, 64, "Drive, mixed: 0 backward, 64 stops, 127 forward.", _share("speed"))
_writes("MixedTurn", 13, 64, "Turn, mixed: 0 left, 64 does not turn, 127 right.", _share("speed"))

# ---------------------------------------------------------------------- the controller (pages 66 to 78)

_TIMEOUT = _number("timeout", Byte, "s", 0.1)
_writes("SetSerialTimeout", 14, 66, "Without serial bytes for so long both motors stop; 0: never.", _TIMEOUT)
_reads("SerialTimeout", 15, 66, "the serial time-out; 0: none", _TIMEOUT)
_reads("Version", 21, 67, "name and firmware, up to 48 bytes", "version" / Text(), framing=_text)
_reads("MainVoltage", 24, 67, "the main battery's voltage", _volts("voltage"))
_reads("LogicVoltage", 25, 67, "the logic battery's voltage", _volts("voltage"))
_reads("Duties", 48, 68, "the duties of both motors", _duty("m1"), _duty("m2"))
_reads(
    "Currents",
    49,
    68,
    "the currents of both motors",
    _number("m1", Int16sb, "A", 0.01),
    _number("m2", Int16sb, "A", 0.01),
)
for _name, _set, _get in (("Main", 57, 59), ("Logic", 58, 60)):
    _limits = (_volts("lowest"), _volts("highest"))
    _writes(
        f"Set{_name}VoltageLimits",
        _set,
        68,
        f"Set the {_name.lower()} battery's limits of voltage.",
        *_limits,
    )
    _reads(f"{_name}VoltageLimits", _get, 68, f"the {_name.lower()} battery's limits of voltage", *_limits)
for _motor in _M1M2:
    _writes(
        f"SetDutyAccelerationM{_motor}",
        67 + _motor,
        68,
        f"Set how fast the duty of motor {_motor} changes, in steps of a duty a second.",
        "acceleration" / Int32ub,
    )
    _writes(
        f"SetDefaultSpeedM{_motor}",
        69 + _motor,
        69,
        f"Set the speed of motor {_motor} to positions without a speed, as a share of its largest.",
        _number("speed", Int16ub, "", 1 / FULL_DUTY, range=(0, 1)),
    )
_reads(
    "DefaultSpeeds",
    72,
    69,
    "the speeds to positions without a speed",
    _number("m1", Int16ub, "", 1 / FULL_DUTY),
    _number("m2", Int16ub, "", 1 / FULL_DUTY),
)
_DEADBAND = (_number("backward", Byte, "%", 0.1), _number("forward", Byte, "%", 0.1))
_writes("SetDeadband", 76, 70, "Set the dead band of RC and analog control.", *_DEADBAND)
_reads("Deadband", 77, 71, "the dead band of RC and analog control", *_DEADBAND)
_reads("DutyAccelerations", 81, 71, "how fast duties change", "m1" / Int32ub, "m2" / Int32ub)
for _name, _command, _what in (("Temperature", 82, "the board"), ("Temperature2", 83, "its second sensor")):
    _reads(_name, _command, 71, f"the temperature of {_what}", _number("temperature", Int16sb, "°C", 0.1))
_reads(
    "Status",
    90,
    72,
    "what is wrong, and warnings",
    "status"
    / Flags(
        Int32ub,
        e_stop=0,
        temperature=1,
        temperature_2=2,
        main_voltage_high=3,
        logic_voltage_high=4,
        logic_voltage_low=5,
        driver_m1=6,
        driver_m2=7,
        speed_m1=8,
        speed_m2=9,
        position_m1=10,
        position_m2=11,
        current_m1=12,
        current_m2=13,
        warning_current_m1=16,
        warning_current_m2=17,
        warning_main_voltage_high=18,
        warning_main_voltage_low=19,
        warning_temperature=20,
        warning_temperature_2=21,
        s4_triggered=22,
        s5_triggered=23,
        warning_speed_limit=24,
        warning_position_limit=25,
    ),
)
_MODE_BITS = {"absolute": 0, "motor_reversed": 5, "encoder_reversed": 6, "for_rc_and_analog": 7}
_reads(
    "EncoderModes",
    91,
    72,
    "the modes of both encoders",
    "m1" / Flags(Byte, **_MODE_BITS),
    "m2" / Flags(Byte, **_MODE_BITS),
)
for _motor in _M1M2:
    _writes(
        f"SetEncoderModeM{_motor}",
        91 + _motor,
        73,
        f"Set the mode of encoder {_motor}.",
        "mode" / Flags(Byte, **_MODE_BITS),
    )
for _name, _set, _get, _page, _make in (
    ("Speed", 109, 110, 76, lambda name: _number(name, Int32ub, "count/s")),
    ("Position", 112, 113, 77, _distance),
):
    _limits = (_make("m1"), _make("m2"))
    _writes(
        f"Set{_name}ErrorLimits",
        _set,
        _page,
        f"Set from what error of {_name.lower()} on it warns.",
        *_limits,
    )
    _reads(f"{_name}ErrorLimits", _get, _page, f"from what error of {_name.lower()} on it warns", *_limits)
for _motor in _M1M2:
    _most = _number("highest", Int32ub, "A", 0.01)
    _writes(
        f"SetCurrentLimitM{_motor}",
        132 + _motor,
        78,
        f"Set the largest current of motor {_motor}.",
        _most,
        Const(bytes(4)),
    )
    _reads(
        f"CurrentLimitM{_motor}",
        134 + _motor,
        78,
        f"the largest current of motor {_motor}; `lowest` is always 0",
        _most,
        _number("lowest", Int32ub, "A", 0.01),
    )

# ---------------------------------------------------------------------- encoders (pages 85 to 88)

_COUNTER_BITS = {"underflow": 0, "backward": 1, "overflow": 2}
for _motor in _M1M2:
    _reads(
        f"EncoderM{_motor}",
        15 + _motor,
        84 + _motor,
        f"encoder {_motor}; underflow and overflow are of the time since they were read",
        _count("position"),
        "status" / Flags(Byte, **_COUNTER_BITS),
    )
    for _name, _command, _page, _what in (
        ("Speed", 17, 86, "the speed, filtered"),
        ("RawSpeed", 29, 87, "the speed of the last 1/300 s"),
    ):
        _reads(
            f"{_name}M{_motor}",
            _command + _motor,
            _page,
            f"{_what}, of encoder {_motor}",
            _speed("speed"),
            "backward" / Byte,
        )
    _writes(f"SetEncoderM{_motor}", 21 + _motor, 87, f"Set encoder {_motor}.", _count("position"))
_writes("ResetEncoders", 20, 86, "Set both encoders to 0.")
_reads("Encoders", 78, 87, "both encoders", _count("m1"), _count("m2"))
for _name, _command, _page, _what in (
    ("RawSpeeds", 79, 87, "both speeds of the last 1/300 s"),
    ("MeanSpeeds", 108, 88, "both speeds of the last second"),
    ("SpeedErrors", 111, 88, "the errors of both speeds"),
):
    _reads(_name, _command, _page, _what, _speed("m1"), _speed("m2"))
_reads("PositionErrors", 114, 88, "the errors of both positions", _count("m1"), _count("m2"))

# ---------------------------------------------------------------------- motion (pages 89 to 99)

for _motor in _M1M2:
    _gains = [_number(name, Int32ub, "", 1 / 65536) for name in ("d", "p", "i")]
    _d, _p, _i = _gains
    _most = _number("full_speed", Int32ub, "count/s")
    _doc = f"the gains of motor {_motor}'s speed, and its speed at full duty (QPPS)"
    _writes(f"SetSpeedGainsM{_motor}", 27 + _motor, 90, f"Set {_doc}.", _d, _p, _i, _most)
    _reads(f"SpeedGainsM{_motor}", 54 + _motor, 97, _doc, _p, _i, _d, _most)
    _d, _p, _i = (_number(name, Int32ub, "", 1 / 1024) for name in ("d", "p", "i"))
    _more = (
        "most_integral" / Int32ub,
        _distance("deadzone"),
        _count("lowest"),
        _count("highest"),
    )
    _doc = f"the gains of motor {_motor}'s position, its dead zone, and its limits"
    _writes(f"SetPositionGainsM{_motor}", 60 + _motor, 97, f"Set {_doc}.", _d, _p, _i, *_more)
    _reads(f"PositionGainsM{_motor}", 62 + _motor, 98, _doc, _p, _i, _d, *_more)
    _own = f"motor {_motor}"
    _writes(
        f"DriveDutyM{_motor}", 31 + _motor, 90, f"Drive {_own} with a share of the supply.", _duty("duty")
    )
    _writes(
        f"DriveSpeedM{_motor}",
        34 + _motor,
        92,
        f"Turn {_own} with a speed, as fast as it gets there.",
        _speed("speed"),
    )
    _writes(
        f"RampSpeedM{_motor}",
        37 + _motor,
        92,
        f"Turn {_own} with a speed, ramped.",
        _rate("acceleration"),
        _speed("speed"),
    )
    _writes(
        f"GoDistanceM{_motor}",
        40 + _motor,
        93,
        f"Turn {_own} over a distance.",
        _speed("speed"),
        _distance("distance"),
        _BUFFER,
    )
    _writes(
        f"RampDistanceM{_motor}",
        43 + _motor,
        94,
        f"Turn {_own} over a distance, ramped.",
        _rate("acceleration"),
        _speed("speed"),
        _distance("distance"),
        _BUFFER,
    )
    _writes(
        f"RampDutyM{_motor}",
        51 + _motor,
        96,
        f"Drive {_own} with a share of the supply, ramped: `acceleration` is steps of a duty a second.",
        _duty("duty"),
        "acceleration" / Int32ub,
    )
    _writes(
        f"RampToM{_motor}",
        64 + _motor,
        98,
        f"Turn {_own} to a position, ramped, and hold it.",
        _rate("acceleration"),
        _number("speed", Int32ub, "count/s"),
        _rate("deceleration"),
        _count("position"),
        _BUFFER,
    )
    _writes(
        f"GoToM{_motor}",
        118 + _motor,
        99,
        f"Turn {_own} to a position, and hold it.",
        _count("position"),
        _BUFFER,
    )
    _writes(
        f"GoWithSpeedToM{_motor}",
        121 + _motor,
        99,
        f"Turn {_own} to a position with a speed, and hold it.",
        _number("speed", Int32ub, "count/s"),
        _count("position"),
        _BUFFER,
    )
_writes("DriveDuties", 34, 91, "Drive both motors with shares of the supply.", _duty("m1"), _duty("m2"))
_writes("DriveSpeeds", 37, 92, "Turn both motors with speeds.", _speed("m1"), _speed("m2"))
_writes(
    "RampSpeeds",
    40,
    93,
    "Turn both motors with speeds, ramped alike.",
    _rate("acceleration"),
    _speed("m1"),
    _speed("m2"),
)
_writes(
    "GoDistances",
    43,
    94,
    "Turn both motors over distances.",
    *(
        make(f"{name}_m{motor}")
        for motor in _M1M2
        for make, name in ((_speed, "speed"), (_distance, "distance"))
    ),
    _BUFFER,
)
_writes(
    "RampDistances",
    46,
    95,
    "Turn both motors over distances, ramped alike.",
    _rate("acceleration"),
    *(
        make(f"{name}_m{motor}")
        for motor in _M1M2
        for make, name in ((_speed, "speed"), (_distance, "distance"))
    ),
    _BUFFER,
)
_reads(
    "Buffers", 47, 95, "how many commands wait; 128: none, and none is under way", "m1" / Byte, "m2" / Byte
)
_writes(
    "RampSpeedsApart",
    50,
    96,
    "Turn both motors with speeds, each ramped.",
    *(
        make(f"{name}_m{motor}")
        for motor in _M1M2
        for make, name in ((_rate, "acceleration"), (_speed, "speed"))
    ),
)
_writes(
    "RampDistancesApart",
    51,
    96,
    "Turn both motors over distances, each ramped.",
    *(
        make(f"{name}_m{motor}")
        for motor in _M1M2
        for make, name in ((_rate, "acceleration"), (_speed, "speed"), (_distance, "distance"))
    ),
    _BUFFER,
)
_writes(
    "RampDuties",
    54,
    97,
    "Drive both motors with shares of the supply, each ramped.",
    _duty("duty_m1"),
    "acceleration_m1" / Int32ub,
    _duty("duty_m2"),
    "acceleration_m2" / Int32ub,
)
_writes(
    "RampBothTo",
    67,
    99,
    "Turn both motors to positions, ramped, and hold them.",
    *(
        make(f"{name}_m{motor}")
        for motor in _M1M2
        for make, name in (
            (_rate, "acceleration"),
            (lambda name: _number(name, Int32ub, "count/s"), "speed"),
            (_rate, "deceleration"),
            (_count, "position"),
        )
    ),
    _BUFFER,
)
_writes("GoBothTo", 121, 99, "Turn both motors to positions.", _count("m1"), _count("m2"), _BUFFER)
_writes(
    "GoBothWithSpeedTo",
    124,
    99,
    "Turn both motors to positions with speeds.",
    *(
        make(f"{name}_m{motor}")
        for motor in _M1M2
        for make, name in ((lambda name: _number(name, Int32ub, "count/s"), "speed"), (_count, "position"))
    ),
    _BUFFER,
)

Done = _acknowledgement(
    "Done",
    direction="from device",
    reply_to=[message.where(address=ADDRESSES) for message in _written],
    within=WITHIN,
    payload=Struct(Const(b"\xff")),
    doc="What was written is carried out. What is not valid is not answered at all.",
    source="page 58",
    examples=[("FF", {"address": 0x80}, "80 0E 0A B9 1F")],
)
