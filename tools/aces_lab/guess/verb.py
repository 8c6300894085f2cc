"""Guess the spec of a recording that no protocol reads.

  aces spec guess drive.log             what is on this bus: messages, rates,
                                        fields, requests and replies
  aces spec guess drive.log -o draft.py
                                        a spec of it that loads and decodes,
                                        evidence in comments, for you to edit
  aces spec guess a.log b.log           several recordings of one bus
  aces spec guess gnss.bin              a serial line: sync, length, check,
                                        what tells packets apart, their fields
  aces spec guess drive.log --no-known  do not try the installed protocols first
  aces spec guess drive.log --json      all guesses, for programs
  aces spec guess drive.log --reference gps.csv:speed --unit m/s -o draft.py
                                        which field is it? A quantity that was
                                        measured meanwhile: identifier, bits,
                                        order, sign, scale, offset, delay

A guess has its evidence, and a confidence from 0 to 1. Fields are named by
kind and place: number_2_4 begins in byte 2, its lowest bit is bit 4 of a byte.
What never changed is a constant of this recording, and no more than that; the
longer a recording is and the more happens in it, the better the guesses.

A reference's instants are in the column that is named like time (time, t_ms,
timestamp …), or in that of --time-column: seconds, Unix time in s, ms, us or
ns, or dates in ISO 8601 (UTC where they name no zone). Where they are not of
the recording's time, both are taken to begin together; --delay says how far
off that may be.

exit status: 0 guessed, or known already; 1 no field follows the reference, or
-o and no draft was written (a draft is loaded and checked before); 2 a wrong
call, or a recording that is empty or cannot be read (what a damaged one holds
is guessed nevertheless)
"""

from __future__ import annotations

import argparse
import os
import shlex
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from aces_bus import FrameTable
from aces_bus.errors import CallerError, CaptureError
from aces_bus.plain_text import printable
from aces_bus.recordings.base import CanRecording
from aces_tools.console import (
    check_suffix,
    counted,
    print_json,
    report_unreadable,
    say,
    say_note,
    write_text,
)
from aces_tools.options import COLOR, JSON, OUTPUT, Arguments, argument, duration, flag
from aces_tools.output.columns import Page
from aces_tools.patience import Patience
from aces_tools.reading.fitting import FittingProtocol
from aces_tools.reading.pieces import open_any

from . import (
    FieldGuess,
    MessageGuess,
    StreamGuess,
    StreamTraffic,
    Traffic,
    TrafficGuess,
    draft_source,
    stream_source,
)
from .checked import checked_draft
from .draft import integer_text, own_name, place_text, reference_said
from .reference import LATEST, ReferenceGuesses
from .reference_file import read_quantity
from .traffic import runs_text

#: Pairs and known protocols that are listed, and lines on the terminal: a draft has all of it.
LISTED, LINES = 8, 40

SUMMARY = "guess the spec of a recording that no protocol reads"

ARGUMENTS: Arguments = (
    argument(
        "files",
        nargs="+",
        metavar="CAPTURE",
        help="recordings of one bus or line, any format; '-': standard input",
    ),
    OUTPUT.but(metavar="draft.py", help="write the draft of a spec there"),
    flag("--force", help="overwrite a draft that is there already"),
    flag("--no-known", help="guess everything, also what an installed protocol decodes"),
    argument(
        "--reference",
        metavar="FILE.csv:COLUMN",
        help="a quantity that was measured meanwhile: find its field (implies --no-known)",
    ),
    argument(
        "--delay",
        type=duration,
        metavar="DURATION",
        help="the longest delay between reference and field, either way (default: 0.6s; at most 1min)",
    ),
    argument("--time-column", metavar="COLUMN", help="the column of the reference's instants"),
    argument("--unit", default="", help="the unit of the reference's values"),
    JSON.but(help="all guesses as JSON"),
    COLOR,
)


