"""What the live screen counts, and how rows are told apart."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from aces_bus import Frame, make_scanner
from aces_bus.errors import CallerError
from aces_bus.hardware.gate import Received
from aces_bus.hardware.simulated.frame_time import INTERMISSION, frame_bits
from aces_tools.screen import ModelFeed
from aces_tools.screen.model import CHANNELS, Meter, Model, changed_bits
from aces_tools.screen.paint import FADE_NS
from tests.tools.screening import (
    MS,
    S,
    arm,
    encoder,
    heard,
    model,
    only,
    periodic,
    scanner,
    wire,
)


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
    """Stamps of zero, and none, are not stamps: the period is that of reading."""
    for stamp in (0.0, None):
        made = model()
        for number in range(50):
            made.feed(heard(Frame(0x060, bytes(8), stamp), at_ms=20 * number))
        assert only(made).period_s == pytest.approx(0.02)


def test_a_clock_that_goes_back_leaves_the_period_alone() -> None:
    """One jump back of the adapter's clock is not an interval."""
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
    expected = (frame_bits(frames[0].content).total + INTERMISSION) * 1000 / 1_000_000
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
    with pytest.raises(CallerError, match="include_unknown"):
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
    stream = ModelFeed(made)
    data = b"".join(bytes([0xAA, 1, n, 0, n]) for n in range(20))
    for at in range(0, len(data), 7):
        stream.feed([Received(data[at : at + 7], at * MS)])
    stream.feed([Received(b"\x00\x01", 200 * MS)])
    stream.idle(200 * MS + 5 * S)
    rows = {row.name: row for row in made.rows.values()}
    assert rows["Sample"].count == 20
    assert rows["skipped"].is_lost
    assert made.channels["tty"].bits == 10 * (len(data) + 2)
    assert not made.is_can


def test_bytes_without_a_protocol_are_refused() -> None:
    """There is nothing to make rows of."""
    with pytest.raises(CallerError, match="-p NAME"):
        ModelFeed(Model(None))


def test_a_meter_reads_right_from_the_beginning() -> None:
    """Not only when it has run for long."""
    meter = Meter(2.0, 0)
    for tenth in range(1, 200):
        meter.add(tenth * 100 * MS, 10)
        assert meter.per_second(tenth * 100 * MS) == pytest.approx(100, rel=0.03)
    assert meter.per_second(60 * S) < 1e-6
