"""How well `aces spec guess --reference` finds the field of a measured quantity: `python -m tests.bench.guess_reference`.

    python -m tests.bench.guess_reference                 50 drawn databases and two twins, as a table
    python -m tests.bench.guess_reference --seed 200 --databases 100

1. A database is ten messages of 8 bytes with numbers of 8 to 16 bits at any bit, little or big endian, a fifth to a half of
   whose range is used, with noise of 0 to 2 of their steps, beside counters, flags and enumerations.
2. The quantity is one of the numbers: scaled, up to 500 ms before or behind, in 50 steps, with noise of 1 % and jitter of
   5 ms in its instants. Nothing of the database is seen by what is scored.
3. A field is right where its moving bits are those of the number, in the same order. Bits that never moved are of either.
"""

from __future__ import annotations

import argparse
import random
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from math import sin
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from aces_bus import Frame, FrameTable
from aces_bus.controller import controller
from aces_bus.controller.log import Logger
from aces_bus.device import load_driver
from aces_bus.hardware import ListeningNode
from aces_bus.robot import VirtualRobot, parse_robot, run_virtual
from aces_lab.guess import ReferenceGuess, Traffic
from aces_lab.guess.reference import MeasuredQuantity, Messages, followers
from aces_lab.guess.reference_file import read_quantity

Array = Any
DURATION_S = 60.0
SCALES = (0.001, 0.01, 0.0125, 0.0375, 0.05, 0.1, 0.25, 1 / 128, 0.5, 1, 2)


class Number(NamedTuple):
    """A number of a message: its bits, lowest first, and the part of its range that it moves in."""

    key: int
    positions: tuple[int, ...]
    signed: bool
    low: float
    share: float
    swing: Swing

    def raw(self, times: Array) -> Array:
        """The exact number at instants (s)."""
        span = 1 << len(self.positions)
        return (self.low + self.share * self.swing(times)) * span - (span / 2 if self.signed else 0)


class Swing:
    """A quantity from 0 to 1: three slow waves."""

    def __init__(self, numbers: Any) -> None:
        self.waves = [
            (numbers.uniform(0.2, 1), numbers.uniform(3, 30), numbers.uniform(0, 6.3)) for _ in range(3)
        ]
        values = self._sum(np.linspace(0, DURATION_S, 6001))
        self.low, self.high = values.min(), values.max()

    def _sum(self, times: Array) -> Array:
        return sum(size * np.sin(2 * np.pi * times / period + phase) for size, period, phase in self.waves)

    def __call__(self, times: Array) -> Array:
        return (self._sum(times) - self.low) / (self.high - self.low)


@dataclass
class Drawn:
    """A database's messages, a quantity, and what it is."""

    messages: list[Messages]
    quantity: MeasuredQuantity
    number: Number
    scale: float
    offset: float
    delay_s: float
    step: float


def drawn(seed: int, count: int = 10) -> Drawn:
    """Draw a database and a quantity."""
    dice = random.Random(f"reference {seed}")
    numbers = np.random.default_rng(seed)
    messages: list[Messages] = []
    found: list[Number] = []
    for message in range(count):
        period = dice.choice([0.01, 0.02, 0.05, 0.1])
        times = np.arange(0, DURATION_S, period)
        times = np.sort(times + numbers.normal(0, 0.0005, len(times)))
        made, rows = _message(dice, numbers, 0x100 + 16 * message, times)
        found += made
        messages.append(Messages(0x100 + 16 * message, times, rows))
    number = dice.choice(found)
    delay = dice.uniform(-0.5, 0.5)
    scale = dice.choice([-1, 1]) * dice.choice(SCALES)
    offset = dice.choice([0, 0, -40, 100, 273.15])
    times = np.arange(0, DURATION_S, dice.choice([0.01, 0.02, 0.05, 0.1]))
    extent = abs(scale) * number.share * (1 << len(number.positions))
    # quantity(t - delay) = raw(t) × scale + offset
    values = number.raw(times + delay) * scale + offset + numbers.normal(0, 0.01 * extent, len(times))
    step = extent / 50
    instants = np.sort(times + numbers.normal(0, 0.005, len(times)))
    quantity = MeasuredQuantity("speed", "m/s", instants, np.round(values / step) * step)
    return Drawn(messages, quantity, number, scale, offset, delay, step)


