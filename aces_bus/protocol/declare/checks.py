"""Checks: the number that proves a packet whole.

1. A check is a pure function of bytes; where those bytes are is said by `over`, where the number is by the message.
2. Sums, xor and Fletcher can be answered from prefix sums (`Sums`), so that a stream full of false headers costs
   no more than twice its length. CRCs cannot, and are bounded by the packet's size.

`over` lists what is covered, in order: a `slice` of the packet's bytes (of the data, on CAN), `IdBytes` for the
identifier, `RequestBytes` for the request that an answer answers, `Extra` for the message's own `check_extra` bytes,
`DataIds` for a byte that a field of the payload chooses. The default is everything behind the sync bytes up to the
check itself.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from functools import cache
from importlib import import_module
from itertools import accumulate
from operator import add, xor
from string import Formatter
from typing import Any, Literal

import msgspec

from ...errors import SpecError
from .place import caller

Order = Literal["little", "big"]
#: Bytes of a check; the widest CRC of the catalogue has 64 bits.
LARGEST = 8


class IdBytes(msgspec.Struct, frozen=True):
    """The CAN identifier as `size` bytes, for a check that covers it. `mask` picks bits of it first."""

    size: int
    order: Order = "big"
    mask: int = 0x1FFF_FFFF

    def bytes(self, identifier: int) -> bytes:
        return (identifier & self.mask & ((1 << 8 * self.size) - 1)).to_bytes(self.size, self.order)


class Extra(msgspec.Struct, frozen=True):
    """The message's own `check_extra` bytes (MAVLink's CRC_EXTRA, a data id of AUTOSAR E2E)."""


class RequestBytes(msgspec.Struct, frozen=True):
    """The packet of the request that an answer answers, from byte `start` up to `stop` (None: to its end), for a check
    that covers what was asked (RoboClaw: address and command)."""

    start: int = 0
    stop: int | None = None

    def bytes(self, packet: bytes) -> bytes:
        return packet[self.start : self.stop]


class DataIds(msgspec.Struct, frozen=True):
    """A byte that is not sent, and that a field of the payload chooses: `ids[field % len(ids)]`.

    AUTOSAR E2E's profile 2 has sixteen ids, chosen by its counter; profile 1 has two that alternate. The field is in one
    byte at a fixed place. `place` (offset, shift, mask) is found by the message.
    """

    field: str
    ids: bytes
    place: tuple[int, int, int] = (0, 0, 0)

    def __post_init__(self) -> None:
        if not isinstance(self.ids, bytes) or not self.ids:  # pyright: ignore[reportUnnecessaryIsInstance]
            raise SpecError(f"{caller()}: the ids that {self.field!r} chooses are bytes, a byte each")

    def bytes(self, packet: bytes) -> bytes:
        offset, shift, mask = self.place
        at = (packet[offset] >> shift & mask) % len(self.ids)
        return self.ids[at : at + 1]


Covered = slice | IdBytes | RequestBytes | Extra | DataIds | bytes


class Check:
    """A check of `size` bytes. `compute` gives the number, `encode` its bytes on the wire.

    `field` names the field of the payload that holds it; without it the check is at the end of the packet: before the
    bytes that close it, with `after_end` behind them. `text` is
    a format for checks written as characters, such as `"*{:02X}"` (NMEA): they are written as it says, and read by value,
    as hexadecimal digits mean the same in either case.
    """

    #: "sum", "xor" or "fletcher" when prefix sums can answer; "crc" otherwise.
    kind = "crc"

    def __init__(
        self,
        size: int,
        *,
        over: Covered | Sequence[Covered] | None = None,
        order: Order = "little",
        field: str | None = None,
        text: str | None = None,
        after_end: bool = False,
    ) -> None:
        self.place = caller()
        if not 1 <= size <= LARGEST:
            raise SpecError(f"{self.place}: a check has 1 to {LARGEST} bytes, not {size!r}")
        self.bytes = size
        self.order: Order = order
        self.field = field
        self.text = text
        self.after_end = after_end
        #: Where a text has hexadecimal digits, whose case means nothing.
        self.digits: slice | None = None
        self.size = size if text is None else self._text_size(text)
        self.over: tuple[Covered, ...] | None = (
            None
            if over is None
            else (over,)
            if isinstance(over, (slice, IdBytes, RequestBytes, Extra, DataIds, bytes))
            else tuple(over)
        )
        for part in self.over or ():
            if isinstance(part, slice) and part.step not in (None, 1):
                raise SpecError(f"{self.place}: a check covers runs of bytes; {part} has a step")
        self.covers_request = any(isinstance(part, RequestBytes) for part in self.over or ())

    def compute(self, data: bytes) -> int:
        """Return the check's number over `data`."""
        raise NotImplementedError

    @property
    def engine(self) -> Callable[[bytes], int]:
        """`compute` as its innermost function."""
        return self.compute

    def _text_size(self, text: str) -> int:
        """Return how many characters the check has as text; raises `SpecError` when that is not the format of one number."""
        try:
            parts = list(Formatter().parse(text))
            least, most = (text.format(number).encode("ascii") for number in (0, (1 << 8 * self.bytes) - 1))
        except (ValueError, LookupError, AttributeError) as error:
            raise SpecError(f"{self.place}: {text!r} is not a format of a check's number: {error}") from None
        numbers = [index for index, part in enumerate(parts) if part[1] is not None]
        if len(numbers) != 1:
            raise SpecError(
                f"{self.place}: the text of a check has one number in it; {text!r} has {len(numbers)}"
            )
        if len(least) != len(most):
            raise SpecError(
                f"{self.place}: {text!r} writes a check in {len(least)} to {len(most)} characters;"
                " give the number a width, as in {:02X}"
            )
        at = numbers[0]
        if (parts[at][2] or "")[-1:] in ("x", "X"):
            behind = sum(len(literal) for literal, *_ in parts[at + 1 :])
            self.digits = slice(sum(len(literal) for literal, *_ in parts[: at + 1]), len(least) - behind)
        return len(least)

    def same(self, stored: bytes, wanted: bytes) -> bool:
        """Return whether the bytes in a packet are the number that `encode` wrote as `wanted`."""
        if stored == wanted or self.digits is None:
            return stored == wanted
        digits = self.digits
        return (
            stored[digits].upper() == wanted[digits].upper()
            and stored[: digits.start] == wanted[: digits.start]
            and stored[digits.stop :] == wanted[digits.stop :]
        )

    def encode(self, data: bytes) -> bytes:
        """Return the check's bytes in a packet whose covered bytes are `data`."""
        return self.write(self.compute(data))

    def write(self, number: int) -> bytes:
        """Return the check's bytes in a packet whose check is `number`."""
        if self.text is not None:
            return self.text.format(number).encode("ascii")
        return number.to_bytes(self.bytes, self.order)

    @staticmethod
    def joined(
        packet: bytes,
        over: Sequence[Covered],
        *,
        identifier: int = 0,
        extra: bytes = b"",
        request: bytes = b"",
    ) -> bytes:
        """Return what `over` takes of a packet, in order."""
        parts: list[bytes] = []
        for part in over:
            if isinstance(part, slice):
                parts.append(packet[part])
            elif isinstance(part, RequestBytes):
                parts.append(part.bytes(request))
            elif isinstance(part, IdBytes):
                parts.append(part.bytes(identifier))
            elif isinstance(part, DataIds):
                parts.append(part.bytes(packet))
            else:
                parts.append(extra if isinstance(part, Extra) else part)
        return b"".join(parts)

    @property
    def describe(self) -> str:
        """Kind of check, in words for tables and pictures."""
        raise NotImplementedError


