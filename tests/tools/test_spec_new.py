"""`aces spec new`: what it writes passes its own tests, is clean, and overwrites nothing."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import settings

from tests.tools.conftest import Aces

RUFF = shutil.which("ruff") or shutil.which("ruff", path=str(Path(sys.executable).parent))
LINKS = ("can", "serial", "datagram")


@pytest.fixture
def made(tmp_path: Path, aces: Aces) -> Path:
    """A folder with a skeleton of each link."""
    for link in LINKS:
        result = aces("spec", "new", f"my_{link}", "--link", link, "-o", tmp_path / link)
        assert result.status == 0
        assert result.out == ""
        assert result.messages[-1].startswith("next: ")
    return tmp_path


@pytest.mark.slow
def test_what_is_written_passes_at_once(made: Path) -> None:
    """pytest in each folder: the worked examples and every law."""
    # The package's plug-in, and no others: they take as long to load as the tests take.
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-q",
        "-p",
        "no:cacheprovider",
        "--hypothesis-seed=1",
        "-c",
        os.devnull,
        "--rootdir",
        str(made),
    ]
    command += ["-p", "_hypothesis_pytestplugin", "-p", "aces_bus.testing.plugin"]
    # In the short profile the laws of one of them.
    command += [] if settings().max_examples > 100 else ["-k", "worked or round_trip"]
    path = os.pathsep.join(one for one in sys.path if one)
    run = subprocess.run(
        [*command, "--aces-examples", "1", *(str(made / link) for link in LINKS)],
        capture_output=True,
        text=True,
        cwd=made,
        env={**os.environ, "PYTHONPATH": path, "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"},
        timeout=300,
    )
    assert run.returncode == 0, run.stdout + run.stderr
    assert " passed" in run.stdout
    assert "skipped" not in run.stdout


@pytest.mark.slow
def test_what_is_written_is_clean(made: Path, aces: Aces) -> None:
    """`aces spec check` finds nothing, formatters change nothing, and the messages are listed."""
    for link in LINKS:
        spec = made / link / f"my_{link}.py"
        result = aces("spec", "check", spec, "--for", "0.2")
        assert (result.status, "warning" in result.out) == (0, False), result.out
        listed = aces("protocols", spec).out
        assert "SetRate" in listed
        assert (made / link / "README.md").read_text(encoding="utf-8").startswith(f"# my_{link}\n")
    if RUFF is not None:
        run = subprocess.run(
            [RUFF, "format", "--isolated", "--check", str(made)], capture_output=True, text=True
        )
        assert run.returncode == 0, run.stdout


def test_nothing_is_overwritten(tmp_path: Path, aces: Aces) -> None:
    """One file that is there is enough: nothing at all is written."""
    (tmp_path / "README.md").write_text("mine")
    result = aces("spec", "new", "grip", "--link", "can", "-o", tmp_path)
    assert result.status == 2
    assert "README.md: is there already" in result.err
    assert [path.name for path in tmp_path.iterdir()] == ["README.md"]
    assert (tmp_path / "README.md").read_text() == "mine"


def test_in_the_present_folder_by_default(
    tmp_path: Path, aces: Aces, monkeypatch: pytest.MonkeyPatch
) -> None:
    """./NAME; with --json the files are told on stdout."""
    monkeypatch.chdir(tmp_path)
    result = aces("spec", "new", "grip", "--link", "can", "--json")
    assert json.loads(result.out)["files"] == [
        str(Path("grip") / name) for name in ("grip.py", "test_grip.py", "README.md")
    ]
    assert result.err == ""


@pytest.mark.parametrize(
    "name", ["1st", "a b", "../x", "class", "json", "can", "bits", "print", "Grip", "_x", "ü", ""]
)
def test_names_that_cannot_be(name: str, tmp_path: Path, aces: Aces) -> None:
    """A line that says why, status 2, and no file."""
    result = aces("spec", "new", "--link", "can", "-o", tmp_path / "x", "--", name)
    assert result.status == 2
    assert len(result.err.splitlines()) == 1
    assert not (tmp_path / "x").exists()


def test_a_folder_that_cannot_be_made(tmp_path: Path, aces: Aces) -> None:
    """A file in the way: a line, status 2."""
    (tmp_path / "file").write_text("")
    result = aces("spec", "new", "grip", "--link", "can", "-o", tmp_path / "file" / "x")
    assert result.status == 2
    assert "cannot be written" in result.err
