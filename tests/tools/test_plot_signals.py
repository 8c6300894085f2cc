# What is held in memory is counted.
# pyright: reportPrivateUsage=false
"""`aces plot`: which signals a pattern means, and what is kept of a long capture."""

from __future__ import annotations

import math
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from aces_bus.errors import CallerError
from aces_bus.frame_table import NO_TIME, Channels
from aces_bus.protocol.columns.table import Column, ColumnKind, MessageTable
from aces_tools.plotting.picture import value_changes
from aces_tools.plotting.select import (
    Declared,
    ImageFormat,
    PlotSignal,
    declared_signals,
    parse_format,
    parse_groups,
    parse_pattern,
    select,
)
from aces_tools.plotting.series import (
    BUCKETS,
    MOST_LINES,
    MOST_POINTS,
    Collector,
    TimeAxis,
    broken,
    longest_period,
    thin,
)
from aces_tools.protocols_arg import parse_protocols
from aces_tools.reading.window import TimeWindow

from .conftest import Aces

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def messages(arm: str) -> dict[tuple[str, str], Declared]:
    """What the protocol `arm` declares."""
    return declared_signals(parse_protocols([arm]))


# ---------------------------------------------------------------------- patterns


def _meant(text: str, messages: dict[tuple[str, str], Declared]) -> list[str]:
    wanted = select([parse_pattern(text)], messages)
    return [signal.name for one in wanted.values() for signal, _ in one.signals]


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ("Encoder.position.0", ["Encoder.position.0"]),
        ("encoder.POSITION.1", ["Encoder.position.1"]),
        ("Encoder.position", ["Encoder.position.0", "Encoder.position.1"]),
        ("Encoder", ["Encoder.position.0", "Encoder.position.1"]),
        ("Encoder.*", ["Encoder.position.0", "Encoder.position.1"]),
        ("angle", ["State.angle"]),
        ("a*e", ["State.angle"]),
        ("k?", ["Gains.kp", "Gains.ki"]),
        ("State.error", ["State.error.hot", "State.error.cold"]),
        ("*.hot", ["State.error.hot"]),
        ("Encoder.board", ["Encoder.board"]),
        ("Encoder[board=1].position.0", ["Encoder.position.0"]),
        ("position.0[board=*]", ["Encoder.position.0", "Encoder3.position.0"]),
        ("Pages[page=1].*", ["Pages.page", "Pages.low", "Pages.high", "Pages.split"]),
        ("State.load:r--", ["State.load"]),
        ("State.load::", ["State.load"]),
    ],
)
def test_a_pattern_means(text: str, names: list[str], messages: dict[tuple[str, str], Declared]) -> None:
    """Names with and without message, wildcards, whole arrays and flag sets, whatever the case."""
    assert _meant(text, messages) == names


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("Encodr", r"no signal matches 'Encodr'.*near: Encoder\.\*"),
        ("Encoder.positon", r"no signal matches 'Encoder.positon'.*near: Encoder\.position\.[01]"),
        ("speed*", r"no signal matches 'speed\*'; --list"),
        ("Name.name", "holds text or bytes"),
        ("State[foo=2].load", r"no such message has a field 'foo' \(there are: .*board.*, channel\)"),
        ("State.load:zz", "'zz' is not a format"),
        ("State.load:rr", "'rr' is not a format"),
        ("[board=1", "is not a signal"),
        ("", "is not a signal"),
        ("State[board].load", "'board' is not a condition"),
    ],
)
def test_a_wrong_pattern_is_refused_before_anything_is_read(
    text: str, said: str, aces: Aces, tmp_path: Path, arm: str
) -> None:
    """The message says what is near or how it is written; the capture need not even exist."""
    result = aces("plot", tmp_path / "absent.log", text, "-p", arm)
    assert result.status == 2
    assert re.search(said, result.err), result.err
    assert result.err.count("\n") == 1


def test_subplots_and_axes_are_separated() -> None:
    """`-` begins a subplot, `,` an axis; doubled and trailing ones mean nothing."""
    groups = parse_groups(["-", "a", "b", ",", "c", "-", "-", "d", ","])
    assert [[[p.text for p in axis] for axis in group] for group in groups] == [[["a", "b"], ["c"]], [["d"]]]


