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

Then the nine laws ('aces fuzz --help' lists them) are tried on the code that is
generated from the spec, for three seconds (--for). What breaks one is an error,
shown with the smallest bytes that do it. The same spec gets the same scenes.

Held against recordings, a spec shows what it does not say, or says wrongly:

  aces spec check hubo --against walk.log
                                    messages and fields never seen, undeclared
                                    identifiers and opcodes, bytes left over,
                                    ranges exceeded, numbers in a wrong byte
                                    order, undeclared checks …
  aces spec check my_spec.py --suggest walk.log
                                    examples=[…] of it, for you to confirm

Rules are named in brackets behind each line; docs/checking.md has them all.
A Python file is executed with your rights: name only what you trust.

exit status: 0 nothing found but notes, 1 errors or warnings, 2 a wrong call
"""

from __future__ import annotations

import argparse
import os
import re
import sys
import textwrap
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any

from construct import Construct

from aces_bus import list_protocols, load_protocol, open_recording
from aces_bus.errors import AcesError, CallerError, SpecError, UnknownNameError
from aces_bus.plain_text import printable, printable_lines
from aces_bus.protocol import Message, Protocol, Variant
from aces_bus.protocol.against.finding import Observation
from aces_bus.protocol.against.recording import RecordingCheck
from aces_bus.protocol.against.suggest import suggest_examples
from aces_bus.protocol.declare.place import SourceLine
from aces_bus.protocol.exchange.read_once import problems_of
from aces_bus.protocol.files import load_file, python_file
from aces_bus.protocol.lint import check_protocol
from aces_bus.protocol.lint.fields import Written
from aces_bus.protocol.lint.finding import Finding
from aces_bus.protocol.lint.templates import check_wire
from aces_bus.protocol.record import PlainValue
from aces_bus.recordings.base import CanRecording, SerialRecording
from aces_bus.tracebacks import exception_text, innermost_line

from ..console import counted, print_json, report_unreadable, say, say_note
from ..options import COLOR, DIRECTION, FOR, JSON, Arguments, argument, duration_or_none, flag, several
from ..output.columns import Page
from ..protocols_arg import named_protocol, parse_protocols

if TYPE_CHECKING:
    from aces_bus.testing.fuzz import Failure


#: How long the laws are tried on a protocol, unless --for says otherwise.
SECONDS = 3.0

_PLACED = re.compile(r"(?P<file>(?:[A-Za-z]:)?[^:\n]+):(?P<line>\d+): (?P<text>.*)", re.DOTALL)
_WITNESS = re.compile(
    r"both accept (?P<frame>[0-9A-F]+#[0-9A-F]*)|both accept (?P<bytes>[0-9A-F]{2}(?: [0-9A-F]{2})*)"
)


SUMMARY = "find what is wrong or doubtful in a spec, with file and line"

ARGUMENTS: Arguments = (
    argument(
        "names", nargs="+", metavar="FILE|NAME|ROBOT", help="specs, databases, installed protocols, robots"
    ),
    flag("--notes", help="show notes too, instead of counting them"),
    flag("--apart", help="the protocols named do not share a bus"),
    several("--against", metavar="CAPTURE", help="what this recording says against the specs"),
    several(
        "--suggest", metavar="CAPTURE", help="print worked examples out of this recording, and check nothing"
    ),
    DIRECTION,
    FOR.but(
        type=duration_or_none,
        help="how long the laws are tried on each protocol (default: 3s; 0: not at all)",
    ),
    JSON.but(help="everything, notes too, as JSON"),
    COLOR,
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
    #: What is said where nothing was found and nothing counted.
    nothing: str = "nothing to check"


def run(arguments: argparse.Namespace) -> int:
    names = list(dict.fromkeys(arguments.names))
    if arguments.suggest:
        return _suggest(names, arguments)
    seconds = SECONDS if arguments.duration is None else arguments.duration / 1e9
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
                if seconds:
                    _ask_laws(protocol, result, seconds)
    if not arguments.apart and len(variants) > 1:
        found = Checked(" + ".join(variants.values()))
        found.labels = {variant.label: name for variant, name in variants.items()}
        found.findings += _unallowed(check_wire(list(variants), "warning", " if they share a bus"))
        if found.findings:
            results.append(found)
    if arguments.against:
        wires = [[variant] for variant in variants] if arguments.apart else [list(variants)]
        results += [_hold_against(wire, variants, arguments) for wire in wires if wire]
    for result in results:
        result.findings.sort(key=Finding.sort_key)
    if arguments.json:
        _print_results(results)
    else:
        _print_text(results, arguments)
    for result in results:
        if result.complaint:
            say(result.complaint)
        if result.scenes is not None:
            is_held = not any(finding.rule == "law" for finding in result.findings)
            held = "held" if is_held else "were asked, and do not all hold,"
            say_note(f"{result.name}: the nine laws {held} on {counted(result.scenes, 'scene')}")
    if any(result.complaint for result in results):
        return 2
    return int(any(finding.level != "note" for result in results for finding in result.findings))


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
    """Return a file that declares several protocols, as the names of each."""
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
    from aces_bus import list_robots

    robots = list_robots()
    if name not in robots and not os.path.exists(name):
        raise UnknownNameError("protocol or robot", name, [*list_protocols(), *robots])
    return name in robots


def _check_robot(name: str, result: Checked) -> None:
    from aces_bus.robot.installed import check_robot

    robot, problems = check_robot(name)
    for problem in problems:
        text = f"{problem.key}: {problem.text}" if problem.key else problem.text
        result.findings.append(
            Finding(
                # What `aces robot check` warns of (a driver that is not installed) is not a fault of a spec.
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
            if python_file(protocol_name)[0]:
                continue  # a file that a robot names is not run; the robot's own check has said so
            try:
                protocol = load_protocol(protocol_name)
            except UnknownNameError:
                continue  # the robot's own check has said so
            chosen = dialect if dialect is not None else robot.dialect(protocol_name)
            variant = protocol.variant(chosen, robot.tables(protocol) or None)
            wire.append(variant)
            result.labels[variant.label] = protocol_name
            if protocol not in result.protocols:
                result.protocols.append(protocol)
        result.findings += _unallowed(check_wire(wire, "error", f" on bus {bus_name!r} of {name}"))


def _unallowed(findings: Iterable[Finding]) -> list[Finding]:
    return [finding for finding in findings if not finding.is_allowed]


def _of_database(protocol: Protocol) -> list[Finding]:
    """Return what of a database could not be taken over."""
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
    """Return a spec that fails while it is imported: where, and what; None for a wrong call."""
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
            return Finding("error", "python", place_of, exception_text(cause))
    return None


def _witness(text: str) -> str | None:
    found = _WITNESS.search(text)
    if found is None:
        return None
    return found["frame"] or f"hex:{found['bytes'].replace(' ', '')}"


def _innermost(error: BaseException) -> SourceLine | None:
    """Return the last line of a traceback that is not Python's own or the core's."""
    if isinstance(error, SyntaxError) and error.filename and not error.filename.startswith("<"):
        return SourceLine(error.filename, error.lineno or 1)
    own = str(Path(sys.modules["aces_bus"].__file__ or "").parent)
    library = str(Path(os.__file__).parent)

    def is_users(file: str) -> bool:
        is_foreign = file.startswith((own, "<")) or (file.startswith(library) and "site-packages" not in file)
        return not (
            is_foreign or f"{os.sep}construct{os.sep}" in file or Path(file).name == "protocols_arg.py"
        )

    at = innermost_line(error, is_users)
    return SourceLine(at.filename, at.lineno or 1) if at is not None else None


# ---------------------------------------------------------------------- recordings


def _hold_against(
    wire: Sequence[Variant], names: Mapping[Variant, str], arguments: argparse.Namespace
) -> Checked:
    """Return what the recordings of the call say against protocols that share a bus."""
    said = " + ".join(names[variant] for variant in wire)
    result = Checked(f"{said} against {', '.join(arguments.against)}", nothing="nothing speaks against it")
    try:
        check = RecordingCheck(wire, direction=arguments.direction)
        for capture in _recordings(arguments.against, wire):
            check.read(capture)
        result.findings += check.observations()
    except AcesError as error:
        result.complaint = str(error)
    return result


def _recordings(paths: Iterable[str], wire: Sequence[Variant]) -> Iterator[CanRecording | SerialRecording]:
    """Yield the recordings, one after the other; what of them cannot be read is said."""
    for path in paths:
        with open_recording(path, link="can" if wire[0].link == "can" else "serial") as capture:
            yield capture
            report_unreadable(capture, is_over=True)


def _suggest(names: Sequence[str], arguments: argparse.Namespace) -> int:
    """Print worked examples; the exit status."""
    try:
        wire = parse_protocols(names)
        found = suggest_examples(wire, _recordings(arguments.suggest, wire), direction=arguments.direction)
    except AcesError as error:
        say(str(error))
        return 2
    if arguments.json:
        print_json(
            [
                {
                    "message": finding.message.name,
                    "count": finding.count,
                    "source": finding.source,
                    "line": finding.message.place.line,
                }
                for finding in found
            ]
        )
        return 0
    for example in found:
        print(
            f"# {example.message.place}: {example.message.name}, 1 of {example.count}; confirm it by the sheet"
        )
        print(printable_lines(f"examples=[\n    {example.source}\n],"))
    if not found:
        say("the recordings have no message that an example could be made of")
    return 0


# ---------------------------------------------------------------------- printing


def _print_results(results: Sequence[Checked]) -> None:
    found: list[dict[str, PlainValue]] = []
    for result in results:
        levels = [finding.level for finding in result.findings]
        found.append(
            {
                "name": result.name,
                "ok": not result.complaint and all(level == "note" for level in levels),
                "messages": sum(len(protocol.declared) for protocol in result.protocols),
                "counts": {level: levels.count(level) for level in Finding.LEVELS},
                "complaint": result.complaint or None,
                "scenes": result.scenes,
                "findings": [finding.as_dict() for finding in result.findings],
            }
        )
    print_json(found)


_STYLES = {"error": "malformed", "warning": "flags", "note": "place"}


def _print_text(results: Sequence[Checked], arguments: argparse.Namespace) -> None:
    paint = Page(arguments.color).paint
    for result in results:
        hidden = 0
        for finding in result.findings:
            if finding.level == "note" and not arguments.notes:
                hidden += 1
                continue
            level = paint(_STYLES[finding.level], f"{finding.level}:")
            place, text = printable(str(finding.place)), printable(finding.text)
            print(f"{place}: {level} {text} {paint('place', f'[{finding.rule}]')}")
            if isinstance(finding, Observation) and finding.remedy:
                print(f"    → {printable(finding.remedy)}")
            if finding in result.drawings:
                print(textwrap.indent(printable_lines(result.drawings[finding]), "    "))
            if finding.witness is not None and finding.rule == "collision":
                spoken = " ".join(
                    name for label, name in result.labels.items() if f"{label} " in finding.text
                )
                print(f"    to see it: aces spec explain {spoken or result.name} '{finding.witness}'")
        if not result.complaint:
            print(f"{printable(result.name)}: {_summary(result, hidden)}")


def _summary(result: Checked, hidden: int) -> str:
    messages = sum(len(protocol.declared) for protocol in result.protocols)
    parts = [counted(messages, "message")] if messages else []
    levels = [finding.level for finding in result.findings]
    parts += [counted(levels.count(level), level) for level in Finding.LEVELS if level in levels]
    is_clean = all(level == "note" for level in levels)
    text = ("ok: " if is_clean else "") + (", ".join(parts) or result.nothing)
    return f"{text} (--notes shows them)" if hidden else text


# ---------------------------------------------------------------------- the laws

#: Which scenes there are.
SEED = 0
#: So many are judged, however little time there is.
LEAST = 8


@dataclass
class ProofResult:
    """How many scenes were judged, and what was found; `drawings` show a failure, by its finding."""

    scenes: int = 0
    findings: list[Finding] = field(default_factory=list[Finding])
    drawings: dict[Finding, str] = field(default_factory=dict[Finding, str])


def prove(protocol: Protocol, name: str, seconds: float) -> ProofResult:
    """Ask the laws of scenes of a protocol for so long; `name` is what the command line calls it."""
    proved = ProofResult()
    end = time.monotonic() + seconds
    try:
        from aces_bus.testing import Fuzzer
        from aces_bus.testing.packets import UndrawableError

        try:
            fuzzer = Fuzzer([protocol], seed=SEED)
            for number in example_numbers(len(fuzzer.benches)):
                if fuzzer.examples >= LEAST and time.monotonic() > end:
                    break
                fuzzer.run(1, number)
                proved.scenes = fuzzer.examples
            for failure in fuzzer.failures:
                _report(proved, failure, protocol, name)
        except UndrawableError as error:
            proved.findings.append(finding_of_error(error, protocol, "the laws could not be asked"))
    except Exception as error:  # whatever a spec makes generated code or the core raise
        proved.findings.append(finding_of_error(error, protocol, "the generated code cannot be made or run"))
    return proved


def example_numbers(benches: int) -> Iterator[int]:
    """Yield the numbers of a fuzzer's examples, one of each bench in turn, each once."""
    from aces_bus.testing.fuzz import BLOCK

    places = [*range(6), BLOCK - 1, BLOCK - 2, *range(6, BLOCK - 2)]
    first = 0
    while True:
        for place in places:
            for block in range(first, first + benches):
                yield block * BLOCK + place
        first += benches


