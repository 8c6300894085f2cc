"""A robot's file: TOML to `Robot` with all that is wrong at once, and a `Robot` as TOML.

1. All problems are found, not the first: each key is checked by itself, then what depends on several.
2. A problem has file, line, key and what is expected; keys and names that are near are proposed.
3. A file is read, never run; its size is limited. Files that it names lie below its folder. A protocol's Python file is run
   only to load a robot, never to check or show one, unless the program has run it already.
4. `print_robot` writes one line an entry: read again, the text gives an equal robot. What is unknown is not written.

The file's tables hold one entry a bus, device, joint, sensor, state and controller; an entry's keys are the fields of its
struct.
"""

from __future__ import annotations

import math
import os
import re
import reprlib
import tomllib
import types
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from datetime import date, time
from functools import cache
from typing import Annotated, Any, Final, TypeVar, Union, get_args, get_origin

import msgspec
from msgspec.structs import FieldInfo, fields

from ..device.config import (
    Bus,
    ControllerConfig,
    DeviceConfig,
    Input,
    Joint,
    Robot,
    Sensor,
    StateConfig,
)
from ..errors import AcesError, CallerError
from .checks import check, near
from .named_files import NamedFiles, NotRunError
from .toml_lines import KeyLines

T = TypeVar("T", bound=msgspec.Struct)

#: Bytes of a file; the largest that ships has 15 kB.
LARGEST: Final = 2**20
#: Problems of a file; then it is given up.
MOST: Final = 1000
#: Tables and lists within one another, in a value.
DEEPEST: Final = 8
ENTRIES: Final[Mapping[str, type[msgspec.Struct]]] = {
    "buses": Bus,
    "devices": DeviceConfig,
    "joints": Joint,
    "sensors": Sensor,
    "states": StateConfig,
    "controllers": ControllerConfig,
    "estop": Input,
}
#: Where one of these is wrong, what depends on them is not looked at.
BASIC: Final = {"link", "protocol", "dialect", "bus", "credentials", "channels", "kind", "device", "channel"}
NAME: Final = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,99}")


class RobotFileProblem(msgspec.Struct, frozen=True, order=True):
    """One complaint. `line` counts from 1; `key` is the dotted path in the file, "" for the file as a whole."""

    file: str
    line: int
    key: str
    text: str
    is_warning: bool = False

    def __str__(self) -> str:
        key = f"{self.key}: " if self.key else ""
        return f"{self.file}:{self.line}: {'warning: ' if self.is_warning else ''}{key}{self.text}"


class RobotError(CallerError):
    """A robot's file that cannot be used: the message has one line a problem, all of them."""

    def __init__(self, problems: Sequence[RobotFileProblem]) -> None:
        super().__init__("\n".join(map(str, problems)))
        self.problems = tuple(problems)


def check_robot_file(
    path: str | os.PathLike[str], *, is_strict: bool = False, runs_protocols: bool = False
) -> tuple[Robot | None, list[RobotFileProblem]]:
    """Return the robot of a TOML file, and all that is wrong with it, in the file's order; no robot where something is an
    error.

    With `is_strict` warnings are errors; with `runs_protocols` the Python files that it names are run. Raises `CallerError`
    for a file that cannot be read.
    """
    file = os.fspath(path)
    try:
        with open(file, "rb") as stream:
            data = stream.read(LARGEST + 1)
    except (OSError, ValueError) as error:
        raise CallerError(f"{file}: {getattr(error, 'strerror', None) or error}") from error
    files = NamedFiles(os.path.dirname(file), runs_protocols=runs_protocols)
    return _parse(data, file, is_strict, files)


def parse_robot(
    text: str | bytes, file: str = "robot.toml", *, is_strict: bool = False
) -> tuple[Robot | None, list[RobotFileProblem]]:
    """Do what `check_robot` does, of a file's content. Problems call it `file`, whose stem names a robot without a name."""
    return _parse(text, file, is_strict, None)


def _parse(
    text: str | bytes, file: str, is_strict: bool, files: NamedFiles | None
) -> tuple[Robot | None, list[RobotFileProblem]]:
    try:
        content, lines = _parsed(text)
    except _NotToml as error:
        return None, [RobotFileProblem(file, error.line, "", str(error))]
    content.setdefault("name", os.path.splitext(os.path.basename(file))[0])
    return _make(content, lambda path: (file, lines.of(path)), is_strict, files)


