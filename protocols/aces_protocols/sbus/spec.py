"""SBUS, from radio-control receivers to servos and flight controllers: 16 channels of 11 bits, two switches, radio state.

1. A frame has 25 bytes: 0F, 22 bytes of channels, lowest bits first, a byte of flags, a last byte. It is its only check.
2. The last byte is 00, of SBUS2 also 04, 14, 24 or 34: it says which eight of 32 slots sensors may answer in (in the
   2 ms after the frame). Each has a message of its own here, of the same fields.
3. The line is inverted, with even parity and two stop bits: an adapter needs an inverter and these settings.

Sources: Betaflight `rx/sbus_channels.c` (fields, flags, scale), PX4 `lib/rc/sbus.cpp` (last bytes), BrushlessPower
`SBUS2-Telemetry` (slots).
"""

from __future__ import annotations

from typing import Any

from aces_bus.protocol import BitLayout, Flags, Protocol, Quantity, Sum, Tuple, bits

CHANNELS = 16
#: Messages by their last byte (PX4; slots: SBUS2-Telemetry).
LAST = {
    "Channels": 0x00,
    "ChannelsSlots0": 0x04,
    "ChannelsSlots8": 0x14,
    "ChannelsSlots16": 0x24,
    "ChannelsSlots24": 0x34,
}

sbus = Protocol(
    "sbus",
    link="serial",
    baud=100_000,
    doc="SBUS and SBUS2: channels of a radio-control receiver.",
    source="Betaflight rx/sbus_channels.c, PX4 lib/rc/sbus.cpp",
)
# 5/8 µs a step, 880 µs at 0: 172 is 987.5 µs, 992 is 1500 µs, 1811 is 2012 µs (Betaflight)
_pulse = Quantity(bits(11), unit="µs", scale=0.625, offset=880)
_payload = BitLayout(
    23,
    "channels" / Tuple(*[_pulse] * CHANNELS),
    "flags" / Flags(bits(4), channel_17=0, channel_18=1, frame_lost=2, failsafe=3),
)
#: All sticks in the middle, but the first two at their ends (172, 1811): packed by struct, bit by bit.
_MIDDLE = {"channels": [987.5, 2011.875, *[1500.0] * 14]}
_PACKED = "0F AC 98 38 F8 C0 07 3E F0 81 0F 7C E0 03 1F F8 C0 07 3E F0 81 0F 7C"


def _frame(name: str, last: int, examples: Any) -> None:
    """Declare a frame with its last byte, as a check of nothing but that byte."""
    slots = f"; slots {name[13:]} to {int(name[13:]) + 7} follow" if last else ""
    packet = sbus.framing(
        sync=b"\x0f", size=25, gap=0.1, check=Sum(over=bytes([last])), name=f"last byte {last:02X}"
    )
    packet(
        name,
        payload=_payload,
        direction="from device",
        overrides=list(sbus.messages),  # never both: the last byte is one of them
        doc=f"Positions of sticks and switches, and whether the radio is heard{slots}.",
        source="Betaflight rx/sbus_channels.c" if not last else "PX4 lib/rc/sbus.cpp, SBUS2-Telemetry",
        examples=examples,
    )


for _name, _last in LAST.items():
    _frame(_name, _last, [(f"{_PACKED} 0C {_last:02X}", {**_MIDDLE, "flags": ["frame_lost", "failsafe"]})])

__all__ = ["CHANNELS", "LAST", "sbus"]
