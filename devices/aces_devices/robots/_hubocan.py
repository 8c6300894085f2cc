"""HuboCan's description trees (`.dd`): `begin TYPE … end TYPE` blocks of keys and values, and includes.

1. Every block is read; what is wrong is collected, with file and line.
2. Includes are relative to their file, are read once each, and cannot lead in circles.

Sensors have ids there, boards are theirs plus 0x2F. A board of type H2P_2CH or DRC_2CH has as many channels as it has
joints (one or two), as hubo-ach's tables count them.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final, NamedTuple

from aces_bus.errors import CallerError

from ._description import (
    BUSES,
    C_INTEGER,
    NUMBER,
    WORD,
    RobotDescription,
    ValueColumn,
    WordLine,
    c_integer,
    named,
    one_of,
    read_lines,
)

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
_NUMBER, _PAIR = NUMBER._replace(optional=True), NUMBER._replace(optional=True, words=2)
_INTEGER = C_INTEGER._replace(optional=True)


def _board(what: str, types: Mapping[str, Any]) -> dict[str, ValueColumn]:
    can = one_of(BUSES, c_integer)
    return {
        "name": WORD,
        "type": named(f"{what} type", types),
        "can_channel": can,
        "hardware_index": C_INTEGER,
    }


#: Type of a block → its keys.
KEYS: Final[Mapping[str, Mapping[str, ValueColumn]]] = {
    "meta": {
        "name": WORD._replace(optional=True),
        "default_frequency": _NUMBER,
        "default_can_bus_count": _INTEGER,
    },
    "JMC": _board("JMC", JMC_TYPES),
    "IMU": _board("IMU", SENSOR_TYPES),
    "FT": _board("FT", SENSOR_TYPES),
    "Joint": {
        "name": WORD,
        "software_index": C_INTEGER,
        "hardware_index": C_INTEGER,
        "jmc_name": WORD,
        **dict.fromkeys(("drive", "driven", "harmonic"), _NUMBER),
        "encoder": _INTEGER,
        **dict.fromkeys(("default_kp", "default_kd", "default_max_pwm"), _NUMBER),
        **dict.fromkeys(("min_max_positions", "nominal_and_max_speeds", "nominal_and_max_accels"), _PAIR),
    },
}
#: Key of a joint here → the key there, and which of its values (None: the only one).
JOINT: Final[Mapping[str, tuple[str, int | None]]] = {
    "device": ("jmc_name", None),
    "channel": ("hardware_index", None),
    "harmonic": ("harmonic", None),
    "encoder": ("encoder", None),
    "lower": ("min_max_positions", 0),
    "upper": ("min_max_positions", 1),
    "nominal_speed": ("nominal_and_max_speeds", 0),
    "max_speed": ("nominal_and_max_speeds", 1),
    "nominal_acceleration": ("nominal_and_max_accels", 0),
    "max_acceleration": ("nominal_and_max_accels", 1),
}
#: Files of one tree.
MOST_FILES: Final = 200


class FileBlock(NamedTuple):
    """One `begin TYPE … end TYPE`: its first line, and the line of each key."""

    type: str
    line: WordLine
    lines: dict[str, WordLine]

    def at(self, key: str) -> WordLine:
        """Return the line of a key, or of the block."""
        return self.lines.get(key, self.line)


class BlockTree:
    """All blocks of a file and its includes, in order."""

    def __init__(self, path: Path, made: RobotDescription) -> None:
        self.made = made
        self.blocks: list[FileBlock] = []
        self.files: list[Path] = []
        self._read(path, None)

    def _read(self, path: Path, included: WordLine | None) -> None:
        complain, known = self.made.complain, path.resolve()
        if known in self.files or len(self.files) >= MOST_FILES:
            if included is not None:
                complain(included, "include", f"{path} is included already")
            return
        self.files.append(known)
        try:
            lines = read_lines(path)
        except CallerError as error:
            if included is None:
                raise
            complain(included, "include", str(error))
            return
        block: FileBlock | None = None
        for line in lines:
            if self.made.is_hopeless:
                break
            word, *values = line.words
            if word == "include" and block is None and len(values) == 1:
                if Path(values[0]).is_absolute():
                    complain(line, "include", "expected a path relative to this file")
                else:
                    self._read(path.parent / values[0], line)
            elif word == "begin" and len(values) == 1:
                self._end(block)
                block = FileBlock(values[0], line, {})
                if block.type not in KEYS:
                    self.made.unknown(line, "begin", "type of block", block.type, KEYS)
            elif word == "end" and block is not None:
                if values != [block.type]:
                    complain(line, "end", f"expected end {block.type}, not {' '.join(line.words)!r:.80}")
                self.blocks.append(block)
                block = None
            elif block is not None and word not in ("include", "end", "begin"):
                if word in block.lines:
                    complain(line, word, f"is there twice: see line {block.lines[word].number}")
                elif block.type in KEYS and word not in KEYS[block.type]:
                    self.made.unknown(line, word, f"key of {block.type}", word, KEYS[block.type])
                block.lines.setdefault(word, line)
            else:
                text = f"expected begin TYPE, end TYPE or include PATH, not {' '.join(line.words)!r:.80}"
                complain(line, "", text)
        self._end(block)

    def _end(self, block: FileBlock | None) -> None:
        """End a block that has no end of its own."""
        if block is not None:
            self.made.complain(block.line, "begin", f"no end {block.type} follows")
            self.blocks.append(block)

    def entries(self, *types: str) -> list[tuple[FileBlock, dict[str, Any]]]:
        """Return the blocks of some types with their values; those that lack what they need are left out, and are
        problems.
        """
        found: list[tuple[FileBlock, dict[str, Any]]] = []
        for block in self.blocks:
            if block.type not in types:
                continue
            row: dict[str, Any] = {}
            for key, column in KEYS[block.type].items():
                if key in block.lines:
                    row[key] = self.made.value(block.lines[key], key, block.lines[key].words[1:], column)
                elif not column.optional:
                    self.made.complain(block.line, key, f"{block.type} needs it")
            if all(
                row.get(key) is not None for key, column in KEYS[block.type].items() if not column.optional
            ):
                found.append((block, row))
        return found

    def claim(self, block: FileBlock, section: str, name: str) -> bool:
        """Return whether an entry's name is free."""
        if name in self.made.content[section]:
            self.made.complain(block.at("name"), "name", f"{name} is there twice")
            return False
        return True


