"""The twin of an ECU that answers OBD-II.

1. It answers what it has, and is silent about the rest, as SAE J1979 has it for values on CAN.
2. Codes outlive power-off; permanent ones outlive being cleared.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field
from typing import Any, ClassVar

from aces_bus.device import Twin, on
from aces_protocols.diagnostics import KINDS, VALUES

BY_PID = {pid: name for name, (pid, _) in KINDS.items()}
#: A request asks for up to so many values (SAE J1979).
AT_ONCE = 6


@dataclass
class EcuModel:
    """An ECU's measured values in the sheet's units, the vehicle's number, and its codes with the bits of their status."""

    values: dict[str, Any] = field(
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
        """The codes that have one of these bits."""
        return sorted(code for code, status in self.codes.items() if not status.isdisjoint(bits))

    def value(self, kind: str) -> Any:
        """What a list of values has of a kind; None where this ECU does not have it."""
        if kind == "monitor_status":
            stored = self.with_status({"confirmed"})
            return {"codes": len(stored), "lamp": int(bool(stored))}
        return self.values.get(kind)

    def mask(self, first: int) -> list[str]:
        """Which of the 32 values behind `first` there are, and whether some are behind them."""
        mine = {"monitor_status", *self.values}
        names = [name for name, (pid, _) in VALUES.items() if name in mine and first < pid < first + 32]
        return [*names, *(["more"] if any(VALUES[name][0] > first + 32 for name in mine) else [])]


class Obd2Twin(Twin):
    """One ECU: `ecu.values["engine_speed"] = 3000` (the sheet's units), `ecu.codes`, `ecu.vin`."""

    protocol = "obd2"
    faults: ClassVar = {"misfire": "cylinder 2 misfires: P0302 is stored, and the lamp is on"}

    def setup(self) -> None:
        """What it had stored it has."""
        if not hasattr(self, "ecu"):
            self.ecu = EcuModel()

    def kept(self) -> None:
        """Store what is wrong now."""
        if "misfire" in self.active_faults:
            self.ecu.codes["P0302"] = {"failed", "pending", "confirmed"}

    @on("ReadLive", "ReadLiveAll")
    def tell_values(self, request: Any) -> None:
        """The values that it has of up to six; nothing when it has none of them."""
        self.kept()
        values: list[dict[str, Any]] = []
        for pid in request.pids if len(request.pids) <= AT_ONCE else ():
            kind = BY_PID.get(pid, "")
            data = self.ecu.mask(pid) if kind.startswith("supported") else self.ecu.value(kind)
            if data is not None and data != []:
                values.append({"kind": kind, "data": data})
        if values:
            self.reply("Live", values=values)

    @on("ReadStoredCodes", "ReadStoredCodesAll")
    def tell_stored(self, request: Any) -> None:
        """Confirmed codes."""
        self.kept()
        self.reply("StoredCodes", codes=self.ecu.with_status({"confirmed"}))

    @on("ReadPendingCodes", "ReadPendingCodesAll")
    def tell_pending(self, request: Any) -> None:
        """Codes of this or the last drive."""
        self.kept()
        self.reply("PendingCodes", codes=self.ecu.with_status({"pending"}))

    @on("ReadPermanentCodes", "ReadPermanentCodesAll")
    def tell_permanent(self, request: Any) -> None:
        """Codes that nobody clears."""
        self.reply("PermanentCodes", codes=sorted(self.ecu.permanent))

    @on("ClearCodes", "ClearCodesAll")
    def clear(self, request: Any) -> None:
        """No codes any more, but permanent ones."""
        self.ecu.codes.clear()
        self.reply("CodesCleared")

    @on("ReadInfo", "ReadInfoAll")
    def tell_info(self, request: Any) -> None:
        """The vehicle's number, its software, its name."""
        match request.what:
            case "supported":
                self.reply("SupportedInfo", types=["vin", "calibrations", "ecu_name"])
            case "vin":
                self.reply("Vin", vin=self.ecu.vin)
            case "calibrations":
                self.reply("Calibrations", names=["ACES-TWIN-1"])
            case "ecu_name":
                self.reply("EcuName", name="ECM\0-EngineControl")
            case _:
                pass
