"""What `aces device` does on an open bus: get, watch, set, and a device's actions.

1. Everything about the call that can be wrong without a bus was looked at before (`checked`).
2. Whatever ends it, motion that this call began is stopped: after `set --enable`, and when an action is interrupted.
   Until then no signal interrupts anything: it ends the waiting, and what has not stopped is said by name.
"""

from __future__ import annotations

import inspect
import sys
import time
from argparse import Namespace
from collections.abc import Callable, Generator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from aces_bus.device import Device
from aces_bus.device.signals import Signal
from aces_bus.device.stopping import stop_devices, wait_stopped
from aces_bus.errors import CallerError, DeviceError, NotStoppedError, UnknownNameError
from aces_bus.protocol.record import FieldValue

from .console import ENDLESS, StatusLine, print_json, say, say_note
from .device_text import host_loss_text, reading, result_lines, shown_value, value_for
from .output.shape import json_value
from .patience import Patience

if TYPE_CHECKING:
    from .live import DeviceEventLines
    from .robot_arg import Opened


#: Seconds in which `get` must receive a signal, and a device must answer before anything is sent to it.
HEARD_S, ANSWERS_S = 2.0, 1.0
#: How long `set` keeps it up without --for (ns); how long an action may take at most (ns); a look at what happens (ns).
SET_FOR, LONGEST, STEP = 2_000_000_000, 300_000_000_000, 200_000_000


def signals_of(device: Device, part: str | None) -> list[Signal]:
    """Return all signals, or those of one joint or sensor with those of the device itself."""
    if part is None:
        return list(device.signals.values())
    names = {part, *(joint.name for joint in device.joints if part in joint.aliases)}
    names |= {sensor.name for sensor in device.sensors if part in sensor.aliases}
    owned = [(signal.name.partition(".")[0], signal) for signal in device.signals.values()]
    return [signal for owner, signal in owned if owner in names] + [
        signal for owner, signal in owned if owner == device.name and owner not in names
    ]


def chosen_signals(device: Device, part: str | None, names: list[str]) -> list[Signal]:
    """Return the signals of these names, with or without their owner's; raises `UnknownNameError`."""
    signals = signals_of(device, part)
    found: list[Signal] = []
    for name in names:
        near = [signal for signal in signals if name in (signal.name, signal.name.partition(".")[2])]
        if not near:
            raise UnknownNameError(
                f"signal of {part or device.name}", name, [signal.name for signal in signals]
            )
        found += [signal for signal in near if signal not in found]
    return found


def checked(device: Device, part: str | None, action: str, values: Any) -> None:
    """Raise `CallerError` unless the device has these signals, or this action with these arguments."""
    if action == "stop":
        return
    if action in ("get", "watch"):
        for signal in chosen_signals(device, part, values):
            if signal.name not in device.readable:
                raise CallerError(f"{signal.name} can only be set: {device.name} does not report it")
        if not values and not any(signal.name in device.readable for signal in signals_of(device, part)):
            raise CallerError(f"{part or device.name} reports nothing: it can only be set")
        return
    if action == "set":
        if not values:
            raise CallerError("set what? aces device NAME set SIGNAL=VALUE …")
        _targets(device, part, values)
        return
    if action not in device.actions:
        known = ["get", "set", "watch", "stop", *device.actions]
        raise UnknownNameError(f"action of {device.name} ({device.config.driver})", action, known)
    signature = inspect.signature(getattr(device, action))
    takes_any = any(
        parameter.kind is inspect.Parameter.VAR_KEYWORD for parameter in signature.parameters.values()
    )
    for name in values:
        if name not in signature.parameters and not takes_any:
            raise UnknownNameError(f"argument of {action}", name, signature.parameters)
    missing = [
        parameter.name
        for parameter in signature.parameters.values()
        if parameter.default is inspect.Parameter.empty
        and parameter.kind not in (inspect.Parameter.VAR_KEYWORD, inspect.Parameter.VAR_POSITIONAL)
        and parameter.name not in values
        and not (parameter.name == "joint" and part is not None)
    ]
    if missing:
        raise CallerError(f"{action} needs {' '.join(f'{name}=…' for name in missing)}")


def _targets(device: Device, part: str | None, values: dict[str, Any]) -> list[tuple[Signal, Any]]:
    """Return what is to be set to what; raises `CallerError`."""
    targets: list[tuple[Signal, Any]] = []
    for name, value in values.items():
        for signal in chosen_signals(device, part, [name]):
            if not signal.is_writable:
                can = [s.name for s in signals_of(device, part) if s.is_writable]
                raise CallerError(f"{signal.name} can only be read (to be set: {', '.join(can) or 'none'})")
            targets.append((signal, value_for(signal, value)))
    return targets


