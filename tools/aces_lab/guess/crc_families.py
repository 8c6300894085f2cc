"""The CRCs of the catalogue as linear maps: what each byte adds, at each distance from the end.

1. CRCs that differ in their constants only are one family, and have one table.
2. Tables grow to the longest row that was asked for, and are kept: the catalogue is the same for all recordings.
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np

from aces_bus.protocol import Crc
from aces_bus.protocol.columns.checks import CrcColumns
from aces_bus.protocol.columns.table import Array
from aces_bus.protocol.record import PlainValue

#: CRCs that are named first where bytes of several of the same polynomial fit as well (AUTOSAR's libraries, SAE J1850).
USUAL = frozenset({"CRC8-SAE-J1850", "CRC8-AUTOSAR", "CRC16-IBM-3740", "CRC32-ISO-HDLC"})


class CrcModel(NamedTuple):
    """The constants of a CRC; without a name: one that is in no catalogue."""

    name: str
    init: int
    xorout: int


class CrcFamily:
    """The CRCs of the catalogue that differ in their constants only, as one linear map."""

    def __init__(self, width: int, poly: int, refin: bool, refout: bool) -> None:
        self.width, self.poly, self.refin, self.refout = width, poly, refin, refout
        self.models: list[CrcModel] = []
        self._tables = np.zeros((0, 256), np.uint32)
        #: What the register is behind the last distance of the tables.
        self._register: Array | None = None
        self._constants: dict[int, Array] = {}

    def columns(self, init: int = 0) -> CrcColumns:
        """Return what computes it for many rows at once, from an initial value on."""
        return CrcColumns(
            Crc(width=self.width, poly=self.poly, init=init, refin=self.refin, refout=self.refout)
        )

    def tables(self, count: int) -> Array:
        """Return what a byte gives at each distance from the end, uint32 (count, 256)."""
        if len(self._tables) < count:
            crc, nothing = self.columns(), np.zeros((1, 1), np.uint8)
            if self._register is None:
                self._register = crc.over(crc.begin(256), np.arange(256, dtype=np.uint8)[:, None])
            steps: list[Array] = []
            for _ in range(max(64, 1 << (count - 1).bit_length()) - len(self._tables)):
                steps.append(self._register)
                self._register = crc.over(self._register, nothing)
            more = crc.end(np.concatenate(steps)).astype(np.uint32).reshape(-1, 256)
            self._tables = np.concatenate([self._tables, more])
        return self._tables[:count]

    def constants(self, init: int, count: int) -> Array:
        """Return what the initial value gives behind 0, 1 … `count` bytes, uint32."""
        known = self._constants.get(init)
        if known is None or len(known) <= count:
            count = max(64, 1 << count.bit_length())
            crc, nothing = self.columns(init), np.zeros((1, 1), np.uint8)
            register = crc.begin(1)
            out = [crc.end(register)]
            for _ in range(count):
                register = crc.over(register, nothing)
                out.append(crc.end(register))
            known = self._constants[init] = np.concatenate(out).astype(np.uint32)
        return known

    def arguments(self, model: CrcModel, constant: int) -> dict[str, PlainValue]:
        """Return what `Crc` takes: the model's name, or the parameters with what is left as the final value."""
        if model.name:
            return {"name": model.name}
        linear = {"width": self.width, "poly": self.poly, "init": model.init}
        return {**linear, "refin": self.refin, "refout": self.refout, "xorout": constant}


@cache
def crc_families(size: int) -> tuple[CrcFamily, ...]:
    """Return the catalogue's CRCs of `size` bytes, by what is linear in them."""
    import anycrc

    found: dict[tuple[int, int, bool, bool], CrcFamily] = {}
    for name, model in anycrc.models.items():
        if model.width == 8 * size:
            linear = model.width, model.poly, model.refin, model.refout
            family = found.setdefault(linear, CrcFamily(*linear))
            family.models.append(CrcModel(name, model.init, model.xorout))
    for family in found.values():
        family.models.sort(key=lambda model: model.name not in USUAL)
    return tuple(found.values())


@cache
def stacked_tables(size: int, count: int) -> Array:
    """Return the tables of all families of a size, uint32 (families, count, 256)."""
    return np.stack([family.tables(count)[:count] for family in crc_families(size)])


def bytes_giving(family: CrcFamily, size: int, constant: int) -> bytes | None:
    """Return the `size` bytes behind what is covered that give a constant, first byte first."""
    tables = family.tables(size)
    if size == 1:
        found = np.flatnonzero(tables[0] == constant)
        return bytes([int(found[0])]) if len(found) else None
    both = tables[1][:, None] ^ tables[0][None, :]
    pairs = np.argwhere(both == constant)
    return bytes(pairs[0].tolist()) if len(pairs) else None
