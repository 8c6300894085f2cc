"""`aces plot --bits` and `--raw`: what an image of flips says, and how identifiers are named."""

from __future__ import annotations

import random
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from aces_bus import Frame, FrameTable
from aces_bus.errors import CallerError
from aces_bus.frame_table import Channels
from aces_tools.plotting.bit_image import BINS, BitImages
from aces_tools.plotting.bits import BitPicture, bit_order, flip_rates, terminal_bits
from aces_tools.plotting.identifiers import choose_identifiers, parse_identifiers
from aces_tools.reading.traffic import BusIdentifier

from .conftest import Aces

EXTENDED = 1 << 31


@pytest.fixture
def bus(tmp_path: Path) -> Path:
    """Two seconds: 2A0 counts in byte 0 and has a bit that is set from 1 s on, then is silent; others come seldom."""
    lines: list[str] = []
    for n in range(200):
        at = n / 100
        if n < 150:
            lines.append(f"({1000 + at:.6f}) can0 2A0#{n & 255:02X}{0x80 if n >= 100 else 0:02X}\n")
        if n % 20 == 0:
            lines.append(f"({1000 + at + 0.001:.6f}) can0 000002A0#{n % 3:02X}\n")
    lines.append("(1001.995000) can0 7FF#AA\n")
    lines.append("(1001.996000) can0 100#R\n")
    path = tmp_path / "bus.log"
    path.write_text("".join(lines))
    return path


def image_of(frames: list[Frame], cut: int = 1 << 30) -> BitImages:
    images = BitImages()
    channels = Channels()
    for start in range(0, len(frames), cut):
        images.add(FrameTable.from_frames(frames[start : start + cut], channels))
    return images


# ---------------------------------------------------------------------- images


FRAMES = st.lists(st.tuples(st.integers(0, 10**10), st.binary(max_size=3)), min_size=1, max_size=80)


