"""Bodies by name: what installed packages bring, entry points of `aces_bus.bodies`; a robot's file names its own."""

from __future__ import annotations

from ..plugins import Plugins
from .body import Body

BODIES: Plugins[Body] = Plugins("aces_bus.bodies", "body", Body)


def load_body(name: str) -> Body:
    """Return the body of this name, such as "MiniHubo". Raises `UnknownNameError` with the names that exist,
    `SpecError` for a wrong entry.
    """
    return BODIES.load(name)
