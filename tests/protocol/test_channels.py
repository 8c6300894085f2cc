"""The same identifier on two buses: protocols bound to channels."""

from __future__ import annotations

from typing import Any

import pytest
from construct import Byte, Int16ul, Struct

from aces_bus import Frame, FrameTable, as_dict, make_column_scanner, make_scanner
from aces_bus.errors import CallerError
from aces_bus.protocol import IdField, Protocol, Variant


@pytest.fixture(scope="module")
def buses() -> list[Variant]:
    """An engine bus on can0, a body bus on can1, and one protocol everywhere; all use identifier 0x100."""
    engine = Protocol("engine", link="can")
    engine.message("Speed", id=0x100, payload=Struct("rpm" / Int16ul))
    body = Protocol("body", link="can")
    body.message("Doors", id=0x100, payload=Struct("left" / Byte, "right" / Byte))
    asked = body.message("Ask", id=0x200 + IdField("unit", range(4)), payload=Struct("what" / Byte))
    for value in (1, 2):
        body.message(
            f"Answer{value}",
            id=0x210 + IdField("unit", range(4)),
            payload=Struct(f"answer{value}" / Byte),
            reply_to=asked.where(what=value),
        )
    common = Protocol("common", link="can")
    common.message("Beat", id=0x7FF, payload=Struct("count" / Byte))
    return [engine.variant().on("can0"), body.variant().on("can1"), common.variant()]


FRAMES = [
    Frame(0x100, b"\x01\x02", 1.0, "can0"),
    Frame(0x100, b"\x01\x02", 1.1, "can1"),
    Frame(0x100, b"\x01\x02", 1.2, "can2"),
    Frame(0x7FF, b"\x07", 1.3, "can2"),
    Frame(0x201, b"\x02", 1.4, "can1"),
    Frame(0x201, b"\x01", 1.5, "can0"),
    Frame(0x211, b"\x09", 1.6, "can1"),
    Frame(0x7FF, b"\x08", 1.7, "can0"),
]


def test_each_channel_has_its_own_protocols(buses: list[Variant]) -> None:
    """One identifier is a speed on one bus, doors on another and unknown on a third."""
    scanner = make_scanner(buses, include_unknown=True)
    given = [type(item).__name__ for item in scanner.feed(FRAMES)]
    assert given == ["Speed", "Doors", "Unknown", "Beat", "Ask", "Unknown", "Answer2", "Beat"]
    assert (scanner.counts.total, scanner.counts.decoded, scanner.counts.unknown) == (8, 6, 2)


@pytest.mark.parametrize("cut", range(len(FRAMES) + 1))
def test_columns_say_the_same(buses: list[Variant], cut: int) -> None:
    """Whole tables give what single frames give, in the same order, wherever the capture is cut."""
    whole = FrameTable.from_frames(FRAMES)
    scanner = make_column_scanner(buses, include_unknown=True)
    tables = scanner.feed(whole.take(slice(0, cut))) + scanner.feed(whole.take(slice(cut, None)))
    found: dict[int, Any] = {}
    for table in tables:
        columns = {column.name: column.to_list() for column in table.columns()}
        for line, row in enumerate(table.row.tolist()):
            found[row] = (table.message, {name: values[line] for name, values in columns.items()})
    live = make_scanner(buses, include_unknown=True).feed(FRAMES)
    for row, item in enumerate(live):
        if type(item).__name__ == "Unknown":
            assert found[row] == ("", {"reason": item.reason, "raw": item.meta.raw})
        else:
            assert found[row] == (type(item).__name__, as_dict(item))
    assert scanner.counts == make_counts(buses)


def make_counts(buses: list[Variant]) -> Any:
    """What the live scanner counts."""
    scanner = make_scanner(buses)
    scanner.feed(FRAMES)
    return scanner.counts


def test_a_bound_protocol_is_for_can() -> None:
    """A serial protocol has no channel to be bound to, and says so."""
    line = Protocol("line", link="serial")
    with pytest.raises(CallerError, match="only protocols on CAN"):
        line.variant().on("can0")
