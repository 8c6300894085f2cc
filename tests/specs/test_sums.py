"""Sums as sheets have them: plain, as their complement, as their two's complement."""

from __future__ import annotations

from typing import Any

import pytest
from construct import Byte, Bytes, BytesInteger, Checksum, GreedyBytes, Struct, this
from hypothesis import given
from hypothesis import strategies as st

from aces_bus.errors import SpecError
from aces_bus.protocol import Protocol, Sum
from aces_bus.protocol.reference import Reference


def protocol_with(check: Sum) -> Protocol:
    """FA FF kind length … check, as Xsens Xbus has it."""
    protocol = Protocol("summed", link="serial")
    packet = protocol.framing(
        sync=b"\xfa\xff",
        header=Struct("kind" / Byte, "length" / Byte),
        size=this.length + 4 + check.size,
        max_size=263,
        check=check,
    )
    packet("Any", payload=Struct("data" / GreedyBytes))
    return protocol


@pytest.mark.parametrize("packet", ["FA FF 30 00 D1", "FA FF 10 00 F1", "FA FF 3E 00 C3"])
def test_packets_of_a_sheet_add_up_to_zero(packet: str) -> None:
    """Xbus' GoToConfig, GoToMeasurement and WakeUp: all bytes behind FA and the check add up to 0."""
    protocol = protocol_with(Sum(negated=True, over=slice(1, -1)))
    data = bytes.fromhex(packet)
    (found,) = protocol.scanner().feed(data)
    assert (found.kind, found.data) == (data[2], b"")
    assert protocol.encode("Any", kind=data[2], data=b"") == data


@given(st.binary(max_size=200), st.sampled_from((1, 2, 3, 8)), st.booleans(), st.integers(0, 255))
def test_construct_agrees(data: bytes, size: int, is_big: bool, spoilt: int) -> None:
    """construct's own `Checksum` reads and refuses the same packets, live and in the reference."""
    protocol = protocol_with(Sum(size, negated=True, order="big" if is_big else "little"))
    modulo = 256**size

    def negative(covered: bytes) -> int:
        return modulo - 1 - (sum(covered) - 1) % modulo if covered else 0

    body = Struct("kind" / Byte, "length" / Byte, "data" / Bytes(this.length))
    wanted = body.build({"kind": 7, "length": len(data), "data": data})
    check: Any = Checksum(BytesInteger(size, swapped=not is_big), negative, lambda _: wanted)
    packet = protocol.encode("Any", kind=7, data=data)
    assert packet == b"\xfa\xff" + wanted + check.build(None)
    (record,) = protocol.scanner().feed(packet)
    assert record.data == data
    broken = packet[:-1] + bytes([spoilt])
    records = [r.meta.message for r in protocol.scanner().feed(broken)]
    truth = Reference([protocol.variant()]).stream(broken)
    assert bool(records) == (broken == packet) == any(item.message is not None for item in truth)


def test_a_sum_is_one_complement_or_the_other() -> None:
    """Both complements at once are refused."""
    with pytest.raises(SpecError, match="not both"):
        Sum(inverted=True, negated=True)
