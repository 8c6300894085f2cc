"""Search for what breaks a device: frames by its spec, beside it, out of order.

  aces device fuzz odrive --twin               a driver's twin, in virtual time
  aces device fuzz RHY -r hubo2plus --virtual  the twin of a robot's device
  aces device fuzz pump --twin --driver pump.py --rests-after 0.5s --then turn
  aces device fuzz dynamixel --twin --not FactoryReset --not Write.address=7..8
  aces device fuzz odrive --twin --seed 7 --frames 100000 --json
  aces device fuzz METER -r robot.toml --tx --for 1min         a real device
  aces device fuzz pump --twin --replay pump-silent-1f0c9a52.log

It is sent valid messages, edges of their fields, damaged and random frames, in
any order, and is asked its polls in between. Something is broken when it does
not answer any more, answers twice, with another's number, what its spec calls
malformed or a value outside of what its spec declares; a twin also when it
raises. Of a twin the fewest frames that break a fresh one are found and saved
as a capture.

A real device is sent only what asks it: the messages of its driver's polls.
--only NAME sends others, --allow-motion all that carry its number. It is
stopped at the end, also by Ctrl-C, and the search ends with the first fault.
"""

from __future__ import annotations

import argparse
import os
import shlex
import time
from collections.abc import Callable
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

from aces_bus.errors import CallerError, DeviceError, NotStoppedError
from aces_bus.protocol import Record
from aces_tools.console import StatusLine, print_json, say, say_note, write_text
from aces_tools.options import (
    FOR,
    JSON,
    OUTPUT,
    QUIET,
    TX,
    Arguments,
    Group,
    argument,
    at_least,
    duration,
    flag,
    positive,
    several,
)
from aces_tools.robot_arg import ROBOT_AND_BUSES, chosen_robot, use_driver_files

if TYPE_CHECKING:
    from aces_bus.device import Robot
    from aces_bus.device.config import Bus

    from .fuzzer import DeviceFinding, DeviceFuzzer
    from .trial import Expectations

#: Frames where neither number nor time is given: of a twin, of a real device.
TWIN_FRAMES, LIVE_FRAMES = 10_000, 500
#: Frames between two looks at the time, and seconds between two lines of progress.
TASK, STEP_S = 500, 0.25
#: Lines of a finding's frames.
LINES = 24

SUMMARY = "search for what breaks a device: a twin, or a real one (--tx)"

EPILOG = """\
what may follow --not: a message, or one with some values of a field:
  FactoryReset, Write.address=7, Write.address=7..8,31, Nmt.command=stop
What a device is meant to do (a factory reset that changes its speed) is no
fault: leave it out.

again: everything follows from --seed: the same seed finds the same. A finding
is saved as a capture: --replay tries it on a fresh twin, 'aces play' repeats
it on any bus; both commands are printed.

exit status:
  0    nothing was found
  1    something broke; --tx is missing; the device was NOT stopped
  2    a wrong call, or a bus that cannot be opened
  130  after Ctrl-C, when nothing was found
"""

USAGE = "%(prog)s NAME [--twin | --virtual | --tx] [options]"
ARGUMENTS: Arguments = (
    argument("name", metavar="NAME", help="a device, joint or sensor of the robot; with --twin a driver"),
    Group(
        "which device",
        (
            flag("--twin", help="the twin of the driver NAME: the first device of its example"),
            flag("--virtual", help="the twin of the robot's device NAME"),
            TX.but(help="the real device NAME, slowly"),
        ),
        is_exclusive=True,
    ),
    several("--only", metavar="MESSAGE", help="send only this message; may be given several times"),
    several(
        "--not", metavar="MESSAGE[.FIELD=VALUES]", help="do not send this; may be given several times"
    ).but(dest="leave_out"),
    flag("--allow-motion", help="real device: send what moves or enables it, too"),
    argument(
        "--frames",
        type=at_least(1),
        metavar="N",
        help="number of frames (default: 10,000; a real device: 500)",
    ),
    FOR.but(help="for this time instead: 10min"),
    argument(
        "--rate", type=positive, default=50.0, metavar="N", help="real device: N a second (default: 50)"
    ),
    argument("--seed", type=int, metavar="N", help="begin with this seed (default: another each time)"),
    argument(
        "--rests-after",
        type=duration,
        metavar="DURATION",
        help="twin: without a frame for this time it must be at rest, as when it was fresh: a watchdog",
    ),
    several(
        "--then", metavar="ACTION", help="twin: this action of its driver must succeed after any sequence"
    ),
    argument("--most", type=at_least(1), default=3, metavar="N", help="end after N findings (default: 3)"),
    argument("--replay", metavar="FILE", help="twin: try this capture on a fresh one, nothing else"),
    OUTPUT.but(help="save the first finding there (.log of CAN, .slog of a serial line)"),
    argument(
        "--failures",
        metavar="DIR",
        default=os.path.join(".aces", "failures"),
        help="where to save findings otherwise (default: %(default)s)",
    ),
    JSON,
    QUIET.but(help="no progress; findings and the summary"),
    ROBOT_AND_BUSES,
)


