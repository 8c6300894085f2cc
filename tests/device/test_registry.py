"""The registry of drivers: lazy, loud, singular; and what every registered driver must be."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from aces_bus import list_protocols
from aces_bus.device import Driver, load_driver
from aces_bus.device.drivers import DRIVERS, list_drivers
from aces_bus.errors import SpecError, UnknownNameError
from aces_bus.plugins import PluginWarning
from aces_bus.robot import parse_robot

NAMES = list(list_drivers())


@pytest.mark.slow
def test_listing_imports_nothing() -> None:
    """Names are listed without importing a driver."""
    code = "import sys; from aces_bus.device.drivers import list_drivers\n"
    code += "list_drivers(); print('aces_devices' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


def test_an_unknown_name_lists_those_that_exist() -> None:
    """An unknown driver is refused with the names, and the nearest."""
    with pytest.raises(UnknownNameError, match="did you mean 'hubo_motor'"):
        load_driver("hubo_moter")


def installed(folder: Path, **points: str) -> str:
    """Have a folder hold a package that registers these drivers; return its path."""
    for number, (name, value) in enumerate(points.items()):
        place = folder / f"brings{number}_{name}-1.0.dist-info"
        place.mkdir(parents=True)
        (place / "METADATA").write_text(f"Name: brings{number}-{name}\nVersion: 1.0\n")
        (place / "entry_points.txt").write_text(f"[{DRIVERS.group}]\n{name.strip('_')} = {value}\n")
    return str(folder)


def test_two_claims_on_a_name_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A name that two packages claim is refused with both places, ours stay ours; so is an entry that is not a driver."""
    with monkeypatch.context() as patch:
        patch.syspath_prepend(installed(tmp_path / "clash", blower="one:driver", blower_="two:driver"))
        with pytest.raises(SpecError, match="one:driver and two:driver"):
            load_driver("blower")
        assert load_driver("hubo_motor").name == "hubo_motor"
    with monkeypatch.context() as patch:
        patch.syspath_prepend(installed(tmp_path / "taken", hubo_motor="one:driver"))
        with pytest.warns(PluginWarning, match="^brings0-hubo-motor: .* aces-bus keeps it"):
            assert list_drivers()["hubo_motor"].distribution == "aces-bus"
    monkeypatch.syspath_prepend(installed(tmp_path / "wrong", blower="math:pi"))
    with pytest.raises(SpecError, match="not a Driver but float"):
        load_driver("blower")
    monkeypatch.syspath_prepend(installed(tmp_path / "named", ventilator="tests.device.fan:FAN"))
    with pytest.raises(SpecError, match="calls itself 'fan'"):
        load_driver("ventilator")


def test_what_is_installed_meanwhile_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A package that is installed while a program runs is there at the next look, and gone when it is removed."""
    monkeypatch.syspath_prepend(str(tmp_path))
    assert "blower" not in list_drivers()
    installed(tmp_path, blower="one:driver")
    assert "blower" in list_drivers()
    shutil.rmtree(tmp_path / "brings0_blower-1.0.dist-info")
    assert "blower" not in list_drivers()


@pytest.mark.parametrize("name", NAMES)
def test_every_driver_is_whole(name: str) -> None:
    """Each has a doc, a source, a manifest beside it, an installed protocol, and an example without errors."""
    driver: Driver = load_driver(name)
    assert driver.doc
    assert driver.source
    module = sys.modules[driver.device.__module__]
    assert module.__file__ is not None
    assert any((folder / "manifest.toml").is_file() for folder in Path(module.__file__).parents[:2])
    assert driver.protocol in list_protocols()
    robot, problems = parse_robot(driver.example, f"{name}.toml")
    assert robot is not None, problems
    assert not [problem for problem in problems if not problem.is_warning]
    assert name in {config.driver for config in robot.devices.values()}
    assert driver.device.__doc__
    assert driver.twin.__doc__
    for action, doc in driver.device.actions.items():
        assert doc, action
        assert callable(getattr(driver.device, action))
