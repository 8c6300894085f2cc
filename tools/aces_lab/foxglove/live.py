"""What happens on a robot or bus, live, for Foxglove and every other program that speaks its WebSocket protocol.

1. It only shows: clients publish nothing, set no parameters, call no services. It listens on this machine alone unless the
   address says otherwise, and pages of other origins are refused (`origins`).
2. It holds nothing up: what is shown is put into a bounded queue, and a thread encodes and sends it. What does not fit is
   dropped, the oldest first, counted (`dropped`) and reported. Where nobody looks on, nothing is queued.
3. Topics, schemas and objects are those of an MCAP of the same data (`aces_lab.tables.topics`).

Topics: `/states`, `/events`, `/log` and `/tf` (robots with a body), `/PROTOCOL/MESSAGE`, and `/_lost` for what was not
decoded. `/log` and `/tf` have Foxglove's own schemas (https://docs.foxglove.dev/docs/sdk/schemas: Log, FrameTransforms).

Needs the extra `[foxglove]` (foxglove-sdk).
"""

from __future__ import annotations

import logging
import math
import threading
import time
from collections import deque
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from types import ModuleType
from typing import Any, Literal, Never, Self
from typing import Protocol as Interface

import msgspec
import numpy as np

from aces_bus import make_scanner
from aces_bus.device import UNKNOWN
from aces_bus.errors import CallerError
from aces_bus.export.base import Dataset, Datasets, Options
from aces_bus.kinematics.body import Body
from aces_bus.kinematics.links import Links
from aces_bus.loopback import is_loopback
from aces_bus.protocol import CanScanner, Record, Variant
from aces_bus.protocol.columns.scanner import RecordColumns
from aces_bus.protocol.declare.message import GivenWay
from aces_bus.protocol.record import PlainValue
from aces_bus.runtime import RealClock
from aces_bus.runtime.clock import Clock
from aces_bus.state.quantity import TimeSeries
from aces_lab.tables.topics import STATES_TOPIC, TableTopics, states_schema

from .origins import OriginGate, hidden_host

#: Foxglove's own port.
HOST, PORT = "127.0.0.1", 8765
#: How often what waits is sent (s): what a viewer may lag behind.
PERIOD_S = 0.05
#: Items that may wait: seconds of a full bus.
WAITING = 1 << 16
#: Messages that may wait for one viewer, in the SDK; it drops the oldest.
BACKLOG = 4096
#: How long what was sent last may take to leave (s).
LINGER_S = 0.1
#: Levels of foxglove.Log.
LEVELS: Mapping[str, int] = {"debug": 1, "info": 2, "warning": 3, "error": 4}
Level = Literal["debug", "info", "warning", "error"]
_TIME = {
    "type": "object",
    "title": "time",
    "properties": {"sec": {"type": "integer", "minimum": 0}, "nsec": {"type": "integer", "minimum": 0}},
}


def _object(title: str, **properties: Any) -> dict[str, PlainValue]:
    return {"type": "object", "title": title, "properties": properties}


_TEXT, _NUMBER, _WHOLE = {"type": "string"}, {"type": "number"}, {"type": "integer"}
LOG_SCHEMA = msgspec.json.encode(
    _object("foxglove.Log", timestamp=_TIME, level=_WHOLE, message=_TEXT, name=_TEXT, file=_TEXT, line=_WHOLE)
)
EVENT_SCHEMA = msgspec.json.encode(_object("event", kind=_TEXT, source=_TEXT, detail=_TEXT, level=_TEXT))
TRANSFORMS_SCHEMA = msgspec.json.encode(
    _object(
        "foxglove.FrameTransforms",
        transforms={
            "type": "array",
            "items": _object(
                "foxglove.FrameTransform",
                timestamp=_TIME,
                parent_frame_id=_TEXT,
                child_frame_id=_TEXT,
                translation=_object("foxglove.Vector3", x=_NUMBER, y=_NUMBER, z=_NUMBER),
                rotation=_object("foxglove.Quaternion", x=_NUMBER, y=_NUMBER, z=_NUMBER, w=_NUMBER),
            ),
        },
    )
)


