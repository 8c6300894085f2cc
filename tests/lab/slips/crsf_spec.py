"""A radio link: channels of eleven bits, telemetry with the high byte first, a CRC over type and payload."""

from __future__ import annotations

from construct import Byte, Int8sb, Int16sb, Int16ub, Int24ub, Int32sb, Struct, this

from aces_bus.protocol import BitLayout, Crc, Enumeration, Protocol, Quantity, Text, bits

crsf = Protocol("crsf", link="serial", baud=420_000, source="CRSF protocol, rev 11")
packet = crsf.framing(
    sync=b"\xc8",
    header=Struct("length" / Byte, "kind" / Byte),
    size=this.length + 2,
    max_size=64,
    gap=0.02,
    check=Crc("CRC8-DVB-S2", over=slice(2, -1)),
)
packet(
    "Gps",
    match={"kind": 0x02},
    direction="from device",
    payload=Struct(
        "latitude" / Quantity(Int32sb, unit="°", scale=1e-7),
        "longitude" / Quantity(Int32sb, unit="°", scale=1e-7),
        "speed" / Quantity(Int16ub, unit="km/h", scale=0.1, range=(0, 500)),
        "heading" / Quantity(Int16ub, unit="°", scale=0.01, range=(0, 360)),
        "altitude" / Quantity(Int16ub, unit="m", offset=-1000, range=(-1000, 5000)),
        "satellites" / Byte,
    ),
)
packet(
    "Battery",
    match={"kind": 0x08},
    direction="from device",
    payload=Struct(
        "voltage" / Quantity(Int16ub, unit="V", scale=0.1, range=(0, 60)),
        "current" / Quantity(Int16ub, unit="A", scale=0.1, range=(0, 200)),
        "used" / Quantity(Int24ub, unit="mAh"),
        "left" / Quantity(Byte, unit="%", range=(0, 100)),
    ),
    examples=[
        ("C8 0A 08 00 F9 00 7B 00 01 F4 4B 10", {"voltage": 24.9, "current": 12.3, "used": 500, "left": 75})
    ],
)
packet(
    "Link",
    match={"kind": 0x14},
    direction="from device",
    payload=Struct(
        "up_rssi" / Byte,
        "up_quality" / Quantity(Byte, unit="%", range=(0, 100)),
        "up_snr" / Quantity(Int8sb, unit="dB"),
        "antenna" / Byte,
        "mode" / Enumeration(Byte, {"4fps": 0, "50fps": 1, "150fps": 2}),
        "power" / Enumeration(Byte, {"0mW": 0, "10mW": 1, "25mW": 2, "100mW": 3}),
    ),
)
packet(
    "Channels",
    match={"kind": 0x16},
    direction="to device",
    payload=BitLayout(22, *(f"channel{n}" / bits(11) for n in range(1, 17))),
)
packet(
    "Attitude",
    match={"kind": 0x1E},
    direction="from device",
    payload=Struct(
        "pitch" / Quantity(Int16sb, unit="rad", scale=1e-4, range=(-3.2, 3.2)),
        "roll" / Quantity(Int16sb, unit="rad", scale=1e-4, range=(-3.2, 3.2)),
        "yaw" / Quantity(Int16sb, unit="rad", scale=1e-4, range=(-3.2, 3.2)),
    ),
)
packet("Mode", match={"kind": 0x21}, direction="from device", payload=Struct("name" / Text(6)))
