"""What is known of devices, as people and programs read it; and what people write, as devices take it."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from aces_bus.errors import CallerError
from aces_bus.protocol.record import FieldValue

from .console import Output, terminal_width
from .output.columns import column_output
from .output.shape import json_value
from .output.text import no_paint
from .values import parse_value

if TYPE_CHECKING:
    from aces_bus.device import Device
    from aces_bus.device.signals import Signal

#: Words for yes and no.
WORDS: Mapping[str, bool] = {"true": True, "false": False, "yes": True, "no": False, "on": True, "off": False}
_DEGREES = re.compile(r"([-+]?[0-9.]+(?:e[-+]?[0-9]+)?)\s*(?:deg|°)(/s)?")


# ---------------------------------------------------------------------- values


def shown_value(value: FieldValue) -> str:
    """Return a plain value for people, in one line."""
    match value:
        case None:
            return "unknown"
        case bool():
            return "yes" if value else "no"
        case float():
            return f"{value + 0.0:.6g}"
        case list():
            return ", ".join(shown_value(item) for item in value) or "none"
        case dict():
            return ", ".join(f"{key} {shown_value(item)}" for key, item in value.items())
        case _:
            return str(value)


def reading(signal: Signal) -> str:
    """Return a signal's value with its unit; what is unknown or stale says so."""
    if signal.instant is None:
        return "unknown"
    whole = f"{shown_value(json_value(signal.last))} {signal.unit}".rstrip()
    age = signal.age_ns
    return f"{whole} (stale, {age / 1e9:.1f} s old)" if signal.is_stale and age is not None else whole


def result_lines(value: FieldValue, indent: str = "") -> list[str]:
    """Return what an action has found, a line a name."""
    if not isinstance(value, dict):
        return [] if value is None else [f"{indent}{shown_value(value)}"]
    lines: list[str] = []
    width = max((len(str(key)) for key, item in value.items() if not isinstance(item, dict)), default=0)
    for key, item in value.items():
        if isinstance(item, dict):
            lines += [f"{indent}{key}", *result_lines(item, indent + "  ")]
        else:
            lines.append(f"{indent}{key:<{width}}  {shown_value(item)}")
    return lines


# ---------------------------------------------------------------------- tables


def aligned_rows(rows: Sequence[tuple[str, ...]], indent: str = "  ") -> list[str]:
    """Align columns under each other; on a terminal the last one is wrapped to its width."""
    if not rows:
        return []
    width = terminal_width() - len(indent) if Output(None).is_terminal else None
    return [indent + line for line in column_output([""] * len(rows[0]), rows, width, no_paint)]


# ---------------------------------------------------------------------- what people write


def parse_pairs(texts: Sequence[str]) -> dict[str, FieldValue]:
    """Parse `kp=200 confirm=true mode=torque` as values: numbers, true and false, [lists], hex:0a; everything
    else is text.

    Raises `CallerError` for what is not a NAME=VALUE, or is given twice.
    """
    found: dict[str, FieldValue] = {}
    for text in texts:
        name, equals, value = text.partition("=")
        if not equals or not name or not value:
            raise CallerError(f"{text}: write NAME=VALUE")
        if name in found:
            raise CallerError(f"{name} is given twice")
        found[name] = value == "true" if value in ("true", "false") else parse_value(value, None, name)
    return found


def value_for(signal: Signal, value: Any) -> Any:
    """Return what is to be set, as the signal takes it: a finite number in its unit, `30deg` where that is rad; yes and no.

    Raises `CallerError`.
    """
    if not signal.unit:
        if isinstance(signal.last, bool) and (value in (0, 1) or value in WORDS):
            return WORDS[value] if isinstance(value, str) else bool(value)
        return value
    degrees = _DEGREES.fullmatch(value) if isinstance(value, str) else None
    if degrees is not None and signal.unit == f"rad{degrees[2] or ''}":
        value = math.radians(float(degrees[1]))
    try:
        number = float("nan" if isinstance(value, bool | str) else value)
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    if not math.isfinite(number):
        also = ", or degrees: 30deg" if signal.unit == "rad" else ""
        raise CallerError(f"{signal.name}: {value!r} is not a number of {signal.unit}{also}")
    return value


def host_loss_text(device: Device) -> str:
    """Return what a device does without this program, and that it has no watchdog where it has none."""
    loss = device.host_loss
    none = "it has no watchdog of its own; " if loss.lacks_watchdog else ""
    return f"{device.name}: {none}without this program it {loss}"
