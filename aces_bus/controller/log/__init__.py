"""Logs: states sampled into a file that survives a kill, and files read back, the original framework's among them.

`Logger("walk.parquet", ["RHY", "RHY(rate)"], rate_hz=200)` records; `read_log("walk.parquet")["RHY"]` reads. See
docs/logging.md.
"""

from __future__ import annotations

from .base import About, Log, LogError, LogSink, Row
from .columns import ATTRIBUTES, LogColumn, parse_column
from .formats import log_format, read_log, recover
from .logger import Logger

__all__ = [
    "ATTRIBUTES",
    "About",
    "Log",
    "LogColumn",
    "LogError",
    "LogSink",
    "Logger",
    "Row",
    "log_format",
    "parse_column",
    "read_log",
    "recover",
]
