"""Prints functions from a record to the text of its fields: constants, and expressions that read the record.

1. What a spec says in words enters by name only, as everywhere in generated text.
2. A number whose form the plan says is written in place. Anything else goes through the function that writes any value of
   its node, and where a node has few values their texts are kept.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from aces_bus.protocol.generate.load import OnDemand
from aces_bus.protocol.generate.source import FunctionSetup, NameScope, SourceText, load_source
from aces_bus.protocol.plan import nodes as p

from .shape import RecordLeaf, json_bytes

#: A node has few values when they are so many at most: many more texts than the processor's caches hold cost more than they
#: spare.
FEW = 32
#: So many texts of a node are kept.
KEPT = 1024
#: What stands before the values is kept for so many identifiers, channels and directions.
HEADS = 1 << 16


def decimal(number: float) -> bytes:
    """Return a float as Python writes it."""
    return json_bytes(number) if 1e-4 <= abs(number) < 1e16 else str(number).encode()


#: What printed functions call.
CALLED: Mapping[str, Any] = {"join": b"".join, "json": json_bytes, "decimal": decimal}


#: The record, and what functions use in passing.
LOCAL = ("r", "v", "n", "line", "pad")


class Read(str):
    """An expression that reads a value and gives its text; beside it, a plain `str` is text as it is."""


class LinePrinter(FunctionSetup):
    """Prints one function of a record `r`."""

    def __init__(self, plan: p.MessagePlan, *arguments: str) -> None:
        self.plan = plan
        self.setup = []
        self.names = NameScope((*CALLED, *LOCAL, *arguments))
        self.body = SourceText()
        self._name = self.names.new(f"line_{plan.name}")
        self.body.line(f"def {self._name}({', '.join(['r', *arguments])}):")
        self.body.depth = 1

    def load(self) -> Callable[..., Any]:
        """Return the function."""
        source = "\n".join([*self.setup, "", *self.body.printed, ""])
        namespace = load_source(source, f"aces lines of {self.plan.name}", {**CALLED, **self.names.bound})
        made: Callable[..., Any] = namespace[self._name]
        return made

    def read(self, leaf: RecordLeaf) -> str:
        """Return the expression of a value; None where it is not there."""
        is_there = self.plan.is_flat and not leaf.conditional
        if len(leaf.way) == 1 or (is_there and all(isinstance(step, (str, int)) for step in leaf.way)):
            return "r" + "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in leaf.way)
        return f"{self._bound(f'get_{leaf.identifier}', leaf.get)}(r)"

    def shown(self, name: str, node: p.Node, show: Callable[[Any], str | bytes], value: str) -> Read:
        """Return what a function makes of a value."""
        if has_few_values(node):
            return Read(f"{self._bound(f'text_{name}', OnDemand(show, most=KEPT), shown=name)}[{value}]")
        return Read(f"{self._bound(f'text_{name}', show, shown=name)}({value})")

    def constant(self, text: str | bytes) -> str:
        """Return the name of a text."""
        return self._bound(f"_{len(self.setup)}", text)

    def literal(self, parts: Sequence[str | Read]) -> str:
        """Return an f-string; an expression may have a format behind it."""
        return (
            f"f'{''.join('{' + (p if isinstance(p, Read) else self.constant(p)) + '}' for p in parts if p)}'"
        )

    def joined(self, parts: Sequence[str | Read]) -> None:
        """Print the joining of parts to bytes: a line for each expression (`Read`), behind the text before it."""
        self.body.line("return join((")
        text = ""
        for part in parts:
            if isinstance(part, Read):
                before = f"{self._encoded(text)}, " if text else ""
                self.body.line(f"    {before}{part},")
                text = ""
            else:
                text += part
        if text:
            self.body.line(f"    {self._encoded(text)},")
        self.body.line("))")

    def _encoded(self, text: str) -> str:
        """Return the name of a constant: the bytes of a text."""
        return self.constant(text.encode("utf-8", "replace"))


def has_few_values(node: p.Node) -> bool:
    """Return whether it pays to keep the texts of a node's values."""
    if node.has_flags or node.enumerated:
        return True
    low, high = node.raw_range or (0, FEW)
    return high - low < FEW


__all__ = ["LinePrinter", "Read", "has_few_values"]
