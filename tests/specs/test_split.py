"""A `Split` as a field of its own reads and writes what it does at the same bits of a `BitLayout`."""

from __future__ import annotations

import pytest
from construct import Array, Byte, Int16ul, Struct
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from aces_bus import decode
from aces_bus.errors import FieldError, SpecError
from aces_bus.protocol import BitLayout, Protocol, Quantity, SignMagnitude, Split, bits
from aces_bus.testing import Fuzzer

#: Pieces of 3 or 4 whole bytes: whole ones in an order of their own, and nibbles.
PIECES = [
    ((8, 16), (0, 8)),
    ((16, 8), (8, 8), (0, 8)),
    ((4, 4), (12, 12), (0, 4), (8, 4), (24, 8)),
]


def alone(pieces: tuple[tuple[int, int], ...], *, signed: bool, order: str) -> Protocol:
    protocol = Protocol("alone", link="can")
    number = Quantity(Split(*pieces, signed=signed, order=order), unit="m", scale=0.01)
    protocol.message("Place", id=1, payload=Struct("before" / Byte, "number" / number, "behind" / Int16ul))
    return protocol


def in_a_layout(pieces: tuple[tuple[int, int], ...], *, signed: bool, order: str) -> Protocol:
    protocol = Protocol("layout", link="can")
    width = sum(width for _, width in pieces)
    moved = Split(*((8 + at, width) for at, width in pieces), signed=signed, order=order)
    protocol.message(
        "Place",
        id=1,
        payload=BitLayout(
            3 + width // 8,
            "before" / bits(8),
            "number" / Quantity(moved, unit="m", scale=0.01),
            "behind" / bits(16, 8 + width),
        ),
    )
    return protocol


@given(
    st.sampled_from(PIECES), st.booleans(), st.sampled_from(("lsb", "msb")), st.binary(min_size=7, max_size=7)
)
def test_it_is_the_number_of_a_layout(
    pieces: tuple[tuple[int, int], ...], signed: bool, order: str, data: bytes
) -> None:
    """The same bytes are the same value either way, live, in columns and back."""
    one, other = (make(pieces, signed=signed, order=order) for make in (alone, in_a_layout))
    assert one["Place"].plan.leaves[1].node.place == other["Place"].plan.leaves[1].node.place
    made = one.encode("Place", before=0, number=0, behind=0)
    frame = replace(made, data=data[: len(made.data)])
    (mine,), (theirs,) = (protocol.scanner().feed([frame]) for protocol in (one, other))
    fields = {name: getattr(mine, name) for name in ("before", "number", "behind")}
    assert fields == {name: getattr(theirs, name) for name in fields}
    assert bytes(one.encode("Place", **fields).data) == bytes(frame.data)
    assert decode([frame], one)["Place"]["number"].values.tolist() == [mine.number]


def test_the_laws_hold_of_it() -> None:
    """Also under a sign and magnitude, in arrays, and in lists of groups."""
    protocol = alone(PIECES[0], signed=True, order="msb")
    protocol.message("Two", id=2, payload=Struct("x" / Array(2, SignMagnitude(Split((4, 12), (0, 4))))))
    assert Fuzzer([protocol], seed=1).run(64) == []


def test_a_number_of_48_bits_with_its_fraction_first() -> None:
    """Xsens' FP16.32: 32 bits of fraction, then 16 bits of sign and integer, each with the high byte first."""
    field = Quantity(Split((0, 32), (32, 16), signed=True, order="msb"), unit="°", scale=2.0**-32)
    protocol = Protocol("fixed", link="can")
    protocol.message("Place", id=1, payload=Struct("latitude" / field))
    (place,) = protocol.scanner().feed([protocol.encode("Place", latitude=-1.75)])
    assert place.latitude == -1.75
    assert protocol.encode("Place", latitude=-1.75).data.hex(" ") == "40 00 00 00 ff fe"
    with pytest.raises(FieldError, match="latitude"):
        protocol.encode("Place", latitude=40_000)


def test_a_register_may_be_one() -> None:
    """Registers are fields by themselves, too; bits that are not whole bytes are refused there as anywhere."""
    protocol = Protocol("servo", link="serial")
    packet = protocol.framing(sync=b"\xff", size=6, max_size=6)
    packet("Read", payload=Struct("start" / Byte, "count" / Byte, "more" / Array(3, Byte)))
    registers = protocol.registers(read="Read", write="Read")
    counts = registers.add("counts", 0, Split((16, 16), (0, 16)))
    assert counts.decode(bytes.fromhex("01 00 02 00")) == 0x0001_0002
    assert counts.encode(0x0001_0002) == bytes.fromhex("01 00 02 00")
    with pytest.raises(SpecError, match="go into a BitLayout"):
        registers.add("part", 8, bits(8))


@pytest.mark.parametrize("pieces", [((0, 8), (16, 8)), ((0, 8), (0, 8)), ((0, 4), (4, 3)), ((8, 8), (16, 8))])
def test_pieces_that_are_no_whole_bytes_side_by_side_are_refused(pieces: tuple[tuple[int, int], ...]) -> None:
    """Bytes between the pieces, bits twice, and parts of bytes."""
    with pytest.raises(SpecError, match=r"test_split.py:\d+: .* whole bytes side by side"):
        Protocol("p", link="can").message("M", id=1, payload=Struct("n" / Split(*pieces), "m" / Byte))
