"""The nine laws on a spec for some seconds: they find what is wrong with the code generated from it, which no rule sees.

1. Scenes follow from one seed and their number: time decides how many there are, never which.
2. All dialects, configurations and directions take turns from the first scene on; what is long comes after what is short.
3. Nothing raises: whatever a spec makes the core raise is a finding, with the message and its line.
"""

from __future__ import annotations

import re
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from types import FrameType
from typing import TYPE_CHECKING, Any

from construct import Construct

from aces_bus.protocol import Message, Protocol
from aces_bus.protocol.declare.place import SourceLine
from aces_bus.protocol.lint import Finding
from aces_bus.protocol.lint.fields import Written

if TYPE_CHECKING:
    from aces_bus.testing.fuzz import Failure, Fuzzer

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
        from aces_bus.testing.fuzz import Fuzzer
        from aces_bus.testing.packets import UndrawableError

        try:
            fuzzer = Fuzzer([protocol], seed=SEED)
            for number in example_numbers(len(fuzzer.benches)):
                if fuzzer.examples >= LEAST and time.monotonic() > end:
                    break
                fuzzer.run(1, number)
                proved.scenes = fuzzer.examples
            for failure in fuzzer.failures:
                _tell(proved, fuzzer, failure, protocol, name)
        except UndrawableError as error:
            proved.findings.append(finding_of_error(error, protocol, "the laws could not be asked"))
    except Exception as error:  # whatever a spec makes generated code or the core raise
        proved.findings.append(finding_of_error(error, protocol, "the generated code cannot be made or run"))
    return proved


def example_numbers(benches: int) -> Iterator[int]:
    """The numbers of a fuzzer's examples, one of each bench in turn, each once."""
    from aces_bus.testing.fuzz import BLOCK

    places = [*range(6), BLOCK - 1, BLOCK - 2, *range(6, BLOCK - 2)]
    first = 0
    while True:
        for place in places:
            for block in range(first, first + benches):
                yield block * BLOCK + place
        first += benches


def _tell(proved: ProofResult, fuzzer: Fuzzer, failure: Failure, protocol: Protocol, name: str) -> None:
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
    """What a spec made the core raise: the message and field that were in hand, and their line."""
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
    path = ".".join(one for one in (owner, name) if one)
    said = " ".join(str(error).split())[:300]
    return Finding(
        "error",
        "law",
        place or protocol.place,
        f"{f'{path}: ' if path else ''}{what}: {type(error).__name__}: {said}",
        owner or None,
    )


def _in_hand(error: BaseException) -> Iterator[Any]:
    """What the functions that an exception came through had in their variables, the innermost first."""
    frames: list[FrameType] = []
    at = error.__traceback__
    while at is not None:
        frames.append(at.tb_frame)
        at = at.tb_next
    for frame in reversed(frames):
        yield from list(frame.f_locals.values())


__all__ = ["ProofResult", "example_numbers", "finding_of_error", "prove"]
