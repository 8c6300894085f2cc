"""A CANopen node as a driver has it: set up when its bus opens and whenever it has booted, watched by its heartbeat.

1. Nothing here moves a node: setting up asks it, switches its heartbeat on and starts it.
2. An absent node is looked for every now and then; one that was there and is not any more is silent.
3. Writing an object by hand goes past every check that the driver makes: it wants `confirm=True`.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import replace
from typing import Any

from aces_bus.device import UNKNOWN, Device, HostLoss, Job, Steps
from aces_bus.device.signals import Signal
from aces_bus.errors import AcesError, CallerError, NoReplyError
from aces_bus.protocol import Record
from aces_bus.protocol.record import FieldValue

from .dictionary import object_of
from .sdo import SdoChannel
from .watchdog import Watchdog

#: How often an absent node is looked for (ns).
RETRY_NS = 2_000_000_000
#: What `identity` asks for: name, index, subindex. The first must be there.
IDENTITY = (
    ("type", 0x1000, 0),
    ("vendor", 0x1018, 1),
    ("product", 0x1018, 2),
    ("revision", 0x1018, 3),
    ("serial", 0x1018, 4),
    ("name", 0x1008, 0),
)
NMT = ("start", "stop", "pre_operational", "reset_node", "reset_communication")


class CanopenNode(Device):
    """A node with an NMT state, a heartbeat and emergencies. Drivers call `add_node` in `setup`, and have `set_up_steps`."""

    dictionary: Any
    sdo: SdoChannel
    heartbeat_ms: int

    def add_node(self, heartbeat_ms: int, sdo_timeout_s: float, watchdog: Watchdog) -> None:
        """Add the signals of any node, and the watch over its heartbeat."""
        self.heartbeat_ms = heartbeat_ms
        beats = 3.5 * heartbeat_ms / 1000 if heartbeat_ms else 1e6
        self.network: Signal = self.add_signal(
            "network", of="Heartbeat.state", stale_s=beats, doc="NMT state", source="CiA 301"
        )
        self.error: Signal = self.add_signal(
            "error", stale_s=beats, doc="the last emergency; empty: none", source="CiA 301, EMCY; object 603F"
        )
        self.sdo = SdoChannel(self, sdo_timeout_s)
        self.watchdog = watchdog
        self.is_set_up = False
        self.last_beat: int | None = None
        self._tried_at = self.clock.now()
        #: How many boot-up messages were received.
        self.boots = 0
        self._set_up: Job | None = None

    # ------------------------------------------------------------------ for drivers

    @abstractmethod
    def set_up_steps(self, job: Job) -> Steps:
        """Ask the node what it is, set it up, start it; then `is_set_up`."""

    def quiet(self, on: bool) -> None:
        """Stop polling the node (`on`), or poll it again: it does not answer now."""

    # ------------------------------------------------------------------ up

    def start(self) -> Job:
        """Set the node up; again whenever it has booted."""
        self.quiet(True)
        self._look()
        return self.set_up()

    def set_up(self) -> Job:
        """Have the node ready: its PDOs known, its heartbeat on, itself operational."""
        if self._set_up is not None and not self._set_up.is_over:
            return self._set_up
        self.quiet(True)

        def steps(job: Job) -> Steps:
            while True:
                boots = self.boots
                try:
                    yield from self.set_up_steps(job)
                except AcesError:
                    if self.boots == boots:
                        raise
                if self.boots == boots:
                    return

        made = self.job("set up", steps)
        self._set_up, self._tried_at = made, self.clock.now()
        made.then(self._was_set_up)
        return made

    def _was_set_up(self, job: Job) -> None:
        if job is not self._set_up or job.error is None:
            return
        self.is_set_up = False
        self.quiet(True)
        if not isinstance(job.error, NoReplyError):
            self.emit_event("alarm", f"cannot be set up: {job.error}")

    def _look(self) -> None:
        """Look now and then whether an absent node is there, or a present one is gone."""
        now = self.clock.now()
        is_idle = self._set_up is None or self._set_up.is_over
        if not self.is_set_up and is_idle and now - self._tried_at >= RETRY_NS:
            self.set_up()
        beat = self.heartbeat_ms * 1_000_000
        if self.is_set_up and beat and not self.is_silent and self.last_beat is not None:
            age = now - max(self.last_beat, self.last_received or 0)
            if age > 3 * beat:
                self.is_silent = True
                self.emit_event("silent", f"no heartbeat for {age / 1e9:.1f} s")
        self.clock.call_in(min(RETRY_NS, beat or RETRY_NS), self._look)

    def received(self, record: Record, instant: int) -> None:
        """Take heartbeats and emergencies."""
        name = type(record).__name__
        if name == "Heartbeat":
            self._beat(record.state, instant)
        elif name == "Emergency":
            self._emergency(record, instant)

    def _beat(self, state: Any, instant: int) -> None:
        self.last_beat = instant
        if self.error.instant is not None:
            self.error.update(self.error.last, instant)
        if state == "boot_up":
            self.boots += 1
            self.watchdog.forget()
            was_set_up, self.is_set_up = self.is_set_up, False
            self.quiet(True)
            if was_set_up:
                self.rebooted("sent its boot-up message")
            self.set_up()  # one that is under way begins anew by itself
        elif state != "operational" and self.is_set_up:
            self.quiet(True)
        elif state == "operational" and self.is_set_up:
            for slot in self.host.slots:
                if slot.device is self and slot.due - instant > RETRY_NS:
                    slot.due = instant

    def _emergency(self, record: Record, instant: int) -> None:
        raw = int.from_bytes(record.meta.raw[:2], "little")
        if raw & 0xFF00 == 0:
            self.error.update("", instant)
            self.emit_event("alarm over", "error reset")
            return
        text = self.describe_emergency(raw)
        details = f", details {record.details.hex(' ')}" if any(record.details) else ""
        self.error.update(text, instant)
        self.emit_event("alarm", f"{text}{details}")

    def describe_emergency(self, code: int) -> str:
        """Return an emergency's code in words."""
        return f"error {code:04X}"

    def received_by_others(self, record: Record, instant: int) -> bool:
        """Return the heartbeat of the program that drives, where this one looks on."""
        return type(record).__name__ == "Heartbeat" and record.node == self.watchdog.host_node

    @property
    def is_operational(self) -> bool:
        """True if the node takes PDOs, as far as is known; a node that has lost the host does not."""
        return self.is_set_up and self.network.last in (UNKNOWN, "operational")

    @property
    def host_loss(self) -> HostLoss:
        """As declared, where it can watch over the host's heartbeat; else what it does is its own settings' affair."""
        loss = self.when_host_is_lost
        if self.watchdog.is_possible:
            return replace(loss, after_s=self.watchdog.wait_ms / 1000)
        moves = loss.does != "nothing moves"
        why = "watchdog_ms = 0" if not self.watchdog.wait_ms else "its file has no object 1016"
        return replace(loss, does="unknown" if moves else loss.does, after_s=None, detail=why)

    # ------------------------------------------------------------------ down

    def nmt(self, command: str) -> Job:
        """Return a command of network management to this node."""
        if command not in NMT:
            raise CallerError(f"{self.name}: no command {command!r} (there are: {', '.join(NMT)})")

        def steps(job: Job) -> Steps:
            if command in ("stop", "pre_operational"):
                self.quiet(True)
            yield self.send("Nmt", command=command)
            if command == "start" and self.is_set_up:
                self.quiet(False)

        return self.job(f"nmt {command}", steps)

    # ------------------------------------------------------------------ objects by hand

    def raw(self, index: int, subindex: int, value: FieldValue) -> bytes:
        """Return an object's value as bytes, as the node's file says. Raises `CallerError` for what does not fit."""
        known = self.dictionary.get_variable(index, subindex)
        if known is None:
            raise CallerError(
                f'{self.name}: its file has no object {index:04X}:{subindex}; give bytes, as value="0f 00"'
            )
        try:
            return bytes(known.encode_raw(value))
        except Exception as error:  # of canopen and struct, by type of object
            raise CallerError(f"{self.name}: {value!r} is not a value of {known.name}: {error}") from None

    def read(self, object: str | int) -> Job:
        """Read an object over SDO: its value, or its bytes in hexadecimal where the file does not know it."""
        index, subindex, known = object_of(self.dictionary, object)

        def steps(job: Job) -> Steps:
            data: bytes = yield self.sdo.upload(index, subindex)
            if known is None:
                return data.hex(" ")
            try:
                value = known.decode_raw(data)
            except Exception:  # another length than the file says
                return data.hex(" ")
            return _printable(data) if isinstance(value, str) else value

        return self.job(f"read {index:04X}:{subindex}", steps)

    def write(self, object: str | int, value: Any, confirm: bool = False) -> Job:
        """Write an object over SDO. Raises `CallerError` without `confirm`: it may move the device, or outlive it."""
        index, subindex, known = object_of(self.dictionary, object)
        if confirm is not True:
            raise CallerError(
                f"{self.name}: writing object {index:04X}:{subindex} goes past all checks; confirm=true if you mean it"
            )
        if known is None and isinstance(value, str):
            try:
                data = bytes.fromhex(value)
            except ValueError:
                raise CallerError(f"{self.name}: {value!r} is not bytes in hexadecimal") from None
        else:
            data = self.raw(index, subindex, value)
        return self.sdo.download(index, subindex, data)

    def identity(self) -> Job:
        """Read what the node says about itself: device type, vendor, product, revision, serial number, name."""

        def steps(job: Job) -> Steps:
            found: dict[str, FieldValue] = {}
            for number, (name, index, subindex) in enumerate(IDENTITY):
                try:
                    data: bytes = yield self.sdo.upload(index, subindex)
                except AcesError:
                    if index == 0x1000:
                        raise
                    continue  # optional
                found[name] = _printable(data) if name == "name" else int.from_bytes(data, "little")
                job.progress = (number + 1) / 6
            return found

        return self.job("identity", steps)


def _printable(data: bytes) -> str:
    """Return a device's text without characters that a terminal would take for a command."""
    return "".join(
        character if character.isprintable() else "?"
        for character in data.decode("ascii", "replace").rstrip("\0")
    )
