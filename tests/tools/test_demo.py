"""`aces demo`: a simulated robot moves, and it is drawn."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from aces_tools import demo
from tests.tools.conftest import Aces


@pytest.fixture
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    """One little knee bend, of a robot that has only the boards of hips, knees and ankles."""
    import aces_bus

    whole = aces_bus.load_robot(demo.ROBOT)
    used = {whole.joints[name].device for name in demo.knee_bends().names}
    devices = {name: replace(one, active=name in used) for name, one in whole.devices.items()}
    monkeypatch.setattr(aces_bus, "load_robot", lambda name: replace(whole, devices=devices))
    monkeypatch.setattr(demo, "BENDS", (0.0, 0.1, 0.0))
    monkeypatch.setattr(demo, "MOVE_S", 0.35)


def test_the_knees_are_bent_within_limits() -> None:
    """The trajectory keeps the trunk upright, the joints' limits, and ends where it began."""
    path = demo.knee_bends()
    times = np.linspace(0, path.duration_s, 500)
    rows = np.array([path.at(t) for t in times])
    knee, hip, ankle = (rows[:, path.names.index(name)] for name in ("RKN", "RHP", "RAP"))
    assert np.allclose(hip + knee + ankle, 0)
    assert (knee.min(), knee.max()) == pytest.approx((0, 1.3), abs=0.01)
    assert np.abs(np.diff(knee) / np.diff(times)).max() <= 2.0
    assert np.allclose(rows[-1], 0)


@pytest.mark.slow
@pytest.mark.usefixtures("short")
def test_the_demonstration_draws(aces: Aces, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It ends by itself, with a plot in characters, a picture in the current folder, and how far it was off."""
    pytest.importorskip("matplotlib")
    monkeypatch.chdir(tmp_path)
    result = aces("demo")
    assert result.status == 0
    assert (tmp_path / "aces-demo.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    assert "right knee" in result.out
    assert "2 actual" in result.out
    assert all(len(line) <= 80 for line in result.out.splitlines()[:20])
    off = float(result.out.split("furthest from its set-point")[1].split()[0])
    assert 0 < off < 0.1


@pytest.mark.slow
@pytest.mark.usefixtures("short")
def test_without_matplotlib_there_is_the_plot_alone(
    aces: Aces, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A missing library is one line that says how to have it, and the rest is as before."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    result = aces("demo", "--seed", 3)
    assert result.status == 0
    assert "pip install 'aces-bus[plot]'" in result.messages[0]
    assert "right knee" in result.out
    assert not list(tmp_path.iterdir())


def test_a_picture_needs_a_suffix_and_a_folder(aces: Aces) -> None:
    """A path that cannot be a picture is a wrong call, before anything moves."""
    assert aces("demo", "-o", "knees.jpeg").status == 2
    assert aces("demo", "-o", "/no/such/folder/knees.png").status == 2
