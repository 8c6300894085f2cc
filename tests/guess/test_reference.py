"""A measured quantity beside a recording: its field, scale, offset and delay."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from aces_bus.errors import CallerError, CaptureError
from aces_bus.protocol import Xor
from aces_lab.guess import MeasuredQuantity, StreamTraffic, read_quantity, stream_source
from aces_lab.guess.reference import Messages, followers, on_clock
from tests.bench.guess_reference import TWINS, drawn, score, twin_guess


def table(folder: Path, text: str) -> str:
    """A file of that text."""
    path = folder / "gps.csv"
    path.write_text(text, encoding="utf-8")
    return str(path)


# ---------------------------------------------------------------------- finding


def test_a_number_is_found_with_its_scale_offset_and_delay() -> None:
    """In a drawn database of ten messages, by a noisy quantity in 50 steps."""
    line = score(drawn(1))
    assert line.is_right, line


@pytest.mark.slow
def test_of_fifty_drawn_databases_nearly_all_are_right() -> None:
    """The right field is first in 95 %, with its scale within 1 % and its offset within one step."""
    lines = {seed: score(drawn(seed)) for seed in range(1, 51)}
    assert sum(line.is_right for line in lines.values()) >= 0.95 * len(lines), lines


@pytest.mark.slow
@pytest.mark.parametrize("driver", TWINS)
def test_a_twins_own_log_gives_the_field_of_its_position(driver: str) -> None:
    """Though the log begins with the run, and the recording before it."""
    _, identifier, start, length = TWINS[driver]
    best = twin_guess(driver)[0]
    assert (best.key[0], best.field.start, best.field.length) == (identifier, start, length)
    assert best.explained > 0.9999


def swing(count: int = 800) -> tuple[Any, Any]:
    """Instants at 100 Hz and a quantity that swings around 0."""
    times = np.arange(count) / 100
    return times, np.sin(times) + 0.4 * np.sin(2.7 * times)


def test_a_float_is_found_as_one() -> None:
    """Its exponent makes no integer of it that a line goes through."""
    times, values = swing()
    rows = np.zeros((len(times), 8), np.uint8)
    rows[:, 2:6] = (10 * values).astype(">f4").view(np.uint8).reshape(-1, 4)
    [found] = followers([Messages(0, times, rows)], MeasuredQuantity("angle", "rad", times, values))
    assert (found.field.kind, found.field.start, found.field.order) == ("float", 40, "big")
    assert found.scale == pytest.approx(0.1)


def test_a_few_messages_of_other_contents_do_no_harm() -> None:
    """They are counted, and not part of the line."""
    times, values = swing()
    rows = np.round(3000 * values).astype("<i2").view(np.uint8).reshape(-1, 2).copy()
    rows[100:120] = 0x55
    [found] = followers([Messages(0, times, rows)], MeasuredQuantity("angle", "rad", times, values))
    assert (found.field.start, found.field.length, found.field.signed) == (0, 16, True)
    assert found.messages < 790
    assert "are far from it" in found.field.evidence


def test_nothing_follows_a_quantity_that_has_nothing_to_do_with_it() -> None:
    """What moves by itself is not listed."""
    times, values = swing()
    numbers = np.random.default_rng(1)
    rows = numbers.integers(0, 256, (len(times), 8), np.uint8)
    assert followers([Messages(0, times, rows)], MeasuredQuantity("angle", "rad", times, values)) == []
    assert (
        followers([Messages(0, times[:5], rows[:5])], MeasuredQuantity("angle", "rad", times, values)) == []
    )


def test_nothing_is_interpolated_over_a_gap_of_the_reference() -> None:
    """Messages that came meanwhile are left out."""
    times, values = swing()
    rows = np.round(3000 * values).astype("<i2").view(np.uint8).reshape(-1, 2)
    known = (times < 2) | (times > 5)
    [found] = followers(
        [Messages(0, times, rows)], MeasuredQuantity("angle", "rad", times[known], values[known])
    )
    assert found.messages <= 500
    assert found.explained > 0.999999


def test_clocks_without_common_instants_begin_together() -> None:
    """And it is said which it was."""
    quantity = MeasuredQuantity("angle", "rad", np.array([5.0, 6.0, 9.0]), np.zeros(3))
    same, is_same = on_clock(quantity, 4.0, 10.0)
    assert (same.times_s.tolist(), is_same) == ([1.0, 2.0, 5.0], True)
    other, is_same = on_clock(quantity, 1.7e9, 1.7e9 + 5)
    assert (other.times_s.tolist(), is_same) == ([0.0, 1.0, 4.0], False)


# ---------------------------------------------------------------------- tables


@pytest.mark.parametrize(
    ("text", "times"),
    [
        ("time,v\n1,5\n2,6\n", [1, 2]),
        ("v;t_ms\n5;1000\n6,0;2000\n", [1, 2]),
        ("Timestamp\tv\n1700000000000\t5\n1700000001000\t6\n", [1.7e9, 1.7e9 + 1]),
        ("time [us],v\n2000000,6\n1000000,5\n1500000,\n", [1, 2]),
        ("date,v\n1970-01-01T00:00:01,5\n1970-01-01T01:00:02+01:00,6\n", [1, 2]),
    ],
)
def test_instants_are_seconds_or_what_the_column_says(tmp_path: Path, text: str, times: list[float]) -> None:
    """Numbers, Unix time by its size, dates; in their order, rows without a value left out."""
    quantity = read_quantity(f"{table(tmp_path, text)}:v")
    assert quantity.times_s.tolist() == times
    assert quantity.values.tolist() == [5, 6]


def test_a_unit_is_the_columns_or_the_callers(tmp_path: Path) -> None:
    """In brackets behind its name, which may be left out."""
    path = table(tmp_path, "time,speed [km/h]\n1,5\n2,6\n")
    assert read_quantity(f"{path}:speed")[:2] == ("speed", "km/h")
    assert read_quantity(f"{path}:speed [km/h]", unit="m/s")[:2] == ("speed", "m/s")
    with pytest.raises(CallerError, match="not a unit"):
        read_quantity(f"{path}:speed", unit="bogus")


@pytest.mark.parametrize(
    ("text", "column", "said"),
    [
        ("time,v\n1,5\n", "v", "two are needed"),
        ("time,v\n1,5\nx,6\n", "v", ":3: 'x' is not an instant"),
        ("time\n1\n", "v", "no names of two columns"),
        ("time,v\n1,5\n", "w", "there are time, v"),
        ("when,v\n1,5\n", "v", "--time-column COLUMN"),
        ("time,v\n1,5\n", "", "FILE.csv:COLUMN"),
    ],
)
def test_what_is_no_quantity_is_refused(tmp_path: Path, text: str, column: str, said: str) -> None:
    """With the file, the place, and what there is."""
    with pytest.raises((CallerError, CaptureError), match=said):
        read_quantity(f"{table(tmp_path, text)}:{column}")


def test_a_column_of_instants_can_be_named(tmp_path: Path) -> None:
    """Where no name says which it is."""
    path = table(tmp_path, "when,v\n1,5\n2,6\n")
    quantity = read_quantity(f"{path}:v", time="when")
    assert quantity.times_s.tolist() == [1, 2]


def test_the_field_of_a_stream_is_found_in_its_packet() -> None:
    """By the times of packets; the draft has it there, with its unit and scale."""
    times, values = swing()
    traffic = StreamTraffic()
    for number, (time, value) in enumerate(zip(times.tolist(), values.tolist(), strict=True)):
        inner = struct.pack("<BBhB", 7 + number % 2, number & 255, round(500 * value), number * 7 & 255)
        traffic.add(b"\xa5\x5a" + inner + Xor().encode(inner), time)
    guess = traffic.guess(known=False, quantity=MeasuredQuantity("angle", "rad", times, values))
    assert guess.reference is not None
    assert guess.reference.found is not None
    assert guess.reference.found.scale == 0.002
    assert '"angle" / Quantity(bits(16' in stream_source(guess)
    untimed = StreamTraffic()
    untimed.add(b"".join(b"\xa5\x5a" + bytes([number, number * 3 & 255]) for number in range(99)))
    with pytest.raises(CallerError, match="with times"):
        untimed.guess(known=False, quantity=MeasuredQuantity("angle", "rad", times, values))


def test_a_slow_number_without_noise_has_its_lowest_bits() -> None:
    """The quantity cannot tell, as they drown in its noise: they make the number smoother."""
    times = np.arange(4000) / 200
    raw = np.round(20000 + 9000 * np.sin(times / 5)).astype(">u2")
    rows = np.zeros((len(times), 8), np.uint8)
    rows[:, 2:4] = raw.view(np.uint8).reshape(-1, 2)
    noisy = 0.01 * raw + np.random.default_rng(3).normal(0, 0.5, len(times))
    [found] = followers([Messages(0, times, rows)], MeasuredQuantity("speed", "m/s", times, noisy))
    assert (found.field.start, found.field.order, found.scale) == (24, "big", 0.01)
