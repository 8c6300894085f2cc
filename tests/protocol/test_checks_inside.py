"""Checks that are not behind the payload: in a packet's header, and a message's own on a stream."""

from __future__ import annotations

import pytest
from construct import Byte, Float32l, GreedyBytes, Int16ub, Int16ul, Struct, this

from aces_bus.errors import FieldError, SpecError
from aces_bus.protocol import Crc, Protocol, Slip, Sum
from aces_bus.testing import law_tests


def blocks() -> Protocol:
    """The layout of Septentrio's SBF: the CRC stands in front of what it covers."""
    made = Protocol("blocks", link="serial", source="SBF reference guide: sync, CRC, ID, length")
    header = Struct("crc" / Int16ul, "kind" / Int16ul, "length" / Int16ul)
    check = Crc("CRC16-XMODEM", field="crc", over=slice(4, None))
    block = made.framing(sync=b"$@", header=header, size=this.length + 0, max_size=96, check=check)
    block("Fixed", match={"kind": 1}, payload=Struct("x" / Int16ul, "y" / Float32l))
    block("Open", match={"kind": 2}, payload=Struct("x" / Int16ul, "rest" / GreedyBytes))
    return made


def sums() -> Protocol:
    """A sum in the header, and a message with a CRC of its own besides."""
    made = Protocol("sums", link="serial", source="drawn")
    header = Struct("kind" / Byte, "sum" / Byte, "length" / Byte)
    packet = made.framing(
        sync=b"\xaa", header=header, size=this.length + 4, max_size=64, check=Sum(field="sum")
    )
    packet("Plain", match={"kind": 1}, payload=Struct("x" / Int16ul, "rest" / GreedyBytes))
    payload = Struct("x" / Int16ul, "own" / Int16ub, "rest" / GreedyBytes)
    packet("Twice", match={"kind": 3}, payload=payload, check=Crc("CRC16-XMODEM", field="own"))
    return made


test_blocks_obey_the_laws = law_tests(blocks(), examples=4)
test_sums_obey_the_laws = law_tests(sums(), examples=4)


def test_bytes_of_a_check_in_front() -> None:
    """The CRC of the bytes behind it: '123456789' in XMODEM's CRC is 31C3 (its catalogue)."""
    made = Protocol("catalogue", link="serial")
    check = Crc("CRC16-XMODEM", field="crc", over=slice(3, None))
    made.framing(sync=b"$", header=Struct("crc" / Int16ul), size=12, check=check)(
        "M", payload=Struct("x" / GreedyBytes)
    )
    assert made.encode("M", x=b"123456789") == b"$\xc3\x31123456789"


def test_an_own_check_is_written_and_read() -> None:
    """The scanner takes what the encoder makes, and nothing with a byte of it changed."""
    made = sums()
    packet = made.encode("Twice", x=5, rest=b"k")
    assert [type(record).__name__ for record in made.scanner().feed(packet)] == ["Twice"]
    for at in range(4, len(packet)):  # the framing's sum made good
        changed = bytearray(packet)
        changed[at] ^= 1
        changed[2] = (changed[1] + sum(changed[3:])) & 0xFF
        (lost,) = made.scanner(include_unknown=True).feed(bytes(changed))
        assert type(lost).__name__ == "Unknown"


def test_a_field_of_a_check_is_in_the_header() -> None:
    """A framing's check names a header field of its size and order, and no message matches it."""
    made = Protocol("wrong", link="serial")
    with pytest.raises(SpecError, match="a header field of 2 bytes"):
        made.framing(sync=b"$", header=Struct("crc" / Byte), size=9, check=Crc("CRC16-XMODEM", field="crc"))
    with pytest.raises(SpecError, match="order='little', its field 'crc' 'big'"):
        made.framing(
            sync=b"$", header=Struct("crc" / Int16ub), size=9, check=Crc("CRC16-XMODEM", field="crc")
        )
    with pytest.raises(SpecError, match="does not go with stuffing"):
        made.framing(
            header=Struct("sum" / Byte), end=b"\xc0", stuffing=Slip(), max_size=9, check=Sum(field="sum")
        )
    framing = made.framing(sync=b"$", header=Struct("sum" / Byte), size=4, check=Sum(field="sum"))
    with pytest.raises(SpecError, match="it is not matched"):
        framing("M", match={"sum": 1}, payload=Struct("x" / Int16ul))


def test_an_own_check_over_what_it_changes_is_refused() -> None:
    """A check that covers the framing's own sum, which covers the check, has no answer."""
    made = Protocol("circle", link="serial")
    framing = made.framing(sync=b"$", header=Struct("sum" / Byte), size=5, check=Sum(field="sum"))
    framing(
        "M",
        payload=Struct("own" / Byte, "x" / Int16ul),
        check=Sum(field="own", over=(slice(1, 2), slice(3, None))),
    )
    with pytest.raises(FieldError, match="its check covers what the check itself changes"):
        made.encode("M", x=5)
