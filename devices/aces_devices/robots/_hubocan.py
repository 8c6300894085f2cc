"""HuboCan's description trees (`.dd`): `begin TYPE … end TYPE` blocks of keys and values, and includes.

1. Every block is read; what is wrong is collected, with file and line.
2. Includes are relative to their file, are read once each, and cannot lead in circles.

Sensors have ids there, boards are theirs plus 0x2F. A board of type H2P_2CH or DRC_2CH has as many channels as it has
joints (one or two), as hubo-ach's tables count them.
"""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final, NamedTuple

from aces_bus.errors import CallerError
from aces_bus.robot import RobotFileProblem

from . import _hubo
from ._words import MOST, WordLine, plausible_number, read_lines, take, whole

#: Type of a motor board → number of its channels (None: as many as it has joints), kind.
JMC_TYPES: Final[Mapping[str, tuple[int | None, str | None]]] = {
    "H2P_1CH": (1, None),
    "H2P_2CH": (None, None),
    "H2P_NCK": (3, None),
    "H2P_5CH": (5, None),
    "DRC_2CH": (None, None),
    "DRC_3CH": (3, "hand"),
}
SENSOR_TYPES: Final[Mapping[str, str]] = {
    "H2P_IMU": "imu",
    "DRC_IMU": "imu",
    "H2P_TILT": "tilt",
    "H2P_FT": "force_torque",
    "DRC_FT": "force_torque",
}
#: Type of a block → its keys.
KEYS: Final[Mapping[str, tuple[str, ...]]] = {
    "meta": ("name", "default_frequency", "default_can_bus_count"),
    "JMC": ("name", "type", "can_channel", "hardware_index"),
    "IMU": ("name", "type", "can_channel", "hardware_index"),
    "FT": ("name", "type", "can_channel", "hardware_index"),
    "Joint": (
        *("name", "software_index", "drive", "driven", "harmonic", "encoder", "default_kp", "default_kd"),
        *("default_max_pwm", "hardware_index", "jmc_name", "min_max_positions", "nominal_and_max_speeds"),
        "nominal_and_max_accels",
    ),
}
NEEDED: Final[Mapping[str, tuple[str, ...]]] = {
    "meta": (),
    "JMC": ("name", "type", "can_channel", "hardware_index"),
    "IMU": ("name", "type", "can_channel", "hardware_index"),
    "FT": ("name", "type", "can_channel", "hardware_index"),
    "Joint": ("name", "software_index", "hardware_index", "jmc_name"),
}
#: Files of one tree.
MOST_FILES: Final = 200


class FileBlock(NamedTuple):
    """One `begin TYPE … end TYPE`."""

    type: str
    line: WordLine
    lines: dict[str, WordLine]

    def place(self, key: str) -> WordLine:
        return self.lines.get(key, self.line)


