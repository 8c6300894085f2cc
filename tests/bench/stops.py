"""Ends of `aces device … set … --enable --tx` against `aces sim`: after each the board is off, and was told so on the wire.

    python -m tests.bench.stops                 5 ends of each kind; a table
    python -m tests.bench.stops --runs 50       what a release is held against

Programs, signals and sockets are real, and so is time: this says how often an end works on a busy machine. What has to
hold each time is in the tests of gates, hosts and tools, in virtual time.
"""

from __future__ import annotations

import argparse
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from contextlib import ExitStack, redirect_stdout
from dataclasses import dataclass, field
from io import StringIO
from typing import Any

import can

from aces_bus import Frame, load_robot, make_scanner
from aces_bus.frames import message_to_frame
from aces_bus.robot.rig import bus_variants
from aces_tools.main import main as aces

ROBOT, JOINT = "hubo2plus", "RHP"
#: How a command ends, and the signal that ends it (None: its time is up).
ENDS: dict[str, int | None] = {
    "time": None,
    "SIGINT": signal.SIGINT,
    "SIGTERM": signal.SIGTERM,
    "SIGHUP": signal.SIGHUP,
}
WAIT_S = 60.0


@dataclass
class Result:
    """What became of the ends of one kind."""

    runs: int = 0
    off: int = 0
    told: int = 0
    statuses: Counter[int] = field(default_factory=Counter[int])
    #: From the signal, or the command's own end, to ControlOff on the wire (s).
    latest_s: float = 0.0

    @property
    def is_good(self) -> bool:
        """Whether every end was one."""
        return self.runs == self.off == self.told


