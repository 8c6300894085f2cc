"""Measurements of signals, state of channels and of the receiver, time."""

from __future__ import annotations

from construct import (
    Array,
    Byte,
    Const,
    Float32l,
    Float64l,
    Int8sl,
    Int16sl,
    Int16ul,
    Int24sl,
    Int32sl,
    Int32ul,
    Rebuild,
    Struct,
    len_,
    this,
)

from aces_bus.protocol import BitLayout, Enumeration, Flags, Quantity, Reserved, Split, Text, bits

from .base import DO_NOT_USE, sbf_block, sbf_groups, sbf_revisions
from .examples import EXAMPLES

_signal = "signal" / BitLayout(1, "number" / bits(5), "antenna" / bits(3))
_cn0 = "cn0" / Quantity(
    Byte, unit="dBHz", scale=0.25, unknown=[255], doc="But for signals 1 and 2 (P code) 10 dBHz more."
)
_info = "info" / BitLayout(1, "smoothed" / bits(1), "half_cycle" / bits(1, at=2), "more" / bits(5, at=3))
_carrier = Quantity(Int24sl, scale=0.001, unknown=[-0x80_0000], doc="Cycles, relative to the pseudorange.")

_others = (
    _signal,
    "lock_time" / Quantity(Byte, unit="s", unknown=[255]),
    _cn0,
    "offsets"
    / BitLayout(
        9,
        "code" / Quantity(Split((24, 16), (0, 3), signed=True), unit="m", scale=0.001, unknown=[-4 << 16]),
        "doppler"
        / Quantity(Split((56, 16), (3, 5), signed=True), unit="Hz", scale=1e-4, unknown=[-16 << 16]),
        "carrier"
        / Quantity(Split((40, 16), (8, 8), signed=True), unit="1", scale=0.001, unknown=[-128 << 16]),
        "smoothed" / bits(1, at=16),
        "half_cycle" / bits(1, at=18),
        "more" / bits(5, at=19),
    ),
)
_first = (
    "channel" / Byte,
    _signal,
    "satellite" / Byte,
    "code" / BitLayout(5, "range" / Quantity(Split((8, 32), (0, 4)), unit="m", scale=0.001, unknown=[0])),
    "doppler" / Quantity(Int32sl, unit="Hz", scale=1e-4, unknown=[-0x8000_0000]),
    "carrier" / _carrier,
    _cn0,
    "lock_time" / Quantity(Int16ul, unit="s", unknown=[0xFFFF]),
    _info,
    "count" / Rebuild(Byte, len_(this.others)),
)
sbf_groups(
    "MeasEpoch",
    4027,
    "satellites",
    _first,
    "common"
    / Flags(
        Byte,
        multipath_mitigation=0,
        smoothed=1,
        aligned=2,
        clock_steering=3,
        high_dynamics=5,
        e6b=6,
        scrambled=7,
    ),
    "clock_jumps" / Quantity(Byte, unit="ms"),
    "reserved" / Reserved(1),
    inner=("others", _others),
    doc="Measurements of all signals.",
    examples=EXAMPLES["MeasEpoch"],
)
sbf_block(
    "EndOfMeas",
    5922,
    doc="All of this epoch's measurements were sent.",
    examples=EXAMPLES["EndOfMeas"],
)

_tracking = (
    "antenna" / Byte,
    "reserved" / Reserved(1),
    "tracking" / Int16ul,
    "pvt" / Int16ul,
    "pvt_info" / Int16ul,
)
_channel = (
    "satellite" / Byte,
    "frequency" / Byte,
    "reserved1" / Reserved(2),
    "sky"
    / BitLayout(
        2,
        "azimuth" / Quantity(bits(9), unit="°", unknown=[511]),
        "course" / Enumeration(bits(2, at=14), setting=0, rising=1, unknown=3),
    ),
    "health" / Int16ul,
    "elevation" / Quantity(Int8sl, unit="°", unknown=[-128]),
    "count" / Rebuild(Byte, len_(this.antennas)),
    "channel" / Byte,
    "reserved2" / Reserved(1),
)
sbf_groups(
    "ChannelStatus",
    4013,
    "channels",
    _channel,
    "reserved" / Reserved(3),
    inner=("antennas", _tracking),
    doc="State of the tracking.",
    examples=EXAMPLES["ChannelStatus"],
)

