"""CANopen's predefined connection set: network management, SYNC, TIME, EMCY, four PDOs each way, SDO, heartbeat, LSS.

1. An identifier is function << 7 | node; nodes are 1 to 127. Objects at other identifiers are not messages here.
2. What a PDO carries is the device's own: `data` is its bytes. A file of the device (`-p drive.eds`) knows what they mean.
3. SDO and EMCY have eight bytes, always.
4. Objects in segments and blocks: in the dialect `frames` each frame is a message, for who makes transfers; in `transfers`
   each transfer is one, for who reads along. Bytes alone do not tell the segments of a block from other frames: in `frames`
   they are `SdoBlockSegment` only where they are like nothing else.

Numbers are little-endian. Sources are CiA 301 as the `canopen` library and ros2_canopen have it, and bytes that the
library made.
"""

from __future__ import annotations

from construct import Byte, Bytes, GreedyBytes, Int16ul, Int32ul, Struct

from aces_bus.protocol import (
    BitLayout,
    Enumeration,
    Flags,
    IdField,
    Protocol,
    Quantity,
    Reserved,
    SdoTransfer,
    bits,
)

CIA301 = "CiA 301 (canopen; ros2_canopen)"

canopen = Protocol(
    "canopen",
    link="can",
    bitrate=1_000_000,
    dialects={
        "frames": "each frame of service data is a message",
        "transfers": "service data in segments and blocks are one message a transfer",
    },
    broadcast={"node": 0},
    doc="What every CANopen node speaks: NMT, SYNC, TIME, EMCY, PDOs, SDO, heartbeat, LSS.",
    source="CiA 301; christiansandberg/canopen; ros-industrial/ros2_canopen",
)

Node = IdField("node", range(1, 128), doc="node id")
#: Bits of an SDO's first byte.
Sized = IdField("sized", range(2), doc="whether a size is given")
Unused = IdField("unused", range(4), doc="how many of the four bytes are not data, when sized")
Left = IdField("unused", range(8), doc="how many of the seven bytes are not data")
Toggle = IdField("toggle", range(2), doc="alternates from segment to segment")
Last = IdField("last", range(2), doc="whether this is the last segment")
Checked = IdField("checked", range(2), doc="whether the sender knows CRCs")

#: NMT states; 80 and 96 are the library's own.
STATES = {
    "boot_up": 0,
    "stopped": 4,
    "operational": 5,
    "sleep": 80,
    "standby": 96,
    "pre_operational": 127,
}
COMMANDS = {
    "start": 0x01,
    "stop": 0x02,
    "pre_operational": 0x80,
    "reset_node": 0x81,
    "reset_communication": 0x82,
}
#: Emergency codes that CiA 301 names one by one; the others belong to groups (see the README).
EMERGENCIES = {
    "no_error": 0x0000,
    "generic": 0x1000,
    "can_overrun": 0x8110,
    "can_passive": 0x8120,
    "heartbeat_lost": 0x8130,
    "bus_off_recovered": 0x8140,
}
ABORTS = {
    "toggle": 0x05030000,
    "timeout": 0x05040000,
    "command": 0x05040001,
    "block_size": 0x05040002,
    "sequence": 0x05040003,
    "crc": 0x05040004,
    "access": 0x06010000,
    "write_only": 0x06010001,
    "read_only": 0x06010002,
    "no_object": 0x06020000,
    "not_mappable": 0x06040041,
    "pdo_length": 0x06040042,
    "parameter": 0x06040043,
    "internal": 0x06040047,
    "hardware": 0x06060000,
    "length": 0x06070010,
    "too_long": 0x06070012,
    "too_short": 0x06070013,
    "no_subindex": 0x06090011,
    "value_range": 0x06090030,
    "value_high": 0x06090031,
    "value_low": 0x06090032,
    "max_below_min": 0x06090036,
    "resource": 0x060A0023,
    "general": 0x08000000,
    "cannot_store": 0x08000020,
    "local_control": 0x08000021,
    "device_state": 0x08000022,
    "no_dictionary": 0x08000023,
    "no_data": 0x08000024,
}