class Sum(Check):
    """The sum of the covered bytes, modulo 256**size; `inverted` for its complement, `negated` for its two's complement,
    with which covered bytes and check add up to 0 (Xsens Xbus, Intel HEX).
    """

    kind = "sum"

    def __init__(self, size: int = 1, *, inverted: bool = False, negated: bool = False, **more: Any) -> None:
        super().__init__(size, **more)
        if inverted and negated:
            raise SpecError(
                f"{self.place}: a sum is inverted (one's complement) or negated (two's), not both"
            )
        self.inverted, self.negated = inverted, negated
        #: What Python writes before the sum.
        self.sign: Literal["", "~", "-"] = "~" if inverted else "-" if negated else ""
        self.mask = (1 << 8 * size) - 1

    def compute(self, data: bytes) -> int:
        return int(self.signed(sum(data))) & self.mask

    def signed(self, total: Any) -> Any:
        """Return the check's number of a sum, or of an array of sums, not yet cut to its size."""
        return ~total if self.inverted else -total if self.negated else total

    @property
    def describe(self) -> str:
        return f"{'inverted ' if self.inverted else 'negated ' if self.negated else ''}sum, {8 * self.bytes} bits"


def InvertedSum(size: int = 1, **more: Any) -> Sum:
    """Return the complement of the sum of the covered bytes (Dynamixel 1.0)."""
    return Sum(size, inverted=True, **more)


