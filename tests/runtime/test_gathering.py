"""What comes for a file may wait for more: read together, in time, and at once where an answer is waited for."""

from __future__ import annotations

import select
import socket
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from aces_bus import Frame
from aces_bus.hardware import CanGate
from aces_bus.hardware.ports import port_of
from aces_bus.hardware.served import packets
from aces_bus.robot import connect
from aces_bus.runtime.loop import Loop
from tests.device.fan import ROBOT, drivers, fan, robot_of

US = 1_000
BEGIN = 1_000_000_000


class Played:
    """A time in which things happen as was planned, whenever the loop waits; `over` is when nothing is left to happen."""

    def __init__(self) -> None:
        self.instant = BEGIN
        self.plan: list[tuple[int, Callable[[], Any]]] = []
        self.is_running = False
        #: Closed with it, once the loop is.
        self.sockets: list[socket.socket] = []

    def at(self, after_us: int, happens: Callable[[], Any]) -> None:
        """Have something happen so long after the beginning."""
        self.plan.append((BEGIN + after_us * US, happens))

    def wait(self, readers: Any, _: Any, __: Any, left: float | None) -> tuple[list[int], Any, Any]:
        """As `select`."""
        until = None if left is None else self.instant + round(left * 1e9)
        while self.is_running:
            found = select.select(readers, (), (), 0)
            if found[0] or left == 0:
                return found
            self.plan.sort(key=lambda one: one[0])
            if self.plan and (until is None or self.plan[0][0] <= until):
                self.instant, happens = self.plan.pop(0)
                happens()
            elif until is not None:
                self.instant = until
                return [], (), ()
            else:
                break
        return select.select(readers, (), (), 0.001)


@pytest.fixture
def played() -> Iterator[Played]:
    made = Played()
    yield made
    for one in made.sockets:
        one.close()


@pytest.fixture
def loop(played: Played) -> Iterator[Loop]:
    with Loop(now=lambda: played.instant, wait=played.wait) as made:
        yield made


