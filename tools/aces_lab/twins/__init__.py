"""Simulated devices for anybody's tests: a fixture for pytest, faults on purpose, recordings that answer.

Owner: the maintainers of the twins. Level: new. `aces_bus.twin` is the way in; nothing else of the core or the catalogue
needs this room.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .bench import TwinBench as TwinBench
    from .bench import open_bench as open_bench

__all__ = ["TwinBench", "open_bench"]


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(".bench", __name__), name)
