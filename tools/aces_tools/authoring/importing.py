"""A database of another tool as spec source: readable, yours to edit.

  aces spec import car.dbc > car.py       DBC, KCD, SYM, ARXML; CANopen: EDS, DCF
  aces spec import drive.eds -o drive.py
  aces decode trip.log -p car.py          decodes what -p car.dbc decodes

What is not taken over is said on stderr, one line each with file, line and
column, and stands as comments at the head of the source; the rest is there.
Senders, receivers and cycle times become text of their message. Text of the
file (comments, units, names of values) is only ever a string in the source.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from aces_bus.errors import CallerError
from aces_bus.protocol.exchange import SUFFIXES, load_database
from aces_bus.protocol.exchange.export_source import print_source

from ..console import check_suffix, say
from .losses import left_out


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("file", metavar="FILE", help=f"one of the kinds {' '.join(SUFFIXES)}")
    parser.add_argument("-o", "--output", metavar="FILE.py", help="write there instead of on stdout")
    parser.add_argument("--force", action="store_true", help="write -o FILE.py even if it is there")
    parser.add_argument(
        "--json", action="store_true", help="source and problems as one JSON object on stdout"
    )
    parser.add_argument(
        "--strict", action="store_true", help="exit 1 when anything of the file could not be taken over"
    )


def run(arguments: argparse.Namespace) -> int:
    path: str = arguments.file
    check_suffix("-o", arguments.output, ".py")
    imported = load_database(path)
    kind = Path(path).suffix.lstrip(".").upper()
    problems = list(imported.problems)
    if kind == "DBC":
        problems = sorted([*problems, *left_out(path)])
    article = "an" if kind[0] in "AESM" else "a"
    text = print_source(imported.protocol, problems, f"{article} {kind} file")
    if arguments.output is not None:
        write(arguments.output, text, force=arguments.force)
    if arguments.json:
        told = [
            {
                "line": one.line or None,
                "column": one.column or None,
                "reason": one.reason,
                "excerpt": one.excerpt,
                "is_note": one.is_note,
            }
            for one in problems
        ]
        about = {
            "file": path,
            "protocol": imported.protocol.name,
            "messages": len(imported.protocol.declared),
            "output": arguments.output,
            "source": text if arguments.output is None else None,
            "problems": told,
        }
        print(json.dumps(about, ensure_ascii=False, indent=2))
    elif arguments.output is None:
        sys.stdout.write(text)
    if not arguments.json:
        for problem in problems:
            say(problem.of(path), who="")
        if imported.summary:
            say(imported.summary)
    return 1 if arguments.strict and imported.losses else 0


def write(path: str, text: str, *, force: bool) -> None:
    """Write a new file; raises `CallerError` for one that is there, unless `force` says that it may go."""
    try:
        with open(path, "w" if force else "x", encoding="utf-8", newline="\n") as file:
            file.write(text)
    except FileExistsError:
        raise CallerError(f"{path}: is there already; choose another name, or say --force") from None
    except OSError as error:
        raise CallerError(f"{path}: cannot be written: {error.strerror or error}") from error
    say(f"wrote {path}")
