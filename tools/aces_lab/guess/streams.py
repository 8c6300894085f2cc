"""What is in a byte stream that no protocol reads: its framings, what each packet is, and the fields of each kind.

1. Every byte is in a packet or in what is left; packets are those that the scanner of the draft finds.
2. At most `KEPT` bytes are looked at, and of these `SAMPLE` searched for framings.
3. Directions are lines of their own: a packet has bytes of one.

What tells packets apart is the byte (or two) in their head that says most about all else: how long they are, and what is in
the other bytes. Numbers of devices say little about that.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from aces_bus.protocol.columns.table import Array
from aces_bus.protocol.record import PlainValue
from aces_tools.reading.fitting import TRIED_BYTES, FittingProtocol, fitting_protocols

from .fields import FieldGuess, fields_of
from .framing_search import framings_of
from .framings import FramingGuess, framing_check, spans_of
from .reference import LATEST, MeasuredQuantity, Messages, ReferenceGuesses, sought
from .sample import SAMPLE, Sample, Span

#: Bytes that are looked at.
KEPT = 1 << 20
#: Bytes behind the sync bytes among which one may say what a packet is, and bytes whose content it may explain.
HEAD, EXPLAINED = 8, 32
#: Different opcodes at most, packets of each on average at least, and bits that an opcode must explain.
OPCODES, EACH, EXPLAINS_BITS = 64, 3.0, 1.0
#: Opcodes from which on one may have two bytes, and different bytes behind the first.
WIDE = 4, 3
#: Packets of one kind that are looked at.
ROWS = 8192
#: Kinds of packets that are drafted, of each framing.
KINDS = 64


@dataclass(frozen=True)
class PacketGuess:
    """Packets of one framing and one opcode; None: of all that its framing has.

    `fields` are of the first `size` bytes of a packet (unstuffed), or of those that all of them have where `sizes` are
    several.
    """

    framing: int
    opcode: bytes | None
    count: int
    sizes: tuple[int, ...]
    fields: tuple[FieldGuess, ...]
    #: A packet as it is on the wire.
    example: bytes

    @property
    def size(self) -> int:
        """The bytes that all of them have."""
        return self.sizes[0]

    def as_dict(self) -> dict[str, PlainValue]:
        """Return the guess in JSON's kinds."""
        return {
            "framing": self.framing,
            "opcode": None if self.opcode is None else self.opcode.hex(" ").upper(),
            "count": self.count,
            "sizes": list(self.sizes),
            "fields": [field.as_dict() for field in self.fields],
        }


@dataclass(frozen=True)
class StreamGuess:
    """All that was guessed of a stream. `spans` are the packets of each line (direction); what is between is unknown."""

    framings: tuple[FramingGuess, ...]
    packets: tuple[PacketGuess, ...]
    spans: tuple[tuple[Span, ...], ...]
    #: Bytes that were given, and of these the ones that were looked at and are in packets.
    bytes: int
    kept: int
    decoded: int
    #: Installed protocols that decode it, best first; then there is nothing to guess.
    known: tuple[FittingProtocol, ...] = ()
    reference: ReferenceGuesses | None = None

    def as_dict(self) -> dict[str, PlainValue]:
        """Return the guess in JSON's kinds."""
        return {
            "link": "serial",
            "bytes": self.bytes,
            "kept": self.kept,
            "decoded": self.decoded,
            "known": [
                {"name": protocol.name, "share": round(protocol.share, 4), "direction": protocol.direction}
                for protocol in self.known
            ],
            "reference": None if self.reference is None else self.reference.as_dict(),
            "framings": [framing.as_dict() for framing in self.framings],
            "packets": [packet.as_dict() for packet in self.packets],
        }


@dataclass
class _Line:
    chunks: list[tuple[bytes, float | None]] = field(default_factory=list[tuple[bytes, float | None]])
    size: int = 0


