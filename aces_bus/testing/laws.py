"""The nine laws: what is true of every protocol, whatever comes over the wire.

1. Each law takes a wire (a variant, or several on one wire), a direction and a scene, and where to cut it; it raises
   `LawError`, an `AssertionError` with what was expected, what came, and the scene to repeat it.
2. A law trusts nothing that it judges: the truth is construct, the reference, or arithmetic on the input.
3. Scenes are drawn by `strategies`, or by `draw_arguments` without Hypothesis; one made by hand does as well.

>>> from aces_bus.testing import laws
>>> from aces_protocols.robotis.spec import robotis
>>> wire = bytes.fromhex("FF FF 01 02 01 FB")
>>> laws.oracle(robotis.variant(), "to device", laws.Scene(wire))
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import pairwise
from typing import Any

from construct import ConstructError

from ..errors import AcesError
from ..frame_table import FrameTable
from ..frames import EXTENDED
from ..protocol.declare.ambiguity import Conflict, are_apart, unresolved
from ..protocol.declare.framing import Verdict
from ..protocol.declare.message import DIRECTIONS, Message
from ..protocol.declare.packet import frame_image
from ..protocol.declare.protocol import Variant
from ..protocol.live.can import CanScanner
from ..protocol.live.stream import StreamScanner
from ..protocol.protocol import Protocol
from ..protocol.record import FieldValue, Record, Unknown
from .allowed_work import candidates_in, unstuffing_allowed, work_allowed
from .bench import bench_of, reads
from .columns import MODES, columns_difference
from .encoders import encoders
from .exemptions import Exemption, are_excused, exemptions
from .packets import DrawnPacket
from .scenes import Cast, Scene, Way, Wire, adversary, draw_cuts, draw_scene, wire_variants
from .source import ChoiceSource
from .trial import (
    Law,
    LawError,
    ScannedItem,
    Trial,
    as_given,
    as_items,
    comparable,
    law,
    plain_counts,
    play,
    record_image,
    reference_items,
    scanned_items,
    scanner_of,
)

# ---------------------------------------------------------------------- 1


@law(1)
def round_trip(trial: Trial) -> None:
    """Law 1: `parse_raw(build_raw(r)) == r`, and `build(parse(f)) == f` for whatever is accepted, bit for bit.

    In the sheet's units, too: what is decoded and sent again is decoded to the same.
    """
    for packet in trial.sample(trial.scene.packets):
        if said := _values_survive(packet):
            trial.fail(1, said, with_scene=False)
    for message, image, request in trial.sample(list(trial.accepted())):
        key = ("built back", message, image, tuple(request.values()))
        said = trial.bench.once(
            key, lambda m=message, i=image, r=request: _bytes_survive(m, i, r) or _meaning_survives(m, i, r)
        )
        if said:
            trial.fail(1, said, with_scene=False)


def _bytes_survive(message: Message, image: bytes, request: Any) -> str:
    parsed = message.struct.parse(image, raw=True, request=request)
    try:
        rebuilt = bytes(message.struct.build(parsed, raw=True))
    except (ConstructError, AcesError, KeyError, TypeError, AttributeError) as error:
        return f"{message.name} {image.hex()} cannot be built back: {error!r}"
    if rebuilt == image:
        return ""
    if message.any_format and (rebuilt[:4], rebuilt[5:]) == (image[:4], image[5:]):
        return ""  # the format in which it came is not among its fields
    text = f"{message.name} {image.hex()} comes back as {rebuilt.hex()} ({comparable(parsed)})"
    if not are_excused(message, image, rebuilt):
        return text
    if comparable(message.struct.parse(rebuilt, raw=True, request=request)) != comparable(parsed):
        return f"{text}, which reads otherwise"
    return ""


def _meaning_survives(message: Message, image: bytes, request: Any) -> str:
    if any(leaf.node.is_rounded for leaf in message.plan.columns):
        return ""
    parsed = message.struct.parse(image, request=request)
    try:
        rebuilt = bytes(message.struct.build(parsed))
    except (ConstructError, AcesError):  # beyond a stated range
        return ""
    wanted, found = comparable(parsed), comparable(message.struct.parse(rebuilt, request=request))
    if found == wanted:
        return ""
    return f"{message.name} {image.hex()} is {wanted}; sent again it is {rebuilt.hex()}, {found}"


def _values_survive(packet: DrawnPacket) -> str:
    message, image = packet.message, packet.image
    request = packet.request.values if packet.request is not None else _asked(message, packet.values)
    try:
        parsed = comparable(message.struct.parse(image, raw=True, request=request))
    except (ConstructError, AcesError) as error:
        return f"{message.name} built from {comparable(packet.values)} is not read again: {image.hex()}: {error!r}"
    wanted = comparable(packet.values)
    if as_given(parsed, wanted) != wanted:
        return f"{message.name}: {wanted} comes back as {parsed} ({image.hex()})"
    return ""


def _asked(message: Message, values: Any) -> dict[str, FieldValue]:
    return {name: values.get(name) for name in message.request_fields}


# ---------------------------------------------------------------------- 2


@law(2, takes_cuts=True)
def oracle(trial: Trial) -> None:
    """Law 2: the generated scanner gives exactly what the reference gives, values and losses; and so do columns.

    Raw values against the reference; physical ones against construct, packet by packet; columns (`check_columns`)
    against the generated scanner.
    """
    got = trial.scanned
    if got != trial.expected:
        trial.fail(2, _first_difference("the reference", trial.expected, "the scanner", got))
    wanted = [_physically(trial, item, record) for item, record in zip(got, _each(trial, got), strict=True)]
    if trial.physical != wanted:
        trial.fail(2, "physical: " + _first_difference("construct", wanted, "the scanner", trial.physical))
    encoders(trial)
    if trial.columns:
        # one mode a scene: a column scanner costs more than a scene
        _columns_agree(trial, (MODES[(len(trial.scene) + len(trial.cuts)) % len(MODES)],))


def _each(trial: Trial, got: Sequence[ScannedItem]) -> Sequence[Any]:
    """Return on CAN the records of some items; of a stream an item says by itself where it is."""
    return trial.given if trial.bench.is_can else [None] * len(got)


def _physically(trial: Trial, item: ScannedItem, record: Record | None) -> ScannedItem:
    """Return what was given in raw values, in physical ones by construct."""
    if item.message is None:
        return item
    message = trial.bench.by_name[item.protocol or "", item.message]
    request = {name: item.fields[name] for name in message.request_fields}
    image = (
        trial.scene.traffic[item.offset : item.offset + item.size] if record is None else record_image(record)
    )
    fields = trial.bench.once(
        ("physical", message, image, tuple(request.values())),
        lambda: comparable(message.struct.parse(image, request=request)),
    )
    return replace(item, fields=fields)


def _columns_agree(trial: Trial, modes: Iterable[tuple[bool, bool]]) -> None:
    """Law 2, of columns."""
    for raw, include_unknown in modes:
        live = trial.bench.scanner(raw=raw)
        said = columns_difference(
            trial.bench.wire,
            trial.direction,
            trial.scene,
            trial.cuts,
            live,
            raw=raw,
            include_unknown=include_unknown,
        )
        if said:
            trial.fail(
                2, f"columns (raw={raw}, include_unknown={include_unknown}), cut at {trial.cuts}: {said}"
            )


def columns_law(wire: Wire, direction: Way, scene: Scene, cuts: Iterable[int] = ()) -> None:
    """Law 2, of columns: a column scanner gives what the live one gives, value for value, cut at `cuts`.

    Raw and physical values, their types, what is absent, rows, times, channels and directions, losses and counts. A
    capture has frames or bytes only: silences and transmissions of the scene are left out.
    """
    _columns_agree(Trial(bench_of(wire, direction), scene, cuts), MODES)


def _first_difference(one: str, first: Sequence[Any], other: str, second: Sequence[Any]) -> str:
    """Return where two lists of items begin to differ."""
    for a, b in zip(first, second, strict=False):
        if a != b:
            return f"{one} says {a}; {other} says {b}"
    longer, items = (one, first) if len(first) > len(second) else (other, second)
    return f"only {longer} has {items[min(len(first), len(second))]}"


# ---------------------------------------------------------------------- 3


@law(3, takes_cuts=True)
def chunking(trial: Trial) -> None:
    """Law 3: the same frames or bytes with the same events give the same records, however they are cut."""
    given, counts, _ = trial.cut_up
    pieces = as_items(given, trial.bench.is_can)
    how = f"cut at {trial.cuts}: "
    if pieces != trial.scanned:
        trial.fail(3, how + _first_difference("whole", trial.scanned, "in pieces", pieces))
    if counts != trial.counts:
        trial.fail(3, f"{how}counts {counts} instead of {trial.counts}")
    if trial.bench.is_can and trial.columns and not trial.scene.sent_at:
        scanner: Any = trial.bench.scanner()
        given = scanner.feed_table(FrameTable.from_frames(trial.scene.traffic)) + scanner.close()
        table = as_items(given, is_can=True)
        if table != trial.scanned:
            trial.fail(3, "as a table: " + _first_difference("whole", trial.scanned, "the table", table))


# ---------------------------------------------------------------------- 4


@law(4)
def resynchronisation(trial: Trial) -> None:
    """Law 4: wherever a template is complete and its check holds, a record starts, or an accepted one covers a byte of it.

    A packet with no message, or a reply without its request, is whole by its framing and counts as accepted.
    """
    if trial.bench.is_can:
        _no_frame_overlooked(trial)
        return
    scene = trial.scene
    covered = bytearray(len(scene))
    for item in trial.scanned:
        if item.message or item.reason.startswith("unknown"):
            covered[item.offset : item.offset + item.size] = b"\1" * item.size
    framings = list(zip(trial.bench.framings, trial.bench.extras, strict=True))
    begin = 0
    for end in [*scene.idle_at, len(scene)]:
        seen = scene.traffic[:end]
        for (variant, framing, messages), extras in framings:
            if framing in trial.bench.answering:
                continue  # a packet only while it is awaited
            for start in candidates_in(framing, seen, begin):
                if covered[start]:
                    continue
                judged = framing.judge(seen, start, silent=True, extras=extras)
                if judged.verdict is not Verdict.WHOLE or any(covered[start : start + judged.size]):
                    continue
                packet = seen[start : start + judged.size]
                name = next(
                    (m.name for m in messages if trial.bench.reads(m, packet)), "a packet without a message"
                )
                trial.fail(4, f"{variant.name} {name} {packet.hex()} at {start} was not found")
        begin = end


def _no_frame_overlooked(trial: Trial) -> None:
    who = Cast.of(trial.bench.wire, trial.direction)
    scanned = trial.scanned
    if trial.bench.has_transports:
        _no_packet_overlooked(trial)
        return
    if len(scanned) != len(trial.scene):
        trial.fail(4, f"of {len(trial.scene)} frames, {len(scanned)} came out")
    for number, frame in enumerate(trial.scene.traffic):
        item = scanned[number]
        if frame.is_error_frame or item.message or item.reason.startswith("unknown: needs"):
            continue
        image = frame_image(frame)
        for variant, message in who.messages:
            if (variant.name, message.name) in trial.bench.contextual:
                continue
            if message.identifier.match(frame.arbitration_id) is not None and trial.bench.reads(
                message, image
            ):
                trial.fail(4, f"frame {number} is {message.name}, but was {item.reason}")


def _no_packet_overlooked(trial: Trial) -> None:
    """Check that a packet is found if its frames follow one another without a frame of another packet of its
    session.

    The frames are those that its transport makes of the drawn packet. A packet that is also a message which
    overrides its own is found as that one.
    """
    overriding: dict[str, set[str]] = {}
    for _, message in Cast.of(trial.bench.wire, trial.direction).messages:
        for name in message.overrides:
            overriding.setdefault(name, set()).add(message.name)
    found = {item.message for item in trial.scanned}
    for packet in trial.sample(trial.scene.packets):
        if packet.message.transport is None or packet.message.reply_to or packet.message.after:
            continue
        wire = [(f.arbitration_id, f.data) for f in packet.as_sent]
        mine = [
            f
            for f in trial.scene.traffic
            if f.arbitration_id in {i for i, _ in wire} and not f.is_error_frame
        ]
        if [(f.arbitration_id, f.data) for f in mine] != wire or len({f.channel for f in mine}) > 1:
            continue  # other frames of these identifiers are there, too
        times = [f.timestamp for f in mine]
        transport, (identifier, data) = packet.message.transport, wire[0]
        slow = transport.gap_s(transport.part(identifier | EXTENDED * packet.message.extended, data))
        if any(None not in (a, b) and b - a > slow for a, b in pairwise(times)):
            continue
        if any(f.is_remote_frame or f.is_extended_id != packet.message.extended for f in mine):
            continue
        if found.isdisjoint({packet.message.name, *overriding.get(packet.message.name, ())}):
            trial.fail(
                4, f"{packet.message.name} {packet.image[5:].hex()} was not found in {len(wire)} frames"
            )


# ---------------------------------------------------------------------- 5


@law(5)
def no_false_accept(trial: Trial) -> None:
    """Law 5: every record's bytes, read again by construct alone, satisfy template and check."""
    for message, image, request in trial.accepted():
        key = ("accepted", message, image, tuple(request.values()))
        said = trial.bench.once(key, lambda m=message, i=image, r=request: _refused(m, i, r))
        if said:
            trial.fail(5, f"{message.name} was accepted in {image.hex()}, where it is not: {said}")


