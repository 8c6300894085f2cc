"""A variant as a page in Markdown: overview, map of identifiers, each message with its picture, fields and values.

1. It reads on GitHub: tables, fences and links of its flavour, nothing else.
2. Text of the spec is escaped: it is text, never a link, a tag or the end of a cell.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

import construct as c

from aces_bus.protocol import BitLayout, Message, Quantity, Variant
from aces_bus.protocol.declare.framing import Framing
from aces_bus.protocol.declare.pattern import describe_values
from aces_bus.protocol.draw.table import FieldRow
from aces_bus.protocol.draw.text import picture
from aces_bus.protocol.exchange.problems import ProblemText
from aces_bus.protocol.plan import nodes as p

_LINKS = {"can": "CAN", "serial": "serial line", "datagram": "datagrams"}
_WAYS = {None: "", "to device": "→ to device", "from device": "← from device"}
#: Rows of a table of values.
MOST_VALUES = 200


def print_markdown(variant: Variant) -> str:
    """Return the page of a variant: Markdown in GitHub's flavour, UTF-8."""
    return _Page(variant).text()


class _Page:
    def __init__(self, variant: Variant) -> None:
        self.variant = variant
        self.messages = list(variant.messages.values())
        self.is_can = variant.link == "can"
        self.map_title = "Identifiers" if self.is_can else "Messages"
        headings = [variant.name, self.map_title, *(message.name for message in self.messages)]
        self.anchors = dict(zip([None, "", *variant.messages], _anchors(headings), strict=True))

    def text(self) -> str:
        lines = [f"# {_escaped(self.variant.name)}", ""]
        lines += [*self._overview(), "", f"## {self.map_title}", ""]
        lines += self._map()
        for message in self.messages:
            lines += ["", f"## {_escaped(message.name)}", "", *self._message(message)]
        if self.variant.protocol.register_map is not None:
            lines += ["", "## Registers", "", *self._registers()]
        return "\n".join(lines) + "\n"

    def _overview(self) -> list[str]:
        variant, protocol = self.variant, self.variant.protocol
        lines = [_escaped(protocol.doc), ""] if protocol.doc else []
        facts = [("Link", _LINKS[variant.link])]
        if protocol.bitrate is not None:
            facts.append(("Bit rate", f"{protocol.bitrate / 1000:g} kbit/s"))
        if protocol.baud is not None:
            facts.append(("Speed", f"{protocol.baud} baud"))
        if variant.dialect is not None:
            others = ", ".join(name for name in protocol.dialects if name != variant.dialect)
            text = f"`{variant.dialect}`: {_escaped(protocol.dialects[variant.dialect])}"
            facts.append(("Dialect", text + (f" (others: {_escaped(others)})" if others else "")))
        if variant.configuration is not None:
            facts.append(("Configuration", f"`{variant.configuration}`"))
        facts += [("Packets", _escaped(_framing(framing))) for framing in protocol.framings]
        if protocol.source:
            facts.append(("Source", _escaped(protocol.source)))
        return lines + _table(("", ""), facts)

    def _map(self) -> list[str]:
        rows: list[Sequence[str]] = []
        if self.is_can:
            for message in sorted(self.messages, key=lambda m: m.identifier.constant):
                kinds = [
                    kind
                    for kind, given in (
                        ("remote", message.remote),
                        ("FD", message.fd and not message.any_format),
                    )
                    if given
                ]
                name = self._link(message)
                rows.append(
                    (
                        " ".join([_code(self._identifier(message), is_cell=True), *kinds]),
                        name,
                        _code(_recognised_by(message), is_cell=True),
                        _WAYS[message.direction],
                        _lengths(message),
                        _escaped(_first_line(message.doc)),
                    )
                )
            return _table(("identifier", "message", "recognised by", "direction", "bytes", "what"), rows)
        for message in self.messages:
            rows.append(
                (
                    self._link(message),
                    _code(_recognised_by(message), is_cell=True),
                    _WAYS[message.direction],
                    _lengths(message),
                    _escaped(_first_line(message.doc)),
                )
            )
        return _table(("message", "recognised by", "direction", "bytes", "what"), rows)

    @staticmethod
    def _identifier(message: Message) -> str:
        return message.identifier.describe(8 if message.extended else 3)

    def _link(self, message: Message) -> str:
        return f"[{_escaped(message.name)}](#{self.anchors[message.name]})"

    # ------------------------------------------------------------------ one message

    def _message(self, message: Message) -> list[str]:
        plan = message.plan
        lines = [_escaped(message.doc), ""] if message.doc else []
        lines += [f"- {fact}" for fact in self._facts(message, plan)]
        drawing = picture(message)
        fence = "`" * max([3, *(len(run) + 1 for run in re.findall(r"`+", "\n".join(drawing)))])
        lines += ["", f"{fence}text", *drawing, fence]
        sources = _sources(message)
        rows = [
            (
                f"`{row.name}`",
                _escaped(row.place),
                _escaped(row.type),
                _escaped(row.unit),
                row.scale,
                row.offset,
                _escaped(row.range),
                _escaped(_joined(row.doc, sources.get(row.name.partition(".")[0], ""))),
            )
            for row in FieldRow.table(plan, FieldRow.captured(message))
        ]
        if rows:
            lines += [
                "",
                *_table(("field", "place", "type", "unit", "scale", "offset", "range", "meaning"), rows),
            ]
        for names, values in _values(plan.columns):
            shown = ", ".join(f"`{name}`" for name in names)
            lines += ["", f"Values of {shown}:", "", *_table(("value", "name"), values)]
        return lines

    def _facts(self, message: Message, plan: p.MessagePlan) -> list[str]:
        facts: list[str] = []
        if self.is_can:
            values = FieldRow.captured(message)
            ranges = [f"`{c.name}` {values[c.name]}" for c in message.identifier.captures]
            kinds = [
                kind
                for kind, given in (
                    ("29 bits", message.extended),
                    ("remote", message.remote),
                    ("CAN FD", message.fd),
                )
                if given
            ]
            facts.append(", ".join([f"identifier `{self._identifier(message)}`", *ranges, *kinds]))
        if message.transport is not None:
            facts.append(f"carried by {message.transport.describe}")
        if how := _recognised_by(message):
            facts.append(f"recognised by {_code(how)}")
        facts.append(f"{_lengths(message)} bytes")
        if message.direction is not None:
            facts.append(message.direction)
        for condition in message.when:
            entries = ", ".join(map(str, sorted(condition.values, key=str)))
            facts.append(f"only where {_code(condition.key)} of `{condition.capture}` is {_escaped(entries)}")
        for what, requests in (("answers", message.reply_to), ("after", message.after)):
            if requests:
                linked = [
                    f"[{_escaped(str(request))}](#{self.anchors[request.message.name]})"
                    if request.message.name in self.anchors
                    else _escaped(str(request))
                    for request in requests
                ]
                facts.append(f"{what} {', '.join(linked)}")
        if message.check is not None:
            facts.append(f"check `{message.check.field}`: {_escaped(message.check.describe)}")
        if plan.opaque:
            facts.append(f"fields without fixed places: {_escaped(plan.opaque)}")
        if message.source:
            facts.append(f"source: {_escaped(message.source)}")
        return facts

    def _registers(self) -> list[str]:
        table = self.variant.protocol.register_map
        assert table is not None
        rows = [
            (
                f"`{entry.address:#04x}`",
                f"`{entry.name}`",
                str(entry.size),
                entry.access,
                _escaped(entry.unit),
                _escaped(entry.doc),
            )
            for entry in sorted(table.values(), key=lambda register: register.address)
        ]
        return _table(("address", "register", "bytes", "access", "unit", "meaning"), rows)


