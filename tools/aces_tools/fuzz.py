"""Search for a stream that breaks a protocol: nine laws on generated input.

  aces fuzz robotis
  aces fuzz my_spec.py --for 10min --jobs 2
  aces fuzz hubo --law oracle --law 3 --seed 7 --examples 100000
  aces fuzz my_spec.py --corpus fuzz/ --json

Each example is a scene: valid packets, damaged ones, garbage, silences, our own
requests, cut into chunks. All laws (docs/fuzzing.md) are tried on it. A scene
that breaks one is reduced to the smallest that does, drawn, and saved.
"""

from __future__ import annotations

import argparse
import os
import time
from collections import Counter
from collections.abc import Generator, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from itertools import islice
from typing import TYPE_CHECKING

from aces_bus.errors import CallerError

from .console import StatusLine, say, terminal_width
from .options import FOR, JOBS, JSON, QUIET, Arguments, Group, argument, at_least, several

if TYPE_CHECKING:
    from aces_bus.testing.coverage import Coverage

    from .fuzz_work import FoundFailure, FuzzJob, FuzzTask, TaskResult

#: Examples when neither a number nor a time is given.
EXAMPLES = 20_000
#: Examples in one task: a worker reports several times a second.
TASK = 128
#: Seconds between two looks at the progress on a terminal, and in a log.
STEP_S, LOG_S = 0.25, 30.0

SUMMARY = "search for a stream that breaks a protocol: laws and coverage"

EPILOG = """\
laws (--law takes a number or a name, several times):
  1 round trip         what is built is read again, bit for bit
  2 oracle             the generated scanner, the columns and construct agree
  3 chunking           records do not depend on how the bytes were cut
  4 resynchronisation  no whole packet is missed, whatever comes before it
  5 no false accept    every record satisfies its template and its check
  6 accounting         every byte and frame ends in exactly one bin
  7 bounded            memory and work stay within their limits
  8 calm               nothing raises an exception
  9 unambiguous        no two messages accept the same packet

A NAME alone is fuzzed in all its dialects, configurations and directions;
hubo:D08 and hubo@drc_hubo only there. Several NAMEs take turns.

again:
  Every example follows from the seed and its number: --seed 7:4130 is example
  4130 of seed 7, alone. --replay FILE tries the laws on a saved scene (.json)
  or on any recording. A corpus keeps scenes that reached something new and
  those that failed; they are judged first the next time.

exit status:
  0    the laws hold
  1    a law does not
  2    a wrong call, or a protocol that cannot be loaded
  130  after Ctrl-C, when no law had failed
"""


ARGUMENTS: Arguments = (
    argument(
        "names", nargs="+", metavar="NAME", help="a protocol as -p takes it: installed, my_spec.py, car.dbc"
    ),
    several("--law", metavar="LAW", help="only this law; may be given several times"),
    Group(
        "how much",
        (
            argument(
                "--examples",
                type=at_least(0),
                metavar="N",
                help=f"how many scenes (default: {EXAMPLES:,}; 0: the corpus only)",
            ),
            FOR.but(help="for this time instead: 10min"),
        ),
        is_exclusive=True,
    ),
    argument(
        "--seed",
        metavar="S[:N]",
        help="begin with this seed (default: another each time); :N that example alone",
    ),
    argument("--corpus", metavar="DIR", help="judge the scenes in DIR first, and keep new ones there"),
    several("--replay", metavar="FILE", help="judge this scene or recording, nothing else"),
    argument(
        "--failures",
        metavar="DIR",
        default=os.path.join(".aces", "failures"),
        help="where to save what fails (default: %(default)s)",
    ),
    argument(
        "--most",
        type=at_least(1),
        default=3,
        metavar="N",
        help="stop after this many failures (default: %(default)s); each law of a protocol fails once",
    ),
    JOBS,
    JSON,
    QUIET.but(help="no progress, no table; failures and the summary"),
)


def run(arguments: argparse.Namespace) -> int:
    from .fuzz_work import FuzzJob, as_json, chosen_laws, coverage_table, failure_text

    seed, only = _seed(arguments.seed)
    job = FuzzJob(
        names=tuple(arguments.names),
        laws=chosen_laws(arguments.law),
        seed=seed,
        failures=arguments.failures,
        most=arguments.most,
        corpus=arguments.corpus,
    )
    jobs = arguments.jobs or os.cpu_count() or 1
    budget = _Budget(arguments, only)
    tally = Tally(arguments, job)
    is_over = False
    try:
        for done in _all(job, budget, jobs):
            for found in tally.add(done):
                if not arguments.json:
                    tally.status_line.clear()
                    print(failure_text(found), flush=True)
            # A law that has failed on a protocol is not asked there again: in the end there is none left to ask.
            if len(tally.found) >= min(arguments.most, len(job.laws) * len(job.names)):
                break
            tally.show(budget)
    except KeyboardInterrupt:
        is_over = True
    tally.status_line.clear()
    numbers = tally.numbers(is_over)
    if arguments.json:
        print(as_json(job.names, numbers, tally.found, tally.coverage()))
    elif tally.examples and not arguments.quiet and not budget.is_single:
        print(coverage_table(tally.coverage(), terminal_width()))
    say(tally.summary(is_over), who="")
    return 1 if tally.found else 130 if is_over else 0


def _seed(text: str | None) -> tuple[int, int | None]:
    if text is None:
        return time.time_ns() // 1_000_000 % 1_000_000, None
    seed, colon, number = text.partition(":")
    try:
        found = int(seed), int(number) if colon else None
    except ValueError:
        raise CallerError(f"--seed {text}: a number, or SEED:EXAMPLE as a failure names it") from None
    if found[1] is not None and found[1] < 0:
        raise CallerError(f"--seed {text}: examples count from 0")
    return found


