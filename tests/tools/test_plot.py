"""`aces plot`: what the pictures show, in the terminal and in files."""

from __future__ import annotations

import io
import math
import re
import struct
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from aces_bus.protocol.columns.table import ColumnKind
from aces_tools import plot
from aces_tools.main import main
from aces_tools.plotting import terminal
from aces_tools.plotting.picture import Picture, PlotLine, PlotPanel, panels_of
from aces_tools.plotting.select import ImageFormat, PlotSignal, parse_format
from aces_tools.plotting.series import Series, TimeAxis
from tests.limits import small_disk

from .conftest import Aces


@pytest.fixture
def walk(tmp_path: Path) -> Path:
    """Two boards, every frame 10 ms apart: a ramp and its opposite, a mode that changes, an error that comes and goes."""
    lines: list[str] = []
    for i in range(200):
        time = 1436509052 + i / 100
        for board in (0, 1):
            data = struct.pack("<ii", i * (1 - 2 * board), 1000 if i == 77 else 0)
            lines.append(f"({time:.6f}) can0 {0x60 + board:03X}#{data.hex()}")
        load = math.nan if 50 <= i < 60 else i / 2
        data = (
            bytes([2 if i >= 100 else 0, 1 if 20 <= i < 40 else 0])
            + struct.pack(">h", i)
            + struct.pack("<f", load)
        )
        lines.append(f"({time:.6f}) can0 300#{data.hex()}")
        lines.append(f"({time:.6f}) can1 500#{i % 2:02X}{i % 50:02X}0000")
        lines.append(f"({time:.6f}) can0 600#{b'arm'.ljust(8, bytes(1)).hex()}")
    path = tmp_path / "walk.log"
    path.write_text("\n".join(lines) + "\n")
    return path


# ---------------------------------------------------------------------- in the terminal


