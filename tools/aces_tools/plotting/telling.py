"""What is drawn where no signals are named: of many signals those that say most.

1. Only what changes; quantities with a unit before bare numbers, for these may be counters and codes.
2. One subplot a unit, a few lines in each, of as many messages as there are.
"""

from __future__ import annotations

from collections.abc import Sequence

from .picture import LineNames
from .series import Series

#: So many lines are drawn without a choice, and of more lines so many subplots of so many lines.
ALL, PANELS, LINES = 24, 4, 6


def telling_signals(series: Sequence[Series]) -> list[str]:
    """Return SIGNALs as they are typed, with `-` between subplots; none where there are few enough to draw
    all of them.
    """
    drawn = [curve for curve in series if curve.count and not curve.others]
    if len(drawn) <= ALL:
        return []
    changing = [curve for curve in drawn if _is_quantity(curve) and curve.low != curve.high] or drawn
    with_unit = [curve for curve in changing if curve.signal.kind.unit]
    by_unit: dict[str, list[Series]] = {}
    for curve in with_unit or changing:
        by_unit.setdefault(curve.signal.kind.unit, []).append(curve)
    panels = sorted(by_unit.values(), key=lambda some: -sum(curve.count for curve in some))[:PANELS]
    names = LineNames(drawn, always=True)
    texts: list[str] = []
    for panel in panels:
        texts += ["-"] * bool(texts) + [names.full(curve) for curve in _spread(panel)]
    return texts


def _is_quantity(curve: Series) -> bool:
    return curve.signal.bit is None and curve.signal.kind.names is None


def _spread(panel: Sequence[Series]) -> list[Series]:
    """Return the lines of a subplot: the first of each message, then the second of each, those with most samples first."""
    rounds: dict[str, int] = {}
    ranked: list[tuple[int, int, Series]] = []
    for curve in sorted(panel, key=lambda curve: -curve.count):
        turn = rounds[curve.signal.name] = rounds.get(curve.signal.name, 0) + 1
        ranked.append((turn, -curve.count, curve))
    ranked.sort(key=lambda entry: entry[:2])
    return [curve for _, _, curve in ranked[:LINES]]
