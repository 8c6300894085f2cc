"""Whether a message's worked examples hold: read, written back, and recognised.

1. What reads is the message's construct and the reference; nothing generated, nothing cached.
2. An example holds when its bytes give its fields, its fields give its bytes, and in some shipped dialect and
   configuration the rule that scanners follow gives this message. A reply without its request may stay unrecognised.
3. Numbers of characters may be written otherwise than the example has them (`38.0` for `38.00`), if they read the same.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from construct import ConstructError

from ...errors import AcesError
from ...frames import Frame
from ..declare.delimited import Delimited
from ..declare.examples import Example, ExampleFrame
from ..declare.fields import FlagSet
from ..declare.message import Message
from ..declare.packet import ContentError, LengthError, NotThisError, WrongCheckError, error_text
from ..declare.protocol import Variant
from ..protocol import Protocol
from ..record import FieldValue, plain_value
from ..reference import Reference, ReferenceItem
from .finding import Finding


def check_examples(protocol: Protocol) -> Iterator[Finding]:
    """Yield what is wrong with the examples of a protocol."""
    for message in protocol.declared:
        for example in message.examples:
            text = failure(message, example)
            if text is not None:
                yield Finding(
                    "error",
                    "example",
                    message.place,
                    f"{message.name}: example {example.packet}: {text}",
                    message.name,
                    _witness(example.packet),
                )
    without = [m.name for m in protocol.declared if not m.examples]
    if without:
        shown = ", ".join(without[:6]) + (", …" if len(without) > 6 else "")
        yield Finding(
            "note",
            "example",
            protocol.place,
            f"{len(without)} of {len(protocol.declared)} messages have no worked example: {shown};"
            " a recording gives some (--suggest CAPTURE), and says what is wrong (--against CAPTURE)",
        )


def _witness(packet: ExampleFrame) -> str:
    return str(packet) if packet.identifier is not None else f"hex:{packet.data.hex().upper()}"


def failure(message: Message, example: Example) -> str | None:
    """Say why an example does not hold; None when it does."""
    request: Mapping[str, Any] | None = None
    if example.request is not None:
        asked = _request_of(message, example.request)
        if isinstance(asked, str):
            return asked
        request = asked
    image = example.packet.image
    try:
        values = message.struct.parse(image, request=request)
    except NotThisError as error:
        return f"it is not {message.name}: {error_text(error)}{_wanted_check(message, image, request)}"
    except LengthError as error:
        return f"its length does not go with the fields of {message.name}: {error_text(error)}"
    except WrongCheckError:
        return "its check does not hold"
    except ContentError as error:
        return f"a field cannot be read: {error_text(error)}"
    except (ConstructError, AcesError) as error:
        return f"it cannot be read: {error_text(error)}"
    found = plain_value(values)
    for name, wanted in example.fields.items():
        if name not in found:
            return f"there is no field {name!r} (there are: {', '.join(found)})"
        if not agree(found[name], wanted):
            return f"{name} is read as {show_value(found[name])}, and should be {show_value(wanted)}"
    try:
        built = bytes(message.struct.build(merge_example(values, example.fields)))
    except (ConstructError, AcesError, KeyError, TypeError, AttributeError, ValueError) as error:
        return f"its fields cannot be written: {error_text(error)}"
    if built != image and not (isinstance(message.payload, Delimited) and _reads_as(message, built, found)):
        return f"its fields are written as {_shown(built, example.packet)}"
    return _unrecognised(message, example)


def _wanted_check(message: Message, packet: bytes, request: Mapping[str, FieldValue] | None) -> str:
    """Say what the check of a packet would have to be, if its framing's check fails."""
    framing = message.framing
    if framing is None or framing.check is None:
        return ""
    asked = message.question(request)
    if framing.judge(packet, 0, silent=True, request=asked).reason != "checksum":
        return ""
    try:
        wanted, given = framing.checks_of(packet, message.check_extra, asked)
    except ValueError:
        return ""
    return f" {given.hex(' ').upper()}; by the spec it is {wanted.hex(' ').upper()}"


def _reads_as(message: Message, image: bytes, found: Any) -> bool:
    try:
        return agree(plain_value(message.struct.parse(image)), found)
    except (ConstructError, AcesError):
        return False


def _shown(image: bytes, like: ExampleFrame) -> str:
    if like.identifier is None:
        return str(ExampleFrame(image))
    number = int.from_bytes(image[:4], "big") & 0x1FFF_FFFF
    return str(ExampleFrame(image[5:], number, like.extended, like.remote, like.fd))


