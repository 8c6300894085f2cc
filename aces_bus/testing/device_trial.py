"""A device under test on its bus: words go to it, what it does is judged.

1. `DeviceTester` is an end of the bus like a host: it asks the driver's polls, and reads what comes by the spec alone.
2. What was sent is noted with its instant, a driver's and a transport's own frames too: played again they do the same.
3. What counts as broken is measured against the device itself when it was fresh: which polls it answers, how often.

A `TwinTrial` is a fresh twin in virtual time: as many as one likes, each the same.
"""

from __future__ import annotations

import traceback
from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal

from ..device import Device, Driver, Poll, Robot, Twin, load_driver
from ..device.config import DeviceConfig
from ..device.port import Left, Port
from ..device.station import BusEndpoint, EndpointMember, shown
from ..device.ticket import Awaited
from ..errors import AcesError
from ..hardware.ports import port_of
from ..protocol import Unknown as UnknownWord
from ..protocol import Variant
from ..protocol.declare.message import Message
from ..protocol.plan.nodes import ValueNames
from ..robot.buses import wire_of
from ..robot.rig import Rig, connect, simulate, spoken_on
from ..runtime import VirtualClock
from .device_words import AnyWord, plain_way

#: How long a fresh device is listened to before anything is sent, so that it is known what it sends by itself (ns).
LISTEN_NS = 300_000_000
#: How long a poll's second answer is waited for (ns).
SECOND_NS = 2_000_000
#: How long a half-duplex line must be quiet before the next word, and how long that is waited for at most (ns).
QUIET_NS, BUSY_NS = 2_000_000, 400_000_000
#: No answer for so long, and none is under way (ns).
SETTLED_NS = 5_000_000
#: A device that does not answer is asked again after these pauses (ns): it may have been told to start anew.
PATIENCE_NS = (20_000_000, 500_000_000, 2_000_000_000)
#: What a device sends by itself and has not sent for so many periods, and so long (ns), has stopped.
PERIODS, STOPPED_NS = 10, 500_000_000
#: How long a driver has to set up a device that does not answer without it (ns), and an action may take (s).
START_NS, ACTION_S = 1_000_000_000, 30.0
#: An enumeration with greater numbers is a list of codes that others may add to: a number without a name is no fault there.
MOST_NAMED = 0xFF
#: Enumerations and flags of a device at rest, by message and field.
Rest = Mapping[tuple[str, str], Any]

Kind = Literal[
    "raises", "silent", "malformed", "out of range", "another's", "twice", "not at rest", "does not follow"
]


@dataclass(frozen=True)
class Problem:
    """What a device did wrong. `kind` and `subject` say which fault it is, `text` what was seen of it."""

    kind: Kind | str
    subject: str
    text: str

    @property
    def key(self) -> tuple[str, str]:
        """The same for the same fault, whatever values were seen."""
        return self.kind, self.subject


@dataclass(frozen=True)
class SentStep:
    """A word, the time (ns) that passed behind it, and how it was made ("valid", "boundary", "mutated" …)."""

    word: AnyWord
    pause_ns: int
    how: str = "valid"


class Tap:
    """A port that several ends share, and that notes what they send: `sent` are (instant in ns, frame or bytes)."""

    def __init__(self, port: Port) -> None:
        self.port = port
        self.sent: list[tuple[int, Any]] = []
        self.ends: list[Callable[[Any, int], Any]] = []
        self._is_open = False

    def end(self) -> TapEnd:
        """One more end."""
        return TapEnd(self)

    def attach(self, received: Callable[[Any, int], Any]) -> None:
        """Have `received` called, too; the first one opens the port."""
        self.ends.append(received)
        if not self._is_open:
            self._is_open = True
            self.port.open(self._received)

    def _received(self, word: Any, instant: int) -> None:
        for received in tuple(self.ends):
            received(word, instant)


class TapEnd:
    """One end of a `Tap`: a port."""

    def __init__(self, tap: Tap) -> None:
        port = tap.port
        self.tap, self.clock, self.name = tap, port.clock, port.name
        self.link: Literal["can", "serial", "datagram"] = port.link
        self.half_duplex = port.half_duplex
        self._received: Callable[[Any, int], Any] | None = None

    def open(self, received: Callable[[Any, int], Any]) -> None:
        """Begin to receive."""
        self._received = received
        self.tap.attach(received)

    def on_event(self, handler: Callable[[str, str], Any]) -> None:
        """As of the port below."""
        self.tap.port.on_event(handler)

    def send(
        self,
        word: Any,
        age_ns: int = 0,
        *,
        urgent: bool = False,
        topic: object = None,
        report: Left | None = None,
    ) -> bool:
        """Send a frame or bytes, and note it."""
        self.tap.sent.append((self.clock.now(), word))
        return self.tap.port.send(word, age_ns, urgent=urgent, topic=topic, report=report)

    def wire_ns(self, word: Any) -> int:
        """As of the port below."""
        return self.tap.port.wire_ns(word)

    def close(self) -> None:
        """Receive no more; the port below stays open for the other ends."""
        if self._received is not None and self._received in self.tap.ends:
            self.tap.ends.remove(self._received)