class _Budget:
    """What there is to do: tasks, until the examples or the time are used up."""

    def __init__(self, arguments: argparse.Namespace, only: int | None) -> None:
        self.only = only
        self.files = tuple(arguments.replay)
        self.is_single = only is not None or bool(self.files)
        self.seconds: float | None = arguments.duration / 1e9 if arguments.duration else None
        self.examples = EXAMPLES if arguments.examples is None else int(arguments.examples)
        self.began = time.monotonic()

    def tasks(self) -> Iterator[FuzzTask]:
        """Yield the tasks, for as long as there is something to do."""
        from .fuzz_work import FuzzTask

        if self.only is not None:
            yield FuzzTask(self.only, 1)
            return
        if self.files or not self.examples:
            yield FuzzTask(files=self.files)
            return
        at = 0
        while self.seconds is not None or at < self.examples:
            if self.seconds is not None and time.monotonic() - self.began > self.seconds:
                return
            count = TASK if self.seconds is not None else min(TASK, self.examples - at)
            yield FuzzTask(at, count)
            at += count

    def part(self, examples: int) -> float:
        """Return how much of it is done."""
        if self.seconds is not None:
            return min(1.0, (time.monotonic() - self.began) / self.seconds)
        return min(1.0, examples / max(1, self.examples))


def _all(job: FuzzJob, budget: _Budget, jobs: int) -> Generator[TaskResult, None, None]:
    """Yield what each task did, as they finish."""
    from .fuzz_work import ignore_interrupts, places, work, worker_of

    for name in job.names:
        places(name)  # complains here, and not in another process
    worker_of.cache_clear()  # an earlier run in this process is none of ours, nor of the processes that we start
    if jobs == 1 or budget.is_single:
        for task in budget.tasks():
            yield work(job, task)
        return
    pool = ProcessPoolExecutor(jobs, initializer=ignore_interrupts)
    try:
        waiting: set[Future[TaskResult]] = set()
        tasks = budget.tasks()
        while True:
            waiting |= {pool.submit(work, job, task) for task in islice(tasks, 2 * jobs - len(waiting))}
            if not waiting:
                return
            finished, waiting = wait(waiting, return_when=FIRST_COMPLETED)
            yield from (future.result() for future in finished)
    finally:  # what waits is dropped, what runs is a fraction of a second
        pool.shutdown(wait=True, cancel_futures=True)


class Tally:
    """What all processes did so far, and how it is shown while it goes on."""

    def __init__(self, arguments: argparse.Namespace, job: FuzzJob) -> None:
        self.job = job
        self.began = time.monotonic()
        self.examples = self.checks = self.bytes_and_frames = 0
        self.found: list[FoundFailure] = []
        self._latest: dict[int, TaskResult] = {}
        self._is_shown = not arguments.quiet and not arguments.json
        self.status_line = StatusLine()
        self._step_s = STEP_S if self.status_line.is_shown else LOG_S
        self._next = self.began + self._step_s

    def add(self, done: TaskResult) -> list[FoundFailure]:
        """Count what a task did; gives the failures that are new."""
        self.examples += done.examples
        self.checks += done.checks
        self.bytes_and_frames += done.bytes_and_frames
        last = self._latest.get(done.process)
        if last is None or last.turn < done.turn:  # they may come out of order
            self._latest[done.process] = done
        known = {(f.law, f.protocol) for f in self.found}
        fresh = [f for f in done.found if (f.law, f.protocol) not in known]
        self.found += fresh
        return fresh

    @property
    def seconds(self) -> float:
        return max(1e-3, time.monotonic() - self.began)

    @property
    def rate(self) -> float:
        """Examples per minute."""
        return 60 * self.examples / self.seconds

    def coverage(self) -> Coverage:
        """Return what was reached, by all processes."""
        from aces_bus.testing.coverage import Coverage

        whole = Coverage()
        for done in self._latest.values():
            whole.reached += Counter(done.reached)
            whole.expected |= done.expected
        return whole

    def show(self, budget: _Budget) -> None:
        """Say how far we are, when it is time."""
        now = time.monotonic()
        if not self._is_shown or now < self._next:
            return
        coverage = self.coverage()
        reached = len(coverage.expected & coverage.reached.keys()) / max(1, len(coverage.expected))
        line = (
            f"{budget.part(self.examples):4.0%}  {self.examples:,} examples  {self.rate:,.0f}/min  "
            f"{reached:.0%} reached  {len(self.found)} failed"
        )
        self._next = now + self._step_s
        if self.status_line.is_shown:
            self.status_line.show(line)
        else:
            say(line, who="")

    def numbers(self, is_over: bool) -> dict[str, object]:
        """Return the run in numbers."""
        return {
            "seed": self.job.seed,
            "laws": list(self.job.laws),
            "examples": self.examples,
            "checks": self.checks,
            "bytes_and_frames": self.bytes_and_frames,
            "seconds": round(self.seconds, 3),
            "examples_per_minute": round(self.rate),
            "interrupted": is_over,
        }

    def summary(self, is_over: bool) -> str:
        """Return the run in one line."""
        failed = f"{len(self.found)} failed" if self.found else "no failure"
        kept = sum(done.kept for done in self._latest.values())
        return (
            f"{'interrupted: ' if is_over else ''}examples={self.examples} checks={self.checks} "
            f"bytes_and_frames={self.bytes_and_frames} "
            f"seconds={self.seconds:.1f} rate={self.rate:.0f}/min seed={self.job.seed}"
            + (f" kept={kept}" if self.job.corpus is not None else "")
            + f": {failed}"
        )
