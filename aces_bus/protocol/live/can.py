"""The CAN scanner: frames in, records out.

1. No I/O, no clock, no thread: `feed` is given frames and returns records.
2. The usual frame costs one table look-up and one generated call. Everything unusual (the first frame of an identifier,
   frames with flags, requests and replies, losses) is beside that path.
3. Each frame ends in exactly one bin of `counts`.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from functools import lru_cache, partial
from itertools import repeat
from typing import TYPE_CHECKING, Any

from construct import ConstructError

from ...errors import AcesError, CallerError
from ...frames import EXTENDED, FD, REMOTE, AnyFrame, key_of
from ..counts import ScanCounts
from ..declare.message import GivenWay, Message, way_of
from ..declare.packet import ContentError, LengthError, WrongCheckError, key_image
from ..declare.protocol import Variant
from ..declare.transport import Transport
from ..record import CarriedBytes, Meta, Record, Unknown
from .decide import REMEMBERED, Decider, Decode

if TYPE_CHECKING:
    from ...frame_table import FrameTable
    from .reassemble import Packet

# ---------------------------------------------------------------------- which messages the frames of a key may be
#
# 1. What hangs on the messages alone is made once for all scanners of a variant and direction.
# 2. Few numbers are spelt out in a table; patterns with many are searched by the bits that never vary, not tried in turn.


#: Identifier patterns up to this many numbers are spelt out in the table; larger ones are matched and then remembered.
SPELT_OUT = 4096
#: The same where all of them together have more numbers than are remembered (a database of J1939 messages).
SPELT_OUT_OF_MANY = 16


_KINDS = EXTENDED | REMOTE | FD


def _kinds_of(message: Message) -> list[int]:
    """Return the flags of the keys of a message's frames."""
    return [key_of(0, extended=message.extended, remote=message.remote, fd=fd) for fd in message.formats]


class _Index:
    """Messages by those bits of their keys that never vary: what a key may be is found without trying them all."""

    def __init__(self, messages: Sequence[Message]) -> None:
        self._by_mask: dict[int, dict[int, list[tuple[int, Message]]]] = {}
        for number, message in enumerate(messages):
            flags = _kinds_of(message)[0]
            mask = message.identifier.fixed | _KINDS
            mask = mask & ~FD if message.any_format else mask
            key = (message.identifier.constant | flags) & mask
            self._by_mask.setdefault(mask, {}).setdefault(key, []).append((number, message))

    def of(self, key: int) -> list[Message]:
        """Return the messages whose identifier and flags fit, in order."""
        identifier = key & 0x1FFF_FFFF
        found = [
            (number, message)
            for mask, table in self._by_mask.items()
            for number, message in table.get(key & mask, ())
            if message.identifier.match(identifier) is not None and key & _KINDS in _kinds_of(message)
        ]
        if len(found) > 1:
            found.sort(key=lambda entry: entry[0])
        return [message for _, message in found]


class _Keys:
    """What the keys of CAN frames may be, by the messages alone: the same for every scanner of a variant and direction."""

    def __init__(self, messages: Sequence[Message]) -> None:
        patterns: list[Message] = []
        by_key: dict[int, list[Message]] = {}
        total = sum(len(m.identifier) for m in messages if len(m.identifier) <= SPELT_OUT)
        most = SPELT_OUT if total <= REMEMBERED else SPELT_OUT_OF_MANY
        for message in messages:
            if len(message.identifier) <= most:
                for flags in _kinds_of(message):
                    for identifier in message.identifier:
                        by_key.setdefault(identifier | flags, []).append(message)
            else:
                patterns.append(message)
        self.has_patterns = bool(patterns)
        self.patterns, self.all = _Index(patterns), _Index(messages)
        same: dict[tuple[Message, ...], tuple[Message, ...]] = {}
        #: The candidates of each key that is spelt out.
        self.spelt_out: dict[int, tuple[Message, ...]] = {}
        for key, known in by_key.items():
            found = (*known, *self.patterns.of(key)) if patterns else tuple(known)
            self.spelt_out[key] = same.setdefault(found, found)


@lru_cache(maxsize=32)
def _keys(messages: tuple[Message, ...]) -> _Keys:
    return _Keys(messages)


