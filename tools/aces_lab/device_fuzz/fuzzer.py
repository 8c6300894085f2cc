"""Search for what breaks a device: packets by its spec and beside it, until it raises, falls silent or answers nonsense.

    findings = fuzz_device("odrive")                    # its twin, in virtual time
    findings[0].save(Path("."))                         # the fewest frames that break it; `aces play` repeats them

1. An episode begins with a fresh device. Everything follows from the seed: the same seed finds the same.
2. A fault counts when a fresh device does it again after the steps alone; the steps are then made fewer and simpler.
3. Each fault is found once: the next episodes look for others.
4. Nothing prints or reads a clock here; `judge` and `progress` are called, and may.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, BinaryIO

from msgspec import structs

from aces_bus import Frame, FrameTable, make_scanner, open_recording
from aces_bus.device import Driver, Robot, load_driver
from aces_bus.device.config import alone
from aces_bus.errors import CallerError, UnknownNameError
from aces_bus.frame_table import Channels
from aces_bus.protocol import Variant
from aces_bus.recordings.base import Chunk, SerialRecording
from aces_bus.robot import parse_robot
from aces_bus.testing.bench import Bench
from aces_bus.testing.shrinking import simpler_frames, smaller_packets
from aces_bus.testing.source import Dice

from .packets import AnyPacket, DevicePackets, LeftOut, SendRules
from .tester import Problem, SentStep
from .trial import Expectations, FreshDevice, TwinTrial, measured, missed

#: Packets of one episode, at most; between two questions whether it still answers.
EPISODE, BETWEEN = 1000, (4, 24)
#: How long nothing is sent behind a packet (ns): mostly a moment, now and then long enough for a watchdog.
PAUSES_NS = (100_000, 100_000, 100_000, 1_000_000, 1_000_000, 5_000_000, 20_000_000)
LONG_PAUSE_NS = 1_200_000_000
#: How often one packet is repeated in a burst, at most; packets that may come again later.
BURST, KEPT = 300, 64
#: Packets that are sent while a fault is made small, at most; a run of so few steps is not asked whether it is only long.
SHRINK_PACKETS, FEW = 60_000, 4
#: The pause (ns) that every step has when that makes no difference.
USUAL_PAUSE_NS = 2_000_000


@dataclass(frozen=True)
class DeviceFinding:
    """A fault of a device, and the fewest steps found after which a fresh one shows it.

    `sent` is what was on the bus then: seconds from the first, and the frame or bytes. `episode` and `packets` say when it
    was found first, `tried` how many fresh devices it took to make it small.
    """

    problem: Problem
    device: str
    driver: str
    bus: str
    variant: Variant = field(repr=False)
    seed: int
    episode: int
    packets: int
    steps: tuple[SentStep, ...] = field(repr=False)
    sent: tuple[tuple[float, Any], ...] = field(repr=False)
    tried: int = 0

    def __str__(self) -> str:
        return f"{self.device} {self.problem.kind}: {self.problem.text}"

    def records(self) -> list[Any]:
        """Return the steps as their receiver reads them; what is not a message is `Unknown`."""
        scanner: Any = make_scanner([self.variant], direction="to device", include_unknown=True)
        found: list[Any] = []
        for step in self.steps:
            if isinstance(step.packet, bytes):
                found += scanner.datagram(step.packet)
            else:
                found += scanner.feed(list(step.packet) if isinstance(step.packet, tuple) else [step.packet])
        return found

    @property
    def suffix(self) -> str:
        """Suffix of the finding's capture: `.log` (candump) for frames, `.slog` for bytes."""
        return ".log" if self.variant.link == "can" else ".slog"

    @property
    def stem(self) -> str:
        """A file's name that follows from the content."""
        said = repr((self.problem.key, [(round(s, 9), w) for s, w in self.sent]))
        kind = self.problem.kind.replace(" ", "-").replace("'", "")
        return f"{self.device}-{kind}-{hashlib.sha256(said.encode()).hexdigest()[:8]}"

    def save(self, path: Path) -> Path:
        """Write what was sent as a capture that `aces play` repeats: this file, or one in this folder.

        Raises `CallerError` when it cannot be written.
        """
        target = path / f"{self.stem}{self.suffix}" if path.is_dir() else path
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
            with target.open("wb") as file:
                _write(file, target, self.sent, self.bus)
        except OSError as error:
            raise CallerError(f"{target}: cannot be written: {error.strerror or error}") from error
        return target


