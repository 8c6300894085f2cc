"""Decoded tables on disk: Parquet, Arrow, CSV, SQLite, and formats by entry point; and as pandas and polars have them.

1. Memory stays bounded whatever the capture's size: tables go in piece by piece, and out as they fill up.
2. Under an export's name there is the whole of it, or what was there before.
3. Heavy libraries are imported where they are used.

    from aces_bus.export import open_export

    with open_recording("walk.log", link="can") as capture, open_export("walk.parquet", variants=[variant]) as export:
        scanner = make_column_scanner([variant])
        for frames in capture.tables():
            export.write(scanner.feed(frames))
        export.write(scanner.close())
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from .._lazy import lazy_names

if TYPE_CHECKING:
    from .open import open_export as open_export
    from .parquet_parts import recover_parts as recover_parts

__all__ = ["open_export", "recover_parts"]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        ".open": "open_export",
        ".parquet_parts": "recover_parts",
    },
)
