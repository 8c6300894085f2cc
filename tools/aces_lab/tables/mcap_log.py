"""Logs as MCAP, for Foxglove and PlotJuggler: one channel `/states`, a JSON object a row, null where unknown.

1. A row's `log_time` is the start (ns since 1970, in virtual time of its clock) plus the row's ns, exactly.
2. What is appended is one chunk. What a killed writer left is read up to its last whole record, and noted; `recover` gives
   it the index.
"""

from __future__ import annotations

import contextlib
import os
import struct
from array import array
from collections.abc import Sequence

import msgspec
import numpy as np

from aces_bus.controller.log.base import About, Log, LogError, LogSink, Row
from aces_bus.errors import CallerError

from .mcap_file import CHANNEL, MESSAGE, Fields, McapFault, McapReader, McapWriter
from .topics import STATES_TOPIC, states_schema

#: Where the log's `About` is among a channel's metadata.
KEY = "aces_log"
#: Rows in a chunk of a recovered file.
CHUNK_ROWS = 1024


class McapSink(LogSink):
    """`walk.mcap`."""

    def __init__(self, path: str, about: About) -> None:
        super().__init__(path, about)
        self._encode = msgspec.json.Encoder().encode
        schema = states_schema({column.name: column.unit for column in about.columns})
        metadata = {"robot": about.robot, "clock": about.clock, KEY: about.to_json()}
        self._file: McapWriter = McapWriter(path)
        self._channel = self._file.channel(STATES_TOPIC, "states", schema, metadata)

    def append(self, rows: Sequence[Row]) -> None:
        """Write one chunk."""
        base, names, encode, channel = self.about.base_ns, self.about.names, self._encode, self._channel
        self._file.chunk(
            [
                (channel, max(0, base + ns), encode(dict(zip(names, values, strict=True))))
                for ns, values in rows
            ]
        )


def _declared(channel: Fields) -> tuple[int, About | None]:
    """Return the number of a channel, and what a log says of itself there."""
    number, _ = channel.take("HH")
    channel.text()
    encoding, metadata = channel.text(), Fields(channel.bytes())
    found = None
    while metadata:
        key, value = metadata.text(), metadata.text()
        if key == KEY and encoding == "json":
            found = About.parse(value)
    return number, found


def read_mcap_log(path: str, most_numbers: int) -> Log:
    """Read the first channel that a logger made."""
    about: About | None = None
    mine = -1
    instants, numbers = array("q"), array("d")
    decode = msgspec.json.Decoder(dict[str, float | None]).decode
    try:
        with open(path, "rb") as stream:
            reader = McapReader(stream)
            for opcode, content in reader.records():
                if opcode == CHANNEL and about is None:
                    mine, about = _declared(content)
                if opcode != MESSAGE or about is None:
                    continue
                channel, _, instant, _ = content.take("HIQQ")
                if channel != mine:
                    continue
                values = decode(content.data[content.at :])
                if not abs(instant - about.base_ns) < 1 << 63:
                    raise McapFault(f"a row at an impossible time ({instant})")
                instants.append(instant - about.base_ns)
                for column in about.columns:
                    value = values.get(column.name)
                    numbers.append(np.nan if value is None else value)
                if len(numbers) + len(instants) > most_numbers:
                    raise McapFault(f"more than {most_numbers} numbers")
    except msgspec.MsgspecError as error:
        raise LogError(f"{path}: a row that is not JSON of numbers ({error})") from None
    except (McapFault, struct.error, RecursionError) as error:
        raise LogError(f"{path}: {error}") from None
    if about is None:
        raise LogError(f"{path}: an MCAP without a channel of a logger; Foxglove and PlotJuggler open it")
    table = np.array(numbers, np.float64).reshape(len(instants), len(about.columns))
    notes = [Log.NOT_CLOSED.format(path)] if reader.is_cut else []
    return Log.of_table(path, "mcap", about, table, notes, np.array(instants, np.int64) / 1e9)


def recover_mcap(path: str) -> int:
    """Close a file whose writer was killed; returns the number of rows. The file takes its place when it is whole."""
    log = read_mcap_log(path, Log.MOST_NUMBERS)
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