def foxglove() -> ModuleType:
    """Return the library; `CallerError` naming the extra when it is missing."""
    try:
        import foxglove as library
    except ImportError as missing:
        raise CallerError(
            f"a live view needs foxglove-sdk: pip install 'aces-bus[foxglove]' ({missing})"
        ) from missing
    return library


def parse_live_address(text: str) -> tuple[str, int]:
    """Return host and port of `8765`, `HOST:8765` or `[::1]:8765`; "" is the usual one. Raises `CallerError`.

    >>> parse_live_address(""), parse_live_address("9000"), parse_live_address("0.0.0.0:8765")
    (('127.0.0.1', 8765), ('127.0.0.1', 9000), ('0.0.0.0', 8765))
    """
    host, colon, port = text.rpartition(":")
    host = host.removeprefix("[").removesuffix("]") if colon else HOST
    port = port or ("" if colon else str(PORT))
    if not host or not port.isdecimal() or int(port) > 65_535:
        raise CallerError(f"{text!r} is not an address of a live view: write PORT or HOST:PORT, such as 8765")
    return host, int(port)


def _time(instant: int) -> dict[str, int]:
    sec, nsec = divmod(max(0, instant), 1_000_000_000)
    return {"sec": sec, "nsec": nsec}


class Feed(Interface):
    """Where items of one kind become messages."""

    def publish(self, items: Sequence[Any]) -> None:
        """Send what has come; on the view's thread."""
        ...


