"""What a protocol has been put through: bronze, silver, gold, platinum.

  aces spec badge my_spec.py        of a file of your own
  aces spec badge odrive            of an installed protocol
  aces spec badge odrive --save     write badges.json beside its manifest.toml;
                                    'aces protocols' and the catalogue show it

bronze    the nine laws hold on drawn packets, and each worked example of the
          data sheet is read and written back (there is one at least)
silver    there is a driver with a twin, and both pass all conformance checks
gold      the tests that manifest.toml names (oracle_tests) ran, every one of
          them, and passed: they compare values with those of a foreign program
          or a recording
platinum  each message is proved for all payloads ('aces spec prove'); what
          finds packets in a stream may be proved up to a length

Each is given by itself, for what ran here and passed; a test that is skipped
earns nothing. The manifest lies beside the spec or its driver; without one, a
file's own driver is tested, and nothing is gold.

A Python file is executed with your rights, and so are the tests that a manifest
names: name only what you trust.

exit status: 0 nothing that was run failed, 1 something did, 2 a wrong call
"""

from __future__ import annotations

import argparse
import datetime
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import msgspec

from aces_bus import list_protocols, load_protocol
from aces_bus.device import load_driver
from aces_bus.device.drivers import use_driver_file
from aces_bus.errors import CallerError
from aces_bus.protocol import Protocol
from aces_bus.protocol.lint import check_protocol
from aces_tools.authoring.check import prove
from aces_tools.badges import (
    LEVELS,
    MANIFEST,
    SAVED,
    CatalogueEntry,
    Earned,
    EntryBadges,
    entries_with,
    read_manifest,
    read_saved,
)
from aces_tools.console import counted, print_json, say, say_note
from aces_tools.options import JSON, Arguments, argument, flag
from aces_tools.proofs import protocol_hash, read_badges
from aces_tools.protocols_arg import named_protocol

SUMMARY = "run what a protocol's badges stand for, and say which it has"

ARGUMENTS: Arguments = (
    argument(
        "protocols", nargs="+", metavar="FILE|NAME", help="specs, which are executed, or installed protocols"
    ),
    flag("--save", help="write the badges beside the manifest, with the date"),
    flag("--prove", help="prove it now (needs z3; minutes), unless a proof of it is kept"),
    JSON,
)
#: How long the laws are tried on each protocol (s), and processor seconds for the proof of a message.
LAWS_S, PROOF_S = 3.0, 15


class Result(NamedTuple):
    """What running one level gave: a badge, or why there is none; `failed` says that something ran and did not pass."""

    earned: Earned | None
    why: str = ""
    failed: bool = False


def run(arguments: argparse.Namespace) -> int:
    given: list[dict[str, object]] = []
    failed, done = False, set[tuple[Path, str]]()
    for text in dict.fromkeys(arguments.protocols):
        named = named_protocol(text)
        for entry in _entries(text, named.protocol, named.source):
            if (entry.folder, entry.title) in done:
                continue  # an entry of several protocols
            done.add((entry.folder, entry.title))
            protocols = [
                named.protocol if name == named.protocol.name else load_protocol(name)
                for name in entry.protocols
            ]
            levels = _results(entry, protocols, named.source, arguments.prove)
            results: dict[str, Result] = dict(zip(LEVELS, levels, strict=True))
            failed |= any(result.failed for result in results.values())
            given.append({"entry": entry.title, **{level: _as_json(r) for level, r in results.items()}})
            if not arguments.json:
                _print(entry, results)
            if arguments.save:
                _save(entry, protocols, results)
    if arguments.json:
        print_json(given)
    return int(failed)


def _print(entry: CatalogueEntry, results: dict[str, Result]) -> None:
    print(f"{entry.title} ({', '.join(entry.protocols)})")
    for level, result in results.items():
        got = result.why if result.earned is None else f"{result.earned.date}, {result.earned.ran}"
        print(f"  {level:8}  {'yes' if result.earned else 'no ':3}  {got}", flush=True)


def _as_json(result: Result) -> dict[str, str]:
    return {"why_not": result.why} if result.earned is None else msgspec.structs.asdict(result.earned)


