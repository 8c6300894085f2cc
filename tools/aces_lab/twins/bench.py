"""A bench: simulated devices on buses of their own, for a test or a program, and what has passed there.

1. Its buses are simulated; nothing here opens an interface of the machine.
2. What programs and twins have said is kept as it passed, and decoded when it is asked for.
3. In real time by default; `time="virtual"` is for programs that wait in `recv` alone.

    with open_bench("odrive", node=3) as motor:
        bus = motor.bus
"""

from __future__ import annotations

import time as _time
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from pathlib import Path
from types import MethodType
from typing import Any, Literal, NamedTuple, Self, TypeVar

import can
import msgspec

from aces_bus import Frame, FrameTable, Unknown, make_scanner
from aces_bus.device import Driver, Robot, Twin, load_driver
from aces_bus.errors import CallerError, UnknownNameError
from aces_bus.recordings.base import Chunk
from aces_bus.recordings.write import open_writer
from aces_bus.robot.rig import simulate, spoken_on
from aces_bus.runtime import VirtualClock
from aces_tools.one_kind import BUS_KEYS, DEVICE_KEYS, robot_of

from .catalogue import Injection
from .lines import Line, line_of
from .recorded import RecordedTwin, recorded_robot
from .tap import Passed, TwinTap

T = TypeVar("T")
#: Lines of a conversation that are printed: its end.
SHOWN = 60
#: Characters of a record that are printed.
WIDTH = 200


class Seen(NamedTuple):
    """A record that passed: when (s since the bench was made), on which bus, whether a twin sent it, what a fault did."""

    time_s: float
    bus: str
    is_answer: bool
    record: Any
    note: str = ""

    def __str__(self) -> str:
        said = str(self.record)
        said = said if len(said) <= WIDTH else said[: WIDTH - 1] + "…"
        note = f"   [{self.note}]" if self.note else ""
        return f"{self.time_s:10.6f} {'<-' if self.is_answer else '->'} {said}{note}"


class _Reader:
    """Decodes what has passed on one bus, as far as it has come: each way by itself, answers with their requests."""

    def __init__(self, line: Line, tap: TwinTap, variants: Iterable[Any], start: int) -> None:
        both = list(variants)
        self._line, self._tap, self._start = line, tap, start
        self._scanners = {
            is_answer: make_scanner(
                both, direction="from device" if is_answer else "to device", include_unknown=True
            )
            for is_answer in (False, True)
        }
        self._taken = 0
        self.seen: list[Seen] = []

    def read(self, *, is_over: bool = False) -> list[Seen]:
        """Return all records so far; with `is_over`, also what is incomplete."""
        passed = self._tap.passed[self._taken :]
        self._taken += len(passed)
        for item in passed:
            self._take(item)
        if is_over:
            for is_answer, scanner in self._scanners.items():
                self.seen += [
                    Seen(self.seconds(0), self._line.name, is_answer, left) for left in scanner.close()
                ]
        return self.seen

    def seconds(self, instant: int) -> float:
        """Return an instant as seconds since the bench was made."""
        return (instant - self._start) / 1e9

    def _take(self, item: Passed) -> None:
        scanner = self._scanners[item.is_answer]
        if item.note.endswith("not sent"):
            self.seen.append(
                Seen(self.seconds(item.instant), self._line.name, True, _shown(item.packet), item.note)
            )
            return
        records = scanner.feed([item.packet] if isinstance(item.packet, Frame) else item.packet)
        if not item.is_answer and isinstance(item.packet, Frame):
            self._scanners[True].sent(item.packet)
        for record in records:
            if not item.is_answer and not isinstance(item.packet, Frame) and not isinstance(record, Unknown):
                self._scanners[True].sent(record.meta.raw)
            self.seen.append(
                Seen(self.seconds(item.instant), self._line.name, item.is_answer, record, item.note)
            )
        if item.note and not records:
            self.seen.append(
                Seen(self.seconds(item.instant), self._line.name, True, _shown(item.packet), item.note)
            )


def _shown(packet: Any) -> str:
    if isinstance(packet, Frame):
        return f"{packet.arbitration_id:03X}#{packet.data.hex().upper()}"
    return bytes(packet).hex(" ")


