"""What ISA-L inflates is what zlib inflates, also where there is damage."""

from __future__ import annotations

import gzip
import random
import zlib
from pathlib import Path

import pytest

from aces_bus.errors import CaptureError
from aces_bus.recordings import inflate
from aces_bus.recordings.inflate import inflate_first, inflate_whole
from aces_bus.recordings.source import ByteSource

pytest.importorskip("isal")

SOURCE = random.Random(1)
#: Some of it packs well, some does not; three members, one of them empty.
DATA = b"".join(SOURCE.choice((b"walk " * 40, SOURCE.randbytes(90))) for _ in range(900))
PACKED = gzip.compress(DATA[:60_000]) + gzip.compress(b"") + gzip.compress(DATA[60_000:], 1)


def read(path: Path) -> tuple[bytes, str]:
    """All bytes of a file, and what is said then."""
    source = ByteSource(path)
    out = bytearray()
    try:
        for block in source.blocks():
            out += block
    except CaptureError as error:
        return bytes(out), str(error)
    return bytes(out), ""


def both(path: Path, packed: bytes, monkeypatch: pytest.MonkeyPatch) -> list[tuple[bytes, str]]:
    """What is read with ISA-L, and with zlib alone."""
    path.write_bytes(packed)
    found = [read(path)]
    with monkeypatch.context() as patch:
        patch.setattr(inflate, "_isal", lambda: None)
        found.append(read(path))
    return found


@pytest.mark.slow
def test_gzip_is_read_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whole, cut anywhere, or with bytes that are wrong: the same bytes, and the same place of the damage."""
    path = tmp_path / "walk.log.gz"
    fast, slow = both(path, PACKED, monkeypatch)
    assert fast == slow == (DATA, "")
    for place in (1, 3, 11, 200, *SOURCE.sample(range(len(PACKED)), 25), len(PACKED) - 3):
        fast, slow = both(path, PACKED[:place], monkeypatch)
        assert fast == slow
        flipped = bytearray(PACKED)
        flipped[place] ^= 1 << SOURCE.randrange(8)
        fast, slow = both(path, bytes(flipped), monkeypatch)
        assert fast == slow


def test_streams_of_zlib_are_inflated_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whole ones, first bytes, and those that are damaged."""
    packed = zlib.compress(DATA)
    assert inflate_whole(packed, 10) == DATA
    assert inflate_first(packed, 100) == DATA[:100]
    assert inflate_first(packed, len(DATA) + 1) == DATA
    assert inflate_first(packed[:1000], len(DATA)) == zlib.decompressobj().decompress(packed[:1000])
    wrong = packed[:-1] + bytes([packed[-1] ^ 1])
    with pytest.raises(zlib.error):
        inflate_whole(wrong, 10)
    with pytest.raises(zlib.error):
        inflate_first(wrong, len(DATA) + 1)
    monkeypatch.setattr(inflate, "_isal", lambda: None)
    assert inflate_whole(packed, 10) == inflate_first(packed, len(DATA) + 1) == DATA
