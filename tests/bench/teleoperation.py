"""SO-101 teleoperation in real time: a leader that is moved, a follower that follows, a pseudo-terminal each.

    python -m tests.bench.teleoperation --seconds 20

1. Twins, wires and the hand are another process; what is measured of CPU is the host's alone.
2. Latency is from where the hand has the leader to the goal in the packet to the follower: the hand is a known function of
   time, so a goal's age is how long ago the leader was there. Joints that hardly move at the moment are left out.
3. Times of a shared machine vary.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from statistics import quantiles
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "examples"))

from teleoperation import JOINTS, SO101, follow, hand

from aces_bus.controller import IGNORE
from aces_bus.hardware.ports import SerialPort
from aces_bus.hardware.simulated.serial_line import PtyPort, SimulatedSerialLine
from aces_bus.robot import run_real
from aces_bus.robot.buses import wire_of
from aces_bus.robot.rig import simulate
from aces_bus.runtime import VirtualClock
from aces_devices.feetech import FeetechTwin
from aces_protocols.feetech.spec import feetech, sts_table

#: How often the hand moves the leader (ns).
HAND_NS = 5_000_000
#: Cycles a second (Hz).
RATE = follow.rate_hz
#: Slower than this (rad/s) a joint's position says little of an instant.
SLOW = 0.5
#: How long a thread may keep the interpreter (s), as `aces run` has it.
SWITCH_S = 0.0001
#: What tells the other process to say what it has found.
END = "end\n"


def twins_process() -> None:
    """Twins on two pseudo-terminals and a hand; says where they are, and at the end how old the goals were (ms)."""
    sys.setswitchinterval(SWITCH_S)
    ages: list[float] = []
    began = time.monotonic_ns()
    with ExitStack() as stack:
        ports: dict[str, Any] = {}
        ptys: dict[str, PtyPort] = {}
        wires: dict[str, SimulatedSerialLine] = {}
        for name, bus in SO101.buses.items():
            wire = wire_of(bus, feetech, VirtualClock(time.monotonic_ns()))
            assert isinstance(wire, SimulatedSerialLine)
            wires[name], ptys[name] = wire, stack.enter_context(PtyPort(wire))
            ports[name] = SerialPort(wire, name=name)
        for pty in ptys.values():
            pty.lock.acquire()
        pose = {f"leader_{name}": hand(name, 0.0) for name in JOINTS}
        simulation = simulate(SO101, ports, pose={**pose, **{name: hand(name, 0.0) for name in JOINTS}})
        leader = {name: simulation.twins[SO101.joint(f"leader_{name}").device] for name in JOINTS}
        by_id = {SO101.devices[SO101.joint(name).device].credentials["id"]: name for name in JOINTS}
        scanner = feetech.scanner(direction="to device")
        goal = sts_table["goal_position"]

        def move() -> None:
            t = (time.monotonic_ns() - began) / 1e9
            for name, twin in leader.items():
                assert isinstance(twin, FeetechTwin)
                twin.turn_by_hand(hand(name, t))
            wires["leader"].clock.call_in(HAND_NS, move)

        def heard(data: bytes, _: int) -> None:
            t = (time.monotonic_ns() - began) / 1e9
            for record in scanner.feed(data):
                if type(record).__name__ == "SyncWrite" and record.start == goal.address:
                    ages.extend(filter(None, (_age(by_id[one.id], one.data, t) for one in record.servos)))

        wires["follower"].attach("ear", heard)
        simulation.open()
        move()
        for pty in ptys.values():
            pty.lock.release()
        print(json.dumps({name: pty.path for name, pty in ptys.items()}), flush=True)
        sys.stdin.readline()
        for pty in ptys.values():
            pty.lock.acquire()
        print(json.dumps(ages), flush=True)


def _age(name: str, data: bytes, t: float) -> float | None:
    """How long ago (ms) the leader was where a goal is; None where that cannot be said."""
    joint = SO101.joint(name)
    assert joint.zero is not None
    at = int.from_bytes(data, "little") * 2 * 3.141592653589793 / 4096 - joint.zero
    speed = (hand(name, t + 1e-3) - hand(name, t - 1e-3)) / 2e-3
    before = (hand(name, t - 0.2) - hand(name, t - 0.202)) / 2e-3
    return (
        (hand(name, t) - at) / speed * 1e3
        if min(abs(speed), abs(before)) > SLOW and speed * before > 0
        else None
    )


def main(arguments: Sequence[str] | None = None) -> None:
    """Run it and print what it took."""
    parser = argparse.ArgumentParser(
        description="teleoperation of an SO-101 over two pseudo-terminals, in real time"
    )
    parser.add_argument("--seconds", type=float, default=20.0)
    seconds = parser.parse_args(arguments).seconds
    command = [sys.executable, "-c", "from tests.bench.teleoperation import twins_process; twins_process()"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as twins:
        assert twins.stdin is not None
        assert twins.stdout is not None
        paths = json.loads(twins.stdout.readline())
        sys.setswitchinterval(SWITCH_S)
        buses = {name: {"channel": path} for name, path in paths.items()}
        reactions = {"*": IGNORE}  # a busy machine is not a fault
        with run_real(SO101, [follow], buses=buses, transmit=True, reactions=reactions) as run:
            run.do("enable", devices=run.driven(run.supervisors[0]))
            cpu, wall = time.process_time(), time.monotonic()
            ended = run.run(seconds)
            cpu, wall = time.process_time() - cpu, time.monotonic() - wall
        twins.stdin.write(END)
        twins.stdin.flush()
        ages = json.loads(twins.stdout.readline())
    cuts = quantiles(ages, n=100)
    print(
        f"latency, leader to the follower's goal: median {cuts[49]:.1f} ms, 99 % {cuts[98]:.1f} ms ({len(ages)} goals)"
    )
    print(f"CPU of the host: {cpu / wall:.0%} of one core, {cpu / wall / RATE * 1e3:.2f} ms a cycle")
    for name, host in run.rig.hosts.items():
        c = host.counts
        print(
            f"{name}: {c.ticks} ticks, {c.ticks_missed} left out, {c.missed} unanswered,"
            f" a round of polls {c.cycle_sum_ns / max(1, c.cycles) / 1e6:.1f} ms"
        )
    print(ended)


if __name__ == "__main__":
    main()