class StreamTraffic:
    """A byte stream as it comes; `guess` says what is in it."""

    def __init__(self) -> None:
        self._lines: dict[tuple[int, str | None], _Line] = {}
        self._recording = 0
        self.bytes = 0
        self.kept = 0

    def next_recording(self) -> None:
        """Begin another recording: no packet continues from the one before."""
        self._recording += 1

    def add(self, data: bytes, time: float | None = None, direction: str | None = None) -> None:
        """Add bytes of one direction, and when they came (s)."""
        self.bytes += len(data)
        data = data[: KEPT - self.kept]
        if data:
            line = self._lines.setdefault((self._recording, direction), _Line())
            line.chunks.append((data, time))
            line.size += len(data)
            self.kept += len(data)

    def guess(
        self, *, known: bool = True, quantity: MeasuredQuantity | None = None, latest_s: float = LATEST
    ) -> StreamGuess:
        """Return what is in it; with `known` installed protocols are tried first, and where one fits nothing is guessed.
        With a quantity, the fields that follow it are sought, with delays of up to `latest_s`; the first is in its packet.
        """
        lines = list(self._lines.values())
        whole = b"".join(data for line in lines for data, _ in line.chunks)
        fitting = tuple(fitting_protocols(whole[:TRIED_BYTES])) if known and whole else ()
        if fitting:
            return StreamGuess((), (), (), self.bytes, self.kept, 0, fitting)
        sample = _sample(lines)
        framings = framings_of(sample)
        if not framings:
            return StreamGuess((), (), tuple(() for _ in lines), self.bytes, self.kept, 0)
        framings, spans = self._scanned(framings, lines)
        if len(sample.data) < self.kept:
            said = f"found in {len(sample.data):,} of the bytes; packets are counted in all"
            framings = [replace(framing, evidence=(*framing.evidence, said)) for framing in framings]
        found: list[PacketGuess] = []
        messages: list[Messages] = []
        for number, framing in enumerate(framings):
            packets, times = _packets(lines, spans, number)
            logical = _logical(framing, packets)
            framing = framings[number] = replace(framing, opcode=opcode_of(framing, logical))
            for packet, rows, instants in _kinds(framing, number, logical, packets, times):
                found.append(packet)
                if instants is not None and rows.size:
                    code = "" if packet.opcode is None else f" {packet.opcode.hex(' ').upper()}"
                    shown = f"packet{code}"
                    messages.append(Messages((number, packet.opcode), instants * 1e-9, rows, shown))
        reference: ReferenceGuesses | None = None
        if quantity is not None:
            every = np.concatenate([np.zeros(0), *(some.times_s for some in messages)])
            reference = sought(messages, every, quantity, latest_s)
            found = [_with_reference(packet, messages, reference) for packet in found]
        decoded = sum(span.end - span.start for line in spans for span in line)
        return StreamGuess(
            tuple(framings),
            tuple(found),
            tuple(map(tuple, spans)),
            self.bytes,
            self.kept,
            decoded,
            reference=reference,
        )

    @staticmethod
    def _scanned(
        framings: list[FramingGuess], lines: Sequence[_Line]
    ) -> tuple[list[FramingGuess], list[list[Span]]]:
        """Return the framings with what they have of all that was kept."""
        spans = spans_of(framings, [line.chunks for line in lines])
        total = sum(line.size for line in lines)
        out: list[FramingGuess] = []
        for number, framing in enumerate(framings):
            own = [span for line in spans for span in line if span.framing == number]
            size = sum(span.end - span.start for span in own)
            out.append(replace(framing, packets=len(own), bytes=size, share=size / total))
        return out, spans


def _sample(lines: Sequence[_Line]) -> Sample:
    """Return the first bytes of each line, with their silences."""
    parts: list[bytes] = []
    borders = [0]
    chunks: list[tuple[int, int, float]] = []
    most = SAMPLE // max(1, min(len(lines), 8))
    timed = True
    for line in lines[:64]:
        size = 0
        for data, time in line.chunks:
            data = data[: most - size]
            if not data:
                break
            start = borders[-1] + size
            size += len(data)
            parts.append(data)
            timed = timed and time is not None
            if time is not None:
                chunks.append((start, start + len(data), time))
        borders.append(borders[-1] + size)
    sample = Sample(b"".join(parts), borders)
    if timed and len(chunks) > 3:
        sample.silences = list(_silences(chunks, set(borders)))
    return sample


def _silences(
    chunks: list[tuple[int, int, float]], borders: set[int]
) -> Iterator[tuple[float, list[tuple[int, int]]]]:
    """Return (pause in seconds, what is between pauses that are longer), if pauses are plainly of two kinds,
    or all alike.
    """
    starts = np.array([chunk[0] for chunk in chunks])
    times = np.array([chunk[2] for chunk in chunks])
    pauses = np.diff(times)
    usual = np.unique(np.round(pauses[(pauses > 1e-6) & ~np.isin(starts[1:], list(borders))], 6))
    if not len(usual):
        return
    limits = [usual[0] / 2]
    if len(usual) > 1:
        jumps = np.argsort(usual[1:] / usual[:-1])[::-1][:2]
        limits += [float(np.sqrt(usual[jump] * usual[jump + 1])) for jump in jumps]
    for limit in limits:
        first = np.concatenate([[True], (pauses > limit) | np.isin(starts[1:], list(borders))])
        at = np.flatnonzero(first)
        ends = np.append(starts[at[1:]], chunks[-1][1])
        yield float(f"{limit:.2g}"), list(zip(starts[at].tolist(), ends.tolist(), strict=True))


