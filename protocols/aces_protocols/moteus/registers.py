"""The registers of a moteus: number, name and what they measure (mjbots/moteus docs/protocol/registers.md).

1. A register has no width: who reads or writes it chooses i8, i16, i32 or f32. Integers count in steps of what is
   measured, a float is in the unit itself.
2. The most negative integer of a measured quantity is "not a number", which means what the register says.

Names are those of mjbots' own libraries in lower case.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

#: The types of values by their number in a sub-frame, with their `struct` format.
TYPES = {"i8": "<b", "i16": "<h", "i32": "<i", "f32": "<f"}

#: What is measured: unit, and one step of an i8, i16, i32.
MEASURES: Mapping[str, tuple[str, tuple[float, float, float]]] = {
    "position": ("turn", (0.01, 0.0001, 0.00001)),
    "velocity": ("turn/s", (0.1, 0.00025, 0.00001)),
    "acceleration": ("turn/s²", (0.05, 0.001, 0.00001)),
    "torque": ("N·m", (0.5, 0.01, 0.001)),
    "current": ("A", (1.0, 0.1, 0.001)),
    "voltage": ("V", (0.5, 0.1, 0.001)),
    "temperature": ("°C", (1.0, 0.1, 0.001)),
    "time": ("s", (0.01, 0.001, 0.000001)),
    "power": ("W", (10.0, 0.05, 0.0001)),
    "share": ("", (1 / 127, 1 / 32767, 1 / 2147483647)),
}

MODES = {
    0: "stopped",
    1: "fault",
    2: "enabling",
    3: "calibrating",
    4: "calibration_complete",
    5: "pwm",
    6: "voltage",
    7: "voltage_foc",
    8: "voltage_dq",
    9: "current",
    10: "position",
    11: "position_timeout",
    12: "zero_velocity",
    13: "stay_within",
    14: "measure_inductance",
    15: "brake",
}
FAULTS = {
    0: "none",
    32: "calibration",
    33: "motor_driver",
    34: "over_voltage",
    35: "encoder",
    36: "not_configured",
    37: "pwm_overrun",
    38: "over_temperature",
    39: "start_outside_limit",
    40: "under_voltage",
    41: "configuration_changed",
    42: "theta_invalid",
    43: "position_invalid",
    44: "driver_enable",
    46: "timing",
    49: "position_error",
    50: "velocity_error",
}
HOMES = {0: "relative", 1: "rotor", 2: "output"}


@dataclass(frozen=True)
class Quantum:
    """One register. `measure` is a key of `MEASURES`, "" for a plain number, which may have `names`."""

    number: int
    name: str
    measure: str = ""
    names: Mapping[int, str] = field(default_factory=dict[int, str])

    @property
    def unit(self) -> str:
        """Its unit, "" for plain numbers and shares."""
        return MEASURES[self.measure][0] if self.measure else ""

    def step(self, kind: str) -> float | None:
        """Return one step of an integer type; None for floats and plain numbers."""
        if not self.measure or kind == "f32":
            return None
        return MEASURES[self.measure][1][("i8", "i16", "i32").index(kind)]


def _from(first: int, measure: str, *names: str) -> list[Quantum]:
    return [Quantum(first + n, name, measure) for n, name in enumerate(names)]


def _numbered(first: int, measure: str, text: str, last: int) -> list[Quantum]:
    return _from(first, measure, *(text.format(n) for n in range(1, last + 1)))


_ALL = [
    Quantum(0x000, "mode", "", MODES),
    Quantum(0x001, "position", "position"),
    Quantum(0x002, "velocity", "velocity"),
    Quantum(0x003, "torque", "torque"),
    *_from(0x004, "current", "q_current", "d_current"),
    Quantum(0x006, "abs_position", "position"),
    Quantum(0x007, "power", "power"),
    Quantum(0x00A, "motor_temperature", "temperature"),
    Quantum(0x00B, "trajectory_complete"),
    Quantum(0x00C, "home_state", "", HOMES),
    Quantum(0x00D, "voltage", "voltage"),
    Quantum(0x00E, "temperature", "temperature"),
    Quantum(0x00F, "fault", "", FAULTS),
    *_from(0x010, "share", "pwm_phase_a", "pwm_phase_b", "pwm_phase_c"),
    *_from(0x014, "voltage", "voltage_phase_a", "voltage_phase_b", "voltage_phase_c"),
    Quantum(0x018, "vfoc_theta", "share"),
    *_from(0x019, "voltage", "vfoc_voltage", "voltagedq_d", "voltagedq_q"),
    *_from(0x01C, "current", "command_q_current", "command_d_current"),
    Quantum(0x01E, "vfoc_theta_rate", "velocity"),
    Quantum(0x020, "command_position", "position"),
    Quantum(0x021, "command_velocity", "velocity"),
    Quantum(0x022, "command_feedforward_torque", "torque"),
    *_from(0x023, "share", "command_kp_scale", "command_kd_scale"),
    Quantum(0x025, "command_position_max_torque", "torque"),
    Quantum(0x026, "command_stop_position", "position"),
    Quantum(0x027, "command_timeout", "time"),
    Quantum(0x028, "command_velocity_limit", "velocity"),
    Quantum(0x029, "command_accel_limit", "acceleration"),
    Quantum(0x02A, "command_fixed_voltage_override", "voltage"),
    Quantum(0x02B, "command_ilimit_scale", "share"),
    Quantum(0x02C, "command_fixed_current_override", "current"),
    Quantum(0x02D, "command_ignore_position_bounds"),
    *_from(0x030, "torque", "position_kp", "position_ki", "position_kd", "position_feedforward"),
    Quantum(0x034, "position_command", "torque"),
    Quantum(0x038, "control_position", "position"),
    Quantum(0x039, "control_velocity", "velocity"),
    Quantum(0x03A, "control_torque", "torque"),
    Quantum(0x03B, "position_error", "position"),
    Quantum(0x03C, "velocity_error", "velocity"),
    Quantum(0x03D, "torque_error", "torque"),
    *_from(0x040, "position", "command_within_lower_bound", "command_within_upper_bound"),
    Quantum(0x042, "command_within_feedforward_torque", "torque"),
    *_from(0x043, "share", "command_within_kp_scale", "command_within_kd_scale"),
    Quantum(0x045, "command_within_max_torque", "torque"),
    Quantum(0x046, "command_within_timeout", "time"),
    Quantum(0x047, "command_within_ilimit_scale", "share"),
    Quantum(0x048, "command_within_ignore_position_bounds"),
    Quantum(0x050, "encoder_0_position", "position"),
    Quantum(0x051, "encoder_0_velocity", "velocity"),
    Quantum(0x052, "encoder_1_position", "position"),
    Quantum(0x053, "encoder_1_velocity", "velocity"),
    Quantum(0x054, "encoder_2_position", "position"),
    Quantum(0x055, "encoder_2_velocity", "velocity"),
    Quantum(0x058, "encoder_validity"),
    *_from(0x05C, "", "aux1_gpio_command", "aux2_gpio_command", "aux1_gpio_status", "aux2_gpio_status"),
    *_numbered(0x060, "share", "aux1_analog_in{}", 5),
    *_numbered(0x068, "share", "aux2_analog_in{}", 5),
    *_from(0x070, "", "millisecond_counter", "clock_trim", "aux1_pwm_input_period"),
    Quantum(0x073, "aux1_pwm_input_duty_cycle", "share"),
    Quantum(0x074, "aux2_pwm_input_period"),
    Quantum(0x075, "aux2_pwm_input_duty_cycle", "share"),
    *_numbered(0x076, "share", "aux1_pwm{}", 5),
    *_numbered(0x07B, "share", "aux2_pwm{}", 5),
    *_from(0x100, "", "model_number", "firmware_version", "register_map_version"),
    Quantum(0x110, "multiplex_id"),
    *_numbered(0x120, "", "serial_number{}", 3),
    *_from(0x130, "position", "set_output_nearest", "set_output_exact"),
    *_from(0x132, "", "require_reindex", "recapture_position_velocity"),
    *_numbered(0x140, "", "driver_fault{}", 2),
    *_numbered(0x150, "", "uuid{}", 4),
    *_numbered(0x154, "", "uuid_mask{}", 4),
    Quantum(0x158, "uuid_mask_capable"),
]
#: The registers by number and by name.
BY_NUMBER: dict[int, Quantum] = {quantum.number: quantum for quantum in _ALL}
BY_NAME: dict[str, Quantum] = {quantum.name: quantum for quantum in _ALL}


def register_at(number: int) -> Quantum:
    """Return the register of a number; one without a name is called after it, such as r0f3."""
    return BY_NUMBER.get(number) or Quantum(number, f"r{number:03x}")


def register_named(name: str) -> Quantum | None:
    """Return the register of a name, r0f3 too; None where there is none."""
    found = BY_NAME.get(name)
    if found is None and name[:1] == "r":
        try:
            found = register_at(int(name[1:], 16))
        except ValueError:
            return None
    return found if found is not None and found.name == name else None
