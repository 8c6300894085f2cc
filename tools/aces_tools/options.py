"""The words of the command line: what an option is, and those that several verbs have, spelled and explained once.

1. A verb lists what it takes in ARGUMENTS, in the order of its help: entries of this table beside its own.
2. What a verb is about is positional (files, messages, a device); what it works on or with is an option: -p PROTOCOL,
   -r ROBOT, -o FILE. So an option can be left out where a variable says it, and its place is never guessed.
3. A number or duration that is none is refused while the call is read, with what can be written.
4. `main` may import this for any verb: nothing here is slow to import.
"""

from __future__ import annotations

import argparse
import math
import re
from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple

_DURATION = re.compile(r"([0-9]+(?:\.[0-9]*)?|\.[0-9]+)\s*(ns|us|µs|ms|s|min|h)?")
_UNITS_NS: Mapping[str | None, float] = {
    "ns": 1,
    "us": 1e3,
    "µs": 1e3,
    "ms": 1e6,
    "s": 1e9,
    "min": 60e9,
    "h": 3600e9,
    None: 1e9,
}


class Argument(NamedTuple):
    """An option or a positional argument: its names, and argparse's keywords."""

    names: tuple[str, ...]
    keywords: Mapping[str, Any]

    def but(self, **keywords: Any) -> Argument:
        """Return the same with other keywords: another help, another default."""
        return self._replace(keywords={**self.keywords, **keywords})


class Group(NamedTuple):
    """Arguments under a title of their own; of those that are exclusive one may be given."""

    title: str
    arguments: tuple[Argument, ...]
    is_exclusive: bool = False


#: A function adds what another library defines.
Arguments = Iterable[Argument | Group | Callable[[argparse.ArgumentParser], None]]


def argument(*names: str, **keywords: Any) -> Argument:
    """Return what argparse's `add_argument` takes, as an entry of a table."""
    return Argument(names, keywords)


def flag(*names: str, help: str, **keywords: Any) -> Argument:
    """Return an option without a value."""
    return Argument(names, {"action": "store_true", "help": help, **keywords})


def several(*names: str, metavar: str, help: str) -> Argument:
    """Return an option that may be given several times; a list."""
    return Argument(names, {"action": "append", "default": [], "metavar": metavar, "help": help})


def add_arguments(parser: argparse.ArgumentParser, arguments: Arguments) -> None:
    """Add the entries of a table to a parser."""
    for argument in arguments:
        if isinstance(argument, Argument):
            parser.add_argument(*argument.names, **argument.keywords)
        elif isinstance(argument, Group):
            adds: Any = (
                parser.add_mutually_exclusive_group()
                if argument.is_exclusive
                else parser.add_argument_group(argument.title)
            )
            add_arguments(adds, argument.arguments)
        else:
            argument(parser)


# ---------------------------------------------------------------------- what a value may be


def duration(text: str, least: int = 1) -> int:
    """Return a duration in ns: `10ms`, `0.5s`, `2min`, or plain seconds."""
    found = _DURATION.fullmatch(text.strip())
    ns = round(float(found[1]) * _UNITS_NS[found[2]]) if found else -1
    if not least <= ns < 1 << 62:
        raise argparse.ArgumentTypeError(f"{text!r} is not a duration; write 10ms, 0.5s, 2min, or seconds")
    return ns


def duration_or_none(text: str) -> int:
    """Return a duration in ns, or 0."""
    return duration(text, least=0)


def direction(text: str) -> Any:
    """Return which way bytes went, as scanners name it."""
    from aces_bus.errors import CallerError
    from aces_bus.protocol.declare.message import way_of

    given: Any = text
    try:
        return way_of(given)
    except CallerError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def at_least(least: int) -> Callable[[str], int]:
    """Return a whole number from `least` on; 0x10 is one, too."""

    def number(text: str) -> int:
        try:
            found = int(text, 0)
        except ValueError:
            found = least - 1
        if found < least:
            raise argparse.ArgumentTypeError(f"{text!r} is not a whole number from {least} on")
        return found

    return number


