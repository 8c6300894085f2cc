"""The fields of one message, out of its payloads: where they begin and end, in which byte order, and what they are.

1. Every bit of the payload is in exactly one guess. What never changes is a constant, however likely something else is.
2. Whatever is costly looks at `SAMPLE` rows, in runs of neighbours; whether a bit ever changes, at all rows.
3. A bit is named as plans name it: 8 × byte + bit, bit 0 being the least significant of its byte.

What is plain comes first, because it explains bits that would confuse the rest: text, counters, floats. What is left
over is split where neighbouring bits do not belong together (`boundaries`), and each piece is called by what its values do.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

from aces_bus._lazy import np
from aces_bus.protocol.record import PlainValue

if TYPE_CHECKING:
    import numpy.typing as npt

    from .checks import CheckGuess

Array: TypeAlias = "npt.NDArray[Any]"
ByteOrder = Literal["little", "big"]
FieldKind = Literal[
    "constant",
    "counter",
    "flag",
    "enumeration",
    "number",
    "text",
    "float",
    "check",
    "multiplexer",
    "quantity",
]

#: Rows that are looked at closely, and the runs of neighbours that they are taken in.
SAMPLE, RUNS = 2048, 4
#: With fewer steps from row to row nothing is known but which bytes change.
STEPS = 8
#: Payloads beyond are bytes: no frame is as long, and the work would grow.
LONGEST = 1024


@dataclass(frozen=True)
class Measured:
    """What a measured quantity says of a field: its name and unit, and value = raw × scale + offset."""

    name: str
    unit: str
    scale: float
    offset: float


@dataclass(frozen=True)
class FieldGuess:
    """Bits that belong together.

    `start` is the number of the lowest bit of the field (8 × byte + bit), `length` its bits. `order` says where the bits
    above those of a byte go on: in the byte behind it ("little") or before it ("big"). `confidence` is from 0 to 1, an
    opinion and no probability; `evidence` says in words what it rests on.
    """

    start: int
    length: int
    order: ByteOrder
    kind: FieldKind
    confidence: float
    evidence: str
    signed: bool = False
    #: Of a constant its value, of a counter its step.
    value: int | None = None
    #: The values that occurred, where they are few.
    values: tuple[int, ...] = ()
    #: Of a check what it is, and over which bytes.
    check: CheckGuess | None = None
    #: Of a counter where it begins anew: from that number on; 0 where that was not seen.
    modulus: int = 0
    #: The multiplexer's name and its values at which the field is there; none: always.
    selector: str = ""
    when: tuple[int, ...] = ()
    #: Of a quantity what a reference says of it.
    measured: Measured | None = None

    @property
    def positions(self) -> tuple[int, ...]:
        """The numbers of its bits, lowest first."""
        return positions_of(self.start, self.length, self.order)

    @property
    def is_aligned(self) -> bool:
        """True if the field consists of whole bytes."""
        return not self.start % 8 and not self.length % 8

    @property
    def first_byte(self) -> int:
        """The first byte of the payload that it is in."""
        return min(self.positions[0], self.positions[-1]) // 8

    def as_dict(self) -> dict[str, PlainValue]:
        """Return the guess in JSON's kinds."""
        found: dict[str, PlainValue] = {
            "start": self.start,
            "length": self.length,
            "order": self.order,
            "signed": self.signed,
            "kind": self.kind,
            "confidence": round(self.confidence, 2),
            "evidence": self.evidence,
        }
        if self.value is not None:
            found["value"] = self.value
        if self.modulus:
            found["modulus"] = self.modulus
        if self.check is not None:
            found["check"] = self.check.declared
        if self.measured is not None:
            found |= asdict(self.measured)
        for name in ("values", "when"):
            if getattr(self, name):
                found[name] = list(getattr(self, name))
        return found


