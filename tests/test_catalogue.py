"""The catalogue: each driver has a manifest beside it, and README.md lists what the manifests say."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any

from aces_bus import list_protocols
from aces_bus.device.drivers import list_drivers

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
