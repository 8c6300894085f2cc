"""`aces spec badge`: a badge is given for what ran and passed, and for nothing else."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from aces_tools import badges
from aces_tools.main import main

SPEC = """
from construct import Byte, Int16ul, Struct
from aces_bus.protocol import Protocol
toy = Protocol("toy_badge", link="can")
toy.message("State", id=0x10, payload=Struct("speed" / Int16ul, "mode" / Byte),
    examples=[("010#{data}", {{"speed": 1, "mode": 2}})])
"""
MANIFEST = """
[[device]]
title = "Toy"
protocols = ["toy_badge"]
oracle_tests = ["checks/compare.py"]
"""


def badge(capsys: pytest.CaptureFixture[str], *words: object) -> tuple[int, dict[str, Any]]:
    status = main(["spec", "badge", *map(str, words), "--json"])
    (found,) = json.loads(capsys.readouterr().out)
    return status, found


@pytest.fixture
def spec(tmp_path: Path) -> Path:
    """A spec beside a manifest that names a test in a folder above."""
    (tmp_path / "toy").mkdir()
    (tmp_path / "checks").mkdir()
    (tmp_path / "toy" / "manifest.toml").write_text(MANIFEST)
    path = tmp_path / "toy" / "spec.py"
    path.write_text(SPEC.format(data="010002"))
    return path


@pytest.mark.slow
def test_gold_is_for_tests_that_ran_and_passed(spec: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A failed test fails the command; a skipped one earns nothing; what passed is saved with day and hash."""
    test = spec.parents[1] / "checks" / "compare.py"
    test.write_text("def test_it():\n    assert False\n")
    status, found = badge(capsys, spec)
    assert (status, found["gold"]) == (1, {"why_not": "1 of 1 tests failed"})
    assert found["silver"] == {"why_not": "no driver"}
    test.write_text("import pytest\ndef test_it():\n    pytest.skip('no kit')\n")
    status, found = badge(capsys, spec)
    assert (status, found["gold"]) == (0, {"why_not": "1 of 1 tests skipped: no kit"})
    test.write_text("def test_it():\n    pass\n")
    status, found = badge(capsys, spec, "--save")
    assert (status, found["gold"]["ran"]) == (0, "1 test of checks/compare.py")
    saved = badges.read_saved(spec.parent / badges.SAVED)["Toy"]
    assert set(saved.badges) == {"bronze", "gold"}
    assert set(saved.protocols) == {"toy_badge"}


@pytest.mark.slow
def test_bronze_wants_examples_that_hold(spec: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A wrong example fails, with its line; without an example there is nothing to give."""
    (spec.parent / "manifest.toml").unlink()
    spec.write_text(SPEC.format(data="010003"))
    status, found = badge(capsys, spec)
    assert status == 1
    assert "spec.py:5: State: example 010#01 00 03: mode is read as 3" in found["bronze"]["why_not"]
    bare = spec.with_name("bare.py")
    bare.write_text(SPEC.partition(",\n    examples")[0] + ")\n")
    status, found = badge(capsys, bare)
    assert (status, "no worked example" in found["bronze"]["why_not"]) == (0, True)


@pytest.mark.slow
def test_silver_is_for_a_files_own_driver(capsys: pytest.CaptureFixture[str]) -> None:
    """Its conformance checks run, without its being installed."""
    status, found = badge(capsys, Path(__file__).parents[3] / "examples" / "own_driver.py")
    assert status == 0
    assert found["silver"]["ran"] == "15 tests, ODriveTwin"


def test_badges_are_saved_beside_a_manifest_only(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    """Without one, the call says what to write."""
    spec = tmp_path / "bare.py"
    spec.write_text(SPEC.partition(",\n    examples")[0] + ")\n")
    assert main(["spec", "badge", str(spec), "--save"]) == 2
    assert "manifest.toml first" in capsys.readouterr().err
