"""The live screen: what is counted, what is shown, what keys do."""

from __future__ import annotations

import asyncio
import io
import math
import os
import select
import subprocess
import sys
from collections.abc import Awaitable, Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
from construct import Array, Byte, Int16sl, Int32sl, Struct
from hypothesis import given
from hypothesis import strategies as st

from aces_bus.errors import CallerError
from aces_bus.frame import Frame
from aces_bus.hardware import BusEvent, Heard, Received, frame_bits
from aces_bus.hardware.frame_time import INTERMISSION
from aces_bus.hardware.gate import Counters
from aces_bus.hardware.inbox import Inbox
from aces_bus.protocol import Capture, Protocol, Quantity, make_scanner
from aces_bus.runtime import VirtualClock
from aces_tools.screen import check_screen, make_screen
from aces_tools.screen.detail import detail
from aces_tools.screen.head import Status, head, text_of
from aces_tools.screen.meter import Meter
from aces_tools.screen.model import CHANNELS, Model, Row, changed_bits
from aces_tools.screen.paint import FADE_NS, Needs, Span, bar, columns, line, styles, title
from aces_tools.screen.stream import Stream
from aces_tools.screen.values import sparkline
from aces_tools.screen.view import SORTS, View

MS = 1_000_000
S = 1_000_000_000

arm = Protocol("arm", link="can", bitrate=1_000_000, doc="An arm for tests.", source="no sheet")
Board = Capture("board", range(4))
arm.message(
    "Encoder",
    id=0x060 + Board,
    direction="from device",
    payload=Struct("position" / Array(2, Quantity(Int32sl, unit="count"))),
    doc="Positions of both motors.",
)
Command = arm.family(id=0x001, prefix=Struct("board" / Byte, "opcode" / Byte), direction="to device")
Command("Get", opcode=0x24, payload=Struct("selector" / Byte))

wire = Protocol("wire", link="serial", baud=115_200, doc="A line for tests.", source="no sheet")
packet = wire.framing(sync=b"\xaa", size=5)
packet("Sample", payload=Struct("servo" / Byte, "value" / Quantity(Int16sl, unit="mV"), "number" / Byte))


def scanner(protocol: Protocol = arm, **more: Any) -> Any:
    """A scanner as the screen needs it."""
    return make_scanner([protocol.variant()], everything=True, **more)


def model(**more: Any) -> Model:
    """A model of the arm's bus."""
    return Model(scanner(), name="can0", **{"bitrate": 1_000_000, **more})


def encoder(board: int, first: int = 0, second: int = 0, at_ms: float = 0.0, **more: Any) -> Frame:
    """An encoder's frame, stamped."""
    data = first.to_bytes(4, "little", signed=True) + second.to_bytes(4, "little", signed=True)
    options: dict[str, Any] = {"channel": "can0", **more}
    return Frame(0x060 + board, data, 1000 + at_ms / 1000, **options)


def heard(*frames: Frame, at_ms: float = 0.0) -> list[Received]:
    """Frames as a gate gives them, read at one instant."""
    return [Received(frame, round(at_ms * MS)) for frame in frames]


def periodic(made: Model, *, every_ms: float, count: int, board: int = 0, batch: int = 10) -> int:
    """Frames of one board, one after the other; when the last one came (ns)."""
    frames = [Received(encoder(board, n, at_ms=n * every_ms), round(n * every_ms * MS)) for n in range(count)]
    for start in range(0, count, batch):
        made.feed(frames[start : start + batch])
    return frames[-1].host_ns


def only(made: Model) -> Row:
    """The model's one row."""
    (row,) = made.rows.values()
    return row


def text(spans: Iterable[Span]) -> str:
    return "".join(span.text for span in spans)


# ---------------------------------------------------------------------- the model


def test_rows_are_told_apart_by_channel_identifier_and_page() -> None:
    """Two buses, two boards, and two boards behind one identifier are rows of their own; repetitions are not."""
    made = model()
    made.feed(heard(encoder(0), encoder(0, 5), encoder(1), encoder(0, channel="can1")))
    made.feed(heard(Frame(0x001, bytes([1, 0x24, 7])), Frame(0x001, bytes([2, 0x24, 7]))))
    made.feed(heard(Frame(0x7FF, b"\x01"), Frame(0x7FF, b"\x02"), Frame(0x7FF, is_extended_id=True)))
    assert sorted((r.channel, r.identifier, r.name, r.count) for r in made.rows.values()) == [
        ("can0", "000007FF", "unknown", 1),
        ("can0", "001", "Get", 1),
        ("can0", "001", "Get", 1),
        ("can0", "060", "Encoder", 2),
        ("can0", "061", "Encoder", 1),
        ("can0", "7FF", "unknown", 2),
        ("can1", "060", "Encoder", 1),
    ]
    assert (made.total, made.unknown) == (9, 3)


