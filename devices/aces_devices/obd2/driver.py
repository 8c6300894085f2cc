"""An ECU by OBD-II: live values as signals, trouble codes, the vehicle's number. It only reads.

1. Up to six values, asked for at once (SAE J1979): an ECU takes one request at a time, and late answers of two
   would be mistaken for each other.
2. Codes are not cleared from here: `aces send ClearCodes -p obd2 … --tx` does, and takes the results of tests along.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from math import pi
from typing import Annotated, Any, ClassVar

import msgspec
from msgspec import Meta

from aces_bus.device import Device, Driver, HostLoss, Job, Poll, Steps
from aces_bus.device.settings import described, settings_of
from aces_bus.errors import CallerError, UnknownNameError
from aces_bus.protocol import Record
from aces_bus.protocol.record import FieldValue
from aces_protocols.diagnostics import VALUES

from ..scanning import scan_numbers
from .twin import AT_ONCE, Obd2Twin

USUAL = ("engine_load", "coolant_temperature", "engine_speed", "vehicle_speed", "throttle", "fuel_level")


#: Units of the sheet → SI: unit, factor, offset.
SI = {
    "%": ("", 0.01, 0.0), "°C": ("K", 1.0, 273.15), "kPa": ("Pa", 1000.0, 0.0), "km": ("m", 1000.0, 0.0),
    "rpm": ("rad/s", pi / 30, 0.0), "km/h": ("m/s", 1 / 3.6, 0.0), "°": ("rad", pi / 180, 0.0),
    "g/s": ("kg/s", 0.001, 0.0), "L/h": ("m³/s", 1e-3 / 3600, 0.0),
}  # fmt: skip
#: How long an answer may take (s): it begins within 50 ms (P2, ISO 15765-4), and has several frames.
TIMEOUT_S = 0.1
#: How often values are asked for (s).
EVERY_S = 0.25


def to_si(name: str, value: FieldValue) -> Any:
    """Return a value by its name, in SI."""
    _, scale, offset = SI.get(getattr(VALUES[name][1], "unit", ""), ("", 1.0, 0.0))
    return value * scale + offset if isinstance(value, (int, float)) else value


class Obd2Settings(msgspec.Struct, frozen=True, kw_only=True):
    """The driver's own keys in a robot file."""

    values: Annotated[
        tuple[str, ...],
        Meta(description="what is asked for, by the names of the spec, 1 to 6; the usual six when absent"),
    ] = USUAL
    every_s: Annotated[
        float, Meta(gt=0, description=f"how often it is asked for (s), {EVERY_S} when absent")
    ] = EVERY_S


