"""CANopen's EDS and DCF files, read through canopen: what is mapped into PDOs becomes messages.

1. An identifier with `$NODEID` is that of any node (1…127, captured as `node`); a DCF says which node it is.
2. RPDOs go to the device, TPDOs come from it (CiA 301, 7.2.2); mapped objects lie one behind the other, lowest bit first.
3. A section that cannot be read costs itself, not the file.

The protocol also has what every node speaks (CiA 301, 7.2.5, 7.2.7, 7.2.8): Nmt, Sync, Emergency, Heartbeat.
"""

from __future__ import annotations

import io
import re
from collections.abc import Mapping, Sequence
from itertools import chain
from typing import Any

import construct as c

from aces_bus.errors import AcesError, CallerError
from aces_bus.protocol import BitLayout, Enumeration, IdField, Protocol, Quantity, bits, float_bits
from aces_bus.protocol.declare.pattern import IdPattern
from aces_bus.protocol.declare.place import SourceLine
from aces_bus.protocol.exchange.import_build import TRAILING
from aces_bus.protocol.exchange.import_dbc import protocol_name, read_text
from aces_bus.protocol.exchange.names import PythonNames
from aces_bus.protocol.exchange.problems import ImportedProtocol, ImportProblem, ProblemText, quiet

#: PDOs of a device (CiA 301, 7.5.1), and the identifiers of the first four where the file gives none (7.3.5).
MOST_PDOS = 512
RECEIVED, SENT = (0x200, 0x300, 0x400, 0x500), (0x180, 0x280, 0x380, 0x480)
#: Subindices of an object.
MOST_ENTRIES = 254
#: Types of CiA 301, 7.4.7.
_SIGNED = frozenset({0x02, 0x03, 0x04, 0x10, 0x12, 0x13, 0x14, 0x15})
_FLOATS = {0x08: 32, 0x11: 64}
_SECTION = re.compile(r"[ \t]*\[([^\]]*)\]")
_INDEX = re.compile(r"([0-9A-Fa-f]{4})(?:[Ss]ub[0-9A-Fa-f]+|Name)?$")


def load_eds(path: str) -> ImportedProtocol:
    """Return the PDOs of a file as a protocol. Raises `CallerError` when nothing of it can be read."""
    text = read_text(path, path.rpartition(".")[2])
    sections, problems = _sections(text)
    if not any(_INDEX.match(section.name) for section in sections):
        raise CallerError(
            f"{path}: not an EDS or DCF file: no section of it is an object ([1000], [1A00sub1], …)"
        )
    dictionary, more = _dictionary(sections)
    built = _Builder(dictionary, path, {section.name.lower(): section.line for section in reversed(sections)})
    protocol = built.build()
    return ImportedProtocol(protocol, tuple(sorted([*problems, *more, *built.problems])), len(sections), path)


# ---------------------------------------------------------------------- sections


class _Section:
    def __init__(self, name: str, line: int) -> None:
        self.name, self.line = name, line
        self.lines: list[str] = []

    @property
    def text(self) -> str:
        return f"[{self.name}]\n" + "\n".join(self.lines) + "\n"


def _sections(text: str) -> tuple[list[_Section], list[ImportProblem]]:
    """Return the sections of a file, each once, with the lines that can be read."""
    found: dict[str, _Section] = {}
    problems: list[ImportProblem] = []
    current: _Section | None = None
    keys: set[str] = set()
    for number, line in enumerate(text.splitlines(), 1):
        bare = line.strip()
        if not bare or bare[0] in ";#":
            continue
        head = _SECTION.match(line)
        if head is not None:
            name = head[1].strip()
            keys = set()
            current = _Section(name, number)
            if name.lower() in found:
                problems.append(
                    ImportProblem(
                        number, "a section that is there already: left out", ProblemText.excerpt(bare)
                    )
                )
            else:
                found[name.lower()] = current
            continue
        key, separator, value = bare.partition("=")
        key = key.strip()
        if current is None or not separator or not key or key in keys:
            problems.append(
                ImportProblem(
                    number, "not of the form key=value, or there twice: left out", ProblemText.excerpt(bare)
                )
            )
            continue
        keys.add(key)
        if key == "NrOfEntries" and not (
            value.strip().isdecimal() and int(value.strip()[:9]) <= MOST_ENTRIES
        ):
            problems.append(
                ImportProblem(
                    number,
                    f"an object has at most {MOST_ENTRIES} entries: left out",
                    ProblemText.excerpt(bare),
                )
            )
            value = "0"
        current.lines.append(f"{key}={value.strip()}")
    return list(found.values()), problems


