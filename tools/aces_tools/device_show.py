"""`aces device` without an action: which devices a robot has, and what one of them can do. No bus is opened."""

from __future__ import annotations

import inspect
import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from .device_text import aligned_rows

if TYPE_CHECKING:
    from aces_bus.device import Device, DeviceConfig, Robot, Signal


def show_devices(robot: Robot, as_json: bool) -> int:
    """The devices of a robot with their joints and sensors."""
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
        print(json.dumps(rows, ensure_ascii=False, indent=2))
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
    """The signals and actions of a device."""
    if as_json:
        whole = {
            "device": device.name,
            "driver": config.driver,
            "signals": {
                one.name: {
                    "unit": one.unit,
                    "read": one.name in device.readable,
                    "set": one.is_writable,
                    "lower": one.lower,
                    "upper": one.upper,
                    "doc": one.doc,
                }
                for one in signals
            },
            "actions": {
                name: {"doc": doc, "arguments": arguments_of(device, name), "asks": name in device.asking}
                for name, doc in device.actions.items()
            },
        }
        print(json.dumps(whole, ensure_ascii=False, indent=2))
        return 0
    print(f"{device.name}: {config.driver} on bus {config.bus}, {credential_text(device.credentials)}")
    table: list[tuple[str, ...]] = []
    for one in signals:
        ways = ["set"] * one.is_writable + ["read"] * (one.name in device.readable)
        limits = "" if one.lower is None or one.upper is None else f" {one.lower:g}…{one.upper:g}"
        table.append((one.name, one.unit or "–", ", ".join(ways) + limits, one.doc))
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


def credential_text(credentials: Mapping[str, int]) -> str:
    """`board 0x03, sensor 0x01`."""
    return ", ".join(f"{key} {value:#04x}" for key, value in credentials.items())


def arguments_of(device: Device, action: str) -> dict[str, bool]:
    """The names of an action's arguments; True: must be given."""
    parameters = inspect.signature(getattr(device, action)).parameters.values()
    return {
        one.name: one.default is inspect.Parameter.empty
        and one.kind is not inspect.Parameter.VAR_KEYWORD
        and one.name != "joint"
        for one in parameters
    }


def _with_arguments(doc: str, arguments: dict[str, bool]) -> str:
    if not arguments:
        return doc
    return f"{doc}  ({' '.join(name if is_needed else f'[{name}]' for name, is_needed in arguments.items())})"


__all__ = ["arguments_of", "credential_text", "show_device", "show_devices"]
