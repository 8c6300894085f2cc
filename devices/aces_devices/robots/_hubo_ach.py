"""hubo-ach's tables: joint.table, sensor.table, .home.

1. A row that is not understood is a problem with file and line; it never takes another row's values.
2. A .home table holds the calibration of one robot, in counts unless its rows say `rad`; limits of the boards become
   limits of the joints too, in rad.

The limit words of a .home table carry their switch in bit 0: −169999 is −170000, on. A limit that is off is no limit.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from aces_bus.robot import RobotFileProblem

from . import _hubo
from ._hubocan import Places
from ._words import MOST, WordLine, decimal_number, plausible_number, read_lines, take

JOINT_COLUMNS: Final = (
    *("name", "motNo", "refEnc", "drive", "driven", "harm", "enc", "dir", "jmc", "active", "can", "numMot"),
    *("kp", "kd", "maxPWM", "zeroed"),
)
SENSOR_COLUMNS: Final = ("name", "can", "active", "board", "x-axis", "y-axis", "z-axis")
HOME_COLUMNS: Final = (
    "JointName",
    "HomeOffset",
    "LowerLimit",
    "UpperLimit",
    "SearchDirection",
    "SearchLimit",
    "Type",
)
WORDS: Final = {"name", "jmc", "JointName", "Type"}
REAL: Final = {"drive", "driven", "harm", "kp", "kd", "maxPWM"}


class TableRows:
    """The rows of a table as mappings from columns to values, and what is wrong with them."""

    def __init__(self, path: Path, columns: Sequence[str], lines: list[WordLine] | None = None) -> None:
        self.problems: list[RobotFileProblem] = []
        self.rows: list[tuple[WordLine, dict[str, Any]]] = []
        seen: dict[str, int] = {}
        for line in lines if lines is not None else read_lines(path):
            if line.words[0] == columns[0] and line.words[0] == "JointName":
                continue
            if len(line.words) != len(columns):
                text = f"expected {len(columns)} columns ({' '.join(columns)}), not {len(line.words)}"
                self.problems.append(line.problem("", text))
                continue
            if len(self.problems) > MOST:
                break
            row: dict[str, Any] = {}
            for column, word in zip(columns, line.words, strict=True):
                read = (
                    str
                    if column in WORDS
                    else plausible_number
                    if column in REAL or line.words[-1] == "rad"
                    else decimal_number
                )
                values = take(line, column, [word], read, 1, self.problems)
                if values is not None:
                    row[column] = values[0]
            name = str(row.get(columns[0]))
            if name in seen:
                self.problems.append(
                    line.problem(columns[0], f"{name} is there twice: see line {seen[name]}")
                )
            elif len(row) == len(columns):
                seen[name] = line.number
                self.rows.append((line, row))

    def among(self, line: WordLine, column: str, value: Any, allowed: Sequence[Any]) -> bool:
        if value in allowed:
            return True
        names = " or ".join(map(str, allowed)) if len(allowed) < 5 else f"{allowed[0]}…{allowed[-1]}"
        self.problems.append(line.problem(column, f"expected {names}, not {value!r:.60}"))
        return False


def read_joints(path: Path, content: dict[str, Any], places: Places) -> list[RobotFileProblem]:
    """A joint table: joints and their boards."""
    table = TableRows(path, JOINT_COLUMNS)
    motors: dict[str, tuple[int, int]] = {}
    devices, joints = content["devices"], content["joints"]
    for line, row in table.rows:
        board = row["jmc"]
        if not all(
            [
                table.among(line, "jmc", board, list(_hubo.BOARDS)),
                table.among(line, "active", row["active"], (0, 1)),
                table.among(line, "can", row["can"], tuple(_hubo.BUSES)),
                table.among(line, "dir", row["dir"], (1, -1)),
                table.among(line, "numMot", row["numMot"], (1, 2, 3, 5)),
            ]
        ):
            continue
        wired = (row["numMot"], row["can"])
        known = devices.get(board)
        if known is None or (row["active"] and not known["active"]):
            # What an inactive row says of a board counts only where no active one says it.
            motors[board] = wired
            devices[board] = {
                "driver": "hubo_motor",
                "bus": _hubo.BUSES[row["can"]],
                "credentials": {"board": _hubo.BOARDS[board]},
                "channels": row["numMot"],
                "active": bool(row["active"]),
            }
        elif row["active"] and motors[board] != wired:
            text = f"{board} has other numMot or can {wired} than before {motors[board]}"
            table.problems.append(line.problem("jmc", text))
        joint = {
            "device": board,
            "channel": row["motNo"],
            "gear": [row["drive"], row["driven"]],
            "harmonic": row["harm"],
            "encoder": row["enc"],
            "direction": row["dir"],
            "active": bool(row["active"]),
        }
        if row["kp"] or row["kd"] or row["maxPWM"]:
            joint["compliance"] = {"kp": row["kp"], "kd": row["kd"], "max_pwm": row["maxPWM"]}
        joints[row["name"]] = joint
        places["joints", row["name"]] = line
        places.setdefault(("devices", board), line)
    # Three motors on a hand's board are a DRC-Hubo's, whose neck is three servos.
    if any(motors.get(hand, (0, 0))[0] == 3 for hand in ("EJMC4", "EJMC5")):
        for board, kind in (("EJMC4", "hand"), ("EJMC5", "hand"), ("EJMC2", "neck")):
            if board in devices and motors[board][0] == 3:
                devices[board]["kind"] = kind
    _hubo.add_aliases(joints)
    return table.problems


def read_sensors(path: Path, content: dict[str, Any], places: Places) -> list[RobotFileProblem]:
    """A sensor table: sensors and their boards."""
    table = TableRows(path, SENSOR_COLUMNS)
    for line, row in table.rows:
        sensor, name = row["board"], row["name"]
        kind = "force_torque" if "FT" in name else "tilt" if "TILT" in name else "imu"
        if not all(
            [
                table.among(line, "can", row["can"], tuple(_hubo.BUSES)),
                table.among(line, "active", row["active"], (0, 1)),
                table.among(line, "board", sensor, range(1, 16)),
                *(table.among(line, axis, row[axis], (1, -1, 0)) for axis in SENSOR_COLUMNS[4:]),
            ]
        ):
            continue
        board = _hubo.SENSOR_BOARDS.get(sensor + _hubo.SENSOR_BASE, f"SENSOR_{sensor}")
        known = content["devices"].get(board)
        kinds = {kind} | {one["kind"] for one in content["sensors"].values() if one["device"] == board}
        made = _hubo.sensor_board(sensor, kinds)
        content["devices"][board] = {
            "driver": _hubo.DRIVERS[made],
            "bus": _hubo.BUSES[row["can"]],
            "credentials": {"board": sensor + _hubo.SENSOR_BASE, "sensor": sensor},
            "kind": made,
            "active": bool(row["active"]) or bool(known and known["active"]),
        }
        entry: dict[str, Any] = {"device": board, "kind": kind, "active": bool(row["active"])}
        signs = [row[axis] for axis in SENSOR_COLUMNS[4:]]
        if all(signs):
            entry["signs"] = signs  # zeros: not used, as the table says
        content["sensors"][name] = entry
        places["sensors", name] = line
        places.setdefault(("devices", board), line)
    return table.problems


def read_homes(
    path: Path, content: dict[str, Any], places: Places
) -> tuple[list[RobotFileProblem], list[str]]:
    """A .home table, into joints that are there; also what is worth saying of it."""
    table, notes = TableRows(path, HOME_COLUMNS), list[str]()
    names = {alias: name for name, joint in content["joints"].items() for alias in joint.get("aliases", ())}
    names |= {name: name for name in content["joints"]}
    for line, row in table.rows:
        known = names.get(row["JointName"])
        if known is None:
            table.problems.append(line.problem("JointName", f"no joint is named {row['JointName']!r:.60}"))
            continue
        if not (
            table.among(line, "Type", row["Type"], ("raw", "rad"))
            and table.among(line, "SearchDirection", row["SearchDirection"], (0, 1))
        ):
            continue
        joint = content["joints"][known]
        scale = _counts_per_rad(joint)
        if scale is None and row["Type"] == "rad":
            table.problems.append(line.problem("Type", f"{known} has no gear: rad cannot be made counts"))
            continue
        home: dict[str, Any] = {
            "offset": row["HomeOffset"]
            if row["Type"] == "raw"
            else math.trunc(row["HomeOffset"] * (scale or 0)),
            "direction": "ccw" if row["SearchDirection"] else "cw",
            "search_turns": int(row["SearchLimit"]),
        }
        for key, column in (("lower", "LowerLimit"), ("upper", "UpperLimit")):
            word = row[column]
            if row["Type"] == "rad":
                joint[key], home[key] = word, math.trunc(word * (scale or 0))
            elif not word & 1:
                notes.append(
                    f"{line.file}:{line.number}: the {key} limit of {known} is switched off: left out"
                )
                joint.pop(key, None)
            else:
                home[key] = word & ~1
                if scale is not None:
                    joint[key] = round(home[key] / scale, 9)
        joint["home"] = {**joint.get("home", {}), **home}
        places["joints", known, "home"] = places["joints", known, "lower"] = places[
            "joints", known, "upper"
        ] = line
    return table.problems, notes


def _counts_per_rad(joint: Mapping[str, Any]) -> float | None:
    if not all(joint.get(key) for key in ("gear", "harmonic", "encoder")) or not all(joint["gear"]):
        return None
    drive, driven = joint["gear"]
    return float(driven / drive * joint["harmonic"] * joint["encoder"] / math.tau)