def _refused(message: Message, image: bytes, request: Any) -> str:
    try:
        message.struct.parse(image, raw=True, request=request)
    except (ConstructError, AcesError) as error:
        return repr(error)
    return ""


# ---------------------------------------------------------------------- 6


@law(6, takes_cuts=True)
def accounting(trial: Trial) -> None:
    """Law 6: every frame or byte ends in one bin; records and losses tile the input; asking for less changes no count."""
    is_can, scene = trial.bench.is_can, trial.scene
    given, counts, balance = trial.cut_up
    if balance or counts["total"] != len(scene):
        trial.fail(6, f"bins do not sum to {len(scene)}: {counts}")
    if trial.bench.has_transports:
        _frames_accounted(trial, given, counts)
        return
    if is_can and len(given) != len(scene):
        trial.fail(6, f"of {len(scene)} frames, {len(given)} came out")
    spans = [(i, 1) for i in range(len(given))] if is_can else [(g.meta.offset, g.meta.size) for g in given]
    at = 0
    losses: dict[str, int] = {}
    decoded = records = 0
    for (offset, size), item in zip(spans, given, strict=True):
        raw = item.meta.raw
        wanted = bytes(scene.traffic[offset].data) if is_can else scene.traffic[offset : offset + size]
        if offset != at or size < 1 or raw != wanted:
            trial.fail(6, f"at {at}, something of {size} from {offset} on, raw {raw.hex()}")
        at += size
        if isinstance(item, Unknown):
            losses[item.reason] = losses.get(item.reason, 0) + size
        else:
            decoded, records = decoded + size, records + 1
    pending = losses.pop("pending", 0)
    if at != len(scene) or (decoded, records, pending, losses) != tuple(
        counts[name] for name in ("decoded", "records", "pending", "reasons")
    ):
        trial.fail(
            6, f"given: decoded={decoded} records={records} pending={pending} {losses}; counts: {counts}"
        )
    less = trial.bench.scanner(include_unknown=False)
    names = [type(item).__name__ for item in play(less, scene, trial.cuts)]
    if plain_counts(less.counts) != counts:
        trial.fail(6, f"without everything, counts are {plain_counts(less.counts)}, not {counts}")
    if names != [type(item).__name__ for item in given if not isinstance(item, Unknown)]:
        trial.fail(6, "without everything, other records come")


