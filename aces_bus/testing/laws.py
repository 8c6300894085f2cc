"""The nine laws: what is true of every protocol, whatever comes over the wire.

1. Each law is a function of a wire (a variant, or several on one wire), a direction and a scene; it raises `LawError`,
   an `AssertionError` with what was expected, what came, and the scene to repeat it.
2. A law trusts nothing that it judges: the truth is construct, the reference, or arithmetic on the input.
3. Scenes are drawn by `strategies`, or by `draw_arguments` without Hypothesis; one made by hand does as well.

>>> from aces_bus.testing import laws
>>> from aces_protocols.robotis.spec import robotis
>>> wire = bytes.fromhex("FF FF 01 02 01 FB")
>>> laws.oracle(robotis.variant(), "to device", laws.Scene(wire))
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

from ..protocol.declare.message import DIRECTIONS
from ..protocol.declare.protocol import Protocol, Variant
from . import _laws_of_content as content
from . import _laws_of_flow as flow
from ._bench import bench_of
from ._columns import MODES
from ._exemptions import Exemption, exemptions
from ._laws_of_content import conflicts, part_accepted
from ._play import play, reference_items, scanned_items, scanner_of
from ._scenes import Scene, Way, Wire, adversary, draw_cuts, draw_scene, wire_variants
from ._source import ChoiceSource
from ._trial import NAMES, LawError, Trial
from ._values import DrawnPacket


def _trial(wire: Wire, direction: Way, scene: Scene, cuts: Iterable[int] = ()) -> Trial:
    return Trial(bench_of(wire, direction), scene, cuts)


def round_trip(wire: Wire, direction: Way, scene: Scene) -> None:
    """Law 1: `parse_raw(build_raw(r)) == r`, and `build(parse(f)) == f` for whatever is accepted, bit for bit."""
    content.check_round_trip(_trial(wire, direction, scene))


def oracle(wire: Wire, direction: Way, scene: Scene, cuts: Iterable[int] = ()) -> None:
    """Law 2: the generated scanner hears exactly what the reference tells, values and losses; and so do columns.

    Raw values against the reference; physical ones against construct, packet by packet; columns (`check_columns`)
    against the generated scanner.
    """
    content.check_oracle(_trial(wire, direction, scene, cuts))


def columns_law(
    wire: Wire,
    direction: Way,
    scene: Scene,
    cuts: Iterable[int] = (),
    *,
    modes: Iterable[tuple[bool, bool]] = MODES,
) -> None:
    """Law 2, of columns: a column scanner gives what the live one gives, value for value, cut at `cuts`.

    Raw and physical values, their types, what is absent, rows, times, channels and directions, losses and counts. A
    capture has words only: silences and transmissions of the scene are left out. `modes` are pairs of (raw, everything).
    """
    content.check_columns_agree(_trial(wire, direction, scene, cuts), modes)


def chunking(wire: Wire, direction: Way, scene: Scene, cuts: Iterable[int]) -> None:
    """Law 3: the same words with the same events give the same records, however they are cut."""
    flow.check_chunking(_trial(wire, direction, scene, cuts))


def resynchronisation(wire: Wire, direction: Way, scene: Scene) -> None:
    """Law 4: wherever a template is complete and its check holds, a record starts, or an accepted one covers a byte of it.

    A packet with no message, or a reply without its request, is whole by its framing and counts as accepted.
    """
    flow.check_resynchronisation(_trial(wire, direction, scene))


def no_false_accept(wire: Wire, direction: Way, scene: Scene) -> None:
    """Law 5: every record's bytes, read again by construct alone, satisfy template and check."""
    content.check_no_false_accept(_trial(wire, direction, scene))


def accounting(wire: Wire, direction: Way, scene: Scene, cuts: Iterable[int] = ()) -> None:
    """Law 6: every word ends in exactly one bin; records and losses tile the input; asking for less changes no count."""
    flow.check_accounting(_trial(wire, direction, scene, cuts))