class CanDecider(Decider):
    """One variant's part of a CAN scanner: from key to the function that decodes it."""

    def __init__(self, variant: Variant, direction: GivenWay | None, *, raw: bool) -> None:
        super().__init__(variant, direction, raw=raw)
        #: The keys of frames (None), and of the packets of each transport.
        self._spaces = {
            transport: _keys(tuple(m for m in self.messages if transport in m.ways))
            for transport in dict.fromkeys((None, *(way for m in self.messages for way in m.ways)))
        }
        #: The candidates of each key that is spelt out.
        self.spelt_out = self._spaces[None].spelt_out

    @property
    def transports(self) -> list[Transport]:
        """Transports of the messages that are longer than a frame."""
        return [transport for transport in self._spaces if transport is not None]

    def carried_by(self, key: int) -> Transport | None:
        """Return the transport whose frames have a key, which is without the flag of CAN FD."""
        for transport, keys in self._spaces.items():
            if transport is not None and (
                transport.is_own(key) or any(m.transport == transport for m in keys.all.of(key))
            ):
                return transport
        return None

    def candidates(self, key: int, transport: Transport | None = None) -> list[Message]:
        """Return the messages whose identifier and flags fit, in order; of a `transport`, those of its packets."""
        keys = self._spaces.get(transport)
        return keys.all.of(key) if keys is not None else []

    @staticmethod
    def matching(key: int, messages: Iterable[Message]) -> list[Message]:
        """Return those of `messages` whose identifier and flags fit."""
        identifier = key & 0x1FFF_FFFF
        return [
            m for m in messages if key & _KINDS in _kinds_of(m) and m.identifier.match(identifier) is not None
        ]

    def lookup(self, key: int, transport: Transport | None = None) -> Decode | None:
        """Return the function that decodes a key; None for one that no message has."""
        keys = self._spaces.get(transport)
        found: Sequence[Message] = keys.spelt_out.get(key, ()) if keys is not None else ()
        if not found and keys is not None and keys.has_patterns:
            found = keys.patterns.of(key)
        return self.decide(found, alone=True) if found else None

    def reason(self, key: int, data: bytes, transport: Transport | None = None) -> str:
        """Why a frame, or a packet of a `transport`, was not decoded."""
        need = self.need_of(key)
        if need:
            self.forget_need()
            return need
        image = key_image(key, data)
        for message in self.candidates(key, transport):
            try:
                message.struct.parse(image, raw=True)
            except LengthError as error:
                return f"malformed: length {len(data)}, {error.what}"
            except WrongCheckError:
                return "malformed: checksum"
            except ContentError as error:
                if error.what and not message.request_fields:
                    return f"malformed: {error.what}"
            except (ConstructError, AcesError):
                continue
        return "unknown"


#: By the two highest flags of a frame table, RX and TX: whether a frame was received.
_WAYS = (None, True, False, True)


