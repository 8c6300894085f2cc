"""A virtual robot of one CiA 402 drive."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager
from typing import Any

from aces_bus.hardware import ListeningNode
from aces_bus.robot import VirtualRobot, parse_robot
from aces_devices.cia402 import driver

ONE = """
name = "one"
rate_hz = 100
[buses]
drives = { link = "can", protocol = "canopen", bitrate = 1_000_000 }
[devices]
D = { driver = "cia402", bus = "drives", credentials = { node = 5 }, settings = { SETTINGS } }
[joints]
J = { device = "D", channel = 0, lower = -1.5, upper = 1.5, MORE }
"""


def one_drive(settings: str = "", more: str = 'command = "position"') -> Any:
    text = ONE.replace("SETTINGS", f"counts_per_turn = 100_000, {settings}".rstrip(", ")).replace(
        "MORE", more
    )
    robot, problems = parse_robot(text, "one.toml")
    assert robot is not None, problems
    return robot


def load_cia402(name: str) -> Any:
    assert name == "cia402"
    return driver


@contextmanager
def running_drive(
    settings: str = "", more: str = 'command = "position"', enabled: bool = True
) -> Generator[Any]:
    """One drive that is set up, and enabled."""
    with VirtualRobot(one_drive(settings, more), rate_hz=100, load=load_cia402) as robot:
        robot.advance(0.5)
        if enabled:
            robot.devices["D"].enable().wait(5)
        yield robot


def frames(recorder: ListeningNode, *identifiers: int) -> list[str]:
    return [f.data.hex(" ").upper() for f in recorder.frames() if f.arbitration_id in identifiers]


def changes(items: list[str]) -> list[str]:
    """Without repetitions in a row."""
    return [one for n, one in enumerate(items) if n == 0 or one != items[n - 1]]
