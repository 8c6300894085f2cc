"""Floors put together: a robot's file becomes hosts, twins, states and controllers, in virtual time or on real buses."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .buses import gate_of as gate_of
    from .buses import open_gates as open_gates
    from .buses import port_for as port_for
    from .parts import Ended as Ended
    from .replay import Replay as Replay
    from .runner import Runner as Runner
    from .states import States as States
    from .virtual import VirtualRobot as VirtualRobot
    from .virtual import wire_of as wire_of
    from .worlds import run_real as run_real
    from .worlds import run_replay as run_replay
    from .worlds import run_virtual as run_virtual

_PLACES = {
    "Ended": "parts",
    "Replay": "replay",
    "Runner": "runner",
    "States": "states",
    "VirtualRobot": "virtual",
    "gate_of": "buses",
    "open_gates": "buses",
    "port_for": "buses",
    "run_real": "worlds",
    "run_replay": "worlds",
    "run_virtual": "worlds",
    "wire_of": "virtual",
}

__all__ = [
    "Ended",
    "Replay",
    "Runner",
    "States",
    "VirtualRobot",
    "gate_of",
    "open_gates",
    "port_for",
    "run_real",
    "run_replay",
    "run_virtual",
    "wire_of",
]


def __getattr__(name: str) -> Any:
    if name in _PLACES:
        from importlib import import_module

        return getattr(import_module(f".{_PLACES[name]}", __name__), name)
    raise AttributeError(f"module 'aces_bus.assembly' has no attribute {name!r}")
