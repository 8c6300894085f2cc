"""The CAN scanner: frames in, records out.

1. No I/O, no clock, no thread: `feed` is given frames and returns records.
2. The usual frame costs one table look-up and one generated call. Everything unusual (the first frame of an identifier,
   frames with flags, requests and replies, losses) is beside that path.
3. Each frame ends in exactly one bin of `counts`.
4. Where protocols are bound to channels, a frame is decided by those of its channel alone: bound to it or to none, in the
   order given. Each channel has a scanner of its own, made when its first frame comes; what is asked on one bus is
   answered there.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import lru_cache
from itertools import groupby, repeat
from typing import Any, Generic, Literal, Protocol, TypeVar

from construct import ConstructError

from ...errors import AcesError
from ...frame_table import NO_TIME, RX, UNUSUAL, FrameTable
from ..counts import ScanCounts, sum_counts
from ..declare.message import Direction, Message
from ..declare.packet import ContentError, LengthError, WrongCheckError, can_image
from ..declare.protocol import Variant
from ..keys import EXTENDED, FD, REMOTE, key_of
from ..record import Meta, Record, Unknown
from .decide import REMEMBERED, Decider, Decode

#: By the two highest flags of a frame table, RX and TX: whether a frame was received.
_WAY = RX.bit_length() - 1
_WAYS = (None, True, False, True)

#: Identifier patterns up to this many numbers are spelt out in the table; larger ones are matched and then remembered.
SPELT_OUT = 4096
#: The same where all of them together have more numbers than are remembered (a database of J1939 messages).
SPELT_OUT_OF_MANY = 16


_KINDS = EXTENDED | REMOTE | FD


def _kinds_of(message: Message) -> list[int]:
    """The flags of the keys of a message's frames."""
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
        """The messages whose identifier and flags fit, in order."""
        identifier = key & 0x1FFF_FFFF
        found = [
            (number, message)
            for mask, table in self._by_mask.items()
            for number, message in table.get(key & mask, ())
            if message.identifier.match(identifier) is not None and key & _KINDS in _kinds_of(message)
        ]
        if len(found) > 1:
            found.sort(key=lambda one: one[0])
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


