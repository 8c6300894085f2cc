"""What is known of a quantity: a value, or that it is unknown."""

from __future__ import annotations

from typing import Any, Final

import msgspec


class UnknownType:
    """The type of `UNKNOWN`. It is false, and equal to itself only."""

    def __bool__(self) -> bool:
        return False

    def __repr__(self) -> str:
        return "UNKNOWN"

    def __reduce__(self) -> str:
        return "UNKNOWN"


#: The value of a quantity before one was received, and when the last one is stale.
UNKNOWN: Final = UnknownType()


class Reading(msgspec.Struct, frozen=True):
    """What is known of a quantity: its last value, the instant (ns) it was measured at, how old that is now."""

    value: Any
    instant: int | None
    age_ns: int | None
    is_stale: bool