@pytest.mark.parametrize(("every_ms", "expected"), [(0.5, 2000.0), (10, 100.0), (250, 4.0), (3000, 1 / 3)])
def test_rate_and_period_are_those_of_the_sender(every_ms: float, expected: float) -> None:
    """What comes regularly has its rate, fast or slow, and no jitter."""
    made = model()
    now = periodic(
        made, every_ms=every_ms, count=400 if every_ms < 100 else 20, batch=10 if every_ms < 100 else 1
    )
    row = only(made)
    assert row.rate(now) == pytest.approx(expected, rel=0.03)
    assert row.period_s == pytest.approx(every_ms / 1000, rel=1e-6)
    assert row.jitter_s == pytest.approx(0, abs=1e-7)


def test_jitter_is_the_standard_deviation_of_the_period() -> None:
    """Intervals of 9 and 11 ms in turn have a period of 10 ms, and 1 ms of jitter."""
    made, at = model(), 0.0
    for number in range(300):
        made.feed(heard(encoder(0, at_ms=at), at_ms=at))
        at += 9 if number % 2 else 11
    assert only(made).period_s * 1e3 == pytest.approx(10, abs=0.05)
    assert only(made).jitter_s * 1e3 == pytest.approx(1, abs=0.05)


def test_a_rate_falls_when_nothing_comes_and_the_row_is_silent() -> None:
    """A sender that stops loses its rate within seconds, and is told to be silent."""
    made = model()
    now = periodic(made, every_ms=10, count=500)
    assert not only(made).is_silent(now + 500 * MS)
    assert only(made).is_silent(now + 3 * S)
    assert only(made).rate(now + 20 * S) < 0.01


def test_an_adapter_without_stamps_is_timed_by_the_host() -> None:
    """Stamps of zero, and none, are no stamps: the period is that of reading."""
    for stamp in (0.0, None):
        made = model()
        for number in range(50):
            made.feed(heard(Frame(0x060, bytes(8), stamp), at_ms=20 * number))
        assert only(made).period_s == pytest.approx(0.02)


def test_a_clock_that_goes_back_leaves_the_period_alone() -> None:
    """One jump back of the adapter's clock is no interval."""
    made = model()
    stamps = [0, 10, 20, -5000, -4990, -4980]
    made.feed(heard(*[encoder(0, at_ms=at) for at in stamps]))
    assert only(made).period_s == pytest.approx(0.010)


@given(st.binary(max_size=64), st.binary(max_size=64))
def test_changed_bits_are_exactly_those_that_differ(before: bytes, after: bytes) -> None:
    """Bit by bit as the definition says; bytes that come or go have changed in all their bits."""
    mask = changed_bits(before, after)
    for number in range(64):
        one, other = before[number : number + 1], after[number : number + 1]
        expected = 0 if one == other else 255 if not one or not other else one[0] ^ other[0]
        assert mask >> (8 * number) & 255 == expected
    assert mask >> 512 == 0


def test_changes_fade_step_by_step() -> None:
    """A changed bit is fresh, then recent, then fading, then like any other."""
    made = model()
    made.feed(heard(encoder(0, 0)))
    made.feed(heard(encoder(0, 0x0100), at_ms=100))
    row = only(made)
    seen = [row.ages(100 * MS + age, FADE_NS) for age in (0, FADE_NS[0], FADE_NS[1], FADE_NS[2])]
    assert seen == [[256, 0, 0], [0, 256, 0], [0, 0, 256], [0, 0, 0]]


def test_the_load_is_the_share_of_bit_times() -> None:
    """1,000 frames a second of the same length take their bits and the intermission of 1 Mbit/s."""
    made = model()
    frames = [Received(encoder(0, at_ms=n), n * MS) for n in range(5000)]
    for start in range(0, 5000, 100):
        made.feed(frames[start : start + 100])
    (channel,) = made.channels.values()
    expected = (frame_bits(frames[0].frame).total + INTERMISSION) * 1000 / 1_000_000
    load = made.load(channel, frames[-1].host_ns)
    assert load is not None
    assert load == pytest.approx(expected, rel=0.02)
    assert channel.frame_meter.per_second(frames[-1].host_ns) == pytest.approx(1000, rel=0.02)
    assert Model(None).load(channel, 0) is None


def test_bits_of_the_data_phase_count_by_their_rate() -> None:
    """With a bit rate switch, bits at 5 Mbit/s take a fifth of one at 1 Mbit/s."""
    frame = Frame(0x10, bytes(64), is_fd=True, bitrate_switch=True)
    made = model(data_bitrate=5_000_000)
    made.feed(heard(frame))
    bits = frame_bits(frame)
    assert made.channels["can0"].bits == pytest.approx(bits.nominal + bits.data / 5 + INTERMISSION)


