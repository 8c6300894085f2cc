"""Formats of logs beside those of the core."""

from __future__ import annotations

from aces_bus.controller.log.formats import LogFormat

from . import MAGIC

LOGS: tuple[LogFormat, ...] = (
    LogFormat(
        "mcap",
        (".mcap",),
        MAGIC,
        "aces_lab.tables.mcap_log:McapSink",
        "aces_lab.tables.mcap_log:read_mcap_log",
        "aces_lab.tables.mcap_log:recover_mcap",
    ),
)
