"""A field that is there only while another one has a value."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

from construct import Construct

from ...errors import FieldError
from .fields import Enumeration
from .place import caller


class Multiplexed(Construct):
    """A field that is there only while the field `selector` has (one of) the raw value(s) `when`; else None, no bytes.

    The selector may be multiplexed itself: while it is not there, neither is this field.
    """

    def __init__(self, selector: str, when: int | Collection[int], subcon: Construct) -> None:
        super().__init__()
        self.selector = selector
        self.when = frozenset((when,) if isinstance(when, int) else when)
        self.body = subcon
        self.place = caller()
        self.flagbuildnone = True
        self.enumeration: Enumeration | None = None

    def is_present(self, context: Any) -> bool:
        value = context[self.selector]
        if isinstance(value, str) and self.enumeration is not None:
            value = self.enumeration.names.get(value)
        return value in self.when

    def _parse(self, stream: Any, context: Any, path: str) -> Any:
        return self.body._parsereport(stream, context, path) if self.is_present(context) else None

    def _build(self, obj: Any, stream: Any, context: Any, path: str) -> Any:
        if self.is_present(context):
            return self.body._build(obj, stream, context, path)
        if obj is not None:
            raise self.absent(path)
        return None

    def around(self, body: Construct) -> Multiplexed:
        """Return the same condition around another field."""
        made = type(self)(self.selector, self.when, body)
        made.place = self.place
        return made

    def absent(self, path: str) -> FieldError:
        """Return the error for a value that is given while the field is not there."""
        return FieldError(f"{path}: only there while {self.selector} is {number_runs(self.when)}")

    def _sizeof(self, context: Any, path: str) -> Any:
        return self.body._sizeof(context, path) if self.is_present(context) else 0


def runs_of_numbers(values: Collection[int]) -> list[tuple[int, int]]:
    """Return the first and the last of each run of numbers that follow one another."""
    runs: list[tuple[int, int]] = []
    for value in sorted(values):
        if runs and value == runs[-1][1] + 1:
            runs[-1] = runs[-1][0], value
        else:
            runs.append((value, value))
    return runs


def number_runs(values: Collection[int]) -> str:
    """Numbers as their runs, shortest form: `0…15, 32`."""
    runs = runs_of_numbers(values)
    texts = [
        f"{low}…{high}" if high - low > 1 else str(low) if low == high else f"{low}, {high}"
        for low, high in runs[:12]
    ]
    return ", ".join(texts) + (f", … ({len(values)} values)" if len(runs) > 12 else "")