class _Ear(EndpointMember):
    """The device, as far as listening to it goes."""

    tester: DeviceTester
    #: Not while its driver speaks to it, who takes its packets.
    listens = True

    @property
    def is_listening(self) -> bool:
        return self.listens

    def receive(self, record: Any, instant: int) -> None:
        self.tester.noted(record, instant)


class DeviceTester(BusEndpoint[_Ear]):
    """An end of a bus that sends to one device, asks its polls, and judges what comes.

    `others` are the credentials of devices that may speak here besides; None: this one is alone on the bus.
    """

    def __init__(
        self,
        port: TapEnd,
        variant: Variant,
        config: DeviceConfig,
        robot: Robot,
        polls: Sequence[Poll],
        others: Sequence[Mapping[str, int]] | None = None,
    ) -> None:
        super().__init__(port, [variant], direction="from device")
        self._end = port
        self.ear = self.add(_Ear(self.clock, config, robot, variant))
        self.ear.tester = self
        self.variant, self.polls, self.others = variant, list(polls), others
        self.problems: list[Problem] = []
        #: What is wrong and known (`Problem.key`).
        self.ignored: Collection[tuple[str, str]] = ()
        #: By message: how often it came, when it came last, and its last enumerations.
        self.counts: Counter[str] = Counter()
        self.last_at: dict[str, int] = {}
        self.rest: dict[tuple[str, str], Any] = {}
        self._heard_ns = 0
        #: After so long a silence a receiver gives up what is incomplete.
        framings = [m.framing for m in variant.messages.values() if m.framing is not None]
        self._gap_ns = round(1.25e9 * max((framing.gap or 0.0 for framing in framings), default=0.0))

    # ------------------------------------------------------------------ what comes

    def noted(self, record: Any, instant: int) -> None:
        """A record of the device."""
        name = type(record).__name__
        self._heard_ns = instant
        self.counts[name] += 1
        self.last_at[name] = instant
        message = self.variant.messages.get(name)
        if message is None:
            return
        for path, is_wrong in _limits(message):
            if (text := is_wrong(record)) is not None:
                self._found("out of range", f"{name}.{path}", f"{name}: {path} is {text}")
        for path in enumerations(message):
            self.rest[name, path] = getattr(record, path, None)

    def _not_understood(self, word: UnknownWord, instant: int) -> None:
        self._heard_ns = instant
        meta = word.meta
        if meta.identifier is not None:
            mine = [m for m in self.variant.messages_for("from device") if self._is_mine(m, meta.identifier)]
            if not mine and self.others is not None:
                return  # another device's, whatever it is
            subject = mine[0].name if mine else f"{meta.identifier:#x}"
            if word.reason.startswith("malformed") or word.reason == "unknown":
                what = f"{meta.identifier:03X}#{meta.raw.hex().upper()}"
                self._found("malformed", subject, f"{what} is {word.reason}")
        elif word.reason.startswith("malformed"):
            self._found("malformed", "a packet", f"{meta.raw.hex(' ').upper()} is {word.reason}")

    def _is_mine(self, message: Message, identifier: int) -> bool:
        found = message.identifier.match(identifier)
        mine = self.ear.credentials
        return found is not None and all(mine.get(name, number) == number for name, number in found.items())

    def _unaddressed(self, record: Any, instant: int) -> None:
        self._heard_ns = instant
        theirs = {n: v for n in self.ear.credentials if (v := getattr(record, n, None)) is not None}
        if self.others is not None and any(
            all(other.get(n, v) == v for n, v in theirs.items()) for other in self.others
        ):
            return
        name = type(record).__name__
        self._found("another's", name, f"{name} came with {shown(theirs) or 'no number'}")

    def _found(self, kind: Kind, subject: str, text: str) -> None:
        if (kind, subject) not in {*self.ignored, *(one.key for one in self.problems)}:
            self.problems.append(Problem(kind, subject, text))

    # ------------------------------------------------------------------ what is sent

    def pass_time(self, duration_ns: int) -> None:
        """Let time pass."""
        if isinstance(self.clock, VirtualClock):
            self.clock.advance(duration_ns)
        else:
            self.clock.wait(lambda: False, duration_ns)

    def _send(self, word: AnyWord, how: str) -> None:
        frames = word if isinstance(word, tuple) else (word,)
        for one in frames:
            self.scanner.sent(one)
        if how != "mutated":
            self.port.send(word)
            return
        for one in frames:  # one behind the other, whatever its receiver allows
            self._end.send(one)

    def _wire_ns(self, word: AnyWord) -> int:
        return sum(map(self._end.wire_ns, word)) if isinstance(word, tuple) else self._end.wire_ns(word)

    def play(self, step: SentStep) -> None:
        """Send a word, and let the time behind it pass."""
        self.clock.call(lambda: self._send(step.word, step.how))
        self.pass_time(step.pause_ns)

    def give(self, word: AnyWord, pause_ns: int, how: str) -> SentStep:
        """Send a word and let so much time pass, on a half-duplex line until it is quiet; the step that does the same."""
        began = self.clock.now()
        self.clock.call(lambda: self._send(word, how))
        self.pass_time(self._wire_ns(word) + pause_ns)
        if self._end.half_duplex:
            self._await_quiet()
        return SentStep(word, self.clock.now() - began, how)

    def _await_quiet(self) -> None:
        end = self.clock.now() + BUSY_NS
        quiet = max(QUIET_NS, self._end.wire_ns(bytes(4)))
        while True:
            before = self._heard_ns
            self.pass_time(quiet)
            if before == self._heard_ns or self.clock.now() >= end:
                return

    def settle(self) -> int:
        """Wait until nothing is under way: answers, and packets that silence ends; how long that took (ns)."""
        began = self.clock.now()
        quiet = max(SETTLED_NS, self._gap_ns)
        while self.clock.now() < began + BUSY_NS + quiet:
            before = self._answered
            self.pass_time(quiet)
            if before == self._answered:
                break
        return self.clock.now() - began

    @property
    def _answered(self) -> int:
        return sum(map(self._answers, self.polls))

    def ask(self, number: int) -> tuple[SentStep, int]:
        """Ask a poll, by its number: the step that does the same, and how many answers came."""
        poll = self.polls[number]
        word = self.word(self.ear, poll.message, poll.fields)
        before = self._answers(poll)
        began = self.clock.now()
        self.clock.call(lambda: self._send(word, "poll"))
        limit = round(poll.timeout_s * 1e9) + self._wire_ns(word)
        self.clock.wait(lambda: self._answers(poll) > before, limit)
        self.pass_time(SECOND_NS)
        if self._end.half_duplex:
            self._await_quiet()
        return SentStep(word, self.clock.now() - began, "poll"), self._answers(poll) - before

    def _answers(self, poll: Poll) -> int:
        return sum(self.counts[name] for name in poll.replies)


