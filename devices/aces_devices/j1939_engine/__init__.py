"""An engine's control unit on SAE J1939: values in SI units, lamps, faults; hours, name and number on request.

1. Values come without being asked. One that its control unit does not have, or has an error for, is unknown.
2. A request names a parameter group; the unit sends it to all, or refuses it.
3. It only reads: torque and speed commands (TSC1) are not declared.

Source: as the spec's.
"""

from __future__ import annotations

from math import pi
from typing import Any, ClassVar

from aces_bus.device import Device, Driver, HostLoss, Job, Steps, signal
from aces_bus.errors import DeviceError
from aces_protocols.j1939.spec import GROUPS

from .twin import EngineTwin

RPM, KPA, KELVIN, KM_H, PERCENT, L_H = pi / 30, 1000.0, 273.15, 1 / 3.6, 0.01, 1e-3 / 3600
#: How long an answer may take (s): it begins within 0.2 s (J1939-21, Tr), and has up to five frames 0.2 s apart.
ANSWER_S = 1.25
#: How long values are fresh (s): of groups that come up to ten times a second, twice, and once.
QUICK_S, HALF_S, SLOW_S = 0.5, 2.5, 5.0
LAMPS = ("malfunction", "red_stop", "amber_warning", "protect")


def _value(name: str, of: str, unit: str, scale: float, stale_s: float, doc: str, offset: float = 0.0) -> Any:
    return signal(
        name, unit=unit, of=of, scale=scale, offset=offset, stale_s=stale_s, doc=doc, source="J1939-71"
    )


class Engine(Device):
    """Signals: see the README. `faults` are those of the last DM1: (SPN, FMI, count)."""

    protocol = "j1939"
    when_host_is_lost = HostLoss("nothing moves", "J1939: it is only read and asked")
    one_at_a_time = True
    provides = (
        _value("speed", "EngineController1.speed", "rad/s", RPM, QUICK_S, "of the crankshaft"),
        _value(
            "torque",
            "EngineController1.torque",
            "",
            PERCENT,
            QUICK_S,
            "of its reference torque, −1.25 … 1.25",
        ),
        _value("pedal", "EngineController2.pedal", "", PERCENT, QUICK_S, "accelerator pedal, 0 … 1"),
        _value(
            "load", "EngineController2.load", "", PERCENT, QUICK_S, "of the torque that it has at this speed"
        ),
        _value("vehicle_speed", "VehicleSpeed.speed", "m/s", KM_H, QUICK_S, "by the wheels"),
        _value("fuel_rate", "FuelEconomy.rate", "m³/s", L_H, QUICK_S, "fuel that flows"),
        _value("throttle", "FuelEconomy.throttle", "", PERCENT, QUICK_S, "position of the throttle, 0 … 1"),
        _value("oil_pressure", "EngineFluids.oil_pressure", "Pa", KPA, HALF_S, "of the engine's oil"),
        _value(
            "fuel_pressure", "EngineFluids.fuel_pressure", "Pa", KPA, HALF_S, "of the fuel before the pump"
        ),
        _value(
            "coolant_temperature", "EngineTemperature.coolant", "K", 1.0, SLOW_S, "of the coolant", KELVIN
        ),
        _value("oil_temperature", "EngineTemperature.oil", "K", 1.0, SLOW_S, "of the engine's oil", KELVIN),
        _value("fuel_temperature", "EngineTemperature.fuel", "K", 1.0, SLOW_S, "of the fuel", KELVIN),
        _value("voltage", "VehiclePower.battery", "V", 1.0, SLOW_S, "of the battery"),
    )
    actions: ClassVar = {
        "vin": "ask for the vehicle's number",
        "identity": "ask for the control unit's name",
        "hours": "ask how long the engine has run",
    }
    asking = tuple(actions)
    attributes: ClassVar = Device.attributes | {"faults"}

    @property
    def sends_every_s(self) -> float | None:
        """Seconds from one of its messages to the next."""
        return 0.1

    def setup(self) -> None:
        """Add the signals of lamps and faults."""
        self.faults: tuple[tuple[int, int, int], ...] = ()
        self._alarms: set[str] = set()
        known: dict[str, Any] = {"read_from": ["ActiveFaults"], "stale_s": SLOW_S, "source": "J1939-73, DM1"}
        for lamp in LAMPS:
            self.add_signal(lamp, doc=f"0 or 1: the lamp {lamp.replace('_', ' ')} is on", **known)
        self.add_signal("fault_count", doc="number of active faults", **known)

    def received(self, record: Any, instant: int) -> None:
        """Take the faults."""
        if type(record).__name__ != "ActiveFaults":
            return
        for lamp in LAMPS:
            state = getattr(record.lamps, lamp)
            if state in ("on", "off"):
                self.signals[f"{self.name}.{lamp}"].update(int(state == "on"), instant)
            else:
                self.signals[f"{self.name}.{lamp}"].forget()
        self.faults = tuple((f.spn, f.fmi, f.count) for f in record.faults if f.spn)
        self.signals[f"{self.name}.fault_count"].update(len(self.faults), instant)
        alarms = {f"SPN {spn} FMI {fmi}" for spn, fmi, _ in self.faults}
        self.emit_alarms(alarms, self._alarms)
        self._alarms = alarms

    def _group(self, name: str) -> Steps:
        """Yield the steps that ask for a parameter group; raise `DeviceError` if it is refused."""
        answer = yield self.ask(
            "Request", reply=(name, "Acknowledgement"), timeout_s=ANSWER_S, priority=6, pgn=GROUPS[name]
        )
        if type(answer).__name__ == "Acknowledgement":
            raise DeviceError(f"{self.name}: {name} is {answer.control}")
        return answer

    def vin(self) -> Job:
        """Return the vehicle's number."""

        def steps(job: Job) -> Steps:
            record = yield from self._group("VehicleIdentification")
            return record.number.partition(b"*")[0].decode("ascii", "replace")

        return self.job("vin", steps)

    def hours(self) -> Job:
        """Return how long the engine has run (s), None where its control unit does not know."""

        def steps(job: Job) -> Steps:
            record = yield from self._group("EngineHours")
            return None if record.running is None else 3600 * record.running

        return self.job("hours", steps)

    def identity(self) -> Job:
        """Return the control unit's name by its parts: {"identity": …, "manufacturer": …, "function": …, …}."""

        def steps(job: Job) -> Steps:
            record = yield from self._group("AddressClaimed")
            names = (
                "identity",
                "manufacturer",
                "ecu_instance",
                "function_instance",
                "function",
                "system",
                "industry",
            )
            return {name: getattr(record, name) for name in names}

        return self.job("identity", steps)


EXAMPLE = """
name = "j1939_engine"
rate_hz = 20

[buses]
truck = { link = "can", protocol = "j1939", bitrate = 250_000 }

[devices]
ENGINE = { driver = "j1939_engine", bus = "truck", credentials = { ecu = 0, tool = 249 } }
SECOND = { driver = "j1939_engine", bus = "truck", credentials = { ecu = 1, tool = 249 } }
"""

driver = Driver(
    "j1939_engine",
    device=Engine,
    twin=EngineTwin,
    example=EXAMPLE,
    doc="An engine's control unit on SAE J1939.",
    source="SAE J1939-21, -71, -73, -81",
)

__all__ = ["EXAMPLE", "Engine", "driver"]