def run(arguments: argparse.Namespace) -> int:
    check_suffix("-o", arguments.output, ".py")
    if arguments.output is not None and os.path.exists(arguments.output) and not arguments.force:
        raise CallerError(f"{arguments.output}: is there already; choose another name, or say --force")
    if arguments.reference is None and (arguments.time_column or arguments.unit or arguments.delay):
        raise CallerError("--time-column, --unit and --delay are of a --reference")
    latest_s = LATEST if arguments.delay is None else arguments.delay * 1e-9
    if latest_s > 60:
        raise CallerError("--delay: at most 1min; shift the reference's instants first")
    quantity = (
        None
        if arguments.reference is None
        else read_quantity(arguments.reference, arguments.time_column, arguments.unit)
    )
    traffic, stream = Traffic(), StreamTraffic()
    status = 0
    with Patience() as patience:
        for name in arguments.files:
            try:
                with patience.waiting():
                    recording = open_any(name)
                with recording:
                    if isinstance(recording, CanRecording):
                        for table in patience.each(recording.tables()):
                            traffic.add(table)
                    else:
                        stream.next_recording()
                        for chunk in patience.each(recording):
                            stream.add(*chunk)
                    report_unreadable(recording, is_over=True)
            except CaptureError as error:  # what a damaged file holds is guessed nevertheless
                if not (traffic.frames or stream.bytes):
                    raise
                say(str(error))
                status = 2
            if patience.is_over:
                break
    if stream.bytes and traffic.frames:
        raise CallerError("recordings of a CAN bus and of a serial line: guess one after the other")
    if stream.bytes:
        known = not arguments.no_known and quantity is None
        found = stream.guess(known=known, quantity=quantity, latest_s=latest_s)
        return _of_stream(found, arguments) or status
    if not traffic.frames:
        raise CaptureError(
            f"{', '.join(map(_title, arguments.files))}: nothing to guess: no frames and no bytes"
        )
    guess = traffic.guess(
        known=not arguments.no_known and quantity is None, quantity=quantity, latest_s=latest_s
    )
    written = False
    if arguments.output is not None and guess.messages:
        made = partial(draft_source, guess, Path(arguments.output).stem, _names(arguments))
        written = _write(arguments.output, made, guess.messages, traffic.first_frames)
    if arguments.json:
        print_json({**guess.as_dict(), "output": arguments.output if written else None})
    else:
        _show(guess, arguments, written)
    if arguments.output is not None and not guess.messages:
        said = f"is {_best(guess.known)}" if guess.known else "has nothing to guess"
        say(f"no draft was written: the recording {said}")
    is_lost = guess.reference is not None and guess.reference.found is None
    return status or int(is_lost or (arguments.output is not None and not written))


def _names(arguments: argparse.Namespace) -> list[str]:
    return [Path(file).name for file in arguments.files]


def _write(
    path: str,
    source_of: Callable[..., str],
    messages: Sequence[MessageGuess] = (),
    frames: FrameTable | None = None,
) -> bool:
    """Write a draft that was tried; return whether there is one."""
    draft = checked_draft(lambda some: source_of(as_bytes=some), own_name(Path(path).stem), messages, frames)
    if draft.wrong:
        say(f"no draft was written: it has a fault that is ours, {draft.wrong}")
        return False
    write_text(path, draft.source, is_quiet=True)
    for name, why in draft.as_bytes.items():
        say(f"{name} is drafted as bytes: {why}")
    return True


def _best(known: Sequence[FittingProtocol]) -> str:
    """Return the protocols that fit best, where bytes alone do not say which one it is."""
    return " or ".join(protocol.name for protocol in known if protocol.share == known[0].share)


# ---------------------------------------------------------------------- streams


def _of_stream(guess: StreamGuess, arguments: argparse.Namespace) -> int:
    written = False
    if arguments.output is not None and guess.framings:
        made = partial(stream_source, guess, Path(arguments.output).stem, _names(arguments))
        written = _write(arguments.output, made)
    if arguments.json:
        print_json({**guess.as_dict(), "output": arguments.output if written else None})
    else:
        _show_stream(guess, arguments, written)
    if arguments.output is not None and not guess.framings:
        said = f"is {_best(guess.known)}" if guess.known else "has no framing that it shows plainly"
        say(f"no draft was written: the recording {said}")
    is_lost = guess.reference is not None and guess.reference.found is None
    return int(is_lost or (arguments.output is not None and not written))


