"""What `python -m tests.bench` measures, one file a subject. Figures are ratios to peers in the same run."""

from __future__ import annotations

import gc
import importlib
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from time import perf_counter_ns, process_time_ns
from typing import Any


@dataclass(frozen=True)
class BenchRow:
    """One line of a result: a contender, its cost and what it is compared with."""

    subject: str
    contender: str
    value: float
    unit: str
    ratio: float | None = None
    target: str = ""
    is_met: bool | None = None


def fastest(
    contenders: Mapping[str, Callable[[], object]], *, rounds: int, one_thread: bool = False
) -> dict[str, float]:
    """Seconds of each contender's fastest round; they take turns, so that drift hits all alike.

    `one_thread` says that all of them work on one thread: then it is processor time, which other programs do not lengthen.
    """
    clock = process_time_ns if one_thread else perf_counter_ns
    best = dict.fromkeys(contenders, float("inf"))
    for _ in range(rounds):
        for name, run in contenders.items():
            gc.collect()
            start = clock()
            run()
            best[name] = min(best[name], (clock() - start) / 1e9)
    return best


def optional(module: str) -> Any:
    """A peer library, or None when it is not installed."""
    known: Any = sys.modules.get(module, module)
    if known is None:
        del sys.modules[module]  # hidden at the start, as only benchmarks want it
    try:
        return importlib.import_module(module)
    except ImportError:
        return None


__all__ = ["BenchRow", "fastest", "optional"]
