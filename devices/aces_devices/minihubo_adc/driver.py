"""MiniHubo's analogue-to-digital converter board: three channels that come without being asked.

1. It is alone on its line and has no number: its device has no credentials.
2. Counts, as the converter has them: nobody has stated what they measure.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

from aces_bus.device import Device
from aces_bus.errors import CallerError

CHANNELS = 3
SETTINGS: Mapping[str, str] = {
    "rate_hz": "how many samples a second it sends (default 100: not stated); for its twin, and for what counts as stale",
}


def rate_of(settings: Mapping[str, Any]) -> float:
    """Samples a second, by a robot file's settings. Raises `CallerError` for what is no rate."""
    rate = settings.get("rate_hz", 100)
    if isinstance(rate, bool) or not isinstance(rate, (int, float)) or not 0 < rate <= 100_000:
        raise CallerError(f"minihubo_adc: rate_hz = {rate!r}; a board sends some samples a second")
    return float(rate)


class MinihuboADC(Device):
    """The board: `ADC.channel_1` to `ADC.channel_3`, and `NAME.value` of each sensor that has one of them.

    A sensor's `channel` counts from 0, as everywhere in a robot's file.
    """

    protocol: ClassVar[Any] = "minihubo_adc"

    def setup(self) -> None:
        """One signal a channel, and one a sensor."""
        stale_s = max(0.1, 5 / rate_of(self.config.settings))
        for number in range(CHANNELS):
            self._channel(number, f"channel_{number + 1}", None, stale_s)
        for sensor in self.sensors:
            if sensor.channel is None or sensor.channel >= CHANNELS:
                raise CallerError(
                    f"{self.name}: sensor {sensor.name} has channel {sensor.channel}; there are 0, 1 and 2"
                )
            self._channel(sensor.channel, "value", sensor.name, stale_s)

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
