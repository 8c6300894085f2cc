"""What a drawn test failed with is a file; what is drawn depends on the test alone."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from aces_bus import Frame
from tests import kept

ROOT = Path(__file__).resolve().parent.parent
#: What the test below is broken by; emptied, it is mended.
FAULTS: set[str] = set()
NODE = "tests/test_kept.py::sample"


@settings(max_examples=50)
@given(st.integers(0, 1000), st.data())
def sample(limit: int, number: int, data: Any) -> None:
    """Fails on numbers above a limit when "large" is among the faults."""
    text = data.draw(st.text(max_size=3))
    assert "large" not in FAULTS or number <= limit, f"{number} {text}"


@pytest.mark.slow
def test_a_failure_is_kept_and_replayed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The smallest failing arguments are written, break the test again, and break it no more once it is mended."""
    monkeypatch.setattr(sys.modules[__name__], "FAULTS", {"large"})
    with (
        pytest.raises(AssertionError) as caught,
        kept.keeping(sample, NODE, {"limit": 7}, tmp_path),
    ):
        sample(limit=7)
    (file,) = tmp_path.iterdir()
    lines = file.read_text().splitlines()
    assert lines[0] == f"# {NODE}"
    assert lines[1].startswith("# AssertionError: 8")
    assert lines[2:] == ["number = 8", "data = Drawn([''])"]
    assert any(str(file) in note for note in caught.value.__notes__)
    with pytest.raises(AssertionError, match="8"):
        kept.replay(sample, NODE, {"limit": 7}, tmp_path)
    assert kept.replay(sample, "tests/test_other.py::sample", {"limit": 7}, tmp_path) == 0
    FAULTS.clear()
    assert kept.replay(sample, NODE, {"limit": 7}, tmp_path) == 1
    sample(limit=7)


def test_frames_and_odd_numbers_are_read_back(tmp_path: Path) -> None:
    """A kept file may name frames, infinities and what is not a number."""
    frame = Frame(0x123, b"\x01")
    broken = given(st.just([frame, float("inf"), float("nan"), -0.0]))(_is_never)
    with pytest.raises(AssertionError), kept.keeping(broken, NODE, {}, tmp_path):
        broken()
    (file,) = tmp_path.iterdir()
    assert file.read_text().splitlines()[2] == f"values = [{frame!r}, inf, nan, -0.0]"
    with pytest.raises(AssertionError):
        kept.replay(broken, NODE, {}, tmp_path)


def test_what_cannot_be_kept_is_said(tmp_path: Path) -> None:
    """An argument that has no text of its own is named, and nothing is written."""
    broken = given(st.builds(object).map(lambda one: [one]))(_is_never)
    with pytest.raises(AssertionError) as caught, kept.keeping(broken, NODE, {}, tmp_path):
        broken()
    assert "not kept as a file: values cannot be read back" in "".join(caught.value.__notes__)
    assert list(tmp_path.iterdir()) == []


def _is_never(values: list[Any]) -> None:
    raise AssertionError(len(values))


@pytest.mark.slow
def test_draws_depend_on_the_test_alone() -> None:
    """Other modules, another hash seed and another folder change nothing in what the short profile draws."""
    program = "import tests.conftest\nfrom tests.test_kept import drawn\nprint(drawn())\n"
    path = os.pathsep.join(str(ROOT / part) for part in ("", "protocols", "devices", "tools"))
    said: set[str] = set()
    for seed, first in (("0", ""), ("5", "import aces_tools.main, aces_protocols.hubo.spec, aces_devices\n")):
        environment = {
            **os.environ,
            "PYTHONHASHSEED": seed,
            "PYTHONPATH": path,
            "HYPOTHESIS_PROFILE": "short",
        }
        done = subprocess.run(
            [sys.executable, "-c", first + program],
            capture_output=True,
            text=True,
            env=environment,
            check=True,
        )
        said.add(done.stdout)
    assert len(said) == 1
    assert len(said.pop()) > 1000


def drawn() -> list[Any]:
    """What a test with many kinds of values is given."""
    found: list[Any] = []

    @settings(max_examples=100)
    @given(st.tuples(st.integers(), st.text(max_size=5), st.floats(), st.binary(max_size=5)))
    def collect(values: Any) -> None:
        found.append(values)

    collect()
    return found
