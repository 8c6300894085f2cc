"""Talk to one device, joint or sensor of a robot: read, set, watch, do things.

  aces device                           the devices of $ACES_ROBOT, their joints
  aces device RHY                       what it has: signals, actions
  aces device RHY get                   all it knows, once
  aces device RHY get position velocity
  aces device RHY watch position        a line every 0.1 s, until Ctrl-C
  aces device JMC0 enable --tx          an action
  aces device RHY home --tx             with its progress
  aces device RHY set position=0.2 --enable --for 3s --tx
  aces device JMC0 set_gains channel=0 kp=200 ki=0 kd=500 --tx

With --robot hubo2plus --virtual nothing is needed: the robot's twins answer, in
virtual time. Reading asks the device; whatever changes it needs --tx. Values
are SI. A joint's name is enough: the device that has it is found.
"""

from __future__ import annotations

import argparse
import ast
import inspect
import json
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from aces_bus.errors import AcesError, CallerError, DeviceError, UnknownNameError

from .console import say
from .live import LivePatience, parse_duration
from .robot_arg import Opened, add_robot_arguments, chosen_robot, opened

if TYPE_CHECKING:
    from aces_bus.device import Device, Robot, Signal

#: The rate of the host where the robot's file says none (Hz).
RATE = 50.0
#: Seconds in which a signal must be heard by `get`.
HEARD_S = 2.0