_QUALITY = {
    "overall": 0,
    "signals_main": 1,
    "signals_aux1": 2,
    "power_main": 11,
    "power_aux1": 12,
    "cpu": 21,
    "ocxo": 25,
    "base": 30,
    "rtk_post_processing": 31,
}
_indicator = BitLayout(
    2,
    "kind" / Enumeration(bits(8), _QUALITY),
    "value" / Quantity(bits(4), unknown=[15], doc="0 poor, 10 best."),
)
sbf_block(
    "QualityInd",
    4082,
    "count" / Rebuild(Byte, len_(this.indicators)),
    "reserved" / Reserved(1),
    "indicators" / Array(this.count, _indicator),
    doc="Quality of the receiver's main functions.",
    source="mosaic-H Reference Guide 4.10.1",
    examples=EXAMPLES["QualityInd"],
)

_STATE = {
    "active_antenna": 1,
    "external_frequency": 2,
    "external_time": 3,
    "week_set": 4,
    "time_of_week_set": 5,
    "fine_time": 6,
    "internal_disk_active": 7,
    "internal_disk_full": 8,
    "internal_disk_mounted": 9,
    "internal_antenna": 10,
    "reference_locked": 11,
    "external_disk_active": 13,
    "external_disk_full": 14,
    "external_disk_mounted": 15,
    "pps_in_calibrated": 16,
    "corrections_in": 17,
    "internet": 18,
}
_FAULTS = {
    "software": 3,
    "watchdog": 4,
    "antenna": 5,
    "congestion": 6,
    "missed_event": 8,
    "cpu_overload": 9,
    "invalid_config": 10,
    "out_of_geofence": 11,
}
_front_end = Struct(
    "front_end" / BitLayout(1, "code" / bits(5), "antenna" / bits(3)),
    "gain" / Quantity(Int8sl, unit="dB", unknown=[-128]),
    "variance" / Quantity(Byte, unknown=[0]),
    "blanking" / Quantity(Byte, unit="%"),
)
sbf_block(
    "ReceiverStatus",
    4014,
    "cpu_load" / Quantity(Byte, unit="%", unknown=[255]),
    "external_error" / Flags(Byte, signal_in_space=0, corrections=1, external_sensor=2, setup=3),
    "uptime" / Quantity(Int32ul, unit="s"),
    "state" / Flags(Int32ul, _STATE),
    "error" / Flags(Int32ul, _FAULTS),
    "count" / Rebuild(Byte, len_(this.front_ends)),
    Const(b"\x04"),
    "commands" / Byte,
    "temperature" / Quantity(Byte, unit="°C", offset=-100, unknown=[0]),
    "front_ends" / Array(this.count, _front_end),
    is_padded=False,
    doc="State of the receiver.",
    examples=EXAMPLES["ReceiverStatus"],
)

sbf_block(
    "ReceiverTime",
    5914,
    *(name / Quantity(Int8sl, unknown=[-128]) for name in ("year", "month", "day")),
    *(
        name / Quantity(Int8sl, unit=unit, unknown=[-128])
        for name, unit in (("hour", "h"), ("minute", "min"), ("second", "s"))
    ),
    "leap_seconds" / Quantity(Int8sl, unit="s", unknown=[-128]),
    "sync" / Flags(Byte, week=0, time_of_week=1, fine_time=2),
    doc="Time of the receiver, in UTC.",
    source="mosaic-H Reference Guide 4.10.1",
    examples=EXAMPLES["ReceiverTime"],
)

