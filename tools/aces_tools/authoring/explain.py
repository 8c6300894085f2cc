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
from collections.abc import Sequence
from typing import Any

from aces_bus.errors import CallerError
from aces_bus.protocol.declare.fields import FlagSet
from aces_bus.protocol.explain import Attempt
from aces_bus.protocol.record import plain_value

from ..console import Output, check_suffix, say, terminal_width, wants_colour
from ..output.text import make_paint, no_paint
from ..protocols_arg import parse_protocols
from .explain_inputs import DIRECTIONS, LARGEST, FrameInput, StreamInput, inputs_of
from .explain_text import attempt_lines


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
    check_suffix("--svg", arguments.svg, ".svg")
    inputs: list[FrameInput | StreamInput] = []
    groups: list[tuple[str, list[Attempt]]] = []
    for one in inputs_of(arguments.capture, variants, DIRECTIONS[arguments.direction]):
        inputs.append(one)  # the capture is open until the next one
        groups.append((one.label, one.attempts(arguments.at, count)))
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


def _counted(inputs: Sequence[FrameInput | StreamInput]) -> str:
    return " and ".join(one.counted for one in inputs) or "nothing in it"


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
            for line in attempt_lines(attempt, width, paint):
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
                "word": step.word,
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