def test_formats_are_those_of_matplotlib() -> None:
    """Colour, marker, line style in any order; `|` in front draws stems."""
    assert parse_format("r--", "x") == ImageFormat("r", None, "--")
    assert parse_format("-.ok", "x") == ImageFormat("k", "o", "-.")
    assert parse_format("C2.", "x") == ImageFormat("C2", ".")
    assert parse_format("|g", "x") == ImageFormat("g", is_stem=True)


# ---------------------------------------------------------------------- what is kept

SAMPLES = st.lists(
    st.tuples(st.integers(0, 10_000), st.one_of(st.just(math.nan), st.integers(-99, 99))),
    min_size=1,
    max_size=600,
)


@given(SAMPLES, st.integers(1, 30))
def test_thinning_keeps_the_extremes(samples: list[tuple[int, float]], buckets: int) -> None:
    """What is left are samples, in order of time, the highest and lowest and the first and last among them, and few."""
    x = np.array([float(a) for a, _ in samples])
    y = np.array([float(b) for _, b in samples])
    thin_x, thin_y = thin(x, y, buckets)
    assert len(thin_x) <= max(5 * buckets, 0) or len(thin_x) == len(x) <= 5 * buckets
    assert (np.diff(thin_x) >= 0).all()
    given_samples = {(a, str(float(b))) for a, b in zip(x.tolist(), y.tolist(), strict=True)}
    kept = {(a, str(float(b))) for a, b in zip(thin_x.tolist(), thin_y.tolist(), strict=True)}
    assert kept <= given_samples
    assert (thin_x[0], thin_x[-1]) == (x.min(), x.max())
    assert np.isnan(thin_y).any() == np.isnan(y).any()
    if not np.isnan(y).all():
        assert (np.nanmin(thin_y), np.nanmax(thin_y)) == (np.nanmin(y), np.nanmax(y))


def _table(time: Any, channels: Channels | None = None, **columns: Any) -> MessageTable:
    n = len(time)
    made = {
        name: Column(ColumnKind(name), values)
        if not isinstance(values, Column)
        else Column(ColumnKind(name), values.values, values.absent)
        for name, values in columns.items()
    }
    return MessageTable(
        *("arm", "State", None, False, np.asarray(time, np.int64), np.zeros(n, np.uint16)),
        channels or Channels(["can0"]),
        *(np.zeros(n, np.uint32), np.arange(n), np.full(n, 2, np.uint8)),
        tuple(column.kind for column in made.values()),
        lambda kind: made[kind.name],
    )


def test_a_spike_in_a_long_capture_survives_in_bounded_memory(
    messages: dict[tuple[str, str], Declared],
) -> None:
    """Of two million samples few are kept, the one that stands out among them, at its time."""
    collector = Collector(select([parse_pattern("State.load")], messages), TimeAxis())
    n = 100_000
    for number in range(20):
        load = np.sin(np.arange(n) / 500)
        if number == 13:
            load[4321] = 50.0
        time = (np.arange(n) + number * n) * 1_000_000
        collector.add(_table(time, load=load, board=np.zeros(n, np.uint8)))
        assert all(series._held <= MOST_POINTS for series in collector.series.values())
    (series,) = collector.series.values()
    x, y = series.points()
    assert len(x) <= MOST_POINTS
    assert len(x) < 6 * BUCKETS + n
    assert (series.count, series.high) == (20 * n, 50.0)
    assert x[np.argmax(y)] == pytest.approx(1304.321)


def test_what_another_page_carries_is_no_gap(messages: dict[tuple[str, str], Declared]) -> None:
    """A value absent because its selector says so is left out; one that is unknown interrupts the line."""
    absent = np.array([False, True, False, True])
    for conditional, kept in ((True, [1.0, 3.0]), (False, [1.0, math.nan, 3.0, math.nan])):
        signal = PlotSignal("arm", "State", "load", "load", ColumnKind("load"), conditional=conditional)
        wanted = select([parse_pattern("State.load")], messages)
        wanted["arm", "State"] = type(wanted["arm", "State"])(((signal, ()),), ())
        collector = Collector(wanted, TimeAxis())
        load = Column(ColumnKind("load"), np.array([1.0, 2.0, 3.0, 4.0]), absent)
        collector.add(_table(range(4), load=load))
        (series,) = collector.series.values()
        assert str(series.points()[1].tolist()) == str(kept)
        assert (series.count, series.low, series.high) == (2, 1.0, 3.0)


