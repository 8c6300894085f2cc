"""The state machine of CiA 402 as tables: what a statusword says, and which controlword leads on.

1. Both ends read these tables: the driver to go on, the twin to be what it says.
2. A statusword is of the first row whose bits it has; the standard's rows exclude one another.
"""

from __future__ import annotations

from typing import Final

#: Statusword: state, mask, value.
STATES: Final = (
    ("not ready to switch on", 0x4F, 0x00),
    ("switch on disabled", 0x4F, 0x40),
    ("ready to switch on", 0x6F, 0x21),
    ("switched on", 0x6F, 0x23),
    ("operation enabled", 0x6F, 0x27),
    ("quick stop active", 0x6F, 0x07),
    ("fault reaction active", 0x4F, 0x0F),
    ("fault", 0x4F, 0x08),
)
VALUES: Final = {name: value for name, _, value in STATES}

# Controlwords.
DISABLE_VOLTAGE, QUICK_STOP, SHUTDOWN, SWITCH_ON, ENABLE, FAULT_RESET = 0x00, 0x02, 0x06, 0x07, 0x0F, 0x80
#: Bits of it that belong to the mode: a new set-point or the start of homing; take set-points at once; relative; halt.
START, AT_ONCE, RELATIVE, HALT = 0x10, 0x20, 0x40, 0x100

# Bits of the statusword.
WARNING, REMOTE, REACHED, LIMITED = 0x80, 0x200, 0x400, 0x800
#: Of the mode: a set-point was taken, or home was found; following error, or no home was found.
TAKEN, FAILED = 0x1000, 0x2000

#: State → the controlword that leads on towards "operation enabled"; None: it goes on by itself, or must be reset first.
ONWARD: Final[dict[str, int | None]] = {
    "not ready to switch on": None,
    "switch on disabled": SHUTDOWN,
    "ready to switch on": SWITCH_ON,
    "switched on": ENABLE,
    "operation enabled": ENABLE,
    "quick stop active": DISABLE_VOLTAGE,
    "fault reaction active": None,
    "fault": None,
}

#: Modes of operation, object 6060.
MODES: Final = {
    "none": 0,
    "profile_position": 1,
    "velocity": 2,
    "profile_velocity": 3,
    "profile_torque": 4,
    "homing": 6,
    "interpolated_position": 7,
    "cyclic_position": 8,
    "cyclic_velocity": 9,
    "cyclic_torque": 10,
}
MODE_NAMES: Final = {number: name for name, number in MODES.items()}
#: Mode → the signal that is its set-point, and the object that takes it.
TARGETS: Final[dict[str, tuple[str, int]]] = {
    "profile_position": ("position", 0x607A),
    "velocity": ("velocity", 0x6042),
    "profile_velocity": ("velocity", 0x60FF),
    "profile_torque": ("torque", 0x6071),
    "cyclic_position": ("position", 0x607A),
    "cyclic_velocity": ("velocity", 0x60FF),
    "cyclic_torque": ("torque", 0x6071),
}
#: What a joint is commanded in → the mode that a drive of it is put into by default.
USUAL: Final = {"position": "profile_position", "speed": "profile_velocity", "current": "profile_torque"}

#: Emergency codes by group, CiA 301: first that fits, masks from the narrow to the wide.
GROUPS: Final = (
    (0xFFFF, 0x8130, "heartbeat lost"),
    (0xFFFF, 0x8611, "following error"),
    (0xFF00, 0x0000, "no error"),
    (0xFF00, 0x1000, "generic error"),
    (0xFF00, 0x2100, "current, input side"),
    (0xFF00, 0x2200, "current inside"),
    (0xFF00, 0x2300, "current, output side"),
    (0xFF00, 0x3100, "mains voltage"),
    (0xFF00, 0x3200, "voltage inside"),
    (0xFF00, 0x3300, "output voltage"),
    (0xFF00, 0x4100, "ambient temperature"),
    (0xFF00, 0x4200, "device temperature"),
    (0xFF00, 0x5000, "device hardware"),
    (0xF000, 0x6000, "device software"),
    (0xFF00, 0x7000, "additional modules"),
    (0xFF00, 0x8100, "communication"),
    (0xFF00, 0x8200, "protocol"),
    (0xFF00, 0x9000, "external error"),
    (0xFF00, 0xFF00, "device specific"),
)


def drive_state(statusword: int) -> str:
    """Return the state that a statusword says; "unknown" for what is none.

    >>> drive_state(0x0637), drive_state(0x0218), drive_state(0x0250)
    ('operation enabled', 'fault', 'switch on disabled')
    """
    return next((name for name, mask, value in STATES if statusword & mask == value), "unknown")


def emergency_text(code: int) -> str:
    """Return what an emergency's code says.

    >>> emergency_text(0x3210), emergency_text(0x8130), emergency_text(0xABCD)
    ('0x3210, voltage inside', '0x8130, heartbeat lost', '0xABCD')
    """
    for mask, value, text in GROUPS:
        if code & mask == value:
            return f"0x{code:04X}, {text}"
    return f"0x{code:04X}"
