"""Segmented transfers of CANopen's service data (SDO, CiA 301 §7.2.4.3): objects of any length, both ways.

Facts: frames have eight bytes; a client sends under 0x600 + node, the node answers under 0x580 + node. The upper three bits
of the first byte are the command, which means another thing each way; a first frame has index, subindex and size, a segment
has a toggle (bit 4), how many of its seven bytes are none (bits 3–1), and whether it is the last one (bit 0). Bytes and
commands are those of canopen 2.4 (`sdo/client.py`, `sdo/constants.py`).
Choice: a packet is command, index and subindex, then the data; its key is that of the frames that carry the data, so that it
says node and direction. Everything else is a packet of one frame (requests, expedited transfers, aborts), but for what asks
for segments or takes them, which steers. Segments before the last one are full, as all who send them have it.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

from ...errors import FieldError
from ..keys import EXTENDED
from .pattern import IdField, IdPattern
from .transport import FrameKind, FrameNumber, FramePart, Transport

_TO_NODE, _FROM_NODE = 0x600, 0x580
_NODES = range(1, 128)
_FRAME, _HEAD, _ROOM = 8, 4, 7
#: Commands (bits 7–5) of the client, and of the node.
_SEGMENT, _ABORT, _BLOCKS = 0, 4, (5, 6)
_OPENS = {_TO_NODE: 1, _FROM_NODE: 2}
_STEERS = {_TO_NODE: (3, "segment request"), _FROM_NODE: (1, "segment taken")}
_ANSWERS = {_TO_NODE: (2,), _FROM_NODE: (3,)}
#: Bits of a first frame: the data are in it; a size is given.
_EXPEDITED, _SIZED = 0x02, 0x01
_TOGGLE, _LEFT, _LAST = FrameNumber(0, 0x10), FrameNumber(0, 0x0E), FrameNumber(0, 0x01)


@dataclass(frozen=True)
class SdoTransfer(Transport):
    """Service data of CANopen in segments, under the identifiers of the predefined connection set.

    Messages have `id=0x600 + Node` (what a client writes) or `id=0x580 + Node` (what a node answers) and begin with the
    command: `0x20 | sized` and `0x40 | sized` are transfers in segments, whose packet is command, index, subindex and data;
    the size is the transport's own matter. All other packets are frames of eight bytes. An abort ends the packet under way,
    and is a message itself. Block transfers are refused: each frame that begins, steers or ends one is malformed; numbered
    frames inside look like others.

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
        """What a frame is: of the client or of the node, which its identifier says."""
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
        if command in _BLOCKS:
            return FramePart("bad", reason="malformed: block transfer")
        if command == _OPENS[way] or command in _ANSWERS[way]:
            return FramePart("single", key, data, key)
        return FramePart("bad", reason=f"malformed: no frame of {self.title}")

    def _first(self, key: int, data: bytes) -> FramePart:
        """One without a size, or of no bytes, goes on until a segment says that it is the last."""
        size = int.from_bytes(data[_HEAD:], "little") if data[0] & _SIZED else 0
        if size + _HEAD > self.max_size:
            return FramePart("bad", reason="malformed: too long")
        return FramePart("first", key, data[:_HEAD], key, _HEAD + size if size else None)

    def carries(self, size: int) -> bool:
        return size >= _HEAD

    def split(self, key: int, data: bytes, sequence: int = 0, extra: bytes = b"") -> list[tuple[int, bytes]]:
        """The frames of a packet: one, or those that carry its data without what the other end says."""
        way, _ = _ways(key)
        if len(data) > self.max_size or len(data) < _HEAD:
            raise FieldError(f"a packet of {len(data)} bytes; {self.title} has {_HEAD} to {self.max_size}")
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


def _ways(key: int) -> tuple[int, int]:
    """The identifiers without a node of a frame's own way and of the other one."""
    way = key & ~0x7F & ~EXTENDED
    return (_TO_NODE, _FROM_NODE) if way == _TO_NODE else (_FROM_NODE, _TO_NODE)


__all__ = ["SdoTransfer"]