def _report(proved: ProofResult, failure: Failure, protocol: Protocol, name: str) -> None:
    from aces_bus.testing.drawing import scene_drawing

    message = next(
        (m for m in protocol.declared if re.search(rf"\b{re.escape(m.name)}\b", failure.text)),
        next((packet.message for packet in failure.scene.packets), None),
    )
    where = f"{message.name}: " if message is not None else ""
    text = " ".join(str(failure).split())
    finding = Finding(
        "error",
        "law",
        message.place if message is not None else protocol.place,
        f"{where}{text}",
        message.name if message is not None else None,
    )
    drawing = scene_drawing(failure.wire, failure.direction, failure.scene, failure.cuts)
    again = f"again: aces fuzz {name} --law {failure.law.number} --seed {SEED}:{failure.example}"
    proved.findings.append(finding)
    proved.drawings[finding] = f"{drawing}\n{again}"


def finding_of_error(error: BaseException, protocol: Protocol, what: str) -> Finding:
    """Return what a spec made the core raise: the message and field that were in hand, and their line."""
    owner = name = ""
    place: SourceLine | None = None
    for value in _in_hand(error):
        if isinstance(value, Written) and not owner:
            owner, name, place = value.owner, value.name, value.place
        elif isinstance(value, Message) and value in protocol.declared and not owner:
            owner = value.name
            place = value.place.of_field(name) if name and value.place.file.endswith(".py") else value.place
        elif isinstance(value, Construct) and value.name and not (owner or name):
            name = str(value.name)
    path = ".".join(part for part in (owner, name) if part)
    said = f"{type(error).__name__}: {' '.join(str(error).split())[:300]}"
    if isinstance(error, KeyError) and (asked := str(error.args[0]) if error.args else ""):
        said = (
            f"an expression asks for this.{asked}, and no field {asked!r} is read before it in its own struct"
        )
        if any(asked in message.outer_names for message in protocol.declared if owner in ("", message.name)):
            said += f"; fields of the identifier and the header are this._.{asked} in a payload"
    return Finding(
        "error",
        "law",
        place or protocol.place,
        f"{f'{path}: ' if path else ''}{what}: {said}",
        owner or None,
    )


def _in_hand(error: BaseException) -> Iterator[Any]:
    """Yield what the functions that an exception came through had in their variables, the innermost first."""
    frames: list[FrameType] = []
    at = error.__traceback__
    while at is not None:
        frames.append(at.tb_frame)
        at = at.tb_next
    for frame in reversed(frames):
        yield from list(frame.f_locals.values())