def _show_stream(guess: StreamGuess, arguments: argparse.Namespace, written: bool) -> None:
    summary = _Summary(arguments.color)
    page = summary.page
    title = ", ".join(map(_title, arguments.files))
    files = " ".join("-" if file == "-" else shlex.quote(file) for file in arguments.files)
    packets = "" if guess.known else f", {guess.decoded:,} in packets"
    page.lines([printable(f"{title}: {counted(guess.bytes, 'byte')}{packets}")])
    if guess.kept < guess.bytes:
        page.lines([f"only the first {guess.kept:,} bytes were looked at"])
    for known in guess.known[:LISTED]:
        page.lines([printable(f"{known.share:4.0%} is {known.name}:  aces decode {files} {known.options}")])
    if guess.known:
        page.lines(["nothing was guessed (--no-known: everything)"])
    elif not guess.framings:
        page.lines(["no sync bytes, length, line end or check that chance could not give as well"])
    if guess.reference is not None:
        _show_reference(guess.reference, page)
    for number, framing in enumerate(guess.framings):
        head = f"framing {number}: {counted(framing.packets, 'packet')}, {framing.share:.1%} of the bytes"
        summary.section(page.paint("message", f"{head} ({framing.confidence:.2f})"))
        page.lines(f"  {printable(line)}" for line in framing.evidence)
        for packet in guess.packets:
            if packet.framing != number:
                continue
            code = "" if packet.opcode is None else f" {_code(packet.opcode, framing.kind == 'lines')}"
            sizes = packet.sizes
            summary.section(page.paint("message", f"packet{code}  {packet.count:,} of {_bytes(sizes)}"))
            if packet.fields:
                page.table(
                    ("field", "bits", "kind", "sure", "evidence"), [_cells(field) for field in packet.fields]
                )
    summary.close(
        f"a draft to edit: aces spec guess {printable(files)} -o draft.py"
        if guess.framings and not arguments.output
        else ""
    )
    if written:
        quoted = shlex.quote(arguments.output)
        say_note(f"{arguments.output}: written; next: aces decode {files} -p {quoted}")


