"""List the installed protocols, the messages of one, the layout of a message.

  aces protocols                    all protocols
  aces protocols robotis            its messages and registers
  aces protocols robotis Status     its bits as a picture, its fields as a table
  aces protocols hubo:D08 NameInfo  in one dialect; also my_spec.py NameInfo
  aces protocols car.dbc            of a database; what cannot be used of it
                                    is listed on stderr
  aces protocols --search imu       those with this word in their name, text,
                                    devices or messages

`unchecked` protocols have no check in their packets: what looks like a packet
is taken for one. Frames on CAN are checked by the bus itself. → goes to the
device, ← comes from it. In pictures, -1 is the last byte of a packet whose
length is not fixed, and `11…8` are bits of the field's own number. Badges say
what was run of a protocol, and when: 'aces spec badge --help' has their
meaning.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterable, Sequence
from typing import Any

from construct import ConstructError

from aces_bus import list_protocols, make_scanner
from aces_bus.errors import AcesError, CallerError, UnknownNameError
from aces_bus.protocol import Message, Protocol, Variant
from aces_bus.protocol.declare.framing import Framing
from aces_bus.protocol.declare.registers import Register
from aces_bus.protocol.draw.table import FieldRow
from aces_bus.protocol.draw.text import picture
from aces_bus.protocol.exchange.read_once import problems_of
from aces_bus.protocol.generate.decode import Decoder
from aces_bus.protocol.generate.load import print_decoders
from aces_bus.protocol.live.stream import StreamScanner
from aces_bus.protocol.plan.flatten import NotFlat, flatten, scalar_of

from .badges import badges_of, dated, entries_with
from .console import counted, print_json, say
from .options import COLOR, JSON, Arguments, argument, flag
from .output.columns import Page
from .proofs import badge_text, read_badges
from .protocols_arg import named_protocol

SUMMARY = "list protocols, their messages, and the layout of a message"

ARGUMENTS: Arguments = (
    argument("protocol", nargs="?", metavar="NAME", help="as -p of 'aces decode'"),
    argument("message", nargs="?", metavar="MESSAGE", help="one of its messages"),
    argument("--search", metavar="WORDS", help="list the protocols that have these words"),
    JSON,
    flag("--source", help="print the Python that is generated from the spec to decode it"),
    COLOR,
)


def run(arguments: argparse.Namespace) -> int:
    name: str | None = arguments.protocol
    if name is not None and arguments.search:
        raise CallerError("--search lists protocols: name none beside it")
    if name is None:
        return _list(arguments)
    chosen = named_protocol(name)
    protocol, messages = chosen.protocol, chosen_messages(arguments)
    if arguments.source:
        _print_source(chosen.variant(), arguments)
    elif arguments.json:
        described = [_of_message(m, is_whole=arguments.message is not None) for m in messages]
        print_json(
            described if arguments.message is not None else {**_of_protocol(protocol), "messages": described}
        )
    elif arguments.message is not None:
        _print_messages(messages, Page(arguments.color))
    else:
        _print_protocol(protocol, messages, Page(arguments.color))
        for problem in problems_of(protocol):
            say(problem.of(protocol.source), who="")
    return 0


def chosen_messages(arguments: argparse.Namespace) -> list[Message]:
    """Return the message that a call asks for, or all of its protocol; raises `UnknownNameError`."""
    chosen = named_protocol(arguments.protocol)
    messages = list(chosen.protocol.declared)
    if chosen.dialect is not None or chosen.configuration is not None:
        messages = list(chosen.variant().messages.values())
    if arguments.message is None:
        return messages
    found = [message for message in messages if message.name == arguments.message]
    if not found:
        known = [message.name for message in messages]
        raise UnknownNameError(f"message of {arguments.protocol}", arguments.message, known)
    return found


# ---------------------------------------------------------------------- all protocols


def _list(arguments: argparse.Namespace) -> int:
    found: list[Protocol] = []
    status = 0
    for name in list_protocols():
        try:
            found.append(named_protocol(name).protocol)
        except AcesError as error:
            say(str(error))
            status = 2
    if arguments.search:
        # Where a word begins or ends: "imu" is not in "simulate", and "lidar" is in "RPLIDAR".
        words = [
            re.compile(rf"\b{re.escape(word)}|{re.escape(word)}\b", re.IGNORECASE)
            for word in arguments.search.split()
        ]
        found = [p for p in found if all(word.search(_searched(p)) for word in words)]
        if not found:
            say(f"no installed protocol has {arguments.search!r}")
            return 1
    if arguments.json:
        print_json([{**_of_protocol(protocol), "messages": len(protocol.declared)} for protocol in found])
        return status
    page = Page(arguments.color)
    width = max([len(protocol.name) for protocol in found], default=0)
    for protocol in found:
        page.beside(protocol.name.ljust(width), _facts(protocol), "message")
    return status


def _searched(protocol: Protocol) -> str:
    """Return the text in which --search looks: names apart at underscores and capitals."""
    texts = [protocol.name, protocol.doc, protocol.source]
    for entry in entries_with(protocol.name):
        texts += [entry.title, *entry.drivers, *entry.sources]
    for message in protocol.declared:
        texts += [message.name, re.sub(r"(?<=[a-z])(?=[A-Z])", " ", message.name), message.doc]
    return "\n".join([*texts, *(text.replace("_", " ") for text in texts)])


def _facts(protocol: Protocol) -> list[str]:
    head = [
        _LINKS[protocol.link],
        _speed(protocol),
        counted(len(protocol.declared), "message"),
        " ".join(badges_of(protocol.name)),
    ]
    dialects = _defaulted(protocol.dialects, protocol.dialect)
    configurations = _defaulted(protocol.configurations, protocol.configuration)
    lines = [
        " · ".join(filter(None, head)),
        _first_line(protocol.doc),
        dialects and f"dialects: {dialects}",
        configurations and f"configurations: {configurations}",
        *(f"packets: {_framing(framing)}" for framing in protocol.framings),
        f"check: {_check(protocol)}",
    ]
    return [line for line in lines if line]


_LINKS = {"can": "CAN", "serial": "serial", "datagram": "datagrams"}


def _speed(protocol: Protocol) -> str:
    if protocol.bitrate is not None:
        return (
            f"{protocol.bitrate / 1000:g} kbit/s"
            if protocol.bitrate < 1_000_000
            else f"{protocol.bitrate / 1e6:g} Mbit/s"
        )
    return f"{protocol.baud} baud" if protocol.baud is not None else ""


def _defaulted(names: Iterable[str], default: str | None) -> str:
    return ", ".join(f"{name} (default)" if name == default else name for name in names)


def _framing(framing: Framing) -> str:
    gap = [f"at most {framing.gap:g} s between bytes"] if framing.gap else []
    return ", ".join([*framing.describe, *gap])


def _check(protocol: Protocol) -> str:
    checks = [framing.check for framing in protocol.framings] + [m.check for m in protocol.declared]
    found = list(dict.fromkeys(check.describe for check in checks if check is not None))
    if protocol.link == "can":
        return ", ".join(["by the bus", *found])
    bare = [framing for framing in protocol.framings if framing.check is None]
    some = [m for m in protocol.declared if m.framing in bare and m.check is None]
    if not some:
        return ", ".join(found)
    return "unchecked" if not found else f"{', '.join(found)}; {counted(len(some), 'message')} unchecked"


def _joined(doc: str, names: str) -> str:
    return f"{doc}{' ' if doc.endswith('.') else '; '}{names}" if doc and names else doc or names


def _first_line(text: str) -> str:
    return text.strip().partition("\n")[0]


# ---------------------------------------------------------------------- one protocol


def _print_protocol(protocol: Protocol, messages: Sequence[Message], page: Page) -> None:
    facts = [
        *_facts(protocol),
        *([f"source: {protocol.source}"] if protocol.source else []),
        f"declared in {protocol.place}",
        *([f"proofs: {badge_text(protocol)}"] if protocol.name in read_badges() else []),
        *_badge_lines(protocol),
    ]
    page.beside(protocol.name, facts, "message")
    page.lines([""])
    rows = []
    for message in messages:
        how = _recognised_by(message)
        kinds = "".join(
            f" {k}"
            for k, given in (("remote", message.remote), ("FD", message.fd and not message.any_format))
            if given
        )
        dialects = ", ".join(sorted(message.dialects)) if message.dialects is not None else ""
        rows.append(
            (
                message.name,
                how + kinds,
                _lengths(message),
                _ARROWS[message.direction],
                dialects,
                _first_line(message.doc),
            )
        )
    page.table(("message", "recognised by", "bytes", "", "dialect", ""), rows)
    for table in protocol.register_maps:
        page.lines(["", *([table.doc] if len(protocol.register_maps) > 1 else [])])
        _print_registers(list(table.values()), page)


def _badge_lines(protocol: Protocol) -> list[str]:
    """Return a line for each entry of the catalogue: its badges with their days, or that they are stale."""
    lines: list[str] = []
    for entry in entries_with(protocol.name):
        saved = entry.saved()
        if saved is not None:
            days = {level: earned.date for level, earned in saved.badges.items()}
            stale = f"stale, run aces spec badge {protocol.name}: " if saved.is_stale() else ""
            lines.append(f"badges of {entry.title}: {stale}{dated(days)}")
    return lines


_ARROWS = {None: "", "to device": "→", "from device": "←"}


def _recognised_by(message: Message) -> str:
    """Return what distinguishes a message from others: identifier, matched head fields, constants of the payload."""
    parts = []
    if message.protocol.link == "can":
        parts.append(message.identifier.describe(8 if message.extended else 3))
    covered = set()
    for head in message.heads_written:
        if head.pattern is not None:
            covered |= set(range(head.offset, head.offset + head.size))
            own = head.wanted
            if head.is_own and not head.is_constant:
                own = FieldRow.captured(message)[head.pattern.captures[0].name]
            parts.append(f"{head.name}={own}" if head.name else own)
    framing = message.framing
    start = len(framing.sync) if framing is not None else 0
    for constant in flatten(message).constants:
        if constant.offset >= start and constant.offset not in covered:
            mask = "" if constant.mask == 0xFF else f" & {constant.mask:#04x}"
            parts.append(f"byte {constant.offset}{mask}={constant.value:#04x}")
    return ", ".join(parts)


def _lengths(message: Message) -> str:
    plan = flatten(message)
    if message.lengths is not None:
        return message.describe_lengths.removesuffix(" bytes")
    if plan.lengths is None:
        return f"{plan.least}…"
    return ", ".join(map(str, plan.lengths))


def _print_registers(registers: Sequence[Register], page: Page) -> None:
    rows = []
    for register in sorted(registers, key=lambda r: r.address):
        row = _of_register(register)
        access = {"read": "r", "write": "w", "read-write": "rw"}[register.access]
        default = f"Default: {row['default']}." if row["default"] else ""
        doc = " ".join(filter(None, [_joined(register.doc, row["names"]), default]))
        rows.append(
            (f"{register.address:#04x}", register.name, row["type"], access, row["range"], row["unit"], doc)
        )
    page.table(("address", "register", "type", "", "range", "unit", ""), rows)


def _of_register(register: Register) -> dict[str, Any]:
    try:
        row = FieldRow.of(register.name, scalar_of(register.field, register.address), register.doc)
        kind, span, names = row.type, row.range, row.names
    except NotFlat:
        kind, span, names = counted(register.size, "byte"), "", ""
    default: Any = ""
    if register.default is not None:
        try:
            default = register.decode(register.encode(register.default, raw=True))
            default = f"{default:g}" if isinstance(default, float) else str(default)
        except (AcesError, ConstructError):
            default = str(register.default)
    unit = register.unit or str(getattr(register.field, "unit", ""))
    return {
        "address": register.address,
        "name": register.name,
        "size": register.size,
        "type": kind,
        "access": register.access,
        "range": span,
        "unit": unit,
        "default": default,
        "names": names,
        "doc": register.doc,
        "source": register.source,
    }


# ---------------------------------------------------------------------- one message


def _print_messages(messages: Sequence[Message], page: Page) -> None:
    for index, message in enumerate(messages):
        if index:
            page.lines([""])
        page.beside(f"{message.protocol.name}.{message.name}", [_first_line(message.doc)], "message")
        for name, text in _template(message):
            page.beside(f"  {name:<13}", [text], "place")
        page.lines(["", *picture(message), ""])
        rows = FieldRow.table(flatten(message), FieldRow.captured(message))
        cells = [
            (
                r.name,
                r.place,
                r.type,
                r.unit,
                r.scale,
                r.offset,
                r.range,
                _joined(" ".join(r.doc.split()), r.names),
            )
            for r in rows
        ]
        page.table(("field", "place", "type", "unit", "scale", "offset", "range", ""), cells)


def _template(message: Message) -> list[tuple[str, str]]:
    """Return what says which frames or packets are this message."""
    values = FieldRow.captured(message) if message.protocol.link == "can" else {}
    kinds = (("29 bits", message.extended), ("remote", message.remote), ("CAN FD", message.fd))
    parts = [
        f"{name} {values[name]}"
        for name in (capture.name for capture in message.identifier.captures)
        if name in values
    ]
    parts += [kind for kind, given in kinds if given and message.protocol.link == "can"]
    within = f", within {message.within:g} s" if message.reply_to and message.within is not None else ""
    plan, framing = flatten(message), message.framing
    facts = [
        ("identifier", ", ".join(parts)),
        ("recognised by", _recognised_by(message)),
        ("length", f"{_lengths(message)} bytes"),
        ("carried by", message.transport.describe if message.transport is not None else ""),
        ("direction", message.direction or ""),
        ("dialect", ", ".join(sorted(message.dialects or ()))),
        *(
            ("only where", f"{c.key} of {c.capture} is {', '.join(map(str, sorted(c.values, key=str)))}")
            for c in message.when
        ),
        ("reply to", ", ".join(map(str, message.reply_to)) + within),
        ("after", ", ".join(map(str, message.after))),
        (
            "note",
            "bytes are counted without stuffing"
            if framing is not None and framing.stuffing is not None
            else "",
        ),
        ("decoded by", "" if plan.is_flat else f"construct, slower: {plan.opaque}"),
        ("source", message.source),
        ("declared in", str(message.place)),
    ]
    return [(name, text) for name, text in facts if text]


def _print_source(variant: Variant, arguments: argparse.Namespace) -> None:
    if arguments.message is None:
        source = print_decoders(variant)
        if variant.link != "can":
            scanner = make_scanner([variant], direction="both")
            assert isinstance(scanner, StreamScanner)
            source += f"\n\n{scanner.source}"
    else:
        setup, lines = Decoder(flatten(variant[arguments.message]), raw=False, guard=True).print()
        source = "\n".join([*setup, "", "", *lines] if setup else lines) + "\n"
    if not Page(arguments.color).is_coloured:
        print(source, end="")
        return
    from rich.console import Console
    from rich.syntax import Syntax

    console = Console(force_terminal=True, width=max(map(len, source.split("\n"))) + 1)
    console.print(Syntax(source, "python", background_color="default"))


# ---------------------------------------------------------------------- for programs


def _of_protocol(protocol: Protocol) -> dict[str, Any]:
    return {
        "name": protocol.name,
        "link": protocol.link,
        "bitrate": protocol.bitrate,
        "baud": protocol.baud,
        "dialects": protocol.dialects,
        "dialect": protocol.dialect,
        "configurations": list(protocol.configurations),
        "configuration": protocol.configuration,
        "framings": [_framing(framing) for framing in protocol.framings],
        "check": _check(protocol),
        "doc": protocol.doc,
        "source": protocol.source,
        "badges": badges_of(protocol.name),
        "registers": [_of_register(r) for r in (protocol.register_map or {}).values()],
    }


def _of_message(message: Message, *, is_whole: bool) -> dict[str, Any]:
    plan = flatten(message)
    is_can = message.protocol.link == "can"
    lengths = message.lengths if message.lengths is not None else plan.lengths
    found: dict[str, Any] = {
        "name": message.name,
        "identifier": message.identifier.describe(8 if message.extended else 3) if is_can else None,
        "recognised_by": _recognised_by(message),
        "extended": message.extended,
        "remote": message.remote,
        "fd": message.fd,
        "lengths": None if lengths is None else list(lengths),
        "direction": message.direction,
        "dialects": sorted(message.dialects) if message.dialects is not None else None,
        "reply_to": [str(request) for request in message.reply_to],
        "after": [str(request) for request in message.after],
        "is_flat": plan.is_flat,
        "doc": message.doc,
        "source": message.source,
        "declared": message.place.stable,
        "fields": list(message.fields),
    }
    if is_whole:
        rows = FieldRow.table(plan, FieldRow.captured(message))
        found["fields"] = [{name: getattr(row, name) for name in row.__dataclass_fields__} for row in rows]
        found["picture"] = picture(message)
    return found
