"""What a command sees, as topics of ROS 2: joint states, sensors, diagnostics; and what it is commanded.

1. It publishes, and takes nothing, unless commands are allowed (`commands.Ros2Commands`).
2. It holds nothing up: a message is packed and given to DDS, which does not wait. Diagnostics and the bag are a thread's,
   once a second.
3. An unknown or stale value is NaN, as ros2_control's broadcaster has it.

Topics: `/joint_states`; `/SENSOR/imu` and `/SENSOR/wrench`; `/diagnostics`, a status for each device, bus or message that
has had an event or record, once a second. Stamps are ns since 1970, of virtual time as if it had begun with the run.
"""

from __future__ import annotations

import logging
import math
import threading
import time
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from typing import Self

from aces_bus.controller.base import ControllerLike
from aces_bus.device import Robot
from aces_bus.device.signals import Signal
from aces_bus.errors import CallerError
from aces_bus.kinematics.body import Body
from aces_bus.protocol import Variant
from aces_bus.runtime import RealClock
from aces_bus.runtime.clock import Clock

from .bag import Bag
from .commands import Ros2Commands
from .dds import DdsDomain, DdsWriter
from .messages import (
    DIAGNOSTICS,
    IMU,
    JOINT_STATE,
    WRENCH,
    PackedNumbers,
    dds_type,
    imu_values,
    packed_imu,
    packed_joint_state,
    packed_wrench,
    stamped_header,
)

#: Between two messages of diagnostics, and two chunks of a bag (s).
PERIOD_S = 1.0
#: Statuses that are kept; a bus may have messages without end.
MOST_STATUSES = 500
#: Characters of a value of a record.
MOST_TEXT = 200
#: Levels of diagnostic_msgs/DiagnosticStatus.
LEVELS = {"info": 0, "warning": 1, "error": 2}
#: What an Imu is made of: roll, pitch, yaw (rad), rates (rad/s), accelerations (m/s²), as drivers name them.
IMU_PARTS = (
    ("roll", "pitch", "yaw"),
    ("roll_rate", "pitch_rate", "yaw_rate"),
    ("ax", "ay", "az"),
)
WRENCH_PARTS = ("fx", "fy", "fz", "mx", "my", "mz")
Read = Callable[[], object]