# ---------------------------------------------------------------------- network

Nmt = canopen.message(
    "Nmt",
    id=0x000,
    direction="to device",
    payload=Struct("command" / Enumeration(Byte, COMMANDS), "node" / Byte),
    doc="Network management: have a node, or all (0), start, stop, go pre-operational, or reset.",
    source=CIA301,
    examples=[
        ("000#01 05", {"command": "start", "node": 5}),
        ("000#80 00", {"command": "pre_operational", "node": 0}),
    ],
)
Sync = canopen.message(
    "Sync",
    id=0x080,
    direction="to device",
    payload=Struct(),
    doc="Synchronous PDOs are sampled, sent and applied now.",
    source=CIA301,
    examples=[("080#", {})],
)
SyncCounter = canopen.message(
    "SyncCounter",
    id=0x080,
    direction="to device",
    payload=Struct("counter" / Quantity(Byte, range=(1, 240))),
    doc="SYNC with a counter, 1 to 240.",
    source=CIA301,
    examples=[("080#07", {"counter": 7})],
)
Time = canopen.message(
    "Time",
    id=0x100,
    direction="to device",
    payload=BitLayout(
        6, "time_of_day" / Quantity(bits(28), unit="ms"), "days" / Quantity(bits(16, 32), unit="d")
    ),
    doc="Time of day, and days since 1 January 1984.",
    source=CIA301,
    examples=[("100#00 2E 93 02 41 3A", {"time_of_day": 43_200_000, "days": 14_913})],
)
Emergency = canopen.message(
    "Emergency",
    id=0x080 + Node,
    direction="from device",
    payload=Struct(
        "code" / Enumeration(Int16ul, EMERGENCIES),
        "register"
        / Flags(
            Byte,
            generic=0,
            current=1,
            voltage=2,
            temperature=3,
            communication=4,
            profile=5,
            manufacturer=7,
        ),
        "details" / Bytes(5),
    ),
    doc="An error, once, when it occurs; 0x00xx: it is over. `register` is object 1001.",
    source=CIA301,
    examples=[
        (
            "085#30 81 11 00 00 00 00 00",
            {"node": 5, "code": "heartbeat_lost", "register": ["generic", "communication"]},
        ),
        ("085#11 86 20 00 00 00 00 00", {"node": 5, "code": 0x8611, "register": ["profile"]}),
    ],
)
Heartbeat = canopen.message(
    "Heartbeat",
    id=0x700 + Node,
    payload=BitLayout(1, "state" / Enumeration(bits(7), STATES), "toggle" / bits(1)),
    doc="A node's state: when it has booted, then again and again; also the host's, for nodes that watch over it. `toggle`"
    " alternates in answers to node guarding only.",
    source=CIA301,
    examples=[
        ("705#00", {"node": 5, "state": "boot_up", "toggle": 0}),
        ("705#05", {"node": 5, "state": "operational", "toggle": 0}),
        ("705#FF", {"node": 5, "state": "pre_operational", "toggle": 1}),
    ],
)
GuardRequest = canopen.message(
    "GuardRequest",
    id=0x700 + Node,
    remote=True,
    direction="to device",
    payload=Struct(),
    doc="Node guarding: what is your state?",
    source=CIA301,
    examples=[("705#R", {"node": 5})],
)
LssRequest = canopen.message(
    "LssRequest",
    id=0x7E5,
    direction="to device",
    payload=Struct("command" / Byte, "details" / Bytes(7)),
    doc="Layer setting services: gives nodes their number and bit rate. The services themselves are not taken apart.",
    source="CiA 301, identifiers only (canopen)",
    examples=[("7E5#04 01 00 00 00 00 00 00", {"command": 4, "details": b"\x01\0\0\0\0\0\0"})],
)
LssAnswer = canopen.message(
    "LssAnswer",
    id=0x7E4,
    direction="from device",
    payload=Struct("command" / Byte, "details" / Bytes(7)),
    doc="What an LSS request is answered with.",
    source="CiA 301, identifiers only (canopen)",
    examples=[("7E4#11 00 00 00 00 00 00 00", {"command": 17, "details": bytes(7)})],
)

