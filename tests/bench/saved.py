"""Figures of a benchmark in a file, with the machine that they are of, and what has changed since."""

from __future__ import annotations

import os
import platform
from collections.abc import Iterable, Mapping, Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import msgspec

from aces_bus.errors import CallerError

from .rows import BenchRow

#: What figures depend on, beside the interpreter.
PACKAGES = (
    "aces-bus",
    "numpy",
    "msgspec",
    "python-can",
    "cantools",
    "construct",
    "pyarrow",
    "polars",
    "asammdf",
)


class Machine(msgspec.Struct, frozen=True):
    """Where and with what was measured; `load` is the system's over the last minute, before the run."""

    cpu: str
    cores: int
    python: str
    system: str
    versions: dict[str, str]
    load: float | None

    @property
    def note(self) -> str:
        """The machine in one line."""
        load = "" if self.load is None else f"; load {self.load:.1f}"
        versions = ", ".join(f"{name} {number}" for name, number in self.versions.items())
        return f"{self.cpu}, {self.cores} cores, {self.system}, {self.python}{load}; {versions}"


class SavedFigures(msgspec.Struct, frozen=True):
    """A run: which benchmark, where, and its rows."""

    subject: str
    machine: Machine
    rows: list[BenchRow]

    def save(self, path: str) -> None:
        """Raises `CallerError` where the file cannot be written."""
        try:
            Path(path).write_bytes(msgspec.json.format(msgspec.json.encode(self), indent=1) + b"\n")
        except OSError as error:
            raise CallerError(f"{path}: cannot be written: {error.strerror or error}") from error


def this_machine() -> Machine:
    """The machine that this runs on, as it is now."""
    versions: dict[str, str] = {}
    for name in PACKAGES:
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            continue
    return Machine(
        _cpu(),
        os.cpu_count() or 1,
        f"{platform.python_implementation()} {platform.python_version()}",
        f"{platform.system()} {platform.machine()}",
        versions,
        os.getloadavg()[0] if hasattr(os, "getloadavg") else None,
    )


def _cpu() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        lines = []
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(names, "") or platform.processor() or "unknown processor"


def read_saved(path: str, subject: str) -> SavedFigures:
    """Figures of an earlier run of the same benchmark; raises `CallerError` for anything else."""
    try:
        saved = msgspec.json.decode(Path(path).read_bytes(), type=SavedFigures)
    except OSError as error:
        raise CallerError(f"--compare {path}: {error.strerror or error}") from error
    except msgspec.MsgspecError as error:
        raise CallerError(f"--compare {path}: not figures that --save has written: {error}") from error
    if saved.subject != subject:
        raise CallerError(
            f"--compare {path}: figures of `python -m tests.bench {saved.subject}`, and this is {subject}"
        )
    return saved


def changes(rows: Sequence[BenchRow], before: Iterable[BenchRow]) -> Mapping[tuple[str, str], float]:
    """By subject and contender what a row has become, as a multiple of what it was: its ratio to a peer where there is
    one, as that does not depend on the machine, else its figure. Rows that are new are not in it."""
    known = {(row.subject, row.contender): row for row in before}
    found: dict[tuple[str, str], float] = {}
    for row in rows:
        old = known.get((row.subject, row.contender))
        if old is None:
            continue
        now, was = (
            (row.value, old.value) if row.ratio is None or old.ratio is None else (row.ratio, old.ratio)
        )
        if was:
            found[row.subject, row.contender] = now / was
    return found
