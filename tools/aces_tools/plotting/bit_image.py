"""Frames of each identifier over time, without knowing what they mean: how many, and how often each bit is set or flips.

1. Time is divided into at most `BINS` equal stretches. When a recording goes on beyond them, each two become one: memory is
   bounded, and nothing needs to be known of the recording's end.
2. A bin without a frame is a gap, and not a zero. `rates` joins bins where a message comes less often than there are bins.
3. Where the recording has no times, frames are counted instead.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from aces_bus import FrameTable
from aces_bus.frame_table import NO_TIME, widened
from aces_bus.frames import REMOTE

from ..reading.traffic import BusIdentifier, identifier_groups
from .series import Array

#: Stretches of time; a picture has about as many pixels.
BINS = 1024
#: Identifiers of which images are kept: 256 KB each of 8-byte frames, eight times that of 64-byte ones.
MOST_IMAGES = 256
#: Frames that are not further apart than this many times the usual are not a gap.
NEAR = 2
#: The first width of a bin (ns), and without times in frames.
FIRST_NS, FIRST_FRAMES = 1000, 1


@dataclass
class BitImage:
    """One identifier: arrays by bin, and by bin and bit. Bit 8 x byte + k is bit k of the byte, 0 the lowest."""

    identifier: BusIdentifier
    frames: Array = field(default_factory=lambda: np.zeros(BINS, np.uint32))
    #: Frames that another one went before, from which a bit may flip.
    steps: Array = field(default_factory=lambda: np.zeros(BINS, np.uint32))
    ones: Array = field(default_factory=lambda: np.zeros((BINS, 0), np.uint32))
    flips: Array = field(default_factory=lambda: np.zeros((BINS, 0), np.uint32))
    #: Frames in which each bit is there at all.
    there: Array = field(default_factory=lambda: np.zeros((BINS, 0), np.uint32))
    length: int = 0
    _last: tuple[Array, int] | None = None

    @property
    def arrays(self) -> tuple[str, ...]:
        """The names of all arrays by bin."""
        return ("frames", "steps", "ones", "flips", "there")

    def add(self, data: Array, lengths: Array, bins: Array) -> None:
        """Add frames in order, and the bin of each."""
        longest = int(lengths.max(initial=0))
        if longest > self.length:
            more = ((0, 0), (0, 8 * (longest - self.length)))
            self.ones, self.flips, self.there = (
                np.pad(array, more) for array in (self.ones, self.flips, self.there)
            )
            self.length = longest
        width = self.length
        data = widened(data, width)[:, :width]
        before, before_length = self._last or (data[0], 0)
        before = widened(before[None], width)[0, :width]
        previous = np.concatenate((before[None], data[:-1]))
        previous_lengths = np.concatenate(([before_length], lengths[:-1]))
        there = np.arange(width) < lengths[:, None]
        both = there & (np.arange(width) < previous_lengths[:, None])
        flipped = np.where(both, data ^ previous, 0).astype(np.uint8)
        follows = np.ones(len(data), np.uint32)
        follows[0] = self._last is not None
        self._last = data[-1], int(lengths[-1])
        if (bins[1:] < bins[:-1]).any():
            order = np.argsort(bins, kind="stable")
            bins, data, flipped = bins[order], data[order], flipped[order]
            there, follows = there[order], follows[order]
        starts = np.flatnonzero(np.concatenate(([True], bins[1:] != bins[:-1])))
        which = bins[starts]
        self.frames[which] += np.diff(np.append(starts, len(bins))).astype(np.uint32)
        self.steps[which] += np.add.reduceat(follows, starts)
        if width:
            masked = np.where(there, data, 0).astype(np.uint8)
            for target, source in ((self.ones, masked), (self.flips, flipped)):
                bits = np.unpackbits(source, axis=1, bitorder="little")
                target[which] += np.add.reduceat(bits, starts, axis=0, dtype=np.uint32)
            seen = np.add.reduceat(there, starts, axis=0, dtype=np.uint32)
            self.there[which] += np.repeat(seen, 8, axis=1)

    def halve(self) -> None:
        """Join each two bins to one."""
        for name in self.arrays:
            array = getattr(self, name)
            joined = array.reshape(BINS // 2, 2, *array.shape[1:]).sum(axis=1, dtype=np.uint32)
            array[: BINS // 2], array[BINS // 2 :] = joined, 0

    def shift(self, bins: int) -> None:
        """Make room for so many earlier bins."""
        for name in self.arrays:
            array = getattr(self, name)
            array[bins:] = array[:-bins].copy()
            array[:bins] = 0

    def coarseness(self) -> int:
        """Return how many bins belong together so that a message that comes regularly has no gaps: four of five are no
        further apart."""
        places = np.flatnonzero(self.frames)
        if len(places) < 2:
            return 1
        return int(np.quantile(np.diff(places), 0.8, method="higher"))

    def joined(self, array: Array, count: int, used: int) -> Array:
        """Return an array's first `used` bins, `count` at a time."""
        size = -(-used // count)
        padded = np.zeros((size * count, *array.shape[1:]), np.int64)
        padded[:used] = array[:used]
        sums: Array = padded.reshape(size, count, *array.shape[1:]).sum(axis=1)
        return sums

    def _between(self, count: int, used: int) -> Array:
        """Return which joined bins without a frame are between two frames that are not further apart than usual: no gaps."""
        places = np.flatnonzero(self.frames[:used])
        near = np.flatnonzero(np.diff(places) <= NEAR * self.coarseness())
        edges = np.zeros(used + 1, np.int64)
        np.add.at(edges, places[near], 1)
        np.add.at(edges, places[near + 1], -1)
        return self.joined(np.cumsum(edges)[:used], count, used) > 0

    def rates(self, used: int, least: int = 1) -> tuple[int, Array]:
        """Return how many bins are joined (at least `least`), and the share of frames in which each bit flips: (bins,
        bits), NaN in gaps."""
        count = max(least, self.coarseness())
        steps = self.joined(self.steps, count, used)[:, None]
        flips = self.joined(self.flips, count, used)
        there = self.joined(self.there, count, used)
        held = self._between(count, used)[:, None]
        return count, np.where((there > 0) | held, flips / np.maximum(1, np.minimum(steps, there)), np.nan)

    def shares(self, used: int, least: int = 1) -> tuple[int, Array]:
        """Return the same for the share of frames in which each bit is set; between two frames as in the one before."""
        count = max(least, self.coarseness())
        ones, there = self.joined(self.ones, count, used), self.joined(self.there, count, used)
        found = np.where(there > 0, ones / np.maximum(1, there), np.nan)
        for row in np.flatnonzero(
            self._between(count, used) & (self.joined(self.frames, count, used) == 0)
        ).tolist():
            found[row] = found[row - 1] if row else found[row]
        return count, found


class BitImages:
    """The images of a recording; `start` and `width` of a bin are in ns, or in frames where `has_times` is not set."""

    def __init__(self) -> None:
        self.images: dict[BusIdentifier, BitImage] = {}
        #: Identifiers for which there was no room, and frames without a time where others have one.
        self.left_out: set[BusIdentifier] = set()
        self.timeless = 0
        self.has_times: bool | None = None
        self.start = self.end = 0
        self.width = FIRST_NS
        self._frames = 0

    @property
    def used(self) -> int:
        """Bins up to the last frame."""
        return max(1, min(BINS, (self.end - self.start) // self.width + 1))

    @property
    def unit(self) -> float:
        """Length of a second, or of a frame, in the unit of `width` and `start`."""
        return 1e9 if self.has_times else 1.0

    def add(self, table: FrameTable) -> None:
        """Add frames in the order of the recording."""
        if not len(table):
            return
        if self.has_times is None:
            self.has_times = bool((table.time != NO_TIME).any())
            self.width = FIRST_NS if self.has_times else FIRST_FRAMES
        if self.has_times:
            known = table.time != NO_TIME
            if not known.all():
                self.timeless += int(np.count_nonzero(~known))
                table = table.take(np.flatnonzero(known))
            places = table.time
        else:
            places = np.arange(self._frames, self._frames + len(table))
            self._frames += len(table)
        if not len(table):
            return
        self._fit(int(places.min()), int(places.max()))
        bins = (places - self.start) // self.width
        for identifier, rows in identifier_groups(table):
            image = self.images.get(identifier)
            if image is None:
                if len(self.images) >= MOST_IMAGES:
                    self.left_out.add(identifier)
                    continue
                image = self.images[identifier] = BitImage(identifier)
            lengths = np.zeros(len(rows), np.uint8) if identifier.key & REMOTE else table.length[rows]
            image.add(table.data[rows], lengths, bins[rows])

    def _fit(self, first: int, last: int) -> None:
        """Have bins from the first place to the last."""
        if not self.images:
            self.start = self.end = first
        self.end = max(self.end, last)
        low = min(self.start, first)
        while (self.end - low) // self.width + 2 > BINS:  # one more: earlier bins begin on the grid of these
            self.width *= 2
            for image in self.images.values():
                image.halve()
        if first < self.start:
            earlier = -(-(self.start - first) // self.width)
            self.start -= earlier * self.width
            for image in self.images.values():
                image.shift(earlier)

    def seconds(self, origin: int | None = None) -> tuple[float, float]:
        """Return the limits of the axis from `origin` (default: the first frame): seconds, or frames."""
        zero = self.start if origin is None else origin
        return (self.start - zero) / self.unit, (self.start + self.used * self.width - zero) / self.unit

    def begin(self, image: BitImage, origin: int | None = None) -> float:
        """Return when the first frame of an image came: its joined bins may begin before it."""
        (there,) = image.frames.nonzero()
        place = int(there[0]) if len(there) else 0
        return self.extent(1, place, origin)[1]

    def extent(self, count: int, size: int, origin: int | None = None) -> tuple[float, float]:
        """Return the limits of an array of `size` columns of `count` bins each."""
        begin, _ = self.seconds(origin)
        return begin, begin + size * count * self.width / self.unit
