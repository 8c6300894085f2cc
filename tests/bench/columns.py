"""`python -m tests.bench columns`: whole captures, beside the libraries people use today.

1. The capture is generated: a candump log of a car with 60 messages, 7.6 signals a frame (`car`), the same everywhere.
2. Peers that are slow do a part of it; all figures are per frame or byte. Contenders take turns, the fastest round counts.
3. Every contender ends with values in hand: columns of every signal, or an object a frame, as the row says.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from typing import Any

import can

from aces_bus import FrameTable, load_protocol, make_column_scanner, open_recording
from aces_bus.export import open_export
from aces_bus.frame_table import joined_tables
from aces_bus.protocol import CanScanner, Variant
from aces_bus.protocol.exchange import load_database
from aces_bus.recordings.write import open_writer

from . import transports
from .car import car_dbc, write_car_log
from .live import dynamixel_stream, sdk_packets
from .peers import run_c
from .rows import BenchRow, fastest, optional

#: Frames that a peer is given of the whole: as many as it does in some tenths of a second.
PEER = 30_000
#: Rows a column scanner is given at once.
BATCH = 1 << 18
#: Rows that are made into records at once.
PART = 4096


class Subject:
    """The generated files and what is read from them once."""

    def __init__(self, folder: Path, count: int) -> None:
        self.folder, self.count = folder, count
        self.log = folder / "car.log"
        self.dbc = folder / "car.dbc"
        self.dbc.write_text(car_dbc())
        self.bytes = write_car_log(self.log, count)
        self.part = folder / "part.log"
        self.part_count = min(PEER, count)
        with open(self.log, "rb") as whole, open(self.part, "wb") as part:
            part.writelines(islice(whole, self.part_count))

        self.variant: Variant = load_database(str(self.dbc)).protocol.variant()
        cantools = optional("cantools")
        self.database: Any = cantools.database.load_file(self.dbc) if cantools is not None else None

    def tables(self) -> list[FrameTable]:
        """The whole log, parsed."""
        with open_recording(str(self.log), link="can") as capture:
            return list(capture.tables())


def run(*, quick: bool, frames: int | None = None) -> list[BenchRow]:
    """All rows; `quick` with fewer frames and rounds."""
    count = frames or (200_000 if quick else 1_000_000)
    rounds = 2 if quick else 4
    with _folder() as folder:
        subject = Subject(folder, count)
        figures = run_c(subject.database, subject.log, folder) if subject.database is not None else None
        c_parse, c_both, c_only = (count / seconds for seconds in figures) if figures else (None, None, None)
        rows = _parse(subject, rounds, c_parse)
        rows += _both(subject, rounds, c_both)
        rows += _decode(subject, rounds, c_only)
        rows += _objects(subject, rounds)
        rows += _parquet(subject, rounds)
        rows += _jobs(subject)
        rows += _memory(subject)
        rows += _blf(subject, rounds)
        rows += _mf4(subject, rounds)

    return rows + transports.run(quick=quick) + stream_rows(quick=quick)


@contextmanager
def _folder() -> Generator[Path]:
    folder = Path(tempfile.mkdtemp(prefix="aces-bench-"))
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _rows(
    subject: str,
    contenders: dict[str, tuple[Callable[[], object], int]],
    rounds: int,
    targets: dict[str, float],
    c_rate: float | None = None,
    c_target: float = 0.3,
) -> list[BenchRow]:
    """Rows of one subject. Each contender is a function and the frames it does; ours, first, is compared with each peer."""
    best = fastest({name: run for name, (run, _) in contenders.items()}, rounds=rounds)
    rates = {name: contenders[name][1] / seconds for name, seconds in best.items()}
    ours = next(iter(contenders))
    rows = [BenchRow(subject, ours, rates[ours], "frames/s")]
    for name, rate in rates.items():
        if name == ours:
            continue
        ratio, target = rates[ours] / rate, targets.get(name)
        rows.append(
            BenchRow(
                subject,
                name,
                rate,
                "frames/s",
                ratio,
                f"≥ {target:g}" if target else "",
                ratio >= target if target else None,
            )
        )
    if c_rate is not None:
        ratio = rates[ours] / c_rate
        rows.append(
            BenchRow(subject, "C, one core", c_rate, "frames/s", ratio, f"≥ {c_target:g}", ratio >= c_target)
        )
    return rows


# ---------------------------------------------------------------------- candump


def _parse(subject: Subject, rounds: int, c_rate: float | None) -> list[BenchRow]:
    def ours() -> int:
        with open_recording(str(subject.log), link="can") as capture:
            return sum(len(table) for table in capture.tables())

    contenders: dict[str, tuple[Callable[[], object], int]] = {
        "aces": (ours, subject.count),
        "python-can": (lambda: sum(1 for _ in can.CanutilsLogReader(str(subject.part))), subject.part_count),
    }
    if optional("cantools") is not None:
        from cantools import logreader

        def reader() -> int:
            with open(subject.part) as file:
                return sum(1 for _ in logreader.Parser(file).iterlines())

        contenders["cantools' reader"] = (reader, subject.part_count)
    if optional("polars") is not None:
        from .peers import parse

        contenders["polars"] = (lambda: parse(subject.log), subject.count)
    return _rows("candump log, parse only", contenders, rounds, {"python-can": 50}, c_rate)


def columns_of(subject: Subject, tables: Iterator[FrameTable] | list[FrameTable]) -> int:
    """Every signal of every frame as a column; the number of values."""
    scanner = make_column_scanner([subject.variant])
    return sum(
        len(column)
        for piece in joined_tables(tables, BATCH)
        for table in scanner.feed(piece)
        for column in table.columns()
    )


def _both(subject: Subject, rounds: int, c_rate: float | None) -> list[BenchRow]:
    def ours() -> int:
        with open_recording(str(subject.log), link="can") as capture:
            return columns_of(subject, capture.tables())

    contenders: dict[str, tuple[Callable[[], object], int]] = {"aces": (ours, subject.count)}
    database = subject.database
    if database is not None:

        def loop() -> int:
            columns: dict[tuple[int, str], list[Any]] = {}
            for message in can.CanutilsLogReader(str(subject.part)):
                values = database.decode_message(message.arbitration_id, message.data, decode_choices=False)
                for name, value in values.items():
                    columns.setdefault((message.arbitration_id, name), []).append(value)
            return len(columns)

        contenders["python-can + cantools"] = (loop, subject.part_count)
    can_decoder, pandas = optional("can_decoder"), optional("pandas")
    if can_decoder is not None and pandas is not None:
        rules = can_decoder.load_dbc(str(subject.dbc))

        def frames() -> int:
            rows = list(can.CanutilsLogReader(str(subject.part)))
            table = pandas.DataFrame(
                {
                    "ID": [m.arbitration_id for m in rows],
                    "IDE": [m.is_extended_id for m in rows],
                    "DataBytes": [list(m.data) for m in rows],
                },
                index=pandas.to_datetime([m.timestamp for m in rows], unit="s"),
            )
            table.index.name = "TimeStamp"
            return len(can_decoder.DataFrameDecoder(rules).decode_frame(table))

        contenders["python-can + can_decoder"] = (frames, subject.part_count)
    if database is not None and optional("polars") is not None:
        from .peers import parse_and_decode

        contenders["polars, by hand"] = (lambda: parse_and_decode(subject.log, database), subject.count)
    targets = {"python-can + cantools": 55.0, "polars, by hand": 1.7}
    return _rows("candump log → columns of physical values", contenders, rounds, targets, c_rate)


def _decode(subject: Subject, rounds: int, c_rate: float | None) -> list[BenchRow]:
    whole = FrameTable.concat(subject.tables())
    tables = [whole.take(slice(at, at + BATCH)) for at in range(0, len(whole), BATCH)]
    contenders: dict[str, tuple[Callable[[], object], int]] = {
        "aces": (lambda: columns_of(subject, tables), subject.count)
    }
    database = subject.database
    if database is not None:
        frames = [(f.arbitration_id, f.data) for f in whole.take(slice(0, subject.part_count)).frames()]

        def loop() -> int:
            decode = database.decode_message
            return sum(len(decode(identifier, data, decode_choices=False)) for identifier, data in frames)

        contenders["cantools"] = (loop, len(frames))
    return _rows("decode only, frames in memory", contenders, rounds, {"cantools": 45}, c_rate)


def _objects(subject: Subject, rounds: int) -> list[BenchRow]:
    def ours() -> int:
        scanner = CanScanner([subject.variant])
        with open_recording(str(subject.log), link="can") as capture:
            return sum(
                len(scanner.feed_table(table.take(slice(at, at + PART))))
                for table in capture.tables()
                for at in range(0, len(table), PART)
            )

    contenders: dict[str, tuple[Callable[[], object], int]] = {"aces": (ours, subject.count)}
    if subject.database is not None:

        def loop() -> int:
            decode = subject.database.decode_message
            return sum(
                len(decode(m.arbitration_id, m.data)) for m in can.CanutilsLogReader(str(subject.part))
            )

        contenders["python-can + cantools"] = (loop, subject.part_count)
    return _rows("candump log → a record a frame", contenders, rounds, {"python-can + cantools": 5})


# ---------------------------------------------------------------------- Parquet, processes, memory


def _parquet(subject: Subject, rounds: int) -> list[BenchRow]:
    if optional("pyarrow") is None:
        return []

    out = subject.folder / "ours.parquet"

    def ours() -> None:
        shutil.rmtree(out, ignore_errors=True)
        scanner = make_column_scanner([subject.variant])
        with open_recording(str(subject.log), link="can") as capture, open_export(str(out)) as export:
            for piece in joined_tables(capture.tables(), BATCH):
                export.write(scanner.feed(piece))

    contenders: dict[str, tuple[Callable[[], object], int]] = {"aces": (ours, subject.count)}
    database = subject.database
    if database is not None:
        import pyarrow
        from pyarrow import parquet

        def loop() -> None:
            rows: dict[str, list[dict[str, Any]]] = {}
            for message in can.CanutilsLogReader(str(subject.part)):
                kind = database.get_message_by_frame_id(message.arbitration_id)
                values = kind.decode(message.data, decode_choices=False)
                rows.setdefault(kind.name, []).append({"time": message.timestamp, **values})
            for name, some in rows.items():
                parquet.write_table(pyarrow.Table.from_pylist(some), subject.folder / f"{name}.parquet")

        contenders["python-can + cantools + pyarrow"] = (loop, subject.part_count)
    targets = {"python-can + cantools + pyarrow": 30.0}
    return _rows("candump log → Parquet", contenders, max(2, rounds - 1), targets)


def _jobs(subject: Subject) -> list[BenchRow]:
    """Two processes beside one, on a longer log, start-up included."""
    long = subject.folder / "long.log"
    with open(long, "wb") as file:
        for _ in range(4):
            with open(subject.log, "rb") as part:
                shutil.copyfileobj(part, file)

    def work(jobs: int) -> Callable[[], None]:
        out = str(subject.folder / f"jobs{jobs}.parquet")

        def run_it() -> None:
            shutil.rmtree(out, ignore_errors=True)
            command = ["decode", str(long), "-p", str(subject.dbc), "-o", out, "--jobs", str(jobs)]
            subprocess.run([sys.executable, "-m", "aces_tools", *command], check=True, capture_output=True)

        return run_it

    best = fastest({"one": work(1), "two": work(2)}, rounds=2)
    rates = {name: 4 * subject.count / seconds for name, seconds in best.items()}
    long.unlink()
    ratio = rates["two"] / rates["one"]
    name = "aces decode → Parquet, the whole command"
    return [
        BenchRow(name, "--jobs 2", rates["two"], "frames/s"),
        BenchRow(name, "--jobs 1", rates["one"], "frames/s", ratio, "≥ 1.8", ratio >= 1.8),
    ]


#: The high-water mark of a process itself; getrusage also counts what it was forked from.
_PEAK = "print([line.split()[1] for line in open('/proc/self/status') if line.startswith('VmHWM')][0])"


def _memory(subject: Subject) -> list[BenchRow]:
    """Peak memory of whole commands, and of an interpreter that only imports."""
    if not Path("/proc/self/status").exists():
        return []
    base = _peak("import aces_bus.protocol, aces_bus.recordings, numpy")
    out = str(subject.folder / "memory.parquet")
    ours = _peak(
        "import sys; from aces_tools.main import main;"
        f"sys.argv = ['aces', 'decode', {str(subject.log)!r}, '-p', {str(subject.dbc)!r}, '-o', {out!r}];"
        "main()"
    )
    rows = [
        BenchRow("peak memory, candump log → Parquet", "aces", ours, "MB"),
        BenchRow("peak memory, candump log → Parquet", "of which imports", base, "MB"),
    ]
    if optional("can_decoder") is not None and optional("pandas") is not None:
        code = (
            "import can, pandas, can_decoder;"
            f"rows = list(can.CanutilsLogReader({str(subject.part)!r}));"
            "t = pandas.DataFrame({'ID': [m.arbitration_id for m in rows],"
            " 'IDE': [m.is_extended_id for m in rows], 'DataBytes': [list(m.data) for m in rows]},"
            " index=pandas.to_datetime([m.timestamp for m in rows], unit='s'));"
            "t.index.name = 'TimeStamp';"
            f"can_decoder.DataFrameDecoder(can_decoder.load_dbc({str(subject.dbc)!r})).decode_frame(t)"
        )
        label = f"can_decoder, {subject.part_count:,} frames only"
        rows.append(BenchRow("peak memory, candump log → Parquet", label, _peak(code), "MB"))
    return rows


def _peak(code: str) -> float:
    done = subprocess.run(
        [sys.executable, "-c", f"{code}\n{_PEAK}"], check=True, capture_output=True, text=True
    )
    return int(done.stdout.split()[-1]) / 1024


# ---------------------------------------------------------------------- binary logs


def _write(subject: Subject, path: Path, count: int) -> None:
    left = count
    with open_recording(str(subject.log), link="can") as capture, open_writer(str(path)) as writer:
        for table in capture.tables():
            writer.write(table.take(slice(0, left)))
            left -= min(left, len(table))


def _read(path: Path) -> int:
    with open_recording(str(path), link="can") as capture:
        return sum(len(table) for table in capture.tables())


def _blf(subject: Subject, rounds: int) -> list[BenchRow]:
    whole, part = subject.folder / "car.blf", subject.folder / "part.blf"
    _write(subject, whole, subject.count)
    _write(subject, part, subject.part_count)
    contenders: dict[str, tuple[Callable[[], object], int]] = {
        "aces": (lambda: _read(whole), subject.count),
        "python-can": (lambda: sum(1 for _ in can.BLFReader(str(part))), subject.part_count),
    }
    return _rows("BLF, read", contenders, rounds, {"python-can": 20})


def _mf4(subject: Subject, rounds: int) -> list[BenchRow]:
    if optional("asammdf") is None or subject.database is None:
        return []
    from asammdf import MDF

    path = subject.folder / "car.mf4"
    _write(subject, path, subject.count)

    def ours() -> int:
        with open_recording(str(path), link="can") as capture:
            return columns_of(subject, capture.tables())

    def extract() -> int:
        with MDF(path) as file, file.extract_bus_logging({"CAN": [(str(subject.dbc), 0)]}) as found:
            return sum(len(signal.samples) for signal in found.iter_channels(skip_master=True))

    contenders: dict[str, tuple[Callable[[], object], int]] = {
        "aces": (ours, subject.count),
        "asammdf": (extract, subject.count),
    }
    return _rows("MF4 → columns of physical values", contenders, max(1, rounds - 2), {"asammdf": 1.4})


# ---------------------------------------------------------------------- serial

#: Chunk size → how many times dynamixel_sdk's rate is wanted.
CHUNKS = {1 << 20: 40.0, 4096: 12.0}


def stream_rows(*, quick: bool) -> list[BenchRow]:
    """Rows for each chunk size; the peer reads a part."""
    data, good = dynamixel_stream(1_000_000)
    whole = data * (8 if quick else 64)
    part = data[:400_000]
    variant = load_protocol("robotis").variant()
    found: dict[int, int] = {}

    def ours(chunk: int) -> Callable[[], object]:
        def run() -> None:
            scanner = make_column_scanner([variant], direction="from device")
            for at in range(0, len(whole), chunk):
                for table in scanner.feed(whole[at : at + chunk]):
                    for column in table.columns():
                        len(column)
            for table in scanner.close():
                for column in table.columns():
                    len(column)
            found[chunk] = scanner.counts.records

        return run

    contenders: dict[str, Callable[[], object]] = {str(chunk): ours(chunk) for chunk in CHUNKS}
    peer = sdk_packets(part)
    if peer is not None:
        contenders["dynamixel_sdk"] = peer
    best = fastest(contenders, rounds=2 if quick else 4)
    base = len(part) / best["dynamixel_sdk"] / 1e6 if peer is not None else None
    subject = f"Dynamixel 1.0 → columns, {len(whole) / 1e6:.0f} MB"
    rows = []
    for chunk, target in CHUNKS.items():
        rate = len(whole) / best[str(chunk)] / 1e6
        ratio = rate / base if base is not None else None
        wanted = good * (len(whole) // len(data))
        label = f"aces, chunks of {chunk:,} bytes, {found[chunk]} of {wanted} good packets"
        is_met = None if ratio is None else ratio >= target and found[chunk] >= wanted
        rows.append(BenchRow(subject, label, rate, "MB/s", ratio, f"≥ {target:g} × dynamixel_sdk", is_met))
    if base is not None:
        rows.append(BenchRow(subject, "dynamixel_sdk", base, "MB/s"))
    return rows