#: File and line of a key.
Place = Callable[[Sequence[str]], tuple[str, int]]


def make_robot(
    content: Mapping[str, Any], place: Place, *, is_strict: bool = False
) -> tuple[Robot | None, list[RobotFileProblem]]:
    """Do what `check_robot` does, of tables that come from anywhere; `place` says where a key of theirs comes from."""
    return _make(content, place, is_strict, None)


def _make(
    content: Mapping[str, Any], place: Place, is_strict: bool, files: NamedFiles | None
) -> tuple[Robot | None, list[RobotFileProblem]]:
    reader = _Reader(place, files)
    robot: Robot | None = None
    with suppress(_Enough):
        robot = reader.read(content)
    problems = sorted(set(reader.problems))
    if is_strict:
        problems = [msgspec.structs.replace(problem, is_warning=False) for problem in problems]
    return (None if any(not problem.is_warning for problem in problems) else robot), problems


def is_robot(content: Mapping[str, Any]) -> bool:
    """Return whether a TOML file's content is a robot's rather than bare configuration tables: a robot has buses."""
    return "buses" in content


class _NotToml(Exception):
    """Not a TOML file of a size that a robot's may have."""

    def __init__(self, line: int, text: str) -> None:
        super().__init__(text)
        self.line = line


def _parsed(text: str | bytes) -> tuple[dict[str, Any], KeyLines]:
    """Return a TOML file's content, and where its keys stand."""
    if len(text) > LARGEST:
        raise _NotToml(1, f"larger than a robot's file may be ({LARGEST >> 20} MB)")
    try:
        if isinstance(text, bytes):
            text = text.decode("utf-8-sig")
        lines = KeyLines(text)
        if lines.too_long is not None:
            raise _NotToml(lines.too_long, "not a robot: a key of very many parts")
        return tomllib.loads(text), lines
    except UnicodeDecodeError as error:
        line = 1 + error.object[: error.start].count(b"\n")
        raise _NotToml(line, "not a TOML file: not UTF-8 text") from None
    except RecursionError:
        raise _NotToml(1, "not a robot: nested too deeply") from None
    except ValueError as error:  # TOMLDecodeError is one; so is a number of too many digits
        assert isinstance(text, str)
        place = re.search(r" \(at (?:line (\d+), column (\d+)|end of document)\)$", str(error))
        line = 1 if place is None else int(place[1]) if place[1] else text.count("\n") + 1
        said = str(error).partition(";")[0] if place is None else str(error)[: place.start()]
        column = f" (column {place[2]})" if place is not None and place[2] else ""
        raise _NotToml(line, f"not a TOML file: {said}{column}") from None


class _Enough(Exception):
    """So much is wrong that the rest does not matter."""