def _request_of(message: Message, packet: ExampleFrame) -> Mapping[str, Any] | str:
    """Return the raw fields of the request in an example, or the reason why it is not a request."""
    wanted = [*message.reply_to, *message.after]
    if not wanted:
        return f"it has a request, and {message.name} answers none (reply_to=, after=)"
    for request in wanted:
        try:
            values = request.message.struct.parse(packet.image, raw=True)
        except (ConstructError, AcesError):
            continue
        if request.accepts(values):
            return dict(values)
    return f"its request {packet} is none of {', '.join(map(str, wanted))}"


def _unrecognised(message: Message, example: Example) -> str | None:
    """Return how scanners read an example that they do not take for this message; None if any of them does."""
    others: dict[str, str] = {}
    for variant in message.protocol.variants():
        here = variant.messages.get(message.name)
        if here is None or here.place != message.place:
            continue
        found = read_example(variant, message, example)
        needs_request = found.reason.startswith("unknown: needs request")
        if found.message == message.name or (needs_request and example.request is None):
            return None
        others.setdefault(found.message or found.reason, variant.label)
    if not others:
        return "no shipped dialect and configuration has this message"
    (what, label), *_ = others.items()
    return f"in {label} it is read as {what}"


def read_example(variant: Variant, message: Message, example: Example) -> ReferenceItem:
    """Return what the reference makes of an example, its request being seen first."""
    if message.framing is None:
        reference = Reference([variant])
        frames = [*(example.frames or (example.packet,))]
        if example.request is not None:
            frames.insert(0, example.request)
        return reference.frames([example_frame(frame) for frame in frames])[-1]
    reference = Reference([variant], direction=message.direction)
    if example.request is not None:
        reference.sent(example.request.data)
    (first, *_) = reference.stream(example.packet.data)
    return first


def example_frame(packet: ExampleFrame) -> Frame:
    """Return a frame with these bytes."""
    return Frame(
        packet.identifier or 0,
        packet.data,
        is_extended_id=packet.extended,
        is_remote_frame=packet.remote,
        is_fd=packet.fd,
    )


# ---------------------------------------------------------------------- values


def merge_example(found: Any, wanted: Any) -> Any:
    """Return what was read with what an example says in its place; what the example leaves out stays as it was read."""
    if isinstance(found, Mapping) and isinstance(wanted, Mapping):
        return {**found, **{name: merge_example(found.get(name), value) for name, value in wanted.items()}}
    if isinstance(found, list) and isinstance(wanted, (list, tuple)) and len(found) == len(wanted):
        return [merge_example(pair, other) for pair, other in zip(found, wanted, strict=True)]
    return wanted


def agree(found: Any, wanted: Any) -> bool:
    """Return whether a value is what an example says: floats up to rounding, flags by name, of nested records what is
    named.
    """
    if isinstance(found, FlagSet):
        if isinstance(wanted, int):
            return int(found) == wanted
        return not found.unknown and list(found) == list(wanted)
    if isinstance(wanted, Mapping):
        return isinstance(found, Mapping) and all(
            name in found and agree(found[name], value) for name, value in wanted.items()
        )
    if isinstance(wanted, Sequence) and not isinstance(wanted, (str, bytes)):
        return (
            isinstance(found, list)
            and len(found) == len(wanted)
            and all(agree(pair, other) for pair, other in zip(found, wanted, strict=True))
        )
    if isinstance(found, float) or isinstance(wanted, float):
        if not isinstance(found, (int, float)) or not isinstance(wanted, (int, float)):
            return False
        if math.isnan(found) or math.isnan(wanted):
            return math.isnan(found) and math.isnan(wanted)
        return math.isclose(found, wanted, rel_tol=1e-6, abs_tol=1e-12)
    return bool(found == wanted)


def show_value(value: FieldValue) -> str:
    """Return a value in a sentence: bytes as hexadecimal, floats short."""
    match value:
        case bytes():
            return value.hex(" ").upper() or "no bytes"
        case FlagSet():
            return repr(value)
        case float():
            return f"{value:.9g}"
        case Mapping():
            return "{" + ", ".join(f"{name}: {show_value(item)}" for name, item in value.items()) + "}"
        case list() | tuple():
            return "[" + ", ".join(map(show_value, value)) + "]"
        case _:
            return repr(value) if isinstance(value, str) else str(value)
