"""Prove that generated codecs give what their spec says, for all payloads.

  aces spec prove hubo              every message of every dialect and
                                    configuration
  aces spec prove hubo:D12          those of one dialect
  aces spec prove car.dbc --message Engine
                                    one message of a database
  aces spec prove my_spec.py -v     each message with time and paths

The generated functions run as they are on symbolic bytes, and a solver (z3)
compares what they give with the declaration, read once more as arithmetic on
bits. What cannot be proved is named with the reason. A failed proof prints
the payload, saves it as a capture in the folder of --witnesses, and runs
scanner and reference on it. docs/proofs.md says what is proved and what is
trusted.

A Python file is executed with your rights: name only what you trust.

exit status: 0 nothing was refuted, 1 something was, 2 a wrong call
"""

from __future__ import annotations

import argparse
import importlib.util
import textwrap
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from aces_bus.errors import CallerError
from aces_bus.plain_text import printable_lines
from aces_bus.protocol import Variant
from aces_tools.console import counted, print_json, say, say_note
from aces_tools.options import COLOR, JSON, Arguments, argument, at_least, positive
from aces_tools.output.columns import Page
from aces_tools.protocols_arg import named_protocol

if TYPE_CHECKING:
    from .account import Outcome
    from .decoding import Witness
    from .run import ProofJob

SUMMARY = "prove that generated codecs equal their spec for all payloads"

ARGUMENTS: Arguments = (
    argument("protocol", metavar="NAME|FILE", help="a protocol, as -p of 'aces decode' takes it"),
    argument("-m", "--message", metavar="NAME", help="one message alone"),
    argument("--seconds", type=positive, default=60.0, metavar="N", help="limit for a message (default: 60)"),
    argument("--jobs", type=at_least(1), default=2, metavar="N", help="processes (default: 2)"),
    argument("--witnesses", default="witnesses", metavar="DIR", help="folder for captures of failed proofs"),
    argument("--columns", action="store_true", help="compare columns of recordings, too: minutes"),
    argument("--c", action="store_true", help="compile the C export and compare it, too"),
    argument("-v", "--verbose", action="store_true", help="a line for each message"),
    JSON,
    COLOR,
)


def variants_of(text: str) -> list[Variant]:
    """Return the variants that a name stands for: all of them, where it says neither dialect nor configuration."""
    named = named_protocol(text)
    if named.dialect is None and named.configuration is None:
        return named.protocol.variants()
    return [named.variant()]


def run(arguments: argparse.Namespace) -> int:
    if importlib.util.find_spec("z3") is None:
        raise CallerError("proofs need z3: pip install 'aces-bus[prove]'")
    variants = variants_of(arguments.protocol)
    if arguments.message is not None and not any(arguments.message in v.messages for v in variants):
        variants[0][arguments.message]  # raises, with the names that there are
    from .account import summary

    start = time.monotonic()
    given: list[Outcome] = []
    found: list[Outcome] = []
    title, page = "", Page(arguments.color)
    try:
        for title, jobs in sections(variants, arguments):
            found = []
            _prove(jobs, found, arguments)
            given += found
            if found and not arguments.json:
                _print_wrapped(f"{arguments.protocol}{title}: {summary(found)}", page)
    except KeyboardInterrupt:
        say(f"interrupted; {summary(found) if found else 'nothing proved'} so far{title}")
        return 130
    if arguments.json:
        print_json([_as_dict(one) for one in given])
    say_note(f"{counted(len(variants), 'variant')}, {time.monotonic() - start:.0f} s")
    return int(any(outcome.status == "refuted" for outcome in given))


def sections(
    variants: Sequence[Variant], arguments: argparse.Namespace
) -> Iterator[tuple[str, Sequence[ProofJob]]]:
    """Yield what is to be proved: jobs of one kind, and what their line of the account is called."""
    from .apart import ApartJob
    from .c_export import CJob
    from .columns import ColumnsJob
    from .run import jobs_of
    from .streams import StreamJob

    jobs = jobs_of(variants, arguments.message)
    yield "", jobs
    if arguments.message is None:
        yield ", apart and reachable", [ApartJob(variant) for variant in variants]
        yield ", streams", [StreamJob(variant) for variant in variants if variant.link != "can"]
    if arguments.columns:
        yield ", columns", [ColumnsJob(job.variant, job.message, job.count) for job in jobs]
    if arguments.c:
        yield ", C", [CJob(variant) for variant in variants]


def _prove(jobs: Sequence[ProofJob], given: list[Outcome], arguments: argparse.Namespace) -> None:
    """Prove jobs into a list, and say at once what is no more than bounded, and what is refuted."""
    from .run import prove_all

    for job, outcomes in zip(jobs, prove_all(jobs, arguments.jobs, arguments.seconds), strict=True):
        given += outcomes
        if arguments.json:
            continue
        for outcome in outcomes:
            if arguments.verbose or outcome.status != "proved":
                _print_outcome(outcome, Page(arguments.color), with_time=arguments.verbose)
            if outcome.status == "refuted" and outcome.witness is not None:
                _show(job.variant, outcome, outcome.witness, arguments)


def _print_outcome(outcome: Outcome, page: Page, *, with_time: bool) -> None:
    """Print what became of one message, with the reason, and the time that it took."""
    used = f"{outcome.seconds:.1f} s" + (f", {counted(outcome.paths, 'path')}" if outcome.paths else "")
    text = "; ".join(part for part in (outcome.reason, used if with_time else "") if part)
    _print_wrapped(f"{outcome.label} {outcome.message}: {outcome.status}{text and f', {text}'}", page)


def _print_wrapped(text: str, page: Page) -> None:
    """Print a line at once, indented where it goes on."""
    text, width = printable_lines(text), page.width
    lines = (
        [text]
        if width is None
        else textwrap.wrap(text, width, subsequent_indent="  ", break_on_hyphens=False)
    )
    print("\n".join(lines), flush=True)


def _show(variant: Variant, outcome: Outcome, found: Witness, arguments: argparse.Namespace) -> None:
    """Print a witness as an annotated frame, with what scanner and reference say of it, and save it as a capture."""
    from . import witness as w

    page = Page(arguments.color)
    message = variant.messages.get(outcome.message)
    print(f"  witness: {found.what}")
    page.lines([f"  {line}" for line in w.explained(variant, message, found, page.width, page.paint)])
    live, slow = w.scanned(variant, message, found)
    print(f"  scanner:   {live}\n  reference: {slow}")
    name = f"{outcome.label} {outcome.message}"
    say(f"saved {w.save(name, message, found, Path(arguments.witnesses))}")


def _as_dict(outcome: Outcome) -> dict[str, object]:
    found = outcome.witness
    return {
        "variant": outcome.label,
        "message": outcome.message,
        "status": outcome.status,
        "parts": [
            {"what": part.what, "status": part.status, "reason": part.reason or None}
            for part in outcome.parts
        ],
        "messages": outcome.count,
        "seconds": round(outcome.seconds, 2),
        "paths": outcome.paths,
        "witness": None
        if found is None
        else {"what": found.what, "key": found.key, "data": found.data.hex()},
    }
