"""A robot put together: a host for each of its buses with the devices on it, or twins in their place.

1. Which driver, credentials, dialect and units: all from the robot's file. Nothing here knows a vendor or a bus's kind.
2. Inactive devices are not made.
3. One resolver of names, `Rig.whole`: a joint's name alone ("RHY", or an alias) is its main quantity, which is what its
   set-points are. The rest is `RHY.velocity`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache, partial
from typing import TypeVar

from ..controller.door import Door
from ..controller.following import following_of
from ..controller.limiter import bounds_of
from ..controller.travel import travel_of
from ..device.coalesce import CoalescingRule
from ..device.config import DeviceConfig, Joint, Robot, Sensor, priority_of
from ..device.device import Device
from ..device.drivers import Driver, load_driver
from ..device.events import DeviceEvent, EventLog
from ..device.host import BUDGET, Host
from ..device.physics import MovedBody, Physics
from ..device.port import Port
from ..device.signals import Signal
from ..device.stopping import stop_devices, wait_stopped
from ..device.ticket import Awaited, Job, Steps, together
from ..device.twin import Twin, Twins, World
from ..errors import CallerError, DeviceError, NotStoppedError, UnknownNameError
from ..hardware.bell import StopRequest
from ..hardware.lock import program_name
from ..protocol import Protocol, Variant
from ..protocol.files import load_protocol
from ..runtime.clock import EventClock
from .estop import EnableChain
from .exits import is_ended, stop_at_exit

T = TypeVar("T")
Loader = Callable[[str], Driver]
#: Actions that wait for the enable chain.
CHAINED = ("enable", "home")
#: How long a body from outside may wait to be caught up (ns): it falls also where nobody asks.
BODY_NS = 10_000_000
#: What a joint's name alone means, by the joint's `command`.
MAIN = {"position": "position", "speed": "velocity", "current": "current", "duty": "duty"}


@dataclass
class Rig:
    """A robot's hosts and devices. A context manager: it opens its buses, and closes them with all stopped that it drove.

    A rig that gave no set-points and enabled nothing stops nothing: it may only have looked on. The end raises
    `NotStoppedError` where a device did not stop, unless something else was raised before.
    """

    robot: Robot
    clock: EventClock
    hosts: dict[str, Host]
    events: EventLog
    devices: dict[str, Device] = field(default_factory=dict[str, Device])
    signals: dict[str, Signal] = field(default_factory=dict[str, Signal])
    aliases: dict[str, str] = field(default_factory=dict[str, str])
    #: Where all set-points leave; `connect` makes it.
    door: Door = field(init=False, repr=False)
    #: What stands between a program and motion; `connect` makes it.
    chain: EnableChain = field(init=False, repr=False)
    _whole: dict[str, str] = field(default_factory=dict[str, str], repr=False)
    #: The program that asked for a stop of all that is driven; "": none, or its stop was released.
    stopped_by: str = field(default="", init=False)

    def whole(self, name: str) -> str:
        """Return the full name of a signal: "RHY" or an alias of it is "RHY.position". Raises `UnknownNameError`."""
        found = self._whole.get(name)
        if found is None:
            owner, _, rest = name.partition(".")
            owner = self.aliases.get(owner, owner)
            if not rest and owner in self.robot.joints:
                rest = MAIN[self.robot.joints[owner].command]
                if f"{owner}.{rest}" not in self.signals:
                    rest = "position"
            found = f"{owner}.{rest}"
            if found not in self.signals:
                raise self._unknown(name, owner)
            self._whole[name] = found
        return found

    def _unknown(self, name: str, owner: str) -> UnknownNameError:
        """Return the error for an unknown name, with the names near it instead of hundreds."""
        near = [whole for whole in self.signals if whole.partition(".")[0] == owner]
        if not near and owner in self.devices:
            near = list(self.devices[owner].signals)
        if near:
            return UnknownNameError(f"signal of {owner}", name, near)
        owners = {whole.partition(".")[0] for whole in self.signals}
        return UnknownNameError(f"joint, sensor or device with signals in {self.robot.name}", owner, owners)

    def __getitem__(self, name: str) -> Signal:
        """Return the signal of this name, see `whole`; raises `UnknownNameError`."""
        return self.signals[self.whole(name)]

    def is_there(self, name: str) -> bool:
        """Return whether a state that the robot's file names is of an active device; raises `UnknownNameError` as
        `whole`.
        """
        owner = name.partition(".")[0]
        whole = self.aliases.get(owner, owner)
        part = self.robot.joints.get(whole) or self.robot.sensors.get(whole)
        if part is not None and (not part.active or part.device not in self.devices):
            return False
        if whole in self.robot.devices and whole not in self.devices:
            return False
        return bool(self.whole(name))

    def refresh_every(self, name: str, period_s: float) -> None:
        """Ask for a signal so often; see `Device.refresh_every`."""
        whole = self.whole(name)
        owner = next(device for device in self.devices.values() if whole in device.signals)
        owner.refresh_every(whole, period_s)

    def device(self, name: str) -> Device:
        """Return the device of this name, or the one that has this joint or sensor; raises `UnknownNameError`."""
        whole = self.aliases.get(name, name)
        part = self.robot.joints.get(whole) or self.robot.sensors.get(whole)
        found = self.devices.get(name) or (None if part is None else self.devices.get(part.device))
        if found is None:
            raise UnknownNameError(f"device of {self.robot.name}", name, self.devices)
        return found

    def by_signal(self, of_joints: Mapping[str, T]) -> dict[str, T]:
        """Return what is known of joints, by the whole names of their main signals; joints that are not connected are
        left out.
        """
        found: dict[str, T] = {}
        for name, of in of_joints.items():
            whole = f"{name}.{MAIN[self.robot.joints[name].command]}"
            if whole in self.signals:
                found[whole] = of
        return found

    def on_event(self, handler: Callable[[DeviceEvent], None]) -> None:
        """Call `handler` at once with everything that happens to a device."""
        self.events.handlers.append(handler)

    def open(self) -> Rig:
        """Open all buses and begin to tick."""
        stop_at_exit(self, partial(self.__exit__, None))
        for host in self.hosts.values():
            host.open()
        return self

    def close(self) -> None:
        """Close all buses, each when what was queued has left. Nothing is stopped: see `stop_motion`."""
        is_ended(self)
        for host in self.hosts.values():
            host.close()

    def stop_motion(self) -> Job:
        """Have every device stop what moves, at once and again until it has (`stopping`).

        On the clock's thread. The job fails with `NotStoppedError`, which names those that have not.
        """
        return stop_devices(self.clock, self.robot.name, self.devices.values())

    def obey_stop(self, bus: str, request: StopRequest) -> None:
        """Stop all that is driven, and take no set-points until `release`: another program asks for it.

        Answers with who has stopped on `bus`; a rig that only listens stops nothing.
        """
        devices = [] if self.hosts[bus].passive else list(self.devices.values())
        if devices:
            self.stopped_by, reason = request.who, f"stopped by {request.who}"
            self.door.trip(reason)
            for trip in self.chain.tripped:
                trip(reason)
        stopping = stop_devices(self.clock, self.robot.name, devices)
        self.events.emit(DeviceEvent("stop asked", self.clock.now(), bus, "", request.who))
        request.answer(is_stopping=True)

        def report(over: Awaited) -> None:
            failed = over.error.devices if isinstance(over.error, NotStoppedError) else {}
            request.answer(
                who=program_name(),
                devices=[
                    {
                        "protocol": device.variant.name,
                        "credentials": device.credentials,
                        "why": failed.get(device.name, ""),
                    }
                    for device in devices
                    if device.host is self.hosts[bus] and device.last_received is not None
                ],
            )

        stopping.then(report)

    def release(self) -> None:
        """Take set-points again after a trip or another program's stop, once the cause has been looked into."""
        self.stopped_by = ""
        self.door.release()

    def each(self, action: str, devices: Iterable[Device] | None = None) -> Job:
        """Call an action ("enable") of these devices (None: all), where they have it; the job is over when all are.

        It fails with all that is missing where the robot's enable chain does not allow an action that moves,
        and after another program's stop, until `release`.
        """
        some = self.devices.values() if devices is None else devices
        able = [device for device in some if action in device.actions]
        missing = self.chain.missing(able, action) if action in CHAINED else []
        if missing:
            return Job(self.clock, f"{self.robot.name} {action}", partial(_refused, action, missing))
        jobs = [getattr(device, action)() for device in able]
        return together(self.clock, f"{self.robot.name} {action}", [job for job in jobs if job is not None])

    def __enter__(self) -> Rig:
        return self.open()

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        try:
            driven = [device for device in self.devices.values() if device.is_driven]
            if driven:
                stopping = self.clock.call(lambda: stop_devices(self.clock, self.robot.name, driven))
                wait_stopped(stopping)
        except DeviceError as error:
            if kind is None:
                raise
            self.events.emit(DeviceEvent("not stopped", self.clock.now(), "", "", str(error)))
        finally:
            self.close()


