"""`python -m tests.bench control`: contenders do the same work, and rows say what they should."""

from __future__ import annotations

import pytest

from tests.bench import control


@pytest.mark.slow
def test_contenders_agree() -> None:
    """The peers of a subject give the value that the states give."""
    _, peer, _, newest = control.values()
    assert {call() for call in newest.values()} == {newest[peer]()}
    _, peer, _, inside = control.control_between()
    assert inside["omega[-1.2345], linear"]() == pytest.approx(inside[peer]())
    assert inside["omega[-1.2345], cubic"]() == pytest.approx(inside[peer](), abs=1e-3)
    subjects = control.made_of, control.samples, control.filters, control.trajectories, control.laws
    for _, _, _, contenders in (subject() for subject in subjects):
        for call in contenders.values():
            call()


@pytest.mark.slow
def test_rows_have_targets_and_ratios(monkeypatch: pytest.MonkeyPatch) -> None:
    """A contender of ours has the target and, where the peer does the same work, a ratio; a peer has neither."""
    monkeypatch.setattr(control, "fastest", lambda loops, rounds: dict.fromkeys(loops, 0.001))
    monkeypatch.setattr(control, "_turns", lambda call, most: most)
    rows = {row.contender: row for row in control.run(quick=True)}
    assert rows["omega[0]"].target == "≤ 300 ns"
    assert (rows["omega[0]"].value, rows["omega[0]"].ratio, rows["omega[0]"].is_met) == (500.0, 1.0, False)
    assert rows["omega[-1.2345], linear"].target == "≤ 3,000 ns"
    assert rows["push"].target == "≤ 1,000 ns"
    assert rows["second order"].target == "≤ 2,000 ns"
    assert rows["median of 15"].ratio is None
    assert rows["PID with limits and filter"].target == "≤ 3,000 ns"
    assert (rows["deque.append"].target, rows["deque.append"].ratio) == ("", None)
