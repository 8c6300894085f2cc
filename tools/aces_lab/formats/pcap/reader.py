"""What tcpdump and Wireshark write: pcap, and what it shares with pcapng (`pcapng.py`).

1. Every packet is a frame, one of `others` in words, or unreadable with its reason; `lines` counts packets.
2. A captured length above the original one, or above any CAN frame's, is damage: one unreadable object, with its offset.
   Reading goes on where the next headers are in order (`_next_packet`). pcapng has no such place: there the rest is one.
3. A buffer is walked from length to length; the packets found are turned into columns together.

4. Files may be joined: each has its own byte order, unit of time and link type.

*Facts*: draft-ietf-opsawg-pcap. The magic number says byte order and µs or ns. The upper half of the link type's word
says how many check bytes follow, which CAN captures have none of.
"""

from __future__ import annotations

import struct
from abc import abstractmethod
from collections.abc import Iterator

import numpy as np

from aces_bus import FrameTable
from aces_bus.errors import CaptureError
from aces_bus.frame_table import Ints
from aces_bus.recordings.base import CanRecording
from aces_bus.recordings.source import ByteSource

from ..beginnings import PCAP
from .socketcan import (
    ERROR_BIT,
    EXTENDED_BIT,
    FRAME_AT,
    GOOD,
    IS_XL,
    LINK_TYPES,
    PADDING,
    REASONS,
    SOCKETCAN,
    WIDE,
    Packets,
    decode_socketcan,
    gather_rows,
)

#: Longer blocks of pcapng are taken for damage.
MAX_BLOCK = 1 << 24
#: The largest packet is a CAN XL frame with a cooked header: 2,080 bytes; and its header.
_LARGEST, _HEAD = 1 << 12, 16
#: Seconds between packets that are next to each other, at most.
_FAR = 86_400
#: Not a fault: another file begins where a packet might.
_HEADER, _JOINED = 24, "joined"
#: Packet headers in order, one behind the other, that make one believe the first.
_WITNESSES = 3
#: Read at once from a file, so that tables have some ten thousand rows.
_BATCH = 1 << 20
#: So many kinds of other things are named apart.
_KINDS = 64

_LINK_NAMES = {1: " (Ethernet)", 189: " (USB)", 190: " (CAN 2.0B)", 220: " (USB)", 249: " (USB)"}


def link_words(link: int) -> str:
    """Return a link type in words."""
    return f"packets of link type {link}{_LINK_NAMES.get(link, '')}"


class PacketCapture(CanRecording):
    """Objects with a length in front, and CAN frames in some of them."""

    def __init__(self, source: ByteSource) -> None:
        super().__init__(source)
        #: Bytes before the buffer at hand.
        self._before = 0
        self._is_damaged = False
        #: Nothing follows the buffer at hand.
        self._is_final = False

    @abstractmethod
    def _walk(self, buffer: bytes) -> tuple[list[FrameTable], int, int]:
        """Return the tables of whole objects, how many bytes these take, and how many bytes from there the next one
        needs.
        """

    @abstractmethod
    def _end(self, rest: int) -> None:
        """Handle the end of the file, `rest` bytes into an object."""

    def _tables(self) -> Iterator[FrameTable]:
        parts: list[bytes] = []
        size, needed = 0, 1
        batch = 0 if self._source.live else _BATCH
        for block in self._source.blocks():
            parts.append(block)
            size += len(block)
            if size >= needed and size >= batch:
                buffer = b"".join(parts)
                tables, used, needed = self._walk(buffer)
                yield from tables
                if self._is_damaged:
                    self.close()
                    return
                parts, size = [buffer[used:]], size - used
                self._before += used
        buffer = b"".join(parts)
        self._is_final = True
        tables, used, _ = self._walk(buffer)
        yield from tables
        self._before += used
        if used < len(buffer) and not self._is_damaged:
            self._end(len(buffer) - used)
        elif not self._is_damaged:
            self._check_end(self._before)

    def _check_end(self, size: int) -> None:
        """Check the end of the file behind a whole object, at `size` bytes."""

    def _give_up(self, offset: int, reason: str, excerpt: bytes) -> None:
        """Count the rest of the file as one unreadable object."""
        self._is_damaged = True
        self.lines += 1
        where = f"{reason} at offset {self._before + offset}; nothing behind it can be read"
        self._unreadable(self.lines, where, excerpt)

    def _frames(
        self, view: Ints, starts: Ints, sizes: Ints, links: Ints, is_little: bool
    ) -> tuple[Packets, Ints]:
        """Return packets of any link types: their columns and which of them are frames; the others are counted."""
        is_can = np.isin(links, LINK_TYPES)
        if not is_can.all():
            kinds, numbers = np.unique(links[~is_can], return_counts=True)
            for kind, number in zip(kinds.tolist(), numbers.tolist(), strict=True):
                self._other(link_words(kind), number)
        sizes = np.where(is_can, sizes, 0)
        packets = decode_socketcan(view, starts, sizes, np.where(is_can, links, LINK_TYPES[0]), is_little)
        is_good = packets.status == GOOD
        if not is_good.all():
            for row in np.flatnonzero(~is_good & is_can).tolist():
                code = int(packets.status[row])
                if code in REASONS:
                    start, size = int(starts[row]), int(sizes[row])
                    excerpt = view[start : start + min(size, 16)].tobytes().hex()
                    reason = REASONS[code]
                    if code == WIDE:
                        reason += self._hint(view, start, int(links[row]), is_little)
                    self._unreadable(self.lines + row + 1, reason, excerpt.encode())
                elif code == IS_XL:
                    self._other("CAN XL frames")
                else:
                    self._other(f"packets of protocol 0x{int(packets.protocol[row]):04X}")
        self.lines += len(starts)
        self.frames += int(is_good.sum())
        return packets, is_good

    @staticmethod
    def _hint(view: Ints, start: int, link: int, is_little: bool) -> str:
        """Return whether the identifier of an unreadable packet would be one with its bytes in the other order."""
        start += FRAME_AT[link]
        number = int.from_bytes(
            view[start : start + 4].tobytes(), "big" if link != SOCKETCAN and is_little else "little"
        )
        if number & ERROR_BIT or not (0 < number & 0x1FFF_FFFF <= 0x7FF or number & EXTENDED_BIT):
            return ""
        number &= 0x1FFF_FFFF
        return f"; with its bytes in the other order it is {number:#x}: the recorder may have written the wrong one"

    def _other(self, kind: str, number: int = 1) -> None:
        if kind not in self.others and len(self.others) >= _KINDS:
            kind = "other packets and blocks"
        self._other_kind(kind, number)


