"""`python -m tests.bench robot`: what a complete robot costs the machine that drives it, and how punctual it is.

1. The complete Hubo 2+ on served buses, its twins in another process, all guards on: host and twins meet as on a real
   bus, in real time. What is measured is the host's process alone.
2. Contenders are processes that run one after another on the same twins: the one loop of a robot, and the same robot with
   its buses behind a python-can bus that has no file to wait for, which takes threads.
3. The first rows are the host without twins, in lock-step with recorded answers (`played.py`): no load of the machine
   makes it miss anything.
4. The last rows are virtual time, host and twins in one process (`virtual.py`): the robot, and a quadruped at 500 Hz.
5. Times of a shared machine vary: ratios carry over, absolute figures are this machine's at this hour.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Generator, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from statistics import median
from typing import Any

from aces_bus.controller import Player, Trajectory
from aces_bus.device import Robot

from . import virtual
from .rows import BenchRow

#: Hz; the second rate is the harder one.
RATES = (200.0, 500.0)
#: What is to be reached at 200 Hz: µs of CPU a frame, share of a core, lateness (ms, median and 99 %), cycles missed.
FRAME_US, SHARE, MEDIAN_MS, LATE_MS = 32.0, 0.38, 0.1, 0.5
#: And how many times less than with threads.
TIMES_LESS = 2.2
#: The same at 500 Hz: share of a core.
SHARE_AT_500 = 0.55
#: Seconds that the other process may take to begin, and a played round in all: no deadline there, so that any machine can.
_PATIENCE_S, _PLAYED_S = 60, 600

#: Rounds of the played measurement, usually and with `quick`; how long each is in virtual time (s).
ROUNDS, ROUND_S = (3, 1), 1.0

_CALL = "import sys; from tests.bench.{} import {} as call; call(*sys.argv[1:])"


def run(*, quick: bool = False) -> Iterable[BenchRow]:
    """All rows: some twenty seconds with `quick`, else a minute and a half."""
    seconds = 5.0 if quick else 20.0
    yield from _played_rows(ROUNDS[quick])
    with tempfile.TemporaryDirectory(prefix="aces") as folder, _twins(folder):
        for rate in RATES[:1] if quick else RATES:
            found = {
                way: _counted(
                    "robot",
                    "drive",
                    folder,
                    str(rate),
                    str(seconds),
                    way,
                    patience_s=_PATIENCE_S + 2 * seconds,
                )
                for way in ("threads", "loop")
            }
            yield from _rows(rate, seconds, found["loop"], found["threads"])
    yield from virtual.run(quick=quick)


def _played_rows(rounds: int) -> Iterator[BenchRow]:
    """The host alone, in lock-step with recorded answers: both ways in turn, the median of each."""
    rate = RATES[0]
    found = [
        {
            way: _counted("played", "measure", str(rate), str(ROUND_S), way, patience_s=_PLAYED_S)
            for way in ("threads", "loop")
        }
        for _ in range(rounds)
    ]
    threads, loop = (median(one[way]["frame_us"] for one in found) for way in ("threads", "loop"))
    frames = found[0]["loop"]["frames_s"]
    subject = f"its host alone, answers played, {rate:g} Hz, {frames:,.0f} frames/s"
    yield BenchRow(subject, "CPU a played frame, threads", threads, "µs")
    yield BenchRow(
        subject,
        "CPU a played frame, one loop",
        loop,
        "µs",
        threads / loop,
        f"≥ {TIMES_LESS:g} × less",
        threads >= TIMES_LESS * loop,
    )


def _rows(
    rate: float, seconds: float, ours: dict[str, float], threads: dict[str, float]
) -> Iterator[BenchRow]:
    subject = f"complete Hubo 2+ at {rate:g} Hz, {seconds:g} s, {ours['frames_s']:,.0f} frames/s"
    is_usual = rate == RATES[0]
    share = SHARE if is_usual else SHARE_AT_500
    yield BenchRow(subject, "CPU a frame, threads", threads["frame_us"], "µs")
    yield BenchRow(
        subject,
        "CPU a frame, one loop",
        ours["frame_us"],
        "µs",
        threads["frame_us"] / ours["frame_us"],
        f"≤ {FRAME_US:g} µs" if is_usual else "",
        ours["frame_us"] <= FRAME_US if is_usual else None,
    )
    yield BenchRow(
        subject, "of a core", 100 * ours["share"], "%", None, f"≤ {100 * share:g} %", ours["share"] <= share
    )
    for name, key, most in (("median", "median_ms", MEDIAN_MS), ("99 %", "late_ms", LATE_MS)):
        yield BenchRow(
            subject,
            f"lateness, {name}",
            ours[key],
            "ms",
            threads[key] / ours[key] if ours[key] else None,
            f"≤ {most:g} ms" if is_usual else "",
            ours[key] <= most if is_usual else None,
        )
    cycles = f"of {ours['cycles']:,.0f} cycles"
    yield BenchRow(subject, "missed", ours["missed"], cycles, None, "0", not ours["missed"])
    yield BenchRow(subject, "requests without an answer", ours["unanswered"], f"of {ours['polls']:,.0f}")


# ---------------------------------------------------------------------- the two processes


@contextmanager
def _twins(folder: str) -> Generator[None]:
    """The robot's twins on served buses in `folder`, in a process of their own."""
    child = subprocess.Popen(
        [sys.executable, "-c", _CALL.format("robot", "serve_twins"), folder],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    )
    assert child.stdout is not None
    assert child.stdin is not None
    try:
        if child.stdout.readline() != b"ready\n":
            raise RuntimeError("the twins' process did not begin")
        yield
    finally:
        child.stdin.close()  # its end
        child.wait(10)


