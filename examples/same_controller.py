"""The paper's claim: one controller, unchanged, on a humanoid over CAN, on a small one over serial, and on a recording.

`walk_controller.py` steps in place on Hubo 2+ (motor boards on CAN), on MiniHubo (servos on a serial line), and on what was
recorded of the first run: only the robot's file is another. On the recording it sees what it saw then and gives
what it gave then, and nothing moves.

    python examples/same_controller.py
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from walk_controller import LEGS, walk

from aces_bus import Frame, load_robot
from aces_bus.hardware import ListeningNode
from aces_bus.robot import Runner, VirtualRobot, run_replay, run_virtual

HUBO = load_robot("hubo2plus").part(*walk.writes)  # its legs and waist
MINIHUBO = load_robot(Path(__file__).with_name("minihubo_like_hubo.toml"))


class Notes:
    """Beside the controller, and after it: what it gave in each cycle, and where the joints were then."""

    name, rate_hz, states = "notes", walk.rate_hz, LEGS

    def __init__(self) -> None:
        self.run: Runner  # the one that it is noted of
        self.given: list[dict[str, float]] = []
        self.worst = 0.0

    def bind(self, states: Mapping[str, Any]) -> None:
        self.bound = states

    def start(self, now: int) -> None:
        """Nothing to open."""

    def step(self, now: int) -> None:
        for name, wanted in (self.given[-1] if self.given else {}).items():
            self.worst = max(self.worst, abs(self.bound[name][0] - wanted))
        self.given.append(dict(self.run.given))

    def stop(self, now: int) -> None:
        """Nothing to close."""


def said(where: str, notes: Notes, run: Runner) -> None:
    knee = max(row["LKP"] for row in notes.given if row)
    print(
        f"{where}: {run.set_points} set-points, knee up to {knee:.3f} rad,"
        f" joints within {notes.worst:.3f} rad of what was wanted; {', '.join(run.ended().tripped.values()) or 'no trips'}"
    )


def on_hubo(seconds: float) -> tuple[Notes, list[Frame], int]:
    """Over CAN; what was on both buses, and when (ns) the controller began."""
    hubo = VirtualRobot(HUBO, rate_hz=100)
    recorders = {name: ListeningNode(wire) for name, wire in hubo.wires.items()}
    notes = Notes()
    run = notes.run = run_virtual(hubo, [walk], loggers=[notes])
    with run:
        run.do("home")
        run.do("enable")
        began = run.clock.now()
        run.run(seconds)
    said("Hubo 2+, CAN", notes, run)
    received = [(at, name, frame) for name, recorder in recorders.items() for at, frame in recorder.received]
    frames = [
        Frame(f.arbitration_id, f.data, at / 1e9, name)
        for at, name, f in sorted(received, key=lambda one: one[0])
    ]
    return notes, frames, began


def on_minihubo(seconds: float) -> Notes:
    """Over serial."""
    notes = Notes()
    run = notes.run = run_virtual(MINIHUBO, [walk], loggers=[notes])
    with run:
        run.do("enable")
        run.run(seconds)
    said("MiniHubo, serial", notes, run)
    return notes


def on_recording(frames: list[Frame], began: int, seconds: float) -> Notes:
    """On what was recorded, from a little before the controller began."""
    since = [frame for frame in frames if (frame.timestamp or 0.0) > began / 1e9 - 0.1]
    notes = Notes()
    run = notes.run = run_replay(HUBO, since, [walk], loggers=[notes])
    with run:
        run.clock.wait(lambda: False, began - round((since[0].timestamp or 0.0) * 1e9))
        run.run(seconds)
    said(f"recording, {len(since)} frames", notes, run)
    return notes


def main(seconds: float = 2.4) -> tuple[Notes, Notes, Notes]:
    print(f"{walk.name}: {walk.rate_hz:g} Hz, reads {', '.join(walk.states)}, sets {', '.join(walk.writes)}")
    first, frames, began = on_hubo(seconds)
    second, third = on_minihubo(seconds), on_recording(frames, began, seconds)
    same = sum(a == b for a, b in zip(first.given, third.given, strict=False))
    print(f"on the recording it gave the same as on the robot in {same} of {len(first.given)} cycles")
    return first, second, third


if __name__ == "__main__":
    main()
