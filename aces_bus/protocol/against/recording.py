"""A recording read against a spec: every piece through the column scanner, what it gives to those who watch.

1. Nothing is kept of a piece but counts, a few values and a few samples: memory does not grow with the recording.
2. A recording is untrusted input: nothing here raises for what is in it.
3. No I/O: the caller opens the recording (`aces_bus.recordings.open_recording`).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

from ...errors import CallerError
from ...frame_table import NO_TIME, FrameTable, to_ns
from ..columns.decode import capture_pieces, feed
from ..columns.scanner import ColumnScanner, make_column_scanner
from ..columns.table import MessageTable
from ..declare.message import GivenWay, Message, Way, way_of
from ..declare.protocol import Variant
from ..lint.finding import Finding
from ..protocol import Protocol
from .fields import AGAIN, MessageWatch
from .finding import Moment, Observation
from .header_counts import HeaderCounts
from .hidden import KEPT, PacketSample, hidden_check
from .losses import Losses, Opcodes, lost_bytes, lost_frames, lost_packets

#: Messages that are gathered before they are looked at: small pieces cost as much as large ones.
GATHER = 1 << 14
#: Bytes of a stream that are fed at once, and that are remembered for packets decided late.
PIECE, REMEMBERED = 1 << 20, 1 << 22


def check_recordings(
    spec: Protocol | Variant | Sequence[Variant],
    captures: Iterable[Any],
    *,
    direction: GivenWay | None = None,
) -> list[Observation]:
    """Return what recordings say against a spec, by file and line; what comments in the spec allow is left out.

    `spec` is a protocol (in its default dialect and configuration), a variant, or all variants that share the wire.
    `captures` are recordings of `aces_bus.recordings`, or whatever else `aces_bus.decode` takes, one after the other.
    `direction` is that of streams which do not say it: "to device", "from device" or "both".

    Raises `CallerError` where bytes alone do not tell the messages apart and no direction is given, or for what is no
    recording of the spec's link; `CaptureError` where reading stops.
    """
    check = RecordingCheck(spec, direction=direction)
    for capture in captures:
        check.read(capture)
    return check.observations()


class RecordingCheck:
    """Recordings read one after the other, then asked what they say; see `check_recordings`."""

    def __init__(
        self, spec: Protocol | Variant | Sequence[Variant], *, direction: GivenWay | None = None
    ) -> None:
        if isinstance(spec, Protocol):
            spec = spec.variant()
        self.variants = (spec,) if isinstance(spec, Variant) else tuple(spec)
        if not self.variants:
            raise CallerError("a recording is held against one protocol at least")
        self.direction: Way | None = way_of(direction)
        self.is_can = self.variants[0].link == "can"
        #: Frames, or bytes, that were read.
        self.size = 0
        self._messages = {(v.name, m.name): m for v in self.variants for m in v.messages.values()}
        self._framings = list(
            dict.fromkeys(m.framing for m in self._messages.values() if m.framing is not None)
        )
        self._header_counts = [HeaderCounts(framing) for framing in self._framings if framing.heads]
        self._opcodes = Opcodes(self._messages.values())
        self._watches: dict[tuple[str, str], MessageWatch] = {}
        self._waiting: dict[tuple[str, str], list[MessageTable]] = {}
        self._waits = 0
        self._samples: dict[tuple[str, str], list[PacketSample]] = {}
        self._losses: dict[Way | None, Losses] = {}
        #: Bytes of streams that begin no packet, or one that never ended.
        self._skipped = 0
        self._names: list[str] = []
        self._start: int | None = None

    # ------------------------------------------------------------------ reading

    def read(self, capture: Any) -> None:
        """Read a recording to its end; see `check_recordings`."""
        self._names.append(str(getattr(capture, "name", "")))
        self._start = None
        scanners: dict[Way | None, tuple[ColumnScanner, _Window]] = {}
        for traffic, stated, time in capture_pieces(capture, self.variants[0]):
            way: Way | None = self.direction or stated
            if way not in scanners:
                scanner = make_column_scanner(self.variants, direction=way, include_unknown=True, raw=True)
                scanners[way] = scanner, _Window()
            scanner, window = scanners[way]
            if isinstance(traffic, FrameTable):
                self._read_frames(traffic, scanner, way, window)
            else:
                self._read_bytes(traffic, time, scanner, way, window)
        for way, (scanner, window) in scanners.items():
            self._take(scanner.close(), way, window, None)
            self._look()
            counts = scanner.counts
            self.size += counts.total
            self._skipped += counts.skipped + counts.pending

    def _read_frames(
        self, frames: FrameTable, scanner: ColumnScanner, way: Way | None, window: _Window
    ) -> None:
        self._begin(frames.time[frames.time != NO_TIME][:1].tolist())
        self._take(scanner.feed(frames), way, window, frames)
        window.frames += len(frames)

    def _read_bytes(
        self, data: bytes, time: float | None, scanner: ColumnScanner, way: Way | None, window: _Window
    ) -> None:
        self._begin([to_ns(time)] if time is not None else [])
        for at in range(0, max(1, len(data)), PIECE):  # no bytes: the line was silent
            piece = data[at : at + PIECE]
            window.add(piece)
            self._take(feed(scanner, piece, time), way, window, None)

    def _begin(self, instants: Sequence[int]) -> None:
        """Set the start of the recording, from which instants are counted."""
        if self._start is None and instants:
            self._start = instants[0]

    def _take(
        self, tables: Iterable[MessageTable], way: Way | None, window: _Window, frames: FrameTable | None
    ) -> None:
        for table in tables:
            if not len(table):
                continue
            if not table.message:
                self._take_lost(table, way, window)
                continue
            who = (table.protocol, table.message)
            self._waiting.setdefault(who, []).append(table)
            self._waits += len(table)
            self._take_samples(who, table, window, frames)
        if self._waits >= GATHER:
            self._look()

    def _look(self) -> None:
        """Look at what was gathered."""
        gathered: list[tuple[Message, MessageTable]] = []
        for who, tables in self._waiting.items():
            if who not in self._watches:
                self._watches[who] = MessageWatch(self._messages[who])
            gathered.append((self._messages[who], MessageTable.concat(tables, is_lazy=True)))
            self._watches[who].take(gathered[-1][1], self._locate)
        for counts in self._header_counts:
            mine = [(message, table) for message, table in gathered if message.framing is counts.framing]
            if mine:
                counts.take(mine)
        self._waiting, self._waits = {}, 0

    def _take_samples(
        self, who: tuple[str, str], table: MessageTable, window: _Window, frames: FrameTable | None
    ) -> None:
        message = self._messages[who]
        if message.check is not None or (message.framing is not None and message.framing.check is not None):
            return
        kept = self._samples.setdefault(who, [])
        for index in range(min(len(table), KEPT - len(kept))):
            at = int(table.row[index])
            if frames is not None:
                row = at - window.frames
                if 0 <= row < len(frames):
                    data = frames.data[row, : frames.length[row]].tobytes()
                    kept.append(PacketSample(int(frames.id[row]), data))
            elif table.size is not None:
                kept.append(PacketSample(0, window.get(at, int(table.size[index]))))

    def _take_lost(self, table: MessageTable, way: Way | None, window: _Window) -> None:
        losses = self._losses.setdefault(way, Losses())
        reasons: list[str] = table["reason"].values.tolist()
        raws: list[bytes] = table["raw"].values.tolist()
        for index, (reason, raw) in enumerate(zip(reasons, raws, strict=True)):
            if table.is_stream:
                if reason in ("skipped", "pending"):
                    continue
                if reason.startswith("malformed"):
                    raw = window.get(int(table.row[index]), max(f.max_size for f in self._framings))
                group = self._opcodes.group(reason, raw)
                key = 0
            else:
                key = int(table.key[index])
                group = (key, len(raw), reason)
            losses.add(group, reason, raw, self._locate(table, index), key)

    def _locate(self, table: MessageTable, index: int) -> Moment:
        time = int(table.time[index])
        relative = None if time == NO_TIME or self._start is None else max(0, time - self._start)
        source = self._names[-1] if len(self._names) > 1 else ""
        return Moment(int(table.row[index]), relative, table.is_stream, source)

    # ------------------------------------------------------------------ what it comes to

    def observations(self) -> list[Observation]:
        """Return what the recordings say, by file and line; what comments in the spec allow is left out."""
        return sorted(
            (observation for observation in self._every() if not observation.is_allowed), key=Finding.sort_key
        )

    def _every(self) -> Iterator[Observation]:
        seen = {who: watch.total for who, watch in self._watches.items()}
        yield from self._of_occurrence(seen)
        for who, watch in self._watches.items():
            yield from watch.observations()
            yield from self._of_checks(watch, self._samples.get(who, []))
        known = {
            (w.message.name, f.leaf.path) for w in self._watches.values() for f in w.fields if f.counts_up
        }
        for counts in self._header_counts:
            yield from counts.observations(known)
        for way, losses in self._losses.items():
            if self.is_can:
                yield from lost_frames(losses, self.variants, seen)
            else:
                yield from self._of_direction(losses, way)
                yield from lost_packets(losses, self._opcodes, self.variants, seen, way)
        if not self.is_can:
            yield from lost_bytes(self.variants, self._skipped, self.size, self._framings)
        else:
            yield from _of_ways(self._watches.values())

    def _of_occurrence(self, seen: dict[tuple[str, str], int]) -> Iterator[Observation]:
        unit = "frames" if self.is_can else "bytes"
        for variant in self.variants:
            place, label = variant.protocol.place, variant.label
            expected = variant.messages_for(self.direction)
            never = [m.name for m in expected if (variant.name, m.name) not in seen]
            if not self.size:
                yield Observation(
                    "note", "unseen", place, f"the recording holds no {unit}", remedy="record something"
                )
            elif len(never) == len(expected):
                yield Observation(
                    "warning",
                    "unseen",
                    place,
                    f"nothing of {self.size} {unit} is a message of {label}",
                    total=self.size,
                    remedy="check protocol, dialect, configuration and direction; then sync bytes, size and check",
                )
            elif never:
                shown = ", ".join(never[:12]) + (", …" if len(never) > 12 else "")
                yield Observation(
                    "note",
                    "unseen",
                    place,
                    f"{len(never)} of {len(expected)} messages of {label} never occur: {shown}",
                    count=len(never),
                    total=len(expected),
                    remedy="record what makes the device send them, or check their opcodes",
                )

    def _of_checks(self, watch: MessageWatch, samples: Sequence[PacketSample]) -> Iterator[Observation]:
        found = hidden_check(samples)
        if found is None:
            return
        message = watch.message
        last = found.offset + found.size - 1
        where = f"byte {found.offset}" if found.size == 1 else f"bytes {found.offset}…{last}"
        yield Observation(
            "warning",
            "check",
            message.place,
            f"{message.name}: {where} {'is' if found.size == 1 else 'are'} {found.words}, in {len(samples)} of"
            f" {len(samples)} samples",
            message.name,
            f"hex:{samples[0].data.hex().upper()}" if message.framing is not None else None,
            count=len(samples),
            total=watch.total,
            first=watch.first,
            remedy=f"declare it: check={found.declared}",
        )

    def _of_direction(self, losses: Losses, way: Way | None) -> Iterator[Observation]:
        """Yield lost packets of a stream that would be messages in the other direction, and count them as
        lost no longer.
        """
        if way not in ("to device", "from device"):
            return
        for key, group in list(losses.groups.items()):
            message = next((m for m in self._messages.values() if m.direction not in (None, way)
                            and any(_is_packet_of(m, sample) for sample in group.samples)), None)  # fmt: skip
            if message is not None and group.count >= AGAIN:
                del losses.groups[key]
                yield Observation(
                    "warning",
                    "direction",
                    message.place,
                    f"{message.name} is declared {message.direction!r}, and {group.count} of its packets went"
                    f" {way!r}; first at {group.first}",
                    message.name,
                    f"hex:{group.samples[0].hex().upper()}",
                    count=group.count,
                    total=group.count,
                    first=group.first,
                    remedy=f"direction={way!r}",
                )


def _is_packet_of(message: Message, data: bytes) -> bool:
    try:
        message.struct.parse(data, raw=True)
    except Exception:  # whatever foreign bytes make a construct raise
        return False
    return True


def _of_ways(watches: Iterable[MessageWatch]) -> Iterator[Observation]:
    """Yield messages that went the other way than declared, by what the recorder says it sent and received.

    The recorder is on the host's side, unless most messages say that it is on the device's.
    """
    stated = [w for w in watches if w.message.direction is not None and w.received + w.sent >= AGAIN]
    if not any(w.sent for w in stated):
        return  # who only listens receives everything

    def is_host(watch: MessageWatch) -> bool | None:
        """Return whether the recorder is the host by this message; None where it went both ways."""
        if watch.received and watch.sent:
            return None
        return bool(watch.sent) == (watch.message.direction == "to device")

    votes = [is_host(watch) for watch in stated]
    host = votes.count(True) >= votes.count(False)
    for watch, vote in zip(stated, votes, strict=True):
        if vote is None or vote == host:
            continue
        message, count = watch.message, watch.received + watch.sent
        right = "from device" if message.direction == "to device" else "to device"
        did = "sent" if watch.sent else "received"
        yield Observation(
            "warning",
            "direction",
            message.place,
            f"{message.name} is declared {message.direction!r}, and the recorder, which is the"
            f" {'host' if host else 'device'} by its other messages, {did} all {count}; first at {watch.first}",
            message.name,
            count=count,
            total=watch.total,
            first=watch.first,
            remedy=f"direction={right!r}",
        )


class _Window:
    """The last bytes of a stream, by their offsets; of frames only how many were fed."""

    def __init__(self) -> None:
        self.frames = 0
        self._base = 0
        self._data = bytearray()

    def add(self, data: bytes) -> None:
        self._data += data
        if len(self._data) > REMEMBERED:
            gone = len(self._data) - REMEMBERED // 2
            del self._data[:gone]
            self._base += gone

    def get(self, offset: int, size: int) -> bytes:
        """Return the bytes from an offset on; fewer where they are gone, or not there yet."""
        start = offset - self._base
        return bytes(self._data[start : start + size]) if start >= 0 else b""
