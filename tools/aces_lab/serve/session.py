"""The run behind a served robot: the server serves, every millisecond, until the run ends."""

from __future__ import annotations

import argparse
from collections.abc import Sequence

from aces_bus.controller.log import Logger
from aces_bus.robot import Runner
from aces_bus.robot.rig import Rig
from aces_tools.console import say, say_note
from aces_tools.running.session import Session

from .server import RobotServer


def serve_robot(
    arguments: argparse.Namespace, server: RobotServer, loggers: Sequence[Logger], rate_hz: float
) -> int:
    """Run the server's desk until the run ends; the exit status."""
    session = Session(arguments, server.desk.robot, [server.desk], loggers, rate_hz, verb="robot serve")
    rigs: list[Rig] = []

    def begin(runner: Runner) -> None:
        rigs.append(runner.rig)
        _say_start(server, runner.rig)

    def serve() -> bool:
        for rig in rigs:
            server.poll(rig)
        return False

    session.opened, session.is_ended = begin, serve
    try:
        return session.run()
    finally:
        stopped_by = rigs[0].stopped_by if rigs else ""
        server.close(f"stopped by {stopped_by}" if stopped_by else "its run has ended")


def _say_start(server: RobotServer, rig: Rig) -> None:
    """Say where it is served, and what becomes of the devices when this program dies."""
    where = f"{rig.robot.name} is served at {server.path}"
    say_note(where if server.drives else f"{where}; nothing is transmitted (no --tx)")
    outcomes: dict[str, list[str]] = {}
    for device in rig.devices.values() if server.drives else ():
        if device.joints:
            loss = device.host_loss
            watched = ", as it has no watchdog of its own" if loss.lacks_watchdog else ""
            outcomes.setdefault(f"{loss}{watched}", []).append(device.name)
    for text, names in outcomes.items():
        say(f"if this program dies, each of {', '.join(names)} {text}")
