"""Frames of Hubo as text: `ID#DATA`, as candump writes them; a variant is `D12@hubo2plus`, as the command line takes it."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest

from aces_bus import Frame, Unknown, make_scanner
from aces_bus.protocol import FlagSet, Variant
from aces_bus.protocol.live.scanner import Scanner
from aces_protocols.hubo.spec import hubo

DEFAULT = "D12@hubo2plus"
HUBO2 = "D08@hubo2"
SHEET = "D08X@hubo2"
DRC = "D12@drc_hubo"


def frame(text: str, *, time: float | None = None, channel: str | None = None) -> Frame:
    identifier, _, data = text.partition("#")
    return Frame(int(identifier, 16), bytes.fromhex(data), timestamp=time, channel=channel)


def variant(label: str) -> Variant:
    dialect, _, configuration = label.partition("@")
    return hubo.variant(dialect, configuration)


def opened(label: str = DEFAULT) -> Scanner:
    return make_scanner([variant(label)], include_unknown=True)


def read(label: str, *frames: str) -> list[Any]:
    """What each frame is, read in one go."""
    scanner = opened(label)
    found = scanner.feed([frame(text) for text in frames])
    assert len(found) == len(frames)
    assert scanner.counts.balance == 0
    return found


def written(label: str, message: str, fields: dict[str, Any]) -> str:
    made = variant(label).encoder.encode(message, **fields)
    return f"{made.arbitration_id:03X}#{bytes(made.data).hex(' ').upper()}"


def names(found: Iterable[Any]) -> list[str]:
    return [f.reason if isinstance(f, Unknown) else type(f).__name__ for f in found]


def same(one: Any, other: Any) -> bool:
    """Equal, floats up to rounding."""
    if isinstance(one, dict) and isinstance(other, dict):
        return one.keys() == other.keys() and all(same(value, other[name]) for name, value in one.items())
    if isinstance(one, list) and isinstance(other, list):
        return len(one) == len(other) and all(map(same, one, other))
    if isinstance(one, FlagSet) and isinstance(other, list):
        return list(one) == other and not one.unknown
    return bool(one == pytest.approx(other)) if isinstance(other, float) else bool(one == other)
