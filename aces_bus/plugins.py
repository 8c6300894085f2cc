"""Protocols, drivers, formats, verbs and more of all installed packages: found by entry point, imported on use.

1. Lazy: listing imports nothing. Loud: an unknown name lists those that exist.
2. Ours are registered as others' are, and keep their names. Using a name that two other packages claim
   raises `SpecError` with both places.
3. A plug-in that cannot be imported, is slow to import or claims a taken name costs only itself; a `PluginWarning` names its
   distribution once.
4. A program may add its own, for as long as it runs; they claim their names as packages do.
5. The metadata on disk is read here: `importlib.metadata` alone takes longer than `aces --help` may.

docs/plugins.md lists the groups with the contract of each; `aces_bus.testing` has the tests of each.
"""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from functools import cache, lru_cache
from importlib import import_module
from time import perf_counter
from typing import Any, Generic, NamedTuple, TypeVar

from .errors import AcesError, SpecError, UnknownNameError

T = TypeVar("T")

OURS = "aces-bus"
#: Seconds that importing another package's plug-in may take before it is named.
SLOW_S = 1.0


class PluginWarning(UserWarning):
    """A plug-in is left out, or slow. The message begins with its distribution."""


class InstalledPoint(NamedTuple):
    """An entry point as its distribution declares it; `value` is `module` or `module:attribute`.

    `distribution` is "" for what a program has added itself.
    """

    name: str
    value: str
    distribution: str = ""

    def load(self) -> Any:
        """Import and return the object, or the module. Raises whatever the import raises."""
        module, _, attributes = self.value.partition(":")
        found: Any = import_module(module)
        for attribute in attributes.split(".") if attributes else ():
            found = getattr(found, attribute)
        return found


def installed_points(group: str) -> Iterator[InstalledPoint]:
    """Yield the entry points of a group, those of aces-bus first, then by distribution; import nothing.

    Of a distribution that is installed twice, the one that is first on `sys.path` counts, as in `importlib.metadata`. They
    are read again when a folder of `sys.path` has changed.
    """
    folders: list[tuple[str, int]] = []
    for folder in sys.path:
        try:
            folders.append((folder, os.stat(folder or ".").st_mtime_ns))
        except OSError:
            continue
    for distribution, text in _entry_texts(tuple(folders)):
        _, is_there, section = text.partition(f"\n[{group}]\n")
        for line in section.partition("\n[")[0].splitlines() if is_there else ():
            name, sign, value = line.partition("=")
            if sign and not line.startswith(("#", ";")):
                yield InstalledPoint(name.strip(), value.strip(), distribution)


@lru_cache(maxsize=4)
def _entry_texts(folders: tuple[tuple[str, int], ...]) -> tuple[tuple[str, str], ...]:
    """Return the distributions that have entry points, and the text of these."""
    places: dict[str, str] = {}
    for folder, _ in folders:
        try:
            entries = sorted(os.scandir(folder or "."), key=lambda entry: entry.name)
        except OSError:
            continue
        for entry in entries:
            if entry.name.endswith((".dist-info", ".egg-info")):
                distribution = entry.name.rpartition(".")[0].partition("-")[0].lower().replace("_", "-")
                places.setdefault(distribution, entry.path)
    found: list[tuple[str, str]] = []
    for distribution in sorted(places, key=lambda name: (name != OURS, name)):
        try:
            with open(os.path.join(places[distribution], "entry_points.txt"), encoding="utf-8") as file:
                found.append((distribution, f"\n{file.read()}"))
        except (OSError, UnicodeDecodeError):
            continue
    return tuple(found)


