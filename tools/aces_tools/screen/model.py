"""What the live screen knows: one row for everything that is repeated on a bus, with its rate, its last value, its changes.

1. No terminal, no thread, no clock: items are fed, instants (host's monotonic ns) are parameters.
2. Every item is counted once: the rows' counts and those of `others` sum to `total`.
3. Memory is bounded: after a batch there are at most `limit` rows. Beyond that those that are silent, then the rarest,
   are folded into `others`.
4. A frame costs a look-up and a few additions. What is done once a batch (rates, exact length on the wire, the history
   for curves) is done for the rows that the batch touched, with their last frame.

A row is what one sender repeats: channel, identifier, message, and its page: the values of the fields that say what the
rest means (the selector of multiplexed fields, the board or servo that a message's head names).

*Choice*: rates are of this host's time, as frames come in; period and jitter of the adapter's stamps, where it gives any.
Bits on the wire are counted to the bit (`frame_bits`) for the last frame of a row in a batch and taken for its others:
frames of one row differ by a few stuff bits.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Hashable, Sequence
from copy import copy
from dataclasses import dataclass, field
from math import exp, sqrt
from operator import attrgetter
from typing import Any

from aces_bus import Frame, Unknown
from aces_bus.errors import CallerError
from aces_bus.frames import key_of
from aces_bus.hardware.gate import Received
from aces_bus.hardware.gate_events import BusEvent
from aces_bus.hardware.simulated.frame_time import INTERMISSION, frame_bits
from aces_bus.protocol.live.scanner import Scanner

from ..output.shape import OfKind
from .values import FieldFormat, FieldsOfKinds

#: Rows, channels and events that are kept, at most.
LIMIT, CHANNELS, EVENTS = 2000, 32, 200
#: Seconds over which rates of rows and of channels are smoothed.
ROW_TAU_S, CHANNEL_TAU_S = 2.0, 1.0
#: The weight of one more interval in a row's period and jitter.
SMOOTH = 1 / 32
#: Values a row remembers for its curves, and the least time between two of them.
HISTORY, STEP_NS = 40, 90_000_000
#: How long a change counts as recent, and how finely its age is known.
RECENT_NS, FINE_NS = 3_000_000_000, 50_000_000
#: Bytes of a packet in which changes are looked for.
COMPARED = 64
#: A row that has not come for so long, and for so many of its intervals, is silent.
SILENT_NS, SILENT_INTERVALS = 2_000_000_000, 5

Place = tuple[Hashable, ...]


class RepeatedFrame:
    """What is repeated: its counts, its pace, and the last of it."""

    __slots__ = (
        "_interval_ns",
        "_meter",
        "_sampled_ns",
        "_variance",
        "changes",
        "channel",
        "count",
        "data",
        "frame",
        "fresh",
        "fresh_mask",
        "history",
        "host_ns",
        "identifier",
        "is_lost",
        "key",
        "name",
        "number",
        "period_s",
        "place",
        "record",
        "search",
        "seen_ns",
        "stamp",
        "wire_bits",
    )

    def __init__(self, place: Place, number: int, channel: str, name: str, host_ns: int) -> None:
        self.place, self.number, self.channel, self.name = place, number, channel, name
        #: The key of `aces_bus.frames`, and as it is shown; of a stream what tells its senders apart.
        self.key = -1
        self.identifier = ""
        #: Whether it is none of the protocols' messages.
        self.is_lost = False
        self.count = 0
        self.data = b""
        self.frame: Frame | None = None
        self.record: Any = None
        #: The host's time of the last one, and up to where rates have been reckoned.
        self.host_ns = self.seen_ns = host_ns
        self.stamp: float | None = None
        #: Bit times on the bus of the last one, with the intermission (CAN).
        self.wire_bits = 0.0
        #: The smoothed time between two, in seconds.
        self.period_s = 0.0
        self._variance = 0.0
        self._interval_ns = 0.0
        self._meter = Meter(ROW_TAU_S, host_ns)
        #: Frames, and bits that changed, since the batch began.
        self.fresh = self.fresh_mask = 0
        #: When (host ns) which bits changed, oldest first; bit 0 is the lowest bit of the first byte.
        self.changes: deque[tuple[int, int]] = deque(maxlen=RECENT_NS // FINE_NS)
        self.history: deque[Any] = deque(maxlen=HISTORY)
        self._sampled_ns = host_ns - STEP_NS
        #: What a text filter looks in.
        self.search = ""

    # ------------------------------------------------------------------ hot

    def received(self, data: bytes, stamp: float) -> None:
        """Take one more frame; `stamp` in seconds of whichever clock stamps this bus."""
        if data != self.data and self.count:
            self.fresh_mask |= changed_bits(self.data, data)
        self.data = data
        self.count += 1
        if self.stamp is not None:
            gap = stamp - self.stamp
            if gap >= 0:  # else the adapter's clock went back
                weight = 1 / (self.count - 1) if self.count < 33 else SMOOTH
                off = gap - self.period_s
                step = weight * off
                self.period_s += step
                self._variance = (1 - weight) * (self._variance + off * step)
        self.stamp = stamp

    def settle(self, now_ns: int) -> int:
        """End a batch; return how many frames it had of this row."""
        fresh, self.fresh = self.fresh, 0
        first = self.count == fresh
        self._meter.add(self.host_ns, fresh - first)  # the first one opens the first interval
        if not first or fresh > 1:
            interval = (self.host_ns - self.seen_ns) / (fresh - first)
            self._interval_ns += (interval - self._interval_ns) * (0.25 if self._interval_ns else 1)
        self.seen_ns = self.host_ns
        if self.fresh_mask:
            changes = self.changes
            if changes and now_ns - changes[-1][0] < FINE_NS:
                changes[-1] = changes[-1][0], changes[-1][1] | self.fresh_mask
            else:
                changes.append((now_ns, self.fresh_mask))
            self.fresh_mask = 0
        if now_ns - self._sampled_ns >= STEP_NS and self.record is not None and not self.is_lost:
            self._sampled_ns = now_ns
            self.history.append(self.record)
        return fresh

    # ------------------------------------------------------------------ what is shown

    @property
    def jitter_s(self) -> float:
        """The standard deviation of the period, in seconds."""
        return sqrt(max(0.0, self._variance))

    def rate(self, now_ns: int) -> float:
        """Return the frames a second, smoothed; of a rare frame, the reciprocal of its interval."""
        if self.count < 2:
            return 0.0
        if self._interval_ns * 3 > ROW_TAU_S * 1e9:
            return 1e9 / max(self._interval_ns, now_ns - self.host_ns)
        return self._meter.per_second(now_ns)

    def is_silent(self, now_ns: int) -> bool:
        """Return whether it has not come for longer than it should."""
        return now_ns - self.host_ns > max(SILENT_NS, SILENT_INTERVALS * self._interval_ns)

    @property
    def changed_ns(self) -> int:
        """When something changed last (host ns); 0: nothing yet."""
        return self.changes[-1][0] if self.changes else 0

    def ages(self, now_ns: int, steps_ns: Sequence[int]) -> list[int]:
        """Return for each of the steps, in ns and rising, the bits that changed within it and not within one before."""
        found = [0] * len(steps_ns)
        for when, mask in self.changes:
            age = now_ns - when
            for index, step in enumerate(steps_ns):
                if age < step:
                    found[index] |= mask
                    break
        taken = 0
        for index, mask in enumerate(found):
            found[index] = mask & ~taken
            taken |= mask
        return found

    def frozen(self) -> RepeatedFrame:
        """Return a copy that stays as it is."""
        row = copy(self)
        row.changes, row.history, row._meter = copy(self.changes), copy(self.history), copy(self._meter)
        return row


def changed_bits(before: bytes, after: bytes) -> int:
    """Return the bits that differ, bit 0 the lowest bit of the first byte; of bytes that came or went, all."""
    before, after = before[:COMPARED], after[:COMPARED]
    mask = int.from_bytes(before, "little") ^ int.from_bytes(after, "little")
    if (size := len(after)) != (old := len(before)):
        low, high = min(size, old), max(size, old)
        mask |= (1 << 8 * high) - (1 << 8 * low)
    return mask


@dataclass
class ChannelRates:
    """One bus of those that are listened to: frames, and bits on the wire, in all and a second."""

    name: str
    start_ns: int
    frames: int = 0
    errors: int = 0
    unknown: int = 0
    bits: float = 0.0
    frame_meter: Meter = field(init=False)
    bit_meter: Meter = field(init=False)

    def __post_init__(self) -> None:
        self.frame_meter = Meter(CHANNEL_TAU_S, self.start_ns)
        self.bit_meter = Meter(CHANNEL_TAU_S, self.start_ns)


@dataclass
class FoldedRows:
    """Rows that were folded away, by channel: how many, and their frames."""

    rows: int = 0
    count: int = 0


class Model:
    """Rows, channels, events: everything that the screen shows.

    `scanner` decodes (None: nothing is decoded); it has to be made with `include_unknown`: it says of each frame what it is.
    `bitrate` and `data_bitrate` in bit/s (of a serial line `bitrate` is its baud rate); None: not known. `name` is shown
    for frames that do not say their channel.
    """

    def __init__(
        self,
        scanner: Scanner | None,
        *,
        name: str = "",
        bitrate: int | None = None,
        data_bitrate: int | None = None,
        limit: int = LIMIT,
    ) -> None:
        self.scanner = scanner if getattr(scanner, "variants", ()) else None
        self.name, self.limit = name, limit
        self.bitrate, self.data_bitrate = bitrate, data_bitrate
        self._data_share = 1.0 if not (bitrate and data_bitrate) else bitrate / data_bitrate
        self.fields = fields = FieldsOfKinds(getattr(scanner, "variants", ()))
        self._pages: OfKind[Callable[[Any], Hashable] | None] = OfKind(
            lambda kind: (
                attrgetter(*known.page) if (known := fields[kind]) is not None and known.page else None
            )
        )
        if self.scanner is not None and not getattr(scanner, "include_unknown", True):
            raise CallerError("the screen's scanner has to be made with include_unknown=True")
        self.events: deque[BusEvent] = deque(maxlen=EVENTS)
        self.event_counts: dict[str, int] = {}
        self._incoming: deque[BusEvent] = deque(maxlen=EVENTS)
        self._numbers = 0
        self.clear()

    def clear(self) -> None:
        """Forget what was received; begin anew."""
        self.rows: dict[Place, RepeatedFrame] = {}
        self.others: dict[str, FoldedRows] = {}
        self.channels: dict[str, ChannelRates] = {}
        self.total = self.errors = self.unknown = self.malformed = 0
        #: Goes up when rows come or go.
        self.generation = getattr(self, "generation", 0) + 1

    # ------------------------------------------------------------------ events

    def emit(self, event: BusEvent) -> None:
        """Take an event of the bus; called on any thread."""
        self._incoming.append(event)

    def take_events(self) -> None:
        """Count the events that came through `send`."""
        while self._incoming:
            event = self._incoming.popleft()
            self.events.append(event)
            self.event_counts[event.kind] = self.event_counts.get(event.kind, 0) + 1

    # ------------------------------------------------------------------ CAN

    def feed(self, items: Sequence[Received[Frame]]) -> None:
        """Take frames as a gate hands them over, in order."""
        if not items:
            return
        touched: list[RepeatedFrame] = []
        rows, pages, scanner = self.rows, self._pages, self.scanner
        frames = [item.content for item in items]
        records: Sequence[Any]
        if getattr(scanner, "has_transports", False) and scanner is not None:
            # A record may be of several frames: it is shown with the one that decided.
            found = [(item, record) for item in items for record in scanner.feed((item.content,))]
            deciding, records = [item for item, _ in found], [record for _, record in found]
            frames = [item.content for item in deciding]
        else:
            deciding = list(items)
            records = [None] * len(frames) if scanner is None else scanner.feed(frames)
        record: Any
        for item, frame, record in zip(deciding, frames, records, strict=True):
            kind: Any = type(record)
            page = pages[kind]
            if page is not None:
                place: Place = frame.channel, record._key, kind, page(record)
            elif kind is Unknown:
                place = frame.channel, self._key(frame), record.kind
            elif record is None:
                place = frame.channel, self._key(frame), "error" if frame.is_error_frame else ""
            else:
                place = frame.channel, record._key, kind
            row = rows.get(place)
            if row is None:
                row = self._can_row(place, frame, record, item.host_ns)
            if not row.fresh:
                touched.append(row)
            row.fresh += 1
            row.frame, row.record, row.host_ns = frame, record, item.host_ns
            row.received(frame.data, frame.timestamp or item.host_ns / 1e9)
        self._settle(touched, items[0].host_ns, items[-1].host_ns)

    @staticmethod
    def _key(frame: Frame) -> int:
        return key_of(
            frame.arbitration_id,
            extended=frame.is_extended_id,
            remote=frame.is_remote_frame,
            fd=frame.is_fd,
        )

    def _can_row(self, place: Place, frame: Frame, record: Any, host_ns: int) -> RepeatedFrame:
        row = self._row(place, frame.channel, record, host_ns)
        row.key = self._key(frame)
        row.identifier = f"{frame.arbitration_id:0{8 if frame.is_extended_id else 3}X}"
        kinds = [
            word
            for word, has in (
                ("error frame", frame.is_error_frame),
                ("remote", frame.is_remote_frame),
                ("fd", frame.is_fd),
            )
            if has
        ]
        if frame.is_error_frame:
            row.name, row.is_lost = "error frame", True
        row.search = " ".join([row.search, row.identifier, *kinds]).lower()
        return row

    # ------------------------------------------------------------------ streams

    def feed_records(self, records: Sequence[Any], host_ns: int, bits: int = 0) -> None:
        """Take packets that a scanner found, and the bits on the line that brought them."""
        touched: list[RepeatedFrame] = []
        for record in records:
            kind = type(record)
            data: bytes
            if kind is Unknown:
                place: Place = (record.kind,)
                data, stamp = record.meta.raw, record.meta.time
            else:
                page = self._pages[kind]
                place = (kind,) if page is None else (kind, page(record))  # type: ignore[assignment]
                data, stamp = record._raw, record._time
            row = self.rows.get(place)
            if row is None:
                row = self._row(place, None, record, host_ns)
                if kind is not Unknown and len(place) > 1:
                    page_value = place[1]
                    row.identifier = (
                        " ".join(map(str, page_value)) if isinstance(page_value, tuple) else str(page_value)
                    )
                    row.search += f" {row.identifier.lower()}"
            if not row.fresh:
                touched.append(row)
            row.fresh += 1
            row.record, row.host_ns = record, host_ns
            row.received(data, stamp or host_ns / 1e9)
        channel = self._channel(self.name, host_ns)
        channel.bits += bits
        channel.bit_meter.add(host_ns, bits)
        self._settle(touched, host_ns, host_ns)

    # ------------------------------------------------------------------ rows

    def _row(self, place: Place, channel: str | None, record: Any, host_ns: int) -> RepeatedFrame:
        self._numbers += 1
        self.generation += 1
        fields = self.fields[type(record)]
        shown = channel or self.name
        is_lost = type(record) is Unknown
        name = (
            (record.kind if record.kind != "errors" else "error frame")
            if is_lost
            else (fields.name if fields is not None else "")
        )
        row = self.rows[place] = RepeatedFrame(place, self._numbers, shown, name, host_ns)
        row.is_lost = is_lost
        words = [shown, name]
        if fields is not None:
            words += [fields.protocol, *fields.names, *(f"{n}={v}" for n, v in fields.page_of(record))]
        row.search = " ".join(words).lower()
        return row

    def _fold(self, now_ns: int) -> None:
        """Make room for a quarter of the rows: first what is silent goes, then what is rare."""
        worst = sorted(
            self.rows.values(), key=lambda row: (not row.is_silent(now_ns), row.count, row.host_ns)
        )
        for row in worst[: len(worst) - self.limit + self.limit // 4]:
            others = self.others.setdefault(row.channel, FoldedRows())
            others.rows += 1
            others.count += row.count
            del self.rows[row.place]
        self.generation += 1

    def _channel(self, name: str, start_ns: int) -> ChannelRates:
        found = self.channels.get(name)
        if found is None:
            if len(self.channels) >= CHANNELS:
                name = "…"
                if name in self.channels:
                    return self.channels[name]
            found = self.channels[name] = ChannelRates(name, start_ns)
        return found

    def _settle(self, touched: Sequence[RepeatedFrame], start_ns: int, now_ns: int) -> None:
        """End a batch: update rates, bits on the wire and counts."""
        sums: dict[str, list[float]] = {}
        for row in touched:
            fresh = row.settle(now_ns)
            self.total += fresh
            counts = sums.setdefault(row.channel, [0, 0.0, 0, 0])
            counts[0] += fresh
            frame = row.frame
            if frame is not None:
                bits = frame_bits(frame)
                row.wire_bits = bits.nominal + bits.data * self._data_share + INTERMISSION
                counts[1] += fresh * row.wire_bits
            if row.is_lost:
                if row.name == "error frame":
                    self.errors += fresh
                    counts[2] += fresh
                elif row.name == "malformed":
                    self.malformed += fresh
                else:
                    self.unknown += fresh
                    counts[3] += fresh
        for name, (frames, wire, errors, unknown) in sums.items():
            channel = self._channel(name, start_ns)
            channel.frames += int(frames)
            channel.errors += int(errors)
            channel.unknown += int(unknown)
            channel.bits += wire
            channel.frame_meter.add(now_ns, frames)
            channel.bit_meter.add(now_ns, wire)
        if len(self.rows) > self.limit:
            self._fold(now_ns)

    # ------------------------------------------------------------------ what is shown

    def load(self, channel: ChannelRates, now_ns: int) -> float | None:
        """Return the share of the bus's time that is taken, 0…1; None where the bit rate is not known."""
        return channel.bit_meter.per_second(now_ns) / self.bitrate if self.bitrate else None

    def fields_of(self, row: RepeatedFrame) -> FieldFormat | None:
        """Return how the row's message is shown; None where it is none."""
        return self.fields[type(row.record)]

    @property
    def is_can(self) -> bool:
        """True if the bus carries frames, not packets of a byte stream."""
        return self.scanner is None or self.scanner.link == "can"

    @property
    def folded(self) -> FoldedRows:
        """Number of rows and frames that are folded away, over all channels."""
        return FoldedRows(
            sum(other.rows for other in self.others.values()),
            sum(other.count for other in self.others.values()),
        )


