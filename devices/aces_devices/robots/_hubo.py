"""What the description files of Hubo's programs leave to the reader: boards' numbers, buses, names.

Sources: hubo-ach canID.h (board numbers), hubo-ach and HuboCan (buses, names of joints), the facts of the protocol's
package `aces_protocols.hubo`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Final

#: Board's name → number: JMC0…JMC31, EJMC0…EJMC15.
BOARDS: Final[Mapping[str, int]] = {
    **{f"JMC{number}": number for number in range(0x20)},
    **{f"EJMC{number}": 0x20 + number for number in range(0x10)},
}
#: A sensor board's number is its id and this.
SENSOR_BASE: Final = 0x2F
#: Number of a CAN bus → what it is called here.
BUSES: Final[Mapping[int, str]] = {0: "lower", 1: "upper", 2: "bus2", 3: "bus3"}
SENSOR_BOARDS: Final[Mapping[int, str]] = {
    0x30: "FT_RF",
    0x31: "FT_LF",
    0x32: "IMU_0",
    0x33: "IMU_1",
    0x34: "IMU_2",
    0x35: "FT_RH",
    0x36: "FT_LH",
}
#: Names of the same joint in different programs.
SAME: Final = (("WST", "TSY"), ("LKN", "LKP"), ("RKN", "RKP"), ("LEB", "LEP"), ("REB", "REP"))
DRIVERS: Final[Mapping[str, str]] = {"imu": "hubo_imu", "foot": "hubo_ft", "ft": "hubo_ft"}


def bus(number: int) -> dict[str, Any]:
    """A bus of dialect D12, which both programs speak."""
    return {
        "link": "can",
        "protocol": "hubo",
        "dialect": "D12",
        "bitrate": 1_000_000,
        "channel": f"can{number}",
    }


def sensor_board(sensor: int, kinds: Iterable[str]) -> str:
    """Kind of the board of a sensor id from the kinds of its sensors: feet have tilt beside force and torque."""
    found = set(kinds)
    if "imu" in found:
        return "imu"
    return "foot" if "tilt" in found or sensor in (1, 2) else "ft"


def add_aliases(joints: Mapping[str, dict[str, Any]]) -> None:
    """The names that other programs have for these joints."""
    for names in SAME:
        present = [name for name in names if name in joints]
        if len(present) == 1:
            joints[present[0]]["aliases"] = [name for name in names if name != present[0]]