def xor_of(data: bytes) -> int:
    """Return the exclusive or of bytes: halves laid over each other until one byte is left."""
    number = int.from_bytes(data, "little")
    for shift in _FOLDS[(len(data) - 1).bit_length() if data else 0]:
        number ^= number >> shift
    return number & 0xFF


#: By the number of halvings: how far the upper half is from the lower, in bits.
_FOLDS = [tuple(8 << step for step in reversed(range(halvings))) for halvings in range(40)]


def fletcher_of(data: bytes) -> int:
    """Return the 8-bit Fletcher pair of bytes, the first in the low byte."""
    return sum(data) & 0xFF | (sum(accumulate(data)) & 0xFF) << 8


class Xor(Check):
    """The exclusive or of the covered bytes."""

    kind = "xor"

    def __init__(self, **more: Any) -> None:
        super().__init__(1, **more)

    def compute(self, data: bytes) -> int:
        return xor_of(data)

    @property
    def describe(self) -> str:
        return "xor, 8 bits"


class Fletcher(Check):
    """The 8-bit Fletcher pair of UBX and MIP: a += byte, b += a, both modulo 256; a comes first."""

    kind = "fletcher"

    def __init__(self, **more: Any) -> None:
        super().__init__(2, **more)

    def compute(self, data: bytes) -> int:
        return fletcher_of(data)

    @property
    def describe(self) -> str:
        return "Fletcher pair, 2 × 8 bits"