class Ros2View:
    """A participant of a DDS domain that publishes what a command sees; a context manager.

    `interface` and `peers` are what is reached beside this machine, `bag` a file that gets all that is published, `commands`
    says whether commands are taken, `report` gets a sentence for whatever its user should know, on any thread. Raises
    `CallerError` for a missing extra, and a domain or file that cannot be had.
    """

    def __init__(
        self,
        domain: int = 0,
        *,
        interface: str = "",
        peers: Collection[str] = (),
        name: str = "aces",
        bag: str | None = None,
        commands: bool = False,
        clock: Clock | None = None,
        report: Callable[[str], object] = lambda text: None,
    ) -> None:
        self.name, self.report, self._commands = name, report, commands
        self.use_clock(clock if clock is not None else RealClock())
        self.dds = DdsDomain(domain, interface, peers)
        self._writers: dict[str, DdsWriter] = {}
        #: Source → level, message, values.
        self._statuses: dict[str, tuple[int, str, Mapping[str, str]]] = {}
        self._events: Counter[str] = Counter()
        self._buses: list[Ros2Bus] = []
        self.failed = 0
        self._bag: Bag | None = None
        self._stopping = threading.Event()
        self._lock = threading.Lock()
        try:
            self._bag = None if bag is None else Bag(bag, report)
            self._diagnostics = self.writer("/diagnostics", DIAGNOSTICS)
        except BaseException:
            self.dds.close()
            raise
        self._thread = threading.Thread(target=self._publish_on, name="ros2", daemon=True)
        self._thread.start()

    def now(self) -> int:
        """Return the instant of the clock (ns)."""
        return self.clock.now()

    def use_clock(self, clock: Clock) -> None:
        """Take instants for those of this clock from now on."""
        self.clock = clock
        self.epoch_ns = int(getattr(clock, "epoch_ns", 0)) or time.time_ns() - clock.now()

    def writer(self, topic: str, message: str) -> DdsWriter:
        """Return the writer of a topic, which is made when it is first asked for."""
        found = self._writers.get(topic)
        if found is None:
            found = self._writers[topic] = self.dds.writer(topic, message)
        return found

    def send(self, writer: DdsWriter, instant: int, data: bytes) -> None:
        """Publish a message of an instant (ns since 1970), and keep it for the bag."""
        writer.write(data)
        if self._bag is not None:
            self._bag.put(writer.topic, writer.message, instant, data)

    # ------------------------------------------------------------------ a LiveView

    def event(self, instant: int, kind: str, source: str, detail: str = "", level: str = "info") -> None:
        """Keep an event as its source's status."""
        self._events[source] += 1
        self.status(
            source,
            LEVELS.get(level, 1),
            f"{kind}: {detail}" if detail else kind,
            {"events": str(self._events[source])},
        )

    def status(self, source: str, level: int, message: str, values: Mapping[str, str]) -> None:
        """Keep what the next diagnostics say of a source; any thread."""
        with self._lock:
            if source in self._statuses or len(self._statuses) < MOST_STATUSES:
                self._statuses[source] = level, message, values

    def records(self, variants: Sequence[Variant], *, scanner: object = None) -> Ros2Records:
        """Return what shows the newest record of each message in the diagnostics."""
        return Ros2Records(self)

    def states(self, rate_hz: float, body: Body | None) -> Ros2States:
        """Return what publishes joints and sensors at a rate."""
        return Ros2States(self, rate_hz)

    def bus(
        self,
        variants: Sequence[Variant],
        *,
        name: str,
        link: str,
        is_host: bool = True,
        direction: object = None,
    ) -> Ros2Bus:
        """Return what counts the packets of one side of a bus in the diagnostics."""
        self._buses.append(made := Ros2Bus(name))
        return made

    def lines(self) -> logging.Handler:
        """Return what takes lines of Python's `logging`: they are not published."""
        return logging.NullHandler()

    def controllers(
        self, robot: Robot, rate_hz: float, others: Sequence[ControllerLike]
    ) -> list[ControllerLike]:
        """Return the controller that carries out commands, of the joints that no other controller gives set-points to."""
        if not self._commands:
            return []
        taken = {name.partition(".")[0] for other in others for name in getattr(other, "writes", ())}
        joints = {j.name: j for j in robot.joints.values() if j.active and j.name not in taken}
        made = Ros2Commands(self, joints, rate_hz)
        if not made.writes:
            raise CallerError("--ros2-commands: no joint is left that takes positions or speeds")
        return [made]

    # ------------------------------------------------------------------ the thread

    def _publish_on(self) -> None:
        while not self._stopping.wait(PERIOD_S):
            self._publish()
        self._publish()

    def _publish(self) -> None:
        """Publish diagnostics, and write the bag."""
        for bus in self._buses:
            values = {"sent": str(bus.sent), "received": str(bus.received)}
            self.status(f"traffic of {bus.name}", 0, "", values)
        with self._lock:
            statuses = dict(self._statuses)
        instant = time.time_ns()
        made, pair = (
            dds_type("diagnostic_msgs/msg/DiagnosticStatus"),
            dds_type("diagnostic_msgs/msg/KeyValue"),
        )
        try:
            found = [
                made(
                    level,
                    f"{self.name}: {source}",
                    message,
                    self.name,
                    [pair(k, v) for k, v in values.items()],
                )
                for source, (level, message, values) in statuses.items()
            ]
            data = dds_type(DIAGNOSTICS)(stamped_header(instant), found).serialize(use_version_2=False)
            self.send(self._diagnostics, instant, data)
            if self._bag is not None:
                self._bag.flush()
        except Exception as error:  # a view must not end what is looked at
            self.failed += 1
            if self.failed == 1:
                self.report(f"ros2: {type(error).__name__}: {error}")

    def close(self) -> None:
        """Publish what is left, and leave the domain; twice does nothing."""
        if self._stopping.is_set():
            return
        self._stopping.set()
        self._thread.join(5.0)
        if self._bag is not None:
            self._bag.close()
        self.dds.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def dropped(self) -> int:
        """Messages that neither DDS nor the bag has taken."""
        return sum(w.dropped for w in self._writers.values()) + (self._bag.dropped if self._bag else 0)

    def __str__(self) -> str:
        text = f"ros2: {sum(writer.sent for writer in self._writers.values())} messages published"
        if self._bag is not None:
            text += f", {self._bag.written} in {self._bag.path}"
        return text + (f", {self.dropped} dropped" if self.dropped else "")


class _Message:
    """One message that is published at a rate: where its numbers come from."""

    def __init__(
        self,
        writer: DdsWriter,
        packed: PackedNumbers,
        sources: Sequence[Signal | Read | None],
        finish: Callable[[list[float]], list[float]] | None = None,
    ) -> None:
        self.writer, self.packed, self._finish = writer, packed, finish
        self._size = len(sources)
        self._signals = [(n, source) for n, source in enumerate(sources) if isinstance(source, Signal)]
        self._reads = [(n, source) for n, source in enumerate(sources) if callable(source)]

    def pack(self, now: int, instant: int) -> bytes:
        """Return the message at `now` of the signals' clock (ns), stamped `instant`."""
        values = [math.nan] * self._size
        for place, signal in self._signals:
            measured = signal.instant
            if measured is None or ((limit := signal.stale_after_ns) is not None and now - measured > limit):
                continue
            value = signal.last
            values[place] = value if value.__class__ is float else _number(value)
        for place, read in self._reads:
            values[place] = _number(read())
        return self.packed.pack(instant, values if self._finish is None else self._finish(values))