def _write(file: BinaryIO, path: Path, sent: Sequence[tuple[float, Any]], bus: str) -> None:
    if sent and isinstance(sent[0][1], Frame):
        from aces_bus.recordings.write.candump import CandumpWriter

        frames = [structs.replace(packet, timestamp=at, channel=bus, is_rx=None) for at, packet in sent]
        writer = CandumpWriter(file, str(path))
        writer.write(FrameTable.from_frames(frames, Channels()))
        writer.close()
        return
    from aces_bus.recordings.write.serial import SerialLogWriter

    lines = SerialLogWriter(file, str(path))
    for at, packet in sent:
        lines.write(Chunk(packet, at, "to device"))
    lines.close()


# ---------------------------------------------------------------------- the search


class DeviceFuzzer:
    """The search for faults of one twin; `run` goes on with it.

    `robot` and `name` say which device it is. `only` are messages to be sent (all of the device by default), `leave_out`
    those that are not: "SetId", "Write.address=3..4". `expected`: what else must hold after any sequence.
    Raises `UnknownNameError` for a device or message that there is not, `CallerError` for a device that cannot be simulated.
    """

    def __init__(
        self,
        robot: Robot,
        name: str,
        *,
        seed: int = 0,
        only: Collection[str] = (),
        leave_out: Sequence[str] = (),
        expected: Expectations | None = None,
        load: Callable[[str], Driver] = load_driver,
    ) -> None:
        self.robot, self.name, self.seed = alone(robot, name), name, seed
        self.expected, self._load = expected or Expectations(), load
        driver = load(robot.devices[name].driver)
        if not driver.virtual:
            raise CallerError(f"{name}: the twin of {driver.name} runs on real time only")
        first = self._fresh_trial(False)
        for action in self.expected.actions:
            if action not in first.device.actions:
                raise UnknownNameError(f"action of {name} ({driver.name})", action, first.device.actions)
        self.variant, self.link = first.tester.variant, first.tester.variant.link
        self.rules = rules_of(self.variant, first.config.credentials, only=only, leave_out=leave_out)
        self.packets = DevicePackets(self.rules)
        self.fresh: FreshDevice = self._measured(first)
        self.findings: list[DeviceFinding] = []
        #: What was done so far: episodes, packets sent in them, and packets sent to make faults small.
        self.episodes = self.sent = self.resent = self.trials = 0
        #: What it does wrong when it is fresh already: not what is searched for.
        self.known: dict[tuple[str, str], Problem] = {problem.key: problem for problem in self.fresh.problems}
        self._bench = Bench(self.variant, "to device")

    def _fresh_trial(self, needs_start: bool | None = None) -> TwinTrial:
        start = self.fresh.needs_start if needs_start is None else needs_start
        trial = TwinTrial(self.robot, self.name, load=self._load, needs_start=start)
        if needs_start is None:
            trial.tester.ignored = {problem.key for problem in self.fresh.problems}
        return trial

    def _measured(self, first: TwinTrial) -> FreshDevice:
        """Return how a fresh one is; one that neither answers nor speaks is set up by its driver first."""
        fresh = measured(first.tester)
        if fresh.answers or fresh.periods:
            return fresh
        set_up = measured(self._fresh_trial(True).tester, needs_start=True)
        return set_up if set_up.answers or set_up.periods else fresh

    def run(
        self, packets: int, *, most: int | None = None, progress: Callable[[], bool] | None = None
    ) -> list[DeviceFinding]:
        """Send about so many packets more, or until there are `most` findings; those that are new.

        `progress` is called now and then; the search ends when it gives False.
        """
        before, end = len(self.findings), self.sent + packets
        while self.sent < end and (most is None or len(self.findings) < most):
            if progress is not None and not progress():
                break
            self._episode(min(EPISODE, end - self.sent), progress)
        return self.findings[before:]

    def _episode(self, packets: int, progress: Callable[[], bool] | None) -> None:
        number, self.episodes = self.episodes, self.episodes + 1
        source = Dice(f"{self.seed} {number}")
        trial = self._fresh_trial()
        steps: list[SentStep] = []
        problem = None
        drawn = self._drawn(source)
        until = source.integer(*BETWEEN)
        # Most are short: what needs a long sequence is the exception, and a short one is soon made small.
        length = min(packets, source.choice((20, 60, 200, EPISODE)))
        while problem is None and len(steps) < length:
            how, packet, pause = next(drawn)
            problem = trial.guarded(lambda: steps.append(trial.tester.give(packet, pause, how)))  # noqa: B023
            if problem is not None and (not steps or steps[-1].packet is not packet):
                steps.append(SentStep(packet, pause, how))  # it has raised
            self.sent += 1
            until -= 1
            if problem is None and until <= 0:
                until = source.integer(*BETWEEN)
                is_missed, problem = self._asked(trial, steps)
                if is_missed or trial.has_another_number:
                    break
                if progress is not None and not progress():
                    break
        problem = problem or trial.judge(self.fresh, self.expected)
        if problem is not None and problem.key not in self.known:
            self.known[problem.key] = problem
            self._report(problem, steps, number)

    def _asked(self, trial: TwinTrial, steps: list[SentStep]) -> tuple[bool, Problem | None]:
        """Ask the polls, as steps: whether one was not answered, and what is wrong."""
        settled: list[int] = []
        problem = trial.guarded(lambda: settled.append(trial.tester.settle()))
        if problem is not None or not settled:
            return False, problem
        steps[-1] = replace(steps[-1], pause_ns=steps[-1].pause_ns + settled[0])
        found: list[int | None] = []
        problem = trial.guarded(lambda: found.append(missed(trial.tester, self.fresh, steps.append)))
        return bool(found) and found[0] is not None, problem

    def _drawn(self, source: Dice) -> Iterator[tuple[str, AnyPacket, int]]:
        """Yield packets without an end, and the pause (ns) behind each: new ones, earlier ones again, bursts of one."""
        kept: list[tuple[str, AnyPacket]] = []
        while True:
            how = source.integer(0, 127)
            if kept and how < 24:
                packet = source.choice(kept)
            else:
                packet = self.packets.draw(source)
                kept = [*kept[-KEPT:], packet]
            pause = LONG_PAUSE_NS if how == 127 else source.choice(PAUSES_NS)
            yield (*packet, pause)
            if how in (125, 126):
                for _ in range(source.integer(2, BURST)):
                    yield (*packet, PAUSES_NS[0])

    # ------------------------------------------------------------------ what was found, made small

    def judged(self, steps: Sequence[SentStep]) -> tuple[Problem | None, TwinTrial, int]:
        """Return what a fresh device does wrong after these steps, the device, and how many steps it took."""
        trial = self._fresh_trial()
        self.trials += 1
        self.resent += len(steps) + 4
        for number, step in enumerate(steps):
            problem = trial.play(step)
            if problem is not None:
                return problem, trial, number + 1
        return trial.judge(self.fresh, self.expected), trial, len(steps)

    def _report(self, problem: Problem, steps: list[SentStep], episode: int) -> None:
        before = self.trials
        least = _Least(self, problem, steps)
        least.make_small()
        found, _, _ = self.judged(least.steps)
        if found is None or found.key != problem.key:  # only where a twin is not the same each time
            found, least.steps = problem, steps
        self.findings.append(
            DeviceFinding(
                found,
                self.name,
                self.robot.devices[self.name].driver,
                self.robot.devices[self.name].bus,
                self.variant,
                self.seed,
                episode,
                self.sent,
                tuple(least.steps),
                self._sent(least.steps),
                self.trials - before,
            )
        )

    def _sent(self, steps: Sequence[SentStep]) -> tuple[tuple[float, Any], ...]:
        """Return what is on the bus when these steps are played: in seconds from the first."""
        trial = self._fresh_trial()
        begin = 0 if self.fresh.needs_start else len(trial.sent)
        for step in steps:
            if trial.play(step) is not None:
                break
        sent = trial.sent[begin:]
        first = sent[0][0] if sent else 0
        return tuple(((instant - first) / 1e9, packet) for instant, packet in sent)

    def simpler_packets(self, packet: AnyPacket) -> Iterator[AnyPacket]:
        """Yield packets with less in them that may be sent, too."""
        if isinstance(packet, tuple):
            return
        simpler: Iterator[AnyPacket]
        if isinstance(packet, bytes):
            simpler = (made for _, made in smaller_packets(self._bench, packet, 0))
        else:
            simpler = _simpler_frames(self._bench, packet)
        seen = {packet}
        for made in simpler:
            if made not in seen:
                seen.add(made)
                if self.rules.admit(made):
                    yield made


