"""Requests that are waiting for their reply, and modes that stick: what bytes alone do not say.

1. The context of a reply is the latest request that fits it: same channel, equal shared captures, not consumed, not
   older than `within`. A mode (`after`) is the latest request of its kind, and is never consumed.
2. Memory is bounded: the last `DEPTH` requests of a kind and device, and the `DEVICES` devices asked last.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from ..declare.ambiguity import request_names
from ..declare.message import Message, Request

DEPTH = 8
DEVICES = 65536


@dataclass
class Entry:
    """A request that was seen."""

    number: int
    time: float | None
    values: Mapping[str, Any]
    consumed: bool = False
    #: Of a request to everyone: who has answered it.
    answered: set[tuple[Any, ...]] = field(default_factory=set)


@dataclass(frozen=True)
class RequestLink:
    """One way in which a message hangs on a request: the fields that both have must be equal."""

    request: Request
    shared: tuple[str, ...]
    is_sticky: bool


class Context:
    """What has been asked on each channel."""

    def __init__(
        self, messages: Sequence[Message], names: frozenset[str], broadcast: Mapping[str, int]
    ) -> None:
        self._links: dict[str, list[RequestLink]] = {}
        self._kinds: dict[str, set[tuple[str, ...]]] = {}
        self._seen: dict[tuple[Any, ...], list[Entry]] = {}
        self._count = 0
        self._broadcast = broadcast
        #: The names of the requests that have passed.
        self.noted: set[str] = set()
        #: Messages to note; and those that need no request to be recognised, but use one up: give them to `of`.
        self.requests, self.answers = request_names(messages, names)
        for message in messages:
            if message.name in names:
                self._link(message, message.reply_to, is_sticky=False)
                self._link(message, message.after, is_sticky=True)
            elif message.name in self.answers:
                some = tuple(one for one in message.reply_to if one.message.name in self.requests)
                self._link(message, some, is_sticky=False)

    def _link(self, message: Message, requests: Sequence[Request], *, is_sticky: bool) -> None:
        links = self._links.setdefault(message.name, [])
        for request in requests:
            shared = tuple(sorted(message.outer_names & request.message.outer_names))
            links.append(RequestLink(request, shared, is_sticky))
            self._kinds.setdefault(request.message.name, set()).add(shared)

    def reset(self) -> None:
        """Forget what has been asked."""
        self._seen.clear()
        self.noted.clear()
        self._count = 0

    def note(self, name: str, channel: Any, time: float | None, values: Mapping[str, Any]) -> None:
        """A request has passed."""
        self._count += 1
        self.noted.add(name)
        entry = Entry(self._count, time, values)
        for shared in self._kinds[name]:
            key = (name, channel, shared, tuple(values.get(n) for n in shared))
            entries = self._seen.setdefault(key, [])
            if len(self._seen) > DEVICES:
                del self._seen[next(iter(self._seen))]
            entries.append(entry)
            del entries[:-DEPTH]

    def requests_of(self, name: str) -> frozenset[str]:
        """The names of the requests that this message may hang on."""
        return frozenset(link.request.message.name for link in self._links[name])

    def of(
        self, candidates: Sequence[tuple[Message, Mapping[str, Any]]], channel: Any, time: float | None
    ) -> tuple[Message, Mapping[str, Any]] | None:
        """Which candidate (a message and its raw fields) the context allows, with the request's values.

        Uses up the request, unless it is a mode; one that was addressed to everyone, for the device that answers.
        """
        latest: Entry | None = None
        found: list[tuple[Entry, RequestLink, bool, Message, Mapping[str, Any]]] = []
        for message, values in candidates:
            for link in self._links[message.name]:
                for wanted, to_all in self._wanted(link, values):
                    entry = self._latest(link, channel, wanted, values, message.within, time)
                    if entry is None:
                        continue
                    found.append((entry, link, to_all, message, values))
                    if latest is None or entry.number > latest.number:
                        latest = entry
        for entry, link, to_all, message, values in found:
            if entry is latest and link.request.accepts(entry.values):
                if to_all and not link.is_sticky:
                    entry.answered.add(_who(link, values))
                else:
                    entry.consumed = not link.is_sticky
                return message, entry.values
        return None

    def pending(
        self, message: Message, values: Mapping[str, Any], channel: Any, time: float | None
    ) -> Mapping[str, Any] | None:
        """The request that a reply with these outer fields would answer: for payloads whose layout is in their request."""
        latest: Entry | None = None
        for link in self._links[message.name]:
            for wanted, _ in self._wanted(link, values):
                entry = self._latest(link, channel, wanted, values, message.within, time)
                if entry is not None and link.request.accepts(entry.values):
                    if latest is None or entry.number > latest.number:
                        latest = entry
        return latest.values if latest is not None else None

    def _wanted(self, link: RequestLink, values: Mapping[str, Any]) -> list[tuple[tuple[Any, ...], bool]]:
        own = _who(link, values)
        if self._broadcast.keys().isdisjoint(link.shared):
            return [(own, False)]
        every = tuple(self._broadcast.get(name, value) for name, value in zip(link.shared, own, strict=True))
        return [(own, False)] if every == own else [(own, False), (every, True)]

    def _latest(
        self,
        link: RequestLink,
        channel: Any,
        wanted: tuple[Any, ...],
        values: Mapping[str, Any],
        within: float | None,
        time: float | None,
    ) -> Entry | None:
        entries = self._seen.get((link.request.message.name, channel, link.shared, wanted), ())
        for entry in reversed(entries):
            if entry.consumed or (entry.answered and _who(link, values) in entry.answered):
                continue
            if None not in (within, time, entry.time) and time - entry.time > within:  # type: ignore[operator]
                return None
            return entry
        return None

    def needs(self, messages: Sequence[Message]) -> str:
        """`needs request A|B`, for messages that had none."""
        names = dict.fromkeys(link.request.message.name for m in messages for link in self._links[m.name])
        return f"unknown: needs request {'|'.join(names)}"


def _who(link: RequestLink, values: Mapping[str, Any]) -> tuple[Any, ...]:
    """The device that `values` are of."""
    return tuple(values.get(name) for name in link.shared)
