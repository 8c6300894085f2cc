"""Notices that a device which sends by itself has fallen silent: nobody asks it, so that no answer is missed."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from ..runtime.clock import EventClock, Timer
from .device import Device
from .events import Kind

#: Between two looks (ns).
LOOK_NS = 50_000_000


class SilenceWatch:
    """Looks at devices that say how often they send (`Device.sends_every_s`), once they have sent.

    `emit` reports: kind, a device's name, details.
    """

    def __init__(
        self, clock: EventClock, devices: Mapping[str, Device], emit: Callable[[Kind, str, str], None]
    ) -> None:
        self._clock, self._devices, self._emit = clock, devices, emit
        self._timer: Timer | None = None

    def begin(self) -> None:
        """Look from now on, where some device sends by itself."""
        if any(device.sends_every_s is not None for device in self._devices.values()):
            self._timer = self._clock.call_in(LOOK_NS, self._look)

    def end(self) -> None:
        """Look no more."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _look(self) -> None:
        clock = self._clock
        self._timer = clock.call_in(LOOK_NS, self._look)
        now = clock.now()
        for device in self._devices.values():
            last = device.last_received
            if last is not None and not device.is_silent and self._is_missed(device, now - last):
                device.is_silent = True
                self._emit(
                    "silent",
                    device.name,
                    f"nothing came for {(now - last) / 1e9:.3f} s; it sends every {device.sends_every_s:g} s",
                )

    @staticmethod
    def _is_missed(device: Device, age_ns: int) -> bool:
        every_s = device.sends_every_s
        return every_s is not None and age_ns > device.silent_after * every_s * 1e9
