"""What happens when several protocols share a bus: frames and packets that two of them claim.

1. On CAN it is decided exactly, over identifier × flags × length × constants; on streams a witness is looked for.
2. Frames are told by their bytes alone here: a bus does not say which way a frame went.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from ..declare.ambiguity import Conflict, conflict
from ..declare.examples import ExampleFrame
from ..declare.protocol import Variant
from .finding import Finding, Level

#: Collisions of two protocols that are named one by one.
SHOWN = 8


def check_wire(variants: Sequence[Variant], level: Level = "error", where: str = "") -> Iterator[Finding]:
    """The collisions of protocols on one bus, in the order in which they are tried; `where` names the bus."""
    for index, first in enumerate(variants):
        for second in variants[index + 1 :]:
            if first.link != second.link or first.protocol is second.protocol:
                continue
            if None not in (first.channel, second.channel) and first.channel != second.channel:
                continue
            yield from _collisions(first, second, level, where)


def _collisions(first: Variant, second: Variant, level: Level, where: str) -> Iterator[Finding]:
    clashes: list[Conflict] = []
    for one in first.messages.values():
        for other in second.messages.values():
            if one.framing is not None or not one.identifier.is_apart(other.identifier):
                clash = conflict(one, other)
                if clash is not None:
                    clashes.append(clash)
    clashes.sort(key=lambda clash: clash.witness is None)  # those with a packet to show first
    shown = SHOWN if first.link == "can" else 1
    for number, clash in enumerate(clashes[:shown], 1):
        one, other = clash.one, clash.other
        if one.protocol is not first.protocol:
            one, other = other, one
        more = len(clashes) - shown if number == min(shown, len(clashes)) else 0
        and_more = f" (and {more} more pair{'s' if more > 1 else ''} of messages)" if more > 0 else ""
        yield Finding(
            "warning" if clash.witness is None else level,
            "collision",
            other.place,
            f"{second.label} {other.name} collides with {first.label} {one.name} ({one.place}){where}:"
            f" {clash.how}{and_more}; {_advice(first)}",
            other.name,
            witness_of(clash),
            (one.place,),
        )


def _advice(first: Variant) -> str:
    if first.link == "can":
        return (
            "give each a channel of its own (-p can0=NAME); else the one that is named first is tried first"
        )
    return "they need lines of their own; else the one that is named first is tried first"


def witness_of(clash: Conflict) -> str | None:
    """A conflict's packet or frame, as `aces spec explain` takes it."""
    if clash.witness is None:
        return None
    if clash.identifier is None:
        return f"hex:{clash.witness.hex().upper()}"
    one = clash.one
    return str(ExampleFrame(clash.witness, clash.identifier, one.extended, one.remote, one.fd)).replace(
        " ", ""
    )


__all__ = ["check_wire", "witness_of"]