def test_errors_unknown_and_malformed_are_counted_apart() -> None:
    """Error frames, identifiers of nobody, and wrong lengths have a row and a count each."""
    made = model()
    made.feed(heard(Frame(0x04, bytes(8), is_error_frame=True), Frame(0x7FE), Frame(0x060, b"\x01\x02")))
    assert (made.errors, made.unknown, made.malformed, made.total) == (1, 1, 1, 3)
    assert {row.name for row in made.rows.values()} == {"error frame", "unknown", "malformed"}
    assert made.channels["can0"].errors == 1


def test_without_protocols_nothing_is_unknown() -> None:
    """Where no protocol is named, frames are rows and no losses."""
    made = Model(None, name="can0")
    made.feed(heard(Frame(0x123, b"\x01"), Frame(0x123, b"\x02"), Frame(0x10, is_error_frame=True)))
    assert (made.total, made.unknown, made.errors) == (3, 0, 1)
    assert [row.name for row in made.rows.values()] == ["", "error frame"]


def test_a_scanner_that_leaves_frames_out_is_refused() -> None:
    """Frames and records have to stand side by side."""
    with pytest.raises(CallerError, match="everything"):
        Model(make_scanner([arm.variant()]))


@given(st.lists(st.tuples(st.integers(0, 40), st.integers(0, 3)), max_size=200), st.integers(4, 12))
def test_every_frame_is_counted_once_however_many_rows_there_are(
    frames: list[tuple[int, int]], limit: int
) -> None:
    """Rows and what was folded of them sum to the frames, and there are never more rows than allowed."""
    made = model(limit=limit)
    for number, (identifier, batch) in enumerate(frames):
        made.feed(heard(*[Frame(0x100 + identifier)] * batch, at_ms=number * 10))
        assert len(made.rows) <= limit
    total = sum(batch for _, batch in frames)
    assert made.total == total
    assert sum(row.count for row in made.rows.values()) + made.folded.count == total
    assert sum(channel.frames for channel in made.channels.values()) == total


def test_folding_keeps_what_repeats() -> None:
    """In a flood of identifiers that come once, those that come all the time stay."""
    made = model(limit=50)
    for number in range(400):
        flood = [Frame(0x1000 + 8 * number + n, is_extended_id=True) for n in range(8)]
        made.feed(heard(encoder(0, number), encoder(1, number), *flood, at_ms=10 * number))
    kept = {row.identifier: row.count for row in made.rows.values()}
    assert kept["060"] == kept["061"] == 400
    assert made.folded.rows > 3000


def test_channels_are_bounded() -> None:
    """However many channels frames claim to come from, only some are kept by name."""
    made = Model(None)
    made.feed(heard(*[Frame(1, channel=f"bus{n}") for n in range(200)]))
    assert len(made.channels) == CHANNELS + 1
    assert sum(one.frames for one in made.channels.values()) == 200


def test_clear_begins_anew() -> None:
    """After clearing there are no rows and no counts, and counting goes on."""
    made = model()
    periodic(made, every_ms=10, count=50)
    before = made.generation
    made.clear()
    assert (len(made.rows), made.total, len(made.channels)) == (0, 0, 0)
    assert made.generation > before
    made.feed(heard(encoder(0)))
    assert only(made).count == made.total == 1


def test_rows_of_a_line_are_messages_by_whom_they_are_about() -> None:
    """Bytes cut anywhere become rows; noise between packets has a row too, and bytes are the line's load."""
    made = Model(scanner(wire), name="tty", bitrate=115_200)
    stream = Stream(made)
    data = b"".join(bytes([0xAA, 1, n, 0, n]) for n in range(20))
    for at in range(0, len(data), 7):
        stream.feed([Heard(data[at : at + 7], at * MS)])
    stream.feed([Heard(b"\x00\x01", 200 * MS)])
    stream.idle(200 * MS + 5 * S)
    rows = {row.name: row for row in made.rows.values()}
    assert rows["Sample"].count == 20
    assert rows["skipped"].is_lost
    assert made.channels["tty"].bits == 10 * (len(data) + 2)
    assert not made.is_can


def test_bytes_without_a_protocol_are_refused() -> None:
    """There is nothing to make rows of."""
    with pytest.raises(CallerError, match="-p NAME"):
        Stream(Model(None))


def test_a_meter_reads_right_from_the_beginning() -> None:
    """Not only when it has run for long."""
    meter = Meter(2.0, 0)
    for tenth in range(1, 200):
        meter.add(tenth * 100 * MS, 10)
        assert meter.per_second(tenth * 100 * MS) == pytest.approx(100, rel=0.03)
    assert meter.per_second(60 * S) < 1e-6