@dataclass
class Doing:
    """One call, on an open bus."""

    live: Opened
    device: Device
    #: The joint or sensor that is meant; None: the whole device.
    part: str | None
    arguments: Namespace
    patience: Patience
    events: DeviceEventLines

    def wait(self, until: Any, duration: int) -> bool:
        """Let time pass until that holds or Ctrl-C, reporting what happens meanwhile; whether it holds."""
        clock = self.live.clock
        end = clock.now() + duration
        while not until() and not self.patience.is_over and clock.now() < end:
            clock.wait(lambda: until() or self.patience.is_over, min(STEP, end - clock.now()))
            self.events.report()
            if self.live.rig.stopped_by:
                self.patience.is_over = True
        return bool(until())

    def readable(self, names: list[str]) -> list[Signal]:
        """Return what is to be read: those of these names, by default all that the device reports."""
        if names:
            return chosen_signals(self.device, self.part, names)
        return [
            signal for signal in signals_of(self.device, self.part) if signal.name in self.device.readable
        ]

    # ------------------------------------------------------------------ get and watch

    def get(self) -> int:
        """Return all that is known, once; 1 when something is unknown."""
        signals = self.readable(self.arguments.values)
        self.wait(lambda: all(signal.instant is not None for signal in signals), round(HEARD_S * 1e9))
        if self.arguments.json:
            whole = {
                signal.name: {
                    "value": json_value(signal.value),
                    "unit": signal.unit,
                    "age_s": None if signal.age_ns is None else signal.age_ns / 1e9,
                }
                for signal in signals
            }
            print_json(whole)
        else:
            width = max(len(signal.name) for signal in signals)
            for signal in signals:
                print(f"{signal.name:<{width}}  {reading(signal)}")
        missing = any(signal.instant is None for signal in signals)
        if missing and self.device.host.passive and self.device.last_received is None:
            say(f"nothing came from {self.device.name}: no other program asks it; --ask does")
        return 1 if missing else 0

    def watch(self, every: int, duration: int | None) -> int:
        """Show values again and again: a table that is kept up to date on a terminal, else a line each time."""
        signals = self.readable(self.arguments.values)
        if duration is None:
            say_note(ENDLESS)
        is_terminal = sys.stdout is not None and sys.stdout.isatty()
        if is_terminal and not self.arguments.json:
            with watched(signals) as show:
                return self._watch(signals, every, duration, show, is_paced=True)
        show = self._print_object if self.arguments.json else self._print_line
        if not self.arguments.json:
            names = [signal.name.rjust(_width(signal)) for signal in signals]
            print("  ".join(["time".rjust(9), *names]), flush=True)
        return self._watch(signals, every, duration, show, is_paced=is_terminal)

    def _watch(
        self, signals: list[Signal], every: int, duration: int | None, show: Any, *, is_paced: bool
    ) -> int:
        clock = self.live.clock
        start, began = clock.now(), time.monotonic_ns()
        due = start + every
        while not self.patience.is_over and (duration is None or due <= start + duration):
            self.wait(lambda: False, due - clock.now())
            if self.live.virtual is not None and is_paced:
                self.patience.wait_until(began + due - start)  # a person is watching
            if not self.patience.is_over:
                show((clock.now() - start) / 1e9, signals)
            due += every
            if self.live.virtual is None and due < clock.now():
                due += (clock.now() - due) // every * every + every  # late by whole lines: they are left out
        return 1 if all(signal.instant is None for signal in signals) else 0

    @staticmethod
    def _print_line(seconds: float, signals: list[Signal]) -> None:
        cells = [reading(signal).rjust(_width(signal)) for signal in signals]
        print("  ".join([f"{seconds:9.3f}", *cells]), flush=True)

    @staticmethod
    def _print_object(seconds: float, signals: list[Signal]) -> None:
        values = {signal.name: json_value(signal.value) for signal in signals}
        print_json({"time": round(seconds, 6), **values}, None)

    # ------------------------------------------------------------------ set

    def set(self, values: dict[str, FieldValue], duration: int | None) -> int:
        """Give set-points for a while; 1 when they cannot have been followed."""
        device = self.device
        if self.arguments.enable and "enable" not in device.actions:
            raise CallerError(f"{device.name} is not enabled or disabled; leave --enable away")
        if not self._is_there():
            self.events.report(last=True)
            say(f"{device.name} does not answer: nothing was set")
            return 1
        self.events.holding.add("not sent")
        self.live.rig.door.takes_unhomed = self.arguments.unhomed
        targets = _targets(device, self.part, values)  # again: now it is known what kind of value each has
        if not self.arguments.enable:
            return self._set(targets, duration)
        with self.patience.stopping():
            try:
                return self._set(targets, duration)
            finally:
                self.stop()

    def _set(self, targets: list[tuple[Signal, Any]], duration: int | None) -> int:
        device = self.device
        try:
            if self.arguments.enable:
                self.finish(self.live.clock.call(getattr(device, "enable")), stops=False)  # noqa: B009
            self.live.clock.call(lambda: self._give(targets))
            if duration is None:
                door = self.live.rig.door
                self.wait(lambda: not door.goals or bool(door.tripped), LONGEST)
                duration = SET_FOR
            self.wait(lambda: False, duration)
            if self.live.rig.stopped_by:
                say(f"{self.arguments.name} set: stopped by {self.live.rig.stopped_by}")
                return 1
            return self._show_set(targets)
        except DeviceError as error:
            self.events.report(without=("no reply",))
            say(f"{self.arguments.name} set: {error}")
            return 1

    def _give(self, targets: list[tuple[Signal, Any]]) -> None:
        """Hand set-points down; positions are led no faster than the joint's nominal speed, where it has one."""
        door, robot = self.live.rig.door, self.live.robot
        for target, value in targets:
            owner, _, quantity = target.name.partition(".")
            joint = robot.joints.get(owner)
            if joint is not None and joint.nominal_speed is not None and quantity == "position":
                door.pace(target.name, joint.nominal_speed)
            try:
                target.set(value)
            except (TypeError, ValueError, ArithmeticError) as error:
                raise CallerError(f"{target.name} cannot be set to {value!r}: {error}") from None

    def _is_there(self) -> bool:
        """Return whether the device has answered; one that is never polled may be there."""
        device = self.device
        chain = self.live.rig.chain
        self.wait(lambda: not chain.waits_for or self.patience.is_over, round(ANSWERS_S * 1e9))
        return not device.polls or self.wait(
            lambda: device.last_received is not None or self.patience.is_over, round(ANSWERS_S * 1e9)
        )

    def _show_set(self, targets: list[tuple[Signal, Any]]) -> int:
        device = self.device
        if self.arguments.json:
            print_json({target.name: json_value(target.value) for target, _ in targets}, None)
        else:
            for target, value in targets:
                now = f", is {reading(target)}" if target.name in device.readable else ""
                given = self.live.rig.door.given(target.name)
                taken = shown_value(json_value(value if given is None else given))
                print(f"{target.name}: set to {taken} {target.unit}".rstrip() + now)
        owners = {target.name.partition(".")[0] for target, _ in targets}
        idle = [o for o in owners if (e := device.signals.get(f"{o}.enabled")) and e.value is False]
        if idle and not self.arguments.enable:
            self.events.drop("not sent")
            say(f"{', '.join(sorted(idle))}: not enabled, so it follows no set-points; add --enable")
            return 1
        if self.arguments.enable and (off := self._no_longer_driven(targets)):
            self.events.drop("not sent")
            say(f"{', '.join(off)}: takes no set-points any more: it was switched off meanwhile")
            return 1
        is_deaf = bool(device.polls) and device.is_silent
        missing = self.live.clock.call(device.waited_for)
        if missing:
            say(f"{device.name}: was not sent; its message needs {', '.join(missing)} too: set both at once")
            return 1
        if self._is_changed(targets):
            return 1
        # What it has not taken is reported at the end.
        return 1 if is_deaf or self.live.rig.events.count("not sent", device.name) else 0

    def _no_longer_driven(self, targets: list[tuple[Signal, Any]]) -> list[str]:
        """Return what takes no set-points now, though it was enabled; the device is heard once more before that."""
        device, since = self.device, self.live.clock.now()
        if device.polls:  # this program may have been held up, and not know yet what became of it
            self.wait(lambda: (device.last_received or 0) > since, round(ANSWERS_S * 1e9))
        return [target.name for target, _ in targets if device.takes(target) is False]

    def _is_changed(self, targets: list[tuple[Signal, Any]]) -> bool:
        """Return whether a set-point was limited, has not been led all the way, or was refused; which is said."""
        door = self.live.rig.door
        changed = False
        for target, value in targets:
            goal, given = door.goal(target.name), door.given(target.name)
            if door.counts(target.name).position:
                limits = (
                    f"{target.lower:g} to {target.upper:g}"
                    if None not in (target.lower, target.upper)
                    else "its limits"
                )
                say(f"{target.name}: limited: {value:g} is not within {limits} {target.unit}".rstrip())
            elif goal is not None:
                so_far = "where it was" if given is None else f"{given:.4g} {target.unit}".rstrip()
                say(
                    f"{target.name}: limited in speed: only at {so_far} on the way to {goal:g}; say --for longer"
                )
            elif target.name not in door.tripped:
                continue
            changed = True
        return changed

    def stop_twin(self) -> int:
        """Stop a simulated device."""
        self.stop()
        print(f"{self.arguments.name} stop: done")
        return 0

    def stop(self) -> None:
        """Stop what moves, whatever was interrupted. Raises `NotStoppedError`."""
        device, clock = self.device, self.live.clock
        wait_stopped(clock.call(lambda: stop_devices(clock, device.name, [device])))

    # ------------------------------------------------------------------ actions

    def act(self, action: str, values: dict[str, Any]) -> int:
        """Have the device do something; 1 when it fails."""
        device = self.device
        method = getattr(device, action)
        if self.part is not None and "joint" in inspect.signature(method).parameters:
            values.setdefault("joint", self.live.rig.aliases.get(self.part, self.part))
        self._is_there()
        stops = action not in device.asking
        try:
            with self.patience.stopping():
                started = self.live.clock.call(lambda: method(**values))
                result = None if started is None else self.finish(started, stops=stops)
        except NotStoppedError:
            raise
        except DeviceError as error:
            self.events.report(without=("no reply", "silent"))
            say(f"{self.arguments.name} {action}: {error}")
            return 1
        except (TypeError, ValueError, AttributeError, ArithmeticError) as error:
            raise CallerError(f"{action}: one of its arguments is not of the right kind: {error}") from None
        if action == "enable" and self.live.virtual is None:
            say(host_loss_text(device))
        found = json_value(result)
        if self.arguments.json:
            print_json({"action": action, "result": found}, None)
        else:
            lines = result_lines(found)
            if len(lines) == 1:
                print(f"{self.arguments.name} {action}: {lines[0]}")
            else:
                print("\n".join([f"{self.arguments.name} {action}: done", *("  " + line for line in lines)]))
        return 0

    def finish(self, awaited: Any, *, stops: bool = True) -> Any:
        """Wait for a ticket or job, with its progress; Ctrl-C cancels it and stops what moves. Raises its error."""
        status_line = StatusLine(is_wanted=self.live.virtual is None)
        end = self.live.clock.now() + LONGEST
        try:
            while not awaited.is_over and not self.patience.is_over and self.live.clock.now() < end:
                self.wait(lambda: awaited.is_over, STEP)
                if hasattr(awaited, "progress"):
                    status_line.show(f"{awaited.progress:4.0%} {awaited.text:.60}".rstrip())
            status_line.clear()
        except BaseException:  # a terminal that has gone, for one
            if stops:
                self.stop()
            raise
        if not awaited.is_over:
            if hasattr(awaited, "cancel"):
                self.live.clock.call(awaited.cancel)
            if stops:
                self.stop()
            why = "interrupted" if self.patience.is_over else f"not over after {LONGEST / 1e9:g} s"
            raise DeviceError(f"{why}{', and stopped' if stops else ''}")
        if awaited.error is not None:
            raise awaited.error
        return awaited.result


