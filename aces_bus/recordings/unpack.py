"""Packed sources: gzip and zstandard, recognised by their first bytes and unpacked as they are read.

1. Memory is bounded whatever the packed bytes claim: at once is unpacked what one small piece of input can hold (some
   16 MiB of `_PIECES`), and no window is larger than `_WINDOW` (128 MiB).
2. What could be read is given first; then damage is one `CaptureError` that says after how many packed bytes it is.
3. A file of several members or frames is read as one, as `gzip -dc` and `zstd -dc` do. What is packed twice is refused.

*Facts*: RFC 1952 (gzip), RFC 8878 (zstandard): a block gives at most 128 KiB and may take as few as 4 bytes; members
may be followed by zeros (RFC 1952 has none, tape archives have). The window is the one `zstd -d` allows without
`--long`.
*Choice*: gzip has a checksum at the end of a member only, so lines before the damage may be wrong already; they are
given like those of a plain file with flipped bits.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable
from typing import Any

from ..errors import CaptureError
from .inflate import FastMember, fast_member

GZIP, ZSTANDARD = "gzip", "zstandard"
_ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
_ZSTD_SKIPPABLE = b"\x2a\x4d\x18"  # behind 0x50 to 0x5F
#: As many bytes tell.
MAGIC = 4

_INPUT = 1 << 16
#: Packed bytes that are unpacked at once.
_PIECES = {GZIP: 1 << 13, ZSTANDARD: 512}
_WINDOW = 1 << 27


def packing(head: bytes) -> str:
    """Return what the first bytes say: "gzip", "zstandard" or ""."""
    if head[:3] == b"\x1f\x8b\x08" and head[3:4] < b"\x20":  # deflate, and none of the reserved flags
        return GZIP
    if head[:4] == _ZSTD_MAGIC or (head[1:4] == _ZSTD_SKIPPABLE and head[:1] >= b"P" and head[:1] <= b"_"):
        return ZSTANDARD
    return ""


def may_be_packed(head: bytes) -> bool:
    """Return whether fewer than `MAGIC` bytes could yet become packed ones."""
    return (
        len(head) < MAGIC
        and head != b""
        and (
            b"\x1f\x8b\x08".startswith(head[:3])
            or _ZSTD_MAGIC.startswith(head)
            or (b"P" <= head[:1] <= b"_" and _ZSTD_SKIPPABLE.startswith(head[1:]))
        )
    )


class Unpacker:
    """Bytes out of packed bytes: `read` as of a file, b"" at the end.

    `head` is what was read to tell the packing, `more` reads on. `again` gives packed bytes once more, by their place and
    number, where that can be: only then gzip may be read quicker, for damage is looked at with zlib, from the member's
    first byte.
    """

    def __init__(
        self,
        kind: str,
        name: str,
        head: bytes,
        more: Callable[[int], bytes],
        again: Callable[[int, int], bytes] | None = None,
    ) -> None:
        self.kind, self._name, self._more, self._again = kind, name, more, again
        self._begin = self._gzip_member if kind == GZIP else _zstandard_frame(name)
        self._begun = 0  # where the member does
        self._member: Any = None
        self._waiting = head
        self._taken = 0  # packed bytes that went into a member or were passed over
        self._damage = ""
        self._ready: memoryview = memoryview(b"")

    def read(self, size: int) -> bytes:
        """Return at least one byte and at most `size`; none at the end."""
        if not self._ready:
            self._ready = memoryview(self._more_unpacked())
        given, self._ready = bytes(self._ready[:size]), self._ready[size:]
        return given

    def _more_unpacked(self) -> bytes:
        while True:
            if self._damage:
                raise CaptureError(f"{self._name}: {self._damage}")
            if not self._waiting:
                self._waiting = self._more(_INPUT)
            if not self._waiting:
                if self._member is None:
                    return b""
                if isinstance(self._member, FastMember) and (out := self._read_again(self._member)):
                    return out
                if self._damage:
                    continue
                self._damage = f"the {self.kind} data ends too early, after {self._taken:,} bytes; what it holds was read"
                continue
            if self._member is None and not self._next_member():
                continue
            if out := self._unpack():
                return out

    def _next_member(self) -> bool:
        """Begin the member or frame that is waiting; False when there is none, or not yet."""
        while may_be_packed(self._waiting) and (more := self._more(_INPUT)):
            self._waiting += more
        if packing(self._waiting) == self.kind:
            self._member, self._begun = self._begin(), self._taken
            return True
        if (
            self.kind == GZIP
            and self._taken
            and (zeros := len(self._waiting) - len(self._waiting.lstrip(b"\0")))
        ):
            self._took(zeros)
        else:
            self._damage = f"damaged {self.kind} data after {self._taken:,} bytes: something else follows"
        return False

    def _unpack(self) -> bytes:
        piece = self._waiting[: _PIECES[self.kind]]
        if isinstance(self._member, FastMember):
            given = self._member.decompress(piece)
            if given is None:
                return self._read_again(self._member)
            return self._unpacked(piece, given)
        before = self._member.copy() if self.kind == GZIP else None
        try:
            out: bytes = self._member.decompress(piece)
        except Exception as error:  # zlib.error, ZstdError: the latter's module may not be there to name it
            out, place, said = (b"", 0, str(error)) if before is None else up_to_damage(before, piece)
            self._damage = f"damaged {self.kind} data after {self._taken + place:,} bytes: {said}"
            return out
        return self._unpacked(piece, out)

    def _unpacked(self, piece: bytes, out: bytes) -> bytes:
        self._took(len(piece) - len(self._member.unused_data))
        if self._member.eof:
            self._member = None
        return out

    def _gzip_member(self) -> Any:
        fast = fast_member() if self._again is not None else None
        return fast if fast is not None else zlib.decompressobj(wbits=31)

    def _read_again(self, fast: FastMember) -> bytes:
        """Go on with zlib, which says where damage is: what it gives of the member so far behind what was given already."""
        assert self._again is not None
        self._member = zlib.decompressobj(wbits=31)
        place, known, rest = self._begun, fast.given, b""
        while place < self._taken and (piece := self._again(place, min(_PIECES[GZIP], self._taken - place))):
            before = self._member.copy()
            try:
                out = self._member.decompress(piece)
            except zlib.error:
                out, inside, said = up_to_damage(before, piece)
                self._damage = f"damaged {self.kind} data after {place + inside:,} bytes: {said}"
            rest += out[known:]
            known = max(0, known - len(out))
            if self._damage:
                break
            place += len(piece)
        return rest

    def _took(self, count: int) -> None:
        self._taken += count
        self._waiting = self._waiting[count:]


def up_to_damage(unpacker: Any, packed: bytes | memoryview) -> tuple[bytes, int, str]:
    """Unpack damaged bytes up to the first damaged byte: return the output, its place, and zlib's words."""
    parts: list[bytes] = []
    for place in range(len(packed)):
        try:
            parts.append(unpacker.decompress(packed[place : place + 1]))
        except zlib.error as error:
            return b"".join(parts), place, str(error)
    return b"".join(parts), len(packed), "it ends too early"


def _zstandard_frame(name: str) -> Callable[[], object]:
    try:
        import zstandard
    except ImportError:
        raise CaptureError(
            f"{name}: this is packed with zstandard, which needs a package: pip install 'aces-bus[columns]', "
            "or unpack it first: zstd -dc FILE | aces decode … -"
        ) from None
    unpacker = zstandard.ZstdDecompressor(max_window_size=_WINDOW)
    return unpacker.decompressobj
