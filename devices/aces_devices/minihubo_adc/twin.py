"""The simulated converter board: samples at a rate, of whatever function it is given.

1. It receives nothing. From power-up it sends one `Sample` a period.
2. Counts are those of a 12-bit converter: what is beyond is cut off.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import ClassVar

from aces_bus.device import Twin
from aces_bus.device.settings import settings_of

from .driver import CHANNELS, AdcSettings

TOP = 4095
#: The means of the recording (counts).
MEANS = (2314.52, 2802.51, 2050.72)
#: How far a channel swings around its mean, and how fast; a choice.
SWING, SWING_HZ = 5.0, 0.5


class MinihuboADCTwin(Twin):
    """The board. `source` gives the counts of all channels at an instant (ns), in place of `resting`."""

    protocol = "minihubo_adc"
    faults: ClassVar[Mapping[str, str]] = {
        "saturated": "all channels at the top of their range",
        "low_ff": "each sample's channel 3 ends in FF, so that FF FF FF comes before the next one",
    }

    source: Callable[[int], Sequence[float]] | None = None

    def setup(self) -> None:
        """Power up and begin to send."""
        self.samples = 0
        self.every(1 / settings_of(self.name, AdcSettings, self.config.settings).rate_hz, self._sample)

    def resting(self, now: int) -> Sequence[float]:
        """Return the recording's means, swinging a little, with a count of noise."""
        swing = SWING * math.sin(math.tau * SWING_HZ * now / 1e9)
        return [mean + swing + self.random.uniform(-1, 1) for mean in MEANS]

    def _sample(self) -> None:
        counts = [max(0, min(TOP, round(value))) for value in (self.source or self.resting)(self.clock.now())]
        counts += [0] * (CHANNELS - len(counts))
        if "saturated" in self.active_faults:
            counts = [TOP] * CHANNELS
        if "low_ff" in self.active_faults:
            counts[2] |= 0xFF
        self.samples += 1
        self.reply("Sample", delay_ns=0, channels=counts[:CHANNELS])
