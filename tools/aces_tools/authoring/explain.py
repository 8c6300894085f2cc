"""Why the words of a capture are decoded as they are: template by template.

  aces spec explain robotis session.bin --direction both --at 1200
                                    what the byte at offset 1200 belongs to
  aces spec explain hubo walk.log --at 17
                                    frame 17 (from 0)
  aces spec explain my_spec.py hex:FFFF0104020032C6 --direction to
  aces spec explain hubo '001#05 24 07; 1C5#C8 00 00 00 F4 01 A0 4F'
                                    bytes or frames from the command line
  aces spec explain hubo robotis x  several protocols on one bus, in order
  … --svg why.svg                   a picture as well

Each word (a byte; of a frame identifier, length and bytes) has a line: what it
is, what was read with it (=), which templates it rules out and why (✗), which
are left (○). Behind them stands what the scanner decides (→), and where the
search goes on. CAPTURE is whatever `aces decode` takes; - is standard input.

A Python file is executed with your rights: name only what you trust.

exit status: 0 everything explained was decoded, 1 something was not,
2 a wrong call or a file that cannot be read
"""

from __future__ import annotations

import argparse
import json
import re
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

from aces_bus.capture import CanCapture, SerialCapture, open_capture
from aces_bus.errors import CallerError
from aces_bus.protocol import Unknown, Variant, make_scanner
from aces_bus.protocol.explain import Attempt, Tracer
from aces_bus.protocol.lint.examples import frame_of, plain
from aces_bus.protocol.spec.examples import parse_word
from aces_bus.protocol.spec.fields import FlagSet

from ..console import Output, say, terminal_width, wants_colour
from ..output.text import make_paint, no_paint
from ..protocols_arg import parse_protocols
from .explain_text import lines_of

Direction = Literal["to device", "from device", "both"]
DIRECTIONS: dict[str | None, Direction | None] = {
    "to": "to device",
    "from": "from device",
    "both": "both",
    None: None,
}
#: Bytes of a stream that are read; frames are read one by one.
LARGEST = 8 * 2**20
#: Items before the wanted one that are read anew, so that replies find their requests.
BEFORE = 64
#: Bytes around the wanted one that are read anew at most, beside one packet on either side.
SPAN = 16384


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("protocols", nargs="+", metavar="FILE|NAME", help="as -p of `aces decode`; the first wins")
    add("capture", metavar="CAPTURE", help="a recording, -, hex:FFFF01…, or frames such as '063#78 00'")
    add(
        "--at",
        type=_number,
        metavar="OFFSET|FRAME",
        help="what this byte or frame belongs to (from 0; 0x10 too)",
    )
    add("--count", type=_number, metavar="N", help="so many decisions (default: 12, with --at 1)")
    add("--direction", choices=["to", "from", "both"], help="which way the bytes of a raw file went")
    add("--json", action="store_true", help="for programs")
    add("--svg", metavar="FILE", help="write a picture too")
    add("--color", action=argparse.BooleanOptionalAction, default=None, help="default: on a terminal")


def _number(text: str) -> int:
    try:
        number = int(text, 0)
    except ValueError:
        number = -1
    if number < 0:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number from 0 on, such as 17 or 0x11")
    return number


def run(arguments: argparse.Namespace) -> int:
    variants = parse_protocols(arguments.protocols)
    count = arguments.count if arguments.count is not None else 1 if arguments.at is not None else 12
    if count < 1:
        raise CallerError("--count: at least one decision is explained")
    inputs = list(_inputs(arguments, variants))
    groups = [(one.label, one.attempts(arguments.at, count)) for one in inputs]
    if arguments.at is not None and not any(attempts for _, attempts in groups):
        raise CallerError(f"--at {arguments.at}: {arguments.capture} has {_counted(inputs)}")
    attempts = [attempt for _, found in groups for attempt in found]
    if arguments.svg:
        _write_svg(arguments, attempts)
    if arguments.json:
        objects = [_as_dict(attempt, label) for label, found in groups for attempt in found]
        print(json.dumps(objects, ensure_ascii=False, indent=2, default=_jsonable))
    else:
        _print(groups, arguments)
    for one in inputs:
        if one.is_cut:
            say(
                f"{arguments.capture}: only the first {LARGEST >> 20} MiB were read; cut it with 'aces convert --from'"
            )
    if not attempts:
        say(f"{arguments.capture}: there is nothing to explain")
    return int(any(attempt.found.message is None for attempt in attempts))


def _counted(inputs: Sequence[Any]) -> str:
    return " and ".join(one.counted for one in inputs) or "nothing in it"


# ---------------------------------------------------------------------- inputs


@dataclass
class Frames:
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
        """The frames from `at` on. Those before are read as fast as they can be; requests are remembered."""
        tracer = Tracer(self.variants)
        interesting = tracer.interesting
        scanner: Any = make_scanner(self.variants, everything=True)
        found: list[Attempt] = []
        first = at or 0
        for number, frame in enumerate(self.frames):
            self.seen = number + 1
            if number < first:
                (record,) = scanner.feed([frame])
                if type(record) is not Unknown and type(record).__name__ in interesting:
                    tracer.frames([frame])
                continue
            found.append(tracer.explain_frame(frame, number))
            if len(found) == count:
                break
        return found


@dataclass
class Stream:
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
        """The decisions from the one that has byte `at` on."""
        _check_direction(self.variants, self.direction)
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
        """From where to where the reference has to read: the scanner, which is quick, finds the decisions' borders."""
        scanner: Any = make_scanner(self.variants, direction=self.direction, everything=True)
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
    """The first border of decisions that is near enough; else the last one before `at`."""
    listed = list(borders)
    return next((border for border in listed if at - border <= SPAN), listed[-1] if listed else 0)


