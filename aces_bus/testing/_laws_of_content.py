"""Laws 1, 2, 5 and 9: what is read is what stands there, and nothing else could.

Each function takes a `Trial` and raises `LawError`; the public ones with wire, direction and scene are in `laws`.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any

from construct import ConstructError

from ..errors import AcesError
from ..protocol.declare.ambiguity import Conflict, conflict, unresolved
from ..protocol.declare.framing import Verdict
from ..protocol.declare.message import Message
from ..protocol.declare.protocol import Variant
from ._bench import reads
from ._columns import MODES, columns_difference
from ._exemptions import are_excused
from ._laws_of_encoder import encoders
from ._play import ScannedItem, comparable, image_of
from ._scenes import Way
from ._trial import Trial
from ._values import DrawnPacket

# ---------------------------------------------------------------------- 1


def check_round_trip(trial: Trial) -> None:
    """Law 1."""
    for packet in trial.sample(trial.scene.packets):
        if said := _values_survive(packet):
            trial.fail(1, said, with_scene=False)
    for message, image, request in trial.sample(list(trial.accepted())):
        key = ("built back", message, image, tuple(request.values()))
        said = trial.bench.once(key, lambda m=message, i=image, r=request: _bytes_survive(m, i, r))
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


def _values_survive(packet: DrawnPacket) -> str:
    message, image = packet.message, packet.image
    request = packet.request.values if packet.request is not None else _asked(message, packet.values)
    try:
        parsed = comparable(message.struct.parse(image, raw=True, request=request))
    except (ConstructError, AcesError) as error:
        return f"{message.name} built from {comparable(packet.values)} is not read again: {image.hex()}: {error!r}"
    wanted = comparable(packet.values)
    if {k: parsed.get(k) for k in wanted} != wanted:
        return f"{message.name}: {wanted} comes back as {parsed} ({image.hex()})"
    return ""


def _asked(message: Message, values: Any) -> dict[str, Any]:
    return {name: values.get(name) for name in message.request_fields}


# ---------------------------------------------------------------------- 2


def check_oracle(trial: Trial) -> None:
    """Law 2."""
    got = trial.heard
    if got != trial.told:
        trial.fail(2, first_difference("the reference", trial.told, "the scanner", got))
    wanted = [_physically(trial, item) for item in got]
    if trial.physical != wanted:
        trial.fail(2, "physical: " + first_difference("construct", wanted, "the scanner", trial.physical))
    encoders(trial)
    if trial.columns:
        # one mode a scene: a column scanner costs more than a scene
        check_columns_agree(trial, (MODES[(len(trial.scene) + len(trial.cuts)) % len(MODES)],))


def _physically(trial: Trial, item: ScannedItem) -> ScannedItem:
    """What was heard in raw values, in physical ones by construct."""
    if item.message is None:
        return item
    message = trial.bench.by_name[item.protocol or "", item.message]
    request = {name: item.fields[name] for name in message.request_fields}
    words = trial.scene.words
    image = (
        image_of(words[item.offset]) if trial.bench.is_can else words[item.offset : item.offset + item.size]
    )
    fields = trial.bench.once(
        ("physical", message, image, tuple(request.values())),
        lambda: comparable(message.struct.parse(image, request=request)),
    )
    return replace(item, fields=fields)


def check_columns_agree(trial: Trial, modes: Iterable[tuple[bool, bool]]) -> None:
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


def first_difference(one: str, first: Sequence[Any], other: str, second: Sequence[Any]) -> str:
    """Where two lists of what was heard part."""
    for a, b in zip(first, second, strict=False):
        if a != b:
            return f"{one} says {a}; {other} says {b}"
    longer, items = (one, first) if len(first) > len(second) else (other, second)
    return f"only {longer} has {items[min(len(first), len(second))]}"


# ---------------------------------------------------------------------- 5


def check_no_false_accept(trial: Trial) -> None:
    """Law 5."""
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


# ---------------------------------------------------------------------- 9


def check_unambiguous(trial: Trial) -> None:
    """Law 9."""
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
    """Every pair of messages that neither the bytes nor the spec's other words tell apart."""
    messages = variant.messages_for(direction)
    pairs = ((one, other) for i, one in enumerate(messages) for other in messages[:i])
    return tuple(found for one, other in pairs if (found := unresolved(one, other)) is not None)


@lru_cache(maxsize=1024)
def _apart(variant: Variant, direction: Way) -> dict[str, tuple[Message, ...]]:
    """For each message those that its bytes alone tell it from."""
    messages = variant.messages_for(direction)
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
        return image if reads(message, image) else None
    judged = framing.judge(image, 0, silent=True, extras=message.extras)
    part = image[: judged.size]
    return part if judged.verdict is Verdict.WHOLE and reads(message, part) else None


__all__ = [
    "check_columns_agree",
    "check_no_false_accept",
    "check_oracle",
    "check_round_trip",
    "check_unambiguous",
    "conflicts",
    "first_difference",
    "part_accepted",
]