def bounded(wire: Wire, direction: Way, scene: Scene, cuts: Iterable[int] = ()) -> None:
    """Law 7: the buffer holds `max_size` at most after each chunk, and checks read a bounded number of bytes.

    Sums, xor and Fletcher: twice the input plus O(1) a candidate. CRCs, and whatever is stuffed as a whole: `max_size` a
    candidate, so `max_size` ÷ header length a byte where headers stand side by side. Unstuffing itself is counted apart: a
    few times the input, and a small part of a packet a candidate.
    """
    flow.check_bounded(_trial(wire, direction, scene, cuts))


def calm(wire: Wire, direction: Way, scene: Scene, cuts: Iterable[int] = ()) -> None:
    """Law 8: no input raises from `feed`, nor from `idle`, `sent` and `close`, whenever they come."""
    flow.check_calm(_trial(wire, direction, scene, cuts))


def unambiguous(wire: Wire, direction: Way, scene: Scene) -> None:
    """Law 9: no two messages accept the same packet in one context, unless the spec orders them.

    What the checker calls disjoint is disjoint: no packet of one is accepted, whole or in part, by the other.
    """
    content.check_unambiguous(_trial(wire, direction, scene))


# ---------------------------------------------------------------------- all of them


def draw_arguments(
    law: Law, wire: Wire, direction: Way, source: ChoiceSource, *, size: int = 400
) -> tuple[Any, ...]:
    """What `law.holds(wire, direction, …)` takes besides: a scene of about `size` bytes, and cuts where it wants them."""
    cut_by = source.branch()
    if law.number == 7 and wire_variants(wire)[0].link != "can" and source.integer(0, 1):
        scene = Scene(adversary(wire, direction, source))
    else:
        scene = draw_scene(wire, direction, source, size=size)
    return (scene, draw_cuts(scene, cut_by)) if law.takes_cuts else (scene,)


def directions(variant: Variant) -> tuple[Way, ...]:
    """The directions in which a variant can be scanned, as far as they differ."""
    ways: list[Way] = [None]
    if variant.direction_conflict is not None:
        ways = ["both"]
    for way in DIRECTIONS:
        if 0 < len(variant.messages_for(way)) < len(variant.messages):
            ways.append(way)
    return tuple(ways)


def wires(protocol: Protocol) -> list[tuple[Variant, Way]]:
    """Every dialect of a protocol × shipped configuration × direction."""
    return [(variant, way) for variant in protocol.variants() for way in directions(variant)]


@dataclass(frozen=True)
class Law:
    """A law by its number. `holds(wire, direction, scene)` asks it of a scene; `takes_cuts` says that it wants to know
    where to cut that, too. `judges(trial)` is the same for a `Trial`, which several laws may share."""

    number: int
    holds: Callable[..., None]
    judges: Callable[[Trial], None]
    takes_cuts: bool = False
    #: Whether it is about streams only: a frame comes whole.
    streams_only: bool = False

    @property
    def name(self) -> str:
        return NAMES[self.number]

    def __str__(self) -> str:
        return f"{self.number}-{self.name.replace(' ', '-')}"


LAWS = (
    Law(1, round_trip, content.check_round_trip),
    Law(2, oracle, content.check_oracle, takes_cuts=True),
    Law(3, chunking, flow.check_chunking, takes_cuts=True),
    Law(4, resynchronisation, flow.check_resynchronisation),
    Law(5, no_false_accept, content.check_no_false_accept),
    Law(6, accounting, flow.check_accounting, takes_cuts=True),
    Law(7, bounded, flow.check_bounded, takes_cuts=True, streams_only=True),
    Law(8, calm, flow.check_calm, takes_cuts=True),
    Law(9, unambiguous, content.check_unambiguous),
)

__all__ = [
    "LAWS",
    "DrawnPacket",
    "Exemption",
    "Law",
    "LawError",
    "Scene",
    "Trial",
    "Way",
    "Wire",
    "accounting",
    "bounded",
    "calm",
    "chunking",
    "columns_law",
    "conflicts",
    "directions",
    "draw_arguments",
    "exemptions",
    "no_false_accept",
    "oracle",
    "part_accepted",
    "play",
    "reference_items",
    "resynchronisation",
    "round_trip",
    "scanned_items",
    "scanner_of",
    "unambiguous",
    "wire_variants",
    "wires",
]
