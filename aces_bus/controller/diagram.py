"""A state machine's table as a diagram: Mermaid (which many pages draw) and Graphviz.

1. The picture is made from the table itself, in its order: the same table, the same text.
2. Names that a diagram language cannot write get an alias; none is left out.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Protocol


class PhaseLike(Protocol):
    """What a diagram shows of a phase."""

    @property
    def name(self) -> str:
        """Its name."""
        ...

    @property
    def final(self) -> bool:
        """Whether the machine ends there."""
        ...


class RowLike(Protocol):
    """What a diagram shows of a transition."""

    @property
    def source(self) -> str:
        """Where it starts; "*" is anywhere."""
        ...

    @property
    def target(self) -> str:
        """Where it leads."""
        ...

    @property
    def label(self) -> str:
        """Its condition."""
        ...


def _expanded(phases: Sequence[PhaseLike], table: Sequence[RowLike]) -> list[tuple[str, str, str]]:
    """Rows with "*" written out."""
    rows: list[tuple[str, str, str]] = []
    for row in table:
        sources = [one.name for one in phases if not one.final and one.name != row.target]
        rows += [(one, row.target, row.label) for one in (sources if row.source == "*" else [row.source])]
    return rows


def mermaid(phases: Sequence[PhaseLike], table: Sequence[RowLike]) -> str:
    """A Mermaid state diagram."""
    lines = ["stateDiagram-v2"]
    ids: dict[str, str] = {}
    for phase in phases:
        plain = re.fullmatch(r"[A-Za-z]\w*", phase.name) and phase.name not in ("state", "note", "end")
        ids[phase.name] = phase.name if plain else f"phase_{len(ids)}"
        if not plain:
            lines.append(f'    state "{_quoted(phase.name)}" as {ids[phase.name]}')
    lines.append(f"    [*] --> {ids[phases[0].name]}")
    for source, target, label in _expanded(phases, table):
        # A colon or a semicolon would end the label.
        text = label.replace(";", ",").replace(":", "").replace("\n", " ")
        lines.append(f"    {ids[source]} --> {ids[target]}" + (f": {text}" if text else ""))
    lines += [f"    {ids[phase.name]} --> [*]" for phase in phases if phase.final]
    return "\n".join(lines)


def dot(name: str, phases: Sequence[PhaseLike], table: Sequence[RowLike]) -> str:
    """A Graphviz graph."""
    lines = [f'digraph "{_quoted(name)}" {{', "    start [shape=point];"]
    for phase in phases:
        shape = "doublecircle" if phase.final else "ellipse"
        lines.append(f'    "{_quoted(phase.name)}" [shape={shape}];')
    lines.append(f'    start -> "{_quoted(phases[0].name)}";')
    for source, target, label in _expanded(phases, table):
        lines.append(f'    "{_quoted(source)}" -> "{_quoted(target)}" [label="{_quoted(label)}"];')
    return "\n".join([*lines, "}"])


def _quoted(text: str) -> str:
    return text.replace("\\", "\\\\").replace('"', '\\"').replace("\n", " ")
