"""Encoders: fields in, frames or packets out.

1. What is derived (identifier, length, check, stuffing) is written by the packet, never given.
2. A value that does not fit raises, naming the message, the field, the value and what would fit.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Hashable, Mapping
from typing import Any

from construct import Construct, ConstructError, Default, Renamed
from construct import Struct as Payload

from ..errors import AcesError, CallerError, FieldError, UnknownNameError
from ..frames import EXTENDED, REMOTE, Frame, key_of
from .declare.bits import BitLayout
from .declare.message import Message
from .declare.packet import FD_FLAG
from .declare.protocol import Variant
from .generate.encode import CALLED, NoEncoder, print_encoder
from .generate.load import load_source
from .generate.source import NameScope, comment_line
from .record import FieldValue

#: Identifier, data, whether the identifier has 29 bits, whether remote, whether CAN FD.
CanParts = tuple[int, bytes, bool, bool, bool]

#: The last value of each rolling counter of each device, by `Message.counter_key`.
Counts = dict[tuple[Hashable, ...], int]


class UnusualValue(Exception):
    """A value that a printed encoder leaves to construct."""


class Encoder:
    """Builds the messages of a variant. `encode` is stateless; `next` fills in rolling counters, device by device."""

    def __init__(self, variant: Variant) -> None:
        self.variant = variant
        self._counters: Counts = {}
        #: Packets that `next` has sent, by transport and key: some transports number them.
        self._sequences: Counts = {}
        self._quick, self.source, self.through_construct = quick_encoders(variant)
        #: By message, what its fields are when they are not given: what construct would take, too.
        self._unsaid = {name: found for name in self._quick if (found := unsaid(variant[name].payload))}

    def encode(self, message: str, /, **fields: Any) -> Any:
        """Return a frame (CAN), a list of frames where a transport carries the message, or the packet's bytes, from
        values in the sheet's units. `aces_bus.frame_to_message` makes a frame a python-can message.

        Raises `UnknownNameError` for a message or field that does not exist, `FieldError` for a value that does not fit
        or is missing.
        """
        return self.build(self.variant[message], fields)

    def next(self, message: str, /, **fields: Any) -> Any:
        """Encode like `encode`, with rolling counters one more than in the last message of the same device,
        and packets of a transport numbered as it numbers them.
        """
        found = self.variant[message]
        return self.build(found, _counted(found, fields, self._counters), number=None)

    def numbered(self, number: int, message: str, /, **fields: Any) -> Any:
        """Encode like `encode`, a packet of a transport with this sequence number: an answer that has that of
        its request.
        """
        return self.build(self.variant[message], fields, number=number)

    def build(
        self, message: Message, fields: dict[str, Any], *, raw: bool = False, number: int | None = 0
    ) -> Frame | bytes | list[Frame]:
        """Return the frame or packet of `message`; a list of frames where a transport carries it, whose sequence number
        is `number` (None: the next one)."""
        built = self._built(message, fields, raw=raw)
        if isinstance(built, bytes):
            return built
        if message.transport is None:
            return _frame(built)
        return [_frame(parts) for parts in self._carried(message, built, number)]

    def packet(self, message: Message, fields: dict[str, Any]) -> Frame | bytes:
        """Return what goes out: an immutable frame (CAN) or the packet's bytes. Raises as `encode`; of a message that
        takes several frames see `as_sent`."""
        built = self._built(message, fields)
        if isinstance(built, bytes):
            return built
        if message.transport is not None:
            raise CallerError(f"{message.name} goes out in several frames ({message.transport.title})")
        return _frame(built)

    def as_sent(
        self, message: Message, fields: dict[str, Any], counts: Counts | None = None
    ) -> list[Frame | bytes]:
        """Return all that goes out for one message: one frame or packet, or the frames of its transport. Raises as
        `encode`. Packets of transports that number them continue from `counts`, which the sender keeps, or from this
        encoder's own.
        """
        built = self._built(message, fields)
        if isinstance(built, bytes):
            return [built]
        if message.transport is None:
            return [_frame(built)]
        return [_frame(parts) for parts in self._carried(message, built, None, counts)]

    def _carried(
        self, message: Message, parts: CanParts, number: int | None, counts: Counts | None = None
    ) -> list[CanParts]:
        """Return the frames of a packet, as its transport cuts it."""
        identifier, data, extended, _, _ = parts
        transport = next((way for way in message.ways if way and len(data) <= way.longest), message.ways[-1])
        assert transport is not None
        key = key_of(identifier, extended=extended)
        if number is None:
            who = (id(transport), transport.numbered_by(key))
            sequences = self._sequences if counts is None else counts
            number = sequences.get(who, 0)
            sequences[who] = number + 1
        try:
            frames = transport.split(key, data, number, message.check_extra)
        except FieldError as error:
            raise FieldError(f"{message.name}: {error}") from None
        return [
            (identifier & 0x1FFF_FFFF, piece, bool(identifier & EXTENDED), False, transport.fd)
            for identifier, piece in frames
        ]

    def writer(
        self, message: Message, tags: Mapping[str, Any], counts: Counts | None = None
    ) -> Callable[[Mapping[str, Any]], Frame | bytes | tuple[Frame | bytes, ...]]:
        """Return a `packet` function of one message for one device: its fields `tags` are prepared, and need
        not be given again. Of a message that a transport carries it returns a tuple of frames. Rolling counters that are
        not given continue from `counts`, which the sender keeps.
        """
        quick = self._quick.get(message.name)

        def whole(fields: Mapping[str, FieldValue]) -> dict[str, Any]:
            given = {**tags, **fields}
            return given if counts is None else _counted(message, given, counts)

        def usual(fields: Mapping[str, Any]) -> Frame | bytes:
            return self.packet(message, whole(fields))

        if message.transport is not None:
            return lambda fields: tuple(self.as_sent(message, whole(fields), counts))
        if quick is None or message.framing is not None:
            return usual
        known = {**self._unsaid.get(message.name, {}), **tags}
        extended, remote, fd = message.extended, message.remote, message.fd

        def write(fields: Mapping[str, Any]) -> Frame | bytes:
            try:
                identifier, head, body = quick({**known, **fields})
            except USUAL_FAILURES:
                return usual(fields)  # construct decides, and explains
            return Frame(identifier, head + body, None, None, extended, remote, False, fd)

        return write

    def _built(self, message: Message, fields: dict[str, Any], *, raw: bool = False) -> CanParts | bytes:
        """Return the packet's bytes; on CAN the parts of the frame."""
        quick = self._quick.get(message.name) if not raw else None
        if quick is not None:
            more = self._unsaid.get(message.name)
            own = fields if more is None else {**more, **fields}
            if message.request_fields:
                own = {name: value for name, value in own.items() if name not in message.request_fields}
            try:
                identifier, head, body = quick(own)
                framing = message.framing
                if framing is not None:
                    asked = message.question(fields) if framing.covers_request else b""
                    return bytes(message.struct.framed(framing, head, body, asked))
                return identifier, head + body, message.extended, message.remote, message.fd
            except USUAL_FAILURES:
                pass  # construct decides, and explains
        image = self.image(message, fields, raw=raw)
        return image if message.framing is not None else can_parts(image)

    def image(self, message: Message, fields: dict[str, Any], *, raw: bool = False) -> bytes:
        """Return the packet's bytes; on CAN, the image that `message.struct` parses."""
        known = set(message.fields)
        for name in fields:
            if name not in known:
                raise UnknownNameError(f"field of {message.name}", name, message.fields)
        try:
            return bytes(message.struct.build(fields, raw=raw))
        except FieldError as error:
            raise FieldError(
                f"{message.name}: {_short(str(error)).removeprefix(f'{message.name}: ')}"
            ) from None
        except Exception as error:  # whatever a construct raises: the value does not fit it
            raise FieldError(f"{message.name}: {_explain(error, message, fields)}") from None


