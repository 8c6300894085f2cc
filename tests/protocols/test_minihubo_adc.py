"""MiniHubo's converter board: frames without a check, kept in place by the FF FF FF rule."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from aces_bus import Unknown
from aces_bus.errors import FieldError
from aces_bus.protocol.live.stream import StreamScanner
from aces_protocols.minihubo_adc.spec import minihubo_adc

FRAME = bytes.fromhex("FF FF 09 0B 0A F1 08 03")
CHANNELS = (0x090B, 0x0AF1, 0x0803)
twelve_bits = st.integers(0, 0xFFF)


def read(*chunks: bytes) -> tuple[list[Any], StreamScanner]:
    """Everything that is found in the chunks, the stream being closed behind them."""
    scanner = minihubo_adc.scanner(include_unknown=True)
    assert isinstance(scanner, StreamScanner)
    found = [item for chunk in chunks for item in scanner.feed(chunk)] + scanner.close()
    assert scanner.counts.balance == 0
    return found, scanner


def samples(found: list[Any]) -> list[tuple[int, tuple[int, ...]]]:
    return [(f.meta.offset, f.channels) for f in found if not isinstance(f, Unknown)]


def test_a_frame_is_three_big_endian_numbers() -> None:
    """Eight bytes are one sample, both ways."""
    found, _ = read(FRAME)
    assert samples(found) == [(0, CHANNELS)]
    assert minihubo_adc.encode("Sample", channels=CHANNELS) == FRAME


def test_the_header_is_the_last_two_of_ff_ff_ff() -> None:
    """A low byte FF before a header moves the header, not the data."""
    found, scanner = read(b"\xff" + FRAME)
    assert samples(found) == [(1, CHANNELS)]
    assert (scanner.counts.skipped, scanner.counts.malformed) == (1, 0)

    # Entered one byte before the header, the stream is still read in step.
    ends_in_ff = minihubo_adc.encode("Sample", channels=[0x0902, 0x0AF2, 0x07FF])
    found, scanner = read(ends_in_ff[7:] + FRAME + ends_in_ff + FRAME)
    assert samples(found) == [(1, CHANNELS), (9, (0x0902, 0x0AF2, 0x07FF)), (17, CHANNELS)]


@given(values=st.lists(st.tuples(twelve_bits, twelve_bits, twelve_bits), max_size=20), data=st.data())
def test_what_the_board_can_send_is_read_wherever_it_is_cut(
    values: list[tuple[int, int, int]], data: st.DataObject
) -> None:
    """A stream of 12-bit samples gives every one of them, however its bytes arrive."""
    stream = b"".join(minihubo_adc.encode("Sample", channels=v) for v in values)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=8)))
    chunks = [stream[a:b] for a, b in zip([0, *cuts], [*cuts, len(stream)], strict=True)]
    found, scanner = read(*chunks)
    assert samples(found) == [(8 * i, v) for i, v in enumerate(values)]
    assert scanner.counts.decoded == len(stream)


@given(
    values=st.lists(st.tuples(twelve_bits, twelve_bits, twelve_bits), min_size=1, max_size=20),
    entry=st.integers(1, 8),
)
def test_any_entry_into_the_stream_finds_step(values: list[tuple[int, int, int]], entry: int) -> None:
    """Entered at any byte of a frame, the rest of that frame is skipped, and every later one is found."""
    stream = b"".join(minihubo_adc.encode("Sample", channels=v) for v in [(0, 0, 0), *values])
    found, scanner = read(stream[entry:])
    assert samples(found) == [(8 * i - entry, v) for i, v in enumerate(values, 1)]
    lost = scanner.counts.skipped + scanner.counts.malformed
    assert lost == 8 - entry


def test_a_cut_off_frame_is_pending() -> None:
    """What the end of the stream cuts off is neither a sample nor lost."""
    found, scanner = read(FRAME + FRAME[:3])
    assert samples(found) == [(0, CHANNELS)]
    assert (scanner.counts.pending, scanner.counts.malformed, scanner.counts.skipped) == (3, 0, 0)


def test_a_sample_that_would_break_step_is_refused() -> None:
    """A first channel of 0xFF00 or more would look like FF FF FF: the encoder does not send it."""
    with pytest.raises(FieldError, match="FF behind FF FF"):
        minihubo_adc.encode("Sample", channels=[0xFF00, 0, 0])


@pytest.mark.parametrize("channels", [[1, 2], [1, 2, 3, 4], [0, 0, 0x10000], [-1, 0, 0]])
def test_a_sample_has_three_numbers_of_sixteen_bits(channels: list[int]) -> None:
    """Too few, too many or too large numbers are refused, naming the field."""
    with pytest.raises(FieldError, match="channels"):
        minihubo_adc.encode("Sample", channels=channels)


def test_the_board_is_not_checked() -> None:
    """There is no check, and the protocol does not pretend to have one."""
    assert [framing.check for framing in minihubo_adc.framings] == [None]
