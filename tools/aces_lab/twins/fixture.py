"""What the fixture `aces_twin` gives: benches that end with their test, and the conversation of a test that fails."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

import pytest

from aces_bus import load_robot
from aces_bus.device import Driver, Robot
from aces_bus.testing.plugin import FAILURES

from .bench import TwinBench, open_bench
from .catalogue import Injection

N = TypeVar("N", int, float)
#: The maker of a test's benches; what it is run under; what its call raised.
MAKER = pytest.StashKey["TwinMaker"]()
INJECTION = pytest.StashKey["Injection | None"]()
RAISED = pytest.StashKey["BaseException | None"]()


class TwinMaker:
    """Makes benches for one test: `aces_twin("odrive", node=3)`, `aces_twin.robot("so101")`."""

    def __init__(self, injection: Injection | None = None) -> None:
        self._injection = injection
        self.benches: list[TwinBench] = []
        self._values = 0

    def __call__(self, driver: str | Driver | Robot, /, **options: Any) -> TwinBench:
        """Return simulated devices, as `aces_bus.twin`; they end with the test."""
        return self._keep(open_bench(driver, injection=self._injection, **options))

    def robot(self, robot: str | Robot, /, **options: Any) -> TwinBench:
        """Return all devices of a robot that is installed, or a file."""
        made = load_robot(robot) if isinstance(robot, str) else robot
        return self._keep(open_bench(made, injection=self._injection, **options))

    def replay(self, recording: str | Path, protocol: str, **options: Any) -> TwinBench:
        """Return a recording of a device as one that answers; its bus's `bitrate`, `baud` and `dialect` may be said."""
        options = {"injection": self._injection, **options}
        return self._keep(open_bench(str(recording), protocol=protocol, **options))

    def _keep(self, bench: TwinBench) -> TwinBench:
        self.benches.append(bench)
        return bench

    def value(self, usual: N, lower: N, upper: N) -> N:
        """Return `usual`; under the fault "values" one that is drawn from `lower` to `upper`: for what a test commands."""
        injection = self._injection
        if injection is None or injection.fault.name != "values":
            return usual
        self._values += 1
        drawn = injection.dice("value", self._values).uniform(lower, upper)
        moved = usual + (drawn - usual) * injection.share
        return type(usual)(round(moved) if isinstance(usual, int) else moved)

    @property
    def answers(self) -> int:
        """Number of answers that the twins have given."""
        return sum(bench.answers for bench in self.benches)

    @property
    def links(self) -> set[str]:
        """The links of its benches."""
        return {line.link for bench in self.benches for line in bench.lines.values()}

    def text(self) -> str:
        """Return the conversations, decoded."""
        return "\n\n".join(f"{bench}\n{bench.text()}" for bench in self.benches)

    def save(self, path: Path) -> list[Path]:
        """Save the conversations as recordings."""
        several = len(self.benches) > 1
        return [
            file
            for number, bench in enumerate(self.benches, 1)
            for file in bench.save(path.with_name(f"{path.name}-{number}") if several else path)
        ]

    def close(self) -> None:
        """End all benches."""
        for bench in self.benches:
            bench.close()


@contextmanager
def maker_of(request: pytest.FixtureRequest) -> Generator[TwinMaker]:
    """Make the fixture of a test; the first of a session has failures reported."""
    plugins = request.config.pluginmanager
    if not plugins.has_plugin("aces_twin_reports"):
        plugins.register(Reports(), "aces_twin_reports")
    maker = request.node.stash[MAKER] = TwinMaker(request.node.stash.get(INJECTION, None))
    try:
        yield maker
    finally:
        maker.close()


class Reports:
    """Adds the conversation to the report of a test that fails."""

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_makereport(
        self, item: pytest.Item, call: pytest.CallInfo[None]
    ) -> Generator[None, Any, Any]:
        """Print the conversation behind the traceback, and save it."""
        report = yield
        maker = item.stash.get(MAKER, None)
        if maker is not None and call.excinfo is not None and call.when != "teardown":
            item.stash[RAISED] = call.excinfo.value
            if report.failed:
                report.sections.append(("what aces_twin and the test said", maker.text()))
                if item.stash.get(INJECTION, None) is None:
                    report.sections.append(("saved", saved(item, maker)))
        return report


def saved(item: Any, maker: TwinMaker, more: str = "") -> str:
    """Save the conversations of a test; return what to do with the files."""
    folder = Path(item.config.getoption("aces_failures", FAILURES))
    name = "".join(c if c.isalnum() or c in "_-." else "_" for c in item.nodeid.rpartition("/")[2]).strip("_")
    files = maker.save(folder / (name + (f"-{more}" if more else "")))
    protocol = next(iter(maker.benches[0].robot.buses.values())).protocol if maker.benches else ""
    return "\n".join(f"aces decode {file} -p {protocol}" for file in files)


__all__ = ["INJECTION", "MAKER", "RAISED", "TwinMaker", "maker_of", "saved"]
