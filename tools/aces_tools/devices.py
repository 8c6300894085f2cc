"""The drivers that are installed, and what their devices can do.

aces devices                   drivers, the protocols they speak, what for
aces devices hubo_motor        its signals, actions, settings, faults
aces devices --json            for programs
"""

from __future__ import annotations

import argparse
import json
from typing import TYPE_CHECKING, Any

from aces_bus.errors import AcesError

from .console import say, terminal_width

if TYPE_CHECKING:
    from aces_bus.device import Driver


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("driver", nargs="?", metavar="NAME", help="a driver")
    parser.add_argument("--json", action="store_true", help="for programs")


def run(arguments: argparse.Namespace) -> int:
    from aces_bus.device import list_drivers, load_driver

    if arguments.driver is not None:
        whole = described(load_driver(arguments.driver))
        print(json.dumps(whole, ensure_ascii=False, indent=2)) if arguments.json else _show(whole)
        return 0
    found: list[dict[str, Any]] = []
    status = 0
    for name, point in list_drivers().items():
        try:
            driver = load_driver(name)
            found.append(
                {"driver": name, "protocol": driver.protocol, "doc": driver.doc, "module": point.value}
            )
        except AcesError as error:
            say(str(error))
            status = 1
    if arguments.json:
        print(json.dumps(found, ensure_ascii=False, indent=2))
        return status
    widths = [max((len(str(one[key])) for one in found), default=0) for key in ("driver", "protocol")]
    for one in found:
        line = f"{one['driver']:<{widths[0]}}  {one['protocol']:<{widths[1]}}  {one['doc']}"
        print(line[: terminal_width()] if terminal_width() > 40 else line)
    return status


def described(driver: Driver) -> dict[str, Any]:
    """A driver with what the devices of its example robot have."""
    from aces_bus.device.twin import FAULTS

    signals: dict[str, dict[str, Any]] = {}
    if driver.virtual:
        from aces_bus.assembly import VirtualRobot
        from aces_bus.device import load_driver, parse_robot

        robot, _ = parse_robot(driver.example, f"{driver.name}.toml")
        if robot is not None:
            for device in VirtualRobot(robot, load=load_driver).devices.values():
                if device.config.driver != driver.name:
                    continue
                for one in device.signals.values():
                    name = one.name.partition(".")[2]
                    known = signals.setdefault(name, {"unit": one.unit, "set": False, "doc": one.doc})
                    known["set"] = known["set"] or one.is_writable
    return {
        "driver": driver.name,
        "protocol": driver.protocol,
        "doc": driver.doc,
        "source": driver.source,
        "finds_itself": driver.scan is not None,
        "signals": signals,
        "actions": dict(driver.device.actions),
        "settings": dict(driver.settings or {}),
        "faults": {**driver.twin.faults, **FAULTS},
    }


def _show(whole: dict[str, Any]) -> None:
    print(f"{whole['driver']}: {whole['doc']}")
    print(f"protocol {whole['protocol']}; source: {whole['source']}")
    print(f"'aces scan' {'finds' if whole['finds_itself'] else 'cannot find'} these devices")
    _table(
        "signals",
        {
            name: f"{one['unit'] or '–':<8} {'set, read' if one['set'] else 'read':<9} {one['doc']}".rstrip()
            for name, one in whole["signals"].items()
        },
    )
    _table("actions", whole["actions"])
    _table("settings in a robot's file", whole["settings"])
    _table("faults of the twin", whole["faults"])


def _table(title: str, rows: dict[str, str]) -> None:
    if rows:
        print(f"\n{title}")
        width = max(map(len, rows))
        for name, text in rows.items():
            print(f"  {name:<{width}}  {text}")
