"""The work of one process: some examples of a run, or given scenes; what comes back is plain data.

1. A task says everything: any process, now or later, does the same with it.
2. Failures are shrunk, drawn and saved where they are found; what is sent back is text.
"""

from __future__ import annotations

import gc
import json
import os
import shlex
import signal
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

from aces_bus.errors import CallerError, UnknownNameError
from aces_bus.protocol import Variant
from aces_bus.testing import LAWS, Fuzzer, Scene, laws
from aces_bus.testing.coverage import Coverage, Feature
from aces_bus.testing.drawing import scene_drawing
from aces_bus.testing.fuzz import Failure
from aces_bus.testing.laws import Way
from aces_bus.testing.saved import load_scene, save_scene
from aces_bus.testing.trial import Law

from .protocols_arg import named_protocol


@dataclass(frozen=True)
class FuzzJob:
    """What is asked of every process: the names as they were written, the laws, the seed, and where things go."""

    names: tuple[str, ...]
    laws: tuple[int, ...]
    seed: int
    failures: str
    most: int = 3
    corpus: str | None = None


@dataclass(frozen=True)
class FuzzTask:
    """Examples `first`…`first + count`, or the scenes of files."""

    first: int = 0
    count: int = 0
    files: tuple[str, ...] = ()


@dataclass(frozen=True)
class FoundFailure:
    """A failure as text."""

    law: int
    name: str
    protocol: str
    label: str
    direction: str | None
    text: str
    drawing: str
    size: int
    capture: str
    scene: str
    commands: tuple[str, ...]
    example: int | None


@dataclass
class TaskResult:
    """What a task did."""

    examples: int = 0
    checks: int = 0
    bytes_and_frames: int = 0
    process: int = 0
    #: Which of its process's tasks it was: what was reached is sent as a whole each time.
    turn: int = 0
    reached: dict[Feature, int] = field(default_factory=dict)
    expected: set[Feature] = field(default_factory=set)
    found: list[FoundFailure] = field(default_factory=list)
    kept: int = 0


def ignore_interrupts() -> None:
    """Ignore Ctrl-C in a process of the pool: the process that started it handles it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def rare_collections() -> None:
    """Collect garbage rarely: specs, plans and scanners stay, and looking through them costs a tenth of the time."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(20_000, 20, 100)


def places(text: str) -> list[tuple[Variant, Way]]:
    """Return the wires of a protocol as the command line names it: all of a name alone, else those of dialect or
    configuration.
    """
    what = named_protocol(text)
    if what.channel is not None:
        raise CallerError(f"{text}: a channel makes no difference here; write {text.partition('=')[2]}")
    if what.configuration is not None:
        variants = [what.variant()]
    elif what.dialect is not None:
        tables: list[str | None] = [*what.protocol.configurations] or [None]
        variants = [what.protocol.variant(what.dialect, table) for table in tables]
    else:
        variants = what.protocol.variants()
    return [(variant, way) for variant in variants for way in laws.directions(variant)]


class FuzzWorker:
    """The fuzzer of this process; what is in the corpus is judged before anything else."""

    def __init__(self, job: FuzzJob) -> None:
        chosen = [law for law in LAWS if law.number in job.laws]
        self.job = job
        self.fuzzer = Fuzzer(
            [place for text in job.names for place in places(text)], seed=job.seed, laws=chosen
        )
        self.fuzzer.keeps = job.corpus is not None
        rare_collections()
        self._done = TaskResult()
        self._failures = self._kept = self._turn = 0
        self.todo = corpus_files(job.corpus) if job.corpus is not None else ()

    def do(self, task: FuzzTask) -> TaskResult:
        """Do a task; report what was done since the last time, and everything that was reached so far."""
        fuzzer, before = self.fuzzer, self._done
        for name in (*self.todo, *task.files):
            _replayed(fuzzer, name)
        fuzzer.kept = [] if self.todo else fuzzer.kept
        self.todo = ()
        fuzzer.run(task.count, task.first, most=self.job.most)
        for bench, scene, cuts in fuzzer.kept if self.job.corpus is not None else ():
            if self._kept < MOST_KEPT:
                save_scene(Path(self.job.corpus or ""), bench.wire, bench.direction, scene, cuts)
                self._kept += 1
        fuzzer.kept.clear()
        found = [failure_report(self.job, failure) for failure in fuzzer.failures[self._failures :]]
        self._failures = len(fuzzer.failures)
        self._turn += 1
        self._done = TaskResult(fuzzer.examples, fuzzer.checks, fuzzer.bytes_and_frames, kept=self._kept)
        return TaskResult(
            fuzzer.examples - before.examples,
            fuzzer.checks - before.checks,
            fuzzer.bytes_and_frames - before.bytes_and_frames,
            os.getpid(),
            self._turn,
            dict(fuzzer.coverage.reached),
            set(fuzzer.coverage.expected),
            found,
            self._kept,
        )


