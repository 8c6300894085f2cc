"""`make test-steady`: the same tests give the same counts, whatever the hash seed and however busy the machine is.

1. Each run has a PYTHONHASHSEED and a threshold of the garbage collector of its own; every third runs beside two busy loops.
2. A line a run: hash seed, threshold, load, seconds, counts. The end is status 1 when a run failed or counted otherwise than
   the first.
"""

from __future__ import annotations

import argparse
import os
import random
import re
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
#: Ends by itself when the run that started it is gone.
BUSY = "import os\nparent = os.getppid()\nwhile os.getppid() == parent:\n    sum(range(100_000))\n"
COUNT = re.compile(r"(\d+) (passed|failed|skipped|deselected|xfailed|xpassed|errors?)\b")


def counts_of(output: str) -> dict[str, int]:
    """What pytest counted, from its last line: `{"passed": 8814, "skipped": 132}`. Empty when there is none."""
    for line in reversed(output.splitlines()):
        if found := COUNT.findall(line):
            return {what: int(number) for number, what in found}
    return {}


def threshold_of(seed: int) -> int:
    """Return how many new objects start a collection in this run: few, or very many, so that it happens elsewhere."""
    return round(10 ** random.Random(seed).uniform(2.5, 5))


def run(seed: int, busy: bool, command: list[str]) -> tuple[int, str]:
    """Status and output of the tests under a hash seed and its threshold, beside two busy loops or alone."""
    loops = [subprocess.Popen([sys.executable, "-c", BUSY]) for _ in range(2 if busy else 0)]
    try:
        done = subprocess.run(
            command,
            cwd=ROOT,
            env={**os.environ, "PYTHONHASHSEED": str(seed), "ACES_GC": str(threshold_of(seed))},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
        )
    finally:
        for loop in loops:
            loop.kill()
            loop.wait()
    return done.returncode, done.stdout


def main() -> int:
    """Run the tests so many times; 0 when all were green with the same counts."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--runs", type=int, default=20, metavar="N", help="how many runs (default: 20)")
    parser.add_argument("--jobs", default="2", metavar="N", help="processes a run (default: 2)")
    parser.add_argument("rest", nargs="*", help="what else pytest is told, behind --")
    arguments = parser.parse_args()
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-n",
        arguments.jobs,
        "--benchmark-disable",
        "-q",
        *arguments.rest,
    ]
    first: dict[str, int] = {}
    bad = 0
    for number in range(arguments.runs):
        busy = number % 3 == 2
        began = time.monotonic()
        status, output = run(number, busy, command)
        counts = counts_of(output)
        first = first or counts
        is_good = status == 0 and counts == first
        bad += not is_good
        said = ", ".join(f"{number} {what}" for what, number in counts.items()) or "no counts"
        seconds = time.monotonic() - began
        load = f"gc threshold {threshold_of(number)}, {'beside two busy loops' if busy else 'alone'}"
        print(
            f"hash seed {number:2}, {load}: {said} in {seconds:.0f} s{'' if is_good else '  <-- differs'}",
            flush=True,
        )
        if not is_good:
            print(output[-20_000:], flush=True)
    print(f"{arguments.runs - bad} of {arguments.runs} runs green with the same counts")
    return 1 if bad else 0


if __name__ == "__main__":
    raise SystemExit(main())
