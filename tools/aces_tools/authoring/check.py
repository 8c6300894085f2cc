"""What is wrong or doubtful in a spec, each with its line.

  aces spec check my_spec.py        errors and warnings of a file
  aces spec check hubo --notes      of an installed protocol, remarks too
  aces spec check car.dbc           of a database
  aces spec check robot.toml        of all protocols of a robot, and whether
                                    those of one bus get in each other's way
  aces spec check a.py b.py         of both, as if they shared a bus;
                                    --apart: they do not

An error is wrong whatever was meant, a warning unless it was meant, a note is
worth knowing. A comment says that something is meant, on its line or above:

    "speed" / Int16ub,  # aces: allow byte-order

Then the nine laws ('aces fuzz --help' lists them) are asked of the code that
is generated from the spec, for --seconds; what breaks one is an error, shown
with the smallest bytes that do it. The same spec gets the same scenes.

Rules are named in brackets behind each line; docs/checking.md has them all.
A Python file is executed with your rights: name only what you trust.

exit status: 0 nothing found but notes, 1 errors or warnings, 2 a wrong call
"""

from __future__ import annotations

import argparse
import json
import os
import re
import sys
import textwrap
import traceback
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from aces_bus.errors import AcesError, CallerError, SpecError, UnknownNameError
from aces_bus.plain_text import printable, printable_lines
from aces_bus.protocol import Protocol, Variant, list_protocols
from aces_bus.protocol.declare.place import SourceLine
from aces_bus.protocol.files import load_file
from aces_bus.protocol.lint import LEVELS, Finding, check_protocol, check_wire, sort_key

from ..console import Output, say, wants_colour
from ..output.text import Paint, make_paint, no_paint
from ..protocols_arg import named_protocol, problems_of
from .proving import finding_of_error, prove

#: How long the laws are asked of a protocol, unless it is said.
SECONDS = 3.0

_PLACED = re.compile(r"(?P<file>(?:[A-Za-z]:)?[^:\n]+):(?P<line>\d+): (?P<text>.*)", re.DOTALL)
_WITNESS = re.compile(
    r"both accept (?P<frame>[0-9A-F]+#[0-9A-F]*)|both accept (?P<bytes>[0-9A-F]{2}(?: [0-9A-F]{2})*)"
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "names", nargs="+", metavar="FILE|NAME|ROBOT", help="specs, databases, installed protocols, robots"
    )
    parser.add_argument("--notes", action="store_true", help="show notes too, instead of counting them")
    parser.add_argument("--apart", action="store_true", help="the protocols named do not share a bus")
    parser.add_argument(
        "--seconds",
        type=float,
        default=SECONDS,
        metavar="N",
        help="how long the laws are asked of each protocol (default: %(default)g; 0: not at all)",
    )
    parser.add_argument("--json", action="store_true", help="for programs: everything, notes too")
    parser.add_argument(
        "--color", action=argparse.BooleanOptionalAction, default=None, help="default: on a terminal"
    )


@dataclass
class Checked:
    """What one name of the command line gave."""

    name: str
    protocols: list[Protocol] = field(default_factory=list)
    findings: list[Finding] = field(default_factory=list)
    #: What is wrong with the call, not with a spec.
    complaint: str = ""
    #: What shares a bus: label of a variant → how the command line names it.
    labels: dict[str, str] = field(default_factory=dict)
    #: Scenes of which the laws were asked; None where they were not. What shows a failure, by its finding.
    scenes: int | None = None
    drawings: dict[Finding, str] = field(default_factory=dict)


def run(arguments: argparse.Namespace) -> int:
    if not 0 <= arguments.seconds <= 3600:
        raise CallerError(
            f"--seconds {arguments.seconds:g}: a number from 0 (the laws are not asked) to 3600"
        )
    names = list(dict.fromkeys(arguments.names))
    variants: dict[Variant, str] = {}
    done: dict[int, None] = {}
    results: list[Checked] = []
    for name in names:
        result = Checked(name)
        results.append(result)
        _check(name, result, variants)
        for protocol in result.protocols:
            if id(protocol) not in done:
                done[id(protocol)] = None
                try:
                    result.findings += check_protocol(protocol) + _of_database(protocol)
                except Exception as error:  # whatever a spec makes a rule raise is a fault with a line
                    placed = _of_error(error) if isinstance(error, AcesError) else None
                    result.findings.append(placed or finding_of_error(error, protocol, "cannot be checked"))
                if arguments.seconds:
                    _ask_laws(protocol, result, arguments.seconds)
    if not arguments.apart and len(variants) > 1:
        found = Checked(" + ".join(variants.values()))
        found.labels = {variant.label: name for variant, name in variants.items()}
        found.findings += _unallowed(check_wire(list(variants), "warning", " if they share a bus"))
        if found.findings:
            results.append(found)
    for result in results:
        result.findings.sort(key=sort_key)
    if arguments.json:
        _print_json(results)
    else:
        _print_text(results, arguments)
    for result in results:
        if result.complaint:
            say(result.complaint)
        if result.scenes is not None:
            is_held = not any(one.rule == "law" for one in result.findings)
            held = "held" if is_held else "were asked, and do not all hold,"
            say(f"{result.name}: the nine laws {held} on {_count(result.scenes, 'scene')}")
    if any(result.complaint for result in results):
        return 2
    return int(any(one.level != "note" for result in results for one in result.findings))


