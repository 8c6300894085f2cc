"""A robot's twins on a served bus, as a process of its own, that does what it reads on stdin and answers on stdout.

    python -m tests.robot.served_twins PATH

Lines of JSON: `["fault", "JMC1", "silent", true]`, `["deaf", "JMC1", true]`, `["reboot", "JMC1"]`, `["bus-off"]` (the
client's controller leaves the bus), `["off"]` → the boards that are off, `["on"]` → those that are on.
"""

from __future__ import annotations

import json
import sys
import threading
from pathlib import Path
from typing import Any

from aces_bus.hardware import CanGate, port_of
from aces_bus.hardware.served.channel import ServedChannel
from aces_bus.hardware.served.server import BusServer
from aces_bus.robot import simulate
from aces_bus.runtime import Loop
from tests.robot.walking import hubo_leg


def main() -> None:
    path = Path(sys.argv[1])
    channel = ServedChannel("lower", bitrate=1_000_000)
    server = BusServer([channel], unix=str(path), tcp=None, socketcand=None)
    threading.Thread(target=server.serve, daemon=True).start()
    options = {"interface": "aces", "channel": f"unix:{path}", "bitrate": 1_000_000}
    with Loop("twins") as loop, simulate(hubo_leg(), {"lower": port_of(CanGate(options), loop)}) as twins:
        mine = list(channel.wire.nodes)
        answer("ready")
        for line in sys.stdin:
            word, *rest = json.loads(line)
            if word == "bus-off":
                server.clock.post(0, lambda: leave(channel, mine))
                answer(True)
            else:
                answer(loop.call(lambda: do(twins, word, rest)))  # noqa: B023
    server.stop()


def answer(what: Any) -> None:
    print(json.dumps(what), flush=True)


def leave(channel: ServedChannel, mine: list[Any]) -> None:
    """The clients' controllers have seen too many errors."""
    for node in channel.wire.nodes:
        if node not in mine:
            for _ in range(40):
                node.count_errors(8, 0, None)


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
        case "on" | "off", ():
            on = [name for name, twin in boards.items() if any(c.control_on for c in twin.channels)]
            return on if word == "on" else [name for name in boards if name not in on]
    return True


if __name__ == "__main__":
    main()
