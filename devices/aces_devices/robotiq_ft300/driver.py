"""Robotiq FT 300: force and torque by registers, or as a stream of its own.

1. By registers it is a Modbus device with a table that ships. With `stream = true` it sends by itself, 100 times a second,
   and is asked nothing: on one pair of wires a question would meet what it sends.
2. A stream that ends is begun again. Values that do not come are unknown after 0.1 s.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, ClassVar

from msgspec import Meta

from aces_bus.device import Driver, HostLoss, Job, Steps, Ticket
from aces_bus.device.settings import described
from aces_bus.protocol import Record

from ..modbus.driver import ModbusDevice, ModbusSettings
from ..modbus.twin import ModbusTwin

#: What starts the stream (register `stream`), and what stops it: so many bytes FF (rq_sensor_com.cpp).
START, STOP = 0x0200, b"\xff" * 50
#: Without a packet for so long the stream has broken off, as in rq_sensor_com.cpp (ns); a new one is asked for so often.
BROKEN_NS = 160_000_000
AGAIN_S = 1.0
PERIOD_S = 0.01
#: The twin's: so many bytes that are not a request, within so long (ns), end its stream.
ENOUGH, BREAK_NS = 40, 500_000_000
STALE_S = 0.1
AXES = ("fx", "fy", "fz", "mx", "my", "mz")


class Ft300Settings(ModbusSettings, frozen=True, kw_only=True):
    """The driver's own keys in a robot file."""

    stream: Annotated[
        bool, Meta(description="true: it sends by itself, 100 times a second; false: its registers are read")
    ] = False


class Ft300(ModbusDevice):
    """Signals: fx, fy, fz (N), mx, my, mz (N·m); without a stream ax, ay, az (m/s²), firmware, serial_number, year, too."""

    settings_type: ClassVar = Ft300Settings
    shipped_table: ClassVar = "robotiq_ft300"
    when_host_is_lost = HostLoss("nothing moves", "a sensor")
    moves: ClassVar = False
    actions: ClassVar = {
        **ModbusDevice.actions,
        "start_stream": "have it send by itself",
        "stop_stream": "have it send nothing more by itself",
    }

    def setup(self) -> None:
        """See `ModbusDevice.setup`; of a stream nothing is polled."""
        super().setup()
        assert isinstance(self.settings, Ft300Settings)
        self._is_streamed = self.settings.stream
        self._streamed_at = -BROKEN_NS
        self._is_wanted = self._is_streamed
        if not self._is_streamed:
            return
        self.polls = ()
        self.spans.clear()
        for name in [*self.table]:
            whole = f"{self.name}.{name}"
            if name in AXES:
                self.signals[whole].stale_after_ns = round(STALE_S * 1e9)
            elif name != "stream":
                self.readable.discard(whole)

    def start(self) -> Job | None:
        """Begin the stream, and see that it goes on."""
        return self.job("stream", self._watch) if self._is_streamed else super().start()

    def _watch(self, job: Job) -> Steps:
        while True:
            if self._is_wanted and self.clock.now() - self._streamed_at >= BROKEN_NS:
                yield from self._sent(START)
            yield round(AGAIN_S * 1e9)

    def _sent(self, value: int) -> Steps:
        """Yield steps that write `stream`, whose answer may be lost among the packets."""
        yield self.send(
            "WriteRegisters", start=self.table["stream"].entry.address, count=1, registers=[value]
        )

    def start_stream(self) -> Job:
        """Have it send by itself, until it is stopped or switched off."""
        self._is_wanted = self._is_streamed
        return self.job("start stream", lambda job: self._sent(START))

    def stop_stream(self) -> Ticket:
        """Have it send nothing more by itself, until `start_stream`."""
        self._is_wanted = False
        return self.host.ask(Ticket(self.clock, self, "the stream's end", STOP, frozenset(), 0))

    def received(self, record: Record, instant: int) -> None:
        """Take a packet of the stream, or what was read."""
        if type(record).__name__ != "ForceTorque":
            super().received(record, instant)
            return
        self._streamed_at = instant
        for name, value in zip(AXES, (*record.force, *record.torque), strict=True):
            self.signals[f"{self.name}.{name}"].update(value, instant)


class Ft300Twin(ModbusTwin):
    """A sensor with a load that rests: `put("fz", -12.5)`. It streams when `stream` is written, until 50 bytes FF come."""

    shipped_table: ClassVar = "robotiq_ft300"
    faults: ClassVar[Mapping[str, str]] = {**ModbusTwin.faults, "quiet": "its stream breaks off"}

    def setup(self) -> None:
        """Begin as switched on: no stream, a small load."""
        super().setup()
        for name, value in {
            "fz": -9.81,
            "mx": 0.25,
            "az": -9.80665,
            "firmware": 0x0102,
            "serial_number": "FT300TWN",
        }.items():
            self.put(name, value)
        self.put("year", 2024)
        self.is_streaming = False
        #: Bytes that were not a request, and since when they are counted (ns).
        self._rubbish, self._since = 0, 0
        self.every(PERIOD_S, self._stream)

    def was_set(self, name: str) -> None:
        """Begin to stream when the register `stream` is written."""
        super().was_set(name)
        if name == "stream" and self.take("stream") == START:
            self.is_streaming, self._rubbish = True, self._undecoded()

    def _undecoded(self) -> int:
        """Return the number of bytes that were not a request: requests that collide with the sensor's own
        packets arrive garbled.
        """
        counts = self.twins.scanner.counts
        return counts.skipped + counts.malformed

    def _stream(self) -> None:
        rubbish, now = self._undecoded(), self.clock.now()
        if rubbish - self._rubbish >= ENOUGH:
            self.is_streaming = False
        if now - self._since > BREAK_NS:
            self._rubbish, self._since = rubbish, now
        if self.is_streaming and "quiet" in self.active_faults:
            self.is_streaming = False
        if self.is_streaming:
            force, torque = ([self.take(name) for name in some] for some in (AXES[:3], AXES[3:]))
            self.reply("ForceTorque", delay_ns=0, force=force, torque=torque)


EXAMPLE = """
name = "robotiq_ft300_example"
rate_hz = 20

[buses]
wrist = { link = "serial", protocol = "modbus", baud = 19_200 }

[devices]
FT = { driver = "robotiq_ft300", bus = "wrist", credentials = { unit = 9 } }
"""

driver = Driver(
    "robotiq_ft300",
    device=Ft300,
    twin=Ft300Twin,
    example=EXAMPLE,
    doc="Robotiq's force/torque sensor FT 300: registers, or a stream of 100 Hz.",
    source="FT 300 manual; ros-industrial/robotiq rq_sensor_com.cpp",
    settings=described(Ft300Settings),
)