def _width(signal: Signal) -> int:
    return max(len(signal.name), 14)


# ---------------------------------------------------------------------- on a terminal

Show = Callable[[float, "list[Signal]"], None]


@contextmanager
def watched(signals: list[Signal]) -> Generator[Show]:
    """Yield a function that shows them, at so many seconds; messages on stderr meanwhile appear above."""
    from rich.live import Live
    from rich.text import Text

    with Live(Text("…"), auto_refresh=False, redirect_stdout=False) as live:

        def show(seconds: float, signals: list[Signal]) -> None:
            live.update(_table(seconds, signals), refresh=True)

        yield show


def _table(seconds: float, signals: list[Signal]) -> Any:
    from rich.table import Table
    from rich.text import Text

    table = Table(
        box=None, padding=(0, 1, 0, 0), show_header=False, title=f"{seconds:.1f} s", title_justify="left"
    )
    table.add_column(no_wrap=True)
    table.add_column(justify="right", overflow="fold")
    table.add_column(no_wrap=True)
    table.add_column(overflow="ellipsis", no_wrap=True)
    for signal in signals:
        value, note, style = "unknown", "", "dim"
        if signal.instant is not None:
            value, style = shown_value(json_value(signal.last)), ""
            if signal.is_stale and signal.age_ns is not None:
                note, style = f"stale, {signal.age_ns / 1e9:.1f} s old", "dim"
        table.add_row(
            signal.name,
            Text(value, style),
            signal.unit if signal.instant is not None else "",
            Text(note, "dim"),
        )
    return table