# ---------------------------------------------------------------------- process data

for _number in range(1, 5):
    canopen.message(
        f"Tpdo{_number}",
        id=(0x080 + 0x100 * _number) + Node,
        direction="from device",
        payload=Struct("data" / GreedyBytes),
        doc=f"Process data of the device, number {_number}: lowest bit first, as object {0x19FF + _number:04X} says.",
        source=CIA301,
        examples=[(f"{0x085 + 0x100 * _number:X}#37 06 2A", {"node": 5, "data": b"\x37\x06\x2a"})],
    )
for _number in range(1, 5):
    canopen.message(
        f"Rpdo{_number}",
        id=(0x100 + 0x100 * _number) + Node,
        direction="to device",
        payload=Struct("data" / GreedyBytes),
        doc=f"Process data for the device, number {_number}: lowest bit first, as object {0x15FF + _number:04X} says.",
        source=CIA301,
        examples=[
            (
                f"{0x105 + 0x100 * _number:X}#0F 00 18 FC FF FF",
                {"node": 5, "data": b"\x0f\x00\x18\xfc\xff\xff"},
            )
        ],
    )

# ---------------------------------------------------------------------- service data: to the device

_OBJECT = Struct("command" / Byte, "index" / Int16ul, "subindex" / Byte)
_SEGMENT = Struct("command" / Byte)
_TO = {"id": 0x600 + Node, "direction": "to device"}
_FROM = {"id": 0x580 + Node, "direction": "from device"}
_FRAMES, _CARRIED = (
    {"dialect": "frames"},
    {"dialect": "transfers", "transport": SdoTransfer(max_size=1 << 16)},
)

ask_frame, ask_segment = (canopen.family(prefix, **_TO, **_FRAMES) for prefix in (_OBJECT, _SEGMENT))
ask_carried = canopen.family(_OBJECT, **_TO, **_CARRIED)

SdoUpload, _ = (
    declare(
        "SdoUpload",
        command=0x40,
        payload=Struct("reserved" / Reserved(4)),
        doc="Read an object.",
        source=CIA301,
        examples=[("605#40 41 60 00 00 00 00 00", {"node": 5, "index": 0x6041, "subindex": 0})],
    )
    for declare in (ask_frame, ask_carried)
)
SdoUploadSegment = ask_segment(
    "SdoUploadSegment",
    command=0x60 | Toggle << 4,
    payload=Struct("reserved" / Reserved(7)),
    doc="The next seven bytes of what is read, please.",
    source=CIA301,
    examples=[("605#70 00 00 00 00 00 00 00", {"node": 5, "toggle": 1})],
)
SdoDownload, _ = (
    declare(
        "SdoDownload",
        command=0x22 | Sized | Unused << 2,
        payload=Struct("data" / Bytes(4)),
        doc="Write an object of up to four bytes.",
        source=CIA301,
        examples=[
            (
                "605#2F 60 60 00 08 00 00 00",
                {
                    "node": 5,
                    "index": 0x6060,
                    "subindex": 0,
                    "sized": 1,
                    "unused": 3,
                    "data": b"\x08\0\0\0",
                },
            ),
            ("605#2B 40 60 00 0F 00 00 00", {"index": 0x6040, "unused": 2, "data": b"\x0f\0\0\0"}),
            ("605#23 7A 60 00 18 FC FF FF", {"index": 0x607A, "unused": 0, "data": b"\x18\xfc\xff\xff"}),
        ],
    )
    for declare in (ask_frame, ask_carried)
)
SdoDownloadStart = ask_frame(
    "SdoDownloadStart",
    command=0x20 | Sized,
    payload=Struct("size" / Quantity(Int32ul, unit="B")),
    doc="Write an object of more than four bytes; segments follow.",
    source=CIA301,
    examples=[
        ("605#21 08 10 00 06 00 00 00", {"node": 5, "index": 0x1008, "subindex": 0, "sized": 1, "size": 6})
    ],
)
SdoDownloadSegment = ask_segment(
    "SdoDownloadSegment",
    command=Last | Left << 1 | Toggle << 4,
    payload=Struct("data" / Bytes(7)),
    doc="Seven bytes of what is written, less those that are unused.",
    source=CIA301,
    examples=[
        (
            "605#03 61 62 63 64 65 66 00",
            {"node": 5, "toggle": 0, "unused": 1, "last": 1, "data": b"abcdef\0"},
        )
    ],
)
SdoAbort, _ = (
    declare(
        "SdoAbort",
        command=0x80,
        payload=Struct("code" / Enumeration(Int32ul, ABORTS)),
        doc="The transfer ends here: who asked has given up.",
        source=CIA301,
        examples=[("605#80 00 00 00 00 00 04 05", {"node": 5, "index": 0, "subindex": 0, "code": "timeout"})],
    )
    for declare in (ask_frame, ask_carried)
)

