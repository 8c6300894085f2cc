"""What a simulated ECU measures and remembers, whatever it is asked by: values, the vehicle's number, trouble codes."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field
from typing import Any

from aces_bus.device.config import DeviceConfig
from aces_bus.device.twin import World
from aces_bus.protocol.record import FieldValue
from aces_protocols.diagnostics import VALUES


@dataclass
class EcuModel:
    """An ECU's measured values in the sheet's units, the vehicle's number, and its codes with the bits of their status."""

    values: dict[str, FieldValue] = field(
        default_factory=lambda: {
            "engine_load": 34.9, "coolant_temperature": 83, "short_fuel_trim": 0, "long_fuel_trim": -2.34375,
            "intake_pressure": 35, "engine_speed": 1726, "vehicle_speed": 50, "timing_advance": 12.5,
            "intake_temperature": 21, "air_flow": 12.34, "throttle": 20, "standard": "EOBD", "run_time": 600,
            "distance_with_lamp": 0, "fuel_level": 60, "distance_since_clear": 1234, "barometric_pressure": 101,
            "module_voltage": 13.8, "ambient_temperature": 18, "oil_temperature": 90, "fuel_rate": 2.5,
        }
    )  # fmt: skip
    vin: str = "1D4GP00R55B123456"
    #: Code → bits of its status (ISO 14229-1).
    codes: dict[str, set[str]] = field(
        default_factory=lambda: {"P0301": {"failed", "pending", "confirmed"}, "P0420": {"pending"}}
    )
    permanent: set[str] = field(default_factory=lambda: {"P0301"})

    def with_status(self, bits: Collection[str]) -> list[str]:
        """Return the codes that have one of these bits."""
        return sorted(code for code, status in self.codes.items() if not status.isdisjoint(bits))

    def value(self, kind: str) -> Any:
        """Return what a list of values has of a kind; None where this ECU does not have it."""
        if kind == "monitor_status":
            stored = self.with_status({"confirmed"})
            return {"codes": len(stored), "lamp": int(bool(stored))}
        return self.values.get(kind)

    def mask(self, first: int) -> list[str]:
        """Return which of the 32 values behind `first` there are, and whether some are behind them."""
        mine = {"monitor_status", *self.values}
        names = [name for name, (pid, _) in VALUES.items() if name in mine and first < pid < first + 32]
        return [*names, *(["more"] if any(VALUES[name][0] > first + 32 for name in mine) else [])]


def ecu_of(world: World, config: DeviceConfig) -> EcuModel:
    """Return the ECU that a twin is: the same one for all twins with its number on its bus. It outlives power-off."""
    key = f"ecu {config.credentials['ecu']} of {config.bus}"
    found: EcuModel = world.shared.setdefault(key, EcuModel())
    return found
