"""Transports: how a packet that is longer than a CAN frame is cut into frames, and which frames are one packet.

1. A transport says of a single frame what it is (`part`); what frames make together is the rule of `Transport`, which
   scanner, reference and columns each carry out by themselves.
2. A message of a transport is matched on packets exactly as others are on frames: identifier, constants, length, fields.
3. Nothing here keeps anything between two calls.

A transport is mostly a table of the kinds of its frames: `IsoTp` and `FastPacket` are nothing else. One whose frames are
told apart otherwise (by their identifiers, say) overrides `part` and `split`.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from math import inf
from typing import TYPE_CHECKING, ClassVar, Literal, NamedTuple

import msgspec
from msgspec.structs import force_setattr

from ...errors import FieldError, SpecError
from ...frames import EXTENDED, FD_LENGTHS, REMOTE, Frame
from . import handshake
from .checks import Crc
from .handshake import AnswerTimes, GivenUp
from .pattern import IdPattern
from .place import caller

if TYPE_CHECKING:
    from .message import Message

#: What a frame is: a whole packet; a packet's first frame; one that follows; one that only steers (flow control, an
#: acknowledgement); one that ends a packet before its end; none of the transport. Of acknowledged packets also: the receiver
#: is ready for the next frames; has taken so many; the sender's last frame; the receiver's last frame.
Role = Literal["single", "first", "next", "control", "abort", "bad", "ready", "taken", "end", "over"]


class FrameNumber(msgspec.Struct, frozen=True, dict=True):
    """A number in a frame: of the `size` bytes from `byte` on (negative: from the end), the bits of `mask`, moved down."""

    byte: int
    mask: int = 0
    size: int = 1
    order: Literal["little", "big"] = "big"

    def __post_init__(self) -> None:
        if not self.mask:
            force_setattr(self, "mask", (1 << 8 * self.size) - 1)

    @cached_property
    def shift(self) -> int:
        """Position of the number's lowest bit."""
        return (self.mask & -self.mask).bit_length() - 1

    @property
    def width(self) -> int:
        """Width of the number in bits."""
        return (self.mask >> self.shift).bit_length()

    def of(self, data: bytes) -> int | None:
        """Return the number in a frame's data; None where the frame is too short."""
        if self.size == 1:
            try:
                return (data[self.byte] & self.mask) >> self.shift
            except IndexError:
                return None
        start = self.byte if self.byte >= 0 else len(data) + self.byte
        piece = data[start : start + self.size] if start >= 0 else b""
        if len(piece) < self.size:
            return None
        return (int.from_bytes(piece, self.order) & self.mask) >> self.shift

    def put(self, data: bytearray, number: int) -> None:
        """Write the number into a frame's data."""
        start = self.byte if self.byte >= 0 else len(data) + self.byte
        old = int.from_bytes(data[start : start + self.size], self.order) & ~self.mask
        data[start : start + self.size] = (old | number << self.shift).to_bytes(self.size, self.order)


class FrameKind(msgspec.Struct, frozen=True):
    """One kind of frame: how it is recognised, and where it has what.

    `match`: numbers that it has. `head` and `tail`: bytes in front of and behind its piece of the packet. `size`: how long
    the packet is, in bytes, `least` to `most`. `number`: which of the following frames it is. `sequence`: a number that all
    frames of one packet share, and frames of another do not. `last`: 1 in the last frame, where frames say so. `over`: only
    frames of more than so many bytes. `name` is for people.
    """

    role: Role
    name: str
    match: tuple[tuple[FrameNumber, int], ...] = ()
    head: int = 1
    tail: int = 0
    size: FrameNumber | None = None
    least: int = 0
    most: int = (1 << 32) - 1
    number: FrameNumber | None = None
    sequence: FrameNumber | None = None
    last: FrameNumber | None = None
    over: int = 0

    def fits(self, data: bytes) -> bool:
        """Return whether a frame with these data is of this kind."""
        return len(data) > self.over and all(bits.of(data) == value for bits, value in self.match)


