"""Examples are run as programs, or their `main` is called for what it gives."""

from __future__ import annotations

import runpy
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pytest

FOLDER = Path(__file__).resolve().parents[2] / "examples"


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[..., list[str]]:
    """`run(name, *arguments)` runs an example as a program and gives the lines that it prints."""

    def program(name: str, *arguments: str) -> list[str]:
        monkeypatch.setattr(sys, "argv", [name, *arguments])
        monkeypatch.syspath_prepend(str(FOLDER))  # where a program's own folder is
        runpy.run_path(str(FOLDER / name), run_name="__main__")
        return capsys.readouterr().out.splitlines()

    return program


@pytest.fixture
def names_of(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], Mapping[str, Any]]:
    """`names_of(name)` gives what an example defines, without running it."""

    def defined(name: str) -> Mapping[str, Any]:
        monkeypatch.syspath_prepend(str(FOLDER))
        return runpy.run_path(str(FOLDER / name), run_name=name)

    return defined