def serve_twins(folder: str) -> None:
    """Serve the robot's buses with its twins on them, on one thread, until stdin ends."""
    import threading

    from aces_bus import load_robot
    from aces_bus.device.config import BUSES
    from aces_bus.hardware.ports import port_of
    from aces_bus.hardware.served.channel import ServedChannel
    from aces_bus.hardware.served.server import BusServer
    from aces_bus.robot.rig import simulate
    from aces_bus.runtime.tasks import run_at

    robot = load_robot("hubo2plus")
    channels = [ServedChannel(name, bitrate=bus.bitrate or 1_000_000) for name, bus in robot.buses.items()]
    server = BusServer(channels, unix=folder)
    twins = simulate(robot, {channel.name: port_of(channel.wire) for channel in channels})
    twins.open()

    def wait() -> None:
        sys.stdin.read()
        server.stop()

    run_at(BUSES)  # else it is measured how busy this machine is with other things

    threading.Thread(target=wait, daemon=True).start()
    print("ready", flush=True)
    server.serve()


def _counted(subject: str, call: str, *arguments: str, patience_s: float) -> dict[str, float]:
    """What a process of its own measured of itself."""
    made = subprocess.run(
        [sys.executable, "-c", _CALL.format(subject, call), *arguments],
        stdout=subprocess.PIPE,
        timeout=patience_s,
        check=True,
    )
    found: dict[str, float] = json.loads(made.stdout)
    return found


def drive(folder: str, rate: str, seconds: str, way: str) -> None:
    """Drive the robot for so long, and print what it cost as JSON."""
    from aces_bus import load_robot
    from aces_bus.controller import IGNORE
    from aces_bus.robot import run_real
    from aces_tools.running.session import SWITCH_S

    if way == "threads":
        hide_files()
    robot = load_robot("hubo2plus")
    player = walking_player(robot, float(rate), float(seconds))
    buses = {
        name: {"interface": "aces", "channel": f"unix:{Path(folder) / name}.sock"} for name in robot.buses
    }
    sys.setswitchinterval(SWITCH_S)
    with run_real(
        robot,
        [player],
        buses=buses,
        rate_hz=float(rate),
        real_time=True,
        transmit=True,
        reactions={"*": IGNORE},
    ) as made:
        made.do("enable")
        hosts = made.rig.hosts.values()
        frames = -sum(h.counts.sent + h.counts.received for h in hosts)
        polls, unanswered = -sum(h.counts.polls for h in hosts), -sum(h.counts.missed for h in hosts)
        cpu, wall = time.process_time(), time.monotonic()
        made.start()
        time.sleep(float(seconds))
        cpu, wall = time.process_time() - cpu, time.monotonic() - wall
        (task,) = made.tasks.tasks
        frames += sum(h.counts.sent + h.counts.received for h in hosts)
        polls += sum(h.counts.polls for h in hosts)
        unanswered += sum(h.counts.missed for h in hosts)
        found = {
            "frames_s": frames / wall,
            "frame_us": cpu / frames * 1e6,
            "share": cpu / wall,
            "median_ms": task.jitter_ns(0.5) / 1e6,
            "late_ms": task.jitter_ns(0.99) / 1e6,
            "cycles": task.ticks,
            "missed": task.missed,
            "polls": polls,
            "unanswered": unanswered,
        }
        print(json.dumps(found), flush=True)


def walking_player(robot: Robot, rate: float, seconds: float) -> Player:
    """All joints follow a motion within their limits, for some seconds more."""
    joints = [j for j in robot.joints.values() if j.active and j.command == "position"]
    rows = [
        [min(max(0.05 * (n % 2), j.lower or 0.0), j.upper or 0.0) for j in joints]
        for n in range(round(seconds) + 3)
    ]
    trajectory = Trajectory([j.name for j in joints], rows, rate_hz=1.0, interpolation="cubic")
    return Player("walk", trajectory, rate_hz=rate)


def hide_files() -> None:
    """Have served buses look like a backend without a file to wait for."""
    from aces_bus.hardware.served.remote import ServedBus

    def fileno(self: Any) -> int:
        raise NotImplementedError

    ServedBus.socket_fileno = fileno  # type: ignore[method-assign]


__all__ = ["drive", "run", "serve_twins"]
