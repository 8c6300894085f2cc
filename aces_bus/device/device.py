"""A device: one node on a bus, as its driver knows it.

1. Down: messages get the device's credentials. Up: only its own records arrive.
2. SI outside, the sheet's units inside: conversions are where a signal is declared, nowhere else.
3. A driver waits for nothing: it asks, and goes on when the answer is there (`ask`, `job`).

A driver is a subclass. The usual one declares what it polls and what its messages' fields mean:

    class Fan(Device):
        protocol = "fan"
        polls = (Poll("AskState", reply="State"),)
        provides = (
            signal("speed", unit="rad/s", of="State.speed", set="SetSpeed.speed", scale=tau / 60),
            signal("temperature", unit="K", of="State.temperature", offset=273.15),
        )

and overrides `setup`, `received`, `check` or adds methods where that is not enough.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar

from ..compiling import mypyc_attr
from ..errors import CallerError, DeviceError, UnknownNameError
from ..protocol import Protocol, Record, Variant
from ..protocol.record import FieldValue
from ..runtime.clock import Timer
from ..runtime.loop import call_there
from .coalesce import CoalescingRule, Setpoint
from .config import DeviceConfig, Robot
from .declared import Poll, SignalSpec, field_reader, same, slot_of
from .host_loss import HostLoss, Outcome
from .signals import Signal
from .station import EndpointMember, refuse_shadowing
from .ticket import Awaited, Job, Steps, Ticket

if TYPE_CHECKING:
    from .events import Kind
    from .host import Host


def _free(action: str) -> str:
    """Return "": no action is refused."""
    return ""


def _refused(error: DeviceError, job: Job) -> Steps:
    """Yield the step of a job that may not begin: it raises `error`."""
    raise error
    yield


#: Methods of `Device` that may be actions, too.
ACTIONS = frozenset({"stop_motion"})


@mypyc_attr(allow_interpreted_subclasses=True)
class Device(EndpointMember):
    """One node. Class attributes are the driver's declaration.

    `actions` names the methods that programs and the command line may call: name → what it does; those in `asking` only
    ask, and change nothing, so that the command line does not want `--tx` for them. `streams` are messages
    of set-points that are repeated in each tick, once given; others are sent when set. `stream_replies`: set-points that are
    answered, with their answer and how long it may take (s): on a line where one speaks at a time nothing is sent before it.
    `silent_after` is how many polls in a row may miss before the device counts as silent. `one_at_a_time`: it takes
    one request at a time, so that on its bus nothing is asked while an answer is due, but for stops.
    """

    #: What it speaks: the name of an installed protocol, or a protocol itself.
    protocol: ClassVar[str | Protocol]
    provides: ClassVar[Sequence[SignalSpec]] = ()
    polls: Sequence[Poll] = ()
    rules: ClassVar[Mapping[str, CoalescingRule]] = {}
    streams: ClassVar[Collection[str]] = ()
    stream_replies: ClassVar[Mapping[str, tuple[str, float]]] = {}
    actions: ClassVar[Mapping[str, str]] = {}
    asking: ClassVar[Collection[str]] = ()
    silent_after: ClassVar[int] = 3
    one_at_a_time: ClassVar[bool] = False
    #: What such a device does by itself when its host is gone.
    when_host_is_lost: ClassVar[HostLoss] = HostLoss("unknown", "its driver does not say")
    stale_s: ClassVar[float] = 0.1
    attributes: ClassVar = EndpointMember.attributes | {
        *("host", "signals", "readable", "last_received", "is_silent", "is_driven", "misses"),
        *("missing_since", "missed_at", "awaiting", "answered", "timed_out", "second_answers"),
        *("epoch", "duplicates", "takes_set_points", "is_double", "interlock"),
    }

    def __init_subclass__(cls) -> None:
        above: Any = super(Device, cls)  # noqa: UP008  # mypyc 2.4 takes `cls` for an instance in `super().…`
        above.__init_subclass__()
        if "signals" in vars(cls):
            raise TypeError(f"{cls.__name__}: signals are declared as `provides = (signal(…), …)`")
        for name in cls.actions:
            if name in vars(cls) and name in vars(Device) and name not in ACTIONS:
                refuse_shadowing(cls, name, "an action")

    def __init__(self, host: Host, config: DeviceConfig, robot: Robot, variant: Variant) -> None:
        super().__init__(host.clock, config, robot, variant)
        self.host = host
        self.signals: dict[str, Signal] = {}
        #: The names of those that are read from messages.
        self.readable: set[str] = set()
        #: When something was last received of it (ns).
        self.last_received: int | None = None
        self.is_silent = False
        #: Whether it was given set-points or commands to move since it was last stopped.
        self.is_driven = False
        #: Whether it follows set-points; a driver whose device has to be enabled first says no until it is.
        self.takes_set_points = True
        #: How often its set-points were dropped: the door then leads a joint anew, from where it is.
        self.epoch = 0
        self.misses = 0
        self.missing_since = self.missed_at = 0
        #: When second answers to one request came lately (ns); the host's.
        self.duplicates: list[int] = []
        #: Whether two devices were seen to answer as it (`report_double`): one may answer for both.
        self.is_double = False
        #: Tickets that wait for an answer, oldest first; the host's.
        self.awaiting: list[Ticket] = []
        #: When each kind of answer was last had.
        self.answered: dict[str, int] = {}
        #: How many answers of each kind are missing, and may still come late.
        self.timed_out: dict[str, int] = {}
        #: How many second answers of each kind are under way, as a poll was sent again before its answer came.
        self.second_answers: dict[str, int] = {}
        self._updates: dict[str, list[tuple[Callable[[Any], Any], Signal]]] = {}
        self._given: dict[str, dict[str, Any]] = {}
        self._paths: dict[str, dict[str, None]] = {}
        self._slots: dict[str, list[tuple[str, str, int | None]]] = {}
        #: The messages that give each signal; the periods (s) that were asked for, by request.
        self._sources: dict[str, AbstractSet[str]] = {}
        self._periods: dict[tuple[str, ...], float] = {}
        #: With a rate of its own: its period, and when it is due (ns).
        self._every = self._due = 0
        #: Signals without a stated stale age, and the messages that give them.
        self._usual_age: list[tuple[Signal, AbstractSet[str]]] = []
        self._dirty: set[str] = set()
        self._held: dict[str, int] = {}
        self._led: list[Job] = []
        #: Says why a job that enables or moves it may not begin now; "" where it may. A robot's e-stop sets it.
        self.interlock: Callable[[str], str] = _free
        #: What is waited for: looked at whenever it has said something.
        self._until_so: list[tuple[Callable[[], bool], Awaited, Timer]] = []
        for spec in self.provides:
            self._declare(spec)
        self.setup()
        self._age_by_polls()

    # ------------------------------------------------------------------ for drivers to override

    def setup(self) -> None:
        """Declare what depends on this device's configuration: `add_signal`, `self.polls`."""

    def received(self, record: Record, instant: int) -> None:
        """Take a record of this device, after its declared signals were updated."""

    def default_of(self, message: str, path: str) -> Any:
        """Return the value for a set-point that was not given yet; None: wait for it."""
        return None

    def packet_together(self, devices: Sequence[Device], poll: Poll) -> Any:
        """Return the packet that asks these devices what `poll` asks one of them; for drivers whose polls say `together`."""
        raise NotImplementedError(
            f"{type(self).__name__} asks several devices by {poll.together}, and does not say how"
        )

    def start(self) -> Any:
        """Begin what is due when the bus has been opened; return its tickets and jobs. It must not move anything."""
        return None

    def stop_motion(self) -> Any:
        """Stop what moves, now; nothing by default. Returns a ticket or job, or None. It may be called again and again."""
        return None

    def confirm_stopped(self) -> Any:
        """Ask whether `stop_motion` has done its work: a ticket or job that fails when it has not; None: that is not known.

        A driver whose `stop_motion` is over only when the device has said so need not override it.
        """
        return None

    def assume_driven(self) -> None:
        """Take it that another program has set all that this driver can: the next `stop_motion` stops that."""
        self.is_driven = True

    @property
    def stop_leaves(self) -> Outcome:
        """The state in which `stop_motion` leaves its joints."""
        return "unknown"

    @property
    def host_loss(self) -> HostLoss:
        """Its behaviour without its host, as it is set up here: `when_host_is_lost`, unless its settings change that."""
        return type(self).when_host_is_lost

    @property
    def lets_go(self) -> str:
        """Why its joints would not stay where they are after this program has ended; "" where they stay."""
        loss = self.host_loss
        stays = loss.does == "holds" or (
            loss.does == "goes on" and all(joint.command == "position" for joint in self.joints)
        )
        return "" if stays else str(loss)

    @property
    def fed_within_s(self) -> float | None:
        """Seconds within which it has to be sent something, for it stops by itself otherwise; None: however little."""
        return None

    @property
    def sends_every_s(self) -> float | None:
        """Period (s) at which the device sends unasked: it is silent after `silent_after` periods; None: only
        when asked.
        """
        return None

    def malformed(self, reason: str, instant: int) -> None:
        """Note a malformed frame or packet that is probably from this device."""

    def renumbered(self) -> None:
        """Drop the frames that were encoded for its credentials of before (`Host.renumber`)."""

    def no_reply(self, ticket: Ticket) -> None:
        """Note a request that was not answered."""

    def takes(self, signal: Signal) -> bool | None:
        """Return whether a set-point of this signal would leave now; False: it is refused; None: it waits for a
        hold-off to end.
        """
        if not self.takes_set_points:
            return False
        return None if self._held and self.is_held else True

    def is_followed(self, signal: Signal) -> bool:
        """Return whether the joint is meant to be where this signal is set to: not while it is off, or gives way on
        purpose.
        """
        return self.is_driven and self.takes(signal) is True

    # ------------------------------------------------------------------ signals

    def _declare(self, spec: SignalSpec) -> None:
        scale, offset = spec.scale, spec.offset
        plain = scale == 1 and offset == 0
        self.add_signal(
            spec.name,
            unit=spec.unit,
            of=spec.of,
            set=spec.set,
            to_si=same if plain else lambda value: value * scale + offset,
            from_si=same if plain else lambda value: (value - offset) / scale,
            lower=spec.lower,
            upper=spec.upper,
            stale_s=spec.stale_s,
            doc=spec.doc,
            source=spec.source,
        )

    def add_signal(
        self,
        name: str,
        *,
        unit: str = "",
        of: str | Sequence[str] | None = None,
        set: str | None = None,
        setter: Callable[[FieldValue], None] | None = None,
        to_si: Callable[[Any], Any] = same,
        from_si: Callable[[Any], Any] = same,
        lower: float | None = None,
        upper: float | None = None,
        stale_s: float | None = None,
        owner: str | None = None,
        read_from: Collection[str] = (),
        doc: str = "",
        source: str = "",
    ) -> Signal:
        """Add a signal, `OWNER.name`; the owner is a joint's or sensor's name, by default the device's.

        `of` are the fields that give it ("Encoder.position.1"), `set` is the field that sets it, or `setter` a function;
        `to_si` and `from_si` convert. `read_from`: the messages from which the driver itself updates it. Values that are set
        beyond `lower` or `upper` are limited, and that is reported.
        """
        whole = f"{owner or self.name}.{name}"
        if whole in self.signals:
            raise CallerError(f"{self.name}: there is a signal {whole} already")
        if set is not None:
            message, path = set.partition(".")[0], set.partition(".")[2]
            self.variant[message]  # raises for a message that does not exist
            if message not in self.rules and not self._overrides_completed:
                self._field(set)  # else what a path means is the driver's affair
            self._paths.setdefault(message, {})[path] = None

            def give(value: FieldValue, message: str = message, path: str = path) -> None:
                self.want(message, path, from_si(value))

            setter = give
        age = stale_s if stale_s is not None else self.stale_s
        made = Signal(
            whole,
            self.clock,
            unit=unit,
            stale_after_ns=round(age * 1e9),
            setter=setter,
            lower=lower,
            upper=upper,
            doc=doc,
            source=source,
        )
        if setter is not None:
            made.limit = self._limited
        sources = (of,) if isinstance(of, str) else of or ()
        messages = {*read_from, *(field.partition(".")[0] for field in sources)}
        if messages:
            self.readable.add(whole)
            self._sources[whole] = messages
        made.request = lambda: self.refresh(whole)
        if stale_s is None:
            self._usual_age.append((made, messages))
        for field in sources:
            message, path = self._field(field)
            self._updates.setdefault(message, []).append((field_reader(path, to_si), made))
        self.signals[whole] = made
        return made

    @property
    def commanding(self) -> frozenset[str]:
        """The messages of its set-points."""
        return frozenset((*self._paths, *self.streams))

    @property
    def _overrides_completed(self) -> bool:
        return type(self).completed is not Device.completed

    def _field(self, path: str) -> tuple[str, str]:
        """Split `Message.field.1` into message and path; raise `UnknownNameError` for an unknown field."""
        message, _, rest = path.partition(".")
        fields = self.variant[message].fields
        name = rest.partition(".")[0]
        if name not in fields:
            raise UnknownNameError(f"field of {self.variant.name}'s {message}", name, fields)
        return message, rest

    def _age_by_polls(self) -> None:
        """Make signals without a stated age stale after five polls."""
        tick = 1 / self.host.rate_hz if self.host.rate_hz else 0.0
        for made, messages in self._usual_age:
            periods = [p.every_s or tick for p in self.all_polls if not messages.isdisjoint(p.replies)]
            if periods:
                made.stale_after_ns = round(max(self.stale_s, 5 * min(periods)) * 1e9)

    def names_of(self, signal: Signal) -> list[str]:
        """Return the names that a signal may read, of values and flags of its messages; none where it has no such names."""
        messages = [name for name, reads in self._updates.items() if any(read is signal for _, read in reads)]
        fields = [field for name in messages for field in self.variant[name].plan.fields]
        return [name for field in fields for name in field.node.known_names or ()]

    def polls_of(self, name: str) -> list[Poll]:
        """Return the polls whose answers give the signal of this whole name; none where it comes by itself."""
        messages = self._sources.get(name, frozenset[str]())
        return [poll for poll in self.all_polls if not messages.isdisjoint(poll.replies)]

    @property
    def all_polls(self) -> Sequence[Poll]:
        """Its polls, by their name: a subclass may have them in its body, where compiled code does not look."""
        device: Any = self
        polls: Sequence[Poll] = device.polls
        return polls

    def refresh(self, name: str) -> None:
        """Ask for a signal with the next tick, from any thread; nothing where it comes by itself."""
        self.clock.call_soon(lambda: self.host.refresh(self, self.polls_of(name)))

    def refresh_every(self, name: str, period_s: float) -> None:
        """Ask for a signal every `period_s`, and for what the same message gives; of several periods the shortest counts.

        Raises `CallerError` where the device is not asked for it, or in ticks that are further apart.
        """
        polls, rate = self.polls_of(name), self.host.rate_hz
        if not polls:
            raise CallerError(
                f"state {name}: a period of {period_s:g} s, but {self.name} is not asked for it"
            )
        if rate is not None and period_s * rate < 0.999:
            raise CallerError(
                f"state {name}: a period of {period_s:g} s, but bus {self.host.name} asks every {1 / rate:g} s"
                f" (rate_hz = {rate:g})"
            )
        for poll in polls:
            key = poll.message, *sorted(map(repr, poll.fields.items()))
            self._periods[key] = every = min(period_s, self._periods.get(key, period_s))
            self._retime(poll, every)

    def tick_at(self, rate_hz: float) -> None:
        """Ask for what is asked in each tick, and send set-points, so often instead."""
        self._every = round(1e9 / rate_hz)
        for poll in self.all_polls:
            if poll.every_s is None:
                self._retime(poll, 1 / rate_hz)

    def _retime(self, poll: Poll, every_s: float) -> None:
        """Poll so often; what it gives may be as old as five such periods."""
        slower = replace(poll, every_s=every_s)
        for name, signal in self.signals.items():
            if signal.stale_after_ns is not None and poll in self.polls_of(name):
                signal.stale_after_ns = max(signal.stale_after_ns, round(5e9 * every_s))
        device: Any = self
        device.polls = [slower if known is poll else known for known in self.all_polls]
        self.host.retime(self, poll, slower)

    def __getitem__(self, name: str) -> Signal:
        """Return the signal of this name, with or without its owner where that is clear; raises `UnknownNameError`."""
        found = self.signals.get(name) or self.signals.get(f"{self.name}.{name}")
        if found is None:
            near = [signal for whole, signal in self.signals.items() if whole.partition(".")[2] == name]
            if len(near) != 1:
                raise UnknownNameError(f"signal of {self.name}", name, self.signals)
            found = near[0]
        return found

    def _limited(self, of: Signal, value: Any) -> Any:
        low, high = of.lower, of.upper
        if isinstance(value, float) and not math.isfinite(value):
            raise CallerError(f"{of.name}: {value!r} is not a set-point; give a finite number")
        if low is not None and value < low:
            self.emit_event("limited", f"{of.name}: {value:g} is below {low:g} {of.unit}")
            return low
        if high is not None and value > high:
            self.emit_event("limited", f"{of.name}: {value:g} is above {high:g} {of.unit}")
            return high
        return value

    def forget(self) -> None:
        """Forget all values and set-points: nothing that was known is true any more."""
        for signal in self.signals.values():
            signal.forget()
        self._given.clear()
        self._dirty.clear()
        self.epoch += 1

    def rebooted(self, detail: str) -> None:
        """Note that the device has lost its state."""
        self.forget()
        self.emit_event("rebooted", detail)

    # ------------------------------------------------------------------ up

    def receive(self, record: Record, instant: int) -> None:
        """Take a record of this device: settle the request that it answers, update signals, call `received`."""
        self.last_received = instant
        name = type(record).__name__
        self.host.answered(self, name, record, instant)
        for read, target in self._updates.get(name, ()):
            value = read(record)
            if value is not None:
                target.update(value, instant)
        self.received(record, instant)
        if self._until_so:
            self._look_again()

    def _look_again(self) -> None:
        """Check again for what is waited for (`MotorDevice.until`)."""

    # ------------------------------------------------------------------ down

    def want(self, message: str, path: str, value: Any) -> None:
        """Have a field of a message sent with the next tick, in the sheet's unit; reported where it takes no set-points."""
        if not self.takes_set_points:
            given = f"{value:g}" if isinstance(value, float) else value
            self.emit_event("not sent", f"{self.name} is not enabled: {message}.{path} = {given}")
            return
        self._given.setdefault(message, {})[path] = value
        self._dirty.add(message)
        if not self.host.is_ticked:
            self.host.wake()

    def drop(self, message: str) -> None:
        """Forget the set-points of a message: a stream ends until new ones are given."""
        self._given.pop(message, None)
        self._dirty.discard(message)
        self.epoch += 1

    def hold(self, message: str, duration_s: float) -> None:
        """Send none of a message for a while; set-points given meanwhile are kept."""
        self._held[message] = self.clock.now() + round(duration_s * 1e9)

    @property
    def is_held(self) -> bool:
        """True if set-points are held back for a while."""
        now = self.clock.now()
        return any(until > now for until in self._held.values())

    def due_messages(self, now: int) -> list[str]:
        """Return the messages whose set-points are to be sent in this tick."""
        if not self._given or now < self._due:
            return []
        if self._every:
            self._due = now + self._every - round(0.5e9 / (self.host.rate_hz or 1e9))  # a tick may be early
        out: list[str] = []
        dirty, held = self._dirty, self._held
        for message in self._given:
            if message not in dirty and message not in self.streams:
                continue
            if held:
                if held.get(message, 0) > now:
                    continue
                held.pop(message, None)
            dirty.discard(message)
            out.append(message)
        return out

    def wants(self, now: int) -> list[Setpoint]:
        """Return the same, set-point by set-point, for rules; a driver that overrides it has more than it was given."""
        return [signal for message in self.due_messages(now) for signal in self.setpoints_of(message)]

    def setpoints_of(self, message: str) -> list[Setpoint]:
        """Return all that was given of a message."""
        return [Setpoint(self, message, path, value) for path, value in self._given[message].items()]

    def gathered(self, message: str, wants: Sequence[Setpoint]) -> dict[str, Any] | None:
        """Return the fields of a message from what is wanted, what was given before and defaults; None: something is
        missing.
        """
        given = self._given.get(message, {})
        if wants:
            given = {**given, **{want.path: want.value for want in wants}}
        slots = self._slots.get(message)
        if slots is None:
            slots = self._slots[message] = [slot_of(path) for path in self._paths.get(message) or given]
        fields: dict[str, Any] = {}
        for path, name, index in slots:
            value = given.get(path)
            if value is None:
                value = self.default_of(message, path)
                if value is None:
                    return None
            if index is None:
                fields[name] = value
                continue
            items = fields.get(name)
            if items is None:
                items = fields[name] = []
            if len(items) == index:  # as they are declared, nearly always
                items.append(value)
                continue
            while len(items) <= index:
                items.append(None)
            items[index] = value
        return self.completed(message, fields)

    def waited_for(self) -> list[str]:
        """Return the set-points ("Set.right") that are missing, and without which others that were given do not go out."""
        return [
            f"{message}.{path}"
            for message, given in self._given.items()
            for path in self._paths.get(message, ())
            if given.get(path) is None and self.default_of(message, path) is None
        ]

    def completed(self, message: str, fields: dict[str, Any]) -> dict[str, Any]:
        """Return what else a message of set-points needs: constant fields, the slot of a channel that is not there."""
        return fields

    def ask(
        self,
        message: str,
        *,
        reply: str | tuple[str, ...] = (),
        timeout_s: float = 0.05,
        retries: int = 2,
        confirms: bool = False,
        **fields: Any,
    ) -> Ticket:
        """Send a message and wait for one of `reply`, asking again `retries` times. The record is the ticket's result.

        `confirms`: it asks whether a stop was obeyed, and on a half-duplex line goes with the stops, before all that waits.
        Raises `UnknownNameError` and `FieldError` as encoders do; a missing answer is the ticket's `NoReplyError`.
        """
        return self._requested(message, reply, timeout_s, retries, fields, confirms=confirms)

    def send(self, message: str, **fields: Any) -> Ticket:
        """Send a message that is not answered. The ticket is over when it has left, and fails when it does not."""
        return self.ask(message, **fields)

    def send_now(
        self,
        message: str,
        *,
        reply: str | tuple[str, ...] = (),
        timeout_s: float = 0.05,
        retries: int = 0,
        **fields: Any,
    ) -> Ticket:
        """Send a message as `send`, before all others and instead of what still waits for this device: for stops.

        With `reply` it is over when that has come, and is sent again `retries` times as by `ask`. While the bus is lost it
        waits, and is the first to leave when the bus is back.
        """
        return self._requested(message, reply, timeout_s, retries, fields, urgent=True)

    def _requested(
        self,
        message: str,
        reply: str | tuple[str, ...],
        timeout_s: float,
        retries: int,
        fields: Mapping[str, FieldValue],
        urgent: bool = False,
        confirms: bool = False,
    ) -> Ticket:
        names = frozenset((reply,) if isinstance(reply, str) else reply)
        packet, timeout_ns = self.host.packet(self, message, fields), round(timeout_s * 1e9)
        made = Ticket(
            self.clock, self, message, packet, names, timeout_ns, retries, urgent=urgent, confirms=confirms
        )
        return call_there(self.clock, lambda: self.host.ask(made))

    def job(self, name: str, steps: Callable[[Job], Steps]) -> Job:
        """Begin something that takes several steps; see `Job`."""
        return Job(self.clock, f"{self.name} {name}", steps)

    def lead(self, name: str, steps: Callable[[Job], Steps], *, moves: bool = True) -> Job:
        """Begin a job that a stop must end: one that enables, moves or changes something in several steps.

        It fails at once while the robot's e-stop forbids motion, unless it never `moves` anything.
        """
        why = self.interlock(name) if moves else ""
        refused = DeviceError(f"{self.name}: {name} is refused: {why}")
        made = self.job(name, partial(_refused, refused) if why else steps)
        self.host.events.act(name, self.name, why and f"refused: {why}")
        self._led = [job for job in self._led if not job.is_over] + [made]
        return made

    def end_led(self, name: str = "") -> None:
        """End the jobs of this name that were begun with `lead`, or all: what `stop_motion` does first."""
        for job in self._led:
            if not name or job.name == f"{self.name} {name}":
                job.cancel()

    def emit_event(self, kind: Kind, detail: str = "") -> None:
        """Report an event of this device."""
        self.host.emit(kind, self.name, detail)

    def report_double(self, detail: str) -> None:
        """Report that two devices seem to answer as this one: from now on no answer confirms a stop."""
        self.is_double = True
        self.emit_event("two devices", detail)

    def emit_alarms(self, now: Collection[str], before: Collection[str], who: str = "") -> None:
        """Report errors when one is new, and when all are over."""
        if set(now) - set(before):
            self.emit_event("alarm", f"{who}{', '.join(sorted(now))}")
        elif before and not now:
            self.emit_event("alarm over", f"{who}{', '.join(sorted(before))}")