EPILOG = """\
exit status: 0; 1 when a value stayed unknown, an action failed, or --tx is
missing; 2 a wrong call, or a bus that cannot be opened
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.epilog = EPILOG
    add = parser.add_argument
    add("name", nargs="?", metavar="NAME", help="a device, joint or sensor of the robot")
    add("action", nargs="?", metavar="ACTION", help="get, set, watch, or an action of the device")
    add("values", nargs="*", metavar="SIGNAL|NAME=VALUE", help="signals to read; what to set; arguments")
    add("--tx", action="store_true", help="really change something; nothing else makes it")
    add("--enable", action="store_true", help="set: enable the device before, and disable it after")
    add(
        "--for", dest="duration", metavar="DURATION", help="set: keep it up so long (default: 2s); watch: end"
    )
    add("--every", metavar="DURATION", default="0.1s", help="watch: between two lines (default: 0.1s)")
    add("--json", action="store_true", help="JSON; watch: an object a line")
    add_robot_arguments(parser)


def run(arguments: argparse.Namespace) -> int:
    robot = chosen_robot(arguments.robot)
    if arguments.name is None:
        return _list(robot, arguments.json)
    if arguments.action is None:
        return _describe(robot, arguments)
    config = _config_of(robot, arguments.name)
    action = arguments.action
    every = parse_duration("--every", arguments.every)
    duration = None if arguments.duration is None else parse_duration("--for", arguments.duration)
    changes = action not in ("get", "watch")
    values = _pairs(arguments.values) if changes else {}
    if changes and action != "set":
        _check_action(_described(robot, config.name), action, values)
    if changes and not arguments.tx and not arguments.virtual:
        say(f"'{action}' changes the device: nothing was sent; add --tx")
        return 1
    alone = _alone(robot, config.name)
    with LivePatience() as patience, opened(alone, arguments, rate_hz=robot.rate_hz or RATE) as live:
        device = live.rig.device(arguments.name)
        part = arguments.name if arguments.name != device.name else None
        told = _Told(live)
        try:
            if action == "get":
                return _get(live, device, part, arguments)
            if action == "watch":
                return _watch(live, device, part, arguments, every, duration, patience)
            if action == "set":
                return _set(live, device, part, values, arguments, duration, patience)
            return _act(live, device, part, action, values, arguments, patience)
        finally:
            told.print()


class _Told:
    """What happened to the device, on stderr at the end."""

    def __init__(self, live: Opened) -> None:
        self.live = live

    def print(self) -> None:
        for event in self.live.rig.events.last:
            if event.kind in ("opened", "closed", "error-active"):
                continue
            say(f"{event.device or event.bus}: {event.kind}{f': {event.detail}' if event.detail else ''}")


# ---------------------------------------------------------------------- what there is


def _config_of(robot: Robot, name: str) -> Any:
    """The device that is meant; raises `UnknownNameError`."""
    aliases = {alias: joint.name for joint in robot.joints.values() for alias in joint.aliases}
    aliases |= {alias: sensor.name for sensor in robot.sensors.values() for alias in sensor.aliases}
    whole = aliases.get(name, name)
    parts: dict[str, Any] = {**robot.sensors, **robot.joints}
    device = parts[whole].device if whole in parts else whole
    if device not in robot.devices:
        raise UnknownNameError(f"device, joint or sensor of {robot.name}", name, [*robot.devices, *parts])
    if not robot.devices[device].active:
        raise CallerError(f"{device} is listed as inactive in {robot.name}; set active = true in its file")
    return robot.devices[device]


def _alone(robot: Robot, name: str) -> Robot:
    """The robot with this device only: nobody else is asked anything."""
    from msgspec.structs import replace

    devices = {n: replace(c, active=c.active and n == name) for n, c in robot.devices.items()}
    return replace(robot, devices=devices)


def _list(robot: Robot, as_json: bool) -> int:
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
    width = max((len(row["device"]) for row in rows), default=0)
    for row in rows:
        parts = " ".join([*row["joints"], *row["sensors"]])
        numbers = ", ".join(f"{k} {v:#04x}" for k, v in row["credentials"].items())
        state = "" if row["active"] else " (inactive)"
        print(f"{row['device']:<{width}}  {row['bus']}  {row['driver']}  {numbers}{state}  {parts}".rstrip())
    return 0


def _describe(robot: Robot, arguments: argparse.Namespace) -> int:
    config = _config_of(robot, arguments.name)
    device = _described(robot, config.name)
    part = arguments.name if arguments.name != device.name else None
    signals = _signals(device, part)
    if arguments.json:
        whole = {
            "device": device.name,
            "driver": config.driver,
            "signals": {
                s.name: {
                    "unit": s.unit,
                    "set": s.is_writable,
                    "lower": s.lower,
                    "upper": s.upper,
                    "doc": s.doc,
                }
                for s in signals
            },
            "actions": dict(device.actions),
        }
        print(json.dumps(whole, ensure_ascii=False, indent=2))
        return 0
    print(f"{device.name}: {config.driver} on bus {config.bus}, {_credentials(device)}")
    width = max((len(signal.name) for signal in signals), default=0)
    for one in signals:
        limits = "" if one.lower is None or one.upper is None else f" {one.lower:g}…{one.upper:g}"
        way = "set, read" if one.is_writable else "read"
        print(f"  {one.name:<{width}}  {one.unit or '–':<6} {way}{limits}  {one.doc}".rstrip())
    print("actions")
    width = max(map(len, device.actions), default=0)
    for action, doc in device.actions.items():
        print(f"  {action:<{width}}  {doc}{_arguments_of(getattr(device, action))}")
    return 0


def _credentials(device: Device) -> str:
    return ", ".join(f"{key} {value:#04x}" for key, value in device.credentials.items())


def _arguments_of(method: Callable[..., Any]) -> str:
    names = [
        one.name if one.default is inspect.Parameter.empty else f"[{one.name}]"
        for one in inspect.signature(method).parameters.values()
    ]
    return f"  ({' '.join(names)})" if names else ""


def _signals(device: Device, part: str | None) -> list[Signal]:
    """All signals, or those of one joint or sensor."""
    if part is None:
        return list(device.signals.values())
    names = {part, *(joint.name for joint in device.joints if part in joint.aliases)}
    names |= {sensor.name for sensor in device.sensors if part in sensor.aliases}
    return [one for one in device.signals.values() if one.name.partition(".")[0] in names]


def _chosen(device: Device, part: str | None, names: list[str]) -> list[Signal]:
    signals = _signals(device, part)
    if not names:
        return signals
    found: list[Signal] = []
    for name in names:
        near = [one for one in signals if name in (one.name, one.name.partition(".")[2])]
        if not near:
            raise UnknownNameError(f"signal of {part or device.name}", name, [one.name for one in signals])
        found += near
    return found


# ---------------------------------------------------------------------- get and watch


def _get(live: Opened, device: Device, part: str | None, arguments: argparse.Namespace) -> int:
    signals = [
        one
        for one in _chosen(device, part, arguments.values)
        if one.name in device.readable or arguments.values
    ]
    live.clock.wait(lambda: all(one.instant is not None for one in signals), round(HEARD_S * 1e9))
    if arguments.json:
        whole = {
            one.name: {"value": plain(one.value), "unit": one.unit, "age_s": _age(one)} for one in signals
        }
        print(json.dumps(whole, ensure_ascii=False, indent=2))
    else:
        width = max((len(one.name) for one in signals), default=0)
        for one in signals:
            print(f"{one.name:<{width}}  {text(one)}")
    return 1 if any(one.instant is None for one in signals) else 0


def _watch(
    live: Opened,
    device: Device,
    part: str | None,
    arguments: argparse.Namespace,
    every: int,
    duration: int | None,
    patience: LivePatience,
) -> int:
    signals = _chosen(device, part, arguments.values)
    start = live.clock.now()
    due = start + every
    widths = [max(len(one.name), 14) for one in signals]
    if not arguments.json:
        print(
            "  ".join(["time".rjust(9), *(one.name.rjust(w) for one, w in zip(signals, widths, strict=True))])
        )
    while not patience.is_over and (duration is None or due <= start + duration):
        live.clock.wait(lambda: patience.is_over, max(0, due - live.clock.now()))
        seconds = (live.clock.now() - start) / 1e9
        if arguments.json:
            values = {one.name: plain(one.value) for one in signals}
            print(json.dumps({"time": round(seconds, 6), **values}, ensure_ascii=False), flush=True)
        else:
            cells = [text(one).rjust(w) for one, w in zip(signals, widths, strict=True)]
            print("  ".join([f"{seconds:9.3f}", *cells]), flush=True)
        due += every
    return 0


def plain(value: Any) -> Any:
    """A value as JSON has it; unknown is null."""
    from aces_bus.device import UNKNOWN

    if value is UNKNOWN:
        return None
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if hasattr(value, "__struct_fields__"):
        return {
            name: plain(getattr(value, name)) for name in value.__struct_fields__ if not name.startswith("_")
        }
    try:
        return [plain(item) for item in value]
    except TypeError:
        return str(value)


def text(one: Signal) -> str:
    """A signal's value with its unit; what is unknown or stale says so."""
    if one.instant is None:
        return "unknown"
    value = one.last
    shown = f"{value:.6g}" if isinstance(value, float) else str(value)
    if one.unit:
        shown += f" {one.unit}"
    age = _age(one)
    return f"{shown} (stale, {age:.1f} s old)" if one.is_stale and age is not None else shown


