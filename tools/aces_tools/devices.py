"""The drivers that are installed, and what their devices can do.

aces devices                   drivers, the protocols they speak, what for
aces devices hubo_motor        its signals, actions, settings, faults
aces devices --json            for programs
"""

from __future__ import annotations

import argparse
import inspect
from collections.abc import Sequence
from typing import Any

from aces_bus.device import Device, Driver, Robot, load_driver
from aces_bus.device.config import DeviceConfig
from aces_bus.device.drivers import list_drivers
from aces_bus.device.signals import Signal
from aces_bus.device.station import credential_text
from aces_bus.device.twin import FAULTS
from aces_bus.errors import AcesError
from aces_bus.protocol.record import PlainValue

from .console import print_json, say
from .device_text import aligned_rows
from .options import JSON, Arguments, argument

SUMMARY = "list the drivers, and what their devices can do"

ARGUMENTS: Arguments = (
    argument("driver", nargs="?", metavar="NAME", help="a driver"),
    JSON,
)


def run(arguments: argparse.Namespace) -> int:
    if arguments.driver is not None:
        whole = describe_driver(load_driver(arguments.driver))
        print_json(whole) if arguments.json else _show(whole)
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
        print_json(found)
        return status
    print(
        "\n".join(aligned_rows([(entry["driver"], entry["protocol"], entry["doc"]) for entry in found], ""))
    )
    return status


def describe_driver(driver: Driver) -> dict[str, PlainValue]:
    """Return a driver with what the devices of its example robot have."""
    signals: dict[str, dict[str, PlainValue]] = {}
    actions = dict(driver.device.actions)
    asking = set(driver.device.asking)
    if driver.virtual:
        from aces_bus.robot import VirtualRobot, parse_robot

        robot, _ = parse_robot(driver.example, f"{driver.name}.toml")
        if robot is not None:
            for device in VirtualRobot(robot, load=load_driver).devices.values():
                if device.config.driver != driver.name:
                    continue
                actions |= device.actions  # a device may have those of its kind only
                asking |= set(device.asking)
                for signal in device.signals.values():
                    name = signal.name.partition(".")[2]
                    known = signals.setdefault(
                        name, {"unit": signal.unit, "read": False, "set": False, "doc": signal.doc}
                    )
                    known["set"] = known["set"] or signal.is_writable
                    known["read"] = known["read"] or signal.name in device.readable
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
    print(f"'aces discover' {'finds' if whole['finds_itself'] else 'cannot find'} these devices")
    _table(
        "signals",
        [
            (
                name,
                signal["unit"] or "–",
                ", ".join(way for way in ("set", "read") if signal[way]),
                signal["doc"],
            )
            for name, signal in whole["signals"].items()
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


# ---------------------------------------------------------------------- one device of a robot, for `aces device`


def show_devices(robot: Robot, as_json: bool) -> int:
    """Return the devices of a robot with their joints and sensors."""
    rows: list[dict[str, Any]] = [
        {
            "device": name,
            "driver": config.driver,
            "bus": config.bus,
            "credentials": config.credentials,
            "active": config.active,
            "joints": [joint.name for joint in robot.joints_of(name)],
            "sensors": [sensor.name for sensor in robot.sensors_of(name)],
        }
        for name, config in robot.devices.items()
    ]
    if as_json:
        print_json(rows)
        return 0
    table: list[tuple[str, ...]] = []
    for row in rows:
        parts = " ".join([*row["joints"], *row["sensors"]])
        state = "" if row["active"] else " (inactive)"
        table.append(
            (row["device"], row["bus"], row["driver"], credential_text(row["credentials"]) + state, parts)
        )
    print("\n".join(aligned_rows(table, "")))
    return 0


def show_device(device: Device, config: DeviceConfig, signals: list[Signal], as_json: bool) -> int:
    """Return the signals and actions of a device."""
    if as_json:
        whole = {
            "device": device.name,
            "driver": config.driver,
            "signals": {
                signal.name: {
                    "unit": signal.unit,
                    "read": signal.name in device.readable,
                    "set": signal.is_writable,
                    "lower": signal.lower,
                    "upper": signal.upper,
                    "doc": signal.doc,
                }
                for signal in signals
            },
            "actions": {
                name: {"doc": doc, "arguments": arguments_of(device, name), "asks": name in device.asking}
                for name, doc in device.actions.items()
            },
        }
        print_json(whole)
        return 0
    print(f"{device.name}: {config.driver} on bus {config.bus}, {credential_text(device.credentials)}")
    table: list[tuple[str, ...]] = []
    for signal in signals:
        ways = ["set"] * signal.is_writable + ["read"] * (signal.name in device.readable)
        limits = "" if signal.lower is None or signal.upper is None else f" {signal.lower:g}…{signal.upper:g}"
        table.append((signal.name, signal.unit or "–", ", ".join(ways) + limits, signal.doc))
    print("\n".join(aligned_rows(table)) if table else "  no signals")
    if device.actions:
        is_marked = any(name in device.asking for name in device.actions)
        print("actions" + (" (those with * only ask, and need no --tx)" if is_marked else ""))
        rows = [
            (name + "*" * (name in device.asking), _with_arguments(doc, arguments_of(device, name)))
            for name, doc in device.actions.items()
        ]
        print("\n".join(aligned_rows(rows)))
    return 0


def arguments_of(device: Device, action: str) -> dict[str, bool]:
    """Return the names of an action's arguments; True: must be given."""
    parameters = inspect.signature(getattr(device, action)).parameters.values()
    return {
        parameter.name: parameter.default is inspect.Parameter.empty
        and parameter.kind is not inspect.Parameter.VAR_KEYWORD
        and parameter.name != "joint"
        for parameter in parameters
    }


def _with_arguments(doc: str, arguments: dict[str, bool]) -> str:
    if not arguments:
        return doc
    return f"{doc}  ({' '.join(name if is_needed else f'[{name}]' for name, is_needed in arguments.items())})"
