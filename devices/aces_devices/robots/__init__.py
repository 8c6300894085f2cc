"""The robots that ship, as TOML files beside this one, and other programs' descriptions read as robots.

A file says what its sources say; what they do not say is listed in its head, and is not in it. `aces_bus.load_robot` reads
these files by name: the package is an entry point of `aces_bus.robots`.
"""

from __future__ import annotations

from .importing import ImportedRobot, import_robot

__all__ = ["ImportedRobot", "import_robot"]
