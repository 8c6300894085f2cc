"""`aces VERB …`: finds the verb, runs it, turns what goes wrong into one line.

1. A verb's module is imported when that verb runs and not before: `aces --help` imports argparse and nothing else.
2. Whatever goes wrong on purpose (`AcesError`) is one line on stderr and status 2; a traceback is a bug.
3. `main` returns a status and never exits, so that tests and programs can call it.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from importlib import import_module
from io import TextIOWrapper
from typing import NoReturn

from aces_bus import __version__
from aces_bus.errors import AcesError, UnknownNameError

from .console import abandon_stdout, say

#: Verb → its module in this package, and what it is for. The module has `add_arguments(parser)` and `run(arguments)`,
#: and describes itself in its docstring, which `aces VERB --help` shows; or a table ACTIONS of the same form, one deeper.
VERBS: dict[str, tuple[str, str]] = {
    "decode": ("decode", "decode recordings: candump, BLF, ASC, MF4 …, serial captures, standard input"),
    "plot": ("plot", "draw signals over time: in the terminal, PNG, SVG, PDF"),
    "convert": ("convert", "convert recordings between formats: candump, ASC, BLF, TRC, MF4, pcapng, serial"),
    "sniff": ("sniff", "listen to a bus: decoded lines, filters, recordings; it cannot send"),
    "send": ("send", "send a message, once or every so often; only with --tx"),
    "play": ("play", "play recordings onto a bus at their pace; only with --tx"),
    "bus": ("bus", "serve a virtual bus to other programs; list buses; measure a bus's load"),
    "robot": ("robot", "robots as files: check, show, list; import from HuboCan and hubo-ach"),
    "devices": ("devices", "list the drivers, and what their devices can do"),
    "device": ("device", "read, set, watch, enable and home the devices of a robot; motion only with --tx"),
    "scan": ("scan", "find what answers on a bus, and write a robot's file of it"),
    "sim": ("sim", "put a robot's simulated devices on a bus"),
    "run": (
        "run",
        "run controllers on a robot: virtual, on its buses (motion only with --tx), on a recording",
    ),
    "protocols": ("protocols", "list protocols, their messages, and how a message is laid out"),
    "spec": ("spec", "for the authors of protocols: new, check, show, explain, export, import, stubs"),
    "fuzz": ("fuzz", "look for a stream that breaks a protocol: nine laws, shrunk failures, coverage"),
    "demo": ("demo", "a simulated robot follows a trajectory: set-point against actual, drawn"),
    "bench": ("bench", "measure decoding speed beside other libraries"),
}


class Parser(argparse.ArgumentParser):
    """An ArgumentParser whose complaint is one line."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"aces: {message} (see '{self.prog} --help')\n")


def main(argv: Sequence[str] | None = None) -> int:
    """Run `aces` with these arguments (by default the program's) and return its exit status."""
    if argv is None:
        # python-can imports asammdf where it is installed, for a format that we read in a process of its own: a second
        # of every start. In this program it is not to be found.
        sys.modules.setdefault("asammdf", None)  # type: ignore[arg-type]  # how import is told
        if isinstance(
            sys.stdout, TextIOWrapper
        ):  # where there is no Unicode, "?" stands for what cannot be written
            sys.stdout.reconfigure(errors="replace")
    try:
        status = _run(list(sys.argv[1:] if argv is None else argv))
        if sys.stdout is not None:
            sys.stdout.flush()
        return status
    except SystemExit as ended:  # argparse has said what is wrong, or has printed the help
        return ended.code if isinstance(ended.code, int) else 0 if ended.code is None else 2
    except AcesError as error:
        say(str(error))
        return 2
    except BrokenPipeError:
        abandon_stdout()
        return 0
    except KeyboardInterrupt:
        return 130


def _run(arguments: list[str]) -> int:
    if not arguments or arguments[0] in ("-h", "--help", "help"):
        if arguments[1:] and not arguments[1].startswith("-"):
            return _run([arguments[1], "--help"])
        print(_help())
        return 0
    if arguments[0] in ("-V", "--version"):
        print(f"aces {__version__}")
        return 0
    verb = arguments[0]
    if verb.startswith("-"):
        raise UnknownNameError("option", verb, ["--help", "--version"])
    if verb not in VERBS:
        raise UnknownNameError("verb", verb, VERBS)
    module = import_module(f"{__package__}.{VERBS[verb][0]}")
    actions: dict[str, tuple[str, str]] | None = getattr(module, "ACTIONS", None)
    if actions is not None:
        if len(arguments) < 2 or arguments[1] in ("-h", "--help"):
            text = _help_of_actions(verb, str(module.__doc__), actions)
            if len(arguments) > 1:
                print(text)
                return 0
            say(f"which action of 'aces {verb}'? {', '.join(actions)} (see 'aces {verb} --help')")
            return 2
        if arguments[1] not in actions:
            raise UnknownNameError(f"action of 'aces {verb}'", arguments[1], actions)
        module = import_module(f"{__package__}.{actions[arguments[1]][0]}")
        verb, arguments = f"{verb} {arguments[1]}", arguments[1:]
    parser = Parser(
        prog=f"aces {verb}",
        description=module.__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    module.add_arguments(parser)
    return int(module.run(parser.parse_intermixed_args(_plain(arguments[1:]))))


def _plain(arguments: list[str]) -> list[str]:
    """Without `--`, which the parser mistakes between options: what stands behind it are files, even `-x.log`."""
    if "--" not in arguments:
        return arguments
    end = arguments.index("--")
    return arguments[:end] + [f"./{a}" if a[:1] == "-" and a != "-" else a for a in arguments[end + 1 :]]


def _help_of_actions(verb: str, doc: str, actions: dict[str, tuple[str, str]]) -> str:
    width = max(map(len, actions))
    lines = "\n".join(f"  {action:<{width}}  {text}" for action, (_, text) in actions.items())
    return (
        f"{doc.strip()}\n\nusage: aces {verb} ACTION …\n\n{lines}\n\n'aces {verb} ACTION --help' says more."
    )


def _help() -> str:
    width = max(map(len, VERBS))
    verbs = "\n".join(f"  {verb:<{width}}  {text}" for verb, (_, text) in VERBS.items())
    return (
        f"aces {__version__}: devices on CAN and serial lines, from one declared protocol\n\n"
        f"usage: aces VERB …\n\n{verbs}\n\n"
        "'aces VERB --help' says more; 'aces --version' prints the version."
    )


if __name__ == "__main__":
    sys.exit(main())