def positions_of(start: int, length: int, order: ByteOrder) -> tuple[int, ...]:
    """Return the numbers of the bits of a number, lowest first.

    >>> positions_of(12, 8, "little"), positions_of(12, 8, "big")
    ((12, 13, 14, 15, 16, 17, 18, 19), (12, 13, 14, 15, 0, 1, 2, 3))
    """
    found = [start]
    while len(found) < length:
        found.append(above(found[-1], order))
    return tuple(found)


def above(bit: int, order: ByteOrder) -> int:
    """Return the bit above a bit of a number: in the same byte, or the lowest of the next one in that order."""
    return bit - 15 if order == "big" and bit % 8 == 7 else bit + 1


class Rows:
    """A sample of `of` payloads of a message at most: its bits, and which rows follow each other."""

    def __init__(self, rows: Array, of: int = SAMPLE) -> None:
        count, self.size = rows.shape
        self.total = count
        flat = rows if count else np.zeros((1, self.size), np.uint8)
        changes = np.bitwise_or.reduce(flat, axis=0) ^ np.bitwise_and.reduce(flat, axis=0)
        #: Which bits ever change; (8 × size,)
        self.varies = np.unpackbits(changes.astype(np.uint8), bitorder="little").astype(bool)
        self.follows = np.ones(max(0, count - 1), bool)
        if count > of:
            each = of // RUNS
            starts = np.linspace(0, count - each, RUNS).astype(np.int64)
            places = np.unique((starts[:, None] + np.arange(each)).ravel())
            self.follows = np.diff(places) == 1
            rows = rows[places]
        #: (n, size) and (n, 8 × size), uint8.
        self.bytes = np.ascontiguousarray(rows)
        self.bits = np.unpackbits(self.bytes, axis=1, bitorder="little")
        flips = (self.bits[1:] ^ self.bits[:-1])[self.follows]
        self.steps = len(flips)
        #: The share of steps in which a bit changes; (8 × size,)
        self.rates = flips.mean(axis=0) if len(flips) else np.zeros(8 * self.size)

    def values(self, positions: Sequence[int]) -> Array:
        """Return the unsigned numbers at these bits, lowest first; uint64, of 64 bits at most."""
        out = np.zeros(len(self.bits), np.uint64)
        for to, at in enumerate(positions[:64]):
            out |= self.bits[:, at].astype(np.uint64) << np.uint64(to)
        return out

    def pairs(self, values: Array) -> tuple[Array, Array]:
        """Return (before, after) of values of rows that follow each other."""
        return values[:-1][self.follows], values[1:][self.follows]


def fields_of(
    rows: Array, times_ns: Array | None = None, prefix: bytes | Array = b"", given: Sequence[FieldGuess] = ()
) -> list[FieldGuess]:
    """Return what the bytes of a message are, by their first bytes.

    `rows` is uint8 of shape (n, size), the payloads in the order in which they came; `times_ns` int64 of shape (n,), or
    None where the recording does not say. `prefix` are bytes before the payload that a check may cover too, for all rows or
    uint8 of shape (n, bytes): an identifier, highest byte first. Payloads are cut at `LONGEST` bytes. Fields that are
    `given` are among the result, and no other has bits of theirs.
    """
    from .kinds import plain_fields
    from .multiplex import selector_of

    rows = rows[:, :LONGEST]
    if not rows.size:
        return []
    sample = Rows(rows)
    taken = {bit for field in given for bit in field.positions}
    plain = [field for field in plain_fields(sample, rows, prefix) if taken.isdisjoint(field.positions)]
    plain += given
    free = np.ones(8 * sample.size, bool)
    selector = selector_of(sample, plain)
    if selector is not None:
        plain = [*(field for field in plain if field.start != selector.start), selector]
    for field in plain:
        free[list(field.positions)] = False
    found = list(plain)
    if selector is not None:
        found += _selected(rows, selector, free)
        for field in found:
            free[list(field.positions)] = False
    return filled(sample, found + _split(rows, sample, free), np.ones(8 * sample.size, bool))


