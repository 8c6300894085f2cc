"""Transfers of CANopen's service data (SDO, CiA 301 §7.2.4.3), in segments and in blocks: objects of any length, both ways.

Facts: frames have eight bytes; a client sends under 0x600 + node, the node answers under 0x580 + node. The upper three bits
of the first byte are the command, which means another thing each way; a first frame has index, subindex and size, a segment
has a toggle (bit 4), how many of its seven bytes are none (bits 3–1), and whether it is the last one (bit 0). Bytes and
commands are those of canopen 2.4 (`sdo/client.py`, `sdo/constants.py`).

In blocks segments are numbered from 1 on, up to 127 in a block (bits 6–0; bit 7: the last one), whatever else such a byte
would be; the receiver says with which one it has taken a block, and the next block goes on behind that. The last frame has a
CRC-16/XMODEM of the data (CiA 301 §7.2.4.3.9–16); where either end knows no CRC it is 0.

Choice: a packet is command, index and subindex, then the data; its key is that of the frames that carry the data, so that it
says node and direction. Everything else is a packet of one frame (requests, expedited transfers, aborts), but for what asks
for segments or takes them, which steers. Segments before the last one are full, as all who send them have it. A CRC of 0 is
not checked: CANopenNode sends 0 where the client asked for none, and says all the same that it knows CRCs.
"""

from __future__ import annotations

from binascii import crc_hqx
from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field
from itertools import islice
from typing import ClassVar

from ...errors import FieldError
from ...frames import EXTENDED
from .pattern import IdField, IdPattern
from .transport import FrameKind, FrameNumber, FramePart, Transport

_TO_NODE, _FROM_NODE = 0x600, 0x580
_NODES = range(1, 128)
_FRAME, _HEAD, _ROOM = 8, 4, 7
#: Commands (bits 7–5) of the client, and of the node.
_SEGMENT, _ABORT = 0, 4
#: Commands of both in a block transfer: of who takes the data, and of who has them.
_TAKES, _HAS = 5, 6
#: What these say (bits 1–0): the beginning, the end, a block is taken, the segments may come.
_BEGIN, _END, _TAKEN, _GO = range(4)
_OPENS = {_TO_NODE: 1, _FROM_NODE: 2}
_STEERS = {_TO_NODE: (3, "segment request"), _FROM_NODE: (1, "segment taken")}
_ANSWERS = {_TO_NODE: (2,), _FROM_NODE: (3,)}
#: Bits of a first frame: the data are in it; a size is given.
_EXPEDITED, _SIZED = 0x02, 0x01
#: The same of a block transfer: a CRC is sent, a size is given.
_CHECKED, _BLOCK_SIZED = 0x04, 0x02
_CRC_SIZE, _BLOCK = 2, 127
_TOGGLE, _LEFT, _LAST = FrameNumber(0, 0x10), FrameNumber(0, 0x0E), FrameNumber(0, 0x01)


