"""Recordings cost time in proportion to their length, whatever is in them. Calls are counted, not time."""

from __future__ import annotations

import io

import pytest

from aces_bus import open_recording
from aces_bus.errors import CaptureError
from tests.counting import calls
from tests.recordings.formats import SAMPLES, Sample

#: Bytes of damage behind a recording, once and twice.
SIZE = 6_000
#: Twice the bytes may cost so much more than twice the calls.
MARGIN = 1.2


def read(content: bytes) -> None:
    """All of a recording; what it says of damage is its business."""
    try:
        for _ in open_recording(io.BytesIO(content)):
            pass
    except CaptureError:
        pass


def damage(sample: Sample, size: int) -> list[bytes]:
    """Itself again and again, the worse half of it, one byte, line ends."""
    content = sample.content
    half = content[len(content) // 2 :]
    return [(unit * (size // len(unit) + 1))[:size] for unit in (content, half, b"\xff", b"\n", b"( can0 ")]


@pytest.mark.parametrize("sample", SAMPLES, ids=lambda sample: sample.format)
def test_damage_costs_in_proportion(sample: Sample) -> None:
    """Behind a recording stands what is none: twice as much of it, twice the calls."""
    for one, two in zip(damage(sample, SIZE), damage(sample, 2 * SIZE), strict=True):
        read(sample.content + one)  # what is imported and made once
        work = [calls(lambda part=part: read(sample.content + part)) for part in (one, two)]  # type: ignore[misc]
        assert work[1] <= 2 * MARGIN * work[0] + 2000, (one[:20], work)
