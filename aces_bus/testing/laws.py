"""The nine laws: what is true of every protocol, whatever comes over the wire.

1. Each law is a function of a wire (a variant, or several on one wire), a direction and a scene; it raises
   `AssertionError` with what was expected, what came, and the scene to repeat it.
2. A law trusts nothing that it judges: the truth is construct, the reference, or arithmetic on the input.
3. Scenes are drawn by `strategies`, or by `draw_arguments` without Hypothesis; one made by hand does as well.

>>> from aces_bus.testing import laws
>>> from aces_protocols.robotis.spec import robotis
>>> wire = bytes.fromhex("FF FF 01 02 01 FB")
>>> laws.oracle(robotis.variant(), "to device", laws.Scene(wire))
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, NoReturn

from construct import ConstructError

from ..errors import AcesError
from ..protocol.scan.can import CanScanner
from ..protocol.scan.record import Unknown
from ..protocol.scan.stream import StreamScanner
from ..protocol.spec.ambiguity import Conflict, conflict, needing_context, unresolved
from ..protocol.spec.framing import Framing, Verdict
from ..protocol.spec.message import DIRECTIONS, Message
from ..protocol.spec.protocol import Protocol, Variant
from ._columns import MODES, difference
from ._exemptions import Exemption, are_excused, exemptions
from ._play import copied, heard, image_of, plain, play, scanner_of, told
from ._scenes import Scene, Way, Wire, adversary, cast, draw_cuts, draw_scene, variants_of
from ._source import Source
from ._values import Packet


def _fail(number: int, wire: Wire, direction: Way, text: str, scene: Scene | None = None) -> NoReturn:
    label = " + ".join(v.label for v in variants_of(wire))
    where = "" if scene is None else f"\n  scene: {_shown(scene)}"
    raise AssertionError(
        f"law {number} ({LAWS[number - 1].name}) of {label}, direction {direction!r}: {text}{where}"
    )


def _shown(scene: Scene) -> str:
    if isinstance(scene.words, bytes):
        words = f"bytes.fromhex({scene.words.hex(' ').upper()!r})"
        sent = tuple((at, f"bytes.fromhex({word.hex(' ').upper()!r})") for at, word in scene.sent_at)
        return f"Scene({words}, idle_at={scene.idle_at}, sent_at={sent})"
    return f"Scene(({', '.join(map(repr, scene.words))},), sent_at={scene.sent_at!r})"


def _is_can(wire: Wire) -> bool:
    return variants_of(wire)[0].link == "can"


# ---------------------------------------------------------------------- 1


def round_trip(wire: Wire, direction: Way, scene: Scene) -> None:
    """Law 1: `parse_raw(build_raw(r)) == r`, and `build(parse(f)) == f` for whatever is accepted, bit for bit."""
    for packet in scene.packets:
        _values_survive(wire, direction, packet)
    for message, image, request in _accepted(wire, direction, scene):
        parsed = message.struct.parse(image, raw=True, request=request)
        try:
            rebuilt = bytes(message.struct.build(parsed, raw=True))
        except (ConstructError, AcesError, KeyError, TypeError, AttributeError) as error:
            _fail(1, wire, direction, f"{message.name} {image.hex()} cannot be built back: {error!r}")
        if rebuilt == image:
            continue
        text = f"{message.name} {image.hex()} comes back as {rebuilt.hex()} ({plain(parsed)})"
        if not are_excused(message, image, rebuilt):
            _fail(1, wire, direction, text)
        if plain(message.struct.parse(rebuilt, raw=True, request=request)) != plain(parsed):
            _fail(1, wire, direction, f"{text}, which reads otherwise")


def _values_survive(wire: Wire, direction: Way, packet: Packet) -> None:
    message, image = packet.message, packet.image
    request = packet.request.values if packet.request is not None else _asked(message, packet.values)
    try:
        parsed = plain(message.struct.parse(image, raw=True, request=request))
    except (ConstructError, AcesError) as error:
        _fail(
            1,
            wire,
            direction,
            f"{message.name} built from {plain(packet.values)} is not read again: {image.hex()}: {error!r}",
        )
    wanted = plain(packet.values)
    if {k: parsed.get(k) for k in wanted} != wanted:
        _fail(1, wire, direction, f"{message.name}: {wanted} comes back as {parsed} ({image.hex()})")


def _asked(message: Message, values: Any) -> dict[str, Any]:
    return {name: values.get(name) for name in message.request_fields}


@lru_cache(maxsize=1024)
def _by_name(variants: tuple[Variant, ...], direction: Way) -> dict[tuple[str, str], Message]:
    return {(v.name, m.name): m for v, m in cast(variants, direction).messages}


def _accepted(wire: Wire, direction: Way, scene: Scene) -> Iterable[tuple[Message, bytes, Any]]:
    """Message, image and request's fields of each record in a scene."""
    names = _by_name(variants_of(wire), direction)
    given = play(scanner_of(wire, direction), scene)
    for number, record in enumerate(given):
        if isinstance(record, Unknown):
            continue
        message = names[record.meta.protocol, type(record).__name__]
        image = image_of(scene.words[number]) if message.framing is None else record.meta.raw
        yield message, image, {name: getattr(record, name) for name in message.request_fields}