@dataclass(frozen=True)
class SdoTransfer(Transport):
    """Service data of CANopen in segments and blocks, under the identifiers of the predefined connection set.

    Messages have `id=0x600 + Node` (what a client writes) or `id=0x580 + Node` (what a node answers) and begin with the
    command: `0x20 | sized` and `0x40 | sized` are transfers in segments, `0xC0 | checked << 2 | sized << 1` in blocks, whose
    packet is command, index, subindex and data; size and CRC are the transport's own matter. All other packets are frames of
    eight bytes. An abort ends the packet under way, and is a message itself.

    `encode` gives the frames as a bystander sees them; sending them takes a handshake, which is not kept here.
    """

    title: ClassVar[str] = "SDO transfer"
    unsendable: ClassVar[str] = (
        "each of its frames waits for an answer; canopen's SdoClient sends transfers, and so do cia402 devices"
    )

    fd: bool = field(default=False, init=False, repr=False)
    address: int = field(default=0, init=False, repr=False)
    pad: int | None = field(default=None, init=False, repr=False)
    kinds: tuple[FrameKind, ...] = field(
        default=(FrameKind("next", "segment", (), number=_TOGGLE, last=_LAST),), init=False, repr=False
    )
    modulo: int = field(default=2, init=False, repr=False)
    first_number: int = field(default=0, init=False, repr=False)
    any_order: bool = field(default=False, init=False, repr=False)

    @property
    def min_size(self) -> int:
        return _HEAD

    @property
    def patterns(self) -> tuple[tuple[IdPattern, bool], ...]:
        return tuple((way + IdField("node", _NODES), False) for way in (_TO_NODE, _FROM_NODE))

    def part(self, key: int, data: bytes) -> FramePart:
        """Return what a frame is: of the client or of the node, which its identifier says."""
        way, other = _ways(key)
        if len(data) != _FRAME:
            return FramePart("bad", reason="malformed: length")
        command = data[0] >> 5
        if command == _SEGMENT:
            piece = data[1 : _FRAME - (data[0] >> 1 & 7)]
            return FramePart("next", key, piece, number=data[0] >> 4 & 1, is_last=bool(data[0] & 1))
        if command == _OPENS[way] and not data[0] & _EXPEDITED:
            return self._first(key, data)
        if command == _STEERS[way][0]:
            return FramePart("control", reason=f"control: {_STEERS[way][1]}")
        if command == _ABORT:
            return FramePart("abort", key, data, key, other=key - way + other)
        if command == _HAS:
            is_end = data[0] & 3 == _END
            return FramePart("bad", reason=_NO_FIRST) if is_end else self._first_of_blocks(key, data)
        if command == _TAKES and (data[0] & 3, way) != (_BEGIN, _TO_NODE):
            return _taking(key - way + other, way, data)
        if command in (_OPENS[way], _TAKES, *_ANSWERS[way]):
            return FramePart("single", key, data, key)
        return FramePart("bad", reason=f"malformed: no frame of {self.title}")

    def _first(self, key: int, data: bytes) -> FramePart:
        """Classify a first frame; without a size, or of no bytes, the packet goes on until a segment says
        that it is the last.
        """
        size = int.from_bytes(data[_HEAD:], "little") if data[0] & _SIZED else 0
        if size + _HEAD > self.max_size:
            return FramePart("bad", reason="malformed: too long")
        return FramePart("first", key, data[:_HEAD], key, _HEAD + size if size else None)

    def _first_of_blocks(self, key: int, data: bytes) -> FramePart:
        size = int.from_bytes(data[_HEAD:], "little") if data[0] & _BLOCK_SIZED else 0
        if size + _HEAD > self.max_size:
            return FramePart("ready", key, reason="malformed: too long", is_acknowledged=True)
        total = _HEAD + size if data[0] & _BLOCK_SIZED else None
        return FramePart("first", key, data[:_HEAD], key, total, is_acknowledged=True)

    def conversations(self, key: int) -> tuple[Hashable, ...]:
        way, other = _ways(key)
        return (key, key - way + other)

    def within(self, so_far: Sequence[FramePart], key: int, data: bytes) -> FramePart | None:
        """Classify a frame during a block transfer, whose session is the key of the frames with the data."""
        session, command = so_far[0].session, data[0] >> 5 if data else 0
        if len(data) != _FRAME:
            return None
        if key == session:
            return self._of_sender(so_far, key, data)
        if command == _ABORT:
            return FramePart("abort", session, data, key)
        if command == _TAKES and data[0] & 3 == _END:
            return FramePart("over", session, reason=_OVER)
        part = self.part(key, data)
        return part._replace(other=session) if part.role in ("single", "first") else part

    def _of_sender(self, so_far: Sequence[FramePart], key: int, data: bytes) -> FramePart | None:
        is_block = data[0] >> 5 == _HAS
        if data[0] == _ABORT << 5:
            return FramePart("abort", key, data, key)
        if so_far[-1].role in ("first", "ready") and is_block and data[0] & 3 != _END:
            return None
        if _is_all_taken(so_far):
            if is_block and data[0] & 3 == _END:
                return FramePart("end", key, data[1 : 1 + _CRC_SIZE], number=data[0] >> 2 & 7)
            return None if data[0] >> 5 != _SEGMENT else FramePart("bad", reason=_NO_FIRST)
        if not data[0] & 0x7F:
            return FramePart("bad", reason=f"malformed: no frame of {self.title}")
        return FramePart("next", key, data[1:], number=data[0] & 0x7F, is_last=bool(data[0] & 0x80))

    def unwrapped(self, data: bytes, extra: bytes) -> bytes | None:
        """Return the packet without the CRC of a transfer in blocks."""
        if data[0] >> 5 != _HAS:
            return data
        crc = int.from_bytes(data[-_CRC_SIZE:], "little")
        data = data[:-_CRC_SIZE]
        return data if not data[0] & _CHECKED or crc in (0, crc_hqx(data[_HEAD:], 0)) else None

    def carries(self, size: int) -> bool:
        return size >= _HEAD

    def split(self, key: int, data: bytes, sequence: int = 0, extra: bytes = b"") -> list[tuple[int, bytes]]:
        """Return the frames of a packet: one, or those that carry its data without what the other end says."""
        way, other = _ways(key)
        if len(data) > self.max_size or len(data) < _HEAD:
            raise FieldError(f"a packet of {len(data)} bytes; {self.title} has {_HEAD} to {self.max_size}")
        if data[0] >> 5 == _HAS and data[0] & 3 != _END:
            return _blocks(key, key - way + other, data)
        if data[0] >> 5 != _OPENS[way] or data[0] & _EXPEDITED:
            if len(data) != _FRAME:
                raise FieldError(f"a frame of {len(data)} bytes; {self.title} has {_FRAME} in each")
            return [(key, data)]
        head, body = data[:_HEAD], data[_HEAD:]
        size = len(body) if data[0] & _SIZED else 0
        frames = [(key, head + size.to_bytes(_FRAME - _HEAD, "little"))]
        for number, at in enumerate(range(0, max(1, len(body)), _ROOM)):
            segment = bytearray(1) + body[at : at + _ROOM].ljust(_ROOM, b"\0")
            _TOGGLE.put(segment, number & 1)
            _LEFT.put(segment, max(0, at + _ROOM - len(body)))
            _LAST.put(segment, at + _ROOM >= len(body))
            frames.append((key, bytes(segment)))
        return frames


