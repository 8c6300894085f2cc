"""What a raw number means: the steps that lead from the wire to the record."""

from __future__ import annotations

import msgspec


class Scale(msgspec.Struct, frozen=True):
    """physical = raw × scale + offset; raw values in `unknown` are None, those in `names` their name.

    `bounds` (physical) and `raw_bounds` are what may be sent; `rounding` is how a physical value becomes an integer.
    """

    scale: float
    offset: float
    unknown: tuple[float, ...] | range = ()
    bounds: tuple[float, float] | None = None
    raw_bounds: tuple[int, int] | None = None
    rounding: str = "nearest"
    #: (raw, name) of raw values that are not a quantity.
    names: tuple[tuple[int, str], ...] = ()

    def physical(self, raw: float) -> float:
        """Return a raw number in its unit, computed as everywhere."""
        scaled = raw * self.scale if self.scale != 1 else raw
        return scaled + self.offset if self.offset else scaled

    @property
    def unknown_runs(self) -> tuple[tuple[float, float], ...]:
        """The raw values that mean unknown, as (least, greatest) of each; a range is one."""
        if isinstance(self.unknown, range):
            low, high = sorted((self.unknown[0], self.unknown[-1]))  # its ends: min() would walk it
            return ((low, high),)
        return tuple((value, value) for value in self.unknown)

    @property
    def text(self) -> str:
        """The step in words."""
        scale = f"× {self.scale:.12g}" if self.scale != 1 else ""
        offset = f"{'+' if self.offset > 0 else '−'} {abs(self.offset):.12g}" if self.offset else ""
        runs = ["…".join(f"{value:g}" for value in dict.fromkeys(run)) for run in self.unknown_runs]
        unknown = f"unknown at {', '.join(runs)}" if runs else ""
        names = f"named at {', '.join(str(value) for value, _ in self.names)}" if self.names else ""
        sent = self.bounds or self.raw_bounds
        bounds = ""
        if sent is not None:
            bounds = f"sent in {sent[0]:g}…{sent[1]:g}{'' if self.bounds is not None else ' (raw)'}"
        return ", ".join(filter(None, [" ".join(filter(None, [scale, offset])), unknown, names, bounds]))

    @property
    def limits(self) -> tuple[float, float] | None:
        """Limits of values that may be sent, in the unit; None if there are none."""
        if self.bounds is not None or self.raw_bounds is None:
            return self.bounds
        low, high = sorted(raw * self.scale + self.offset for raw in self.raw_bounds)
        return low, high


class ScaleByBit(msgspec.Struct, frozen=True):
    """Scales of a number whose highest bit, `half`, is clear and set; the bits below it are scaled."""

    half: int
    scales: tuple[Scale, Scale]

    @property
    def text(self) -> str:
        """The step in words."""
        first, other = (scale.text or "× 1" for scale in self.scales)
        return f"{first} below {self.half:#x}, from there on {other}"

    @property
    def spans(self) -> list[tuple[float, float]]:
        """The least and the greatest value in either scale."""
        ends = [sorted(map(scale.physical, (0, self.half - 1))) for scale in self.scales]
        return [(low, high) for low, high in ends]


class ValueNames(msgspec.Struct, frozen=True):
    """Raw number to name."""

    values: tuple[tuple[int, str], ...]

    @property
    def text(self) -> str:
        """The step in words."""
        return f"{len(self.values)} names"


class FlagBits(msgspec.Struct, frozen=True):
    """Flag name to bit number."""

    bits: tuple[tuple[str, int], ...]

    @property
    def text(self) -> str:
        """The step in words."""
        return f"{len(self.bits)} flags"


class Magnitude(msgspec.Struct, frozen=True):
    """Sign and magnitude of `width` bits: part of the raw value, not of its meaning."""

    width: int

    @property
    def text(self) -> str:
        """The step in words."""
        return f"sign and magnitude of {self.width} bits"


Step = Scale | ScaleByBit | ValueNames | FlagBits | Magnitude
