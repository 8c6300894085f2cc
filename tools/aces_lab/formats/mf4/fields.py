"""A field of many records at once, at any bit.

1. A field lies within its record, or there is none: `field_of` checks it, and the rest may rely on it.
2. What comes is new or shared with the records, and is not written to.
3. What is not read here is refused with `Refused`, which names the channel and the reason: arrays, complex numbers, dates,
   floating-point numbers of 16 bits, and numbers with their highest byte first that are not 1, 2, 4 or 8 whole bytes, as
   programs do not agree about them.

*Facts*: bits count from the lowest of the byte in which a field begins.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from aces_bus.frame_table import Ints

from .tree import MASTER, SIZED, VALUE, VARIABLE, MdfChannel

_UNSIGNED, _SIGNED, _REAL, _TEXT, _BYTES = (0, 1), (2, 3), (4, 5), (6, 7), 10


class BitField(NamedTuple):
    """Where a field is: `size` bytes from `at` on, of them `bits` from `shift` on; `plain` reads it where that suffices."""

    at: int
    size: int
    shift: int
    bits: int
    is_signed: bool
    is_real: bool
    is_bytes: bool
    plain: np.dtype[np.generic] | None


class Refused(Exception):
    """A channel group that is not read, and why."""


def refuse(*faults: tuple[bool, str], name: str = "") -> None:
    """Raise `Refused` with the first fault that is there, of pairs (whether it is there, text), of the channel `name`."""
    for is_there, text in faults:
        if is_there:
            raise Refused(f"{name} {text}".lstrip())


def field_of(channel: MdfChannel, record_bytes: int) -> BitField:
    """Return the field of a channel, in records with so many bytes. Raises `Refused` where it is not read."""
    kind, shift, bits = channel.data_type, channel.first_bit, channel.bits
    size = (shift + bits + 7) // 8
    is_number, is_real = kind in _UNSIGNED + _SIGNED, kind in _REAL
    is_bytes = kind == _BYTES or kind in _TEXT
    is_whole = not shift and not bits % 8
    plain = None
    if channel.kind == VARIABLE:  # the field has an offset
        is_number, is_real, is_bytes, kind = True, False, False, _UNSIGNED[0]
    is_placed = channel.kind in (VALUE, VARIABLE, MASTER) or (channel.kind == SIZED and is_bytes)
    is_high_first = not is_bytes and kind % 2 == 1
    has_plain = not is_bytes and is_whole and size in (1, 2, 4, 8)
    refuse(
        (channel.is_array or not is_placed, "is not a plain field of its records"),
        (not (is_number or is_real or is_bytes), f"is of data type {kind}, which is not read"),
        (not bits or channel.first_byte + size > record_bytes, "does not lie within its records"),
        (
            shift > 7 or (is_number and size > 8) or ((is_real or is_bytes) and not is_whole),
            "does not begin and end where its data type does",
        ),
        (is_real and bits not in (32, 64), f"is a floating-point number of {bits} bits, which is not read"),
        (
            is_high_first and not has_plain,
            "has its highest byte first, and not 1, 2, 4 or 8 whole bytes",
        ),
        name=channel.name,
    )
    if has_plain:
        letter = "f" if is_real else "i" if kind in _SIGNED else "u"
        plain = np.dtype(f"{'>' if is_high_first else '<'}{letter}{size}")
    return BitField(channel.first_byte, size, shift, bits, kind in _SIGNED, is_real, is_bytes, plain)


def bytes_at(rows: Ints, field: BitField) -> Ints:
    """Return the bytes of a field, (n, size)."""
    return np.asarray(rows[:, field.at : field.at + field.size])


def integers(rows: Ints, field: BitField) -> Ints:
    """Return a field as integers, of a type in which they have room."""
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


def numbers(rows: Ints, field: BitField) -> Ints:
    """Return a field as integers, or as floating-point numbers if it has those."""
    return _plain(rows, field, field.plain) if field.plain is not None else integers(rows, field)


def _plain(rows: Ints, field: BitField, kind: np.dtype[np.generic]) -> Ints:
    values: Ints = rows[:, field.at : field.at + field.size].view(kind)[:, 0]
    return values.astype(kind.newbyteorder("="))