_NO_FIRST, _OVER = "malformed: no first frame", "control: block transfer over"


def _taking(session: int, way: int, data: bytes) -> FramePart:
    """Classify a frame of the receiver of a block transfer of which no earlier frame is known."""
    says = data[0] & 3
    if says == _END:
        return FramePart("control", reason=_OVER)
    if says == _TAKEN:
        return FramePart("taken", session, number=data[1], is_acknowledged=True)
    if (says, way) in ((_BEGIN, _FROM_NODE), (_GO, _TO_NODE)):
        return FramePart("ready", session, is_acknowledged=True)
    return FramePart("bad", reason=f"malformed: no frame of {SdoTransfer.title}")


def _is_all_taken(so_far: Sequence[FramePart]) -> bool:
    """Return whether the receiver has just taken the last segment."""
    taken = so_far[-1]
    if taken.role == "taken":
        for part in islice(reversed(so_far), 1, None):
            if part.role != "next":
                break
            if part.number == taken.number:
                return part.is_last
    return False


def _blocks(key: int, back: int, data: bytes) -> list[tuple[int, bytes]]:
    """Return the frames of a transfer in blocks, with those of who takes it under the key `back`: it misses none."""
    head, body = data[:_HEAD], data[_HEAD:]
    size = len(body) if data[0] & _BLOCK_SIZED else 0
    takes, checked = _TAKES << 5, data[0] & _CHECKED
    is_upload = key & ~0x7F == _FROM_NODE
    ready = bytes([takes | _GO]) if is_upload else bytes([takes | checked]) + head[1:] + bytes([_BLOCK])
    frames = [(key, head + size.to_bytes(_FRAME - _HEAD, "little")), (back, ready.ljust(_FRAME, b"\0"))]
    pieces = [body[at : at + _ROOM] for at in range(0, len(body), _ROOM)] or [b""]
    for at in range(0, len(pieces), _BLOCK):
        block = pieces[at : at + _BLOCK]
        for number, piece in enumerate(block, 1):
            last = 0x80 if at + number == len(pieces) else 0
            frames.append((key, bytes([last | number]) + piece.ljust(_ROOM, b"\0")))
        frames.append((back, bytes([takes | _TAKEN, len(block), _BLOCK]).ljust(_FRAME, b"\0")))
    crc = crc_hqx(body, 0) if checked else 0
    end = bytes([_HAS << 5 | _ROOM - len(pieces[-1]) << 2 | _END]) + crc.to_bytes(_CRC_SIZE, "little")
    return [*frames, (key, end.ljust(_FRAME, b"\0"))]


def _ways(key: int) -> tuple[int, int]:
    """Return the identifiers without a node of a frame's own way and of the other one."""
    way = key & ~0x7F & ~EXTENDED
    return (_TO_NODE, _FROM_NODE) if way == _TO_NODE else (_FROM_NODE, _TO_NODE)


__all__ = ["SdoTransfer"]
