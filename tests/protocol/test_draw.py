"""Pictures and tables of messages: every bit in its place."""

from __future__ import annotations

import pytest
from construct import Array, Byte, Bytes, Float64b, GreedyBytes, Int16sb, Int16ul, Int32ul, Struct

from aces_bus import list_protocols, load_protocol
from aces_bus.protocol import BitLayout, Message, Multiplexed, Protocol, Quantity, Split, bits
from aces_bus.protocol.draw.table import FieldRow
from aces_bus.protocol.draw.text import picture
from aces_bus.protocol.plan.flatten import flatten
from tests.conftest import Golden
from tests.specs.catalogue import SPECS

PROTOCOLS: dict[str, Protocol] = {name: load_protocol(name) for name in list_protocols()} | SPECS
every_protocol = pytest.mark.parametrize("protocol", PROTOCOLS.values(), ids=list(PROTOCOLS))


@every_protocol
def test_every_field_has_its_row(protocol: Protocol) -> None:
    """The table names every value of the record, in order."""
    for message in protocol.declared:
        rows = FieldRow.table(flatten(message), FieldRow.captured(message))
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
    rows = FieldRow.table(flatten(message), FieldRow.captured(message))
    table = [" | ".join([r.name, r.place, r.type, r.unit, r.scale, r.range, r.names, r.doc]) for r in rows]
    golden(f"draw/{message.name}.txt", "\n".join([*picture(message), "", *table, ""]))


def test_a_message_without_bytes() -> None:
    """Nothing to draw is said."""
    assert picture(spec.message("Empty", id=5, length=0)) == ["(no bytes)"]
