"""How long a CAN frame is on the wire, to the bit.

1. The answer is exact: the frame's real bits, its real CRC, the stuff bits that these need.
2. Bits are counted by table, eight at a time, from the state "which level, for how long".

*Facts* (ISO 11898-1:2015, 10.4 and 10.5): a classic frame is SOF, arbitration and control field, data and CRC-15, stuffed
after five equal bits; then CRC delimiter, ACK slot, ACK delimiter and seven bits of EOF, which are not. Three bits of
intermission follow. An FD frame is stuffed like that up to its data; then come a stuff count of four bits and a CRC of 17
(up to 16 bytes) or 21 bits with a fixed stuff bit in front and after every four bits. With BRS, the bits from behind the
BRS bit to the CRC delimiter are sent at the data rate.
*Choice*: the bit rate switches at the border between bits, not at the sample point inside the BRS bit and the CRC delimiter:
times differ from a controller's by less than a bit.
"""

from __future__ import annotations

from functools import cache
from struct import Struct
from typing import NamedTuple

from ...frames import FD_LENGTHS, Frame

#: CRC delimiter, ACK slot, ACK delimiter, EOF.
TRAILER = 1 + 1 + 1 + 7
INTERMISSION = 3
#: An active error flag of six bits, one that answers it one bit later, the delimiter (10.4.4).
ERROR_FRAME = 6 + 1 + 8
#: What a passive transmitter waits beside the intermission.
SUSPEND = 8

_DLC = {size: code for code, size in enumerate(FD_LENGTHS)}


class FrameBits(NamedTuple):
    """Bits from SOF to the last bit of EOF: at the nominal rate, and at the data rate (FD with BRS, else 0)."""

    nominal: int
    data: int

    @property
    def total(self) -> int:
        """All bits, whatever their rate."""
        return self.nominal + self.data

    def duration_ns(self, bitrate: int, data_bitrate: int | None = None) -> int:
        """Time on the wire in ns, rounded to nearest; rates in bit/s."""
        rate = data_bitrate or bitrate
        return (
            self.nominal * 1_000_000_000 * rate + self.data * 1_000_000_000 * bitrate + bitrate * rate // 2
        ) // (bitrate * rate)


def frame_bits(frame: Frame) -> FrameBits:
    """Return the bits of a frame. An error frame has the bits of an error flag and its delimiter.

    >>> frame_bits(Frame(0x123, bytes.fromhex("55AA55AA55AA55AA")))
    FrameBits(nominal=109, data=0)
    """
    if frame.is_fd and not frame.is_error_frame:
        return _fd_bits(frame)
    return FrameBits(classic_bits(frame), 0)


def classic_bits(frame: Frame) -> int:
    """Return the same of a frame that is not CAN FD, whose bits all have the nominal rate."""
    data, key = frame.data, frame.arbitration_id
    if frame.is_extended_id:
        key |= _EXTENDED
    if frame.is_error_frame:
        return ERROR_FRAME
    if frame.is_remote_frame:
        key, size = key | _REMOTE, min(frame.dlc or 0, 15)
    else:
        size = len(data)
    state, bits, check, known = _HEADS.get(key << 4 | size) or _classic_head(key << 4 | size)
    if size <= _SHORT and data in known:
        return known[data]
    single, double, last, crc = _tables()
    if len(data) & 1:
        number = data[0]
        found = single[state << 8 | number]
        state, bits = found >> 3, bits + (found & 7)
        check = crc[check >> 7 ^ number] ^ check << 8 & 0x7FFF
        data = data[1:]
    for pair in _PAIRS[len(data) >> 1](data):
        found = double[state << 16 | pair]
        state = found >> 3
        bits += found & 7
        check = crc[check << 1 ^ pair]
    bits += last[state << 15 | check] & 7
    if size <= _SHORT and len(known) < _KEPT_SHORT:
        known[frame.data] = bits
    return bits