def _age(one: Signal) -> float | None:
    return None if one.age_ns is None else one.age_ns / 1e9


# ---------------------------------------------------------------------- set and actions


def _pairs(texts: list[str]) -> dict[str, Any]:
    """`kp=200 mode=torque` as values: numbers, true, false, lists; everything else is text."""
    found: dict[str, Any] = {}
    for one in texts:
        name, equals, value = one.partition("=")
        if not equals or not name:
            raise CallerError(f"{one}: write NAME=VALUE")
        if value in ("true", "false"):
            found[name] = value == "true"
            continue
        try:
            found[name] = ast.literal_eval(value)
        except (ValueError, SyntaxError, MemoryError, RecursionError):
            found[name] = value
    return found


def _described(robot: Robot, name: str) -> Device:
    """The device, on no bus: what it has can be looked at."""
    from aces_bus.assembly import VirtualRobot

    return VirtualRobot(_alone(robot, name)).devices[name]


def _check_action(device: Device, action: str, values: dict[str, Any]) -> None:
    """Whether a device has such an action with such arguments, before anything is opened."""
    if action not in device.actions:
        known = ["get", "set", "watch", *device.actions]
        raise UnknownNameError(f"action of {device.name} ({device.config.driver})", action, known)
    parameters = inspect.signature(getattr(device, action)).parameters
    takes_any = any(one.kind is inspect.Parameter.VAR_KEYWORD for one in parameters.values())
    for name in values:
        if name not in parameters and not takes_any:
            raise UnknownNameError(f"argument of {action}", name, parameters)


