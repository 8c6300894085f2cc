"""The smart power controller: voltage, current and power of the robot; alarm and beeper.

1. It is asked 20 times a second unless the robot's file says otherwise: a battery is slow.
2. A low battery is reported once, and again when it is over by half a volt.
"""

from __future__ import annotations

from typing import Annotated, ClassVar

import msgspec
from msgspec import Meta

from aces_bus.device import Device, Driver, HostLoss, Job, Poll, Steps, Ticket
from aces_bus.device.config import DeviceConfig
from aces_bus.device.host import Host
from aces_bus.device.settings import described, settings_of
from aces_bus.errors import CallerError
from aces_bus.protocol import Record

from .twin import PowerTwin

#: How often it is asked (s): hubo-ach asks twice in each cycle of 5 ms.
EVERY_S = 0.05
#: Where a low battery is reported (V), and by how much it must recover. No sheet has it: 3.67 V a cell of a 12-cell pack.
LOW_V, RECOVERED_V = 44.0, 0.5
SOUNDS = ("off", "sound_1", "sound_2", "sound_3", "sound_4")


class PowerSettings(msgspec.Struct, frozen=True, kw_only=True):
    """The driver's own keys in a robot file."""

    every_s: Annotated[float, Meta(gt=0, description=f"how often it is asked (s), {EVERY_S} when absent")] = (
        EVERY_S
    )
    low_voltage_v: Annotated[
        float, Meta(description=f"below this a low battery is reported (V), {LOW_V:g} when absent")
    ] = LOW_V


class PowerBoard(Device):
    """Signals: voltage (V), current (A), power (W)."""

    protocol = "hubo"
    when_host_is_lost = HostLoss("nothing moves", "a supply; hubo-ach states no time-out")
    actions: ClassVar = {
        "alarm": "sound the alarm: 1 to 4, by default 1",
        "quiet": "end the alarm",
        "beep": "beep, by default for 0.3 s",
    }

    def setup(self) -> None:
        """Add three signals and one poll, as often as the settings say."""
        settings = settings_of(self.name, PowerSettings, self.config.settings)
        every, self.low_v = settings.every_s, settings.low_voltage_v
        self.is_low = False
        self.polls = (Poll("PowerQuery", reply="Power", every_s=every),)
        for name, unit in (("voltage", "V"), ("current", "A"), ("power", "W")):
            self.add_signal(
                name, unit=unit, of=f"Power.{name}", stale_s=max(0.1, 5 * every), source="hubo-ach"
            )

    def received(self, record: Record, instant: int) -> None:
        """Take the battery's voltage, and report when it becomes low."""
        if type(record).__name__ != "Power":
            return
        voltage = record.voltage
        if not self.is_low and voltage < self.low_v:
            self.is_low = True
            self.emit_event("alarm", f"low battery: {voltage:.1f} V, below {self.low_v:g} V")
        elif self.is_low and voltage > self.low_v + RECOVERED_V:
            self.is_low = False
            self.emit_event("alarm over", f"battery: {voltage:.1f} V")

    def alarm(self, sound: int = 1) -> Ticket:
        """Sound the alarm: 1 to 4; 0 ends it. Raises `CallerError` for another sound."""
        if not 0 <= int(sound) < len(SOUNDS):
            raise CallerError(f"{self.name}: there is no alarm {sound}; there are 1 to 4, and 0 for none")
        return self.send("Alarm", sound=SOUNDS[int(sound)])

    def quiet(self) -> Ticket:
        """End the alarm."""
        return self.alarm(0)

    def beep(self, seconds: float = 0.3) -> Ticket:
        """Beep for up to 25.5 s. Raises `FieldError` for longer."""
        return self.send("Beep", time=float(seconds))


def _scan(host: Host, job: Job) -> Steps:
    """Look for the power board: one number of D12; older robots have no such board."""
    variant = host.variants["hubo"]
    found: list[DeviceConfig] = []
    if variant.dialect != "D12":
        return found
    table = variant.tables["channels"]
    for board in [number for number, kind in table.items() if kind == "power"]:
        who = {"board": board}
        if (yield from host.answers("hubo", who, "PowerQuery", reply="Power", timeout_s=0.03)):
            config = DeviceConfig(
                name="JMC14", driver="hubo_power", bus=host.name, credentials=who, kind="power"
            )
            found.append(config)
    return found


EXAMPLE = """
name = "hubo_power"
rate_hz = 50

[buses]
upper = { link = "can", protocol = "hubo", dialect = "D12" }

[devices]
JMC14 = { driver = "hubo_power", bus = "upper", credentials = { board = 0x0E }, kind = "power" }
"""

driver = Driver(
    "hubo_power",
    device=PowerBoard,
    twin=PowerTwin,
    example=EXAMPLE,
    doc="Hubo's smart power controller: voltage, current, power; alarm and beeper.",
    source="hubo-ach; HuboCan",
    scan=_scan,
    settings=described(PowerSettings),
)