class BlockTree:
    """All blocks of a file and its includes, in order."""

    def __init__(self, path: Path) -> None:
        self.problems: list[RobotFileProblem] = []
        self.blocks: list[FileBlock] = []
        self.files: list[Path] = []
        self._read(path, None)

    def _read(self, path: Path, included: WordLine | None) -> None:
        known = path.resolve()
        if known in self.files or len(self.files) >= MOST_FILES:
            if included is not None:
                self.problems.append(included.problem("include", f"{path} is included already"))
            return
        self.files.append(known)
        try:
            lines = read_lines(path)
        except CallerError as error:
            if included is None:
                raise
            self.problems.append(included.problem("include", str(error)))
            return
        block: FileBlock | None = None
        for line in lines:
            if len(self.problems) > MOST:
                break
            word, *values = line.words
            if word == "include" and block is None and len(values) == 1:
                if Path(values[0]).is_absolute():
                    self.problems.append(line.problem("include", "expected a path relative to this file"))
                else:
                    self._read(path.parent / values[0], line)
            elif word == "begin" and len(values) == 1:
                if block is not None:
                    self._unfinished(block)
                block = FileBlock(values[0], line, {})
                if block.type not in KEYS:
                    self._unknown(line, "begin", "type of block", block.type, KEYS)
            elif word == "end" and block is not None:
                if values != [block.type]:
                    self.problems.append(
                        line.problem("end", f"expected end {block.type}, not {' '.join(line.words)!r:.80}")
                    )
                self.blocks.append(block)
                block = None
            elif block is not None and word not in ("include", "end", "begin"):
                self._entry(block, line)
            else:
                text = f"expected begin TYPE, end TYPE or include PATH, not {' '.join(line.words)!r:.80}"
                self.problems.append(line.problem("", text))
        if block is not None:
            self._unfinished(block)

    def _entry(self, block: FileBlock, line: WordLine) -> None:
        key = line.words[0]
        if block.type in KEYS and key not in KEYS[block.type]:
            self._unknown(line, key, f"key of {block.type}", key, KEYS[block.type])
        elif key in block.lines:
            text = f"is there twice: see line {block.lines[key].number}"
            self.problems.append(line.problem(key, text))
        block.lines.setdefault(key, line)

    def _unfinished(self, block: FileBlock) -> None:
        self.problems.append(block.line.problem("begin", f"no end {block.type} follows"))
        self.blocks.append(block)

    def _unknown(self, line: WordLine, key: str, what: str, name: str, known: Any) -> None:
        near = difflib.get_close_matches(name, list(known), n=1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        self.problems.append(
            line.problem(key, f"no {what} named {name!r:.60}{hint} (there are: {', '.join(known)})")
        )

    # ------------------------------------------------------------------ values of a block

    def word(self, block: FileBlock, key: str) -> str | None:
        found = self._values(block, key, str, 1)
        return str(found[0]) if found else None

    def whole(self, block: FileBlock, key: str) -> int | None:
        found = self._values(block, key, whole, 1)
        return int(found[0]) if found else None

    def number(self, block: FileBlock, key: str) -> float | None:
        found = self._values(block, key, plausible_number, 1)
        return float(found[0]) if found else None

    def pair(self, block: FileBlock, key: str) -> tuple[float, float] | tuple[None, None]:
        found = self._values(block, key, plausible_number, 2)
        return (found[0], found[1]) if found else (None, None)

    def _values(self, block: FileBlock, key: str, read: Any, count: int) -> list[Any] | None:
        line = block.lines.get(key)
        if line is None:
            if key in NEEDED.get(block.type, ()):
                self.problems.append(block.line.problem(key, f"{block.type} needs it"))
            return None
        return take(line, key, line.words[1:], read, count, self.problems)

    def among(self, block: FileBlock, key: str, known: Mapping[str, Any]) -> Any:
        """What `known` has for the word of a key."""
        name = self.word(block, key)
        if name is None:
            return None
        if name not in known:
            self._unknown(block.place(key), key, f"{block.type} {key}", name, known)
            return None
        return known[name]


Places = dict[tuple[str, ...], WordLine]


def read_tree(path: Path) -> tuple[dict[str, Any], Places, list[RobotFileProblem]]:
    """A tree as the tables of a robot's file, where each comes from, and what is wrong with it."""
    tree = BlockTree(path)
    content: dict[str, Any] = {"name": path.stem, "buses": {}, "devices": {}, "joints": {}, "sensors": {}}
    places: Places = {}
    buses = 0
    for block in tree.blocks:
        if block.type == "meta":
            content["name"] = tree.word(block, "name") or content["name"]
            if (rate := tree.number(block, "default_frequency")) is not None:
                content["rate_hz"] = rate
            buses = tree.whole(block, "default_can_bus_count") or 0
    _add_boards(tree, content, places)
    _add_joints(tree, content, places)
    _add_sensors(tree, content, places)
    used = {device["bus"] for device in content["devices"].values()}
    for index, name in _hubo.BUSES.items():
        if index < buses or name in used:
            content["buses"][name] = _hubo.bus(index)
    return content, places, tree.problems


def _bus(tree: BlockTree, block: FileBlock) -> str | None:
    channel = tree.whole(block, "can_channel")
    if channel is not None and channel not in _hubo.BUSES:
        tree.problems.append(
            block.place("can_channel").problem("can_channel", f"expected 0…3, not {channel}")
        )
        return None
    return _hubo.BUSES[channel] if channel is not None else None


def _claim(tree: BlockTree, block: FileBlock, section: str, name: str, content: dict[str, Any]) -> bool:
    if name in content[section]:
        tree.problems.append(block.place("name").problem("name", f"{name} is there twice"))
        return False
    return True


def _add_boards(tree: BlockTree, content: dict[str, Any], places: Places) -> None:
    joints: dict[str, int] = {}
    for block in tree.blocks:
        if block.type == "Joint" and "jmc_name" in block.lines and len(block.lines["jmc_name"].words) == 2:
            wired = block.lines["jmc_name"].words[1]
            joints[wired] = joints.get(wired, 0) + 1
    for block in tree.blocks:
        if block.type != "JMC":
            continue
        name, model, bus = tree.word(block, "name"), tree.among(block, "type", JMC_TYPES), _bus(tree, block)
        board = tree.whole(block, "hardware_index")
        if name is None or model is None or bus is None or board is None:
            continue
        if not _claim(tree, block, "devices", name, content):
            continue
        channels, kind = model
        content["devices"][name] = {
            "driver": "hubo_motor",
            "bus": bus,
            "credentials": {"board": board},
            "channels": channels if channels is not None else max(1, joints.get(name, 0)),
            **({"kind": kind} if kind is not None else {}),
            "model": block.lines["type"].words[1],
        }
        places["devices", name] = block.place("name")
        places["devices", name, "credentials"] = block.place("hardware_index")
        places["devices", name, "bus"] = block.place("can_channel")


def _add_joints(tree: BlockTree, content: dict[str, Any], places: Places) -> None:
    order: dict[int, str] = {}
    for block in tree.blocks:
        if block.type != "Joint":
            continue
        name, index = tree.word(block, "name"), tree.whole(block, "software_index")
        channel, board = tree.whole(block, "hardware_index"), tree.word(block, "jmc_name")
        drive, driven = tree.number(block, "drive"), tree.number(block, "driven")
        compliance = {key: tree.number(block, f"default_{key}") for key in ("kp", "kd", "max_pwm")}
        joint: dict[str, Any] = {"device": board, "channel": channel}
        if drive is not None and driven is not None:
            joint["gear"] = [drive, driven]
        joint |= {"harmonic": tree.number(block, "harmonic"), "encoder": tree.whole(block, "encoder")}
        joint["lower"], joint["upper"] = tree.pair(block, "min_max_positions")
        joint["nominal_speed"], joint["max_speed"] = tree.pair(block, "nominal_and_max_speeds")
        joint["nominal_acceleration"], joint["max_acceleration"] = tree.pair(block, "nominal_and_max_accels")
        if any(compliance.values()):
            joint["compliance"] = {key: value for key, value in compliance.items() if value is not None}
        if name is None or index is None or not _claim(tree, block, "joints", name, content):
            continue
        if index in order:
            text = f"{index} is joint {order[index]} already"
            tree.problems.append(block.place("software_index").problem("software_index", text))
            continue
        order[index] = name
        content["joints"][name] = {key: value for key, value in joint.items() if value is not None}
        for key, own in _JOINT_PLACES.items():
            places["joints", name, *key] = block.place(own)
    for expected, (index, name) in enumerate(sorted(order.items())):
        if index != expected:
            line = places["joints", name, "software_index"]
            text = f"joints are numbered from 0 without gaps: {expected} is missing before {index}"
            tree.problems.append(line.problem("software_index", text))
            break
    content["joints"] = {name: content["joints"][name] for _, name in sorted(order.items())}
    _hubo.add_aliases(content["joints"])


#: Key of a joint here → the key there.
_JOINT_PLACES: Final[Mapping[tuple[str, ...], str]] = {
    (): "name",
    ("software_index",): "software_index",
    ("device",): "jmc_name",
    ("channel",): "hardware_index",
    ("gear",): "drive",
    ("harmonic",): "harmonic",
    ("encoder",): "encoder",
    ("lower",): "min_max_positions",
    ("upper",): "min_max_positions",
    ("nominal_speed",): "nominal_and_max_speeds",
    ("max_speed",): "nominal_and_max_speeds",
    ("nominal_acceleration",): "nominal_and_max_accels",
    ("max_acceleration",): "nominal_and_max_accels",
}


def _add_sensors(tree: BlockTree, content: dict[str, Any], places: Places) -> None:
    boards: dict[int, tuple[str, set[str], FileBlock]] = {}
    for block in tree.blocks:
        if block.type not in ("IMU", "FT"):
            continue
        name, kind, bus = tree.word(block, "name"), tree.among(block, "type", SENSOR_TYPES), _bus(tree, block)
        sensor = tree.whole(block, "hardware_index")
        if name is None or kind is None or bus is None or sensor is None:
            continue
        if not _claim(tree, block, "sensors", name, content):
            continue
        known, kinds, _ = boards.setdefault(sensor, (bus, set(), block))
        if known != bus:
            text = f"sensor {sensor} is on the {known} bus already"
            tree.problems.append(block.place("can_channel").problem("can_channel", text))
        kinds.add(kind)
        content["sensors"][name] = {
            "device": _board_name(sensor),
            "kind": kind,
            "model": block.lines["type"].words[1],
        }
        places["sensors", name] = block.place("name")
    for sensor, (bus, kinds, block) in sorted(boards.items()):
        kind = _hubo.sensor_board(sensor, kinds)
        content["devices"][_board_name(sensor)] = {
            "driver": _hubo.DRIVERS[kind],
            "bus": bus,
            "credentials": {"board": sensor + _hubo.SENSOR_BASE, "sensor": sensor},
            "kind": kind,
        }
        places["devices", _board_name(sensor)] = block.place("hardware_index")


def _board_name(sensor: int) -> str:
    board = sensor + _hubo.SENSOR_BASE
    return _hubo.SENSOR_BOARDS.get(board, f"SENSOR_{sensor}")
