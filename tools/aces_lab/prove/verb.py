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
import time
from pathlib import Path
from typing import Any

from aces_bus.errors import CallerError
from aces_bus.protocol import Variant
from aces_tools.console import print_json, say, say_note
from aces_tools.options import COLOR, JSON, Arguments, argument, at_least, positive
from aces_tools.output.columns import Page
from aces_tools.protocols_arg import named_protocol

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
    from .account import summary
    from .apart import prove_apart
    from .c_export import check_c
    from .run import jobs_of, prove_all

    variants = variants_of(arguments.protocol)
    if arguments.message is not None and not any(arguments.message in v.messages for v in variants):
        variants[0][arguments.message]  # raises, with the names that there are
    start = time.monotonic()
    jobs = jobs_of(variants, arguments.message, with_columns=arguments.columns)
    page = Page(arguments.color)
    outcomes = []
    for job, outcome in zip(jobs, prove_all(jobs, arguments.jobs, arguments.seconds), strict=True):
        outcomes.append(outcome)
        if arguments.json:
            continue
        if arguments.verbose or outcome.status not in ("proved",):
            more = f" ({outcome.reason})" if outcome.reason else ""
            time_used = f"{outcome.seconds:.1f} s, {outcome.paths} paths"
            print(f"{outcome.label} {outcome.message}: {outcome.status}{more}, {time_used}", flush=True)
        if outcome.status == "refuted" and outcome.witness is not None:
            _show(job, outcome, page, Path(arguments.witnesses))
    relations = (
        []
        if arguments.message
        else [outcome for v in variants for outcome in prove_apart(v, arguments.seconds)]
    )
    columns = [outcome.columns for outcome in outcomes if outcome.columns is not None]
    in_c = [outcome for v in variants for outcome in check_c(v)] if arguments.c else []
    if arguments.json:
        print_json([_as_dict(outcome) for outcome in [*outcomes, *relations, *columns, *in_c]])
    else:
        functions = sum(outcome.status == "proved" for outcome in outcomes)
        print(f"{arguments.protocol}: {summary(outcomes)}")
        if relations:
            print(f"{arguments.protocol}, apart and reachable: {summary(relations)}")
        if columns:
            print(f"{arguments.protocol}, columns: {summary(columns)}")
        if in_c:
            print(f"{arguments.protocol}, C: {summary(in_c)}")
        say_note(
            f"{len(jobs)} different messages in {len(variants)} variants, {functions} proved,"
            f" {time.monotonic() - start:.0f} s"
        )
    return int(any(outcome.status == "refuted" for outcome in [*outcomes, *relations, *columns, *in_c]))


def _show(job: Any, outcome: Any, page: Page, folder: Path) -> None:
    from . import witness as w

    found = outcome.witness
    print(f"  witness: {found.what}")
    page.lines([f"  {line}" for line in w.explained(job.variant, job.message, found, page.width, page.paint)])
    live, slow = w.scanned(job.variant, job.message, found)
    print(f"  scanner:   {live}\n  reference: {slow}")
    say(f"saved {w.save(job.variant, job.message, found, folder)}")


def _as_dict(outcome: Any) -> dict[str, Any]:
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
