"""The twin of an ECU that answers OBD-II.

1. It answers what it has, and is silent about the rest, as SAE J1979 has it for values on CAN.
2. Codes outlive power-off; permanent ones outlive being cleared.
"""

from __future__ import annotations

from typing import ClassVar

from aces_bus.device import Twin, on
from aces_bus.protocol import Record
from aces_bus.protocol.record import FieldValue
from aces_devices.ecu_model import ecu_of
from aces_protocols.diagnostics import KINDS

BY_PID = {pid: name for name, (pid, _) in KINDS.items()}
#: A request asks for up to so many values (SAE J1979).
AT_ONCE = 6


class Obd2Twin(Twin):
    """One ECU: `ecu.values["engine_speed"] = 3000` (the sheet's units), `ecu.codes`, `ecu.vin`."""

    protocol = "obd2"
    faults: ClassVar = {"misfire": "cylinder 2 misfires: P0302 is stored, and the lamp is on"}

    def setup(self) -> None:
        """Keep the codes that the ECU had stored."""
        self.ecu = ecu_of(self.world, self.config)

    def kept(self) -> None:
        """Store what is wrong now."""
        if "misfire" in self.active_faults:
            self.ecu.codes["P0302"] = {"failed", "pending", "confirmed"}

    @on("ReadLive", "ReadLiveAll")
    def send_values(self, request: Record) -> None:
        """Send those of up to six values that the ECU has; send nothing if it has none of them."""
        self.kept()
        values: list[dict[str, FieldValue]] = []
        for pid in request.pids if len(request.pids) <= AT_ONCE else ():
            kind = BY_PID.get(pid, "")
            data = self.ecu.mask(pid) if kind.startswith("supported") else self.ecu.value(kind)
            if data is not None and data != []:
                values.append({"kind": kind, "data": data})
        if values:
            self.reply("Live", values=values)

    @on("ReadStoredCodes", "ReadStoredCodesAll")
    def send_stored(self, request: Record) -> None:
        """Send the confirmed codes."""
        self.kept()
        self.reply("StoredCodes", codes=self.ecu.with_status({"confirmed"}))

    @on("ReadPendingCodes", "ReadPendingCodesAll")
    def send_pending(self, request: Record) -> None:
        """Send codes of this or the last drive."""
        self.kept()
        self.reply("PendingCodes", codes=self.ecu.with_status({"pending"}))

    @on("ReadPermanentCodes", "ReadPermanentCodesAll")
    def send_permanent(self, request: Record) -> None:
        """Send codes that cannot be cleared."""
        self.reply("PermanentCodes", codes=sorted(self.ecu.permanent))

    @on("ClearCodes", "ClearCodesAll")
    def clear(self, request: Record) -> None:
        """Clear the codes, but permanent ones."""
        self.ecu.codes.clear()
        self.reply("CodesCleared")

    @on("ReadInfo", "ReadInfoAll")
    def send_info(self, request: Record) -> None:
        """Send the vehicle's number, the calibrations, or the ECU's name."""
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
