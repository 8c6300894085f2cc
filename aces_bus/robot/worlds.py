"""The three worlds in which the same controllers run: virtual time with twins, real buses, a recording.

1. Only the world differs: states, controllers, loggers and their order are the same.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from ..controller import ControllerLike
from ..device import Robot
from ..device.drivers import Driver, load_driver
from ..frames import Frame
from ..runtime import Loop, ThreadTasks, VirtualTasks
from ..runtime.tasks import run_at
from .buses import open_gates
from .replay import Replay
from .rig import connect
from .runner import BUSES, Runner
from .virtual import VirtualRobot

Load = Callable[[str], Driver]


def run_virtual(
    robot: Robot | VirtualRobot,
    controllers: Sequence[ControllerLike],
    *,
    rate_hz: float | None = None,
    seed: int = 0,
    load: Load = load_driver,
    **options: Any,
) -> Runner:
    """A runner in virtual time: `with run_virtual(robot, [walk]) as run: run.do("enable"); run.run(10.0)`.

    `rate_hz` is the buses' tick (default: the robot's, else 100 Hz). Other options are `Runner`'s.
    """
    made = robot
    if isinstance(made, Robot):
        made = VirtualRobot(made, rate_hz=rate_hz or made.rate_hz or 100, seed=seed, load=load)
    runner = Runner(made.rig, controllers, tasks=VirtualTasks(made.clock), **options)
    runner.before.append(made.simulation.open)
    runner.after.append(made.simulation.close)
    runner.world = made
    return runner


def run_real(
    robot: Robot,
    controllers: Sequence[ControllerLike],
    *,
    buses: Mapping[str, Mapping[str, Any]] | None = None,
    rate_hz: float | None = None,
    real_time: bool = False,
    load: Load = load_driver,
    **options: Any,
) -> Runner:
    """A runner on real buses: threads on absolute deadlines, `SCHED_FIFO` with `real_time` where the system allows it.

    What raises on the buses' thread (a driver's fault) is an event, "bug", which stops motion unless declared otherwise.
    `buses` says where each is, see `gate_of`. Other options are `Runner`'s.
    """
    failed: list[Callable[[BaseException], None]] = []
    loop = Loop(failed=lambda error: failed[0](error))
    ports = open_gates(robot, loop, buses, load=load)
    rig = connect(robot, ports, rate_hz=rate_hz or robot.rate_hz or 100, load=load)
    runner = Runner(rig, controllers, tasks=ThreadTasks(loop, real_time=real_time), **options)
    failed.append(runner.bus_failed)
    runner.before.append(loop.start)
    if real_time:
        runner.before.append(lambda: loop.call(lambda: run_at(BUSES)))
    runner.after.append(loop.stop)
    return runner


def run_replay(
    robot: Robot,
    frames: Iterable[Frame],
    controllers: Sequence[ControllerLike],
    *,
    channels: Mapping[str, str] | None = None,
    load: Load = load_driver,
    **options: Any,
) -> Runner:
    """A runner on a recording: controllers see what was measured, their set-points are counted and go nowhere.

    `runner.run(until=lambda: runner.world.is_over)` runs to its end.
    """
    replay = Replay(robot, frames, channels=channels, load=load)
    options.setdefault("guard", False)
    runner = Runner(replay.rig, controllers, tasks=VirtualTasks(replay.clock), drives=False, **options)
    runner.before.append(replay.start)
    runner.world = replay
    return runner