class CanScanner:
    """Finds the messages of one or more protocols in CAN frames; made by `make_scanner`.

    `feed(frames)` takes python-can messages or `Frame`s and returns their records in order; with `include_unknown`,
    `Unknown` for the others. It raises nothing for any frame that python-can or `Frame` can hold.
    """

    link = "can"

    def __init__(
        self,
        variants: Sequence[Variant],
        *,
        direction: GivenWay | None = None,
        include_unknown: bool = False,
        raw: bool = False,
    ) -> None:
        self.variants = tuple(variants)
        self.direction = way_of(direction)
        self.include_unknown = include_unknown
        self.wires = [CanDecider(variant, direction, raw=raw) for variant in variants]
        #: By key, what decodes it; made when the first frame with that key comes.
        self._table: dict[int, Decode] = {}
        #: By key, the requests that a frame of our own may be.
        self._asked: dict[Hashable, list[tuple[CanDecider, Message]]] = {}
        #: Keys that no request has; they are among `_asked`, and bounded as these.
        self._unasked: set[int] = set()
        #: By key and data, requests of our own with their fields: polls are the same frames again and again.
        self._requests: dict[tuple[int, bytes], tuple[CanDecider, str, Mapping[str, Any]]] = {}
        self._counts = ScanCounts()
        #: Keys that two protocols claim, with their names, first the one that wins.
        self.contested: dict[int, tuple[str, str]] = {}
        if len(self.wires) > 1:
            owners: dict[int, str] = {}
            for wire in self.wires:
                for key in wire.spelt_out:
                    owner = owners.setdefault(key, wire.variant.label)
                    if owner != wire.variant.label:
                        self.contested.setdefault(key, (owner, wire.variant.label))
        #: Records given out, and how many of them were `Unknown`.
        self._given = [0, 0]
        self._carriers = [
            _Carrier(t) for t in dict.fromkeys(t for wire in self.wires for t in wire.transports)
        ]
        #: By key (without the flag of CAN FD), whose frames they are.
        self._carrier_of: dict[int, _Carrier | None] = {}
        #: Frames of packets that were decoded, beside one each; those that were pending when the capture ended.
        self._beside = self._left = 0
        #: The number of the frame that is looked at, and where what was given out last came from; see `feed_numbered`.
        self._number = 0
        self._origins: list[int] | None = None
        # The methods' places are taken by closures: no look-up of `self` in the hot loop.
        self.__dict__["feed"] = self._make_feed()
        self.__dict__["take"] = self._make_take()

    def _lookup(self, key: int) -> Decode | None:
        """Return the function that decodes a key, which is remembered: the protocols that claim it, in order."""
        found = [decode for wire in self.wires if (decode := wire.lookup(key)) is not None]
        if not found:
            return None
        decode = found[0] if len(found) == 1 else self._chain(found)
        if len(self._table) < REMEMBERED:
            self._table[key] = decode
        return decode

    def _chain(self, found: Sequence[Decode]) -> Decode:
        def decode(*frame: AnyFrame) -> Any:
            for decode_message in found:
                try:
                    record = decode_message(*frame)
                except struct.error:
                    continue
                if record is not None:
                    self._forget_needs()
                    return record
            return None

        return decode

    def _forget_needs(self) -> None:
        for wire in self.wires:
            wire.forget_need()

    @property
    def counts(self) -> ScanCounts:
        """Number of frames so far by their outcome."""
        counts = self._counts
        counts.records = self._given[0] - self._given[1]
        counts.decoded = counts.records + self._beside
        counts.pending = self._left + sum(carrier.reassembler.pending for carrier in self._carriers)
        counts.total = counts.decoded + counts.pending + sum(counts.reasons.values())
        counts.missed = sum(wire.missed for wire in self.wires)
        return counts

    def feed(self, frames: Iterable[AnyFrame], /) -> list[Record]:
        """Return the records of `frames`, in order; see the class."""
        return self._make_feed()(frames)

    def take(self, frame: Any, /) -> Any:
        """Take one usual frame, and return its record without a list around it; None: nothing was done with it, `feed` is to
        have it.

        Usual are 11-bit data frames whose identifier has come before.
        """
        return self._make_take()(frame)

    def _make_take(self) -> Callable[[Any], Any]:
        table, given, error = self._table, self._given, struct.error

        def take(frame: Any) -> Any:
            if frame.is_extended_id or frame.is_remote_frame or frame.is_fd or frame.is_error_frame:
                return None
            try:
                record = table[key := frame.arbitration_id](
                    data := b"" + frame.data, key, frame.timestamp, frame.channel, data, frame.is_rx
                )
            except (KeyError, error):
                return None
            if record is not None:
                given[0] += 1
            return record

        return take

    def _make_feed(self) -> Callable[[Iterable[Any]], list[Any]]:
        """Return the hot loop, as a closure: what it touches for each frame are local names."""
        table = self._table
        given = self._given
        unusual = self._unusual
        error = struct.error

        def feed(frames: Iterable[AnyFrame]) -> list[Record]:
            out: list[Record] = []
            try:
                each = iter(frames)
            except TypeError:
                name = type(frames).__name__
                raise CallerError(f"feed takes several frames, not one {name}: feed([frame])") from None
            for frame in each:
                if frame.is_extended_id or frame.is_remote_frame or frame.is_fd or frame.is_error_frame:
                    unusual(frame, out)
                    continue
                try:
                    # Adding to b"" copies a bytearray in half the time of bytes(…).
                    record = table[key := frame.arbitration_id](
                        data := b"" + frame.data, key, frame.timestamp, frame.channel, data, frame.is_rx
                    )
                except (KeyError, error):
                    record = None
                if record is None:
                    unusual(frame, out)
                    continue
                out.append(record)
            given[0] += len(out)
            return out

        return feed

    def feed_table(self, frames: FrameTable, /) -> list[Record]:
        """Take frames as columns: what `feed(frames.frames())` gives, without an object a frame in
        between.
        """
        if not len(frames):
            return []
        from ...frame_table import NO_TIME, FrameFlag

        way, is_unusual = FrameFlag.RX.bit_length() - 1, FrameFlag.UNUSUAL
        table, error, unusual = self._table, struct.error, self._unusual
        width, length = frames.data.shape[1], frames.length
        raw = frames.data.tobytes()
        datas: Iterable[bytes]
        if width == 8 and int(length.min()) == 8:
            datas = [data for (data,) in struct.iter_unpack("8s", raw)]
        else:
            starts = range(0, len(raw), width)
            datas = [raw[start : start + size] for start, size in zip(starts, length.tolist(), strict=True)]
        names = frames.channels.names
        channels = [names[number] for number in frames.channel.tolist()]
        flags = frames.flags.tolist() if frames.flags.any() else repeat(0, len(frames))
        out: list[Record] = []
        rows = zip(frames.time.tolist(), channels, frames.id.tolist(), flags, datas, strict=True)
        for number, (time, channel, key, flag, data) in enumerate(rows):
            record = None
            if not flag & is_unusual:
                seconds = time / 1_000_000_000 if time != NO_TIME else None
                try:
                    record = table[key](data, key, seconds, channel, data, _WAYS[flag >> way])
                except (KeyError, error):
                    record = None
            if record is None:
                unusual(frames.take(slice(number, number + 1)).frames()[0], out)
                continue
            out.append(record)
        self._given[0] += len(out)
        return out

    @property
    def has_transports(self) -> bool:
        """True if some messages are carried in several frames: then a single frame may give no record."""
        return bool(self._carriers)

    def transport_of(self, key: int) -> Transport | None:
        """Return the transport whose frames have a key."""
        bare = key & ~FD
        carrier = self._find_carrier(bare) if self._carriers else None
        return carrier.transport if carrier is not None and (key == bare or carrier.transport.fd) else None

    def carries(self, frame: AnyFrame) -> bool:
        """Return whether a frame is a transport's."""
        key = key_of(
            frame.arbitration_id, extended=frame.is_extended_id, remote=frame.is_remote_frame, fd=frame.is_fd
        )
        return self.transport_of(key) is not None

    def feed_numbered(
        self, frames: Iterable[AnyFrame], numbers: Iterable[int]
    ) -> tuple[list[Record], list[int]]:
        """Feed like `feed`, and return for each record the number of its frame; of a packet, of its last frame."""
        out: list[Record] = []
        origins: list[int] = []
        for frame, number in zip(frames, numbers, strict=True):
            self._number, self._origins = number, []
            given = self.feed((frame,))
            out += given
            origins += self._origins or [number] * len(given)
        self._origins = None
        return out, origins

    def _unusual(self, frame: AnyFrame, out: list[Record]) -> None:
        """Handle a frame that is unusual, of an unknown identifier or refused: append its record or its loss."""
        identifier = frame.arbitration_id
        if frame.is_error_frame:
            return self._lost(frame, "error frame", out)
        key = key_of(identifier, extended=frame.is_extended_id, remote=frame.is_remote_frame, fd=frame.is_fd)
        data = bytes(frame.data)
        if self._carriers:
            bare = key & ~FD
            carrier = self._carrier_of[bare] if bare in self._carrier_of else self._find_carrier(bare)
            if carrier is not None and (key == bare or carrier.transport.fd):
                self._carry(carrier, frame, bare, data, out)
                return None
        if key != identifier or key not in self._table:
            record = self._rare(frame, key, data)
            if record is not None:
                out.append(record)
                return None
        reasons = [wire.reason(key, data) for wire in self.wires]
        return self._lost(frame, next((r for r in reasons if r != "unknown"), "unknown"), out)

    # ------------------------------------------------------------------ packets of several frames

    def _find_carrier(self, key: int) -> _Carrier | None:
        """Return the carrier whose frames have a key, and remember it: the first protocol with it in a
        transport decides.
        """
        transport = next((t for wire in self.wires if (t := wire.carried_by(key)) is not None), None)
        found = next((carrier for carrier in self._carriers if carrier.transport == transport), None)
        if len(self._carrier_of) < REMEMBERED:
            self._carrier_of[key] = found
        return found

    def _carry(self, carrier: _Carrier, frame: AnyFrame, key: int, data: bytes, out: list[Record]) -> None:
        packets = carrier.reassembler.take(frame, self._number, key, data, frame.channel, frame.timestamp)
        for packet in packets:
            self._packet(carrier, packet, out)

    def _packet(self, carrier: _Carrier, packet: Packet, out: list[Record]) -> None:
        """Append a packet's record, or the loss of its frames."""
        frames, reason = packet.frames, packet.reason
        if not reason:
            record, reason = self._decoded(carrier, packet)
            if record is not None:
                out.append(record)
                self._beside += len(frames) - 1
                if self._origins is not None:
                    self._origins.append(frames[-1].number)
                return
        for frame in frames:
            self._lost(frame.frame, reason, out)
            if self._origins is not None:
                self._origins.append(frame.number)

    def _decoded(self, carrier: _Carrier, packet: Packet) -> tuple[Any, str]:
        """Return a packet's record; where it has none, the reason."""
        key, frames = packet.key, packet.frames
        transport, last = carrier.transport, frames[-1]
        data = self._unwrapped(carrier, packet)
        if data is None:
            return None, "malformed: checksum"
        decode = carrier.table.get(key)
        if decode is None:
            found = [one for wire in self.wires if (one := wire.lookup(key, transport)) is not None]
            if found:
                decode = found[0] if len(found) == 1 else self._chain(found)
                if len(carrier.table) < REMEMBERED:
                    carrier.table[key] = decode
        if decode is not None:
            raw = CarriedBytes.of(data, [frame.data for frame in frames], frames[0].time)
            try:
                record = decode(data, key, last.time, last.frame.channel, raw, last.frame.is_rx)
            except (KeyError, struct.error):
                record = None
            if record is not None:
                self._forget_needs()
                return record, ""
        reasons = [wire.reason(key, data, transport) for wire in self.wires]
        return None, next((r for r in reasons if r != "unknown"), "unknown")

    def _rare(self, frame: AnyFrame, key: int, data: bytes) -> Any:
        """Return the record of a frame with flags, or with a key that comes for the first time."""
        decode = self._table.get(key) or self._lookup(key)
        if decode is None:
            return None
        try:
            record = decode(data, key, frame.timestamp, frame.channel, data, frame.is_rx)
        except (KeyError, struct.error):
            return None
        if record is not None:
            self._forget_needs()
        return record

    def _unwrapped(self, carrier: _Carrier, packet: Packet) -> bytes | None:
        """Return a packet's bytes without the check that its transport has added; None where it does not hold."""
        transport, key = carrier.transport, packet.key
        if len(packet.frames) == 1 or type(transport).unwrapped is Transport.unwrapped:
            return packet.data
        extra = carrier.extras.get(key)
        if extra is None:
            candidates = (m for wire in self.wires for m in wire.candidates(key, transport))
            extra = next((m.check_extra for m in candidates), b"")
            if len(carrier.extras) < REMEMBERED:
                carrier.extras[key] = extra
        return transport.unwrapped(packet.data, extra)

    def _lost(self, frame: AnyFrame, reason: str, out: list[Record]) -> None:
        self._counts.lose(1, reason)
        if self.include_unknown:
            out.append(self._unknown(frame, reason))

    def _unknown(self, frame: Any, reason: str) -> Unknown:
        self._given[1] += 1
        meta = Meta(
            None,
            None,
            frame.timestamp,
            frame.channel,
            None,
            bytes(frame.data),
            frame.arbitration_id & 0x1FFF_FFFF,
            bool(frame.is_extended_id),
            bool(frame.is_fd),
            bool(frame.is_remote_frame),
            frame.is_rx,
        )
        return Unknown(reason, meta)

    def reset(self) -> None:
        """Forget everything seen, counts included: as if just made."""
        self._counts = ScanCounts()
        self._given[:] = 0, 0
        self._beside = self._left = 0
        for wire in self.wires:
            wire.reset()
        for carrier in self._carriers:
            carrier.reset()

    def sent(self, frame: Any) -> None:
        """Note our own transmission: a request that replies may need. It is not counted and gives no record."""
        key = frame.arbitration_id
        if frame.is_extended_id or frame.is_remote_frame or frame.is_fd:
            key = self._key_of(frame)
        if key in self._unasked:  # no reply hangs on it: most set-points
            return
        carrier = self._carrier_at(key)
        if carrier is None:
            known = self._request_of(key, bytes(frame.data), None)
            if known is None and not self._asked.get(key, True):
                self._unasked.add(key)
            self._note(known, frame)
            return
        for packet in carrier.sent.take(
            frame, 0, key & ~FD, bytes(frame.data), frame.channel, frame.timestamp
        ):
            if not packet.reason and (data := self._unwrapped(carrier, packet)) is not None:
                self._note(self._request_of(packet.key, data, carrier.transport), frame)

    def noting(self, frame: AnyFrame) -> Callable[[], None] | None:
        """Return a function to call whenever this frame was sent, instead of `sent`; None if no reply depends on it."""
        key = self._key_of(frame)
        if self._carrier_at(key) is not None:
            return partial(self.sent, frame)
        known = self._request_of(key, bytes(frame.data), None)
        if known is None:
            return None
        wire, name, values = known
        note: Callable[[], None] = wire.context.noting(name, frame.channel, frame.timestamp, values)
        return note

    @staticmethod
    def _key_of(frame: AnyFrame) -> int:
        key: int = frame.arbitration_id
        if frame.is_extended_id or frame.is_remote_frame or frame.is_fd:
            key = key_of(key, extended=frame.is_extended_id, remote=frame.is_remote_frame, fd=frame.is_fd)
        return key

    def _carrier_at(self, key: int) -> _Carrier | None:
        """Return the transport that frames with this key belong to."""
        if not self._carriers:
            return None
        bare = key & ~FD
        return self._carrier_of[bare] if bare in self._carrier_of else self._find_carrier(bare)

    @staticmethod
    def _note(known: tuple[Any, str, Mapping[str, Any]] | None, frame: AnyFrame) -> None:
        if known is not None:
            wire, name, values = known
            wire.context.note(name, frame.channel, frame.timestamp, values)

    def _request_of(
        self, key: int, data: bytes, transport: Transport | None
    ) -> tuple[Any, str, Mapping[str, Any]] | None:
        """Return the request that a frame or packet is, with whose it is and its raw fields; None: no reply hangs on it."""
        asked = self._asked.get((key, transport)) if transport is not None else self._asked.get(key)
        if asked is None:
            asked = [
                (wire, message)
                for wire in self.wires
                for message in wire.matching(key, wire.asked)
                if transport in message.ways
            ]
            if len(self._asked) < REMEMBERED:
                self._asked[key if transport is None else (key, transport)] = asked
        if not asked:
            return None
        known = self._requests.get((key, data))
        if known is None:
            known = next(
                (
                    (wire, message.name, values)
                    for wire, message in asked
                    if (values := wire.request_values(message, data, key, data)) is not None
                ),
                None,
            )
            if known is None:
                return None
            if len(self._requests) < REMEMBERED:
                self._requests[key, data] = known
        return known

    def idle(self, time: float | None = None) -> list[Record]:
        """Refuse packets of a transport that wait too long at `time`, or for ever. Single frames are whole."""
        return self._end([packet for carrier in self._carriers for packet in carrier.reassembler.idle(time)])

    def close(self) -> list[Record]:
        """End a capture: frames of packets that are not whole are pending, and stay so."""
        return self.close_numbered()[0]

    def close_numbered(self) -> tuple[list[Record], list[int]]:
        """Close like `close`, and return for each record the number of its frame."""
        packets = [packet for carrier in self._carriers for packet in carrier.reassembler.close()]
        left = [frame for packet in packets for frame in packet.frames]
        self._left += len(left)
        if not self.include_unknown:
            return [], []
        out: list[Record] = [self._unknown(frame.frame, "pending") for frame in left]
        self._given[0] += len(out)
        return out, [frame.number for frame in left]

    def _end(self, packets: Iterable[Packet]) -> list[Record]:
        out: list[Record] = []
        for packet in packets:
            for frame in packet.frames:
                self._lost(frame.frame, packet.reason, out)
        self._given[0] += len(out)
        return out


class _Carrier:
    """A transport in a scanner: its packets under way, received and sent, and what decodes them."""

    def __init__(self, transport: Transport) -> None:
        self.transport = transport
        from .reassemble import Reassembler

        self.reassembler, self.sent = Reassembler(transport), Reassembler(transport)
        #: By key of a packet, what decodes it; made when the first packet with that key comes.
        self.table: dict[int, Decode] = {}
        #: By key of a packet, the `check_extra` of its message.
        self.extras: dict[int, bytes] = {}

    def reset(self) -> None:
        """Forget packets under way."""
        self.reassembler.reset()
        self.sent.reset()
