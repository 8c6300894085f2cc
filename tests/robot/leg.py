"""A leg of three joints, running in virtual time, with a way in for each kind of writer and an independent listener.

Two D12 boards on a virtual bus at 200 Hz. The listener decodes references and encoder replies by the sheet alone: three
bytes a motor, sign and magnitude, counts; four bytes, signed. Nothing of the driver, the door or the spec.
"""

from __future__ import annotations

import math
import socket
from collections.abc import Callable, Mapping
from contextlib import suppress
from itertools import pairwise

from aces_bus.access import UdpStates
from aces_bus.access.inlet import AccessEvents, Inlet
from aces_bus.controller import Controller
from aces_bus.errors import CallerError
from aces_bus.hardware import ListeningNode
from aces_bus.robot import Runner, parse_robot, run_virtual

MS = 1_000_000
TICK_S = 0.005
RATE = 4.0
#: Joint → board, place in its frame, direction, zero (rad), lower, upper.
JOINTS: Mapping[str, tuple[int, int, int, float, float, float]] = {
    "HIP": (0, 0, 1, 0.0, -1.0, 1.0),
    "ROLL": (0, 1, 1, 0.0, -0.5, 0.75),
    "KNEE": (1, 0, -1, 0.1, 0.0, 1.5),
}
#: driven ÷ drive × harmonic × encoder ÷ 2π.
COUNTS = 25 / 10 * 100 * 4000 / math.tau
ROBOT = """
name = "leg"
rate_hz = 200
[buses]
can = { link = "can", protocol = "hubo", dialect = "D12" }
[devices]
JMC0 = { driver = "hubo_motor", bus = "can", credentials = { board = 0 }, channels = 2, settings = { hold_start_s = 0.05 } }
JMC1 = { driver = "hubo_motor", bus = "can", credentials = { board = 1 }, channels = 1, settings = { hold_start_s = 0.05 } }
[joints]
""" + "".join(
    f"{name} = {{ device = 'JMC{board}', channel = {place}, gear = [10, 25], harmonic = 100, encoder = 4000,"
    f" direction = {direction}, zero = {zero}, lower = {lower}, upper = {upper}, max_speed = {RATE},"
    f" following_time_s = 0.5, aliases = ['{name}2'] }}\n"
    for name, (board, place, direction, zero, lower, upper) in JOINTS.items()
)


class Wish(Controller):
    """Gives what is wished for, every 5 ms."""

    def __init__(self, name: str = "walk", writes: tuple[str, ...] = ()) -> None:
        super().__init__(name, rate_hz=200, writes=writes)
        self.wishes: dict[str, float] = {}

    def step(self, now_ns: int) -> Mapping[str, float]:
        return dict(self.wishes)


class Leg:
    """The leg, enabled and running, with a way in for each kind of writer; `refused` are those that were not let in."""

    def __init__(self, *, owner: str = "") -> None:
        robot, problems = parse_robot(ROBOT)
        assert robot is not None, problems
        self.walk = Wish()
        mine = [self.walk]
        if owner:
            mine.append(Wish(owner, writes=("HIP.position",)))
        self.run: Runner = run_virtual(robot, mine, guard=True)
        self.received = ListeningNode(self.run.world.wires["can"])
        states = self.run.states
        self.udp = UdpStates(states, dict.fromkeys(JOINTS, 0), clock=self.run.clock, allow_set=True)
        self.zenoh = Inlet(self.run.clock, states, AccessEvents(), "zenoh", all_states=states)
        self.client = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.errors: list[str] = []
        self.writers: dict[str, Callable[[str, float], None]] = {
            "controller": self.walk.wishes.__setitem__,
            "udp": self._by_udp,
            "zenoh": lambda name, value: self.zenoh.put({name: value}),
            "script": lambda name, value: self.run.rig[f"{name}2"].set(value),  # an alias
            "state": lambda name, value: self.run.states[f"{name}.position"].set(value),
        }

    def _by_udp(self, name: str, value: float) -> None:
        text = f"{value:f}" if math.isfinite(value) else "1e3000"
        self.client.sendto(f"SET {text}".encode(), ("127.0.0.1", self.udp.ports[name]))
        self.udp.poll()

    def write(self, writer: str, name: str, value: float) -> None:
        """A set-point; 10 ms pass."""
        try:
            self.writers[writer](name, value)
        except CallerError as error:
            self.errors.append(str(error))
        self.pass_time(0.01)

    def pass_time(self, seconds: float) -> None:
        self.run.clock.wait(lambda: False, round(seconds * 1e9))

    @property
    def refused(self) -> list[str]:
        """What writers were told of set-points that were not taken."""
        told = [event.detail for one in (self.udp, self.zenoh) for event in one.events.last]
        trips = [s.reason for s in self.run.supervisors if s.reason]
        return [*self.errors, *told, *trips]

    def motor_is_off(self, board: int = 0) -> bool:
        return not any(channel.control_on for channel in self.run.world.twins[f"JMC{board}"].channels)

    def sent(self, joint: str) -> list[tuple[float, float]]:
        """Instant (s) and position (rad) of each reference on the bus."""
        board, place, direction, zero, _, _ = JOINTS[joint]
        return [
            (instant / 1e9, direction * (count_of(frame.data, place) / COUNTS - zero))
            for instant, frame in self.received.received
            if frame.arbitration_id == 0x010 + board
        ]

    def where(self, joint: str, at: float) -> float:
        """Where the joint was (rad) by its board's last encoder reply before that instant (s)."""
        board, place, direction, zero, _, _ = JOINTS[joint]
        end = round(at * 1e9)
        data = next(
            f.data
            for t, f in reversed(self.received.received)
            if t < end and f.arbitration_id == 0x060 + board
        )
        count = int.from_bytes(data[4 * place : 4 * place + 4], "little", signed=True)
        return direction * (count / COUNTS - zero)

    def __enter__(self) -> Leg:
        self.run.open()
        self.udp.open()
        self.run.do("enable")
        self.run.start()
        self.pass_time(0.05)
        return self

    def __exit__(self, *_: object) -> None:
        with suppress(CallerError):
            self.run.stop()
        self.udp.close()
        self.client.close()


def count_of(data: bytes, place: int) -> int:
    """Sign and magnitude of three bytes, the lowest first."""
    raw = int.from_bytes(data[3 * place : 3 * place + 3], "little")
    return -(raw & 0x7FFFFF) if raw & 0x800000 else raw


def check_sent(leg: Leg) -> int:
    """What was on the bus was within limits and rate, frame by frame; how many frames that were."""
    seen = 0
    for joint, (*_, lower, upper) in JOINTS.items():
        sent = leg.sent(joint)
        seen += len(sent)
        # Where it began, it may have been outside: from there only inwards.
        first = sent[0][1] if sent else 0.0
        for _, value in sent:
            assert min(lower, first) - 2 / COUNTS <= value <= max(upper, first) + 2 / COUNTS, (joint, value)
        for (t0, before), (t1, after) in pairwise(sent):
            ticks = max(1, round((t1 - t0) / TICK_S))  # a frame waits for others a little
            if abs(after - before) > RATE * TICK_S * min(ticks, 2) + 2 / COUNTS:
                # To stay where it is, as when a board is enabled, moves nothing.
                assert abs(after - leg.where(joint, t1)) < 0.003, (joint, t1, before, after)
    return seen


WRITERS = ("controller", "udp", "zenoh", "script", "state")