# ---------------------------------------------------------------------- which rows


def filled() -> tuple[Model, int]:
    """Three boards at 100, 50 and 10 Hz, and an unknown identifier."""
    made = model()
    for tick in range(200):
        frames = [encoder(0, tick, at_ms=10 * tick)]
        if tick % 2 == 0:
            frames.append(encoder(1, 7, at_ms=10 * tick))
        if tick % 10 == 0:
            frames += [encoder(2, tick // 50, at_ms=10 * tick), Frame(0x7FF, b"\xde\xad", channel="can1")]
        made.feed(heard(*frames, at_ms=10 * tick))
    return made, 1990 * MS


def shown(view: View, now: int = 1990 * MS) -> list[str]:
    return [row.identifier for row in view.rows(now)]


@pytest.mark.parametrize(
    ("sort", "expected"),
    [
        ("id", ["060", "061", "062", "7FF"]),
        ("rate", ["060", "061", "062", "7FF"]),
        ("name", ["060", "061", "062", "7FF"]),
        ("change", ["060", "062", "061", "7FF"]),
    ],
)
def test_rows_are_sorted(sort: str, expected: list[str]) -> None:
    """By each order, and the other way round."""
    made, now = filled()
    view = View(made)
    while view.sort != sort:
        view.next_sort()
    assert shown(view, now) == expected
    view.is_reversed = True
    assert shown(view, now)[0] == expected[-1]


def test_rows_do_not_jump_more_than_once_a_second() -> None:
    """An order by rate is kept for a while, though rates change."""
    made, now = filled()
    view = View(made)
    view.next_sort()
    assert shown(view, now)[0] == "060"
    for tick in range(500):
        made.feed(heard(encoder(2, at_ms=tick), at_ms=1990 + tick))
    assert shown(view, now + 500 * MS)[0] == "060"
    assert shown(view, now + 1000 * MS)[0] == "062"


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", ["060", "061", "062", "7FF"]),
        ("enc", ["060", "061", "062"]),
        ("ENC 061", ["061"]),
        ("position", ["060", "061", "062"]),
        ("can1", ["7FF"]),
        ("060:7FE", ["060", "061"]),
        ("can1,000:000", ["7FF"]),
        ("060~7FE", ["062", "7FF"]),
        ("nothing", []),
        ("060:7FF 062:7FF", ["060", "062"]),
    ],
)
def test_filters_are_words_or_candumps(text: str, expected: list[str]) -> None:
    """Words are looked for in everything a row is called; candump's filters are candump's."""
    made, now = filled()
    view = View(made)
    view.look_for(text)
    assert shown(view, now) == expected
    assert view.problem == ""


def test_a_page_is_found_by_its_value() -> None:
    """`board=2` finds the rows about board 2 behind one identifier."""
    made = model()
    made.feed(heard(Frame(0x001, bytes([1, 0x24, 7])), Frame(0x001, bytes([2, 0x24, 7]))))
    view = View(made)
    view.look_for("board=2")
    (row,) = view.rows(0)
    assert row.data[0] == 2


@given(st.text(max_size=20))
def test_no_filter_raises(text: str) -> None:
    """Whatever is typed, half of a filter too, there is a list of rows."""
    made = model()
    made.feed(heard(encoder(0)))
    view = View(made)
    view.look_for(text)
    assert len(view.rows(0)) <= 1


def test_half_a_filter_says_what_is_wrong() -> None:
    """What looks like candump's and is not yet has a reason."""
    made, now = filled()
    view = View(made)
    view.look_for("060:7F0,zz")
    assert "zz" in view.problem
    assert len(shown(view, now)) == 4


def test_unknown_only_hides_what_is_decoded() -> None:
    """And error frames and malformed ones are not hidden."""
    made, now = filled()
    made.feed(heard(Frame(0x060, b"\x01")))
    view = View(made)
    view.unknown_only = True
    assert shown(view, now) == ["060", "7FF"]


def test_a_frozen_view_stays_as_it_was() -> None:
    """Counts, data, changes and rates of frozen rows stand still while the model goes on."""
    made, now = filled()
    view = View(made)
    view.freeze(now)
    before = [text(line(row, made, cols(made), view.instant(now))) for row in view.rows(now)]
    periodic(made, every_ms=1, count=100, board=3)
    made.feed(heard(encoder(0, -1), at_ms=4000))
    after = [text(line(row, made, cols(made), view.instant(9 * S))) for row in view.rows(9 * S)]
    assert after == before
    view.thaw()
    assert "063" in shown(view, 9 * S)


