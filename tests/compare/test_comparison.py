"""What differs between two recordings: nothing where nothing does, what was planted and only that, what may be chance."""

from __future__ import annotations

import io
import random
from collections.abc import Iterable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from aces_bus import Frame, FrameTable
from aces_bus.errors import CallerError
from aces_bus.frame_table import Channels
from aces_bus.recordings.filters import parse_filter
from aces_lab.compare import RecordingComparison, TrafficChange, compare_recordings, parse_marks
from aces_lab.compare.changes import bits_text, values_text
from aces_lab.compare.marks import windows_of
from aces_lab.compare.traffic import IdentifierTraffic, TrafficProfile
from aces_tools.reading import traffic
from aces_tools.reading.traffic import BusIdentifier, GapCounts

ROOT = Path(__file__).resolve().parents[2]
WALK = ROOT / "examples" / "captures" / "hubo2plus.log"

FRAMES = st.lists(
    st.builds(
        Frame,
        st.sampled_from([0x10, 0x11, 0x7FF]),
        st.binary(max_size=8),
        st.integers(0, 10**7).map(lambda us: us / 1e6),
        st.sampled_from(["can0", "can1"]),
        st.booleans(),
    ),
    min_size=1,
    max_size=60,
)


def candump(frames: Iterable[tuple[float, str]]) -> io.BytesIO:
    """Frames as a log: (seconds, `123#00FF`)."""
    return io.BytesIO("".join(f"({1000 + at:.6f}) can0 {text}\n" for at, text in frames).encode())


def compared(a: Iterable[tuple[float, str]], b: Iterable[tuple[float, str]]) -> list[TrafficChange]:
    """All changes from `a` to `b`, however weak."""
    return compare_recordings(candump(a), candump(b), least=0).changes


def steady(text: str, period: float = 0.01, number: int = 100) -> list[tuple[float, str]]:
    """A periodic message."""
    return [(n * period, text) for n in range(number)]


# ---------------------------------------------------------------------- profiles


@given(FRAMES, st.integers(1, 60))
def test_a_profile_says_what_sets_say(frames: list[Frame], cut: int) -> None:
    """Values, lengths, flips and bits seen of each byte are those that plain sets have, however the frames are cut."""
    frames.sort(key=lambda one: one.timestamp or 0)
    channels = Channels()
    profile = TrafficProfile()
    for start in range(0, len(frames), cut):
        table = FrameTable.from_frames(frames[start : start + cut], channels)
        profile.add(table, np.zeros(len(table), np.int64))
    expected: dict[BusIdentifier, list[bytes]] = {}
    for frame in frames:
        key = frame.arbitration_id | (1 << 31 if frame.is_extended_id else 0)
        expected.setdefault(BusIdentifier(frame.channel, key), []).append(frame.data)
    assert set(profile.identifiers) == set(expected)
    for identifier, datas in expected.items():
        found = profile.identifiers[identifier]
        assert found.frames == len(datas)
        assert {int(n) for n in np.flatnonzero(found.lengths)} == {len(data) for data in datas}
        for byte in range(found.width):
            values = [data[byte] for data in datas if len(data) > byte]
            assert {int(v) for v in np.flatnonzero(found.values[byte])} == set(values)
            assert int(found.values[byte].sum()) == len(values)
            for bit in range(8):
                seen = {value >> bit & 1 for value in values}
                assert bool(found.ones[0, byte] >> bit & 1) is (1 in seen)
                assert bool(found.zeros[0, byte] >> bit & 1) is (0 in seen)
                flips = sum(
                    (old[byte] ^ new[byte]) >> bit & 1
                    for old, new in pairwise(datas)
                    if len(old) > byte and len(new) > byte
                )
                assert int(found.flips[byte, bit]) == flips


def test_periods_are_those_of_pandas() -> None:
    """The median gap of each identifier, by pandas' groupby: exact where periodic, within a bin of 2 % where not."""
    pandas = pytest.importorskip("pandas")
    rng = random.Random(4)
    frames = [Frame(0x100, b"", n * 0.01, "can0") for n in range(500)]
    at = 0.0
    for _ in range(500):
        at += rng.expovariate(50)
        frames.append(Frame(0x200, b"", round(at, 6), "can0"))
    frames.sort(key=lambda one: one.timestamp or 0)
    profile = TrafficProfile()
    table = FrameTable.from_frames(frames)
    profile.add(table, np.zeros(len(table), np.int64))
    data = pandas.DataFrame({"id": table.id, "time": table.time})
    medians = data.groupby("id").time.apply(lambda times: times.diff().median()) / 1e6
    found = {one.number: times.period_ms for one, times in profile.identifiers.items()}
    assert found[0x100] == pytest.approx(medians[0x100], rel=1e-9)
    assert found[0x200] == pytest.approx(medians[0x200], rel=0.02)


