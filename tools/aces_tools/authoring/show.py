"""How messages are laid out and decoded, and what differs between two specs.

  aces spec show hubo               every message as a picture
  aces spec show hubo NameInfo      one, with its fields as a table
  aces spec show hubo NameInfo --svg nameinfo.svg
                                    the picture for a page; without MESSAGE,
                                    of all
  aces spec show robotis --source   the Python that decodes it
  aces spec show robotis Read --plan
                                    what that is printed from: bit positions,
                                    scales, constants, lengths
  aces spec show robotis --paths    what is decoded by generated code, what by
                                    construct (slower, and equal), and why
  aces spec show --diff hubo:D08 hubo:D12
  aces spec show --diff old.py new.py
                                    messages and fields added, removed, moved
                                    and changed; exit status 1 when any is

A Python file is executed with your rights: name only what you trust.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping
from typing import Any

import msgspec

from aces_bus.errors import CallerError
from aces_bus.protocol import Message
from aces_bus.protocol.declare.ambiguity import needing_context
from aces_bus.protocol.draw.svg import picture_svg
from aces_bus.protocol.draw.table import FieldRow
from aces_bus.protocol.draw.text import picture
from aces_bus.protocol.plan import nodes as p

from .. import protocols
from ..console import check_suffix, print_json, write_text
from ..options import COLOR, JSON, Arguments, argument, flag
from ..output.columns import Page
from ..protocols import chosen_messages
from ..protocols_arg import named_protocol

_WAYS = ("source", "plan", "paths", "diff")


SUMMARY = "show how messages are laid out and decoded; compare specs"

ARGUMENTS: Arguments = (
    argument("protocol", nargs="?", metavar="NAME|FILE", help="as -p of 'aces decode'"),
    argument("message", nargs="?", metavar="MESSAGE", help="only this message"),
    flag("--source", help="the Python generated from the spec"),
    flag("--plan", help="what the source is generated from"),
    flag("--paths", help="how each field is decoded"),
    argument("--diff", nargs=2, metavar=("A", "B"), help="what differs from A to B"),
    argument("--svg", metavar="FILE", help="write the pictures there"),
    JSON,
    COLOR,
)


def run(arguments: argparse.Namespace) -> int:
    check_suffix("--svg", arguments.svg, ".svg")
    ways = [way for way in _WAYS if getattr(arguments, way)]
    if len(ways) > 1 or (ways and arguments.svg):
        both = [*ways, *(["svg"] if arguments.svg else [])]
        raise CallerError(f"--{both[0]} and --{both[1]} show different things; give one")
    if arguments.diff:
        if arguments.protocol is not None:
            raise CallerError("--diff A B names both protocols; leave the other out")
        return _diff(arguments)
    if arguments.protocol is None:
        raise CallerError("name a protocol or a file; 'aces protocols' lists the installed ones")
    if arguments.svg:
        write_text(arguments.svg, picture_svg(chosen_messages(arguments)))
    elif arguments.plan:
        _plan(arguments)
    elif arguments.paths:
        _paths(arguments)
    elif arguments.message is None and not arguments.source and not arguments.json:
        _pictures(arguments)
    else:
        arguments.search = None
        return protocols.run(arguments)
    return 0


# ---------------------------------------------------------------------- pictures


def _pictures(arguments: argparse.Namespace) -> None:
    page = Page(arguments.color)
    for index, message in enumerate(chosen_messages(arguments)):
        if index:
            page.lines([""])
        doc = message.doc.strip().partition("\n")[0]
        page.beside(f"{message.protocol.name}.{message.name}", [doc], "message")
        page.lines(picture(message))


# ---------------------------------------------------------------------- the plan


def _plan(arguments: argparse.Namespace) -> None:
    plans = [(message, message.plan) for message in chosen_messages(arguments)]
    if arguments.json:
        print_json([_plain(plan) for _, plan in plans])
        return
    page = Page(arguments.color)
    for index, (message, plan) in enumerate(plans):
        if index:
            page.lines([""])
        page.beside(f"{message.protocol.name}.{plan.name}", [f"declared in {plan.place}"], "message")
        for name, text in _facts(plan):
            page.beside(f"  {name:<10}", [text], "place")
        rows = [(row.name, row.place, row.type, _steps(node)) for row, node in _with_nodes(plan)]
        page.table(
            ("  field", "place", "type", "from the wire to the record"), [(f"  {r[0]}", *r[1:]) for r in rows]
        )


def _facts(plan: p.MessagePlan) -> Iterator[tuple[str, str]]:
    lengths = "any" if plan.lengths is None else ", ".join(map(str, plan.lengths))
    yield (
        "lengths",
        f"{lengths}; at least {plan.least} bytes"
        + (f", {plan.tail} behind the payload" if plan.tail else ""),
    )
    for constant in plan.constants:
        mask = "" if constant.mask == 0xFF else f" & {constant.mask:#04x}"
        yield "constant", f"byte {constant.offset}{mask} = {constant.value:#04x}"
    for choice in plan.one_of:
        values = choice.values
        listed = (
            f"{values[0]}…{values[-1]}" if isinstance(values, range) else ", ".join(map(str, values[:16]))
        )
        more = "" if isinstance(values, range) or len(values) <= 16 else ", …"
        yield "one of", f"{FieldRow.bits_place(choice.number.bits)}: {listed}{more}"
    if plan.lengths_by is not None:
        selector, table, other = plan.lengths_by
        yield (
            "length by",
            f"{selector.name}: {', '.join(f'{value} → {size}' for value, size in table)}; else {other}",
        )
    if plan.split is not None:
        yield "split", f"bytes {plan.split.start}…{plan.split.end} at {plan.split.separator!r}"
    if plan.is_checked:
        yield "check", "the message's own"
    if plan.opaque:
        yield "opaque", plan.opaque


def _with_nodes(plan: p.MessagePlan) -> Iterator[tuple[FieldRow, p.Node]]:
    """Yield the lines of the field table, each with the node that it comes from."""
    nodes = {node.path: node.node for node in (*plan.walk(), *plan.columns)}
    for row in FieldRow.table(plan):
        yield row, nodes.get(row.name, p.Opaque(""))


def _steps(node: p.Node) -> str:
    if node.is_opaque:
        return f"construct: {node.reason}" if node.reason else ""
    for _, item in node.children:
        return _steps(item.node)  # all items have the same
    return ", ".join(filter(None, [*(step.text for step in node.steps), node.unit]))


def _plain(value: Any) -> Any:
    """Return a plan for JSON: each node says what it is."""
    if isinstance(value, msgspec.Struct):
        inside = {name: _plain(getattr(value, name)) for name in value.__struct_fields__}
        return {"is": type(value).__name__, **inside}
    if isinstance(value, range):
        return {"from": value.start, "to": value.stop - 1, "step": value.step}
    if isinstance(value, (tuple, list)):
        return [_plain(item) for item in value]
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    return value.hex() if isinstance(value, bytes) else value


# ---------------------------------------------------------------------- the paths


def _paths(arguments: argparse.Namespace) -> None:
    messages = chosen_messages(arguments)
    hanging: set[str] = set()
    for variant in named_protocol(arguments.protocol).protocol.variants():
        hanging |= needing_context(list(variant.messages.values()))
    found = [_path(message, message.name in hanging) for message in messages]
    if arguments.json:
        print_json(found)
        return
    page = Page(arguments.color)
    if arguments.message is not None:
        for path in found:
            page.beside(str(path["message"]), [f"{path['path']}; in columns {path['columns']}"], "message")
            fields: list[dict[str, str]] = path["fields"]
            page.table(("", "", ""), [(f"  {f['field']}", f["path"], f["how"]) for f in fields])
        return
    rows = [
        (str(path["message"]), str(path["path"]), str(path["columns"]), str(path["why"])) for path in found
    ]
    page.table(("message", "live", "in columns", ""), rows)
    generated = sum(path["path"] == "generated" for path in found)
    page.lines(
        ["", f"{generated} of {len(found)} messages are decoded by generated code, the others by construct"]
    )


def _path(message: Message, hangs: bool) -> dict[str, Any]:
    plan = message.plan
    columns = "at once" if plan.is_flat and not hangs else "one by one"
    both = "" if message.framing is None else "read in both directions together, "
    why = plan.opaque or (f"{both}which message it is hangs on a request before it" if hangs else "")
    return {
        "message": message.name,
        "path": "generated" if plan.is_flat else "construct",
        "columns": columns,
        "why": why,
        "fields": [
            {
                "field": leaf.path,
                "path": "construct" if leaf.node.is_by_construct else "generated",
                "how": leaf.node.how,
            }
            for leaf in plan.columns
        ],
    }


# ---------------------------------------------------------------------- differences


def _diff(arguments: argparse.Namespace) -> int:
    from .diff import difference_lines, spec_difference

    old, new = (named_protocol(text).variant() for text in arguments.diff)
    found = spec_difference(old.messages, new.messages)
    if arguments.json:
        print_json({"from": old.label, "to": new.label, **found.as_dict()})
        return int(not found.is_none)
    page = Page(arguments.color)
    page.lines([f"{page.paint('malformed', f'- {old.label}')}", page.paint("from device", f"+ {new.label}")])
    for style, line in difference_lines(found):
        page.lines(page.paint(style, part) for part in _folded(line, page.width))
    page.lines(
        [
            f"{len(found.removed)} removed, {len(found.added)} added, {len(found.changed)} changed,"
            f" {found.same} the same"
        ]
    )
    return int(not found.is_none)


def _folded(line: str, width: int | None) -> list[str]:
    import textwrap

    if width is None or len(line) <= width:
        return [line]
    indent = " " * (len(line) - len(line.lstrip()) + 4)
    return textwrap.wrap(
        line, max(width, 24), subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
    )
