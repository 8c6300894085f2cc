"""How packets are laid out in a byte stream.

A packet on the wire is  sync | header | payload | check | end,  and one of three things says where it ends:

* `size`: its size in bytes, a number or an expression of header fields (`this.length + 4`), perhaps `Escaped`;
* `end`: bytes that close it (`b"\\r\\n"`), with `stuffing` to keep them out of the data; `(b"\\r\\n", b"\\n")` reads packets
  that the last byte alone closes, too, and writes the whole end;
* `end="silence"`: a pause on the line longer than `gap`.

Behind the check there may be a `trailer` (a signature).

1. A framing knows nothing of messages, but for how long each is where zeros are cut off them (`sizes`).
2. `judge` is the slow, obvious truth about one candidate; generated scanners must agree with it on every input.
3. Every framing has a `max_size`: memory is bounded whatever the wire says.
"""

from __future__ import annotations

import enum
from collections.abc import Callable, Collection, Iterable, Mapping
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal

import msgspec
from construct import Construct, Container, Struct
from msgspec.structs import replace

from ...errors import SpecError
from .checks import Check, Covered, DataIds
from .fields import innermost, wire_number
from .head import Head, heads_of
from .normalise import sizes
from .pattern import describe_values
from .place import SourceLine, caller
from .shapes import Shapes
from .stuffing import Cobs, CutZeros, Insert, Slip, Stuffing

if TYPE_CHECKING:
    from .message import Message
    from .protocol import DeclaredProtocol


class Verdict(enum.Enum):
    """What one candidate is, as far as the bytes tell."""

    DEAD = "dead"
    MORE = "more bytes needed"
    BAD = "check or length failed"
    WHOLE = "whole"


class Judgement(msgspec.Struct, frozen=True):
    """A verdict with the packet's size on the wire, or with the reason of a failure.

    `data` is what the check of a whole packet is taken of: the packet, unstuffed where it is stuffed as a whole.
    """

    verdict: Verdict
    size: int = 0
    reason: str = ""
    data: bytes = b""


DEAD = Judgement(Verdict.DEAD)
MORE = Judgement(Verdict.MORE)


def BAD(reason: str) -> Judgement:
    return Judgement(Verdict.BAD, 0, reason)


class Escaped(msgspec.Struct, frozen=True):
    """A size by a header field of which the value `escape` says that a wider length follows: `Escaped(this.length + 5, 255,
    Int16ub)`.

    `size` is the expression, without the wider length's own bytes, which are between header and payload. A length below
    `escape` is never written wide, so that a packet has one form.
    """

    size: Callable[[Any], Any]
    escape: int
    wide: Construct


class Trailer(msgspec.Struct, frozen=True):
    """`size` bytes behind the check of those packets in whose header field `field` bit `bit` is set: MAVLink's signature is
    `Trailer(13, "incompat_flags")`.

    In records they are the end of the message's last field, which takes all bytes that there are.
    """

    size: int
    field: str
    bit: int = 0


