"""Completion scripts and manual pages, made of the verbs' tables. Needs shtab (extra `[dev]`).

1. The same tables give the same text on every machine: no dates, no versions, no widths of terminals.
2. What completes an argument is said by its name here, once for all verbs.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterator

from aces_bus.protocol.record import PlainValue

from ..main import Parser, parser_of
from ..verbs import actions_of, summary_of, top_verbs, verbs
from . import SCRIPTS

#: Names of arguments → the kind of names that completes them (see `completion.NAMES`).
KINDS = {
    "protocol": "protocols",
    "protocols": "protocols",
    "robot": "robots",
    "robots": "robots",
    "bus": "buses",
}
#: The same where an argument's name alone says too little.
KINDS_OF_VERBS = {
    ("devices", "driver"): "drivers",
    ("stop", "which"): "robots",
    ("device", "name"): "devices",
    ("device", "action"): "actions",
    ("device", "values"): "values",
    ("device fuzz", "name"): "devices",
    ("bus", "channels"): "buses",
    ("fuzz", "names"): "protocols",
    ("spec check", "names"): "protocols",
}
#: Kinds beside which files are offered: a name may be that of a file, a bus that of a port.
OR_FILES = ("protocols", "robots", "buses")
#: Arguments that are files.
FILES = ("files", "capture", "captures", "items", "paths", "path", "file")


def generated() -> dict[str, str]:
    """Return each file's name and text."""
    from shtab import complete

    whole = whole_parser()
    found = {file: complete(whole, shell) for shell, file in SCRIPTS.items()}
    # fish offers actions behind what else the verb takes, where they are (`whole_parser`); they come first.
    found["aces.fish"] = re.sub(r"(npos) -ge \d+(' -a)\b", r"\1 -eq 0\2", found["aces.fish"])
    found["man/aces.1"] = _contents_page()
    for verb in our_verbs():
        parser = parser_of(verb)
        found[f"man/{parser.prog.replace(' ', '-')}.1"] = _page(verb, parser)
    return {
        name: re.sub(r"[ \t]+$", "", text, flags=re.MULTILINE).rstrip("\n") + "\n"
        for name, text in found.items()
    }


def our_verbs() -> list[str]:
    """Return every verb of ours, with its action where it has some: `decode`, `spec check`."""
    return [name for name, verb in verbs().items() if verb.distribution == "aces-bus"]


# ---------------------------------------------------------------------- completion


def whole_parser() -> Parser:
    """Return one parser of all verbs."""
    whole = Parser(prog="aces", allow_abbrev=False)
    whole.add_argument("-V", "--version", action="store_true", help="print the version")
    subparsers = whole.add_subparsers(dest="verb")
    known = our_verbs()
    for verb in top_verbs():
        purpose = summary_of(verb)
        made = subparsers.add_parser(verb, help=purpose, description=purpose)
        if verb in known:
            _complete(verb, parser_of(verb, made))
        if not actions_of(verb):
            continue
        # Behind the places of the verb's own arguments: in the first one their names complete it (`completion`).
        actions = made.add_subparsers(dest="whole_action")
        for action, found in actions_of(verb).items():
            name, what = f"{verb} {action}", found.summary
            _complete(name, parser_of(name, actions.add_parser(action, help=what, description=what)))
    return whole


def _complete(verb: str, parser: Parser) -> None:
    """Say what completes each argument that is not a choice."""
    from shtab import FILE

    parser.description = summary_of(verb)
    for action in parser.arguments:
        if action.help and action.help is not argparse.SUPPRESS:
            action.help = _help(action, parser)
        if action.choices is not None or action.nargs == 0:
            continue
        kind = KINDS_OF_VERBS.get((verb, action.dest)) or KINDS.get(action.dest)
        metavar = action.metavar if isinstance(action.metavar, str) else ""
        if kind is not None:
            action.complete = _names(kind)  # type: ignore[attr-defined]
        elif action.dest in FILES or "FILE" in metavar or "CAPTURE" in metavar:
            action.complete = FILE  # type: ignore[attr-defined]