def _entries(text: str, protocol: Protocol, source: str) -> list[CatalogueEntry]:
    """Return the entries that a call names: those of a manifest, else the protocol by itself."""
    file = Path(protocol.place.file)
    beside = file.parent / MANIFEST
    found = list(entries_with(text)) if text in list_protocols() else []
    if not found and beside.is_file():
        found = [entry for entry in read_manifest(beside) if protocol.name in entry.protocols]
    if found:
        return found
    drivers = (
        [d.name for d in use_driver_file(str(file)) if d.protocol == protocol.name]
        if _is_file(source)
        else []
    )
    return [CatalogueEntry(file.parent, protocol.name, [protocol.name], drivers)]


def _is_file(source: str) -> bool:
    return source.partition(".py")[1] == ".py"


def _results(
    entry: CatalogueEntry, protocols: Sequence[Protocol], source: str, with_proof: bool
) -> Iterator[Result]:
    yield _bronze(protocols)
    yield _silver(entry, protocols, source)
    yield _gold(entry)
    yield _platinum(protocols, source, with_proof)


def _today(ran: str) -> Result:
    return Result(Earned(datetime.date.today().isoformat(), ran))


def _bronze(protocols: Sequence[Protocol]) -> Result:
    """Try the laws, and the worked examples."""
    examples = 0
    for protocol in protocols:
        found = len([example for message in protocol.declared for example in message.examples])
        if not found:
            return Result(None, f"{protocol.name} has no worked example: examples=[…] of a message")
        examples += found
        faults = [finding for finding in check_protocol(protocol) if finding.level == "error"]
        proved = prove(protocol, protocol.name, LAWS_S)
        faults += proved.findings
        if faults:
            return Result(None, f"{faults[0].place}: {faults[0].text}", failed=True)
    return _today(f"the nine laws, {counted(examples, 'worked example')}")


def _silver(entry: CatalogueEntry, protocols: Sequence[Protocol], source: str) -> Result:
    """Run the conformance checks of all drivers."""
    if not entry.drivers:
        return Result(None, "no driver")
    if entry.driver_tests:
        return _tested(entry, entry.driver_tests)
    file = str(Path(protocols[0].place.file).resolve()) if _is_file(source) else ""
    lines = [
        "from aces_bus.device.drivers import use_driver_file",
        "from aces_bus.testing import driver_tests",
    ]
    lines += [f"use_driver_file({file!r})"] * bool(file)
    lines += [f"test_{number} = driver_tests({name!r})" for number, name in enumerate(entry.drivers)]
    with tempfile.TemporaryDirectory(prefix="aces-badge-") as folder:
        test = Path(folder, "test_conformance.py")
        test.write_text("\n".join(lines), encoding="utf-8")
        found = _pytest([str(test)], Path(folder))
    if found.earned is None:
        return found
    twins = ", ".join(sorted({load_driver(name).twin.__name__ for name in entry.drivers}))
    return _today(f"{found.earned.ran}, {twins}")


def _gold(entry: CatalogueEntry) -> Result:
    """Run the tests that compare with a foreign program or a recording."""
    if not entry.oracle_tests:
        return Result(None, "no manifest names a test that compares: oracle_tests = […]")
    return _tested(entry, entry.oracle_tests)


def _tested(entry: CatalogueEntry, tests: Sequence[str]) -> Result:
    """Run tests that a manifest names by their paths from a folder above it."""
    files = list(dict.fromkeys(test.partition("::")[0] for test in tests))
    for root in entry.folder.parents:
        if all((root / file).is_file() for file in files):
            found = _pytest(tests, root)
            return found if found.earned is None else _today(f"{found.earned.ran} of {', '.join(files)}")
    return Result(
        None, f"{', '.join(files)} is in no folder above {entry.folder}: run this in its repository"
    )


