"""The catalogue: each driver has a manifest beside it, and README.md lists what the manifests say."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any

import pytest

from aces_bus import list_protocols
from aces_bus.device.drivers import list_drivers
from aces_tools.badges import LEVELS, installed_entries
from aces_tools.proofs import read_badges

ROOT = Path(__file__).resolve().parent.parent


def _catalogue() -> Any:
    spec = importlib.util.spec_from_file_location("catalogue", ROOT / "docs" / "catalogue.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


catalogue = _catalogue()


def test_each_driver_has_one_manifest() -> None:
    """A driver's owner, sources and oracle are beside it, once; names are those that are installed."""
    found = [
        (path.parent.name, device)
        for path, manifest in catalogue.manifests()
        for device in manifest["device"]
    ]
    ours = {name: p for name, p in list_drivers().items() if p.value.startswith("aces_devices.")}
    assert sorted(name for _, device in found for name in device.get("drivers", ())) == sorted(ours)
    for folder, device in found:
        for name in device.get("drivers", ()):
            assert ours[name].value.startswith(f"aces_devices.{folder}"), name
        assert set(device["protocols"]) <= set(list_protocols())


def test_manifests_say_what_they_have_to() -> None:
    """An owner, a level, and of each device its title, link, oracle and sources."""
    assert catalogue.faults() == []


def test_the_table_is_what_the_manifests_say(request: Any) -> None:
    """README.md is written by `python docs/catalogue.py`."""
    if request.config.getoption("--update-golden"):
        catalogue.main()
    found = catalogue.PLACE.search((ROOT / "README.md").read_text(encoding="utf-8"))
    assert found is not None
    assert found[0] == catalogue.table(), "stale; to write it anew: python docs/catalogue.py"


def test_badges_are_of_entries_that_say_how_they_are_earned() -> None:
    """Silver has a driver, gold names tests that are there, platinum is a proof that is kept."""
    for entry in installed_entries():
        saved = entry.saved()
        if saved is None:
            continue  # no badge yet
        assert set(saved.badges) <= set(LEVELS)
        assert set(saved.protocols) == set(entry.protocols), entry.title
        for test in [*entry.oracle_tests, *entry.driver_tests]:
            assert (ROOT / test.partition("::")[0]).is_file(), f"{entry.title}: {test}"
        if "silver" in saved.badges:
            assert entry.drivers, entry.title
        if "gold" in saved.badges:
            assert entry.oracle_tests, entry.title
        if "platinum" in saved.badges:
            assert {read_badges()[name].hash for name in entry.protocols} == set(saved.protocols.values())


@pytest.mark.slow
def test_no_badge_is_stale() -> None:
    """After a change of a spec or of the generator: make badges."""
    saved = {entry.title: entry.saved() for entry in installed_entries()}
    assert [title for title, badges in saved.items() if badges is not None and badges.is_stale()] == []