class FoxgloveView:
    """A server of live topics; a context manager.

        with FoxgloveView() as view:
            gate.on_event(lambda event: view.event(event.instant, event.kind, event.bus, event.detail))

    `address` is PORT or HOST:PORT (port 0: one that is free), `origins` are pages beside the app's own and this machine's
    that may look on. `report` gets a sentence for whatever its user should know, on any thread. Instants that are given are
    of `clock` (default: the monotonic one), and become ns since 1970 where it knows them (`epoch_ns`).

    `dropped` counts items that did not fit into the queue, `published` messages that were sent, `viewers` who looks on.
    Raises `CallerError` for a missing extra, and an address that cannot be had.
    """

    def __init__(
        self,
        address: str = "",
        *,
        name: str = "aces",
        origins: Collection[str] = (),
        clock: Clock | None = None,
        report: Callable[[str], object] = lambda text: None,
        waiting: int = WAITING,
    ) -> None:
        self.host, port = parse_live_address(address)
        self._report = report
        self.waiting = waiting
        self.dropped = self.published = self.failed = 0
        self._is_dropping = False
        self._queue: deque[tuple[Feed, Any]] = deque()
        self._channels: list[Any] = []
        self._stopping = threading.Event()
        self._is_open = False
        self._encode = msgspec.json.Encoder().encode
        self.use_clock(clock if clock is not None else RealClock())
        self._library = foxglove()
        self._context = self._library.Context()
        #: What the library logs is not for stderr.
        self._library_log = logging.getLogger("foxglove")
        self._library_log.propagate = False
        self._library_log.addHandler(_SlowViewers(self._too_slow))
        self._slow = 0
        inside = hidden_host()
        self._server = self._library.start_server(
            name=name,
            host=inside,
            port=0,
            capabilities=[],
            supported_encodings=[],
            context=self._context,
            message_backlog_size=BACKLOG,
        )
        try:
            self._gate = OriginGate(self.host, port, (inside, self._server.port), origins, report)
        except CallerError as error:
            self._server.stop()
            raise CallerError(f"live view: {error}; another port is free, such as {port + 1}") from None
        self.port = self._gate.port
        self._log_feed, self._event_feed = _Messages(self), _Messages(self)
        self._log_feed.channel = self.channel("/log", "foxglove.Log", LOG_SCHEMA, {})
        self._event_feed.channel = self.channel("/events", "aces.event", EVENT_SCHEMA, {})
        self._thread = threading.Thread(target=self._publish_on, name="foxglove", daemon=True)
        self._thread.start()
        self._is_open = True

    @property
    def address(self) -> str:
        """Address that clients connect to: `ws://127.0.0.1:8765`."""
        return f"ws://{f'[{self.host}]' if ':' in self.host else self.host}:{self.port}"

    @property
    def is_local(self) -> bool:
        """True if only programs of this machine can connect."""
        return is_loopback(self.host)

    @property
    def viewers(self) -> int:
        """Who looks on."""
        return self._gate.viewers

    def now(self) -> int:
        """Return the instant of the clock (ns)."""
        return self.clock.now()

    def use_clock(self, clock: Clock) -> None:
        """Take instants for those of this clock from now on."""
        self.clock = clock
        self.epoch_ns = int(getattr(clock, "epoch_ns", 0))

    # ------------------------------------------------------------------ channels: a ChannelSink

    def channel(self, topic: str, title: str, schema: bytes, metadata: Mapping[str, str]) -> int:
        """Declare a channel of JSON messages that a JSON schema describes; returns its number."""
        made = self._library.Channel(
            topic,
            schema=self._library.Schema(name=title, encoding="jsonschema", data=schema),
            message_encoding="json",
            context=self._context,
            metadata=dict(metadata),
        )
        self._channels.append(made.base)
        return len(self._channels) - 1

    def is_wanted(self, channel: int) -> bool:
        """Return whether a client has subscribed to it."""
        return bool(self._channels[channel].has_sinks())

    def send(self, channel: int, instant: int, message: bytes) -> None:
        """Send a message, of an instant in ns since 1970 (or of virtual time); on the view's thread."""
        self._channels[channel].log(message, max(0, instant))
        self.published += 1

    # ------------------------------------------------------------------ what is shown

    def put(self, feed: Feed, item: Any) -> None:
        """Have a feed publish an item soon. Never waits; any thread."""
        if not self._gate.viewers:
            return
        queue = self._queue
        if len(queue) >= self.waiting:
            try:
                queue.popleft()
            except IndexError:  # the other thread was faster
                pass
            else:
                self.dropped += 1
                if not self._is_dropping:
                    self._is_dropping = True
                    self._report("live view: more happens than can be shown; the oldest is dropped")
        queue.append((feed, item))

    def records(self, variants: Sequence[Variant], *, scanner: Any = None) -> LiveRecords:
        """Return what shows a scanner's records."""
        return LiveRecords(self, variants, scanner=scanner)

    def states(self, rate_hz: float, body: Body | None) -> LiveStates:
        """Return what shows states at a rate, and the transforms of a body."""
        return LiveStates(self, rate_hz, body=body)

    def bus(
        self,
        variants: Sequence[Variant],
        *,
        name: str,
        link: Literal["can", "serial", "datagram"],
        is_host: bool = True,
        direction: GivenWay | None = None,
    ) -> LiveBus:
        """Return what shows the packets of one side of a bus, decoded."""
        return LiveBus(self, variants, name=name, link=link, is_host=is_host, direction=direction)

    def lines(self) -> LogLines:
        """Return what shows lines of Python's `logging`."""
        return LogLines(self)

    def controllers(self, robot: object, rate_hz: float, others: object) -> Sequence[Never]:
        """Return none: who looks on commands nothing."""
        return ()

    def log(self, instant: int, level: Level, name: str, message: str) -> None:
        """Put a line into `/log`; `instant` in ns of the clock."""
        self.put(self._log_feed, (instant + self.epoch_ns, _log_line, (level, name, message)))

    def event(self, instant: int, kind: str, source: str, detail: str = "", level: Level = "info") -> None:
        """Publish an event for `/events`, and as a line for `/log`."""
        self.put(self._event_feed, (instant + self.epoch_ns, _event, (kind, source, detail, level)))
        self.log(instant, level, source, f"{kind}: {detail}" if detail else kind)

    # ------------------------------------------------------------------ the thread

    def _publish_on(self) -> None:
        while not self._stopping.wait(PERIOD_S):
            self._publish()
        self._publish()

    def _publish(self) -> None:
        """Publish all that waits, feed by feed."""
        queue = self._queue
        by_feed: dict[int, tuple[Feed, list[Any]]] = {}
        for feed, item in (queue.popleft() for _ in range(len(queue))):
            by_feed.setdefault(id(feed), (feed, []))[1].append(item)
        if len(queue) < self.waiting // 2:
            self._is_dropping = False
        for feed, items in by_feed.values():
            try:
                feed.publish(items)
            except Exception as error:  # a view must not end what is looked at
                self.failed += len(items)
                if self.failed == len(items):
                    self._report(f"live view: {type(error).__name__}: {error}")

    def _too_slow(self) -> None:
        self._slow += 1
        if self._slow == 1:
            self._report("live view: a viewer does not keep up; the oldest is left out for it")

    def close(self) -> None:
        """Send what waits, and end; twice does nothing."""
        if not self._is_open:
            return
        self._is_open = False
        self._stopping.set()
        self._thread.join(5.0)
        if self.viewers:
            time.sleep(LINGER_S)  # the library sends on threads of its own, and says not when it has
        self._server.stop()
        self._gate.close()
        for handler in [*self._library_log.handlers]:
            if isinstance(handler, _SlowViewers):
                self._library_log.removeHandler(handler)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __str__(self) -> str:
        text = f"live view: {self.published} messages sent"
        if self.dropped:
            text += f", {self.dropped} items dropped"
        if self._gate.refusals:
            text += f", {self._gate.refusals} pages refused"
        return text


