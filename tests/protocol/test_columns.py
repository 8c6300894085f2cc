"""Columns are what the live scanner gives: on every wire, in long pieces and short; and the check that says so can fail.

`tests/laws` holds law 2, columns included, on many small scenes of every wire. Here stand scenes of some hundred frames or
packets, which is where tables are filled in one go, and what small scenes hardly ever have.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from construct import Byte, Float32l, Int16sl, Int16ul, Struct, this
from hypothesis import settings

from aces_bus import Frame, FrameTable, make_column_scanner
from aces_bus.protocol import (
    BitLayout,
    Counter,
    Enumeration,
    Flags,
    IdField,
    InvertedSum,
    Multiplexed,
    Protocol,
    Quantity,
    bits,
)
from aces_bus.protocol.columns.scanner import ColumnScanner
from aces_bus.protocol.columns.table import Column, MessageTable
from aces_bus.testing import LAWS, Scene, columns, laws
from tests.laws.drawn import columns_agree, drawn_arguments
from tests.laws.wires import CASES, MIXED, Case

#: Bytes of a scene, or sixteenths of a frame.
SIZE = 1200
#: Cases of a protocol that get a long scene: its first, and some of its other dialects, configurations, directions.
LONG_CASES = 3 if settings().max_examples > 100 else 1


def _some(cases: Sequence[Case]) -> list[Case]:
    """Every n-th case of a protocol that has many."""
    seen: dict[str, int] = {}
    chosen: list[Case] = []
    for case in cases:
        name = laws.wire_variants(case.wire)[0].name
        number = seen[name] = seen.get(name, -1) + 1
        if number % max(1, -(-case.share // LONG_CASES)) == 0:
            chosen.append(case)
    return chosen


@pytest.mark.parametrize("case", [*_some(CASES), *MIXED], ids=str)
def test_long_scenes_are_the_same_in_columns(case: Case) -> None:
    """Some hundred frames or packets, cut somewhere, give the same values in columns as one by one."""
    scene, cuts = drawn_arguments(LAWS[1], case.wire, case.direction, 11, entropy=1 << 14, size=SIZE)
    columns_agree(case.wire, case.direction, scene, cuts[::16])


# ---------------------------------------------------------------------- what scenes seldom have


def a_bus() -> Protocol:
    """Requests with their answers, a counter, pages, names, flags, values that are unknown."""
    made = Protocol("victim", link="can")
    node = IdField("node", range(8))
    made.message(
        "Layout",
        id=0x10 + node,
        payload=BitLayout(
            3,
            "page" / bits(2),
            "low" / Multiplexed("page", 0, Quantity(bits(10, at=8), scale=0.5)),
            "high" / Multiplexed("page", 1, bits(6, at=8)),
        ),
    )
    made.message("Count", id=0x20 + node, payload=Struct("alive" / Counter(Byte, modulo=16), "x" / Int16sl))
    made.message(
        "State",
        id=0x30 + node,
        payload=Struct(
            "mode" / Enumeration(Byte, off=0, on=2),
            "error" / Flags(Byte, hot=0, cold=7),
            "angle" / Quantity(Int16sl, scale=0.1, unknown=[-1]),
            "load" / Float32l,
        ),
    )
    ask = made.message("Ask", id=0x40 + node, direction="to device", payload=Struct("which" / Byte))
    for which, field in ((1, Int16ul), (2, Int16sl)):
        made.message(
            f"Answer{which}",
            id=0x50 + node,
            direction="from device",
            reply_to=ask.where(which=which),
            payload=Struct("value" / field),
        )
    return made


def a_stream() -> Protocol:
    """Packets with a sum."""
    made = Protocol("victim", link="serial")
    packet = made.framing(
        sync=b"\xff\xff",
        header=Struct("id" / Byte, "length" / Byte),
        size=this.length + 4,
        max_size=60,
        check=InvertedSum(),
    )
    packet("Move", payload=Struct("kind" / Byte, "speed" / Quantity(Int16sl, scale=0.5)))
    return made


def _frames() -> list[Frame]:
    frames: list[Frame] = []
    for i in range(120):
        node, channel = i % 3, ("can0", "can1", None)[i // 7 % 3]
        data = [
            bytes([i % 4, i, 1]),
            bytes([(i // 4 + (i > 60)) % 16, i, 0]),
            struct.pack("<BBhf", i % 4, i, -1 if i % 3 == 0 else i, float("nan") if i % 7 == 0 else i / 3),
            bytes([1 + i // 8 % 2]),
            bytes([i, 255 - i]),
        ]
        identifiers = (0x10, 0x20, 0x30, 0x40, 0x50)
        place = i % 5 if i % 11 else (i + 1) % 5
        frames.append(
            Frame(identifiers[place] + node, data[place], i / 1000, channel, is_rx=(None, True, False)[i % 3])
        )
    return frames


def _packets() -> bytes:
    out = bytearray()
    for i in range(60):
        body = struct.pack("<BBBh", i % 4, 4, i % 3, i * 100 - 3000)
        check = ~sum(body) & 0xFF
        out += b"\xff\xff" + body + bytes([check if i % 9 else check ^ 1]) + b"\x00" * (i % 13 == 0)
    return bytes(out)


SCENES: dict[str, tuple[Callable[[], Protocol], Scene]] = {
    "bus": (a_bus, Scene(tuple(_frames()))),
    "stream": (a_stream, Scene(_packets())),
}


@pytest.mark.parametrize("step", [1, 2, 7, 50, 10_000])
@pytest.mark.parametrize("name", SCENES)
def test_requests_counters_and_pages_carry_on(name: str, step: int) -> None:
    """However a capture is cut, requests find their answers and counters what is missing, in columns as one by one."""
    make, scene = SCENES[name]
    cuts = tuple(range(step, len(scene), step))
    columns_agree(make().variant(), None, scene, cuts)
    counts = laws.scanner_of(make().variant(), None).counts
    assert counts.total == 0  # a scanner of its own, as if just made


def test_the_scenes_hold_what_they_are_for() -> None:
    """Answers of both kinds and unanswered ones, counters that jump, absent and unknown values, losses."""
    scanner = a_bus().scanner(include_unknown=True)
    items = scanner.feed(SCENES["bus"][1].traffic)
    names = {type(item).__name__ for item in items}
    assert names >= {"Layout", "Count", "State", "Ask", "Answer1", "Answer2", "Unknown"}
    assert scanner.counts.missed > 0
    states = [item for item in items if type(item).__name__ == "State"]
    assert {None} < {state.angle for state in states}
    assert {"off", "on"} <= {state.mode for state in states}
    stream = a_stream().scanner(include_unknown=True)
    stream.feed(SCENES["stream"][1].traffic)
    assert stream.counts.records > 40
    assert stream.counts.malformed
    assert stream.counts.skipped


def test_values_are_read_from_any_cut_of_a_table() -> None:
    """A table that is a slice, or picked frame by frame, decodes like one made of these frames alone."""
    variant = a_bus().variant()
    whole = FrameTable.from_frames(_frames())
    for rows in (slice(10, 90), slice(0, None, 3), np.arange(119, -1, -1), np.arange(120) % 2 == 0):
        part = whole.take(rows)
        alone = FrameTable.from_frames(part.frames())
        one, other = (make_column_scanner([variant]).feed(table) for table in (part, alone))
        assert [table.message for table in one] == [table.message for table in other]
        for a, b in zip(one, other, strict=True):
            assert a.row.tolist() == b.row.tolist()
            for column, expected in zip(a.columns(), b.columns(), strict=True):
                assert str(column.to_list()) == str(expected.to_list())


# ---------------------------------------------------------------------- the check finds what is wrong

Spoil = Callable[[MessageTable], MessageTable]


def _column(table: MessageTable, change: Callable[[Column], Column], name: str = "") -> MessageTable:
    """The table with one column changed: the named one, or the last that has numbers."""
    chosen = name or next(
        (kind.name for kind in reversed(table.kinds) if table[kind.name].values.dtype != object), ""
    )
    return replace(
        table,
        make=lambda kind: change(table[kind.name]) if kind.name == chosen else table[kind.name],
        _made={},
    )


def a_value_is_off(table: MessageTable) -> MessageTable:
    def change(column: Column) -> Column:
        values = column.values.copy()
        values[-1] += 1
        return replace(column, values=values)

    return _column(table, change)


def a_type_is_wide(table: MessageTable) -> MessageTable:
    return _column(table, lambda column: replace(column, values=column.values.astype(np.complex128)))


def absence_is_forgotten(table: MessageTable) -> MessageTable:
    return _column(table, lambda column: replace(column, absent=None), "low" if "low" in table else "")


def absence_is_invented(table: MessageTable) -> MessageTable:
    return _column(table, lambda column: replace(column, absent=np.ones(len(column), bool)))


def a_column_is_short(table: MessageTable) -> MessageTable:
    return _column(table, lambda column: replace(column, values=column.values[1:], absent=None))


def a_zero_is_negative(table: MessageTable) -> MessageTable:
    return _column(
        table,
        lambda column: replace(column, values=-column.values) if column.values.dtype.kind == "f" else column,
    )


def rows_are_one_off(table: MessageTable) -> MessageTable:
    return replace(table, row=table.row + 1)


def rows_are_turned(table: MessageTable) -> MessageTable:
    return replace(table, row=table.row[::-1])


def a_nanosecond_is_lost(table: MessageTable) -> MessageTable:
    return replace(table, time=table.time - 1)


def keys_are_others(table: MessageTable) -> MessageTable:
    return replace(table, key=table.key ^ 1)


def everything_was_received(table: MessageTable) -> MessageTable:
    return replace(table, rx=np.ones(len(table), np.uint8))


def channels_are_mixed_up(table: MessageTable) -> MessageTable:
    return replace(table, channel=table.channel * 0)


def a_message_is_overlooked(table: MessageTable) -> MessageTable:
    keep = np.arange(len(table)) > 0
    return replace(
        table,
        **{n: getattr(table, n)[keep] for n in ("time", "channel", "key", "row", "rx")},
        size=None if table.size is None else table.size[keep],
        make=lambda kind: replace(
            table[kind.name],
            values=table[kind.name].values[keep],
            absent=None if (gone := table[kind.name].absent) is None else gone[keep],
        ),
        _made={},
    )


def directions_are_lost(table: MessageTable) -> MessageTable:
    return replace(table, direction="both")


def reasons_are_others(table: MessageTable) -> MessageTable:
    if table.message:
        return table
    return _column(table, lambda column: replace(column, values=column.values + "!"), "reason")


def lost_bytes_are_others(table: MessageTable) -> MessageTable:
    if table.message:
        return table
    return _column(table, lambda column: replace(column, values=column.values + b"!"), "raw")


class Spoilt:
    """A column scanner that goes wrong in one way."""

    def __init__(self, good: ColumnScanner, spoil: Spoil) -> None:
        self.good, self.spoil = good, spoil
        self.link = good.link

    @property
    def counts(self) -> Any:
        return self.good.counts

    def feed(self, traffic: Any) -> list[MessageTable]:
        return self.spoilt(self.good.feed(traffic))

    def close(self) -> list[MessageTable]:
        return self.spoilt(self.good.close())

    def spoilt(self, tables: Sequence[MessageTable]) -> list[MessageTable]:
        return [self.spoil(table) for table in tables]


class Miscounting(Spoilt):
    """Counts one too many."""

    @property
    def counts(self) -> Any:
        return replace(self.good.counts, records=self.good.counts.records + 1)


class Repeating(Spoilt):
    """Gives each table twice."""

    def spoilt(self, tables: Sequence[MessageTable]) -> list[MessageTable]:
        return [table for table in tables for _ in range(2)]


class Forgetful(Spoilt):
    """Gives the tables of losses to nobody."""

    def spoilt(self, tables: Sequence[MessageTable]) -> list[MessageTable]:
        return [table for table in tables if table.message]


class Talkative(Spoilt):
    """Gives losses that nobody asked for."""

    def spoilt(self, tables: Sequence[MessageTable]) -> list[MessageTable]:
        return [*tables, *(replace(table, message="") for table in tables[:1] if table.message)]


def _same(table: MessageTable) -> MessageTable:
    return table


FAULTS: Sequence[tuple[str, type[Spoilt], Spoil]] = [
    *(
        (name, Spoilt, spoil)
        for name in SCENES
        for spoil in (
            a_value_is_off,
            a_type_is_wide,
            absence_is_invented,
            a_column_is_short,
            rows_are_one_off,
            rows_are_turned,
            a_nanosecond_is_lost,
            keys_are_others,
            everything_was_received,
            a_message_is_overlooked,
            directions_are_lost,
            reasons_are_others,
            lost_bytes_are_others,
        )
    ),
    ("bus", Spoilt, absence_is_forgotten),
    ("bus", Spoilt, channels_are_mixed_up),
    ("stream", Spoilt, a_zero_is_negative),
    *((name, kind, _same) for name in SCENES for kind in (Miscounting, Repeating, Forgetful, Talkative)),
]


@pytest.mark.parametrize(("name", "kind", "spoil"), FAULTS, ids=lambda v: getattr(v, "__name__", str(v)))
def test_a_fault_in_columns_is_found(
    name: str, kind: type[Spoilt], spoil: Spoil, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever a column scanner gets wrong, the law says so."""

    def make(*arguments: Any, **options: Any) -> Spoilt:
        return kind(make_column_scanner(*arguments, **options), spoil)

    protocol, scene = SCENES[name]
    monkeypatch.setattr(columns, "make_column_scanner", make)
    with pytest.raises(AssertionError, match=r"law 2 \(oracle\) of victim, direction None: columns"):
        columns_agree(protocol().variant(), None, scene, (20, 70))