def test_sorts_go_round() -> None:
    """One key goes through all orders and comes back."""
    view = View(model())
    assert [view.next_sort() for _ in SORTS] == [*SORTS[1:], SORTS[0]]


# ---------------------------------------------------------------------- painting


def cols(made: Model, width: int = 100) -> Any:
    return columns(Needs.of(made, made.rows.values()), width)


@pytest.mark.parametrize("width", [20, 40, 59, 60, 72, 80, 100, 120, 200])
def test_lines_are_exactly_as_wide_as_asked_for(width: int) -> None:
    """Whatever the width: with long names, FD frames, losses and remote frames."""
    made, now = filled()
    made.feed(
        heard(
            Frame(0x1FFF0001, bytes(range(64)), is_fd=True, is_extended_id=True, channel="a long channel"),
            Frame(0x123, is_remote_frame=True, dlc=4),
            Frame(0x060, b"\x01"),
            Frame(0x01, bytes(8), is_error_frame=True),
        )
    )
    found = cols(made, width)
    for row in made.rows.values():
        assert len(text(line(row, made, found, now))) <= width
    assert len(text(title(found, "id", is_reversed=False))) <= width
    if width >= 60:
        assert {"id", "rate", "data", "message", "values"} <= {column.name for column in found}
    if width >= 100:
        assert {"channel", "period", "length"} <= {column.name for column in cols(filled()[0], width)}


def test_a_row_tells_what_there_is() -> None:
    """Identifier, message, rate, period and jitter, length, data, decoded values with units."""
    made = model()
    now = periodic(made, every_ms=10, count=200)
    said = text(line(only(made), made, cols(made, 120), now))
    assert " ".join(said.split()) == (
        "← can0 060 Encoder 100 10.0±0.00 8 C7 00 00 00 00 00 00 00 board=0 position=[199, 0] count"
    )


def test_only_the_digits_that_changed_are_marked() -> None:
    """The low digit of the first byte changed: that one is fresh, and no other."""
    made = model()
    made.feed(heard(encoder(0, 0x11)))
    made.feed(heard(encoder(0, 0x12), at_ms=50))
    spans = line(only(made), made, cols(made), 60 * MS)
    assert [span.text for span in spans if span.style == "fresh"] == ["2 "]
    assert not [
        s for s in line(only(made), made, cols(made), 60 * MS, is_marking=False) if s.style == "fresh"
    ]
    assert not [
        s for s in line(only(made), made, cols(made), 4 * S) if s.style in ("fresh", "recent", "fading")
    ]


def test_what_comes_over_a_wire_does_not_reach_the_terminal_as_control() -> None:
    """A channel's name with an escape sequence is spelt out."""
    made = Model(None)
    made.feed(heard(Frame(1, channel="\x1b[2J")))
    said = text(line(only(made), made, cols(made), 0))
    said += text_of(head(made, Status("\x1b[2J", title="\x07"), View(made), 1, 0, 80))
    said += text_of(detail(only(made), made, 0, 80))
    assert "\x1b" not in said
    assert "\x07" not in said


def test_without_colour_marks_are_bold_and_underlined() -> None:
    """Every style exists, none has a colour, and what is fresh is told from what is not."""
    plain = styles(has_colour=False)
    assert plain.keys() == styles().keys()
    assert all(style.color is None and style.bgcolor is None for style in plain.values())
    assert plain["fresh"].underline
    assert plain["fresh"] != plain["recent"] != plain["data"]


def test_bars_and_curves() -> None:
    """Empty, half and full; and from the least to the greatest, nothing where nothing varies."""
    assert [text(bar(share, 4)) for share in (0, 0.5, 1, 7)] == ["░░░░", "██░░", "████", "████"]
    assert sparkline([5, 5, 5]) == ""
    assert sparkline([1, 2, math.inf, math.nan, 3]) == "▁▅  █"


def test_the_head_says_what_is_wrong() -> None:
    """Losses, errors, unknown frames, the filter, frozen, the recording and the last event."""
    made, now = filled()
    made.feed(heard(Frame(0x01, is_error_frame=True)))
    made.tell(BusEvent("lost", now, "can0", "unplugged"))
    made.take_events()
    view = View(made)
    view.look_for("enc")
    view.freeze(now)
    status = Status("can0", "arm", "lost", lost=1234, bad_input=2, missed=3, recording="walk.log 5")
    said = text_of(head(made, status, view, 3, now, 200))
    for part in (
        "can0 lost", "arm", "FROZEN", "walk.log 5", "1,234 lost", "1 errors", "2 bad input", "3 missed",
        "20 unknown", "3 of 5 rows", "/enc", "lost: unplugged", "%", "frames/s", "can1",
    ):  # fmt: skip
        assert part in said, part
    assert "nothing lost" in text_of(head(model(), Status("can0"), View(model()), 0, 0, 80))


