"""Bodies by name: what installed packages bring, entry points of `aces_bus.bodies`, and files in formats that they read."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from typing import Any, NamedTuple

from ..plugins import Plugins, installed_items
from .body import Body

BODIES: Plugins[Body] = Plugins("aces_bus.bodies", "body", Body)


class BodyFormat(NamedTuple):
    """A format of files with bodies; an entry point of the group `aces_bus.body_formats` is one, or a tuple of them.

    `suffix` has its point, in lower case. `body` and `joints` are places of functions (`their_package.module:function`) of a
    file's path: `body` returns the `Body`; `joints` returns for each of its joints the keys that a robot's file would have
    (`type`, `lower`, `upper`, `max_speed`). Both raise `CallerError` with file and line for a file that is wrong.
    """

    name: str
    suffix: str
    body: str
    joints: str

    def load(self, path: str) -> Body:
        """Return the body of a file."""
        found: Body = _called(self.body, path)
        return found

    def robot_joints(self, path: str) -> Mapping[str, Mapping[str, object]]:
        """Return the joints of a file, as a robot's file would have them."""
        found: Mapping[str, Mapping[str, object]] = _called(self.joints, path)
        return found


def _called(place: str, path: str) -> Any:
    module, _, name = place.partition(":")
    return getattr(import_module(module), name)(path)


def body_format(path: str) -> BodyFormat | None:
    """Return the installed format that files of this name have; None for the name of an installed body."""
    formats = installed_items("aces_bus.body_formats", BodyFormat)
    return next((found for found in formats if path.lower().endswith(found.suffix)), None)


def load_body(name: str) -> Body:
    """Return the body of this name, such as "MiniHubo", or that of a file, such as "arm.urdf". Raises `UnknownNameError`
    with the names that exist, `SpecError` for a wrong entry, `CallerError` for a file that is wrong.
    """
    found = body_format(name)
    return BODIES.load(name) if found is None else found.load(name)