# ---------------------------------------------------------------------- what a message declares


@lru_cache(maxsize=4096)
def _limits(message: Message) -> tuple[tuple[str, Callable[[Any], str | None]], ...]:
    """What is declared of a message's fields: for each a function that says what is wrong in a record, or None."""
    found: list[tuple[str, Callable[[Any], str | None]]] = []
    for leaf in message.plan.leaves if message.plan.is_flat else ():
        scale, way = leaf.node.scale, plain_way(leaf)
        if way is None:
            continue
        if scale is not None and scale.limits is not None:
            low, high = scale.limits
            slack = 1e-9 * max(abs(low), abs(high)) + abs(scale.scale) * 1e-6
            found.append((leaf.path, _beyond(way, low - slack, high + slack, (low, high), leaf.node.unit)))
        elif any(isinstance(step, ValueNames) for step in leaf.node.steps):
            ends = leaf.node.raw_range
            if ends is not None and ends[1] <= MOST_NAMED:
                found.append((leaf.path, _unnamed(way)))
    return tuple(found)


@lru_cache(maxsize=4096)
def enumerations(message: Message) -> tuple[str, ...]:
    """The enumerations of a message that are fields of the record itself."""
    return tuple(
        str(leaf.way[0])
        for leaf in (message.plan.leaves if message.plan.is_flat else ())
        if len(leaf.way) == 1 and any(isinstance(step, ValueNames) for step in leaf.node.steps)
    )


def _at(record: Any, way: Sequence[str | int]) -> Any:
    value = record
    for step in way:
        if value is None:
            return None
        value = value[step] if isinstance(step, int) else getattr(value, step)
    return value