def _message(dice: random.Random, numbers: Any, key: int, times: Array) -> tuple[list[Number], Array]:
    is_little = dice.random() < 0.5
    bits = np.zeros((len(times), 64), np.uint8)
    found: list[Number] = []
    at = 0
    while at < 60:
        if dice.random() < 0.2:
            at += dice.choice([1, 2, 4, 8])
        kind = dice.choice(["number"] * 6 + ["flag", "enumeration", "counter"])
        length = {"flag": 1, "enumeration": dice.choice([2, 3, 4]), "counter": 4}.get(
            kind, dice.randint(8, 16)
        )
        if length >= 8 and dice.random() < 0.5:
            at = -(-at // 8) * 8
        if at + length > 64:
            break
        places = range(at, at + length)
        positions = tuple(places if is_little else (bit ^ 7 for bit in reversed(places)))
        if kind == "number":
            signed = dice.random() < 0.4
            share = dice.uniform(0.2, 0.5)
            number = Number(key, positions, signed, dice.uniform(0, 1 - share), share, Swing(numbers))
            found.append(number)
            half = 1 << length - 1
            noise = numbers.normal(0, dice.choice([0, 0.5, 1, 2]), len(times))
            low, high = (-half, half - 1) if signed else (0, 2 * half - 1)
            values = np.clip(np.round(number.raw(times) + noise), low, high).astype(np.int64)
        elif kind == "counter":
            values = np.arange(len(times)) % 16
        else:
            values = np.repeat(
                numbers.integers(1 << length, size=len(times)), numbers.integers(5, 60, size=len(times))
            )
        for place, position in enumerate(positions):
            bits[:, position] = values[: len(times)] >> place & 1
        at += length
    return found, np.packbits(bits, axis=1, bitorder="little")


@dataclass
class Line:
    """What was said of one quantity: the rank of the right field, and errors of its scale, offset (steps) and delay (s)."""

    rank: int | None = None
    scale: float = float("nan")
    offset: float = float("nan")
    delay_s: float = float("nan")
    said: list[str] = field(default_factory=list[str])

    @property
    def is_right(self) -> bool:
        """Right field first, scale within 1 %, offset within one step of the reference."""
        return self.rank == 1 and self.scale <= 0.01 and self.offset <= 1


def score(case: Drawn) -> Line:
    """Return how the guess of a drawn case is."""
    line = Line()
    rows = next(message.rows for message in case.messages if message.key == case.number.key)
    bits = np.unpackbits(rows, axis=1, bitorder="little")
    moves = (bits != bits[0]).any(axis=0)
    number = case.number
    for rank, guess in enumerate(followers(case.messages, case.quantity), 1):
        positions = guess.field.positions
        line.said.append(f"{guess.key:03X} {positions[0]}+{len(positions)} {guess.field.order}")
        if guess.key != number.key or _moving(positions, moves) != _moving(number.positions, moves):
            continue
        weights = {place: 2.0**power for power, place in enumerate(number.positions)}
        if number.signed:
            weights[number.positions[-1]] *= -1
        # What bits say that never moved, and that only the number has, is in the guess's offset.
        still = sum(
            float(weights[place] * bits[0, place]) for place in number.positions if place not in positions
        )
        line.rank = rank
        line.scale = abs(guess.scale / case.scale - 1)
        line.offset = abs(guess.offset - case.offset - case.scale * still) / case.step
        line.delay_s = guess.delay_s - case.delay_s
        break
    return line


def _moving(positions: tuple[int, ...], moves: Array) -> tuple[int, ...]:
    return tuple(place for place in positions if moves[place])


# ---------------------------------------------------------------------- twins

#: Drivers, a joint of the example robot, and the field that says where the joint is: identifier, lowest bit, length.
TWINS: Mapping[str, tuple[str, int, int, int]] = {
    "damiao": ("ELBOW", 0x011, 16, 16),
    "hubo_motor": ("RHP", 0x061, 0, 32),
}


def twin_recording(driver: str, joint: str, log: Path, seconds: float = 12.0) -> list[Frame]:
    """Return the traffic of a driver's example robot that swings a joint, which it logs."""
    robot, _ = parse_robot(load_driver(driver).example, f"{driver}.toml")
    assert robot is not None
    virtual = VirtualRobot(robot, rate_hz=robot.rate_hz or 50, seed=1)
    nodes = [ListeningNode(wire) for wire in virtual.wires.values()]
    steps = iter(range(1_000_000))

    @controller(rate_hz=50, writes=[joint])
    def swing() -> Mapping[str, float]:
        time = next(steps) / 50
        return {joint: 0.35 * sin(1.1 * time) + 0.15 * sin(2.7 * time)}

    with run_virtual(virtual, [swing], loggers=[Logger(log, [joint], rate_hz=50)]) as run:
        run.do("enable")
        run.run(seconds)
    return [
        Frame(frame.arbitration_id, frame.data, time * 1e-9, "can0", frame.is_extended_id, is_fd=frame.is_fd)
        for node in nodes
        for time, frame in node.received
    ]


def twin_guess(driver: str) -> list[ReferenceGuess]:
    """Return the fields that follow the log of a twin's joint. The log begins when the run does, after the recording."""
    joint = TWINS[driver][0]
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "joint.csv"
        traffic = Traffic()
        traffic.add(FrameTable.from_frames(twin_recording(driver, joint, log)))
        quantity = read_quantity(f"{log}:{joint}", unit="rad")
    reference = traffic.guess(known=False, quantity=quantity, latest_s=2.0).reference
    assert reference is not None
    return list(reference.guesses)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--databases", type=int, default=50)
    arguments = parser.parse_args()
    seeds = range(arguments.seed, arguments.seed + arguments.databases)
    lines = {seed: score(drawn(seed)) for seed in seeds}
    first = [line for line in lines.values() if line.rank == 1]
    print(
        f"{'databases':>10} {'right first':>12} {'and scale, offset':>18} {'scale':>8} {'offset':>9} {'delay':>7}"
    )
    print(
        f"{len(lines):>10} {len(first):>12} {sum(line.is_right for line in first):>18}"
        f" {max(line.scale for line in first):>8.2%} {max(line.offset for line in first):>8.2f}s"
        f" {1e3 * max(abs(line.delay_s) for line in first):>5.0f}ms    (largest errors; s: steps)"
    )
    for seed, line in lines.items():
        if not line.is_right:
            print(f"  seed {seed}: {line}")
    for driver, (joint, identifier, start, length) in TWINS.items():
        guess = twin_guess(driver)[0]
        right = (guess.key[0], guess.field.start, guess.field.length) == (identifier, start, length)
        print(
            f"{driver} {joint}: {'right' if right else 'WRONG'}, {guess.key[0]:03X} {guess.field.start}+{guess.field.length}"
            f" {guess.field.order}, × {guess.scale:g} + {guess.offset:g}, {guess.explained:.4%}"
        )


if __name__ == "__main__":
    main()