def test_gaps_of_one_kind_do_not_differ() -> None:
    """Two samples of one distribution are the same, those of different ones are not, and few say nothing."""
    rng = np.random.default_rng(1)
    one, same, other, few = GapCounts(), GapCounts(), GapCounts(), GapCounts()
    one.add(rng.exponential(1e7, 1000))
    same.add(rng.exponential(1e7, 1000))
    other.add(rng.exponential(1.5e7, 1000))
    few.add(np.array([1e9, 1e9]))
    assert one.differs_by(same) == 0
    assert one.differs_by(other) > 0.1
    assert one.differs_by(few) == 0


def test_what_is_between_windows_is_no_gap() -> None:
    """A frame is followed by the next one of its window, never by one of another."""
    found = IdentifierTraffic(2)
    times = np.array([0, 10, 20, 500, 510]) * 1_000_000
    data = np.array([[1], [1], [1], [9], [9]], np.uint8)
    data = np.pad(data, ((0, 0), (0, 7)))
    found.add(data, np.full(5, 1, np.uint8), times, np.array([0, 0, 0, 1, 1]))
    assert found.gaps.count == 3
    assert found.period_ms == pytest.approx(10)
    assert not found.flips.any()


def test_memory_is_bounded_whatever_the_recording_holds(monkeypatch: pytest.MonkeyPatch) -> None:
    """Identifiers beyond the limit are counted, not kept."""
    monkeypatch.setattr(traffic, "MOST_IDENTIFIERS", 100)
    n = 150
    table = FrameTable.from_frames([Frame(number, b"\0", None, None, True) for number in range(n)])
    profile = TrafficProfile()
    profile.add(table, np.zeros(n, np.int64))
    assert (len(profile.identifiers), profile.identifiers.beyond, profile.frames) == (100, 50, n)


# ---------------------------------------------------------------------- changes


@given(FRAMES)
def test_a_recording_does_not_differ_from_itself(frames: list[Frame]) -> None:
    """Whatever it holds, nothing is a change, not even a weak one."""
    lines = [
        f"({1000 + (one.timestamp or 0):.6f}) {one.channel} "
        f"{one.arbitration_id:0{8 if one.is_extended_id else 3}X}#{one.data.hex()}\n"
        for one in frames
    ]
    log = "".join(lines).encode()
    found = compare_recordings(io.BytesIO(log), io.BytesIO(log), least=0)
    assert found.is_same
    assert found.weaker == 0


@pytest.mark.parametrize("protocol", [None, "hubo"])
def test_a_real_recording_does_not_differ_from_itself(protocol: str | None) -> None:
    """Also decoded: of messages and signals."""
    assert compare_recordings(WALK, WALK, protocol=protocol, least=0).changes == []


@given(
    st.integers(0, 7),
    st.integers(0, 7),
    st.binary(min_size=8, max_size=8),
    st.integers(0, 98),
)
def test_a_planted_bit_is_found_and_only_it(byte: int, bit: int, data: bytes, at: int) -> None:
    """One bit that is another in some frames of B, beside a counter and noise that both have."""
    a, b = [], []
    for n in range(100):
        other = bytearray(data)
        other[byte] ^= (1 << bit) if n in (at, at + 1) else 0
        a.append((n * 0.01, f"2A0#{data.hex()}"))
        b.append((n * 0.01, f"2A0#{other.hex()}"))
        for side in (a, b):
            side.append((n * 0.01 + 0.001, f"123#{n % 16:02X}{n * 37 % 251:02X}"))
    (change,) = compared(a, b)
    assert (change.kind, change.subject, change.byte, change.bits) == ("changes", "2A0", byte, (bit,))
    assert (change.count, change.frames) == (2, 100)
    assert change.score > 0.8


def test_identifiers_appear_and_vanish() -> None:
    """Surely where there were many, and hardly where one came."""
    found = compared(
        steady("100#00") + steady("200#00"), steady("100#00") + steady("300#00") + [(0.5, "400#")]
    )
    assert [(one.kind, one.subject) for one in found] == [
        ("vanishes", "200"),
        ("appears", "300"),
        ("appears", "400"),
    ]
    assert found[0].score > 0.99
    assert found[0].a == "100 frames, every 10 ms"
    assert found[2].score == pytest.approx(0.632, abs=0.01)


