"""Protocols: declare one, and scan, encode and check with it.

A spec imports its words from here; they are construct's own beside ours. See the tutorial and the architecture page.
"""

from __future__ import annotations

from ..frame import Frame as Frame
from .records import record_types as record_types
from .scan.can import CanScanner as CanScanner
from .scan.counts import Counts as Counts
from .scan.record import Meta as Meta
from .scan.record import Part as Part
from .scan.record import Record as Record
from .scan.record import Unknown as Unknown
from .scan.record import as_dict as as_dict
from .scan.reference import Reference as Reference
from .scan.scanner import Scanner as Scanner
from .scan.scanner import list_protocols as list_protocols
from .scan.scanner import load_protocol as load_protocol
from .scan.scanner import make_scanner as make_scanner
from .scan.stream import StreamScanner as StreamScanner
from .spec.bits import BitLayout as BitLayout
from .spec.bits import Split as Split
from .spec.bits import Tuple as Tuple
from .spec.bits import bits as bits
from .spec.bits import float_bits as float_bits
from .spec.checks import Check as Check
from .spec.checks import Crc as Crc
from .spec.checks import Extra as Extra
from .spec.checks import Fletcher as Fletcher
from .spec.checks import IdBytes as IdBytes
from .spec.checks import InvertedSum as InvertedSum
from .spec.checks import Sum as Sum
from .spec.checks import Xor as Xor
from .spec.delimited import AsciiDegrees as AsciiDegrees
from .spec.delimited import AsciiEnumeration as AsciiEnumeration
from .spec.delimited import AsciiInteger as AsciiInteger
from .spec.delimited import AsciiNumber as AsciiNumber
from .spec.delimited import AsciiText as AsciiText
from .spec.delimited import Delimited as Delimited
from .spec.fields import Counter as Counter
from .spec.fields import Enumeration as Enumeration
from .spec.fields import Field as Field
from .spec.fields import Flags as Flags
from .spec.fields import FlagSet as FlagSet
from .spec.fields import Multiplexed as Multiplexed
from .spec.fields import Quantity as Quantity
from .spec.fields import Reserved as Reserved
from .spec.fields import SignMagnitude as SignMagnitude
from .spec.fields import Text as Text
from .spec.framing import Framing as Framing
from .spec.message import Message as Message
from .spec.message import Request as Request
from .spec.packet import can_image as can_image
from .spec.pattern import Capture as Capture
from .spec.protocol import Protocol as Protocol
from .spec.protocol import Variant as Variant
from .spec.registers import Register as Register
from .spec.registers import RegisterMap as RegisterMap
from .spec.stuffing import Cobs as Cobs
from .spec.stuffing import Insert as Insert
from .spec.stuffing import Slip as Slip
