"""A length of which one value means that a wider one follows, as in Xbus."""

from __future__ import annotations

from typing import Any

import pytest
from construct import (
    Byte,
    Bytes,
    Checksum,
    Const,
    If,
    Int16sb,
    Int16ub,
    RawCopy,
    Rebuild,
    Struct,
    len_,
    this,
)

from aces_bus import Unknown, decode
from aces_bus.errors import FieldError, SpecError
from aces_bus.protocol import Escaped, Protocol, Slip, Sum
from aces_bus.protocol.explain.tracer import Tracer
from aces_bus.protocol.reference import Reference
from tests.specs.xbus_like import xbus_like

#: The same packet written with construct alone.
BODY = Struct(
    "bus" / Byte,
    "mid" / Byte,
    "length" / Rebuild(Byte, lambda ctx: min(len(ctx.data), 255)),
    "wide" / If(this.length == 255, Rebuild(Int16ub, len_(this.data))),
    "data" / Bytes(lambda ctx: ctx.wide if ctx.length == 255 else ctx.length),
)
PACKET = Struct(
    Const(b"\xfa"),
    "body" / RawCopy(BODY),
    Checksum(Byte, lambda data: -sum(data) & 0xFF, this.body.data),
)
SIZES = (0, 1, 253, 254, 255, 256, 257, 258, 600, 2048)


def foreign(data: bytes) -> bytes:
    """A packet as construct makes it."""
    return bytes(PACKET.build({"body": {"value": {"bus": 0xFF, "mid": 0x36, "data": data}}}))


@pytest.mark.parametrize("size", SIZES)
def test_construct_agrees_on_both_sides_of_the_escape(size: int) -> None:
    """What construct builds is read, and what is encoded construct reads: short, longest short, shortest wide, longest."""
    data = bytes(n * 7 & 0xFF for n in range(size))
    packet = foreign(data)
    assert xbus_like.encode("MtData2", items=data) == packet
    assert PACKET.parse(packet).body.value.data == data
    assert len(packet) == size + (5 if size < 255 else 7)
    (item,) = Reference([xbus_like.variant()]).stream(packet)
    assert item.fields is not None
    assert item.fields["items"] == data
    table = decode(packet * 3, xbus_like)["MtData2"]
    assert table["items"].to_list() == [data] * 3
    for cut in (1, 3, 5, 6, 1000, 10_000):
        scanner = xbus_like.scanner()
        stream = b"\xfa" + packet + b"\x00" + packet
        records = [r for at in range(0, len(stream), cut) for r in scanner.feed(stream[at : at + cut])]
        assert [record.items for record in [*records, *scanner.close()]] == [data, data]


def test_a_length_has_one_form() -> None:
    """A wide length that was not needed is malformed, live and by the reference, and the search goes on."""
    body = b"\xff\x36\xff\x00\x02\x11\x22"
    packet = b"\xfa" + body + bytes([-sum(body) & 0xFF])
    good = foreign(b"\x01")
    records = xbus_like.scanner(include_unknown=True).feed(packet + good)
    assert isinstance(records[0], Unknown)
    assert records[0].reason == "malformed: length"
    assert records[-1].items == b"\x01"
    truth = Reference([xbus_like.variant()]).stream(packet + good)
    assert next(item.reason for item in truth) == "malformed: length"


def test_too_much_data_is_refused() -> None:
    """Longer than max_size is not sent."""
    with pytest.raises(FieldError, match="longer than 2055"):
        xbus_like.encode("MtData2", items=bytes(2049))


def test_the_wide_length_is_explained() -> None:
    """`aces spec explain` knows where a long packet ends, and that its check holds."""
    packet = foreign(bytes(300))
    tracer = Tracer([xbus_like.variant()], direction="from device")
    (attempt,) = tracer.explain_stream(packet)
    assert (attempt.found.size, attempt.found.message) == (307, "MtData2")
    places = {step.what for step in attempt.steps}
    assert {"sync", "mid", "length", "check"} <= places


@pytest.mark.parametrize(
    ("framing", "text"),
    [
        ({"size": Escaped(this.length + 5, 256, Int16ub)}, "is never 256"),
        ({"size": Escaped(this.length + 5, 255, Byte)}, "more than 1 bytes"),
        ({"size": Escaped(this.length + 5, 255, Int16sb)}, "unsigned"),
        ({"size": Escaped(this.kind + 5, 255, Int16ub)}, "'kind' must be its last field"),
        ({"size": Escaped(this.length + 5, 255, Int16ub), "stuffing": Slip()}, "does not go with stuffing"),
    ],
)
def test_what_cannot_be_escaped_is_refused(framing: dict[str, Any], text: str) -> None:
    """Values that the length cannot have, widths that are none, fields between length and wider length."""
    protocol = Protocol("refused", link="serial")
    with pytest.raises(SpecError, match=text):
        protocol.framing(
            sync=b"\xfa",
            header=Struct("kind" / Byte, "length" / Byte),
            max_size=300,
            check=Sum(negated=True),
            **framing,
        )


def test_a_message_is_not_told_by_the_escape() -> None:
    """`match` of the escape value would be of every long packet."""
    protocol = Protocol("told", link="serial")
    packet = protocol.framing(
        sync=b"\xfa",
        header=Struct("length" / Byte),
        size=Escaped(this.length + 2, 255, Int16ub),
        max_size=300,
    )
    with pytest.raises(SpecError, match="a wider one follows"):
        packet("Long", match={"length": 255})