class Ros2States:
    """Joints and sensors at a rate; a `Runner` has it among its `loggers`. `read` in place of `bind` gives positions."""

    def __init__(self, view: Ros2View, rate_hz: float) -> None:
        self.name, self.rate_hz = "ros2 topics", rate_hz
        self.states: tuple[str, ...] = ()
        self._view = view
        self._messages: list[_Message] = []

    def bind(self, states: Mapping[str, object]) -> None:
        """Take a run's joints and sensors, of devices that are there."""
        rig = getattr(states, "rig", None)
        if rig is None:
            raise CallerError("ros2: joints and sensors are those of a run: bind its states")
        self._view.use_clock(rig.clock)
        signals, robot = rig.signals, rig.robot

        def found(owner: str, *parts: str) -> Signal | None:
            return next((signals[f"{owner}.{p}"] for p in parts if f"{owner}.{p}" in signals), None)

        joints = [
            joint.name
            for joint in robot.joints.values()
            if joint.active and joint.device in rig.devices and f"{joint.name}.position" in signals
        ]
        groups = ("position",), ("velocity",), ("torque", "force")
        self._joints(joints, [found(name, *parts) for parts in groups for name in joints])
        for sensor in robot.sensors.values():
            name, topic = sensor.name, f"/{ros_name(sensor.name)}"
            if not sensor.active or sensor.device not in rig.devices:
                continue
            if sensor.kind in ("imu", "tilt"):
                parts = [found(name, part) for group in IMU_PARTS for part in group]
                self._messages.append(
                    _Message(self._view.writer(f"{topic}/imu", IMU), packed_imu(name), parts, _imu)
                )
            elif sensor.kind == "force_torque":
                parts = [found(name, part) for part in WRENCH_PARTS]
                self._messages.append(
                    _Message(self._view.writer(f"{topic}/wrench", WRENCH), packed_wrench(name), parts)
                )

    def read(self, reads: Mapping[str, tuple[str, Read]]) -> None:
        """Have these joints' positions: name → unit, and what gives the value."""
        self._joints([*reads], [*(read for _, read in reads.values()), *[None] * (2 * len(reads))])

    def _joints(self, names: list[str], sources: Sequence[Signal | Read | None]) -> None:
        if names:
            self._add(
                _Message(self._view.writer("/joint_states", JOINT_STATE), packed_joint_state(names), sources)
            )

    def _add(self, message: _Message) -> None:
        self._messages.append(message)

    def start(self, now: int) -> None:
        """Begin nothing."""

    def step(self, now: int) -> None:
        """Publish once."""
        view = self._view
        instant = now + view.epoch_ns
        for message in self._messages:
            view.send(message.writer, instant, message.pack(now, instant))

    def stop(self, now: int) -> None:
        """End nothing: the view is its owner's."""


class Ros2Records:
    """The newest record of each message, and of each identifier on CAN, as a status of the diagnostics."""

    def __init__(self, view: Ros2View) -> None:
        self._view = view
        self._counts: Counter[str] = Counter()

    def put(self, items: Iterable[object]) -> None:
        """Keep them; never waits."""
        for item in items:
            identifier = getattr(item, "_key", None)  # of a CAN frame
            name = type(item).__name__ + ("" if identifier is None else f" {identifier:03X}")
            self._counts[name] += 1
            fields = [f for f in getattr(type(item), "__struct_fields__", ()) if not f.startswith("_")]
            values = {field: str(getattr(item, field))[:MOST_TEXT] for field in fields}
            self._view.status(name, 0, f"{self._counts[name]} received", values)


class Ros2Bus:
    """The packets of one side of a bus, counted."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.sent = self.received = 0

    def passed(self, packet: object, instant: int, is_sent: bool) -> None:
        """Count a packet."""
        if is_sent:
            self.sent += 1
        else:
            self.received += 1


def ros_name(name: str) -> str:
    """Return a name as a part of a ROS topic's: letters, digits and _, no digit first.

    >>> ros_name("left.AP"), ros_name("2nd")
    ('left_AP', '_2nd')
    """
    found = "".join(c if c.isascii() and c.isalnum() else "_" for c in name)
    return f"_{found}" if found[:1].isdigit() or not found else found


def _imu(values: list[float]) -> list[float]:
    return imu_values(values[:3], values[3:6], values[6:])


def _number(value: object) -> float:
    """Return a value, NaN where it is unknown."""
    return float(value) if isinstance(value, int | float) else math.nan