def positive(text: str) -> float:
    """Return a number above 0."""
    try:
        found = float(text)
    except ValueError:
        found = math.nan
    if not 0 < found <= 1e9:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number above 0")
    return found


# ---------------------------------------------------------------------- options of several verbs

PROTOCOL = several(
    "-p", "--protocol", metavar="PROTOCOL", help="protocols, as of 'aces decode'; the first that fits wins"
)
DIRECTION = argument(
    "--direction",
    type=direction,
    metavar="{to,from,both}",
    help="which way the bytes went: to or from the device; both pairs requests and replies",
)
FILTER = several(
    "--filter",
    metavar="FILTER",
    help="CAN: only what candump's filters pass, such as 060:7F0 or can0,150~7FF",
)
MAP = several("--map", metavar="OLD=NEW", help="CAN: another name for channel OLD")
MESSAGE = several(
    "-m",
    "--message",
    metavar="NAME",
    help="only this message, in any case, also Motor*; may be given several times",
)
WHERE = several("--where", metavar="CONDITION", help="only records such as field=value, as of 'aces decode'")
UNKNOWN = argument(
    "--unknown",
    choices=["show", "hide", "only"],
    help="what is not decoded (default: show; hide with --message or --where, and in tables)",
)
FROM = argument(
    "--from",
    dest="start",
    metavar="TIME",
    help="from this time on: seconds from the first frame or since 1970, 14:05:30, 2026-11-22T14:05:30",
)
TO = argument("--to", dest="stop", metavar="TIME", help="up to this time, without it")
#: How times are shown, and candump's letters for it (`-t z`, `a`, `d`, `A`).
TIME_MODES = {"z": "relative", "a": "absolute", "d": "delta", "A": "date"}
TIME = argument(
    "-t",
    "--time",
    choices=[*TIME_MODES.values()],
    type=lambda text: TIME_MODES.get(text, text),
    default="relative",
    help="from the first on, since 1970, since the line before, or local; also candump's z a d A (default: relative)",
)
COUNT = argument("-n", "--count", type=at_least(1), metavar="N", help="end after this many")
FOR = argument(
    "--for", dest="duration", type=duration, metavar="DURATION", help="for this time: 10s, 500ms, 2min"
)
EVERY = argument("--every", type=duration, metavar="DURATION", help="again and again: 10ms, 0.5s")
RATE = argument("--rate", type=positive, metavar="N", help="CAN: at most N frames a second")
LOOP = argument(
    "--loop", type=at_least(0), default=1, metavar="N", help="this many times; 0: until Ctrl-C (default: 1)"
)
TX = flag("--tx", help="really send; nothing else makes it")
ASK = flag("--ask", help="ask the devices; without (and without --tx) only listen to what others ask")
OUTPUT = argument("-o", "--output", metavar="FILE", help="write there instead of on standard output")
ROTATE = several(
    "--rotate",
    metavar="SIZE|DURATION",
    help="begin the next file (FILE-00002 …) after this size, such as 100MB, or this time, such as 10min",
)
JSON = flag("--json", help="JSON on standard output, for programs")
#: Every verb takes it: `main` adds it to those that say nothing more about it.
QUIET = flag("-q", "--quiet", help="no notes, no progress: only results, and what is wrong")
STRICT = flag("--strict", help="exit 1 when anything was lost or not understood")
JOBS = argument(
    "--jobs",
    type=at_least(0),
    default=1,
    metavar="N",
    help="number of processes (default: 1; 0: one a processor)",
)
SEED = argument("--seed", type=int, default=0, metavar="N", help="of noise and chance (default: %(default)s)")
COLOR = argument(
    "--color",
    action=argparse.BooleanOptionalAction,
    default=None,
    help="colour always, or never (default: on a terminal)",
)