def _frames_accounted(trial: Trial, given: Sequence[Any], counts: dict[str, Any]) -> None:
    """Law 6 where a record may be of several frames: each frame is in one of what was given, and counted there."""
    came: Counter[bytes] = Counter()
    losses: Counter[str] = Counter()
    decoded = records = 0
    for item in given:
        frames = item.meta.frames or (item.meta.raw,)
        came.update(frames)
        if isinstance(item, Unknown):
            losses[item.reason] += 1
        else:
            decoded, records = decoded + len(frames), records + 1
    fed = Counter(bytes(frame.data) for frame in trial.scene.traffic)
    if came != fed:
        trial.fail(
            6, f"frames that came out of nothing: {came - fed}; frames that did not come out: {fed - came}"
        )
    pending = losses.pop("pending", 0)
    if (decoded, records, pending, dict(losses)) != tuple(
        counts[name] for name in ("decoded", "records", "pending", "reasons")
    ):
        trial.fail(
            6,
            f"given: decoded={decoded} records={records} pending={pending} {dict(losses)}; counts: {counts}",
        )
    less = trial.bench.scanner(include_unknown=False)
    names = [type(item).__name__ for item in play(less, trial.scene, trial.cuts)]
    if plain_counts(less.counts) != counts:
        trial.fail(6, f"without everything, counts are {plain_counts(less.counts)}, not {counts}")
    if names != [type(item).__name__ for item in given if not isinstance(item, Unknown)]:
        trial.fail(6, "without everything, other records come")


