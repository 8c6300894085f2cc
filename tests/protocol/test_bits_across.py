"""Numbers with bits in header and payload, and quantities of two scales that a bit chooses."""

from __future__ import annotations

import json
import random
from fractions import Fraction
from typing import Any

import pytest
from construct import Byte, Default, Float32l, Int16sl, Int16ub, Int16ul, Struct, this

from aces_bus import decode
from aces_bus.errors import AcesError, FieldError, SpecError
from aces_bus.protocol import BitLayout, Crc, Enumeration, Protocol, Quantity, Split, TwoScales, bits
from aces_bus.protocol.draw.table import FieldRow
from aces_bus.protocol.draw.text import picture
from aces_bus.protocol.exchange import print_dbc
from aces_bus.protocol.exchange.export_stubs import print_stub
from aces_bus.testing import law_tests
from aces_tools.output.shape import plain_of
from aces_tools.output.value_text import step_format

FIRST = [number for number in range(256) if number & 3 in (1, 2)]


def nodes() -> Protocol:
    """Packets without sync bytes: bits of both header bytes say what they are, and the rest of them are data."""
    made = Protocol("nodes", link="serial", source="after RPLIDAR's measurements")
    packet = made.framing(
        header=Struct("first" / Byte, "second" / Byte),
        match={"first": FIRST, "second": range(1, 256, 2)},
        size=5,
    )
    packet(
        "Node",
        direction="from device",
        payload_from="first",
        payload=BitLayout(
            5,
            "turn" / Enumeration(bits(2), start=1, goes_on=2),
            "quality" / bits(6),
            "mark" / Default(bits(1), 1),
            "angle" / Quantity(bits(15), unit="deg", scale=1 / 64),
            "distance" / Quantity(bits(16), unit="mm", scale=0.25),
        ),
    )
    return made


def heights() -> Protocol:
    """A height whose highest bit says whether it counts decimetres from −1000 m or metres."""
    made = Protocol("heights", link="serial", source="after CRSF's barometric altitude")
    packet = made.framing(
        sync=b"\xc8",
        header=Struct("length" / Byte, "type" / Byte),
        size=this.length + 2,
        max_size=64,
        check=Crc("CRC8-DVB-S2", over=slice(2, -1)),
    )
    height = TwoScales(Int16ub, (0.1, -1000), (1, 0), unit="m", doc="above the start")
    packet("Height", match={"type": 9}, payload=Struct("height" / height))
    swapped = Split((1, 7), (0, 1))  # another bit than the highest chooses
    packet(
        "Small",
        match={"type": 10},
        payload=BitLayout(1, "speed" / TwoScales(swapped, (0.5, 0), (10, 0), unit="m/s")),
    )
    return made


test_nodes_obey_the_laws = law_tests(nodes(), examples=4)
test_heights_obey_the_laws = law_tests(heights(), examples=4)


def test_a_number_has_bits_in_header_and_payload() -> None:
    """What plain arithmetic makes of five bytes is what live scanners, columns and the reference make of them."""
    made, chance = nodes(), random.Random(30)
    data, wanted = b"", []
    for _ in range(3000):
        turn, quality = chance.choice([1, 2]), chance.randrange(64)
        angle, distance = chance.randrange(1 << 15), chance.randrange(1 << 16)
        packet = bytes([turn | quality << 2, 1 | angle << 1 & 0xFF, angle >> 7]) + distance.to_bytes(
            2, "little"
        )
        values: dict[str, Any] = {
            "turn": ("start", "goes_on")[turn - 1],
            "quality": quality,
            "angle": angle / 64,
        }
        assert made.encode("Node", **values, distance=distance / 4) == packet
        data += packet
        wanted.append((values["turn"], quality, angle / 64, distance / 4))
    found = [(r.turn, r.quality, r.angle, r.distance) for r in made.scanner().feed(data)]
    assert found == wanted
    table = decode(data, made)["Node"]
    assert table["angle"].to_list() == [angle for _, _, angle, _ in wanted]
    message = made.messages["Node"]
    assert message.struct.parse(data[:5]).angle == wanted[0][2]
    assert message.fields == ("turn", "quality", "mark", "angle", "distance")


def test_what_the_template_refuses_is_not_built() -> None:
    """A packet whose fields contradict what its framing reads is an error that names the header field."""
    with pytest.raises(FieldError, match="by its fields second is 0x00, which does not go with it"):
        nodes().encode("Node", turn="start", quality=0, mark=0, angle=0, distance=0)


def test_a_picture_has_the_payloads_fields_alone() -> None:
    """The drawing and the table show the bits of the header bytes as the payload's fields, once."""
    message = nodes().messages["Node"]
    text = "\n".join(picture(message))
    assert "first" not in text
    assert "angle" in text
    rows = {row.name: row for row in FieldRow.table(message.plan)}
    assert rows["angle"].place == "byte 1 bits 7…1 + byte 2"


@pytest.mark.parametrize(
    ("given", "reason"),
    [
        (
            {"payload_from": "third"},
            "'third' is not a field of the framing's header .there are: first, length",
        ),
        ({"payload_from": "length"}, "would begin in front of length, which is computed"),
    ],
)
def test_a_payload_begins_at_fields_that_are_given(given: dict[str, Any], reason: str) -> None:
    """A payload cannot begin at a header field that there is not, or that is computed."""
    made = Protocol("lengths", link="serial", source="made up")
    packet = made.framing(
        sync=b"\xaa", header=Struct("first" / Byte, "length" / Byte), size=this.length + 3, max_size=20
    )
    with pytest.raises(SpecError, match=reason):
        packet("Any", payload=Struct("first" / Byte, "more" / Byte), **given)


