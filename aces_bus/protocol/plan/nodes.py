"""The plan: a message with every decision taken, from which everything else is printed.

1. A plan is frozen data: no construct, no expression, no callable in it.
2. Positions are canonical bit numbers (8 × byte + bit, bit 0 least significant) from the first byte of the data (CAN) or
   of the packet (streams), lowest bit of the number first. Byte order exists only in that list.
3. What does not flatten is marked `Opaque` with the reason; construct decodes it, slower and equally.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class Scale:
    """physical = raw × scale + offset; raw values in `unknown` are None, those in `names` their name.

    `bounds` (physical) and `raw_bounds` are what may be sent; `rounding` is how a physical value becomes an integer.
    """

    scale: float
    offset: float
    unknown: tuple[float, ...] = ()
    bounds: tuple[float, float] | None = None
    raw_bounds: tuple[int, int] | None = None
    rounding: str = "nearest"
    #: (raw, name) of raw values that are no quantity.
    names: tuple[tuple[int, str], ...] = ()


@dataclass(frozen=True)
class ValueNames:
    """Raw number to name."""

    values: tuple[tuple[int, str], ...]


@dataclass(frozen=True)
class FlagBits:
    """Flag name to bit number."""

    bits: tuple[tuple[str, int], ...]


@dataclass(frozen=True)
class Magnitude:
    """Sign and magnitude of `width` bits: part of the raw value, not of its meaning."""

    width: int


Step = Scale | ValueNames | FlagBits | Magnitude


@dataclass(frozen=True)
class Scalar:
    """One value in the bytes.

    `kind` is "uint", "int" (two's complement), "float", "bytes" or "text". `size` is in bytes, None for "to the end".
    `bits` is empty for everything but integers, and floats that are not whole bytes in one order: then the number has
    `len(bits)` bits, and `offset` and `size` are those of its layout. `steps` go from the wire to the record.
    """

    kind: Literal["uint", "int", "float", "bytes", "text"]
    offset: int
    size: int | None
    order: Literal["little", "big"] = "little"
    bits: tuple[int, ...] = ()
    steps: tuple[Step, ...] = ()
    unit: str = ""

    @property
    def is_whole(self) -> bool:
        """Whether an integer is whole bytes in one byte order."""
        assert self.size is not None
        run = tuple(range(8 * self.offset, 8 * (self.offset + self.size)))
        if self.bits == run:
            return self.order == "little" or self.size == 1
        return self.order == "big" and self.bits == big_endian_bits(self.offset, self.size)


def big_endian_bits(offset: int, size: int) -> tuple[int, ...]:
    """Canonical bit numbers of a big-endian number of `size` bytes, lowest bit first."""
    return tuple(
        p for byte in range(offset + size - 1, offset - 1, -1) for p in range(8 * byte, 8 * byte + 8)
    )


@dataclass(frozen=True)
class Many:
    """Several nodes under one name: a tuple."""

    items: tuple[Node, ...]


@dataclass(frozen=True)
class NestedRecord:
    """A nested record."""

    type_name: str
    fields: tuple[PlanField, ...]


@dataclass(frozen=True)
class FromIdentifier:
    """A captured part of the CAN identifier, or of a head number.

    Alone in it: (number − constant) >> shift; beside others: `width` bits from `shift`. For an identifier `constant`
    includes the flag bits of `aces_bus.protocol.keys`, so that it is taken off a key directly.
    """

    constant: int
    shift: int
    width: int
    is_alone: bool
    steps: tuple[Step, ...] = ()
    unit: str = ""
    #: The number it is part of: None for the identifier.
    number: Scalar | None = None


@dataclass(frozen=True)
class FromRequest:
    """A field of the request that this message answers, as raw number."""


@dataclass(frozen=True)
class Selector:
    """A number that says whether other fields are there. What it is is which number of the packet, and under what
    condition that one is there itself; `name` is for people: two selectors of one name are two.
    """

    name: str
    number: Scalar
    when: When | None = None


@dataclass(frozen=True)
class When:
    """The raw values of a selector that make a field present, where the selector is."""

    selector: Selector
    values: tuple[int, ...]


@dataclass(frozen=True)
class Rest:
    """The bits of `size` bytes from `offset` that no field claims; `claimed` as masks of the little-endian word by the
    selector's raw value (None: any other).

    Where selectors are several, or multiplexed themselves, `claimed` is what is always claimed, and `more` has for each
    selector the masks that its raw values add; other values, and a selector that is not there, add nothing.
    """

    offset: int
    size: int
    claimed: tuple[tuple[int | None, int], ...]
    selector: Selector | None = None
    more: tuple[tuple[Selector, tuple[tuple[int, int], ...]], ...] = ()


@dataclass(frozen=True)
class DelimitedField:
    """A field of a delimited payload, by its number; `conversion` names how text becomes a value."""

    index: int
    conversion: Literal["text", "number", "integer", "degrees", "names"]
    form: str
    names: tuple[tuple[str, str], ...] = ()
    unit: str = ""
    optional: bool = False


@dataclass(frozen=True)
class MoreCells:
    """The cells beyond the declared ones, as texts."""

    start: int


@dataclass(frozen=True)
class Opaque:
    """Decoded by construct, for this reason."""

    reason: str


Node = (
    Scalar | Many | NestedRecord | FromIdentifier | FromRequest | Rest | DelimitedField | MoreCells | Opaque
)


@dataclass(frozen=True)
class PlanField:
    """A field of a record, or of the nested record that it is in. `when`: there only then."""

    name: str
    node: Node
    doc: str = ""
    when: When | None = None


@dataclass(frozen=True)
class Constant:
    """Bits that are always the same: (data[offset] & mask) == value."""

    offset: int
    mask: int
    value: int


@dataclass(frozen=True)
class OneOf:
    """A whole number that must be among some values."""

    number: Scalar
    values: tuple[int, ...] | range


@dataclass(frozen=True)
class DelimitedSplit:
    """How a delimited payload comes apart: bytes [start, end) of the packet, end counted from the packet's end."""

    start: int
    end: int
    separator: bytes
    lead: bool
    least: int
    most: int | None


@dataclass(frozen=True)
class MessagePlan:
    """Everything about one message."""

    name: str
    fields: tuple[PlanField, ...]
    constants: tuple[Constant, ...]
    one_of: tuple[OneOf, ...]
    #: Lengths of the data (CAN) or the packet (streams); None: any from `least` up.
    lengths: tuple[int, ...] | None
    least: int
    #: Bytes of sync at the packet's start: the framing has seen them.
    sync: int = 0
    #: The least size that the framing lets through.
    framed: int = 0
    #: Bytes at the packet's end that are not payload (check and end of a framing).
    tail: int = 0
    #: selector → total length, where multiplexed fields make the length.
    lengths_by: tuple[Selector, tuple[tuple[int, int], ...], int] | None = None
    #: What decides about fields, an outer one before an inner one, each once.
    selectors: tuple[Selector, ...] = ()
    split: DelimitedSplit | None = None
    #: Whether the message has a check of its own, inside the payload.
    is_checked: bool = False
    opaque: str = ""
    #: Of an opaque message: (path, field names) of each nested record.
    parts: tuple[tuple[str, tuple[str, ...]], ...] = ()
    doc: str = ""
    place: str = ""

    @property
    def is_flat(self) -> bool:
        return not self.opaque
