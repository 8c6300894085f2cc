"""The driver `cia402`: a servo drive on CANopen, one axis or several.

1. The node is set up when its bus opens and whenever it has booted: it is asked what it is, its PDOs are read (or written),
   its heartbeat is switched on, it is started. Nothing of that moves it.
2. What must be quick goes in PDOs: one a tick each way, at SYNC. What need not goes over SDO, one transfer at a time.
3. It is enabled where it is. After a reboot or a fault it stays disabled until it is enabled again.
4. While it is enabled it watches over the host, where it can (`watchdog`).

Modes, states and objects: CiA 402 as `states` has it. See the README for what is not done.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

from aces_bus.device import HostLoss, Job, MotorDevice, Poll, Steps
from aces_bus.device.settings import settings_of
from aces_bus.device.signals import Signal
from aces_bus.errors import AcesError, CallerError, DeviceError
from aces_bus.protocol import Record

from ..canopen_node.node import NMT, CanopenNode
from ..canopen_node.pdo import RECEIVED, SENT, PdoEntry, PdoLayout, from_file, offset_of
from ..canopen_node.watchdog import Watchdog
from .axis import CONTROLWORD, MODE, MODE_SHOWN, POSITION, STATUSWORD, DriveAxis
from .dictionary import dictionary_of
from .set_up import set_up
from .states import (
    DISABLE_VOLTAGE,
    ENABLE,
    FAILED,
    FAULT_RESET,
    MODES,
    ONWARD,
    QUICK_STOP,
    REACHED,
    SHUTDOWN,
    START,
    TAKEN,
    TARGETS,
    emergency_text,
)
from .units import DriveSettings

#: Seconds that one step of the state machine may take, and a change of mode.
STEP_S, MODE_S = 1.0, 1.0
#: A stop that no PDO has answered for so long (s) goes over SDO; then the statusword is looked at this often (ns). How long
#: it may stay enabled (s): the stop is repeated then.
SOON_S, LOOK_NS, STOP_S = 0.1, 20_000_000, 0.3
#: `Host.postpone` for good (s).
LONG_S = 1e9
#: Object → the signals that it gives.
_SHOWN = {
    POSITION: ("position",),
    0x606C: ("velocity",),
    0x6077: ("torque",),
    MODE_SHOWN: ("mode",),
    STATUSWORD: ("status", "state", "reached", "limited", "warning"),
}
#: The object that says what an axis does without its host.
ABORT_OPTION = 0x6007


class Cia402(CanopenNode, MotorDevice[DriveAxis]):
    """Signals of each joint: position, velocity, torque (the one that its mode takes can be set), state, mode and status;
    of the drive: network (NMT state) and error (the last emergency).
    """

    protocol = "canopen"
    streams = ("Rpdo1", "Rpdo2", "Rpdo3", "Rpdo4")
    when_host_is_lost = HostLoss(
        "limp", "CiA 301 object 1016, CiA 402 objects 6007 and 605E", 0.5,
        "after its fault reaction; `enable` sets object 1016 (`watchdog_ms`) where its file has it, else nobody knows",
    )  # fmt: skip
    actions: ClassVar = {
        "enable": "bring the joints to 'operation enabled', holding where they are (joint=NAME for one)",
        "disable": "torque off: 'ready to switch on'",
        "home": "search home as the drive's homing method says (method=, joint=); it moves",
        "reset_fault": "acknowledge a fault; the drive stays disabled",
        "set_mode": f"another mode of operation: {', '.join(TARGETS)}",
        "nmt": f"a command of network management: {', '.join(NMT)}",
        "read": "read an object: object=0x6064, object=0x6099:1 or its name",
        "write": "write an object: object= value= confirm=true",
        "identity": "ask what the drive is",
    }

    def setup(self) -> None:
        """Create axes and signals; polls as the node's file says."""
        self.node = self.credentials["node"]
        settings = self.settings = settings_of(self.name, DriveSettings, self.config.settings)
        self.pdo, self.event_ms = settings.pdo, settings.event_ms
        self.dictionary = dictionary_of(settings.eds, self.node)
        self.inputs = from_file(self.name, self.dictionary, self.node, SENT)
        self.outputs = from_file(self.name, self.dictionary, self.node, RECEIVED)
        holder = next((pdo for pdo in self.inputs.values() if pdo.has(STATUSWORD)), None)
        as_filed = holder is not None and holder.kind == 1
        self.sync = self.pdo == "write" or as_filed if settings.sync is None else settings.sync
        slowest = max([pdo.event_ms for pdo in self.inputs.values()] + [self.event_ms])
        self.pdo_stale_s = 0.1 if self.sync else max(0.1, 5 * slowest / 1000)
        self.axes = [DriveAxis(self, joint) for joint in self.joints]
        reactions = [ABORT_OPTION + axis.offset for axis in self.axes]
        watchdog = Watchdog(self, settings.watchdog_ms, settings.host_node, reactions)
        self.add_node(settings.heartbeat_ms, settings.sdo_timeout_s, watchdog)
        self._by_sdo: dict[int, int] = {}
        self._writing: Job | None = None
        self._wire()
        if self.sync:
            number = holder.number if holder is not None else 1
            self.polls = (Poll("Sync", reply=f"Tpdo{number}", timeout_s=0.02),)

    def _wire(self) -> None:
        """Note which axis reads which PDO, and which PDO takes which set-point."""
        axes = {axis.offset: axis for axis in self.axes}
        self._readers: dict[str, list[tuple[PdoEntry, DriveAxis, int]]] = {}
        self._takers: dict[int, int] = {}
        for pdo in self.inputs.values():
            for place in pdo.places:
                axis = axes.get(offset_of(place.index))
                if axis is None or place.subindex:
                    continue
                index = place.index - axis.offset
                self._readers.setdefault(f"Tpdo{pdo.number}", []).append((place, axis, index))
        for axis in self.axes:
            found = {index for readers in self._readers.values() for _, a, index in readers if a is axis}
            for index, names in _SHOWN.items():
                wholes = {axis.signals[name].name for name in names}
                self.readable = self.readable | wholes if index in found else self.readable - wholes
        for pdo in self.outputs.values():
            for place in pdo.places:
                self._takers.setdefault(place.index, pdo.number)

    def polls_of(self, name: str) -> list[Poll]:
        """Return the polls of a signal; SYNC asks for all PDOs, if the node waits for it."""
        return list(self.polls) if name in self.readable and name != self.network.name else []

    # ------------------------------------------------------------------ up

    def set_up_steps(self, job: Job) -> Steps:
        """See `set_up`."""
        return set_up(self, job)

    def begin(self) -> None:
        """Begin to watch the drive: it was started, and its PDOs are known."""
        self._wire()
        self.is_set_up = True
        self.quiet(False)

    def quiet(self, on: bool) -> None:
        """Do not expect the drive at SYNC (`on`), or expect it again."""
        if on:
            self.host.postpone(self, "Sync", LONG_S)
            return
        holder = next((n for n, pdo in self.inputs.items() if pdo.has(STATUSWORD)), 1)
        for slot in self.host.slots:
            if slot.device is self:
                slot.replies = frozenset((f"Tpdo{holder}",))
                slot.due = self.clock.now()

    def received(self, record: Record, instant: int) -> None:
        """Take PDOs, heartbeats and emergencies."""
        name = type(record).__name__
        readers = self._readers.get(name)
        if readers is not None:
            data = record.data
            if len(data) < self.inputs[int(name[-1])].size:
                self.emit_event("malformed", f"{name} has {len(data)} bytes, fewer than are mapped")
                return
            word = int.from_bytes(data, "little")
            for place, axis, index in readers:
                axis.update(index, place.take(word), instant)
        else:
            super().received(record, instant)

    def describe_emergency(self, code: int) -> str:
        """Return an emergency's code in words."""
        return emergency_text(code)

    def forget(self) -> None:
        """Forget all that was known."""
        super().forget()
        for axis in self.axes:
            axis.forget()

    # ------------------------------------------------------------------ down

    def takes(self, signal: Signal) -> bool | None:
        """Return True for an axis that is enabled, None while nothing is known of it: set-points wait."""
        found = next((axis.takes for axis in self.axes if axis.signals.get("position") is signal), True)
        return super().takes(signal) if found else found

    def put(self, axis: DriveAxis, *indices: int) -> None:
        """Send objects of an axis, as `axis.outputs` has them: in their PDOs, else over SDO."""
        for index in indices:
            number = self._takers.get(index + axis.offset)
            if number is not None:
                self.want(f"Rpdo{number}", "data", b"")
            else:
                self._by_sdo[index + axis.offset] = axis.outputs[index]
        self._go_on_writing()

    def _go_on_writing(self) -> None:
        if self._by_sdo and (self._writing is None or self._writing.is_over):
            self._writing = self.job("set-points over SDO", self._write_all)

    def _write_all(self, job: Job) -> Steps:
        while self._by_sdo:
            index, value = next(iter(self._by_sdo.items()))
            try:
                yield self.sdo.download(index, 0, self.raw(index, 0, value))
            except AcesError:
                self._by_sdo.pop(index, None)
                raise
            if self._by_sdo.get(index) == value:
                del self._by_sdo[index]

    def gathered(self, message: str, wants: Any) -> dict[str, Any] | None:
        """Return an RPDO: all its objects as they are wanted now."""
        layout: PdoLayout | None = self.outputs.get(int(message[-1]))
        if layout is None:
            return None
        word = 0
        axes = {axis.offset: axis for axis in self.axes}
        for place in layout.places:
            axis = axes.get(offset_of(place.index))
            if axis is not None and not place.subindex:
                word = place.put(word, axis.outputs.get(place.index - axis.offset, 0))
        return {"data": word.to_bytes(layout.size, "little")}

    def _control(self, axis: DriveAxis, word: int) -> Steps:
        """Return a controlword that is known to have arrived: statuswords were made after it."""
        axis.outputs[CONTROLWORD] = word
        if CONTROLWORD + axis.offset not in self._takers:
            yield self.sdo.download(CONTROLWORD + axis.offset, 0, word.to_bytes(2, "little"))
            return
        self.put(axis, CONTROLWORD)
        before = axis.received
        yield self.until(
            lambda: axis.received >= before + 2, STEP_S, lambda: f"{axis.name} says no statusword"
        )

    def _ready(self) -> Steps:
        """Set the node up if needed, until it reports its state."""
        if not self.is_set_up:
            yield self.set_up()
        elif not self.is_operational:
            yield self.send("Nmt", command="start")
            self.quiet(False)
        for axis in self.axes:
            before = axis.received
            yield self.until(
                lambda axis=axis, before=before: axis.received > before,  # type: ignore[misc]
                STEP_S,
                lambda axis=axis: f"{axis.name} says no statusword",  # type: ignore[misc]
            )

    # ------------------------------------------------------------------ actions

    def enable(self, joint: str | None = None) -> Job:
        """Bring the joints, or one, to "operation enabled". Fails with `DeviceError` where a joint is in fault."""
        axes = self.axes_of(joint)
        self.is_driven = True

        def steps(job: Job) -> Steps:
            yield from self._ready()
            for axis in self.in_turn(job, axes):
                yield from self._enabled(axis)

        return self.lead("enable", steps)

    def _enabled(self, axis: DriveAxis) -> Steps:
        yield from self.watchdog.begin()
        if axis.state != "operation enabled":
            self.epoch += 1
            axis.hold()
        yield from self._into_mode(axis, axis.wanted)
        for _ in range(8):
            state = axis.state
            if state == "operation enabled":
                return
            if state == "fault":
                why = f" ({self.error.last})" if self.error.last else ""
                raise DeviceError(f"{self.name}: {axis.name} is in fault{why}; reset_fault first")
            axis.hold()
            word = ONWARD.get(state)
            if word is not None:
                yield from self._control(axis, word)
            yield self.until(
                lambda state=state: axis.state != state,  # type: ignore[misc]
                STEP_S,
                lambda: f"{axis.name} stays {axis.state!r} with controlword {axis.outputs[CONTROLWORD]:04X}",
            )
        raise DeviceError(f"{self.name}: {axis.name} does not get enabled; it is {axis.state!r}")

    def disable(self, joint: str | None = None) -> Job:
        """Switch torque off."""
        return self._down("disable", SHUTDOWN, self.axes_of(joint), STEP_S)

    def stop_motion(self) -> Job:
        """Stop all joints by a quick stop."""
        return self._down("stop", QUICK_STOP, self.axes, STOP_S)

    def _down(self, name: str, word: int, axes: Sequence[DriveAxis], within_s: float) -> Job:
        """Return a controlword that stops, at once: in PDOs, else over SDO; over when statuswords made after it say so."""
        self.end_led()
        self.epoch += 1
        offsets = {axis.offset for axis in axes}
        self._by_sdo = {
            index: value for index, value in self._by_sdo.items() if offset_of(index) not in offsets
        }
        if self._writing is not None:
            self._writing.cancel()
        for axis in axes:
            axis.hold()
            axis.outputs[CONTROLWORD] = word
        #: By PDO where the node takes them and they are known; it may move where it does not.
        takers = self._takers if self.is_operational else {}
        numbers = {axis: takers.get(CONTROLWORD + axis.offset) for axis in axes}
        sent = [
            self.send_now(f"Rpdo{number}", **fields)
            for number in sorted({number for number in numbers.values() if number is not None})
            if (fields := self.gathered(f"Rpdo{number}", ())) is not None
        ]
        others = [axis for axis, number in numbers.items() if number is None]
        written = self._write_control(others, word) if others else None
        self._go_on_writing()
        before = {axis: axis.received for axis in axes}

        def steps(job: Job) -> Steps:
            yield from sent
            if written is not None:
                yield written
            is_asked = not self.is_operational
            try:
                for axis in () if is_asked else axes:
                    yield self.until(
                        lambda axis=axis: axis.received >= before[axis] + 2,  # type: ignore[misc]
                        SOON_S,
                        lambda: "",
                    )
            except DeviceError:  # it takes no PDOs, and its heartbeat has not said so yet
                is_asked = True
                yield self._write_control(axes, word)
            for axis in axes:
                yield from self._off(axis, within_s, is_asked=is_asked)
            if all(axis.state != "operation enabled" for axis in self.axes):
                yield from self.watchdog.end()

        return self.job(name, steps)

    def _write_control(self, axes: Sequence[DriveAxis], word: int) -> Job:
        """Write a controlword over SDO, instead of all that waits there."""
        data = word.to_bytes(2, "little")
        return self.sdo.download_now([(CONTROLWORD + axis.offset, 0, data) for axis in axes])

    def _off(self, axis: DriveAxis, within_s: float, *, is_asked: bool) -> Steps:
        """Wait until its statusword says that it is not enabled; where no PDO brings it, it is asked for over SDO."""
        end = self.clock.now() + round(within_s * 1e9)
        while is_asked:
            data: bytes = yield self.sdo.upload(STATUSWORD + axis.offset)
            axis.update(STATUSWORD, int.from_bytes(data[:2], "little"), self.clock.now())
            if axis.state != "operation enabled" or self.clock.now() >= end:
                break
            yield LOOK_NS
        yield self.until(
            lambda: axis.state != "operation enabled",
            0 if is_asked else within_s,
            lambda: f"{axis.name} stays enabled",
        )

    def reset_fault(self, joint: str | None = None) -> Job:
        """Acknowledge a fault. Fails with `DeviceError` while its cause is there."""
        axes = self.axes_of(joint)

        def steps(job: Job) -> Steps:
            yield from self._ready()
            for axis in axes:
                if axis.state not in ("fault", "fault reaction active"):
                    continue
                yield from self._control(axis, DISABLE_VOLTAGE)
                yield from self._control(axis, FAULT_RESET)
                yield self.until(
                    lambda axis=axis: axis.state != "fault",  # type: ignore[misc]
                    STEP_S,
                    lambda axis=axis: f"{axis.name} stays in fault: {self.error.last or 'no reason given'}",  # type: ignore[misc]
                )
                yield from self._control(axis, DISABLE_VOLTAGE)

        return self.lead("reset fault", steps, moves=False)

    def set_mode(self, mode: str, joint: str | None = None) -> Job:
        """Choose another mode of operation; the joint holds where it is. Raises `CallerError` for an unknown mode."""
        if mode not in TARGETS:
            raise CallerError(f"{self.name}: no mode {mode!r} (there are: {', '.join(TARGETS)})")
        axes = self.axes_of(joint)

        def steps(job: Job) -> Steps:
            yield from self._ready()
            self.epoch += 1
            for axis in axes:
                axis.hold()
                yield from self._into_mode(axis, mode)
                axis.choose(mode)

        return self.lead(f"mode {mode}", steps, moves=False)

    def _into_mode(self, axis: DriveAxis, mode: str) -> Steps:
        number = MODES[mode]
        axis.outputs[MODE] = number
        axis.outputs[CONTROLWORD] &= ~START
        if MODE + axis.offset in self._takers:
            self.put(axis, MODE)
        else:
            yield self.sdo.download(MODE + axis.offset, 0, number.to_bytes(1, "little", signed=True))
        shown = {index for readers in self._readers.values() for _, a, index in readers if a is axis}
        if MODE_SHOWN in shown:
            yield self.until(
                lambda: axis.mode_shown == number,
                MODE_S,
                lambda: f"{axis.name} does not go into mode {mode}; does the drive have it?",
            )
            return
        for _ in range(20):
            data: bytes = yield self.sdo.upload(MODE_SHOWN + axis.offset)
            axis.update(MODE_SHOWN, int.from_bytes(data[:1], "little", signed=True), self.clock.now())
            if axis.mode_shown == number:
                return
            yield round(MODE_S * 1e9 / 20)
        raise DeviceError(f"{self.name}: {axis.name} does not go into mode {mode}; does the drive have it?")

    def home(self, joint: str | None = None, method: int | None = None, timeout_s: float = 30.0) -> Job:
        """Search home; the job's text says how far it is. Fails with `DeviceError` when the drive does not find it."""
        axes = self.axes_of(joint)
        self.is_driven = True

        def steps(job: Job) -> Steps:
            yield from self._ready()
            for axis in self.in_turn(job, axes):
                job.text = f"{axis.name} searches"
                yield from self._homed(axis, method, timeout_s)
                job.text = f"{axis.name} is home"

        return self.lead("home", steps)

    def _homed(self, axis: DriveAxis, method: int | None, timeout_s: float) -> Steps:
        if method is not None:
            yield self.sdo.download(0x6098 + axis.offset, 0, self.raw(0x6098 + axis.offset, 0, int(method)))
        mode, axis.wanted = axis.wanted, "homing"
        try:
            yield from self._enabled(axis)
            yield from self._control(axis, ENABLE)
            yield from self._control(axis, ENABLE | START)

            def status() -> int:
                return axis.statusword or 0

            yield self.until(
                lambda: bool(status() & (TAKEN | FAILED)) or axis.state != "operation enabled",
                timeout_s,
                lambda: f"{axis.name} has not found home",
            )
            if axis.state != "operation enabled" or status() & FAILED:
                why = f" ({self.error.last})" if self.error.last else ""
                raise DeviceError(f"{self.name}: {axis.name} has not found home: homing error{why}")
            yield self.until(
                lambda: bool(status() & REACHED), STEP_S, lambda: f"{axis.name} is home and moves on"
            )
        finally:
            axis.wanted = mode
            axis.outputs[CONTROLWORD] &= ~START
            axis.hold()
            if self.is_set_up:
                self.put(axis, CONTROLWORD)
        yield from self._into_mode(axis, mode)
