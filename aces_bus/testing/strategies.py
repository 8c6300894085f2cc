"""Hypothesis strategies of a protocol: fields, packets, wires; and of whole protocols.

1. Values are valid by construction; damage comes after, on purpose.
2. One message is drawn number by number, and shrinks to the simplest numbers. A wire is made of one string of bytes (see
   `aces_bus.testing.source`), which is cheap enough for hundreds of thousands of examples, and shrinks as bytes do.

Needs the extra `[testing]`.
"""

from __future__ import annotations

from typing import Any

from ..protocol.record import FieldValue

try:
    from hypothesis import strategies as st
except ImportError as missing:
    raise ImportError(
        "aces_bus.testing.strategies needs Hypothesis: pip install 'aces-bus[testing]'"
    ) from missing

from ..protocol.declare.message import Message
from ..protocol.declare.protocol import Variant
from ..protocol.protocol import Protocol
from .laws import Law, draw_arguments
from .packets import DrawnPacket, draw_packet, draw_values
from .scenes import Scene, Way, Wire, adversary, draw_cuts, draw_frames, draw_scene, draw_stream
from .source import Drawn, Entropy
from .specs import Link, draw_spec, protocol_of


def _drawn(draw: st.DrawFn) -> Drawn:
    return Drawn(
        lambda low, high: draw(st.integers(low, high)),
        lambda size: draw(st.binary(min_size=size, max_size=size)),
    )


@st.composite
def fields(draw: st.DrawFn, message: Message) -> dict[str, FieldValue]:
    """Draw raw values of all fields of `message`: `message.struct.build(values, raw=True)` takes them."""
    return draw_values(message, _drawn(draw))


@st.composite
def packets(
    draw: st.DrawFn, variant: Variant, direction: Way = None, message: str | None = None
) -> DrawnPacket:
    """Return a valid packet or frame of a variant, with a request that it answers where it answers one.

    `message` names the one wanted; else it is any that can occur in `direction`.
    """
    messages = [variant[message]] if message is not None else variant.messages_for(direction)
    return draw_packet(draw(st.sampled_from(messages)), _drawn(draw), variant)


def entropy(size: int) -> st.SearchStrategy[Entropy]:
    """Return what wires are made of: up to about `size` bytes' worth of choices."""
    # Read from its end: what Hypothesis shrinks to zero, the front, is then the tail that a scene does without.
    return st.binary(min_size=size // 2, max_size=size).map(lambda data: Entropy(data[::-1]))


def streams(wire: Wire, direction: Way = None, *, size: int = 400) -> st.SearchStrategy[Scene]:
    """Draw byte streams of about `size` bytes: packets of all messages of the wire, whole and damaged, and garbage."""
    return entropy(size // 3).map(lambda source: draw_stream(wire, direction, source, size=size))


def frames(wire: Wire, direction: Way = None, *, size: int = 24) -> st.SearchStrategy[Scene]:
    """Draw about `size` CAN frames: valid ones, nearly valid ones, and others."""
    return entropy(5 * size).map(lambda source: draw_frames(wire, direction, source, size=size))


def scenes(wire: Wire, direction: Way = None, *, size: int = 400) -> st.SearchStrategy[Scene]:
    """Draw `streams` or `frames`, as the wire's link is; some streams are long enough for the scanner's long
    strides.
    """
    return entropy(size // 3).map(lambda source: draw_scene(wire, direction, source, size=size))


def adversaries(wire: Wire, direction: Way = None, *, size: int = 3000) -> st.SearchStrategy[Scene]:
    """Draw streams of headers that all promise long packets: what costs a scanner most."""
    return entropy(32).map(lambda source: Scene(adversary(wire, direction, source, size=size)))


def cuts(scene: Scene) -> st.SearchStrategy[tuple[int, ...]]:
    """Return where to cut a scene into chunks: anywhere, regularly, or at every byte or frame."""
    return entropy(32).map(lambda source: draw_cuts(scene, source))


def arguments(
    law: Law, wire: Wire, direction: Way = None, *, size: int = 400
) -> st.SearchStrategy[tuple[Any, ...]]:
    """Return what `law(wire, direction, …)` takes besides: a scene, and cuts where it wants them."""
    return entropy(size // 3).map(lambda source: draw_arguments(law, wire, direction, source, size=size))


def specs(*, link: Link | None = None) -> st.SearchStrategy[str]:
    """Draw Python source of random protocols, each named `drawn`, on CAN or on a serial line.

    Random identifiers with captures, layouts, numbers, enumerations, multiplexed fields; framings with length fields, end
    marks, fixed sizes, stuffing and checks.
    """
    return entropy(400).map(lambda source: draw_spec(source, link))


def protocols(*, link: Link | None = None) -> st.SearchStrategy[Protocol]:
    """Return the protocols of `specs`, declared: whatever holds for every protocol can be tested on these."""
    return specs(link=link).map(protocol_of)


__all__ = ["fields", "packets", "scenes"]
