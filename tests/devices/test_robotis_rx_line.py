"""MiniHubo's 21 servos on their half-duplex line at 1 Mbaud: what the wire allows, and what is reached of it.

`pytest -s tests/devices/test_robotis_rx_line.py` prints the figures.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from functools import partial
from importlib.resources import files
from typing import Any

import msgspec
import pytest

from aces_bus.controller import IGNORE, controller
from aces_bus.device import Robot
from aces_bus.hardware import Noise
from aces_bus.robot import VirtualRobot, parse_robot, run_virtual
from aces_bus.robot.rig import simulate
from aces_devices.robotis_rx import RobotisRXTwin, driver
from tests.conftest import PROFILE
from tests.counting import calls

LOAD = {"robotis_rx": driver}.__getitem__
BYTE_S = 10e-6
#: A read of a position: request of 8 bytes, answer of 8.
READ_BYTES = 16
#: One SyncWrite of a goal to each of 21 servos.
SYNC_BYTES = 8 + 21 * 3
#: How long is measured; in the long profile over a whole second, with its read of all registers.
SECONDS = 1.0 if PROFILE == "long" else 0.4


def minihubo(**settings: Any) -> Robot:
    """MiniHubo 1, each servo with these settings."""
    text = files("aces_devices.robots").joinpath("minihubo_1.toml").read_text(encoding="utf-8")
    robot, problems = parse_robot(text)
    assert robot is not None, problems
    devices = {
        name: msgspec.structs.replace(device, settings=settings) for name, device in robot.devices.items()
    }
    return msgspec.structs.replace(robot, devices=devices)


@dataclass
class Measured:
    """Position reads a second, by joint and in all; what went out; what the wire allows."""

    reads: Counter[str]
    seconds: float
    rate_hz: float
    delay_s: float
    syncs: int
    ticks: int
    robot: VirtualRobot

    @property
    def total(self) -> float:
        return self.reads.total() / self.seconds

    @property
    def allowed(self) -> float:
        """Reads a second that fit beside the set-points: bit times and return delays, nothing else."""
        return (1 - self.rate_hz * SYNC_BYTES * BYTE_S) / (READ_BYTES * BYTE_S + self.delay_s)

    @property
    def possible(self) -> float:
        """The same, and no joint more often than the ticks."""
        return min(self.allowed, 21 * self.rate_hz)

    def __str__(self) -> str:
        return (
            f"{self.rate_hz:g} Hz, return delay {self.delay_s * 1e6:g} µs: {self.total:.0f} reads a second of"
            f" {self.possible:.0f} possible ({self.total / self.possible:.1%}; the wire allows {self.allowed:.0f});"
            f" each joint {min(self.reads.values()) / self.seconds:.1f} to {max(self.reads.values()) / self.seconds:.1f}"
            f" times; {self.syncs / self.ticks:.2f} SyncWrites a tick"
        )


def measure(
    rate_hz: float, *, delay_us: int = 500, seconds: float = SECONDS, budget: float = 1.0, **options: Any
) -> Measured:
    """All joints follow set-points and are read, for a while."""
    before = options.pop("before", None)
    note = options.pop("note", "")
    settings = {"return_delay_us": delay_us, **options.pop("settings", {})}
    robot = VirtualRobot(minihubo(**settings), rate_hz=rate_hz, budget=budget, load=LOAD, **options).open()
    robot.advance(0.1)
    robot.rig.each("enable").wait()
    for name in robot.robot.joints:
        robot[f"{name}.position"].set(0.1)
    if before is not None:
        before(robot)
    robot.advance(0.3)
    reads: Counter[str] = Counter(dict.fromkeys(robot.robot.joints, 0))

    def count(change: int, name: str, value: Any, now: int) -> None:
        reads[name] += change

    for name in robot.robot.joints:
        robot[f"{name}.position"].listeners.append(partial(count, 1, name))
        # The read of the whole RAM, once a second, has the position too; it does not count here.
        robot[f"{name}.enabled"].listeners.append(partial(count, -1, name))
    counts = robot.rig.hosts["servos"].counts
    syncs, ticks = counts.set_points, counts.ticks
    whole = round(seconds * rate_hz) / rate_hz
    robot.advance(whole - 1e-6)
    found = Measured(
        reads, whole, rate_hz, delay_us / 1e6, counts.set_points - syncs, counts.ticks - ticks, robot
    )
    print(f"\n  {note and f'{note}: '}{found}", end="")
    return found


@pytest.mark.slow
@pytest.mark.parametrize(
    ("rate_hz", "delay_us"),
    [(50, 500), (68.5, 500), (100, 500), (240, 0)],
    ids=["50 Hz", "fastest", "beyond", "fastest without delay"],
)
def test_the_line_is_used(rate_hz: float, delay_us: int) -> None:
    """One SyncWrite a tick, every joint read in turn: at least 90 % of what bit times and return delays allow.

    68.5 Hz is the fastest rate at which all 21 could be read in each tick with the factory's return delay, 245 without.
    """
    found = measure(rate_hz, delay_us=delay_us, seconds=SECONDS if delay_us else SECONDS / 2)
    assert found.total >= 0.9 * found.possible
    assert min(found.reads.values()) >= 0.9 * found.possible / 21 * found.seconds
    assert found.syncs == found.ticks
    assert not found.robot.events.counts


def test_polls_keep_to_the_budget() -> None:
    """With half of each tick for polls, half of the reads; set-points go out all the same."""
    found = measure(50, budget=0.5, note="half a tick for polls")
    most = (0.5 / 50 - SYNC_BYTES * BYTE_S) / (READ_BYTES * BYTE_S + 500e-6) * 50
    assert 0.85 * most <= found.total <= 1.02 * most
    assert found.syncs == found.ticks


@pytest.mark.slow
@pytest.mark.parametrize(("flip", "share"), [(1e-4, 0.95), (1e-3, 0.9)])
def test_noise_costs_what_it_hits(flip: float, share: float) -> None:
    """A garbled packet costs its time-out and no more; it is reported, and no wrong value is taken for a position."""
    settings = {"timeout_s": 0.002}
    found = measure(50, settings=settings, noise={"servos": Noise(seed=3, flip=flip)}, note=f"noise {flip:g}")
    assert found.total >= share * found.possible
    assert found.robot.events.count("garbled") > 0
    host = found.robot.rig.hosts["servos"]
    assert host.counts.missed > 0
    bins = host.scanner.counts
    assert bins.total == bins.decoded + sum(bins.reasons.values())
    for name in found.robot.robot.joints:
        assert -0.1 < found.robot[f"{name}.position"].last < 0.2


@pytest.mark.slow
def test_a_silent_servo_costs_its_time_outs() -> None:
    """It is told once and asked less often; the others are read as often as the rest of the line allows."""

    def hush(robot: VirtualRobot) -> None:
        robot.twins["S40"].fault("silent")

    found = measure(50, before=hush, note="one silent")
    others = Counter({name: n for name, n in found.reads.items() if name != "RAP"})
    assert found.reads["RAP"] == 0
    assert found.robot.events.count("silent", "S40") == 1
    assert min(others.values()) >= 0.75 * 50 * found.seconds
    quick = measure(
        50, seconds=1.0, before=hush, settings={"timeout_s": 0.002}, note="one silent, time-out 2 ms"
    )
    assert min(n for name, n in quick.reads.items() if name != "RAP") >= 0.97 * 50 * quick.seconds
    assert not quick.robot["RAP.position"].value
    quick.robot.twins["S40"].fault("silent", on=False)
    quick.robot.advance(0.5)
    assert quick.robot.events.count("answers", "S40") == 1
    assert quick.robot["RAP.position"].value == pytest.approx(0.1, abs=0.02)


def test_two_servos_with_one_id_are_named() -> None:
    """Both answer at once and garble each other: told with the id; what others lose by the garbage, they get again."""

    def double(robot: VirtualRobot) -> None:
        one = {"S40": robot.robot.devices["S40"]}
        second = msgspec.structs.replace(robot.robot, devices=one)
        other = simulate(second, robot.ports("second"), seed=9, load=LOAD).open()
        twin = other["S40"]
        assert isinstance(twin, RobotisRXTwin)
        twin.motion.at = 900.0

    found = measure(50, before=double, settings={"timeout_s": 0.002}, note="two with one id")
    said = [event for event in found.robot.events.of("two devices") if event.device == "S40"]
    assert said
    assert "id 0x28" in said[0].detail
    assert found.robot.wires["servos"].garbled > 0
    # Garbage that looks like a long packet keeps servos from hearing the next requests, as it would on a real line.
    assert found.total >= 0.75 * found.possible
    assert min(n for name, n in found.reads.items() if name != "RAP") > 0
    assert {event.device for event in found.robot.events.of("two devices")} == {"S40"}


def test_a_servo_that_answers_with_another_id_is_named() -> None:
    """A stranger's answers are nobody's values, and its own name falls silent."""

    def stray(robot: VirtualRobot) -> None:
        robot.twins["S40"].fault("wrong_number", 99)

    found = measure(50, before=stray, settings={"timeout_s": 0.002}, note="one with another id")
    assert "id 0x63" in found.robot.events.of("unknown device")[0].detail
    assert found.robot.events.count("silent", "S40") == 1
    assert found.reads["RAP"] == 0
    assert min(n for name, n in found.reads.items() if name != "RAP") >= 0.9 * 50 * found.seconds


def test_noise_stops_no_run() -> None:
    """What noise garbles is asked again: it is told, and the controller goes on."""

    @controller(rate_hz=50, writes=["RHP"])
    def hold(RHP: Any, t: float) -> dict[str, float]:
        return {"RHP": 0.1}

    noise = {"servos": Noise(seed=3, flip=2e-3)}
    robot = VirtualRobot(minihubo().part("RHP"), rate_hz=50, load=LOAD, noise=noise)
    with run_virtual(robot, [hold], reactions={"alarm": IGNORE}) as run:  # of requests that noise has changed
        run.do("enable")
        ended = run.run(2.0)
    assert ended.tripped == {}
    assert robot.events.count("garbled") > 0


def test_an_answer_whose_end_comes_too_late_is_lost() -> None:
    """Its first bytes came in time: it is asked for again, as if all of it were lost, and nothing is malformed."""
    stretched: list[int] = []

    def stretch(robot: VirtualRobot) -> None:
        twin = robot.twins["S40"]
        transmit = twin._transmit

        def in_parts(packet: bytes, delay: int) -> None:
            twin._transmit = transmit
            stretched.append(robot.clock.now())
            transmit(packet[:3], delay)
            transmit(packet[3:], delay + 30_000_000)

        twin._transmit = in_parts

    found = measure(50, before=stretch, settings={"timeout_s": 0.02}, note="one answer in two parts")
    assert len(stretched) == 1
    assert [event.detail for event in found.robot.events.of("garbled")] == ["ff …: incomplete"]
    assert {event.kind for event in found.robot.events.last} <= {"opened", "garbled", "overrun"}
    assert found.reads["RAP"] >= 50 * found.seconds - 2
    found.robot.twins["S40"].fault("short")
    found.robot.advance(0.2)
    assert found.robot.events.count("silent", "S40") == 1


def test_a_packet_to_many_fits_the_receive_buffer() -> None:
    """An RX-28 receives 143 bytes: 45 goals in one SyncWrite, the 46th in a second one."""
    devices = "\n".join(
        f'S{n} = {{ driver = "robotis_rx", bus = "line", credentials = {{ id = {n} }} }}' for n in range(46)
    )
    joints = "\n".join(f'J{n} = {{ device = "S{n}", max_speed = 1000 }}' for n in range(46))
    robot, _ = parse_robot(
        f'name = "many"\n[buses]\nline = {{ link = "serial", protocol = "robotis" }}\n[devices]\n{devices}\n'
        f"[joints]\n{joints}"
    )
    assert robot is not None
    with VirtualRobot(robot, load=LOAD) as virtual:
        virtual.advance(0.2)
        virtual.rig.hosts["line"].poll()  # where they are is where their way begins
        virtual.advance(0.08)
        packets: list[int] = []
        port = virtual.rig.hosts["line"].port
        send = port.send

        def noted(packet: bytes, *how: Any, **more: Any) -> bool:
            packets.append(len(packet))
            return bool(send(packet, *how, **more))

        port.send = noted  # type: ignore[method-assign]
        for n in range(46):
            virtual[f"J{n}.position"].set(1.0)
        virtual.advance(0.1)
        assert packets[-2:] == [143, 8 + 3]
        goals = {twin["goal_position"] for twin in virtual.twins.values()}
        assert goals == {int(1.0 / (300 / 1023) * 57.29577951308232)}


@pytest.mark.slow
def test_a_robot_of_servos_costs_what_its_packets_do() -> None:
    """50 Hz, all joints: a second of MiniHubo is some 270,000 calls, a fifth of a second where that was measured."""
    found = measure(50, seconds=0.2)
    assert calls(lambda: found.robot.advance(0.2)) < 350_000 / 5
