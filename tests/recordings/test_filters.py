"""candump's filters: SocketCAN's rules, checked against a plain reading of them."""

from __future__ import annotations

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

from aces_bus import Frame
from aces_bus.errors import CallerError
from aces_bus.recordings.filters import parse_filter

STANDARD = Frame(0x123, channel="can0")
EXTENDED = Frame(0x123, channel="can0", is_extended_id=True)
REMOTE = Frame(0x123, channel="can0", is_remote_frame=True)
ERROR = Frame(0x004, bytes(8), channel="can0", is_error_frame=True)
OTHER = Frame(0x124, channel="can1")
ALL = {"standard": STANDARD, "extended": EXTENDED, "remote": REMOTE, "error": ERROR, "other": OTHER}


@pytest.mark.parametrize(
    ("text", "passes"),
    [
        ("123:7FF", "standard extended remote"),  # candump's help: including EFF and RTR frames
        ("123:C00007FF", "standard"),  # only SFF and non-RTR frames
        ("00000123:DFFFFFFF", "extended"),  # only this extended frame
        ("00000123:1FFFFFFF", "standard extended remote"),  # the mask leaves the flag out
        ("0x123:0x7ff", "standard extended remote"),
        ("123~7FF", "other"),
        ("120:7F0", "standard extended remote other"),
        ("0:0", "standard extended remote other"),
        ("0~0", ""),
        ("0~0,#FFFFFFFF", "error"),
        ("0:0,#FFFFFFFF", "standard extended remote error other"),
        ("#00000004", "standard extended remote error other"),
        ("#00000008", "standard extended remote other"),
        ("123:7FF,124:7FF", "standard extended remote other"),
        ("120:7F0,124~7FF,j", "standard extended remote"),
        ("J,123:7FF,124:7FF", ""),
        ("can0", "standard extended remote error"),
        ("any", "standard extended remote error other"),
        ("can1,0:0", "other"),
        ("can0,124:7FF", ""),
        (" can0 , 123:7FF ", "standard extended remote"),
    ],
)
def test_a_filter_passes_what_candump_passes(text: str, passes: str) -> None:
    """Each form of candump's syntax, by hand."""
    chosen = parse_filter(text)
    assert [name for name, frame in ALL.items() if chosen.matches(frame)] == passes.split()


def test_each_interface_has_its_own_filters() -> None:
    """As several arguments of candump: a frame passes when one of them lets it."""
    chosen = parse_filter("can0,123:C00007FF", "can1")
    assert [name for name, frame in ALL.items() if chosen.matches(frame)] == ["standard", "other"]


def test_an_interface_may_be_a_number() -> None:
    """BLF, ASC and TRC number their channels; with a mask behind, a number in front is one of these."""
    chosen = parse_filter("1,123:7FF")
    assert [chosen.matches(Frame(0x123, b"", channel=name)) for name in ("0", "1")] == [False, True]
    with pytest.raises(CallerError, match="'124' has no mask"):
        parse_filter("123,124")


def test_a_python_can_message_is_filtered_alike() -> None:
    """Filters look at attributes that both kinds of frame have."""
    chosen = parse_filter("can0,123:7FF")
    assert chosen.matches(can.Message(arbitration_id=0x123, is_extended_id=False, channel="can0"))
    assert not chosen.matches(can.Message(arbitration_id=0x123, is_extended_id=False, channel=1))


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("123", "'123' has no mask; for this identifier alone: 123:7FF"),
        ("can0,12345678", "12345678:DFFFFFFF"),
        ("", "is not a filter; write id:mask"),
        ("can0,", "'' is not a filter"),
        ("can0,can1", "'can1' is not a filter"),
        ("123:", "'123:' is not a filter"),
        (":7FF", "is not a filter"),
        ("123:7FG", "is not a filter"),
        ("123:7FF:1", "is not a filter"),
        ("123456789:7FF", "is not a filter"),
        ("#", "is not a filter"),
        ("123-7FF", "can0,060:7F0"),
        ("can 0", "is not a filter"),
    ],
)
def test_a_wrong_filter_says_what_can_be_written(text: str, says: str) -> None:
    """An error names the text, the part and an example that works."""
    if text == "123-7FF":
        text = "can0,123-7FF"
    with pytest.raises(CallerError) as caught:
        parse_filter(text)
    assert str(caught.value).startswith(f"filter {text!r}: ")
    assert says in str(caught.value)


def test_no_filter_at_all_is_an_error() -> None:
    """Whoever filters says by what."""
    with pytest.raises(CallerError, match="no filter given"):
        parse_filter()


@given(
    st.integers(0, 0xFFFFFFFF),
    st.integers(0, 0xFFFFFFFF),
    st.sampled_from([":", "~"]),
    st.integers(0, 0x1FFFFFFF),
    st.booleans(),
    st.booleans(),
)
def test_filters_are_the_kernels_formula(
    wanted: int, mask: int, sign: str, identifier: int, extended: bool, remote: bool
) -> None:
    """`received & mask == id & mask` on 32 bits, as the kernel's documentation says; no bit pattern raises."""
    identifier &= 0x1FFFFFFF if extended else 0x7FF
    frame = Frame(identifier, is_extended_id=extended, is_remote_frame=remote)
    received = identifier | extended << 31 | remote << 30
    text = f"{wanted:X}{sign}{mask:X}"
    wanted |= (wanted > 0xFFFFFFF) << 31
    mask &= 0xDFFFFFFF
    if mask >> 31 and not wanted >> 31:
        mask &= 0xC00007FF
    equal = received & mask == wanted & mask
    assert parse_filter(text).matches(frame) is (equal if sign == ":" else not equal)