@cache
def installed_items(group: str, kind: type[T]) -> tuple[T, ...]:
    """Return the objects of a kind that the entry points of a group name; one may name a tuple of them.

    One that cannot be imported or is of another kind, or has the name of one before it, is left out with a `PluginWarning`.
    """
    found: dict[str, T] = {}
    for point in installed_points(group):
        try:
            with slow_named(point, group):
                named = point.load()
            items: tuple[Any, ...] = (named,) if isinstance(named, kind) else tuple(named)
            if wrong := next((item for item in items if not isinstance(item, kind)), None):
                raise TypeError(f"{wrong!r} is not a {kind.__name__}")
        except Exception as error:  # whatever another package's import may raise
            warn(f"{point.distribution}: {group} {point.name!r} is left out: {error}")
            continue
        for item in items:
            if found.setdefault(item.name, item) is not item:
                warn(
                    f"{point.distribution}: {group} {item.name!r} is left out: another package has that name"
                )
    return tuple(found.values())


def warn(text: str) -> None:
    """Name a plug-in that is left out, or slow."""
    warnings.warn(text, PluginWarning, stacklevel=3)


@contextmanager
def slow_named(point: InstalledPoint, what: str) -> Generator[None]:
    """Name another package's plug-in whose import, inside the block, takes longer than `SLOW_S`."""
    begun = perf_counter()
    yield
    seconds = perf_counter() - begun
    if seconds > SLOW_S and point.distribution not in ("", OURS):
        warn(f"{point.distribution}: {what} {point.name!r} takes {seconds:.1f} s to import")


class Plugins(Generic[T]):
    """The installed objects of one `kind`, which have a `name`; `what` is what messages call them."""

    def __init__(self, group: str, what: str, kind: type[T]) -> None:
        self.group, self.what, self.kind = group, what, kind
        #: What was loaded is kept: searching all that is installed takes milliseconds.
        self._loaded: dict[str, T] = {}
        self._added: list[InstalledPoint] = []
        #: What was last found: listing names and loading them searches once.
        self._listed: dict[str, InstalledPoint] = {}
        #: Name that two packages claim → what is wrong.
        self._disputed: dict[str, str] = {}

    def points(self) -> dict[str, InstalledPoint]:
        """Return the entry points in order of names, not imported.

        A name of ours that another package claims, too, stays ours, with a `PluginWarning`.
        """
        found: dict[str, InstalledPoint] = {}
        self._disputed = {}
        for point in sorted(
            [*installed_points(self.group), *self._added],
            key=lambda point: (point.name, point.distribution != OURS, point.value),
        ):
            other = found.setdefault(point.name, point)
            if other.value == point.value:
                continue
            claim = f"two packages claim the {self.what} name {point.name!r}: {other.value} and {point.value}"
            if other.distribution == OURS:
                warn(f"{point.distribution or 'this program'}: {claim}; aces-bus keeps it")
            else:
                self._disputed[point.name] = claim
        self._listed = found
        return found

    def add(self, name: str, item: T, place: str) -> None:
        """Have this object under a name, in this program. `place` is what messages say of it.

        Raises `SpecError` when the name is another's.
        """
        known = self.points().get(name)
        if known is not None and known.value == place:
            return
        if known is not None and self.load(name) is item:
            return  # imported from where it is registered
        if known is not None:
            raise SpecError(f"two packages claim the {self.what} name {name!r}: {known.value} and {place}")
        self._added.append(InstalledPoint(name, place))
        self._loaded[name] = item

    def load(self, name: str) -> T:
        """Return the object named `name`. Raises `UnknownNameError` with the names that exist, `SpecError` for a wrong
        entry and for a name that two packages claim.
        """
        if name in self._loaded:
            return self._loaded[name]
        known = self._listed if name in self._listed else self.points()
        if name not in known:
            raise UnknownNameError(self.what, name, known)
        if name in self._disputed:
            raise SpecError(self._disputed[name])
        point = known[name]
        try:
            with slow_named(point, self.what):
                found: Any = point.load()
        except AcesError:
            raise
        except Exception as error:  # whatever another package's import may raise
            raise SpecError(f"{self.what} {name!r} ({point.value}) cannot be imported: {error}") from error
        if not isinstance(found, self.kind):
            raise SpecError(f"{point.value} is not a {self.kind.__name__} but {type(found).__name__}")
        own = getattr(found, "name", name)
        if own != name:
            raise SpecError(f"{point.value} calls itself {own!r} and is registered as {name!r}")
        self._loaded[name] = found
        return found
