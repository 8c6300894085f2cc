"""What the diagnostics of cars share: identifiers, ISO-TP, the measured values (PIDs), trouble codes.

1. A tester asks one ECU with 0x7E0 + n, or all with 0x7DF; ECU n answers with 0x7E8 + n (ISO 15765-4, 11 bits).
2. Frames are filled up to 8 bytes, which ISO 15765-4 asks for; any filling is read.
3. A value has the same bytes under its PID (mode 01) and under the data identifier 0xF400 + PID (ISO 14229-1, annex C).

Sources: SAE J1979 / ISO 15031-5 (values), SAE J2012 / ISO 15031-6 (codes), ISO 15765-4, ISO 14229-1.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

from construct import Byte, BytesInteger, Construct, Int16ub, Int32ub

from aces_bus.errors import FieldError
from aces_bus.protocol import BitLayout, Enumeration, Field, Flags, IdField, IsoTp, Quantity, bits

Ecu = IdField("ecu", range(8), doc="the ECU: 0 is the engine's, 1 the transmission's as a rule")
#: The identifier of a request to all; a packet to all is a single frame (ISO 15765-2).
ALL = 0x7DF
#: Between a tester and one ECU, and from a tester to all of them.
ONE_ECU = IsoTp(to_device=0x7E0 + Ecu, from_device=0x7E8 + Ecu, pad=0)
ALL_ECUS = IsoTp(pad=0, max_size=7)

PERCENT = Quantity(Byte, unit="%", scale=100 / 255)
TRIM = Quantity(Byte, unit="%", scale=100 / 128, offset=-100)
CELSIUS = Quantity(Byte, unit="°C", offset=-40)
KILOPASCAL = Quantity(Byte, unit="kPa")
KILOMETRES = Quantity(Int16ub, unit="km")
STANDARDS = {
    "OBD_II_CARB": 1, "OBD_EPA": 2, "OBD_and_OBD_II": 3, "OBD_I": 4, "none": 5, "EOBD": 6, "EOBD_and_OBD_II": 7,
    "EOBD_and_OBD": 8, "EOBD_OBD_and_OBD_II": 9, "JOBD": 10, "JOBD_and_OBD_II": 11, "JOBD_and_EOBD": 12,
    "JOBD_EOBD_and_OBD_II": 13,
}  # fmt: skip
#: Values by name: PID and form.
VALUES: dict[str, tuple[int, Construct]] = {
    "monitor_status": (0x01, BitLayout(4, "codes" / bits(7, at=0), "lamp" / bits(1, at=7))),
    "engine_load": (0x04, PERCENT),
    "coolant_temperature": (0x05, CELSIUS),
    "short_fuel_trim": (0x06, TRIM),
    "long_fuel_trim": (0x07, TRIM),
    "fuel_pressure": (0x0A, Quantity(Byte, unit="kPa", scale=3)),
    "intake_pressure": (0x0B, KILOPASCAL),
    "engine_speed": (0x0C, Quantity(Int16ub, unit="rpm", scale=0.25)),
    "vehicle_speed": (0x0D, Quantity(Byte, unit="km/h")),
    "timing_advance": (0x0E, Quantity(Byte, unit="°", scale=0.5, offset=-64)),
    "intake_temperature": (0x0F, CELSIUS),
    "air_flow": (0x10, Quantity(Int16ub, unit="g/s", scale=0.01)),
    "throttle": (0x11, PERCENT),
    "standard": (0x1C, Enumeration(Byte, STANDARDS)),
    "run_time": (0x1F, Quantity(Int16ub, unit="s")),
    "distance_with_lamp": (0x21, KILOMETRES),
    "fuel_level": (0x2F, PERCENT),
    "distance_since_clear": (0x31, KILOMETRES),
    "barometric_pressure": (0x33, KILOPASCAL),
    "module_voltage": (0x42, Quantity(Int16ub, unit="V", scale=0.001)),
    "ambient_temperature": (0x46, CELSIUS),
    "oil_temperature": (0x5C, CELSIUS),
    "fuel_rate": (0x5E, Quantity(Int16ub, unit="L/h", scale=0.05)),
}
NAMES = {pid: name for name, (pid, _) in VALUES.items()}


def supported(first: int) -> Flags:
    """Return which of the 32 PIDs behind `first` there are: the highest bit is the first, the lowest says that a mask
    follows.
    """
    last = first + 32
    names = {NAMES.get(pid, f"pid_{pid:02X}"): last - pid for pid in range(first + 1, last)}
    return Flags(Int32ub, {**names, "more": 0})


#: The masks of PIDs, and all that a list of values may have.
MASKS: dict[str, tuple[int, Construct]] = {
    f"supported_{first + 1:02X}": (first, supported(first)) for first in (0x00, 0x20, 0x40)
}
KINDS = {**MASKS, **VALUES}


class TroubleCode(Field):
    """A trouble code as text: P0301; of three bytes with its failure type, P0301-11 (SAE J2012).

    The two highest bits are its letter, the others four digits, of which the first is 0 to 3.
    """

    def to_physical(self, raw: Any) -> str:
        """Return the text."""
        code, kind = (raw >> 8, f"-{raw & 0xFF:02X}") if self.sizeof() == 3 else (raw, "")
        return f"{'PCBU'[code >> 14]}{code & 0x3FFF:04X}{kind}"

    def to_raw(self, value: Any, path: str = "") -> int:
        """Return the number. Raises `FieldError` for what is not a code."""
        wide = self.sizeof() == 3
        found = re.fullmatch(r"([PCBU])([0-3][0-9A-F]{3})" + ("-([0-9A-F]{2})" if wide else ""), str(value))
        if found is None:
            raise FieldError(
                f"{value!r} is not a trouble code such as {'P0301-11' if wide else 'P0301'}", path
            )
        code = "PCBU".index(found[1]) << 14 | int(found[2], 16)
        return code << 8 | int(found[3], 16) if wide else code


#: Codes of two bytes (OBD) and of three (UDS).
Code = TroubleCode(Int16ub)
LongCode = TroubleCode(BytesInteger(3))

#: Why a request was refused (ISO 14229-1, annex A; SAE J1979 has some of them).
REFUSALS = {
    "general_reject": 0x10, "service_not_supported": 0x11, "subfunction_not_supported": 0x12, "incorrect_length": 0x13,
    "response_too_long": 0x14, "busy": 0x21, "conditions_not_correct": 0x22, "sequence_error": 0x24,
    "no_response_from_subnet": 0x25, "failure_prevents_execution": 0x26, "out_of_range": 0x31, "security_denied": 0x33,
    "authentication_required": 0x34, "invalid_key": 0x35, "too_many_attempts": 0x36, "delay_not_over": 0x37,
    "transfer_not_accepted": 0x70, "transfer_suspended": 0x71, "programming_failure": 0x72, "wrong_block_number": 0x73,
    "response_pending": 0x78, "subfunction_not_in_this_session": 0x7E, "service_not_in_this_session": 0x7F,
    "engine_speed_too_high": 0x81, "engine_speed_too_low": 0x82, "engine_running": 0x83, "engine_not_running": 0x84,
    "run_time_too_low": 0x85, "temperature_too_high": 0x86, "temperature_too_low": 0x87, "vehicle_speed_too_high": 0x88,
    "vehicle_speed_too_low": 0x89, "throttle_too_high": 0x8A, "throttle_too_low": 0x8B, "not_in_neutral": 0x8C,
    "not_in_gear": 0x8D, "brake_not_pressed": 0x8F, "not_in_park": 0x90, "torque_converter_locked": 0x91,
    "voltage_too_high": 0x92, "voltage_too_low": 0x93,
}  # fmt: skip


def for_all(examples: Sequence[tuple[str, dict[str, Any]]]) -> list[tuple[str, dict[str, Any]]]:
    """Return worked examples of a request to one ECU as those of the request to all."""
    return [
        (f"{ALL:X}#{frame.partition('#')[2]}", {k: v for k, v in values.items() if k != "ecu"})
        for frame, values in examples
    ]
