"""Protocols: declare one, and scan, encode and check with it.

A spec imports its words from here; they are construct's own beside ours. See the tutorial and the architecture page.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from .._lazy import lazy_names

if TYPE_CHECKING:
    from .declare.bits import BitLayout, Split, Tuple, bits, float_bits
    from .declare.checks import (
        Check,
        Crc,
        DataIds,
        Extra,
        Fletcher,
        IdBytes,
        InvertedSum,
        RequestBytes,
        Sum,
        Xor,
    )
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
        Multiplexed,
        Present,
        Quantity,
        Reserved,
        SignMagnitude,
        Text,
        TwoScales,
        top,
    )
    from .declare.framing import Escaped, Trailer
    from .declare.isotp import IsoTp
    from .declare.items import ItemList, Items
    from .declare.j1939 import J1939Transport
    from .declare.message import Message
    from .declare.pattern import IdField
    from .declare.protocol import Variant
    from .declare.sdo import SdoTransfer
    from .declare.stuffing import Cobs, CutZeros, Insert, Slip
    from .declare.tail_byte import TailByte
    from .declare.transport import Transport
    from .live.can import CanScanner
    from .protocol import Protocol
    from .record import Part, Record
    from .record_plans import record_types

__all__ = [
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
    "DataIds",
    "Delimited",
    "Enumeration",
    "Escaped",
    "Extra",
    "FastPacket",
    "Field",
    "FlagSet",
    "Flags",
    "Fletcher",
    "IdBytes",
    "IdField",
    "Insert",
    "InvertedSum",
    "IsoTp",
    "ItemList",
    "Items",
    "J1939Transport",
    "Message",
    "Multiplexed",
    "Part",
    "Present",
    "Protocol",
    "Quantity",
    "Record",
    "RequestBytes",
    "Reserved",
    "SdoTransfer",
    "SignMagnitude",
    "Slip",
    "Split",
    "Sum",
    "TailByte",
    "Text",
    "Trailer",
    "Transport",
    "Tuple",
    "TwoScales",
    "Variant",
    "Xor",
    "bits",
    "float_bits",
    "record_types",
    "top",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        ".declare.bits": "BitLayout Split Tuple bits float_bits",
        ".declare.checks": "Check Crc DataIds Extra Fletcher IdBytes InvertedSum RequestBytes Sum Xor",
        ".declare.delimited": "AsciiDegrees AsciiEnumeration AsciiInteger AsciiNumber AsciiText Delimited",
        ".declare.fast_packet": "FastPacket",
        ".declare.fields": "Counter Enumeration Field FlagSet Flags Multiplexed Present Quantity Reserved"
        " SignMagnitude Text TwoScales top",
        ".declare.framing": "Escaped Trailer",
        ".declare.isotp": "IsoTp",
        ".declare.items": "ItemList Items",
        ".declare.j1939": "J1939Transport",
        ".declare.message": "Message",
        ".declare.pattern": "IdField",
        ".declare.protocol": "Variant",
        ".declare.sdo": "SdoTransfer",
        ".declare.stuffing": "Cobs CutZeros Insert Slip",
        ".declare.tail_byte": "TailByte",
        ".declare.transport": "Transport",
        ".live.can": "CanScanner",
        ".protocol": "Protocol",
        ".record": "Part Record",
        ".record_plans": "record_types",
    },
)