class Affine(msgspec.Struct, frozen=True):
    """size = factor × length + constant, read off a size expression so that building can invert it.

    Where the length is `escape`, a `wide` one behind the header counts instead, and its bytes are of the packet too.
    Where a bit of `flags` is set, a trailer of `more` bytes is; `mask` is that bit.
    """

    length: Head
    factor: int
    constant: int
    escape: int | None = None
    wide: Head | None = None
    flags: Head | None = None
    mask: int = 0
    more: int = 0

    def invert(self, size: int) -> int | None:
        """Return the length field of a packet of `size` bytes; None when it has no number for that."""
        number, rest = divmod(size - self.constant, self.factor)
        if self.wide is not None and self.escape is not None and number >= self.escape:
            return self.escape if self.invert_wide(size) is not None else None
        return number if not rest and 0 <= number < 1 << 8 * self.length.size else None

    def invert_wide(self, size: int) -> int | None:
        """Return the wider length of a packet of `size` bytes; None when it has no number for that."""
        assert self.wide is not None
        assert self.escape is not None
        number, rest = divmod(size - self.wide.size - self.constant, self.factor)
        return number if not rest and self.escape <= number < 1 << 8 * self.wide.size else None

    def size_of(self, packet: bytes) -> int | None:
        """Return the size of a packet that begins so: None while its length is not there, 0 where that is not a length."""
        head = self.length
        if len(packet) < head.offset + head.size:
            return None
        number = head.number(packet)
        if self.flags is not None:
            if len(packet) < self.reach:
                return None
            return self.factor * number + self.constant + self.trailing(packet)
        if self.wide is None or self.escape is None or number < self.escape:
            return self.factor * number + self.constant
        if number > self.escape:
            return 0
        if len(packet) < self.wide.offset + self.wide.size:
            return None
        number = self.wide.number(packet)
        return self.factor * number + self.constant + self.wide.size if number >= self.escape else 0

    def trailing(self, packet: bytes) -> int:
        """Return how many bytes are behind the check of a packet that begins so."""
        return self.more if self.flags is not None and self.flags.number(packet) & self.mask else 0

    @property
    def reach(self) -> int:
        """Number of bytes of a packet that say its size, at most."""
        return max(
            number.offset + number.size
            for number in (self.length, self.wide, self.flags)
            if number is not None
        )

    @property
    def largest(self) -> int:
        """The size of the longest packet that can be said."""
        last = self.wide or self.length
        more = self.wide.size if self.wide is not None else self.more
        return self.factor * ((1 << 8 * last.size) - 1) + self.constant + more


class BitSize(msgspec.Struct, frozen=True):
    """size = constant + what each bit of some header bytes adds, read off a size expression: `tables` has for each of these
    bytes its offset, and what it adds by its value.
    """

    names: tuple[str, ...]
    tables: tuple[tuple[int, tuple[int, ...]], ...]
    constant: int

    def size_of(self, packet: bytes) -> int | None:
        """Return the size of a packet that begins so: None while the bytes that say it are not there."""
        if len(packet) < self.reach:
            return None
        return self.constant + sum(table[packet[offset]] for offset, table in self.tables)

    @property
    def reach(self) -> int:
        """Number of bytes of a packet that say its size."""
        return 1 + max(offset for offset, _ in self.tables)

    @property
    def describe(self) -> str:
        return f"size by bits of {', '.join(self.names)}"


class FieldSize(msgspec.Struct):
    """The size of packets that are as long as the fields of their message say: `size="fields"`."""

    behind: int
    shapes: Shapes | None = None
    describe = "as long as its fields say"

    def size_of(self, packet: bytes) -> int | None:
        """Return the size of a packet that begins so: None while the bits that say it are not there."""
        assert self.shapes is not None
        size = self.shapes.size_of(packet)
        return None if size is None else size + self.behind


class WideLength(Stuffing, msgspec.Struct, frozen=True):
    """The wider length of `Escaped` as stuffing: bytes in front of the data, where there is much of it.

    `around` is the size of header and check.
    """

    affine: Affine
    around: int
    is_inside = True

    @property
    def describe(self) -> str:
        assert self.affine.wide is not None
        return (
            f"from {self.affine.length.name} {self.affine.escape} on {self.affine.wide.size} bytes of length"
        )

    def _is_wide(self, size: int) -> bool:
        assert self.affine.escape is not None
        return size + self.around - self.affine.constant >= self.affine.escape * self.affine.factor

    def stuff(self, data: bytes) -> bytes:
        wide = self.affine.wide
        assert wide is not None
        if not self._is_wide(len(data)):
            return data
        number = self.affine.invert_wide(len(data) + wide.size + self.around)
        return (wide.bytes(number) if number is not None else bytes(wide.size)) + data

    def unstuff(self, wire: bytes) -> bytes:
        wide = self.affine.wide
        assert wide is not None
        return wire[wide.size :] if self._is_wide(len(wire)) else wire

    def largest(self, size: int) -> int:
        return size + (self.affine.wide.size if self.affine.wide is not None else 0)