def test_details_have_every_field_its_curve_the_bits_and_the_layout() -> None:
    """Each number apart, with its unit and its place; bytes as bits; the picture where there is room."""
    made = model()
    now = periodic(made, every_ms=100, count=40, batch=1)
    said = text_of(detail(only(made), made, now, 100))
    for part in (
        "060 Encoder", "from device", "Positions of both motors.", "40 times, 10.0/s, every 100 ± 0.00 ms",
        "position.0", "39 count", "byte 0…3", "▁", "█", "27 0010 0111", "position.1 7…0",
    ):  # fmt: skip
        assert part in said, part
    narrow = detail(only(made), made, now, 50)
    assert all(len(text(one)) <= 50 for one in narrow)
    assert "┌" not in text_of(narrow)


# ---------------------------------------------------------------------- the application


@dataclass
class Gate:
    """What the screen looks at of a gate; time is virtual."""

    name: str = "can0"
    state: str = "open"
    counters: Counters = field(default_factory=Counters)
    clock: VirtualClock = field(default_factory=VirtualClock)


@dataclass
class Stage:
    """A screen in a terminal that is none, with hands to feed it."""

    app: Any
    pilot: Any
    gate: Gate
    inbox: Inbox[Received]

    async def hear(self, *frames: Frame, seconds: float = 0.1) -> None:
        """Frames come, time goes on, a picture is made."""
        self.gate.clock.advance(round(seconds * S))
        self.inbox.put([Received(frame, self.gate.clock.now()) for frame in frames])
        await self.look()

    async def look(self) -> None:
        await self.app.turn()
        await self.pilot.pause()

    async def press(self, *keys: str) -> None:
        await self.pilot.press(*keys)
        await self.look()

    @property
    def head(self) -> str:
        return str(self.app.query_one("#head").text)

    @property
    def rows(self) -> list[str]:
        return [row.identifier for row in self.app.table.rows]

    @property
    def picture(self) -> str:
        """What stands on the terminal."""
        svg: str = self.app.export_screenshot()
        return svg.replace("&#160;", " ")


Scene = Callable[[Stage], Awaitable[None]]


def play(scene: Scene, size: tuple[int, int] = (100, 24), **more: Any) -> None:
    """Run a scene on a screen of this size."""
    app_module = pytest.importorskip("aces_tools.screen.app")

    async def run() -> None:
        gate, inbox = Gate(), Inbox[Received]()
        app = app_module.LiveScreen(model(), gate, inbox, **more)
        async with app.run_test(size=size) as pilot:
            await scene(Stage(app, pilot, gate, inbox))

    pytest.importorskip("textual")
    asyncio.run(run())


async def three(stage: Stage) -> None:
    """Two boards and an unknown identifier, for two seconds."""
    for tick in range(20):
        await_frames = [encoder(n, tick * (n + 1), at_ms=100 * tick) for n in (0, 1)]
        stage.gate.clock.advance(100 * MS)
        stage.inbox.put([Received(f, stage.gate.clock.now()) for f in (*await_frames, Frame(0x7FF, b"\xde"))])
        await stage.app.hear()
    await stage.look()


@pytest.mark.parametrize("size", [(80, 24), (60, 20)])
def test_the_screen_shows_the_bus(size: tuple[int, int]) -> None:
    """Bus, rates, messages, data and values stand on terminals of any size, and the keys below."""

    async def scene(stage: Stage) -> None:
        await three(stage)
        await stage.press("down")
        picture = stage.picture
        for part in ("can0", "open", "frames/s", "Encoder", "unknown", "060", "061", "7FF", "board=", "Quit"):
            assert part in picture, part
        assert "13" in picture  # 19 as hexadecimal

    play(scene, size)


def test_keys_sort_filter_and_hide() -> None:
    """s sorts, / filters while typing, Enter keeps and Esc ends the filter, u shows the unknown only."""

    async def scene(stage: Stage) -> None:
        await three(stage)
        assert stage.rows == ["060", "061", "7FF"]
        await stage.press("S")
        assert stage.rows == ["7FF", "061", "060"]
        await stage.press("s")
        assert stage.app.view.sort == "rate"
        await stage.press("slash", *"61")
        assert stage.rows == ["061"]
        await stage.press("enter")
        assert stage.rows == ["061"]
        assert "/61" in stage.head
        await stage.press("escape")
        assert len(stage.rows) == 3
        await stage.press("u")
        assert stage.rows == ["7FF"]
        assert "unknown only" in stage.head

    play(scene)