#: Scenes that a process adds to a corpus at most.
MOST_KEPT = 1000


def corpus_files(folder: str) -> tuple[str, ...]:
    """Return the files of a corpus to judge: scenes, and captures that users put there; not those that scenes come with."""
    try:
        names = sorted(path for path in Path(folder).iterdir() if path.is_file() and path.name[0] != ".")
    except FileNotFoundError:
        return ()
    except OSError as error:
        raise CallerError(f"{folder}: {error.strerror or error}") from error
    scenes = {path.with_suffix("") for path in names if path.suffix == ".json"}
    return tuple(str(path) for path in names if path.suffix == ".json" or path.with_suffix("") not in scenes)


@lru_cache(maxsize=1)
def worker_of(job: FuzzJob) -> FuzzWorker:
    """Return the worker of this process."""
    return FuzzWorker(job)


def work(job: FuzzJob, task: FuzzTask) -> TaskResult:
    """Do a task in this process."""
    return worker_of(job).do(task)


def _replayed(fuzzer: Fuzzer, name: str) -> None:
    """Judge the scene of a file, or the pieces of a capture, on the wires that they are of."""
    if not name.endswith(".json"):
        _captured(fuzzer, name)
        return
    loaded = load_scene(Path(name))
    mine = [b for b in fuzzer.benches if b.variants[0].name == loaded.protocol] or fuzzer.benches
    mine = [b for b in mine if b.is_can != isinstance(loaded.traffic, bytes)]
    if not mine:
        raise CallerError(
            f"{name}: a scene of {loaded.protocol}, on another kind of link than what is fuzzed"
        )
    same = [b for b in mine if (b.label, b.direction) == (loaded.label, loaded.direction)]
    for bench in same or mine:
        fuzzer.judge(bench, loaded.scene(bench), loaded.cuts)


#: Of a capture, frames or bytes in one scene, and scenes.
PIECES = {True: (32, 200), False: (512, 200)}


