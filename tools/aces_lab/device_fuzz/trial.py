"""A device under test: how it was when it was fresh, and whether it still is; a fresh twin in virtual time.

1. What counts as broken is measured against the device itself when it was fresh: which polls it answers, how often.
2. A device that does not answer is asked again, after it had the time to start anew.

A `TwinTrial` is a fresh twin in virtual time: as many as one likes, each the same.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from aces_bus.device import Device, Driver, Robot, Twin, load_driver
from aces_bus.device.ticket import Awaited
from aces_bus.errors import AcesError
from aces_bus.hardware.ports import port_of
from aces_bus.hardware.simulated.serial_line import SimulatedSerialLine
from aces_bus.robot import connect
from aces_bus.robot.buses import wire_of
from aces_bus.robot.rig import Rig, simulate, spoken_on
from aces_bus.runtime import VirtualClock
from aces_bus.tracebacks import innermost_line

from .tester import DeviceTester, Problem, SentStep, Tap

#: How long a fresh device is listened to before anything is sent, so that it is known what it sends by itself (ns).
LISTEN_NS = 300_000_000
#: A device that does not answer is asked again after these pauses (ns): it may have been reset.
PATIENCE_NS = (20_000_000, 500_000_000, 2_000_000_000)
#: What a device sends by itself and has not sent for so many periods, and so long (ns), has stopped.
PERIODS, STOPPED_NS = 10, 500_000_000
#: How long a driver has to set up a device that does not answer without it (ns), and an action may take (s).
START_NS, ACTION_S = 1_000_000_000, 30.0
#: Enumerations and flags of a device at rest, by message and field.
Rest = Mapping[tuple[str, str], Any]


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
    received = tester.counts - before
    periods = {name: LISTEN_NS // count for name, count in received.items() if count >= 3}
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

    `is_late`: answers to what was asked before may still come, so that two are not a fault. The device is quiet otherwise
    (`DeviceTester.settle`).
    """
    for number, usual in fresh.answers.items():
        step, count = tester.ask(number)
        poll = tester.polls[number]
        is_twice = usual and count > usual and not is_late
        if is_twice and tester.unasked.isdisjoint(
            poll.replies
        ):  # is it that it has begun to send this by itself?
            tester.pass_time(LISTEN_NS)
            step = replace(step, pause_ns=step.pause_ns + LISTEN_NS)
        note(step)
        if not count:
            return number
        if is_twice and tester.unasked.isdisjoint(poll.replies):
            tester.problems.append(
                Problem("twice", poll.message, f"{poll.message} was answered {count} times, not {usual}")
            )
    return None


#: What has happened where frames of two senders destroy each other.
COLLIDED = "frames met ones of the device with the same identifier, again and again, until an end was bus-off"


def judged_alive(tester: DeviceTester, fresh: FreshDevice) -> Problem | None:
    """Return whether a device still does what it did when it was fresh; it is given the time to start anew."""
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
            if tester.was_off:
                return Problem("bus-off", "", COLLIDED)
            return Problem("silent", name, f"{name} is not answered: asked {tries} times in {seconds:.1f} s")
    elif fresh.periods:
        now = tester.clock.now()
        tester.pass_time(max(PERIODS * max(fresh.periods.values()), STOPPED_NS))
        for name in fresh.periods:
            if tester.last_at.get(name, 0) < now:
                return Problem("silent", name, f"{name}, which it sends by itself, does not come any more")
    return tester.problems[0] if tester.problems else None


def _forget(step: SentStep) -> None:
    """Do nothing: the step does not belong to the sequence."""


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
        if isinstance(wire, SimulatedSerialLine):
            self.tester.line_free_at = lambda: wire.free_at
        self._simulation.open()
        if needs_start:
            rig.open()
            self.clock.advance(START_NS)
            rig.close()
        self.tester.open()
        self._credentials = dict(self.twin.credentials)

    def _rig(self) -> Rig:
        return connect(self.robot, {self.config.bus: self.tap.end()}, load=self._load)

    @property
    def sent(self) -> list[tuple[int, Any]]:
        """Frames or bytes that the twin has sent, each with its instant (ns)."""
        return self.tap.sent

    @property
    def has_another_number(self) -> bool:
        """True if the twin was given other credentials or switched off; it is then right not to answer to the
        old ones.
        """
        return self.twin.credentials != self._credentials or not self.twin.is_powered

    def guarded(self, action: Callable[[], object]) -> Problem | None:
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
        """Return what is wrong with it now; some time passes."""
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
        """Return the action of the driver that must succeed."""
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
            rig.close()
            self.tester.ear.listens = True
        return None


def _raised(error: Exception) -> Problem:
    """Return what a twin raised, and where in its own code."""
    own = innermost_line(error, lambda file: "aces_bus" not in Path(file).parts)
    last = own or innermost_line(error, bool)
    assert last is not None
    place = f"{Path(last.filename).name}:{last.lineno}"
    return Problem(
        "raises", f"{type(error).__name__} in {last.name}", f"{place}: {type(error).__name__}: {error}"
    )


__all__ = ["Expectations", "FreshDevice", "Judge", "TwinTrial", "judged_alive", "measured", "missed"]