def run(arguments: argparse.Namespace) -> int:
    searching = Searching(arguments)
    if arguments.twin or arguments.virtual:
        return searching.replay() if arguments.replay else searching.twin()
    for option in ("replay", "rests_after", "then"):
        if getattr(arguments, option):
            raise CallerError(f"--{option.replace('_', '-')} is for twins: add --twin or --virtual")
    return searching.real()


class Searching:
    """One run. A wrong call raises before anything is opened."""

    def __init__(self, arguments: argparse.Namespace) -> None:
        self.arguments = arguments
        self.example: str | None = None
        self.robot, self.name = self._device()
        self.seed: int = (
            arguments.seed if arguments.seed is not None else time.time_ns() // 1_000_000 % 1_000_000
        )
        self.status_line = StatusLine(is_wanted=not arguments.quiet and not arguments.json)
        self.began = self._shown = time.monotonic()
        self.is_over = False
        self.saved: dict[str, Path] = {}

    def _device(self) -> tuple[Robot, str]:
        """Return the robot and the device that are meant."""
        arguments = self.arguments
        if not arguments.twin:
            from aces_tools.device import config_of

            robot = chosen_robot(
                arguments.robot,
                arguments.driver,
                how="--robot NAME or FILE.toml (a driver's own example: --twin)",
            )
            return robot, config_of(robot, arguments.name).name
        if arguments.robot:
            raise CallerError("--twin is a driver's example; of a robot's device: --virtual")
        use_driver_files(arguments.driver)
        from aces_bus.device import load_driver

        from .fuzzer import example_of

        driver = load_driver(arguments.name)
        self.example = driver.example
        return example_of(driver)

    # ------------------------------------------------------------------ a twin

    def _fuzzer(self) -> DeviceFuzzer:
        from .fuzzer import DeviceFuzzer

        arguments = self.arguments
        for option in ("bus", "interface", "baud", "allow_motion"):
            if getattr(arguments, option):
                raise CallerError(f"--{option.replace('_', '-')} is for a real device; this is a twin")
        return DeviceFuzzer(
            self.robot,
            self.name,
            seed=self.seed,
            only=arguments.only,
            leave_out=arguments.leave_out,
            expected=self._expected(),
        )

    def _expected(self) -> Expectations:
        from .trial import Expectations

        return Expectations(rests_ns=self.arguments.rests_after, actions=tuple(self.arguments.then))

    def twin(self) -> int:
        """Search in virtual time."""
        fuzzer = self._fuzzer()
        arguments = self.arguments
        for problem in fuzzer.fresh.problems:
            say(f"{self.name}, fresh: {problem.text}")
        if not fuzzer.fresh.answers and not fuzzer.fresh.periods:
            say_note(
                f"{self.name} neither answers polls nor sends by itself: only what it does else is judged"
            )
        frames = arguments.frames or TWIN_FRAMES
        try:
            while not self._is_enough(fuzzer.sent, frames) and len(fuzzer.findings) < arguments.most:
                left = TASK if arguments.duration is not None else min(TASK, frames - fuzzer.sent)
                for found in fuzzer.run(
                    left,
                    most=arguments.most,
                    progress=lambda: self._progress(fuzzer.sent, len(fuzzer.findings), frames),
                ):
                    self._print(found)
        except KeyboardInterrupt:
            self.is_over = True
        return self._end(fuzzer.sent, fuzzer.findings)

    def replay(self) -> int:
        """Try a capture on a fresh twin."""
        from .fuzzer import capture_steps

        fuzzer = self._fuzzer()
        steps = capture_steps(self.arguments.replay, fuzzer.link)
        problem, _, _ = fuzzer.judged(steps)
        text = "nothing is wrong after it" if problem is None else f"{problem.kind}: {problem.text}"
        if self.arguments.json:
            found = None if problem is None else {"kind": problem.kind, "text": problem.text}
            print_json({"device": self.name, "capture": self.arguments.replay, "finding": found}, None)
        else:
            print(f"{self.name} {text}")
        return 0 if problem is None else 1

    def _is_enough(self, sent: int, frames: int) -> bool:
        if self.is_over:
            return True
        if self.arguments.duration is not None:
            return time.monotonic() - self.began >= float(self.arguments.duration) / 1e9
        return sent >= frames

    def _progress(self, sent: int, found: int, frames: int) -> bool:
        now = time.monotonic()
        if now - self._shown >= STEP_S:
            self._shown = now
            rate = sent / max(1e-3, now - self.began)
            self.status_line.show(f"{sent:,} frames  {rate:,.0f}/s  {found} found")
        return not self._is_enough(sent, frames)

    # ------------------------------------------------------------------ a real device

    def real(self) -> int:
        """Search on a bus, slowly."""
        from aces_bus.device.config import alone
        from aces_bus.robot import open_gates
        from aces_bus.runtime.loop import Loop
        from aces_tools.patience import Patience
        from aces_tools.robot_arg import bus_options, check_channels

        from .live import LiveDeviceFuzzer

        arguments = self.arguments
        robot = alone(self.robot, self.name)
        options = bus_options(robot, arguments)
        if arguments.tx:
            check_channels(robot, options)
        with Patience() as patience, Loop() as loop:
            ports: Any = open_gates(robot, loop, options) if arguments.tx else None
            fuzzer = LiveDeviceFuzzer(
                self.robot,
                self.name,
                ports if ports is not None else self._no_ports(),
                seed=self.seed,
                only=arguments.only,
                leave_out=arguments.leave_out,
                allow_motion=arguments.allow_motion,
                rate_hz=arguments.rate,
            )
            self._say_what_is_sent(fuzzer)
            if not arguments.tx:
                say("nothing was sent: add --tx, or --virtual for its twin")
                return 1
            frames = arguments.frames or (1 << 62 if arguments.duration is not None else LIVE_FRAMES)

            def progress() -> bool:
                self.is_over |= patience.is_over
                return self._progress(fuzzer.sent, 0, frames)

            return self._searched(fuzzer, frames, progress, patience)

    def _no_ports(self) -> dict[str, Any]:
        """Return ports on no bus: the packets are known without one."""
        from aces_bus.device.config import alone
        from aces_bus.robot import VirtualRobot

        return VirtualRobot(alone(self.robot, self.name)).ports("nowhere")

    def _say_what_is_sent(self, fuzzer: Any) -> None:
        names = ", ".join(message.name for message in fuzzer.rules.messages)
        left = f"; left out: {', '.join(fuzzer.left_out)}" if fuzzer.left_out else ""
        more = "" if self.arguments.only or self.arguments.allow_motion else " (--only, --allow-motion)"
        say_note(f"{self.name}: sent are {names}{left}{more if left else ''}")

    def _searched(self, fuzzer: Any, frames: int, progress: Callable[[], bool], patience: Any) -> int:
        """Return the search on an open bus; whatever ends it, the device is stopped."""
        found: DeviceFinding | None = None
        status = 0
        with patience.stopping():
            try:
                self._open(fuzzer)
                try:
                    found = fuzzer.run(frames, progress)
                finally:
                    fuzzer.stop()
            except NotStoppedError as error:
                say(str(error))
                status = 1
            except DeviceError as error:
                say(str(error))
                status = 1
            finally:
                fuzzer.close()
        self.is_over = patience.is_over
        if found is not None:
            self._print(found)
        return status or self._end(fuzzer.sent, [] if found is None else [found])

    @staticmethod
    def _open(fuzzer: Any) -> None:
        try:
            fuzzer.open()
        except (CallerError, DeviceError):
            raise
        except Exception as error:  # whatever a backend or the system may raise
            said = " ".join(str(error).split()) or type(error).__name__
            raise CallerError(f"bus {fuzzer.device.host.name} cannot be opened: {said}") from error

    # ------------------------------------------------------------------ what was found

    def _print(self, found: DeviceFinding) -> None:
        """Save a finding, and print it with the commands that repeat it."""
        self.status_line.clear()
        arguments = self.arguments
        target = Path(arguments.output) if arguments.output and not self.saved else None
        if target is None:
            target = Path(arguments.failures)
            target.mkdir(parents=True, exist_ok=True)
        path = found.save(target)
        self.saved[found.stem] = path
        if arguments.json:
            return
        lines = [str(found), *(f"    {line}" for line in step_lines(found)), f"  saved: {path}", "  again:"]
        print("\n".join([*lines, *(f"    {line}" for line in self._commands(found, path))]), flush=True)

    def _commands(self, found: DeviceFinding, path: Path) -> list[str]:
        """Return what repeats a finding."""
        arguments = self.arguments
        more = "".join(f" --driver {shlex.quote(file)}" for file in arguments.driver)
        file = shlex.quote(str(path))
        bus = self.robot.buses[found.bus]
        if not (arguments.twin or arguments.virtual):
            channel = self._given_channel(bus)
            return [
                f"aces play {file} {_where(bus.link, channel, arguments.interface or bus.interface)} --tx"
            ]
        wanted = arguments.robot or os.environ.get("ACES_ROBOT", "")
        robot = f" -r {shlex.quote(wanted)}" if arguments.virtual else ""
        kind = "--twin" if arguments.twin else "--virtual"
        judged = f" --rests-after {arguments.rests_after / 1e9:g}s" if arguments.rests_after else ""
        judged += "".join(f" --then {action}" for action in arguments.then)
        again = f"aces device fuzz {shlex.quote(arguments.name)} {kind}{robot}{more}{judged} --replay {file}"
        if self.example is not None:
            text = path.parent / f"{arguments.name}.toml"
            write_text(str(text), self.example, is_quiet=True)
            robot = f" -r {shlex.quote(str(text))}"
        channel = f"unix:{bus.channel or bus.name}" if bus.link == "can" else None
        play = f"aces play {file} {_where(bus.link, channel, 'aces')} --tx"
        return [again, f"aces sim{robot}{more}     # and in another window:", play]

    def _given_channel(self, bus: Bus) -> str | None:
        for text in self.arguments.bus:
            name, equals, channel = str(text).partition("=")
            if not equals or name == bus.name:
                return channel if equals else name
        return bus.channel

    def _end(self, sent: int, findings: list[DeviceFinding]) -> int:
        """Print the summary, and return the status."""
        self.status_line.clear()
        seconds = max(1e-3, time.monotonic() - self.began)
        if self.arguments.json:
            print_json(
                {
                    "device": self.name,
                    "seed": self.seed,
                    "frames": sent,
                    "seconds": round(seconds, 3),
                    "interrupted": self.is_over,
                    "findings": [self._as_object(finding) for finding in findings],
                }
            )
        found = f"{len(findings)} found" if findings else "nothing found"
        begun = "interrupted: " if self.is_over else ""
        say(
            f"{begun}frames={sent} seconds={seconds:.1f} rate={sent / seconds:.0f}/s seed={self.seed}: {found}",
            who="",
        )
        return 1 if findings else 130 if self.is_over else 0

    def _as_object(self, found: DeviceFinding) -> dict[str, Any]:
        return {
            "kind": found.problem.kind,
            "subject": found.problem.subject,
            "text": found.problem.text,
            "frames": len(found.steps),
            "steps": step_lines(found),
            "capture": str(self.saved[found.stem]),
            "commands": self._commands(found, self.saved[found.stem]),
            "found_after": found.packets,
        }


