"""A field of many records at once, at any bit.

1. A field lies within its record, or there is none: `field_of` checks it, and the rest may rely on it.
2. What comes is new or shared with the records, and is not written to.

*Facts*: bits count from the lowest of the byte in which a field begins. What has its highest byte first is read only where
it takes whole bytes, 1, 2, 4 or 8; programs do not agree about the rest.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..frame_table import Ints
from ._mdf_tree import SIZED, Channel, Unusual

_UNSIGNED, _SIGNED, _REAL, _TEXT, _BYTES = (0, 1), (2, 3), (4, 5), (6, 7), 10


class Field(NamedTuple):
    """Where a field is: `size` bytes from `at` on, of them `bits` from `shift` on; `plain` reads it where that suffices."""

    at: int
    size: int
    shift: int
    bits: int
    is_signed: bool
    is_real: bool
    is_bytes: bool
    plain: np.dtype[np.generic] | None


def number_of(channel: Channel, record_bytes: int) -> Field:
    """The same as `field_of`, of a channel that has integers."""
    field = field_of(channel, record_bytes)
    if field.is_real or field.is_bytes:
        raise Unusual(f"{channel.name} is no integer")
    return field


def field_of(channel: Channel, record_bytes: int) -> Field:
    """The field of a channel, in records with so many bytes. Raises `Unusual` where it is not read here."""
    kind, shift, bits = channel.data_type, channel.first_bit, channel.bits
    size = (shift + bits + 7) // 8
    is_number, is_real = kind in _UNSIGNED + _SIGNED, kind in _REAL
    is_bytes = kind == _BYTES or kind in _TEXT
    is_whole = not shift and not bits % 8
    plain = None
    if not channel.is_plain or (channel.kind not in (0, 2) and not (channel.kind == SIZED and is_bytes)):
        raise Unusual(f"{channel.name} is not a plain field")
    if not bits or channel.first_byte + size > record_bytes or not (is_number or is_real or is_bytes):
        raise Unusual(f"{channel.name} is no field of its records")
    if shift > 7 or (is_number and size > 8) or ((is_real or is_bytes) and not is_whole):
        raise Unusual(f"{channel.name} does not begin and end where its kind does")
    if is_real and bits not in (32, 64):
        raise Unusual(f"{channel.name} is a number of {bits} bits")
    if not is_bytes:
        is_high_first = kind % 2 == 1
        if is_whole and size in (1, 2, 4, 8):
            letter = "f" if is_real else "i" if kind in _SIGNED else "u"
            plain = np.dtype(f"{'>' if is_high_first else '<'}{letter}{size}")
        elif is_high_first:
            raise Unusual(f"{channel.name} has its highest byte first, and not whole bytes")
    return Field(channel.first_byte, size, shift, bits, kind in _SIGNED, is_real, is_bytes, plain)


def bytes_at(rows: Ints, field: Field) -> Ints:
    """The bytes of a field, (n, size)."""
    return np.asarray(rows[:, field.at : field.at + field.size])


def integers(rows: Ints, field: Field) -> Ints:
    """A field as integers, of a type in which they have room."""
    if field.plain is not None:
        return _plain(rows, field, field.plain)
    width = next(width for width in (1, 2, 4, 8) if width >= field.size)
    wide = np.zeros((len(rows), width), np.uint8)
    wide[:, : field.size] = rows[:, field.at : field.at + field.size]
    values: Ints = wide.view(f"<u{width}")[:, 0]
    if field.is_signed:  # up to the top, and back down with the sign
        values = values << np.array(8 * width - field.shift - field.bits, values.dtype)
        signed: Ints = values.view(f"<i{width}")
        signed = signed >> np.array(8 * width - field.bits, signed.dtype)
        return signed
    values = values >> np.array(field.shift, values.dtype)
    values &= np.array((1 << field.bits) - 1, values.dtype)
    return values


def reals(rows: Ints, field: Field) -> Ints:
    """A field as floating-point numbers."""
    assert field.plain is not None
    return _plain(rows, field, field.plain)


def _plain(rows: Ints, field: Field, kind: np.dtype[np.generic]) -> Ints:
    values: Ints = rows[:, field.at : field.at + field.size].view(kind)[:, 0]
    return values.astype(kind.newbyteorder("="))
