"""Which board is what, robot by robot: the tables that decide how a board's frames are read.

1. A table maps a board number (`channels`) or a sensor id (`sensors`) to its kind; nothing else about a robot is here.
2. Kinds are numbers of motor channels, or a word where two boards with as many channels speak differently.

A sensor's id is its board number − 0x2F: requests and data carry the id, commands the board number.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

Kind = int | str

#: Legs, arms and waist: the same on all three robots (acesHubo config.ops, hubo-ach, HuboCan).
LIMBS: Final[Mapping[int, Kind]] = {
    0x00: 2,  # JMC0   RHY RHR
    0x01: 1,  # JMC1   RHP
    0x02: 1,  # JMC2   RKP
    0x03: 2,  # JMC3   RAP RAR
    0x04: 2,  # JMC4   LHY LHR
    0x05: 1,  # JMC5   LHP
    0x06: 1,  # JMC6   LKP
    0x07: 2,  # JMC7   LAP LAR
    0x08: 2,  # JMC8   RSP RSR
    0x09: 2,  # JMC9   RSY REB
    0x0A: 2,  # JMC10  LSP LSR
    0x0B: 2,  # JMC11  LSY LEB
    0x23: 1,  # EJMC3  WST
}

#: Sensor boards. "foot": force/torque and tilt; "ft": force/torque of a hand; "imu".
SENSOR_BOARDS: Final[Mapping[int, Kind]] = {
    0x30: "foot",  # right
    0x31: "foot",  # left
    0x32: "imu",  # pelvis
    0x33: "imu",  # IMU 1, inactive in hubo-ach's table
    0x34: "imu",  # IMU 2, inactive in hubo-ach's table
    0x35: "ft",  # right hand
    0x36: "ft",  # left hand
}

SENSORS: Final[Mapping[int, Kind]] = {board - 0x2F: kind for board, kind in SENSOR_BOARDS.items()}

#: Hubo 2 (2008–2011): three-channel wrists, board 0x0E spare. Sources: sheet JMC_NO (2); acesHubo config.ops.
HUBO2: Final[Mapping[int, Kind]] = {
    **LIMBS,
    0x20: 3,  # EJMC0  RWY RW1 RW2
    0x21: 3,  # EJMC1  LWY LW1 LW2
    0x22: 3,  # EJMC2  NKY NK1 NK2
    0x24: 5,  # EJMC4  RF1…RF5
    0x25: 5,  # EJMC5  LF1…LF5
    **SENSOR_BOARDS,
}

#: Hubo 2+ (2012): two-channel wrists. Sources: hubo-ach huboplus.joint.table; HuboCan Hubo2Plus.dd.
HUBO2PLUS: Final[Mapping[int, Kind]] = {
    **LIMBS,
    0x0E: "power",  # JMC14  smart power controller
    0x20: 2,  # EJMC0  RWY RWP
    0x21: 2,  # EJMC1  LWY LWP
    0x22: 3,  # EJMC2  NKY NK1 NK2, inactive in hubo-ach's table
    0x24: 5,  # EJMC4  RF1…RF5
    0x25: 5,  # EJMC5  LF1…LF5
    **SENSOR_BOARDS,
}

#: DRC-Hubo (2013): wrist roll on the hand boards, servos in the neck. Sources: hubo-ach drc-hubo.joint.table; HuboCan.
DRC_HUBO: Final[Mapping[int, Kind]] = {
    **LIMBS,
    0x0E: "power",  # JMC14  smart power controller
    0x20: 2,  # EJMC0  RWY RWP
    0x21: 2,  # EJMC1  LWY LWP
    0x22: "neck",  # EJMC2  NKY NK1 NK2, servos
    0x24: "hand",  # EJMC4  RWR RF1 RF2
    0x25: "hand",  # EJMC5  LWR LF1 LF2
    **SENSOR_BOARDS,
}

#: What the protocol ships; the first is the default.
CONFIGURATIONS: Final[Mapping[str, Mapping[str, Mapping[int, Kind]]]] = {
    "hubo2plus": {"channels": HUBO2PLUS, "sensors": SENSORS},
    "hubo2": {"channels": HUBO2, "sensors": SENSORS},
    "drc_hubo": {"channels": DRC_HUBO, "sensors": SENSORS},
}