class _SlowViewers(logging.Handler):
    """What the library logs: that a viewer's backlog is full is known in no other way."""

    def __init__(self, too_slow: Callable[[], object]) -> None:
        super().__init__(logging.INFO)
        self._too_slow = too_slow

    def emit(self, record: logging.LogRecord) -> None:
        """Take one."""
        if "full" in record.getMessage():
            self._too_slow()


class LogLines(logging.Handler):
    """What a program logs with Python's `logging`, as lines of `/log`."""

    def __init__(self, view: FoxgloveView) -> None:
        super().__init__()
        self._view = view

    def emit(self, record: logging.LogRecord) -> None:
        """Take one. Where no other handler is, it is on stderr, too, as it were without this one."""
        level: Level = "info"
        if record.levelno < logging.INFO:
            level = "debug"
        elif record.levelno >= logging.ERROR:
            level = "error"
        elif record.levelno >= logging.WARNING:
            level = "warning"
        try:
            text = record.getMessage()
        except Exception:  # arguments that do not fit the text: logging's own way with them
            self.handleError(record)
            return
        self._view.log(self._view.clock.now(), level, record.name, text)
        last = logging.lastResort
        if logging.getLogger().handlers == [self] and last is not None and record.levelno >= last.level:
            last.handle(record)


class _Messages:
    """Single messages: (instant, what makes the object, its arguments)."""

    def __init__(self, view: FoxgloveView) -> None:
        self._view = view
        self._encode = msgspec.json.Encoder().encode
        self.channel = -1

    def publish(self, items: Sequence[Any]) -> None:
        """Send them."""
        if self._view.is_wanted(self.channel):
            for instant, make, arguments in items:
                self._view.send(self.channel, instant, self._encode(make(instant, *arguments)))


def _log_line(instant: int, level: str, name: str, message: str) -> dict[str, PlainValue]:
    return {
        "timestamp": _time(instant),
        "level": LEVELS.get(level, 0),
        "message": message,
        "name": name,
        "file": "",
        "line": 0,
    }


def _event(instant: int, kind: str, source: str, detail: str, level: str) -> dict[str, PlainValue]:
    return {"kind": kind, "source": source, "detail": detail, "level": level}


# ---------------------------------------------------------------------- states


