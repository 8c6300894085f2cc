"""A recording in place of a robot's buses: hosts hear what was recorded, and what they send goes nowhere.

1. Nothing is sent: what a host sends is counted, and heard by nobody.
2. Requests in the recording are noted before their answers are read, so that answers which need them are decoded.
3. Time is virtual: the recording's own pace, from event to event, as fast as the machine can.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any, Literal

from ..device import Host, Robot
from ..errors import CallerError
from ..frame_table import NO_TIME, to_ns
from ..frames import Frame
from ..runtime import VirtualClock
from .rig import Rig, connect, spoken_on


class ReplayPort:
    """One bus of a recording. Frames of other buses are not given to it."""

    link: Literal["can", "serial", "datagram"] = "can"
    half_duplex = False

    def __init__(self, clock: VirtualClock, name: str) -> None:
        self.clock, self.name = clock, name
        self.swallowed = 0
        self._received: Callable[[Any, int], Any] | None = None
        self.note: Callable[[Any], None] | None = None

    def open(self, received: Callable[[Any, int], Any]) -> None:
        """Begin to hear."""
        self._received = received

    def on_event(self, handler: Callable[[str, str], Any]) -> None:
        """Nothing happens to a recording."""

    def send(
        self,
        word: Any,
        age_ns: int = 0,
        *,
        urgent: bool = False,
        topic: object = None,
        report: Callable[[str, str], Any] | None = None,
    ) -> bool:
        """Taken and dropped."""
        self.swallowed += 1
        if report is not None:
            report("sent", "")
        return True

    def wire_ns(self, word: Any) -> int:
        """Nothing."""
        return 0

    def close(self) -> None:
        """Hear no more."""
        self._received = None

    def heard(self, word: Any) -> None:
        """A word of the recording."""
        if self.note is not None:
            self.note(word)
        if self._received is not None:
            self._received(word, self.clock.now())


class Replay:
    """A robot whose buses are a recording. `is_over` when all of it has been heard.

    `frames` are a CAN recording's, in order; `channels` maps the recording's channel names to the robot's buses (default:
    the `channel` of each bus in the robot's file, or its name; the only bus takes all). Raises `CallerError` for a robot
    with buses that are not CAN.
    """

    def __init__(
        self,
        robot: Robot,
        frames: Iterable[Frame],
        *,
        channels: Mapping[str, str] | None = None,
        clock: VirtualClock | None = None,
        load: Any = None,
    ) -> None:
        self.clock = clock if clock is not None else VirtualClock()
        more = {} if load is None else {"load": load}
        links = {name: robot.buses[name].link for name in spoken_on(robot, **more)}
        if set(links.values()) != {"can"}:
            raise CallerError(f"robot {robot.name} has buses that are not CAN; replays are of CAN recordings")
        self.ports = {name: ReplayPort(self.clock, name) for name in links}
        self.rig: Rig = connect(robot, self.ports, **more)
        for name, host in self.rig.hosts.items():
            self._mute(host)
            self.ports[name].note = host.scanner.sent
        self._channels = dict(channels or {})
        if not self._channels:
            for name in self.ports:
                self._channels[robot.buses[name].channel or name] = name
                self._channels[name] = name
        self._frames: Iterator[Frame] = iter(frames)
        self.is_over = False
        #: Frames that were on no channel of this robot.
        self.others = 0
        self._first: int | None = None
        self._start = self.clock.now()

    @staticmethod
    def _mute(host: Host) -> None:
        """Devices' first requests go nowhere either: nothing answers, so nothing is missed."""
        host.rate_hz = None

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
                port.heard(frame)
            self._next()

        self.clock.post(due, happen)

    def _port_of(self, frame: Frame) -> ReplayPort | None:
        if len(self.ports) == 1:
            return next(iter(self.ports.values()))
        bus = self._channels.get(frame.channel or "")
        return None if bus is None else self.ports[bus]
