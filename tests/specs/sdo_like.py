"""Service data of CANopen: objects that are read and written in segments, in blocks, and in single frames.

What it asks of the language: packets in a conversation of two identifiers; messages of one frame on the identifiers of
packets; aborts, which end a packet and are messages; frames that are what they are only in their conversation.

Source: CiA 301 as canopen 2.4 carries it out, which sent the transfers of the worked examples.
"""

from __future__ import annotations

from construct import Byte, Bytes, GreedyBytes, Int16ul, Int32ul, Struct

from aces_bus.protocol import IdField, Protocol, Reserved, SdoTransfer

sdo_like = Protocol("sdo_like", link="can", bitrate=1_000_000, doc="Service data.", source="CiA 301")

Node = IdField("node", range(1, 128))
Sized, Unused = IdField("sized", range(2)), IdField("unused", range(4))
Checked, BlockSized = IdField("checked", range(2)), IdField("sized", range(2))
transfer = SdoTransfer(max_size=400)

_OBJECT = Struct("command" / Byte, "index" / Int16ul, "subindex" / Byte)
ask = sdo_like.family(_OBJECT, id=0x600 + Node, direction="to device", transport=transfer)
answer = sdo_like.family(_OBJECT, id=0x580 + Node, direction="from device", transport=transfer)

ask(
    "Write",
    command=0x20 | Sized,
    payload=Struct("data" / GreedyBytes),
    doc="An object that is written, in segments.",
    examples=[
        (
            ["605#21 08 10 00 0A 00 00 00", "605#00 61 62 63 64 65 66 67", "605#19 68 69 6A 00 00 00 00"],
            {"node": 5, "sized": 1, "index": 0x1008, "subindex": 0, "data": b"abcdefghij"},
        )
    ],
)
ask(
    "WriteShort",
    command=0x22 | Sized | Unused << 2,
    payload=Struct("data" / Bytes(4)),
    doc="An object of up to four bytes that is written.",
    examples=[
        ("605#2B 17 10 00 E8 03 00 00", {"node": 5, "index": 0x1017, "unused": 2, "data": b"\xe8\x03\0\0"})
    ],
)
ask(
    "WriteBlocks",
    command=0xC0 | Checked << 2 | BlockSized << 1,
    payload=Struct("data" / GreedyBytes),
    doc="An object that is written, in blocks.",
    examples=[
        (
            [
                "605#C6 08 10 00 0A 00 00 00", "585#A4 08 10 00 7F 00 00 00", "605#01 61 62 63 64 65 66 67",
                "605#82 68 69 6A 00 00 00 00", "585#A2 02 7F 00 00 00 00 00", "605#D1 2A A3 00 00 00 00 00",
            ],
            {"node": 5, "checked": 1, "sized": 1, "index": 0x1008, "subindex": 0, "data": b"abcdefghij"},
        )
    ],
)  # fmt: skip
ask(
    "ReadBlocks",
    command=0xA0 | Checked << 2,
    payload=Struct("block_size" / Byte, "switch" / Byte, "reserved" / Reserved(2)),
    doc="What does an object say? In blocks of so many segments; in fewer frames where it has no more bytes than `switch`.",
)
ask("Read", command=0x40, payload=Struct("reserved" / Reserved(4)), doc="What does an object say?")
ask("Abort", command=0x80, payload=Struct("code" / Int32ul), doc="Who asked has given up.")
answer(
    "Object",
    command=0x40 | Sized,
    payload=Struct("data" / GreedyBytes),
    doc="An object that is read, in segments.",
    examples=[
        (
            ["585#41 08 10 00 0A 00 00 00", "585#00 61 62 63 64 65 66 67", "585#19 68 69 6A 00 00 00 00"],
            {"node": 5, "sized": 1, "index": 0x1008, "subindex": 0, "data": b"abcdefghij"},
        )
    ],
)
answer(
    "ObjectInBlocks",
    command=0xC0 | Checked << 2 | BlockSized << 1,
    payload=Struct("data" / GreedyBytes),
    doc="An object that is read, in blocks.",
    examples=[
        (
            [
                "585#C2 08 10 00 03 00 00 00", "605#A3 00 00 00 00 00 00 00", "585#81 61 62 63 00 00 00 00",
                "605#A2 01 7F 00 00 00 00 00", "585#D1 00 00 00 00 00 00 00",
            ],
            {"node": 5, "checked": 0, "sized": 1, "index": 0x1008, "subindex": 0, "data": b"abc"},
        )
    ],
)  # fmt: skip
answer(
    "ShortObject",
    command=0x42 | Sized | Unused << 2,
    payload=Struct("data" / Bytes(4)),
    doc="An object of up to four bytes.",
)
answer("Written", command=0x60, payload=Struct("reserved" / Reserved(4)), doc="Written, or: go on.")
answer("Refused", command=0x80, payload=Struct("code" / Int32ul), doc="The node ends the transfer.")