def _packets(
    lines: Sequence[_Line], spans: Sequence[Sequence[Span]], number: int
) -> tuple[list[bytes], Array | None]:
    """Return the packets of a framing, in the order of lines, and when they came (ns); None where that is not known."""
    packets: list[bytes] = []
    times: list[float] = []
    is_timed = True
    for line, some in zip(lines, spans, strict=True):
        data = b"".join(chunk for chunk, _ in line.chunks)
        starts = np.cumsum([0, *(len(chunk) for chunk, _ in line.chunks)])
        for span in some:
            if span.framing != number:
                continue
            packets.append(data[span.start : span.end])
            time = line.chunks[int(np.searchsorted(starts, span.start, "right")) - 1][1]
            is_timed = is_timed and time is not None
            times.append(time or 0.0)
    return packets, (np.array(times) * 1e9).astype(np.int64) if is_timed else None


def _logical(framing: FramingGuess, packets: list[bytes]) -> list[bytes]:
    """Return the packets as fields see them: without stuffing."""
    if framing.stuffing is None or not framing.end:
        return packets
    out: list[bytes] = []
    for packet in packets:
        try:
            out.append(framing.stuffing.unstuff(packet[len(framing.sync) : -len(framing.end)]))
        except ValueError:
            out.append(packet)
    return out


def body_end(framing: FramingGuess) -> int:
    """Return how many bytes at the end of a packet (unstuffed) are not fields: the check, what is behind it, the end.

    A check that a framing cannot declare is among the fields.
    """
    size = 0
    if framing.check is not None and not framing.is_check_in_front and framing_check(framing) is not None:
        size = framing.check.size + len(framing.tail)
    if framing.written is not None:
        size = framing.written.size
    return size + (len(framing.end) if framing.stuffing is None else 0)


# ---------------------------------------------------------------------- what tells packets apart


