"""Plug-ins of a made-up package that are broken, slow or claim a taken name: each costs only itself, and is named once."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from aces_bus import list_robots, plugins
from aces_bus.controller.log.formats import log_formats
from aces_bus.export.open import table_formats
from aces_bus.hardware.backends import backend_of
from aces_bus.plugins import PluginWarning
from aces_bus.protocol.exchange import database_suffixes

#: Group → a plug-in of it that works, in their module.
THEIRS = """
from aces_bus.controller.log.formats import LogFormat
from aces_bus.export.open import TableFormat
from aces_bus.hardware.backends import Backend
from aces_bus.protocol.exchange import DatabaseFormat

exporters = TableFormat("theirs", (".their",), "their_plug_ins:Nothing")
logs = LogFormat("theirs", (".their",), b"THEIR", "their_plug_ins:Nothing", "their_plug_ins:nothing")
databases = DatabaseFormat("theirs", (".their",), "their_plug_ins:nothing")
backends = Backend("theirs", {"silent": True}, echoes=True)
taken = TableFormat("mcap", (".mcap",), "their_plug_ins:Nothing")
"""


class Package:
    """A distribution on the path; `points` writes its entry points."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        (folder / "their_plug_ins.py").write_text(THEIRS, encoding="utf-8")
        (folder / "their_broken.py").write_text("1 / 0", encoding="utf-8")

    def points(self, **groups: str) -> None:
        """Declare an entry point `theirs` in each group."""
        info = self.folder / "their_tools-1.0.dist-info"
        info.mkdir()
        text = "\n".join(f"[aces_bus.{group}]\ntheirs = {value}\n" for group, value in groups.items())
        (info / "entry_points.txt").write_text(text, encoding="utf-8")


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Package]:
    """A package of others."""
    monkeypatch.setattr(sys, "path", [*sys.path, str(tmp_path)])
    plugins.installed_items.cache_clear()
    yield Package(tmp_path)
    plugins.installed_items.cache_clear()
    for name in ("their_plug_ins", "their_broken"):
        sys.modules.pop(name, None)


def test_a_plug_in_of_each_kind_is_found(package: Package) -> None:
    """One entry point is all that a format of tables, of logs, a database or a backend takes."""
    groups = ("exporters", "logs", "databases", "backends")
    package.points(**{group: f"their_plug_ins:{group}" for group in groups})
    assert table_formats()["theirs"].suffixes == (".their",)
    assert log_formats()["theirs"].magic == b"THEIR"
    assert ".their" in database_suffixes()
    assert backend_of("theirs").echoes
    assert "parquet" in table_formats()


def test_what_cannot_be_imported_is_left_out(package: Package) -> None:
    """Formats of others are there; the broken one is named with its distribution and group."""
    package.points(exporters="their_broken:exporters")
    with pytest.warns(
        PluginWarning, match=r"their-tools: aces_bus\.exporters 'theirs' is left out: division by"
    ):
        assert {"parquet", "mcap", "npz"} <= set(table_formats())


def test_a_taken_name_stays_whose_it_is(package: Package) -> None:
    """Ours keep their names."""
    package.points(exporters="their_plug_ins:taken")
    with pytest.warns(PluginWarning, match=r"their-tools: aces_bus\.exporters 'mcap' is left out"):
        assert table_formats()["mcap"].place.startswith("aces_lab.")


def test_a_slow_plug_in_is_named(package: Package, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is there, and said to be slow."""
    monkeypatch.setattr(plugins, "SLOW_S", -1.0)
    package.points(exporters="their_plug_ins:exporters")
    with pytest.warns(
        PluginWarning, match=r"their-tools: aces_bus\.exporters 'theirs' takes 0\.\d s to import"
    ):
        assert "theirs" in table_formats()


def test_robots_of_a_package_that_is_gone(package: Package) -> None:
    """Robots of others are listed."""
    package.points(robots="their_robots_that_are_not_there")
    with pytest.warns(PluginWarning, match="their-tools: its robots are left out: No module named"):
        assert "hubo2plus" in list_robots()


@pytest.mark.slow
def test_the_command_says_it_in_one_line(package: Package) -> None:
    """`aces` prints a line for a broken plug-in, no warning of Python's, and does its work."""
    package.points(exporters="their_broken:exporters")
    code = "import sys; sys.argv = ['aces', 'decode', '--help']; from aces_tools.main import main; sys.exit(main())"
    done = subprocess.run(
        [sys.executable, "-c", code],
        env={"PYTHONPATH": f"{package.folder}"},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stderr == "aces: their-tools: aces_bus.exporters 'theirs' is left out: division by zero\n"
    assert "usage: aces decode" in done.stdout