class Obd2(Device):
    """Signals: the values in SI units (shares 0 to 1), and codes and lamp of the monitor status."""

    protocol = "obd2"
    when_host_is_lost = HostLoss("nothing moves", "SAE J1979: services that read")
    one_at_a_time = True
    actions: ClassVar = {
        "vin": "ask for the vehicle's number",
        "supported": "ask which values it has",
        "stored_codes": "ask for the trouble codes that the lamp is on for",
        "pending_codes": "ask for codes that were seen and are not confirmed",
        "permanent_codes": "ask for codes that clearing leaves",
    }
    asking = tuple(actions)

    def setup(self) -> None:
        """Add signals, and the poll that asks for them. Raises `CallerError` for more than six values, or none."""
        settings = settings_of(self.name, Obd2Settings, self.config.settings)
        if not 1 <= len(settings.values) <= AT_ONCE:
            raise CallerError(
                f"{self.name}: values has {len(settings.values)} entries; one request asks for 1 to {AT_ONCE}"
            )
        self._add_values(settings.values, max(0.5, 5 * settings.every_s))
        pids = [VALUES[name][0] for name in settings.values]
        self.polls = (
            Poll(
                "ReadLive",
                reply="Live",
                fields={"pids": pids},
                every_s=settings.every_s,
                timeout_s=TIMEOUT_S,
            ),
        )

    def _add_values(self, names: Iterable[str], stale_s: float) -> None:
        """Add a signal for each value; raise `UnknownNameError` for an unknown name."""
        self._wanted = tuple(names)
        for name in self._wanted:
            if name not in VALUES:
                raise UnknownNameError(f"value of {self.name}", name, VALUES)
            unit, _, _ = SI.get(sheet := getattr(VALUES[name][1], "unit", ""), (sheet, 1.0, 0.0))
            shown = f"{name.replace('_', ' ')}{', 0 to 1' if sheet == '%' else ''}"
            for part in ("codes", "lamp") if name == "monitor_status" else (name,):
                doc = {"codes": "number of stored codes", "lamp": "the warning lamp is on"}.get(part, shown)
                self.add_signal(
                    part, unit=unit, read_from=("Live",), stale_s=stale_s, doc=doc, source="SAE J1979"
                )

    def received(self, record: Record, instant: int) -> None:
        """Take the values of an answer that have signals."""
        if type(record).__name__ != "Live":
            return
        for item in record.values:
            if item.reason is not None or item.kind not in self._wanted:
                continue
            if item.kind == "monitor_status":
                self.signals[f"{self.name}.codes"].update(item.data.codes, instant)
                self.signals[f"{self.name}.lamp"].update(bool(item.data.lamp), instant)
            else:
                self.signals[f"{self.name}.{item.kind}"].update(to_si(item.kind, item.data), instant)

    def _asked(self, message: str, reply: str, taken: Callable[[Any], Any], **fields: Any) -> Job:
        def steps(job: Job) -> Steps:
            return taken((yield self.ask(message, reply=reply, timeout_s=TIMEOUT_S, **fields)))

        return self.job(message, steps)

    def vin(self) -> Job:
        """Return the vehicle's identification number."""
        return self._asked("ReadInfo", "Vin", lambda record: record.vin, what="vin")

    def stored_codes(self) -> Job:
        """Read the codes that the lamp is on for, as text."""
        return self._asked("ReadStoredCodes", "StoredCodes", lambda record: list(record.codes))

    def pending_codes(self) -> Job:
        """Read the codes that were seen and are not confirmed, as text."""
        return self._asked("ReadPendingCodes", "PendingCodes", lambda record: list(record.codes))

    def permanent_codes(self) -> Job:
        """Read the codes that clearing leaves, as text."""
        return self._asked("ReadPermanentCodes", "PermanentCodes", lambda record: list(record.codes))

    def supported(self) -> Job:
        """Return the names of the values that it has; those without one as pid_A6."""

        def steps(job: Job) -> Steps:
            names: list[str] = []
            for first in (0x00, 0x20, 0x40):
                kind, more = f"supported_{first + 1:02X}", False
                record = yield self.ask("ReadLive", reply="Live", timeout_s=TIMEOUT_S, pids=[first])
                for item in record.values:
                    if item.kind == kind:
                        names += [name for name in item.data if name != "more"]
                        more = item.data.more
                if not more:
                    break
            return names

        return self.job("supported", steps)


EXAMPLE = """
name = "obd2"
rate_hz = 20

[buses]
can = { link = "can", protocol = "obd2", bitrate = 500_000 }

[devices]
ENGINE = { driver = "obd2", bus = "can", credentials = { ecu = 0 } }
GEARBOX = { driver = "obd2", bus = "can", credentials = { ecu = 1 }, settings = { values = ["monitor_status", "throttle"] } }
"""

driver = Driver(
    "obd2",
    device=Obd2,
    twin=Obd2Twin,
    example=EXAMPLE,
    doc="A car's ECU by OBD-II: live values, trouble codes, the vehicle's number.",
    source="SAE J1979 / ISO 15031-5; ISO 15765-4",
    # Which values it has.
    scan=scan_numbers(
        "obd2", "ECU", "ecu", range(8), "ReadLive", reply="Live", timeout_s=TIMEOUT_S, retries=0, pids=[0]
    ),
    settings=described(Obd2Settings),
)
