"""The test suite of the ACES paper: three sines go down to a device that echoes them, and come up as states.

X turns within −1…1, Y within 3…4, Z within 5…6, as A·sin(t) + C, at 50 to 10 000 set-points a second. What comes up is
compared with the sine, its derivative with the cosine, its integral with one minus the cosine, each at the sample's own
instant. What may differ is stated: the loop is 0.2 ms long, a difference over one sample is half a sample late, and a
trapezoid is wrong by h²/12 for each second.

    python examples/spinner.py [FOLDER]        # with a folder: logs as the original wrote them, log50.txt …
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from math import cos, sin
from pathlib import Path
from typing import Any

from construct import Byte, Float64l, Struct, this

from aces_bus.controller import Equations
from aces_bus.controller.log import Logger
from aces_bus.device import Device, Driver, Twin, on
from aces_bus.protocol import InvertedSum, Protocol
from aces_bus.robot import VirtualRobot, parse_robot, run_virtual

# ---------------------------------------------------------------------- a device that echoes what it receives

loop = Protocol(
    "loop", link="datagram", doc="Datagrams that come back", source="acesHubo testsuite.cpp: SET is 2"
)
datagram = loop.framing(
    sync=b"\xac\xe5",
    header=Struct("node" / Byte, "length" / Byte),
    size=this.length + 5,
    max_size=32,
    check=InvertedSum(),
)
datagram(
    "Set",
    direction="to device",
    prefix=Struct("mode" / Byte),
    match={"mode": 2},
    payload=Struct("value" / Float64l),
)
datagram(
    "Value",
    direction="from device",
    prefix=Struct("mode" / Byte),
    match={"mode": 2},
    payload=Struct("value" / Float64l),
)


class Loop(Device):
    """One quantity, which is set and comes back."""

    protocol = loop

    def setup(self) -> None:
        for joint in self.joints:
            self.add_signal(
                "velocity",  # positions are led: they would not go out as they came
                owner=joint.name,
                of="Value.value",
                set="Set.value",
                lower=joint.lower,
                upper=joint.upper,
            )


class LoopTwin(Twin):
    """The end of the wire."""

    protocol = loop
    reply_delay_ns = 0

    @on("Set")
    def back(self, request: Any) -> None:
        self.reply("Value", value=request.value)


ROBOT = """
name = "test suite"
[buses]
loop = { link = "datagram", protocol = "loop" }
[devices]
D1 = { driver = "loop", bus = "loop", credentials = { node = 1 } }
D2 = { driver = "loop", bus = "loop", credentials = { node = 2 } }
D3 = { driver = "loop", bus = "loop", credentials = { node = 3 } }
[joints]
X = { device = "D1", command = "speed", lower = -1.0, upper = 1.0 }
Y = { device = "D2", command = "speed", lower = 3.0, upper = 4.0 }
Z = { device = "D3", command = "speed", lower = 5.0, upper = 6.0 }
"""
SPINNER = Driver(
    "loop", Loop, LoopTwin, ROBOT, doc="Echoes what it receives", source="acesHubo testsuite.cpp"
)

# ---------------------------------------------------------------------- three sines, and what comes back of them

RATES = (50, 100, 500, 1000, 5000, 10_000)
#: There and back (s): 0.1 ms of the virtual network each way.
LATENCY = 0.2e-3
AXES = {"X": (1.0, 0.0), "Y": (0.5, 3.5), "Z": (0.5, 5.5)}


def bounds(rate: float, seconds: float) -> tuple[float, float, float]:
    """Return how far value, derivative and integral of sin(t) may be from the analytic ones."""
    h, hair = 1 / rate, 1e-9
    return LATENCY + hair, LATENCY + h / 2 + hair, LATENCY * seconds + h * h / 12 * seconds + hair


class Judge:
    """Looks at each sample once, as a logger does, and keeps the worst of its differences to the analytic ones."""

    name, states = "judge", tuple(AXES)

    def __init__(self, rate_hz: float) -> None:
        self.rate_hz = rate_hz
        self.worst, self.samples = [0.0, 0.0, 0.0], 0

    def bind(self, states: Mapping[str, Any]) -> None:
        self.bound = [
            (states[name], states[name].rate(), states[name].integral(), *AXES[name]) for name in AXES
        ]

    def start(self, now: int) -> None:
        self.began = now

    def step(self, now: int) -> None:
        if self.bound[-1][0].counts.kept < 2:
            return
        for state, rate, integral, a, c in self.bound:
            t, t0 = (state.instant - self.began) / 1e9, LATENCY  # an integral begins with the first sample
            area = a * (cos(t0) - cos(t)) + c * (t - t0)
            expected = (state[0], a * sin(t) + c), (rate[0], a * cos(t)), (integral[0], area)
            self.worst = [
                max(was, abs(got - true)) for was, (got, true) in zip(self.worst, expected, strict=True)
            ]
        self.samples += 1

    def stop(self, now: int) -> None:
        """Nothing is on disk."""


def spin(rate: float, seconds: float, folder: Path | None = None, seed: int = 0) -> Judge:
    """Spin at a rate for some seconds of virtual time."""
    robot, _ = parse_robot(ROBOT)
    assert robot is not None
    sines = Equations(
        "spinner", "X[0] = sin(t) \n Y[0] = 3.5 + 0.5*sin(t) \n Z[0] = 5.5 + 0.5*sin(t)", rate_hz=rate
    )
    judge = Judge(rate)
    loggers: list[Any] = [judge]
    if folder is not None:
        more = ["X(integral)", "X(rate)"] if rate >= 1000 else []
        loggers.append(Logger(folder / f"log{rate:g}.txt", [*AXES, *more], rate_hz=rate))
    load = {"loop": SPINNER}.__getitem__
    bench = VirtualRobot(robot, rate_hz=0, seed=seed, load=load)  # event-driven: nothing waits for a tick
    ended = run_virtual(bench, [sines], loggers=loggers, load=load).run(seconds)
    assert not ended.tripped, ended
    return judge


def main(arguments: Sequence[str]) -> None:
    folder = Path(arguments[0]) if arguments else None
    print(
        "  rate     time  samples   |value − sin|     |rate − cos|      |integral|     (worst of X, Y, Z; bound)"
    )
    for rate in RATES:
        seconds = min(6.3, 600 / rate)
        judge = spin(rate, seconds, folder)
        cells = [
            f"{got:.2e} < {most:.2e}" for got, most in zip(judge.worst, bounds(rate, seconds), strict=True)
        ]
        print(f"{rate:5} Hz {seconds:5.2f} s {judge.samples:7}   " + "   ".join(cells))


if __name__ == "__main__":
    main(sys.argv[1:])
