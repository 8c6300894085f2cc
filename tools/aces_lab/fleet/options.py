"""`--cluster`: the option that decodes with a fleet.

Every `aces decode` imports this module for its option. What a fleet needs, NumPy and the dataset's writers among it, is
imported with `decode_verb`, by a run that asks for a fleet.
"""

from __future__ import annotations

import argparse

from aces_tools.options import Arguments, argument

ARGUMENTS: Arguments = (
    argument(
        "--cluster",
        metavar="WHERE",
        help="tables, of many files and URIs, into a dataset: here (this process), local:4 (processes) or a Dask"
        " scheduler's address; see below",
    ),
)


def is_wanted(arguments: argparse.Namespace) -> bool:
    """Return whether the call says where to decode, and what is spoken."""
    return arguments.cluster is not None and bool(arguments.protocol)


def run(arguments: argparse.Namespace) -> int:
    """Run `aces decode --cluster`; return the exit status."""
    from .decode_verb import run as run_with_fleet

    return run_with_fleet(arguments)
