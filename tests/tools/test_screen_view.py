"""Which rows the live screen shows, in which order, and how they are painted."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from aces_bus import Frame
from aces_bus.hardware.gate_events import BusEvent
from aces_tools.screen.head import Status, detail, head, plain_text
from aces_tools.screen.model import Model
from aces_tools.screen.paint import bar, line, styles, title
from aces_tools.screen.values import sparkline
from aces_tools.screen.view import SORTS, View
from tests.tools.screening import (
    MS,
    S,
    cols,
    encoder,
    filled,
    heard,
    model,
    only,
    periodic,
    text,
)


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
    before = [line(row, made, cols(made), view.instant(now)) for row in view.rows(now)]
    periodic(made, every_ms=1, count=100, board=3)
    made.feed(heard(encoder(0, -1), at_ms=4000))
    after = [line(row, made, cols(made), view.instant(9 * S)) for row in view.rows(9 * S)]
    assert after == before
    view.thaw()
    assert "063" in shown(view, 9 * S)


def test_sorts_go_round() -> None:
    """One key goes through all orders and comes back."""
    view = View(model())
    assert [view.next_sort() for _ in SORTS] == [*SORTS[1:], SORTS[0]]


# ---------------------------------------------------------------------- painting


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


@pytest.mark.parametrize(
    ("now", "digits"), [(0x1112, ["2 "]), (0x1121, ["2"]), (0x1211, ["2 "]), (0x2112, ["2 2"])]
)
def test_only_the_digits_that_changed_are_marked(now: int, digits: list[str]) -> None:
    """Of 11 11 one digit, or two, become a 2: they are fresh and no other; not without marks, and not later."""
    made = model()
    made.feed(heard(encoder(0, 0x1111)))
    made.feed(heard(encoder(0, now), at_ms=50))
    row, found = only(made), cols(made)
    assert [span.text for span in line(row, made, found, 60 * MS) if span.style == "fresh"] == digits
    faded = {"fresh", "recent", "fading"}
    assert not faded & {span.style for span in line(row, made, found, 60 * MS, is_marking=False)}
    assert not faded & {span.style for span in line(row, made, found, 4 * S)}


def test_what_comes_over_a_wire_does_not_reach_the_terminal_as_control() -> None:
    """A channel's name with an escape sequence is spelt out."""
    made = Model(None)
    made.feed(heard(Frame(1, channel="\x1b[2J")))
    said = text(line(only(made), made, cols(made), 0))
    said += plain_text(head(made, Status("\x1b[2J", title="\x07"), View(made), 1, 0, 80))
    said += plain_text(detail(only(made), made, 0, 80))
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
    made.emit(BusEvent("lost", now, "can0", "unplugged"))
    made.take_events()
    view = View(made)
    view.look_for("enc")
    view.freeze(now)
    status = Status("can0", "arm", "lost", lost=1234, bad_input=2, missed=3, recording="walk.log 5")
    said = plain_text(head(made, status, view, 3, now, 200))
    for part in (
        "can0 lost", "arm", "FROZEN", "walk.log 5", "1,234 lost", "1 errors", "2 bad input", "3 missed",
        "20 unknown", "3 of 5 rows", "/enc", "lost: unplugged", "%", "frames/s", "can1",
    ):  # fmt: skip
        assert part in said, part
    assert "nothing lost" in plain_text(head(model(), Status("can0"), View(model()), 0, 0, 80))


def test_details_have_every_field_its_curve_the_bits_and_the_layout() -> None:
    """Each number apart, with its unit and its place; bytes as bits; the picture where there is room."""
    made = model()
    now = periodic(made, every_ms=100, count=40, batch=1)
    said = plain_text(detail(only(made), made, now, 100))
    for part in (
        "060 Encoder", "from device", "Positions of both motors.", "40 times, 10.0/s, every 100 ± 0.00 ms",
        "position.0", "39 count", "byte 0…3", "▁", "█", "27 0010 0111", "position.1 7…0",
    ):  # fmt: skip
        assert part in said, part
    narrow = detail(only(made), made, now, 50)
    assert all(len(text(one)) <= 50 for one in narrow)
    assert "┌" not in plain_text(narrow)
