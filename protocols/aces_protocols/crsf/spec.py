"""CRSF, the serial protocol between radio-control receivers, flight controllers, transmitter modules and handsets.

1. Every frame is `address | length | type | payload | CRC-8`, big-endian, 64 bytes at most. Types from 0x28 on begin with
   destination and origin.
2. A frame may be longer than declared here: newer versions append fields. They are kept in `more`.
3. The direction of a frame follows from who is asked: the same telemetry goes from a flight controller to its receiver and
   from a module to its handset. So frames have no direction here.

Sources: Team BlackSheep's "CRSF Protocol" (tbs-crsf-spec, crsf.md; here "TBS" with the frame type), the CRSF working
group's wiki (crsf-wg), and the unit tests of Betaflight (rx_crsf, telemetry_crsf) for worked frames. README.md says where
these differ.
"""

from __future__ import annotations

from typing import Any

from construct import (
    Byte,
    BytesInteger,
    Construct,
    Default,
    GreedyBytes,
    GreedyRange,
    Int8sb,
    Int16sb,
    Int16ub,
    Int32sb,
    Int32ub,
    NullTerminated,
    Struct,
    this,
)

from aces_bus.protocol import BitLayout, Crc, Enumeration, Protocol, Quantity, Text, Tuple, TwoScales, bits

#: Addresses of devices (TBS, Device Addresses).
ADDRESSES = {
    "broadcast": 0x00, "cloud": 0x0E, "usb": 0x10, "bluetooth": 0x12, "wifi": 0x13, "video_receiver": 0x14, "osd": 0x80,
    **{f"esc_{n + 1}": 0x90 + n for n in range(8)},
    "current_sensor": 0xC0, "gps": 0xC2, "blackbox": 0xC4, "flight_controller": 0xC8, "race_tag": 0xCC, "vtx": 0xCE,
    "handset": 0xEA, "receiver": 0xEC, "transmitter": 0xEE,
}  # fmt: skip
#: First bytes of frames: the sync byte of serial lines (as the flight controller's address), broadcast, and the addresses of
#: handset, receiver and transmitter module (TBS, Frame Details: receivers expect any of them).
FIRST = (0x00, 0xC8, 0xEA, 0xEC, 0xEE)
#: The longest frame (TBS, Structure).
LONGEST = 64

crsf = Protocol(
    "crsf",
    link="serial",
    baud=416_666,  # between receiver and flight controller; handsets and modules begin with 400,000 (TBS, Hardware)
    doc="CRSF (Crossfire): radio-control channels, link statistics and telemetry.",
    source="TBS, CRSF Protocol (crsf.md)",
)
_address = Enumeration(Byte, ADDRESSES)
packet = crsf.framing(
    header=Struct("address" / Default(_address, 0xC8), "length" / Byte, "type" / Byte),
    match={"address": FIRST},
    size=this.length + 2,
    max_size=LONGEST,
    gap=0.1,  # the longest frame takes 5.6 ms at 115,200 Bd; the rest is for adapters that collect bytes
    check=Crc("CRC8-DVB-S2", over=slice(2, -1)),
)
_addressed = packet.family(Struct("destination" / _address, "origin" / _address))
_command = packet.family(
    Struct("destination" / _address, "origin" / _address, "realm" / Byte, "command" / Byte),
    check=Crc(width=8, poly=0xBA, field="command_check", over=slice(2, -1)),
)
#: Fields that newer versions append (TBS, Frame Details).
_more = "more" / Default(GreedyBytes, b"")


def _frame(name: str, number: int, *fields: Construct, doc: str, examples: Any = ()) -> Any:
    """Declare a broadcast frame."""
    return packet(
        name, match={"type": number}, payload=Struct(*fields), doc=doc, source=f"TBS, {number:#04x}", examples=examples
    )  # fmt: skip


def _text(name: str) -> Any:
    return name / NullTerminated(Text())


# ---------------------------------------------------------------------- radio control