_satellite = (
    "satellite" / Byte,
    "frequency" / Byte,
    "azimuth" / Quantity(Int16ul, unit="°", scale=0.01, unknown=[0xFFFF]),
    "elevation" / Quantity(Int16sl, unit="°", scale=0.01, unknown=[-0x8000]),
    "course" / Enumeration(Byte, setting=0, rising=1, unknown=255),
    "source" / Enumeration(Byte, almanac=1, ephemeris=2, unknown=255),
)
sbf_groups(
    "SatVisibility",
    4012,
    "satellites",
    _satellite,
    doc="Where satellites above the horizon are.",
    source="mosaic-H Reference Guide 4.10.1",
    examples=EXAMPLES["SatVisibility"],
)

_link = (
    "connection" / Byte,
    "type" / Byte,
    "age" / Quantity(Int16ul, unit="s", unknown=[0xFFFF], doc="Of the last message."),
    "bytes_received" / Int32ul,
    "bytes_accepted" / Int32ul,
    "messages_received" / Int32ul,
    "messages_accepted" / Int32ul,
)
sbf_groups(
    "InputLink",
    4090,
    "links",
    _link,
    doc="What came over each connection.",
    source="mosaic-H Reference Guide 4.10.1",
    examples=EXAMPLES["InputLink"],
)

_client = (
    "connection" / Byte,
    "status"
    / Enumeration(Byte, sending_disabled=0, initialising=1, sending=2, receiving=3, paused=4, error=5),
    "error" / Byte,
    "info" / Byte,
)
sbf_groups(
    "NTRIPClientStatus",
    4053,
    "clients",
    _client,
    doc="Connections to casters of corrections.",
    source="mosaic-H Reference Guide 4.10.1",
    examples=EXAMPLES["NTRIPClientStatus"],
)

sbf_block(
    "xPPSOffset",
    5911,
    "sync_age" / Quantity(Byte, unit="s"),
    "time_scale" / Enumeration(Byte, gps=1, utc=2, receiver=3, glonass=4, galileo=5, beidou=6),
    "offset" / Quantity(Float32l, unit="ns", doc="Of the pulse from the second."),
    doc="How far the pulse a second was off.",
    source="mosaic-H Reference Guide 4.10.1",
    examples=EXAMPLES["xPPSOffset"],
)
sbf_revisions(
    "ExtEvent",
    5924,
    "pin" / Byte,
    "polarity" / Enumeration(Byte, rising=0, falling=1),
    "offset" / Quantity(Float32l, unit="s", doc="Of the event from tow."),
    "clock_bias" / Quantity(Float64l, unit="ms", unknown=[DO_NOT_USE]),
    later={1: ["position_age" / Quantity(Int16ul, unit="s", unknown=[0xFFFF])]},
    doc="An event on an input pin.",
    source="mosaic-H Reference Guide 4.10.1",
)
sbf_revisions(
    "ReceiverSetup",
    5902,
    "reserved" / Reserved(2),
    "marker" / Text(60),
    "marker_number" / Text(20),
    "observer" / Text(20),
    "agency" / Text(40),
    "serial_number" / Text(20) * "Of the receiver.",
    "firmware" / Text(20),
    "antenna_serial_number" / Text(20),
    "antenna" / Text(20),
    *(
        f"offset_{axis}" / Quantity(Float32l, unit="m", doc="Of the antenna from the marker.")
        for axis in ("up", "east", "north")
    ),
    later={
        1: ["marker_type" / Text(20)],
        2: ["gnss_firmware" / Text(40)],
        3: ["product" / Text(40)],
        4: [
            "latitude" / Quantity(Float64l, unit="rad", unknown=[DO_NOT_USE]),
            "longitude" / Quantity(Float64l, unit="rad", unknown=[DO_NOT_USE]),
            "height" / Quantity(Float32l, unit="m", unknown=[DO_NOT_USE]),
            "station" / Text(10),
            "monument" / Byte,
            "receiver" / Byte,
            "country" / Text(3),
            "reserved1" / Reserved(21),
        ],
    },
    doc="What the installer has said of marker, antenna and receiver.",
)
