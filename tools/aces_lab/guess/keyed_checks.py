"""A CRC over data and a byte that is not sent, which a counter of the message chooses (AUTOSAR E2E profiles 1 and 2).

1. Within messages of one count the byte is a constant, and a CRC is linear: of two of them the check's difference is the CRC
   of their difference. Polynomial, place and range follow from that, as in `checks`, and the byte from what is left.
2. What all counts share may as well be the CRC's constants: those of the catalogue are taken, AUTOSAR's first.
3. The place of the byte does not show. It is behind the data where profile 2 has it (CRC8-AUTOSAR), else in front.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from math import log2
from typing import NamedTuple

import numpy as np

from aces_bus.protocol import Crc, DataIds
from aces_bus.protocol.columns.table import Array
from aces_bus.protocol.declare.checks import Covered

from .check_evidence import independent_rows
from .checks import CHANCE_BITS, SHARE, CheckGuess, check_source
from .crc_families import CrcFamily, crc_families
from .fields import FieldGuess, Rows

#: Counts that choose, messages of each at least, pairs of messages in all that are looked at.
COUNTS, EACH, PAIRS = 16, 4, 128
#: First bytes at which what is covered may begin, and rows that are longer are not looked at.
STARTS, LONGEST = 6, 64


class _Solved(NamedTuple):
    """The ids of each count, and how many messages agree."""

    name: str
    ids: tuple[int, ...]
    agreeing: int


def keyed_checks(rows: Array, counter: FieldGuess) -> Iterator[FieldGuess]:
    """Yield the check of messages, uint8 (n, size), whose id the counter chooses; `values` are the ids, by rising count."""
    if not 2 <= rows.shape[1] <= LONGEST:
        return
    rows = rows[: 64 * COUNTS]
    positions = counter.positions[:4]
    counts = Rows(rows, of=len(rows)).values(positions).astype(np.int64)
    numbers, each = np.unique(counts, return_counts=True)
    if len(numbers) < 2 or each.min() < EACH:
        return
    order = np.argsort(counts, kind="stable")
    pairs = np.flatnonzero(counts[order][1:] == counts[order][:-1])
    pairs = pairs[np.linspace(0, len(pairs) - 1, min(len(pairs), PAIRS)).astype(np.int64)]
    later, base = order[pairs + 1], order[pairs]
    size = rows.shape[1]
    own = {position // 8 for position in positions}
    places = [byte for byte in range(size) if byte not in own and len(np.unique(rows[:, byte])) > COUNTS]
    families = crc_families(1)
    tried = len(places) * len(families) * 2 * STARTS
    for place in places:
        back = np.delete(rows, place, axis=1)[:, ::-1]
        changes = back[later] ^ back[base]
        wanted = (rows[later, place] ^ rows[base, place]).astype(np.uint32)
        for family, is_behind in product(families, (True, False)):
            distances = np.arange(size - 1) + is_behind
            parts = family.tables(size + 1)[distances, changes]
            agree = (np.bitwise_xor.accumulate(parts, axis=1) == wanted[:, None]).mean(axis=0)
            start = next((n for n in range(min(STARTS, size - 2)) if agree[size - 2 - n] >= SHARE), None)
            if start is None or is_behind != _is_behind(family):
                continue
            covered = size - 1 - start
            bits = 8.0 * independent_rows(changes[:, :covered]) - log2(tried)
            solved = _solved(family, back[:, :covered], rows[:, place], counts, numbers, is_behind)
            if bits < CHANCE_BITS or solved is None or len(set(solved.ids)) < 2:
                continue
            start += start >= place
            runs = tuple(run for run in ((start, place), (max(place + 1, start), size)) if run[0] < run[1])
            yield _guess(place, runs, counter, numbers.tolist(), solved, len(rows), is_behind, bits)
            return


def _is_behind(family: CrcFamily) -> bool:
    """Return whether the byte is taken to be behind the data: the family of AUTOSAR's profile 2."""
    return any(model.name == "CRC8-AUTOSAR" for model in family.models)


def _solved(
    family: CrcFamily, back: Array, stored: Array, counts: Array, numbers: Array, is_behind: bool
) -> _Solved | None:
    """Return the byte of each count, by the first constants of the catalogue with which all of them have one."""
    length = back.shape[1]
    tables = family.tables(length + 1)
    rest = np.bitwise_xor.reduce(tables[np.arange(length) + is_behind, back], axis=1) ^ stored
    for model in family.models:
        left = rest ^ family.constants(model.init, length + 1)[length + 1] ^ np.uint32(model.xorout)
        ids: list[int] = []
        agreeing = 0
        for number in numbers:
            values, each = np.unique(left[counts == number], return_counts=True)
            byte = np.flatnonzero(tables[0 if is_behind else length] == values[np.argmax(each)])
            ids += byte[:1].tolist()
            agreeing += int(each.max())
        if len(ids) == len(numbers) and agreeing >= SHARE * len(stored):
            return _Solved(model.name, tuple(ids), agreeing)
    return None


def _guess(
    place: int,
    runs: tuple[tuple[int, int], ...],
    counter: FieldGuess,
    numbers: list[int],
    solved: _Solved,
    count: int,
    is_behind: bool,
    bits: float,
) -> FieldGuess:
    covers = " and ".join(_run(first, end) for first, end in runs)
    shown = " ".join(f"{byte:02X}" for byte in solved.ids)
    where = "behind" if is_behind else "in front of"
    said = f"{solved.name} of {covers}, and {where} them an id that the counter in byte {counter.first_byte} chooses:"
    said += f" {shown}; {solved.agreeing} of {count} rows"
    check: CheckGuess | None = None
    if numbers == list(range(len(numbers))) and counter.positions[0] // 8 == counter.positions[-1] // 8:
        from .draft import field_name

        over: list[Covered] = [slice(*run) for run in runs]
        over.insert(len(over) if is_behind else 0, DataIds(field_name(counter), bytes(solved.ids)))
        made = Crc(solved.name, over=over)
        check = CheckGuess(place, 1, made, check_source(made), runs, 0, solved.agreeing, count, bits)
    else:
        said += "; the ids of some counts were not seen: not declared"
    return FieldGuess(
        8 * place, 8, "little", "check", 0.98 * solved.agreeing / count, said, values=solved.ids, check=check
    )


def _run(first: int, end: int) -> str:
    return f"byte {first}" if end == first + 1 else f"bytes {first} to {end - 1}"
