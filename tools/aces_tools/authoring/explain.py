"""Why the bytes of a recording are decoded as they are: template by template.

  aces spec explain robotis session.bin --direction both --at 1200
                                    what the byte at offset 1200 belongs to
  aces spec explain hubo walk.log --at 17
                                    frame 17 (from 0)
  aces spec explain my_spec.py hex:FFFF0104020032C6 --direction to
  aces spec explain hubo '001#05 24 07; 1C5#C8 00 00 00 F4 01 A0 4F'
                                    bytes or frames from the command line
  aces spec explain hubo robotis x  several protocols on one bus, in order
  … --svg why.svg                   a picture as well

Each byte (of a frame also identifier and length) has a line: what it is, which
fields it completes (=), which templates it rules out and why (✗), which are
left (○). Then comes what the scanner decides (→), and where the search goes on.
CAPTURE is whatever 'aces decode' takes; - is standard input.

A Python file is executed with your rights: name only what you trust.

exit status: 0 everything explained was decoded, 1 something was not,
2 a wrong call or a file that cannot be read
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence

from aces_bus.errors import CallerError
from aces_bus.protocol.explain.attempt import Attempt
from aces_bus.protocol.record import PlainValue, plain_value

from ..console import check_suffix, print_json, say, write_text
from ..options import COLOR, COUNT, DIRECTION, JSON, Arguments, argument, at_least
from ..output.columns import Page
from ..output.shape import json_value
from ..protocols_arg import parse_protocols
from .explain_inputs import LARGEST, FrameInput, StreamInput, inputs_of
from .explain_text import attempt_lines

SUMMARY = "explain why bytes are decoded as they are"

ARGUMENTS: Arguments = (
    argument("protocols", nargs="+", metavar="FILE|NAME", help="as -p of 'aces decode'; the first wins"),
    argument("capture", metavar="CAPTURE", help="a recording, -, hex:FFFF01…, or frames such as '063#78 00'"),
    argument(
        "--at",
        type=at_least(0),
        metavar="OFFSET|FRAME",
        help="what this byte or frame belongs to (from 0; 0x10 too)",
    ),
    COUNT.but(help="number of decisions (default: 12, with --at 1)"),
    DIRECTION,
    JSON,
    argument("--svg", metavar="FILE", help="write a picture too"),
    COLOR,
)


def run(arguments: argparse.Namespace) -> int:
    variants = parse_protocols(arguments.protocols)
    count = arguments.count if arguments.count is not None else 1 if arguments.at is not None else 12
    check_suffix("--svg", arguments.svg, ".svg")
    inputs: list[FrameInput | StreamInput] = []
    groups: list[tuple[str, list[Attempt]]] = []
    for given in inputs_of(arguments.capture, variants, arguments.direction):
        inputs.append(given)  # the capture is open until the next one
        groups.append((given.label, given.attempts(arguments.at, count)))
    if arguments.at is not None and not any(attempts for _, attempts in groups):
        there = " and ".join(given.counted for given in inputs) or "nothing in it"
        raise CallerError(f"--at {arguments.at}: {arguments.capture} has {there}")
    attempts = [attempt for _, found in groups for attempt in found]
    if arguments.svg:
        from .explain_svg import svg_of

        title = f"{' + '.join(arguments.protocols)}: {arguments.capture}"
        write_text(arguments.svg, svg_of(attempts, title), [arguments.capture])
    if arguments.json:
        objects = [_as_dict(attempt, label) for label, found in groups for attempt in found]
        print_json(json_value(objects))
    else:
        _print(groups, arguments)
    for given in inputs:
        if given.is_cut:
            say(
                f"{arguments.capture}: only the first {LARGEST >> 20} MiB were read; cut it with 'aces convert --from'"
            )
    if not attempts:
        say(f"{arguments.capture}: there is nothing to explain")
    return int(any(attempt.found.message is None for attempt in attempts))


# ---------------------------------------------------------------------- output


def _print(groups: Sequence[tuple[str, Sequence[Attempt]]], arguments: argparse.Namespace) -> None:
    page = Page(arguments.color)
    paint, width = page.paint, page.width
    is_first = True
    for label, attempts in groups:
        if label and attempts:
            print(("" if is_first else "\n") + paint("source", f"{label}:"))
            is_first = True
        for attempt in attempts:
            if not is_first:
                print()
            is_first = False
            page.lines(attempt_lines(attempt, width, paint))


def _as_dict(attempt: Attempt, label: str) -> dict[str, PlainValue]:
    found = attempt.found
    shown: dict[str, PlainValue] = {
        "direction": label or None,
        "frame" if attempt.is_can else "offset": attempt.start,
        "size": None if attempt.is_can else found.size * attempt.run,
        "raw": attempt.raw.hex(),
        "protocol": found.protocol,
        "message": found.message,
        "fields": None if found.fields is None else plain_value(found.fields),
        "reason": found.reason or None,
        "resumes": None if attempt.is_can else attempt.resumes,
        "request": None
        if attempt.request is None
        else {"message": attempt.request[0], "fields": plain_value(attempt.request[1])},
        "templates": list(attempt.templates),
        "steps": [
            {
                "place": step.place,
                "part": step.part,
                "what": step.what or None,
                "read": [
                    {
                        "template": r.template or None,
                        "field": r.name,
                        "value": plain_value(r.value),
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
    return shown
