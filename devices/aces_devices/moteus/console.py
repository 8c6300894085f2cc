"""The diagnostic console of a moteus: lines of text in, answers out, tunnelled in sub-frames 0x40 to 0x42.

1. A line is a group (`conf`, `tel`, `d`), a command and its arguments; what it says is answered, also what is unknown.
2. Text ends with `OK`, or is a line `ERR …`; `conf get` and binary telemetry are answered by themselves alone.
3. A channel of telemetry has a schema of its own, in the binary form that mjbots' reader takes.

Facts: mjbots/moteus docs/protocol/diagnostic.md (commands), lib/python/moteus: moteus_tool.py and reader.py (answers).
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping, Sequence

from aces_protocols.moteus.subframes import varuint

from .configuration import Configuration

#: The channel of the console; others are the serial ports, where there is nothing.
CHANNEL = 1
#: The longest line (bytes), and how much of the answers waits for polls, the last of it (bytes): choices.
LONGEST, MOST_WAITING = 256, 65536
#: Numbers of types in a schema (reader.py) and their `struct` formats.
_TYPES = {
    "bool": (b"\x02", "?"),
    "i32": (b"\x03\x04", "i"),
    "u8": (b"\x04\x01", "B"),
    "u32": (b"\x04\x04", "I"),
    "u64": (b"\x04\x08", "Q"),
    "f32": (b"\x07", "f"),
}
_OBJECT, _FIXED_ARRAY, _FINAL = b"\x10\x00", b"\x13", b"\x00\x00\x00\x00\x00"

#: The fields of a channel of telemetry by name: type and values; more than one value are an array.
Fields = Mapping[str, tuple[str, Sequence[float]]]


class Console:
    """The console of one controller: `take` bytes of a host, `give` the answers as they are polled.

    `telemetry` returns the fields of a channel now; `debug` carries out a command of the group `d` and returns whether it
    could. `load` and `store` move the configuration from and to what outlives power-off.
    """

    def __init__(
        self,
        configuration: Configuration,
        telemetry: Mapping[str, Callable[[], Fields]],
        debug: Callable[[str, Sequence[float]], bool],
        load: Callable[[], None],
        store: Callable[[], None],
    ) -> None:
        self.configuration, self._telemetry, self._debug = configuration, telemetry, debug
        self._load, self._store = load, store
        self._line, self._answers = bytearray(), bytearray()
        self._as_text: set[str] = set()

    def take(self, data: bytes) -> None:
        """Take bytes of the host; each line that is whole is carried out."""
        self._line += data
        while (end := next((at for at, byte in enumerate(self._line) if byte in b"\r\n"), -1)) >= 0:
            line = bytes(self._line[:end]).decode("latin1").strip()
            del self._line[: end + 1]
            if line:
                self._answers += self._answer(line)
        del self._line[LONGEST:], self._answers[:-MOST_WAITING]

    def give(self, most: int) -> bytes:
        """Return up to `most` bytes of the answers that wait."""
        data = bytes(self._answers[:most])
        del self._answers[:most]
        return data

    def _answer(self, line: str) -> bytes:
        group, _, rest = line.partition(" ")
        command, _, argument = rest.strip().partition(" ")
        argument = argument.strip()
        if group == "conf":
            return _text(self._conf(command, argument))
        if group == "tel":
            return self._tel(command, argument)
        if group == "d":
            try:
                numbers = [float(part) for part in argument.split()]
            except ValueError:
                return _text("ERR invalid number")
            return _text("OK" if self._debug(command, numbers) else "ERR unknown command")
        return _text("ERR unknown command")

    def _conf(self, command: str, argument: str) -> str:
        values = self.configuration
        name, _, text = argument.partition(" ")
        if command == "enumerate":
            found = [each for each in values if not argument or each.startswith(f"{argument}.")]
            listed = "".join(f"{each} {values.text_of(each)}\r\n" for each in found)
            return f"{listed}OK" if found else "ERR unknown group"
        if command in ("get", "set") and not any(
            each.startswith(f"{name.split('.')[0]}.") for each in values
        ):
            return "ERR unknown group"
        if command == "get":
            return values.text_of(name) if name in values else "ERR error reading"
        if command == "set":
            return "OK" if name in values and values.accept(name, text.strip()) else "ERR error setting"
        act = {"load": self._load, "write": self._store, "default": values.reset}.get(command)
        if act is None:
            return "ERR unknown subcommand"
        act()
        return "OK"

    def _tel(self, command: str, argument: str) -> bytes:
        name, _, number = argument.partition(" ")
        if command == "list":
            return _text("\r\n".join((*self._telemetry, "OK")))
        if command == "stop":  # nothing is sent of its own accord here
            return _text("OK")
        if command == "text":
            self._as_text = set(self._telemetry)
            return _text("OK")
        if command not in ("schema", "get", "fmt"):
            return _text("ERR unknown subcommand")
        if name not in self._telemetry:
            return _text("ERR unknown name")
        if command == "fmt":
            (self._as_text.discard if number.strip() == "0" else self._as_text.add)(name)
            return _text("OK")
        fields = self._telemetry[name]()
        if command == "schema":
            return _text(f"schema {name}") + _blob(telemetry_schema(fields))
        if name in self._as_text:
            lines = (
                f"{name}.{field}{f'.{place}' if len(values) > 1 else ''} {value}"
                for field, (_, values) in fields.items()
                for place, value in enumerate(values)
            )
            return _text("\r\n".join((*lines, "OK")))
        return _text(f"emit {name}") + _blob(telemetry_data(fields))


def telemetry_schema(fields: Fields) -> bytes:
    """Return the schema of a channel: an object with a type for each field."""
    out = bytearray(_OBJECT)
    for name, (kind, values) in fields.items():
        array = _FIXED_ARRAY + varuint(len(values)) if len(values) > 1 else b""
        out += b"\x00" + varuint(len(name)) + name.encode() + b"\x00" + array + _TYPES[kind][0] + b"\x00"
    return bytes(out + _FINAL)


def telemetry_data(fields: Fields) -> bytes:
    """Return the values of a channel, as its schema has them."""
    return b"".join(
        struct.pack(f"<{len(values)}{_TYPES[kind][1]}", *values) for kind, values in fields.values()
    )


def _text(text: str) -> bytes:
    return f"{text}\r\n".encode("latin1")


def _blob(data: bytes) -> bytes:
    return struct.pack("<I", len(data)) + data
