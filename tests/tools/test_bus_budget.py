"""`aces bus budget`: tables, JSON, pictures, statuses; the table in Hubo's README."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from .conftest import Aces

ROOT = Path(__file__).resolve().parents[2]
README = ROOT / "devices" / "aces_devices" / "hubo_motor" / "README.md"


@pytest.mark.slow
def test_the_readme_s_table_is_what_is_printed(aces: Aces) -> None:
    """Hubo 2+ at 200 Hz: status 0, each deadline is kept; the README shows this very text."""
    result = aces("bus", "budget", "hubo2plus")
    assert result.status == 0
    shown = (
        README.read_text(encoding="utf-8").partition("$ aces bus budget hubo2plus\n")[2].partition("```")[0]
    )
    assert result.out == shown


@pytest.mark.slow
def test_a_budget_as_json_and_as_a_picture(aces: Aces, tmp_path: Path) -> None:
    """All numbers, in ns; twice the rate beside; the picture is written, and nothing else is."""
    picture = tmp_path / "budget.png"
    result = aces("bus", "budget", "omnibot", "--json", "-q", "-o", picture)
    assert result.status == 0
    found = json.loads(result.out)
    (bus,) = found["buses"]
    assert (found["robot"], found["ok"], bus["link"], bus["bitrate"]) == ("omnibot", True, "serial", 38_400)
    assert bus["messages"][0]["wire_ns"] * 4 == pytest.approx(bus["round_ns"], abs=8)
    assert found["twice"]["rate_hz"] == 2 * found["rate_hz"]
    assert picture.read_bytes()[:4] == b"\x89PNG"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["budget.png"]


@pytest.mark.slow
def test_a_deadline_that_is_missed_is_status_1(aces: Aces) -> None:
    """It is named, with the time it has; assumptions are options."""
    result = aces("bus", "budget", "omnibot", "--rate", "300", "--all")
    assert result.status == 1
    assert "125% used; a tick is not over within its 3.33 ms" in result.out
    assert "QIK1.SetSpeed" in result.out
    assert "miss their deadlines" in result.out
    result = aces("bus", "budget", "omnibot", "--jitter", "97ms")
    assert result.status == 1


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["omnibott"], "did you mean 'omnibot'"),
        (["omnibot", "rover"], "one too many: rover"),
        (["omnibot", "--queue", "host"], "write NODE=fifo"),
        (["omnibot", "--queue", "hos=fifo"], "hos"),
        (["omnibot", "--errors", "many"], "how many at once"),
        (["omnibot", "-o", "budget.txt"], "suffix"),
        ([], "which robot? aces bus budget NAME"),
    ],
)
def test_a_wrong_call_is_one_line(
    aces: Aces, arguments: list[str], said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Status 2, before anything is computed where that can be."""
    monkeypatch.delenv("ACES_ROBOT", raising=False)
    result = aces("bus", "budget", *arguments)
    assert result.status == 2
    assert said in result.err
    assert len(result.err.splitlines()) == 1