def _set(
    live: Opened,
    device: Device,
    part: str | None,
    values: dict[str, Any],
    arguments: argparse.Namespace,
    duration: int | None,
    patience: LivePatience,
) -> int:
    if not values:
        raise CallerError("what? aces device NAME set SIGNAL=VALUE …")
    targets = [(signal, value) for name, value in values.items() for signal in _chosen(device, part, [name])]
    for one, value in targets:
        if not one.is_writable:
            raise CallerError(f"{one.name} is read-only")
        if one.unit and (isinstance(value, bool) or not isinstance(value, int | float)):
            raise CallerError(f"{one.name}: {value!r} is no number of {one.unit}")
    if arguments.enable:
        if "enable" not in device.actions:
            raise CallerError(f"{device.name} is not enabled; leave --enable away")
        _finish(live, live.clock.call(getattr(device, "enable")), patience)  # noqa: B009
    soon = live.clock.now() + (duration if duration is not None else 2_000_000_000)

    def give() -> None:
        for one, value in targets:
            one.set(value)

    live.clock.call(give)
    live.clock.wait(lambda: patience.is_over, soon - live.clock.now())
    if arguments.json:
        print(json.dumps({one.name: plain(one.value) for one, _ in targets}, ensure_ascii=False))
    else:
        for one, value in targets:
            print(f"{one.name}: set {value} {one.unit}".rstrip() + f", is {text(one)}")
    if arguments.enable:
        ended = live.clock.call(device.stop_motion)
        if ended is not None:
            _finish(live, ended, patience)
    return 0


def _act(
    live: Opened,
    device: Device,
    part: str | None,
    action: str,
    values: dict[str, Any],
    arguments: argparse.Namespace,
    patience: LivePatience,
) -> int:
    method = getattr(device, action)
    if part is not None and "joint" in inspect.signature(method).parameters:
        values.setdefault("joint", live.rig.aliases.get(part, part))
    live.clock.wait(lambda: device.last_heard is not None, 1_000_000_000)
    try:
        started = live.clock.call(lambda: method(**values))
        result = None if started is None else _finish(live, started, patience)
    except DeviceError as error:
        say(str(error))
        return 1
    except TypeError as error:
        raise CallerError(f"{action}: {error}") from None
    shown = plain(result)
    if arguments.json:
        print(json.dumps({"action": action, "result": shown}, ensure_ascii=False))
    else:
        print(f"{arguments.name} {action}: done" + (f": {shown}" if shown is not None else ""))
    return 0


def _finish(live: Opened, awaited: Any, patience: LivePatience) -> Any:
    """Wait for a ticket or job, with its progress; Ctrl-C cancels a job."""
    import sys

    is_shown = sys.stderr.isatty() and live.virtual is None
    end = live.clock.now() + 300_000_000_000
    while not awaited.is_over and not patience.is_over and live.clock.now() < end:
        live.clock.wait(lambda: awaited.is_over or patience.is_over, 200_000_000)
        if is_shown and hasattr(awaited, "progress"):
            print(f"\r{awaited.progress:4.0%} {awaited.text:<40.40}", end="", file=sys.stderr)
    if is_shown:
        print("\r" + " " * 50 + "\r", end="", file=sys.stderr)
    if not awaited.is_over:
        if hasattr(awaited, "cancel"):
            live.clock.call(awaited.cancel)
        raise DeviceError("interrupted" if patience.is_over else f"{awaited!r} is not over after 300 s")
    if awaited.error is not None:
        error: AcesError = awaited.error
        raise error
    return awaited.result
