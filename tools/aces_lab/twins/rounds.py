"""`--aces-faults`: a user's own tests, run again under each fault, and which assumption of the program broke.

1. A test is run plainly first; only one that passes is run under faults.
2. Under a fault a test may pass, or end in an error of the program's own (reported as expected); it fails where it takes
   wrong data (an assertion), stumbles (an exception of Python's own, such as IndexError), or does not end.
3. What fails is run again with less of the fault, and reported with the least that still fails.
"""

from __future__ import annotations

import signal
import struct
import threading
import time
from collections import Counter
from collections.abc import Generator
from dataclasses import dataclass, field
from typing import Any, Self

import pytest
from _pytest.outcomes import Failed
from _pytest.reports import TestReport
from _pytest.runner import runtestprotocol

from .catalogue import CATALOGUE, Fault, Injection, chosen, injections, smaller
from .fixture import INJECTION, MAKER, RAISED, TwinMaker, saved

#: What Python raises itself: who ends so did not expect what came.
STUMBLES: frozenset[type[BaseException]] = frozenset(
    {
        *(AttributeError, IndexError, KeyError, NameError, OverflowError, TypeError, UnboundLocalError),
        *(UnicodeDecodeError, ZeroDivisionError, struct.error),
    }
)
#: How long one failing test may be run again for less (s).
SHRINK_S = 30.0


class Hang(Failed):
    """A test under a fault that did not end in time."""


@dataclass
class FaultRun:
    """One run of a test: its reports, its conversation, and what came of it."""

    reports: list[TestReport]
    maker: TwinMaker | None
    raised: BaseException | None
    seconds: float

    @property
    def outcome(self) -> str:
        """Return "passes", "skips", "refuses", "takes wrong data", "stumbles" or "hangs"."""
        error = self.raised
        if not any(report.failed for report in self.reports):
            return "skips" if any(report.skipped for report in self.reports) else "passes"
        if isinstance(error, Hang):
            return "hangs"
        if error is None or isinstance(error, (AssertionError, Failed)):
            return "takes wrong data"
        return "stumbles" if type(error) in STUMBLES else "refuses"

    def is_wrong(self, injection: Injection, survives: frozenset[str]) -> bool:
        """Return whether the program may not do this under the fault."""
        may = "pass" if injection.fault.name in survives else injection.fault.may
        match self.outcome:
            case "passes" | "skips":
                return False
            case "hangs":
                return True
            case "refuses":
                return may == "pass"
            case _:
                return may != "end"


