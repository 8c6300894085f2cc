"""`aces VERB …`: finds the verb, runs it, turns what goes wrong into one line.

1. Verbs are entry points (`verbs`). A verb's module is imported when that verb runs and not before: `aces --help` imports
   argparse and nothing else.
2. Whatever goes wrong on purpose (`AcesError`) is one line on stderr and status 2, and so is what a Python file of the
   user's raises; a traceback is a bug of ours.
3. `main` returns a status and never exits, so that tests and programs can call it.
"""

from __future__ import annotations

import argparse
import errno
import gc
import os
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from io import TextIOWrapper
from typing import Any, NoReturn

import aces_bus
from aces_bus.errors import AcesError, CallerError, UnknownNameError
from aces_bus.plain_text import LOOKALIKES
from aces_bus.plugins import PluginWarning
from aces_bus.version import __version__

from .console import abandon_stdout, say, show_notes
from .verbs import actions_of, options_of, summary_of, top_verbs, verbs, wanted_options

#: What the system says of a write where there is no room: a full disk, a file that has its largest size, a quota.
NO_ROOM = (errno.ENOSPC, errno.EFBIG, errno.EDQUOT)

#: Other names of verbs.
ALIASES = {"scan": "discover"}


class Parser(argparse.ArgumentParser):
    """An ArgumentParser whose complaint is one line."""

    def error(self, message: str) -> NoReturn:
        if message.startswith("unrecognized arguments: "):
            known = [name for action in self._actions for name in action.option_strings]
            message = _unknown_options(message.partition(": ")[2].split(), known)
        if message.startswith("the following arguments are required: -p/--protocol"):
            message = "which protocol? -p NAME; 'aces decode FILE' says which fit a recording"
        if message.startswith("the following arguments are required: "):
            message = self._missing(message)
        self.exit(2, f"aces: {message.removeprefix('argument ')} (see '{self.prog} --help')\n")

    def _missing(self, message: str) -> str:
        """Return what is said of missing words: where one has choices, what it may be."""
        for action in self._actions:
            if not action.option_strings and action.choices is not None and action.required:
                return f"what is to be done? {self.prog} {'|'.join(map(str, action.choices))} …"
        return message

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        """Raise `UnknownNameError` for a value that is none of an argument's choices."""
        if action.choices is not None and value not in action.choices:
            kind = "/".join(action.option_strings) or f"argument of '{self.prog}'"
            raise UnknownNameError(kind, str(value), map(str, action.choices))

    @property
    def arguments(self) -> list[argparse.Action]:
        """All that it takes, in the order of its help."""
        return list(self._actions)


def _unknown_options(given: list[str], known: list[str]) -> str:
    """Return what is said of arguments that a verb does not take: of a mistyped option, what was meant."""
    from difflib import get_close_matches

    option = next((word.partition("=")[0] for word in given if word.startswith("-")), None)
    if option is None:
        return f"one too many: {' '.join(given)}"
    near = get_close_matches(option, known, n=1)
    return f"no option {option!r}" + (f"; did you mean {near[0]}?" if near else "")


def main(argv: Sequence[str] | None = None) -> int:
    """Run `aces` with these arguments (by default the program's) and return its exit status."""
    if argv is None:
        # python-can imports asammdf where it is installed, for a format that we read in a process of its own: a second
        # of every start. In this program it is not to be found.
        sys.modules.setdefault("asammdf", None)  # type: ignore[arg-type]  # how an import is forbidden
        for stream in (sys.stdout, sys.stderr):
            if isinstance(stream, TextIOWrapper):  # where there is no Unicode, something like it is written
                stream.reconfigure(errors=LOOKALIKES)
        warnings.showwarning = partial(_show_warning, warnings.showwarning)
        gc.disable()  # what is imported stays; `_run` switches it on again
    try:
        status = _run(list(sys.argv[1:] if argv is None else argv))
        if sys.stdout is not None:
            sys.stdout.flush()
        if argv is None:
            gc.freeze()  # the program ends: to look for garbage in all that is loaded takes a sixth of a short run
        return status
    except SystemExit as ended:  # argparse has said what is wrong, or has printed the help
        return ended.code if isinstance(ended.code, int) else 0 if ended.code is None else 2
    except AcesError as error:
        say(str(error))
        return 2
    except BrokenPipeError:
        abandon_stdout()
        return 0
    except OSError as error:
        if error.filename is not None or error.errno not in NO_ROOM:
            raise
        abandon_stdout()
        say(f"standard output: writing stopped: {error.strerror}")
        return 2
    except KeyboardInterrupt:
        return 130
    except Exception as error:
        text = _raised_by_user(error)
        if text is None:
            raise
        say(text)
        return 2


def _show_warning(usual: Callable[..., None], message: Warning | str, *rest: Any, **more: Any) -> None:
    """Say what is wrong with a plug-in in one line; show another warning as Python does."""
    if isinstance(message, PluginWarning):
        say(str(message))
    else:
        usual(message, *rest, **more)