def read_tree(path: Path, made: RobotDescription) -> int:
    """Return a tree as the tables of a robot's file; how many buses it says there are."""
    tree = BlockTree(path, made)
    buses = 0
    for _, row in tree.entries("meta"):
        made.content["name"] = row.get("name") or made.content["name"]
        if row.get("default_frequency") is not None:
            made.content["rate_hz"] = row["default_frequency"]
        buses = row.get("default_can_bus_count") or 0
    joints = tree.entries("Joint")
    _add_boards(tree, [row["jmc_name"] for _, row in joints])
    _add_joints(tree, joints)
    for block, row in tree.entries("IMU", "FT"):
        if tree.claim(block, "sensors", row["name"]):
            kind, bus = SENSOR_TYPES[row["type"]], BUSES[row["can_channel"]]
            made.add_sensor(
                block.at("name"), row["name"], row["hardware_index"], bus, kind, model=row["type"]
            )
    return buses


def _add_boards(tree: BlockTree, wired: list[str]) -> None:
    places = tree.made.places
    for block, row in tree.entries("JMC"):
        name = row["name"]
        if not tree.claim(block, "devices", name):
            continue
        channels, kind = JMC_TYPES[row["type"]]
        tree.made.content["devices"][name] = {
            "driver": "hubo_motor",
            "bus": BUSES[row["can_channel"]],
            "credentials": {"board": row["hardware_index"]},
            "channels": channels if channels is not None else max(1, wired.count(name)),
            **({"kind": kind} if kind is not None else {}),
            "model": row["type"],
        }
        places["devices", name] = block.at("name")
        places["devices", name, "credentials"] = block.at("hardware_index")
        places["devices", name, "bus"] = block.at("can_channel")


def _add_joints(tree: BlockTree, entries: list[tuple[FileBlock, dict[str, Any]]]) -> None:
    made, order = tree.made, dict[int, tuple[str, WordLine]]()
    joints, places = made.content["joints"], made.places
    for block, row in entries:
        name, index = row["name"], row["software_index"]
        if not tree.claim(block, "joints", name):
            continue
        line = block.at("software_index")
        if order.setdefault(index, (name, line))[0] != name:
            made.complain(line, "software_index", f"{index} is joint {order[index][0]} already")
            continue
        joint = joints[name] = dict[str, Any]()
        places["joints", name] = block.at("name")
        for key, (own, part) in JOINT.items():
            value = row.get(own)
            if value is not None:
                joint[key] = value if part is None else value[part]
                places["joints", name, key] = block.at(own)
        if row.get("drive") is not None and row.get("driven") is not None:
            joint["gear"], places["joints", name, "gear"] = [row["drive"], row["driven"]], block.at("drive")
        compliance = {key: row.get(f"default_{key}") for key in ("kp", "kd", "max_pwm")}
        if any(compliance.values()):
            joint["compliance"] = {key: value for key, value in compliance.items() if value is not None}
    for expected, (index, (_, line)) in enumerate(sorted(order.items())):
        if index != expected and len(order) == len(entries):
            text = f"joints are numbered from 0 without gaps: {expected} is missing before {index}"
            made.complain(line, "software_index", text)
            break
    made.content["joints"] = {name: joints[name] for _, (name, _) in sorted(order.items())}