def _pytest(tests: Sequence[str], folder: Path) -> Result:
    """Run tests by pytest in a program of its own; all must pass, none may be skipped."""
    with tempfile.NamedTemporaryFile(suffix=".xml") as report:
        command = [sys.executable, "-m", "pytest", "-q", "--junitxml", report.name, *tests]
        environment = {name: value for name, value in os.environ.items() if name != "PYTEST_ADDOPTS"}
        ended = subprocess.run(
            command, cwd=folder, env=environment, capture_output=True, text=True, check=False
        )
        text = Path(report.name).read_text(encoding="utf-8")
    if not text:
        said = (ended.stderr or ended.stdout).strip().splitlines()[-1:]
        return Result(None, f"pytest did not run: {' '.join(said)}", failed=True)
    counts = dict.fromkeys(("tests", "failures", "errors", "skipped"), 0)
    for suite in ElementTree.fromstring(text).iter("testsuite"):
        for name in counts:
            counts[name] += int(suite.get(name, 0))
    if counts["failures"] or counts["errors"]:
        say(ended.stdout[-4000:], who="")
        return Result(
            None, f"{counts['failures'] + counts['errors']} of {counts['tests']} tests failed", failed=True
        )
    if counts["skipped"]:
        skips = [skip.get("message", "") for skip in ElementTree.fromstring(text).iter("skipped")]
        return Result(None, f"{counts['skipped']} of {counts['tests']} tests skipped: {skips[0]}")
    if not counts["tests"]:
        return Result(None, f"no test in {', '.join(tests)}")
    return _today(counted(counts["tests"], "test"))


def _platinum(protocols: Sequence[Protocol], source: str, with_proof: bool) -> Result:
    """Take the proofs that are kept, or prove now."""
    dates, summaries = [], []
    for protocol in protocols:
        kept = read_badges().get(protocol.name)
        if kept is not None and kept.hash == protocol_hash(protocol):
            parts = {"messages": kept.summary, "apart": kept.apart, "streams": kept.streams}
            date = kept.date
        elif with_proof:
            say_note(f"proving {protocol.name}")
            parts, date = _proved_now(source if len(protocols) == 1 else protocol.name)
        else:
            return Result(None, "no proof is kept: --prove")
        allowed = {"messages": {"proved"}, "apart": {"proved"}, "streams": {"proved", "bounded"}}
        for part, summary in parts.items():
            if summary and not {word.split()[0] for word in summary.split(", ")} <= allowed[part]:
                return Result(None, f"{part}: {summary}", failed="refuted" in summary)
        dates.append(date)
        streams = f"; streams: {parts['streams']}" if parts["streams"] else ""
        summaries.append(f"{parts['messages']}{streams}")
    return Result(Earned(min(dates), "; ".join(summaries)))


def _proved_now(name: str) -> tuple[dict[str, str], str]:
    """Have `aces spec prove` prove a protocol; return what became of it, counted by status."""
    command = [sys.executable, "-m", "aces_tools", "spec", "prove", name, "--json", "--seconds", str(PROOF_S)]
    ended = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=False)
    if ended.returncode == 2 or not ended.stdout:
        raise CallerError(f"aces spec prove {name} did not run; it says why above")
    counts: dict[str, dict[str, int]] = {"messages": {}, "streams": {}}
    for outcome in json.loads(ended.stdout):
        part = counts["streams" if outcome["message"].startswith("stream, ") else "messages"]
        part[outcome["status"]] = part.get(outcome["status"], 0) + outcome["messages"]
    texts = {
        part: ", ".join(f"{status} {count}" for status, count in found.items())
        for part, found in counts.items()
    }
    return texts, datetime.date.today().isoformat()


def _save(entry: CatalogueEntry, protocols: Sequence[Protocol], results: dict[str, Result]) -> None:
    """Write an entry's badges beside its manifest; other entries of the folder keep theirs."""
    if not (entry.folder / MANIFEST).is_file():
        raise CallerError(
            f"--save writes beside a manifest: write {entry.folder / MANIFEST} first (CONTRIBUTING.md)"
        )
    path = entry.folder / SAVED
    hashes = {protocol.name: protocol_hash(protocol) for protocol in protocols}
    earned = {level: result.earned for level, result in results.items() if result.earned is not None}
    titles = [known.title for known in read_manifest(entry.folder / MANIFEST)]
    kept = {title: badges for title, badges in read_saved(path).items() if title in titles}
    read_saved.cache_clear()
    badges = dict(sorted({**kept, entry.title: EntryBadges(hashes, earned)}.items()))
    path.write_bytes(msgspec.json.format(msgspec.json.encode(badges), indent=1) + b"\n")
    say_note(f"wrote {path}")