class Crc(Check):
    """A CRC by its name in the catalogue of the `anycrc` package, or by its parameters.

    >>> from aces_bus.protocol import Crc
    >>> hex(Crc("CRC16-MCRF4XX").compute(b"123456789"))
    '0x6f91'
    >>> hex(Crc(width=8, poly=0x1D, init=0xFF, xorout=0xFF).compute(b"123456789"))
    '0x4b'
    """

    def __init__(
        self,
        name: str | None = None,
        *,
        width: int | None = None,
        poly: int = 0,
        init: int = 0,
        refin: bool = False,
        refout: bool = False,
        xorout: int = 0,
        **more: Any,
    ) -> None:
        if name is not None:
            width, poly, init, refin, refout, xorout = _catalogued(name)
        if width is None:
            raise SpecError(f"{caller()}: a CRC needs a name of the catalogue or width and poly")
        if not 1 <= width <= 8 * LARGEST:
            raise SpecError(f"{caller()}: a CRC has 1 to {8 * LARGEST} bits, not {width}")
        for what, number in {"poly": poly, "init": init, "xorout": xorout}.items():
            if not 0 <= number < 1 << width:
                raise SpecError(f"{caller()}: {what} has {width} bits, and {number:#x} does not fit")
        super().__init__((width + 7) // 8, **more)
        self.name = name or f"CRC-{width} poly {poly:#x}"
        #: (width, poly, init, refin, refout, xorout), also of a CRC that is given by its name.
        self.parameters = (width, poly, init, refin, refout, xorout)
        self._calc: Callable[[bytes], int] = _engine(name, self.parameters)

    def compute(self, data: bytes) -> int:
        return self._calc(data)

    @property
    def engine(self) -> Callable[[bytes], int]:
        return self._calc

    @property
    def describe(self) -> str:
        return self.name


#: What sheets call a CRC of the catalogue (its aliases, https://reveng.sourceforge.io/crc-catalogue/), as `_plain` has it.
ALSO_CALLED = {
    "CRC16": "CRC16-ARC",
    "CRC16IBM": "CRC16-ARC",
    "CRC16BUYPASS": "CRC16-UMTS",
    "CRC16AUTOSAR": "CRC16-IBM-3740",
    "CRC16CCITTFALSE": "CRC16-IBM-3740",
    "CRC16CCITTTRUE": "CRC16-KERMIT",
    "CRC16AUGCCITT": "CRC16-SPI-FUJITSU",
    "CRC16X25": "CRC16-IBM-SDLC",
    "CRC16ZMODEM": "CRC16-XMODEM",
    # Said of three.
    "CRC16CCITT": "CRC16-IBM-3740 (it begins with FFFF), CRC16-XMODEM (with 0) or CRC16-KERMIT (low bit first)",
    "CRC32": "CRC32-ISO-HDLC",
    "CRC32C": "CRC32-ISCSI",
    "CRC8": "CRC8-SMBUS",
    "CRC8MAXIM": "CRC8-MAXIM-DOW",
}


def _plain(name: str) -> str:
    return re.sub("[^A-Z0-9]", "", name.upper())


@cache
def _catalogued(name: str) -> tuple[int, int, int, bool, bool, int]:
    import anycrc

    known = anycrc.models
    if name not in known:
        import difflib

        plain = _plain(name)
        meant = {_plain(known_name): known_name for known_name in known} | ALSO_CALLED
        for written in (plain, f"CRC16{plain.removeprefix('CRC')}"):
            if written in meant:
                raise SpecError(
                    f"{caller()}: no CRC named {name!r} in the catalogue; there it is {meant[written]}"
                )
        near = difflib.get_close_matches(name.upper(), known, n=5, cutoff=0.4)
        raise SpecError(
            f"{caller()}: no CRC named {name!r} in the catalogue; near: {', '.join(near) or 'none'}"
        )
    model = known[name]
    return model.width, model.poly, model.init, model.refin, model.refout, model.xorout


@cache
def _engine(name: str | None, parameters: tuple[int, int, int, bool, bool, int]) -> Callable[[bytes], int]:
    quick = _quick(name) if name is not None else None
    if quick is not None:
        return quick
    import anycrc

    model = anycrc.Model(name) if name is not None else anycrc.CRC(*parameters)
    calc: Callable[[bytes], int] = model.calc
    return calc


def _quick(name: str) -> Callable[[bytes], int] | None:
    """Return a CRC of the catalogue by `fastcrc`, where that is installed and has it: most of a packet's check by
    `anycrc` is what a call costs."""
    family, _, model = name.lower().partition("-")
    try:
        found: Callable[[bytes], int] | None = getattr(
            import_module(f"fastcrc.{family}"), model.replace("-", "_"), None
        )
    except ImportError:
        return None
    return found


class Sums:
    """Checks of overlapping candidates at bounded cost: prefix sums, kept only where a check has failed.

    While checks hold, each byte is summed once, directly. A failed check makes prefix sums of its bytes; they are grown on
    demand and answer in O(1), for every candidate that begins before their `end`. So no byte is read more than twice.
    Offsets are absolute, so that the buffer may be cut. `work` counts the bytes summed for candidates that failed and for
    prefix sums.
    """

    #: Where the prefix sums end: a candidate that begins behind is summed directly.
    end: int

    def __init__(self, check: Check) -> None:
        self.check = check
        self.reset()

    def reset(self) -> None:
        """Begin anew, as if nothing had been summed."""
        self.work = 0
        self.forget()

    def forget(self) -> None:
        """Drop the prefix sums."""
        self._start = self.end = -1
        self._first: Any = []
        self._second: Any = []

    def fail(self, fresh: bytes, start: int) -> None:
        """Note that a direct check over the bytes `fresh`, which begin at `start`, has failed."""
        self.work += len(fresh)
        self._start, self.end = start, start + len(fresh)
        self._first, self._second = [0], [0]
        self._grow(fresh)

    def lend(self, start: int, end: int, first: Any, second: Any) -> None:
        """Use prefix sums that were made elsewhere, until `forget`."""
        self._start, self.end = start, end
        self._first, self._second = first, second

    def compute(self, buffer: bytes, base: int, start: int, end: int) -> int:
        """Return the check's number over [start, end) of the stream, `start` not behind the sums' end.

        `buffer` begins at stream offset `base`.
        """
        self._reach(buffer, base, start, end)
        return self._number(*self._run(start, end))

    def compute_runs(
        self, buffer: bytes, base: int, start: int, end: int, over: Sequence[Covered], extra: bytes
    ) -> int:
        """Return what `compute` does, over what `over` takes of the packet at [start, end) of the stream."""
        self._reach(buffer, base, start, end)
        first = second = 0
        for part in over:
            if isinstance(part, slice):
                low, high, _ = part.indices(end - start)
                high = max(low, high)
                more, twice = self._run(start + low, start + high)
            else:
                run = part if isinstance(part, bytes) else extra
                low, high = 0, len(run)
                more = xor_of(run) if self.check.kind == "xor" else sum(run)
                twice = sum(accumulate(run)) if self.check.kind == "fletcher" else 0
            second += twice + (high - low) * first
            first = first ^ more if self.check.kind == "xor" else first + more
        return self._number(first, second)

    def _reach(self, buffer: bytes, base: int, start: int, end: int) -> None:
        """Have prefix sums from `start` to `end`; those before may go."""
        if end > self.end:
            self._grow(buffer[self.end - base : end - base])
            self.end = min(
                end, base + len(buffer)
            )  # a whole end in place of a short one may be behind the buffer
        low = start - self._start
        if low > 65536 and isinstance(self._first, list):
            del self._first[:low], self._second[:low]
            self._start = start

    def _run(self, start: int, end: int) -> tuple[int, int]:
        """Return the sum of [start, end), and the sum of its sums."""
        low, high = start - self._start, end - self._start
        before, after = int(self._first[low]), int(self._first[high])
        if self.check.kind == "xor":
            return after ^ before, 0
        if self.check.kind == "sum":
            return after - before, 0
        return after - before, int(self._second[high]) - int(self._second[low]) - (high - low) * before

    def _number(self, first: int, second: int) -> int:
        if isinstance(self.check, Sum):
            return int(self.check.signed(first)) & self.check.mask
        if self.check.kind == "xor":
            return first
        return first & 0xFF | (second & 0xFF) << 8

    def _grow(self, fresh: bytes) -> None:
        self.work += len(fresh)
        fold = xor if self.check.kind == "xor" else add
        first = list(accumulate(fresh, fold, initial=self._first[-1]))
        self._first += first[1:]
        if self.check.kind == "fletcher":
            self._second += list(accumulate(first[1:], initial=self._second[-1]))[1:]