# ---------------------------------------------------------------------- 7


@law(7, takes_cuts=True, streams_only=True)
def bounded(trial: Trial) -> None:
    """Law 7: the buffer holds `max_size` at most after each chunk, and checks read a bounded number of bytes.

    Sums, xor and Fletcher: twice the input plus O(1) a candidate. CRCs, and whatever is stuffed as a whole: `max_size` a
    candidate, so `max_size` ÷ header length a byte where headers stand side by side. Unstuffing itself is counted apart: a
    few times the input, and a small part of a packet a candidate.
    """
    if trial.bench.is_can:
        return
    scanner, traffic = trial.bench.scanner(), trial.scene.traffic
    assert isinstance(scanner, StreamScanner)
    at = 0
    cuts = [*trial.cuts, len(traffic)]
    for cut in cuts:
        chunk = traffic[at : max(at, cut)]
        scanner.feed(chunk)
        at = max(at, cut)
        if scanner.buffered > scanner.max_size:
            trial.fail(7, f"{scanner.buffered} bytes held after {at}, max_size is {scanner.max_size}")
    scanner.close()
    limit = work_allowed(scanner.framings, traffic, len(cuts))
    if scanner.check_work > limit:
        trial.fail(7, f"checks read {scanner.check_work} bytes of {len(traffic)}; {limit} is the limit")
    limit = unstuffing_allowed(scanner.framings, traffic, len(cuts))
    if scanner.unstuff_work > limit:
        trial.fail(7, f"unstuffing read {scanner.unstuff_work} bytes of {len(traffic)}; {limit} is the limit")


