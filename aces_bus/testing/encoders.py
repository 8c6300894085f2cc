"""Law 2, of encoders: what a printed encoder builds is what construct builds, and it refuses what construct refuses.

1. The truth is `message.struct.build` alone. Values are those of the packets in a scene as construct reads them; then one
   field at a time is another: a little beside, beyond what fits, of another type, missing.
2. A refusal is a `FieldError` (an `UnknownNameError` for a name that is none) that says the message, and the field where
   construct says it: one that is missing, one out of its range. What Python itself raises names none.
3. What is tried of a packet follows from its bytes: a scene with less in it tries the same of what is left, or more.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any
from zlib import crc32

from construct import ConstructError

from ..errors import AcesError, FieldError, UnknownNameError
from ..frames import key_of
from ..protocol.declare.fields import FlagSet
from ..protocol.declare.message import Message
from ..protocol.declare.packet import frame_image
from ..protocol.declare.packet_rule import PacketRule, packet_image
from ..protocol.encoder import Encoder
from ..protocol.record import FieldValue
from .trial import Trial

#: What construct raises for a value that does not fit.
REFUSALS = (AcesError, ConstructError, KeyError, TypeError, AttributeError, ValueError, ArithmeticError)
#: The name of a field that no message has.
NO_FIELD = "no_such_field"
#: Elements of a list that are tried one by one.
ELEMENTS = 3
#: Of so many packets in a scene everything is tried; of more, so many changes each, by numbers so far apart.
FEW, SOME, STEP = 2, 3, 7919
#: Of a packet of many fields so many changes are tried, others of the next one.
MOST = 64
#: A way to the value that is another, and the value; `GONE` when it is left out.
Change = tuple[tuple[Any, ...], Any]
GONE = object()


def encoders(trial: Trial) -> None:
    """Check law 2 of encoders."""
    accepted = list(trial.accepted())
    if not trial.thorough and accepted:
        accepted = [accepted[trial.turn % len(accepted)]]
    for message, image, request in accepted:
        given = _given(trial, message, image, request)
        if trial.thorough and len(accepted) <= FEW:
            changes = changed_values(given)
            apart = -(-len(changes) // MOST)
            found: list[Change | None] = [None, *changes[crc32(image) % apart :: apart]]
        else:
            turn = crc32(image)
            found = [_change(given, turn + n * STEP) for n in range(SOME if trial.thorough else 1)]
        for change in found:
            _judge(trial, message, given, change)


def _given(
    trial: Trial, message: Message, image: bytes, request: Mapping[str, FieldValue]
) -> dict[str, FieldValue]:
    """Return a packet's values in the sheet's units: what an encoder is given. What only the request says is not."""

    def ask() -> dict[str, FieldValue]:
        parsed = message.struct.parse(image, request=request)
        return {name: parsed[name] for name in message.fields if name in parsed and name not in request}

    found: dict[str, FieldValue] = trial.bench.once(("given", message, image, tuple(request.values())), ask)
    return found


def _judge(trial: Trial, message: Message, given: dict[str, FieldValue], change: Change | None) -> None:
    fields = given if change is None else changed(given, change)
    wanted, refusal = built(message, fields) if NO_FIELD not in fields else (None, NO_FIELD)
    encoder = trial.bench.encoder(message)
    ways = ("encode", "as_sent") if trial.thorough else (("encode", "as_sent")[trial.turn // 8 % 2],)
    for way in ways:
        said = _difference(encoder, way, message, fields, wanted, refusal, change)
        if said:
            text = ", ".join(f"{name}={value!r}" for name, value in fields.items())
            trial.fail(2, f"{way}({message.name!r}, {text}) {said}", with_scene=False)


def built(message: Message, fields: Mapping[str, FieldValue]) -> tuple[bytes | None, str]:
    """Return what construct builds, or why it does not."""
    try:
        return bytes(message.struct.build(fields)), ""
    except REFUSALS as error:
        return None, str(error)


def _difference(
    encoder: Encoder,
    way: str,
    message: Message,
    fields: dict[str, FieldValue],
    image: bytes | None,
    refusal: str,
    change: Change | None,
) -> str:
    try:
        made: Any = (
            encoder.encode(message.name, **fields) if way == "encode" else encoder.as_sent(message, fields)
        )
    except (FieldError, UnknownNameError) as error:
        if image is not None:
            return f"refused with {str(error)!r}, where construct builds {image.hex()}"
        return _misnamed(error, message, refusal, change)
    except Exception as error:
        return f"raises {type(error).__name__}: {error}"
    got = _image(message, made if isinstance(made, list) else [made])
    if image is None:
        return f"gives {got.hex()}, where construct refuses"
    return "" if got == image else f"gives {got.hex()}, and construct builds {image.hex()}"


def _image(message: Message, sent: Sequence[Any]) -> bytes:
    """Return the image of what an encoder made: of a packet that a transport carries, by the rule of the reference."""
    if message.transport is None:
        (packet,) = sent
        return bytes(packet) if message.framing is not None else frame_image(packet)
    own = key_of(sent[0].arbitration_id, extended=sent[0].is_extended_id)
    way = next(way for way in reversed(message.ways) if way and (way is message.transport or way.is_own(own)))
    rule, found = PacketRule(way), b""
    for number, frame in enumerate(sent):
        key = key_of(frame.arbitration_id, extended=frame.is_extended_id)
        for decided in rule.decide(frame, number, key, bytes(frame.data)):
            if not decided.reason and len(decided.frames) == len(sent):
                found = packet_image(way, decided, message.check_extra) or b""
    return found


def _misnamed(error: AcesError, message: Message, refusal: str, change: Change | None) -> str:
    """Return what a refusal should say and does not."""
    text = str(error)
    if isinstance(error, UnknownNameError) != (refusal == NO_FIELD):
        return f"refused as {type(error).__name__}: {text}"
    if change is None:
        return "" if message.name in text else f"the refusal does not name {message.name}: {text}"
    (name, *_), value = change
    wanted = [
        part
        for part in (message.name, str(name))
        if part not in text and (part == message.name or part in refusal)
    ]
    if not wanted:
        return ""
    shown = "left out" if value is GONE else repr(value)
    return f"with {name} {shown}, the refusal does not name {' and '.join(wanted)}: {text}"


# ---------------------------------------------------------------------- other values


def changed_values(fields: Mapping[str, FieldValue]) -> list[Change]:
    """Return what may be changed in some fields, one at a time."""
    return [((NO_FIELD,), 0), *(change for name in fields for change in _changes_of(name, fields[name]))]


def _change(fields: Mapping[str, FieldValue], turn: int) -> Change | None:
    """Draw a change, or none."""
    turn, place = divmod(turn, len(fields) + 1)
    if place == len(fields):
        return ((NO_FIELD,), 0) if turn % 4 == 0 else None
    name = list(fields)[place]
    found = _changes_of(name, fields[name])
    return found[turn % len(found)]


def _changes_of(name: str, value: FieldValue) -> list[Change]:
    return [((name,), GONE), *(((name, *path), other) for path, other in _others(value))]


def changed(fields: Mapping[str, FieldValue], change: Change) -> dict[str, FieldValue]:
    """Return the fields with one change."""
    path, value = change
    made: dict[str, FieldValue] = _with(fields, path, value)
    return made


def _with(around: Any, path: Sequence[Any], value: FieldValue) -> Any:
    if not path:
        return value
    key, *rest = path
    if isinstance(around, Mapping):
        copy = {name: item for name, item in around.items() if not str(name).startswith("_")}
        if not rest and value is GONE:
            copy.pop(key, None)
        else:
            copy[key] = _with(around.get(key), rest, value)
        return copy
    items = list(around)
    items[key] = _with(items[key], rest, value)
    return items


def _others(value: FieldValue) -> Iterator[Change]:
    """Return values to put in a value's place: near it, beyond it, of another kind."""
    if isinstance(value, FlagSet):
        yield from _each(int(value), -1, 1 << 40, [], [*value, "no such flag"], None, "no such flag")
    elif isinstance(value, bool) or value is None:
        yield from _each(0, 1, -1, "on", 0.5, b"")
    elif isinstance(value, int):
        yield from _each(value + 1, value - 1, -value, ~value)
        if abs(value) < 1 << 64:  # a float ends at 2¹⁰²⁴, and reserved bits may be more
            yield from _each(value + 0.5, value + 0.75, float(value))
        yield from _each(1 << 64, -1, True, None, str(value), float("nan"), [value])
    elif isinstance(value, float):
        yield from _each(value * 0.9997, value * 1.0003, value + 0.4, value - 0.4, -value, 1e300, -1e300)
        yield from _each(float("nan"), float("inf"), 0, None, str(value), [value])
    elif isinstance(value, str):
        yield from _each("no such name", "", 0, 3, 255, -1, 1 << 40, 1.0, None)
    elif isinstance(value, (bytes, bytearray)):
        data = bytes(value)
        yield from _each(data + b"\0", data[:-1], b"", bytearray(data), data + bytes(5000), None, 3)
    elif isinstance(value, Mapping):
        yield from _each({}, None)
        for name, item in value.items():
            if not str(name).startswith("_"):
                yield (name,), GONE
                yield from (((name, *path), other) for path, other in _others(item))
    elif isinstance(value, (list, tuple)):
        yield from _each([*value, *value[-1:]], list(value[:-1]), tuple(value), None, 0)
        for index, item in enumerate(value[:ELEMENTS]):
            yield from (((index, *path), other) for path, other in _others(item))


def _each(*values: Any) -> Iterator[Change]:
    return (((), value) for value in values)


__all__ = ["built", "changed", "changed_values", "encoders"]