def _raised_by_user(error: Exception) -> str | None:
    """Return what a file that the user has named raised, with its line; None for an exception of our own."""
    files = sys.modules.get("aces_bus.protocol.files")
    place = files.line_in_loaded(error) if files is not None else None
    if place is None:
        return None
    from aces_bus.tracebacks import exception_text

    return f"{place}: {exception_text(error)}"


def _build() -> str:
    """Return whether the wheel was compiled (`hatch_build.py`)."""
    made = os.listdir(os.path.join(os.path.dirname(aces_bus.__file__), "runtime"))
    return (
        "compiled"
        if any(name.startswith("virtual.") and name.endswith(".so") for name in made)
        else "pure Python"
    )


def _run(arguments: list[str]) -> int:
    if not arguments or arguments[0] in ("-h", "--help", "help"):
        if arguments[1:] and not arguments[1].startswith("-"):
            return _run([arguments[1], "--help"])
        print(f"aces {__version__}: devices on CAN and serial lines, from one declared protocol\n")
        print(f"usage: aces VERB …\n\n{_listed(top_verbs())}\n")
        print("'aces VERB --help' says more; 'aces --version' prints the version.")
        print("-q: no notes, no progress; ACES_NOTES=off in the environment: no notes at all.")
        return 0
    if arguments[0] in ("-V", "--version"):
        print(f"aces {__version__} ({_build()})")
        return 0
    verb = ALIASES.get(arguments[0], arguments[0])
    if verb.startswith("-"):
        raise UnknownNameError("option", verb, ["--help", "--version"])
    if verb not in top_verbs():
        raise UnknownNameError("verb", verb, [*top_verbs(), *_with_action(verb)])
    actions = actions_of(verb)
    if actions and not (verb in verbs() and (len(arguments) < 2 or arguments[1] not in actions)):
        if len(arguments) < 2:
            raise CallerError(
                f"which action of 'aces {verb}'? {', '.join(actions)} (see 'aces {verb} --help')"
            )
        if arguments[1] in ("-h", "--help"):
            print(f"aces {verb}: {summary_of(verb)}\n\nusage: aces {verb} ACTION …\n")
            print(f"{_listed(actions, verb)}\n")
            print(f"'aces {verb} ACTION --help' says more.")
            return 0
        if arguments[1] not in actions:
            raise UnknownNameError(f"action of 'aces {verb}'", arguments[1], actions)
        verb, arguments = f"{verb} {arguments[1]}", arguments[1:]
    given = parser_of(verb).parse_intermixed_args(_plain(arguments[1:]))
    show_notes(not given.quiet)
    if not gc.isenabled():  # to look for garbage in all that was imported takes a twentieth of a short run
        gc.freeze()
        gc.enable()
    for module in wanted_options(verb, given, "run"):
        return int(module.run(given))
    return int(verbs()[verb].load().run(given))


def _with_action(action: str) -> Iterator[str]:
    """Yield the verbs that have an action of this name, with it: `bus serve` for `serve`."""
    for verb in top_verbs():
        arguments = parser_of(verb).arguments if verb in verbs() else ()
        if action in actions_of(verb) or any(action in (argument.choices or ()) for argument in arguments):
            yield f"{verb} {action}"


def parser_of(verb: str, parser: Parser | None = None) -> Parser:
    """Return the parser of a verb, or of `spec check` and its like: a new one, or this one with all that the verb takes."""
    from .options import QUIET, add_arguments

    module = verbs()[verb].load()
    if parser is None:
        parser = Parser(prog=f"aces {verb}", allow_abbrev=False)
    parser.usage, parser.description = getattr(module, "USAGE", None), module.__doc__
    parser.epilog = getattr(module, "EPILOG", None)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    add_arguments(parser, module.ARGUMENTS)
    for options in options_of(verb):
        add_arguments(parser, options.ARGUMENTS)
    if not any("-q" in argument.option_strings for argument in parser.arguments):
        add_arguments(parser, [QUIET])
    parser.set_defaults(**getattr(module, "DEFAULTS", {}))
    return parser


def _plain(arguments: list[str]) -> list[str]:
    """Return arguments without `--`, which the parser does not understand between options: words behind it
    are files, even `-x.log`.
    """
    if "--" not in arguments:
        return arguments
    end = arguments.index("--")
    return arguments[:end] + [f"./{a}" if a[:1] == "-" and a != "-" else a for a in arguments[end + 1 :]]


def _listed(names: Iterable[str], verb: str = "") -> str:
    lines = [(name, summary_of(f"{verb} {name}".strip())) for name in names]
    width = max(len(name) for name, _ in lines)
    return "\n".join(f"  {name:<{width}}  {text}" for name, text in lines)