@given(FRAMES, st.integers(1, 80), st.booleans())
def test_an_image_has_every_frame_and_flip_once(
    drawn: list[tuple[int, bytes]], cut: int, is_ordered: bool
) -> None:
    """However long, unordered and cut: sums are those of plain loops, and each frame is in the bin of its time."""
    rows = sorted(drawn, key=lambda one: one[0]) if is_ordered else drawn
    images = image_of([Frame(0x10, data, us / 1e6, "can0") for us, data in rows], cut)
    (image,) = images.images.values()
    assert int(image.frames.sum()) == len(rows)
    flips = np.zeros(8 * image.length, int)
    ones = np.zeros(8 * image.length, int)
    before = b""
    for _, data in rows:
        for byte in range(len(data)):
            for bit in range(8):
                ones[8 * byte + bit] += data[byte] >> bit & 1
                if byte < len(before):
                    flips[8 * byte + bit] += (data[byte] ^ before[byte]) >> bit & 1
        before = data
    assert image.flips.sum(axis=0).tolist() == flips.tolist()
    assert image.ones.sum(axis=0).tolist() == ones.tolist()
    bins = np.zeros(BINS, int)
    for us, _ in rows:
        bins[(us * 1000 - images.start) // images.width] += 1
    assert image.frames.tolist() == bins.tolist()


def test_without_times_frames_are_counted() -> None:
    """The axis is the number of the frame."""
    images = image_of([Frame(0x10 + n % 2, bytes([n % 256]), None) for n in range(3000)], 700)
    assert not images.has_times
    assert images.width == 4
    assert images.seconds() == (0.0, 3000.0)
    assert [int(one.frames.sum()) for one in images.images.values()] == [1500, 1500]


def test_a_silence_is_a_gap_and_a_seldom_message_is_none() -> None:
    """Ten times a second for 10 s in bins of some ms, with nothing from 4 s to 6 s."""
    frames = [Frame(0x10, bytes([n % 2]), n / 10, "can0") for n in range(101) if not 40 < n < 60]
    images = image_of(frames)
    (image,) = images.images.values()
    begin, end, rates = flip_rates(images, image, 400)
    at = begin + (np.arange(rates.shape[1]) + 0.5) * (end - begin) / rates.shape[1]
    gone = np.isnan(rates[0])
    assert gone[(at > 4.3) & (at < 5.7)].all()
    assert not gone[(at < 3.9) | ((at > 6.2) & (at < 9.9))].any()
    assert np.nanmax(rates[7]) == 1  # bit 0 flips in each frame
    assert np.nanmax(rates[:7]) == 0


def test_bits_go_down_as_they_are_written() -> None:
    """Byte 0 on top, of each byte bit 7."""
    assert bit_order(2).tolist() == [7, 6, 5, 4, 3, 2, 1, 0, 15, 14, 13, 12, 11, 10, 9, 8]


def test_rates_are_shares_of_the_frames_that_have_the_bit() -> None:
    """Frames of two lengths in turn: a byte that only long ones have never follows itself."""
    frames = [Frame(0x10, bytes([n & 1]) + b"\xff" * (n % 2), n / 100, "can0") for n in range(200)]
    images = image_of(frames)
    (image,) = images.images.values()
    _, rates = image.rates(images.used, least=BINS)
    assert rates[0, 0] == pytest.approx(1)
    assert rates[0, 8:].tolist() == [0] * 8


# ---------------------------------------------------------------------- identifiers

THERE = [
    BusIdentifier("can0", 0x2A0),
    BusIdentifier("can1", 0x2A0),
    BusIdentifier("can0", 0x2A0 | EXTENDED),
    BusIdentifier("can0", 0x2A1),
    BusIdentifier("can0", 0x18FEF100 | EXTENDED),
]


@pytest.mark.parametrize(
    ("text", "meant"),
    [
        ("2A0", [0, 1]),
        ("0x2a0", [0, 1]),
        ("can1:2A0", [1]),
        ("000002A0", [2]),
        ("18FEF100", [4]),
        ("2A*", [0, 1, 3]),
        ("2A1,18fe*", [3, 4]),
        ("2a?", [0, 1, 3]),
    ],
)
def test_an_identifier_means(text: str, meant: list[int]) -> None:
    """As candump prints it: three digits are 11 bits, eight are 29."""
    assert choose_identifiers(parse_identifiers(text) or (), THERE) == [THERE[place] for place in meant]


def test_an_identifier_that_is_not_there_is_refused() -> None:
    """With those that are; what is not an identifier at all is not one."""
    with pytest.raises(
        CallerError, match=r"no frame has the identifier '123' \(there are: 2A0, 2A1, 000002A0, 18FEF100\)"
    ):
        choose_identifiers(parse_identifiers("123") or (), THERE)
    assert parse_identifiers("walk.log") is None
    assert parse_identifiers("2A0,") is None


# ---------------------------------------------------------------------- the command


def test_a_terminal_shows_bits_that_flip(aces: Aces, bus: Path) -> None:
    """A line a bit, the rest counted; no line is wider than the terminal."""
    result = aces("plot", bus, "--bits", "2A0")
    assert result.status == 0
    lines = result.out.splitlines()
    assert lines[0] == "2A0  150 frames, 7 bits constant"
    assert [line[:14].rstrip() for line in lines[1:10]] == [
        *(f" byte 0 bit {bit}" for bit in range(7, -1, -1)),
        " byte 1 bit 7",
    ]
    assert "█" in lines[8]
    assert max(map(len, lines)) <= 80
    assert aces("plot", "--bits", bus).out.splitlines()[0] == "2A0  150 frames"


def test_a_narrow_terminal_is_kept_to(bus: Path) -> None:
    """Whatever the width, and with ASCII alone."""
    from aces_bus import open_recording

    images = BitImages()
    with open_recording(str(bus), link="can") as capture:
        for table in capture.tables():
            images.add(table)
    picture = BitPicture(images, list(images.images.values()), "A title that is long beyond measure")
    for width in (20, 40, 200):
        text = terminal_bits(picture, width, is_rich=False, is_by_byte=True)
        assert max(map(len, text.splitlines())) <= width
        assert "100% of frames" in text
        assert text.isascii()


@pytest.mark.parametrize("suffix", ["png", "svg"])
def test_pictures_are_the_same_each_time(aces: Aces, bus: Path, tmp_path: Path, suffix: str) -> None:
    """Identifiers that came once are named and not drawn; units are on the axes."""
    pytest.importorskip("matplotlib")
    path = tmp_path / f"bits.{suffix}"
    result = aces("plot", bus, "--bits", "-o", path)
    assert (result.status, result.messages) == (0, ["not drawn: 1 identifier with one frame (7FF)"])
    first = path.read_bytes()
    if suffix == "svg":
        for label in ("2A0  150 frames", "000002A0  10 frames", "time in s", "byte"):
            assert f"<!-- {label} -->".encode() in first
    assert aces("plot", bus, "--bits", "-o", path, "-q").messages == []
    assert path.read_bytes() == first


@pytest.mark.slow
def test_fifty_identifiers_have_room(aces: Aces, tmp_path: Path) -> None:
    """Each has its image, in three columns; of FD frames no byte is missing."""
    pytest.importorskip("matplotlib")
    rng = random.Random(1)
    log = tmp_path / "many.log"
    log.write_text(
        "".join(
            f"({1000 + n / 100:.6f}) can0 {0x100 + n % 50:03X}#{rng.randbytes(1 + n % 50 % 8).hex()}\n"
            for n in range(500)
        )
        + "".join(f"({1005 + n / 100:.6f}) can0 7F0##0{rng.randbytes(64).hex()}\n" for n in range(5))
    )
    path = tmp_path / "many.svg"
    assert aces("plot", log, "--bits", "-o", path).status == 0
    text = path.read_text()
    assert text.count(" 10 frames -->") == 50
    assert "7F0 FD  5 frames" in text


def test_bytes_are_drawn_as_steps(aces: Aces, bus: Path, tmp_path: Path) -> None:
    """A panel a byte that changes, in the terminal and in a file; constant ones are said."""
    result = aces("plot", bus, "--raw", "2A0")
    assert result.status == 0
    assert [line for line in result.out.splitlines() if line.startswith("2A0")] == [
        "2A0  byte 0  value",
        "2A0  byte 1  value",
    ]
    assert "time in s" in result.out
    pytest.importorskip("matplotlib")
    path = tmp_path / "bytes.svg"
    assert aces("plot", bus, "--raw", "000002A0", "-o", path, "--from", "0.5").status == 0
    assert "<!-- 000002A0  byte 0 -->" in path.read_text()


def test_a_constant_byte_is_said(aces: Aces, tmp_path: Path) -> None:
    """And drawn where nothing else is."""
    log = tmp_path / "one.log"
    log.write_text("".join(f"({1000 + n}.000000) can0 100#{n:02X}FF\n" for n in range(9)))
    result = aces("plot", log, "--raw", "100")
    assert result.messages == ["100: not drawn, being constant: byte 1 is FF"]
    assert "byte 1  value" not in result.out


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["bus.log"], "which protocol? -p NAME; 'aces decode FILE' says which fit"),
        ([], "name a recording"),
        (["bus.log", "--bits", "--raw", "2A0"], "give one"),
        (["bus.log", "--raw", "xyz"], "'xyz' is not an identifier"),
        (["bus.log", "--raw", "123"], "no frame has the identifier '123' (there are: 2A0, 7FF, 000002A0)"),
        (["bus.log", "--bits", "123"], "no frame has the identifier '123'"),
        (["bus.log", "--bits", "100"], "nothing to draw"),
        (["bus.log", "--bits", "--from", "50"], "no frame is between --from and --to"),
        (["bus.log", "speed", "--bits"], "'speed' is not a file, and --bits takes no signals"),
        (["bus.log", "--bits", "-p", "hubo"], "--protocol is not for --bits"),
        (["bus.log", "--raw", "2A0", "--ymax", "3"], "--ymax is not for --raw"),
        (["none.log", "--bits"], "none.log"),
        (["raw.bin", "--bits"], "bytes of a serial line, which have no identifiers"),
        (["empty.log", "--bits"], "holds no frames"),
    ],
)
def test_a_wrong_call_is_refused(
    arguments: list[str], said: str, aces: Aces, bus: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In one line, with what would work, and status 2."""
    monkeypatch.chdir(bus.parent)
    Path("raw.bin").write_bytes(bytes(range(256)))
    Path("empty.log").write_text("# candump of nothing\n")
    result = aces("plot", *arguments)
    assert result.status == 2
    assert said in result.err
    assert len(result.err.splitlines()) == 1
