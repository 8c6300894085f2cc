"""The drivers that are installed, and what their devices can do.

aces devices                   drivers, the protocols they speak, what for
aces devices hubo_motor        its signals, actions, settings, faults
aces devices --json            for programs
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from aces_bus.errors import AcesError

from .console import say
from .device_text import aligned_rows

if TYPE_CHECKING:
    from aces_bus.device import Driver


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("driver", nargs="?", metavar="NAME", help="a driver")
    parser.add_argument("--json", action="store_true", help="for programs")


def run(arguments: argparse.Namespace) -> int:
    from aces_bus.device import list_drivers, load_driver

    if arguments.driver is not None:
        whole = describe_driver(load_driver(arguments.driver))
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
    print("\n".join(aligned_rows([(one["driver"], one["protocol"], one["doc"]) for one in found], "")))
    return status


def describe_driver(driver: Driver) -> dict[str, Any]:
    """A driver with what the devices of its example robot have."""
    from aces_bus.device.twin import FAULTS

    signals: dict[str, dict[str, Any]] = {}
    actions = dict(driver.device.actions)
    asking = set(driver.device.asking)
    if driver.virtual:
        from aces_bus.device import load_driver
        from aces_bus.robot import VirtualRobot, parse_robot

        robot, _ = parse_robot(driver.example, f"{driver.name}.toml")
        if robot is not None:
            for device in VirtualRobot(robot, load=load_driver).devices.values():
                if device.config.driver != driver.name:
                    continue
                actions |= device.actions  # a device may have those of its kind only
                asking |= set(device.asking)
                for one in device.signals.values():
                    name = one.name.partition(".")[2]
                    known = signals.setdefault(
                        name, {"unit": one.unit, "read": False, "set": False, "doc": one.doc}
                    )
                    known["set"] = known["set"] or one.is_writable
                    known["read"] = known["read"] or one.name in device.readable
    return {
        "driver": driver.name,
        "protocol": driver.protocol,
        "doc": driver.doc,
        "source": driver.source,
        "finds_itself": driver.scan is not None,
        "signals": signals,
        "actions": actions,
        "asking": sorted(asking & set(actions)),
        "settings": dict(driver.settings or {}),
        "faults": {**driver.twin.faults, **FAULTS},
    }


def _show(whole: dict[str, Any]) -> None:
    head = [("protocol", whole["protocol"]), ("source", whole["source"])]
    print("\n".join(aligned_rows([(f"{whole['driver']}:", whole["doc"])], "") + aligned_rows(head, "")))
    print(f"'aces scan' {'finds' if whole['finds_itself'] else 'cannot find'} these devices")
    _table(
        "signals",
        [
            (name, one["unit"] or "–", ", ".join(way for way in ("set", "read") if one[way]), one["doc"])
            for name, one in whole["signals"].items()
        ],
    )
    asking = whole["asking"]
    _table(
        "actions" + (" (those with * only ask, and need no --tx)" if asking else ""),
        [(name + "*" * (name in asking), doc) for name, doc in whole["actions"].items()],
    )
    _table("settings in a robot's file", list(whole["settings"].items()))
    _table("faults of the twin", list(whole["faults"].items()))


def _table(title: str, rows: Sequence[tuple[str, ...]]) -> None:
    if rows:
        print("\n".join([f"\n{title}", *aligned_rows(rows)]))
