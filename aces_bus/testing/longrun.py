"""All laws on one protocol for a long time: `python -m aces_bus.testing.longrun NAME --examples 200000 --jobs 2`.

1. The examples are Hypothesis's, shared evenly among the laws and the protocol's dialects, configurations and directions.
2. A failure is shrunk and printed with the scene that repeats it; the exit code is then 1.

NAME is a registered protocol, or `module:attribute`.
"""

from __future__ import annotations

import argparse
import importlib
import sys
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

try:
    from hypothesis import HealthCheck, Phase, given, seed, settings
except ImportError as missing:
    raise ImportError(
        "aces_bus.testing.longrun needs Hypothesis: pip install 'aces-bus[testing]'"
    ) from missing

from ..errors import AcesError, CallerError
from ..protocol import Protocol, load_protocol
from . import laws, strategies

#: Examples in one go: Hypothesis remembers each example of a run, and a worker should report now and then.
BATCH = 1000


@dataclass(frozen=True)
class Task:
    """Some examples of one law on one wire of a protocol."""

    protocol: str
    wire: int
    law: int
    examples: int
    size: int
    seed: int


@lru_cache(maxsize=8)
def find(name: str) -> Protocol:
    """The protocol `name`: registered, or `module:attribute`. Raises `CallerError` when there is none."""
    if ":" not in name:
        return load_protocol(name)
    module, _, attribute = name.partition(":")
    found = getattr(importlib.import_module(module), attribute, None)
    if not isinstance(found, Protocol):
        raise CallerError(f"{name} is not a Protocol")
    return found


def tasks(name: str, *, examples: int, size: int, first_seed: int, only: Sequence[int] = ()) -> list[Task]:
    """The work, in batches, wires and laws taking turns."""
    wires = laws.wires(find(name))
    places = [
        (wire, law.number)
        for wire, (variant, _) in enumerate(wires)
        for law in laws.LAWS
        if (not only or law.number in only) and not (law.streams_only and variant.link == "can")
    ]
    left = {place: examples // len(places) + (i < examples % len(places)) for i, place in enumerate(places)}
    return list(_batches(name, left, size, first_seed))


def _batches(name: str, left: dict[tuple[int, int], int], size: int, first_seed: int) -> Iterator[Task]:
    number = first_seed
    while left:
        for (wire, law), count in list(left.items()):
            batch = min(BATCH, count)
            if batch:
                yield Task(name, wire, law, batch, size, number)
            number += 1
            left[wire, law] -= batch
            if not left[wire, law]:
                del left[wire, law]


def run(task: Task) -> tuple[Task, int, str]:
    """Run a task: (task, examples run, what failed)."""
    variant, direction = laws.wires(find(task.protocol))[task.wire]
    law = laws.LAWS[task.law - 1]
    done = 0

    @seed(task.seed)
    @settings(
        max_examples=task.examples,
        database=None,
        deadline=None,
        suppress_health_check=(HealthCheck.too_slow, HealthCheck.data_too_large),
        phases=(Phase.generate, Phase.shrink),
        print_blob=False,
    )
    @given(strategies.arguments(law, variant, direction, size=task.size))
    def holds(arguments: tuple[Any, ...]) -> None:
        nonlocal done
        done += 1
        law.holds(variant, direction, *arguments)

    try:
        holds()
    except Exception as error:  # whatever a law or the core raises is what we look for
        return task, done, f"{type(error).__name__}: {error} (seed {task.seed})"
    return task, done, ""


def main(arguments: Sequence[str] | None = None) -> int:
    """The command; gives its exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m aces_bus.testing.longrun", description="All laws on one protocol, for a long time."
    )
    parser.add_argument("name", help="a registered protocol, or module:attribute")
    parser.add_argument("--examples", type=int, default=200_000, help="in total (default: %(default)s)")
    parser.add_argument("--jobs", type=int, default=2, help="processes (default: %(default)s)")
    parser.add_argument("--size", type=int, default=160, help="of a scene, in bytes or sixteenths of a frame")
    parser.add_argument("--seed", type=int, default=None, help="of the first batch (default: the time)")
    parser.add_argument("--law", type=int, action="append", default=[], help="only this law; may be repeated")
    asked = parser.parse_args(arguments)
    first_seed = asked.seed if asked.seed is not None else time.time_ns() % 1_000_000_000
    try:
        work = tasks(
            asked.name, examples=asked.examples, size=asked.size, first_seed=first_seed, only=asked.law
        )
    except (AcesError, ImportError) as error:
        print(error, file=sys.stderr)
        return 2
    started = time.monotonic()
    done = 0
    failures: list[str] = []
    with ProcessPoolExecutor(asked.jobs) as pool:
        for finished in as_completed([pool.submit(run, task) for task in work]):
            task, count, problem = finished.result()
            done += count
            if problem:
                failures.append(problem)
                print(f"law {task.law}: {problem}\n", flush=True)
            passed = time.monotonic() - started
            if sys.stderr.isatty():
                print(f"\r{done} examples, {done / passed:.0f}/s ", end="", file=sys.stderr, flush=True)
    passed = time.monotonic() - started
    result = f"{len(failures)} failures" if failures else "no failure"
    print(
        f"{asked.name}: {done} examples in {passed:.0f} s ({done / passed:.0f}/s), first seed {first_seed}: {result}"
    )
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