class Framing:
    """A way of packing messages into a byte stream; made by `Protocol.framing`, called to declare messages."""

    def __init__(
        self,
        protocol: DeclaredProtocol,
        *,
        sync: bytes = b"",
        not_next: bytes = b"",
        not_inside: bytes = b"",
        header: Struct | None = None,
        match: Mapping[str, Collection[int]] | None = None,
        size: int | Callable[[Any], Any] | Escaped | Literal["fields"] | None = None,
        multiple: int = 1,
        end: bytes | str | tuple[bytes, bytes] | None = None,
        stuffing: Stuffing | None = None,
        check: Check | None = None,
        trailer: Trailer | None = None,
        max_size: int | None = None,
        gap: float | None = None,
        name: str = "",
    ) -> None:
        self.place: SourceLine = caller()
        self.protocol = protocol
        self.name = name or protocol.name
        for what, given in (("sync", sync), ("not_next", not_next), ("not_inside", not_inside)):
            if not isinstance(given, bytes):  # pyright: ignore[reportUnnecessaryIsInstance]
                raise SpecError(f"{self.place}: {what} is bytes, as in b'\\xaa', not {given!r}")
        self.sync = sync
        self.not_next = frozenset(not_next)
        #: Bytes that no packet has between sync and end.
        self.not_inside = bytes(sorted(set(not_inside)))
        if isinstance(check, type) or isinstance(stuffing, type):
            raise SpecError(f"{self.place}: check and stuffing are made by calling: Sum(), Crc('…'), Slip()")
        if check is not None and any(isinstance(part, DataIds) for part in check.over or ()):
            raise SpecError(
                f"{self.place}: DataIds are of a message's own check: it chooses by a field of its payload"
            )
        self.check = check
        self.stuffing = stuffing
        self.gap = gap
        self.heads = heads_of(header, len(sync), self.place, "header")
        self.head_end = len(sync) + sum(h.size for h in self.heads)
        #: Where nothing marks a packet's beginning: the header bytes, by their offset, that its packets have.
        self.match = self._matched(match or {})
        #: The header field that has the check; None: it is behind the payload.
        self.check_head = self._check_head()
        #: Bytes of the check behind the payload.
        self.check_size = check.size if check is not None and self.check_head is None else 0
        #: Whether the check covers what was asked: it can be judged with the request alone.
        self.covers_request = check is not None and check.covers_request
        #: What closes packets that are read as well, and with which `end` ends; empty: nothing else does.
        self.short_end = b""
        if isinstance(end, tuple):
            end, self.short_end = end
            lone = check is not None and (check.after_end or check.covers_request)
            if not self.short_end or not end.endswith(self.short_end) or end == self.short_end:
                raise SpecError(f"{self.place}: of two ends the second is the last bytes of the first")
            if stuffing is not None or lone:
                raise SpecError(
                    f"{self.place}: two ends do not go with stuffing, nor with a check over the request or behind the end"
                )
        self.is_silent = end == "silence"
        if isinstance(end, str) and not self.is_silent:
            raise SpecError(f"{self.place}: end is bytes or 'silence', not {end!r}")
        self.end: bytes = end if isinstance(end, bytes) else b""
        if (size is not None) + bool(self.end) + self.is_silent != 1:
            raise SpecError(f"{self.place}: a framing ends by one of size=…, end=b'…', end='silence'")
        #: Bytes of the check behind the bytes that close a packet.
        self.check_behind = check.size if check is not None and check.after_end else 0
        if check is not None and check.after_end and (not self.end or check.field is not None):
            raise SpecError(
                f"{self.place}: a check after_end=True is behind the end=b'…' of packets, and in no field"
            )
        if stuffing is not None and (self.covers_request or self.check_behind):
            raise SpecError(
                f"{self.place}: a check over the request, or behind the end, does not go with stuffing"
            )
        if not_inside and (not self.end or stuffing is not None):
            raise SpecError(
                f"{self.place}: not_inside is for packets that an end=b'…' closes, without stuffing"
            )
        if set(not_inside) & set(self.end[:-1]):
            raise SpecError(f"{self.place}: not_inside has a byte with which the end {self.end!r} may begin")
        self.fixed_size = size if isinstance(size, int) else None
        self.affine: Affine | None = None
        #: What says the size where it is not a multiple of a length: bits of the header, or fields that are there by bits.
        self.measure: BitSize | FieldSize | None = None
        if isinstance(size, Escaped):
            self.affine = self._escaped(size)
        elif isinstance(size, str):  # an expression equals nothing
            self.measure = FieldSize(self.check_size)
            if size != "fields":
                raise SpecError(f"{self.place}: size is a number, an expression or 'fields', not {size!r}")
        elif callable(size):
            self._ask(size)
        if self.measure is not None and stuffing is not None:
            raise SpecError(f"{self.place}: a size by bits or fields does not go with stuffing")
        if self.affine is not None and self.affine.wide is not None:
            if stuffing is not None:
                raise SpecError(f"{self.place}: a length that is escaped does not go with stuffing")
            self.stuffing = WideLength(self.affine, self.head_end + self.check_size)
        self.trailer = trailer
        if trailer is not None:
            self.affine = self._trailed(trailer)
        #: Where zeros are cut off: by the number that selects a message, the bytes of its fields behind the header.
        self.sizes: dict[int, int] = {}
        #: What the size of all packets is a multiple of; zeros at the end of the payload make it so.
        self.multiple = multiple
        plain = self.affine is not None and self.stuffing is None and trailer is None
        if multiple != 1 and (not plain or multiple not in (2, 4, 8, 16)):
            raise SpecError(
                f"{self.place}: multiple= is 2, 4, 8 or 16, of packets with size=this.FIELD + …, without stuffing"
            )
        self.max_size = max_size if max_size is not None else (self.fixed_size or 0)
        self.min_size = self.head_end + self.check_size + len(self.end)
        if max_size is None and self.fixed_size is None:
            raise SpecError(f"{self.place}: max_size= is missing: how many bytes may a packet have at most?")
        if self.max_size < max(1, self.min_size):
            raise SpecError(
                f"{self.place}: a packet of {self.max_size} bytes has no room for header and check ({self.min_size} bytes)"
            )
        if self.is_silent and not gap:
            raise SpecError(f"{self.place}: a packet that ends by silence needs gap=seconds")
        if self.affine is None and self.fixed_size is None and isinstance(stuffing, Insert):
            raise SpecError(f"{self.place}: inserted bytes need a size; delimited framings take Slip or Cobs")

    def _check_head(self) -> Head | None:
        """Return the header field that the check names."""
        check = self.check
        if check is None or check.field is None:
            return None
        found = next((head for head in self.heads if head.name == check.field), None)
        if found is None or found.size != check.size or found.is_text or check.text is not None:
            names = ", ".join(head.name for head in self.heads if head.name) or "none"
            raise SpecError(
                f"{self.place}: field={check.field!r} of a framing's check is a header field of {check.size} bytes"
                f" (there are: {names})"
            )
        if check.size > 1 and found.order != check.order:
            raise SpecError(
                f"{self.place}: the check is order={check.order!r}, its field {check.field!r} {found.order!r}"
            )
        if self.stuffing is not None:
            raise SpecError(f"{self.place}: a check in the header does not go with stuffing")
        return found

    @cached_property
    def derived(self) -> frozenset[str | None]:
        """The header fields that are computed, and that records do not have: the packet's length, its check."""
        heads = (self.affine.length if self.affine is not None else None, self.check_head)
        return frozenset(head.name for head in heads if head is not None)

    @cached_property
    def check_at(self) -> int:
        """Start of the check in a packet: from its first byte, or negative, from its end."""
        assert self.check is not None
        if self.check_head is not None:
            return self.check_head.offset
        return -self.check.size - (0 if self.check_behind else len(self.end))

    @cached_property
    def check_over(self) -> tuple[Covered, ...]:
        """Bytes of a whole packet that the check covers; by default all behind the sync bytes but check and end."""
        assert self.check is not None
        if self.check.over is not None:
            return self.check.over
        sync, at = len(self.sync), self.check_at
        if at < 0:
            return (slice(sync, at),)
        behind = slice(at + self.check.size, -len(self.end) or None)
        return (slice(sync, at), behind) if at > sync else (behind,)

    def check_covers(self, packet: bytes, extra: bytes = b"", request: bytes = b"") -> bytes:
        """Return the bytes that the check of a packet (up to its trailer, without stuffing around it) covers; `request` is
        the packet that it answers."""
        return Check.joined(packet, self.check_over, extra=extra, request=request)

    def check_in(self, packet: bytes) -> bytes:
        """Return the check's bytes in such a packet."""
        assert self.check is not None
        at = self.check_at if self.check_at >= 0 else len(packet) + self.check_at
        return packet[at : at + self.check.size]

    def _ask(self, size: Callable[[Any], Any]) -> None:
        """Set what an expression says of the size: a multiple of a length, or a sum over bits."""
        try:
            self.affine = self._affine(size)
        except SpecError as error:
            self.measure = self._bit_size(size)
            if self.measure is None:
                raise error from None

    def _bit_size(self, size: Callable[[Any], Any]) -> BitSize | None:
        """Return the size as a sum over bits of header fields; None where it is none."""
        heads = [h for h in self.heads if h.name is not None and not h.is_text]
        zeros = {str(h.name): 0 for h in heads}

        def ask(**values: int) -> int:
            return int(size(Container({**zeros, **values})))

        try:
            base = ask()
            added = {h: [ask(**{str(h.name): 1 << bit}) - base for bit in range(8 * h.size)] for h in heads}
            for step in range(1, 64):  # bits that are not neighbours, together
                values = {
                    h: (0x9E3779B97F4A7C15 * (step + n)) & (1 << 8 * h.size) - 1 for n, h in enumerate(heads)
                }
                wanted = base + sum(
                    more
                    for h, number in values.items()
                    for bit, more in enumerate(added[h])
                    if number >> bit & 1
                )
                if ask(**{str(h.name): number for h, number in values.items()}) != wanted:
                    return None
        except Exception:  # whatever an expression raises
            return None
        used = [h for h in heads if any(added[h])]
        if not used or any(more < 0 for h in used for more in added[h]):
            return None
        tables: list[tuple[int, tuple[int, ...]]] = []
        for head in used:
            for index in range(head.size):
                bits = added[head][8 * index : 8 * index + 8]
                at = index if head.order == "little" else head.size - 1 - index
                table = tuple(
                    sum(more for bit, more in enumerate(bits) if byte >> bit & 1) for byte in range(256)
                )
                if any(table):
                    tables.append((head.offset + at, table))
        return BitSize(tuple(str(h.name) for h in used), tuple(tables), base)

    def _affine(self, size: Callable[[Any], Any]) -> Affine:
        """Read off which header field the size depends on, and how: by asking the expression."""

        def ask(values: dict[str, int]) -> int:
            return int(size(Container(values)))

        zeros = {h.name: 0 for h in self.heads if h.name}
        try:
            base = ask(zeros)
            used = [h for h in self.heads if h.name and ask({**zeros, h.name: 1}) != base]
        except Exception as error:
            raise SpecError(
                f"{self.place}: size must be an expression of header fields, not of {error}"
                f" (there are: {', '.join(zeros) or 'none'})"
            ) from None
        if len(used) != 1:
            raise SpecError(
                f"{self.place}: size must depend on one header field, not on {[h.name for h in used]}"
            )
        length = used[0]
        assert length.name is not None
        factor = ask({**zeros, length.name: 1}) - base
        probes = (2, 3, 7, (1 << 8 * length.size) - 1)
        if factor < 1 or any(ask({**zeros, length.name: n}) != factor * n + base for n in probes):
            raise SpecError(
                f"{self.place}: size must be a whole multiple of {length.name!r} plus a constant, so that it can be inverted"
            )
        return Affine(length, factor, base)

    def _matched(self, match: Mapping[str, Collection[int]]) -> tuple[tuple[Head, frozenset[int]], ...]:
        """Return the header fields by which packets are of this framing at all, in the order of their bytes."""
        if match and self.sync:
            raise SpecError(
                f"{self.place}: match= of a framing is for packets without sync bytes; behind these, match= of messages does"
            )
        found: list[tuple[Head, frozenset[int]]] = []
        heads = {head.name: head for head in self.heads if head.name is not None and head.size == 1}
        for name, numbers in match.items():
            if name not in heads:
                raise SpecError(
                    f"{self.place}: match= names one-byte fields of the header, not {name!r}"
                    f" (there are: {', '.join(heads) or 'none'})"
                )
            chosen = frozenset(numbers)
            if not chosen or not chosen <= frozenset(range(256)):
                raise SpecError(f"{self.place}: match= of {name!r} is numbers from 0 to 255")
            found.append((heads[name], chosen))
        return tuple(sorted(found, key=lambda pair: pair[0].offset))

    def _escaped(self, size: Escaped) -> Affine:
        affine = self._affine(size.size)
        length, wire = affine.length, wire_number(innermost(size.wide))
        if length.offset + length.size != self.head_end:
            raise SpecError(
                f"{self.place}: the wider length follows the header; {length.name!r} must be its last field"
            )
        if wire is None or wire.kind != "uint" or wire.size <= length.size:
            raise SpecError(
                f"{self.place}: the wider length is an unsigned integer of more than {length.size} bytes"
            )
        if not 0 < size.escape < 1 << 8 * length.size:
            raise SpecError(f"{self.place}: {length.name!r} is never {size.escape}")
        wide = Head("wide_length", size.wide, self.head_end, wire.size, wire.order, False)
        return replace(affine, escape=size.escape, wide=wide)

    def _trailed(self, trailer: Trailer) -> Affine:
        flags = next((head for head in self.heads if head.name == trailer.field), None)
        if flags is None or not 0 <= trailer.bit < 8 * flags.size or trailer.size < 1:
            names = ", ".join(head.name for head in self.heads if head.name) or "none"
            raise SpecError(
                f"{self.place}: a trailer has bytes and is there by a bit of a header field (there are: {names})"
            )
        if self.affine is None or self.affine.wide is not None or not self.sync:
            raise SpecError(f"{self.place}: a trailer is for packets with sync bytes and size=this.FIELD + …")
        if self.check is None or self.check.kind != "crc":
            raise SpecError(f"{self.place}: a trailer follows a CRC")
        if not isinstance(self.stuffing, CutZeros):
            raise SpecError(f"{self.place}: a trailer is for packets with stuffing=CutZeros()")
        return replace(self.affine, flags=flags, mask=1 << trailer.bit, more=trailer.size)

    # ------------------------------------------------------------------ declaring messages

    def known(self, message: Message, numbers: Iterable[int] | None) -> None:
        """Note how long a message is, whose selecting header field has these `numbers`; None: it says none."""
        least, most = sizes(message.payload)
        size = message.payload_start + least + message.behind
        if least == most and size % self.multiple:
            raise SpecError(
                f"{message.place}: a packet of {message.name} would have {size} bytes, and those of {self.name} a multiple"
                f' of {self.multiple}; end it with "padding" / Default(GreedyBytes, b"")'
            )
        if isinstance(self.measure, FieldSize):
            if self.measure.shapes is not None:
                raise SpecError(
                    f"{message.place}: packets of {self.name} are as long as the fields of"
                    f" {self.measure.shapes.message.name} say; give {message.name} a framing of its own"
                )
            if not isinstance(message.payload, Struct):
                raise SpecError(
                    f"{message.place}: size='fields' is for a Struct, which {message.name} does not have"
                )
            self.measure.shapes = Shapes(message)
            if any(sizes(body)[0] != sizes(body)[1] for body in self.measure.shapes.bodies):
                raise SpecError(
                    f"{message.place}: packets of {self.name} are as long as their fields say, and a field of"
                    f" {message.name} has no fixed size"
                )
        if not isinstance(self.stuffing, CutZeros):
            return
        if numbers is None:
            raise SpecError(
                f"{message.place}: zeros that were cut off are given back by the message's size:"
                f" match the header's {self.extra_head.name if self.extra_head else 'number of the message'}"
            )
        size = message.payload_start - self.head_end + message.least
        for number in numbers:
            if self.sizes.setdefault(number, size) != size:
                raise SpecError(
                    f"{message.place}: two messages {number} of {self.sizes[number]} and {size} bytes:"
                    f" how many zeros were cut off {message.name} cannot be said"
                )

    def __call__(self, name: str, **declared: Any) -> Message:
        """Declare a message in this framing; the keywords are those of `Protocol.message`."""
        self.protocol.check_keywords(name, declared, {head.name for head in self.heads})
        return self.protocol.message(name, framing=self, **declared)

    def family(self, prefix: Struct, **shared: Any) -> Any:
        """Declare messages that share the fields of `prefix` at the start of their payload; see `Protocol.family`."""
        return self.protocol.family(prefix=prefix, framing=self, **shared)

    # ------------------------------------------------------------------ the truth about one candidate

    def judge(
        self,
        data: bytes,
        start: int,
        *,
        silent: bool = False,
        extras: dict[int, bytes] | None = None,
        request: bytes | None = None,
    ) -> Judgement:
        """Return what begins at `start` of `data`.

        `silent` says that the line fell silent at the end of `data`. `extras` are the `check_extra` bytes by the number
        that selects them (see `Message.extra_key`); `request` is the packet that is answered, for a check that covers it.
        """
        left = len(data) - start
        seen = data[start : start + len(self.sync)]
        if seen != self.sync[: len(seen)]:
            return DEAD
        if len(seen) < len(self.sync):
            return MORE
        if self.not_next:
            if left == len(self.sync):
                return MORE
            if data[start + len(self.sync)] in self.not_next:
                return DEAD
        for head, numbers in self.match:
            if left <= head.offset:
                return MORE
            if data[start + head.offset] not in numbers:
                return DEAD
        if self.is_silent:
            if left > self.max_size:
                return BAD("length")
            return self._checked(data[start:], extras, request) if silent else MORE
        if self.end:
            most = self.max_size - self.check_behind
            mark, first = self.short_end or self.end, start + len(self.sync)
            at = data.find(mark, first, start + most)
            stop = at + len(mark)
            if self.short_end and data.endswith(self.end, first, max(first, stop)):
                at = stop - len(self.end)
            if self.not_inside:
                if self.strays(data, first, at if at >= 0 else start + most):
                    return BAD("a byte that no packet has")
            if at < 0:
                return MORE if left < most else BAD("no end")
            packet = data[start : stop + self.check_behind]
            if at == first:
                return DEAD
            if len(packet) < stop - start + self.check_behind:
                return MORE
            return self._checked(packet, extras, request)
        if self.affine is not None:
            said = self.affine.size_of(data[start : start + self.affine.reach])
            if said is None:
                return MORE
            size = said
        elif self.measure is not None:
            said = self.measure.size_of(data[start : start + self.max_size])
            if said is None:
                return MORE if left < self.max_size else BAD("length")
            size = said
        else:
            assert self.fixed_size is not None
            size = self.fixed_size
        if not self.min_size <= size <= self.max_size or size % self.multiple:
            return BAD("length")
        if left < size:
            return MORE
        return self._checked(data[start : start + size], extras, request)

    def parted(self, packet: bytes) -> tuple[bytes, bytes]:
        """Return a packet up to its check, and what is behind that."""
        size = self.affine.trailing(packet) if self.affine is not None else 0
        return (packet[:-size], packet[-size:]) if size else (packet, b"")

    def _checked(
        self, packet: bytes, extras: dict[int, bytes] | None, request: bytes | None = None
    ) -> Judgement:
        # The check covers the bytes on the wire, except where the whole packet is stuffed.
        inserted = self.stuffing is not None and self.stuffing.is_inside
        try:
            covered = self.parted(packet)[0] if inserted else self.logical(packet)
        except ValueError as error:
            return BAD(str(error))
        judged = self.judge_data(covered, packet, extras, request)
        if inserted and judged.verdict is Verdict.WHOLE:
            try:
                self.logical(packet)
            except ValueError as error:
                return BAD(str(error))
        return judged

    def judge_data(
        self,
        covered: bytes,
        packet: bytes,
        extras: dict[int, bytes] | None,
        request: bytes | None = None,
    ) -> Judgement:
        """Return what a packet is by its length and its check, which covers `covered`: the packet, or its unstuffed form."""
        if len(covered) < self.min_size:
            return BAD("length")
        if self.check is not None:
            extra = b""
            if extras is not None:
                key = self.extra_number(packet)
                if key not in extras:
                    return BAD(f"no message {key} to check by")
                extra = extras[key]
            if request is None and self.covers_request:
                return BAD("no request to check by")
            want = self.check.encode(self.check_covers(covered, extra, request or b""))
            stored = self.check_in(covered)
            if stored != want and not self.check.same(stored, want):
                return BAD("checksum")
        return Judgement(Verdict.WHOLE, len(packet), "", covered)

    def strays(self, data: bytes, start: int, stop: int) -> bool:
        """Return whether a byte of `not_inside` is in [start, stop)."""
        return any(data.find(byte, start, stop) >= 0 for byte in self.not_inside)

    def logical(self, packet: bytes) -> bytes:
        """Return the packet without stuffing, closed by its whole end; raises `ValueError` when it cannot have been
        stuffed so.
        """
        if self.stuffing is None:
            if self.short_end and not packet.endswith(self.end, len(self.sync)):
                return packet[: -len(self.short_end)] + self.end
            return packet
        if self.stuffing.is_inside:
            return self._unstuffed_inside(packet, self.stuffing)
        inner = packet[len(self.sync) : len(packet) - len(self.end)]
        return self.sync + self.stuffing.unstuff(inner) + self.end

    def _unstuffed_inside(self, packet: bytes, stuffing: Stuffing) -> bytes:
        """Return the packet whose payload alone is stuffed, between head and check, without stuffing."""
        body, behind = self.parted(packet)
        end = len(body) - self.check_size
        inner = body[self.head_end : end]
        plain = stuffing.unstuff(inner)
        if self.sizes:  # zeros at the end were left out: the payload has its declared size
            size = self.sizes.get(self.extra_number(packet), 0)
            plain = plain.rstrip(b"\0").ljust(size, b"\0") + behind
        return packet if plain is inner else body[: self.head_end] + plain + body[end:]

    @property
    def is_enclosed(self) -> bool:
        """True if packets are stuffed as a whole and closed by the byte that stuffing keeps out of them
        (SLIP, COBS).
        """
        kind = type(self.stuffing)
        mark = b"\xc0" if kind is Slip else b"\0" if kind is Cobs else None
        return not self.sync and self.end == mark

    @property
    def extra_head(self) -> Head | None:
        """The header field that picks a message's `check_extra`: the last one."""
        named = [head for head in self.heads if head.name is not None and head.name not in self.derived]
        return named[-1] if named else None

    def extras_of(self, messages: Iterable[Message]) -> dict[int, bytes] | None:
        """Return the `check_extra` bytes of those of the messages that have this framing, by the number that selects
        them; None where the check has none."""
        known = [m.extras for m in messages if m.framing is self and m.extras is not None]
        return {number: extra for extras in known for number, extra in extras.items()} if known else None

    def checks_of(self, packet: bytes, extra: bytes, request: bytes = b"") -> tuple[bytes, bytes]:
        """Return the check that a packet should have, and the one that it has; raises `ValueError` where it cannot be
        unstuffed.
        """
        assert self.check is not None
        inserted = self.stuffing is not None and self.stuffing.is_inside
        whole = self.parted(packet)[0] if inserted else self.logical(packet)
        return self.check.encode(self.check_covers(whole, extra, request)), self.check_in(whole)

    def extra_number(self, packet: bytes) -> int:
        head = self.extra_head
        return head.number(packet) if head is not None else 0

    @property
    def describe_check(self) -> str:
        """Kind of check, and where it is not as usual, in words for people; empty without a check."""
        if self.check is None:
            return ""
        over = " over request and packet" if self.covers_request else ""
        return f"{self.check.describe}{over}{', behind the end' if self.check_behind else ''}"

    @property
    def describe(self) -> list[str]:
        """Beginning and end of packets, in words for people."""
        parts = [f"begin with {self.sync.hex(' ').upper()}"] if self.sync else []
        parts += [f"{head.name} {describe_values(numbers)}" for head, numbers in self.match]
        if self.fixed_size is not None:
            parts.append(f"{self.fixed_size} bytes")
        elif self.measure is not None:
            parts.append(f"{self.measure.describe}, at most {self.max_size} bytes")
        elif self.affine is not None:
            parts.append(f"size by {self.affine.length.name}, at most {self.max_size} bytes")
        elif self.end:
            also = f" or {self.short_end.hex(' ').upper()}" if self.short_end else ""
            parts.append(f"end with {self.end.hex(' ').upper()}{also}, at most {self.max_size} bytes")
        else:
            parts.append(f"end by silence, at most {self.max_size} bytes")
        if self.stuffing is not None:
            parts.append(self.stuffing.describe)
        if self.trailer is not None:
            parts.append(f"{self.trailer.size} more by {self.trailer.field} bit {self.trailer.bit}")
        return parts

    def __repr__(self) -> str:
        return f"<framing {self.name} of {self.protocol.name}>"
