"""Pictures and tables of messages: every bit in its place."""

from __future__ import annotations

import re
from collections.abc import Iterator

import pytest
from construct import Array, Byte, Bytes, Float64b, GreedyBytes, Int16sb, Int16ul, Int32ul, Struct

from aces_bus import list_protocols, load_protocol
from aces_bus.protocol import BitLayout, Message, Multiplexed, Protocol, Quantity, Split, bits
from aces_bus.protocol.draw.cells import SHARING
from aces_bus.protocol.draw.table import captured_values, field_table
from aces_bus.protocol.draw.text import picture
from aces_bus.protocol.plan import nodes as p
from aces_bus.protocol.plan.flatten import flatten
from tests.conftest import Golden
from tests.specs.catalogue import SPECS

PROTOCOLS: dict[str, Protocol] = {name: load_protocol(name) for name in list_protocols()} | SPECS
every_protocol = pytest.mark.parametrize("protocol", PROTOCOLS.values(), ids=list(PROTOCOLS))
ROW = re.compile(r"^ *(\S+) │(.*)│$")


Rows = dict[int, list[tuple[int, str]]]


def cells(lines: list[str]) -> list[Rows]:
    """Of each picture of what is always there: of each byte that has a row of its own, the cells: (bits, text), bit 7
    first."""
    found: list[Rows] = [{}]
    is_always = True
    for line in lines:
        if line == "":
            is_always = False  # pictures of multiplexed fields follow
        elif line == SHARING:
            found.append({})
            is_always = True
        elif line.endswith(":"):
            break
        row = ROW.match(line)
        if is_always and row is not None and row[1].isdecimal():
            found[-1][int(row[1])] = [((len(text) + 1) // 9, text.strip()) for text in row[2].split("│")]
    return found


@every_protocol
def test_every_message_can_be_drawn(protocol: Protocol) -> None:
    """A picture fits 79 columns, its frame is closed, and each byte has eight bits; each bit is where the plan has it.

    The cell at a bit's place names the bit's field, and the bit's number where the field has several cells.
    """
    for message in protocol.declared:
        lines = picture(message)
        assert max(map(len, lines)) <= 79, message
        assert all(line == line.rstrip() for line in lines), message
        assert all(len(line) == 79 for line in lines if line[6:7] in ("│", "┌", "├", "└")), message
        pictures = cells(lines)
        for rows in pictures:
            assert all(sum(width for width, _ in row) == 8 for row in rows.values()), message
        for name, scalar in scalars(flatten(message).fields, ""):
            if not any(isinstance(step, p.FlagBits) for step in scalar.steps):
                assert any(is_drawn(name, scalar, rows) for rows in pictures), (message, name)


def is_drawn(name: str, scalar: p.Scalar, rows: Rows) -> bool:
    """Whether all bits of a field are where the plan has them."""
    for index, position in enumerate(scalar.bits):
        row = rows.get(position // 8)
        if row is None:
            continue  # a long message has one row for a whole number
        at = 7
        for width, text in row:
            if at - width < position % 8 <= at:
                shown = text.partition("…")[0].partition(" ")[0]
                if not shown or not any(n.startswith(shown) for n in (name, name.rpartition(".")[2])):
                    return False
                numbers = re.search(r" (\d+)(?:…(\d+))?$", text)
                if numbers and int(numbers[1]) - (at - position % 8) != index:
                    return False
                if not numbers and width != len(scalar.bits):
                    return False
                break
            at -= width
    return True


def scalars(fields: tuple[p.PlanField, ...], prefix: str) -> Iterator[tuple[str, p.Scalar]]:
    """Integers that are always there, by their names in pictures."""
    for field in fields:
        if field.when is not None:
            continue
        if isinstance(field.node, p.NestedRecord):
            yield from scalars(field.node.fields, f"{prefix}{field.name}.")
        elif isinstance(field.node, p.Many):
            for index, item in enumerate(field.node.items):
                if isinstance(item, p.Scalar):
                    yield f"{prefix}{field.name}.{index}", item
        elif isinstance(field.node, p.Scalar):
            yield prefix + field.name, field.node


@every_protocol
def test_every_field_has_its_row(protocol: Protocol) -> None:
    """The table names every value of the record, in order."""
    for message in protocol.declared:
        rows = field_table(flatten(message), captured_values(message))
        assert list(dict.fromkeys(row.name.partition(".")[0] for row in rows)) == list(message.fields), (
            message
        )


spec = Protocol("drawn", link="can")
Orders = spec.message(
    "Orders",
    id=1,
    payload=Struct("little" / Int16ul, "big" / Quantity(Int16sb, unit="°", scale=0.5), "one" / Byte),
)
Layout = spec.message(
    "Layout",
    id=2,
    payload=BitLayout(
        4,
        "page" / bits(2),
        "lonely" / bits(1),
        "split" / Split((4, 4), (28, 4)),
        "low" / Multiplexed("page", 0, bits(10, at=8)),
        "high" / Multiplexed("page", (1, 2), bits(6, at=8, signed=True)),
    ),
)
Long = spec.message(
    "Long", id=3, fd=True, payload=Struct("words" / Array(6, Int32ul), "f" / Float64b, "b" / Bytes(16))
)
Open = spec.message("Open", id=4, payload=Struct("first" / Byte, "rest" / GreedyBytes))
line = Protocol("drawn_line", link="serial")
framing = line.framing(
    sync=b"\xaa", header=Struct("length" / Byte), size=lambda this: this.length + 2, max_size=100
)
Packet = framing("Packet", payload=Struct("value" / Int16ul, "rest" / GreedyBytes))


@pytest.mark.parametrize("message", [Orders, Layout, Long, Open, Packet], ids=lambda m: m.name)
def test_pictures(message: Message, golden: Golden) -> None:
    """Byte orders, split and multiplexed fields, long and open messages look as they always did."""
    rows = field_table(flatten(message), captured_values(message))
    table = [" | ".join([r.name, r.place, r.type, r.unit, r.scale, r.range, r.names, r.doc]) for r in rows]
    golden(f"draw/{message.name}.txt", "\n".join([*picture(message), "", *table, ""]))


def test_a_message_without_bytes() -> None:
    """Nothing to draw is said."""
    assert picture(spec.message("Empty", id=5, length=0)) == ["(no bytes)"]