packet(
    "Channels",
    match={"type": 0x16},
    payload=BitLayout(
        22,
        # (n − 992) × 5 / 8 + 1500 µs
        "channels" / Tuple(*[Quantity(bits(11), unit="µs", scale=0.625, offset=880) for _ in range(16)]),
        trailing="more",
    ),
    doc="Positions of 16 sticks and switches: pulses of 880…2159 µs, 1500 µs in the middle.",
    source="TBS, 0x16",
    # captured by Betaflight (rx_crsf): numbers 189, 993, 978, 983 …
    examples=[("00 18 16 BD 08 9F F4 AE F7 BD EF 7D EF FB AD FD 45 2B 5A 01 00 00 00 00 00 6C",
        {"address": "broadcast", "channels": [998.125, 1500.625, 1491.25, 1494.375, 1499.375, 1499.375, 1499.375,
            2139.375, 1788.125, 999.375, 988.125, 988.125, 880.0, 880.0, 880.0, 880.0]})],
)  # fmt: skip
_rssi = Quantity(Byte, unit="dBm", scale=-1)
_percent = Quantity(Byte, unit="%")
_decibel = Quantity(Int8sb, unit="dB")
_frame(
    "LinkStatistics", 0x14,
    "uplink_rssi_1" / _rssi, "uplink_rssi_2" / _rssi, "uplink_quality" / _percent, "uplink_snr" / _decibel,
    "antenna" / Byte, "profile" / Enumeration(Byte, fps_4=0, fps_50=1, fps_150=2),
    "power" / Enumeration(Byte, mw_0=0, mw_10=1, mw_25=2, mw_100=3, mw_500=4, mw_1000=5, mw_2000=6, mw_250=7, mw_50=8),
    "downlink_rssi" / _rssi, "downlink_quality" / _percent, "downlink_snr" / _decibel, _more,
    doc="The radio link: up to the craft, down to the ground.",
    # built by crsf-parser 0.3.2
    examples=[("C8 0C 14 3C 46 63 0A 00 02 03 41 62 FB 2B", {"uplink_rssi_1": -60, "uplink_rssi_2": -70,
        "uplink_quality": 99, "uplink_snr": 10, "antenna": 0, "profile": "fps_150", "power": "mw_100", "downlink_rssi": -65,
        "downlink_quality": 98, "downlink_snr": -5})],
)  # fmt: skip
_received = ("rssi" / _rssi, "rssi_percent" / _percent, "quality" / _percent, "snr" / _decibel)
_power = "power" / Quantity(Byte, unit="dBm")
_frame("ReceiverLink", 0x1C, *_received, _power, _more, doc="The link as the receiver has it.")
_frame("TransmitterLink", 0x1D, *_received, _power, "rate" / Quantity(Byte, unit="Hz", scale=10), _more,
    doc="The link as the transmitter module has it; `rate` in frames a second.")  # fmt: skip

# ---------------------------------------------------------------------- telemetry

_degrees = Quantity(Int32sb, unit="°", scale=1e-7)
_cm_s = Quantity(Int16sb, unit="m/s", scale=0.01)
_frame(
    "Gps", 0x02, "latitude" / _degrees, "longitude" / _degrees,
    "speed" / Quantity(Int16ub, unit="km/h", scale=0.1), "heading" / Quantity(Int16ub, unit="°", scale=0.01),
    "altitude" / Quantity(Int16ub, unit="m", offset=-1000), "satellites" / Byte, _more,
    doc="Place, speed over ground, course, height above the sea, satellites in use.",
    # Betaflight, TelemetryCrsfTest TestGPS
    examples=[("C8 11 02 21 60 EC 00 61 27 D3 80 02 4B 39 C6 0D 11 09 6B", {"latitude": 56.0, "longitude": 163.0,
        "speed": 58.7, "heading": 147.9, "altitude": 2345, "satellites": 9})],
)  # fmt: skip
_frame("GpsTime", 0x03, "year" / Int16sb, "month" / Byte, "day" / Byte, "hour" / Byte, "minute" / Byte, "second" / Byte,
    "millisecond" / Quantity(Int16ub, unit="ms"), _more, doc="The time of the satellites.")  # fmt: skip
