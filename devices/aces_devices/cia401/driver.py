"""The driver `cia401`: a module of digital and analog inputs and outputs on CANopen.

1. Setting it up asks what it is and what its channels say, switches its heartbeat on, and starts it. No output is written
   before it is set.
2. Inputs come with PDOs when they change, and all channels are read over SDO now and then: a PDO that was lost is made good.
3. Outputs go in PDOs, in each tick, where the module takes them at once; else over SDO.
4. From its first output on the module watches over the host, where it can; a stop sets what was set to its error value, at
   once and then once more over SDO, reads it back, and ends the watch.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial
from typing import Any, ClassVar

from aces_bus.device import HostLoss, Job, Steps
from aces_bus.device.settings import settings_of
from aces_bus.device.signals import Signal
from aces_bus.errors import AcesError, DeviceError
from aces_bus.protocol import Record

from ..canopen_node.node import NMT, CanopenNode
from ..canopen_node.pdo import RECEIVED, SENT, PdoLayout, from_file, read_layouts
from ..canopen_node.watchdog import Watchdog
from .channels import (
    ERROR_VALUES,
    LEAST,
    MOST,
    OUTPUTS,
    USUAL_ERRORS,
    IoChannel,
    ModuleSettings,
    io_channels,
    module_dictionary,
)
from .twin import ANALOG_EVENTS, error_number

PROFILE = 401
_SIGNED = 0x6401, 0x6411


class Cia401(CanopenNode):
    """Signals: each channel by its name, else di1…, do1…, ai1…, ao1…; network (NMT state) and error (the last emergency)."""

    protocol = "canopen"
    streams = ("Rpdo1", "Rpdo2", "Rpdo3", "Rpdo4")
    when_host_is_lost = HostLoss(
        "nothing moves", "CiA 301 object 1016, CiA 401 objects 6206, 6207, 6443 and 6444", 0.5,
        "outputs take their error values; the first output sets object 1016 (`watchdog_ms`) where its file has it",
    )  # fmt: skip
    actions: ClassVar = {
        "nmt": f"a command of network management: {', '.join(NMT)}",
        "read": "read an object: object=0x6200:1 or its name",
        "write": "write an object: object= value= confirm=true",
        "identity": "ask what the module is",
    }

    def setup(self) -> None:
        """Add a signal for each channel that the module's file has."""
        self.settings = settings = settings_of(self.name, ModuleSettings, self.config.settings)
        node = self.credentials["node"]
        self.dictionary = module_dictionary(settings.eds, node)
        self.channels = io_channels(self.name, settings, self.dictionary)
        self.inputs = from_file(self.name, self.dictionary, node, SENT)
        self.outputs = from_file(self.name, self.dictionary, node, RECEIVED)
        #: The numbers of objects, as the module says, and of outputs that were set.
        self.numbers: dict[tuple[int, int], int] = {}
        self.goals: dict[tuple[int, int], int] = {}
        #: Which bits of these were set.
        self._driven: dict[tuple[int, int], int] = {}
        self._is_foreign = False
        #: Of outputs, the module's own: which take an error value, and that value.
        self.errors: dict[tuple[int, int], tuple[int, int]] = {}
        self._by_where: dict[tuple[int, int], list[tuple[IoChannel, Signal]]] = {}
        for channel in self.channels.values():
            self._by_where.setdefault(channel.where, []).append((channel, self._add(channel)))
        watchdog = Watchdog(self, settings.watchdog_ms, settings.host_node)
        self.add_node(settings.heartbeat_ms, settings.sdo_timeout_s, watchdog)
        self._reading: Job | None = None
        self._writing: Job | None = None
        self._unsent: set[tuple[int, int]] = set()
        #: Set-points that came before the module was set up.
        self._early: dict[str, Any] = {}

    def _add(self, channel: IoChannel) -> Signal:
        given, setter = channel.given, partial(self._set, channel) if channel.is_output else None
        ends: list[float | None] = [given.lower, given.upper]
        if channel.bit is None and channel.is_output:
            low, high = sorted((channel.value(LEAST), channel.value(MOST)))
            ends = [low if given.lower is None else given.lower, high if given.upper is None else given.upper]
        return self.add_signal(
            channel.name,
            unit=given.unit,
            setter=setter,
            lower=ends[0],
            upper=ends[1],
            stale_s=max(0.5, 5 * self.settings.every_s),
            read_from=("Tpdo1", "SdoUploaded"),
            doc=given.kind.replace("_", " ") + f" {given.number}",
            source=f"CiA 401, object {channel.index:04X}:{channel.subindex}",
        )

    # ------------------------------------------------------------------ up

    def set_up_steps(self, job: Job) -> Steps:
        """Set up its PDOs and its heartbeat, start it, and read its channels."""
        job.text = "identity"
        data: bytes = yield self.sdo.upload(0x1000)
        profile = int.from_bytes(data[:2], "little")
        if profile != PROFILE:
            raise DeviceError(
                f"{self.name}: node {self.credentials['node']} is of device profile {profile}, not {PROFILE}"
            )
        job.progress, job.text = 0.2, "PDOs"
        self.outputs = yield from read_layouts(self, RECEIVED)
        self.inputs = yield from read_layouts(self, SENT)
        job.progress, job.text = 0.6, "settings"
        if self.heartbeat_ms:
            yield self.sdo.download(0x1017, 0, self.raw(0x1017, 0, self.heartbeat_ms))
        if self.dictionary.get_variable(ANALOG_EVENTS, 0) is not None:
            yield self.sdo.download(ANALOG_EVENTS, 0, b"\x01")
        job.progress, job.text = 0.8, "channels"
        for where in self._by_where:
            if where[0] in OUTPUTS:
                mode, value = ERROR_VALUES[where[0]]
                self.errors[where] = (
                    (yield from self._error_object(mode, where[1])),
                    (yield from self._error_object(value, where[1])),
                )
        yield from self._read_all()
        yield self.send("Nmt", command="start")
        self.is_set_up = True
        self.error.update("", self.clock.now())
        if self._reading is None:
            self._read_again(None)
        for _ in range(50 if self.heartbeat_ms else 0):
            if self.network.last == "operational":
                break
            yield self.heartbeat_ms * 1_000_000 // 20
        if not self.is_operational:
            raise DeviceError(
                f"{self.name}: it was started, and its heartbeat does not say that it is operational"
            )
        early, self._early = self._early, {}
        for name, value in early.items():
            self._give(self.channels[name], value)

    def _error_object(self, index: int, subindex: int) -> Steps:
        if self.dictionary.get_variable(index, subindex) is None:
            return USUAL_ERRORS[index]
        data: bytes = yield self.sdo.upload(index, subindex)
        return int.from_bytes(data, "little", signed=index == ERROR_VALUES[0x6411][1])

    def quiet(self, on: bool) -> None:
        """Drop waiting set-points while the module is not operational (`on`). They are not sent again; a stop
        still acts.
        """
        if on:
            for number in range(1, 5):
                self.drop(f"Rpdo{number}")
            self.goals.clear()
            self._unsent.clear()

    def _read_again(self, _: Any) -> None:
        """Read all channels over SDO, now and then, while the module is there."""
        if not self.host.is_open:
            return

        def steps(job: Job) -> Steps:
            yield round(self.settings.every_s * 1e9)
            if self.is_set_up:
                try:
                    yield from self._read_all()
                except AcesError:
                    pass  # its heartbeat, or that there is none, says more

        self._reading = self.job("read all channels", steps)
        self._reading.then(self._read_again)

    def _read_all(self) -> Steps:
        for where in self._by_where:
            yield from self._read_one(where)

    def _read_one(self, where: tuple[int, int]) -> Steps:
        data: bytes = yield self.sdo.upload(*where)
        number = int.from_bytes(data, "little", signed=where[0] in _SIGNED)
        self._known(where, number, self.clock.now())
        return number

    def _known(self, where: tuple[int, int], number: int, instant: int) -> None:
        self.numbers[where] = number
        for channel, signal in self._by_where.get(where, ()):
            signal.update(channel.value(number), instant)

    def received(self, record: Record, instant: int) -> None:
        """Take PDOs, and what any node sends."""
        name = type(record).__name__
        layout = self.inputs.get(int(name[-1])) if name.startswith("Tpdo") else None
        if layout is None:
            super().received(record, instant)
        elif len(record.data) < layout.size:
            self.emit_event("malformed", f"{name} has {len(record.data)} bytes, fewer than are mapped")
        else:
            word = int.from_bytes(record.data, "little")
            for place in layout.places:
                self._known((place.index, place.subindex), place.take(word), instant)

    def forget(self) -> None:
        """Forget all that was known and set."""
        super().forget()
        self.numbers.clear()
        self._early.clear()
        self.goals.clear()
        self._driven.clear()
        self._unsent.clear()

    # ------------------------------------------------------------------ down

    def takes(self, signal: Signal) -> bool | None:
        """Return True if an operational module takes the output, False if not, None while its state is unknown."""
        if self._is_unknown:
            return None
        return super().takes(signal) if self.is_operational else False

    def _set(self, channel: IoChannel, value: Any) -> None:
        if self.host.passive:
            self.emit_event("not sent", f"{channel.name}: this bus is only listened to")
            return
        if self._is_unknown:
            self._early[channel.name] = value
            return
        self._give(channel, value)

    @property
    def _is_unknown(self) -> bool:
        """True if the module is being set up, or never has been."""
        return not self.numbers or (self._set_up is not None and not self._set_up.is_over)

    def _give(self, channel: IoChannel, value: Any) -> None:
        if not self.is_operational or channel.where not in self.numbers:
            self.emit_event(
                "not sent", f"{channel.name}: the module is not operational; the set-point is dropped"
            )
            return
        if self._stop_number(channel.where, 0) is None:
            self.emit_event(
                "not sent",
                f"{channel.name}: the module's error value (6444) is {self.errors[channel.where][1]}, which CiA 401 does not"
                " define for 16 bits; give the channel a value that stops it: stop = 0.0",
            )
            return
        self.is_driven = True
        before = self.goals.get(channel.where, self.numbers[channel.where])
        self.goals[channel.where] = channel.put(before, value)
        self._driven[channel.where] = self._driven.get(channel.where, 0) | (
            -1 if channel.bit is None else 1 << channel.bit
        )
        self._unsent.add(channel.where)
        if self._writing is None or self._writing.is_over:
            is_watched = self.watchdog.entry is not None or not self.watchdog.is_possible
            if is_watched and self._in_pdos(self._unsent):
                self._send()
            else:
                self._writing = self.job("set outputs", self._write)

    def _write(self, job: Job) -> Steps:
        """Set the watch over the host first; then write what was set."""
        try:
            yield from self.watchdog.begin()
            while self._unsent:
                self._send()
                if self._unsent:
                    where = self._unsent.pop()
                    yield self.sdo.download(*where, self._bytes(where, self.goals[where]))
        except AcesError as error:
            self._unsent.clear()
            self.emit_event("not sent", str(error))
            raise

    def _send(self) -> None:
        """Put the changed outputs into their PDOs, to be sent with the next tick."""
        for number, layout in self._taking():
            held = {(place.index, place.subindex) for place in layout.places} & self._unsent
            if held:
                self._unsent -= held
                self.want(f"Rpdo{number}", "data", b"")

    def _taking(self) -> Iterable[tuple[int, PdoLayout]]:
        """Yield the PDOs whose outputs are taken at once, and of which all objects are known."""
        for number, layout in self.outputs.items():
            known = all((place.index, place.subindex) in self.numbers for place in layout.places)
            if known and not layout.is_synchronous:
                yield number, layout

    def _in_pdos(self, places: Iterable[tuple[int, int]]) -> bool:
        held = {(place.index, place.subindex) for _, layout in self._taking() for place in layout.places}
        return held.issuperset(places)

    def gathered(self, message: str, wants: Any) -> dict[str, Any] | None:
        """Return a PDO: its outputs as they were set, else as they are."""
        layout = self.outputs.get(int(message[-1]))
        return None if layout is None else {"data": self._content(layout)}

    def _content(self, layout: PdoLayout) -> bytes:
        word = 0
        for place in layout.places:
            where = place.index, place.subindex
            word = place.put(word, self.goals.get(where, self.numbers.get(where, 0)))
        return word.to_bytes(layout.size, "little")

    def _bytes(self, where: tuple[int, int], number: int) -> bytes:
        return number.to_bytes(2 if where[0] in _SIGNED else 1, "little", signed=where[0] in _SIGNED)

    # ------------------------------------------------------------------ stopping

    def stop_motion(self) -> Job | None:
        """Set driven outputs to their `stop`, or else to the module's error value: by PDO at once, then over
        SDO; read back.
        """
        self._unsent.clear()
        self._early.clear()
        for job in (self._writing, self._reading):
            if job is not None and not job.is_over:
                job.cancel()
        self._writing = None
        for number in self.outputs:
            self.drop(f"Rpdo{number}")
        if not self._driven:
            return None
        wanted = {
            where: self._stop_number(where, self.goals.get(where, self.numbers.get(where, 0))) or 0
            for where in self._driven
        }
        self.goals = dict(wanted)
        for number, layout in list(self._taking()) if self.is_operational else ():
            self.send_now(f"Rpdo{number}", data=self._content(layout))
        written = self.sdo.download_now(
            [(*where, self._bytes(where, goal)) for where, goal in wanted.items()]
        )

        def steps(job: Job) -> Steps:
            yield written
            for where, goal in wanted.items():
                number = yield from self._read_one(where)
                if number != goal:
                    raise DeviceError(
                        f"{self.name}: object {where[0]:04X}:{where[1]} stays 0x{number:X}; 0x{goal:X} stops it"
                    )
            self.goals.clear()
            self._driven.clear()
            yield from self.watchdog.end()

        return self.job("stop", steps)

    def assume_driven(self) -> None:
        """Take it that another program set its outputs: what they were before is not known."""
        super().assume_driven()
        self._is_foreign = True

    def confirm_stopped(self) -> Job | None:
        """Fail after another program's set-points, which cannot be taken back here."""
        if not self._is_foreign:
            return None

        def steps(job: Job) -> Steps:
            yield 0
            raise DeviceError(
                f"{self.name}: another program has set its outputs, and they stay as they are: end that program"
            )

        return self.job("say that its outputs stay", steps)

    def _stop_number(self, where: tuple[int, int], number: int) -> int | None:
        """Return the number that an output's object gets when its driven channels stop; None if it is not known."""
        mode, value = self.errors.get(where, (0xFF, 0))
        found = error_number(where[0], number, mode, value)
        stated = [channel for channel, _ in self._by_where[where] if channel.given.stop is not None]
        for channel in stated:
            found = channel.put(found, channel.given.stop)
        is_open = where[0] == 0x6411 and mode and value and not stated
        driven = self._driven.get(where, 0)
        return None if is_open else number & ~driven | found & driven