def test_times_decide_the_axis(messages: dict[tuple[str, str], Declared]) -> None:
    """Times count from the first; messages without one are left out and counted; without any, frames are counted."""
    wanted = select([parse_pattern("State.load")], messages)
    load, board = np.arange(3.0), np.zeros(3, np.uint8)
    clock = TimeAxis()
    collector = Collector(wanted, clock, TimeWindow.parse("1000000000.5", None))
    first = 10**18
    collector.add(_table([first, NO_TIME, first + 2 * 10**9], load=load, board=board))
    (series,) = collector.series.values()
    assert series.points()[0].tolist() == [2.0]
    assert clock.timeless == 1
    collector = Collector(wanted, TimeAxis())
    collector.add(_table([NO_TIME] * 3, load=load, board=board))
    (series,) = collector.series.values()
    assert series.points()[0].tolist() == [0.0, 1.0, 2.0]


def test_too_many_devices_end_the_reading(messages: dict[tuple[str, str], Declared]) -> None:
    """As soon as there are more lines than a picture can show, the call is refused, with what would work."""
    collector = Collector(select([parse_pattern("State.load")], messages), TimeAxis())
    n = MOST_LINES + 1
    with pytest.raises(CallerError, match=r"more than 64 lines.*State\[board=0\].load"):
        collector.add(_table(range(n), load=np.zeros(n), board=np.arange(n, dtype=np.uint8)))


def test_a_gap_is_some_periods() -> None:
    """Of what comes periodically; what comes when it happens has none, and so have a few samples."""
    assert longest_period(np.arange(100) * 0.01) == pytest.approx(0.05)
    assert longest_period(np.append(np.arange(100) * 0.01, 9.0)) == pytest.approx(0.05)
    assert longest_period(np.cumsum(np.tile([0.1, 0.2, 3.0], 10))) == math.inf
    assert longest_period(np.arange(4) * 0.01) == math.inf


@pytest.mark.slow
def test_no_signals_are_named(aces: Aces, tmp_path: Path) -> None:
    """Of many signals the most telling are drawn, by unit; it is said how many, and never an error."""
    capture = ROOT / "examples" / "captures" / "hubo2plus.log"
    result = aces("plot", capture, "-p", "hubo@hubo2plus", "-o", tmp_path / "all.svg")
    assert result.status == 0
    assert re.search(r"drawn: \d+ of \d+ signals; --list shows all", result.err)
    text = (tmp_path / "all.svg").read_text()
    assert "Encoder" in text
    assert "Current" in text
    assert "driver_on" not in text
    piped = subprocess.run(
        [
            sys.executable,
            "-m",
            "aces_tools",
            "plot",
            "-",
            "-p",
            "hubo@hubo2plus",
            "-o",
            str(tmp_path / "pipe.svg"),
        ],
        stdin=capture.open("rb"),
        capture_output=True,
        check=False,
        cwd=ROOT,
    )
    assert (piped.returncode, b"some are left out" in piped.stderr) == (0, True)


def test_lines_are_broken_where_nothing_came() -> None:
    """A pause longer than the break time is a gap."""
    x, y = broken(np.array([0.0, 1.0, 9.0]), np.array([1.0, 2.0, 3.0]), 5.0)
    assert x.tolist() == [0.0, 1.0, 1.0, 9.0]
    assert str(y.tolist()) == "[1.0, 2.0, nan, 3.0]"


@given(st.lists(st.sampled_from([0.0, 1.0, math.nan]), min_size=1, max_size=40))
def test_steps_lose_nothing_by_leaving_out_repetitions(values: list[float]) -> None:
    """What holds at any sample's time is the same with and without the samples that repeat their neighbours."""
    x, y = np.arange(float(len(values))), np.array(values)
    kept_x, kept_y = value_changes(x, y)
    held = kept_y[np.searchsorted(kept_x, x, side="right") - 1]
    assert str(held.tolist()) == str(y.tolist())
