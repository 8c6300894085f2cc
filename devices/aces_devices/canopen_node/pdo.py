"""Process data: which objects lie where in a node's PDOs, from its file, from itself, or as we would have it.

1. `canopen` reads mappings from files; here they are places in a number, which is quick: bytes are one little-endian
   integer, an object so many bits of it.
2. PDOs are at their predefined identifiers (PDO n of node i): others belong to no message of the spec, and are refused
   with a word about it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from aces_bus.device import Steps
from aces_bus.errors import DeviceError

from .sdo import SdoRefused

if TYPE_CHECKING:
    from canopen import ObjectDictionary

    from .node import CanopenNode

NOT_VALID = 1 << 31
#: PDOs each way that the predefined connection set has.
MOST = 4
#: First objects of communication and mapping, and identifiers: what the node receives, and what it sends.
RECEIVED, SENT = (0x1400, 0x1600, 0x200), (0x1800, 0x1A00, 0x180)


@dataclass(frozen=True)
class PdoEntry:
    """One object in a PDO: `shift` and `size` in bits."""

    index: int
    subindex: int
    shift: int
    size: int
    is_signed: bool

    def take(self, word: int) -> int:
        """Return the object's value in a PDO's content."""
        value = word >> self.shift & (1 << self.size) - 1
        return value - (1 << self.size) if self.is_signed and value >> self.size - 1 else value

    def put(self, word: int, value: int) -> int:
        """Return the content with another value; values that do not fit stop at the end of the range."""
        low, high = (
            (-(1 << self.size - 1), (1 << self.size - 1) - 1) if self.is_signed else (0, (1 << self.size) - 1)
        )
        mask = (1 << self.size) - 1
        return word & ~(mask << self.shift) | (min(max(value, low), high) & mask) << self.shift


@dataclass
class PdoLayout:
    """One PDO: its number (1…4), the objects in it, its transmission type and event timer (ms)."""

    number: int
    places: list[PdoEntry] = field(default_factory=list[PdoEntry])
    kind: int = 255
    event_ms: int = 0

    @property
    def size(self) -> int:
        """Its length in bytes."""
        return (sum(place.size for place in self.places) + 7) // 8

    @property
    def is_synchronous(self) -> bool:
        """True if the node sends or applies the PDO at SYNC."""
        return self.kind <= 240

    def has(self, index: int) -> bool:
        """Return whether an object, of any axis, is in it."""
        return any(place.index - offset_of(place.index) == index for place in self.places)


def offset_of(index: int) -> int:
    """Return what the axis of an object adds to its index: 0x800 an axis (ros2_canopen)."""
    return (index - 0x6000) & ~0x7FF if index >= 0x6000 else 0


def layout_of(
    who: str,
    dictionary: ObjectDictionary,
    number: int,
    base: int,
    node: int,
    raw: dict[int, int],
    entries: list[int],
) -> PdoLayout | None:
    """Return a PDO from its communication parameters (`raw`: subindex → value) and mapping entries; None: it is
    switched off.

    Raises `DeviceError` for another identifier than the predefined one.
    """
    identifier = raw[1]
    if identifier & NOT_VALID or not entries:
        return None
    predefined = base + 0x100 * (number - 1) + node
    if identifier & 0x1FFFFFFF != predefined:
        raise DeviceError(
            f"{who}: PDO {number} has identifier 0x{identifier & 0x1FFFFFFF:X}, and 0x{predefined:X} is predefined;"
            ' settings pdo = "write" makes it so'
        )
    made = PdoLayout(number, kind=raw.get(2, 255), event_ms=raw.get(5, 0))
    shift = 0
    for entry in entries:
        index, subindex, size = entry >> 16, entry >> 8 & 0xFF, entry & 0xFF
        made.places.append(PdoEntry(index, subindex, shift, size, _is_signed(dictionary, index, subindex)))
        shift += size
    if shift > 64:
        raise DeviceError(f"{who}: the objects of PDO {number} have {shift} bits; a frame has 64")
    return made


def _is_signed(dictionary: ObjectDictionary, index: int, subindex: int) -> bool:
    """Return whether an object is a signed number: as the file says; of objects that it does not have, as CiA 402 does."""
    from canopen.objectdictionary import SIGNED_TYPES

    known = dictionary.get_variable(index, subindex)
    return known.data_type in SIGNED_TYPES if known is not None else index - offset_of(index) in SIGNED


#: Signed objects of CiA 402 that drives map (of axis 0).
SIGNED = frozenset((0x6042, 0x6060, 0x6061, 0x6064, 0x606C, 0x6071, 0x6077, 0x607A, 0x60C1, 0x60FF))


def layouts(
    who: str,
    dictionary: ObjectDictionary,
    node: int,
    side: tuple[int, int, int],
    value: Callable[[int, int], int | None],
) -> dict[int, PdoLayout]:
    """Return the PDOs of `side` (`RECEIVED` or `SENT`) that a device has, by number; `value` is an object's (None: not
    there).
    """
    communication, mapping, base = side
    found: dict[int, PdoLayout] = {}
    for number in range(1, MOST + 1):
        index, objects = communication + number - 1, mapping + number - 1
        if index not in dictionary or objects not in dictionary:
            continue
        raw = {1: base + 0x100 * (number - 1) + node}
        raw |= {sub: known for sub in (1, 2, 5) if (known := value(index, sub)) is not None}
        count = min(value(objects, 0) or 0, 64)
        entries = [value(objects, sub) or 0 for sub in range(1, count + 1)]
        made = layout_of(who, dictionary, number, base, node, raw, [entry for entry in entries if entry])
        if made is not None:
            found[number] = made
    return found


def from_file(
    who: str, dictionary: ObjectDictionary, node: int, side: tuple[int, int, int]
) -> dict[int, PdoLayout]:
    """Return the PDOs that a file says its device has."""

    def value(index: int, subindex: int) -> int | None:
        known = dictionary.get_variable(index, subindex)
        found = None if known is None else known.default if known.value is None else known.value
        return found if isinstance(found, int) else None

    return layouts(who, dictionary, node, side, value)


def _number(device: CanopenNode, index: int, subindex: int) -> Steps:
    data: bytes = yield device.sdo.upload(index, subindex)
    return int.from_bytes(data, "little")


def read_layouts(device: CanopenNode, side: tuple[int, int, int]) -> Steps:
    """Return the PDOs as the node has them."""
    communication, mapping, base = side
    found: dict[int, PdoLayout] = {}
    for number in range(1, MOST + 1):
        index = communication + number - 1
        if index not in device.dictionary:
            continue
        raw: dict[int, int] = {}
        for subindex in (1, 2, 5):
            if subindex == 5 and (side is RECEIVED or raw.get(2, 255) <= 240):
                continue
            try:
                raw[subindex] = yield from _number(device, index, subindex)
            except SdoRefused:
                if subindex == 1:
                    break
        if 1 not in raw or raw[1] & NOT_VALID:
            continue
        count = yield from _number(device, mapping + number - 1, 0)
        entries: list[int] = []
        for subindex in range(1, min(count, 64) + 1):
            entries.append((yield from _number(device, mapping + number - 1, subindex)))
        made = layout_of(
            device.name, device.dictionary, number, base, device.credentials["node"], raw, entries
        )
        if made is not None:
            found[number] = made
    return found