_accuracy = Quantity(Int16sb, unit="m", scale=0.01)
_frame(
    "GpsExtended", 0x06, "fix" / Byte, "north" / _cm_s, "east" / _cm_s, "up" / _cm_s, "speed_accuracy" / _cm_s,
    "heading_accuracy" / Quantity(Int16sb, unit="°", scale=0.1), "ellipsoid_altitude" / Quantity(Int16sb, unit="m"),
    "accuracy" / _accuracy, "altitude_accuracy" / _accuracy, "reserved" / Byte,
    "hdop" / Quantity(Byte, scale=0.1), "vdop" / Quantity(Byte, scale=0.1), _more,
    doc="Velocity and accuracy of the satellites' fix.",
)  # fmt: skip
_frame("Vario", 0x07, "speed" / _cm_s, _more, doc="Vertical speed, up is positive.")
_frame(
    "Battery", 0x08, "voltage" / Quantity(Int16sb, unit="V", scale=0.1), "current" / Quantity(Int16sb, unit="A", scale=0.1),
    "used" / Quantity(BytesInteger(3), unit="mAh"), "remaining" / _percent, _more,
    doc="Battery: voltage, current, charge that was used, estimated rest.",
    # Betaflight, TelemetryCrsfTest TestBattery; the numbers of crsf-wg's page
    examples=[("C8 0A 08 00 21 01 28 00 04 D2 43 B2", {"voltage": 3.3, "current": 29.6, "used": 1234, "remaining": 67}),
        ("C8 0A 08 00 FC 00 BD 00 08 97 64 74", {"voltage": 25.2, "current": 18.9, "used": 2199, "remaining": 100})],
)  # fmt: skip
_altitude = "altitude" / TwoScales(
    Int16ub,
    (0.1, -1000),
    (1, 0),
    unit="m",
    doc="above the start; 0xFFFF is not sent, as OpenTX takes it for none",
)
packet("BaroAltitude", match={"type": 0x09, "length": 4}, payload=Struct(_altitude), source="TBS, 0x09; crsf-wg",
    doc="Barometric height above the start: decimetres up to 2276.7 m, metres above.",
    # the numbers of crsf-wg's page, and the greatest of TBS
    examples=[("C8 04 09 27 74 74", {"altitude": 10.0}), ("C8 04 09 26 AC 76", {"altitude": -10.0}),
        ("C8 04 09 7F FF 4F", {"altitude": 2276.7})])  # fmt: skip
packet(
    "BaroVario", match={"type": 0x09, "length": 5}, source="TBS, 0x09",
    payload=Struct(
        _altitude,
        "vertical" / Int8sb * "vertical speed n: (exp(0.026 × |n|) − 1) m/s, with the sign of n, up is positive",
    ),
    doc="Barometric height above the start, with vertical speed in a logarithmic scale.",
)  # fmt: skip
packet("BaroSpeed", match={"type": 0x09, "length": 6}, payload=Struct(_altitude, "speed" / _cm_s), source="crsf-wg",
    doc="Barometric height above the start, with vertical speed, up is positive.",
    examples=[("C8 06 09 27 74 00 96 AA", {"altitude": 10.0, "speed": 1.5})])  # fmt: skip
_frame(
    "Airspeed", 0x0A, "speed" / Quantity(Int16ub, unit="km/h", scale=0.1), _more, doc="Speed through the air."
)
_frame("Heartbeat", 0x0B, "origin" / Int16ub, _more, doc="A device is there.")
_frame("Rpm", 0x0C, "source" / Byte, "speeds" / GreedyRange(Quantity(BytesInteger(3, signed=True), unit="rpm")),
    doc="Speeds of motors, up to 19; negative ones turn backward.")  # fmt: skip
_frame("Temperatures", 0x0D, "source" / Byte, "temperatures" / GreedyRange(Quantity(Int16sb, unit="°C", scale=0.1)),
    doc="Temperatures, up to 20.")  # fmt: skip
_frame("Voltages", 0x0E, "source" / Byte, "voltages" / GreedyRange(Quantity(Int16ub, unit="V", scale=0.001)),
    doc="Voltages, up to 29: of a battery's cells (source 0…127), or of one device.")  # fmt: skip
