"""The verbs of `aces`, and options that other packages add to verbs: found by entry point, imported when they run.

1. Listing verbs imports none of them: a summary is read from the source text of the verb's module.
2. A plug-in that is broken or claims a taken name costs only itself, and is named once on stderr.
3. Ours are registered as others' are: group `aces_bus.verbs`, `decode = "aces_tools.decode"`; an action of a verb is
   `spec.check`. Group `aces_bus.options`: `decode.cluster` adds what its module takes to the verb `decode`.
"""

from __future__ import annotations

import argparse
import os
import re
import sys
from collections.abc import Iterable
from contextlib import AbstractContextManager
from functools import cache
from importlib import import_module
from textwrap import shorten
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

from aces_bus.errors import AcesError, CallerError
from aces_bus.plugins import installed_points, slow_named

from .console import say

if TYPE_CHECKING:
    from .live_view import LiveView
    from .options import Arguments

VERBS_GROUP, OPTIONS_GROUP = "aces_bus.verbs", "aces_bus.options"

#: The order of `aces --help`; other verbs follow by name.
ORDER = (
    "decode",
    "plot",
    "diff",
    "convert",
    "sniff",
    "send",
    "play",
    "bridge",
    "bus",
    "robot",
    "devices",
    "device",
    "stop",
    "discover",
    "sim",
    "run",
    "protocols",
    "spec",
    "fuzz",
    "demo",
    "fleet",
    "completion",
)

_SUMMARY = re.compile(r'^SUMMARY = "(.*)"$', re.MULTILINE)


class VerbModule(Protocol):
    """What a verb's module has; where it needs them also USAGE, EPILOG and DEFAULTS. Its docstring is its help."""

    #: What `aces --help` says of it, on one line of the source text.
    SUMMARY: str
    ARGUMENTS: Arguments

    def run(self, arguments: argparse.Namespace) -> int:
        """Run the verb; return its exit status. `AcesError` becomes one line on stderr and status 2."""
        ...


class OptionsModule(Protocol):
    """What a module has that adds options to a verb. One of the two functions, `run` or `open_view`, is there."""

    ARGUMENTS: Arguments

    def is_wanted(self, arguments: argparse.Namespace) -> bool:
        """Return whether the call gives its options. Raises `CallerError` for options that do not go together."""
        ...

    def run(self, arguments: argparse.Namespace) -> int:
        """Run in the verb's place."""
        ...

    def open_view(self, arguments: argparse.Namespace, name: str) -> AbstractContextManager[LiveView]:
        """Show live what the verb sees and does."""
        ...


class Verb(NamedTuple):
    """A verb, or an action of one: `decode`, `spec check`."""

    name: str
    module: str
    distribution: str

    @property
    def summary(self) -> str:
        """One line for lists: the module's SUMMARY, or its docstring's first line; nothing is imported."""
        try:
            with open(_source_of(self.module), encoding="utf-8") as file:
                text = file.read()
        except (OSError, UnicodeDecodeError):
            return f"of {self.distribution}"
        if found := _SUMMARY.search(text):
            return found[1]
        return text.lstrip().lstrip('"').partition("\n")[0].strip().rstrip('".')

    def load(self) -> VerbModule:
        """Import the module. Raises `CallerError`, naming the distribution, where that fails."""
        found: VerbModule = _imported(
            self.module, f"the verb {self.name!r}", self.distribution, ("ARGUMENTS", "run")
        )
        return found


@cache
def verbs() -> dict[str, Verb]:
    """Return the installed verbs by name, actions as `spec check`, in the order of help."""
    found: dict[str, Verb] = {}
    for point in installed_points(VERBS_GROUP):
        verb = Verb(point.name.replace(".", " "), point.value, point.distribution)
        first = found.setdefault(verb.name, verb)
        if first.module != verb.module:
            say(
                f"{verb.distribution}: its verb {verb.name!r} is left out: {first.distribution} has that name"
                f" ({verb.module}, {first.module})"
            )
    places = {name: place for place, name in enumerate(ORDER)}
    return dict(
        sorted(found.items(), key=lambda item: (places.get(item[0].split()[0], len(places)), item[0].split()))
    )


def top_verbs() -> list[str]:
    """Return the names of verbs without their actions, in the order of help."""
    return list(dict.fromkeys(name.split()[0] for name in verbs()))


def actions_of(verb: str) -> dict[str, Verb]:
    """Return the actions of a verb by name; empty for a verb without any."""
    return {name.split()[1]: found for name, found in verbs().items() if name.split()[:-1] == [verb]}


def summary_of(verb: str) -> str:
    """Return the line that lists show of a verb; of one that has only actions, these."""
    found = verbs().get(verb)
    return found.summary if found is not None else shorten(", ".join(actions_of(verb)), 64, placeholder=" …")


@cache
def options_of(verb: str) -> tuple[OptionsModule, ...]:
    """Return the modules that add options to a verb; one that cannot be imported is named on stderr and left out."""
    found: list[OptionsModule] = []
    for point in installed_points(OPTIONS_GROUP):
        if point.name.rpartition(".")[0].replace(".", " ") != verb:
            continue
        try:
            with slow_named(point, OPTIONS_GROUP):
                found.append(
                    _imported(
                        point.value,
                        f"the options {point.name!r}",
                        point.distribution,
                        ("ARGUMENTS", "is_wanted"),
                    )
                )
        except CallerError as error:
            say(str(error))
    return tuple(found)


def wanted_options(verb: str, arguments: argparse.Namespace, function: str) -> Iterable[Any]:
    """Yield the options modules of a verb that the call asks for and that have a function of this name."""
    return (
        module for module in options_of(verb) if hasattr(module, function) and module.is_wanted(arguments)
    )


def _imported(module: str, what: str, distribution: str, needed: tuple[str, ...]) -> Any:
    try:
        found = import_module(module)
    except AcesError:
        raise
    except Exception as error:  # whatever another package's import may raise
        if distribution == "aces-bus":
            raise
        raise CallerError(f"{distribution}: {what} cannot be imported: {error}") from error
    for name in needed:
        if not hasattr(found, name):
            raise CallerError(f"{distribution}: {what} is not usable: {module} has no {name}")
    return found


def _source_of(module: str) -> str:
    """Return the path of a module's source text, found without importing a package; a path that does not exist otherwise."""
    parts = os.path.join(*module.split("."))
    for folder in sys.path:
        for path in (os.path.join(folder, f"{parts}.py"), os.path.join(folder, parts, "__init__.py")):
            if os.path.exists(path):
                return path
    return f"{parts}.py"
