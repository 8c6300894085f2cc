"""MiniHubo's analogue-to-digital converter board: three channels that come without being asked.

1. It is alone on its line and has no number: its device has no credentials.
2. Counts, as the converter has them: what they measure is not stated.
"""

from __future__ import annotations

from typing import Annotated

import msgspec
from msgspec import Meta

from aces_bus.device import Device, HostLoss
from aces_bus.device.settings import settings_of
from aces_bus.errors import CallerError

CHANNELS = 3


class AdcSettings(msgspec.Struct, frozen=True, kw_only=True):
    """The driver's own keys in a robot file."""

    rate_hz: Annotated[
        float,
        Meta(
            gt=0,
            le=100_000,
            description=(
                "how many samples a second it sends (default 100: not stated); for its twin, and for what counts as stale"
            ),
        ),
    ] = 100


class MinihuboADC(Device):
    """The board: `ADC.channel_1` to `ADC.channel_3`, and `NAME.value` of each sensor that has one of them.

    A sensor's `channel` counts from 0, as everywhere in a robot's file.
    """

    protocol = "minihubo_adc"
    when_host_is_lost = HostLoss("nothing moves", "a converter of analog inputs")

    def setup(self) -> None:
        """Add one signal a channel, and one a sensor."""
        settings = self.settings = settings_of(self.name, AdcSettings, self.config.settings)
        stale_s = max(0.1, 5 / settings.rate_hz)
        for number in range(CHANNELS):
            self._channel(number, f"channel_{number + 1}", None, stale_s)
        for sensor in self.sensors:
            if sensor.channel is None or sensor.channel >= CHANNELS:
                raise CallerError(
                    f"{self.name}: sensor {sensor.name} has channel {sensor.channel}; there are 0, 1 and 2"
                )
            self._channel(sensor.channel, "value", sensor.name, stale_s)

    @property
    def sends_every_s(self) -> float | None:
        """As the robot's file says."""
        return 1 / self.settings.rate_hz

    def _channel(self, number: int, name: str, owner: str | None, stale_s: float) -> None:
        self.add_signal(
            name,
            unit="count",
            of=f"Sample.channels.{number}",
            owner=owner,
            stale_s=stale_s,
            doc=f"Channel {number + 1}, 0 to 4095; mid-scale is 2048.",
            source="recording of the board",
        )
