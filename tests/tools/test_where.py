"""`--where`: which records fulfil a condition."""

from __future__ import annotations

from typing import Any

import pytest
from construct import Array, Byte, Bytes, Float32l, GreedyRange, Int16sl, Struct

from aces_bus import Frame, FrameTable, make_column_scanner
from aces_bus.errors import CallerError, UnknownNameError
from aces_bus.protocol import BitLayout, Enumeration, Flags, Multiplexed, Protocol, Quantity, Text, bits
from aces_tools.output.shape import plans_of
from aces_tools.reading.where import Where, WhereColumns

spec = Protocol("where_spec", link="can")
spec.message(
    "State",
    id=0x10,
    payload=Struct(
        "mode" / Enumeration(Byte, off=0, torque=2),
        "error" / Flags(Byte, hot=0, cold=3),
        "angle" / Quantity(Int16sl, scale=0.1, unknown=(0x7FFF,)),
        "load" / Float32l,
    ),
)
spec.message(
    "Points", id=0x11, payload=Struct("points" / Array(2, Struct("x" / Byte, "y" / Byte)), "tag" / Bytes(2))
)
spec.message("List", id=0x12, payload=Struct("servos" / GreedyRange(Struct("id" / Byte, "goal" / Byte))))
spec.message("Name", id=0x13, payload=Struct("name" / Text(8)))
spec.message(
    "Page", id=0x14, payload=BitLayout(2, "page" / bits(1), "low" / Multiplexed("page", 0, bits(8, at=8)))
)


def one(identifier: int, data: bytes, time: float | None = None) -> Any:
    (record,) = spec.scanner().feed([Frame(identifier, data, time, "can0")])
    return record


STATE = one(0x10, bytes.fromhex("0289 7B00 0000803F"), 12.5)  # torque, {hot, cold, 0x80}, 12.3, 1.0
POINTS = one(0x11, bytes([1, 2, 3, 4, 0x0A, 0xFF]))
LIST = one(0x12, bytes([7, 70, 8, 80]))
NAME = one(0x13, b"neck\0\0\0\0")
PAGE_0, PAGE_1 = one(0x14, b"\x00\x05"), one(0x14, b"\x01\x05")
NOT_KNOWN = one(0x10, bytes.fromhex("0500 FF7F 0000C07F"))  # 5, {}, not known, NaN


#: Of the very types that these records have.
PLANS = plans_of([spec.variant()])


def holds(record: Any, *conditions: str) -> bool:
    return Where(conditions, PLANS).holds(record)


@pytest.mark.parametrize(
    ("record", "condition", "wanted"),
    [
        (STATE, "mode=torque", True),
        (STATE, "mode=2", True),
        (STATE, "mode=0x2", True),
        (STATE, "mode=off", False),
        (STATE, "mode!=off", True),
        (NOT_KNOWN, "mode=5", True),
        (NOT_KNOWN, "mode!=torque", True),
        (STATE, "error=hot", True),
        (STATE, "error!=hot", False),
        (STATE, "error=0x89", True),
        (STATE, "error=1", False),
        (STATE, "error>0", True),
        (STATE, "angle=12.3", True),
        (STATE, "angle==12.3", True),
        (STATE, " angle = 12.3 ", True),
        (STATE, "angle!=12.3", False),
        (STATE, "angle>12", True),
        (STATE, "angle>=12.4", False),
        (STATE, "angle<1.3e1", True),
        (STATE, "angle<=-1", False),
        (STATE, "load=1", True),
        (NOT_KNOWN, "angle=none", True),
        (NOT_KNOWN, "angle=", True),
        (NOT_KNOWN, "angle!=3", True),
        (NOT_KNOWN, "angle<100", False),
        (STATE, "angle=none", False),
        (NOT_KNOWN, "load=nan", True),
        (NOT_KNOWN, "load<1", False),
        (STATE, "load=nan", False),
        (POINTS, "points.x=3", True),
        (POINTS, "points.x=2", False),
        (POINTS, "points.0.x=3", False),
        (POINTS, "points.1.y=4", True),
        (POINTS, "points.x!=3", False),
        (POINTS, "points.x!=9", True),
        (POINTS, "points.y>3", True),
        (POINTS, "tag=0aff", True),
        (POINTS, "tag=0A FF", True),
        (POINTS, "tag=0x0aff", True),
        (POINTS, "tag!=0aff", False),
        (LIST, "servos.id=8", True),
        (LIST, "servos.id=9", False),
        (LIST, "servos.0.goal=70", True),
        (LIST, "servos.5.goal=70", False),
        (LIST, "servos.5.goal!=70", False),
        (NAME, "name=neck", True),
        (NAME, "name!=neck", False),
        (PAGE_0, "low=5", True),
        (PAGE_1, "low=5", False),
        (PAGE_1, "low=none", True),
        (STATE, "meta.time>12", True),
        (STATE, "meta.channel=can0", True),
        (STATE, "meta.identifier=0x10", True),
        (NAME, "meta.time=none", True),
        (STATE, "meta.direction=to", False),
        (NAME, "angle!=3", False),
        (NAME, "angle=none", False),
        (STATE, "mode=off,torque", True),
        (STATE, "mode=0,1", False),
        (STATE, "mode!=0,1", True),
        (STATE, "mode!=0,torque", False),
        (STATE, "angle=-3..12.3", True),
        (STATE, "angle=12.4..20,12..12.2", False),
        (STATE, "angle!=13..20", True),
        (POINTS, "points.y=3..4", True),
        (POINTS, "points.x=2..2.5", False),
        (NAME, "angle=0..9", False),
        (NAME, "angle=0..9 or name=neck", True),
        (NAME, "name=neck or angle=0..9", True),
        (STATE, "mode=off or mode=torque and angle>12", True),
        (STATE, "mode=off or mode=torque and angle>13", False),
        (STATE, "mode=torque and name=neck", False),
        (STATE, "meta.time=12..13", True),
        (NAME, 'name="neck"', True),
        (NAME, "name='neck or head, left'", False),
    ],
)
def test_conditions(record: Any, condition: str, wanted: bool) -> None:
    """Names, flags, units, items of several, absent values: each as the help says."""
    assert holds(record, condition) is wanted