SdoDownloadTransfer = ask_carried(
    "SdoDownloadTransfer",
    command=0x20 | Sized,
    payload=Struct("data" / GreedyBytes),
    doc="An object that was written in segments; the time is that of the last one.",
    source=CIA301,
    examples=[
        (
            ["605#21 08 10 00 06 00 00 00", "605#03 61 62 63 64 65 66 00"],
            {"node": 5, "index": 0x1008, "subindex": 0, "sized": 1, "data": b"abcdef"},
        )
    ],
)

# ---------------------------------------------------------------------- service data: from the device

answer_frame, answer_segment = (canopen.family(prefix, **_FROM, **_FRAMES) for prefix in (_OBJECT, _SEGMENT))
answer_carried = canopen.family(_OBJECT, **_FROM, **_CARRIED)

SdoUploaded, _ = (
    declare(
        "SdoUploaded",
        command=0x42 | Sized | Unused << 2,
        payload=Struct("data" / Bytes(4)),
        doc="An object of up to four bytes.",
        source=CIA301,
        examples=[
            (
                "585#4B 41 60 00 37 06 00 00",
                {
                    "node": 5,
                    "index": 0x6041,
                    "subindex": 0,
                    "sized": 1,
                    "unused": 2,
                    "data": b"\x37\x06\0\0",
                },
            )
        ],
    )
    for declare in (answer_frame, answer_carried)
)
SdoUploadStarted = answer_frame(
    "SdoUploadStarted",
    command=0x40 | Sized,
    payload=Struct("size" / Quantity(Int32ul, unit="B")),
    doc="An object of more than four bytes; ask for its segments.",
    source=CIA301,
    examples=[
        ("585#41 08 10 00 0A 00 00 00", {"node": 5, "index": 0x1008, "subindex": 0, "sized": 1, "size": 10})
    ],
)
SdoUploadedSegment = answer_segment(
    "SdoUploadedSegment",
    command=Last | Left << 1 | Toggle << 4,
    payload=Struct("data" / Bytes(7)),
    doc="Seven bytes of what is read, less those that are unused.",
    source=CIA301,
    examples=[
        (
            "585#19 61 62 63 00 00 00 00",
            {"node": 5, "toggle": 1, "unused": 4, "last": 1, "data": b"abc\0\0\0\0"},
        )
    ],
)
SdoDownloaded, _ = (
    declare(
        "SdoDownloaded",
        command=0x60,
        payload=Struct("reserved" / Reserved(4)),
        doc="The object is written, or may be sent in segments.",
        source=CIA301,
        examples=[("585#60 08 10 00 00 00 00 00", {"node": 5, "index": 0x1008, "subindex": 0})],
    )
    for declare in (answer_frame, answer_carried)
)
SdoDownloadedSegment = answer_segment(
    "SdoDownloadedSegment",
    command=0x20 | Toggle << 4,
    payload=Struct("reserved" / Reserved(7)),
    doc="A segment has been taken.",
    source=CIA301,
    examples=[("585#20 00 00 00 00 00 00 00", {"node": 5, "toggle": 0})],
)
SdoAborted, _ = (
    declare(
        "SdoAborted",
        command=0x80,
        payload=Struct("code" / Enumeration(Int32ul, ABORTS)),
        doc="The transfer ends here: the device refuses.",
        source=CIA301,
        examples=[
            (
                "585#80 40 60 00 30 00 09 06",
                {"node": 5, "index": 0x6040, "subindex": 0, "code": "value_range"},
            )
        ],
    )
    for declare in (answer_frame, answer_carried)
)
SdoUploadTransfer = answer_carried(
    "SdoUploadTransfer",
    command=0x40 | Sized,
    payload=Struct("data" / GreedyBytes),
    doc="An object that was read in segments; the time is that of the last one.",
    source=CIA301,
    examples=[
        (
            ["585#41 08 10 00 0A 00 00 00", "585#00 61 62 63 64 65 66 67", "585#19 68 69 6A 00 00 00 00"],
            {"node": 5, "index": 0x1008, "subindex": 0, "sized": 1, "data": b"abcdefghij"},
        )
    ],
)

