"""What a dataset of a fleet consists of: inputs, frames, faults, what is missing.

  aces fleet status s3://lake/truck/
  aces fleet status lake/ --faults          each fault in a line
  aces fleet status lake/ --json            all of it, for programs

DATASET is what -o of aces decode --cluster named. It may be asked while a run
writes. More: docs/fleets.md.
"""

from __future__ import annotations

import argparse

from aces_tools.console import counted, print_json, say
from aces_tools.options import JSON, Arguments, argument, flag

from . import FleetStatus, status
from .decode_verb import duration_text

SUMMARY = "say what a dataset of a fleet consists of, and what is missing"

EPILOG = """\
exit status:
  0  all inputs are decoded, without a fault
  1  some are not, or something of them could not be read
  2  there is no such dataset, or it cannot be read
"""

ARGUMENTS: Arguments = (
    argument("dataset", metavar="DATASET", help="a folder, or its URI"),
    flag("--faults", help="each fault in a line"),
    JSON,
)


def run(arguments: argparse.Namespace) -> int:
    found = status(arguments.dataset)
    if arguments.json:
        print_json(_whole(found))
    else:
        _show(found, shows_faults=arguments.faults)
    return int(bool(found.cut_off or found.faulty or set(found.states) - {"done"}))


def _show(found: FleetStatus, *, shows_faults: bool) -> None:
    states = ", ".join(f"{number} {state}" for state, number in sorted(found.states.items())) or "none"
    print(f"{counted(len(found.inputs), 'input')} ({states}), {found.bytes / 1e9:.3g} GB")
    print(f"{duration_text(found.duration_s)} of recordings, {duration_text(found.seconds)} of work")
    for link, total in sorted(found.total.items()):
        print(total.line(link))
    print(f"{counted(len(found.messages), 'dataset')}: {', '.join(found.messages)}")
    for uri in found.cut_off:
        say(f"{uri}: an attempt was cut off; decode it again")
    if shows_faults:
        for entry in found.faulty:
            for fault in entry.faults:
                print(fault)
    elif found.faulty:
        print(f"{counted(len(found.faulty), 'input')} with faults; --faults shows them")


def _whole(found: FleetStatus) -> dict[str, object]:
    return {
        "dataset": found.dataset,
        "states": found.states,
        "bytes": found.bytes,
        "duration_s": found.duration_s,
        "seconds": found.seconds,
        "total": {link: total.bins for link, total in found.total.items()},
        "messages": found.messages,
        "cut_off": found.cut_off,
        "inputs": [
            {
                "uri": entry.uri,
                "state": entry.state,
                "size": entry.size,
                "hash": entry.hash,
                "format": entry.format,
                "counts": entry.counts,
                "duration_s": entry.duration_s,
                "rows": entry.rows,
                "faults": entry.faults,
                "outputs": entry.outputs,
            }
            for entry in found.inputs.values()
        ],
    }