#: What construct says of a value that a number of the struct module does not take.
_UNFIT = re.compile(r"(.*?):? struct '[<>=]?([bBhHiIlLqQefd])' error during building, given value (.*)")


def _short(text: str) -> str:
    """Shorten `(building) -> speed: …` to `speed: …`, and a name that its own field repeats."""
    text = text.replace("(building) -> ", "").replace("(building): ", "")
    return re.sub(r"\b(\w+) -> (?=\1\b)", "", text)


def _explain(error: Exception, message: Message, fields: Mapping[str, FieldValue]) -> str:
    given = {*fields, *message.request_fields, *unsaid(message.payload)}
    missing = [name for name in message.fields if name not in given]
    if isinstance(error, KeyError) and missing:
        return f"no value given for {', '.join(missing)}"
    text = re.sub(r"^Error in path (.*)\n", r"\1: ", _short(str(error)))
    text = " ".join(text.replace("Error in path ", "").split())
    unfit = _UNFIT.match(text)
    if unfit is None:
        return text or type(error).__name__
    path, form, value = unfit.groups()
    if form in "efd" or not re.fullmatch(r"-?\d+", value):
        return f"{path}: {value} is not a number that fits"
    width = 8 * struct.calcsize(f"<{form}")
    low, high = (0, (1 << width) - 1) if form.isupper() else (-(1 << width - 1), (1 << width - 1) - 1)
    return f"{path}: {value} is outside {low}…{high}"


