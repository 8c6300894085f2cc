"""Numbers as people write them, in conditions and values."""

from __future__ import annotations

from contextlib import suppress


def parse_number(text: str) -> int | float | None:
    """Return a number as people write it: 12, 0x1F, -2.5, 1e3; None for anything else."""
    with suppress(ValueError):
        return int(text, 0)
    try:
        return int(text) if text.lstrip("+-").isdecimal() else float(text)
    except ValueError:
        return None
