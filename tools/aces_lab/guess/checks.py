"""Which bytes of unknown rows are a check, of what kind, over which bytes.

1. Kinds are those that a spec can declare, CRCs those of the catalogue; a row that disagrees counts against a guess.
2. A guess needs more evidence than all that was tried could give by chance: `CHANCE_BITS` bits more.
3. At most `ROWS` different rows are looked at, and each trial is of a few of them first: time is bounded.

A CRC without initial and final value is linear: of two rows of one length the check's difference is the CRC of their
difference, whatever the constants. So polynomial, place and range are found first, from the contributions of single bytes (a
table for each byte and distance to the end, exclusive-ored from the end on: all ranges that end there at once), and the
constants afterwards. Sums and exclusive or are found in the same way. Constant bytes in front of what is covered say nothing
of a linear check; of ranges that differ in them only, the one whose constants the catalogue explains is taken, the
longest first.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from math import log2
from typing import Any, NamedTuple

import numpy as np

from aces_bus.protocol import Check, Crc, DataIds, Fletcher, IdBytes, Sum, Xor
from aces_bus.protocol.columns.table import Array
from aces_bus.protocol.declare.checks import Covered, Order
from aces_bus.protocol.record import PlainValue

from .check_evidence import entropy_bits, independent_rows, stored_numbers, sum_bits
from .crc_families import CrcFamily, CrcModel, bytes_giving, crc_families, stacked_tables

#: Different rows that are looked at, and of these the ones that a trial sees first.
ROWS, FIRST = 256, 24
#: The share of these that must agree: where one row in twenty is not a packet, one pair in ten is none.
TRIAL = 0.65
#: Pairs of rows that a CRC is tried on first.
PAIRS = 12
#: Bits of evidence beyond all trials together: a chance of one in 1e9.
CHANCE_BITS = 30.0
#: The share of rows that must agree.
SHARE = 0.95
#: Bytes of a row at either end in which a check may begin, where rows are long.
EDGE = 6
#: First bytes of a long row at which what is covered may begin.
STARTS = 40
#: Where there are so many packets up to this size, longer ones, which cost more, are left out.
SHORT, FEWEST = 128, 12
#: Longer rows are not looked at.
LONGEST = 1024
#: What spreads a byte over a number of 64 bits: 2^64 by the golden ratio, odd (Knuth, TAOCP 3, 6.4), and half its bits.
_MIX, _HALF = np.uint64(0x9E37_79B9_7F4A_7C15), np.uint64(32)


@dataclass(frozen=True)
class CheckGuess:
    """A check, where it is and what says so.

    `offset` is that of its first byte, below 0 from the end of rows of several lengths; `size` its bytes. `check` computes
    it, with `over` (None: all other bytes of the row); `covers` are the runs of row bytes, end excluded, below 0 from the
    end, `prefix` the number of the prefix's last bytes that are covered too.
    """

    offset: int
    size: int
    check: Check
    declared: str
    covers: tuple[tuple[int, int | None], ...]
    prefix: int
    #: Different rows that agree, of how many.
    agreeing: int
    rows: int
    #: Bits of evidence, less those that all trials together may give by chance.
    bits: float

    @property
    def confidence(self) -> float:
        """Between 0 and 1: the share of rows that agree, less what chance could do."""
        return float(self.agreeing / self.rows * (1 - 2.0 ** -max(self.bits, 0.0)))

    @property
    def evidence(self) -> str:
        """In words: what fits, over what, in how many rows."""
        runs = " and ".join(_span(*run) for run in self.covers) or "no byte"
        lead = f"the identifier's last {_bytes(self.prefix)} and " if self.prefix else ""
        return (
            f"{self.check.describe}{_order(self.check)} of {lead}{runs}: {self.agreeing} of {self.rows} different rows,"
            f" chance below 1e-{min(int((self.bits) * 0.30103), 99)}"
        )

    def declare(self, field: str = "") -> str:
        """Return the check as a spec writes it, in `field` of the message when one is given."""
        return self.declared if not field else f"{self.declared[:-1]}{_comma(self.declared)}field={field!r})"


def _span(start: int, stop: int | None) -> str:
    """Return a run of bytes in words."""
    if stop is None:
        return f"bytes {start} to the end"
    return f"byte {start}" if stop == start + 1 else f"bytes {start} to {stop - 1}"


def _bytes(count: int) -> str:
    return "byte" if count == 1 else f"{count} bytes"


def _order(check: Check) -> str:
    return f", {check.order} endian" if check.bytes > 1 and check.kind != "fletcher" else ""


def _comma(declared: str) -> str:
    return "" if declared.endswith("()") else ", "


# ---------------------------------------------------------------------- what may be asked


def checks_of(rows: Array, prefix: bytes | Array = b"", *, least_share: float = SHARE) -> list[CheckGuess]:
    """Return the checks in rows of one length, uint8 (N, L); none is listed twice, and none that chance could give.

    `prefix` is the identifier, highest byte first, that a check may cover too: for all rows, or uint8 (N, P).
    """
    data = np.ascontiguousarray(rows, np.uint8)
    if data.ndim != 2 or not data.shape[1] or len(data) < 4:
        return []
    lead = np.frombuffer(prefix, np.uint8) if isinstance(prefix, bytes) else np.asarray(prefix, np.uint8)
    leads: Array = np.broadcast_to(
        lead.reshape(-1, lead.shape[-1]) if lead.size else lead.reshape(1, 0),
        (len(data), lead.shape[-1] if lead.size else 0),
    )
    return _Search(
        data, np.full(len(data), data.shape[1]), leads, from_end=False, least_share=least_share
    ).guesses()


def checks_of_packets(
    packets: Iterable[bytes], *, least_share: float = SHARE, in_front: bool = False
) -> list[CheckGuess]:
    """Return the checks of packets of any lengths, at the same place from their end, over the bytes from the same
    start on; with `in_front` those at the same place from their start, over all that is behind.
    """
    known = [packet for packet in dict.fromkeys(packets) if 2 <= len(packet) <= LONGEST]
    # The few shortest ones would bound where what is covered may begin, and may be no packets at all.
    least = sorted(map(len, known))[len(known) // 16] if known else 0
    known = [packet for packet in known if len(packet) >= least]
    short = [packet for packet in known if len(packet) <= SHORT]
    some = _spread(short if len(short) >= FEWEST else known, ROWS)
    if len(some) < 4:
        return []
    lengths = np.array([len(packet) for packet in some])
    data = np.zeros((len(some), int(lengths.max())), np.uint8)
    for row, packet in zip(data, some, strict=True):
        row[: len(packet)] = np.frombuffer(packet, np.uint8)
    lead = np.zeros((len(some), 0), np.uint8)
    found = _Search(data, lengths, lead, from_end=not in_front, least_share=least_share).guesses()
    return [check for check in found if not in_front or 0 <= check.offset == check.covers[0][0] - check.size]


def _different(lengths: Array, *parts: Array) -> Array:
    """Return the first row of each content, in order; int64. Rows are compared by a number of 64 bits made of all bytes."""
    mixed = lengths.astype(np.uint64)
    for part in parts:
        for column in part.T:
            mixed = (mixed ^ mixed >> _HALF) * _MIX + column
    return np.sort(np.unique(mixed, return_index=True)[1])


def _spread(items: Sequence[Any], most: int) -> list[Any]:
    """Return at most so many, evenly over all."""
    if len(items) <= most:
        return list(items)
    return [items[index] for index in np.linspace(0, len(items) - 1, most).astype(int).tolist()]


# ---------------------------------------------------------------------- the search


class _Covering(NamedTuple):
    """What a check at one place may cover: bytes up to `end` of each row, read from there backwards."""

    #: (N, M) bytes, the last first, 0 beyond; and how many there are in each row.
    back: Array
    ends: Array
    #: Whether what is behind the check is covered as well.
    is_all: bool

    def covered(self, start: int) -> Array:
        """Return the bytes from the `start`-th on, the last first, 0 beyond."""
        index = np.arange(self.back.shape[1])
        return np.where(index < (self.ends - start)[:, None], self.back, 0)


class _Place(NamedTuple):
    """Bytes that may be a check: their offset, the first one's place in each row, and what they are, uint8 (N, size)."""

    offset: int
    size: int
    at: Array
    own: Array