def test_a_plot_goes_to_the_terminal(
    aces: Aces, walk: Path, arm: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Panels with title, unit, names as ticks and lanes of flags over one time axis; the summary on stderr."""
    monkeypatch.setenv("COLUMNS", "60")
    result = aces("plot", walk, "Encoder.position.0", "-", "State.mode", "State.error", "-p", arm)
    assert result.status == 0
    lines = result.out.splitlines()
    assert lines[0] == "Encoder.position.0 in count"
    assert lines[1] == "1 board=0   2 board=1"
    assert max(map(len, lines)) <= 60
    assert "\x1b" not in result.out
    assert "State.mode" in lines
    assert any(line.strip().startswith("torque┤") for line in lines)
    hot = next(line for line in lines if line.lstrip().startswith("error.hot"))
    body = hot.partition("┤")[2]
    assert 0.05 < body.count("█") / len(body) < 0.15
    assert lines[-1].strip() == "time in s"
    assert result.summary["frames"] == result.summary["decoded"] == 1000


def test_a_spike_of_one_frame_is_seen(
    aces: Aces, walk: Path, arm: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """However narrow the terminal, a single high sample reaches the top of its panel."""
    monkeypatch.setenv("COLUMNS", "30")
    result = aces("plot", walk, "Encoder[board=1].position.1", "-p", arm)
    assert result.out.splitlines()[0] == "Encoder[board=1].position.1 i…"
    top = next(line for line in result.out.splitlines() if line.lstrip().startswith("1000┤"))
    assert len(top.partition("┤")[2].strip()) == 1


def test_colours_only_where_wanted(aces: Aces, walk: Path, arm: str) -> None:
    """A pipe gets no escapes, --color gives them; without their colour the same characters are left."""
    plain = aces("plot", walk, "State.angle", "-p", arm).out
    coloured = aces("plot", walk, "State.angle", "-p", arm, "--color").out
    assert "\x1b[" not in plain
    assert "\x1b[" in coloured
    strip = [line.rstrip() for line in re.sub(r"\x1b\[[0-9;]*m", "", coloured).splitlines()]
    assert strip == plain.splitlines()


def test_an_output_without_braille_gets_ascii(walk: Path, arm: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Stars for dots and ASCII frames, where the output's encoding has no more."""
    output = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    monkeypatch.setattr(sys, "stdout", output)
    status = main(["plot", str(walk), "State.mode", "State.error", "State.load", "-p", arm])
    monkeypatch.undo()
    assert status == 0
    assert isinstance(output.buffer, io.BytesIO)
    text = output.buffer.getvalue().decode("ascii")
    assert "*" in text
    assert "#" in text
    assert "?" not in text


@given(
    st.integers(20, 200),
    st.lists(
        st.tuples(st.floats(-1e12, 1e12), st.sampled_from([math.nan, 0.0, 1.0, -1e30, 1e30, 5e-324])),
        min_size=1,
        max_size=30,
    ),
    st.booleans(),
    st.sampled_from(["", "r--", ".", "|", "-o"]),
)
def test_no_line_is_wider_than_the_terminal(
    width: int, samples: list[tuple[float, float]], is_step: bool, shape: str
) -> None:
    """Whatever the values and names, every line fits and nothing raises."""
    x = np.array(sorted(a for a, _ in samples))
    y = np.array([b for _, b in samples])
    kind = ColumnKind("a_rather_long_name_of_a_signal\x1b", unit="m/s")
    series = Series(PlotSignal("p", "Message", kind.name, kind.name, kind), ())
    lines = [PlotLine(series, parse_format(shape, ""), x, y, kind.name) for _ in range(3)]
    flag = PlotLine(series, ImageFormat(), x, np.where(np.isnan(y), y, y > 0), "flag")
    panels = [
        PlotPanel("numbers", [lines[:2], lines[2:]], "Title", ["m/s", ""], ["", ""], [(None, None), (0, 5)]),
        PlotPanel("flags", [[flag]], "Flags", [""], [""], [(None, None)]),
    ]
    for paint in (None, lambda style, text: text):
        text = terminal.draw_terminal(
            Picture(panels, TimeAxis(origin=0, is_set=True), is_step=is_step), width, paint=paint
        )
        assert max(map(len, text.splitlines())) <= width
        assert "\x1b" not in text


@pytest.mark.parametrize(
    ("low", "high", "room", "texts"),
    [
        (0, 10, 5, ["0", "2", "4", "6", "8", "10"]),
        (-0.5, 0.5, 4, ["-0.5", "0.0", "0.5"]),
        (0.001, 0.0025, 3, ["0.0010", "0.0015", "0.0020", "0.0025"]),
    ],
)
def test_ticks_are_round(low: float, high: float, room: int, texts: list[str]) -> None:
    """Ticks are multiples of 1, 2 or 5 and a power of ten, with as many digits as that."""
    step = terminal.nice_step((high - low) / room)
    assert [terminal.number_text(number, step) for number in terminal.ticks(low, high, step)] == texts


# ---------------------------------------------------------------------- lists and limits


def test_the_list_says_what_occurs(aces: Aces, walk: Path, arm: str) -> None:
    """Name as it can be asked for, count, range and unit; enumerations by name, texts as such."""
    result = aces("plot", walk, "-p", arm, "--list")
    rows = [line.split() for line in result.out.splitlines()]
    assert rows[0] == ["signal", "count", "min", "max", "unit"]
    assert ["Encoder[board=1].position.0", "200", "-199", "0", "count"] in rows
    assert ["State[board=0].mode", "200", "off", "torque"] in rows
    assert ["State[board=0].error.hot", "200", "0", "1"] in rows
    assert ["State[board=0].load", "200", "0", "99.5"] in rows
    assert ["Pages.low", "100", "0", "24", "V"] in rows
    assert ["Name.name", "200", "text"] in rows
    assert not any(row[0].startswith("Gains") for row in rows)


def test_a_listed_name_can_be_plotted(aces: Aces, walk: Path, arm: str) -> None:
    """Every number in the list, typed as it stands there, means itself."""
    listed = aces("plot", walk, "-p", arm, "--list").out.splitlines()[1:]
    names = [line.split()[0] for line in listed if not line.startswith("Name")]
    assert len(names) > 8
    for name in names:
        assert name in aces("plot", walk, name, "-p", arm, "--list").out


def test_from_and_to_limit_what_is_taken(aces: Aces, walk: Path, arm: str) -> None:
    """In seconds from the first frame or since 1970; nothing between them is said, and is an error."""
    name = "State[board=0].angle"
    for start, stop in (("0.5", "0.7"), ("1436509052.5", "1436509052.7")):
        out = aces("plot", walk, name, "-p", arm, "--list", "--from", start, "--to", stop).out
        assert out.splitlines()[1].split() == [name, "20", "0.5", "0.69", "°"]
    result = aces("plot", walk, name, "-p", arm, "--from", "50")
    assert result.status == 2
    assert result.messages == ["nothing to draw: none of these signals occurs between --from and --to"]


def test_channels_are_told_apart(aces: Aces, tmp_path: Path, arm: str) -> None:
    """A message on two buses is one line each, and one of them can be asked for."""
    log = tmp_path / "two.log"
    log.write_text("".join(f"({i}.0) can{i % 2} 300#0000000{i}00000000\n" for i in range(8)))
    other = tmp_path / "other.log"
    other.write_text("".join(f"({i}.0) can{i % 2} 30{i % 2}#0000000{i}00000000\n" for i in range(8)))
    out = aces("plot", log, "angle", "-p", arm).out
    assert out.splitlines()[:2] == ["State.angle in °", "1 channel=can0   2 channel=can1"]
    out = aces("plot", log, "State[channel=can1].angle", "-p", arm).out
    assert out.splitlines()[0] == "State[channel=can1].angle in °"
    out = aces("plot", other, "angle", "-p", arm).out  # each board speaks on one bus: its number says enough
    assert out.splitlines()[1] == "1 board=0   2 board=1"


def test_enumerations_do_not_lie_on_each_other(aces: Aces, tmp_path: Path, arm: str) -> None:
    """Of several devices each has a panel; where most numbers have no name, the values are drawn as numbers."""
    log = tmp_path / "two.log"
    log.write_text("".join(f"({i}.0) can0 30{i % 2}#0{i % 4 // 2 * 2}00000000000000\n" for i in range(8)))
    lines = aces("plot", log, "State.mode", "-p", arm).out.splitlines()
    assert lines.count("State[board=0].mode") == lines.count("State[board=1].mode") == 1
    log.write_text("".join(f"({i}.0) can0 300#{i:02X}00000000000000\n" for i in range(90)))
    assert "torque" not in aces("plot", log, "State.mode", "-p", arm).out


def test_what_is_named_and_does_not_occur_is_said(aces: Aces, walk: Path, arm: str) -> None:
    """Beside signals that do occur it is a remark; alone it is an error."""
    result = aces("plot", walk, "State.load", "Limits.lower", "-p", arm)
    assert result.status == 0
    assert result.messages == ["nothing that 'Limits.lower' means occurs"]
    assert aces("plot", walk, "Limits.lower", "-p", arm).status == 2


def test_without_signals_each_message_has_a_subplot(aces: Aces, walk: Path, arm: str) -> None:
    """Everything that can be drawn is, one sort and unit a panel."""
    out = aces("plot", walk, "-p", arm).out
    for title in ("Encoder in count", "State.mode", "State.angle in °", "State.load", "Pages.low in V"):
        assert title in out.splitlines()


def test_serial_captures_are_plotted(aces: Aces, tmp_path: Path, line: str) -> None:
    """Raw bytes have no times: the axis counts bytes, and the summary accounts for them."""
    path = tmp_path / "s.bin"
    path.write_bytes(b"".join(b"\xaa" + struct.pack(">hB", i, 0) for i in range(50)) + b"z")
    result = aces("plot", path, "Sample.value", "-p", line)
    assert result.out.splitlines()[-1].strip() == "byte"
    assert result.summary["records"] == 50
    assert result.summary["bytes"] == 201


def test_damage_is_said_as_by_decode(aces: Aces, log: Path, arm: str) -> None:
    """Unreadable lines are named, frames counted by bin."""
    result = aces("plot", log, "State.angle", "-p", arm)
    assert result.status == 0
    assert "not a line of" in result.messages[0]
    assert result.summary["lines_unreadable"] == 1
    assert (result.summary["frames"], result.summary["decoded"]) == (12, 8)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--ylim", "5"], "write LOW:HIGH"),
        (["--ylim", "5:5"], "write LOW:HIGH"),
        (["--ylim", "0:nan"], "write LOW:HIGH"),
        (["--ymin", "5", "--ymax", "5"], "--ymin 5 is not below --ymax 5"),
        (["--ymin", "inf"], "'inf' is not a number"),
        (["--break-time", "nan"], "'nan' is not a number"),
        (["-o", "x.bmp"], r"one of \.png, \.svg, \.pdf"),
        (["-o", "nowhere/x.png"], "there is no folder"),
        (["-o", "x.png", "--show"], "choose one of"),
        (["--style", "ggplot"], "--style is for pictures"),
    ],
)
def test_wrong_calls_are_one_line(
    options: list[str], said: str, aces: Aces, tmp_path: Path, arm: str
) -> None:
    """Refused before the capture is opened."""
    result = aces("plot", tmp_path / "absent.log", "State.load", "-p", arm, *options)
    assert result.status == 2
    assert re.search(said, result.err)
    assert result.err.count("\n") == 1