class LiveStates:
    """States at a rate, and the transforms of a body; a `Runner` has it among its `loggers`.

    `states` (None: joints, their set-points, and sensors) are names, as loggers take them without attributes; `body` has
    joints of these names. `read` instead of `bind` gives them directly: name → unit and what reads it.
    """

    def __init__(
        self,
        view: FoxgloveView,
        rate_hz: float = 100.0,
        states: Iterable[str] | None = None,
        *,
        body: Body | None = None,
    ) -> None:
        if not 0 < rate_hz <= 10_000:
            raise CallerError(f"live view: rate_hz = {rate_hz!r} is not a rate up to 10 kHz")
        self.name, self.rate_hz = "live view", rate_hz
        self.view = view
        self.states: tuple[str, ...] = () if states is None else tuple(dict.fromkeys(states))
        self._is_usual = states is None
        self._links = None if body is None else Links(body)
        self._names: list[str] = []
        self._reads: list[Callable[[], object]] = []
        self._channel = self._transforms = -1
        self._encode = msgspec.json.Encoder().encode

    def bind(self, states: Mapping[str, Any]) -> None:
        """Take the states; `UnknownNameError` lists those that exist when one is missing."""
        rig = getattr(states, "rig", None)
        if self._is_usual and rig is not None:
            self.states = tuple(_usual(rig, states))
        found = {name: states[name] for name in self.states}
        clock = getattr(rig, "clock", None) or next((state.clock for state in found.values()), None)
        if clock is not None:
            self.view.use_clock(clock)
        self.read(
            {
                name: (getattr(quantity, "unit", "") or "", _newest(quantity))
                for name, quantity in found.items()
            }
        )

    def read(self, reads: Mapping[str, tuple[str, Callable[[], object]]]) -> None:
        """Have these quantities: name → unit, and what gives the value (whatever is not a number is unknown)."""
        self._names = list(reads)
        self._reads = [read for _, read in reads.values()]
        units = {name: unit for name, (unit, _) in reads.items()}
        self._channel = self.view.channel(STATES_TOPIC, "states", states_schema(units), {})
        if self._links is not None:
            self._transforms = self.view.channel("/tf", "foxglove.FrameTransforms", TRANSFORMS_SCHEMA, {})

    def start(self, now: int) -> None:
        """Begin nothing."""

    def step(self, now: int) -> None:
        """Sample once, where a client looks on."""
        view = self.view
        if view.is_wanted(self._channel) or (self._links is not None and view.is_wanted(self._transforms)):
            view.put(self, (now + view.epoch_ns, [_number(read) for read in self._reads]))

    def stop(self, now: int) -> None:
        """End nothing: the view is its owner's."""

    def publish(self, items: Sequence[Any]) -> None:
        """Publish rows, and of the transforms the newest."""
        view, names = self.view, self._names
        if view.is_wanted(self._channel):
            for instant, values in items:
                view.send(self._channel, instant, self._encode(dict(zip(names, values, strict=True))))
        if self._links is not None and view.is_wanted(self._transforms):
            instant, values = items[-1]
            known = {name: value for name, value in zip(names, values, strict=True) if value is not None}
            view.send(self._transforms, instant, self._encode(_transforms(self._links, known, instant)))


def _newest(state: Any) -> Callable[[], object]:
    return lambda: state[0]


def _number(read: Callable[[], Any]) -> float | None:
    """Return a value that JSON has; None where it is unknown."""
    try:
        value = read()
        if value.__class__ is not float:  # nearly always it is; a raised exception costs more than all else
            if value is UNKNOWN or value is None:
                return None
            value = float(value)
    except Exception:  # a derived quantity's own
        return None
    return value if -math.inf < value < math.inf else None


def _usual(rig: Any, states: Mapping[str, TimeSeries]) -> Iterable[str]:
    """Return joints with their set-points, and what sensors measure, of devices that are there."""
    for joint in rig.robot.joints.values():
        if joint.active and joint.device in rig.devices and joint.name in states:
            yield joint.name
            if getattr(states[joint.name], "is_writable", False):
                yield f"{joint.name}.setpoint"
    for name in rig.signals:
        sensor = rig.robot.sensors.get(name.partition(".")[0])
        if sensor is not None and sensor.active:
            yield name


