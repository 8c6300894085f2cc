"""Protocols for other tools, beside the core's DBC: C99 source, a dissector for Wireshark, pages in Markdown.

`aces spec export` writes them, and the DBC. What the other format cannot hold is a `Loss` with its reason, never silence.
"""

from __future__ import annotations

from .export_c import print_c_source
from .export_markdown import print_markdown
from .export_wireshark import print_dissector

__all__ = ["print_c_source", "print_dissector", "print_markdown"]