packet(
    "VideoTransmitter", match={"type": 0x10}, source="TBS, 0x10", doc="State of a video transmitter.",
    payload=BitLayout(
        5, "origin" / Enumeration(bits(8), ADDRESSES), "power" / Quantity(bits(8), unit="dBm"),
        "frequency" / Quantity(bits(16, at=16, order="msb"), unit="MHz"), "pit_mode" / bits(1, at=32),
        "pit_control" / Enumeration(bits(2), off=0, on=1, switch=2, failsafe=3), "pit_switch" / bits(4), trailing="more",
    ),
)  # fmt: skip
_angle = Quantity(Int16sb, unit="rad", scale=1e-4)
_frame("Attitude", 0x1E, "pitch" / _angle, "roll" / _angle, "yaw" / _angle, _more,
    doc="Angles of the craft, within ±π.",
    # Betaflight, TelemetryCrsfTest TestAttitude
    examples=[("C8 08 1E 2E 39 65 EC 85 5A 05", {"pitch": 1.1833, "roll": 2.6092, "yaw": -3.1398})])  # fmt: skip
_frame("FlightMode", 0x21, _text("mode"), doc="Name of the flight mode; `*` at its end: disarmed (Betaflight).",
    examples=[("C8 08 21 41 43 52 4F 2A 00 14", {"mode": "ACRO*"})])  # fmt: skip

# ---------------------------------------------------------------------- between devices: destination and origin

_addressed("PingDevices", match={"type": 0x28}, source="TBS, 0x28",
    doc="Ask a device, or all (destination broadcast), who it is.",
    examples=[("C8 04 28 00 EA 54", {"destination": "broadcast", "origin": "handset"})])  # fmt: skip
_addressed(
    "DeviceInfo", match={"type": 0x29}, source="TBS, 0x29", doc="A device's answer to PingDevices.",
    payload=Struct(_text("name"), "serial" / Int32ub, "hardware" / Int32ub, "firmware" / Int32ub, "parameters" / Byte,
        "parameter_version" / Byte),
    # crsf-wg
    examples=[("C8 1C 29 EA EE 53 49 59 49 20 46 4D 33 30 00 45 4C 52 53 00 00 00 00 00 00 00 00 13 00 CA", {
        "destination": "handset", "origin": "transmitter", "name": "SIYI FM30", "serial": 0x454C5253, "hardware": 0,
        "firmware": 0, "parameters": 19, "parameter_version": 0})],
)  # fmt: skip
_addressed("ParameterEntry", match={"type": 0x2B}, source="TBS, 0x2B", doc="Part of a parameter: value, limits, texts.",
    payload=Struct("parameter" / Byte, "chunks_left" / Byte, "data" / GreedyBytes))  # fmt: skip
_addressed("ParameterRead", match={"type": 0x2C}, source="TBS, 0x2C", doc="Ask for a part of a parameter.",
    payload=Struct("parameter" / Byte, "chunk" / Byte, _more))  # fmt: skip
_addressed("ParameterWrite", match={"type": 0x2D}, source="TBS, 0x2D", doc="Set a parameter; the answer repeats it.",
    payload=Struct("parameter" / Byte, "data" / GreedyBytes))  # fmt: skip
packet.family(Struct("destination" / _address, "origin" / _address, "subtype" / Byte))(
    "Timing", match={"type": 0x3A}, subtype=0x10, source="TBS, 0x3A.0x10",
    payload=Struct("interval" / Quantity(Int32ub, unit="µs", scale=0.1),
        "offset" / Quantity(Int32sb, unit="µs", scale=0.1), _more),
    doc="When the module wants channels: their interval, and how much too early (positive) the last ones came.",
)  # fmt: skip
_check = "command_check" / Byte
_command("SpeedProposal", match={"type": 0x32}, realm=0x0A, command=0x70,
    payload=Struct("port" / Byte, "baud" / Quantity(Int32ub, unit="Bd"), _check),
    doc="Propose another speed of the line.", source="TBS, 0x32.0x0A",
    # Betaflight, CrossFireTest: 2 MBd
    examples=[("C8 0C 32 C8 EC 0A 70 01 00 1E 84 80 22 72", {"destination": "flight_controller", "origin": "receiver",
        "port": 1, "baud": 2_000_000})])  # fmt: skip
_command("SpeedAnswer", match={"type": 0x32}, realm=0x0A, command=0x71,
    payload=Struct("port" / Byte, "accepted" / Byte, _check),
    doc="Accept (1) or reject (0) a speed.", source="TBS, 0x32.0x0A")  # fmt: skip

__all__ = ["ADDRESSES", "FIRST", "LONGEST", "crsf"]