def _refused(action: str, missing: Iterable[str], job: Job) -> Steps:
    """Yield the step of a job that the enable chain does not allow: it raises `DeviceError`."""
    raise DeviceError(f"{action} is refused: {'; '.join(missing)}")
    yield


def connect(
    robot: Robot,
    ports: Mapping[str, Port],
    *,
    rate_hz: float | None = None,
    budget: float = BUDGET,
    rules: Mapping[str, CoalescingRule] | None = None,
    passive: bool = False,
    load: Loader = load_driver,
) -> Rig:
    """Connect the robot's devices to these ports (bus name → port), which are not opened yet.

    `rate_hz` is the tick of buses whose rate the file does not state (None: no ticks at all); `rules` replace the drivers'
    rules of coalescing; `passive` hosts listen to what others ask, and send nothing. Raises `CallerError` for a bus
    without a port, or a state that cannot be asked for so often, `UnknownNameError` for a driver or protocol that is not
    installed, and for a state that is none.
    """
    events = EventLog()
    hosts = {
        name: Host(
            ports[name],
            variants,
            rate_hz=rate_hz and (robot.buses[name].rate_hz or rate_hz),
            budget=budget,
            rules=rules,
            events=events,
            name=name,
            passive=passive,
        )
        for name, variants in sorted(
            _variants(robot, ports, load).items(), key=lambda item: -priority_of(robot.buses[item[0]])
        )
    }
    if not hosts:
        raise CallerError(f"robot {robot.name} has no active device")
    rig = Rig(robot, next(iter(hosts.values())).clock, hosts, events)
    for config, driver in sorted(_driven(robot, load), key=lambda item: -priority_of(item[0])):
        host = hosts[config.bus]
        device = driver.device(host, config, robot, host.variants[driver.protocol])
        if config.rate_hz is not None:
            device.tick_at(config.rate_hz)
        host.add(device)
        rig.devices[config.name] = device
        rig.signals.update(device.signals)
    parts: list[Joint | Sensor] = [*robot.joints.values(), *robot.sensors.values()]
    for part in parts:
        rig.aliases.update(dict.fromkeys(part.aliases, part.name))
    rig.door = Door(
        rig.clock,
        rig.devices.values(),
        rig.by_signal(bounds_of(robot)),
        rig.by_signal(following_of(robot)),
        rig.whole,
        travel_of(robot),
    )
    rig.door.noted = lambda what, device, detail: rig.events.act(what, device.name, detail)
    rig.chain = EnableChain(rig)
    for name in hosts:
        lock = getattr(ports[name], "lock", None)
        if lock is not None:
            lock.on_stop = partial(rig.obey_stop, name)
    for name, state in robot.states.items():
        if state.period_s is not None and rig.is_there(name):
            rig.refresh_every(name, state.period_s)
    return rig