def _where(link: str, channel: str | None, interface: str | None) -> str:
    """Return how `aces play` reaches a bus."""
    if link == "can":
        return f"{f'-i {interface} ' if interface else ''}-c {channel}"
    if link == "serial":
        return f"--serial {channel or 'PORT'}"
    return f"--udp {channel or 'HOST:PORT'}"


def step_lines(found: DeviceFinding) -> list[str]:
    """Return the packets of a finding, one a line: `2 × Configure key=0 value=65535`; what is not a message as it is on
    the wire.
    """
    lines = [f"{len(list(same)):>4} × {text}" for text, same in groupby(map(_shown, found.records()))]
    if len(lines) > LINES:
        lines = [*lines[:LINES], f"       and {len(lines) - LINES} more lines"]
    return lines


def _shown(record: Record) -> str:
    from aces_bus import Unknown
    from aces_bus.protocol.record import field_names
    from aces_tools.device_text import shown_value
    from aces_tools.output.shape import json_value

    if isinstance(record, Unknown):
        meta = record.meta
        where = "" if meta.identifier is None else f"{meta.identifier:03X}#"
        return f"{where}{meta.raw.hex().upper()} ({record.reason})"
    fields = [
        f"{name}={shown_value(json_value(getattr(record, name)))}" for name in field_names(type(record))
    ]
    return " ".join([type(record).__name__, *fields])
