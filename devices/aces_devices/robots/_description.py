"""What the description files of Hubo's programs have in common: lines of words, columns, and what they leave to the reader.

1. Every value knows its file and line. Nothing is guessed from a line that is not understood: it is a problem.
2. Sizes are limited; only regular files are read.

Sources of boards' numbers, buses and names: hubo-ach canID.h, hubo-ach and HuboCan, the facts of the protocol's package
`aces_protocols.hubo`.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

from aces_bus.errors import CallerError
from aces_bus.robot.checks import near
from aces_bus.robot.file import RobotFileProblem

#: Bytes of a description file; those of the sources have 7 kB at most.
LARGEST: Final = 2**20
#: Problems of a description; then it is given up.
MOST: Final = 1000
_WORD: Final = re.compile(r'"([^"]*)"|([^\s"#]+)|(#.*)|(")')

#: Board's name → number: JMC0…JMC31, EJMC0…EJMC15.
BOARDS: Final[Mapping[str, int]] = {
    **{f"JMC{number}": number for number in range(0x20)},
    **{f"EJMC{number}": 0x20 + number for number in range(0x10)},
}
#: A sensor board's number is its id and this.
SENSOR_BASE: Final = 0x2F
#: Number of a CAN bus → what it is called here.
BUSES: Final[Mapping[int, str]] = {0: "lower", 1: "upper", 2: "bus2", 3: "bus3"}
SENSOR_BOARDS: Final = ("FT_RF", "FT_LF", "IMU_0", "IMU_1", "IMU_2", "FT_RH", "FT_LH")
#: Names of the same joint in different programs.
SAME: Final = (("WST", "TSY"), ("LKN", "LKP"), ("RKN", "RKP"), ("LEB", "LEP"), ("REB", "REP"))


# ---------------------------------------------------------------------- lines and values


class WordLine(NamedTuple):
    """A line that has words."""

    file: str
    number: int
    words: tuple[str, ...]


def read_lines(path: Path) -> list[WordLine]:
    """Return the lines of a file that have words; `#` begins a comment, quotes keep blanks. Raises `CallerError`."""
    try:
        if path.exists() and not path.is_file():
            raise CallerError(f"{path}: not a file")
        data = path.read_bytes() if path.stat().st_size <= LARGEST else None
    except (OSError, ValueError) as error:
        raise CallerError(f"{path}: {getattr(error, 'strerror', None) or error}") from error
    if data is None:
        raise CallerError(f"{path}: larger than a description may be ({LARGEST >> 20} MB)")
    if b"\0" in data:
        raise CallerError(f"{path}: not a text file")
    lines = enumerate(data.decode("utf-8", "replace").splitlines(), 1)
    found = (WordLine(str(path), number, tuple(_words(text))) for number, text in lines)
    return [line for line in found if line.words]


def _words(text: str) -> Iterator[str]:
    for match in _WORD.finditer(text):
        if match[3] is not None:
            return
        yield match[1] if match[1] is not None else match[2] or match[4]


def c_integer(word: str) -> int:
    """Return a whole number as C reads it, in any of its bases. Raises `ValueError`."""
    text = _checked(word).lstrip("+-")
    if len(text) > 1 and text[0] == "0" and text.isdigit():
        return (-1 if word[0] == "-" else 1) * int(text, 8)
    return int(word, 0)


def decimal_number(word: str) -> int:
    """Return a whole number in decimal, zeros in front or not. Raises `ValueError`."""
    return int(_checked(word), 10)


def plausible_number(word: str) -> float:
    """Return a number of a size that occurs. Raises `ValueError`."""
    value = float(_checked(word))
    if not abs(value) <= 1e12 or 0 < abs(value) < 1e-12:
        raise ValueError
    return value


def _checked(word: str) -> str:
    if len(word) > 40 or "_" in word:
        raise ValueError
    return word


class ValueColumn(NamedTuple):
    """What a value must be: how a word is read, what messages call it, how many words there are, whether it can be absent.

    `names`: it is one of these, and a message proposes the nearest.
    """

    read: Callable[[str], Any]
    what: str
    words: int = 1
    optional: bool = False
    names: Collection[str] = ()


WORD: Final = ValueColumn(str, "a word")
DECIMAL: Final = ValueColumn(decimal_number, "a whole number")
C_INTEGER: Final = ValueColumn(c_integer, "a whole number")
NUMBER: Final = ValueColumn(plausible_number, "a number")


def one_of(values: Iterable[Any], read: Callable[[str], Any] = decimal_number) -> ValueColumn:
    """Return a column of these values."""
    known = {value: value for value in values}
    names = [str(value) for value in known]
    what = " or ".join(names) if len(names) < 5 else f"{names[0]}…{names[-1]}"
    return ValueColumn(lambda word: known[read(word)], what)


def named(what: str, names: Mapping[str, Any]) -> ValueColumn:
    """Return a column of names."""
    return ValueColumn({name: name for name in names}.__getitem__, what, names=names)


# ---------------------------------------------------------------------- a robot being described


class RobotDescription:
    """The tables of a robot's file, the line that each of their keys comes from, and what is wrong with those lines."""

    def __init__(self, content: Mapping[str, Any], first: str) -> None:
        self.content: dict[str, Any] = {"buses": {}, "devices": {}, "joints": {}, "sensors": {}, **content}
        self.places: dict[tuple[str, ...], WordLine] = {}
        self.problems: list[RobotFileProblem] = []
        self.notes: list[str] = []
        self._first = first

    @property
    def is_hopeless(self) -> bool:
        """True if there are so many problems that the rest need not be read."""
        return len(self.problems) > MOST

    def complain(self, line: WordLine, key: str, text: str) -> None:
        """Report a fault of a line."""
        self.problems.append(RobotFileProblem(line.file, line.number, key, text))

    def unknown(self, line: WordLine, key: str, what: str, name: str, known: Collection[str]) -> None:
        """Report a name that is not among the known names."""
        self.complain(
            line, key, f"no {what} named {name!r:.60}{near(name, known)} (there are: {', '.join(known)})"
        )

    def place(self, path: Sequence[str]) -> tuple[str, int]:
        """Return file and line that a key comes from, or the innermost of its tables that has one."""
        wanted = tuple(path)
        while wanted and wanted not in self.places:
            wanted = wanted[:-1]
        return self.places[wanted][:2] if wanted else (self._first, 1)

    def value(self, line: WordLine, key: str, words: Sequence[str], column: ValueColumn) -> Any:
        """Return the value of a column; None, and a problem, when it is not there."""
        if len(words) == column.words:
            try:
                found = [column.read(word) for word in words]
                return found[0] if column.words == 1 else found
            except (ValueError, KeyError):
                pass
        if column.names and len(words) == 1:
            self.unknown(line, key, column.what, words[0], column.names)
        else:
            wanted = column.what if column.words == 1 else f"{column.words} values, each {column.what}"
            self.complain(line, key, f"expected {wanted}, not {' '.join(words)[:60]!r}")
        return None

    def names(self) -> dict[str, str]:
        """Return the joints' names and aliases, each with the name here."""
        return {
            alias: name
            for name, joint in self.content["joints"].items()
            for alias in (name, *joint.get("aliases", ()))
        }

    def add_sensor(
        self,
        line: WordLine,
        name: str,
        number: int,
        bus: str,
        kind: str,
        *,
        active: bool = True,
        **entry: Any,
    ) -> None:
        """Add a sensor and its board, whose kind follows from its sensors: feet have tilt beside force and torque."""
        devices, sensors = self.content["devices"], self.content["sensors"]
        known = 0 < number <= len(SENSOR_BOARDS)
        board = SENSOR_BOARDS[number - 1] if known else f"SENSOR_{number}"
        before = devices.get(board, {"bus": bus, "active": False})
        if before["bus"] != bus:
            self.complain(line, "can", f"sensor {number} is on the {before['bus']} bus already")
        kinds = {kind} | {sensor["kind"] for sensor in sensors.values() if sensor["device"] == board}
        is_foot = "tilt" in kinds or number in (1, 2)
        devices[board] = {
            "driver": "hubo_imu" if "imu" in kinds else "hubo_ft",
            "bus": bus,
            "credentials": {"board": number + SENSOR_BASE, "sensor": number},
            "kind": "imu" if "imu" in kinds else "foot" if is_foot else "ft",
            "active": active or before["active"],
        }
        sensors[name] = {"device": board, "kind": kind, "active": active, **entry}
        self.places["sensors", name] = line
        self.places.setdefault(("devices", board), line)

    def finish(self, count: int = 0) -> None:
        """Add the first `count` buses and those in use, of dialect D12; and the joints' names in other programs."""
        used = {device["bus"] for device in self.content["devices"].values()}
        for number, name in BUSES.items():
            if number < count or name in used:
                more = {"dialect": "D12", "bitrate": 1_000_000, "channel": f"can{number}"}
                self.content["buses"][name] = {"link": "can", "protocol": "hubo", **more}
        joints = self.content["joints"]
        for names in SAME:
            present = [name for name in names if name in joints]
            if len(present) == 1:
                joints[present[0]]["aliases"] = [name for name in names if name != present[0]]
