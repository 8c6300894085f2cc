"""Logs that were never closed, closed: for programs that want the index at a file's end.

1. What `read_log` reads of it is what the closed log has. The file takes its place when it is whole, not before.
"""

from __future__ import annotations

import contextlib
import os

from ...errors import CallerError
from . import parquet
from .mcap import MAGIC, McapSink
from .read_mcap import read_mcap_log

#: Rows in a chunk of a recovered MCAP.
CHUNK_ROWS = 1024


def recover(path: str | os.PathLike[str]) -> int:
    """Close a log whose writer was killed, Parquet or MCAP; returns the number of rows.

    Raises `CallerError` for a file that needs none, `LogError` for one that is no log, `OSError` when the closed one cannot
    be written; what is there stays then.
    """
    where = os.fspath(path).removesuffix(".journal")
    if os.path.isfile(where):
        with open(where, "rb") as stream:
            if stream.read(len(MAGIC)) == MAGIC:
                return _mcap(where)
    if not os.path.exists(parquet.journal_of(where)):
        raise CallerError(
            f"{where}: is no unclosed MCAP, and there is no {os.path.basename(parquet.journal_of(where))} beside it;"
            " text, CSV and SQLite need no recovery"
        )
    return parquet.recover_parquet(where)


def _mcap(path: str) -> int:
    log = read_mcap_log(path)
    if not log.notes:
        raise CallerError(f"{path}: was closed; nothing is to recover")
    made = path + ".part"
    try:
        sink = McapSink(made, log.about)
        rows = [
            (round(seconds * 1e9), values)
            for seconds, values in zip(log.time_s.tolist(), log.values.tolist(), strict=True)
        ]
        for start in range(0, len(rows), CHUNK_ROWS):
            sink.append(rows[start : start + CHUNK_ROWS])
        sink.close()
        os.replace(made, path)
    except BaseException:
        with contextlib.suppress(OSError):
            os.remove(made)
        raise
    return len(log)