class _Wire(Decider):
    """One variant's part of a CAN scanner: from key to the function that decodes it."""

    def __init__(self, variant: Variant, direction: Direction | Literal["both"] | None, *, raw: bool) -> None:
        super().__init__(variant, direction, raw=raw)
        keys = _keys(tuple(self.messages))
        #: The candidates of each key that is spelt out.
        self.spelt_out = keys.spelt_out
        self._patterns, self._all = keys.patterns if keys.has_patterns else None, keys.all

    def candidates(self, key: int) -> list[Message]:
        """The messages whose identifier and flags fit, in order."""
        return self._all.of(key)

    @staticmethod
    def matching(key: int, messages: Iterable[Message]) -> list[Message]:
        """Those of `messages` whose identifier and flags fit."""
        identifier = key & 0x1FFF_FFFF
        return [
            m for m in messages if key & _KINDS in _kinds_of(m) and m.identifier.match(identifier) is not None
        ]

    def lookup(self, key: int) -> Decode | None:
        """The function that decodes a key; None for one that no message has."""
        found: Sequence[Message] = self.spelt_out.get(key, ())
        if not found and self._patterns is not None:
            found = self._patterns.of(key)
        return self.decide(found, alone=True) if found else None

    def reason(self, key: int, data: bytes) -> str:
        """Why a frame is none of the messages."""
        need = self.need_of(key)
        if need:
            self.forget_need()
            return need
        identifier = key & 0x1FFF_FFFF
        image = can_image(
            identifier, data, extended=bool(key & EXTENDED), remote=bool(key & REMOTE), fd=bool(key & FD)
        )
        for message in self.candidates(key):
            try:
                message.struct.parse(image, raw=True)
            except LengthError:
                return f"malformed: length {len(data)}, {message.name} has {message.describe_lengths}"
            except WrongCheckError:
                return "malformed: checksum"
            except ContentError as error:
                if error.what and not message.request_fields:
                    return f"malformed: {error.what}"
            except (ConstructError, AcesError):
                continue
        return "unknown"


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
        direction: Direction | Literal["both"] | None = None,
        include_unknown: bool = False,
        raw: bool = False,
    ) -> None:
        self.variants = tuple(variants)
        self.direction = direction
        self.include_unknown = include_unknown
        self.wires = [_Wire(variant, direction, raw=raw) for variant in variants]
        #: By key, what decodes it; made when the first frame with that key comes.
        self._table: dict[int, Decode] = {}
        #: By key, the requests that a frame of our own may be.
        self._asked: dict[int, list[tuple[_Wire, Message]]] = {}
        #: By key and data, requests of our own with their fields: polls are the same frames again and again.
        self._requests: dict[tuple[int, bytes], tuple[_Wire, str, Mapping[str, Any]]] = {}
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
        # The method's place is taken by the closure: no look-up of `self` in the hot loop.
        self.__dict__["feed"] = self._make_feed()

    def _lookup(self, key: int) -> Decode | None:
        """The function that decodes a key, which is remembered: the protocols that claim it, in order."""
        found = [decode for wire in self.wires if (decode := wire.lookup(key)) is not None]
        if not found:
            return None
        decode = found[0] if len(found) == 1 else self._chain(found)
        if len(self._table) < REMEMBERED:
            self._table[key] = decode
        return decode

    def _chain(self, found: Sequence[Decode]) -> Decode:
        def decode(*frame: Any) -> Any:
            for one in found:
                try:
                    record = one(*frame)
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
        """Where every frame went so far."""
        counts = self._counts
        counts.records = counts.decoded = self._given[0] - self._given[1]
        counts.total = counts.decoded + sum(counts.reasons.values())
        counts.missed = sum(wire.missed for wire in self.wires)
        return counts

    def feed(self, frames: Iterable[Any], /) -> list[Record]:
        """Records of `frames`, in order; see the class."""
        return self._make_feed()(frames)

    def _make_feed(self) -> Callable[[Iterable[Any]], list[Any]]:
        """The hot loop, as a closure: what it touches for each frame are local names."""
        table = self._table
        given = self._given
        unusual = self._unusual
        error = struct.error

        def feed(frames: Iterable[Any]) -> list[Any]:
            out: list[Any] = []
            for frame in frames:
                if frame.is_extended_id or frame.is_remote_frame or frame.is_fd or frame.is_error_frame:
                    record = unusual(frame)
                    if record is not None:
                        out.append(record)
                    continue
                try:
                    # Adding to b"" copies a bytearray in half the time of bytes(…).
                    record = table[key := frame.arbitration_id](
                        data := b"" + frame.data, key, frame.timestamp, frame.channel, data, frame.is_rx
                    )
                except (KeyError, error):
                    record = None
                if record is None:
                    record = unusual(frame)
                    if record is None:
                        continue
                out.append(record)
            given[0] += len(out)
            return out

        return feed

    def feed_table(self, frames: FrameTable, /) -> list[Record]:
        """The same for frames as columns: what `feed(frames.frames())` gives, without an object a frame in between."""
        if not len(frames):
            return []
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
        out: list[Any] = []
        rows = zip(frames.time.tolist(), channels, frames.id.tolist(), flags, datas, strict=True)
        for number, (time, channel, key, flag, data) in enumerate(rows):
            record = None
            if not flag & UNUSUAL:
                seconds = time / 1_000_000_000 if time != NO_TIME else None
                try:
                    record = table[key](data, key, seconds, channel, data, _WAYS[flag >> _WAY])
                except (KeyError, error):
                    record = None
            if record is None:
                record = unusual(frames.take(slice(number, number + 1)).frames()[0])
                if record is None:
                    continue
            out.append(record)
        self._given[0] += len(out)
        return out

    def _unusual(self, frame: Any) -> Any:
        """A frame that is not a plain data frame of a known identifier, or was refused: its record or its loss."""
        identifier = frame.arbitration_id
        if frame.is_error_frame:
            return self._lost(frame, "error frame")
        key = key_of(identifier, extended=frame.is_extended_id, remote=frame.is_remote_frame, fd=frame.is_fd)
        data = bytes(frame.data)
        if key != identifier or key not in self._table:
            record = self._rare(frame, key, data)
            if record is not None:
                return record
        reasons = [wire.reason(key, data) for wire in self.wires]
        return self._lost(frame, next((r for r in reasons if r != "unknown"), "unknown"))

    def _rare(self, frame: Any, key: int, data: bytes) -> Any:
        """The record of a frame with flags, or with a key that comes for the first time."""
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

    def _lost(self, frame: Any, reason: str) -> Unknown | None:
        self._counts.lose(1, reason)
        if not self.include_unknown:
            return None
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
        for wire in self.wires:
            wire.reset()

    def sent(self, frame: Any) -> None:
        """Our own transmission: a request that replies may hang on. It is not counted and gives no record."""
        known = self._request_of(frame)
        if known is not None:
            wire, name, values = known
            wire.context.note(name, frame.channel, frame.timestamp, values)

    def noting(self, frame: Any) -> Callable[[], None] | None:
        """What is called whenever this frame was sent, instead of `sent`; None: no reply hangs on it."""
        known = self._request_of(frame)
        if known is None:
            return None
        wire, name, values = known
        note: Callable[[], None] = wire.context.noting(name, frame.channel, frame.timestamp, values)
        return note

    def _request_of(self, frame: Any) -> tuple[Any, str, Mapping[str, Any]] | None:
        """The request that a frame is, with whose it is and its raw fields; None: no reply hangs on it."""
        key = frame.arbitration_id
        if frame.is_extended_id or frame.is_remote_frame or frame.is_fd:
            key = key_of(key, extended=frame.is_extended_id, remote=frame.is_remote_frame, fd=frame.is_fd)
        asked = self._asked.get(key)
        if asked is None:
            asked = [(wire, message) for wire in self.wires for message in wire.matching(key, wire.asked)]
            if len(self._asked) < REMEMBERED:
                self._asked[key] = asked
        if not asked:
            return None
        data = bytes(frame.data)
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
        """Frames are whole: silence decides nothing on CAN."""
        return []

    def close(self) -> list[Record]:
        """Frames are whole: the end of a capture decides nothing on CAN."""
        return []