class FramePart(NamedTuple):
    """What a frame is to its transport.

    `session` tells packets apart that are under way at the same time; frames of one packet have the same. `key` (identifier
    and flags, see `keys`) is that of the packet. `size` is the packet's, of a first frame; None where its last frame says
    that it is the last. `number` is that of a following frame. `reason` says what a frame is that is not a part of a packet:
    "control: flow control", "malformed: length".
    """

    role: Role
    session: Hashable = None
    data: bytes = b""
    key: int = 0
    size: int | None = None
    number: int = 0
    is_last: bool = False
    reason: str = ""
    #: Of an abort (which without a reason is a packet itself): the session that it ends where the first one has no packet
    #: under way. Of a first or single frame: another session whose packet it ends as well.
    other: Hashable = None
    #: Of a first frame: its packet is an acknowledged one. So are the frames of such packets that are seen without it.
    is_acknowledged: bool = False
    #: Of a first frame: nobody can ask for a frame of its packet again. They come in one order, `Transport.gap_s` apart.
    is_broadcast: bool = False


class AddedCheck(NamedTuple):
    """A CRC that a transport adds to packets of several frames: at the front of them, where it begins with the message's
    `check_extra`, or behind them."""

    crc: Crc
    is_in_front: bool


@dataclass(frozen=True)
class Transport:
    """How packets are cut into CAN frames, and the rule by which frames are packets again.

    A *first* frame opens a packet, *next* frames go on with it, a *single* frame is a whole packet. Packets under way
    are kept apart by channel and session (`FramePart.session`), so that senders do not disturb one another.

    * A next frame has the number that is due: the first one `first_number`, then one more each, modulo `modulo`. Another
      number: a frame is missing, and the packet is malformed. With `any_order` next frames may come in any order, each one
      once, unless they are of a broadcast.
    * A frame that is the same as the one before it is *repeated* (a controller that sent again what had arrived): it is
      malformed alone, its packet goes on.
    * All frames of a packet but the last are full: they have the `room` of a next frame. A frame with which the first one's
      size is reached, and which does not say that it is the last although frames do, has no more bytes than are left.
    * A first or single frame of the same session while a packet is open: that packet is malformed, it was restarted.
    * More than `gap_s` seconds (`timeout_s`, of a broadcast perhaps less) between two frames of a session: the packet before
      is malformed, it timed out.
    * `senders` packets may be open at once; when one more begins, the oldest is malformed. With `max_size`, the number of
      bytes of the longest packet (its address aside), this bounds what is kept.

    An *acknowledged* packet is a conversation of two identifiers: what frames of either are, `within` says while it is open.

    * The receiver may say that it is *ready*, before the first next frame.
    * *Next* frames are numbered from 1 on, in blocks; `taken` ends a block: of its frames those up to this number count, and
      each of them must be there. The others do not; they come again in the next block.
    * *end* ends it: `number` bytes of the last frame are none, and its data go behind all.
    * *over*: the receiver knows of an end; a packet that is still open is malformed.
    * One with a fault is malformed at once. Its session stays *lost* until its end, an abort or a time-out: its frames are
      no messages, whatever they look like. So is one whose beginning was not seen, from the first frame on that says so.

    `fd`: its frames are CAN FD. `address` bytes at the beginning of each frame belong to the address: they keep packets
    apart, too, and a packet's data begin with them. `pad` fills frames up (None: they are as short as they can be).
    `also` is another transport by which the same packets may come (that of ISO 11783 beside fast packets): it has
    identifiers of its own, and what is too long for this one is sent by it.
    """

    #: For people, in messages and docs.
    #: What a transport of one's own is written with: a kind of frame, a number in it, what `part` and `steering` give.
    Kind = FrameKind
    Number = FrameNumber
    Part = FramePart
    Steering = handshake.Steering
    AnswerTimes = handshake.AnswerTimes
    title: ClassVar[str] = "transport"
    #: Why devices and twins send no packets of several frames ("" where they do).
    unsendable: ClassVar[str] = ""
    #: The longest time between two frames of a broadcast (s), where that is less than `timeout_s`.
    broadcast_gap_s: ClassVar[float] = inf

    fd: bool = False
    address: int = 0
    pad: int | None = None
    max_size: int = 4095
    timeout_s: float = 1.0
    senders: int = 256
    also: Transport | None = field(default=None, init=False, repr=False)

    #: The kinds of its frames, in the order of trial.
    kinds: tuple[FrameKind, ...] = field(default=(), kw_only=True, repr=False)
    modulo: int = field(default=16, kw_only=True, repr=False)
    first_number: int = field(default=1, kw_only=True, repr=False)
    any_order: bool = field(default=False, kw_only=True, repr=False)

    def __post_init__(self) -> None:
        for name, least in (("max_size", 1), ("senders", 1), ("address", 0)):
            if getattr(self, name) < least:
                raise SpecError(f"{caller()}: {name} of {self.title} is at least {least}")
        if not self.timeout_s > 0:
            raise SpecError(
                f"{caller()}: timeout_s of {self.title} is a time in seconds, not {self.timeout_s}"
            )

    @property
    def frame_size(self) -> int:
        """Size of a full frame in bytes."""
        return 64 if self.fd else 8

    @property
    def longest(self) -> int:
        """Largest size of a packet in bytes, with its address."""
        return self.max_size + self.address

    def gap_s(self, first: FramePart) -> float:
        """Return the longest time between two frames (s) of the packet that this first frame begins."""
        return min(self.timeout_s, self.broadcast_gap_s) if first.is_broadcast else self.timeout_s

    @property
    def min_size(self) -> int:
        """Smallest size of a packet in bytes, with its address."""
        least = [kind.least for kind in self.kinds if kind.role in ("single", "first")]
        return self.address + min(least, default=0)

    @property
    def overhead(self) -> int:
        """Number of bytes that the transport adds to a packet of several frames (a check)."""
        return 0

    @property
    def added_check(self) -> AddedCheck | None:
        """CRC that `unwrapped` removes; None where it removes anything else or nothing."""
        return None

    def carries(self, size: int) -> bool:
        """Return whether a packet may have so many bytes; `max_size` is asked beside this."""
        return True

    @property
    def patterns(self) -> tuple[tuple[IdPattern, bool], ...]:
        """Identifiers of frames that it carries beside those of its messages, and whether they have 29 bits."""
        return ()

    def identifier(self, direction: str | None) -> IdPattern | None:
        """Return the identifier of packets in a direction ("to device", "from device"), where the transport names it."""
        return None

    # ------------------------------------------------------------------ reading

    def part(self, key: int, data: bytes) -> FramePart:
        """Return what a frame is; `key` is without the flag of CAN FD."""
        address = data[: self.address]
        body = data[self.address :] if self.address else data
        for kind, is_sure in self.by_telling[body[self.telling]] if body else ():
            if (is_sure and len(body) > kind.over) or kind.fits(body):
                return self._part(kind, key, address, body)
        return FramePart("bad", reason=f"malformed: no frame of {self.title}")

    def conversations(self, key: int) -> tuple[Hashable, ...]:
        """Return the sessions whose acknowledged packets frames of a key may belong to."""
        return ()

    def within(self, so_far: Sequence[FramePart], key: int, data: bytes) -> FramePart | None:
        """Classify a frame while an acknowledged packet with the parts `so_far` is open; None leaves it to
        `part`.

        Of blocks before the last one parts may be left out. Of a lost session `so_far` is one part that is
        *ready*.
        """
        return None

    @cached_property
    def most_frames(self) -> int:
        """Largest number of frames of an acknowledged packet, with acknowledgements and repeated frames."""
        return 4 * (2 + -(-self.longest // max(1, self.room(self.frame_size))))

    @cached_property
    def has_conversations(self) -> bool:
        """True if the transport has acknowledged packets."""
        return type(self).within is not Transport.within

    @cached_property
    def telling(self) -> int:
        """The byte that tells kinds of frames apart: the first one behind the address, or the last one."""
        bytes_asked = {bits.byte for kind in self.kinds for bits, _ in kind.match}
        return -1 if bytes_asked == {-1} else 0

    @cached_property
    def by_telling(self) -> list[list[tuple[FrameKind, bool]]]:
        """By that byte of a frame, the kinds that it may be, and whether that byte says all."""
        found: list[list[tuple[FrameKind, bool]]] = []
        for byte in range(256):
            data = bytes([byte])
            kinds = [
                (kind, [bits for bits, _ in kind.match if self._asks_more(bits)])
                for kind in self.kinds
                if all(self._asks_more(bits) or bits.of(data) == value for bits, value in kind.match)
            ]
            found.append([(kind, not others) for kind, others in kinds])
        return found

    def _asks_more(self, bits: FrameNumber) -> bool:
        """Return whether a number is in other bytes than the one that tells kinds apart."""
        return bits.byte != self.telling or bits.size > 1

    def _part(self, kind: FrameKind, key: int, address: bytes, body: bytes) -> FramePart:
        if kind.role == "control":
            return FramePart("control", reason=f"control: {kind.name}")
        sequence = kind.sequence.of(body) if kind.sequence is not None else None
        session = (key, address, sequence)
        piece = body[kind.head : len(body) - kind.tail]
        number = kind.number.of(body) if kind.number is not None else 0
        is_last = kind.last is not None and kind.last.of(body) == 1
        if kind.role == "next" and number is not None and kind.head + kind.tail <= len(body):
            return FramePart("next", session, piece, key, None, number, is_last)
        size = kind.size.of(body) if kind.size is not None else None
        if number is None or (kind.size is not None and size is None) or kind.head + kind.tail > len(body):
            return FramePart("bad", reason="malformed: length")
        if size is not None and not kind.least <= size <= kind.most:
            return FramePart("bad", reason="malformed: length")
        if kind.role == "single":
            if size is not None and size > len(piece):
                return FramePart("bad", reason="malformed: length")
            return FramePart("single", session, address + piece[:size], key)
        if kind.role == "first":
            if size is not None and size > self.max_size:
                return FramePart("bad", reason="malformed: too long")
            total = None if size is None else size + self.address
            return FramePart("first", session, address + piece, key, total, number, is_last)
        return FramePart("bad", reason=f"malformed: no frame of {self.title}")

    def room(self, length: int) -> int:
        """Return how many bytes of a packet a full next frame has, the first frame having had `length` bytes of data."""
        following = self.following
        return length - self.address - following.head - following.tail

    @cached_property
    def full_lengths(self) -> frozenset[int]:
        """`lengths()`, asked once."""
        return frozenset(self.lengths())

    def lengths(self) -> tuple[int, ...]:
        """Return how many bytes of data a first frame may have that is not the only one: those of a full frame."""
        return tuple(n for n in FD_LENGTHS if n >= 8) if self.fd else (8,)

    @cached_property
    def following(self) -> FrameKind:
        """The kind of the frames that follow the first one."""
        return next(kind for kind in self.kinds if kind.role == "next")

    def unwrapped(self, data: bytes, extra: bytes) -> bytes | None:
        """Return a packet of several frames without what the transport has added to it (a check), or None where that
        is wrong.

        `extra` is the `check_extra` of the message that its identifier is of.
        """
        return data

    # ------------------------------------------------------------------ handshakes

    @property
    def answer_times(self) -> handshake.AnswerTimes:
        """Times that both ends of a packet with a handshake wait for each other."""
        return AnswerTimes(*[self.timeout_s] * 4)

    @cached_property
    def has_handshake(self) -> bool:
        """True if the transport has packets whose senders wait for a go-ahead."""
        return type(self).go_ahead is not Transport.go_ahead

    def pause_s(self, key: int) -> float:
        """Return how long to wait between two frames of a packet (s), whose first one has this key; a go-ahead says
        otherwise.
        """
        return 0.0

    def in_turn(self, key: int) -> int:
        """Return the shared key of packets that must not be under way at once, from the key of a first frame."""
        return key

    def go_ahead(self, key: int, data: bytes, start: int = 1, frames: int = 0) -> tuple[int, bytes] | None:
        """Return the frame (key and data) with which the receiver of a packet lets its sender go on; None where none
        is needed.

        `key` and `data` are those of the packet's first frame. The receiver lacks `frames` frames (0: all that follow) from
        place `start` on. The answer may ask for fewer: `steering` of it says for how many.
        """
        return None

    def acknowledgement(self, key: int, data: bytes) -> tuple[int, bytes] | None:
        """Return the frame by which the receiver says that it has the packet with this first frame; None where it says
        nothing.
        """
        return None

    def abort(self, key: int, data: bytes, why: GivenUp, *, by_sender: bool) -> tuple[int, bytes] | None:
        """Return the frame by which one end gives up the packet with this first frame; None where ends fall silent."""
        return None

    def steering(self, key: int, data: bytes) -> handshake.Steering | None:
        """Return what a frame says to the sender of a packet; None of frames that steer nothing."""
        return None

    def frame(self, key: int, data: bytes) -> Frame:
        """Return a frame of its own: what these give."""
        return Frame(key & 0x1FFF_FFFF, data, is_extended_id=bool(key & EXTENDED), is_fd=self.fd)

    def addressed(self, key: int, data: bytes) -> dict[str, int] | None:
        """Return what the address in a frame captures beside its identifier; None where it is for no device."""
        return {}

    def is_for(
        self, key: int, data: bytes, message: Message, known: Mapping[str, object], sent: Iterable[Message]
    ) -> bool:
        """Return whether the packet that a first frame begins may be this message, to who takes it.

        `known` are the values of fields that messages to it and of it have, as its credentials; `sent` is what it sends
        itself.
        """
        packet = self.part(key, data).key
        captures = message.identifier.match(packet & 0x1FFF_FFFF)
        inside = self.addressed(key, data)
        if captures is None or inside is None or message.extended != bool(packet & EXTENDED):
            return False
        return all(known.get(name, number) == number for name, number in (captures | inside).items())

    # ------------------------------------------------------------------ writing

    def numbered_by(self, key: int) -> int:
        """Return what of a packet's key its sequence numbers are counted for: all of it."""
        return key

    def split(self, key: int, data: bytes, sequence: int = 0, extra: bytes = b"") -> list[tuple[int, bytes]]:
        """Return the frames of a packet, as key and data; `sequence` counts the packets of a sender.

        Raises `FieldError` for a packet that is too long.
        """
        if len(data) > self.longest:
            raise FieldError(f"a packet of {len(data)} bytes; {self.title} has {self.longest} at most")
        address, body = data[: self.address], data[self.address :]
        room = self.frame_size - self.address
        for kind in self.kinds:
            longest = min(kind.most, room - kind.head - kind.tail)
            if kind.role == "single" and kind.least <= len(body) <= longest:
                return [(key, self._frame(kind, address, body, sequence, size=len(body)))]
        for kind in self.kinds:
            if kind.role == "first" and kind.least <= len(body) <= kind.most:
                break
        else:
            raise FieldError(f"a packet of {len(body)} bytes, which {self.title} cannot carry")
        at = room - kind.head - kind.tail
        frames = [(key, self._frame(kind, address, body[:at], sequence, size=len(body)))]
        following, number = self.following, self.first_number
        step = room - following.head - following.tail
        while at < len(body):
            piece, at = body[at : at + step], at + step
            numbers = {"number": number % self.modulo, "last": at >= len(body)}
            frames.append((key, self._frame(following, address, piece, sequence, **numbers)))
            number += 1
        return frames

    def _frame(self, kind: FrameKind, address: bytes, piece: bytes, sequence: int, **numbers: int) -> bytes:
        body = bytearray(bytes(kind.head) + piece + bytes(kind.tail))
        for bits, value in kind.match:
            bits.put(body, value)
        if kind.sequence is not None:
            kind.sequence.put(body, sequence & kind.sequence.mask >> kind.sequence.shift)
        for name, number in numbers.items():
            bits_of = getattr(kind, name)
            if bits_of is not None:
                bits_of.put(body, number)
        return self.padded(address + bytes(body), kind.over + 1)

    def padded(self, data: bytes, least: int = 0) -> bytes:
        """Return a frame's data filled up to a length that a frame may have."""
        least = max(least, 8 if self.pad is not None else 0, len(data))
        length = next(n for n in FD_LENGTHS if n >= least) if self.fd else least
        return data.ljust(length, bytes([self.pad if self.pad is not None else 0xCC]))

    @property
    def describe(self) -> str:
        """In words for people."""
        own = f"{self.title}, packets of up to {self.max_size} bytes"
        return own if self.also is None else f"{own}; or by {self.also.describe}"

    def is_own(self, key: int) -> bool:
        """Return whether frames of a key, without the flag of CAN FD, are the transport's own, whatever its messages."""
        return not key & REMOTE and any(
            is_long == bool(key & EXTENDED) and pattern.match(key & 0x1FFF_FFFF) is not None
            for pattern, is_long in self.patterns
        )


__all__ = ["FrameKind", "FrameNumber", "FramePart", "Role", "Transport"]