def longest_bits(
    size: int, *, extended: bool = False, fd: bool = False, bitrate_switch: bool = False
) -> FrameBits:
    """Return the most bits that a data frame of `size` bytes can have, whatever its identifier and content.

    A stuff bit behind the fifth equal bit and then behind each fourth, as it begins a run of its own (Davis, Burns, Bril,
    Lukkien 2007, 3.1, of classic frames: 55 + 10 × size bits with 11-bit identifiers, 80 + 10 × size with 29, of which 3 are
    the intermission and not counted here). Of CAN FD, those of the part before the fixed stuff bits.

    >>> longest_bits(8), longest_bits(8, extended=True)
    (FrameBits(nominal=132, data=0), FrameBits(nominal=157, data=0))
    """
    if not fd:
        stuffed = (54 if extended else 34) + 8 * size
        return FrameBits(stuffed + (stuffed - 1) // 4 + TRAILER, 0)
    front, back = _FD_FRONT[extended], 5 + 8 * size
    first, all_stuffed = (front - 2) // 4, (front + back - 2) // 4
    nominal, data = front + first + TRAILER - 1, back + all_stuffed - first + _fd_tail(size) + 1
    return FrameBits(nominal, data) if bitrate_switch else FrameBits(nominal + data, 0)


#: A key has these above its identifier, of 29 bits.
_EXTENDED, _REMOTE = 1 << 29, 1 << 30
#: Of so many headers is remembered what `_classic_head` gives.
_KEPT = 1 << 12
#: Of frames with so few bytes, as requests have that are sent again and again, so many are remembered for each header.
_SHORT, _KEPT_SHORT = 3, 16
_HEADS: dict[int, tuple[int, int, int, dict[bytes, int]]] = {}


def _classic_head(head: int) -> tuple[int, int, int, dict[bytes, int]]:
    """Return the stuffing state behind a header, the bits of all but stuff bits behind it, the header's CRC, and what
    is remembered of short frames; `head` is the key and four bits of length."""
    key, code = head >> 4, head & 15
    remote = key >= _REMOTE
    word, width = _head(key & _EXTENDED - 1, bool(key & _EXTENDED), remote, code)
    state, count = _stuff(word, width, _START)
    check, crc = 0, _crc15()
    for number in word.to_bytes((width + 7) // 8, "big"):
        check = crc[check >> 7 ^ number] ^ check << 8 & 0x7FFF
    if len(_HEADS) >= _KEPT:
        _HEADS.clear()
    bits = width + count + (0 if remote else 8 * code) + 15 + TRAILER
    known: dict[bytes, int] = {}
    _HEADS[head] = found = state, bits, check, known
    return found


def _head(identifier: int, extended: bool, remote: bool, code: int) -> tuple[int, int]:
    """Return SOF to DLC of a classic frame as a number, and its width."""
    code = min(code, 15)
    if extended:
        base, rest = identifier >> 18, identifier & 0x3FFFF
        # SOF 0, base, SRR 1, IDE 1, extension, RTR, r1 r0 0, DLC
        return (base << 2 | 3) << 25 | rest << 7 | remote << 6 | code, 39
    return identifier << 7 | remote << 6 | code, 19


def _fd_bits(frame: Frame) -> FrameBits:
    size = len(frame.data)
    brs = 1 if frame.bitrate_switch else 0
    identifier = frame.arbitration_id
    if frame.is_extended_id:
        base, rest = identifier >> 18, identifier & 0x3FFFF
        # SOF 0, base, SRR 1, IDE 1, extension, RRS 0, FDF 1, res 0, BRS
        front, front_width = (base << 2 | 3) << 22 | rest << 4 | 4 | brs, 36
    else:
        # SOF 0, base, RRS 0, IDE 0, FDF 1, res 0, BRS
        front, front_width = identifier << 5 | 4 | brs, 17
    esi = 1 if frame.error_state_indicator else 0
    back = (esi << 4 | _DLC[size]) << 8 * size | int.from_bytes(frame.data, "big")
    back_width = 5 + 8 * size
    state, first = _stuff(front, front_width, _START)
    _, second = _stuff(back, back_width, state)
    # A stuff bit behind the last bit before the stuff count is not sent: the first fixed stuff bit takes its place.
    second -= _ends_full(front << back_width | back, front_width + back_width)
    if _ends_full(front, front_width):  # the stuff bit behind BRS is sent at the new rate
        first, second = first - 1, second + 1
    # The delimiter is data.
    nominal, data = front_width + first + TRAILER - 1, back_width + second + _fd_tail(size) + 1
    return FrameBits(nominal, data) if brs else FrameBits(nominal + data, 0)


#: Bits from SOF to BRS of a CAN FD frame, with 11 and with 29 bits of identifier.
_FD_FRONT = (17, 36)


def _fd_tail(size: int) -> int:
    """Stuff count and CRC of a CAN FD frame, with their fixed stuff bits."""
    check = 4 + (17 if size <= 16 else 21)
    return check + 1 + check // 4


# ---------------------------------------------------------------------- stuffing

#: A state is 2 × (length of the run − 1) + level, for runs of one to four equal bits; this one is before all bits.
_START = 10


def _step(state: int, bit: int) -> tuple[int, int]:
    """Return the state after a bit, and the stuff bits sent behind it."""
    if state == _START:
        return bit, 0
    level, run = state & 1, (state >> 1) + 1
    if bit != level:
        return bit, 0
    if run + 1 < 5:
        return 2 * run + level, 0
    return 1 - level, 1  # the stuff bit begins a new run


@cache
def _table(width: int) -> bytes:
    """Return for each state and number of up to 8 bits: the state after them × 8 + the stuff bits."""
    table = []
    for state in range(_START + 1):
        for number in range(1 << width):
            now, count = state, 0
            for place in reversed(range(width)):
                now, more = _step(now, number >> place & 1)
                count += more
            table.append(now << 3 | count)
    return bytes(table)  # small: it stays in the processor's cache


@cache
def _wide(first: int, second: int) -> bytes:
    """Return the same for first + second bits, made of both, from all states but the one before all bits."""
    high, low = _table(first), _table(second)
    out: list[int] = []
    for state in range(_START):
        for number in range(1 << first):
            found = high[state << first | number]
            base, count = found >> 3 << second, found & 7
            out += [after + count for after in low[base : base + (1 << second)]]
    return bytes(out)


@cache
def _tables() -> tuple[bytes, bytes, bytes, list[int]]:
    """Return what eight bits, sixteen, and a CRC of fifteen make of a stuffing state, and `_crc15`."""
    return _table(8), _wide(8, 8), _wide(8, 7), _crc15()


def _stuff(word: int, width: int, state: int) -> tuple[int, int]:
    """Return state and number of stuff bits after the `width` bits of `word`, from `state`."""
    count = 0
    for part in (width % 8, width % 16 & 8) if width % 16 else ():
        if part:
            width -= part
            found = _table(part)[state << part | word >> width]
            state = found >> 3
            count += found & 7
            word &= (1 << width) - 1
    if state == _START and width:
        width -= 8
        found = _table(8)[state << 8 | word >> width]
        return _joined(found, _stuff(word & (1 << width) - 1, width, found >> 3))
    table = _wide(8, 8)
    for pair in _PAIRS[width >> 4](word.to_bytes(width >> 3, "big")):
        found = table[state << 16 | pair]
        state = found >> 3
        count += found & 7
    return state, count


def _joined(first: int, rest: tuple[int, int]) -> tuple[int, int]:
    return rest[0], rest[1] + (first & 7)


#: By how many they are, what reads pairs of bytes.
_PAIRS = [Struct(f">{pairs}H").unpack for pairs in range(40)]


def _ends_full(word: int, width: int) -> int:
    """Return 1 if the last bit of the word is the fifth of a run, behind which a stuff bit follows."""
    return _stuff(word, width, _START)[1] - _stuff(word >> 1, width - 1, _START)[1]


@cache
def _crc15() -> list[int]:
    """Return what 16 bits make of a CRC of 0 (CRC-15: x¹⁵ + x¹⁴ + x¹⁰ + x⁸ + x⁷ + x⁴ + x³ + 1, ISO 11898-1:2015,
    10.4.2.6).
    """
    table, step = [0], 1 << 14
    for _ in range(16):
        step = (step << 1 ^ (0x4599 if step & 0x4000 else 0)) & 0x7FFF
        table.extend([entry ^ step for entry in table])
    return table
