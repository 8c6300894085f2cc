"""Badges of the catalogue: what was run of an entry and passed, when, and on which state of its specs.

1. A badge is never written by hand: `aces spec badge NAME --save` runs what it stands for, and writes `badges.json`
   beside the entry's `manifest.toml`. The manifest says only which tests to run.
2. An entry is a `[[device]]` of a manifest; a protocol has the badges of all its entries.
3. A badge holds for the specs that were run: it is stale once `protocol_hash` gives another hash.
"""

from __future__ import annotations

import functools
import importlib.util
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec

from aces_bus import list_protocols, load_protocol
from aces_bus.device.drivers import list_drivers

from .proofs import protocol_hash

#: The badges, in their order: laws and examples; driver and twin; compared with a foreign program or recording; proved.
LEVELS = ("bronze", "silver", "gold", "platinum")
MANIFEST, SAVED = "manifest.toml", "badges.json"


class Earned(msgspec.Struct, frozen=True):
    """One badge: the day, and what was run."""

    date: str
    ran: str


class EntryBadges(msgspec.Struct, frozen=True):
    """The badges of an entry, by level, and the hashes of its protocols when they were earned."""

    protocols: dict[str, str]
    badges: dict[str, Earned]

    def is_stale(self) -> bool:
        """Return whether a protocol has changed since, or is not installed any more."""
        known = list_protocols()
        return any(
            name not in known or protocol_hash(load_protocol(name)) != hash
            for name, hash in self.protocols.items()
        )


class CatalogueEntry(msgspec.Struct, frozen=True):
    """A `[[device]]` of a manifest, or a spec without a manifest."""

    #: The folder of the manifest.
    folder: Path
    title: str
    protocols: list[str]
    drivers: list[str] = []
    sources: list[str] = []
    oracle: str = ""
    #: Tests (as pytest takes them) that compare with a foreign program or a recording.
    oracle_tests: list[str] = []
    #: Tests that run the conformance checks, where a driver is excused from some.
    driver_tests: list[str] = []

    def saved(self) -> EntryBadges | None:
        """Return the badges that were saved, stale or not."""
        return read_saved(self.folder / SAVED).get(self.title)


@functools.cache
def read_saved(path: Path) -> dict[str, EntryBadges]:
    """Return the badges of a folder, by the titles of its entries."""
    if not path.is_file():
        return {}
    return msgspec.json.decode(path.read_bytes(), type=dict[str, EntryBadges])


def read_manifest(path: Path) -> list[CatalogueEntry]:
    """Return the entries of a manifest."""
    manifest = tomllib.loads(path.read_text(encoding="utf-8"))
    fields = [field for field in CatalogueEntry.__struct_fields__ if field != "folder"]
    return [
        msgspec.convert(
            {"folder": path.parent, **{k: v for k, v in device.items() if k in fields}}, CatalogueEntry
        )
        for device in manifest.get("device", ())
    ]


def _folder_of(module: str) -> Path | None:
    """Return the folder of an installed module that has a manifest, without importing the module."""
    top, *rest = module.split(".")
    found: Any = importlib.util.find_spec(top)
    for root in [] if found is None else found.submodule_search_locations or []:
        for count in range(len(rest), -1, -1):
            folder = Path(root, *rest[:count])
            if (folder / MANIFEST).is_file():
                return folder
    return None


@functools.cache
def installed_entries() -> tuple[CatalogueEntry, ...]:
    """Return the entries of all installed protocols and drivers that have a manifest beside them."""
    points = [*list_protocols().values(), *list_drivers().values()]
    folders = {_folder_of(point.value.partition(":")[0]) for point in points}
    return tuple(
        entry
        for folder in sorted(folder for folder in folders if folder is not None)
        for entry in read_manifest(folder / MANIFEST)
    )


def entries_with(protocol: str) -> Iterator[CatalogueEntry]:
    """Yield the entries of an installed protocol."""
    return (entry for entry in installed_entries() if protocol in entry.protocols)


def badges_of(protocol: str) -> dict[str, str]:
    """Return the days of a protocol's badges, by level: the newest of its entries."""
    found: dict[str, str] = {}
    for entry in entries_with(protocol):
        saved = entry.saved()
        for level, earned in ({} if saved is None else saved.badges).items():
            found[level] = max(found.get(level, ""), earned.date)
    return {level: found[level] for level in LEVELS if level in found}


def dated(badges: dict[str, str]) -> str:
    """Return `bronze, silver 2026-11-28; gold 2026-11-30`: badges by their day."""
    by_day: dict[str, list[str]] = {}
    for level, day in badges.items():
        by_day.setdefault(day, []).append(level)
    return "; ".join(f"{', '.join(levels)} {day}" for day, levels in by_day.items())


__all__ = [
    "LEVELS",
    "MANIFEST",
    "SAVED",
    "CatalogueEntry",
    "Earned",
    "EntryBadges",
    "badges_of",
    "dated",
    "entries_with",
    "installed_entries",
    "read_manifest",
    "read_saved",
]
