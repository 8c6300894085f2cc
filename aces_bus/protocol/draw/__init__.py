"""Pictures and tables of messages, from their plans: `text` for terminals, `svg` for pages, `table` for both."""

from __future__ import annotations

from .cells import SHARING as SHARING
from .cells import Mark as Mark
from .cells import marks_of as marks_of
from .svg import picture_svg as picture_svg
from .table import FieldRow as FieldRow
from .table import bits_place as bits_place
from .table import captured_values as captured_values
from .table import field_table as field_table
from .table import row_of as row_of
from .text import draw_text as draw_text
from .text import picture as picture
