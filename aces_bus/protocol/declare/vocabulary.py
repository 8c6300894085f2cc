"""Which words of construct a payload may have: every class of its module is named here, and why those that are refused are.

1. A word is refused when what it reads cannot be built again byte for byte, when it runs a program on bytes from a
   wire, or when it reads later than `feed`. A class that is not named here, from a construct yet to come, is refused too.
2. Types of your own (`Field`, adapters, any `Construct`) are taken as they are: what they lose, the laws find.
"""

from __future__ import annotations

from collections.abc import Hashable

import construct as c
from construct import Construct, core

#: Read and built as they are; nothing is inside them that could lose bytes.
LEAVES: frozenset[type] = frozenset(
    {
        c.Construct,
        c.FormatField,
        c.BytesInteger,
        c.BitsInteger,
        c.Bytes,
        type(c.GreedyBytes),
        type(c.VarInt),
        type(c.ZigZag),
        type(c.Pass),
        type(c.Terminated),
        type(c.Error),
        c.Const,
        c.StopIf,
        c.Check,
    }
)

#: Looked into: what is inside is held to the same rules.
WALKED: frozenset[type] = frozenset(
    {
        c.Renamed,
        c.Struct,
        c.Sequence,
        c.FocusedSeq,
        c.Array,
        c.GreedyRange,
        c.RepeatUntil,
        c.Prefixed,
        c.FixedSized,
        c.NullTerminated,
        c.NullStripped,
        c.IfThenElse,
        c.Switch,
        c.LazyBound,
        c.Enum,
        c.FlagsEnum,
        c.Transformed,
        c.StringEncoded,
        # These leave their bytes to what is inside.
        c.Subconstruct,
        c.Adapter,
        c.SymmetricAdapter,
        c.Validator,
        c.ExprAdapter,
        c.ExprSymmetricAdapter,
        c.ExprValidator,
        c.Mapping,
        c.NamedTuple,
        c.Hex,
        c.HexDump,
        c.Default,
        c.Rebuild,
        type(c.Flag),
    }
)

_SKIPS = "{} would skip or repeat bytes; name them, for instance as Reserved(n)"
_LATE = "{} reads when it is looked at, not when the bytes come"
_PROGRAM = "{} runs what the bytes say; a wire is not to be trusted with that"
_OTHER = "{} does not give the same bytes back"
_OPEN = "{} leaves open which bytes it has read"

REFUSED: dict[type, str] = {
    **dict.fromkeys(
        (
            c.Padded,
            c.Aligned,
            c.Pointer,
            c.Peek,
            c.Seek,
            type(c.Tell),
            c.RawCopy,
            c.Union,
            c.Select,
            c.Computed,
            c.Probe,
            type(c.Index),
            c.Indexing,
            c.Slicing,
        ),
        _SKIPS,
    ),
    **dict.fromkeys((c.Lazy, c.LazyArray, c.LazyStruct), _LATE),
    **dict.fromkeys((type(c.Pickled), type(c.Numpy)), _PROGRAM),
    **dict.fromkeys(
        (c.Tunnel, c.Compressed, c.CompressedLZ4, c.EncryptedSym, c.EncryptedSymAead, c.TimestampAdapter),
        _OTHER,
    ),
    **dict.fromkeys(
        (c.Restreamed, c.RestreamData, c.Rebuffered, c.OffsettedEnd, c.ProcessXor, c.ProcessRotateLeft), _OPEN
    ),
    c.Checksum: "{} belongs to the message: check=Sum(field=…), check=Crc(…, field=…)",
    c.Debugger: "{} stops the program at a prompt",
    c.Compiled: "{} hides what it was compiled from; use that",
}

#: Encodings in which every text that reads is written with the same bytes; others have a mark of their byte order.
ENCODINGS = frozenset(
    {"ascii", "latin_1", "latin1", "utf8", "utf_8", "u8", "utf_16_be", "utf_16_le", "utf_32_be", "utf_32_le"}
)

#: What `Bitwise`, `ByteSwapped` and `BitsSwapped` do to bytes: how many come out of one.
TRANSFORMS: dict[Hashable, int] = {core.bytes2bits: 8, core.swapbytes: 1, core.swapbitsinbytes: 1}


def construct_class(con: c.Construct) -> type | None:
    """Return the class that decides about a construct: its own, or for a user's type the nearest of construct's.

    None for a class of construct's that is not named here.
    """
    kind = type(con)
    if kind.__module__.partition(".")[0] == "construct":
        return kind if kind in LEAVES or kind in WALKED or kind in REFUSED else None
    return next(k for k in kind.__mro__ if k in LEAVES or k in WALKED or k in REFUSED)


def construct_name(con: Construct) -> str:
    """Return construct's own name of a field's class, for texts."""
    return type(con).__name__.removeprefix("Whole")


def refusal_of(con: c.Construct) -> str:
    """Say why a payload cannot have this construct, its content aside; empty when it can."""
    kind = construct_class(con)
    if kind is None:
        return f"{type(con).__name__} is a word of construct that aces-bus does not know"
    if kind in REFUSED:
        return REFUSED[kind].format(type(con).__name__)
    if isinstance(con, c.FormatField) and con.fmtstr[-1:] == "?":
        return f"{type(con).__name__} '?' loses bits; use Enumeration(Byte, off=0, on=1)"
    if isinstance(con, c.StringEncoded) and str(con.encoding).lower().replace("-", "_") not in ENCODINGS:
        return f"text in {con.encoding} has a mark of its byte order, which would be lost; say the order (utf_16_le)"
    if isinstance(con, c.NullTerminated) and (con.include or not con.consume or not con.require):
        return "NullTerminated takes its end off and needs it: include, consume and require are not to be changed"
    if getattr(con, "discard", False):
        return f"{type(con).__name__} discards what it reads"
    if isinstance(con, c.Transformed):
        if con.decodefunc not in TRANSFORMS:
            return "Transformed by a function of its own; write a Field, or Bitwise, ByteSwapped, BitsSwapped"
        if con.decodeamount is None:
            return _OPEN.format(type(con).__name__)
    return ""