def unsaid(payload: Construct) -> dict[str, Any]:
    """Return what the fields of a payload are when they are not given: constants of `Default`, no reserved bits,
    nothing behind.
    """
    found: dict[str, Any] = {}
    fields: list[tuple[str | None, Any]]
    if isinstance(payload, BitLayout):
        fields = [(slot.name, slot.field) for slot in payload.slots]
        if payload.has_reserved:
            found["reserved"] = 0
        if payload.trailing:
            found[payload.trailing] = b""
    elif isinstance(payload, Payload):
        fields = [(item.name, item.subcon if isinstance(item, Renamed) else item) for item in payload.subcons]
    else:
        return {}
    for name, field in fields:
        while isinstance(field, Renamed):
            field = field.subcon
        if name and isinstance(field, Default) and not callable(field.value):
            found[name] = field.value
    return found


#: What printed encoders raise for a value that they leave to construct.
USUAL_FAILURES = (
    UnusualValue,
    struct.error,
    AcesError,
    ConstructError,
    KeyError,
    TypeError,
    ValueError,
    AttributeError,
    OverflowError,
)


def quick_encoders(
    variant: Variant,
) -> tuple[dict[str, Callable[[dict[str, Any]], Any]], str, dict[str, str]]:
    """Return the printed encoders of a variant, their source, and why the other messages are built by construct."""
    lines = [f'"""Encoders of {comment_line(variant.label)}: generated from its spec."""', ""]
    names = NameScope(CALLED)
    functions: dict[str, str] = {}
    others: dict[str, str] = {}
    for message in variant.messages.values():
        try:
            functions[message.name], printed = print_encoder(message, message.plan, names)
        except NoEncoder as reason:
            others[message.name] = str(reason)
            continue
        lines += ["", *printed, ""]
    source = "\n".join(lines) + "\n"
    called = {"Struct": struct.Struct, "Unusual": UnusualValue, **names.bound}
    space = load_source(source, f"aces {variant.label} encoders", called)
    return {name: space[function] for name, function in functions.items()}, source, others


def _counted(message: Message, fields: Mapping[str, FieldValue], counts: Counts) -> dict[str, Any]:
    """Return fields with the rolling counters that are not given: each one more than the last in `counts`."""
    found = dict(fields)
    for name, modulo in message.counters.items():
        if name not in fields:
            key = message.counter_key(name, fields)
            found[name] = counts[key] = (counts.get(key, -1) + 1) % modulo
    return found


def _frame(parts: CanParts) -> Frame:
    identifier, data, extended, remote, fd = parts
    return Frame(identifier, data, is_extended_id=extended, is_remote_frame=remote, is_fd=fd)


def can_parts(image: bytes) -> CanParts:
    """Return identifier, data, whether extended, remote, CAN FD, of a frame's image."""
    word = int.from_bytes(image[:4], "big")
    return word & 0x1FFF_FFFF, image[5:], bool(word & EXTENDED), bool(word & REMOTE), bool(image[4] & FD_FLAG)
