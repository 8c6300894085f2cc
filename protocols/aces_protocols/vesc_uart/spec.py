"""VESC packets on UART, USB and TCP: a start, a length, the packet, its check, a stop.

1. The first byte of a packet (`comm`) says what it is; a request and its answer have the same one.
2. Numbers have the high byte first.
3. The check is CRC-16/XMODEM of the packet, and behind it stands the stop, 03. Both are one check here: a CRC of 24 bits
   whose polynomial is that of CRC-16, eight bits higher, leaves the low byte alone; the last exclusive or makes it 03.

Facts: vedderb/bldc `comm/packet.c`, `comm/commands.c`, `datatypes.h` (firmware 3.40 to 7.01).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from construct import (
    Array,
    Byte,
    Construct,
    GreedyBytes,
    GreedyRange,
    If,
    Int16sb,
    Int16ub,
    Int32sb,
    Int32ub,
    NullTerminated,
    StringEncoded,
    Struct,
    this,
)

from aces_bus.protocol import Crc, Enumeration, Flags, Message, Protocol

from .numbers import in_steps

_SOURCE = "vedderb/bldc comm/commands.c"
#: The longest packet of standard firmware.
MOST = 512
#: A longer pause inside a packet is a host that went away; the firmware names none.
GAP = 0.1

vesc_uart = Protocol(
    "vesc_uart",
    link="serial",
    baud=115_200,
    doc="VESC motor controllers on UART, USB and TCP.",
    source="vedderb/bldc comm/packet.c, comm/commands.c",
)


def _check(start: int) -> Crc:
    return Crc(width=24, poly=0x102100, init=0, xorout=0x000003, over=slice(start, -3), order="big")


short = vesc_uart.framing(
    name="short",
    sync=b"\x02",
    header=Struct("length" / Byte),
    size=this.length + 5,
    max_size=260,
    gap=GAP,
    check=_check(2),
)
#: Packets of 256 bytes and more.
long = vesc_uart.framing(
    name="long",
    sync=b"\x03",
    header=Struct("length" / Int16ub),
    size=this.length + 6,
    max_size=MOST + 6,
    gap=GAP,
    check=_check(3),
)
packet = short.family(prefix=Struct("comm" / Byte))


def _ask(comm: int, name: str, doc: str, *examples: Any, payload: Struct | None = None) -> Message:
    made: Message = packet(
        name, comm=comm, direction="to device", payload=payload, doc=doc, source=_SOURCE, examples=examples
    )
    return made


def _tell(comm: int, name: str, payload: Struct, doc: str, *examples: Any, **more: Any) -> None:
    packet(
        name,
        comm=comm,
        direction="from device",
        payload=payload,
        doc=doc,
        source=_SOURCE,
        examples=examples,
        **more,
    )


# ---------------------------------------------------------------------- values

FAULTS = {
    "none": 0,
    "over_voltage": 1,
    "under_voltage": 2,
    "drv": 3,
    "abs_over_current": 4,
    "over_temperature_fet": 5,
    "over_temperature_motor": 6,
    "gate_driver_over_voltage": 7,
    "gate_driver_under_voltage": 8,
    "mcu_under_voltage": 9,
    "watchdog_reset": 10,
    "encoder_spi": 11,
    "sincos_low": 12,
    "sincos_high": 13,
    "flash": 14,
    "current_offset_1": 15,
    "current_offset_2": 16,
    "current_offset_3": 17,
    "unbalanced_currents": 18,
    "brk": 19,
    "resolver_lot": 20,
    "resolver_dos": 21,
    "resolver_los": 22,
    "flash_app": 23,
    "flash_motor": 24,
    "encoder_no_magnet": 25,
    "encoder_magnet_strong": 26,
    "phase_filter": 27,
    "encoder": 28,
    "lv_output": 29,
    "encoder_slip": 30,
    "over_speed": 31,
    "under_speed": 32,
    "abs_over_speed": 33,
}

_TEMPERATURE, _CURRENT = in_steps(Int16sb, "°C", 10), in_steps(Int32sb, "A", 100)
#: What a controller tells of itself, in the order of the bits of the mask.
VALUES: Mapping[str, Construct] = {
    "fet_temperature": _TEMPERATURE,
    "motor_temperature": _TEMPERATURE,
    "motor_current": _CURRENT,
    "input_current": _CURRENT,
    "d_current": _CURRENT,
    "q_current": _CURRENT,
    "duty": in_steps(Int16sb, "", 1000),
    "speed": in_steps(Int32sb, "rpm", 1),
    "voltage": in_steps(Int16sb, "V", 10),
    "charge_used": in_steps(Int32sb, "A·h", 1e4),
    "charge_charged": in_steps(Int32sb, "A·h", 1e4),
    "energy_used": in_steps(Int32sb, "W·h", 1e4),
    "energy_charged": in_steps(Int32sb, "W·h", 1e4),
    "tachometer": Int32sb,
    "tachometer_abs": Int32sb,
    "fault": Enumeration(Byte, FAULTS),
    "position": in_steps(Int32sb, "°", 1e6),
    "controller": Byte,
    "mosfet_temperatures": Array(3, _TEMPERATURE),
    "d_voltage": in_steps(Int32sb, "V", 1e3),
    "q_voltage": in_steps(Int32sb, "V", 1e3),
    "status": Flags(Byte, timed_out=0, kill_switch=1),
}


def _up_to(last: str) -> Struct:
    names = list(VALUES)
    return Struct(*(name / VALUES[name] for name in names[: names.index(last) + 1]))


def mask_of(*names: str) -> int:
    """Return the mask that asks for these values.

    >>> hex(mask_of("duty", "speed", "voltage", "fault"))
    '0x81c0'
    """
    return sum(1 << list(VALUES).index(name) for name in names)


#: Worked by hand: the first 58 bytes of values, of firmware 3.40; then those of 4.02; then the last one.
_OF3 = (
    "01 9C 01 63 00 00 04 CE FF FF FE 3E 00 00 00 0A FF FF FB 37 FF 83 FF FF FA 24 01 E2 00 00 30 39 00 00 00 64"
    " 00 00 D4 31 00 00 00 C8 00 00 02 58 00 00 03 84 01 05 5D 4A 80 05"
)
_MORE = " 01 90 01 9A 01 A4 FF FF FA 24 00 00 09 C4"
_IN3 = {
    "fet_temperature": 41.2,
    "motor_temperature": 35.5,
    "motor_current": 12.3,
    "input_current": -4.5,
    "d_current": 0.1,
    "q_current": -12.25,
    "duty": -0.125,
    "speed": -1500,
    "voltage": 48.2,
    "charge_used": 1.2345,
    "charge_charged": 0.01,
    "energy_used": 5.4321,
    "energy_charged": 0.02,
    "tachometer": 600,
    "tachometer_abs": 900,
    "fault": "over_voltage",
    "position": 90.0,
    "controller": 5,
}
_IN5 = {**_IN3, "mosfet_temperatures": [40.0, 41.0, 42.0], "d_voltage": -1.5, "q_voltage": 2.5}
GetValues = _ask(4, "GetValues", "Ask for all values; it restarts their averages.", ("02 01 04 40 84 03", {}))
_tell(
    4,
    "Values",
    _up_to("status"),
    "All values, of firmware 6.00 and later.",
    (f"02 4A 04 {_OF3}{_MORE} 01 7F A4 03", {**_IN5, "status": ["timed_out"]}),
    reply_to=GetValues,
)
_tell(
    4,
    "ValuesOf5",
    _up_to("q_voltage"),
    "All values, of firmware 4.02 to 5.00.",
    (f"02 49 04 {_OF3}{_MORE} 27 3B 03", _IN5),
    reply_to=GetValues,
)
_tell(
    4,
    "ValuesOf3",
    _up_to("controller"),
    "All values, of firmware 3.40.",
    (f"02 3B 04 {_OF3} CA 96 03", _IN3),
    reply_to=GetValues,
)
GetSelected = _ask(
    50,
    "GetSelected",
    "Ask for the values of the bits of `mask`, see VALUES.",
    ("02 05 32 00 00 81 C0 B9 88 03", {"mask": 0x81C0}),
    payload=Struct("mask" / Int32ub),
)
_tell(
    50,
    "Selected",
    Struct(
        "mask" / Int32ub,
        *(name / If(this.mask & 1 << bit, field) for bit, (name, field) in enumerate(VALUES.items())),
    ),
    "The values of the bits of `mask`; others are unknown.",
    (
        "02 0E 32 00 00 81 C0 FF 83 FF FF FA 24 01 E2 00 E7 97 03",
        {"mask": 0x81C0, "duty": -0.125, "speed": -1500, "voltage": 48.2, "fault": "none"},
    ),
    reply_to=GetSelected,
)

# ---------------------------------------------------------------------- who it is

GetFirmware = _ask(0, "GetFirmware", "Ask for version, hardware, and chip.", ("02 01 00 00 00 03", {}))
_tell(
    0,
    "Firmware",
    Struct(
        "major" / Byte,
        "minor" / Byte,
        "hardware" / StringEncoded(NullTerminated(GreedyBytes), "ascii"),
        "more" / GreedyBytes * "12 bytes of chip number, then what the version has",
    ),
    "Version and hardware.",
    (
        "02 12 00 06 05 36 30 00 00 01 02 03 04 05 06 07 08 09 0A 0B E6 FD 03",
        {"major": 6, "minor": 5, "hardware": "60", "more": bytes(range(12))},
    ),
    reply_to=GetFirmware,
)
PingCan = _ask(
    62, "PingCan", "Ask for the controllers that it finds on its CAN bus.", ("02 01 3E D7 9D 03", {})
)
_tell(
    62,
    "CanDevices",
    Struct("devices" / GreedyRange(Byte)),
    "The numbers of controllers on its CAN bus.",
    ("02 03 3E 05 17 43 87 03", {"devices": [5, 0x17]}),
    reply_to=PingCan,
)

# ---------------------------------------------------------------------- set-points: each restarts the controller's time-out

_ask(
    5,
    "SetDuty",
    "Drive at a share of the supply.",
    ("02 05 05 FF FF 9E 58 47 8E 03", {"duty": -0.25}),
    payload=Struct("duty" / in_steps(Int32sb, "", 1e5, range=(-1.0, 1.0))),
)
for _comm, _name, _doc, _example in (
    (6, "SetCurrent", "Drive with a motor current; 0 releases the motor.", "02 05 06 00 00 13 88 8B 25 03"),
    (7, "SetBrakeCurrent", "Brake with a motor current.", "02 05 07 00 00 13 88 21 74 03"),
    (10, "SetHandbrake", "Hold where it is, with a current.", "02 05 0A 00 00 13 88 00 0E 03"),
):
    _ask(
        _comm,
        _name,
        _doc,
        (_example, {"current": 5.0}),
        payload=Struct("current" / in_steps(Int32sb, "A", 1000)),
    )
_ask(
    8,
    "SetSpeed",
    "Hold an electrical speed: pole pairs × that of the motor.",
    ("02 05 08 00 00 0B B8 F8 04 03", {"speed": 3000}),
    payload=Struct("speed" / in_steps(Int32sb, "rpm", 1)),
)
_ask(
    9,
    "SetPosition",
    "Hold an angle of the encoder; it is taken within a turn.",
    ("02 05 09 05 5D 4A 80 7B 29 03", {"position": 90.0}),
    payload=Struct("position" / in_steps(Int32sb, "°", 1e6)),
)
_ask(
    84,
    "SetCurrentRelative",
    "Drive with a share of the maximum current.",
    ("02 05 54 FF FF 9E 58 F8 ED 03", {"current": -0.25}),
    payload=Struct("current" / in_steps(Int32sb, "", 1e5, range=(-1.0, 1.0))),
)
_ask(
    12,
    "SetServo",
    "Where a model servo on its output is to be.",
    ("02 03 0C 01 F4 E9 CB 03", {"position": 0.5}),
    payload=Struct("position" / in_steps(Int16sb, "", 1000, range=(0.0, 1.0))),
)
_ask(30, "Alive", "Restart the time-out, and nothing else.", ("02 01 1E F3 FF 03", {}))
_ask(29, "Reboot", "Switch it off and on.", ("02 01 1D C3 9C 03", {}))

# ---------------------------------------------------------------------- terminal, display, other buses

_ask(
    20,
    "Terminal",
    "A line to its terminal.",
    ("02 07 14 66 61 75 6C 74 73 0D 9A 03", {"text": b"faults"}),
    payload=Struct("text" / GreedyBytes),
)
_tell(
    21,
    "Print",
    Struct("text" / GreedyBytes),
    "A line of its terminal.",
    ("02 03 15 6F 6B 6E 4A 03", {"text": b"ok"}),
)
_ask(
    11,
    "SetDisplay",
    "Have it send angles, again and again.",
    ("02 02 0B 03 EC 99 03", {"mode": "encoder"}),
    payload=Struct("mode" / Enumeration(Byte, none=0, encoder=3, position=4, error=5)),
)
_tell(
    22,
    "RotorPosition",
    Struct("position" / in_steps(Int32sb, "°", 1e5)),
    "An angle, as SetDisplay has it.",
    ("02 05 16 00 89 54 40 E6 AB 03", {"position": 90.0}),
)
_ask(
    34,
    "ForwardCan",
    "Give a packet to a controller on its CAN bus, whose answer comes as if it were its own.",
    ("02 07 22 05 08 00 00 0B B8 B5 10 03", {"controller": 5, "packet": bytes.fromhex("08 00 00 0B B8")}),
    payload=Struct("controller" / Byte, "packet" / GreedyBytes),
)
_ask(
    85,
    "SendCanFrame",
    "Send a frame on its CAN bus.",
    (
        "02 08 55 00 00 01 23 00 DE AD D7 76 03",
        {"identifier": 0x123, "extended": 0, "data": bytes.fromhex("DE AD")},
    ),
    payload=Struct("identifier" / Int32ub, "extended" / Byte, "data" / GreedyBytes),
)
long(
    "LongAnswer",
    direction="from device",
    payload=Struct("data" / GreedyBytes),
    doc="An answer of 256 bytes and more: configurations, custom data; `data` begins with its number.",
    source="vedderb/bldc comm/packet.c",
    examples=[("03 01 00 0E" + " 00" * 255 + " 32 7E 03", {"data": b"\x0e" + bytes(255)})],
)