def _dictionary(sections: Sequence[_Section]) -> tuple[Any, list[ImportProblem]]:
    """Return canopen's object dictionary, and the problems of the objects that canopen cannot read.

    The whole file is tried first. Where that fails, each part is tried by itself, and those that fail are left out.
    """
    commissioning = [section for section in sections if section.name.lower() == "devicecomissioning"]
    by_index: dict[int, list[_Section]] = {}
    for section in sections:
        found = _INDEX.match(section.name)
        if found is not None:
            by_index.setdefault(int(found[1], 16), []).append(section)
    types = [section for index, parts in by_index.items() if index < 0x1000 for section in parts]
    objects = [parts for index, parts in by_index.items() if index >= 0x1000]
    whole, reason = _attempt([*commissioning, *types, *chain(*objects)])
    if whole is not None:
        return whole, []
    problems: list[ImportProblem] = []
    readable: list[list[_Section]] = []
    for part in (commissioning, types):
        dictionary, reason = _attempt(part)
        readable.append(part if dictionary is not None else [])
        if dictionary is None:
            problems += [
                ImportProblem(section.line, f"cannot be read: {reason}", f"[{section.name}]")
                for section in part
            ]
    commissioning, types = readable
    kept: list[_Section] = []
    for parts in objects:
        dictionary, reason = _attempt([*types, *parts])
        if dictionary is not None:
            kept += parts
        else:
            text = f"an object that cannot be read: {reason}"
            problems.append(ImportProblem(parts[0].line, text, f"[{parts[0].name}]"))
    return _read([*commissioning, *types, *kept]), problems


def _attempt(sections: Sequence[_Section]) -> tuple[Any | None, str]:
    """Return the object dictionary of some sections, or None and the reason why canopen cannot read them."""
    try:
        return _read(sections), ""
    except Exception as error:  # whatever a parser of a damaged file may raise
        return None, ProblemText.excerpt(str(error))


def _read(sections: Sequence[_Section]) -> Any:
    try:
        from canopen.objectdictionary.eds import import_eds
    except ImportError:
        raise CallerError("EDS and DCF files need canopen: pip install canopen") from None
    text = "[DeviceInfo]\n" + "".join(section.text for section in sections)
    # With a node's number canopen resolves $NODEID; 0 leaves what is added to it.
    is_known = re.search(r"(?im)^NodeID=", text) is not None
    read: Any = import_eds  # has no types
    with quiet("canopen"):
        return read(io.StringIO(text), None if is_known else 0)


# ---------------------------------------------------------------------- messages


class _LeftOut(Exception):
    """This PDO or object cannot be taken over; the argument says why."""