class Read:
    """A file, and what is read of it: when (µs), how much, since when it has waited."""

    def __init__(self, loop: Loop, played: Played, *, gathers: bool = True) -> None:
        self.ours, self.theirs = socket.socketpair()
        played.sockets += [self.ours, self.theirs]
        self.seen: list[tuple[int, int, int]] = []
        self.loop, self.played = loop, played
        loop.call(lambda: loop.watch(self.ours.fileno(), self.read, gathers=gathers))

    def read(self) -> None:
        since = self.loop.waited_since
        size = len(self.ours.recv(100))
        self.seen.append(((self.played.instant - BEGIN) // US, size, (since - BEGIN) // US if since else 0))

    def comes(self, *after_us: int) -> None:
        for one in after_us:
            self.played.at(one, lambda: self.theirs.send(b"x"))


def live(loop: Loop, played: Played, for_us: int = 10_000) -> None:
    """Let all of it happen."""
    over: list[bool] = []
    played.at(for_us, lambda: over.append(True))
    loop.call(lambda: setattr(played, "is_running", True))
    assert loop.wait(lambda: bool(over), 5_000_000_000)


def test_what_comes_in_the_next_moment_is_read_together(loop: Loop, played: Played) -> None:
    """Files that gather are read half a millisecond after the first has something, and say since when; others at once."""
    one, other, plain = Read(loop, played), Read(loop, played), Read(loop, played, gathers=False)
    loop.gather(800_000)
    one.comes(100, 300, 599, 601, 5000)
    other.comes(400)
    plain.comes(200, 350)
    live(loop, played)
    assert one.seen == [(600, 3, 100), (1101, 1, 601), (5500, 1, 5000)]
    assert other.seen == [(600, 1, 400)]
    assert plain.seen == [(200, 1, 0), (350, 1, 0)]


def test_nothing_gathers_unless_it_is_said(loop: Loop, played: Played) -> None:
    """A loop without a cycle reads at once."""
    one = Read(loop, played)
    one.comes(100, 300)
    live(loop, played)
    assert one.seen == [(100, 1, 0), (300, 1, 0)]


def test_while_an_answer_is_waited_for_all_is_read_at_once(loop: Loop, played: Played) -> None:
    """What was gathering is read then, too."""
    one = Read(loop, played)
    loop.gather(500_000)
    one.comes(100, 300, 400, 1100, 1200)
    played.at(200, lambda: loop.call_soon(lambda: loop.hurry(BEGIN + 1000 * US)))
    live(loop, played)
    assert one.seen == [(200, 1, 100), (300, 1, 0), (400, 1, 0), (1600, 2, 1100)]


def test_what_is_there_is_read_before_what_is_due(loop: Loop, played: Played) -> None:
    """A deadline does not pass over an answer that has come: neither one that was planned before, nor one planned since."""
    one = Read(loop, played)
    loop.gather(500_000)
    order: list[int] = []
    loop.call(lambda: loop.post(BEGIN + 400 * US, lambda: order.append(len(one.seen))))
    one.comes(100, 1000)
    played.at(
        1100,
        lambda: loop.call_soon(lambda: loop.post(BEGIN + 1200 * US, lambda: order.append(len(one.seen)))),
    )
    live(loop, played)
    assert order == [1, 2]
    assert one.seen == [(100, 1, 0), (1200, 1, 1000)]


def test_a_file_that_is_given_up_while_it_gathers_is_not_read(loop: Loop, played: Played) -> None:
    """Its number may be another's then."""
    one = Read(loop, played)
    loop.gather(500_000)
    one.comes(100)
    played.at(200, lambda: loop.call_soon(lambda: loop.unwatch(one.ours.fileno())))
    live(loop, played)
    assert one.seen == []


# ---------------------------------------------------------------------- buses


class Bus:
    """The other end of a served bus: what it sends has its instants."""

    def __init__(self, path: Path, played: Played) -> None:
        self.path, self.played = path, played
        self.listener = socket.socket(socket.AF_UNIX)
        self.listener.bind(str(path))
        self.listener.listen()
        self.client: socket.socket

    def welcome(self) -> None:
        self.client, _ = self.listener.accept()
        self.client.recv(4096)
        self.client.sendall(packets.value_packet(packets.Welcome("line", 0, False, 500_000, 0)))

    def comes(self, after_us: int, frame: Frame, late_us: int = 0) -> None:
        """A frame of this instant is there, some µs later."""
        data = frame.data.ljust(8, b"\0")
        one = packets.CLASSIC_PACKET.pack(
            24, packets.CLASSIC, BEGIN + after_us * US, frame.arbitration_id, 0, len(frame.data), data
        )
        self.played.at(after_us + late_us, lambda: self.client.send(one))


@pytest.fixture
def bus(tmp_path: Path, played: Played) -> Iterator[Bus]:
    made = Bus(tmp_path / "b.sock", played)
    threading.Thread(target=made.welcome, daemon=True).start()
    yield made
    made.listener.close()
    made.client.close()


def gate_of(bus: Bus) -> CanGate:
    return CanGate({"interface": "aces", "channel": f"unix:{bus.path}"}, name="line")


@pytest.mark.parametrize(("ahead_us", "third"), [(0, 430), (400, 630)])
def test_frames_that_waited_have_their_own_instants(
    loop: Loop, played: Played, bus: Bus, ahead_us: int, third: int
) -> None:
    """By their stamps, reckoned from when the first was there; a stamp that cannot be moves none beyond its reading."""
    came: list[int] = []
    port = port_of(gate_of(bus), loop)
    port.open(lambda frame, instant: came.append((instant - BEGIN) // US))
    loop.gather(500_000)
    bus.comes(100, Frame(0x121), late_us=30)
    bus.comes(200, Frame(0x121), late_us=30)
    bus.comes(400 + ahead_us, Frame(0x121), late_us=30 - ahead_us)
    live(loop, played)
    assert came == [130, 230, third]
    port.close()


def test_a_host_with_a_cycle_gathers_but_waits_for_no_answer_or_stop(
    loop: Loop, played: Played, bus: Bus
) -> None:
    """What comes by itself is read within a tenth of the tick; once something is asked, or stopped, all at once."""
    robot = robot_of(ROBOT)
    rig = connect(robot, {"line": port_of(gate_of(bus), loop)}, rate_hz=500, load=drivers)
    taken: list[int] = []
    rig["A.temperature"].listeners.append(lambda value, now: taken.append((played.instant - BEGIN) // US))
    rig.open()
    state = fan.encode("State", node=1, left=0, right=0, temperature=40)
    frame = Frame(state.arbitration_id, bytes(state.data))
    asked: list[Any] = []
    bus.comes(500, frame)
    played.at(900, lambda: loop.call_soon(lambda: asked.append(rig.devices["A"].ask("Ask", reply="State"))))
    bus.comes(1100, frame)
    bus.comes(52_500, frame)
    played.at(53_000, lambda: loop.call_soon(lambda: asked.append(rig.devices["A"].stop_motion())))
    bus.comes(53_100, frame)
    live(loop, played, 60_000)
    assert taken == [700, 1100, 52_700, 53_100]
    assert asked[0].state == "done"
    rig.close()
