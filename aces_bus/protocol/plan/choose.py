"""Which of several messages a packet is: by the bytes in which they differ.

1. Order is kept: what is tried first is what was declared (or ordered by `over`) first.
2. A choice is a byte to look at and, for each value, the messages left; or a list to try in turn.
"""

from __future__ import annotations

from collections.abc import Sequence

import msgspec

from .nodes import MessagePlan


class Choice(msgspec.Struct, frozen=True):
    """Look at byte `offset`: `cases` are the choices by its value, `names` what to try when there is no byte to look at."""

    names: tuple[str, ...]
    offset: int | None = None
    cases: tuple[tuple[int, Choice], ...] = ()


def choose(plans: Sequence[MessagePlan], tried: frozenset[int] = frozenset()) -> Choice:
    """Return the choice among messages that share identifier or framing."""
    names = tuple(plan.name for plan in plans)
    if len(plans) < 2:
        return Choice(names)
    best: tuple[int, int] | None = None
    known = [_fixed_bytes(plan) for plan in plans]
    for offset in sorted(set().union(*known) - tried):
        if not all(offset in fixed for fixed in known):
            continue
        distinct = len({value for fixed in known for value in fixed[offset]})
        if distinct > 1 and (best is None or distinct > best[0]):
            best = (distinct, offset)
    if best is None:
        return Choice(names)
    offset = best[1]
    values = sorted({value for fixed in known for value in fixed[offset]})
    cases = []
    for value in values:
        left = [plan for plan, fixed in zip(plans, known, strict=True) if value in fixed[offset]]
        cases.append((value, choose(left, tried | {offset})))
    return Choice(names, offset, tuple(cases))


def _fixed_bytes(plan: MessagePlan) -> dict[int, tuple[int, ...]]:
    """Return the bytes that a message allows only some values, by offset."""
    found: dict[int, tuple[int, ...]] = {c.offset: (c.value,) for c in plan.constants if c.mask == 0xFF}
    for choice in plan.one_of:
        if choice.number.size == 1:
            found[choice.number.offset] = tuple(choice.values)
    return found
