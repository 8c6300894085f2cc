"""Formats of decoded tables and of logs that the core does not need: NumPy's npz, and MCAP for Foxglove and PlotJuggler.

They are entry points of the groups `aces_bus.exporters` and `aces_bus.logs` (in `logs`), as a stranger's formats are: a
writer or reader is imported when its format is used.
"""

from __future__ import annotations

from aces_bus.export.open import TableFormat

#: How an MCAP begins.
MAGIC = b"\x89MCAP0\r\n"

EXPORTERS: tuple[TableFormat, ...] = (
    TableFormat("npz", (".npz",), "aces_lab.tables.npz:NpzExport"),
    TableFormat(
        "mcap", (".mcap",), "aces_lab.tables.mcap:McapExport", growing="aces_lab.tables.mcap:McapExport"
    ),
)