def test_all_conditions_must_hold() -> None:
    """Several conditions are joined by `and`; a record that lacks one field is refused."""
    assert holds(STATE, "mode=torque", "angle>0")
    assert not holds(STATE, "mode=torque", "angle<0")
    assert not holds(STATE, "mode=torque", "name=neck")


@pytest.mark.parametrize(
    "text", ["", "=3", "a", "a~3", "3=a", "a..b=1", "a.=1", ".a=1", "a=1 or", "a=1 or 2", "a=3..1", "a>1..3"]
)
def test_what_is_no_condition(text: str) -> None:
    """Is refused with how one is written."""
    with pytest.raises(CallerError, match="--where"):
        Where([text], PLANS)


@pytest.mark.parametrize(
    "text",
    [
        "nosuch=1",
        "points.z=1",
        "points.2.x=1",
        "mode.x=1",
        "mode=troque",
        "error=warm",
        "meta.raw=00",
        "meta=1",
        "meta.time.x=1",
    ],
)
def test_a_name_that_cannot_hold(text: str) -> None:
    """A field, name or flag that does not exist is said before anything is read, with those that do."""
    with pytest.raises(UnknownNameError, match="there are:"):
        holds(STATE, text)


@pytest.mark.parametrize("text", ["mode<off", "angle>x", "angle=x", "tag=xyz", "tag=123"])
def test_a_value_that_cannot_hold(text: str) -> None:
    """So is a value of the wrong kind."""
    with pytest.raises(CallerError, match="--where"):
        holds(STATE, text)


@pytest.mark.parametrize(
    ("condition", "wanted"),
    [
        ("angle=0.3", True),
        ("angle<=0.3", True),
        ("angle>=0.3", True),
        ("angle<0.3", False),
        ("angle>0.3", False),
        ("angle!=0.3", False),
        ("angle=0.3..1", True),
        ("angle=-1..0.3", True),
        ("angle<=0.29999", False),
        ("angle>0.29999", True),
        ("meta.time=1500000000.25", True),
        ("meta.time<=1500000000.25", True),
        ("meta.time<1500000000.25", False),
        ("meta.time=1500000000.24", False),
        ("meta.time>1500000000.24", True),
        ("meta.time=1500000000.25..1500000001", True),
    ],
)
def test_a_printed_number_is_equal_for_every_sign(condition: str, wanted: bool) -> None:
    """A value that prints as the written number is at it, neither above nor below: of a record, and in columns."""
    frame = Frame(0x10, bytes.fromhex("0289 0300 0000803F"), 1_500_000_000.25, "can0")
    (record,) = spec.scanner().feed([frame])
    assert record.angle == 0.1 * 3 != 0.3
    assert holds(record, condition) is wanted
    (table,) = make_column_scanner([spec.variant()]).feed(FrameTable.from_frames([frame]))
    assert WhereColumns([condition], PLANS).holds(table).tolist() == [wanted]