def _captured(fuzzer: Fuzzer, name: str) -> None:
    from aces_bus import open_recording
    from aces_bus.recordings.base import CanRecording

    for is_can in sorted({bench.is_can for bench in fuzzer.benches}):
        size, most = PIECES[is_can]
        with open_recording(name, link="can" if is_can else "serial") as capture:
            traffic: list[Any] = []
            for item in capture:
                traffic += [item] if isinstance(capture, CanRecording) else [bytes([b]) for b in item.data]
                if len(traffic) >= size * most:
                    break
        for start in range(0, len(traffic), size):
            piece: Any = traffic[start : start + size]
            scene = Scene(tuple(piece) if is_can else b"".join(piece))
            for bench in fuzzer.benches:
                if bench.is_can == is_can:
                    fuzzer.judge(bench, scene, (len(scene) // 2,))


def failure_report(job: FuzzJob, failure: Failure) -> FoundFailure:
    """Return a failure, saved and in words."""
    folder = Path(job.failures)
    wire, direction, law = failure.wire, failure.direction, failure.law
    saved = save_scene(folder, wire, direction, failure.scene, failure.cuts, law=law.number)
    if job.corpus is not None:
        save_scene(Path(job.corpus), wire, direction, failure.scene, failure.cuts, law=law.number)
    names = " ".join(map(shlex.quote, job.names))
    commands = [f"aces fuzz {names} --replay {shlex.quote(str(saved.scene))}"]
    if failure.example is not None:
        commands.insert(0, f"aces fuzz {names} --law {law.number} --seed {job.seed}:{failure.example}")
    name = next(
        (n for n in job.names if named_protocol(n).protocol.name == laws.wire_variants(wire)[0].name), names
    )
    commands.append(saved.decode_command(name, direction))
    return FoundFailure(
        law.number,
        law.name,
        laws.wire_variants(wire)[0].name,
        failure.label,
        direction,
        failure.text,
        scene_drawing(wire, direction, failure.scene, failure.cuts),
        len(failure.scene),
        str(saved.capture),
        str(saved.scene),
        tuple(commands),
        failure.example,
    )


def chosen_laws(texts: Sequence[str]) -> tuple[int, ...]:
    """Return the numbers of laws that are named: `3`, `chunking`, `3-chunking`; all when none is."""
    found = {_law(law.strip()).number for text in texts for law in text.split(",")}
    return tuple(sorted(found)) or tuple(law.number for law in LAWS)


def _law(text: str) -> Law:
    wanted = text.lower().replace("-", " ").replace("_", " ")
    for law in LAWS:
        if wanted in (str(law.number), law.name, f"{law.number} {law.name}"):
            return law
    raise UnknownNameError("law", text, [str(law) for law in LAWS])


# ---------------------------------------------------------------------- what is printed

#: Names of a kind that are listed when they were never reached.
NAMED = 40
PLURALS = {"message": "messages", "field": "fields", "value": "named values", "template": "templates"}


def failure_text(found: FoundFailure) -> str:
    """Return a failure, drawn, with the lines that repeat it."""
    where = f"{found.label}, {found.direction or 'any direction'}"
    lines = [f"FAILED law {found.law} ({found.name}) of {where}", ""]
    lines += textwrap.wrap(found.text.replace("\n", " "), 108, initial_indent="  ", subsequent_indent="    ")[
        :8
    ]
    lines += ["", textwrap.indent(found.drawing, "  "), "", f"  saved: {found.capture}", "  again:"]
    lines += [f"    {command}" for command in found.commands]
    return "\n".join(lines) + "\n"


def coverage_table(coverage: Coverage, width: int) -> str:
    """Return what was reached, a line a message; then what never was."""
    lines: list[str] = []
    for protocol in coverage.protocols:
        parts = [(PLURALS[kind], *coverage.parts(protocol, kind)) for kind in Coverage.KINDS]
        lines.append(f"{protocol}: " + ", ".join(f"{n}/{all} {kind}" for kind, n, all in parts if all))
        names = sorted(f[2] for f in coverage.expected if f[0] == protocol and f[1] == "message")
        long = max([len("message"), *map(len, names)])
        lines.append(f"  {'message':<{long}}  {'records':>8}  {'fields':>7}  {'values':>7}  templates")
        for name in names:
            records = coverage.reached[protocol, "message", name]
            cells = [
                _part(coverage.of_message(protocol, name, kind)) for kind in ("field", "value", "template")
            ]
            lines.append(
                f"  {name:<{long}}  {records:>8}  {cells[0]:>7}  {cells[1]:>7}  {cells[2]:>9}".rstrip()
            )
        ends: dict[str, list[str]] = {}
        for _, _, what in sorted(f for f in coverage.expected if f[:2] == (protocol, "template")):
            framing, _, end = what.rpartition(": ")
            if framing.startswith("framing "):
                ends.setdefault(framing, []).append(f"{end} {coverage.reached[protocol, 'template', what]}")
        lines += [f"  {framing}: {', '.join(texts)}" for framing, texts in ends.items()]
        never = coverage.never(protocol)
        for kind in Coverage.KINDS:
            missing = [name for _, k, name in never if k == kind]
            if missing:
                more = f" and {len(missing) - NAMED} more" if len(missing) > NAMED else ""
                text = f"{PLURALS[kind]} never reached: {', '.join(missing[:NAMED])}{more}"
                lines += textwrap.wrap(
                    text, max(40, width - 2), initial_indent="  ", subsequent_indent="    "
                )
        if not never:
            lines.append("  nothing was left out")
    return "\n".join(lines)


def _part(numbers: tuple[int, int]) -> str:
    return f"{numbers[0]}/{numbers[1]}" if numbers[1] else "-"


def as_json(
    names: Sequence[str], numbers: Mapping[str, Any], found: Sequence[FoundFailure], coverage: Coverage
) -> str:
    """Return the whole run as one JSON object."""
    protocols = {
        protocol: {
            **{
                PLURALS[kind].replace(" ", "_"): dict(
                    zip(("reached", "of"), coverage.parts(protocol, kind), strict=True)
                )
                for kind in Coverage.KINDS
            },
            "never": [f"{kind} {name}" for _, kind, name in coverage.never(protocol)],
            "records": {
                name: coverage.reached[protocol, "message", name]
                for p, kind, name in sorted(coverage.expected)
                if (p, kind) == (protocol, "message")
            },
        }
        for protocol in coverage.protocols
    }
    failures = [
        {
            "law": failure.law,
            "name": failure.name,
            "wire": failure.label,
            "direction": failure.direction,
            "text": failure.text,
            "drawing": failure.drawing,
            "capture": failure.capture,
            "scene": failure.scene,
            "commands": list(failure.commands),
            "example": failure.example,
        }
        for failure in found
    ]
    return json.dumps(
        {"names": list(names), **numbers, "failures": failures, "protocols": protocols}, ensure_ascii=False
    )
