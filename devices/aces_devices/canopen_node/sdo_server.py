"""A node's SDO server: canopen's, and block transfers both ways, which canopen's refuses.

1. A block is taken up to the first segment that is missing; the client sends the others again (CiA 301, 7.2.4.3.9–16).
2. Data are written when all of them are there and their CRC is right, and not before.
"""

from __future__ import annotations

from binascii import crc_hqx
from dataclasses import dataclass, field
from typing import Any

from canopen.sdo.exceptions import SdoAbortedError
from canopen.sdo.server import SdoServer

#: Segments in a block at most, and bytes in a segment.
BLOCK, ROOM = 127, 7
#: Bits 1–0 of what the client says in a block transfer.
_BEGIN, _END, _TAKEN, _GO = range(4)
#: Commands of a segment, down and up.
_SEGMENTS = (0, 3)
#: Abort codes (CiA 301, 7.2.4.3.17).
_COMMAND = 0x05040001
_BLOCK_SIZE, _SEQUENCE, _CRC = 0x05040002, 0x05040003, 0x05040004
_READ_ONLY, _NO_OBJECT, _NO_SUBINDEX = 0x06010002, 0x06020000, 0x06090011
_LENGTH, _TOO_LONG, _GENERAL = 0x06070010, 0x06070012, 0x08000000
#: The longest object that is written in blocks (bytes).
LONGEST = 1 << 20


@dataclass
class _Download:
    """What a client writes: the object, the size (None: it does not say), whether its CRC counts, the data so far."""

    index: int
    subindex: int
    size: int | None
    is_checked: bool
    data: bytearray = field(default_factory=bytearray)
    #: The last segment of this block that was taken, and whether it is the last of all.
    number: int = 0
    is_all: bool = False


@dataclass
class _Upload:
    """What a client reads: the data, how many of them it has, and how many segments the block under way has."""

    data: bytes
    block_size: int
    is_checked: bool
    at: int = 0
    sent: int = 0


class BlockSdoServer(SdoServer):
    """canopen's server with block transfers; in the place of a local node's `sdo`."""

    def __init__(self, receives: int, sends: int, node: Any) -> None:
        super().__init__(receives, sends, node)  # type: ignore[no-untyped-call]
        self._download: _Download | None = None
        self._upload: _Upload | None = None

    def on_request(self, can_id: int, data: Any, timestamp: float) -> None:
        """Handle a frame of the client; while a block is written nearly all frames are segments."""
        block = self._download
        if block is not None and not block.is_all and data[0] & 0x7F:
            try:
                self._segment(block, data)
            except SdoAbortedError as error:
                self.abort(error.code)
            return
        if data[0] >> 5 not in (5, 6) or data[0] & 3 == _BEGIN:
            self._download = self._upload = None
        if self._buffer is None and data[0] >> 5 in _SEGMENTS:
            self.abort(_COMMAND)  # canopen's own server would look into a transfer that never began
            return
        super().on_request(can_id, data, timestamp)  # type: ignore[no-untyped-call]

    def abort(self, abort_code: int = _GENERAL) -> None:
        """Abort the transfer under way."""
        self._download = self._upload = None
        if getattr(self, "_index", None) is None:  # nothing was asked for yet
            self._index = self._subindex = 0
        super().abort(abort_code)  # type: ignore[no-untyped-call]

    def block_download(self, data: Any) -> None:
        """Begin or end a block download."""
        if data[0] & 3 == _END:
            self._written(data)
            return
        self._index, self._subindex = int.from_bytes(data[1:3], "little"), data[3]
        self._refuse_now(self._index, self._subindex)
        size = int.from_bytes(data[4:8], "little") if data[0] & 2 else None
        self._download = _Download(self._index, self._subindex, size, bool(data[0] & 4))
        self._say(0xA0 | data[0] & 4, bytes(data[1:4]) + bytes([BLOCK]))

    def _refuse_now(self, index: int, subindex: int) -> None:
        """Raise `SdoAbortedError` for an object that cannot be written, before its data are sent."""
        dictionary = self._node.object_dictionary
        known = dictionary.get_variable(index, subindex)
        if known is None:
            raise SdoAbortedError(_NO_SUBINDEX if index in dictionary else _NO_OBJECT)
        if not known.writable:
            raise SdoAbortedError(_READ_ONLY)

    def _segment(self, block: _Download, data: Any) -> None:
        number, is_last = data[0] & 0x7F, bool(data[0] & 0x80)
        if number == block.number + 1:
            block.data += data[1:8]
            block.number, block.is_all = number, is_last
        if len(block.data) > LONGEST:
            raise SdoAbortedError(_TOO_LONG)
        if number == BLOCK or is_last:
            self._say(0xA2, bytes([block.number, BLOCK]))
            block.number = 0

    def _written(self, data: Any) -> None:
        block, self._download = self._download, None
        if block is None or not block.is_all:
            raise SdoAbortedError(_SEQUENCE)
        content = bytes(block.data[: len(block.data) - (data[0] >> 2 & 7)])
        if block.is_checked and int.from_bytes(data[1:3], "little") != crc_hqx(content, 0):
            raise SdoAbortedError(_CRC)
        if block.size not in (None, len(content)):
            raise SdoAbortedError(_LENGTH)
        self._node.set_data(block.index, block.subindex, content, check_writable=True)
        self._say(0xA1)

    def block_upload(self, data: Any) -> None:
        """Handle any request of the client about an upload."""
        says, block = data[0] & 3, self._upload
        if says == _BEGIN:
            self._begin_upload(data)
        elif says == _END:
            self._upload = None
        elif block is None:
            raise SdoAbortedError(_SEQUENCE)
        elif says == _GO:
            self._send_block(block)
        else:
            if data[1] > block.sent:
                raise SdoAbortedError(_SEQUENCE)
            block.at += ROOM * data[1]
            block.block_size = data[2]
            self._check_size(block.block_size)
            if block.at < len(block.data):
                self._send_block(block)
            else:
                crc = crc_hqx(block.data, 0) if block.is_checked else 0
                self._say(0xC1 | (block.at - len(block.data)) << 2, crc.to_bytes(2, "little"))

    def _begin_upload(self, request: bytes) -> None:
        self._index, self._subindex = int.from_bytes(request[1:3], "little"), request[3]
        self._check_size(request[4])
        data = bytes(self._node.get_data(self._index, self._subindex, check_readable=True))
        if len(data) <= request[5] or not data:
            self.init_upload(request)  # type: ignore[no-untyped-call]  # the client allows that of so few bytes
            return
        self._upload = _Upload(data, request[4], bool(request[0] & 4))
        self._say(0xC2 | request[0] & 4, bytes(request[1:4]) + len(data).to_bytes(4, "little"))

    def _send_block(self, block: _Upload) -> None:
        rest = block.data[block.at : block.at + ROOM * block.block_size]
        pieces = [rest[at : at + ROOM] for at in range(0, len(rest), ROOM)]
        is_last = block.at + len(rest) == len(block.data)
        block.sent = len(pieces)
        for number, piece in enumerate(pieces, 1):
            self._say(number | (0x80 if is_last and number == len(pieces) else 0), piece)

    def _check_size(self, block_size: int) -> None:
        if not 1 <= block_size <= BLOCK:
            raise SdoAbortedError(_BLOCK_SIZE)

    def _say(self, command: int, rest: bytes = b"") -> None:
        self.send_response(bytes([command]) + rest.ljust(ROOM, b"\0"))  # type: ignore[no-untyped-call]
