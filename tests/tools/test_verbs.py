"""Verbs and options of other packages: found by entry point, and what a bad one costs."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from aces_bus.plugins import installed_points
from aces_tools import verbs

from .conftest import Aces

Installs = Callable[..., None]


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Installs]:
    """`install("their-package", "[aces_bus.verbs]…", their_module="source")` puts a distribution on the path."""
    monkeypatch.setattr(sys, "path", [*sys.path, str(tmp_path)])

    def install(distribution: str, points: str, **modules: str) -> None:
        info = tmp_path / f"{distribution.replace('-', '_')}-1.0.dist-info"
        info.mkdir()
        (info / "entry_points.txt").write_text(points, encoding="utf-8")
        for name, source in modules.items():
            (tmp_path / f"{name}.py").write_text(source, encoding="utf-8")
        verbs.verbs.cache_clear()
        verbs.options_of.cache_clear()

    before = set(sys.modules)
    yield install
    for name in set(sys.modules) - before:
        if name.startswith("their_"):
            del sys.modules[name]
    verbs.verbs.cache_clear()
    verbs.options_of.cache_clear()


WAVE = '''"""Wave a flag.

  aces wave
"""

SUMMARY = "wave a flag"
ARGUMENTS = ()


def run(arguments):
    print("waving")
    return 3
'''


def test_a_verb_of_another_package(aces: Aces, install: Installs) -> None:
    """It is listed with its summary, explains itself, and runs."""
    install("their-flags", "[aces_bus.verbs]\nwave = their_flags\n", their_flags=WAVE)
    assert "  wave        wave a flag\n" in aces("--help").out
    assert "Wave a flag." in aces("wave", "--help").out
    assert aces("wave")[:2] == (3, "waving\n")


def test_an_action_of_another_package(aces: Aces, install: Installs) -> None:
    """A name with a dot is an action of a verb, also of one of ours."""
    install("their-flags", "[aces_bus.verbs]\nspec.wave = their_flags\n", their_flags=WAVE)
    assert "  wave     wave a flag\n" in aces("spec", "--help").out
    assert aces("spec", "wave").status == 3


def test_listing_verbs_imports_none(aces: Aces, install: Installs) -> None:
    """A slow or broken module costs `aces --help` nothing; its summary is its docstring's first line."""
    install(
        "their-flags",
        "[aces_bus.verbs]\nwave = their_flags\n",
        their_flags='"""Wave slowly."""\nraise SystemError\n',
    )
    result = aces("--help")
    assert (result.status, result.err) == (0, "")
    assert "  wave        Wave slowly\n" in result.out
    assert "their_flags" not in sys.modules


@pytest.mark.parametrize(
    ("source", "said"),
    [
        ("raise OSError('no flag here')", "their-flags: the verb 'wave' cannot be imported: no flag here"),
        ("ARGUMENTS = ()", "their-flags: the verb 'wave' is not usable: their_flags has no run"),
    ],
)
def test_a_broken_verb_costs_only_itself(aces: Aces, install: Installs, source: str, said: str) -> None:
    """It is one line that names its package; other verbs run."""
    install("their-flags", "[aces_bus.verbs]\nwave = their_flags\n", their_flags=source)
    result = aces("wave")
    assert (result.status, result.messages) == (2, [said])
    assert aces("protocols", "-q")[0] == 0


def test_a_name_that_is_taken(aces: Aces, install: Installs) -> None:
    """Ours keep their names; who claims one is named once, with both places."""
    install("their-flags", "[aces_bus.verbs]\ndecode = their_flags\n", their_flags=WAVE)
    first, second = aces("--help"), aces("--help")
    assert first.messages == [
        "their-flags: its verb 'decode' is left out: aces-bus has that name (their_flags, aces_tools.decode)"
    ]
    assert second.messages == []
    assert "decode recordings" in first.out


OPTIONS = """
from aces_tools.options import flag

ARGUMENTS = (flag("--upside-down", help="turn it"),)


def is_wanted(arguments):
    return arguments.upside_down


def run(arguments):
    print("down side up")
    return 4
"""


def test_options_of_another_package(aces: Aces, install: Installs) -> None:
    """They are in the verb's help; where they are given, the package's module runs in the verb's place."""
    install(
        "their-flags", "[aces_bus.options]\nprotocols.upside_down = their_options\n", their_options=OPTIONS
    )
    assert "--upside-down        turn it" in aces("protocols", "--help").out
    assert aces("protocols", "--upside-down")[:2] == (4, "down side up\n")
    assert aces("protocols", "-q").status == 0


def test_broken_options_cost_only_themselves(aces: Aces, install: Installs) -> None:
    """The verb runs without them, and they are named once."""
    install(
        "their-flags", "[aces_bus.options]\nprotocols.upside_down = their_options\n", their_options="1 / 0"
    )
    first, second = aces("protocols", "-q"), aces("protocols", "-q")
    assert (first.status, second.status) == (0, 0)
    assert first.messages == [
        "their-flags: the options 'protocols.upside_down' cannot be imported: division by zero"
    ]
    assert second.messages == []


def test_what_is_installed_is_what_the_standard_library_finds() -> None:
    """Reading the metadata ourselves finds the entry points that `importlib.metadata` finds."""
    from importlib.metadata import entry_points

    for group in ("aces_bus.verbs", "aces_bus.protocols", "pytest11", "console_scripts"):
        ours = {(point.name, point.value) for point in installed_points(group)}
        assert ours == {(point.name, point.value) for point in entry_points(group=group)}