def test_freeze_stops_the_picture_and_not_the_counting() -> None:
    """f freezes rows; frames still count; f again shows what is now."""

    async def scene(stage: Stage) -> None:
        await three(stage)
        await stage.press("f")
        await stage.hear(encoder(3))
        assert stage.rows == ["060", "061", "7FF"]
        assert "FROZEN" in stage.head
        assert stage.app.model.total == 61
        await stage.press("space")
        assert stage.rows == ["060", "061", "063", "7FF"]
        assert "FROZEN" not in stage.head

    play(scene)


def test_clear_counts_anew() -> None:
    """c forgets rows and losses; new losses are counted from there."""

    async def scene(stage: Stage) -> None:
        await three(stage)
        stage.gate.counters.dropped = 5
        await stage.look()
        assert "5 lost" in stage.head
        await stage.press("c")
        assert stage.rows == []
        assert "nothing lost" in stage.head
        stage.gate.counters.kernel_dropped = 2
        await stage.hear(encoder(0))
        assert "2 lost" in stage.head
        assert stage.rows == ["060"]

    play(scene)


def test_details_follow_the_selected_row_wherever_it_goes() -> None:
    """d opens them, the arrows choose, sorting moves the row and not the choice, Esc closes."""

    async def scene(stage: Stage) -> None:
        await three(stage)
        await stage.press("down", "down", "d")
        await stage.look()
        await stage.look()
        about = stage.app.query_one("#detail")
        assert "061 Encoder" in about.text
        assert "position.0" in about.text
        await stage.press("S")
        await stage.look()
        assert stage.app.table.selected.identifier == "061"
        await stage.press("home")
        await stage.look()
        await stage.look()
        assert "7FF" in about.text
        await stage.press("escape")
        assert not stage.app.has_class("detailed")

    play(scene, (100, 40))


def test_highlighting_can_be_switched_off() -> None:
    """h takes the marks away and brings them back."""

    async def scene(stage: Stage) -> None:
        await three(stage)
        fresh = "#ffd166"
        assert fresh in stage.picture
        await stage.press("h")
        assert fresh not in stage.picture
        await stage.press("h")
        assert fresh in stage.picture

    play(scene)


def test_without_colour_nothing_is_coloured() -> None:
    """On a terminal without colours the rows have none, and stand there all the same."""

    async def scene(stage: Stage) -> None:
        await three(stage)
        picture = stage.picture
        assert "#ffd166" not in picture
        assert "#6cc7e0" not in picture
        assert "Encoder" in picture

    play(scene, has_colour=False)


@pytest.mark.parametrize("key", ["q", "ctrl+c"])
def test_help_opens_and_closes_and_q_quits(key: str) -> None:
    """? tells the keys, Esc goes back, q and Ctrl-C end with status 0."""

    async def scene(stage: Stage) -> None:
        await three(stage)
        await stage.press("question_mark")
        assert "freeze what is shown" in stage.picture
        await stage.press("escape")
        assert "freeze what is shown" not in stage.picture
        await stage.pilot.press(key)
        assert (stage.app.return_code or 0) == 0
        assert stage.app._exit

    play(scene)


def test_resizing_keeps_rows_and_moves_the_details() -> None:
    """From wide to narrow and back: the details stand beside the table where there is room."""

    async def scene(stage: Stage) -> None:
        await three(stage)
        await stage.press("down", "d")
        for width, height, is_wide in ((170, 40, True), (60, 20, False), (100, 30, False)):
            await stage.pilot.resize_terminal(width, height)
            await stage.look()
            assert stage.app.has_class("wide") is is_wide
            assert "060" in stage.picture

    play(scene)


def test_a_long_list_scrolls_with_the_cursor() -> None:
    """The last of 300 rows is reached, and stands on the terminal."""

    async def scene(stage: Stage) -> None:
        await stage.hear(*[Frame(0x100 + n, bytes(8)) for n in range(300)])
        await stage.press("end")
        await stage.look()
        assert stage.app.table.selected.identifier == "22B"
        assert "22B" in stage.picture
        await stage.press("pageup", "up", "home")
        await stage.look()
        assert "100" in stage.picture

    play(scene)


def test_a_backlog_is_worked_off_in_pieces() -> None:
    """Ten thousand frames at once are all counted, and events that came meanwhile too."""

    async def scene(stage: Stage) -> None:
        stage.app.model.tell(BusEvent("dropped", stage.gate.clock.now(), "can0", "7 frames", 7))
        await stage.hear(*[encoder(n % 4, n) for n in range(10_000)])
        assert stage.app.model.total == 10_000
        assert "dropped: 7 frames" in stage.head

    play(scene, (160, 24))


