"""What `aces fuzz` prints: failures as they come, then what was reached, then one line that sums up.

1. Failures and the table go to stdout, progress and the summary to stderr; with `--json` one object goes to stdout.
2. What was never reached is named, all of it up to `NAMED`.
"""

from __future__ import annotations

import json
import textwrap
from collections.abc import Mapping, Sequence
from typing import Any

from aces_bus.testing.coverage import KINDS, Coverage

from .work import FoundFailure

#: Names of a kind that are listed when they were never reached.
NAMED = 40
PLURALS = {"message": "messages", "field": "fields", "value": "named values", "template": "templates"}


def failure_text(found: FoundFailure) -> str:
    """A failure, drawn, with the lines that repeat it."""
    where = f"{found.label}, {found.direction or 'any direction'}"
    lines = [f"FAILED law {found.law} ({found.name}) of {where}", ""]
    lines += textwrap.wrap(found.text.replace("\n", " "), 108, initial_indent="  ", subsequent_indent="    ")[
        :8
    ]
    lines += ["", textwrap.indent(found.drawing, "  "), "", f"  saved: {found.capture}", "  again:"]
    lines += [f"    {command}" for command in found.commands]
    return "\n".join(lines) + "\n"


def coverage_table(coverage: Coverage, width: int) -> str:
    """What was reached, a line a message; then what never was."""
    lines: list[str] = []
    for protocol in coverage.protocols:
        parts = [(PLURALS[kind], *coverage.parts(protocol, kind)) for kind in KINDS]
        lines.append(f"{protocol}: " + ", ".join(f"{n}/{all} {kind}" for kind, n, all in parts if all))
        names = sorted(f[2] for f in coverage.expected if f[0] == protocol and f[1] == "message")
        long = max([len("message"), *map(len, names)])
        lines.append(f"  {'message':<{long}}  {'records':>8}  {'fields':>7}  {'values':>7}  templates")
        for name in names:
            records = coverage.reached[protocol, "message", name]
            cells = [
                _part(coverage.of_message(protocol, name, kind)) for kind in ("field", "value", "template")
            ]
            lines.append(
                f"  {name:<{long}}  {records:>8}  {cells[0]:>7}  {cells[1]:>7}  {cells[2]:>9}".rstrip()
            )
        ends: dict[str, list[str]] = {}
        for _, _, what in sorted(f for f in coverage.expected if f[:2] == (protocol, "template")):
            framing, _, end = what.rpartition(": ")
            if framing.startswith("framing "):
                ends.setdefault(framing, []).append(f"{end} {coverage.reached[protocol, 'template', what]}")
        lines += [f"  {framing}: {', '.join(texts)}" for framing, texts in ends.items()]
        never = coverage.never(protocol)
        for kind in KINDS:
            missing = [name for _, k, name in never if k == kind]
            if missing:
                more = f" and {len(missing) - NAMED} more" if len(missing) > NAMED else ""
                text = f"{PLURALS[kind]} never reached: {', '.join(missing[:NAMED])}{more}"
                lines += textwrap.wrap(
                    text, max(40, width - 2), initial_indent="  ", subsequent_indent="    "
                )
        if not never:
            lines.append("  nothing was left out")
    return "\n".join(lines)


def _part(numbers: tuple[int, int]) -> str:
    return f"{numbers[0]}/{numbers[1]}" if numbers[1] else "-"


def as_json(
    names: Sequence[str], numbers: Mapping[str, Any], found: Sequence[FoundFailure], coverage: Coverage
) -> str:
    """The whole run as one JSON object."""
    protocols = {
        protocol: {
            **{
                PLURALS[kind].replace(" ", "_"): dict(
                    zip(("reached", "of"), coverage.parts(protocol, kind), strict=True)
                )
                for kind in KINDS
            },
            "never": [f"{kind} {name}" for _, kind, name in coverage.never(protocol)],
            "records": {
                name: coverage.reached[protocol, "message", name]
                for p, kind, name in sorted(coverage.expected)
                if (p, kind) == (protocol, "message")
            },
        }
        for protocol in coverage.protocols
    }
    failures = [
        {
            "law": one.law,
            "name": one.name,
            "wire": one.label,
            "direction": one.direction,
            "text": one.text,
            "drawing": one.drawing,
            "capture": one.capture,
            "scene": one.scene,
            "commands": list(one.commands),
            "example": one.example,
        }
        for one in found
    ]
    return json.dumps(
        {"names": list(names), **numbers, "failures": failures, "protocols": protocols}, ensure_ascii=False
    )


__all__ = ["as_json", "coverage_table", "failure_text"]
