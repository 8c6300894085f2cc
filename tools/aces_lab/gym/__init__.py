"""Robots as environments of Gymnasium (extra: gymnasium)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from aces_bus._lazy import lazy_names
from aces_bus.errors import CallerError

if TYPE_CHECKING:
    from .env import RobotEnv, aces_env
    from .sticks import Sticks

__all__ = ["RobotEnv", "Sticks", "aces_env"]

_get, __dir__ = lazy_names(__name__, {".env": "RobotEnv aces_env", ".sticks": "Sticks"})


def __getattr__(name: str) -> Any:
    try:
        return _get(name)
    except ModuleNotFoundError as error:
        if error.name != "gymnasium":
            raise
        raise CallerError(
            f"environments need Gymnasium: pip install 'aces-bus[gymnasium]' ({error})"
        ) from error
