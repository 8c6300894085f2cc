"""The twin of a diesel engine's control unit: a pedal, a crankshaft that follows, heat, fuel, faults.

1. Groups come at the rates of J1939-71: EEC1 each 20 ms, EEC2 each 50, CCVS and LFE each 100, EFL/P1 each 500, ET1, VEP1
   and DM1 each second. Hours, number and name come on request; what it does not have it refuses, if it was asked by itself.
2. It claims its address when it is powered, and keeps it: a contender is not answered.
3. The engine is a choice: idle at 650 rpm, 2200 rpm at full pedal, half a second behind; warm at 85 °C after minutes.
"""

from __future__ import annotations

import math
from typing import Any, ClassVar

from aces_bus.device import Twin, on
from aces_protocols.j1939.spec import GROUPS

IDLE_RPM, MOST_RPM, FOLLOWS_S = 650.0, 2200.0, 0.5
COLD_C, WARM_C, WARMS_S = 20.0, 85.0, 120.0
#: Liters an hour at idle and at full load; metres a second of the vehicle at full speed.
IDLE_L_H, FULL_L_H, FASTEST_KM_H = 2.0, 40.0, 90.0


class EngineTwin(Twin):
    """One engine: `pedal` (0 … 1); `active` are its faults: SPN, FMI → count."""

    protocol = "j1939"
    faults: ClassVar = {
        "hot": "the coolant has 110 °C: SPN 110, FMI 0, and the lamp red stop",
        "no_oil": "the oil has no pressure: SPN 100, FMI 1, and the lamp red stop",
        "blind": "its sensors fail: temperatures and pressures are not available",
    }

    def setup(self) -> None:
        """Power up: claim the address, idle."""
        self.pedal = 0.0
        self.rpm, self.hours = IDLE_RPM, 5000.0
        self.active: dict[tuple[int, int], int] = {}
        self.vin = "1XKDD49X0AJ123456"
        self.name_fields: dict[str, Any] = {
            "identity": 1000 + self.credentials.get("ecu", 0), "manufacturer": 666, "ecu_instance": 0, "function": 0,
            "function_instance": 0, "system": 0, "system_instance": 0, "industry": "on_highway", "arbitrary_address": 0,
        }  # fmt: skip
        self._since = self._powered = self.clock.now()
        for period_s, name in (
            (0.02, "EngineController1"), (0.05, "EngineController2"), (0.1, "VehicleSpeed"), (0.1, "FuelEconomy"),
            (0.5, "EngineFluids"), (1.0, "EngineTemperature"), (1.0, "VehiclePower"), (1.0, "ActiveFaults"),
        ):  # fmt: skip
            self.every(period_s, lambda name=name: self.say(name))  # type: ignore[misc]
        self.clock.post(self.clock.now(), lambda: self.say("AddressClaimed"))

    # ------------------------------------------------------------------ the engine

    def _run(self) -> None:
        """Let the engine run until now."""
        now = self.clock.now()
        passed = (now - self._since) / 1e9
        self._since = now
        goal = IDLE_RPM + (MOST_RPM - IDLE_RPM) * self.pedal
        self.rpm += (goal - self.rpm) * -math.expm1(-passed / FOLLOWS_S)
        self.hours += passed / 3600

    @property
    def coolant_c(self) -> float:
        """Its temperature (°C)."""
        if "hot" in self.active_faults:
            return 110.0
        passed = (self.clock.now() - self._powered) / 1e9
        return WARM_C + (COLD_C - WARM_C) * math.exp(-passed / WARMS_S)

    def current_faults(self) -> dict[tuple[int, int], int]:
        """Return the active faults: those that were set, and those that its state brings."""
        found = dict(self.active)
        found.update({(110, 0): 1} if "hot" in self.active_faults else {})
        found.update({(100, 1): 1} if "no_oil" in self.active_faults else {})
        return found

    def fields_of(self, name: str) -> dict[str, Any]:
        """Return the fields of a parameter group, as they are now."""
        self._run()
        share = (self.rpm - IDLE_RPM) / (MOST_RPM - IDLE_RPM)
        load = min(1.0, 0.1 + 0.9 * self.pedal)
        is_blind = "blind" in self.active_faults
        oil = 0.0 if "no_oil" in self.active_faults else 200.0 + 250.0 * share
        match name:
            case "EngineController1":
                mode = {"torque_mode": 1, "torque_eighths": 0}
                torque = round(100 * load)
                return {"mode": mode, "demanded_torque": torque, "torque": torque, "speed": self.rpm}
            case "EngineController2":
                return {"pedal": 100 * self.pedal, "load": round(100 * load)}
            case "VehicleSpeed":
                return {"speed": FASTEST_KM_H * share}
            case "FuelEconomy":
                return {"rate": IDLE_L_H + (FULL_L_H - IDLE_L_H) * share * load, "throttle": 100 * load}
            case "EngineFluids":
                known = {"fuel_pressure": 400.0, "oil_pressure": oil}
                pressures = dict.fromkeys(known) if is_blind else known
                return {**pressures, "oil_level": 80.0}
            case "EngineTemperature":
                coolant = round(self.coolant_c)
                known = {"coolant": coolant, "fuel": 30, "oil": self.coolant_c + 5.0}
                return {
                    **(dict.fromkeys(known) if is_blind else known),
                    "turbo_oil": None,
                    "intercooler": None,
                }
            case "VehiclePower":
                return {"battery": 28.0}
            case "EngineHours":
                return {"running": self.hours, "revolutions": None}
            case "VehicleIdentification":
                return {"number": f"{self.vin}*".encode()}
            case "AddressClaimed":
                return self.name_fields
            case _:
                return self._faults()

    def _faults(self) -> dict[str, Any]:
        found = self.current_faults()
        is_red = bool({(110, 0), (100, 1)} & set(found))
        lamps = {
            "malfunction": "off", "red_stop": "on" if is_red else "off",
            "amber_warning": "on" if found else "off", "protect": "off",
        }  # fmt: skip
        faults = [
            {"spn": spn, "fmi": fmi, "count": count, "method": 0}
            for (spn, fmi), count in sorted(found.items())
        ]
        faults = faults or [{"spn": 0, "fmi": 0, "count": 0, "method": 0}]
        return {"lamps": lamps, "faults": faults, "padding": b"\xff\xff" if len(faults) == 1 else b""}

    def say(self, name: str) -> None:
        """Send a parameter group to all."""
        priority = 3 if name.startswith("EngineController") else 6
        self.reply(name, delay_ns=0, priority=priority, **self.fields_of(name))

    # ------------------------------------------------------------------ requests

    @on("Request", "RequestAll")
    def answer(self, request: Any) -> None:
        """Send what is asked for; refuse what is not there, unless all were asked."""
        name = next((name for name, group in GROUPS.items() if group == request.pgn), None)
        if name is not None:
            self.say(name)
        elif type(request).__name__ == "Request":
            self.reply(
                "Acknowledgement", priority=6, control="refused", address=request.tool, pgn=request.pgn
            )