# ---------------------------------------------------------------------- from names to findings


def _check(name: str, result: Checked, variants: dict[Variant, str]) -> None:
    """Load what a name names; what fails while loading is a finding where it has a line."""
    try:
        if _is_robot(name):
            _check_robot(name, result)
            return
        for protocol_name in _every(name):
            chosen = named_protocol(protocol_name)
            variants.setdefault(chosen.variant(), protocol_name)
            result.protocols.append(chosen.protocol)
    except SystemExit as ended:
        result.complaint = f"{name}: the file ends the program ({ended.code!r}); a spec only declares"
    except AcesError as error:
        finding = _of_error(error)
        if finding is None:
            result.complaint = str(error)
        else:
            result.findings.append(finding)
    except (
        Exception
    ) as error:  # of the core, in the hands of a spec: no traceback, and the line where it began
        place = _innermost(error) or SourceLine(name, 0)
        said = " ".join(str(error).split())
        result.findings.append(Finding("error", "python", place, f"{type(error).__name__}: {said}"))


def _ask_laws(protocol: Protocol, result: Checked, seconds: float) -> None:
    if not protocol.declared:
        return
    spoken = result.name if len(result.protocols) == 1 else f"{result.name}:{protocol.name}"
    proved = prove(protocol, spoken, seconds)
    result.findings += proved.findings
    result.drawings.update(proved.drawings)
    result.scenes = (result.scenes or 0) + proved.scenes


def _every(name: str) -> list[str]:
    """A file that declares several protocols, as the names of each."""
    if not name.lower().endswith(".py"):
        return [name]
    found = {
        variable: value
        for variable, value in vars(load_file(name)).items()
        if isinstance(value, Protocol) and Path(value.place.file).resolve() == Path(name).resolve()
    }
    return [f"{name}:{variable}" for variable in found] if len(found) > 1 else [name]


def _is_robot(name: str) -> bool:
    if name.lower().endswith(".toml"):
        return True
    if name in list_protocols() or not re.fullmatch(r"[\w-]+", name):
        return False
    from aces_bus.robot import list_robots

    robots = list_robots()
    if name not in robots and not os.path.exists(name):
        raise UnknownNameError("protocol or robot", name, [*list_protocols(), *robots])
    return name in robots


def _check_robot(name: str, result: Checked) -> None:
    from aces_bus.robot import check_robot

    robot, problems = check_robot(name)
    for problem in problems:
        text = f"{problem.key}: {problem.text}" if problem.key else problem.text
        result.findings.append(
            Finding(
                # What `aces robot check` warns of (a driver that is not installed) is no fault of a spec.
                "note" if problem.is_warning else "error",
                "robot",
                SourceLine(problem.file, problem.line),
                text,
            )
        )
    if robot is None:
        return
    for bus_name, bus in robot.buses.items():
        spoken: dict[str, str | None] = {bus.protocol: bus.dialect}
        for device in robot.devices.values():
            own: str | None = getattr(device, "protocol", None)
            if device.bus == bus_name and own is not None:
                spoken.setdefault(own, getattr(device, "dialect", None))
        wire: list[Variant] = []
        for protocol_name, dialect in spoken.items():
            if protocol_name not in list_protocols():
                continue  # the robot's own check has said so
            protocol = named_protocol(protocol_name).protocol
            chosen = dialect if dialect is not None else robot.dialect(protocol_name)
            variant = protocol.variant(chosen, robot.tables(protocol) or None)
            wire.append(variant)
            result.labels[variant.label] = protocol_name
            if protocol not in result.protocols:
                result.protocols.append(protocol)
        result.findings += _unallowed(check_wire(wire, "error", f" on bus {bus_name!r} of {name}"))


def _unallowed(findings: Iterable[Finding]) -> list[Finding]:
    return [one for one in findings if not one.is_allowed]


