"""Witnesses: what scanner and reference make of the bytes on which a proof failed; on paper, and as a capture."""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Mapping
from pathlib import Path

from aces_bus import Frame, FrameTable, Unknown, as_dict
from aces_bus.errors import AcesError
from aces_bus.frames import EXTENDED, FD, REMOTE
from aces_bus.protocol import FlagSet, Message, Record, Variant
from aces_bus.protocol.declare.packet import key_image
from aces_bus.protocol.record import plain_value
from aces_tools.output.text import Paint

from .decoding import Witness

#: Values of fields as they are compared.
Value = int | float | str | bytes | list["Value"] | dict[str, "Value"] | None
Plain = dict[str, Value]
Decode = Callable[..., Record | None]
Encode = Callable[[dict[str, Value]], tuple[int, bytes, bytes]]


def image_of(message: Message | None, witness: Witness) -> bytes:
    """Return what `message.struct` parses: a frame's image, or the packet on the wire with its length and check written.

    Without a message the bytes are a stream's, as they are.
    """
    if witness.key is not None:
        return key_image(witness.key, witness.data)
    if message is None or message.framing is None:
        return witness.data
    framing, data = message.framing, witness.data
    end = len(data) - framing.check_size - len(framing.end)
    head, body = data[len(framing.sync) : message.payload_start], data[message.payload_start : max(end, 0)]
    try:
        return bytes(message.struct.framed(framing, head, body, message.question(request_of(message))))
    except (AcesError, ValueError, OverflowError):  # no packet of this message is so
        return data


def request_of(message: Message) -> dict[str, int] | None:
    """Return a request that the message answers, where its framing's check covers it."""
    if message.framing is None or not message.framing.covers_request:
        return None
    return {name: min(wanted) for name, wanted in message.reply_to[0].values}


def frame_of(witness: Witness) -> Frame:
    """Return the frame of a witness on CAN."""
    key = witness.key or 0
    return Frame(
        key & 0x1FFF_FFFF,
        witness.data,
        0.0,
        "can0",
        bool(key & EXTENDED),
        bool(key & REMOTE),
        False,
        bool(key & FD),
    )


def by_reference(message: Message, image: bytes, *, raw: bool = True) -> Plain | None:
    """Return the fields that the reference reads; None when it refuses."""
    try:
        values = message.struct.parse(image, raw=raw, request=request_of(message))
    except Exception:  # whatever a construct raises
        return None
    return {name: plain_value(values[name]) for name in message.fields}


def by_function(
    message: Message, decode: Decode, witness: Witness, image: bytes, *, quick: bool = False
) -> Plain | None:
    """Return the fields that a generated function reads, or what it raises; None when it refuses."""
    framing = message.framing
    try:
        data = witness.data if framing is None else framing.logical(image)
        request = request_of(message)
        more = () if request is None else (request,)
        record = decode(data, witness.key or 0, None, None, image, None, *more)
    except Exception as error:
        return None if quick and isinstance(error, struct.error) else {"raises": type(error).__name__}
    return None if record is None else {name: plain_value(getattr(record, name)) for name in message.fields}


def by_encoder(message: Message, encode: Encode, image: bytes) -> bytes | None:
    """Return the image that a generated encoder makes of what the reference reads; None where it leaves it to construct."""
    request = request_of(message)
    values = message.struct.parse(image, raw=False, request=request)
    fields = {name: values[name] for name in message.fields if name not in message.request_fields}
    try:
        identifier, head, body = encode(fields)
        if message.framing is not None:
            return bytes(message.struct.framed(message.framing, head, body, message.question(request)))
    except Exception:  # construct decides
        return None
    flags = int.from_bytes(image[:4], "big") & ~0x1FFF_FFFF
    return (flags | int(identifier)).to_bytes(4, "big") + image[4:5] + bytes(head + body)


def plain_meaning(values: Mapping[str, object] | None) -> Plain | None:
    """Return the declaration's fields as plain values, as the reference's are compared."""
    return None if values is None else {name: plain_value(value) for name, value in values.items()}


def text_of(value: Plain | None) -> str:
    """Return fields as a text to compare: NaN is NaN."""
    return repr(value)


def value_in_record(record: Record, path: str) -> Value:
    """Return the value of a record at a path of names and numbers, as `channels.0`; a flag set as its number."""
    held: Record | Value = record
    for step in path.split("."):
        if step.isdigit() and isinstance(held, tuple | list):
            held = held[int(step)]
        else:
            held = getattr(held, step)
    found: Value = int(held) if isinstance(held, FlagSet) else plain_value(held)
    return found


def explained(
    variant: Variant, message: Message | None, witness: Witness, width: int | None, paint: Paint
) -> list[str]:
    """Return the witness as `aces spec explain` shows it."""
    from aces_bus.protocol.explain.tracer import Tracer
    from aces_tools.authoring.explain_text import attempt_lines

    tracer = Tracer([variant])
    if witness.key is not None:
        attempts = tracer.explain_frames([frame_of(witness)], 0) + tracer.explain_end()
    else:
        attempts = tracer.explain_stream(image_of(message, witness))
    return [line for attempt in attempts[:3] for line in attempt_lines(attempt, width, paint)]


def save(name: str, message: Message | None, witness: Witness, folder: Path) -> Path:
    """Write the witness as a capture that `aces decode` and `aces spec explain` read; return its path."""
    from aces_bus.recordings.write import open_writer

    folder.mkdir(parents=True, exist_ok=True)
    name = re.sub(r"\W+", "_", name)
    if witness.key is None:
        path = folder / f"{name}.bin"
        path.write_bytes(image_of(message, witness))
        return path
    path = folder / f"{name}.log"
    with open(path, "wb") as file, open_writer(file, "candump") as writer:
        writer.write(FrameTable.from_frames([frame_of(witness)]))
    return path


def scanned(variant: Variant, message: Message | None, witness: Witness) -> tuple[str, str]:
    """Return what the live scanner and the reference make of the witness alone, each in one line."""
    from aces_bus import make_scanner
    from aces_bus.protocol.reference import Reference

    way = witness.way if message is None else message.direction
    scanner = make_scanner([variant], direction=way, include_unknown=True, raw=True)
    reference = Reference([variant], direction=way, raw=True)
    image = image_of(message, witness)
    if witness.key is not None:
        records = scanner.feed([frame_of(witness)])
        items = reference.frames([frame_of(witness)])
    else:
        records = [*scanner.feed(image), *scanner.close()]
        items = reference.stream(image)
    live = "; ".join(
        r.reason if isinstance(r, Unknown) else _line(type(r).__name__, plain_value(as_dict(r)))
        for r in records
    )
    slow = "; ".join(
        _line(i.message or i.reason, None if i.fields is None else plain_value(i.fields)) for i in items
    )
    return live or "nothing", slow or "nothing"


def _line(name: str, fields: Plain | None) -> str:
    return (
        name
        if fields is None
        else f"{name}({', '.join(f'{key}={value!r}' for key, value in fields.items())})"
    )