class Command:
    """`aces …` as a process of its own: a fork of this one, which has all modules loaded, so that its start costs little."""

    def __init__(self, *words: str) -> None:
        self._errors = tempfile.TemporaryFile()  # noqa: SIM115
        self.pid = os.fork()
        if self.pid:
            return
        status = 99
        try:
            with open(os.devnull, "wb") as nowhere:
                os.dup2(nowhere.fileno(), 1)
            os.dup2(self._errors.fileno(), 2)
            # A test's own streams may lead elsewhere.
            sys.stdout, sys.stderr = os.fdopen(1, "w"), os.fdopen(2, "w", buffering=1)
            status = aces(list(words))
        finally:
            os._exit(status)

    def poll(self) -> bool:
        """Whether it has ended."""
        return os.waitid(os.P_PID, self.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None

    def wait(self) -> int:
        """Its exit status; minus the signal that killed it."""
        return os.waitstatus_to_exitcode(os.waitpid(self.pid, 0)[1])

    def said(self) -> str:
        """What it wrote to stderr."""
        self._errors.seek(0)
        return self._errors.read().decode()


class Stand:
    """The simulated robot, and a listener on the joint's bus."""

    def __init__(self) -> None:
        self.robot = load_robot(ROBOT)
        joint = self.robot.joints[JOINT]
        self.config = self.robot.devices[joint.device]
        self.board = self.config.credentials["board"]
        self.environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
        self.sim = subprocess.Popen(
            [sys.executable, "-m", "aces_tools", "sim", "-r", ROBOT],
            env=self.environment,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        channel = f"unix:{self.robot.buses[self.config.bus].channel}"
        self.bus: Any = None
        until = time.monotonic() + WAIT_S
        while self.bus is None:
            try:
                self.bus = can.Bus(channel=channel, interface="aces")
            except can.CanError:
                if time.monotonic() > until or self.sim.poll() is not None:
                    raise
                time.sleep(0.1)
        with redirect_stdout(StringIO()):
            aces(["device", JOINT, "-r", ROBOT, "--virtual", "get"])  # loads what it needs
        (self.variant,) = bus_variants(self.robot, self.config.bus)
        self.scanner = make_scanner([self.variant], include_unknown=True)

    def received(self, wait_s: float) -> list[Any]:
        """The joint's board's records of the next so many seconds."""
        records: list[Any] = []
        until = time.monotonic() + wait_s
        while (left := until - time.monotonic()) > 0:
            message = self.bus.recv(left)
            if message is not None:
                records += self.scanner.feed([message_to_frame(message)])
        return [record for record in records if getattr(record, "board", None) == self.board]

    def await_record(self, name: str, command: Command | None = None) -> float | None:
        """When a record of this name came; None: the command has ended without."""
        until = time.monotonic() + WAIT_S
        while time.monotonic() < until:
            if any(type(record).__name__ == name for record in self.received(0.02)):
                return time.monotonic()
            if command is not None and command.poll():
                return None
        raise TimeoutError(f"no {name} within {WAIT_S:g} s")

    def is_off(self) -> bool:
        """Ask the board, once all that it said before was heard: a status may leave after a ControlOff that it precedes."""
        self.received(0.1)
        frame = self.variant.encoder.packet(self.variant["SendStatus"], {"board": self.board})
        self.scanner.sent(frame)
        assert isinstance(frame, Frame)
        self.bus.send(can.Message(arbitration_id=frame.arbitration_id, data=frame.data, is_extended_id=False))
        until = time.monotonic() + WAIT_S
        while time.monotonic() < until:
            for record in self.received(0.01):
                if type(record).__name__.startswith("Status"):
                    return all("control_on" not in motor.drive for motor in record.motor)
        raise TimeoutError("the board does not answer")

    def close(self) -> None:
        if self.bus is not None:
            self.bus.shutdown()
        self.sim.terminate()
        self.sim.wait(WAIT_S)


def one(stand: Stand, end: int | None, chance: random.Random, result: Result) -> None:
    """One command, from its start to its end."""
    duration = "1s" if end is None else "60s"
    command = Command(
        *("device", JOINT, "-r", ROBOT, "-i", "aces"),
        *("set", "position=0.1", "--enable", "--for", duration, "--tx"),
    )
    result.runs += 1
    if stand.await_record("ControlOn", command) is None:
        raise RuntimeError(f"it never began: {command.wait()}: {command.said()}")
    began = time.monotonic()
    if end is not None:
        time.sleep(chance.random())
        began = time.monotonic()
        os.kill(command.pid, end)
    off_at = stand.await_record("ControlOff", command) or (
        time.monotonic() if any(type(r).__name__ == "ControlOff" for r in stand.received(0.2)) else None
    )
    status = command.wait()
    result.statuses[status] += 1
    if off_at is not None:
        result.told += 1
        result.latest_s = max(result.latest_s, off_at - began)
    if stand.is_off():
        result.off += 1
    else:
        print(f"still on, exit status {status}: {command.said()}", file=sys.stderr)


def _restore(before: str | None) -> None:
    if before is None:
        del os.environ["XDG_RUNTIME_DIR"]
    else:
        os.environ["XDG_RUNTIME_DIR"] = before


def measure(runs: int, seed: int = 0) -> dict[str, Result]:
    """So many ends of each kind; seeds choose when signals come."""
    found = {name: Result() for name in ENDS}
    chance = random.Random(seed)
    with ExitStack() as stack:
        before = os.environ.get("XDG_RUNTIME_DIR")
        os.environ["XDG_RUNTIME_DIR"] = stack.enter_context(tempfile.TemporaryDirectory())
        stack.callback(_restore, before)
        stand = Stand()
        stack.callback(stand.close)
        for number in range(runs):
            for name, end in ENDS.items():
                one(stand, end, chance, found[name])
            print(f"{number + 1} of {runs}", file=sys.stderr)
    return found


def table(found: dict[str, Result]) -> str:
    """One line a kind of end."""
    lines = [f"{'end':<8} {'runs':>5} {'off':>5} {'ControlOff':>10}  {'latest':>8}  exit status"]
    for name, result in found.items():
        statuses = ", ".join(f"{status}: {count}" for status, count in sorted(result.statuses.items()))
        lines.append(
            f"{name:<8} {result.runs:>5} {result.off:>5} {result.told:>10}  {result.latest_s:>6.3f} s  {statuses}"
        )
    return "\n".join(lines)


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--runs", type=int, default=5, metavar="N", help="ends of each kind (default: 5)")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of when signals come")
    arguments = parser.parse_args()
    found = measure(arguments.runs, arguments.seed)
    print(table(found))
    return 0 if all(result.is_good for result in found.values()) else 1


if __name__ == "__main__":
    sys.exit(main())