def _of_database(protocol: Protocol) -> list[Finding]:
    """What of a database could not be taken over."""
    path = protocol.place.file
    return [
        Finding(
            "note" if p.is_note else "warning",
            "database",
            SourceLine(path, p.line),
            str(p).removeprefix(f"line {p.line}: "),
        )
        for p in problems_of(protocol)
    ]


def _of_error(error: AcesError) -> Finding | None:
    """A spec that fails while it is imported: where, and what; None for a wrong call."""
    text = str(error)
    found = _PLACED.fullmatch(text)
    if found is not None and (isinstance(error, SpecError) or os.path.exists(found["file"])):
        place = SourceLine(os.path.abspath(found["file"]), int(found["line"]))
        rule = "ambiguous" if " is ambiguous with " in text else "spec"
        return Finding("error", rule, place, found["text"], None, _witness(text))
    if isinstance(error, SpecError):
        return Finding("error", "spec", SourceLine("<spec>", 0), text)
    cause = error.__cause__
    if isinstance(error, CallerError) and cause is not None and not isinstance(cause, AcesError):
        place_of = _innermost(cause)
        if place_of is not None:
            return Finding(
                "error", "python", place_of, f"{type(cause).__name__}: {' '.join(str(cause).split())}"
            )
    return None


def _witness(text: str) -> str | None:
    found = _WITNESS.search(text)
    if found is None:
        return None
    return found["frame"] or f"hex:{found['bytes'].replace(' ', '')}"


def _innermost(error: BaseException) -> SourceLine | None:
    """The last line of a traceback that is not Python's own or the core's."""
    if isinstance(error, SyntaxError) and error.filename and not error.filename.startswith("<"):
        return SourceLine(error.filename, error.lineno or 1)
    own = str(Path(sys.modules["aces_bus"].__file__ or "").parent)
    library = str(Path(os.__file__).parent)
    for one in reversed(traceback.extract_tb(error.__traceback__)):
        is_foreign = one.filename.startswith((own, "<")) or (
            one.filename.startswith(library) and "site-packages" not in one.filename
        )
        if not is_foreign and f"{os.sep}construct{os.sep}" not in one.filename:
            if Path(one.filename).name != "protocols_arg.py":
                return SourceLine(one.filename, one.lineno or 1)
    return None


# ---------------------------------------------------------------------- printing


def _print_json(results: Sequence[Checked]) -> None:
    found: list[dict[str, Any]] = []
    for result in results:
        levels = [one.level for one in result.findings]
        found.append(
            {
                "name": result.name,
                "ok": not result.complaint and all(level == "note" for level in levels),
                "messages": sum(len(protocol.declared) for protocol in result.protocols),
                "counts": {level: levels.count(level) for level in LEVELS},
                "complaint": result.complaint or None,
                "scenes": result.scenes,
                "findings": [one.as_dict() for one in result.findings],
            }
        )
    print(json.dumps(found, ensure_ascii=False, indent=2))


_STYLES = {"error": "malformed", "warning": "flags", "note": "place"}


def _print_text(results: Sequence[Checked], arguments: argparse.Namespace) -> None:
    colour = wants_colour(arguments.color, Output(None).is_terminal)
    paint: Paint = make_paint() if colour else no_paint
    for result in results:
        hidden = 0
        for one in result.findings:
            if one.level == "note" and not arguments.notes:
                hidden += 1
                continue
            level = paint(_STYLES[one.level], f"{one.level}:")
            place, text = printable(str(one.place)), printable(one.text)
            print(f"{place}: {level} {text} {paint('place', f'[{one.rule}]')}")
            if one in result.drawings:
                print(textwrap.indent(printable_lines(result.drawings[one]), "    "))
            if one.witness is not None and one.rule == "collision":
                spoken = " ".join(name for label, name in result.labels.items() if f"{label} " in one.text)
                print(f"    to see it: aces spec explain {spoken or result.name} '{one.witness}'")
        if not result.complaint:
            print(f"{printable(result.name)}: {_summary(result, hidden)}")


def _summary(result: Checked, hidden: int) -> str:
    messages = sum(len(protocol.declared) for protocol in result.protocols)
    parts = [_count(messages, "message")] if messages else []
    levels = [one.level for one in result.findings]
    parts += [_count(levels.count(level), level) for level in LEVELS if level in levels]
    is_clean = all(level == "note" for level in levels)
    text = ("ok: " if is_clean else "") + (", ".join(parts) or "nothing to check")
    return f"{text} (--notes shows them)" if hidden else text


def _count(number: int, what: str) -> str:
    return f"{number} {what}" if number == 1 else f"{number} {what}s"
