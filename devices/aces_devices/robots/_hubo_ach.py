"""hubo-ach's tables: joint.table, sensor.table, .home.

1. A row that is not understood is a problem with file and line; it never takes another row's values.
2. A .home table holds the calibration of one robot, in counts unless its rows say `rad`; limits of the boards become
   limits of the joints too, in rad.

The limit words of a .home table carry their switch in bit 0: −169999 is −170000, on. A limit that is off is not a limit.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

from ._description import (
    BOARDS,
    BUSES,
    DECIMAL,
    NUMBER,
    WORD,
    RobotDescription,
    ValueColumn,
    WordLine,
    one_of,
    read_lines,
)

_FLAG, _CAN, _SIGN = one_of((0, 1)), one_of(BUSES), one_of((1, -1, 0))
JOINT_COLUMNS: Final[Mapping[str, ValueColumn]] = {
    "name": WORD,
    "motNo": DECIMAL,
    "refEnc": DECIMAL,
    "drive": NUMBER,
    "driven": NUMBER,
    "harm": NUMBER,
    "enc": DECIMAL,
    "dir": one_of((1, -1)),
    "jmc": one_of(BOARDS, str),
    "active": _FLAG,
    "can": _CAN,
    "numMot": one_of((1, 2, 3, 5)),
    "kp": NUMBER,
    "kd": NUMBER,
    "maxPWM": NUMBER,
    "zeroed": DECIMAL,
}
SENSOR_COLUMNS: Final[Mapping[str, ValueColumn]] = {
    "name": WORD,
    "can": _CAN,
    "active": _FLAG,
    "board": one_of(range(1, 16)),
    "x-axis": _SIGN,
    "y-axis": _SIGN,
    "z-axis": _SIGN,
}
HOME_COLUMNS: Final[Mapping[str, ValueColumn]] = {
    "JointName": WORD,
    "HomeOffset": DECIMAL,
    "LowerLimit": DECIMAL,
    "UpperLimit": DECIMAL,
    "SearchDirection": _FLAG,
    "SearchLimit": DECIMAL,
    "Type": one_of(("raw", "rad"), str),
}
_IN_RAD: Final = dict.fromkeys(("HomeOffset", "LowerLimit", "UpperLimit", "SearchLimit"), NUMBER)


def _rows(
    made: RobotDescription, path: Path, columns: Mapping[str, ValueColumn]
) -> Iterator[tuple[WordLine, dict[str, Any]]]:
    """Yield the rows of a table as mappings from columns to values: those that are right."""
    seen: dict[str, int] = {}
    for line in read_lines(path):
        if line.words[0] == "JointName":
            continue
        if made.is_hopeless:
            return
        if len(line.words) != len(columns):
            text = f"expected {len(columns)} columns ({' '.join(columns)}), not {len(line.words)}"
            made.complain(line, "", text)
            continue
        kinds = {**columns, **_IN_RAD} if line.words[-1] == "rad" else columns
        words = zip(kinds.items(), line.words, strict=True)
        row = {key: made.value(line, key, [word], kind) for (key, kind), word in words}
        first = next(iter(columns))
        if row[first] in seen:
            made.complain(line, first, f"{row[first]} is there twice: see line {seen[row[first]]}")
        elif None not in row.values():
            seen[row[first]] = line.number
            yield line, row


def read_joints(path: Path, made: RobotDescription) -> None:
    """Read joints and their boards from a joint table."""
    motors: dict[str, tuple[int, int]] = {}
    devices, joints = made.content["devices"], made.content["joints"]
    for line, row in _rows(made, path, JOINT_COLUMNS):
        board, active = row["jmc"], bool(row["active"])
        wired = (row["numMot"], row["can"])
        known = devices.get(board)
        if known is None or (active and not known["active"]):
            # What an inactive row says of a board counts only where no active one says it.
            motors[board] = wired
            devices[board] = {
                "driver": "hubo_motor",
                "bus": BUSES[row["can"]],
                "credentials": {"board": BOARDS[board]},
                "channels": row["numMot"],
                "active": active,
            }
        elif active and motors[board] != wired:
            made.complain(line, "jmc", f"{board} has other numMot or can {wired} than before {motors[board]}")
        joints[row["name"]] = joint = {
            "device": board,
            "channel": row["motNo"],
            "gear": [row["drive"], row["driven"]],
            "harmonic": row["harm"],
            "encoder": row["enc"],
            "direction": row["dir"],
            "active": active,
        }
        if row["kp"] or row["kd"] or row["maxPWM"]:
            joint["compliance"] = {"kp": row["kp"], "kd": row["kd"], "max_pwm": row["maxPWM"]}
        made.places["joints", row["name"]] = line
        made.places.setdefault(("devices", board), line)
    # Three motors on a hand's board are a DRC-Hubo's, whose neck is three servos.
    if any(motors.get(hand, (0, 0))[0] == 3 for hand in ("EJMC4", "EJMC5")):
        for board, kind in (("EJMC4", "hand"), ("EJMC5", "hand"), ("EJMC2", "neck")):
            if board in devices and motors[board][0] == 3:
                devices[board]["kind"] = kind


def read_sensors(path: Path, made: RobotDescription) -> None:
    """Read sensors and their boards from a sensor table."""
    for line, row in _rows(made, path, SENSOR_COLUMNS):
        name = row["name"]
        kind = "force_torque" if "FT" in name else "tilt" if "TILT" in name else "imu"
        signs = [row[axis] for axis in ("x-axis", "y-axis", "z-axis")]
        more = {"signs": signs} if all(signs) else {}  # zeros: not used, as the table says
        made.add_sensor(line, name, row["board"], BUSES[row["can"]], kind, active=bool(row["active"]), **more)


def read_homes(path: Path, made: RobotDescription) -> None:
    """Read a .home table into the joints that exist."""
    names = made.names()
    for line, row in _rows(made, path, HOME_COLUMNS):
        known = names.get(row["JointName"])
        if known is None:
            made.complain(line, "JointName", f"no joint is named {row['JointName']!r:.60}")
            continue
        joint, in_rad = made.content["joints"][known], row["Type"] == "rad"
        scale = _counts_per_rad(joint)
        if scale is None and in_rad:
            made.complain(line, "Type", f"{known} has no gear: rad cannot be made counts")
            continue
        unit = (scale or 0) if in_rad else 1
        home: dict[str, Any] = {
            "offset": math.trunc(row["HomeOffset"] * unit),
            "direction": "ccw" if row["SearchDirection"] else "cw",
            "search_turns": int(row["SearchLimit"]),
        }
        for key, column in (("lower", "LowerLimit"), ("upper", "UpperLimit")):
            limit = row[column]
            if in_rad:
                joint[key], home[key] = limit, math.trunc(limit * unit)
            elif not limit & 1:
                made.notes.append(
                    f"{line.file}:{line.number}: the {key} limit of {known} is switched off: left out"
                )
                joint.pop(key, None)
            else:
                home[key] = limit & ~1
                if scale is not None:
                    joint[key] = round(home[key] / scale, 9)
        joint["home"] = {**joint.get("home", {}), **home}
        for key in ("home", "lower", "upper"):
            made.places["joints", known, key] = line


def _counts_per_rad(joint: Mapping[str, Any]) -> float | None:
    if not all(joint.get(key) for key in ("gear", "harmonic", "encoder")) or not all(joint["gear"]):
        return None
    drive, driven = joint["gear"]
    return float(driven / drive * joint["harmonic"] * joint["encoder"] / math.tau)