def _check_direction(variants: Sequence[Variant], direction: Direction | None) -> None:
    for variant in variants if direction is None else ():
        clash = variant.needs_direction
        if clash is not None and variant.link != "can":
            raise CallerError(
                f"{variant.name}: bytes alone do not tell {clash[0].name} from {clash[1].name};"
                " say which way they went: --direction to (to the device), from, or both"
            )


def _inputs(arguments: argparse.Namespace, variants: list[Variant]) -> Iterator[Any]:
    """What the capture holds, for the protocols of its link."""
    capture: str = arguments.capture
    can = [variant for variant in variants if variant.link == "can"]
    streams = [variant for variant in variants if variant.link != "can"]
    direction = DIRECTIONS[arguments.direction]
    if capture.startswith("hex:"):
        if not streams:
            raise CallerError("hex: is for bytes of a stream; a CAN frame is written '063#78 00'")
        stream = Stream(streams, direction)
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
            words = [parse_word(text, is_can=True) for text in re.split(r"[;,]", capture) if text.strip()]
        except ValueError as error:
            raise CallerError(str(error)) from None
        yield Frames(can, [frame_of(word) for word in words])
        return
    opened: CanCapture | SerialCapture
    if not streams:
        opened = open_capture(capture, link="can")
    elif not can:
        opened = open_capture(capture, link="serial")
    else:
        opened = open_capture(capture)
    with opened:
        if isinstance(opened, CanCapture):
            yield Frames(can, (frame for frames in opened.batches(256) for frame in frames))
        else:
            yield from _streams(opened, streams, direction)


def _streams(
    capture: SerialCapture, variants: list[Variant], direction: Direction | None
) -> Iterator[Stream]:
    """The bytes of a serial capture: one stream a direction, requests going over to the replies'."""
    found: dict[Direction | None, Stream] = {}
    is_paired = any(m.reply_to or m.after for variant in variants for m in variant.messages.values())
    requests: Any = make_scanner(variants, direction="to device") if is_paired else None
    total = 0
    for chunk in capture:
        way: Direction | None = direction or chunk.direction
        if not chunk.data:
            for stream in found.values():
                stream.idle_at.append(len(stream.data))
            continue
        stream = found.setdefault(way, Stream(variants, way, "" if way is None else way))
        room = LARGEST - total
        stream.data += chunk.data[:room]
        total += len(chunk.data)
        if way == "to device" and direction is None and requests is not None:
            replies = found.setdefault("from device", Stream(variants, "from device", "from device"))
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


# ---------------------------------------------------------------------- output


def _print(groups: Sequence[tuple[str, Sequence[Attempt]]], arguments: argparse.Namespace) -> None:
    is_terminal = Output(None).is_terminal
    paint = make_paint() if wants_colour(arguments.color, is_terminal) else no_paint
    width = terminal_width() if is_terminal else None
    is_first = True
    for label, attempts in groups:
        if label and attempts:
            print(("" if is_first else "\n") + paint("source", f"{label}:"))
            is_first = True
        for attempt in attempts:
            if not is_first:
                print()
            is_first = False
            for line in lines_of(attempt, width, paint):
                print(line)


def _write_svg(arguments: argparse.Namespace, attempts: Sequence[Attempt]) -> None:
    from .explain_svg import svg_of

    title = f"{' + '.join(arguments.protocols)}: {arguments.capture}"
    picture = svg_of(attempts, title)
    output = Output(arguments.svg, [arguments.capture])
    output.write(picture.encode("utf-8"))
    output.close()
    if arguments.svg != "-":
        say(f"wrote {arguments.svg}")


def _as_dict(attempt: Attempt, label: str) -> dict[str, Any]:
    found = attempt.found
    shown: dict[str, Any] = {
        "direction": label or None,
        "frame" if attempt.is_can else "offset": attempt.start,
        "size": None if attempt.is_can else found.size * attempt.run,
        "raw": attempt.raw.hex(),
        "protocol": found.protocol,
        "message": found.message,
        "fields": None if found.fields is None else plain(found.fields),
        "reason": found.reason or None,
        "resumes": None if attempt.is_can else attempt.resumes,
        "request": None
        if attempt.request is None
        else {"message": attempt.request[0], "fields": plain(attempt.request[1])},
        "templates": list(attempt.templates),
        "steps": [
            {
                "place": step.place,
                "word": step.word,
                "what": step.what or None,
                "read": [
                    {
                        "template": r.template or None,
                        "field": r.name,
                        "value": plain(r.value),
                        "unit": r.unit or None,
                    }
                    for r in step.read
                ],
                "died": [{"template": d.template, "why": d.why, "detail": d.detail} for d in step.died],
                "alive": list(step.alive),
            }
            for step in attempt.steps
        ],
    }
    if attempt.is_can and attempt.frame is not None:
        shown["id"] = attempt.frame.arbitration_id
    finite: dict[str, Any] = _finite(shown)
    return finite


def _finite(value: Any) -> Any:
    """JSON has no NaN, and flags are lists of names there."""
    if isinstance(value, FlagSet):
        return [*value, *([value.unknown] if value.unknown else [])]
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(item) for item in value]
    if isinstance(value, float) and (value != value or value in (float("inf"), float("-inf"))):
        return None
    return value


def _jsonable(value: Any) -> Any:
    if isinstance(value, (bytes, bytearray)):
        return bytes(value).hex()
    return str(value)


__all__ = ["add_arguments", "run"]
