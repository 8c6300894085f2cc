"""A real device under test: slowly, only what is allowed, and stopped at the end.

1. Without `allow_motion`, or messages that were named, only what asks is sent: the messages of the driver's polls. A packet
   goes out when nothing that a sloppy receiver may take it for is another message (`SendRules.strictly`).
2. It carries this device's credentials, never another's; messages to everybody are none of it.
3. The search ends with the first fault: a real device cannot be made fresh. What was sent since it last answered is kept.
4. `stop` sends the driver's stop and has it confirmed, whatever happened before.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any

from aces_bus.device import Device, Driver, Robot, load_driver
from aces_bus.device.config import alone
from aces_bus.device.port import Port
from aces_bus.device.stopping import stop_devices, wait_stopped
from aces_bus.errors import CallerError, DeviceError
from aces_bus.robot import connect
from aces_bus.robot.rig import Rig
from aces_bus.testing.source import Dice

from .fuzzer import BETWEEN, DeviceFinding, rules_of
from .packets import DevicePackets, SendRules
from .tester import DeviceTester, Problem, SentStep, Tap, enumerations
from .trial import FreshDevice, judged_alive, measured, missed

#: Packets a second, where the caller says nothing.
RATE = 50.0
#: How long the driver has to set the device up (ns), and how often it is waited for so long until something comes.
SET_UP_NS, SET_UP_TRIES = 1_000_000_000, 10


def asking_rules(device: Device) -> tuple[frozenset[str], dict[str, dict[str, Collection[Any]]]]:
    """Return the messages that only ask a device, and the values of their enumerations.

    They are those of its driver's polls which are not set-points. What their enumerations name may be another command:
    it is what the polls have it be.
    """
    names = {poll.message for poll in device.polls} - device.commanding
    fixed: dict[str, dict[str, Collection[Any]]] = {}
    for poll in device.polls:
        if poll.message not in names:
            continue
        for field in enumerations(device.variant[poll.message]):
            values = fixed.setdefault(poll.message, {}).setdefault(field, [])
            assert isinstance(values, list)
            values.append(poll.fields.get(field))
    return frozenset(names), fixed


class LiveDeviceFuzzer:
    """The search for a fault of one real device, on a bus that this program drives.

    `ports` are those of `open_gates(alone(robot, name), …)`, which take the bus's lock. `only` are messages that may be sent
    besides none but what asks; `allow_motion`: all of this device. `rate_hz`: packets a second.

    Raises `UnknownNameError` as `DeviceFuzzer`, `CallerError` where nothing may be sent.
    """

    def __init__(
        self,
        robot: Robot,
        name: str,
        ports: Mapping[str, Port],
        *,
        seed: int = 0,
        only: Collection[str] = (),
        leave_out: Sequence[str] = (),
        allow_motion: bool = False,
        rate_hz: float = RATE,
        load: Callable[[str], Driver] = load_driver,
    ) -> None:
        self.robot, self.name, self.seed = robot, name, seed
        config = robot.devices[name]
        bus = config.bus
        self.tap = Tap(ports[bus])
        self.rig: Rig = connect(alone(robot, name), {bus: self.tap.end()}, load=load)
        self.device: Device = self.rig.devices[name]
        variant = self.device.variant
        asking, fixed = asking_rules(self.device)
        allowed = only or (() if allow_motion else asking)
        self.rules: SendRules = rules_of(
            variant,
            config.credentials,
            only=allowed,
            leave_out=leave_out,
            strictly=True,
            fixed={} if only or allow_motion else fixed,
        )
        if not self.rules.messages or not (allowed or allow_motion):
            raise CallerError(
                f"{name}: its driver asks by no message of its own, so that nothing may be sent:"
                " name messages (--only MESSAGE), or --allow-motion"
            )
        #: Messages to the device that are not sent.
        self.left_out = sorted(
            {m.name for m in variant.messages_for("to device")} - {m.name for m in self.rules.messages}
        )
        self.packets = DevicePackets(self.rules)
        others = [c.credentials for n, c in robot.devices.items() if n != name and c.bus == bus]
        self.tester = DeviceTester(self.tap.end(), variant, config, robot, self.device.polls, others)
        self.clock = self.tester.clock
        self._pause_ns = round(1e9 / rate_hz)
        self.sent = 0
        self._fresh: FreshDevice | None = None

    def open(self) -> None:
        """Open the bus, have the driver set the device up, and see how it answers.

        Raises `DeviceError` for a device that neither answers nor sends anything.
        """
        self.clock.call(self.tester.open)
        for host in self.rig.hosts.values():
            host.open()
        fresh = self._after_set_up()
        for _ in range(SET_UP_TRIES):
            if not fresh.answers and not fresh.periods:
                fresh = self._after_set_up()
        if not fresh.answers and not fresh.periods:
            raise DeviceError(
                f"{self.name} neither answers its polls nor sends anything: nothing was sent to it"
            )
        self.tester.ignored = {problem.key for problem in fresh.problems}
        self.tester.problems.clear()

    def _after_set_up(self) -> FreshDevice:
        self.tester.pass_time(SET_UP_NS)
        self._fresh = measured(self.tester)
        return self._fresh

    def run(self, packets: int, progress: Callable[[], bool] | None = None) -> DeviceFinding | None:
        """Send so many packets, or until something is wrong: what was found."""
        fresh = self._fresh
        if fresh is None:
            raise CallerError(f"{self.name}: open() comes first")
        source = Dice(f"{self.seed} live")
        steps: list[SentStep] = []
        began, until = len(self.tap.sent), source.integer(*BETWEEN)
        for _ in range(packets):
            if progress is not None and not progress():
                break
            how, packet = self.packets.draw(source)
            steps.append(self.tester.give(packet, self._pause_ns, how))
            self.sent += 1
            until -= 1
            if self.tester.problems or until <= 0:
                until = source.integer(*BETWEEN)
                problem = self._judged(fresh)
                if problem is not None:
                    return self._found(problem, steps, began)
                steps, began = [], len(self.tap.sent)
        problem = self._judged(fresh)
        return None if problem is None else self._found(problem, steps, began)

    def _judged(self, fresh: FreshDevice) -> Problem | None:
        if self.tester.problems:
            return self.tester.problems[0]
        self.tester.settle()
        if missed(self.tester, fresh, lambda step: None) is None and not self.tester.problems:
            return None
        return judged_alive(self.tester, fresh)

    def _found(self, problem: Problem, steps: Sequence[SentStep], began: int) -> DeviceFinding:
        sent = self.tap.sent[began:]
        first = sent[0][0] if sent else 0
        config = self.robot.devices[self.name]
        return DeviceFinding(
            problem,
            self.name,
            config.driver,
            config.bus,
            self.tester.variant,
            self.seed,
            0,
            self.sent,
            tuple(steps),
            tuple(((instant - first) / 1e9, packet) for instant, packet in sent),
        )

    def stop(self) -> None:
        """Stop the device and have it confirmed. Raises `NotStoppedError`."""
        self.device.is_driven = True
        wait_stopped(self.clock.call(lambda: stop_devices(self.clock, self.name, [self.device])))

    def close(self) -> None:
        """Leave the bus."""
        self.tester.close()
        for host in self.rig.hosts.values():
            host.close()
        self.tap.port.close()


__all__ = ["RATE", "LiveDeviceFuzzer", "asking_rules"]
