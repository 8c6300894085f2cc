"""What laws are asked with, and packets, drawn from a seed: the same seed gives the same on every machine."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from aces_bus.protocol import Message, Protocol, Variant
from aces_bus.testing import LAWS, laws
from aces_bus.testing.packets import DrawnPacket, draw_packet
from aces_bus.testing.source import spread

#: Laws by what they say.
ROUND_TRIP, ORACLE, CHUNKING, RESYNCHRONISATION, NO_FALSE_ACCEPT, ACCOUNTING = LAWS[:6]


def drawn_arguments(
    law: laws.Law, wire: laws.Wire, way: laws.Way, seed: int, *, entropy: int | None = None, **sizes: Any
) -> tuple[Any, ...]:
    """Return what `law` is asked with behind wire and direction: a scene, and where to cut it."""
    source = spread(seed) if entropy is None else spread(seed, entropy)
    return tuple(laws.draw_arguments(law, wire, way, source, **sizes))


def drawn_packet(message: Message, seed: int, variant: Variant | None = None) -> DrawnPacket:
    """Return a valid packet or frame of a message."""
    return draw_packet(message, spread(seed), variant)


def wires_of(protocol: Protocol) -> list[tuple[Variant, laws.Way]]:
    """Return each variant of a protocol with each of its directions."""
    return laws.wires(protocol)


def columns_agree(wire: laws.Wire, way: laws.Way, scene: laws.Scene, cuts: Iterable[int] = ()) -> None:
    """Assert that columns are what the scanner gives, in each of their modes."""
    laws.columns_law(wire, way, scene, cuts)
