"""The registry of drivers: lazy, loud, singular; and what every registered driver must be."""

from __future__ import annotations

import importlib.metadata
import subprocess
import sys
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import pytest

from aces_bus.device import Driver, list_drivers, load_driver
from aces_bus.device.drivers import DRIVERS
from aces_bus.errors import SpecError, UnknownNameError
from aces_bus.protocol import list_protocols
from aces_bus.robot import parse_robot

NAMES = list(list_drivers())


@pytest.mark.slow
def test_listing_imports_nothing() -> None:
    """Names are listed without importing a driver."""
    code = "import sys; from aces_bus.device import list_drivers; list_drivers(); print('aces_devices' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


def test_an_unknown_name_lists_those_that_exist() -> None:
    """An unknown driver is refused with the names, and the nearest."""
    with pytest.raises(UnknownNameError, match="did you mean 'hubo_motor'"):
        load_driver("hubo_moter")


def test_two_claims_on_a_name_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two packages with one name raise, with both places; so does an entry that is no driver or has another name."""
    points: list[EntryPoint] = []

    def entry_points(group: str) -> Any:
        return points

    monkeypatch.setattr(importlib.metadata, "entry_points", entry_points)
    points[:] = [
        EntryPoint("fan", "one:driver", DRIVERS.group),
        EntryPoint("fan", "two:driver", DRIVERS.group),
    ]
    with pytest.raises(SpecError, match="one:driver and two:driver"):
        list_drivers()
    points[:] = [EntryPoint("fan", "math:pi", DRIVERS.group)]
    with pytest.raises(SpecError, match="not a Driver but float"):
        load_driver("fan")
    points[:] = [EntryPoint("ventilator", "tests.device.fan:FAN", DRIVERS.group)]
    with pytest.raises(SpecError, match="calls itself 'fan'"):
        load_driver("ventilator")


@pytest.mark.parametrize("name", NAMES)
def test_every_driver_is_whole(name: str) -> None:
    """Each has a doc, a source, a README beside it, an installed protocol, and an example without errors."""
    driver: Driver = load_driver(name)
    assert driver.doc
    assert driver.source
    module = sys.modules[driver.device.__module__]
    assert module.__file__ is not None
    assert (Path(module.__file__).parent / "README.md").is_file()
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
