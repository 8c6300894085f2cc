"""`-p`: which protocol, in which dialect and configuration.

    hubo                    an installed protocol (`aces protocols` lists them), default dialect and configuration
    hubo:D08                a dialect
    hubo:D08@hubo2          a configuration that ships with the protocol
    hubo@robot.toml         a configuration of your own, from a file: a robot's (docs/robots.md), or bare tables
    my_spec.py              the one protocol that a Python file declares; my_spec.py:NAME where there are several;
                            dialect and configuration follow as above (my_spec.py:NAME:D08@robot.toml)
    car.dbc                 a database of messages: .dbc, .kcd, .sym, .arxml; CANopen: .eds, .dcf
    common.xml              a MAVLink dialect; common.xml:v1 for the packets of MAVLink 1
    canboat.json            canboat's table of NMEA 2000
    can0=car.dbc            any of these, for the frames of one channel only

What of a database cannot be taken over is said once, on stderr.

A Python file is executed, with all your rights, like any program that you start: name only files that you trust.

A robot's file says which board is what, and in which dialect it speaks where none is named. A file of bare tables holds
those of the protocol's configurations, and with `base` only what differs:

    base = "hubo2plus"      # optional: start from this shipped configuration, change the entries below
    [channels]
    0x00 = 2
    0x24 = 3

1. A table that the file names replaces the shipped one; without `base`, all that the protocol needs must be there.
2. Every complaint names the file, and what would have worked.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

from aces_bus import load_protocol
from aces_bus.errors import CallerError, UnknownNameError
from aces_bus.protocol import Protocol, Variant
from aces_bus.protocol.exchange import database_suffixes
from aces_bus.protocol.exchange.problems import ImportedProtocol
from aces_bus.protocol.exchange.read_once import known_database
from aces_bus.protocol.record import PlainValue

from .console import say_note

_FILE = re.compile(
    rf"(?P<path>.+\.(?P<kind>py|{'|'.join(suffix[1:] for suffix in database_suffixes())}))"
    r"(?P<names>(?::[^:@/\\]+)*)(?:@(?P<configuration>.+))?",
    re.IGNORECASE,
)
_CHANNEL = re.compile(r"(?P<channel>[^=:@/\\]+)=(?P<rest>.+)", re.DOTALL)
_NAME = re.compile(r"(?P<name>[^:@]+)(?::(?P<dialect>[^:@]+))?(?:@(?P<configuration>.+))?")

SYNTAX = "write NAME, NAME:DIALECT, NAME@CONFIGURATION, NAME@robot.toml, my_spec.py or car.dbc"


class Named(NamedTuple):
    """What a `-p` names: None for what it leaves to the protocol."""

    protocol: Protocol
    dialect: str | None
    configuration: str | None
    #: What `load_protocol` takes for it: a name, or a path.
    source: str
    channel: str | None = None

    def variant(self) -> Variant:
        """Return the protocol in this dialect and configuration; raises `CallerError` for one that it does not have."""
        dialect, configuration = self.decided()
        found = self.protocol.variant(dialect, configuration)
        return found if self.channel is None else found.on(self.channel)

    def decided(self) -> tuple[str | None, str | dict[str, Mapping[int, Any]] | None]:
        """Return dialect and configuration, of a file its tables; raise `CallerError` for a file that has none."""
        configuration = self.configuration
        if configuration is None or not configuration.lower().endswith(".toml"):
            return self.dialect, configuration
        tables, dialect = read_configuration(configuration, self.protocol)
        return dialect if self.dialect is None else self.dialect, tables or None


def parse_protocols(texts: Iterable[str]) -> list[Variant]:
    """Return the variants of several `-p`, each once, in the order given."""
    return list(dict.fromkeys(named_protocol(text).variant() for text in texts))


def named_protocol(text: str) -> Named:
    """Return the protocol that a `-p` names; raise `CallerError` with the valid choices."""
    bound = _CHANNEL.fullmatch(text)
    if bound and not os.path.exists(text):
        return named_protocol(bound["rest"])._replace(channel=bound["channel"])
    file = _FILE.fullmatch(text)
    if file:
        names = file["names"].split(":")[1:]
        read = _named_python if file["kind"].lower() == "py" else _named_database
        return read(text, file["path"], names, file["configuration"])
    installed = _NAME.fullmatch(text)
    if installed is None:
        raise CallerError(f"-p {text!r} is not understood; {SYNTAX}")
    name = installed["name"]
    return Named(_installed(name), installed["dialect"], installed["configuration"], name)


def _named_database(text: str, path: str, names: list[str], configuration: str | None) -> Named:
    """Read a DBC, EDS or the like; `names` may hold a dialect, which only some of them have."""
    protocol = known_database(path, _say_problems)
    if len(names) > bool(protocol.dialects) or configuration is not None:
        has = "no configurations" if protocol.dialects else "neither dialects nor configurations"
        raise CallerError(f"-p {text}: {path} has {has}")
    return Named(protocol, names[0] if names else None, None, path)


def _named_python(text: str, path: str, names: list[str], configuration: str | None) -> Named:
    """Read a Python file: `names` are the protocol's, if the file has several, and then the dialect's."""
    from aces_bus.protocol.files import protocol_of_file

    protocol, left = protocol_of_file(path, names)
    if len(left) > 1:
        raise CallerError(f"-p {text}: nothing named {left[1]!r} is left to choose; {SYNTAX}")
    source = ":".join([path, *names[: len(names) - len(left)]])
    return Named(protocol, left[0] if left else None, configuration, source)


def _installed(name: str) -> Protocol:
    try:
        return load_protocol(name)
    except UnknownNameError as unknown:
        for suffix in (".py", *database_suffixes()):
            if os.path.exists(name + suffix):
                raise CallerError(f"{unknown}; the file of that name: -p {name}{suffix}") from None
        if os.path.isfile(name):
            kinds = " ".join((".py", *database_suffixes()))
            raise CallerError(
                f"-p {name}: a file that declares a protocol has one of the suffixes {kinds}"
            ) from None
        raise


def _say_problems(imported: ImportedProtocol) -> None:
    """Say on stderr what of a database could not be taken over; only the first process does."""
    from multiprocessing import parent_process

    if parent_process() is None:
        more = f" (all: aces protocols {imported.path})" if len(imported.problems) > 1 else ""
        say_note(imported.summary + more)


# ---------------------------------------------------------------------- configuration files


def read_configuration(path: str, protocol: Protocol) -> tuple[dict[str, Mapping[int, Any]], str | None]:
    """Return the configuration tables of a TOML file, and the dialect that it names; None: none.

    Raises `CallerError` naming file and entry.
    """
    import tomllib

    try:
        with open(path, "rb") as file:
            data = file.read()
        content = tomllib.loads(data.decode("utf-8-sig"))
    except OSError as error:
        raise CallerError(f"{path}: {error.strerror or error}") from error
    except (ValueError, RecursionError) as error:  # tomllib's own, decoding, numbers too long
        raise CallerError(f"{path}: not a TOML file: {error}") from error
    if "buses" in content:  # as `aces_bus.device.is_robot` has it, not yet imported
        return _of_robot(path, data, protocol)
    return _of_tables(path, content, protocol), None


def _of_robot(path: str, data: bytes, protocol: Protocol) -> tuple[dict[str, Mapping[int, Any]], str | None]:
    """Return what a robot's file says of a protocol; raises `CallerError` with all that is wrong with the file."""
    from aces_bus.robot import parse_robot
    from aces_bus.robot.file import RobotError

    robot, problems = parse_robot(data, path)
    if robot is None:
        raise RobotError([problem for problem in problems if not problem.is_warning])
    return {**robot.tables(protocol)}, robot.dialect(protocol.name)