def _names(kind: str) -> dict[str, PlainValue]:
    """Return what completes names of a kind, and files, in each shell."""
    is_file = kind in OR_FILES
    name, ask = f"_aces_{kind}", f"aces completion --list {kind} --words"
    bash = f"""
{name}() {{
  compgen -W "$({ask} "$COMP_LINE" 2>/dev/null)" -- "$1"
{'  _shtab_compgen_files "$1"' if is_file else ""}
}}
"""
    zsh = f"""
{name}() {{
  local -a names
  names=(${{(f)"$({ask} "$BUFFER" 2>/dev/null)"}})
  compadd -a names
{"  _files" if is_file else ""}
}}
"""
    more = "; __fish_complete_path (commandline -ct)" if is_file else ""
    fish = f"({ask} (commandline -p | string collect) 2>/dev/null{more})"
    return {"bash": name, "zsh": name, "fish": fish, "preamble": {"bash": bash, "zsh": zsh}}


# ---------------------------------------------------------------------- manual pages


def _contents_page() -> str:
    lines = [*_head("aces", "devices on CAN and serial lines, from one declared protocol")]
    lines += [".SH SYNOPSIS", ".B aces", r".I VERB \fR…", ".SH VERBS"]
    for verb in our_verbs():
        lines += [".TP", f".BR aces\\-{_escaped(verb.replace(' ', '-'))} (1)", _escaped(summary_of(verb))]
    lines += [
        ".SH ENVIRONMENT",
        ".TP",
        ".B ACES_NOTES",
        _escaped("off: no notes on stderr, only results and what is wrong"),
    ]
    lines += [".TP", ".B ACES_ROBOT", "the robot of verbs that take one", ".TP", ".B NO_COLOR", "no colours"]
    return "\n".join(lines)


def _page(verb: str, parser: Parser) -> str:
    lines = [
        *_head(parser.prog.replace(" ", "-"), summary_of(verb)),
        ".SH SYNOPSIS",
        f".B {_escaped(parser.prog)}",
    ]
    positional = [argument for argument in parser.arguments if not argument.option_strings]
    lines += [_escaped(" ".join(["[options]", *map(_placed, positional)])), ".SH DESCRIPTION"]
    lines += _prose(parser.description or "")
    lines.append(".SH ARGUMENTS")
    for argument in parser.arguments:
        names = ", ".join(argument.option_strings) or str(argument.metavar or argument.dest)
        value = "" if not argument.option_strings or argument.nargs == 0 else f" {_value(argument)}"
        lines += [".TP", f".B {_escaped(names + value)}", _escaped(_help(argument, parser))]
    if parser.epilog:
        lines += [".SH NOTES", ".nf", *map(_escaped, parser.epilog.rstrip().splitlines()), ".fi"]
    return "\n".join([*lines, ".SH SEE ALSO", ".BR aces (1)"])


def _head(name: str, purpose: str) -> list[str]:
    return [
        f'.TH "{name.upper()}" 1 "" "aces\\-bus"',
        ".SH NAME",
        rf"{_escaped(name)} \- {_escaped(purpose)}",
    ]


def _placed(argument: argparse.Action) -> str:
    """Return a positional argument as a synopsis has it."""
    name = (
        argument.metavar
        if isinstance(argument.metavar, str)
        else "{" + ",".join(map(str, argument.choices or [argument.dest])) + "}"
    )
    return {"?": f"[{name}]", "*": f"[{name} …]", "+": f"{name} …"}.get(str(argument.nargs), name)


def _value(argument: argparse.Action) -> str:
    if isinstance(argument.metavar, tuple):
        return " ".join(argument.metavar)
    name = argument.metavar or (
        "{" + ",".join(map(str, argument.choices)) + "}" if argument.choices else argument.dest.upper()
    )
    return f"[{name}]" if argument.nargs == "?" else name


def _help(argument: argparse.Action, parser: Parser) -> str:
    return (argument.help or "") % {**vars(argument), "prog": parser.prog}


def _prose(text: str) -> Iterator[str]:
    """Yield paragraphs as they are; indented text line by line."""
    for paragraph in text.strip("\n").split("\n\n"):
        lines = paragraph.splitlines()
        is_code = any(line.startswith(" ") for line in lines)
        yield ".PP"
        yield from ([".nf"] if is_code else [])
        yield from map(_escaped, lines)
        yield from ([".fi"] if is_code else [])


def _escaped(line: str) -> str:
    """Return a line whose signs mean nothing to roff."""
    text = line.replace("\\", "\\e").replace("-", "\\-")
    return f"\\&{text}" if text[:1] in (".", "'") else text