class _Builder:
    def __init__(self, dictionary: Any, path: str, lines: Mapping[str, int]) -> None:
        self.dictionary, self.path, self.lines = dictionary, path, lines
        self.node: int | None = dictionary.node_id or None
        self.problems: list[ImportProblem] = []
        self.taken = set(PythonNames.TAKEN_BY_CODE)
        self.protocol = Protocol(
            protocol_name(path),
            link="can",
            bitrate=dictionary.bitrate or None,
            doc=f"CANopen{f', node {self.node}' if self.node else ''}",
            source=path,
        )
        self.protocol.place = SourceLine(path, 1)

    def line(self, index: int) -> int:
        return self.lines.get(f"{index:04x}", 0)

    def build(self) -> Protocol:
        self._of_every_node()
        for number in range(MOST_PDOS):
            self._pdo(f"RPDO{number + 1}", 0x1400 + number, 0x1600 + number, RECEIVED[number : number + 1])
            self._pdo(f"TPDO{number + 1}", 0x1800 + number, 0x1A00 + number, SENT[number : number + 1])
        return self.protocol

    def _identifier(self, base: int, *, is_relative: bool) -> IdPattern:
        """Return an identifier that a node's number is part of; `base` has the number in it where the node is known."""
        if not is_relative or self.node is not None:
            return IdPattern(base)
        return base + IdField("node", range(1, 128), doc="the device's number")

    def _of_every_node(self) -> None:
        node = self.node or 0
        states = {"boot_up": 0, "stopped": 4, "operational": 5, "pre_operational": 127}
        commands = {"start": 1, "stop": 2, "pre_operational": 128, "reset": 129, "reset_communication": 130}
        command = c.Struct(
            c.Renamed(Enumeration(c.Byte, commands), newname="command"),
            c.Renamed(c.Byte, newname="to_node", newdocs="0: all nodes"),
        )
        emergency = c.Struct(
            c.Renamed(c.Int16ul, newname="code", newdocs="error code"),
            c.Renamed(c.Byte, newname="error_register", newdocs="object 1001h"),
            c.Renamed(c.Bytes(5), newname="data", newdocs="the manufacturer's own"),
        )
        state = c.Struct(c.Renamed(Enumeration(c.Byte, states), newname="state"))
        self._declare(
            "Nmt", IdPattern(0), command, 0x1000, "to device", "network management: change of state"
        )
        counter = c.Struct(c.Renamed(c.GreedyBytes, newname="counter"))
        sync = (self._number(0x1005, 0) or 0x80) & 0x7FF
        self._declare("Sync", IdPattern(sync), counter, 0x1005, None, "synchronisation", length=(0, 1))
        pattern = self._identifier(0x80 + node, is_relative=True)
        self._declare("Emergency", pattern, emergency, 0x1014, "from device", "an error, or its end (code 0)")
        pattern = self._identifier(0x700 + node, is_relative=True)
        self._declare("Heartbeat", pattern, state, 0x1017, "from device", "the node is there, in this state")

    def _declare(
        self,
        name: str,
        identifier: IdPattern,
        payload: Any,
        index: int,
        direction: Any,
        doc: str,
        **more: Any,
    ) -> None:
        try:
            made = self.protocol.message(
                PythonNames.unused(name, self.taken),
                id=identifier,
                payload=payload,
                direction=direction,
                doc=doc,
                **more,
            )
        except AcesError as error:
            self.problems.append(
                ImportProblem(self.line(index), f"{name}: {ProblemText.of_error(error)}: left out")
            )
            return
        made.place = SourceLine(self.path, self.line(index) or 1)

    def _pdo(self, name: str, parameters: int, mapping: int, usual: Sequence[int]) -> None:
        if mapping not in self.dictionary or not self._number(mapping, 0):
            return
        try:
            word, is_relative = self._cob_id(parameters, usual)
            fields = self._mapped(name, mapping)
        except _LeftOut as reason:
            self.problems.append(ImportProblem(self.line(mapping), f"{name}: {reason}: left out"))
            return
        identifier = self._identifier(word & 0x1FFF_FFFF, is_relative=is_relative)
        facts = [
            f"{text} {number}"
            for text, number in (
                ("transmission type", self._number(parameters, 2)),
                ("event timer in ms", self._number(parameters, 5)),
            )
            if number is not None
        ]
        direction = "to device" if name[0] == "R" else "from device"
        extended = bool(word >> 29 & 1)
        self._declare(name, identifier, fields, mapping, direction, "; ".join(facts), extended=extended)

    def _object(self, index: int, sub: int) -> Any:
        """Return an object of the dictionary, or None."""
        try:
            entry = self.dictionary[index]
            return entry[sub] if hasattr(entry, "subindices") else entry if sub == 0 else None
        except (KeyError, IndexError, ValueError):
            return None

    def _number(self, index: int, sub: int) -> int | None:
        """Return the value of an object: of a DCF what is set, of an EDS the default."""
        one = self._object(index, sub)
        numbers = (getattr(one, "value", None), getattr(one, "default", None))
        return next((number for number in numbers if isinstance(number, int)), None)

    def _cob_id(self, parameters: int, usual: Sequence[int]) -> tuple[int, bool]:
        """Return the identifier's word, and whether the node's number is part of it."""
        one = self._object(parameters, 1)
        value = getattr(one, "value", None)
        word = self._number(parameters, 1)
        if word is None:
            if not usual:
                raise _LeftOut("no identifier is given")
            return usual[0] + (self.node or 0), True
        raw = getattr(one, "value_raw", "") if isinstance(value, int) else getattr(one, "default_raw", "")
        if word >> 31 & 1:
            raise _LeftOut("it is switched off (bit 31 of its COB-ID)")
        return word, "$NODEID" in str(raw).upper()

    def _mapped(self, name: str, mapping: int) -> BitLayout:
        fields: list[c.Construct] = []
        taken = {"reserved", "node", TRAILING, *PythonNames.TAKEN_BY_RECORDS}
        at = 0
        for sub in range(1, min(self._number(mapping, 0) or 0, 64) + 1):
            word = self._number(mapping, sub)
            if word is None:
                raise _LeftOut(f"its entry {sub} has no value")
            index, part, width = word >> 16 & 0xFFFF, word >> 8 & 0xFF, word & 0xFF
            if not width or at + width > 64:
                raise _LeftOut(
                    "its objects do not fit into 8 bytes" if width else f"its entry {sub} has 0 bits"
                )
            if index >= 0x20:  # below are types: bits that mean nothing
                fields.append(self._field(name, index, part, width, at, taken))
            at += width
        size = (at + 7) // 8
        return BitLayout(size, *fields, trailing=TRAILING if size < 8 else "")

    def _field(self, pdo: str, index: int, sub: int, width: int, at: int, taken: set[str]) -> c.Construct:
        one = self._object(index, sub)
        if one is None:
            reason = f"{pdo}: object {index:04X}h/{sub} is not described: an unsigned number here"
            self.problems.append(ImportProblem(self.line(index), reason, is_note=True))
            return c.Renamed(bits(width, at), newname=PythonNames.unused(f"x{index:04X}_{sub}", taken))
        parent: Any = getattr(one, "parent", None)
        text = ProblemText.clean(one.name)
        if getattr(parent, "subindices", None) is not None:
            text = f"{ProblemText.clean(parent.name)} {text}"
        place: c.Construct
        place = (
            float_bits(width, at)
            if _FLOATS.get(one.data_type) == width
            else bits(width, at, signed=one.data_type in _SIGNED)
        )
        names = {plain: number for number, plain in getattr(one, "value_descriptions", {}).items()}
        factor = getattr(one, "factor", 1)
        scale = int(factor) if float(factor).is_integer() else float(factor)
        span = None
        if isinstance(one.min, int) and isinstance(one.max, int) and one.min <= one.max:
            span = one.min, one.max
        unit = ProblemText.clean(getattr(one, "unit", "") or "")
        if names:
            place = Enumeration(place, names)
        elif scale != 1 or unit or span is not None:
            place = Quantity(place, unit=unit, scale=scale or 1, raw_range=span)
        doc = f"object {index:04X}h/{sub}"
        said = ProblemText.clean(getattr(one, "description", "") or "")
        return c.Renamed(
            place, newname=PythonNames.unused(text, taken), newdocs=f"{said} ({doc})" if said else doc
        )