class TwinState:
    """A twin's own state: its attributes, and its registers in brackets. Each is read and set while its bus stands still."""

    __slots__ = ("_bench", "_twin")

    def __init__(self, bench: TwinBench, twin: Twin) -> None:
        object.__setattr__(self, "_bench", bench)
        object.__setattr__(self, "_twin", twin)

    def __getattr__(self, name: str) -> Any:
        found = self._bench.call(lambda: getattr(self._twin, name))
        if isinstance(found, MethodType):
            return lambda *values, **named: self._bench.call(lambda: found(*values, **named))
        return found

    def __setattr__(self, name: str, value: Any) -> None:
        """Set an attribute that the twin has. Raises `UnknownNameError`: a misspelt name would set nothing."""

        def give() -> None:
            if not hasattr(self._twin, name):
                known = [known for known in dir(self._twin) if not known.startswith("_")]
                raise UnknownNameError(f"state of {self._twin.name}", name, known)
            setattr(self._twin, name, value)

        self._bench.call(give)

    def __getitem__(self, name: str) -> Any:
        return self._bench.call(lambda: self._twin[name])

    def __setitem__(self, name: str, value: Any) -> None:
        def give() -> None:
            self._twin[name] = value

        self._bench.call(give)

    def __repr__(self) -> str:
        return repr(self._twin)