@dataclass
class FaultRounds:
    """Runs tests that use `aces_twin` under faults."""

    faults: list[Fault]
    seed: int
    places: int
    patience_s: float
    counts: Counter[str] = field(default_factory=Counter[str])
    broken: list[str] = field(default_factory=list[str])

    @classmethod
    def of(cls, names: str, config: Any) -> Self:
        """Return what `--aces-faults NAMES` asks for. Raises `pytest.UsageError`, also for `help`, with the catalogue."""
        if names == "help":
            lines = [f"  {f.name:13} {f.what}; breaks: {f.assumption}" for f in CATALOGUE.values()]
            raise pytest.UsageError("\n".join(["--aces-faults takes all, or of these:", *lines]))
        try:
            faults = chosen(names)
        except LookupError as error:
            raise pytest.UsageError(str(error)) from None
        option = config.getoption
        return cls(faults, option("aces_seed"), option("aces_places"), option("aces_patience"))

    # ------------------------------------------------------------------ running

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_protocol(self, item: pytest.Item, nextitem: pytest.Item) -> bool | None:
        """Run a test that uses the fixture plainly, then under each fault."""
        if "aces_twin" not in getattr(item, "fixturenames", ()):
            return None
        item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
        plain = self._run(item, nextitem, None)
        for report in plain.reports:
            item.ihook.pytest_runtest_logreport(report=report)
        if plain.outcome == "passes" and plain.maker is not None and plain.maker.benches:
            self._under_faults(item, nextitem, plain, plain.maker)
        item.ihook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
        return True

    def _run(self, item: Any, nextitem: pytest.Item, injection: Injection | None) -> FaultRun:
        for key in (MAKER, RAISED):
            if key in item.stash:
                del item.stash[key]
        item.stash[INJECTION] = injection
        if hasattr(item, "_request"):
            item._initrequest()
        began = time.monotonic()
        reports = runtestprotocol(item, log=False, nextitem=nextitem)
        raised = item.stash.get(RAISED, None)
        return FaultRun(reports, item.stash.get(MAKER, None), raised, time.monotonic() - began)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_call(self, item: pytest.Item) -> Generator[None, Any, Any]:
        """End a test that hangs under a fault."""
        can_end = hasattr(signal, "setitimer") and threading.current_thread() is threading.main_thread()
        if item.stash.get(INJECTION, None) is None or not can_end:
            return (yield)

        def end(*_: object) -> None:
            raise Hang(f"it has not ended within {self.patience_s:g} s")

        before = signal.signal(signal.SIGALRM, end)
        signal.setitimer(signal.ITIMER_REAL, self.patience_s, 1.0)
        try:
            return (yield)
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0)
            signal.signal(signal.SIGALRM, before)

    def _under_faults(
        self, item: pytest.Item, nextitem: pytest.Item, plain: FaultRun, maker: TwinMaker
    ) -> None:
        said: set[str] = set()
        left: set[str] = set()
        for mark in item.iter_markers("aces_faults"):
            said.update(mark.kwargs.get("survives", ()))
            left.update(mark.kwargs.get("without", ()))
        survives = frozenset(said)
        done: set[str] = set()
        faults = [fault for fault in self.faults if fault.name not in left]
        for injection in injections(
            faults, maker.answers, sorted(maker.links), most=self.places, seed=self.seed
        ):
            if injection.fault.name in done:
                continue
            run = self._run(item, nextitem, injection)
            if not run.is_wrong(injection, survives):
                self._report(item, injection, run)
                continue
            done.add(injection.fault.name)  # its other places would say the same
            injection, run = self._least(item, nextitem, injection, run, survives, maker.answers)
            self._report_broken(item, injection, run)

    def _least(
        self,
        item: pytest.Item,
        nextitem: pytest.Item,
        injection: Injection,
        run: FaultRun,
        survives: frozenset[str],
        answers: int,
    ) -> tuple[Injection, FaultRun]:
        """Return the least of a fault under which the test still does the same wrong thing, and that run."""
        end = time.monotonic() + SHRINK_S
        for less in smaller(injection, answers):
            if time.monotonic() > end:
                break
            again = self._run(item, nextitem, less)
            if again.is_wrong(less, survives) and again.outcome == run.outcome:
                return less, again
        return injection, run

    # ------------------------------------------------------------------ reporting

    def _report(self, item: pytest.Item, injection: Injection, run: FaultRun) -> None:
        report = _report_of(item, injection, "passed" if run.outcome == "passes" else "skipped", None)
        outcome = run.outcome
        if run.outcome != "passes":
            outcome = (
                f"{run.outcome} ({type(run.raised).__name__})" if run.raised is not None else run.outcome
            )
            report.wasxfail = f"{injection.fault.name}: {outcome}"
            report.longrepr = (str(item.path), item.location[1] or 0, outcome)
        report.user_properties.append(("aces_fault", (injection.fault.name, outcome, "")))
        item.ihook.pytest_runtest_logreport(report=report)

    def _report_broken(self, item: pytest.Item, injection: Injection, run: FaultRun) -> None:
        failed = next(report for report in run.reports if report.failed)
        report = _report_of(item, injection, "failed", failed.longrepr)
        fault = injection.fault
        error = (
            f": {type(run.raised).__name__}: {run.raised}".splitlines()[0] if run.raised is not None else ""
        )
        text = (
            f"{injection}\nit {run.outcome}{error}\nthe assumption that broke: {fault.assumption}\n"
            f"again: --aces-faults {fault.name} --aces-seed {injection.seed}"
        )
        report.sections = [("aces_twin: which assumption broke", text), *failed.sections]
        if run.maker is not None:
            report.sections.append(("saved", saved(item, run.maker, fault.name)))
        line = f"{item.nodeid}: {fault.name}: it {run.outcome}; assumed: {fault.assumption}"
        report.user_properties.append(("aces_fault", (fault.name, run.outcome, line)))
        item.ihook.pytest_runtest_logreport(report=report)

    def pytest_runtest_logreport(self, report: Any) -> None:
        """Count what came of each run, also of other processes' runs."""
        for name, value in report.user_properties:
            if name == "aces_fault":
                _, outcome, line = value
                self.counts[outcome] += 1
                if line:
                    self.broken.append(line)

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        """Say what the program did under faults, and which assumptions broke."""
        if not self.counts:
            return
        terminalreporter.section("under faults")
        runs = ", ".join(f"{outcome} {count} times" for outcome, count in sorted(self.counts.items()))
        terminalreporter.write_line(f"{sum(self.counts.values())} runs: {runs}")
        for line in self.broken:
            terminalreporter.write_line(line)


def _report_of(item: pytest.Item, injection: Injection, outcome: Any, longrepr: Any) -> TestReport:
    file, line, domain = item.location
    where = f"{injection.fault.name}{'' if injection.hits is None else ''.join(f'-{n + 1}' for n in sorted(injection.hits))}"
    return TestReport(
        f"{item.nodeid}[{where}]",
        (file, line, f"{domain}[{where}]"),
        {item.name: 1},
        outcome,
        longrepr,
        "call",
    )


__all__ = ["FaultRounds", "FaultRun", "Hang"]
