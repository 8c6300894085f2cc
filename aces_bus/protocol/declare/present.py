"""A field that is there only while a bit of another one is set."""

from __future__ import annotations

from typing import Any

from construct import Construct

from ...errors import FieldError, SpecError
from .multiplexed import Multiplexed
from .place import caller


class Present(Multiplexed):
    """A field that is there only while bit `bit` of the field `selector` is set; else None, no bytes.

    `selector` is an integer field or `Flags` before it in the same `Struct`, or a field of the header. It may be
    `Present` itself: while it is not there, neither is this field. Several in a row stand one behind the other, each
    where those before it end.
    """

    def __init__(self, selector: str, bit: int, subcon: Construct) -> None:
        if not isinstance(bit, int) or not 0 <= bit < 64:  # pyright: ignore[reportUnnecessaryIsInstance]
            raise SpecError(f"{caller()}: a bit has a number from 0 to 63, not {bit!r}")
        super().__init__(selector, 1 << bit, subcon)
        self.bit = bit

    def around(self, body: Construct) -> Present:
        made = Present(self.selector, self.bit, body)
        made.place = self.place
        return made

    def is_present(self, context: Any) -> bool:
        value = context[self.selector] if self.selector in context else context._.get(self.selector)
        return value is not None and bool(int(value) >> self.bit & 1)

    def absent(self, path: str) -> FieldError:
        return FieldError(f"{path}: only there while bit {self.bit} of {self.selector} is set")
