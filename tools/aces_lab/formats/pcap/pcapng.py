"""What Wireshark writes by default: pcapng, blocks of which most are packets.

1. Every block is counted in `lines`: a frame, something else in words, unreadable, or a remark (`lines_comment`: blocks that
   describe the section, its interfaces and names).
2. A block whose length cannot be true ends the reading, as in `pcap.py`; what is wrong inside a block costs that block.
3. A section's byte order, interfaces and their numbers are its own.
4. What the file states about itself is compared with what was read: both lengths of a block, the captured and the original
   length of a packet, and the length of a section where it states one.

*Facts*: draft-ietf-opsawg-pcapng: section header 0x0A0D0D0A, interface description 1, packet 2 (old), simple packet 3,
name resolution 4, interface statistics 5, enhanced packet 6, decryption secrets 10. Simple packets have no time.
*Choice*: the first interface of a section that has no name has the channel None, another one "interface 1". Frames lost are
the last numbers of `isb_ifdrop` and `isb_osdrop` of each interface, and the sum of what old packet blocks say.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import ClassVar, Literal

import numpy as np

from aces_bus import FrameTable
from aces_bus.errors import CaptureError
from aces_bus.frame_table import NO_TIME, FrameFlag, Ints
from aces_bus.recordings.source import ByteSource

from .reader import MAX_BLOCK, PacketCapture, as_tables, padded, run_length
from .socketcan import gather_rows

SECTION, INTERFACE, OLD_PACKET, SIMPLE, NAMES, STATISTICS, ENHANCED, SECRETS = (
    0x0A0D0D0A,
    1,
    2,
    3,
    4,
    5,
    6,
    10,
)
BYTE_ORDER = 0x1A2B3C4D
_REMARKS = {SECTION, INTERFACE, NAMES, STATISTICS, SECRETS}
_WORDS = {0x0BAD: "custom blocks", 0x4000_0BAD: "custom blocks", 9: "systemd journal blocks"}
_SMALLEST = {SECTION: 28, INTERFACE: 20, OLD_PACKET: 32, SIMPLE: 16, ENHANCED: 32}

_IF_NAME, _IF_RESOLUTION, _IF_OFFSET = 2, 9, 14
_DROPPED_BY_INTERFACE, _DROPPED_BY_SYSTEM = 5, 7
_PACKET_FLAGS = 2
_WAYS = {1: FrameFlag.RX, 2: FrameFlag.TX}
NAME_BYTES = 256
#: A hostile section may describe more; those are unreadable.
_INTERFACES = 1 << 16


def interface_name(raw: bytes, number: int) -> str | None:
    """Return the channel that an interface is, of its name in the file, if it has one, and its number in the section."""
    raw = raw[:NAME_BYTES].rstrip(b"\0")
    if not raw:
        return None if number == 0 else f"interface {number}"
    text = raw.decode("utf-8", "backslashreplace")
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


@dataclass
class _Interface:
    link: int
    cut: int  # bytes that it keeps of a packet
    channel: int
    resolution: int = 6
    offset_ns: int | None = 0  # None: beyond what an instant can be
    dropped: dict[int, int] = field(default_factory=dict)

    def nanoseconds(self, ticks: Ints) -> Ints:
        """Convert uint64 ticks since 1970 to int64 ns; `NO_TIME` beyond the year 2262."""
        exponent = self.resolution & 0x7F
        if self.resolution & 0x80:  # of 2
            if exponent > 63:
                ticks, exponent = ticks >> np.uint64(min(exponent - 63, 63)), 63
            seconds, rest = np.divmod(ticks, np.uint64(1 << exponent))
            if exponent > 33:
                rest >>= np.uint64(exponent - 33)
            small = np.where(seconds < 9_000_000_000, seconds, 0).astype(np.int64) * 1_000_000_000
            time = small + ((rest * np.uint64(1_000_000_000)) >> np.uint64(min(exponent, 33))).astype(
                np.int64
            )
            is_far = seconds >= 9_000_000_000
        elif exponent <= 9:
            unit = 10 ** (9 - exponent)
            is_far = ticks > np.uint64((1 << 63) // unit - 1)
            time = np.where(is_far, 0, ticks).astype(np.int64) * unit
        else:
            time = (ticks // np.uint64(10 ** min(exponent - 9, 19))).astype(np.int64)
            is_far = np.zeros(len(ticks), bool)
        offset = self.offset_ns
        if offset is None:
            is_far = np.ones(len(ticks), bool)
        elif offset > 0:
            is_far = is_far | (time > (1 << 63) - 1 - offset)
            time = np.where(is_far, 0, time) + offset
        elif offset < 0:
            time = time + offset  # time is not negative: this cannot overflow
        time[is_far] = NO_TIME
        return time


class PcapngCapture(PacketCapture):
    """Frames of a pcapng file, of all its interfaces of link type 227 (SocketCAN), 113 or 276 (Linux cooked capture).

    `channel` is the name of the interface, and "if3" where a cooked header says 3.
    """

    format: ClassVar[str] = "pcapng"

    def __init__(self, source: ByteSource) -> None:
        super().__init__(source)
        self._order = ""
        self._interfaces: list[_Interface] = []
        self._dropped_before = 0  # in earlier sections, and by old packet blocks
        #: Where the blocks of the section begin, and how many bytes it says that they have; below 0: it does not.
        self._section = 0, -1

    def _walk(self, buffer: bytes) -> tuple[list[FrameTable], int, int]:
        """Find the blocks; packets are collected until something comes that changes what they mean."""
        tables: list[FrameTable] = []
        packets: list[Ints] = []
        position, end, needed = 0, len(buffer), 12
        same, last = 0, (0, 0)
        head_at = struct.Struct(self._order + "II").unpack_from
        damage = ""
        while position + 12 <= end:
            if buffer[position : position + 4] == b"\n\r\r\n":
                order = {b"\x1a\x2b\x3c\x4d": ">", b"\x4d\x3c\x2b\x1a": "<"}.get(
                    buffer[position + 8 : position + 12]
                )
                if order is None:
                    damage = "a section of no known byte order"
                    break
                tables += self._flush(buffer, packets)
                packets = []
                self._order, head_at = order, struct.Struct(order + "II").unpack_from
            elif not self._order:
                raise CaptureError(f"{self.name}: not a pcapng file: it begins with {buffer[:4].hex()}")
            kind, size = head_at(buffer, position)
            if size < _SMALLEST.get(kind, 12) or size % 4 or size > MAX_BLOCK:
                damage = f"a block of type {kind:#x} with {size} bytes"
                break
            if position + size > end:
                needed = size
                break
            if buffer[position + 4 : position + 8] != buffer[position + size - 4 : position + size]:
                damage = f"a block of type {kind:#x} whose two lengths differ"
                break
            same = same + 1 if (kind, size) == last else 0
            last = kind, size
            if kind in (ENHANCED, OLD_PACKET, SIMPLE):
                many = 1
                if same == 8:
                    same = 0
                    many = _same_blocks(buffer, self._order, position, size)
                packets.append(position + np.arange(many, dtype=np.int64) * size)
                position += many * size
                continue
            if kind in (SECTION, INTERFACE, STATISTICS):
                tables += self._flush(buffer, packets)
                packets = []
            if kind == SECTION:
                self._check_end(self._before + position)
                stated = int.from_bytes(buffer[position + 16 : position + 24], self._endian, signed=True)
                self._section = self._before + position + size, stated
            self._describe(kind, buffer[position + 8 : position + size - 4])
            position += size
        tables += self._flush(buffer, packets)
        if damage:
            self._give_up(position, damage, buffer[position : position + 16].hex().encode())
        return tables, position, needed

    def _describe(self, kind: int, body: bytes) -> None:
        """Handle a block that does not hold a packet."""
        self.lines += 1
        if kind == SECTION:
            self._dropped_before += self._dropped()
            self._interfaces = []
        elif kind == INTERFACE:
            if len(self._interfaces) >= _INTERFACES:
                self._unreadable(self.lines, f"more than {_INTERFACES} interfaces", body[:16].hex().encode())
                return
            self._interfaces.append(self._interface(body))
        elif kind == STATISTICS and len(body) >= 12:
            number = struct.unpack_from(self._order + "I", body)[0]
            if number < len(self._interfaces):
                for code, value in _options(self._order, body, 12):
                    if code in (_DROPPED_BY_INTERFACE, _DROPPED_BY_SYSTEM) and len(value) == 8:
                        self._interfaces[number].dropped[code] = int.from_bytes(value, self._endian)
                self.frames_dropped = self._dropped_before + self._dropped()
        if kind in _REMARKS:
            self.lines_comment += 1
        else:
            self._other(_WORDS.get(kind, f"blocks of type {kind:#x}"))

    @property
    def _endian(self) -> Literal["little", "big"]:
        return "little" if self._order == "<" else "big"

    def _dropped(self) -> int:
        return sum(sum(interface.dropped.values()) for interface in self._interfaces)

    def _interface(self, body: bytes) -> _Interface:
        link, cut = struct.unpack_from(self._order + "HxxI", body)
        number = len(self._interfaces)
        name = b""
        found = _Interface(link, cut, 0)
        for code, value in _options(self._order, body, 8):
            if code == _IF_NAME:
                name = value
            elif code == _IF_RESOLUTION and len(value) == 1:
                found.resolution = value[0]
            elif code == _IF_OFFSET and len(value) == 8:
                seconds = int.from_bytes(value, self._endian, signed=True)
                found.offset_ns = seconds * 1_000_000_000 if abs(seconds) < 9_000_000_000 else None
        found.channel = self.channels.number(interface_name(name, number))
        return found

    def _flush(self, buffer: bytes, blocks: list[Ints]) -> list[FrameTable]:
        """Return the packets in these blocks, all of one section."""
        if not blocks:
            return []
        starts = np.concatenate(blocks)
        view = padded(buffer)
        # The last columns are, in a simple packet, data; they are not used then.
        rows = np.ascontiguousarray(gather_rows(view, starts, 28))
        words = rows.view(self._order + "u4")
        head = words[:, :6].astype(np.int64)
        kind, total = head[:, 0], head[:, 1]
        is_simple, is_old = kind == SIMPLE, kind == OLD_PACKET
        at = starts + np.where(is_simple, 12, 28)
        number = np.where(is_simple, 0, head[:, 2])
        if is_old.any():
            halves = rows.view(self._order + "u2")[:, 4:6]
            number = np.where(is_old, halves[:, 0], number)
        links = np.array([interface.link for interface in self._interfaces] or [0], np.int64)
        cuts = np.array([interface.cut or MAX_BLOCK for interface in self._interfaces] or [0], np.int64)
        is_known = number < len(self._interfaces)
        known = np.where(is_known, number, 0)
        room = total - np.where(is_simple, 16, 32)
        size = np.where(is_simple, np.minimum(np.minimum(head[:, 2], cuts[known]), room), head[:, 5])
        is_more = ~is_simple & (words[:, 5] > words[:, 6])
        is_bad = ~is_known | (size > room) | is_more
        if is_bad.any():
            return self._flush_without(buffer, starts, is_bad, is_known, is_more)
        if is_old.any():
            drops = rows.view(self._order + "u2")[is_old, 5].astype(np.int64)
            self._dropped_before += int(drops[drops != 0xFFFF].sum())
            self.frames_dropped = self._dropped_before + self._dropped()

        ticks = (head[:, 3].astype(np.uint64) << np.uint64(32)) | head[:, 4].astype(np.uint64)
        time = np.full(len(starts), NO_TIME, np.int64)
        channel = np.zeros(len(starts), np.uint16)
        for interface in np.unique(number).tolist():
            rows = np.flatnonzero(number == interface)
            time[rows] = self._interfaces[interface].nanoseconds(ticks[rows])
            channel[rows] = self._interfaces[interface].channel
        time[is_simple] = NO_TIME

        packets, is_good = self._frames(view, at, size, links[number], self._order == "<")
        is_cooked_number = packets.interface >= 0
        for interface in np.unique(packets.interface[is_cooked_number]).tolist():
            channel[packets.interface == interface] = self.channels.number(f"if{interface}")
        ways = self._ways(buffer, view, at, size, starts + total - 4, is_simple)
        np.bitwise_or(
            packets.flags,
            np.where(packets.flags & (FrameFlag.RX | FrameFlag.TX) == 0, ways, 0),
            out=packets.flags,
        )
        return as_tables(packets, is_good, time, channel[is_good], self)

    def _flush_without(
        self, buffer: bytes, starts: Ints, is_bad: Ints, is_known: Ints, is_more: Ints
    ) -> list[FrameTable]:
        """Flush packets of which some are unreadable; those before and behind keep their order and their numbers."""
        tables: list[FrameTable] = []
        edges = np.flatnonzero(np.diff(is_bad.astype(np.int8))) + 1
        for part in np.split(np.arange(len(starts)), edges):
            if not is_bad[part[0]]:
                tables += self._flush(buffer, [starts[part]])
                continue
            for row in part.tolist():
                self.lines += 1
                if not is_known[row]:
                    reason = "of an interface that is not described"
                elif is_more[row]:
                    reason = "of which more is captured than there was"
                else:
                    reason = "with more data than the block holds"
                start = int(starts[row])
                self._unreadable(self.lines, f"a packet {reason}", buffer[start : start + 16].hex().encode())
        return tables

    def _ways(self, buffer: bytes, view: Ints, at: Ints, size: Ints, end: Ints, is_simple: Ints) -> Ints:
        """Return uint8: RX, TX or nothing, from the option `epb_flags`, which mostly is the first one."""
        options = at + ((size + 3) & -4)
        ways = np.zeros(len(at), np.uint8)
        rows = np.flatnonzero((options + 8 <= end) & ~is_simple)
        if not len(rows):
            return ways
        first = np.ascontiguousarray(gather_rows(view, options[rows], 8))
        halves = first.view(self._order + "u2").astype(np.int64)
        is_flags = (halves[:, 0] == _PACKET_FLAGS) & (halves[:, 1] == 4)
        way = first.view(self._order + "u4")[:, 1] & 3
        ways[rows[is_flags]] = np.array([0, FrameFlag.RX, FrameFlag.TX, 0], np.uint8)[way[is_flags]]
        for row in rows[~is_flags & (halves[:, 0] != 0)].tolist():
            for code, value in _options(self._order, buffer[int(options[row]) : int(end[row])], 0):
                if code == _PACKET_FLAGS and len(value) == 4:
                    ways[row] = _WAYS.get(int.from_bytes(value, self._endian) & 3, 0)
        return ways

    def _check_end(self, size: int) -> None:
        begin, stated = self._section
        if size - begin < stated:
            self.lines += 1
            self._unreadable(
                self.lines, f"the section states {stated:,} bytes, {size - begin:,} are there", b""
            )

    def _end(self, rest: int) -> None:
        if not self._order:
            raise CaptureError(f"{self.name}: not a whole pcapng file: it ends within its first block")
        self._give_up(0, f"the file ends {rest} bytes into a block", b"")


def _same_blocks(buffer: bytes, order: str, position: int, size: int) -> int:
    """Return how many blocks from here are of one type and length, both lengths."""
    count = (len(buffer) - position) // size
    words = np.frombuffer(buffer, order + "u4", count * size // 4, position).reshape(count, size // 4)
    return min(run_length(words[:, 0]), run_length(words[:, 1]), _agreeing(words[:, -1], words[0, 1]))


def _agreeing(column: Ints, value: int) -> int:
    return run_length(column) if column[0] == value else 0


def _options(order: str, body: bytes, position: int) -> Iterator[tuple[int, bytes]]:
    """Yield code and value of each option, up to the end or to what cannot be an option."""
    head = struct.Struct(order + "HH")
    while position + 4 <= len(body):
        code, size = head.unpack_from(body, position)
        if code == 0 or position + 4 + size > len(body):
            return
        yield code, body[position + 4 : position + 4 + size]
        position += 4 + ((size + 3) & -4)
