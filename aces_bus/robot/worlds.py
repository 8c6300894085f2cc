"""The three worlds in which the same controllers run: virtual time with twins, real buses, a recording.

1. Only the world differs: states, controllers, loggers and their order are the same.
2. A replay sends nothing: what a host sends is counted and dropped. Requests in the recording are noted before their answers
   are read, so that answers which need them are decoded. Its time is virtual: the recording's own, from event to event.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, Literal

from ..controller.base import ControllerLike
from ..device import Robot
from ..device.config import priority_of
from ..device.drivers import Driver, load_driver
from ..device.physics import Physics
from ..errors import CallerError
from ..frame_table import NO_TIME, to_ns
from ..frames import Frame
from ..runtime import ThreadTasks, VirtualClock
from ..runtime.loop import Loop
from ..runtime.tasks import VirtualTasks, run_at
from .buses import VirtualRobot, open_gates
from .rig import Rig, connect, spoken_on
from .runner import Runner

Load = Callable[[str], Driver]


def run_virtual(
    robot: Robot | VirtualRobot,
    controllers: Sequence[ControllerLike],
    *,
    rate_hz: float | None = None,
    seed: int = 0,
    pose: Mapping[str, float] | None = None,
    physics: Physics | str | None = None,
    load: Load = load_driver,
    **options: Any,
) -> Runner:
    """Return a runner in virtual time: `with run_virtual(robot, [walk]) as run: run.do("enable"); run.run(10.0)`.

    `rate_hz` is the buses' tick (default: the robot's, else 100 Hz), `pose` where joints are at first and `physics` the
    body that the twins' motors move (see `VirtualRobot`). Other options are `Runner`'s.
    """
    made = robot
    if isinstance(made, Robot):
        rate_hz = rate_hz or made.rate_hz or 100
        made = VirtualRobot(made, rate_hz=rate_hz, seed=seed, pose=pose, physics=physics, load=load)
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
    transmit: bool = False,
    real_time: bool = False,
    passive: bool | None = None,
    load: Load = load_driver,
    **options: Any,
) -> Runner:
    """Return a runner on real buses: threads on absolute deadlines, `SCHED_FIFO` with `real_time` where the system
    allows it.

    Without `transmit` controllers run, and their set-points are counted and not sent; nothing is enabled or stopped, and it
    is `passive` unless that is False: it sends nothing at all, and states are what others ask for. What raises on the buses'
    thread (a driver's fault) is an event, "bug", which stops motion unless declared otherwise. `buses` says where each is,
    see `gate_of`. Other options are `Runner`'s.
    """
    if passive is None:
        passive = not transmit
    elif passive and transmit:
        raise CallerError("a run that is passive sends nothing: leave transmit=True or passive=True away")
    failed: list[Callable[[BaseException], None]] = []
    loop = Loop(failed=lambda error: failed[0](error))
    ports = open_gates(robot, loop, buses, passive=passive, load=load)
    rig = connect(robot, ports, rate_hz=rate_hz or robot.rate_hz or 100, passive=passive, load=load)
    runner = Runner(
        rig, controllers, tasks=ThreadTasks(loop, real_time=real_time), drives=transmit, **options
    )
    failed.append(runner.bus_failed)
    runner.before.append(loop.start)
    if real_time:
        most = max(priority_of(robot.buses[name]) for name in rig.hosts)
        runner.before.append(lambda: loop.call(lambda: run_at(most)))
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
    """Return a runner on a recording: controllers see what was measured, their set-points are counted and go nowhere.

    `runner.run(until=lambda: runner.world.is_over)` runs to its end.
    """
    replay = Replay(robot, frames, channels=channels, load=load)
    options.setdefault("guard", False)
    runner = Runner(replay.rig, controllers, tasks=VirtualTasks(replay.clock), drives=False, **options)
    runner.before.append(replay.start)
    runner.world = replay
    return runner


class ReplayPort:
    """One bus of a recording. Frames of other buses are not given to it."""

    link: Literal["can", "serial", "datagram"] = "can"
    half_duplex = False

    def __init__(self, clock: VirtualClock, name: str) -> None:
        self.clock, self.name = clock, name
        self.swallowed = 0
        self._received: Callable[[Frame | bytes, int], object] | None = None
        self.note: Callable[[Any], None] | None = None

    def open(self, received: Callable[[Any, int], Any]) -> None:
        """Start receiving."""
        self._received = received

    def on_event(self, handler: Callable[[str, str], object]) -> None:
        """Ignore the handler: nothing happens to a recording."""

    def send(
        self,
        packet: Any,
        age_ns: int = 0,
        *,
        urgent: bool = False,
        topic: object = None,
        report: Callable[[str, str], object] | None = None,
    ) -> bool:
        """Count the packet and drop it."""
        self.swallowed += 1
        if report is not None:
            report("sent", "")
        return True

    def wire_ns(self, packet: Any) -> int:
        """Return 0: nothing is sent."""
        return 0

    def close(self) -> None:
        """Stop receiving."""
        self._received = None

    def give(self, packet: Any) -> None:
        """Hand over a packet of the recording."""
        if self.note is not None:
            self.note(packet)
        if self._received is not None:
            self._received(packet, self.clock.now())


class Replay:
    """A robot whose buses are a recording. `is_over` when all of it was received.

    `frames` are a CAN recording's, in order; `channels` maps the recording's channel names to the robot's buses. Default:
    the `channel` of each bus in the robot's file, or its name; for channels without names (0, 1, as BLF and ASC have) the
    number at the end of the bus's channel, or the order of buses; the only bus takes all. Raises `CallerError` for a robot
    with buses that are not CAN.
    """

    def __init__(
        self,
        robot: Robot,
        frames: Iterable[Frame],
        *,
        channels: Mapping[str, str] | None = None,
        clock: VirtualClock | None = None,
        load: Load = load_driver,
    ) -> None:
        self.clock = clock if clock is not None else VirtualClock()
        links = {name: robot.buses[name].link for name in spoken_on(robot, load)}
        if set(links.values()) != {"can"}:
            raise CallerError(f"robot {robot.name} has buses that are not CAN; replays are of CAN recordings")
        self.ports = {name: ReplayPort(self.clock, name) for name in links}
        self.rig: Rig = connect(robot, self.ports, load=load)
        for name, host in self.rig.hosts.items():
            host.rate_hz = (
                None  # devices' first requests go nowhere either: nothing answers, so nothing is missed
            )
            self.ports[name].note = host.scanner.sent
        self._channels = dict(channels or {}) or _channels_of(
            {name: robot.buses[name].channel for name in links}
        )
        self._frames: Iterator[Frame] = iter(frames)
        self.is_over = False
        #: Frames that were on no channel of this robot.
        self.others = 0
        #: Frames by channel of the recording ("": without one).
        self.seen: dict[str, int] = {}
        self._first: int | None = None
        self._start = self.clock.now()

    def start(self) -> None:
        """Plan the recording's first frame for now."""
        self._start = self.clock.now()
        self._next()

    def _next(self) -> None:
        frame = next(self._frames, None)
        if frame is None:
            self.is_over = True
            return
        stamp = to_ns(frame.timestamp)
        if stamp == NO_TIME:
            due = self.clock.now()
        else:
            if self._first is None:
                self._first = stamp
            due = self._start + stamp - self._first

        def happen() -> None:
            port = self._port_of(frame)
            if port is None:
                self.others += 1
            else:
                port.give(frame)
            self._next()

        self.clock.post(due, happen)

    @property
    def unmatched(self) -> str:
        """Frames of the recording that belong to no bus of the robot, with the channels of both; empty if
        there are none.
        """
        if not self.others:
            return ""
        seen = ", ".join(
            f"{name or 'without a name'} ({count} frames)" for name, count in sorted(self.seen.items())
        )
        buses = ", ".join(f"{bus} is {channel}" for channel, bus in self._channels.items() if channel != bus)
        return (
            f"{self.others} frames were on no bus of {self.rig.robot.name}: the recording's channels are {seen};"
            f" of the robot's buses {buses or ', '.join(self.ports)}"
        )

    def _port_of(self, frame: Frame) -> ReplayPort | None:
        name = frame.channel or ""
        self.seen[name] = self.seen.get(name, 0) + 1
        if len(self.ports) == 1:
            return next(iter(self.ports.values()))
        bus = self._channels.get(name)
        return None if bus is None else self.ports[bus]


_NUMBER = re.compile(r"(?:.*[^0-9])?([0-9]{1,5})", re.DOTALL)


def _channels_of(buses: Mapping[str, str | None]) -> dict[str, str]:
    """Return a recording's channel names with the bus of each: by name, by number, by order where no bus has a number."""
    found = {name: name for name in buses}
    found.update((channel, name) for name, channel in buses.items() if channel is not None)
    numbers = [_NUMBER.fullmatch(channel or "") for channel in buses.values()]
    if not any(numbers):
        numbered = {str(place): name for place, name in enumerate(buses)}
    else:
        numbered = {}
        for name, number in zip(buses, numbers, strict=True):
            if number is not None:
                numbered.setdefault(str(int(number[1])), name)
    return {**numbered, **found}