# ---------------------------------------------------------------------- rates

#: Younger than this, nothing is divided by a meter's age, in seconds.
YOUNGEST_S = 0.05


class Meter:
    """Adds amounts, gives the amount a second over about the last `tau_s` seconds.

    >>> meter = Meter(1.0, 0)
    >>> for tenth in range(1, 51):
    ...     meter.add(tenth * 100_000_000, 80)
    >>> round(meter.per_second(5_000_000_000))
    800
    """

    __slots__ = ("_amount", "_at", "_start", "_tau")

    def __init__(self, tau_s: float, start_ns: int) -> None:
        self._tau = tau_s * 1e9
        self._start = self._at = start_ns
        self._amount = 0.0

    def add(self, now_ns: int, amount: float) -> None:
        """Add an amount that has come until `now_ns`."""
        age = now_ns - self._at
        if age > 0:
            half = exp(-0.5 * age / self._tau)
            self._amount = self._amount * half * half + amount * half
            self._at = now_ns
        else:
            self._amount += amount

    def _faded(self, now_ns: int) -> float:
        age = now_ns - self._at
        return self._amount * exp(-age / self._tau) if age > 0 else self._amount

    def per_second(self, now_ns: int) -> float:
        """Return the amount a second at `now_ns`."""
        tau = self._tau / 1e9
        age = max((now_ns - self._start) / 1e9, YOUNGEST_S)
        return self._faded(now_ns) / (tau * (1.0 - exp(-age / tau)))