@dataclass
class Simulation:
    """A robot's twins, by bus, and the world they share. A context manager."""

    robot: Robot
    world: World
    buses: dict[str, Twins]
    _is_moving: bool = field(default=False, init=False, repr=False)

    @property
    def twins(self) -> dict[str, Twin]:
        """All twins, by name."""
        return {name: twin for twins in self.buses.values() for name, twin in twins.members.items()}

    def __getitem__(self, name: str) -> Twin:
        """Return the twin of a device; raises `UnknownNameError`."""
        found = self.twins
        if name not in found:
            raise UnknownNameError(f"twin of {self.robot.name}", name, found)
        return found[name]

    def open(self) -> Simulation:
        """Put the twins on their buses."""
        for twins in self.buses.values():
            twins.open()
        if self.world.body is not None and not self._is_moving:
            self._is_moving = True
            self.world.clock.call_in(BODY_NS, self._move)
        return self

    def _move(self) -> None:
        """Catch the body up, again and again until the twins are closed."""
        clock, body = self.world.clock, self.world.body
        if self._is_moving and body is not None:
            body.advance(clock.now())
            clock.call_in(BODY_NS, self._move)

    def close(self) -> None:
        """Take the twins off their buses."""
        self._is_moving = False
        for twins in self.buses.values():
            twins.close()

    def __enter__(self) -> Simulation:
        return self.open()

    def __exit__(self, *_: object) -> None:
        self.close()


