"""A protocol in other tools' forms: DBC, a Wireshark dissector, pages in Markdown; and a protocol as spec source.

1. Printers read variants and their plans, and say what they could not say: a `Loss` each, never silence.
2. Nothing here does I/O, and text of others (names, comments, units) reaches printed source as literals only.
"""

from __future__ import annotations

from .leaves import Loss as Loss

__all__ = ["Loss"]
