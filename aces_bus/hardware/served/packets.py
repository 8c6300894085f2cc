"""What a served bus and its clients say to each other: packets of frames, the same both ways.

1. Every number from the other side is checked before it is used; what is wrong raises `PacketError` and nothing else.
2. A packet is at most 64 KiB, so what waits for its end is bounded.

A packet is the length of its body (u16, little-endian), its kind (u8), a zero byte, and the body. `CLASSIC` and `LONG` hold
records of frames one behind another, of 24 and 80 bytes: so many frames cost one call of the system, and one of `struct`.
What else is said is MessagePack.

A client says `HELLO`; the server answers `WELCOME`, or `REFUSED` with the reason as text, and closes. Then frames go both
ways. `REPORT` tells a client how many of its frames the bus has taken, so that it can stop when its mailboxes are full.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from struct import Struct
from typing import TYPE_CHECKING, Annotated, Final, Literal, TypeVar

import msgspec

from ...errors import AcesError, CallerError
from ...frames import FD_LENGTHS, Frame, message_to_frame
from ..simulated.bus_event import SimulatedBusEvent

if TYPE_CHECKING:
    from can import Message

T = TypeVar("T")

VERSION: Final = 2
#: Of a body, in bytes.
MOST = 0xFFFF

HELLO, WELCOME, REFUSED, CLASSIC, LONG, REPORT, EVENT, RESTART, ABORT, QUERY, STATUS = range(1, 12)
#: Those that hold frames.
FRAMES = (CLASSIC, LONG)

HEAD = Struct("<HBx")
#: Time (ns since 1970), identifier, flags, length, data.
CLASSIC_RECORD = Struct("<qIBB2x8s")
LONG_RECORD = Struct("<qIBB2x64s")
#: A packet with one record: what most packets are.
CLASSIC_PACKET = Struct("<HBxqIBB2x8s")

EXTENDED, REMOTE, ERROR, FD, BITRATE_SWITCH, ERROR_STATE, OWN = 1, 2, 4, 8, 16, 32, 64

_FD_LENGTHS = frozenset(FD_LENGTHS)


class PacketError(AcesError):
    """The other side said something that is none of these packets."""


def packet(kind: int, body: bytes = b"") -> bytes:
    """Return a packet."""
    if len(body) > MOST:
        raise CallerError(f"a packet of {len(body)} bytes; {MOST} is the most")
    return HEAD.pack(len(body), kind) + body


def split_packets(data: bytes) -> tuple[list[tuple[int, bytes]], bytes]:
    """Return the whole packets at the front of `data` as (kind, body), and what is left."""
    found: list[tuple[int, bytes]] = []
    at, end = 0, len(data)
    while end - at >= 4:
        size, kind = HEAD.unpack_from(data, at)
        if not 1 <= kind <= STATUS:
            raise PacketError(f"a packet of kind {kind}, which does not exist")
        if end - at - 4 < size:
            break
        found.append((kind, data[at + 4 : at + 4 + size]))
        at += 4 + size
    return found, data[at:] if at else data


# ---------------------------------------------------------------------- frames


def unpack_records(kind: int, body: bytes) -> Iterator[tuple[int, int, int, int, bytes]]:
    """Yield (time, identifier, flags, length, padded data) of each frame in a packet, checked."""
    form, most = (CLASSIC_RECORD, 8) if kind == CLASSIC else (LONG_RECORD, 64)
    if len(body) % form.size:
        raise PacketError(f"{len(body)} bytes of frames of {form.size} bytes")
    for found in form.iter_unpack(body):
        _, identifier, flags, length, _ = found
        if flags == EXTENDED or not flags:
            if length <= 8 and identifier <= (0x1FFF_FFFF if flags else 0x7FF):
                yield found
                continue
        _check(identifier, flags, length, most)
        yield found


def _check(identifier: int, flags: int, length: int, most: int) -> None:
    if flags & ERROR:
        raise PacketError("an error frame, which cannot be sent")
    if identifier > (0x1FFF_FFFF if flags & EXTENDED else 0x7FF):
        raise PacketError(f"identifier {identifier:#x} does not exist")
    if flags & FD:
        if length > most or length not in _FD_LENGTHS or flags & REMOTE:
            raise PacketError(f"a CAN FD frame of {length} bytes does not exist")
    elif flags & (BITRATE_SWITCH | ERROR_STATE) or length > (15 if flags & REMOTE else 8):
        raise PacketError(f"a classic frame of {length} bytes with flags {flags:#x} does not exist")


def single_frames(data: bytes) -> list[Frame] | None:
    """Return the frames of packets that hold a plain one each, as they come while a bus is busy; None where one is
    another.
    """
    if len(data) % CLASSIC_PACKET.size:
        return None
    found: list[Frame] = []
    for size, kind, time_ns, identifier, flags, length, padded in CLASSIC_PACKET.iter_unpack(data):
        if size != CLASSIC_RECORD.size or kind != CLASSIC or flags or length > 8 or identifier > 0x7FF:
            return None
        seconds = time_ns / 1e9
        found.append(
            Frame(identifier, padded[:length], seconds, None, False, False, False, False, False, False, True)
        )
    return found


def pack_record(time_ns: int, identifier: int, flags: int, length: int, data: bytes) -> bytes:
    """Return a frame as a record; short where it fits."""
    form = LONG_RECORD if len(data) > 8 and length > 8 and not flags & REMOTE else CLASSIC_RECORD
    return form.pack(time_ns, identifier, flags, length, data)


def unpacked(record: bytes) -> tuple[int, int, int, int, bytes]:
    """Return (time, identifier, flags, length, padded data) of a record of our own."""
    found: tuple[int, int, int, int, bytes] = (
        CLASSIC_RECORD if len(record) == CLASSIC_RECORD.size else LONG_RECORD
    ).unpack(record)
    return found


def frame_record(frame: Frame, time_ns: int, more: int = 0) -> bytes:
    """Return a frame as a record; `more` is added to its flags."""
    if not (
        frame.is_extended_id
        or frame.is_remote_frame
        or frame.is_fd
        or frame.bitrate_switch
        or frame.error_state_indicator
    ):
        data = frame.data
        return CLASSIC_RECORD.pack(time_ns, frame.arbitration_id, more, len(data), data)
    flags = (
        more
        | (EXTENDED if frame.is_extended_id else 0)
        | (REMOTE if frame.is_remote_frame else 0)
        | (FD if frame.is_fd else 0)
        | (BITRATE_SWITCH if frame.bitrate_switch else 0)
        | (ERROR_STATE if frame.error_state_indicator else 0)
    )
    return pack_record(time_ns, frame.arbitration_id, flags, frame.length, frame.data)


def record_to_frame(
    identifier: int,
    flags: int,
    length: int,
    data: bytes,
    seconds: float | None = None,
    is_rx: bool | None = None,
) -> Frame:
    """Return the frame of a checked record, with a time (s) and direction where they are given."""
    if not flags:
        return Frame(
            identifier, data[:length], seconds, None, False, False, False, False, False, False, is_rx
        )
    remote = bool(flags & REMOTE)
    return Frame(
        identifier,
        b"" if remote else data[:length],
        seconds,
        None,
        bool(flags & EXTENDED),
        remote,
        False,
        bool(flags & FD),
        bool(flags & BITRATE_SWITCH),
        bool(flags & ERROR_STATE),
        is_rx,
        length if remote else None,
    )


def packed(many: Iterable[bytes]) -> Iterator[bytes]:
    """Yield records as packets; consecutive records of one size share a packet, as far as they fit."""
    run: list[bytes] = []
    size = total = 0
    for record in many:
        if len(record) != size or total + size > MOST:
            if run:
                yield HEAD.pack(total, CLASSIC if size == CLASSIC_RECORD.size else LONG) + b"".join(run)
            run, size, total = [], len(record), 0
        run.append(record)
        total += size
    if run:
        yield HEAD.pack(total, CLASSIC if size == CLASSIC_RECORD.size else LONG) + b"".join(run)


def frames_packet(frames: Sequence[Frame], time_ns: int) -> bytes:
    """Return frames as packets, one behind another."""
    if 0 < len(frames) <= MOST // CLASSIC_RECORD.size:
        pack, out = CLASSIC_RECORD.pack, [HEAD.pack(CLASSIC_RECORD.size * len(frames), CLASSIC)]
        for frame in frames:
            if (
                frame.is_extended_id
                or frame.is_remote_frame
                or frame.is_fd
                or frame.bitrate_switch
                or frame.error_state_indicator
            ):
                break
            data = frame.data
            out.append(pack(time_ns, frame.arbitration_id, 0, len(data), data))
        else:
            return b"".join(out)
    return b"".join(packed([frame_record(frame, time_ns) for frame in frames]))


def message_packet(message: Message, time_ns: int = 0) -> bytes:
    """Return a message as a packet of its own. Raises `CallerError` when it cannot exist on a bus."""
    data = message.data
    identifier, length = message.arbitration_id, message.dlc
    flags = EXTENDED if message.is_extended_id else 0
    if not (message.is_fd or message.is_remote_frame or message.is_error_frame):
        if len(data) == length <= 8 and 0 <= identifier <= (0x1FFF_FFFF if flags else 0x7FF):
            return CLASSIC_PACKET.pack(24, CLASSIC, time_ns, identifier, flags, length, data)
    if message.is_error_frame:
        raise CallerError("an error frame is not sent but made by faults")
    frame = message_to_frame(message)  # refuses what cannot exist
    if not 0 <= frame.length <= (64 if frame.is_fd else 8):
        raise CallerError(f"a frame of {frame.length} bytes cannot be sent")
    record = frame_record(frame, time_ns)
    return HEAD.pack(len(record), CLASSIC if len(record) == CLASSIC_RECORD.size else LONG) + record


# ---------------------------------------------------------------------- the rest


class Hello(msgspec.Struct, frozen=True):
    """Who a client is. Rates in bit/s, 0: whatever the bus has.

    `fd`: takes CAN FD. `own`: receives its own frames, too. `looks`: joins no bus and only asks. `restart_ms`: comes back
    from bus-off after so long; None: when it is restarted.
    """

    channel: Annotated[str, msgspec.Meta(max_length=64)] = ""
    bitrate: int = 0
    data_bitrate: int = 0
    listen_only: bool = False
    fd: bool = False
    own: bool = False
    looks: bool = False
    restart_ms: Annotated[int, msgspec.Meta(ge=0, le=0xFFFF_FFFF)] | None = None
    version: Literal[2] = VERSION


class Welcome(msgspec.Struct, frozen=True):
    """What bus a client is on. `mailboxes`: frames it may have under way; `physics`: it has bit rates and arbitration."""

    channel: str
    mailboxes: int
    physics: bool
    bitrate: int
    data_bitrate: int
    version: Literal[2] = VERSION


class TransmitReport(msgspec.Struct, frozen=True):
    """How many of a client's frames are off its mailboxes, how many of them unsent, and how many it did not get in time."""

    taken: int
    rejected: int
    dropped: int


_KINDS = {Hello: HELLO, Welcome: WELCOME, TransmitReport: REPORT, SimulatedBusEvent: EVENT}


def value_packet(value: Hello | Welcome | TransmitReport | SimulatedBusEvent) -> bytes:
    """Return a value as a packet."""
    return packet(_KINDS[type(value)], msgspec.msgpack.encode(value))


def read_value(body: bytes, wanted: type[T]) -> T:
    """Return what `value_packet` packed."""
    try:
        return msgspec.msgpack.decode(body, type=wanted)
    except (msgspec.MsgspecError, AcesError) as error:
        raise PacketError(
            f"no {wanted.__name__} of a served bus, in version {VERSION} of its packets: {error}"
        ) from error
