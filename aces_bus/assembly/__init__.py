"""Floors put together: a robot's file becomes hosts and twins on virtual wires or real buses."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .buses import gate_of as gate_of
    from .buses import open_gates as open_gates
    from .buses import port_for as port_for
    from .virtual import VirtualRobot as VirtualRobot
    from .virtual import wire_of as wire_of

_PLACES = {
    "VirtualRobot": "virtual",
    "gate_of": "buses",
    "open_gates": "buses",
    "port_for": "buses",
    "wire_of": "virtual",
}

__all__ = ["VirtualRobot", "gate_of", "open_gates", "port_for", "wire_of"]


def __getattr__(name: str) -> Any:
    if name in _PLACES:
        from importlib import import_module

        return getattr(import_module(f".{_PLACES[name]}", __name__), name)
    raise AttributeError(f"module 'aces_bus.assembly' has no attribute {name!r}")
