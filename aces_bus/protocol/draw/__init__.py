"""Pictures and tables of messages, from their plans: `text` for terminals, `svg` for pages, `table` for both."""

from __future__ import annotations

from .cells import SHARING, Mark, marks_of
from .svg import picture_svg
from .table import FieldRow, bits_place, captured_values, field_table, row_of
from .text import draw_text, picture

__all__ = [
    "SHARING",
    "FieldRow",
    "Mark",
    "bits_place",
    "captured_values",
    "draw_text",
    "field_table",
    "marks_of",
    "picture",
    "picture_svg",
    "row_of",
]
