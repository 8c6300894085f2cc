"""What is going on in a run, as numbers.

1. Reading never disturbs: nothing is asked of a device, no lock is taken, and what a run's threads change meanwhile is
   read as it is.
2. Rates are of the time between two looks, on the run's own clock.
"""

from __future__ import annotations

from collections import Counter, deque
from dataclasses import dataclass, field
from typing import Any

from aces_bus import Frame
from aces_bus.controller import Bounds
from aces_bus.controller.trip import Clipped
from aces_bus.device.config import Joint
from aces_bus.hardware import SimulatedBus
from aces_bus.protocol.record import FieldValue
from aces_bus.robot import Runner
from aces_bus.runtime.tasks import Task

from ..console import counted

#: What happens on a good day, and is not worth a line.
USUAL = frozenset({"opened", "closed", "error-active", "clipped"})
#: The longest classic frame: what a bus's load is estimated by where it is not measured.
LONGEST = Frame(0, bytes(8))
KEPT_EVENTS = 5
#: A joint of which one set-point in so many is changed is led by its limits; so many of them are named.
CLIPPED_SHARE, MOST_CLIPPED = 10, 3
#: Between two looks at the jitter (ns).
JITTER_EVERY = 2_000_000_000


@dataclass(frozen=True)
class Component:
    """A controller or log: its rate (wanted, and what it came to), jitter in ns, what was missed, how it is."""

    name: str
    wanted_hz: float
    rate_hz: float
    median_ns: int
    most_ns: int
    missed: int
    overruns: int
    says: str
    is_bad: bool = False


@dataclass(frozen=True)
class BusLine:
    """A bus: its load (`is_most`: no more than that), packets a second, unanswered requests, ticks that were left out, the
    longest latency in ns.
    """

    name: str
    load: float | None
    is_most: bool
    sent_hz: float
    received_hz: float
    missed: int
    ticks_missed: int
    latency_ns: int
    state: str


@dataclass(frozen=True)
class StateLine:
    """A state that is in use: its newest value and age in ns, None where it was never known; its last set-point."""

    name: str
    unit: str
    value: FieldValue
    age_ns: int | None
    is_fresh: bool
    set_point: float | None


@dataclass
class Figures:
    """One look. `seconds` of the run's clock, `pace` in seconds of it for one of ours."""

    seconds: float
    pace: float
    components: list[Component]
    buses: list[BusLine]
    states: list[StateLine]
    set_points: int
    clipped: int
    clipped_most: str
    counts: Counter[str]
    events: list[str] = field(default_factory=list[str])

    @property
    def oldest(self) -> StateLine | None:
        """The oldest value in use."""
        return max(
            (s for s in self.states if s.age_ns is not None), key=lambda s: s.age_ns or 0, default=None
        )

    @property
    def unknown(self) -> list[str]:
        """States without a fresh value."""
        return [state.name for state in self.states if not state.is_fresh]


def often_clipped(runner: Runner) -> str:
    """Return the joints that are led by their limits rather than by their controllers, most of all first; "" without any."""
    cycles = {task.name: task.ticks for task in runner.tasks.tasks}
    often: dict[str, int] = {}
    for supervisor in runner.supervisors:
        steps, bounds = cycles[supervisor.name], supervisor.guard.bounds
        for name, clips in supervisor.guard.clips.items():
            changed = max(clips.position, clips.rate, clips.acceleration)  # one set-point may be in each
            if changed * CLIPPED_SHARE > steps:
                state = runner.states[name]
                joint = runner.rig.robot.joints.get(state.name.partition(".")[0])
                why = _limit(clips, bounds[name], state.unit or "", joint)
                often[f"{name} {changed} times in {steps} cycles ({why})"] = changed
    texts = sorted(often, key=lambda text: -often[text])
    more = len(texts) - MOST_CLIPPED
    return ", ".join(texts[:MOST_CLIPPED]) + (f", and {more} more" if more > 0 else "")


def _limit(clips: Clipped, bounds: Bounds, unit: str, joint: Joint | None) -> str:
    """Return the limit that changed most set-points."""
    if clips.position >= max(clips.rate, clips.acceleration):
        return f"limits {bounds.lower:g} … {bounds.upper:g} {unit}"
    if clips.acceleration > clips.rate:
        return f"at most {bounds.acceleration:g} {unit}/s²"
    is_usual = joint is not None and joint.max_speed is joint.nominal_speed is None
    return f"at most {bounds.rate:g} {unit}/s{', as its file states no max_speed' if is_usual else ''}"