def test_captures_stand_before_signals(aces: Aces, walk: Path, arm: str) -> None:
    """A file behind a signal is not a signal that was misspelt."""
    result = aces("plot", walk, "State.load", walk, "-p", arm)
    assert result.status == 2
    assert "captures come first, signals after them" in result.err


@pytest.mark.parametrize("limit", ["--ymin", "--ymax"])
@pytest.mark.parametrize("value", ["1e300", "-1e300", "-12345.5", "0"])
def test_a_limit_far_from_all_values_is_drawn(
    limit: str, value: str, aces: Aces, walk: Path, arm: str
) -> None:
    """An axis without a value on it, and no error."""
    result = aces("plot", walk, "State.load", "-p", arm, f"{limit}={value}")
    assert result.status == 0, result.err


def test_a_picture_that_cannot_be_written_leaves_what_was_there(aces: Aces, walk: Path, arm: str) -> None:
    """The picture of before, and no part of the new one."""
    out = walk.with_name("walk.png")
    out.write_bytes(b"before")
    files = sorted(walk.parent.glob("[!_]*"))
    with small_disk(1000):
        result = aces("plot", walk, "State.load", "-p", arm, "-o", out)
    assert result.status == 2
    assert f"{out}: cannot be written" in result.err
    assert out.read_bytes() == b"before"
    assert sorted(walk.parent.glob("[!_]*")) == files


