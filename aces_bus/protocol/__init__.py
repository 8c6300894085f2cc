"""Protocols: declare one, and scan, encode and check with it.

A spec imports its words from here; they are construct's own beside ours. See the tutorial and the architecture page.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from .._lazy import lazy_names

if TYPE_CHECKING:
    from ..frames import Frame
    from .counts import ScanCounts
    from .declare.bits import BitLayout, Split, Tuple, bits, float_bits
    from .declare.checks import Check, Crc, Extra, Fletcher, IdBytes, InvertedSum, Sum, Xor
    from .declare.delimited import (
        AsciiDegrees,
        AsciiEnumeration,
        AsciiInteger,
        AsciiNumber,
        AsciiText,
        Delimited,
    )
    from .declare.fast_packet import FastPacket
    from .declare.fields import (
        Counter,
        Enumeration,
        Field,
        Flags,
        FlagSet,
        Quantity,
        Reserved,
        SignMagnitude,
        Text,
        top,
    )
    from .declare.framing import Escaped, Framing, Trailer
    from .declare.handshake import AnswerTimes, Steering
    from .declare.isotp import IsoTp
    from .declare.item_list import ItemList
    from .declare.items import Items
    from .declare.j1939 import J1939Transport
    from .declare.message import Message, Request
    from .declare.multiplexed import Multiplexed
    from .declare.pattern import IdField
    from .declare.present import Present
    from .declare.protocol import Protocol, Variant
    from .declare.registers import Register, RegisterMap
    from .declare.sdo import SdoTransfer
    from .declare.stuffing import Cobs, CutZeros, Insert, Slip
    from .declare.tail_byte import TailByte
    from .declare.transport import FrameKind, FrameNumber, FramePart, Transport
    from .live.can import CanScanner
    from .live.scanner import Scanner, list_protocols, load_protocol, make_scanner
    from .live.stream import StreamScanner
    from .record import Meta, Part, Record, Unknown, as_dict, record_types
    from .reference import Reference

__all__ = [
    "AnswerTimes",
    "AsciiDegrees",
    "AsciiEnumeration",
    "AsciiInteger",
    "AsciiNumber",
    "AsciiText",
    "BitLayout",
    "CanScanner",
    "Check",
    "Cobs",
    "Counter",
    "Crc",
    "CutZeros",
    "Delimited",
    "Enumeration",
    "Escaped",
    "Extra",
    "FastPacket",
    "Field",
    "FlagSet",
    "Flags",
    "Fletcher",
    "Frame",
    "FrameKind",
    "FrameNumber",
    "FramePart",
    "Framing",
    "IdBytes",
    "IdField",
    "Insert",
    "InvertedSum",
    "IsoTp",
    "ItemList",
    "Items",
    "J1939Transport",
    "Message",
    "Meta",
    "Multiplexed",
    "Part",
    "Present",
    "Protocol",
    "Quantity",
    "Record",
    "Reference",
    "Register",
    "RegisterMap",
    "Request",
    "Reserved",
    "ScanCounts",
    "Scanner",
    "SdoTransfer",
    "SignMagnitude",
    "Slip",
    "Split",
    "Steering",
    "StreamScanner",
    "Sum",
    "TailByte",
    "Text",
    "Trailer",
    "Transport",
    "Tuple",
    "Unknown",
    "Variant",
    "Xor",
    "as_dict",
    "bits",
    "float_bits",
    "list_protocols",
    "load_protocol",
    "make_scanner",
    "record_types",
    "top",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "..frames": "Frame",
        ".counts": "ScanCounts",
        ".declare.bits": "BitLayout Split Tuple bits float_bits",
        ".declare.checks": "Check Crc Extra Fletcher IdBytes InvertedSum Sum Xor",
        ".declare.delimited": "AsciiDegrees AsciiEnumeration AsciiInteger AsciiNumber AsciiText Delimited",
        ".declare.fast_packet": "FastPacket",
        ".declare.fields": "Counter Enumeration Field Flags FlagSet Quantity Reserved SignMagnitude Text top",
        ".declare.framing": "Escaped Framing Trailer",
        ".declare.handshake": "AnswerTimes Steering",
        ".declare.isotp": "IsoTp",
        ".declare.item_list": "ItemList",
        ".declare.items": "Items",
        ".declare.j1939": "J1939Transport",
        ".declare.message": "Message Request",
        ".declare.multiplexed": "Multiplexed",
        ".declare.present": "Present",
        ".declare.pattern": "IdField",
        ".declare.protocol": "Protocol Variant",
        ".declare.registers": "Register RegisterMap",
        ".declare.sdo": "SdoTransfer",
        ".declare.stuffing": "Cobs CutZeros Insert Slip",
        ".declare.tail_byte": "TailByte",
        ".declare.transport": "FrameKind FrameNumber FramePart Transport",
        ".live.can": "CanScanner",
        ".live.scanner": "Scanner list_protocols load_protocol make_scanner",
        ".live.stream": "StreamScanner",
        ".record": "Meta Part Record Unknown as_dict record_types",
        ".reference": "Reference",
    },
)
