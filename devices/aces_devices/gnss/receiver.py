"""What drivers of receivers have in common, whatever these speak: signals and settings.

1. SI: angles rad, lengths m, time in seconds since 1970 (UTC). Position without a fix is unknown, never the last one or 0.
2. A receiver sends by itself. A value is stale after two and a half periods: one lost message makes none stale, two do.
"""

from __future__ import annotations

from math import radians
from typing import Annotated, Any, ClassVar

import msgspec
from msgspec import Meta

from aces_bus.device import Device, HostLoss
from aces_bus.device.settings import settings_of
from aces_bus.errors import CallerError

from .earth import Origin

#: How many periods a value holds.
PERIODS = 2.5


class ReceiverSettings(msgspec.Struct, frozen=True, kw_only=True):
    """The keys in a robot file that all receivers have."""

    rate_hz: Annotated[
        float,
        Meta(
            gt=0,
            le=100,
            description="how often it says where it is (1 when absent), Hz: for its twin, and for what is stale",
        ),
    ] = 1.0
    origin: (
        Annotated[
            list[float],
            Meta(
                min_length=2,
                max_length=3,
                description="[latitude °, longitude °, height m]: `north`, `east` and `up` count from there",
            ),
        ]
        | None
    ) = None


#: Name, unit, text; which of them a receiver has, its protocol decides.
QUANTITIES: dict[str, tuple[str, str]] = {
    "fix": ("", "none, fix_2d, fix_3d, or what else its protocol names"),
    "quality": ("", "of what kind: none, gps, dgps, rtk_float, rtk_fixed, dead_reckoning"),
    "satellites": ("", "how many it uses"),
    "latitude": ("rad", "positive to the north"),
    "longitude": ("rad", "positive to the east"),
    "height": ("m", "above the ellipsoid WGS 84"),
    "altitude": ("m", "above mean sea level"),
    "north": ("m", "from the origin"),
    "east": ("m", "from the origin"),
    "up": ("m", "from the origin"),
    "velocity_north": ("m/s", ""),
    "velocity_east": ("m/s", ""),
    "velocity_down": ("m/s", ""),
    "speed": ("m/s", "over ground"),
    "course": ("rad", "over ground, from north over east; of one that rests it means nothing"),
    "horizontal_accuracy": ("m", "the receiver's estimate, one standard deviation"),
    "vertical_accuracy": ("m", "the receiver's estimate, one standard deviation"),
    "speed_accuracy": ("m/s", "the receiver's estimate, one standard deviation"),
    "time": ("s", "UTC since 1970"),
    "time_accuracy": ("s", "the receiver's estimate, one standard deviation"),
    "pdop": ("", "dilution of precision, in space"),
    "hdop": ("", "dilution of precision, horizontal"),
}
#: What only has a value while the receiver knows where it is.
LOCATED = frozenset(QUANTITIES) - {"fix", "quality", "satellites", "time", "time_accuracy", "pdop", "hdop"}


class Receiver(Device):
    """One receiver. A subclass names in `messages` which message gives which quantities, and calls `found` with them."""

    settings_type: ClassVar[type[ReceiverSettings]] = ReceiverSettings
    when_host_is_lost = HostLoss("nothing moves", "a receiver")
    messages: ClassVar[dict[str, tuple[str, ...]]]
    attributes = Device.attributes | {"settings", "origin"}

    @property
    def sends_every_s(self) -> float | None:
        """As the robot's file says."""
        return 1 / self.settings.rate_hz

    def setup(self) -> None:
        """Add a signal for each quantity; positions in metres if the file names an origin."""
        self.settings = settings_of(self.name, self.settings_type, self.config.settings)
        self.origin = origin_of(self.settings)
        given: dict[str, list[str]] = {}
        for message, names in self.messages.items():
            for name in names:
                given.setdefault(name, []).append(message)
        if self.origin is not None:
            given["north"] = given["east"] = given["latitude"]
            given["up"] = given["height"]
        for name, (unit, doc) in QUANTITIES.items():
            if name in given:
                self.add_signal(
                    name,
                    unit=unit,
                    read_from=given[name],
                    stale_s=PERIODS / self.settings.rate_hz,
                    doc=doc,
                    source=str(self.variant.protocol.source),
                )

    def found(self, instant: int, **values: Any) -> None:
        """Take what a message says; None: it is not known now."""
        origin = self.origin
        if origin is not None and "latitude" in values:
            latitude, longitude = values["latitude"], values["longitude"]
            north = east = None
            if latitude is not None and longitude is not None:
                north, east = origin.metres(latitude, longitude)
            values |= {"north": north, "east": east}
        if origin is not None and "height" in values:
            height = values["height"]
            values["up"] = None if height is None else height - origin.height
        for name, value in values.items():
            signal = self.signals[f"{self.name}.{name}"]
            if value is None:
                signal.forget()
            else:
                signal.update(value, instant)

    def lost(self) -> None:
        """Forget the position."""
        for name in LOCATED:
            signal = self.signals.get(f"{self.name}.{name}")
            if signal is not None:
                signal.forget()


def origin_of(settings: ReceiverSettings) -> Origin | None:
    """Return the origin that a file says. Raises `CallerError` for a place that is not on the Earth."""
    if settings.origin is None:
        return None
    latitude, longitude, *height = settings.origin
    if abs(latitude) > 90 or abs(longitude) > 180:
        raise CallerError(
            f"an origin is [latitude °, longitude °, height m]: {settings.origin} is not a place on the Earth"
        )
    return Origin(radians(latitude), radians(longitude), *height)
