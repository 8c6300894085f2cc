"""Requests that are waiting for their reply, and modes that stick: what bytes alone do not say.

1. The context of a reply is the latest request that fits it: same channel, equal shared captures, not consumed, not
   older than `within`. A mode (`after`) is the latest request of its kind, whether or not a reply has consumed it.
2. An answer that no byte marks is awaited while the latest request that such answers hang on is pending, and is its
   request: a newer request ends the wait for the answer to an older one.
3. Memory is bounded: the last `REQUESTS` requests of a kind and device, and the `DEVICES` devices asked last.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from ...compiling import mypyc_attr
from ..declare.ambiguity import request_names
from ..declare.message import REQUESTS, Message, Request
from ..record import FieldValue

DEVICES = 65536


#: What names a device among the raw fields of a message, as one value a field.
Who = Callable[[Mapping[str, Any]], tuple[Hashable, ...]]


@dataclass(slots=True)
class Entry:
    """A request that was seen."""

    number: int
    time: float | None
    values: Mapping[str, FieldValue]
    consumed: bool = False
    #: Of a request to everyone: who has answered it.
    answered: set[tuple[Hashable, ...]] = field(default_factory=set)


@dataclass(frozen=True, slots=True)
class RequestLink:
    """One way in which a message hangs on a request: the fields that both have, of which `who` is made, must be equal.

    `to_all` is what stands in them in a request to everybody, None for a field that is as in the reply; empty where there
    are no such requests.
    """

    request: Request
    shared: tuple[str, ...]
    is_sticky: bool
    who: Who
    to_all: tuple[int | None, ...]


#: Where requests are found; and in which of these places, the message that hangs on it, and what it has to say.
Modes = tuple[list[Any], list[tuple[int, Message, Request]]]


@mypyc_attr(allow_interpreted_subclasses=True)
class Context:
    """What has been asked on each channel."""

    def __init__(
        self,
        messages: Sequence[Message],
        names: frozenset[str],
        broadcast: Mapping[str, int],
        unmarked: Sequence[Message] = (),
    ) -> None:
        self._links: dict[str, list[RequestLink]] = {}
        #: By request, the sets of fields that replies share with it, each with what makes a device of them.
        self._kinds: dict[str, dict[tuple[str, ...], Who]] = {}
        #: By message, all fields that it shares with its requests: what `of` looks at.
        self.shared: dict[str, tuple[str, ...]] = {}
        self._seen: dict[tuple[Hashable, ...], list[Entry]] = {}
        self._count = 0
        self._broadcast = broadcast
        #: The names of the requests that have passed.
        self.noted: set[str] = set()
        #: By request, the answers without a mark that hang on it; and the latest of these requests, with its name.
        self._unmarked: dict[str, list[tuple[Message, RequestLink]]] = {}
        self._last: tuple[str, Entry] | None = None
        #: What `awaited` has said last, and of when.
        self._awaited: Sequence[tuple[Message, Mapping[str, Any]]] = ()
        self._awaited_at: tuple[int, bool, float | None] | None = None
        #: Messages to note; and those that need no request to be recognised, but use one up: give them to `of`.
        self.requests, self.answers = request_names(messages, names)
        for message in messages:
            if message.name in names:
                self._link(message, message.reply_to, is_sticky=False)
                self._link(message, message.after, is_sticky=True)
            elif message.name in self.answers:
                some = tuple(request for request in message.reply_to if request.message.name in self.requests)
                self._link(message, some, is_sticky=False)
        for message in unmarked:
            for link in self._links[message.name]:
                self._unmarked.setdefault(link.request.message.name, []).append((message, link))

    def _link(self, message: Message, requests: Sequence[Request], *, is_sticky: bool) -> None:
        links = self._links.setdefault(message.name, [])
        for request in requests:
            shared = tuple(sorted(message.outer_names & request.message.outer_names))
            who = _who_of(shared)
            to_all = tuple(self._broadcast.get(name) for name in shared)
            is_common = any(name in self._broadcast for name in shared)
            links.append(RequestLink(request, shared, is_sticky, who, to_all if is_common else ()))
            self._kinds.setdefault(request.message.name, {})[shared] = who
        self.shared[message.name] = tuple(dict.fromkeys(name for link in links for name in link.shared))

    def reset(self) -> None:
        """Forget what has been asked."""
        self._seen.clear()
        self.noted.clear()
        self._count = 0
        self._last = self._awaited_at = None

    def note(
        self, name: str, channel: str | int | None, time: float | None, values: Mapping[str, FieldValue]
    ) -> None:
        """Note that a request has passed."""
        self.noting(name, channel, time, values)()

    def noting(
        self, name: str, channel: str | int | None, time: float | None, values: Mapping[str, FieldValue]
    ) -> Callable[[], None]:
        """Return a function to call whenever this request has passed: for a request that is repeated."""
        keys = [(name, channel, shared, who(values)) for shared, who in self._kinds[name].items()]
        is_asking = name in self._unmarked

        def note() -> None:
            self._count += 1
            self.noted.add(name)
            entry = Entry(self._count, time, values)
            if is_asking:
                self._last = name, entry
            seen = self._seen
            for key in keys:
                entries = seen.get(key)
                if entries is None:
                    entries = seen[key] = []
                    if len(seen) > DEVICES:
                        del seen[next(iter(seen))]
                entries.append(entry)
                if len(entries) > REQUESTS:
                    del entries[:-REQUESTS]

        return note

    def awaited(self, time: float | None) -> Sequence[tuple[Message, Mapping[str, Any]]]:
        """Return the answers without a mark that are awaited, each with the latest request, which it answers."""
        if self._last is None:
            return ()
        name, entry = self._last
        now = (entry.number, entry.consumed, time)
        if now != self._awaited_at:  # it is asked of each such framing at each byte
            self._awaited_at = now
            self._awaited = [
                (message, entry.values)
                for message, link in self._unmarked[name]
                if (link.is_sticky or not entry.consumed)
                and link.request.accepts(entry.values)
                and (None in (message.within, time, entry.time) or time - entry.time <= message.within)  # type: ignore[operator]
            ]
        return self._awaited

    def requests_of(self, name: str) -> frozenset[str]:
        """Return the names of the requests that this message may hang on."""
        return frozenset(link.request.message.name for link in self._links[name])

    def of(
        self, candidates: Sequence[tuple[Message, Mapping[str, Any]]], channel: Any, time: float | None
    ) -> tuple[Message, Mapping[str, Any]] | None:
        """Return which candidate (a message and its raw `shared` fields) the context allows, with the request's values.

        Uses up the request, unless it is a mode; one that was addressed to everyone, for the device that answers.
        """
        latest: Entry | None = None
        found: list[tuple[Entry, RequestLink, bool, Message, Mapping[str, Any]]] = []
        for message, values in candidates:
            for link in self._links[message.name]:
                who = link.who(values)
                for wanted, to_all in _wanted(link, who):
                    entry = self._latest(link, channel, wanted, who, message.within, time)
                    if entry is None:
                        continue
                    found.append((entry, link, to_all, message, values))
                    if latest is None or entry.number > latest.number:
                        latest = entry
        for entry, link, to_all, message, values in found:
            if entry is latest and link.request.accepts(entry.values):
                if link.is_sticky:
                    pass  # a mode stays
                elif to_all:
                    entry.answered.add(link.who(values))
                else:
                    entry.consumed = True
                return message, entry.values
        return None

    def modes_of(
        self, messages: Sequence[Message], identifier: int, channel: str | int | None
    ) -> Modes | None:
        """Return for `mode` the requests that messages with this identifier hang on, and where each is found.

        None where the identifier alone does not say, or a request is used up or too old some time.
        """
        places: dict[Hashable, int] = {}
        found: list[tuple[int, Message, Request]] = []
        for message in messages:
            outer = message.identifier.match(identifier) or {}
            for link in self._links[message.name]:
                if not link.is_sticky or message.within is not None or not outer.keys() >= {*link.shared}:
                    return None
                for wanted, _ in _wanted(link, link.who(outer)):
                    place = (link.request.message.name, channel, link.shared, wanted)
                    found.append((places.setdefault(place, len(places)), message, link.request))
        return [*places], found

    def mode(self, modes: Modes) -> tuple[Message, Mapping[str, Any]] | None:
        """Return what `of` gives where all of these messages fit; None where it is to be asked."""
        seen = self._seen
        latest: Entry | None = None
        last: list[Entry | None] = []
        for place in modes[0]:
            entries = seen.get(place)
            entry = entries[-1] if entries else None
            last.append(entry)
            if entry is not None:
                if entry.consumed or entry.answered:
                    return None
                if latest is None or entry.number > latest.number:
                    latest = entry
        if latest is not None:
            for at, message, request in modes[1]:
                if last[at] is latest and request.accepts(latest.values):
                    return message, latest.values
        return None

    def pending(
        self,
        message: Message,
        values: Mapping[str, FieldValue],
        channel: str | int | None,
        time: float | None,
    ) -> Mapping[str, Any] | None:
        """Return the request that a reply with these outer fields would answer: for payloads whose layout is in their
        request.
        """
        latest: Entry | None = None
        for link in self._links[message.name]:
            who = link.who(values)
            for wanted, _ in _wanted(link, who):
                entry = self._latest(link, channel, wanted, who, message.within, time)
                if entry is not None and link.request.accepts(entry.values):
                    if latest is None or entry.number > latest.number:
                        latest = entry
        return latest.values if latest is not None else None

    def _latest(
        self,
        link: RequestLink,
        channel: str | int | None,
        wanted: tuple[Hashable, ...],
        who: tuple[Hashable, ...],
        within: float | None,
        time: float | None,
    ) -> Entry | None:
        entries = self._seen.get((link.request.message.name, channel, link.shared, wanted), ())
        for entry in reversed(entries):
            if not link.is_sticky and (entry.consumed or (entry.answered and who in entry.answered)):
                continue
            if None not in (within, time, entry.time) and time - entry.time > within:  # type: ignore[operator]
                return None
            return entry
        return None

    def needs(self, messages: Sequence[Message]) -> str:
        """Return `needs request A|B`, for messages that had none."""
        names = dict.fromkeys(link.request.message.name for m in messages for link in self._links[m.name])
        return f"unknown: needs request {'|'.join(names)}"


def _wanted(link: RequestLink, who: tuple[Hashable, ...]) -> Sequence[tuple[tuple[Hashable, ...], bool]]:
    """Return what a request to the device `who` has in the shared fields, and one to everybody, with whether it is that."""
    if not link.to_all:
        return ((who, False),)
    every = tuple(own if all_ is None else all_ for all_, own in zip(link.to_all, who, strict=True))
    return ((who, False),) if every == who else ((who, False), (every, True))


def _who_of(shared: tuple[str, ...]) -> Who:
    """Return the values of these fields, None where there is none; of one field without a loop, as it is for most
    replies.
    """
    if len(shared) == 1:
        name = shared[0]
        return lambda values: (values.get(name),)
    return lambda values: tuple(values.get(name) for name in shared)
