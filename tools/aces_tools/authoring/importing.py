"""A database of another tool as spec source: readable, yours to edit.

  aces spec import car.dbc > car.py       also KCD, SYM, ARXML, EDS, DCF
  aces spec import drive.eds -o drive.py
  aces decode trip.log -p car.py          decodes what -p car.dbc decodes

What cannot be imported is listed on stderr, one line each with file, line and
column, and in comments at the head of the source. Senders, receivers and cycle
times become text of their message. Text of the file (comments, units, names of
values) is only ever a string in the source.
"""

from __future__ import annotations

import argparse
import os
import re
import sys
from pathlib import Path

from aces_bus.errors import CallerError
from aces_bus.protocol.exchange import database_suffixes, load_database, print_source
from aces_bus.protocol.exchange.import_dbc import read_text
from aces_bus.protocol.exchange.import_statements import split_statements
from aces_bus.protocol.exchange.problems import ImportProblem, ProblemText

from ..console import check_suffix, print_json, say, write_text
from ..options import JSON, OUTPUT, STRICT, Arguments, argument, flag

SUMMARY = "turn a DBC, KCD, SYM, ARXML or EDS file into a spec"

ARGUMENTS: Arguments = (
    argument(
        "file", metavar="FILE", help=f"one of the kinds {' '.join(database_suffixes())}; what is on CAN"
    ),
    OUTPUT.but(metavar="FILE.py"),
    flag("--force", help="write -o FILE.py even if it exists"),
    JSON.but(help="source and problems as one JSON object on standard output"),
    STRICT.but(help="exit 1 when anything of the file could not be imported"),
)


def run(arguments: argparse.Namespace) -> int:
    path: str = arguments.file
    check_suffix("-o", arguments.output, ".py")
    imported = load_database(path)
    kind = Path(path).suffix.lstrip(".").upper()
    problems = list(imported.problems)
    if kind == "DBC":
        problems = sorted([*problems, *dbc_losses(path)])
    article = "an" if kind[0] in "AESM" else "a"
    text = print_source(imported.protocol, problems, f"{article} {kind} file")
    if arguments.output is not None:
        if os.path.exists(arguments.output) and not arguments.force:
            raise CallerError(f"{arguments.output}: is there already; choose another name, or say --force")
        write_text(arguments.output, text)
    if arguments.json:
        listed = [
            {
                "line": problem.line or None,
                "column": problem.column or None,
                "reason": problem.reason,
                "excerpt": problem.excerpt,
                "is_note": problem.is_note,
            }
            for problem in problems
        ]
        about = {
            "file": path,
            "protocol": imported.protocol.name,
            "messages": len(imported.protocol.declared),
            "output": arguments.output,
            "source": text if arguments.output is None else None,
            "problems": listed,
        }
        print_json(about)
    elif arguments.output is None:
        sys.stdout.write(text)
    if not arguments.json:
        for problem in problems:
            say(problem.of(path), who="")
        if imported.summary:
            say(imported.summary)
    return 1 if arguments.strict and imported.losses else 0


# ---------------------------------------------------------------------- what a DBC says and a spec cannot

#: Attributes that are taken over: frame format, names, cycle time, J1939.
_TAKEN = frozenset(
    (
        *("VFrameFormat", "ProtocolType", "GenMsgCycleTime", "Baudrate"),
        *("SystemMessageLongSymbol", "SystemSignalLongSymbol", "SystemNodeLongSymbol"),
    )
)
_ATTRIBUTE = re.compile(r'\s*BA_\s+"([^"]*)"')
_KINDS = (
    (re.compile(r"\s*(EV_|ENVVAR_DATA_|EV_DATA_)\s"), "environment variables"),
    (re.compile(r"\s*SIG_GROUP_\s"), "groups of signals"),
    (re.compile(r"\s*BO_TX_BU_\s"), "further senders of messages"),
    (re.compile(r"\s*BA_REL_\s"), "attributes of relations"),
    (re.compile(r"\s*VAL_TABLE_\s"), "tables of values that no signal has"),
    (re.compile(r"\s*CM_\s+BU_\s"), "comments of nodes"),
    (re.compile(r"\s*CM_\s+EV_\s"), "comments of environment variables"),
    (re.compile(r'\s*CM_\s+"'), "comments of the whole file"),
)


def dbc_losses(path: str) -> list[ImportProblem]:
    """Return remarks about a DBC file. Raises `CallerError` when it cannot be read."""
    found: dict[str, list[int]] = {}
    for statement in split_statements(read_text(path, "dbc")):
        what = ""
        if statement.word == "BA_":
            attribute = _ATTRIBUTE.match(statement.text)
            if attribute is not None and attribute[1] not in _TAKEN:
                what = f"the attribute {ProblemText.excerpt(attribute[1])}"
        else:
            what = next((kind for pattern, kind in _KINDS if pattern.match(statement.text)), "")
        if what:
            found.setdefault(what, []).append(statement.line)
    return [
        ImportProblem(
            where[0],
            f"{what}: not taken over" + (f" ({len(where):,} times)" if len(where) > 1 else ""),
            is_note=True,
        )
        for what, where in found.items()
    ]