# ---------------------------------------------------------------------- 2, 3


def oracle(wire: Wire, direction: Way, scene: Scene, cuts: Iterable[int] = ()) -> None:
    """Law 2: the generated scanner hears exactly what the reference tells, values and losses; and so do columns.

    Raw values against the reference; physical ones against construct, packet by packet; columns (`check_columns`)
    against the generated scanner.
    """
    wanted = told(wire, direction, scene)
    got = heard(scanner_of(wire, direction), scene)
    if got != wanted:
        _fail(2, wire, direction, _first_difference("the reference", wanted, "the scanner", got), scene)
    physical = heard(scanner_of(wire, direction, raw=False), scene)
    names = _by_name(variants_of(wire), direction)
    physically: list[Any] = []
    for item in got:
        if item.message is None:
            wanted_item = item
        else:
            message = names[item.protocol or "", item.message]
            request = {name: item.fields[name] for name in message.request_fields}
            image = (
                image_of(scene.words[item.offset])
                if _is_can(wire)
                else scene.words[item.offset : item.offset + item.size]
            )
            wanted_item = replace(item, fields=plain(message.struct.parse(image, request=request)))
        physically.append(wanted_item)
    if physical != physically:
        _fail(
            2,
            wire,
            direction,
            "physical: " + _first_difference("construct", physically, "the scanner", physical),
            scene,
        )
    cuts = tuple(cuts)
    mode = MODES[
        (len(scene) + len(cuts)) % len(MODES)
    ]  # one a scene: a column scanner costs more than a scene
    check_columns(wire, direction, scene, cuts, modes=(mode,))