# ---------------------------------------------------------------------- facts


def _recognised_by(message: Message) -> str:
    """Return what distinguishes a message from others beside its identifier: matched head fields, constants of its
    payload.
    """
    parts: list[str] = []
    covered: set[int] = set()
    for head in message.heads_written:
        if head.pattern is None:
            continue
        covered |= set(range(head.offset, head.offset + head.size))
        shown = head.wanted
        if head.is_own and not head.is_constant:
            shown = describe_values(head.pattern.captures[0].values)
        parts.append(f"{head.name}={shown}" if head.name else shown)
    start = len(message.framing.sync) if message.framing is not None else 0
    for constant in message.plan.constants:
        if constant.offset >= start and constant.offset not in covered:
            mask = "" if constant.mask == 0xFF else f" & {constant.mask:#04x}"
            parts.append(f"byte {constant.offset}{mask}={constant.value:#04x}")
    return ", ".join(parts)


def _lengths(message: Message) -> str:
    if message.lengths is not None:
        return message.describe_lengths.removesuffix(" bytes")
    plan = message.plan
    return f"{plan.least}…" if plan.lengths is None else ", ".join(map(str, plan.lengths))


def _framing(framing: Framing) -> str:
    check = f"check: {framing.describe_check}" if framing.check is not None else "no check"
    return ", ".join([*framing.describe, check])