class TwinBench:
    """Twins of a robot, each bus with its own way in. A context manager: its end takes all away.

    `channel`, `bus_options`, `bus` and `port` are those of the only bus; of several see `lines`, by the bus's name.
    """

    def __init__(
        self,
        robot: Robot,
        *,
        shared: bool = False,
        time: Literal["real", "virtual"] = "real",
        seed: int = 0,
        pose: Mapping[str, float] | None = None,
        homed: bool = True,
        fd: bool = False,
        tcp: bool = False,
        injection: Injection | None = None,
        load: Callable[[str], Driver] = load_driver,
    ) -> None:
        self.robot = robot
        self.clock = VirtualClock() if time == "virtual" else None
        self.lines: dict[str, Line] = {}
        self._taps: dict[str, TwinTap] = {}
        self._buses: list[can.BusABC] = []
        self._is_open = False
        self._expected = 0
        try:
            for name, protocol in spoken_on(robot, load).items():
                made = line_of(robot.buses[name], protocol, shared=shared, fd=fd, tcp=tcp, clock=self.clock)
                self.lines[name] = made
                self._taps[name] = TwinTap(made.port)
            self._simulation = self._in_all(
                lambda: simulate(robot, self._taps, seed=seed, pose=pose, homed=homed, load=load)
            )
            self.twins: dict[str, Twin] = dict(self._simulation.twins)
            self._readers = {
                name: _Reader(
                    line,
                    self._taps[name],
                    self._simulation.buses[name].variants.values(),
                    line.port.clock.now(),
                )
                for name, line in self.lines.items()
            }
            for name, line in self.lines.items():
                twins = self._simulation.buses[name]
                line.call(twins.open)
                if injection is not None:
                    self._taps[name].alter = line.call(partial(injection.prepare, line, twins))
            self._is_open = True
        except BaseException:
            self.close()
            raise

    def _in_all(self, action: Callable[[], T]) -> T:
        """Call something while all buses stand still."""
        for line in self.lines.values():
            action = partial(line.call, action)
        return action()

    # ------------------------------------------------------------------ the ways in

    @property
    def line(self) -> Line:
        """The only bus. Raises `CallerError` where there are several."""
        if len(self.lines) != 1:
            raise CallerError(
                f"{self.robot.name} has several buses; say which: .lines[{next(iter(self.lines))!r}]"
            )
        return next(iter(self.lines.values()))

    @property
    def channel(self) -> str:
        """The channel of the only bus, for python-can's `interface="aces"`."""
        return self.line.channel

    @property
    def bus_options(self) -> dict[str, Any]:
        """Keywords for `can.Bus`. Raises `CallerError` for a serial line."""
        if self.line.link != "can":
            raise CallerError(f"{self.robot.name} is on a serial line: .port is its terminal")
        return dict(self.line.keywords)

    @property
    def bus(self) -> can.BusABC:
        """A new python-can bus on it, which is shut down at the end."""
        made = can.Bus(**self.bus_options)
        self._buses.append(made)
        return made

    @property
    def port(self) -> str:
        """The path of the only bus's terminal, or a URL for `serial.serial_for_url` where there are no terminals.

        Raises `CallerError` for a CAN bus.
        """
        if not self.line.path:
            raise CallerError(
                f"{self.robot.name} is on CAN: .bus is a python-can bus, .bus_options its keywords"
            )
        return self.line.path

    @property
    def baud(self) -> int:
        """The speed of its line (bit/s); at another one it does not understand."""
        return self.line.baud

    # ------------------------------------------------------------------ the twins

    def __getitem__(self, name: str) -> TwinState:
        """Return the state of a device's twin. Raises `UnknownNameError`."""
        return TwinState(self, self._twin(name))

    def _twin(self, name: str) -> Twin:
        if name not in self.twins:
            raise UnknownNameError(f"device of {self.robot.name}", name, self.twins)
        return self.twins[name]

    @property
    def state(self) -> TwinState:
        """The state of the first device's twin."""
        return self[next(iter(self.twins))]

    def call(self, action: Callable[[], T]) -> T:
        """Return what `action()` returns, called when nothing else touches the twins."""
        return self._in_all(action)

    def fault(self, name: str, device: str | None = None, *, on: bool = True, **amount: float) -> None:
        """Have a device misbehave, or all: one of `aces_bus.device.twin.FAULTS` or of its driver's.

        The amount has whatever name reads well: `fault("loses", every=3)`. Raises `UnknownNameError`, and `CallerError` for
        several amounts.
        """
        if len(amount) > 1:
            raise CallerError(f"fault {name}: one amount, not {', '.join(amount)}")
        given = next(iter(amount.values()), None)
        for twin in self.twins.values() if device is None else [self._twin(device)]:
            self.call(partial(twin.fault, name, given, on=on))

    def reboot(self, off_s: float = 0.1) -> None:
        """Switch all devices off, and on again after a while (s)."""

        def off() -> None:
            for twin in self.twins.values():
                twin.power(False)
                twin.clock.call_in(round(off_s * 1e9), partial(twin.power, True))

        self.call(off)

    def wait(self, seconds: float) -> None:
        """Let time pass: the bench's own where it is virtual."""
        if self.clock is not None:
            self.clock.advance(round(seconds * 1e9))
        else:
            _time.sleep(seconds)

    # ------------------------------------------------------------------ what has passed

    @property
    def frames(self) -> list[Seen]:
        """All records that have passed, in order, with what was not understood as `Unknown`."""
        self.call(lambda: None)
        return self._seen()

    def _seen(self, *, is_over: bool = False) -> list[Seen]:
        found = [seen for reader in self._readers.values() for seen in reader.read(is_over=is_over)]
        return found if len(self._readers) == 1 else sorted(found, key=lambda seen: seen.time_s)

    @property
    def answers(self) -> int:
        """Number of answers that the twins have given."""
        return sum(tap.answers for tap in self._taps.values())

    def last(self, message: str) -> Any:
        """Return the last record of a message, from either side. Raises `AssertionError` where there was none."""
        for seen in reversed(self.frames):
            if type(seen.record).__name__ == message:
                return seen.record
        raise AssertionError(f"no {message} has passed\n{self.text()}")

    def expect(self, message: str, *, within_s: float = 1.0, **fields: Any) -> Any:
        """Return the next record of a message that has these fields, behind what was expected before; wait for it.

        Numbers agree within a thousandth, or what one step of their field is. Raises `AssertionError` with the conversation.
        """
        end = _time.monotonic() + within_s
        left_s = within_s
        while True:
            seen = self.frames
            for place in range(self._expected, len(seen)):
                record = seen[place].record
                if type(record).__name__ == message and all(_agrees(record, k, v) for k, v in fields.items()):
                    self._expected = place + 1
                    return record
            if self.clock is not None:
                if left_s <= 0:
                    break
                self.wait(0.001)
                left_s -= 0.001
            elif _time.monotonic() > end:
                break
            else:
                _time.sleep(0.001)
        wanted = ", ".join(f"{name}={value!r}" for name, value in fields.items())
        raise AssertionError(f"no {message}({wanted}) within {within_s:g} s\n{self.text()}")

    def text(self, *, is_over: bool = False) -> str:
        """Return the conversation in lines, decoded: its last `SHOWN`. -> is to the device, <- its answer."""
        seen = self._seen(is_over=is_over)
        lines = [f"({len(seen) - SHOWN} before)"] if len(seen) > SHOWN else []
        lines += [str(item) for item in seen[-SHOWN:]]
        lines += [f"{name}: {said}" for name, line in self.lines.items() if (said := line.complaint())]
        lines += [
            said for twin in self.twins.values() if isinstance(twin, RecordedTwin) and (said := twin.report())
        ]
        return "\n".join(lines) or "nothing has passed"

    def save(self, path: str | Path) -> list[Path]:
        """Save what has passed as recordings, `.log` (candump) or `.slog` (serial), one a bus. Return the files."""
        base, files = Path(path), []
        base.parent.mkdir(parents=True, exist_ok=True)
        for name, tap in self._taps.items():
            line, reader = self.lines[name], self._readers[name]
            passed = [item for item in tap.passed if not item.note.endswith("not sent")]
            stem = base.name if len(self._taps) == 1 else f"{base.name}.{name}"
            file = base.with_name(stem + (".log" if line.link == "can" else ".slog"))
            with open_writer(str(file)) as writer:
                if line.link == "can":
                    frames = [
                        msgspec.structs.replace(
                            item.packet, timestamp=max(0.0, reader.seconds(item.instant)), channel=name
                        )
                        for item in passed
                    ]
                    if frames:
                        writer.write(FrameTable.from_frames(frames))
                else:
                    for item in passed:
                        way: Any = "from device" if item.is_answer else "to device"
                        writer.write(Chunk(item.packet, max(0.0, reader.seconds(item.instant)), way))
            files.append(file)
        return files

    # ------------------------------------------------------------------ its end

    def close(self) -> None:
        """Take all away."""
        for bus in self._buses:
            bus.shutdown()
        self._buses.clear()
        if self._is_open:
            self._is_open = False
            for name, line in self.lines.items():
                line.call(self._simulation.buses[name].close)
        for line in self.lines.values():
            line.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __repr__(self) -> str:
        where = ", ".join(f"{name}: {line.channel or line.path}" for name, line in self.lines.items())
        return f"<{', '.join(self.twins)} on {where}>"


