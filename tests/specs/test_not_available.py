"""The highest raw values as *not available*: SAE J1939 by the highest byte, NMEA 2000 by the value."""

from __future__ import annotations

import pytest
from construct import Byte, Float32l, Int8sl, Int16sl, Int16ul, Int32ul, Int64ul, Struct

from aces_bus import Frame, FrameTable, decode
from aces_bus.errors import FieldError, SpecError
from aces_bus.protocol import BitLayout, Protocol, Quantity, SignMagnitude, bits, top
from aces_bus.protocol.exchange import print_dbc
from aces_bus.protocol.lint import check_protocol
from aces_bus.protocol.reference import Reference


@pytest.mark.parametrize(
    ("quantity", "highest", "known"),
    [
        (Quantity(Byte, unknown=top(3)), 255, 252),
        (Quantity(Int8sl, unknown=top(3)), 127, 124),
        (Quantity(Int16sl, unknown=top(2)), 0x7FFF, 0x7FFD),
        (Quantity(SignMagnitude(16), unknown=top(1)), 0x7FFF, 0x7FFE),
        (Quantity(bits(2), unknown=top(2)), 3, 1),
        (Quantity(bits(12, signed=True), unknown=top(3)), 0x7FF, 0x7FC),
        (Quantity(Int64ul, unknown=top(1)), (1 << 64) - 1, (1 << 64) - 2),
        # SAE J1939-71, table 1: FE error, FF not available, in the highest byte.
        (Quantity(Byte, unknown=top(2, bits=8)), 0xFF, 0xFD),
        (Quantity(Int16ul, unknown=top(2, bits=8)), 0xFFFF, 0xFDFF),
        (Quantity(Int32ul, unknown=top(5, bits=8)), 0xFFFF_FFFF, 0xFAFF_FFFF),
    ],
)
def test_the_highest_values_mean_unknown(quantity: Quantity, highest: int, known: int) -> None:
    """By width and sign of the number; None is sent as the highest, and no number as one of them."""
    assert quantity.to_physical(highest) is None
    assert quantity.to_physical(known + 1) is None
    assert quantity.to_physical(known) == known
    assert quantity.to_raw(None) == highest
    assert quantity.to_raw(known) == known
    with pytest.raises(FieldError, match="means unknown"):
        quantity.to_raw(known + 1)


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (lambda: Quantity(Byte, unknown=top(256)), "256 of the 256 raw values"),
        (lambda: Quantity(Byte, unknown=top(0)), "0 of the 256"),
        (lambda: Quantity(bits(2), unknown=top(1, bits=8)), "highest 8 bits of a number of 2 bits"),
        (lambda: Quantity(Float32l, unknown=top(1)), "integer of fixed width"),
        (lambda: Quantity(Byte, unknown=top(3), names={"error": 254}), "'error' .254. is one of the values"),
    ],
)
def test_what_has_no_highest_values_is_refused(make: object, text: str) -> None:
    """Floats, more values than there are, and names that could never show."""
    assert callable(make)
    with pytest.raises(SpecError, match=text):
        make()


def engine() -> Protocol:
    """A few numbers of EEC1, and bits."""
    protocol = Protocol("engine", link="can", bitrate=250_000, source="SAE J1939-71")
    protocol.message(
        "Engine",
        id=0x0CF00400,
        extended=True,
        payload=Struct(
            "torque" / Quantity(Byte, offset=-125, unit="%", unknown=top(5)),
            "speed" / Quantity(Int16ul, scale=0.125, unit="rpm", unknown=top(2, bits=8)),
            "switch" / BitLayout(1, "brake" / Quantity(bits(2), unknown=top(2)), "gear" / bits(6)),
            "distance" / Quantity(Int32ul, scale=0.125, unit="km", unknown=top(2, bits=8)),
        ),
        source="EEC1, VD",
        examples=[("0CF00400#7DC05D01A0860100", {"torque": 0, "speed": 3000.0, "distance": 12500.0})],
    )
    return protocol


EDGES = [bytes([b, low, b, b, low, low, low, b]) for b in range(248, 256) for low in (0, 255)]


def test_every_reader_has_the_same_values_unknown() -> None:
    """Live, in columns and by the reference, at the edges of every width."""
    protocol = engine()
    frames = [Frame(0x0CF00400, data, is_extended_id=True) for data in EDGES]
    live = protocol.scanner().feed(frames)
    slow = [item.fields or {} for item in Reference([protocol.variant()]).frames(frames)]
    table = decode([FrameTable.from_frames(frames)], protocol)["Engine"]
    for name, limit, number in (
        ("torque", 251, lambda data: data[0]),
        ("speed", 0xFE00, lambda data: data[1] | data[2] << 8),
        ("distance", 0xFE000000, lambda data: int.from_bytes(data[4:], "little")),
    ):
        gone = [number(data) >= limit for data in EDGES]
        assert [getattr(record, name) is None for record in live] == gone
        assert [values[name] is None for values in slow] == gone
        assert [value is None for value in table[name].to_list()] == gone
        assert True in gone
        assert False in gone
    assert [f.text for f in check_protocol(protocol) if f.level != "note"] == []


def test_cantools_names_the_same_values() -> None:
    """As a DBC the few values of a byte are named; cantools reads that name where we read None."""
    cantools = pytest.importorskip("cantools")
    protocol = engine()
    database = cantools.database.load_string(print_dbc(protocol.variant())[0], "dbc")
    scanner = protocol.scanner()
    for data in EDGES:
        (record,) = scanner.feed([Frame(0x0CF00400, data, is_extended_id=True)])
        values = database.decode_message(0x0CF00400, data)
        assert (str(values["torque"]) == "not known") == (record.torque is None)