# ---------------------------------------------------------------------- two scales


def meant(raw: int) -> Fraction:
    """Return the height in metres that a raw number means, exactly."""
    return Fraction(raw & 0x7FFF) if raw & 0x8000 else Fraction(raw, 10) - 1000


def test_every_raw_number_of_two_scales_is_the_same_everywhere() -> None:
    """Live, columns and construct give the same float for nine thousand raw numbers, and it is the value that is meant."""
    made = heights()
    message = made.messages["Height"]
    raws = [*range(0, 1 << 16, 7), *range(0x7FF0, 0x8010), 0xFFFF]
    packets = [bytes(message.struct.build({"height": raw}, raw=True)) for raw in raws]
    live = [record.height for record in made.scanner().feed(b"".join(packets))]
    assert all(type(value) is float for value in live)
    columns = decode(b"".join(packets), made)["Height"]["height"]
    assert columns.values.dtype == "f8"
    assert columns.to_list() == live
    assert all(
        abs(Fraction(value) - meant(raw)) < Fraction(1, 10**9) for raw, value in zip(raws, live, strict=True)
    )
    assert [message.struct.parse(packet).height for packet in packets[::97]] == live[::97]
    node = next(iter(message.plan.leaves)).node
    plain = plain_of(node)
    values = [10127 * 0.1 - 1000, 5.0]
    assert [json.dumps(plain(value)) for value in values] == ["12.7", "5.0"]
    assert [format(value, step_format(node)) for value in values] == ["12.7", "5.0"]


def test_what_is_sent_takes_the_scale_that_says_it_best() -> None:
    """Of all raw numbers none is nearer to the value than the one that is sent, the finer scale where both say it."""
    made, chance = heights(), random.Random(30)
    message = made.messages["Height"]
    drawn = [chance.uniform(-1000, 2300) for _ in range(200)] + [
        chance.uniform(2276, 32767) for _ in range(100)
    ]
    for value in [*drawn, -1000, 0, 12, 2276.7, 2276.74, 2276.76, 32767]:
        raw = message.struct.parse(made.encode("Height", height=value), raw=True).height
        nearest = min(abs(meant(n) - Fraction(value)) for n in _around(value))
        assert abs(meant(raw) - Fraction(value)) <= nearest + Fraction(1, 10**9)
        assert raw & 0x8000 or value < 2276.85
    for value in range(-1000, 2277):  # both say it
        assert not message.struct.parse(made.encode("Height", height=value), raw=True).height & 0x8000


def _around(value: float) -> list[int]:
    low, high = round((value + 1000) * 10), round(value)
    return [n for n in range(low - 2, low + 3) if 0 <= n < 1 << 15] + [
        1 << 15 | n for n in range(high - 2, high + 3) if 0 <= n < 1 << 15
    ]


@pytest.mark.parametrize("value", [-1001, 32768, -1.7e308, 1.7e308, float("nan"), float("inf"), "high", None])
def test_what_neither_scale_says_is_refused(value: Any) -> None:
    """A value outside both scales, or no number, is an error that names the field."""
    with pytest.raises(FieldError, match="Height: height: "):
        heights().encode("Height", height=value)


def test_any_bit_may_choose() -> None:
    """With `Split` the lowest bit is on top, so that it chooses."""
    made = heights()
    assert made.encode("Small", speed=3.5)[3] == 7 << 1
    assert made.encode("Small", speed=800)[3] == 80 << 1 | 1
    assert made.scanner().feed(made.encode("Small", speed=800))[0].speed == 800.0


def test_exports_say_what_they_leave_out() -> None:
    """Formats that have one scale a signal show the raw number, without the unit, and say so."""
    from aces_lab.exchange import print_c_source, print_dissector

    made = Protocol("car", link="can", source="made up")
    height = TwoScales(Int16ul, (0.1, -1000), (1, 0), unit="m")
    made.message("Height", id=0x10, direction="from device", payload=Struct("height" / height))
    variant, reason = made.variant(), "two scales, of which its highest bit chooses"
    text, losses = print_dbc(variant)
    assert ' "" ' in text
    assert any(reason in loss.reason for loss in losses)
    dissector, losses = print_dissector(variant)
    assert any(reason in loss.reason for loss in losses)
    assert '"m"' not in dissector
    source = print_c_source(variant)
    assert any(reason in loss.reason for loss in source.losses)
    assert "[m]" not in source.header
    assert "height: float" in print_stub(made, "made")
    row = FieldRow.table(made.messages["Height"].plan)[0]
    assert (row.unit, row.scale, row.offset, row.range) == (
        "m",
        "0.1 or 1",
        "-1000 or 0",
        "-1000…2276.7 or 0…32767",
    )


@pytest.mark.parametrize(
    ("made", "reason"),
    [
        (lambda: TwoScales(Int16sl, (1, 0), (2, 0)), "takes an unsigned integer"),
        (lambda: TwoScales(Float32l, (1, 0), (2, 0)), "takes an integer"),
        (lambda: TwoScales(Byte, (0, 0), (2, 0)), "a scale must be finite and not zero"),
        (lambda: Quantity(TwoScales(Byte, (1, 0), (2, 0)), scale=2), "takes a number of the wire"),
    ],
)
def test_two_scales_are_of_an_unsigned_number(made: Any, reason: str) -> None:
    """A field of two scales without a bit that chooses is refused where it is declared."""
    with pytest.raises(AcesError, match=reason):
        made()