# ---------------------------------------------------------------------- 8


@law(8, takes_cuts=True)
def calm(trial: Trial) -> None:
    """Law 8: no input raises from `feed`, nor from `idle`, `sent` and `close`, whenever they come."""
    for include_unknown, raw in trial.sample(((True, False), (False, False), (True, True))):
        scanner = trial.bench.scanner(include_unknown=include_unknown, raw=raw)
        try:
            for record in play(scanner, trial.scene, trial.cuts):
                assert repr(record)
                assert record.meta is not None
            _provoke(scanner, trial.scene)
        except Exception as error:
            trial.fail(8, f"raised {error!r} (include_unknown={include_unknown}, raw={raw})")


def _provoke(scanner: Any, scene: Scene) -> None:
    """Do what a caller may also do: feed nonsense, fall silent twice, go on after the end."""
    traffic = scene.traffic
    if isinstance(scanner, CanScanner):
        for frame in traffic:
            scanner.sent(frame)
        scanner.feed(traffic)
        scanner.feed(iter(traffic))
        return
    scanner.sent(traffic[: len(traffic) // 2])
    scanner.sent(b"")
    scanner.feed(bytearray(traffic), 1.5)
    scanner.idle()
    scanner.idle(float("nan"))
    scanner.feed(traffic[::-1], float("inf"))
    scanner.close()
    scanner.close()
    if scanner.counts.balance:
        raise AssertionError(f"bins do not sum: {scanner.counts}")


# ---------------------------------------------------------------------- 9


@law(9)
def unambiguous(trial: Trial) -> None:
    """Law 9: no two messages accept the same packet in one context, unless the spec orders them.

    What the checker calls disjoint is disjoint: no packet of one is accepted, whole or in part, by the other.
    """
    for variant in trial.bench.variants:
        for found in conflicts(variant, trial.direction):
            text = f"{found.one.name} and {found.other.name} are ambiguous: {found.how}"
            trial.fail(9, text, with_scene=False)
        apart = _apart(variant, trial.direction)
        for packet in trial.sample(trial.scene.packets):
            for other in apart.get(packet.message.name, ()):
                part = part_accepted(other, packet.image)
                if part is not None:
                    text = f"{packet.message.name} and {other.name} were found disjoint, but both accept {part.hex()}"
                    trial.fail(9, text, with_scene=False)


@lru_cache(maxsize=1024)
def conflicts(variant: Variant, direction: Way) -> tuple[Conflict, ...]:
    """Return every pair of messages that neither the bytes nor anything else in the spec tells apart."""
    messages = variant.messages_for(direction)
    pairs = ((message, other) for i, message in enumerate(messages) for other in messages[:i])
    return tuple(found for pair, other in pairs if (found := unresolved(pair, other)) is not None)


@lru_cache(maxsize=1024)
def _apart(variant: Variant, direction: Way) -> dict[str, tuple[Message, ...]]:
    """Return for each message those that its bytes alone tell it from."""
    messages = variant.messages_for(direction)
    found: dict[str, list[Message]] = {m.name: [] for m in messages}
    for i, message in enumerate(messages):
        for other in messages[:i]:
            if are_apart(message, other):
                found[message.name].append(other)
                found[other.name].append(message)
    return {name: tuple(others) for name, others in found.items()}


def part_accepted(message: Message, image: bytes) -> bytes | None:
    """Return the packet, or the beginning of it, that a message accepts."""
    framing = message.framing
    if framing is None:
        if message.identifier.match(int.from_bytes(image[:4], "big") & 0x1FFF_FFFF) is None:
            return None
        return image if reads(message, image) else None
    judged = framing.judge(image, 0, silent=True, extras=message.extras)
    part = image[: judged.size]
    return part if judged.verdict is Verdict.WHOLE and reads(message, part) else None


# ---------------------------------------------------------------------- all of them


def draw_arguments(
    law: Law, wire: Wire, direction: Way, source: ChoiceSource, *, size: int = 400
) -> tuple[Any, ...]:
    """Return what a law takes besides wire and direction: a scene of about `size` bytes, and cuts where it wants them."""
    cut_by = source.branch()
    if law.number == 7 and wire_variants(wire)[0].link != "can" and source.integer(0, 1):
        scene = Scene(adversary(wire, direction, source))
    else:
        scene = draw_scene(wire, direction, source, size=size)
    return (scene, draw_cuts(scene, cut_by)) if law.takes_cuts else (scene,)


def directions(variant: Variant) -> tuple[Way, ...]:
    """Return the directions in which a variant can be scanned, as far as they differ."""
    ways: list[Way] = [None]
    if variant.direction_conflict is not None:
        ways = ["both"]
    for way in DIRECTIONS:
        if 0 < len(variant.messages_for(way)) < len(variant.messages):
            ways.append(way)
    return tuple(ways)


def wires(protocol: Protocol) -> list[tuple[Variant, Way]]:
    """Return every dialect of a protocol × shipped configuration × direction."""
    return [(variant, way) for variant in protocol.variants() for way in directions(variant)]


LAWS = (
    round_trip,
    oracle,
    chunking,
    resynchronisation,
    no_false_accept,
    accounting,
    bounded,
    calm,
    unambiguous,
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
