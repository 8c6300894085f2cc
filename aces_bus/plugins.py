"""Protocols, drivers, verbs and more of all installed packages: found by entry point, imported on use.

1. Lazy: listing imports nothing. Loud: an unknown name lists those that exist.
2. Singular: two packages that claim one name raise, with both places.
3. Ours are registered as others' are.
4. A program may add its own, for as long as it runs; they claim their names as packages do.
5. `installed_points` reads the metadata on disk itself: `importlib.metadata` alone takes longer than `aces --help` may.
"""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Iterator
from functools import cache, lru_cache
from importlib import import_module
from typing import TYPE_CHECKING, Any, Generic, NamedTuple, TypeVar

from .errors import AcesError, SpecError, UnknownNameError

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

T = TypeVar("T")


class InstalledPoint(NamedTuple):
    """An entry point as its distribution declares it; `value` is `module` or `module:attribute`."""

    name: str
    value: str
    distribution: str


def installed_points(group: str) -> Iterator[InstalledPoint]:
    """Yield the entry points of a group, those of aces-bus first, then by distribution; import nothing.

    Of a distribution that is installed twice, the one that is first on `sys.path` counts, as in `importlib.metadata`.
    """
    found: dict[str, str] = {}
    for folder in sys.path:
        try:
            entries = sorted(os.scandir(folder or "."), key=lambda entry: entry.name)
        except OSError:
            continue
        for entry in entries:
            if entry.name.endswith((".dist-info", ".egg-info")):
                distribution = entry.name.rpartition(".")[0].partition("-")[0].lower().replace("_", "-")
                found.setdefault(distribution, entry.path)
    for distribution in sorted(found, key=lambda name: (name != "aces-bus", name)):
        try:
            with open(os.path.join(found[distribution], "entry_points.txt"), encoding="utf-8") as file:
                text = file.read()
        except (OSError, UnicodeDecodeError):
            continue
        _, is_there, section = f"\n{text}".partition(f"\n[{group}]\n")
        for line in section.partition("\n[")[0].splitlines() if is_there else ():
            name, sign, value = line.partition("=")
            if sign and not line.startswith(("#", ";")):
                yield InstalledPoint(name.strip(), value.strip(), distribution)


def entry_points_of(group: str) -> tuple[EntryPoint, ...]:
    """Return the entry points of a group. They are read again when a folder of `sys.path` has changed."""
    folders: list[tuple[str, int]] = []
    for folder in sys.path:
        try:
            folders.append((folder, os.stat(folder or ".").st_mtime_ns))
        except OSError:
            continue
    return _read_points(group, tuple(folders))


@lru_cache(maxsize=32)
def _read_points(group: str, folders: tuple[tuple[str, int], ...]) -> tuple[EntryPoint, ...]:
    from importlib.metadata import entry_points  # a tenth of a second

    return tuple(entry_points(group=group))


@cache
def installed_items(group: str, kind: type[T]) -> tuple[T, ...]:
    """Return the objects of a kind that the entry points of a group name; one may name a tuple of them.

    One that cannot be imported or is of another kind, or has the name of one before it, is left out with a warning.
    """
    found: dict[str, T] = {}
    for point in installed_points(group):
        module, _, attribute = point.value.partition(":")
        try:
            named = getattr(import_module(module), attribute)
            items: tuple[Any, ...] = (named,) if isinstance(named, kind) else tuple(named)
            if wrong := next((item for item in items if not isinstance(item, kind)), None):
                raise TypeError(f"{wrong!r} is not a {kind.__name__}")
        except Exception as error:  # whatever another package's import may raise
            warnings.warn(f"{point.distribution}: {group} {point.name!r} is left out: {error}", stacklevel=2)
            continue
        for item in items:
            if found.setdefault(item.name, item) is not item:
                warnings.warn(
                    f"{point.distribution}: {group} {item.name!r} is left out: another package has that name",
                    stacklevel=2,
                )
    return tuple(found.values())


class Plugins(Generic[T]):
    """The installed objects of one `kind`, which have a `name`; `what` is what messages call them."""

    def __init__(self, group: str, what: str, kind: type[T]) -> None:
        self.group, self.what, self.kind = group, what, kind
        #: What was loaded is kept: searching all that is installed takes milliseconds.
        self._loaded: dict[str, T] = {}
        self._added: list[EntryPoint] = []
        #: What was last found: listing names and loading them searches once.
        self._listed: dict[str, EntryPoint] = {}

    def points(self) -> dict[str, EntryPoint]:
        """Return the entry points in order of names, not imported. Raises `SpecError` when two packages claim a name."""
        found: dict[str, EntryPoint] = {}
        for point in sorted(
            [*entry_points_of(self.group), *self._added], key=lambda one: (one.name, one.value)
        ):
            other = found.setdefault(point.name, point)
            if other.value != point.value:
                raise SpecError(
                    f"two packages claim the {self.what} name {point.name!r}: {other.value} and {point.value}"
                )
        self._listed = found
        return found

    def add(self, name: str, item: T, place: str) -> None:
        """Have this object under a name, in this program. `place` is what messages say of it.

        Raises `SpecError` when the name is another's.
        """
        from importlib.metadata import EntryPoint

        known = self.points().get(name)
        if known is not None and known.value == place:
            return
        if known is not None and self.load(name) is item:
            return  # imported from where it is registered
        point = EntryPoint(name, place, self.group)
        if known is not None:
            raise SpecError(f"two packages claim the {self.what} name {name!r}: {known.value} and {place}")
        self._added.append(point)
        self._loaded[name] = item

    def load(self, name: str) -> T:
        """Return the object named `name`. Raises `UnknownNameError` with the names that exist, `SpecError` for a wrong
        entry.
        """
        if name in self._loaded:
            return self._loaded[name]
        known = self._listed if name in self._listed else self.points()
        if name not in known:
            raise UnknownNameError(self.what, name, known)
        place = known[name].value
        try:
            found: Any = known[name].load()
        except AcesError:
            raise
        except Exception as error:  # whatever another package's import may raise
            raise SpecError(f"{self.what} {name!r} ({place}) cannot be imported: {error}") from error
        if not isinstance(found, self.kind):
            raise SpecError(f"{place} is not a {self.kind.__name__} but {type(found).__name__}")
        own = getattr(found, "name", name)
        if own != name:
            raise SpecError(f"{place} calls itself {own!r} and is registered as {name!r}")
        self._loaded[name] = found
        return found