def test_without_matplotlib_only_files_are_refused(
    aces: Aces, walk: Path, arm: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The message names the extra; the terminal needs nothing."""
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    result = aces("plot", walk, "State.load", "-p", arm, "-o", "x.png")
    assert result.status == 2
    assert "pip install 'aces-bus[plot]'" in result.err
    assert aces("plot", walk, "State.load", "-p", arm).status == 0


# ---------------------------------------------------------------------- in files

SIGNATURES = {"png": b"\x89PNG", "svg": b"<?xml", "pdf": b"%PDF"}


@pytest.mark.slow
@pytest.mark.parametrize("suffix", SIGNATURES)
def test_files_are_of_their_kind_and_repeat(aces: Aces, walk: Path, arm: str, suffix: str) -> None:
    """The suffix says the format; the same call gives the same bytes; nothing goes to stdout."""
    pytest.importorskip("matplotlib")
    made: list[bytes] = []
    for name in ("one", "other"):
        path = walk.with_name(f"{name}.{suffix}")
        result = aces("plot", walk, "State.load", "State.mode", "-p", arm, "-o", path)
        assert (result.status, result.out) == (0, "")
        made.append(path.read_bytes())
    assert made[0].startswith(SIGNATURES[suffix])
    assert made[0] == made[1]


def test_the_capture_is_not_overwritten(aces: Aces, walk: Path, arm: str) -> None:
    """-o naming an input is refused."""
    pytest.importorskip("matplotlib")
    path = walk.with_name("walk.png")
    path.write_bytes(walk.read_bytes())
    result = aces("plot", path, "State.load", "-p", arm, "-o", path)
    assert result.status == 2
    assert "one of the files to read" in result.err


@pytest.mark.parametrize(
    ("signals", "units"),
    [
        (["Encoder.position.0", "State.angle"], [["count"], ["°"]]),
        (["Pages.low", "Encoder.position.0", "State.angle"], [["V", "count", "°"]]),
        (["Pages.low", ",", "Encoder.position.0", "State.angle"], [["V"], ["count", "°"]]),
    ],
)
def test_two_units_have_an_axis_each(
    aces: Aces,
    walk: Path,
    arm: str,
    monkeypatch: pytest.MonkeyPatch,
    signals: list[str],
    units: list[list[str]],
) -> None:
    """In one subplot, unless axes were asked for; of more units one is for all."""
    panels: list[PlotPanel] = []

    def keep(*given: Any, **others: Any) -> list[PlotPanel]:
        panels.extend(panels_of(*given, **others))
        return panels

    monkeypatch.setattr(plot, "panels_of", keep)
    assert aces("plot", walk, *signals, "-p", arm).status == 0
    assert [[sorted({line.unit for line in axis}) for axis in panel.axes] for panel in panels] == [units]


@pytest.mark.slow
def test_a_figure_shows_what_was_asked_for(
    aces: Aces, walk: Path, arm: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Titles, units, limits, a second axis, names as ticks, lanes, legends outside; names are never formulas."""
    pytest.importorskip("matplotlib")
    from matplotlib.figure import Figure

    from aces_tools.plotting import figure

    shown: list[Any] = []
    draw = figure.draw_figure

    def keep(picture: Picture, made: Figure) -> None:
        draw(picture, made)
        shown.append(made)

    monkeypatch.setattr(figure, "draw_figure", keep)
    arguments = ["Encoder.position.0:r--", ",", "State.load", "-", "State.mode", "-", "State.error"]
    labels = ["--title", "A $walk", "--ylim", "0:5", "--xlabel", "now", "--ylabel", "steps", "--ylabel", "A"]
    result = aces("plot", walk, *arguments, "-p", arm, "-o", walk.with_name("a.png"), *labels)
    assert result.status == 0, result.err
    (made,) = shown
    first, second, names, flags = (made.axes[i] for i in (0, 1, 2, 3))
    assert (first.get_ylabel(), second.get_ylabel()) == ("steps", "A")
    assert first.get_ylim() == second.get_ylim() == (0, 5)
    assert made.get_suptitle() == "A $walk"
    assert names.get_title(loc="left") == "State.mode"
    assert [text.get_text() for text in names.get_yticklabels()] == ["off", "torque"]
    assert [text.get_text() for text in flags.get_yticklabels()] == ["error.hot", "error.cold"]
    assert flags.get_xlabel() == "now"
    assert [line.get_linestyle() for line in first.lines] == ["--", "--"]
    assert np.isnan(second.lines[0].get_ydata()).any()
    legend = [text.get_text() for text in first.get_legend().get_texts()]
    assert legend == ["Encoder[board=0].position.0", "Encoder[board=1].position.0", "State.load →"]
