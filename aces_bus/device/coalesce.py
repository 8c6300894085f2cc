"""Coalescing: the set-points of many devices become few frames or packets.

1. A rule is a function of all set-points of one message in one tick. Drivers declare theirs; the maker of a `Host`
   may give another.
2. A rule loses nothing: each set-point is in a message, or waits in its signal for the next tick.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING, Any

import msgspec

if TYPE_CHECKING:
    from .device import Device


class Setpoint(msgspec.Struct, frozen=True, gc=False):
    """One set-point that one device is to be given: `value` at `path` ("position.1") of `message`, in the sheet's unit."""

    device: Any
    message: str
    path: str
    value: Any


class OutgoingMessage(msgspec.Struct, frozen=True, gc=False):
    """One message that is to go out, of a device (or of all, with the first one's credentials overridden by `fields`).

    `carries` are the set-points in it where they are several devices': a stop of one of them takes its own out.
    """

    device: Any
    message: str
    fields: dict[str, Any]
    carries: Sequence[Setpoint] = ()


CoalescingRule = Callable[[Sequence[Setpoint]], Iterable[OutgoingMessage]]


def per_device(wants: Sequence[Setpoint]) -> Iterable[OutgoingMessage]:
    """Send one message a device, with all its channels: both motors of a board in one reference frame. The default.

    A channel that was never given a set-point has none: its device waits until all have one, unless it says what to send
    in its place (`Device.default_of`).
    """
    grouped: dict[int, list[Setpoint]] = {}
    for want in wants:
        grouped.setdefault(id(want.device), []).append(want)
    for mine in grouped.values():
        device: Device = mine[0].device
        fields = device.gathered(mine[0].message, mine)
        if fields is not None:
            yield OutgoingMessage(device, mine[0].message, fields)


def uncoalesced(wants: Sequence[Setpoint]) -> Iterable[OutgoingMessage]:
    """Send one message a set-point, to measure what coalescing saves. Other channels repeat their last set-points."""
    for want in wants:
        fields = want.device.gathered(want.message, [want])
        if fields is not None:
            yield OutgoingMessage(want.device, want.message, fields)