def _of_tables(
    path: str, content: Mapping[str, PlainValue], protocol: Protocol
) -> dict[str, Mapping[int, Any]]:
    """Return the tables of a file that holds nothing else."""
    needed = {key for tables in protocol.configurations.values() for key in tables}
    needed |= {condition.key for message in protocol.declared for condition in message.when}
    if not needed:
        raise CallerError(f"{path}: {protocol.name} takes no configuration")
    base = content.get("base")
    if base is not None and (not isinstance(base, str) or base not in protocol.configurations):
        raise UnknownNameError(
            f"configuration of {protocol.name} (base in {path})", str(base), protocol.configurations
        )
    tables: dict[str, Mapping[int, Any]] = dict(protocol.configurations[base]) if base is not None else {}
    for key in needed & content.keys():
        given = content[key]
        if not isinstance(given, dict):
            raise CallerError(f"{path}: {key} is a table, written as [{key}] with lines such as 0x00 = 2")
        table = dict(tables.get(key, {}))
        for number, entry in _numbered(path, key, given).items():
            table[number] = entry
        tables[key] = table
    if missing := sorted(needed - tables.keys()):
        has = ", ".join(f"[{name}]" for name, value in content.items() if isinstance(value, dict)) or "none"
        raise CallerError(f"{path}: {protocol.name} needs a table [{missing[0]}] (the file has: {has})")
    return tables


def _numbered(path: str, table: str, given: Mapping[str, Any]) -> dict[int, Any]:
    found: dict[int, Any] = {}
    for text, entry in given.items():
        try:
            number = int(text, 0) if not text.isdecimal() else int(text)
        except ValueError:
            raise CallerError(f"{path}: [{table}] {text!r} is not a number; write 0x2A or 42") from None
        if number in found:
            raise CallerError(f"{path}: [{table}] names {number:#04x} twice")
        found[number] = entry
    return found
