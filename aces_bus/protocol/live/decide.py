"""From messages to one function that decides among them: constants first, then requests, then order.

1. A message that needs its request is tried before those that do not, and only with its request.
2. Requests are noted as they are decoded, whether or not their records are used.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from functools import lru_cache, partial
from typing import Any
from weakref import WeakKeyDictionary

from ...compiling import mypyc_attr
from ..declare.ambiguity import framings_in_order, needing_context, ordered, unmarked_answers
from ..declare.message import GivenWay, Message
from ..declare.protocol import Variant
from ..generate.load import decoders_of, load_source
from ..generate.scan import Choice, choose, print_choice
from ..generate.source import SourceText
from ..record import Record, field_names
from .context import Context, Modes

#: Devices whose rolling counters are remembered.
REMEMBERED = 65536

#: (data, key, time, channel, raw, rx[, request]) to a record, or None.
Decode = Callable[..., Any]


#: Of so many messages the decode functions are made when a packet of theirs comes: most never do.
MANY = 32


class _Later:
    """A decode function that is made when it is first called."""

    __slots__ = ("_decode", "_make")

    def __init__(self, make: Callable[[], Decode]) -> None:
        self._make = make
        self._decode: Decode | None = None

    def __call__(self, *arguments: Any) -> Any:
        if self._decode is None:
            self._decode = self._make()
        return self._decode(*arguments)


@lru_cache(maxsize=512)
def _choice_of(messages: tuple[Message, ...], name: str) -> str:
    """Return the printed choice among messages; of one protocol many scanners are made."""
    choice: Choice = choose([m.plan for m in messages])
    out = SourceText()
    print_choice(out, name, choice)
    return out.text()


@mypyc_attr(allow_interpreted_subclasses=True)
class Decider:
    """One variant in one direction: its messages in order of trial, and what they hang on."""

    def __init__(self, variant: Variant, direction: GivenWay | None, *, raw: bool) -> None:
        self.variant = variant
        self.messages = ordered(variant.readable(direction))
        self.decoders = decoders_of(variant, raw)
        self._quick = decoders_of(variant, raw, False)
        self.raw_decoders = decoders_of(variant, True)
        self.contextual = needing_context(self.messages)
        #: Answers that only a pending request tells from other bytes, and their framings.
        self.unmarked = unmarked_answers(self.messages, self.contextual)
        self.answering = frozenset(message.framing for message in self.unmarked)
        #: The framings of its messages in order of trial.
        self.framings = framings_in_order(self.messages, self.unmarked)
        self.context = Context(self.messages, self.contextual, variant.protocol.broadcast, self.unmarked)
        #: What `sent` looks for: requests, whichever way this scanner faces.
        self.asked = [m for m in ordered(variant.messages.values()) if m.name in self.context.requests]
        self._chosen: dict[tuple[str, ...], Decode] = {}
        #: The printed choices, for those who want to read them.
        self.source = ""
        #: Messages that rolling counters say were missed.
        self.missed = 0
        #: The key of the last packet that is recognised only with its request, and why; asked by `need_of`.
        self._need: tuple[int, str] = (-1, "")
        #: The last value of each rolling counter of each device on each channel, whichever function decodes it.
        self.last_counts: dict[tuple[Hashable, ...], int] = {}

    def reset(self) -> None:
        """Forget requests and rolling counters."""
        self.context.reset()
        self.last_counts.clear()
        self.missed, self._need = 0, (-1, "")

    def need_of(self, key: int) -> str:
        """Return the reason when the packet `key` just refused is a reply without its request, else empty."""
        return self._need[1] if self._need[0] == key else ""

    def forget_need(self) -> None:
        """Forget the packet that needed a request: another protocol has decoded it."""
        self._need = (-1, "")

    def decide(self, messages: Sequence[Message], *, alone: bool = False) -> Decode:
        """Return the function that decides among `messages`.

        `alone` says that the caller takes `struct.error` for None, which saves the usual frame a length check.
        """
        messages = ordered(messages)
        names = tuple(m.name for m in messages)
        if alone and len(messages) == 1 and self._is_simple(messages[0]):
            return self._quick[names[0]]
        if names not in self._chosen:
            self._chosen[names] = self._made(messages)
        return self._chosen[names]

    def _is_simple(self, message: Message) -> bool:
        names = (self.context.requests, self.context.answers, self.contextual)
        return not message.counters and not any(message.name in some for some in names)

    def _made(self, messages: Sequence[Message]) -> Decode:
        plain = [m for m in messages if m.name not in self.contextual]
        bound = [m for m in messages if m.name in self.contextual]
        functions = {
            m.name: _Later(partial(self._noting, m)) if len(plain) > MANY else self._noting(m) for m in plain
        }
        decode: Decode | None = None
        if len(plain) == 1:
            decode = functions[plain[0].name]
        elif plain:
            name = f"choose_{len(self._chosen)}"
            source = _choice_of(tuple(plain), name)
            self.source += source
            space = load_source(
                source,
                f"aces {self.variant.label} {name}",
                {f"decode_{n}": f for n, f in functions.items()},
            )
            decode = space[name]
        if bound:
            return self._with_context(bound, decode)
        assert decode is not None
        return decode

    def _noting(self, message: Message) -> Decode:
        """Return the decode function of a message, which also notes it when replies hang on it, or uses up what it
        answers.
        """
        decode = self.decoders[message.name]
        if message.counters:
            decode = _counting(decode, message, self)
        is_request, is_answer = message.name in self.context.requests, message.name in self.context.answers
        if not is_request and not is_answer:
            return decode

        def noted(
            data: bytes,
            key: int,
            time: float | None,
            channel: str | int | None,
            packet: bytes,
            rx: bool | None,
        ) -> Any:
            record = decode(data, key, time, channel, packet, rx)
            if record is not None and is_answer:
                seen = self.raw_decoders[message.name](data, key, time, channel, packet, None)
                self.context.of([(message, self._shared(message, seen))], channel, time)
            if record is not None and is_request:
                self.note(message, data, key, time, channel, packet)
            return record

        return noted

    def note(
        self,
        message: Message,
        data: bytes,
        key: int,
        time: float | None,
        channel: str | int | None,
        packet: bytes,
    ) -> bool:
        """Note a packet that may be the request `message`; whether it is."""
        values = self.request_values(message, data, key, packet)
        if values is not None:
            self.context.note(message.name, channel, time, values)
        return values is not None

    def request_values(
        self, message: Message, data: bytes, key: int, packet: bytes
    ) -> Mapping[str, Any] | None:
        """Return the fields of a packet as the request `message`; None if it is another message."""
        seen = self.raw_decoders[message.name](data, key, None, None, packet, None)
        return None if seen is None else _values(seen)

    def _shared(self, message: Message, record: Record) -> dict[str, Any]:
        """Return what a raw record has in the fields that its message shares with its requests."""
        return {name: getattr(record, name, None) for name in self.context.shared[message.name]}

    def _with_context(self, bound: Sequence[Message], otherwise: Decode | None) -> Decode:
        """Return a decoder that tries replies which only their request tells apart, then messages without a request."""
        context, raw, decoders = self.context, self.raw_decoders, self.decoders
        asked = {message: context.requests_of(message.name) for message in bound}
        is_unmarked = bound[0] in self.unmarked

        def fit(
            messages: Sequence[Message],
            data: bytes,
            key: int,
            time: float | None,
            channel: str | int | None,
            packet: bytes,
            rx: bool | None,
        ) -> list[tuple[Message, dict[str, Any]]]:
            """Return those that the bytes may be, with what they share with their requests."""
            fitting = []
            for message in messages:
                seen = raw[message.name](data, key, time, channel, packet, rx)
                if (
                    seen is None
                    and message.request_fields
                    and (outer := message.outer(data, key & 0x1FFF_FFFF)) is not None
                ):
                    # The layout may be in the request.
                    request = context.pending(message, outer, channel, time)
                    seen = (
                        raw[message.name](data, key, time, channel, packet, rx, request)
                        if request is not None
                        else None
                    )
                if seen is not None:
                    fitting.append((message, self._shared(message, seen)))
            return fitting

        likely: list[Message] = []
        noted = set[str]()
        #: By key and channel, where the mode is asked for before the bytes are looked at; None: the bytes come first.
        modes: dict[tuple[int, Any], Modes | None] = {}
        is_plain = all(m.framing is None and m.transport is None for m in bound)

        def by_mode(
            data: bytes,
            key: int,
            time: float | None,
            channel: str | int | None,
            packet: bytes,
            rx: bool | None,
        ) -> Any:
            """Return the record of the message that the mode says, where the bytes fit it: the same, and quicker."""
            try:
                some = modes[key, channel]
            except KeyError:
                some = context.modes_of(bound, key & 0x1FFF_FFFF, channel) if is_plain else None
                if len(modes) < REMEMBERED:
                    modes[key, channel] = some
            found = None if some is None else context.mode(some)
            if found is None:
                return None
            message, request = found
            more = (request,) if message.request_fields else ()
            return decoders[message.name](data, key, time, channel, packet, rx, *more)

        def decode(
            data: bytes,
            key: int,
            time: float | None,
            channel: str | int | None,
            packet: bytes,
            rx: bool | None,
        ) -> Any:
            nonlocal likely, noted
            if is_plain and (record := by_mode(data, key, time, channel, packet, rx)) is not None:
                return record
            if is_unmarked:
                awaited = [message for message, _ in context.awaited(time)]
                likely = [message for message in bound if message in awaited]
            elif context.noted != noted:  # what was never asked cannot be answered
                noted = set(context.noted)
                likely = [message for message in bound if not noted.isdisjoint(asked[message])]
            fitting = fit(likely, data, key, time, channel, packet, rx) if likely else []
            if fitting:
                found = context.of(fitting, channel, time)
                if found is not None:
                    message, request = found
                    more = (request,) if message.request_fields else ()
                    return decoders[message.name](data, key, time, channel, packet, rx, *more)
            record = otherwise(data, key, time, channel, packet, rx) if otherwise is not None else None
            if record is None and not self.need_of(key):
                fitting = fit(bound, data, key, time, channel, packet, rx)
                if fitting:
                    self._need = (key, context.needs([m for m, _ in fitting]))
            return record

        return decode


def _values(record: Record) -> dict[str, Any]:
    """Return the fields of a raw record, for the memory of requests."""
    kind = type(record)
    names = _names.get(kind)
    if names is None:
        names = _names[kind] = field_names(kind)
    return {name: getattr(record, name) for name in names}


#: The fields of record types, which do not change. Weak: a type lives as long as its scanner.
_names: WeakKeyDictionary[type, tuple[str, ...]] = WeakKeyDictionary()


def _counting(decode: Decode, message: Message, decider: Decider) -> Decode:
    """Watch a message's rolling counters and count what they show as missed."""
    last = decider.last_counts
    raw = decider.raw_decoders[message.name]

    def counted(
        data: bytes, key: int, time: float | None, channel: str | int | None, packet: bytes, rx: bool | None
    ) -> Any:
        record = decode(data, key, time, channel, packet, rx)
        if record is not None:
            seen = _values(raw(data, key, time, channel, packet, rx))
            for name, modulo in message.counters.items():
                who = (channel, *message.counter_key(name, seen))
                before = last.get(who)
                if before is not None:
                    decider.missed += (seen[name] - before - 1) % modulo
                if before is not None or len(last) < REMEMBERED:
                    last[who] = seen[name]
        return record

    return counted