# ---------------------------------------------------------------------- service data: blocks

_SIZE = Struct("size" / Quantity(Int32ul, unit="B"))
_CRC = Struct("crc" / Int16ul, "reserved" / Reserved(5))
_TAKEN = Struct("number" / Byte, "block_size" / Byte, "reserved" / Reserved(5))
_ALONE = Struct("reserved" / Reserved(7))
_BEGINS = 0xC0 | Checked << 2 | Sized << 1
_ENDS = 0xC1 | Left << 2

SdoBlockUpload, _ = (
    declare(
        "SdoBlockUpload",
        command=0xA0 | Checked << 2,
        payload=Struct("block_size" / Byte, "switch" / Byte, "reserved" / Reserved(2)),
        doc="Read an object in blocks of so many segments; one of up to `switch` bytes may come otherwise.",
        source=CIA301,
        examples=[
            (
                "605#A4 08 10 00 7F 00 00 00",
                {"node": 5, "checked": 1, "index": 0x1008, "subindex": 0, "block_size": 127, "switch": 0},
            )
        ],
    )
    for declare in (ask_frame, ask_carried)
)
for _declare, _name, _command, _payload, _doc, _bytes, _values in (
    (ask_frame, "SdoBlockDownload", _BEGINS, _SIZE, "Write an object in blocks.",
     "605#C6 08 10 00 0A 00 00 00", {"checked": 1, "sized": 1, "index": 0x1008, "size": 10}),
    (ask_segment, "SdoBlockDownloadEnd", _ENDS, _CRC, "All is written; so many bytes of the last segment are none.",
     "605#D1 2A A3 00 00 00 00 00", {"unused": 4, "crc": 0xA32A}),
    (ask_segment, "SdoBlockUploadGo", 0xA3, _ALONE, "Segments of what is read, please.",
     "605#A3 00 00 00 00 00 00 00", {}),
    (ask_segment, "SdoBlockUploadTaken", 0xA2, _TAKEN, "Segments up to this one are taken; how many may follow.",
     "605#A2 02 7F 00 00 00 00 00", {"number": 2, "block_size": 127}),
    (ask_segment, "SdoBlockUploaded", 0xA1, _ALONE, "The object has been read.",
     "605#A1 00 00 00 00 00 00 00", {}),
    (answer_frame, "SdoBlockDownloadStarted", 0xA0 | Checked << 2, Struct("block_size" / Byte, "reserved" / Reserved(3)),
     "The object may be sent in blocks of so many segments.",
     "585#A4 08 10 00 7F 00 00 00", {"checked": 1, "index": 0x1008, "block_size": 127}),
    (answer_segment, "SdoBlockDownloadTaken", 0xA2, _TAKEN,
     "Segments up to this one are taken; how many may follow.",
     "585#A2 02 7F 00 00 00 00 00", {"number": 2, "block_size": 127}),
    (answer_segment, "SdoBlockDownloaded", 0xA1, _ALONE, "The object has been written.",
     "585#A1 00 00 00 00 00 00 00", {}),
    (answer_frame, "SdoBlockUploadStarted", _BEGINS, _SIZE, "The object comes in blocks.",
     "585#C6 08 10 00 0A 00 00 00", {"checked": 1, "sized": 1, "index": 0x1008, "size": 10}),
    (answer_segment, "SdoBlockUploadEnd", _ENDS, _CRC, "All is read; so many bytes of the last segment are none.",
     "585#D1 2A A3 00 00 00 00 00", {"unused": 4, "crc": 0xA32A}),
):  # fmt: skip
    _declare(
        _name,
        command=_command,
        payload=_payload,
        doc=_doc,
        source=CIA301,
        examples=[(_bytes, {"node": 5, **_values})],
    )