class _Reader:
    """Makes one robot and collects what is wrong with it."""

    def __init__(self, place: Place, files: NamedFiles | None) -> None:
        self.place = place
        #: None: the content is no file's, and names of files in it stay as they are.
        self.files = files
        self.problems: list[RobotFileProblem] = []

    def complain(self, path: Sequence[str], text: str, is_warning: bool = False) -> None:
        names = [name if NAME.fullmatch(name) and "." not in name else f"{name!r:.60}" for name in path]
        self.problems.append(RobotFileProblem(*self.place(path), ".".join(names), text, is_warning))
        if len(self.problems) == MOST:
            self.problems.append(
                RobotFileProblem(
                    *self.place(()), "", f"{MOST} problems: the rest of the file is not looked at"
                )
            )
            raise _Enough

    def read(self, content: Mapping[str, Any]) -> Robot:
        known = [field.name for field in _fields(Robot)]
        self._unknown_keys((), content, known, "a robot")
        values: dict[str, Any] = {}
        for field in _fields(Robot):
            if field.name not in ENTRIES:
                values |= self._field(field, (), content)
        for section, kind in ENTRIES.items():
            values[section] = self._section(section, kind, content.get(section, {}))
        if not values["buses"] and not self.problems:
            self.complain(
                (),
                'a robot has buses: [buses], with lines such as upper = { link = "can", protocol = "NAME" }',
            )
        values.setdefault("name", "")  # said to be missing; what else is wrong is looked for all the same
        self._resolved(values, ())
        robot = Robot(**values)
        written = {s: set(content[s]) if isinstance(content.get(s), dict) else set[str]() for s in ENTRIES}
        check(robot, written, self.complain)
        return robot

    # ------------------------------------------------------------------ entries

    def _section(self, section: str, kind: type[T], content: Any) -> dict[str, T]:
        if not isinstance(content, dict):
            self.complain(
                (section,),
                f"expected a table, written as [{section}] with one entry a line, not {_shown(content)}",
            )
            return {}
        found: dict[str, T] = {}
        for name, entry in content.items():
            path = (section, name)
            if not NAME.fullmatch(name):
                self.complain(
                    path,
                    "a name has letters, digits, _ . and -, no other characters, and 100 of them at most",
                )
            before = len(self.problems)
            made = self._struct(kind, path, entry, name=name)
            errors = [problem for problem in self.problems[before:] if not problem.is_warning]
            wrong = {problem.key.rpartition(".")[2] for problem in errors}
            if made is not None and not wrong & BASIC:
                found[name] = made
        return found

    def _resolved(self, values: dict[str, Any], path: tuple[str, ...]) -> None:
        """Replace the files that an entry names: a protocol by its name, data of a driver by its place below the folder."""
        if self.files is None:
            return
        for key, resolve in (
            ("protocol", self.files.protocol),
            ("settings", self.files.data),
            ("body", self.files.body),
            ("physics", self.files.physics),
        ):
            if values.get(key) is not None:
                try:
                    values[key] = resolve(values[key])
                except NotRunError as note:
                    self.complain((*path, key), str(note), is_warning=True)
                except AcesError as error:
                    self.complain((*path, key), str(error))

    def _struct(self, kind: type[T], path: tuple[str, ...], content: Any, **given: str) -> T | None:
        """Return one table as a struct; None when a key that it needs is missing or wrong."""
        noun = kind.__name__.removesuffix("Config")
        what = f"{'an' if noun[0] in 'AEIOU' else 'a'} {noun.lower()}"
        infos = [field for field in _fields(kind) if field.name not in given]
        if not isinstance(content, dict):
            names = " = …, ".join(field.name for field in infos if field.required) or infos[0].name
            self.complain(path, f"expected {what}: a table, {{ {names} = … }}, not {_shown(content)}")
            return None
        self._unknown_keys(path, content, [field.name for field in infos], what)
        values: dict[str, Any] = dict(given)
        for field in infos:
            values |= self._field(field, path, content)
        self._resolved(values, path)
        return None if any(field.required and field.name not in values for field in infos) else kind(**values)

    def _field(self, field: FieldInfo, path: tuple[str, ...], content: Mapping[str, Any]) -> dict[str, Any]:
        """Return the value of a key, as keywords for the struct: none where it is absent or wrong."""
        at = (*path, field.name)
        if field.name not in content:
            if field.required:
                self.complain((*path, field.name), f"is missing: expected {_expected(field.type)}")
            return {}
        value = content[field.name]
        if not _is_shallow(value):
            self.complain(at, f"tables and lists within one another, deeper than {DEEPEST}")
            return {}
        nested = _struct_in(field.type)
        if nested is not None:
            unnamed = {"name": ""} if any(field.name == "name" for field in _fields(nested)) else {}
            made = self._struct(nested, at, value, **unnamed)
            return {} if made is None else {field.name: made}
        try:
            converted = msgspec.convert(value, field.type)
        except (msgspec.ValidationError, OverflowError):
            self.complain(at, f"expected {_expected(field.type)}, not {_shown(value)}")
            return {}
        if not _is_finite(converted):
            self.complain(at, f"expected {_expected(field.type)}, not {_shown(value)}")
            return {}
        return {field.name: converted}

    def _unknown_keys(
        self, path: tuple[str, ...], content: Mapping[str, Any], known: list[str], what: str
    ) -> None:
        for key in content:
            if key not in known:
                self.complain(
                    (*path, key), f"{what} has no such key{near(key, known)} (keys: {', '.join(known)})"
                )


@cache
def _fields(kind: type[msgspec.Struct]) -> tuple[FieldInfo, ...]:
    """Return a struct's fields; msgspec evaluates annotations anew each time."""
    return fields(kind)