def test_the_screen_ends_when_it_is_told_to() -> None:
    """A signal, or the end of a duration, ends it."""
    is_over = False

    async def scene(stage: Stage) -> None:
        nonlocal is_over
        await three(stage)
        assert not stage.app._exit
        is_over = True
        await stage.app.turn()
        assert stage.app._exit

    play(scene, end=lambda: is_over)


# ---------------------------------------------------------------------- how it is started


def test_without_textual_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    """The extra is named."""
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(CallerError, match=r"aces-bus\[screen\]"):
        check_screen()


def test_without_a_terminal_it_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    """A screen into a pipe is refused, before anything is opened."""
    monkeypatch.setattr("importlib.util.find_spec", lambda name: object())
    monkeypatch.setattr(sys, "__stderr__", io.StringIO())
    with pytest.raises(CallerError, match="terminal"):
        check_screen()


@pytest.mark.parametrize("kind", ["can", "serial"])
def test_a_screen_is_made_for_a_gate(kind: str) -> None:
    """A gate gives the screen its frames or bytes, its events, its bit rate; nothing is opened yet."""
    pytest.importorskip("textual")
    from aces_bus.hardware import CanGate, SerialGate

    gate: Any
    if kind == "can":
        gate, made_scanner = CanGate(lambda: None, name="bus", listen_only=True), scanner()
    else:
        gate, made_scanner = SerialGate("loop://", baud=57_600, listen_only=True), scanner(wire)
    app = make_screen(gate, made_scanner, title="arm", show=["Encoder"])
    assert app.model.bitrate == (1_000_000 if kind == "can" else 57_600)
    assert app.view.text == "Encoder"
    assert gate.state == "new"
    gate.events.tell(BusEvent("lost", 0, "bus"))
    app.model.take_events()
    assert app.model.event_counts == {"lost": 1}
    item = Heard(bytes([0xAA, 1, 2, 3, 4]), 5) if kind == "serial" else Received(encoder(0), 5)
    gate._put([item])
    asyncio.run(app.hear())
    assert only(app.model).name == ("Encoder" if kind == "can" else "Sample")


@pytest.mark.parametrize(
    ("options", "why"),
    [
        (["-i", "virtual", "-c", "x", "--format", "jsonl"], "--format is about lines"),
        (["-i", "virtual", "-c", "x", "-n", "5"], "--count is about lines"),
        (["--serial", "loop://"], "name one: -p NAME"),
        (["-i", "virtual", "-c", "x"], "needs a terminal"),
    ],
)
def test_a_wrong_call_leaves_nothing_behind(
    options: list[str], why: str, aces: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Options of lines, bytes without a protocol, no terminal: one message, status 2, and no recording begun."""
    monkeypatch.setattr("importlib.util.find_spec", lambda name: object())
    monkeypatch.setattr(sys, "__stderr__", io.StringIO())
    log = tmp_path / "x.log"
    result = aces("sniff", *options, "--screen", "--record", log)
    assert result.status == 2
    assert why in result.err
    assert not list(tmp_path.iterdir())


LOG = "".join(f"({1000 + n / 1000:.6f}) can0 060#{n:02X}000000F6FFFFFF\n" for n in range(200))


@pytest.mark.skipif(sys.platform == "win32", reason="needs a terminal as POSIX has them")
def test_a_recording_is_seen_on_a_terminal_and_recorded_again(tmp_path: Path) -> None:
    """The command on a real terminal: it shows rows, q ends it, the summary and the recording are those of the lines."""
    pytest.importorskip("textual")
    import pty
    import termios

    log, copy = tmp_path / "walk.log", tmp_path / "copy.log"
    log.write_text(LOG)
    mine, its = pty.openpty()
    termios.tcsetwinsize(mine, (24, 100))
    command = ["sniff", "-i", "aces-replay", "-c", str(log), "-p", "hubo", "--screen", "--record", str(copy)]
    with subprocess.Popen(
        [sys.executable, "-m", "aces_tools.main", *command],
        stdin=its,
        stdout=its,
        stderr=its,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), "TERM": "xterm-256color"},
    ) as process:
        os.close(its)
        seen, is_asked = b"", False
        try:
            while select.select([mine], [], [], 30)[0]:
                seen += os.read(mine, 65536)
                if not is_asked and b"Encoder" in seen and b"200 in all" in seen:
                    is_asked = os.write(mine, b"q") == 1
        except OSError:  # the other side has gone
            pass
        os.close(mine)
        said = seen.decode(errors="replace")
        assert process.wait(30) == 0, said
    assert "frames=200 decoded=200" in said
    assert "recorded 200 frames" in said
    assert [at.split()[2] for at in copy.read_text().splitlines()] == [
        at.split()[2] for at in LOG.splitlines()
    ]