#: First bytes of what is declared above, of both ways: a block's segment may have any of them, too.
_BEGINNINGS = {0x80, 0xA0, 0xA1, 0xA2, 0xA4, *range(0x20), *range(0xC0, 0xC8, 2), *range(0xC1, 0xE0, 4)}
_TO_BEGINNINGS = {0x20, 0x21, 0x40, 0x60, 0x70, 0xA3, *(0x22 | n for n in (0, 1, 4, 5, 8, 9, 12, 13))}
_FROM_BEGINNINGS = {0x20, 0x30, 0x40, 0x41, 0x60, *(0x42 | n for n in (0, 1, 4, 5, 8, 9, 12, 13))}
for _way, _name, _key, _others in (
    (_TO, "SdoBlockSegment", 605, _TO_BEGINNINGS),
    (_FROM, "SdoBlockUploadedSegment", 585, _FROM_BEGINNINGS),
):
    _segments = sorted({*range(1, 128), *range(0x81, 0x100)} - _BEGINNINGS - _others)
    canopen.family(_SEGMENT, **_way, **_FRAMES)(
        _name,
        command=IdField("segment", _segments, doc="its number in the block, and 128 more in the last one"),
        payload=Struct("data" / Bytes(7)),
        doc="Seven bytes of a block, where the first byte is no other frame's.",
        source=CIA301,
        examples=[(f"{_key}#81 61 62 63 00 00 00 00", {"node": 5, "segment": 0x81, "data": b"abc\0\0\0\0"})],
    )
for _declare, _name, _key, _back, _go, _doc in (
    (ask_carried, "SdoBlockDownloadTransfer", 605, 585, "A4 08 10 00 7F 00 00 00", "written"),
    (answer_carried, "SdoBlockUploadTransfer", 585, 605, "A3 00 00 00 00 00 00 00", "read"),
):
    _declare(
        _name,
        command=_BEGINS,
        payload=Struct("data" / GreedyBytes),
        doc=f"An object that was {_doc} in blocks; the time is that of the last frame.",
        source=CIA301,
        examples=[
            (
                [
                    f"{_key}#C6 08 10 00 0A 00 00 00",
                    f"{_back}#{_go}",
                    f"{_key}#01 61 62 63 64 65 66 67",
                    f"{_key}#82 68 69 6A 00 00 00 00",
                    f"{_back}#A2 02 7F 00 00 00 00 00",
                    f"{_key}#D1 2A A3 00 00 00 00 00",
                ],
                {
                    "node": 5,
                    "checked": 1,
                    "sized": 1,
                    "index": 0x1008,
                    "subindex": 0,
                    "data": b"abcdefghij",
                },
            )
        ],
    )
