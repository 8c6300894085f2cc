"""What differs between the messages of two profiles: as of identifiers, and signal by signal."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, Literal

import numpy as np

from .changes import (
    LISTED,
    WEIGHTS,
    ChangeKind,
    TrafficChange,
    by_itself,
    novelty,
    occurrence_text,
    rarity,
    timing_change,
)
from .exposure import Exposure
from .signals import DeviceMessage, MessageProfile, MessageTraffic, SignalValues

#: Values up to which those of a number are listed, and further ones are a range.
FEW = 16
#: What counts of a number that left its range where it only ever went one way: a clock, an odometer.
ONE_WAY = 0.25


def message_changes(a: MessageProfile, b: MessageProfile, exposure: Exposure) -> list[TrafficChange]:
    """Return what differs between the messages of two profiles, in no order."""
    by_name = any(len({subject.channel for subject in side.subjects}) > 1 for side in (a, b))
    sides = [
        {
            subject if by_name else subject._replace(channel=None): traffic
            for subject, traffic in side.subjects.items()
        }
        for side in (a, b)
    ]
    found: list[TrafficChange] = []
    for key in sorted(sides[0].keys() | sides[1].keys(), key=_natural):
        name = f"{key.channel} {key}" if by_name and key.channel is not None else str(key)
        in_a, in_b = sides[0].get(key), sides[1].get(key)
        if in_a is not None and in_b is not None:
            found += _changes_of(name, key, in_a, in_b, exposure)
        elif (there := in_b or in_a) is not None:
            kind: Literal["appears", "vanishes"] = "appears" if in_a is None else "vanishes"
            text = occurrence_text(there.frames, "message", there.gaps)
            both = ("", text) if kind == "appears" else (text, "")
            score = exposure.lone_score(kind, there.frames)
            found.append(TrafficChange(score, kind, name, *both, device_message=key))
    return found


def _natural(key: DeviceMessage) -> Any:
    """Return a sort key by which board 10 comes after board 9."""
    device = [(int(value) if value.isdecimal() else -1, value) for _, value in key.device]
    return key.protocol, key.message, device, str(key.channel)


def _changes_of(
    name: str, key: DeviceMessage, a: MessageTraffic, b: MessageTraffic, exposure: Exposure
) -> Iterator[TrafficChange]:
    timing = timing_change(a, b, exposure, "message")
    if timing is not None:
        kind, score, before, after = timing
        yield TrafficChange(WEIGHTS.get(kind, 1.0) * score, kind, name, before, after, device_message=key)
    for path, values in a.signals.items():
        found = _signal(values, b.signals[path])
        if found is not None:
            kind, score, more = found
            yield TrafficChange(
                WEIGHTS.get(kind, 1.0) * score,
                kind,
                name,
                _text(values),
                _text(b.signals[path]),
                device_message=key,
                signal=path,
                **more,
            )


def _signal(a: SignalValues, b: SignalValues) -> tuple[ChangeKind, float, dict[str, Any]] | None:
    """Return kind, score and evidence of a signal's change; None where there is none."""
    if not a.count or not b.count:
        if not a.count and not b.count:
            return None
        n = max(a.count, b.count)
        return ("vanishes" if a.count else "appears"), n / (n + 1), {}
    is_fixed = len(a.values) == 1 and not a.is_more
    fresh = [found for value, found in b.values.items() if value not in a.values] if not a.is_more else []
    count = sum(found.count for found in fresh)
    if b.is_more:  # those that were not kept are none of A's, where A has fewer
        count = b.count - sum(found.count for value, found in b.values.items() if value in a.values)
    windows_b = _union(b.values.values())
    windows = _union(fresh)
    more = {
        "count": count,
        "frames": b.count,
        "seen_in": windows.bit_count(),
        "windows": windows_b.bit_count(),
    }
    if is_fixed:
        if not count:
            return None
        kind: ChangeKind = "differs" if len(b.values) == 1 and not b.is_more else "changes"
        share = more["seen_in"] / more["windows"] if more["windows"] else 1.0
        return kind, a.count / (a.count + 1) * share * (1 - 0.3 / count), more
    mostly = None if count else _mostly(a, b, windows_b.bit_count())
    if mostly is not None:
        return mostly
    if len(b.values) == 1 and not b.is_more and next(iter(b.values)) in a.values:
        return (
            "constant",
            -math.expm1(-a.changes * b.count / a.count) * b.count / (b.count + 1),
            {"frames": b.count},
        )
    is_listed = not a.is_more and (a.low is None or a.kind.names is not None or len(a.values) <= FEW)
    if is_listed:
        if not count:
            return None
        visits = np.array([found.visits for found in a.values.values()])
        score = novelty(count / b.count, by_itself(visits))
        if a.is_monotone and a.kind.names is None:
            score *= ONE_WAY
        return "values", score, more
    if a.low is None or a.high is None or b.low is None or b.high is None:
        return None
    beyond = max(b.high - a.high, a.low - b.low)
    if not beyond > 0:
        return None
    overshoot = beyond / (a.high - a.low) if a.high > a.low else 1.0
    score = overshoot / (overshoot + 0.25)
    return "range", score * (ONE_WAY if a.is_monotone else 1.0), {"frames": b.count}


def _mostly(
    a: SignalValues, b: SignalValues, windows: int
) -> tuple[ChangeKind, float, dict[str, Any]] | None:
    """Return a value that is most of B and hardly any of A; None where there is none."""
    if a.is_more or b.is_more or b.count < 2:
        return None
    value, usual = max(b.values.items(), key=lambda item: item[1].count)
    rare = a.values.get(value)
    score = 0.0 if rare is None else rarity(rare.count, a.count, usual.count, b.count, windows)
    if not score:
        return None
    score *= 1 - by_itself(np.array([found.visits for found in a.values.values()]))
    if a.is_monotone and a.kind.names is None:
        score *= ONE_WAY
    seen_in = usual.windows.bit_count()
    more = {"count": usual.count, "frames": b.count, "seen_in": seen_in, "windows": windows}
    return "mostly", score * seen_in / max(1, windows), more


def _union(found: Any) -> int:
    mask = 0
    for message in found:
        mask |= message.windows
    return mask


def _text(signal: SignalValues) -> str:
    """Return its values, or their range, in its unit."""
    unit = f" {signal.kind.unit}" if signal.kind.unit else ""
    names = signal.kind.names is not None or signal.low is None
    if not signal.is_more and (len(signal.values) <= LISTED or (names and len(signal.values) <= FEW)):
        values = sorted(signal.values.items(), key=lambda item: -item[1].count)
        return ", ".join(signal.text(value) for value, _ in values) + (unit if values else "")
    if signal.low is None or signal.high is None:
        return f"{'more than ' if signal.is_more else ''}{len(signal.values)} values"
    return f"{signal.text(signal.low)}…{signal.text(signal.high)}{unit}"