def _beyond(
    way: Sequence[str | int], least: float, greatest: float, said: tuple[float, float], unit: str
) -> Callable[[Any], str | None]:
    def is_wrong(record: Any) -> str | None:
        value = _at(record, way)
        if not isinstance(value, (int, float)) or least <= value <= greatest:
            return None
        return f"{value:g}, outside of {said[0]:g}…{said[1]:g} {unit}".rstrip()

    return is_wrong


def _unnamed(way: Sequence[str | int]) -> Callable[[Any], str | None]:
    def is_wrong(record: Any) -> str | None:
        value = _at(record, way)
        return None if isinstance(value, str) or value is None else f"{value}, which has no name"

    return is_wrong


# ---------------------------------------------------------------------- how a fresh device is


@dataclass(frozen=True)
class FreshDevice:
    """What a device did when it was fresh: what it is measured against.

    `answers` are the numbers of the polls that it answers, with how many answers come; `periods` (ns) those of the
    messages that it sends by itself; `needs_start`: it answers only when its driver has set it up; `problems`: what it did
    wrong already.
    """

    answers: Mapping[int, int]
    periods: Mapping[str, int]
    rest: Rest
    needs_start: bool = False
    problems: Sequence[Problem] = ()


def measured(tester: DeviceTester, *, needs_start: bool = False) -> FreshDevice:
    """Listen to a device and ask its polls once."""
    before = Counter(tester.counts)
    tester.pass_time(LISTEN_NS)
    heard = tester.counts - before
    periods = {name: LISTEN_NS // count for name, count in heard.items() if count >= 3}
    answers: dict[int, int] = {}
    for number, poll in enumerate(tester.polls):
        _, count = tester.ask(number)
        if count:
            answers[number] = 0 if not poll.replies.isdisjoint(periods) else count
    return FreshDevice(answers, periods, dict(tester.rest), needs_start, tuple(tester.problems))


def missed(
    tester: DeviceTester, fresh: FreshDevice, note: Callable[[SentStep], None], *, is_late: bool = False
) -> int | None:
    """Ask the polls that a fresh device answers; the first that is not answered now. Each step is given to `note`.

    `is_late`: answers to what was asked before may still come, so that two are no fault. The device is quiet otherwise
    (`DeviceTester.settle`).
    """
    for number, usual in fresh.answers.items():
        step, count = tester.ask(number)
        note(step)
        poll = tester.polls[number]
        if not count:
            return number
        if usual and count > usual and not is_late:
            tester.problems.append(
                Problem("twice", poll.message, f"{poll.message} was answered {count} times, not {usual}")
            )
    return None


def judged_alive(tester: DeviceTester, fresh: FreshDevice) -> Problem | None:
    """Whether a device still does what it did when it was fresh; it is given the time to start anew."""
    if fresh.answers:
        tester.settle()
        began, tries = tester.clock.now(), 1
        number = missed(tester, fresh, _forget)
        for pause in PATIENCE_NS:
            if number is None:
                break
            tester.pass_time(pause)
            tries += 1
            number = missed(tester, fresh, _forget, is_late=True)
        if number is not None:
            seconds = (tester.clock.now() - began) / 1e9
            name = tester.polls[number].message
            return Problem("silent", name, f"{name} is not answered: asked {tries} times in {seconds:.1f} s")
    elif fresh.periods:
        now = tester.clock.now()
        tester.pass_time(max(PERIODS * max(fresh.periods.values()), STOPPED_NS))
        for name in fresh.periods:
            if tester.last_at.get(name, 0) < now:
                return Problem("silent", name, f"{name}, which it sends by itself, does not come any more")
    return tester.problems[0] if tester.problems else None


def _forget(step: SentStep) -> None:
    """The step is none of the sequence."""


# ---------------------------------------------------------------------- twins

#: One's own judgement of a trial's end: what is wrong, or None.
Judge = Callable[["TwinTrial"], str | None]


@dataclass(frozen=True)
class Expectations:
    """What else a device must do after any sequence.

    `rests_ns`: when it was sent nothing for so long, its enumerations are as they were when it was fresh (its watchdog has
    tripped). `actions` of the driver must succeed. `judges`: name → a function of a trial that says what is wrong, or None.
    """

    rests_ns: int | None = None
    actions: Sequence[str] = ()
    judges: Mapping[str, Judge] | None = None


class TwinTrial:
    """A fresh twin of a robot's device, alone on its bus, in virtual time."""

    def __init__(
        self,
        robot: Robot,
        name: str,
        *,
        seed: int = 0,
        load: Callable[[str], Driver] = load_driver,
        needs_start: bool = False,
    ) -> None:
        config = robot.devices[name]
        self.clock = VirtualClock()
        protocol = spoken_on(robot, load)[config.bus]
        wire = wire_of(robot.buses[config.bus], protocol, self.clock)
        self.robot, self.config, self._load = robot, config, load
        self._simulation = simulate(
            robot, {config.bus: port_of(wire, name=f"{config.bus} twins")}, seed=seed, load=load
        )
        self.twin: Twin = self._simulation[name]
        self.tap = Tap(port_of(wire, name=config.bus))
        rig = self._rig()
        self.device: Device = rig.devices[name]
        self.tester = DeviceTester(self.tap.end(), self.device.variant, config, robot, self.device.polls)
        self._simulation.open()
        if needs_start:
            rig.open()
            self.clock.advance(START_NS)
            _close(rig)
        self.tester.open()
        self._credentials = dict(self.twin.credentials)

    def _rig(self) -> Rig:
        return connect(self.robot, {self.config.bus: self.tap.end()}, load=self._load)

    @property
    def sent(self) -> list[tuple[int, Any]]:
        """What was sent so far: instants (ns) and frames or bytes."""
        return self.tap.sent

    @property
    def has_another_number(self) -> bool:
        """Whether it was given other credentials, or switched off: then it is right that it does not answer to these."""
        return self.twin.credentials != self._credentials or not self.twin.is_powered

    def guarded(self, action: Callable[[], Any]) -> Problem | None:
        """Do something; what the twin raises, or did wrong until then, is the problem."""
        try:
            action()
        except Exception as error:  # a fault of any kind is what we look for
            return _raised(error)
        if self.has_another_number:  # its answers have it, too
            return None
        return self.tester.problems[0] if self.tester.problems else None

    def play(self, step: SentStep) -> Problem | None:
        """Send a step; what has gone wrong by then."""
        return self.guarded(lambda: self.tester.play(step))

    def judge(self, fresh: FreshDevice, expected: Expectations) -> Problem | None:
        """What is wrong with it now; some time passes."""
        found: list[Problem | None] = []
        problem = self.guarded(lambda: found.append(self._judged(fresh, expected)))
        return problem or (found[0] if found else None)

    def _judged(self, fresh: FreshDevice, expected: Expectations) -> Problem | None:
        if self.has_another_number:
            return None
        if expected.rests_ns is not None:
            self.tester.pass_time(expected.rests_ns)
        problem = judged_alive(self.tester, fresh)
        if problem is None and expected.rests_ns is not None:
            problem = self._unrested(fresh, expected.rests_ns)
        for name, judge in (expected.judges or {}).items():
            if problem is None and (text := judge(self)):
                problem = Problem(name, "", text)
        for action in expected.actions:
            if problem is None:
                problem = self._failed(action)
        if problem is None:  # what it sends by itself may be wrong
            self.tester.pass_time(LISTEN_NS)
        return problem

    def _unrested(self, fresh: FreshDevice, rests_ns: int) -> Problem | None:
        for (message, field), value in fresh.rest.items():
            now = self.tester.rest.get((message, field))
            if now != value:
                seconds = rests_ns / 1e9
                return Problem(
                    "not at rest",
                    f"{message}.{field}",
                    f"{message}: {field} is {now}, not {value}, when nothing was sent for {seconds:g} s",
                )
        return None

    def _failed(self, action: str) -> Problem | None:
        """The action of the driver that must succeed."""
        rig = self._rig()
        device = rig.devices[self.config.name]
        self.tester.ear.listens = False
        rig.open()
        try:
            self.clock.advance(100_000_000)
            started = getattr(device, action)()
            if isinstance(started, Awaited):
                started.wait(ACTION_S)
        except AcesError as error:
            return Problem("does not follow", action, f"{action} fails: {error}")
        finally:
            _close(rig)
            self.tester.ear.listens = True
        return None


def _close(rig: Rig) -> None:
    """Take a driver off its bus, and stop nothing."""
    for host in rig.hosts.values():
        host.close()


def _raised(error: Exception) -> Problem:
    """What a twin raised, and where in its own code."""
    frames = traceback.extract_tb(error.__traceback__)
    inner = [frame for frame in frames if "/aces_bus/" not in frame.filename.replace("\\", "/")]
    last = (inner or frames)[-1]
    place = f"{last.filename.replace(chr(92), '/').rpartition('/')[2]}:{last.lineno}"
    return Problem(
        "raises", f"{type(error).__name__} in {last.name}", f"{place}: {type(error).__name__}: {error}"
    )


__all__ = [
    "DeviceTester",
    "Expectations",
    "FreshDevice",
    "Judge",
    "Problem",
    "SentStep",
    "Tap",
    "TapEnd",
    "TwinTrial",
    "enumerations",
    "judged_alive",
    "measured",
    "missed",
]