def test_standard_extended_remote_and_error_frames_of_one_number_are_different_subjects() -> None:
    """Identifier 123 with 11 and 29 bits, as a request, with FD."""
    found = compared(
        steady("123#00"),
        steady("00000123#00") + steady("123#R") + steady("123##000") + [(0.1, "20000004#00")],
    )
    subjects = {(one.kind, one.subject) for one in found}
    assert subjects == {
        ("vanishes", "123"),
        ("appears", "00000123"),
        ("appears", "123 remote"),
        ("appears", "123 FD"),
        ("appears", "004 error"),
    }


def test_a_period_that_changes_is_told_from_jitter() -> None:
    """Twice the period is a change; a tenth of jitter around the same is none."""
    rng = random.Random(2)
    jitter = [(n * 0.01 + rng.random() * 0.002, "100#00") for n in range(200)]
    other = [(n * 0.01 + rng.random() * 0.002, "100#00") for n in range(200)]
    assert compared(jitter, other) == []
    (change,) = compared(steady("100#00", 0.01), steady("100#00", 0.02))
    assert (change.kind, change.a, change.b) == ("period", "every 10 ms", "every 20 ms")


def test_a_rate_that_breaks_down_is_seen_where_no_period_can_be() -> None:
    """Two frames in a second that had a hundred, beside a message that says how long it was."""
    clock = steady("001#00", 0.01)
    (change,) = compared(clock + steady("100#00"), [*clock, (0.1, "100#00"), (0.9, "100#00")])
    assert change.kind == "rate"
    assert change.a.startswith("100 frames, 101 a second")


def test_lengths_that_are_new() -> None:
    """A frame that is longer than any before."""
    (change,) = compared(steady("100#0011"), [*steady("100#0011"), (1.0, "100#001122")])
    assert (change.kind, change.a, change.b, change.count) == ("length", "2 bytes", "2, 3 bytes", 1)


def test_what_stops_changing_is_said() -> None:
    """A byte that toggles in A and not in B."""
    (change,) = compared([(n * 0.01, f"100#{n & 1:02X}") for n in range(100)], steady("100#00"))
    assert (change.kind, change.bits) == ("constant", (0,))


def test_a_bit_among_noise_that_pauses_by_chance_is_not_telling() -> None:
    """In six frames some of 64 noisy bits do not change."""
    rng = random.Random(3)
    noise = [(n * 0.01, f"100#{rng.randbytes(8).hex()}") for n in range(606)]
    found = [one for one in compared(noise[:600], noise[600:]) if one.kind == "constant"]
    assert found
    assert max(one.score for one in found) < 0.2


@pytest.mark.parametrize("late", [0.0, 0.01, 0.3])
def test_marks_that_are_a_bit_late_find_the_button_nevertheless(late: float) -> None:
    """The first frames of each press are in A: its bit, its length and its value of an enumeration are hardly ever there."""
    presses = [(5.0, 7.0), (12.0, 14.0), (20.0, 22.5)]

    def is_pressed(at: float) -> bool:
        return any(start <= at < stop for start, stop in presses)

    frames: list[tuple[float, str]] = []
    for n in range(3000):
        at = n / 100
        frames.append((at, f"2A0#{n % 16:02X}{0x21 if is_pressed(at) else 0x01:02X}"))
        frames.append((at + 0.001, f"2A1#{'0000' if is_pressed(at) else '00'}"))
    times = [(start + late, stop - late) for start, stop in presses]
    found = compare_recordings(candump(frames), b_times=times).changes
    what = {(one.subject, one.byte, one.bits): (one.kind, one.seen_in) for one in found}
    if late:
        assert what == {("2A0", 1, (5,)): ("mostly", 3), ("2A1", None, ()): ("mostly", 0)}
        assert min(one.score for one in found) > 0.5
    else:
        assert what == {("2A0", 1, (5,)): ("differs", 3), ("2A1", None, ()): ("length", 0)}


def test_what_is_common_in_a_is_no_button() -> None:
    """A bit that is set for a third of A says nothing when it is set in B."""
    frames = [(n * 0.01, f"100#{0x20 if n % 300 >= 200 else 0:02X}") for n in range(3000)]
    found = compare_recordings(candump(frames), b_times=[(14.1, 14.8)], least=0).changes
    assert "mostly" not in {one.kind for one in found}


