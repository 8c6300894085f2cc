"""What is done with every input: the protocols, by name or as the contents of their files, and the options.

1. A recipe is data. A worker reads it from the dataset and decodes by it only when its hash is the one of the task; a
   Python file in it is executed there, with the worker's rights, as it is here.
2. The same protocols and options are the same recipe: then what was decoded stands. An installed protocol is known by its
   name and the version of aces-bus.
"""

from __future__ import annotations

import datetime
import hashlib
import os
import re
import tempfile
import warnings
from collections.abc import Iterable, Mapping, Sequence
from fnmatch import fnmatchcase
from typing import Any, Literal

import msgspec

from aces_bus import load_protocol
from aces_bus.errors import CallerError, UnknownNameError
from aces_bus.protocol import Variant
from aces_bus.protocol.exchange import database_suffixes
from aces_bus.protocol.files import python_file
from aces_bus.protocol.record_plans import plans_of
from aces_bus.recordings.base import Link
from aces_bus.recordings.filters import parse_filter
from aces_bus.version import __version__
from aces_tools.reading.pieces import Direction
from aces_tools.reading.selection import RecordingSelection
from aces_tools.reading.where import Where, WhereColumns
from aces_tools.reading.window import TimeWindow

_INCLUDE = re.compile(rb"<include>\s*([^<>/\\]+?)\s*</include>")

Unknown = Literal["hide", "show", "only"]