def _transforms(links: Links, angles: Mapping[str, float], instant: int) -> dict[str, PlainValue]:
    time = _time(instant)
    return {
        "transforms": [
            {
                "timestamp": time,
                "parent_frame_id": link.parent,
                "child_frame_id": link.child,
                "translation": dict(zip("xyz", link.position, strict=True)),
                "rotation": dict(zip("xyzw", link.rotation, strict=True)),
            }
            for link in links.at(angles)
        ]
    }


# ---------------------------------------------------------------------- records


class LiveRecords(Datasets):
    """Records and `Unknown`s of one link as messages, as an MCAP has them. `put` takes them as a scanner gave them."""

    def __init__(
        self, view: FoxgloveView, variants: Sequence[Variant], *, link: str = "", scanner: Any = None
    ) -> None:
        super().__init__(Options(), variants)
        self._view = view
        self._columns = RecordColumns(variants, include_unknown=True, scanner=scanner)
        self._is_can = (link or self._columns.link) == "can"
        self._topics = TableTopics(self, view)
        self._seen = 0

    def put(self, items: Iterable[Any]) -> None:
        """Show them. Never waits."""
        if self._view.viewers:
            for item in items:
                self._view.put(self, item)

    def _begin(self, dataset: Dataset) -> None:
        self._topics.begin(dataset)

    def publish(self, items: Sequence[Record]) -> None:
        """Publish the messages of records, in their order."""
        rows = np.arange(self._seen, self._seen + len(items)) if self._is_can else None
        self._seen += len(items)
        tables = [table for table in self._columns.tables(items, rows) if len(table)]
        self.see_times(tables)
        for channel, instant, text in self._topics.messages(tables, is_wanted=self._view.is_wanted):
            self._view.send(channel, instant, text)


class LiveBus:
    """What passes one side of a bus, both ways, decoded; `passed` is for `BusEndpoint.watch`.

    `variants` are the bus's protocols (none: frames alone), `link` what it carries; `is_host` says on which side of it we
    are. `name` is the channel in what is shown (of frames, "" leaves their own). `direction` is that of a line of which
    nobody knows which way its bytes went.
    """

    def __init__(
        self,
        view: FoxgloveView,
        variants: Sequence[Variant],
        *,
        name: str,
        link: Literal["can", "serial", "datagram"],
        is_host: bool = True,
        direction: GivenWay | None = None,
    ) -> None:
        self._view, self._name, self._link, self._is_host = view, name, link, is_host
        if link == "can" and direction is None:
            direction = "both"
        #: Of all that passes, or one for each way.
        ways: tuple[Any, ...] = ("from device", "to device") if direction is None else (direction,)
        self._scanners: list[Any] = [
            make_scanner(list(variants), direction=way, include_unknown=True)
            if variants
            else CanScanner((), include_unknown=True)
            for way in ways
        ]
        self._records = LiveRecords(view, variants, scanner=self._scanners[0])

    def passed(self, packet: Any, instant: int, is_sent: bool) -> None:
        """Queue a frame or a piece of bytes for the view, without waiting."""
        self._view.put(self, (packet, instant + self._view.epoch_ns, is_sent is self._is_host))

    def publish(self, items: Sequence[Any]) -> None:
        """Decode, and send what clients have subscribed to."""
        found: list[Any] = []
        for packet, instant, is_to_device in items:
            found += self._decoded(packet, instant, is_to_device)
        self._records.publish(found)

    def _decoded(self, packet: Any, instant: int, is_to_device: bool) -> list[Any]:
        found: list[Any]
        if self._link == "can":
            frame = msgspec.structs.replace(
                packet, timestamp=instant / 1e9, channel=self._name or packet.channel
            )
            found = self._scanners[0].feed((frame,))
            return found
        scanner = self._scanners[-1 if is_to_device else 0]
        if scanner is not self._scanners[0]:
            self._scanners[0].sent(packet)  # its reply hangs on it
        found = (scanner.datagram if self._link == "datagram" else scanner.feed)(packet, instant / 1e9)
        return found
