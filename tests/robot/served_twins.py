"""A robot's twins on served buses, as a process of its own, that does what it reads on stdin and answers on stdout.

    python -m tests.robot.served_twins PATH          a leg of Hubo 2+, whose bus is PATH
    python -m tests.robot.served_twins FOLDER all    the complete robot, each bus in the folder

Lines of JSON: `["fault", "JMC1", "silent", true]`, `["deaf", "JMC1", true]`, `["reboot", "JMC1"]`, `["bus-off"]` (the
client's controller leaves the bus), `["off"]` → the boards that are off, `["on"]` → those that are on,
`["off_at"]` → when each was switched off, since it was on (ns of the machine's monotonic clock).
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from aces_bus import Frame, load_robot
from aces_bus.hardware import CanGate
from aces_bus.hardware.ports import port_of
from aces_bus.hardware.served.channel import ServedChannel
from aces_bus.hardware.served.server import BusServer
from aces_bus.robot.rig import simulate
from aces_bus.runtime.loop import Loop
from tests.robot.walking import hubo_leg

#: A limit that a machine twenty times slower keeps, too.
PATIENCE_S = 60.0


class Twins:
    """The process, for who starts it."""

    def __init__(self, path: Path, *more: str) -> None:
        self.path = path
        self.process = subprocess.Popen(
            [sys.executable, "-m", "tests.robot.served_twins", str(path), *more],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
        )
        assert self.process.stdout is not None
        assert json.loads(self.process.stdout.readline()) == "ready"

    def __call__(self, *words: Any) -> Any:
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        print(json.dumps(words), file=self.process.stdin, flush=True)
        return json.loads(self.process.stdout.readline())

    def close(self) -> None:
        """End it."""
        self.process.kill()
        self.process.communicate()  # which closes the pipes

    def wait_for(self, word: str, boards: list[str]) -> bool:
        """Whether these boards become "on" or "off"."""
        end = time.monotonic() + PATIENCE_S
        while time.monotonic() < end:
            if self(word) == boards:
                return True
            time.sleep(0.02)
        return False


def main() -> None:
    path, is_all = Path(sys.argv[1]), sys.argv[2:] == ["all"]
    robot = load_robot("hubo2plus") if is_all else hubo_leg()
    channels = {
        name: ServedChannel(name, bitrate=1_000_000) for name in (robot.buses if is_all else ("lower",))
    }
    server = BusServer(channels.values(), unix=str(path), tcp=None, socketcand=None)
    threading.Thread(target=server.serve, daemon=True).start()
    with Loop("twins") as loop:
        ports = {
            name: port_of(CanGate({"interface": "aces", "channel": server.addresses[name][0]}), loop)
            for name in channels
        }
        with simulate(robot, ports) as twins:
            mine = list(channels["lower"].wire.nodes)
            note_off(twins, time.monotonic_ns, OFF_AT)
            answer("ready")
            for line in sys.stdin:
                word, *rest = json.loads(line)
                if word == "bus-off":
                    server.clock.post(0, lambda: leave(channels["lower"], mine))
                    answer(True)
                else:
                    answer(loop.call(partial(do, twins, word, rest)))
    server.stop()


OFF_AT: dict[str, int] = {}


def note_off(twins: Any, now: Callable[[], int], off_at: dict[str, int]) -> None:
    """Have each board note when it is switched off."""
    for name, twin in twins.twins.items():
        if hasattr(twin, "channels"):
            channel = twin.channels[0]

            def switch(at: int, *, name: str = name, switch: Any = channel.switch, **how: Any) -> None:
                switch(at, **how)
                if how.get("control") is False:
                    off_at.setdefault(name, now())
                elif how.get("control"):
                    off_at.pop(name, None)

            channel.switch = switch


def answer(what: Any) -> None:
    print(json.dumps(what), flush=True)


def leave(channel: ServedChannel, mine: list[Any]) -> None:
    """The clients' controllers have seen too many errors."""
    for node in channel.wire.nodes:
        if node not in mine:
            for _ in range(40):
                node.count_errors(8, 0, Frame(0))


def do(twins: Any, word: str, rest: list[Any]) -> Any:
    boards = {name: twin for name, twin in twins.twins.items() if name.startswith("JMC")}
    match word, rest:
        case "fault", (name, fault, is_on):
            twins[name].fault(fault, on=is_on)
        case "reboot", (name,):
            twins[name].reboot()
        case "deaf", (name, is_deaf):
            for channel in twins[name].channels:
                channel.switch = (lambda now, **_: None) if is_deaf else type(channel).switch.__get__(channel)
        case "off_at", ():
            return OFF_AT
        case "on" | "off", ():
            on = [name for name, twin in boards.items() if any(c.control_on for c in twin.channels)]
            return on if word == "on" else [name for name in boards if name not in on]
        case _:
            raise ValueError(word)
    return True


if __name__ == "__main__":
    main()
