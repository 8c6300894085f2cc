"""What `aces spec explain` explains: frames or bytes from a recording, standard input or the command line.

1. What lies before the wanted place is read by the generated scanner, which is quick; the reference reads what is
   explained, and so much before it that replies find their requests.
2. Memory is bounded: of a stream `LARGEST` bytes are kept, frames come one by one.
"""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

from aces_bus import Unknown, make_scanner, open_recording
from aces_bus.errors import CallerError
from aces_bus.protocol import Variant
from aces_bus.protocol.declare.examples import parse_packet
from aces_bus.protocol.explain.attempt import Attempt
from aces_bus.protocol.explain.tracer import Tracer
from aces_bus.protocol.lint.examples import example_frame
from aces_bus.recordings.base import CanRecording, SerialRecording

from ..reading.pieces import Direction, check_direction, has_requests

#: Bytes of a stream that are read; frames are read one by one.
LARGEST = 8 * 2**20
#: Items before the wanted one that are read anew, so that replies find their requests.
BEFORE = 64
#: Bytes around the wanted one that are read anew at most, beside one packet on either side.
SPAN = 16384


@dataclass
class FrameInput:
    """The frames of a capture, one after the other."""

    variants: Sequence[Variant]
    frames: Iterable[Any]
    label: str = ""
    seen: int = 0
    is_cut: bool = False

    @property
    def counted(self) -> str:
        return f"{self.seen} frame{'' if self.seen == 1 else 's'}"

    def attempts(self, at: int | None, count: int) -> list[Attempt]:
        """Return the frames from `at` on. Those before are read as fast as they can be; requests are remembered."""
        tracer = Tracer(self.variants)
        interesting = tracer.interesting
        scanner: Any = make_scanner(self.variants, include_unknown=True)
        found: list[Attempt] = []
        first = at or 0
        for number, frame in enumerate(self.frames):
            self.seen = number + 1
            if number < first:
                records = scanner.feed([frame])
                is_part = scanner.has_transports and scanner.carries(frame)
                if is_part or any(
                    type(r) is not Unknown and type(r).__name__ in interesting for r in records
                ):
                    tracer.frames([frame], number)
                continue
            found += tracer.explain_frames([frame], number)
            if len(found) >= count:
                return found[:count]
        return (found + tracer.explain_end())[:count]


@dataclass
class StreamInput:
    """The bytes of one direction, with what happened between them."""

    variants: Sequence[Variant]
    direction: Direction | None
    label: str = ""
    data: bytearray = field(default_factory=bytearray)
    idle_at: list[int] = field(default_factory=list)
    sent_at: list[tuple[int, bytes]] = field(default_factory=list)
    is_cut: bool = False

    @property
    def largest(self) -> int:
        """Bytes of the longest packet."""
        return max((f.max_size for v in self.variants for f in v.protocol.framings), default=0)

    @property
    def counted(self) -> str:
        return f"{len(self.data)} byte{'' if len(self.data) == 1 else 's'}"

    def attempts(self, at: int | None, count: int) -> list[Attempt]:
        """Return the decisions from the one that has byte `at` on."""
        check_direction(self.variants, self.direction)
        data = bytes(self.data)
        if at is not None and at >= len(data):
            return []
        tracer = Tracer(self.variants, direction=self.direction)
        start, end = self._around(at or 0, count)
        for offset, packet in self.sent_at:
            if offset < start:
                tracer.sent(packet)
        attempts = tracer.explain_stream(
            data[start:end],
            idle_at=[offset - start for offset in self.idle_at if start <= offset <= end],
            sent_at=[(offset - start, packet) for offset, packet in self.sent_at if start <= offset <= end],
            base=start,
            # What begins near a cut may end behind it: only the scanner knows, and is not asked here.
            wanted=range(at or 0, len(data) if end == len(data) else end - self.largest),
        )
        return attempts[:count]

    def _around(self, at: int, count: int) -> tuple[int, int]:
        """Return from where to where the reference has to read: the scanner, which is quick, finds the borders."""
        scanner: Any = make_scanner(self.variants, direction=self.direction, include_unknown=True)
        last: deque[int] = deque(maxlen=BEFORE)
        behind = 0
        events: list[tuple[int, bytes | None]] = [(offset, None) for offset in self.idle_at]
        events += self.sent_at
        events.sort(key=lambda event: (event[0], event[1] is not None))
        done = 0
        data = bytes(self.data)
        pieces: list[tuple[int, bytes | Literal["end"] | None]] = [*events, (len(data), "end")]
        for offset, event in pieces:
            while done < offset:
                step = min(4096, offset - done)
                for item in scanner.feed(data[done : done + step]):
                    if item.meta.offset + item.meta.size <= at:
                        last.append(item.meta.offset)
                    else:
                        behind += 1
                done += step
                is_enough = behind > count + 1 or done > at + SPAN
                if is_enough and done > at + self.largest:
                    return _begin(last, at), min(len(data), done + 2 * self.largest)
            if event is None:
                scanner.idle()
            elif isinstance(event, bytes):
                scanner.sent(event)
        return _begin(last, at), len(data)