def _simpler_frames(bench: Bench, frame: Frame) -> Iterator[Frame]:
    for made in simpler_frames(bench, frame):
        if made.arbitration_id == frame.arbitration_id:
            yield made
    for at in range(len(frame.data)):
        for value in (0, 1, frame.data[at] >> 1):
            if value < frame.data[at]:
                yield structs.replace(frame, data=frame.data[:at] + bytes([value]) + frame.data[at + 1 :])


class _Least:
    """The fewest and simplest steps so far after which a fresh device shows a problem."""

    def __init__(self, fuzzer: DeviceFuzzer, problem: Problem, steps: Sequence[SentStep]) -> None:
        self.fuzzer, self.problem, self.steps = fuzzer, problem, list(steps)
        self._end = fuzzer.resent + SHRINK_PACKETS

    @property
    def is_over(self) -> bool:
        return self.fuzzer.resent >= self._end

    def offer(self, steps: Sequence[SentStep]) -> bool:
        """Take steps after which it happens, too."""
        if self.is_over:
            return False
        found, _, used = self.fuzzer.judged(steps)
        if found is None or found.key != self.problem.key:
            return False
        self.steps = list(steps[:used])
        return True

    def make_small(self) -> None:
        """Try fewer steps first, then simpler ones."""
        if not self.offer(self.steps) or self.offer([]):
            return
        size = 1
        while size < len(self.steps) and not self.offer(self.steps[-size:]):
            size *= 2
        if not self._repeated():
            self._fewer()
            self._at_the_same_time()
        self._quicker()
        done: set[str] = set()
        while (
            packet := next((s.packet for s in self.steps if repr(s.packet) not in done), None)
        ) is not None:
            done.add(repr(self._simpler(packet)))

    def _repeated(self) -> bool:
        """Return what only needs many: one step again and again, as often as it takes; whether it is that."""
        if len(self.steps) <= FEW:
            return False
        by_packet: dict[str, list[SentStep]] = {}
        for step in self.steps:
            by_packet.setdefault(repr(step.packet), []).append(step)
        for alike in sorted(by_packet.values(), key=len, reverse=True)[:FEW]:
            least, most = 1, len(self.steps)
            if not self.offer([alike[0]] * most):
                continue
            most = len(self.steps)
            while least < most and not self.is_over:
                middle = (least + most) // 2
                if self.offer([alike[0]] * middle):
                    most = len(self.steps)
                else:
                    least = middle + 1
            return True
        return False

    def _fewer(self) -> None:
        """Leave out ever smaller runs of steps (delta debugging)."""
        size = max(1, len(self.steps) // 2)
        while self.steps and not self.is_over:
            at, is_less = max(0, len(self.steps) - size), False
            while True:
                is_less |= self.offer(self.steps[:at] + self.steps[at + size :])
                if at == 0:
                    break
                at = max(0, min(at, len(self.steps)) - size)
            if size == 1 and not is_less:
                return
            size = max(1, size // 2)

    def _at_the_same_time(self) -> None:
        """Drop steps but keep their pauses: some faults need the instant, not the step."""
        for at in range(len(self.steps) - 1, 0, -1):
            if len(self.steps) <= FEW or at >= len(self.steps):
                continue
            before = self.steps[at - 1]
            longer = replace(before, pause_ns=before.pause_ns + self.steps[at].pause_ns)
            self.offer([*self.steps[: at - 1], longer, *self.steps[at + 1 :]])

    def _quicker(self) -> None:
        """Try the usual pause for each step, and each packet as it is sent when it is valid."""
        usual = [self._usual(step) for step in self.steps]
        if usual != self.steps and not self.offer(usual):
            for number, step in enumerate(usual):
                if step != self.steps[number]:
                    self.offer([*self.steps[:number], step, *self.steps[number + 1 :]])

    def _usual(self, step: SentStep) -> SentStep:
        return (
            replace(step, pause_ns=min(step.pause_ns, USUAL_PAUSE_NS)) if self.fuzzer.link == "can" else step
        )

    def _simpler(self, packet: AnyPacket) -> AnyPacket:
        """Make a packet simpler wherever it is sent; what it is then."""
        while not self.is_over:
            for made in self.fuzzer.simpler_packets(packet):
                if self.offer(
                    [replace(step, packet=made) if step.packet == packet else step for step in self.steps]
                ):
                    packet = made
                    break
            else:
                break
        return packet


# ---------------------------------------------------------------------- one call


def fuzz_device(
    device: str | Driver | Robot,
    name: str | None = None,
    *,
    seed: int = 0,
    packets: int = 10_000,
    most: int | None = 3,
    only: Collection[str] = (),
    leave_out: Sequence[str] = (),
    expected: Expectations | None = None,
    load: Callable[[str], Driver] = load_driver,
) -> list[DeviceFinding]:
    """Return the faults of a twin: of a driver's example, or of the device `name` of a robot.

    `packets` are sent at most, until `most` faults are found. The rest is `DeviceFuzzer`'s, which raises.
    """
    if isinstance(device, str):
        device = load(device)
    if isinstance(device, Driver):
        driver, others = device, load
        device, found = example_of(driver)
        name = name or found

        def loading(wanted: str) -> Driver:
            return driver if wanted == driver.name else others(wanted)

        load = loading

    if name is None:
        raise CallerError(f"which device of {device.name}? {', '.join(device.devices)}")
    fuzzer = DeviceFuzzer(
        device, name, seed=seed, only=only, leave_out=leave_out, expected=expected, load=load
    )
    return fuzzer.run(packets, most=most)


def example_of(driver: Driver) -> tuple[Robot, str]:
    """Return the example robot of a driver, and its first device. Raises `CallerError` where there is none."""
    robot, problems = parse_robot(driver.example, f"{driver.name}.toml")
    names = (
        [] if robot is None else [n for n, c in robot.devices.items() if c.driver == driver.name and c.active]
    )
    if robot is None or not names:
        raise CallerError(f"driver {driver.name} has no example robot with such a device: {problems}")
    return robot, names[0]


def rules_of(
    variant: Variant,
    credentials: Any,
    *,
    only: Collection[str] = (),
    leave_out: Sequence[str] = (),
    strictly: bool = False,
    fixed: Mapping[str, Mapping[str, Collection[Any]]] | None = None,
) -> SendRules:
    """Return what may be sent of a variant's messages; raises `UnknownNameError` for names that are none."""
    sent = [m.name for m in variant.messages_for("to device")]
    for message in only:
        if message not in sent:
            raise UnknownNameError(f"message to a device of {variant.label}", message, sent)
    return SendRules(
        variant,
        credentials,
        allowed=frozenset(only) or None,
        left_out=[LeftOut.parse(text, variant) for text in leave_out],
        fixed=fixed,
        strictly=strictly,
    )


# ---------------------------------------------------------------------- captures


def capture_steps(path: str, link: str) -> list[SentStep]:
    """Return the steps of a capture: what went to the device, with the pauses between. Raises `CaptureError`,
    `CallerError`.
    """
    packets: list[tuple[float, Any]] = []
    with open_recording(path, link="can" if link == "can" else "serial") as capture:
        if isinstance(capture, SerialRecording):
            for chunk in capture:
                if chunk.direction != "from device":
                    packets.append((chunk.time or 0.0, chunk.data))
        else:
            for frames in capture.batches(256):
                packets += [
                    (f.timestamp or 0.0, structs.replace(f, timestamp=None, channel=None, is_rx=None))
                    for f in frames
                ]
    if not packets:
        raise CallerError(f"{path}: nothing in it went to a device")
    following = [at for at, _ in packets[1:]] + [packets[-1][0] + USUAL_PAUSE_NS / 1e9]
    return [
        SentStep(packet, max(0, round((then - at) * 1e9)), "mutated")
        for (at, packet), then in zip(packets, following, strict=True)
    ]


__all__ = [
    "DeviceFinding",
    "DeviceFuzzer",
    "capture_steps",
    "example_of",
    "fuzz_device",
    "rules_of",
]
