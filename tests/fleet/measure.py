"""`make fleet`: how fast a fleet is on this machine, beside `aces decode --jobs`; what docs/fleets.md computes with.

1. One and two processes are measured in turns, and the best of each counts: what else the machine does falls on both alike.
2. Processor time is what a machine that others use does not change much.
3. Starts are in no figure: a cluster's workers are there, and `--jobs` forks this process, before it has any thread.
"""

from __future__ import annotations

import os
import resource
import shutil
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

from aces_bus import FrameTable
from aces_bus.recordings.write import open_writer
from aces_lab import fleet
from aces_lab.fleet.cluster import DaskWorkers
from tests.fleet.recordings import frames_of, record, truck

#: Recordings of the measurement of speed, and frames of each; turns.
FILES, FRAMES, TURNS = (int(one) for one in os.environ.get("ACES_FLEET_SIZES", "6,400000,3").split(","))
SMALL = 100


def large(path: Path, number: int, frames: int) -> Path:
    """A recording of so many frames, 5 ms apart or less."""
    table = FrameTable.from_frames(list(frames_of(number, 20_000)))
    span = int(table.time[-1] - table.time[0]) // 10 + 100_000
    first = int(table.time[0])
    table = replace(table, time=first + (table.time - first) // 10)
    with open_writer(path) as writer:
        for place in range(frames // 20_000):
            writer.write(replace(table, time=table.time + place * span))
    return path


def timed(call: Callable[[], object]) -> float:
    """Seconds that a call takes."""
    began = time.perf_counter()
    call()
    return time.perf_counter() - began


def size_of(folder: Path) -> int:
    """Bytes of all parts."""
    return sum(one.stat().st_size for one in folder.rglob("*.parquet") if "_fleet" not in one.parts)


def main() -> None:
    """Print the figures."""
    from aces_tools.main import main as aces

    folder = Path(tempfile.mkdtemp(prefix="aces-fleet-"))
    dbc = truck(folder)
    inputs = [large(folder / f"long-{number}.log", number, FRAMES) for number in range(FILES)]
    total = sum(one.stat().st_size for one in inputs)
    print(f"{os.cpu_count()} processors, load {os.getloadavg()[0]:.1f}; {FILES} logs, {total / 1e6:.0f} MB")
    found: dict[str, list[float]] = {}
    clusters: dict[int, DaskWorkers] = {}
    spent: dict[str, list[float]] = {}

    def cpu() -> float:
        """Seconds of processor time: of this process with the schedulers, and of all workers."""
        return time.process_time() + sum(
            float(seconds)
            for one in clusters.values()
            for seconds in one.client.run(time.process_time).values()
        )

    def with_jobs(number: int) -> None:
        out = folder / "jobs.parquet"
        shutil.rmtree(out, ignore_errors=True)
        aces(["decode", *map(str, inputs), "-p", dbc, "-o", str(out), "-q", "--jobs", str(number)])

    def with_fleet(number: int, files: list[Path]) -> None:
        lake = folder / "lake"
        shutil.rmtree(lake, ignore_errors=True)
        run = fleet.decode([str(one) for one in files], dbc, str(lake), cluster=clusters[number].client)
        assert not run.failed, run.failed[0].faults

    with_jobs(1)  # what is made once is made
    for _ in range(TURNS):
        for number in (1, 2):
            found.setdefault(f"--jobs {number}", []).append(timed(partial(with_jobs, number)))
    clusters |= {number: DaskWorkers(processes=number) for number in (1, 2)}
    for number in clusters:
        with_fleet(number, inputs)  # every worker has loaded the protocol
    for _ in range(TURNS):
        for number in clusters:
            before = cpu()
            found.setdefault(f"local:{number}", []).append(timed(partial(with_fleet, number, inputs)))
            spent.setdefault(f"local:{number}", []).append(cpu() - before)
    best = {name: min(some) for name, some in found.items()}
    for name, seconds in best.items():
        print(f"  {name:9} {seconds:6.2f} s  {total / seconds / 1e6:6.1f} MB/s")
    jobs, ours = best["--jobs 1"] / best["--jobs 2"], best["local:1"] / best["local:2"]
    print(f"  1 to 2: --jobs {jobs:.2f}, fleet {ours:.2f}: {ours / jobs:.2f} of it (wanted: 0.9)")
    small = folder / "small"
    small.mkdir()
    tinies = [record(small, number, 20, ".log") for number in range(SMALL)]
    print(f"  processor time: {', '.join(f'{name} {min(some):.2f} s' for name, some in spent.items())}")
    before = cpu()
    each = min(timed(partial(with_fleet, 1, tinies)) for _ in range(TURNS)) / SMALL * 1e3
    busy = (cpu() - before) / TURNS / SMALL * 1e3
    print(f"  a small input: {each:.0f} ms with one worker, {busy:.0f} ms of processor time (wanted: 50 ms)")
    manifest = folder / "lake" / "_fleet" / "manifest.parquet"
    print(f"  the manifest: {manifest.stat().st_size / SMALL:.0f} bytes an input")
    for one in clusters.values():
        one.close()
    print("one worker, by format:")
    for form in (".log", ".blf", ".mf4"):
        source = large(folder / f"form{form}", 1, FRAMES)
        lake = folder / f"lake{form}"
        fleet.decode(str(tinies[0]), dbc, str(folder / "warm"))
        [entry] = fleet.decode(str(source), dbc, str(lake)).inputs
        print(
            f"  {form:5} {entry.size / entry.seconds / 1e6:6.1f} MB/s  {FRAMES / entry.seconds / 1e6:5.2f} M frames/s"
            f"  parquet {size_of(lake) / entry.size:.2f} of the input"
        )
    print(f"  most memory of the process: {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MB")
    shutil.rmtree(folder)


if __name__ == "__main__":
    main()