class PcapCapture(PacketCapture):
    """Frames of a pcap file of link type 227 (SocketCAN), 113 or 276 (Linux cooked capture).

    A pcap file names no interface: `channel` is None, or "if3" where the cooked header says 3. Reading raises
    `CaptureError` when the file is not as long as its header, or holds packets of another link type.
    """

    format = "pcap"

    def __init__(self, source: ByteSource) -> None:
        super().__init__(source)
        self._order = ""
        #: Where damage began, its reason, and how it looks.
        self._damage: tuple[int, str, bytes] | None = None
        self._unit = 1
        self._link = 0

    def _header(self, buffer: bytes) -> None:
        self._order, self._unit = PCAP[buffer[:4]]
        self._link = struct.unpack_from(self._order + "I", buffer, 20)[0] & 0xFFFF
        if self._link not in LINK_TYPES:
            raise CaptureError(
                f"{self.name}: a pcap file with {link_words(self._link)}, and no CAN frames; capture on a CAN interface"
                " (tcpdump -i can0 -w walk.pcap)"
            )

    def _walk(self, buffer: bytes) -> tuple[list[FrameTable], int, int]:
        position = 0
        if not self._order:
            if len(buffer) < _HEADER:
                return [], 0, _HEADER
            if buffer[:4] not in PCAP:
                raise CaptureError(f"{self.name}: not a pcap file: it begins with {buffer[:4].hex()}")
            self._header(buffer)
            position = _HEADER
        tables: list[FrameTable] = []
        while True:
            if self._damage is None:
                starts, position, needed, fault = self._packets(buffer, position)
                tables += self._table(buffer, starts)
                if fault == _JOINED:
                    if len(buffer) - position < _HEADER:
                        return tables, position, _HEADER
                    try:
                        self._header(buffer[position : position + _HEADER])
                    except CaptureError as reason:
                        self._give_up(position, f"{reason}: joined to this one", b"")
                        return tables, position, 0
                    position += _HEADER
                    continue
                if not fault:
                    return tables, position, needed
                excerpt = buffer[position : position + _HEAD].hex().encode()
                self._damage, skip = (self._before + position, fault, excerpt), _HEAD
            else:
                skip = 0
            found, position = self._next_packet(buffer, position + skip)
            if not found:
                return tables, position, len(buffer) - position + 1
            self._end_damage(position)

    def _packets(self, buffer: bytes, position: int) -> tuple[Ints, int, int, str]:
        """Return where packets begin, and where the next would; how many bytes it needs, and what is wrong with its
        header.
        """
        lengths_at = struct.Struct(self._order + "II").unpack_from
        starts: list[Ints] = []
        singles: list[int] = []
        end, needed, same, last, fault = len(buffer), _HEAD, 0, -1, ""
        while position + _HEAD <= end:
            captured, original = lengths_at(buffer, position + 8)
            if captured > original or captured > _LARGEST:
                limit = f"of {original} in all" if captured > original else "captured"
                fault = f"a packet of {captured} bytes {limit}"
                break
            if not original and buffer[position : position + 4] in PCAP:
                fault = _JOINED
                break
            size = captured + _HEAD
            if position + size > end:
                needed = size
                break
            same = same + 1 if size == last else 0
            last = size
            if (
                same == 8
            ):  # records of one size mostly come in long runs, and are compared by both lengths at once
                same = 0
                count = (end - position) // size
                many = run_length(np.ndarray((count,), "u8", buffer, position + 8, (size,)))
                starts += [np.array(singles, np.int64), position + np.arange(many, dtype=np.int64) * size]
                singles = []
                position += many * size
                continue
            singles.append(position)
            position += size
        starts.append(np.array(singles, np.int64))
        return np.concatenate(starts), position, needed, fault

    def _next_packet(self, buffer: bytes, position: int) -> tuple[bool, int]:
        """Return whether there is a packet from here on, and where; otherwise from where to look when there is more."""
        count = len(buffer) - _HEAD + 1 - position
        if count <= 0:
            return False, position
        fraction, captured, original = (
            np.ndarray((count,), self._order + "u4", buffer, position + at, (1,)) for at in (4, 8, 12)
        )
        may_be = (captured >= 8) & (captured <= original) & (original <= _LARGEST)
        may_be &= fraction < 1_000_000_000 // self._unit
        for place in (position + np.flatnonzero(may_be)).tolist():
            believed = self._is_packet(buffer, place)
            if believed is not False:
                return believed is True, place
        return False, position + count

    def _is_packet(self, buffer: bytes, place: int) -> bool | None:
        """Return whether headers follow each other from here on, or one up to the end of the file; None: too little is
        there.
        """
        head_at = struct.Struct(self._order + "IIII").unpack_from
        limit, at, first = 1_000_000_000 // self._unit, place, -1
        for _ in range(_WITNESSES):
            if at + _HEAD > len(buffer):
                return at == len(buffer) if self._is_final else None
            seconds, fraction, captured, original = head_at(buffer, at)
            first = seconds if first < 0 else first
            if not 8 <= captured <= original <= _LARGEST or fraction >= limit or abs(seconds - first) > _FAR:
                return False
            at += _HEAD + captured
        return at <= len(buffer) or not self._is_final

    def _end_damage(self, position: int) -> None:
        """Count what lies before this place of the buffer, and is not a packet, as one unreadable object."""
        assert self._damage is not None
        offset, fault, excerpt = self._damage
        self._damage = None
        self.lines += 1
        lost = self._before + position - offset
        self._unreadable(self.lines, f"{fault} at offset {offset}; {lost} bytes are not a packet", excerpt)

    def _table(self, buffer: bytes, starts: Ints) -> list[FrameTable]:
        n = len(starts)
        if not n:
            return []
        view = padded(buffer)
        head = np.ascontiguousarray(gather_rows(view, starts, 12)).view(self._order + "u4")
        time = head[:, 0].astype(np.int64) * 1_000_000_000 + head[:, 1].astype(np.int64) * self._unit
        packets, is_good = self._frames(
            view, starts + 16, head[:, 2].astype(np.int64), np.full(n, self._link), self._order == "<"
        )
        interfaces = packets.interface[is_good]
        numbers = np.zeros(len(interfaces), np.uint16)
        for interface in np.unique(interfaces).tolist():
            name = None if interface < 0 else f"if{interface}"
            numbers[interfaces == interface] = self.channels.number(name)
        return as_tables(packets, is_good, time, numbers, self)

    def _end(self, rest: int) -> None:
        if not self._order:
            raise CaptureError(f"{self.name}: not a whole pcap file: it ends within its header")
        if self._damage is not None:
            return self._end_damage(rest)
        self._give_up(0, f"the file ends {rest} bytes into a packet", b"")


def padded(buffer: bytes) -> Ints:
    """Return the bytes of a buffer, and so many behind it that nothing is read from elsewhere."""
    return np.frombuffer(buffer + bytes(PADDING), np.uint8)


def as_tables(
    packets: Packets, is_good: Ints, time: Ints, channel: Ints, capture: CanRecording
) -> list[FrameTable]:
    """Return the good packets as a table, if there are any; `channel` is of these alone."""
    if not is_good.any():
        return []
    if not is_good.all():
        time, packets = time[is_good], Packets._make(column[is_good] for column in packets)
    return [
        FrameTable(time, channel, packets.id, packets.flags, packets.length, packets.data, capture.channels)
    ]


def run_length(sizes: Ints) -> int:
    """Return how many of the first numbers are equal."""
    reach, n = 16, len(sizes)
    while True:
        wrong = sizes[:reach] != sizes[0]
        if wrong.any():
            return int(wrong.argmax())
        if reach >= n:
            return n
        reach *= 16