class Watch:
    """Looks at a runner now and then. `real` is whether its clock is that on the wall."""

    def __init__(self, runner: Runner, *, real: bool) -> None:
        self.runner, self.real = runner, real
        self.counts: Counter[str] = Counter()
        self.last: deque[str] = deque(maxlen=KEPT_EVENTS)
        self._before: dict[str, tuple[int, ...]] = {}
        self._jitter: dict[str, tuple[int, int, int]] = {}
        self._at = runner.clock.now()
        self._wall = 0
        self._at_first, self._wall_first, self._first = self._at, 0, dict(self._before)
        runner.handlers.append(self._happened)

    def _happened(self, event: Any) -> None:
        self.counts[event.kind] += 1
        if event.kind not in USUAL:
            self.last.append(event_text(event))

    def begin(self, wall_ns: int) -> None:
        """Reckon rates from here on."""
        self.look(wall_ns)
        self._at_first, self._wall_first, self._first = self._at, wall_ns, dict(self._before)

    def total(self, wall_ns: int, seconds: float) -> Figures:
        """Return the figures at the end of a run of so many seconds: rates are of all of it."""
        self._wall, self._before = self._wall_first, dict(self._first)
        return self._figures(wall_ns, seconds, seconds)

    def look(self, wall_ns: int) -> Figures:
        """Return the figures now; `wall_ns` is an instant of the monotonic clock."""
        now = self.runner.clock.now()
        passed = (now - self._at) / 1e9
        self._at = now
        return self._figures(wall_ns, self.runner.seconds, passed)

    def _figures(self, wall_ns: int, seconds: float, passed: float) -> Figures:
        runner = self.runner
        now = runner.clock.now()
        pace = passed * 1e9 / (wall_ns - self._wall) if self._wall and wall_ns > self._wall else 1.0
        passed, self._wall = max(1e-9, passed), wall_ns
        clips = {name: c.total for s in runner.supervisors for name, c in dict(s.guard.clips).items()}
        return Figures(
            seconds,
            pace,
            [self._component(task, passed) for task in runner.tasks.tasks],
            [self._bus(name, host, passed) for name, host in runner.rig.hosts.items()],
            self._states(now),
            runner.set_points,
            sum(clips.values()),
            max(clips, key=lambda name: clips[name]) if clips else "",
            Counter(self.counts),
            list(self.last),
        )

    def _since(self, key: str, *numbers: int) -> tuple[int, ...]:
        before = self._before.get(key, (0,) * len(numbers))
        self._before[key] = numbers
        return tuple(new - old for new, old in zip(numbers, before, strict=True))

    def _component(self, task: Task, passed: float) -> Component:
        (ticks,) = self._since(f"task {task.name}", task.ticks)
        says, is_bad = self._says(task.name)
        median, most = self._jitter_of(task) if self.real else (0, 0)
        return Component(
            task.name,
            task.rate_hz,
            ticks / passed,
            median,
            most,
            task.missed,
            task.overruns,
            says,
            is_bad,
        )

    def _jitter_of(self, task: Task) -> tuple[int, int]:
        """Return median and 99 %; sorting thousands of numbers would disturb, so not at each look."""
        known = self._jitter.get(task.name)
        if known is None or self._wall - known[0] >= JITTER_EVERY:
            known = self._jitter[task.name] = (self._wall, task.jitter_ns(), task.jitter_ns(0.99))
        return known[1:]

    def _says(self, name: str) -> tuple[str, bool]:
        runner = self.runner
        reason = runner.stopped.get(name)
        if reason is not None:
            return f"stopped: {reason}", True
        if name in runner.held:
            return f"held: {runner.held[name]}", True
        for supervisor in runner.supervisors:
            if supervisor.name != name:
                continue
            controller: Any = supervisor.controller
            if supervisor.degraded:
                return f"degraded: {', '.join(supervisor.degraded)}", True
            if getattr(controller, "waiting", ""):
                return f"waits for {controller.waiting}", False
            mode = str(getattr(controller, "mode", "") or "")
            progress = getattr(controller, "progress", None)
            phase = getattr(controller, "phase", None)
            parts = [mode, f"{progress:.0%}" if isinstance(progress, float) else "", str(phase or "")]
            return " ".join(part for part in parts if part), mode == "failed"
        for logger in runner.loggers:
            if logger.name == name:
                lost = getattr(logger, "dropped", 0) + getattr(logger, "lost", 0)
                rows = counted(getattr(logger, "written", 0), "row")
                return (f"{rows}, {lost} lost", True) if lost else (rows, False)
        return "", False

    def _bus(self, name: str, host: Any, passed: float) -> BusLine:
        counts, port = host.counts, host.port
        wire = getattr(self.runner.world, "wires", {}).get(name)
        busy = wire.load.busy_ns if isinstance(wire, SimulatedBus) else 0
        sent, received, on_wire = self._since(f"bus {name}", counts.sent, counts.received, busy)
        load: float | None = None
        if isinstance(wire, SimulatedBus):
            load = on_wire / 1e9 / passed
        elif port.link == "can" and self.real:
            load = (sent + received) * port.wire_ns(LONGEST) / 1e9 / passed
        silent = [device.name for device in host.devices.values() if device.is_silent]
        return BusLine(
            name,
            load,
            not isinstance(wire, SimulatedBus),
            sent / passed,
            received / passed,
            counts.missed,
            counts.ticks_missed,
            counts.latency_ns,
            f"silent: {', '.join(silent)}" if silent else "",
        )

    def _states(self, now: int) -> list[StateLine]:
        runner = self.runner
        given, door = runner.given, runner.rig.door
        lines: list[StateLine] = []
        for name in runner.used:
            signal = runner.states[name]
            value, age = signal.last, signal.age_ns
            fresh = age is not None and not signal.is_stale
            left = door.given(name) if runner.drives and name in given else given.get(name)
            lines.append(StateLine(name, signal.unit or "", value, age, fresh, left))
        return lines


def event_text(event: Any) -> str:
    """Return an event as one line."""
    source = event.source
    text = f"{source}: {event.kind}" + (f": {event.detail}" if event.detail else "")
    return " ".join(text.split())[:300]