def _sources(message: Message) -> dict[str, str]:
    """Return where the facts of single fields come from, by the field's name."""
    payload = message.payload
    items = [(slot.name, slot.field) for slot in payload.slots] if isinstance(payload, BitLayout) else []
    if isinstance(payload, c.Struct):
        items = [(str(item.name), item) for item in payload.subcons if item.name]
    found: dict[str, str] = {}
    for name, item in items:
        field: c.Construct | None = item
        while field is not None:
            if isinstance(field, Quantity) and field.source:
                found[name] = field.source
            field = getattr(field, "subcon", None)
    return found


def _joined(doc: str, source: str) -> str:
    return " ".join(filter(None, [*doc.split(), f"(source: {source})" if source else ""]))


def _values(found: Iterable[p.NodePath]) -> list[tuple[list[str], list[tuple[str, str]]]]:
    """Return the named values of fields; fields that have the same share a table."""
    tables: dict[tuple[tuple[str, str], ...], list[str]] = {}
    for leaf in found:
        rows: list[tuple[str, str]] = []
        node = leaf.node.alone
        names, texts = node.value_names, [key for key in node.value_names if isinstance(key, str)]
        rows += [(_code(text, is_cell=True), _escaped(names[text])) for text in texts]
        numbers = sorted(names.keys() - set(texts))
        rows += [(str(number), _escaped(names[number])) for number in numbers[:MOST_VALUES]]
        if len(numbers) > MOST_VALUES:
            rows.append(("…", f"{len(numbers) - MOST_VALUES} more"))
        runs = node.scale.unknown_runs if node.scale is not None else ()
        rows += [("…".join(f"{value:.10g}" for value in dict.fromkeys(run)), "*not known*") for run in runs]
        rows += [(f"bit {bit}", _escaped(name)) for bit, name in node.flag_names.items()]
        if rows:
            tables.setdefault(tuple(rows), []).append(leaf.path)
    return [(names, list(rows)) for rows, names in tables.items()]


# ---------------------------------------------------------------------- Markdown


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """Return a table without the columns that are empty in every row."""
    body = [list(row) for row in rows]
    used = [i for i in range(len(head)) if not body or any(row[i] for row in body)]
    lines = [head, ["---"] * len(head), *body]
    return ["| " + " | ".join(row[i] for i in used) + " |" for row in lines]


def _escaped(text: str) -> str:
    """Return a text as Markdown that shows it, on one line."""
    flat = " ".join(ProblemText.clean(text).split())
    flat = flat.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
    # What a spec's author writes as `code` stays that.
    parts = re.split(r"(`[\w.:@-]+`)", flat)
    parts[::2] = [re.sub(r"([\\`*_\[\]|~$#])", r"\\\1", part) for part in parts[::2]]
    flat = "".join(parts)
    return re.sub(r"(?<=\w):(?=//)|(?<=www)\.|@(?=\w)", lambda m: f"&#{ord(m[0])};", flat)


def _code(text: str, *, is_cell: bool = False) -> str:
    """Return a text as code; in a cell of a table a bar is escaped even there."""
    flat = " ".join(ProblemText.clean(text).split()).replace("`", "'")
    flat = flat.replace("|", "\\|") if is_cell else flat
    return f"`{flat}`" if flat else ""


def _first_line(text: str) -> str:
    return text.strip().partition("\n")[0]


def _anchors(headings: Iterable[str]) -> list[str]:
    """Return the anchors that GitHub gives to headings, in their order on the page."""
    seen: dict[str, int] = {}
    found: list[str] = []
    for heading in headings:
        anchor = re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")
        count = seen.get(anchor, 0)
        seen[anchor] = count + 1
        found.append(f"{anchor}-{count}" if count else anchor)
    return found
