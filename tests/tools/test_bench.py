"""`python -m tests.bench`: what is saved and compared, and lines beside a peer; figures themselves are of the machine."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path

import pytest

from tests.bench import __main__ as command
from tests.bench import control, text, transports
from tests.bench.rows import BenchRow
from tests.bench.saved import this_machine
from tests.tools.conftest import Aces, Result


@pytest.fixture
def bench(capsys: pytest.CaptureFixture[str]) -> Aces:
    """`bench("control", …)` measures in this process."""

    def run(*arguments: str | Path) -> Result:
        capsys.readouterr()
        try:
            status = command.main([str(argument) for argument in arguments])
        except SystemExit as ended:
            status = int(ended.code or 0)
        out, err = capsys.readouterr()
        return Result(status, out, err)

    return run


@pytest.fixture
def figures(monkeypatch: pytest.MonkeyPatch) -> dict[str, float]:
    """What `python -m tests.bench control` measures: a figure, and a ratio to a peer."""
    made = {"figure": 10.0, "ratio": 2.0}

    def run(*, quick: bool) -> Iterable[BenchRow]:
        yield BenchRow("filters", "ours", made["figure"], "µs", made["ratio"], "≥ 2 ×", made["ratio"] >= 2)
        yield BenchRow("filters", "plain", made["figure"], "µs")

    monkeypatch.setattr(control, "run", run)
    return made


def test_what_has_changed_since_an_earlier_run(
    figures: dict[str, float], bench: Aces, tmp_path: Path
) -> None:
    """Where there is a ratio, that is compared, as it does not depend on the machine; else the figure."""
    saved = tmp_path / "before.json"
    first = bench("control", "--save", saved)
    assert (first.status, "change" in first.out) == (0, False)
    figures.update(figure=5.0, ratio=3.0)
    rows = bench("control", "--compare", saved, "--json").objects
    assert [(row["contender"], row["change"]) for row in rows] == [("ours", 1.5), ("plain", 0.5)]
    table = bench("control", "--compare", saved)
    assert "1.50 ×" in table.out
    assert "0.50 ×" in table.out
    assert "compared with" in table.err


def test_each_run_says_of_which_machine_it_is(figures: dict[str, float], bench: Aces, tmp_path: Path) -> None:
    """Processor, cores, Python, versions and load, beside the figures and in the file."""
    saved = tmp_path / "figures.json"
    done = bench("control", "--save", saved)
    machine = json.loads(saved.read_text())["machine"]
    assert machine["cores"] == this_machine().cores
    for part in (machine["cpu"], machine["python"], f"{machine['cores']} cores", "numpy", "python-can"):
        assert part in done.err


def test_figures_of_something_else_are_refused(
    figures: dict[str, float], bench: Aces, tmp_path: Path
) -> None:
    """A file that is not there, is not figures, or is of another benchmark: said before anything is measured."""
    saved, other = tmp_path / "figures.json", tmp_path / "notes.txt"
    assert bench("control", "--save", saved).status == 0
    other.write_text("nothing")
    for subject, path, why in (
        ("control", tmp_path / "none", "No such file"),
        ("control", other, "not figures that --save has written"),
        ("bus", saved, "figures of `python -m tests.bench control`"),
    ):
        done = bench(subject, "--compare", path)
        assert (done.status, why in done.err) == (2, True)


@pytest.mark.long
def test_lines_are_measured_beside_a_peer() -> None:
    """Whole commands read the same log, each of the three formats has a row, and the peer one where it is installed."""
    pytest.importorskip("cantools")
    rows = list(text.run(quick=True, frames=100))
    assert [row.contender.split()[-1] for row in rows] == ["text", "jsonl", "csv", "--single-line"]
    assert all(row.value > 0 for row in rows)
    assert [row.ratio is not None for row in rows] == [True, True, True, False]


def test_loops_with_accounts_have_those_of_columns() -> None:
    """What columns of packets are measured beside: the same counts on frames that are lost, late and doubled."""
    by_hand = transports.IsoTpAccounts()
    for make in (
        transports.isotp,
        transports.fast_packets,
        transports.parameter_groups,
        transports.transfers,
    ):
        protocol, senders = make()
        peers = [protocol.scanner(), *([by_hand] if make is transports.isotp else [])]
        transports.accounts(protocol, transports.taking_turns(senders), peers)
    reasons = {reason for _, reason in by_hand.losses}
    assert {"repeated", "no first frame", "restarted", "timed out", "frame 3 missing"} <= reasons


@pytest.mark.parametrize("frames", ["0", "-5"])
def test_a_benchmark_needs_frames(bench: Aces, frames: str) -> None:
    """With too few it would never end, or end in a traceback."""
    result = bench("columns", "--frames", frames)
    assert result.status == 2
    assert f"--frames: '{frames}' is not a whole number from 100 on" in result.err