def _begin(borders: Iterable[int], at: int) -> int:
    """Return the first border of decisions that is near enough; else the last one before `at`."""
    listed = list(borders)
    return next((border for border in listed if at - border <= SPAN), listed[-1] if listed else 0)


def inputs_of(
    capture: str, variants: Sequence[Variant], direction: Direction | None
) -> Iterator[FrameInput | StreamInput]:
    """Yield what the capture holds, for the protocols of its link."""
    can = [variant for variant in variants if variant.link == "can"]
    streams = [variant for variant in variants if variant.link != "can"]
    if capture.startswith("hex:"):
        if not streams:
            raise CallerError("hex: is for bytes of a stream; a CAN frame is written '063#78 00'")
        stream = StreamInput(streams, direction)
        try:
            stream.data += bytes.fromhex(capture[4:].replace(",", " "))
        except ValueError:
            raise CallerError(f"{capture}: not hexadecimal bytes such as hex:FFFF0102") from None
        yield stream
        return
    if re.match(r"\s*[0-9A-Fa-f]{1,8}#", capture):
        if not can:
            raise CallerError(
                f"{capture}: a CAN frame, but no protocol that was named is for CAN; bytes: hex:FFFF01"
            )
        try:
            frames = [parse_packet(text, is_can=True) for text in re.split(r"[;,]", capture) if text.strip()]
        except ValueError as error:
            raise CallerError(str(error)) from None
        yield FrameInput(can, [example_frame(frame) for frame in frames])
        return
    opened: CanRecording | SerialRecording
    if not streams:
        opened = open_recording(capture, link="can")
    elif not can:
        opened = open_recording(capture, link="serial")
    else:
        opened = open_recording(capture)
    with opened:
        if isinstance(opened, CanRecording):
            yield FrameInput(can, (frame for frames in opened.batches(256) for frame in frames))
        else:
            yield from _streams(opened, streams, direction)


def _streams(
    capture: SerialRecording, variants: list[Variant], direction: Direction | None
) -> Iterator[StreamInput]:
    """Yield the bytes of a serial capture: one stream a direction, requests going over to the replies'."""
    found: dict[Direction | None, StreamInput] = {}
    is_paired = any(map(has_requests, variants))
    requests: Any = make_scanner(variants, direction="to device") if is_paired else None
    total = 0
    for chunk in capture:
        way: Direction | None = direction or chunk.direction
        if not chunk.data:
            for stream in found.values():
                stream.idle_at.append(len(stream.data))
            continue
        stream = found.setdefault(way, StreamInput(variants, way, "" if way is None else way))
        room = LARGEST - total
        stream.data += chunk.data[:room]
        total += len(chunk.data)
        if way == "to device" and direction is None and requests is not None:
            replies = found.setdefault("from device", StreamInput(variants, "from device", "from device"))
            replies.sent_at += [
                (len(replies.data), r.meta.raw) for r in requests.feed(chunk.data, chunk.time)
            ]
        if total >= LARGEST:
            stream.is_cut = True
            break
    ways = [stream for stream in found.values() if stream.data]
    for stream in ways:
        if len(ways) == 1:
            stream.label = ""
        yield stream
