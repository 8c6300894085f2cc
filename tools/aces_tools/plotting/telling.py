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
    """SIGNALs as they are typed, with `-` between subplots; none where there are few enough to draw all of them."""
    drawn = [one for one in series if one.count and not one.others]
    if len(drawn) <= ALL:
        return []
    changing = [one for one in drawn if _is_quantity(one) and one.low != one.high] or drawn
    with_unit = [one for one in changing if one.signal.kind.unit]
    by_unit: dict[str, list[Series]] = {}
    for one in with_unit or changing:
        by_unit.setdefault(one.signal.kind.unit, []).append(one)
    panels = sorted(by_unit.values(), key=lambda some: -sum(one.count for one in some))[:PANELS]
    names = LineNames(drawn, always=True)
    texts: list[str] = []
    for panel in panels:
        texts += ["-"] * bool(texts) + [names.full(one) for one in _spread(panel)]
    return texts


def _is_quantity(one: Series) -> bool:
    return one.signal.bit is None and one.signal.kind.names is None


def _spread(panel: Sequence[Series]) -> list[Series]:
    """Return the lines of a subplot: the first of each message, then the second of each, those with most samples first."""
    rounds: dict[str, int] = {}
    ranked: list[tuple[int, int, Series]] = []
    for one in sorted(panel, key=lambda one: -one.count):
        turn = rounds[one.signal.name] = rounds.get(one.signal.name, 0) + 1
        ranked.append((turn, -one.count, one))
    ranked.sort(key=lambda entry: entry[:2])
    return [one for _, _, one in ranked[:LINES]]