class _Summary:
    """A page of `LINES` lines at most: details are left out where there is no room, then the last sections."""

    def __init__(self, colour: bool | None) -> None:
        #: The first line of each section and its details; the first section has no such line.
        self._sections: list[tuple[str, list[str]]] = [("", [])]
        self._out = Page(colour)
        #: What sections are written with.
        self.page = Page(colour, lambda lines: self._sections[-1][1].extend(lines))

    def section(self, head: str) -> None:
        """Begin a section: further lines are its details."""
        self._sections.append((head, []))

    def close(self, last: str) -> None:
        """Print it all, or what there is room for, and a last line."""
        (_, first), *sections = self._sections
        whole = [*first, *(line for head, details in sections for line in ("", head, *details))]
        if len(whole) + 2 <= LINES:
            self._out.lines([*whole, *(["", last] if last else [])])
            return
        room = LINES - min(len(first), LINES // 2) - 2
        shown = first[: LINES // 2]
        spare = room - len(sections)
        for head, details in sections[:room]:
            shown.append(head)
            if len(details) <= spare:
                shown += details
                spare -= len(details)
        left = f"; {len(sections) - room} more" if len(sections) > room else ""
        self._out.lines(
            [*shown, f"fields and evidence: in the draft (-o draft.py){left}", *([last] if last else [])]
        )


def _title(file: str) -> str:
    return "standard input" if file == "-" else file


def _code(opcode: bytes, is_text: bool) -> str:
    return printable(opcode.decode("latin-1")) if is_text else opcode.hex(" ").upper()


# ---------------------------------------------------------------------- text


def _show(guess: TrafficGuess, arguments: argparse.Namespace, written: bool) -> None:
    summary = _Summary(arguments.color)
    page = summary.page
    title = ", ".join(map(_title, arguments.files))
    found = f"{counted(guess.frames, 'frame')}, {counted(len(guess.messages), 'message')} guessed"
    page.lines([printable(f"{title}: {found}")])
    if guess.kept < guess.frames - guess.errors:
        page.lines([f"only the first {guess.kept:,} frames were looked at"])
    if guess.beyond:
        page.lines([f"{counted(guess.beyond, 'frame')} of still more identifiers were not looked at"])
    files = " ".join("-" if file == "-" else shlex.quote(file) for file in arguments.files)
    for known in guess.known[:LISTED]:
        page.lines([printable(f"{known.share:4.0%} is {known.name}:  aces decode {files} {known.options}")])
    if guess.known:
        left = sum(message.frames for message in guess.messages)
        page.lines(
            [
                f"guessed is what {guess.known[0].name} leaves: {counted(left, 'frame')} (--no-known: everything)"
            ]
        )
    if guess.reference is not None:
        _show_reference(guess.reference, page)
    for protocol in guess.protocols:
        page.beside(protocol.name, [f"{protocol.evidence} ({protocol.confidence:.2f})"], "message")
    for message in guess.messages:
        summary.section(page.paint("message", printable(_headline(message))))
        page.table(("field", "bits", "kind", "sure", "evidence"), [_cells(field) for field in message.fields])
    if guess.pairs:
        summary.section(counted(len(guess.pairs), "request") + " with replies")
        page.table(
            ("request", "reply", "sure", "evidence"),
            [
                (_identifier(pair.request), _identifier(pair.reply), f"{pair.confidence:.2f}", pair.evidence)
                for pair in guess.pairs[:LISTED]
            ],
        )
    summary.close(
        f"a draft to edit: aces spec guess {printable(files)} -o draft.py"
        if guess.messages and not arguments.output
        else ""
    )
    if written:
        quoted = shlex.quote(arguments.output)
        say_note(
            f"{arguments.output}: written; next: aces decode {files} -p {quoted}; aces spec check {quoted} --against {files}"
        )


def _show_reference(reference: ReferenceGuesses, page: Page) -> None:
    heading, *_ = reference_said(reference)
    page.lines(["", printable(heading)])
    if not reference.guesses:
        return
    unit = reference.quantity.unit
    page.table(
        ("message", "bits", "number", "scale", "offset", "delay", "explains", "leaves"),
        [
            (
                guess.shown,
                place_text(guess.field),
                integer_text(guess.field),
                f"{guess.scale:g}",
                f"{guess.offset:g}{unit and ' ' + unit}",
                f"{1e3 * guess.delay_s:+.0f} ms",
                f"{guess.explained:.2%}",
                f"{guess.residual:.2g}",
            )
            for guess in reference.guesses
        ],
    )


def _bytes(lengths: Sequence[int]) -> str:
    return counted(lengths[0], "byte") if len(lengths) == 1 else f"{lengths[0]} to {lengths[-1]} bytes"


def _identifier(key: int) -> str:
    return f"{key & 0x1FFF_FFFF:0{8 if key >> 31 else 3}X}"


def _headline(message: MessageGuess) -> str:
    parts = [f"{message.shown}  {counted(message.frames, 'frame')}"]
    if message.timing is not None and message.frames > 2:
        period, jitter = message.timing.period_ns / 1e6, message.timing.jitter_ns / 1e6
        parts.append(
            f"every {period:.4g} ms ± {jitter / 2:.2g}" if message.timing.is_regular else "at no fixed rate"
        )
    lengths: Sequence[int] = message.lengths
    parts.append(_bytes(lengths))
    if message.transport:
        parts.append(f"packets of {message.transport.removesuffix('()')}")
    if message.node is not None:
        node = message.node
        parts.append(f"{node.name} {runs_text(node.numbers)} ({node.confidence:.2f})")
    return ", ".join(parts)


def _cells(field: FieldGuess) -> tuple[str, ...]:
    where = place_text(field)
    kind: str = field.kind
    if field.kind in ("number", "counter", "float", "quantity"):
        kind += f" {integer_text(field)}"
    if field.when:
        where += f" at {field.when[0]}"
    return (_name(field), where, kind, f"{field.confidence:.2f}", field.evidence)


def _name(field: FieldGuess) -> str:
    from .draft import field_name

    return "" if field.kind == "constant" else field_name(field)