def _shown(value: Any) -> str:
    """Return a value of the file, short."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int) and value.bit_length() > 128:
        return "so large a number"
    text = _REPR.repr(value)
    return text if len(text) <= 60 else f"{text[:57]}…"


_REPR: Final = reprlib.Repr()
_REPR.maxlevel, _REPR.maxstring, _REPR.maxother = 3, 60, 60


def _is_shallow(value: Any) -> bool:
    """Return whether tables and lists are nested no deeper than `DEEPEST`."""
    level = [value]
    for _ in range(DEEPEST):
        level = [
            inner
            for part in level
            if isinstance(part, (dict, list))
            for inner in (part.values() if isinstance(part, dict) else part)
        ]
        if not level:
            return True
    return False


def _is_finite(value: Any) -> bool:
    if isinstance(value, float):
        return math.isfinite(value)
    if isinstance(value, (tuple, list)):
        return all(map(_is_finite, value))
    return True


def _parts(annotation: Any) -> list[Any]:
    """Return the alternatives of an annotation, None left out."""
    if get_origin(annotation) in (types.UnionType, Union):
        return [part for arg in get_args(annotation) if arg is not type(None) for part in _parts(arg)]
    return [annotation]


def _expected(annotation: Any) -> str:
    """Return what may stand there, in words."""
    (part,) = _parts(annotation)
    meta = (
        next((m for m in part.__metadata__ if m.description), None) if get_origin(part) is Annotated else None
    )
    return str(meta.description) if meta is not None else f"a {getattr(part, '__name__', part)}"


def _struct_in(annotation: Any) -> type[msgspec.Struct] | None:
    return next(
        (p for p in _parts(annotation) if isinstance(p, type) and issubclass(p, msgspec.Struct)), None
    )


# ---------------------------------------------------------------------- writing

_BARE: Final = re.compile(r"[A-Za-z0-9_-]+")
_ESCAPED: Final = {"\\": "\\\\", '"': '\\"', "\n": "\\n", "\t": "\\t", "\r": "\\r", "\b": "\\b", "\f": "\\f"}


def print_robot(robot: Robot, notes: Iterable[str] = ()) -> str:
    """Return the robot's TOML file; `notes` become comments at its head."""
    lines = [f"# {note}".rstrip() for note in notes]
    lines += [f"{name} = {_toml(value)}" for name, value in _stated(robot).items() if name not in ENTRIES]
    for section in ENTRIES:
        entries: Mapping[str, msgspec.Struct] = getattr(robot, section)
        if entries:
            lines += ["", f"[{section}]"]
            lines += [f"{_toml_key(name)} = {_toml(entry, ('name',))}" for name, entry in entries.items()]
    return "\n".join(lines) + "\n"


def _stated(struct: msgspec.Struct) -> dict[str, Any]:
    """Return the fields of a struct that are known and not what they are by default; a joint's channel always."""
    values = [(field, getattr(struct, field.name)) for field in fields(type(struct))]
    return {
        field.name: value
        for field, value in values
        if (field.required or field.name == "channel" or value != field.default)
        and value is not None
        and value != {}
    }


def _toml(value: Any, without: tuple[str, ...] = ()) -> str:
    match value:
        case msgspec.Struct():
            value = {name: inner for name, inner in _stated(value).items() if name not in without}
            return _toml_table(
                {
                    name: _hex(inner) if name == "credentials" else _toml(inner)
                    for name, inner in value.items()
                }
            )
        case Mapping():
            return _toml_table({name: _toml(inner) for name, inner in value.items()})
        case bool():
            return "true" if value else "false"
        case str():
            return _toml_text(value)
        case list() | tuple():
            return f"[{', '.join(map(_toml, value))}]"
        case float() if value.is_integer() and abs(value) < 1e15:
            return str(int(value))
        case _:
            return value.isoformat() if isinstance(value, (date, time)) else repr(value)


def _hex(credentials: Mapping[str, int]) -> str:
    return _toml_table({name: f"0x{number:02X}" for name, number in credentials.items()})


def _toml_table(values: Mapping[str, str]) -> str:
    return (
        f"{{ {', '.join(f'{_toml_key(name)} = {value}' for name, value in values.items())} }}"
        if values
        else "{}"
    )


def _toml_key(name: str) -> str:
    return name if _BARE.fullmatch(name) else _toml_text(name)


def _toml_text(text: str) -> str:
    escaped = "".join(_ESCAPED.get(c) or (c if c.isprintable() else f"\\U{ord(c):08X}") for c in text)
    return f'"{escaped}"'