#: Channels with scanners of their own; the frames of more channels share the one of unbound protocols.
MOST = 256


class _Counting(Protocol):
    """What channels have a scanner each of."""

    @property
    def counts(self) -> ScanCounts: ...
    @property
    def contested(self) -> Mapping[int, tuple[str, str]]: ...


Kind = TypeVar("Kind", bound=_Counting)


class ChannelScanners(Generic[Kind]):
    """A scanner for each channel, made on demand."""

    link = "can"

    def __init__(self, variants: Sequence[Variant], make: Callable[[Sequence[Variant]], Kind]) -> None:
        self.variants = tuple(variants)
        self._make: Callable[[Sequence[Variant]], Kind] = make
        self._bound = {variant.channel for variant in variants}
        self._scanners: dict[str | None, Kind] = {}

    def of(self, channel: str | None) -> Kind:
        """The scanner of a channel; channels that no protocol is bound to keep apart too."""
        if channel not in self._scanners:
            if len(self._scanners) >= MOST and channel not in self._bound:
                channel = None
            mine = [v for v in self.variants if v.channel is None or v.channel == channel]
            self._scanners[channel] = self._make(mine)
        return self._scanners[channel]

    @property
    def counts(self) -> ScanCounts:
        """Where every frame went so far, all channels together."""
        return sum_counts(scanner.counts for scanner in self._scanners.values())

    @property
    def contested(self) -> Mapping[int, tuple[str, str]]:
        """Keys that two protocols of one channel claim, with their names, first the one that wins."""
        found: dict[int, tuple[str, str]] = {}
        for scanner in self._scanners.values():
            found.update(scanner.contested)
        return found


class ChannelScanner(ChannelScanners[CanScanner]):
    """The live scanner of several channels; made by `make_scanner` when a protocol is bound to one."""

    def __init__(
        self,
        variants: Sequence[Variant],
        *,
        direction: Direction | Literal["both"] | None = None,
        include_unknown: bool = False,
        raw: bool = False,
    ) -> None:
        super().__init__(
            variants,
            lambda mine: CanScanner(mine, direction=direction, include_unknown=include_unknown, raw=raw),
        )

    def feed(self, frames: Iterable[Any], /) -> list[Record]:
        """Records of `frames`, in order."""
        out: list[Any] = []
        for channel, some in groupby(frames, key=lambda frame: frame.channel):
            out += self.of(channel).feed(list(some))
        return out

    def reset(self) -> None:
        """Forget everything seen, counts included: as if just made."""
        self._scanners.clear()

    def sent(self, frame: Any) -> None:
        """Our own transmission: a request that replies on its channel may hang on."""
        self.of(frame.channel).sent(frame)

    def idle(self, time: float | None = None) -> list[Record]:
        """Frames are whole: silence decides nothing on CAN."""
        return []

    def close(self) -> list[Record]:
        """Frames are whole: the end of a capture decides nothing on CAN."""
        return []