def simulate(
    robot: Robot,
    ports: Mapping[str, Port],
    *,
    seed: int = 0,
    pose: Mapping[str, float] | None = None,
    homed: bool = True,
    physics: Physics | None = None,
    load: Loader = load_driver,
) -> Simulation:
    """Return the robot's twins, on these ports (bus name → port), not open yet; `homed` False: as after power-up.

    `pose` is where joints are at first (name or alias → rad, or m); the others are where their twins begin, or where
    `physics` has them: the body that the twins' motors then move. Raises as `connect`, and `CallerError` for a joint that
    cannot be there.
    """
    wanted = {robot.joint(name).name: angle for name, angle in (pose or {}).items()}
    buses = {name: Twins(ports[name], variants) for name, variants in _variants(robot, ports, load).items()}
    if not buses:
        raise CallerError(f"robot {robot.name} has no active device")
    clock = next(iter(buses.values())).clock
    body = None if physics is None else MovedBody(physics, clock.now())
    world = World(clock, seed, pose=wanted, homed=homed, body=body)
    for config, driver in _driven(robot, load):
        twins = buses[config.bus]
        twins.add(driver.twin(twins, config, robot, twins.variants[driver.protocol], world))
    for name, angle in wanted.items():
        model = world.joints.get(name)
        begins = None if model is None else model.position(world.clock.now())
        if begins is None or not abs(begins - angle) < 1e-6:
            where = "it has none here" if begins is None else f"it begins at {begins:.6g}"
            raise CallerError(f"{name}: its twin cannot begin at {angle:.6g}: {where}")
    return Simulation(robot, world, buses)


# ---------------------------------------------------------------------- what speaks what


def _active(robot: Robot) -> list[DeviceConfig]:
    return [config for config in robot.devices.values() if config.active]


def _driven(robot: Robot, load: Loader) -> Iterator[tuple[DeviceConfig, Driver]]:
    """Return the active devices with their drivers, each loaded once."""
    load = cache(load)
    return ((config, load(config.driver)) for config in _active(robot))


def spoken_on(robot: Robot, load: Loader = load_driver) -> dict[str, Protocol]:
    """Return the main protocol of each bus that has active devices: that of the file, or that of its first device's
    driver.
    """
    found: dict[str, Protocol] = {}
    for config, protocol in _spoken(robot, load):
        if config.bus not in found or protocol.name == robot.buses[config.bus].protocol:
            found[config.bus] = protocol
    return found


def _spoken(robot: Robot, load: Loader) -> Iterator[tuple[DeviceConfig, Protocol]]:
    """Yield the active devices, each with what it speaks; what is installed is looked up once a driver."""
    known: dict[tuple[str, str], Protocol] = {}
    for config in _active(robot):
        key = (config.driver, robot.protocol_of(config)[0])
        if key not in known:
            known[key] = _protocol_of(robot, config, load)
        yield config, known[key]


def _protocol_of(robot: Robot, config: DeviceConfig, load: Loader) -> Protocol:
    """Return what a device speaks: its driver's protocol, which may not be installed, or the installed one."""
    name, _ = robot.protocol_of(config)
    driver = load(config.driver)
    if driver.protocol != name:
        raise CallerError(
            f"robot {robot.name}: {config.name} speaks {name}, its driver {driver.name} speaks {driver.protocol}"
        )
    own = driver.spoken
    protocol = load_protocol(own) if isinstance(own, str) else own
    bus = robot.buses[config.bus]
    if protocol.link != bus.link:
        raise CallerError(
            f"robot {robot.name}: {config.name} speaks {protocol.name}, which is for link {protocol.link}; its bus"
            f" {bus.name} has link {bus.link}"
        )
    return protocol


def bus_variants(robot: Robot, bus: str) -> list[Variant]:
    """Return the installed protocols of a bus, with the robot's dialect and tables; also where it has no devices."""
    found: dict[str, Variant] = {}
    spoken = [(robot.buses[bus].protocol, robot.buses[bus].dialect)]
    spoken += [robot.protocol_of(config) for config in robot.devices_on(bus)]
    for name, dialect in spoken:
        protocol = load_protocol(name)
        tables = robot.tables(protocol) if robot.devices else None
        found.setdefault(name, protocol.variant(dialect, tables or None))
    return list(found.values())


def _variants(robot: Robot, ports: Mapping[str, Port], load: Loader) -> dict[str, list[Variant]]:
    """Return the protocols of each bus that has active devices, with the robot's own tables."""
    found: dict[str, dict[str, Variant]] = {}
    made: dict[tuple[str, str | None], Variant] = {}
    for config, protocol in _spoken(robot, load):
        if config.bus not in ports:
            raise CallerError(
                f"robot {robot.name}: no port for bus {config.bus} (there are: {', '.join(ports) or 'none'})"
            )
        name, dialect = spoken = robot.protocol_of(config)
        if spoken not in made:
            made[spoken] = protocol.variant(dialect, robot.tables(protocol) or None)
        variant = made[spoken]
        other = found.setdefault(config.bus, {}).setdefault(name, variant)
        if other is not variant:
            raise CallerError(
                f"robot {robot.name}: bus {config.bus} has {name} in two dialects, {other.dialect} and {dialect};"
                " a bus has one"
            )
    return {bus: list(variants.values()) for bus, variants in found.items()}