class _Fit(NamedTuple):
    """What a check of a place is: its class and arguments, constant bytes that are covered as well, and what says so."""

    kind: str
    arguments: dict[str, Any]
    constant: bytes
    start: int
    agreeing: int
    bits: float


class _Found(NamedTuple):
    guess: CheckGuess
    #: The bytes of the row that take part, for kinds in which any of them could be the check.
    relation: frozenset[int] | None
    rank: tuple[float, ...]


class _Search:
    """Rows of one or several lengths, and what is tried on them."""

    def __init__(
        self, data: Array, lengths: Array, lead: Array, *, from_end: bool, least_share: float
    ) -> None:
        which = np.array(_spread(_different(lengths, lead, data).tolist(), ROWS))
        self.data, self.lengths, self.lead = data[which], lengths[which], lead[which]
        self.from_end, self.least_share = from_end, least_share
        self.count = len(which)
        self.least = int(self.lengths.min())
        self.is_even = bool((self.lengths == self.least).all())
        self.tried = 0
        #: Rows that trials see first, and pairs of rows of one length, where there are enough.
        self.few = np.array(_spread(range(self.count), FIRST))
        by_length = np.argsort(self.lengths, kind="stable")
        even = np.flatnonzero(np.diff(self.lengths[by_length]) == 0)
        some = np.array(_spread(even.tolist(), PAIRS), np.intp) if len(even) >= PAIRS // 2 else even[:0]
        self.pairs = by_length[some], by_length[some + 1]
        self.all = np.concatenate([self.lead, self.data], axis=1)

    def guesses(self) -> list[CheckGuess]:
        """Return what fits beyond chance, the most certain of what overlaps, in the order of places."""
        if self.count < 4 or self.least < 2:
            return []
        found = [check for size in (1, 2, 3, 4) if size < self.least for check in self._of_size(size)]
        by_chance = log2(max(self.tried, 1))
        kept: list[_Found] = []
        for check in sorted(found, key=lambda check: check.rank, reverse=True):
            if check.guess.bits >= by_chance + CHANCE_BITS and not any(_same(check, other) for other in kept):
                kept.append(check)
        kept.sort(key=lambda check: check.guess.offset)
        return [replace(check.guess, bits=check.guess.bits - by_chance) for check in kept]

    # ------------------------------------------------------------------ places

    def _offsets(self, size: int) -> Iterator[int]:
        """Yield where a check may begin: from the end where rows differ in length."""
        last = self.least - size
        if self.from_end:
            yield from (-size - behind for behind in range(min(EDGE, last)))
        elif self.least <= 2 * EDGE:
            yield from range(last, -1, -1)
        else:
            yield from (*range(last, last - EDGE, -1), *range(EDGE))

    def _of_size(self, size: int) -> Iterator[_Found]:
        for offset in self._offsets(size):
            at = self.lengths + offset if offset < 0 else np.full(self.count, offset)
            own = np.stack([self.data[np.arange(self.count), at + n] for n in range(size)], axis=1)
            if any(len(np.unique(column)) < 3 for column in own.T):
                continue
            place = _Place(offset, size, at, own)
            for covering in self._coverings(place):
                if covering.ends.min() < 1:
                    continue
                starts = np.arange(min(int(covering.ends.min()), STARTS))
                for fit in (*self._sums(place, covering, starts), *self._crcs(place, covering, starts)):
                    yield self._made(place, covering, fit)

    def _coverings(self, place: _Place) -> Iterator[_Covering]:
        lead = self.lead.shape[1]
        before, everything = lead + place.at, lead + self.lengths - place.size
        yield self._covering(place, before, is_all=False)
        if (everything != before).any():
            yield self._covering(place, everything, is_all=True)

    def _covering(self, place: _Place, ends: Array, *, is_all: bool) -> _Covering:
        """Return bytes of prefix and row without the check, up to `ends`, the last first."""
        index = ends[:, None] - 1 - np.arange(int(ends.max()))
        behind = index >= (self.lead.shape[1] + place.at)[:, None]
        source = np.clip(index + np.where(behind, place.size, 0), 0, self.all.shape[1] - 1)
        back = np.take_along_axis(self.all, source, axis=1)
        back[index < 0] = 0
        return _Covering(back, ends, is_all)

    # ------------------------------------------------------------------ sums, exclusive or, Fletcher pairs

    def _sums(self, place: _Place, covering: _Covering, starts: Array) -> Iterator[_Fit]:
        if place.size > 2:
            return
        pick = covering.ends[:, None] - 1 - starts
        rows = np.arange(self.count)[:, None]
        total = np.cumsum(covering.back, axis=1, dtype=np.int64)[rows, pick]
        mask = (1 << 8 * place.size) - 1
        for order in _orders(place.size):
            stored = stored_numbers(place.own, order)[:, None]
            yield from self._rest("sum", order, stored - total & mask, place, covering, starts)
            yield from self._rest("negated", order, stored + total & mask, place, covering, starts)
        if place.size == 1:
            folded = np.bitwise_xor.accumulate(covering.back, axis=1)[rows, pick]
            yield from self._rest("xor", "little", folded ^ place.own, place, covering, starts)
        else:
            # The byte j places before the end is added j + 1 times.
            weights = np.arange(1, covering.back.shape[1] + 1)
            twice = np.cumsum(covering.back * weights, axis=1, dtype=np.int64)[rows, pick]
            rest = (total & 0xFF | (twice & 0xFF) << 8) ^ stored_numbers(place.own, "little")[:, None]
            yield from self._rest("fletcher", "little", rest, place, covering, starts)

    def _rest(
        self, kind: str, order: Order, rest: Array, place: _Place, covering: _Covering, starts: Array
    ) -> Iterator[_Fit]:
        """Return ranges in which nearly all rows leave one rest."""
        self.tried += len(starts)
        few = rest[self.few]
        if max(
            int((few == few[example]).sum(axis=0).max()) for example in (0, len(few) // 2, -1)
        ) < TRIAL * len(few):
            return
        for start, column in zip(starts.tolist(), rest.T, strict=True):
            values, counts = np.unique(column, return_counts=True)
            best = int(np.argmax(counts))
            constant, agreeing = int(values[best]), int(counts[best])
            made = _sum_of(kind, order, place.size, constant)
            if agreeing < self.least_share * self.count or made is None:
                continue
            good = column == constant
            bits = sum_bits(kind, place.own[good], covering.covered(start)[good])
            yield _Fit(*made, start, agreeing, bits)

    # ------------------------------------------------------------------ CRCs

    def _crcs(self, place: _Place, covering: _Covering, starts: Array) -> Iterator[_Fit]:
        families = crc_families(place.size)
        length = covering.back.shape[1]
        later, base = self.pairs
        which = later if len(later) else self.few
        probe = covering.back[later] ^ covering.back[base] if len(later) else covering.back[which]
        pick = covering.ends[which][:, None] - 1 - starts
        # Behind what is covered there may be constant bytes that are not sent: the data id of AUTOSAR's profiles 2 and 5.
        for gap in (0, place.size) if place.size <= 2 and not self.from_end else (0,):
            self.tried += len(families) * len(starts) * len(_orders(place.size))
            tables = stacked_tables(place.size, 1 << (length + gap - 1).bit_length())
            linear = np.bitwise_xor.accumulate(tables[:, np.arange(length) + gap, probe], axis=2)
            linear = linear[:, np.arange(len(which))[:, None], pick]
            for order in _orders(place.size):
                stored = stored_numbers(place.own, order).astype(np.uint32)
                if len(later):
                    target = stored[later] ^ stored[base]
                    agree = (linear == target[None, :, None]).sum(axis=1) >= TRIAL * len(later)
                    some = np.argwhere(agree).tolist()
                else:
                    some = _by_model(families, linear ^ stored[which][None, :, None], pick + 1 + gap)
                for number, column in some:
                    fit = self._constants(
                        families[number], gap, order, stored, place, covering, int(starts[column])
                    )
                    if fit is not None:
                        yield fit

    def _constants(
        self,
        family: CrcFamily,
        gap: int,
        order: Order,
        stored: Array,
        place: _Place,
        covering: _Covering,
        start: int,
    ) -> _Fit | None:
        """Return the constants of a CRC whose linear part fits: of the catalogue, or whatever is left."""
        covered = covering.covered(start)
        distance = np.arange(covered.shape[1]) + gap
        parts = family.tables(covered.shape[1] + gap)[distance, covered]
        rest = np.bitwise_xor.reduce(parts, axis=1) ^ stored
        counts = covering.ends - start + gap
        unnamed = [CrcModel("", init, 0) for init in ((0,) if self.is_even else (0, (1 << family.width) - 1))]
        best: _Fit | None = None
        for model in (*family.models, *([] if gap else unnamed)):
            left = rest ^ family.constants(model.init, int(counts.max()))[counts] ^ np.uint32(model.xorout)
            values, numbers = np.unique(left, return_counts=True)
            common = int(np.argmax(numbers))
            constant, agreeing = int(values[common]), int(numbers[common])
            behind = bytes_giving(family, gap, constant) if gap and constant else b""
            if behind is None or (model.name and bool(constant) != bool(gap)):
                continue
            if agreeing < self.least_share * self.count or (best is not None and agreeing <= best.agreeing):
                continue
            arguments = family.arguments(model, constant)
            if place.size > 1:
                arguments["order"] = order
            good = covered[left == constant]
            bits = float(family.width * independent_rows(good))
            best = _Fit("Crc", arguments, behind, start, agreeing, bits)
        return best

    # ------------------------------------------------------------------ what is declared

    def _made(self, place: _Place, covering: _Covering, fit: _Fit) -> _Found:
        lead = self.lead.shape[1]
        prefix = max(0, lead - fit.start)
        covers = self._runs(max(0, fit.start - lead), place, covering.is_all)
        over: list[Covered] = [IdBytes(prefix)] if prefix else []
        over += [slice(*run) for run in covers]
        if fit.constant:
            over.insert(len(over) if fit.kind == "Crc" else 0, fit.constant)
        arguments = dict(fit.arguments)
        if self.from_end or prefix or fit.constant or covers != self._runs(0, place, True):
            arguments["over"] = over
        check: Check = _CLASSES[fit.kind](**arguments)
        declared = check_source(check)
        guess = CheckGuess(
            place.offset, place.size, check, declared, covers, prefix, fit.agreeing, self.count, fit.bits
        )
        places = [n for low, high in covers for n in range(self.least)[low:high]]
        relation: frozenset[int] | None = None
        if fit.kind in ("Xor", "InvertedSum") or "negated" in fit.arguments:
            relation = frozenset(n for n in places if (self.data[:, n] != self.data[0, n]).any())
            relation |= set(range(self.least)[place.offset : place.offset + place.size or None])
        is_named = not fit.constant and "poly" not in fit.arguments
        rank = (
            fit.agreeing,
            place.size,
            is_named,
            prefix == 0,
            len(places) - prefix,
            # Of bytes that all make a sum zero, the last one of a packet is the check.
            place.offset if self.from_end else 0,
            round(entropy_bits(place.own[:, 0])),
            place.offset,
        )
        return _Found(guess, relation, rank)

    def _runs(self, start: int, place: _Place, is_all: bool) -> tuple[tuple[int, int | None], ...]:
        """Return the runs of row bytes that a check covers from the `start`-th byte that is not its own."""
        behind = place.offset + place.size
        if self.from_end:
            return (start, place.offset), *([(behind, None)] if is_all and behind else [])
        runs: list[tuple[int, int | None]] = [(start, place.offset)] if start < place.offset else []
        if is_all and max(start + place.size, behind) < self.least:
            runs.append((max(start + place.size, behind), self.least if self.is_even else None))
        return tuple(runs)


_CLASSES: dict[str, Any] = {
    "Sum": Sum,
    "InvertedSum": lambda size=1, **more: Sum(size, inverted=True, **more),
    "Xor": Xor,
    "Fletcher": Fletcher,
    "Crc": Crc,
}


def check_source(check: Check) -> str:
    """Return a sum, exclusive or, Fletcher pair or CRC as a spec writes it."""
    name, shown = type(check).__name__, list[str]()
    if isinstance(check, Crc):
        width, poly, init, refin, refout, xorout = check.parameters
        numbers = f"width={width}, poly={poly:#x}, init={init:#x}, refin={refin}, refout={refout}, xorout={xorout:#x}"
        shown.append(numbers if " " in check.name else f'"{check.name}"')
    elif isinstance(check, Sum):
        name = "InvertedSum" if check.inverted else name
        shown += [str(check.bytes)] * (check.bytes > 1) + ["negated=True"] * check.negated
    if check.field is not None:
        shown.append(f"field={check.field!r}")
    if check.text is not None:
        shown.append(f"text={check.text!r}")
    elif check.field is None and check.bytes > 1 and check.kind != "fletcher":
        shown.append(f'order="{check.order}"')
    if check.over is not None:
        items = ", ".join(map(_over_text, check.over))
        shown.append(f"over={items}" if len(check.over) == 1 else f"over=[{items}]")
    return f"{name}({', '.join(shown)})"


def _over_text(part: Covered) -> str:
    if isinstance(part, IdBytes):
        return f"IdBytes({part.size})"
    if isinstance(part, DataIds):
        return f'DataIds("{part.field}", bytes.fromhex("{part.ids.hex(" ").upper()}"))'
    return (
        repr(part)
        if isinstance(part, bytes)
        else f"slice({part.start}, {part.stop})"
        if isinstance(part, slice)
        else ""
    )


def _same(one: _Found, other: _Found) -> bool:
    """Return whether two guesses are of one check: their bytes overlap, or any byte of the relation could be the check."""
    first, second = one.guess, other.guess
    if (first.offset < 0) == (second.offset < 0):
        if first.offset < second.offset + second.size and second.offset < first.offset + first.size:
            return True
    return one.relation is not None and one.relation == other.relation


def _orders(size: int) -> tuple[Order, ...]:
    return ("little", "big") if size > 1 else ("little",)


def _sum_of(
    kind: str, order: Order, size: int, constant: int
) -> tuple[str, dict[str, PlainValue], bytes] | None:
    """Return (class, its arguments, constant bytes that are covered as well) of a sum that leaves a constant;
    None: no class.
    """
    if kind == "fletcher":
        return None if constant else ("Fletcher", {}, b"")
    if kind == "xor":
        return "Xor", {}, bytes([constant]) if constant else b""
    top = (1 << 8 * size) - 1
    wide: dict[str, PlainValue] = {"size": size, "order": order} if size > 1 else {}
    if kind == "negated" and constant == top:
        return "InvertedSum", wide, b""
    short = -constant & top if kind == "negated" else constant
    if short > 255:
        return None
    return "Sum", {**wide, "negated": True} if kind == "negated" else wide, bytes([short]) if short else b""


def _by_model(families: Sequence[CrcFamily], rest: Array, counts: Array) -> list[list[int]]:
    """Return where there are no two rows of a length: families of which a model's constants explain most rows."""
    found: list[list[int]] = []
    for number, family in enumerate(families):
        agree = np.zeros(rest.shape[2], bool)
        for model in family.models:
            wanted = family.constants(model.init, int(counts.max()))[counts] ^ np.uint32(model.xorout)
            agree |= (rest[number] == wanted).sum(axis=0) >= TRIAL * len(rest[number])
        found += [[number, column] for column in np.flatnonzero(agree).tolist()]
    return found
