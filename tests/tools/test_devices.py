"""`aces devices`: the drivers that are installed, what each can do, and what is said of one that is broken."""

from __future__ import annotations

import json
from typing import Any

import pytest

from aces_bus.device.drivers import list_drivers
from aces_bus.errors import SpecError
from tests.tools.conftest import Aces


@pytest.mark.slow
def test_the_drivers(aces: Aces) -> None:
    """Each installed driver has a line with its protocol and purpose; as JSON also where it is."""
    shown = aces("devices")
    assert shown.status == 0, shown.err
    assert [line.split()[0] for line in shown.out.splitlines()] == list(list_drivers())
    rows = json.loads(aces("devices", "--json").out)
    assert {"driver", "protocol", "doc", "module"} == set(rows[0])
    assert next(row for row in rows if row["driver"] == "hubo_motor")["protocol"] == "hubo"


def test_one_driver(aces: Aces) -> None:
    """A driver shows signals, actions, settings and the faults of its twin."""
    shown = aces("devices", "pololu_qik")
    assert shown.status == 0
    for part in (
        "signals",
        "duty",
        "actions",
        "firmware*",
        "settings in a robot's file",
        "timeout_s",
        "silent",
    ):
        assert part in shown.out
    whole = json.loads(aces("devices", "hubo_motor", "--json").out)
    assert whole["signals"]["position"]["unit"] == "rad"
    assert whole["signals"]["position"]["set"]
    assert not whole["signals"]["current"]["set"]
    assert "home" in whole["actions"]  # those that only some boards have, too
    assert whole["asking"] == ["parameters"]
    assert "jam" in whole["faults"]


def test_an_unknown_driver(aces: Aces) -> None:
    """Its name is refused with those that exist."""
    shown = aces("devices", "hubo_moto")
    assert shown.status == 2
    assert "did you mean 'hubo_motor'" in shown.err
    assert shown.out == ""


def test_a_broken_driver_hides_no_other(aces: Aces, monkeypatch: pytest.MonkeyPatch) -> None:
    """One that cannot be loaded is said on stderr, with status 1; the others are listed."""
    import aces_bus.device as devices

    load = devices.load_driver

    def loading(name: str) -> Any:
        if name == "robotis_rx":
            raise SpecError("driver 'robotis_rx' cannot be loaded: no module named 'x'")
        return load(name)

    monkeypatch.setattr("aces_tools.devices.load_driver", loading)
    shown = aces("devices")
    assert shown.status == 1
    assert "robotis_rx" not in shown.out
    assert "pololu_qik" in shown.out
    assert shown.messages == ["driver 'robotis_rx' cannot be loaded: no module named 'x'"]
