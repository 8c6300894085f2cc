"""The registry of drivers: lazy, loud, singular; and what every registered driver must be."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from aces_bus import list_protocols
from aces_bus.device import Driver, load_driver
from aces_bus.device.drivers import list_drivers
from aces_bus.errors import UnknownNameError
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