def check_columns(
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
    cuts = tuple(sorted(cuts))
    for raw, everything in modes:
        live = scanner_of(wire, direction, raw=raw)
        said = difference(wire, direction, scene, cuts, live, raw=raw, everything=everything)
        if said:
            how = f"columns (raw={raw}, everything={everything}), cut at {cuts}: "
            _fail(2, wire, direction, how + said, scene)


def chunking(wire: Wire, direction: Way, scene: Scene, cuts: Iterable[int]) -> None:
    """Law 3: the same words with the same events give the same records, however they are cut."""
    cuts = tuple(cuts)
    whole = heard(scanner := scanner_of(wire, direction), scene)
    counts = copied(scanner.counts)
    pieces = heard(scanner := scanner_of(wire, direction), scene, cuts)
    if pieces != whole:
        _fail(
            3,
            wire,
            direction,
            f"cut at {cuts}: " + _first_difference("whole", whole, "in pieces", pieces),
            scene,
        )
    if copied(scanner.counts) != counts:
        _fail(
            3, wire, direction, f"cut at {cuts}: counts {copied(scanner.counts)} instead of {counts}", scene
        )


def _first_difference(one: str, first: list[Any], other: str, second: list[Any]) -> str:
    for a, b in zip(first, second, strict=False):
        if a != b:
            return f"{one} says {a}; {other} says {b}"
    longer, items = (one, first) if len(first) > len(second) else (other, second)
    return f"only {longer} has {items[min(len(first), len(second))]}"


# ---------------------------------------------------------------------- 4, 5


def resynchronisation(wire: Wire, direction: Way, scene: Scene) -> None:
    """Law 4: wherever a template is complete and its check holds, a record starts, or an accepted one covers a byte of it.

    A packet with no message, or a reply without its request, is whole by its framing and counts as accepted.
    """
    given = heard(scanner_of(wire, direction), scene)
    if _is_can(wire):
        who = cast(wire, direction)
        bound = _contextual(variants_of(wire), direction)
        for number, frame in enumerate(scene.words):
            if (
                frame.is_error_frame
                or given[number].message
                or given[number].reason.startswith("unknown: needs")
            ):
                continue
            image = image_of(frame)
            for variant, message in who.messages:
                if (variant.name, message.name) not in bound and _reads(message, image):
                    _fail(
                        4,
                        wire,
                        direction,
                        f"frame {number} is {message.name}, but was {given[number].reason}",
                        scene,
                    )
        return
    covered = bytearray(len(scene))
    for item in given:
        if item.message or item.reason.startswith("unknown"):
            covered[item.offset : item.offset + item.size] = b"\1" * item.size
    ends = [*scene.idle_at, len(scene)]
    begin = 0
    for end in ends:
        seen = scene.words[:end]
        for start in range(begin, end):
            if covered[start]:
                continue
            for variant, framing, messages in _framings(variants_of(wire), direction):
                judged = framing.judge(seen, start, silent=True, extras=_extras(messages))
                if judged.verdict is not Verdict.WHOLE or any(covered[start : start + judged.size]):
                    continue
                packet = seen[start : start + judged.size]
                name = next((m.name for m in messages if _reads(m, packet)), "a packet without a message")
                _fail(
                    4,
                    wire,
                    direction,
                    f"at {start} stands {variant.name} {name} {packet.hex()}, not heard",
                    scene,
                )
        begin = end


@lru_cache(maxsize=1024)
def _contextual(variants: tuple[Variant, ...], direction: Way) -> frozenset[tuple[str, str]]:
    return frozenset((v.name, name) for v in variants for name in needing_context(v.facing(direction)))


@lru_cache(maxsize=1024)
def _framings(
    variants: tuple[Variant, ...], direction: Way
) -> list[tuple[Variant, Framing, tuple[Message, ...]]]:
    found: dict[tuple[Variant, Framing], list[Message]] = {}
    for variant, message in cast(variants, direction).messages:
        if message.framing is not None:
            found.setdefault((variant, message.framing), []).append(message)
    return [(variant, framing, tuple(messages)) for (variant, framing), messages in found.items()]


@lru_cache(maxsize=1024)
def _extras(messages: tuple[Message, ...]) -> dict[int, bytes] | None:
    extras: dict[int, bytes] = {}
    for message in messages:
        extras.update(message.extras or {})
    return extras or None


def _reads(message: Message, image: bytes) -> bool:
    try:
        message.struct.parse(image, raw=True)
    except (ConstructError, AcesError):
        return False
    return True


def no_false_accept(wire: Wire, direction: Way, scene: Scene) -> None:
    """Law 5: every record's bytes, read again by construct alone, satisfy template and check."""
    for message, image, request in _accepted(wire, direction, scene):
        try:
            message.struct.parse(image, raw=True, request=request)
        except (ConstructError, AcesError) as error:
            _fail(
                5,
                wire,
                direction,
                f"{message.name} was accepted in {image.hex()}, where it is not: {error!r}",
                scene,
            )


# ---------------------------------------------------------------------- 6, 7, 8


def accounting(wire: Wire, direction: Way, scene: Scene, cuts: Iterable[int] = ()) -> None:
    """Law 6: every word ends in exactly one bin; records and losses tile the input; asking for less changes no count."""
    scanner = scanner_of(wire, direction)
    given = play(scanner, scene, cuts)
    counts = copied(scanner.counts)
    if scanner.counts.balance or counts["total"] != len(scene):
        _fail(6, wire, direction, f"bins do not sum to {len(scene)}: {counts}", scene)
    spans = (
        [(i, 1) for i in range(len(given))]
        if _is_can(wire)
        else [(g.meta.offset, g.meta.size) for g in given]
    )
    at = 0
    losses: dict[str, int] = {}
    decoded = records = 0
    for (offset, size), item in zip(spans, given, strict=True):
        raw = item.meta.raw
        wanted = bytes(scene.words[offset].data) if _is_can(wire) else scene.words[offset : offset + size]
        if offset != at or size < 1 or raw != wanted:
            _fail(
                6, wire, direction, f"at {at}, something of {size} from {offset} on, raw {raw.hex()}", scene
            )
        at += size
        if isinstance(item, Unknown):
            losses[item.reason] = losses.get(item.reason, 0) + size
        else:
            decoded, records = decoded + size, records + 1
    pending = losses.pop("pending", 0)
    if at != len(scene) or (decoded, records, pending, losses) != tuple(
        counts[name] for name in ("decoded", "records", "pending", "reasons")
    ):
        _fail(
            6,
            wire,
            direction,
            f"given: decoded={decoded} records={records} pending={pending} {losses}; counts: {counts}",
            scene,
        )
    less = scanner_of(wire, direction, everything=False)
    names = [type(item).__name__ for item in play(less, scene, cuts)]
    if copied(less.counts) != counts:
        _fail(
            6, wire, direction, f"without everything, counts are {copied(less.counts)}, not {counts}", scene
        )
    if names != [type(item).__name__ for item in given if not isinstance(item, Unknown)]:
        _fail(6, wire, direction, "without everything, other records come", scene)


#: A check may cost this many bytes for a candidate besides the sums of its bytes (law 7: O(1)).
PER_CANDIDATE = 16


def bounded(wire: Wire, direction: Way, scene: Scene, cuts: Iterable[int] = ()) -> None:
    """Law 7: the buffer holds `max_size` at most after each chunk, and checks read a bounded number of bytes.

    Sums, xor and Fletcher: twice the input plus O(1) a candidate. CRCs: `max_size` a candidate, so `max_size` ÷ header
    length a byte where headers stand side by side.
    """
    if _is_can(wire):
        return
    scanner = scanner_of(wire, direction)
    assert isinstance(scanner, StreamScanner)
    at = 0
    cuts = [*cuts, len(scene)]
    for cut in cuts:
        chunk = scene.words[at : max(at, cut)]
        scanner.feed(chunk)
        at = max(at, cut)
        if scanner.buffered > scanner.max_size:
            _fail(
                7,
                wire,
                direction,
                f"{scanner.buffered} bytes held after {at}, max_size is {scanner.max_size}",
                scene,
            )
    scanner.close()
    limit = _work_allowed(scanner.framings, scene.words, len(cuts))
    if scanner.check_work > limit:
        _fail(
            7,
            wire,
            direction,
            f"checks read {scanner.check_work} bytes of {len(scene)}; {limit} is the limit",
            scene,
        )


def _work_allowed(framings: Sequence[Framing], words: bytes, chunks: int) -> int:
    """How many bytes checks may read in `words`."""
    limit = len(words)  # each byte of an accepted packet once
    for framing in framings:
        if framing.check is None:
            continue
        candidates = sum(words.startswith(framing.sync, i) for i in range(len(words)))
        if framing.check.kind == "crc" or not framing.sync or framing.end:
            limit += framing.max_size * candidates
            if len(framings) > 1:
                # While another framing waits at the same offset, each chunk has the candidate read again.
                limit += framing.max_size * chunks
        else:
            limit += len(words) + PER_CANDIDATE * candidates
    return limit


def calm(wire: Wire, direction: Way, scene: Scene, cuts: Iterable[int] = ()) -> None:
    """Law 8: no input raises from `feed`, nor from `idle`, `sent` and `close`, whenever they come."""
    for everything, raw in ((True, False), (False, False), (True, True)):
        scanner = scanner_of(wire, direction, everything=everything, raw=raw)
        try:
            for record in play(scanner, scene, cuts):
                assert repr(record)
                assert record.meta is not None
            _provoke(scanner, scene)
        except Exception as error:
            _fail(8, wire, direction, f"raised {error!r} (everything={everything}, raw={raw})", scene)


def _provoke(scanner: Any, scene: Scene) -> None:
    """What a caller may also do: send nonsense, fall silent twice, go on after the end."""
    words = scene.words
    if isinstance(scanner, CanScanner):
        for frame in words:
            scanner.sent(frame)
        scanner.feed(words)
        scanner.feed(iter(words))
        return
    scanner.sent(words[: len(words) // 2])
    scanner.sent(b"")
    scanner.feed(bytearray(words), 1.5)
    scanner.idle()
    scanner.idle(float("nan"))
    scanner.feed(words[::-1], float("inf"))
    scanner.close()
    scanner.close()
    if scanner.counts.balance:
        raise AssertionError(f"bins do not sum: {scanner.counts}")


# ---------------------------------------------------------------------- 9


def unambiguous(wire: Wire, direction: Way, scene: Scene) -> None:
    """Law 9: no two messages accept the same packet in one context, unless the spec orders them.

    What the checker calls disjoint is disjoint: no packet of one is accepted, whole or in part, by the other.
    """
    for variant in variants_of(wire):
        for found in conflicts(variant, direction):
            _fail(9, wire, direction, f"{found.one.name} and {found.other.name} are ambiguous: {found.how}")
        apart = _apart(variant, direction)
        for packet in scene.packets:
            for other in apart.get(packet.message.name, ()):
                part = part_accepted(other, packet.image)
                if part is not None:
                    text = f"{packet.message.name} and {other.name} were found disjoint, but both accept {part.hex()}"
                    _fail(9, wire, direction, text)


@lru_cache(maxsize=1024)
def conflicts(variant: Variant, direction: Way) -> tuple[Conflict, ...]:
    """Every pair of messages that neither the bytes nor the spec's other words tell apart."""
    messages = variant.facing(direction)
    pairs = ((one, other) for i, one in enumerate(messages) for other in messages[:i])
    return tuple(found for one, other in pairs if (found := unresolved(one, other)) is not None)


@lru_cache(maxsize=1024)
def _apart(variant: Variant, direction: Way) -> dict[str, tuple[Message, ...]]:
    """For each message those that its bytes alone tell it from."""
    messages = variant.facing(direction)
    found: dict[str, list[Message]] = {m.name: [] for m in messages}
    for i, one in enumerate(messages):
        for other in messages[:i]:
            if conflict(one, other) is None:
                found[one.name].append(other)
                found[other.name].append(one)
    return {name: tuple(others) for name, others in found.items()}


def part_accepted(message: Message, image: bytes) -> bytes | None:
    """The packet, or the beginning of it, that a message accepts."""
    framing = message.framing
    if framing is None:
        if message.identifier.match(int.from_bytes(image[:4], "big") & 0x1FFF_FFFF) is None:
            return None
        return image if _reads(message, image) else None
    judged = framing.judge(image, 0, silent=True, extras=message.extras)
    part = image[: judged.size]
    return part if judged.verdict is Verdict.WHOLE and _reads(message, part) else None


# ---------------------------------------------------------------------- all of them


def draw_arguments(
    law: Law, wire: Wire, direction: Way, source: Source, *, size: int = 400
) -> tuple[Any, ...]:
    """What `law.holds(wire, direction, …)` takes besides: a scene of about `size` bytes, and cuts where it wants them."""
    cut_by = source.branch()
    if law.number == 7 and not _is_can(wire) and source.integer(0, 1):
        scene = Scene(adversary(wire, direction, source))
    else:
        scene = draw_scene(wire, direction, source, size=size)
    return (scene, draw_cuts(scene, cut_by)) if law.takes_cuts else (scene,)


def directions(variant: Variant) -> tuple[Way, ...]:
    """The directions in which a variant can be scanned, as far as they differ."""
    ways: list[Way] = [None]
    if variant.needs_direction is not None:
        ways = ["both"]
    for way in DIRECTIONS:
        if 0 < len(variant.facing(way)) < len(variant.messages):
            ways.append(way)
    return tuple(ways)


def wires(protocol: Protocol) -> list[tuple[Variant, Way]]:
    """Every dialect of a protocol × shipped configuration × direction."""
    return [(variant, way) for variant in protocol.variants() for way in directions(variant)]


@dataclass(frozen=True)
class Law:
    """A law by its number; `takes_cuts` says that it wants to know where to cut the scene."""

    number: int
    name: str
    holds: Callable[..., None]
    takes_cuts: bool = False
    #: Whether it is about streams only: a frame comes whole.
    streams_only: bool = False

    def __str__(self) -> str:
        return f"{self.number}-{self.name.replace(' ', '-')}"


LAWS = (
    Law(1, "round trip", round_trip),
    Law(2, "oracle", oracle, takes_cuts=True),
    Law(3, "chunking", chunking, takes_cuts=True),
    Law(4, "resynchronisation", resynchronisation),
    Law(5, "no false accept", no_false_accept),
    Law(6, "accounting", accounting, takes_cuts=True),
    Law(7, "bounded", bounded, takes_cuts=True, streams_only=True),
    Law(8, "calm", calm, takes_cuts=True),
    Law(9, "unambiguous", unambiguous),
)

__all__ = [
    "LAWS",
    "Exemption",
    "Law",
    "Packet",
    "Scene",
    "Way",
    "Wire",
    "accounting",
    "bounded",
    "calm",
    "check_columns",
    "chunking",
    "conflicts",
    "directions",
    "draw_arguments",
    "exemptions",
    "heard",
    "no_false_accept",
    "oracle",
    "part_accepted",
    "play",
    "resynchronisation",
    "round_trip",
    "scanner_of",
    "told",
    "unambiguous",
    "variants_of",
    "wires",
]
