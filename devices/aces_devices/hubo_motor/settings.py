"""The driver's own keys in a robot file: what they mean, what they are when absent, and within what they must be.

1. A key that is not here, or a value that is none, is an error with the board's name and what may stand there.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from aces_bus.errors import CallerError, UnknownNameError

#: Key → what it is, what it is when absent (None: see its text), smallest and largest.
_KNOWN: Final[Mapping[str, tuple[str, float | None, float, float]]] = {
    "period_ms": (
        "what NameInfo (D08) and GetBoardInfo (D12) tell the board: ms between two references",
        None,
        1,
        255,
    ),
    "status_s": ("how often the status is asked for (s, default 0.1)", 0.1, 0, 3600),
    "current_s": ("how often currents and temperature are asked for (s, default 0.1)", 0.1, 0, 3600),
    "filter": ("length of hubo-ach's reference filter (40 there; default 1: none)", 1, 1, 100_000),
    "neck_counts": (
        "what a neck servo's turn is divided by in references: 4096 (default) or hubo-ach's 4095",
        4096,
        4095,
        4096,
    ),
    "home_timeout_s": ("how long a home search may take (s, default 30)", 30, 0.1, 3600),
    "home_tries": ("how often a D08 home search is tried (default 3 for arms, 2 for others)", None, 1, 100),
    "hold_start_s": ("no references for so long after the start (s, default 0.8)", 0.8, 0, 3600),
    "hold_home_s": (
        "no references of any board on the bus for so long after a home command (s, default 3)",
        3,
        0,
        3600,
    ),
}
_TRIGGER = "true: set-points go out when all channels of the board have a new one (acesHubo); default false"

#: For `Driver.settings`.
SETTINGS: Final[Mapping[str, str]] = {
    **{key: text for key, (text, *_) in _KNOWN.items()},
    "trigger": _TRIGGER,
}


class Settings:
    """The settings of one board. Raises `UnknownNameError` and `CallerError` for what is wrong in them."""

    def __init__(self, board: str, given: Mapping[str, Any]) -> None:
        self._board, self._given = board, given
        for key in given:
            if key not in SETTINGS:
                raise UnknownNameError(f"setting of {board}", key, SETTINGS)
        trigger = given.get("trigger", False)
        if not isinstance(trigger, bool):
            raise CallerError(f"{board}: the setting trigger is true or false, not {trigger!r}")
        self.trigger = trigger
        for key in _KNOWN:
            self.number(key)

    def number(self, key: str) -> float | None:
        """A number; what it is when absent."""
        _, usual, least, most = _KNOWN[key]
        value = self._given.get(key, usual)
        if value is None:
            return None
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not least <= value <= most:
            raise CallerError(
                f"{self._board}: the setting {key} is a number from {least:g} to {most:g}, not {value!r}"
            )
        return float(value)

    def known(self, key: str) -> float:
        """A number that is never None."""
        value = self.number(key)
        if value is None:
            raise CallerError(f"{self._board} needs the setting {key}")
        return value