def test_a_counter_that_goes_on_is_hardly_telling_and_a_mode_is() -> None:
    """16-bit counter, noise and a mode of two values that gets a third."""
    rng = random.Random(1)

    def drive(first: int, modes: str) -> list[tuple[float, str]]:
        return [
            (n * 0.01, f"100#{first + n:04X}{rng.randrange(256):02X}{int(modes[n // 3 % len(modes)]):02X}")
            for n in range(1500)
        ]

    found = compared(drive(0, "13"), drive(1500, "132"))
    assert (found[0].byte, found[0].kind) == (3, "values")
    assert found[0].score > 0.6
    assert all(one.score < 0.2 for one in found[1:])


def test_channels_are_compared_by_name_only_where_there_are_several() -> None:
    """`vcan0` of one recording is `can0` of the other where each has one; two keep their names."""

    def log(*names: str) -> io.BytesIO:
        return io.BytesIO(
            "".join(f"({1000 + n}.0) {name} 100#00\n" for n in range(3) for name in names).encode()
        )

    assert compare_recordings(log("can0"), log("vcan0"), least=0).is_same
    found = compare_recordings(log("can0", "can1"), log("can0", "can2"), least=0).changes
    assert {(one.kind, one.subject) for one in found} == {("vanishes", "can1 100"), ("appears", "can2 100")}


# ---------------------------------------------------------------------- times of one recording


def pressing(times: Iterable[tuple[float, float]]) -> io.BytesIO:
    """A recording of 40 s in which a bit is set during these times."""
    times = list(times)
    frames = [
        (n * 0.01, f"2A0#{n & 15:02X}{0x20 if any(a <= n * 0.01 < b for a, b in times) else 0:02X}")
        for n in range(4000)
    ]
    return candump(frames)


def test_the_rest_of_a_recording_is_what_b_is_compared_with() -> None:
    """Three presses, of which each is a window: the bit is there in all of them."""
    presses = [(12.0, 13.5), (20.0, 21.0), (31.0, 33.0)]
    found = compare_recordings(pressing(presses), b_times=presses)
    (change,) = found.changes
    assert (change.kind, change.byte, change.bits) == ("differs", 1, (5,))
    assert (change.seen_in, change.windows, change.count) == (3, 3, 450)
    assert (found.a.traffic.frames, found.b.traffic.frames) == (3550, 450)


def test_what_is_in_one_of_three_times_counts_a_third() -> None:
    """A button that was pressed once, and marks that say three times."""
    presses = [(12.0, 13.5), (20.0, 21.0), (31.0, 33.0)]
    (change,) = compare_recordings(pressing(presses[:1]), b_times=presses).changes
    assert (change.seen_in, change.windows) == (1, 3)
    assert change.score == pytest.approx(1 / 3, abs=0.01)


def test_two_times_of_one_recording() -> None:
    """Windows are half open, and what is in neither counts for none."""
    found = compare_recordings(pressing([(12, 13)]), a_times=[(0, 10)], b_times=[(12, 13)])
    assert (found.a.traffic.frames, found.b.traffic.frames) == (1000, 100)
    assert [one.kind for one in found.changes] == ["differs"]


def test_a_filter_keeps_to_some_identifiers() -> None:
    """What it does not let pass is not counted, decoded or not."""
    both = steady("100#00") + steady("200#00")
    found = compare_recordings(
        candump(both), candump(steady("100#01")), wanted=parse_filter("200:7FF"), least=0
    )
    assert [(one.kind, one.subject) for one in found.changes] == [("vanishes", "200")]


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: compare_recordings(candump(steady("1#"))), "say when B is"),
        (
            lambda: compare_recordings(candump(steady("1#")), b_times=[(50, 60)]),
            "nothing of the recording is in the times",
        ),
        (
            lambda: compare_recordings(io.BytesIO(b"  can0  123   [1]  00\n" * 3), b_times=[(0, 1)]),
            "has no times",
        ),
        (lambda: compare_recordings(ROOT / "examples/captures/adc.bin", WALK), "not a format"),
    ],
)
def test_what_cannot_be_compared_is_refused(call: object, said: str) -> None:
    """By name, and with what would work."""
    with pytest.raises(Exception, match=said):
        call()  # type: ignore[operator]


