"""MicroStrain MIP in under 100 lines: some messages to and from inertial units of that make.

Written from the README and the tutorial alone. A packet carries fields of different kinds, each with its own length, so
that devices may send unknown kinds: those stay bytes.

    aces decode session.bin -p examples/mip.py --direction from

Source: LORD-MicroStrain/mip_sdk (`src/c/mip/definitions`); its own parser accepts the examples.
"""

from __future__ import annotations

from typing import Any

from construct import (
    Array,
    Byte,
    Const,
    Float32b,
    Float64b,
    Int16ub,
    Prefixed,
    PrefixedArray,
    Struct,
    this,
)

from aces_bus.protocol import Enumeration, Flags, Fletcher, Items, Protocol, Quantity

mip = Protocol("mip", link="serial", baud=115_200, source="LORD-MicroStrain/mip_sdk, definitions")
SETS = Enumeration(Byte, base=0x01, imu=0x0C, filter=0x0D, sensors=0x80, estimate=0x82)

# 75 65 | descriptor set, length | fields | Fletcher pair over all before it
packet = mip.framing(
    sync=b"\x75\x65",
    header=Struct("set" / SETS, "length" / Byte),
    size=this.length + 6,
    max_size=261,
    gap=0.1,
    check=Fletcher(over=slice(0, -2)),
)


def field(data: Any) -> Prefixed:
    """Return a length that counts itself, then a descriptor and its data."""
    return Prefixed(Byte, data, includelength=True)


def fields(**kinds: tuple[int, Any]) -> Struct:
    """Any number of fields, each with a length that counts all of it and a descriptor; those of unknown kinds stay bytes."""
    return Struct("fields" / Items(size=Byte, tag=Byte, size_first=True, counts="item", kinds=kinds))


def vector(count: int, unit: str = "") -> Any:
    return Array(count, Quantity(Float32b, unit=unit))


# fmt: off
SELECTOR = Enumeration(Byte, write=1, read=2, save=3, load=4, reset=5)
CODES = Enumeration(Byte, ok=0, unknown=1, checksum=2, parameter=3, failed=4, timeout=5)
TIME = Struct("of_week" / Quantity(Float64b, unit="s"), "week" / Int16ub,
              "valid" / Flags(Int16ub, pps=0, refresh=1, initialised=2, of_week=3, week=4))
EULER = Struct("roll_pitch_yaw" / vector(3, "rad"), "valid" / Int16ub)
POSITION = Struct("degrees" / Array(2, Quantity(Float64b, unit="°")), "height" / Quantity(Float64b, unit="m"),
                  "valid" / Int16ub)

command = packet.family(Struct("size" / Byte, "command" / Byte), direction="to device")
command("Ping", match={"set": "base"}, size=2, command=0x01, examples=[("75 65 01 02 02 01 E0 C6", {})])
command("Idle", match={"set": "base"}, size=2, command=0x02, examples=[("75 65 01 02 02 02 E1 C7", {})])
command("Resume", match={"set": "base"}, size=2, command=0x06)
packet("MessageFormat", match={"set": "imu"}, direction="to device", doc="What the device sends by itself, and how often.",
       payload=Struct("command" / field(Struct(Const(0x0F, Byte), "function" / SELECTOR, "set" / SETS,
                      "fields" / PrefixedArray(Byte, Struct("kind" / Byte, "decimation" / Int16ub))))),
       examples=[("75 65 0C 0B 0B 0F 01 80 02 04 00 0A 05 00 0A AB 00", {"command": {"function": "write", "set": "sensors",
                  "fields": [{"kind": 4, "decimation": 10}, {"kind": 5, "decimation": 10}]}})])
packet("Answer", match={"set": {0x01, 0x0C, 0x0D}}, direction="from device", doc="Whether a command was taken.",
       payload=fields(ack=(0xF1, Struct("command" / Byte, "code" / CODES))), examples=[
           ("75 65 01 04 04 F1 01 00 D5 6A", {"set": "base", "fields": [{"kind": "ack", "data": {"code": "ok"}}]}),
           ("75 65 0C 04 04 F1 08 03 EA BD", {"set": "imu", "fields": [{"data": {"command": 8, "code": "parameter"}}]})])
packet("Sensors", match={"set": "sensors"}, direction="from device", doc="What was measured.",
       payload=fields(accel=(0x04, vector(3, "g")), gyro=(0x05, vector(3, "rad/s")), mag=(0x06, vector(3, "G")),
                      quaternion=(0x0A, vector(4)), euler=(0x0C, vector(3, "rad")), gps_time=(0x12, TIME)),
       examples=[("75 65 80 2A 0E 04 3C 23 D7 0A BC A3 D7 0A BF 80 00 00 0E 05 3A 83 12 6F 00 00 00 00 BB 03 12 6F"
                  " 0E 12 40 FE 24 08 00 00 00 00 08 FC 00 1F 92 A3", {"fields": [
                      {"kind": "accel", "data": [0.01, -0.02, -1]}, {"kind": "gyro", "data": [0.001, 0, -0.002]},
                      {"kind": "gps_time", "data": {"of_week": 123456.5, "week": 2300}}]})])
packet("Estimate", match={"set": "estimate"}, direction="from device", doc="What the filter makes of it.",
       payload=fields(position=(0x01, POSITION), euler=(0x05, EULER),
                      quaternion=(0x03, Struct("wxyz" / vector(4), "valid" / Int16ub))),
       examples=[("75 65 82 14 14 03 3F 80 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 01 47 93",
                  {"fields": [{"kind": "quaternion", "data": {"wxyz": [1, 0, 0, 0], "valid": 1}}]})])