def _agrees(record: Any, name: str, wanted: Any) -> bool:
    found = getattr(record, name, None)
    if isinstance(wanted, float) and isinstance(found, (int, float)):
        return abs(found - wanted) <= 1e-3 * max(1.0, abs(wanted))
    return bool(found == wanted)


#: Keywords of a bench itself.
_BENCH = ("shared", "time", "seed", "pose", "homed", "tcp", "injection")


def open_bench(driver: str | Driver | Robot, /, *, fd: bool = False, **options: Any) -> TwinBench:
    """Return simulated devices on a bus of their own, open: `with open_bench("feetech", ids=[1, 2]) as arm:`.

    `driver` names one of `aces devices`, or a protocol that one kind of device speaks, or is a robot. Its numbers are given
    by name (`node=3`, `ids=[1, 2]`); with none it is the first device of the driver's example. `model`, `settings`,
    `channels`, `kind` say what the device is, `bitrate`, `baud`, `dialect` what its bus is, as in a robot's file; `fd`: a
    bus for CAN FD, and the kind of device that speaks it, where there are two.

    With `protocol` it is a recording that answers as its device did: `open_bench("talk.slog", protocol="modbus")`.

    `shared`: on a CAN bus that other processes join too. `time="virtual"`: see the module. `seed`, `pose` (joint → rad) and
    `homed` are `simulate`'s. `tcp`: a serial line as a TCP port (a URL of pyserial) though there are terminals.

    Raises `UnknownNameError` and `CallerError` for what there is not or cannot be.
    """
    own = {name: options.pop(name) for name in _BENCH if name in options}
    if isinstance(driver, str) and (protocol := options.pop("protocol", None)) is not None:
        robot, made = recorded_robot(driver, protocol, **options)
        return TwinBench(robot, fd=fd, load=lambda name: made, **own)
    if isinstance(driver, Robot):
        robot = driver
    else:
        said = {name: options.pop(name) for name in (*BUS_KEYS, *DEVICE_KEYS) if name in options}
        robot, options = robot_of(driver, options, fd=fd, **said), {}
    if options:
        raise CallerError(f"a robot has its numbers in its file; not {', '.join(options)}")
    return TwinBench(robot, fd=fd, **own)


__all__ = ["Seen", "TwinBench", "TwinState", "open_bench"]
