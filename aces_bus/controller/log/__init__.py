"""Logs: states sampled into a file that survives a kill, and files read back, the original framework's among them.

`Logger("walk.parquet", ["RHY", "RHY(rate)"], rate_hz=200)` records; `read_log("walk.parquet")["RHY"]` reads. See
docs/logging.md.
"""

from __future__ import annotations

from .formats import read_log, recover
from .logger import Logger

__all__ = ["Logger", "read_log", "recover"]
