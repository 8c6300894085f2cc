"""CRCs of many packets at once, with NumPy: all packets a step further, two bytes a step.

1. `CrcColumns` gives what `Crc.compute` gives, for every CRC of at most 64 bits.
2. Time is bounded by the bytes covered; memory by the number of packets.

The register is kept reflected (lowest bit first), whatever the CRC: where bytes go in highest bit first, they are turned
round before, and the result at the end. Then one step is `T[(register ^ word) & 0xFFFF] ^ register >> 16`, with a table of
what sixteen bits of the register become.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt

from ..declare.checks import Crc

Array = npt.NDArray[Any]

#: What a step over all packets costs beside one packet done alone, in microseconds: decides which are done alone.
_STEP, _ALONE = 6.0, 0.8


class CrcColumns:
    """The CRC of runs of bytes in one buffer; `can` says for which CRCs there is one."""

    def __init__(self, check: Crc) -> None:
        width, poly, init, refin, refout, xorout = parameters_of(check)
        self.width = width
        self.is_turned = not refin
        self._turn_out = not refout
        self.dtype = np.dtype(np.uint16 if width <= 16 else np.uint32 if width <= 32 else np.uint64)
        self._bytes, self._words = _tables(width, poly, self.dtype.itemsize)
        self._init = self.dtype.type(_turned(init, width))
        self._xorout = self.dtype.type(xorout)

    @staticmethod
    def can(check: Crc) -> bool:
        """Whether the CRC fits a machine word."""
        return parameters_of(check)[0] <= 64

    def begin(self, count: int) -> Array:
        """The registers of `count` packets before their first byte."""
        return np.full(count, self._init, self.dtype)

    def words(self, data: Array) -> tuple[Array, Array]:
        """(bytes, words that start at each byte) of a buffer, as `run` wants them."""
        if self.is_turned:
            data = _TURN.take(data)
        words = np.empty(max(len(data) - 1, 0), np.uint16)
        np.copyto(words, np.ndarray(len(words), "<u2", data.data if len(data) else b"", strides=(1,)))
        return data, words

    def run(self, register: Array, source: tuple[Array, Array], starts: Array, sizes: Array) -> Array:
        """The registers after `sizes` bytes from `starts` of the buffer."""
        if not len(register):
            return register
        data, words = source
        most, least = int(sizes.max()), int(sizes.min())
        if most == least:
            at = starts.astype(np.intp)
            for _ in range(most >> 1):
                register = self._word(register, words.take(at))
                at += 2
            return self._byte(register, data.take(at)) if most & 1 else register
        # The longest first: those that are still running are always the first ones.
        order = np.argsort(-sizes, kind="stable")
        register, at, sizes = register[order], starts[order].astype(np.intp), sizes[order]
        left = -(sizes >> 1)
        for count in np.searchsorted(left, -np.arange(most >> 1), "left").tolist():
            register[:count] = self._word(register[:count], words.take(at[:count]))
            at[:count] += 2
        odd = np.flatnonzero(sizes & 1)
        register[odd] = self._byte(register[odd], data.take(at[odd]))
        out = np.empty_like(register)
        out[order] = register
        return out

    def over(self, register: Array, rows: Array) -> Array:
        """The registers after the bytes of `rows`, a row a packet (or one row for all)."""
        if self.is_turned:
            rows = _TURN.take(rows)
        for column in range(rows.shape[1]):
            register = self._byte(register, rows[:, column])
        return register

    def end(self, register: Array) -> Array:
        """The numbers that stand for these registers in a packet."""
        if self._turn_out:
            # Each byte turned round, and the bytes read the other way.
            octets = _TURN.take(register.astype(self.dtype.newbyteorder("<")).view(np.uint8))
            turned = octets.view(self.dtype.newbyteorder(">")).astype(self.dtype)
            register = turned >> self.dtype.type(8 * self.dtype.itemsize - self.width)
        return register ^ self._xorout

    def _word(self, register: Array, words: Array) -> Array:
        if self.width <= 16:
            found: Array = self._words.take(register ^ words)
            return found
        low = (register ^ words).astype(np.uint16)
        found = self._words.take(low) ^ (register >> self.dtype.type(16))
        return found

    def _byte(self, register: Array, octets: Array) -> Array:
        low = (register ^ octets).astype(np.uint8)
        found: Array = self._bytes.take(low) ^ (register >> self.dtype.type(8))
        return found


def done_alone(sizes: Array) -> Array:
    """Which packets are better done one by one: the few longest, where a step would be for them alone."""
    order = np.argsort(-sizes, kind="stable")
    steps = np.append(sizes[order] >> 1, 0)
    best = int(np.argmin(_ALONE * np.arange(len(steps)) + _STEP * steps))
    found: Array = order[:best]
    return found


def parameters_of(check: Crc) -> tuple[int, int, int, bool, bool, int]:
    """(width, poly, init, refin, refout, xorout), also of a CRC given by its name."""
    import anycrc

    known = anycrc.models.get(check.name)
    if known is None:
        return check.parameters
    return known.width, known.poly, known.init, known.refin, known.refout, known.xorout


def _turned(number: int, width: int) -> int:
    """The lowest `width` bits in reverse."""
    return int(f"{number & ((1 << width) - 1):0{width}b}"[::-1], 2)


_TURN = np.array([_turned(n, 8) for n in range(256)], np.uint8)


@cache
def _tables(width: int, poly: int, size: int) -> tuple[Array, Array]:
    """What 8 and what 16 bits of a register become, as numbers of `size` bytes."""
    kind = np.dtype(f"u{size}").type
    reflected, one = kind(_turned(poly, width)), kind(1)
    octets = np.arange(256, dtype=kind)
    for _ in range(8):
        octets = np.where(octets & one, octets >> one ^ reflected, octets >> one)
    words = np.arange(65536, dtype=kind)
    for _ in range(2):
        words = octets.take(words & kind(0xFF)) ^ words >> kind(8)
    return octets, words
