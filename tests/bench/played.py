"""What a robot's host costs by itself: its loop in lock-step with recorded answers, on real sockets, in virtual time.

1. What the robot's twins answer to each poll is recorded once they are enabled; played, the same request has the same
   answer. Set-points have none: the robot stays where it is, enabled.
2. The loop's time is played, too: whenever it would wait, the next thing happens at once. No other process takes part and
   no deadline can be missed, so that the load of the machine shows in nothing but what CPU itself costs.
3. All else is as in life: the sockets of served buses, one frame at a time as a bus carries them, each of which wakes the
   loop; all guards on. What the other end costs is left out.

With threads instead of one loop (the gates' own), each step of the other end waits until they have done their part.
"""

from __future__ import annotations

import heapq
import json
import select
import socket
import tempfile
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from aces_bus import Frame, load_robot
from aces_bus.controller import IGNORE
from aces_bus.device import Robot
from aces_bus.hardware.served import packets
from aces_bus.robot import Runner, VirtualRobot, connect, open_gates
from aces_bus.runtime.loop import Loop
from aces_bus.runtime.tasks import VirtualTasks

#: What is answered to a request, by its identifier and data.
Answers = Mapping[tuple[int, bytes], Sequence[Frame]]
#: How long an answer is waited for when it is recorded (ns).
ANSWER_NS = 5_000_000
#: A classic frame of no data on the wire, and each byte of it, in bits that are not stuffed (ISO 11898-1).
FRAME_BITS, BYTE_BITS = 47, 8
#: Seconds of virtual time before it is measured: hold-offs are over, all joints are led.
WARM_S = 0.5
#: How often it is looked whether all buses are open (s).
OPENING_S = 0.001
#: Seconds that threads may take for one step of the other end.
PATIENCE_S = 30.0


def recorded_answers(robot: Robot, rate_hz: float) -> dict[str, Answers]:
    """By bus, what the enabled robot's twins answer to each poll. For robots on CAN."""
    made = VirtualRobot(robot, rate_hz=rate_hz, seed=1)
    made.simulation.open()
    made.rig.open()
    made.rig.each("enable").wait()
    made.rig.close()
    made.advance(10 * ANSWER_NS / 1e9)  # what is under way is over
    found: dict[str, Answers] = {}
    for name, host in made.rig.hosts.items():
        received: list[Frame] = []
        node = made.wires[name].attach("asks", lambda frame, _, received=received: received.append(frame))
        node.hears_sent = False
        answers: dict[tuple[int, bytes], Sequence[Frame]] = {}
        for slot in host.slots:
            packet = slot.packet
            assert isinstance(packet, Frame)
            node.send(packet)
            made.advance(ANSWER_NS / 1e9)
            answers[packet.arbitration_id, packet.data] = tuple(received)
            received.clear()
        found[name] = answers
    return found


class _PlayedBus:
    """The other end of one served bus, and when its wire is free (ns)."""

    def __init__(self, answers: Answers, bitrate: int, path: Path) -> None:
        self.name, self.bitrate = path.stem, bitrate
        self.answers = {
            key: [(one.arbitration_id, one.data, self.wire_ns(len(one.data))) for one in frames]
            for key, frames in answers.items()
        }
        self.listener = socket.socket(socket.AF_UNIX)
        self.listener.bind(str(path))
        self.listener.listen()
        self.client: socket.socket | None = None
        #: What is due: instant, number, packet; how many frames were taken.
        self.due: list[tuple[int, int, bytes]] = []
        self.taken = self._count = self._free_at = 0
        self._rest = b""

    def wire_ns(self, size: int) -> int:
        """How long a frame of so many bytes occupies the bus."""
        return (FRAME_BITS + BYTE_BITS * size) * 1_000_000_000 // self.bitrate

    def welcome(self) -> None:
        """Take the one client."""
        client, _ = self.listener.accept()
        client.recv(4096)
        client.sendall(packets.value_packet(packets.Welcome(self.name, 0, False, self.bitrate, 0)))
        self.client = client

    def close(self) -> None:
        """The end of it."""
        self.listener.close()
        if self.client is not None:
            self.client.close()

    def take(self, now: int) -> None:
        """What the client has sent: answers follow behind all of it."""
        assert self.client is not None
        found, self._rest = packets.split_packets(self._rest + self.client.recv(65_536))
        free = max(self._free_at, now)
        given: list[tuple[int, bytes, int]] = []
        for kind, body in found:
            for _, identifier, _, length, data in packets.unpack_records(kind, body):
                self.taken += 1
                free += self.wire_ns(length)
                given += self.answers.get((identifier, data[:length]), ())
        for identifier, data, wire_ns in given:
            free += wire_ns
            self._count += 1
            one = packets.CLASSIC_PACKET.pack(24, packets.CLASSIC, free, identifier, 0, len(data), data)
            heapq.heappush(self.due, (free, self._count, one))
        self._free_at = free