def opcode_of(framing: FramingGuess, packets: Sequence[bytes]) -> tuple[int, int] | None:
    """Return the offset and size of what says which packet it is; None where nothing in the head does.

    Of lines it is all up to the first character that is neither letter nor digit, when that is at one place.
    """
    if framing.kind == "lines":
        return _word_of(framing, packets)
    first = len(framing.sync)
    least = min(map(len, packets), default=0) - body_end(framing)
    places = [at for at in range(first, min(first + HEAD, least)) if not _is_known(framing, at)]
    if len(packets) < 8 or not places:
        return None
    some = packets if len(packets) <= ROWS else packets[:: len(packets) // ROWS + 1]
    width = min(least, first + EXPLAINED)
    data = np.array([list(packet[:width]) for packet in some], np.int64)
    sizes = np.array([len(packet) for packet in some], np.int64)
    columns = [data[:, at] for at in range(first, width) if not _is_known(framing, at)]
    # What sizes say counts where there are several: contents differ from device to device, too.
    explained = [] if len(np.unique(sizes)) > 1 else columns
    gains = {
        at: _explained(data[:, at], sizes, explained) * (0.5 + _settled(data[:, at], sizes)) for at in places
    }
    at = max(gains, key=lambda at: gains[at])
    if gains[at] < EXPLAINS_BITS:
        return None
    for start in (at - 1, at):
        if start in places and start + 1 in places:
            pair = data[:, start] << 8 | data[:, start + 1]
            if _explained(pair, sizes, []) >= _explained(data[:, at], sizes, []) + EXPLAINS_BITS:
                return start, 2
    if at + 1 in places and _is_of_two(data[:, at], data[:, at + 1]):
        return at, 2
    return at, 1


def _is_of_two(codes: Array, behind: Array) -> bool:
    """Return whether the byte behind an opcode is the rest of it: it changes with it, and never alone."""
    kinds, pairs = len(np.unique(codes)), len(np.unique(codes << 8 | behind))
    return pairs == kinds >= WIDE[0] and len(np.unique(behind)) >= WIDE[1]


def _settled(codes: Array, sizes: Array) -> float:
    """Return the share of packets whose code has one size."""
    _, kinds = np.unique(codes, return_inverse=True)
    least = np.full(int(kinds.max()) + 1, 1 << 30)
    most = np.zeros(len(least), np.int64)
    np.minimum.at(least, kinds, sizes)
    np.maximum.at(most, kinds, sizes)
    return float((least == most)[kinds].mean())


def _is_known(framing: FramingGuess, at: int) -> bool:
    """Return whether a byte is of the length, or of a check in the header."""
    length, check = framing.length, framing.check if framing.is_check_in_front else None
    return (length is not None and length.offset <= at < length.offset + length.width) or (
        check is not None and check.offset <= at < check.offset + check.size
    )


def _explained(codes: Array, sizes: Array, columns: Sequence[Array]) -> float:
    """Return how many bits of sizes and contents a number explains; 0 where it is not a number of kinds."""
    _, kinds = np.unique(codes, return_inverse=True)
    count = int(kinds.max()) + 1
    if count < 2 or count > OPCODES or len(codes) < EACH * count:
        return 0.0
    gain = 4 * _shared(sizes, kinds, count)
    return gain + sum(_shared(column, kinds, count) for column in columns if (column != codes).any())


def _shared(values: Array, kinds: Array, count: int) -> float:
    """Return mutual information in bits, less what this many kinds give by chance."""
    _, values = np.unique(values, return_inverse=True)
    number = int(values.max()) + 1
    if number < 2:
        return 0.0
    table = np.zeros((number, count))
    np.add.at(table, (values, kinds), 1)
    table /= len(values)
    expected = table.sum(axis=1, keepdims=True) * table.sum(axis=0, keepdims=True)
    there = table > 0
    bits = float((table[there] * np.log2(table[there] / expected[there])).sum())
    return max(0.0, bits - float((number - 1) * (count - 1) / (2 * len(values) * np.log(2))))


def _word_of(framing: FramingGuess, packets: Sequence[bytes]) -> tuple[int, int] | None:
    first = len(framing.sync)
    ends: Counter[int] = Counter()
    for packet in packets:
        end = first
        while end < len(packet) and packet[end : end + 1].isalnum():
            end += 1
        ends[end] += 1
    if not ends:
        return None
    end, count = ends.most_common(1)[0]
    return (first, end - first) if count >= 0.9 * len(packets) and end - first >= 2 else None


# ---------------------------------------------------------------------- kinds of packets


def _kinds(
    framing: FramingGuess, number: int, logical: list[bytes], wire: list[bytes], times: Array | None
) -> Iterator[tuple[PacketGuess, Array, Array | None]]:
    """Yield the packets by their opcode, the most frequent first, with their fields; the rows that these are of, and when
    they came (ns).
    """
    groups: dict[bytes | None, list[int]] = {}
    for index, packet in enumerate(logical):
        groups.setdefault(_code(framing, packet), []).append(index)
    for code, members in sorted(groups.items(), key=lambda group: -len(group[1]))[:KINDS]:
        members = members[:ROWS]
        sizes = sorted({len(logical[index]) for index in members})
        fields: list[FieldGuess] = []
        rows: Array = np.zeros((0, 0), np.uint8)
        instants = None if times is None else times[members]
        # Packets of many lengths that nothing tells apart are not one message.
        if framing.kind != "lines" and (code is not None or len(sizes) == 1):
            start, end = framing.head_end, sizes[0] - body_end(framing)
            if end > start:
                rows = np.array([list(logical[index][start:end]) for index in members], np.uint8)
                fields = fields_of(rows, instants)
        guess = PacketGuess(number, code, len(groups[code]), tuple(sizes), tuple(fields), wire[members[0]])
        yield guess, rows, instants


def _with_reference(
    packet: PacketGuess, messages: Sequence[Messages], reference: ReferenceGuesses
) -> PacketGuess:
    """Return a packet with the field that a quantity is, if that is in it."""
    key = packet.framing, packet.opcode
    given = reference.fields_of([key])
    if not given:
        return packet
    rows = next(some.rows for some in messages if some.key == key)
    return replace(packet, fields=tuple(fields_of(rows, given=given)))


def _code(framing: FramingGuess, packet: bytes) -> bytes | None:
    if framing.opcode is None:
        return None
    at, size = framing.opcode
    return packet[at : at + size]