def _split(rows: Array, sample: Rows, free: Array) -> list[FieldGuess]:
    """Return the fields of what is left; `sample` is of `rows`."""
    from .boundaries import merged_pieces, split, whole_bytes
    from .kinds import classified, with_all_values

    changing = free & sample.varies
    pieces = (
        merged_pieces(sample, split(sample, changing), free)
        if sample.steps >= STEPS
        else whole_bytes(changing)
    )
    return [with_all_values(classified(sample, piece), rows) for piece in pieces]


def _selected(rows: Array, selector: FieldGuess, free: Array) -> list[FieldGuess]:
    """Return the fields that are there at one value of the multiplexer each; those that are there at all of them, once."""
    from .kinds import plain_fields

    values = Rows(rows, of=len(rows)).values(selector.positions)
    found: list[list[FieldGuess]] = []
    for value in selector.values:
        some = rows[values == value]
        sample = Rows(some)
        own = free.copy()
        plain = [field for field in plain_fields(sample, None, b"") if free[list(field.positions)].all()]
        for field in plain:
            own[list(field.positions)] = False
        fields = filled(sample, [*plain, *_split(some, sample, own)], free)
        found.append([field for field in fields if field.kind != "constant"])
    places = [{field.positions for field in some} for some in found]
    common = set.intersection(*places)
    if common and all(place == common for place in places):
        return []
    return [
        replace(field, when=(value,), selector=f"{selector.kind}_{selector.first_byte}")
        for value, some in zip(selector.values, found, strict=True)
        for field in some
    ]


def filled(sample: Rows, found: Iterable[FieldGuess], free: Array) -> list[FieldGuess]:
    """Return the guesses, widened by zeros that fill their bytes, and constants for all bits of `free` that are left."""
    found = list(found)
    free = free.copy()
    for field in found:
        free[list(field.positions)] = False
    constant = free & ~sample.varies
    widened = [
        _widened(field, constant, sample.bits[0]) if field.kind == "number" else field for field in found
    ]
    for field in widened:
        free[list(field.positions)] = False
    widened += _constants(sample, free & ~sample.varies)
    return sorted(widened, key=lambda field: (field.first_byte, min(field.positions)))


def _widened(field: FieldGuess, free: Array, values: Array) -> FieldGuess:
    """Return a number with the bits around it, in its bytes, that never change: zeros, or a single bit that fills the
    byte.
    """
    start, length = field.start, field.length
    if length < 4:
        return field
    while start % 8 and free[start - 1] and not values[start - 1]:
        start, length = start - 1, length + 1
        free[start] = False
    top = positions_of(start, length, field.order)[-1]
    while top % 8 != 7 and free[top + 1] and not field.signed and (not values[top + 1] or top % 8 == 6):
        top, length = top + 1, length + 1
        free[top] = False
    return replace(field, start=start, length=length)


def _constants(sample: Rows, free: Array) -> list[FieldGuess]:
    """Return runs of bits that never change: whole bytes together, other bits byte by byte."""
    found: list[FieldGuess] = []
    bit = 0
    while bit < len(free):
        if not free[bit]:
            bit += 1
            continue
        end = bit + 1
        while (
            end < len(free)
            and free[end]
            and (end % 8 or (not bit % 8 and free[end : end + 8].all() and end - bit < 64))
        ):
            end += 1
        value = int(sample.values(range(bit, end))[0])
        shown = (
            f"always {value.to_bytes((end - bit) // 8, 'little').hex(' ').upper()}"
            if not (end - bit) % 8
            else f"always {value}"
        )
        confidence = sample.total / (sample.total + 4)
        found.append(
            FieldGuess(
                bit,
                end - bit,
                "little",
                "constant",
                confidence,
                f"{shown} in {sample.total} message{'s' if sample.total > 1 else ''}",
                value=value,
            )
        )
        bit = end
    return found