class _PlayedTime:
    """The time of a loop, and all that happens while it waits. `cost_ns`: what that took of its thread."""

    def __init__(self, buses: Sequence[_PlayedBus], *, threads: bool) -> None:
        self.buses, self.threads = buses, threads
        self.instant = 1_000_000_000
        self.cost_ns = 0
        #: How many frames each bus was given; threads send them in their own time.
        self.given: Callable[[str], int] = lambda name: 0

    def now(self) -> int:
        """This instant (ns)."""
        return self.instant

    def wait(self, readers: Any, _: Any, __: Any, left: float | None) -> tuple[list[int], Any, Any]:
        """Have the next thing happen, at once."""
        if any(bus.client is None for bus in self.buses):  # no time passes before all buses are open
            return select.select(readers, (), (), OPENING_S)
        began = time.thread_time_ns()
        for bus in self.buses:
            self._take(bus)
        until = None if left is None else self.instant + round(left * 1e9)
        while True:
            due = [bus for bus in self.buses if bus.due]
            first = min(due, key=lambda bus: bus.due[0][0], default=None)
            is_written = False
            if left != 0:
                if first is not None and (until is None or first.due[0][0] <= until):
                    instant, _, packet = heapq.heappop(first.due)
                    self.instant = max(self.instant, instant)
                    assert first.client is not None
                    first.client.send(packet)
                    is_written = True
                elif until is not None:
                    self.instant = until
            # A thread that receives wakes the loop when it has.
            patience = (
                PATIENCE_S if is_written and self.threads else None if left is None and first is None else 0
            )
            if not is_written or self.threads or select.select(readers, (), (), 0)[0]:
                break  # else the loop does not wait for this file, and sleeps on
        self.cost_ns += time.thread_time_ns() - began
        return select.select(readers, (), (), patience)

    def _take(self, bus: _PlayedBus) -> None:
        """Take all that the host has given to this bus."""
        assert bus.client is not None
        if not self.threads:
            if select.select((bus.client,), (), (), 0)[0]:
                bus.take(self.instant)
            return
        end = time.monotonic() + PATIENCE_S
        while bus.taken < self.given(bus.name) and time.monotonic() < end:
            if select.select((bus.client,), (), (), PATIENCE_S)[0]:
                bus.take(self.instant)


def measure(rate: str, seconds: str, way: str) -> None:
    """Drive the complete Hubo 2+ for so long, and print what it cost as JSON: frames, µs of CPU a frame."""
    from .robot import hide_files

    if way == "threads":
        hide_files()
    robot = load_robot("hubo2plus")
    answers = recorded_answers(robot, float(rate))
    with tempfile.TemporaryDirectory(prefix="aces") as folder, ExitStack() as stack:
        buses = [
            _PlayedBus(known, robot.buses[name].bitrate or 1_000_000, Path(folder) / f"{name}.sock")
            for name, known in answers.items()
        ]
        for bus in buses:
            stack.callback(bus.close)
        played = _PlayedTime(buses, threads=way == "threads")
        found = _measured(robot, played, folder, float(rate), float(seconds))
    print(json.dumps(found), flush=True)


def _measured(
    robot: Robot, played: _PlayedTime, folder: str, rate: float, seconds: float
) -> dict[str, float]:
    from .robot import walking_player

    loop = Loop(now=played.now, wait=played.wait)
    options = {
        bus.name: {"interface": "aces", "channel": f"unix:{Path(folder) / bus.name}.sock"}
        for bus in played.buses
    }
    rig = connect(robot, open_gates(robot, loop, options), rate_hz=rate)
    run = Runner(
        rig,
        [walking_player(robot, rate, seconds + WARM_S)],
        tasks=VirtualTasks(loop),
        reactions={"*": IGNORE},
        at_end="hold",
    )
    run.before.append(loop.start)
    run.after.append(loop.stop)
    for bus in played.buses:
        threading.Thread(target=bus.welcome, daemon=True).start()
    counts = {name: host.counts for name, host in rig.hosts.items()}
    played.given = lambda name: counts[name].sent
    noted: list[tuple[int, int, int]] = []
    over = threading.Event()

    def note() -> None:
        cpu = time.process_time_ns() - played.cost_ns
        frames = sum(one.sent + one.received for one in counts.values())
        noted.append((cpu, frames, sum(one.missed for one in counts.values())))
        if len(noted) == 2:
            over.set()

    with run:
        run.do("enable")
        run.start()
        for after in (WARM_S, WARM_S + seconds):
            loop.call_in(round(after * 1e9), note)
        over.wait()
    (cpu, frames, missed), (cpu_then, frames_then, missed_then) = noted
    return {
        "frames_s": (frames_then - frames) / seconds,
        "frame_us": (cpu_then - cpu) / (frames_then - frames) / 1e3,
        "missed": missed_then - missed,
    }


__all__ = ["measure", "recorded_answers"]
