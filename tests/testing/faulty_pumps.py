"""A pump on CAN and on a serial line, its sound twin, and twins with one fault each, as firmware has them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

from construct import Byte, GreedyBytes, Int16sl, Int16ul, Struct, this

from aces_bus.device import Device, Driver, Job, Poll, Steps, Twin, on, signal
from aces_bus.errors import DeviceError
from aces_bus.protocol import Enumeration, IdField, InvertedSum, Protocol, Quantity
from aces_bus.runtime.clock import Timer
from aces_lab.device_fuzz.trial import Expectations

#: Without a set-point for so long (ns) the pump stops.
WATCHDOG_NS = 200_000_000

SPEED = Struct("speed" / Quantity(Int16sl, unit="rpm", range=(-3000, 3000)))
PAYLOADS: Mapping[str, Any] = {
    "Ask": None,
    "SetSpeed": SPEED,
    "Configure": Struct("key" / Byte, "value" / Int16ul),
    "Read": Struct("address" / Byte),
    "Begin": None,
    "Data": Struct("data" / GreedyBytes),
    "Finish": None,
}
ANSWERS: Mapping[str, Any] = {
    "State": Struct(
        "state" / Enumeration(Byte, idle=0, running=1, loading=2), *SPEED.subcons, "commands" / Byte
    ),
    "Value": Struct("address" / Byte, "pressure" / Quantity(Int16ul, unit="mbar", range=(0, 4000))),
}

can_pump = Protocol("can_pump", link="can", bitrate=500_000)
Node = IdField("node", range(1, 16))
for _number, (_name, _payload) in enumerate(PAYLOADS.items()):
    _lengths = range(8) if _name == "Data" else None
    can_pump.message(
        _name, id=0x100 + 0x10 * _number + Node, direction="to device", payload=_payload, length=_lengths
    )
for _number, (_name, _payload) in enumerate(ANSWERS.items()):
    can_pump.message(_name, id=0x200 + 0x10 * _number + Node, direction="from device", payload=_payload)

serial_pump = Protocol("serial_pump", link="serial", baud=115_200, half_duplex=True)
packet = serial_pump.framing(
    sync=b"\xa5\x5a",
    header=Struct("node" / Byte, "length" / Byte),
    size=this.length + 5,
    max_size=40,
    gap=0.02,
    check=InvertedSum(),
)
for _number, (_name, _payload) in enumerate([*PAYLOADS.items(), *ANSWERS.items()]):
    packet(
        _name,
        direction="to device" if _name in PAYLOADS else "from device",
        prefix=Struct("kind" / Byte),
        match={"kind": _number},
        payload=_payload,
    )


class Pump(Device):
    """A pump."""

    protocol: ClassVar[str | Protocol] = can_pump
    polls: Sequence[Poll] = (Poll("Ask", reply="State"),)
    provides = (
        signal("speed", unit="rpm", of="State.speed", set="SetSpeed.speed", lower=-3000, upper=3000),
        signal("state", of="State.state"),
    )
    actions: ClassVar[Mapping[str, str]] = {"turn": "let it turn for a moment", "halt": "stop it"}

    def halt(self) -> Any:
        """Stop."""
        self.drop("SetSpeed")
        return self.send_now("SetSpeed", speed=0)

    stop_motion = halt

    def confirm_stopped(self) -> Job:
        """It says that it does not turn."""

        def steps(job: Job) -> Steps:
            state = yield self.ask("Ask", reply="State")
            if state.speed:
                raise DeviceError(f"it still turns at {state.speed} rpm")

        return self.job("check that it stopped", steps)

    def turn(self) -> Job:
        """It must be at 100 rpm when that was set."""

        def steps(job: Job) -> Steps:
            yield self.send("SetSpeed", speed=100)
            yield 10_000_000
            state = yield self.ask("Ask", reply="State")
            if state.speed != 100:
                raise DeviceError(f"its speed is {state.speed} rpm, not 100")
            yield self.halt()

        return self.job("turn", steps)


class SerialPump(Pump):
    """The same on a line."""

    protocol = serial_pump


class PumpTwin(Twin):
    """A pump without a fault. Its hooks are where firmware goes wrong."""

    protocol: ClassVar[str | Protocol] = can_pump

    def setup(self) -> None:
        self.state: str | int = "idle"
        self.speed = self.commands = 0
        self.watchdog: Timer | None = None
        self.loaded = b""
        self.is_hung = False

    def receive(self, record: Any, instant: int) -> None:
        if not self.is_hung:
            super().receive(record, instant)

    @on("Ask")
    def answer(self, request: Any) -> None:
        self.report()

    def report(self) -> None:
        self.reply("State", state=self.state, speed=self.speed, commands=self.commands)

    @on("SetSpeed")
    def change(self, request: Any) -> None:
        if abs(request.speed) > 3000:
            return
        self.state, self.speed, self.commands = "running", request.speed, (self.commands + 1) & 0xFF
        self.watch()

    def watch(self) -> None:
        if self.watchdog is not None:
            self.watchdog.cancel()
        self.watchdog = self.clock.call_in(WATCHDOG_NS, self.unheard)

    def unheard(self) -> None:
        self.state, self.speed = "idle", 0

    @on("Configure")
    def configure(self, request: Any) -> None:
        """Nothing that shows."""

    @on("Read")
    def read(self, request: Any) -> None:
        self.reply("Value", address=request.address, pressure=1000)

    @on("Begin")
    def begin(self, request: Any) -> None:
        self.state, self.loaded = "loading", b""
        self.watch()

    @on("Data")
    def data(self, request: Any) -> None:
        if self.state == "loading":
            self.loaded += request.data[:8]

    @on("Finish")
    def finish(self, request: Any) -> None:
        if self.state == "loading":
            self.state = "idle"


# ---------------------------------------------------------------------- one fault each


class HangsOnABoundary(PumpTwin):
    """The largest value of one setting is an endless loop."""

    def configure(self, request: Any) -> None:
        self.is_hung = request.key == 0 and request.value == 0xFFFF


class StopsAfterManyRequests(PumpTwin):
    """A leak: each answer takes a buffer that is never given back."""

    def report(self) -> None:
        if self.requests <= 90:
            super().report()


class CrashesOnShortData(PumpTwin):
    """It looks at the second byte of what may have one."""

    def data(self, request: Any) -> None:
        self.loaded += bytes((request.data[0] ^ request.data[1],))


class SwapsBytes(PumpTwin):
    """An address above 127 is answered by other code, in another byte order."""

    def read(self, request: Any) -> None:
        if request.address < 128:
            super().read(request)
            return
        packet = self.twins.packet(self, "Value", {"address": request.address, "pressure": 0x0101})
        self.send_raw(changed(packet, b"\x01\x01", b"\xe8\x0f"))


class AnswersAnothersNumber(PumpTwin):
    """After it turned backwards it answers with the next number."""

    def report(self) -> None:
        if self.speed >= 0:
            super().report()
        else:
            self.send_raw(
                self.twins.packet(self, "State", self.shown() | {"node": self.credentials["node"] + 1})
            )

    def shown(self) -> dict[str, Any]:
        """What its state says."""
        return {"state": self.state, "speed": self.speed, "commands": self.commands}


class IsOneTooMuch(PumpTwin):
    """At the end of its range it reports one more."""

    def report(self) -> None:
        if self.speed != 3000:
            super().report()
            return
        packet = self.twins.packet(
            self, "State", {"state": "running", "speed": 3000, "commands": self.commands}
        )
        self.send_raw(changed(packet, b"\xb8\x0b", b"\xb9\x0b"))


class IsStuck(PumpTwin):
    """A load that is begun twice is never over: it answers, and follows nothing any more."""

    def begin(self, request: Any) -> None:
        self.is_stuck = self.state == "loading"
        super().begin(request)

    def change(self, request: Any) -> None:
        if not getattr(self, "is_stuck", False):
            super().change(request)


class Overflows(PumpTwin):
    """Its count of commands has eight bits on the wire, and more inside."""

    def change(self, request: Any) -> None:
        count = self.commands
        super().change(request)
        self.commands = count + 1


class AnswersTwice(PumpTwin):
    """A setting that is for diagnosis has it answer on both its ports, which are one."""

    def configure(self, request: Any) -> None:
        self.doubles = request.value == 0

    def report(self) -> None:
        super().report()
        if getattr(self, "doubles", False):
            super().report()


class NeverRests(PumpTwin):
    """A set-point during a load takes the watchdog away, and starts none."""

    def change(self, request: Any) -> None:
        was_loading = self.state == "loading"
        super().change(request)
        if was_loading and self.watchdog is not None:
            self.watchdog.cancel()


class IsAByteShort(PumpTwin):
    """After a load its state has a byte less."""

    def report(self) -> None:
        if not self.loaded:
            super().report()
            return
        self.fault("short")
        super().report()
        self.fault("short", on=False)


class HasNoName(PumpTwin):
    """A load that is finished before it was begun is a state that nothing names."""

    def finish(self, request: Any) -> None:
        self.state = "idle" if self.state == "loading" else 9


def changed(packet: Any, old: bytes, new: bytes) -> Any:
    """A frame or packet with other bytes in one place, and the check that goes with them."""
    from msgspec.structs import replace

    if isinstance(packet, bytes):
        inner = packet[2:-1].replace(old, new)
        return packet[:2] + inner + bytes((~sum(inner) & 0xFF,))
    return replace(packet, data=packet.data.replace(old, new))


@dataclass(frozen=True)
class PlantedFault:
    """A twin with a fault; what the fault is called; how many packets it takes at most; what else must hold."""

    twin: type[PumpTwin]
    kind: str
    packets: int
    expected: Expectations = field(default_factory=Expectations)

    def __str__(self) -> str:
        return self.twin.__name__


FAULTS = (
    PlantedFault(HangsOnABoundary, "silent", 1),
    PlantedFault(StopsAfterManyRequests, "silent", 90),
    PlantedFault(CrashesOnShortData, "raises", 1),
    PlantedFault(SwapsBytes, "out of range", 1),
    PlantedFault(AnswersAnothersNumber, "another's", 1),
    PlantedFault(IsOneTooMuch, "out of range", 1),
    PlantedFault(IsStuck, "does not follow", 2, Expectations(actions=("turn",))),
    PlantedFault(Overflows, "raises", 256),
    PlantedFault(AnswersTwice, "twice", 1),
    PlantedFault(NeverRests, "not at rest", 2, Expectations(rests_ns=2 * WATCHDOG_NS)),
    PlantedFault(IsAByteShort, "malformed", 2),
    PlantedFault(HasNoName, "out of range", 1),
)

ROBOT = """
name = "cellar"
rate_hz = 50
[buses]
line = { link = "can", protocol = "can_pump" }
[devices]
P1 = { driver = "can_pump", bus = "line", credentials = { node = 3 } }
"""


def pump(twin: type[PumpTwin] = PumpTwin, link: str = "can") -> Driver:
    """The driver of a pump with this twin, on CAN or on a serial line."""
    if link == "can":
        return Driver("can_pump", Pump, twin, ROBOT, doc="a pump", source="invented for tests")
    made = type(twin.__name__, (twin,), {"protocol": serial_pump})
    text = ROBOT.replace('"can"', '"serial"').replace("can_pump", "serial_pump")
    return Driver("serial_pump", SerialPump, made, text, doc="a pump", source="invented for tests")


Load = Callable[[str], Driver]


__all__ = ["FAULTS", "PlantedFault", "PumpTwin", "pump"]