def test_marks() -> None:
    """A mark lasts until the next line, as long as is asked for, or as long as it says."""
    text = "# a button\n12.3 pressed\n14 released\n\n20..21.5 pressed\t\n14:05:30 Pressed hard # twice\n"
    marks = parse_marks(text)
    assert [(one.name, one.start, one.stop, one.line) for one in marks] == [
        ("pressed", "12.3", None, 2),
        ("released", "14", None, 3),
        ("pressed", "20", "21.5", 5),
        ("Pressed hard", "14:05:30", None, 6),
    ]
    windows = windows_of(marks, "PRESSED")
    assert [one.bounds for one in windows] == [
        (12_300_000_000, 14_000_000_000),
        (20_000_000_000, 21_500_000_000),
    ]
    assert windows_of(marks, "pressed", 500_000_000)[0].bounds == (12_300_000_000, 12_800_000_000)
    assert len(windows_of(marks, "press*")) == 3
    assert windows_of(marks, "held") == []


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "no marks"),
        ("1 a\npressed\n", "marks.txt:2: mark 'pressed' is not a time"),
        ("2..1 a\n", "its end 1 is not later than marks.txt:1: mark 2"),
        ("..  a\n", "not a range of time"),
    ],
)
def test_a_line_that_is_no_mark_is_refused(text: str, said: str) -> None:
    """With its number."""
    with pytest.raises(CallerError, match=said):
        parse_marks(text, "marks.txt")


# ---------------------------------------------------------------------- messages and signals


def test_signals_that_change() -> None:
    """With a protocol the message, its device and its signal are named, and what is decoded is not said twice."""
    found = compare_recordings(WALK, b_times=[(0.0, 0.2)], protocol="hubo", least=0)
    assert all(one.message is not None for one in found.changes if one.subject.startswith("Encoder"))
    signals = {one.signal for one in found.changes if one.subject == "can0 Encoder[board=3]"}
    assert "position.0" in signals
    assert not [one for one in found.changes if one.subject == "can0 063"]


def test_a_signal_that_is_mostly_another_in_b_is_said() -> None:
    """A value that A has in hardly any message, and B in most."""
    values = [3 if 20 <= n < 40 else 0 for n in range(400)]
    frames = [(n * 0.01, f"063#{value:02X}00000000000000") for n, value in enumerate(values)]
    found = compare_recordings(candump(frames), b_times=[(0.22, 0.4)], protocol="hubo").changes
    (change,) = [one for one in found if one.signal == "position.0"]
    assert (change.kind, change.count, change.seen_in) == ("mostly", change.frames, 1)


def test_streams_are_compared_by_their_messages(tmp_path: Path) -> None:
    """Bytes of a serial line: channels that go on beyond what they had."""
    data = (ROOT / "examples/captures/adc.bin").read_bytes()
    first, last = tmp_path / "a.bin", tmp_path / "b.bin"
    first.write_bytes(data[:80])
    last.write_bytes(data)
    found = compare_recordings(first, last, protocol="minihubo_adc", least=0)
    assert found.changes
    assert {one.kind for one in found.changes} <= {"range", "values"}
    assert {(one.message, one.place) for one in found.changes} <= {
        ("Sample", f"channels.{n}") for n in range(3)
    }
    assert compare_recordings(first, first, protocol="minihubo_adc", least=0).is_same


def test_values_in_words() -> None:
    """Bits and bytes as the report has them."""
    assert bits_text((1,)) == "bit 1"
    assert bits_text((0, 1, 2, 5, 7)) == "bits 0-2 5 7"
    counts = np.zeros(256, np.int64)
    counts[[0, 0x20]] = [5, 9]
    assert values_text(counts) == "20 00"
    counts[[1, 2, 3]] = 1
    assert values_text(counts) == "5 values 00-20"


def test_the_result_is_small_and_says_so() -> None:
    """A result has no frames, and its changes are JSON."""
    found = compare_recordings(candump(steady("100#00")), candump(steady("100#01")))
    assert isinstance(found, RecordingComparison)
    assert repr(found) == "<1 changes, and 0 less telling>"
    assert found.changes[0].as_dict() == {
        "score": 0.987,
        "kind": "differs",
        "subject": "100",
        "channel": "can0",
        "identifier": 256,
        "extended": False,
        "byte": 0,
        "bits": [0],
        "a": "00",
        "b": "01",
        "count": 100,
        "frames": 100,
        "seen_in": 1,
        "windows": 1,
    }