class FleetProtocol(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """A protocol as it travels: the name of an installed one, or the contents of a file.

    `FleetProtocol.of` makes one. `files` are by name; the first is the protocol's, others are included by it.
    """

    name: str
    files: dict[str, bytes] = {}
    dialect: str | None = None
    #: The name of a shipped configuration, or tables: {"channels": {0: 2}}.
    configuration: str | dict[str, dict[int, Any]] | None = None
    #: Only frames of this channel.
    channel: str | None = None

    @classmethod
    def of(
        cls,
        protocol: str,
        *,
        dialect: str | None = None,
        configuration: str | Mapping[str, Mapping[int, Any]] | None = None,
        channel: str | None = None,
    ) -> FleetProtocol:
        """Return a protocol; `protocol` is what `load_protocol` takes: "hubo", "car.dbc", "lamp.py",
        "lamp.py:NAME", "common.xml".

        Raises `CallerError` for a file that cannot be read.
        """
        path, attribute = python_file(protocol)
        if not path and protocol.lower().endswith(database_suffixes()):
            path = protocol
        tables = (
            {name: dict(table) for name, table in configuration.items()}
            if isinstance(configuration, Mapping)
            else configuration
        )
        files = _read_files(path) if path else {}
        if files:
            protocol = next(iter(files)) + (f":{attribute}" if attribute else "")
        return cls(name=protocol, files=files, dialect=dialect, configuration=tables, channel=channel)

    def variant(self, folder: str) -> Variant:
        """Return the protocol in its dialect and configuration; its files are written into a folder of their own in
        `folder`.

        Raises `CallerError` where they cannot be.
        """
        where = os.path.join(self._written(folder), self.name) if self.files else self.name
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # what of a database is left out was said where the run began
            protocol = load_protocol(where)
        found = protocol.variant(self.dialect, self.configuration or None)
        return found if self.channel is None else found.on(self.channel)

    def _written(self, folder: str) -> str:
        """Return the folder with the protocol's files."""
        for name in self.files:
            if os.path.basename(name) != name or name in ("", ".", ".."):
                raise CallerError(f"{name!r} is not a name of a file beside the protocol's")
        try:
            place = tempfile.mkdtemp(dir=folder)
            for name, data in self.files.items():
                with open(os.path.join(place, name), "wb") as file:
                    file.write(data)
        except (OSError, ValueError) as error:
            raise CallerError(f"{folder!r}: {error}") from error
        return place


def _read_files(path: str) -> dict[str, bytes]:
    """Return a protocol's file by its name, and the files that it includes."""
    folder, name = os.path.split(path)
    found: dict[str, bytes] = {}
    waiting = [name]
    while waiting:
        name = waiting.pop()
        if name in found:
            continue
        try:
            with open(os.path.join(folder, name), "rb") as file:
                found[name] = file.read()
        except (OSError, ValueError) as error:
            if found:
                continue  # reading it says which included file is missing
            raise CallerError(f"{path}: {getattr(error, 'strerror', None) or error}") from error
        if name.lower().endswith(".xml"):
            waiting += [text.decode("utf-8", "replace") for text in _INCLUDE.findall(found[name])]
    return found


class Recipe(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """Protocols and options of a run; `key` is its hash."""

    protocols: list[FleetProtocol]
    #: What the protocols speak on.
    links: list[Link]
    direction: Direction | None = None
    #: Only these messages, and of some only these columns; None: all.
    messages: list[str] | None = None
    columns: dict[str, list[str]] | None = None
    unknown: Unknown = "hide"
    names: bool = False
    float32: bool = False
    #: Only records that fulfil these conditions, frames that pass these filters, and what is of this time (ns; below
    #: `window.ABSOLUTE_S` from the first frame on).
    where: list[str] = []
    filter: list[str] = []
    start: int | None = None
    stop: int | None = None
    #: Of aces-bus, where an installed protocol is used.
    version: str = ""

    @classmethod
    def of(
        cls,
        protocols: Iterable[FleetProtocol | str],
        *,
        message: str | Iterable[str] = (),
        columns: Mapping[str, Sequence[str]] | None = None,
        where: str | Iterable[str] = (),
        filter: str | Iterable[str] = (),
        start: str | None = None,
        stop: str | None = None,
        **options: Any,
    ) -> Recipe:
        """Make a recipe from protocols and options; raise `CallerError` for unknown names before any work is
        sent out.
        """
        given = [
            FleetProtocol.of(protocol) if isinstance(protocol, str) else protocol for protocol in protocols
        ]
        if not given:
            raise CallerError("name a protocol: fleet.decode(inputs, 'truck.dbc', …)")
        with tempfile.TemporaryDirectory(prefix="aces-") as folder:
            variants = [protocol.variant(folder) for protocol in given]
        known = {name for variant in variants for name in variant.messages}
        wanted: set[str] = set()
        for name in _several(message):
            fits = {known_name for known_name in known if fnmatchcase(known_name.lower(), name.lower())}
            if not fits:
                raise UnknownNameError("message", name, known)
            wanted |= fits
        for name in columns or ():
            if name not in known:
                raise UnknownNameError("message", name, known)
        links: list[Link] = sorted({_link(variant) for variant in variants})
        conditions, filters = _several(where), _several(filter)
        if conditions:
            Where(conditions, plans_of(variants))
        if filters:
            if "can" not in links:
                raise CallerError("--filter is for CAN frames, and no protocol of the fleet is for CAN")
            parse_filter(*filters)
        first, last = _instants(TimeWindow.parse(start, stop))
        return cls(
            protocols=given,
            links=links,
            where=conditions,
            filter=filters,
            start=first,
            stop=last,
            messages=sorted(wanted) or None,
            columns=None if columns is None else {name: list(some) for name, some in sorted(columns.items())},
            version="" if all(protocol.files for protocol in given) else __version__,
            **options,
        )

    def encoded(self) -> bytes:
        """Return it as it lies in the dataset."""
        return msgspec.json.format(msgspec.json.encode(self))

    @staticmethod
    def key_of(data: bytes) -> str:
        """Return the hash of an encoded recipe."""
        return hashlib.blake2b(data, digest_size=10).hexdigest()

    @classmethod
    def decoded(cls, data: bytes, key: str) -> Recipe:
        """Return the recipe; raises `CallerError` where it is not the one of this hash."""
        if cls.key_of(data) != key:
            raise CallerError(f"the recipe {key} in the dataset was changed: it is not used")
        return msgspec.json.decode(data, type=cls)

    def selection(self, variants: Mapping[Link, Sequence[Variant]]) -> RecordingSelection:
        """Return what of a recording is decoded into the dataset."""
        plans = plans_of([variant for some in variants.values() for variant in some])
        return RecordingSelection(
            filter=parse_filter(*self.filter) if self.filter else None,
            messages=frozenset(self.messages or ()),
            columns=self.columns,
            where=WhereColumns(self.where, plans) if self.where else None,
            unknown=self.unknown,
        )

    @property
    def window(self) -> TimeWindow | None:
        """The time that is wanted, for one recording."""
        return None if self.start is None and self.stop is None else TimeWindow(self.start, self.stop)

    def variants(self, folder: str) -> dict[Link, list[Variant]]:
        """Return the protocols by their link."""
        found: dict[Link, list[Variant]] = {"can": [], "serial": []}
        for protocol in self.protocols:
            variant = protocol.variant(folder)
            found[_link(variant)].append(variant)
        return found


def _several(given: str | Iterable[str]) -> list[str]:
    return [given] if isinstance(given, str) else list(given)


def _instants(window: TimeWindow | None) -> tuple[int | None, int | None]:
    """Return the bounds of a window, the same on every machine."""
    start, stop = (None, None) if window is None else (window.start, window.stop)
    for name, bound in (("--from", start), ("--to", stop)):
        if isinstance(bound, datetime.time):
            raise CallerError(
                f"{name} {bound}: a time of day is one of this machine's zone, and those who decode may have another;"
                f" write the instant, 2026-11-22T{bound}, or seconds from the first frame"
            )
    assert not isinstance(start, datetime.time)
    assert not isinstance(stop, datetime.time)
    return start, stop


def _link(variant: Variant) -> Link:
    if variant.link == "datagram":
        raise CallerError(
            f"{variant.name} is a protocol on datagrams, and there is no capture format for them yet"
        )
    return "can" if variant.link == "can" else "serial"
