"""Which messages the frames of a key may be: one variant's part of a CAN scanner, from key to the function that decodes it.

1. What hangs on the messages alone is made once for all scanners of a variant and direction.
2. Few numbers are spelt out in a table; patterns with many are searched by the bits that never vary, not tried in turn.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import lru_cache

from construct import ConstructError

from ...errors import AcesError
from ..declare.message import GivenWay, Message
from ..declare.packet import ContentError, LengthError, WrongCheckError, key_image
from ..declare.protocol import Variant
from ..declare.transport import Transport
from ..keys import EXTENDED, FD, REMOTE, key_of
from .decide import REMEMBERED, Decider, Decode

#: Identifier patterns up to this many numbers are spelt out in the table; larger ones are matched and then remembered.
SPELT_OUT = 4096
#: The same where all of them together have more numbers than are remembered (a database of J1939 messages).
SPELT_OUT_OF_MANY = 16


_KINDS = EXTENDED | REMOTE | FD


def _kinds_of(message: Message) -> list[int]:
    """Return the flags of the keys of a message's frames."""
    return [key_of(0, extended=message.extended, remote=message.remote, fd=fd) for fd in message.formats]


class _Index:
    """Messages by those bits of their keys that never vary: what a key may be is found without trying them all."""

    def __init__(self, messages: Sequence[Message]) -> None:
        self._by_mask: dict[int, dict[int, list[tuple[int, Message]]]] = {}
        for number, message in enumerate(messages):
            flags = _kinds_of(message)[0]
            mask = message.identifier.fixed | _KINDS
            mask = mask & ~FD if message.any_format else mask
            key = (message.identifier.constant | flags) & mask
            self._by_mask.setdefault(mask, {}).setdefault(key, []).append((number, message))

    def of(self, key: int) -> list[Message]:
        """Return the messages whose identifier and flags fit, in order."""
        identifier = key & 0x1FFF_FFFF
        found = [
            (number, message)
            for mask, table in self._by_mask.items()
            for number, message in table.get(key & mask, ())
            if message.identifier.match(identifier) is not None and key & _KINDS in _kinds_of(message)
        ]
        if len(found) > 1:
            found.sort(key=lambda entry: entry[0])
        return [message for _, message in found]


class _Keys:
    """What the keys of CAN frames may be, by the messages alone: the same for every scanner of a variant and direction."""

    def __init__(self, messages: Sequence[Message]) -> None:
        patterns: list[Message] = []
        by_key: dict[int, list[Message]] = {}
        total = sum(len(m.identifier) for m in messages if len(m.identifier) <= SPELT_OUT)
        most = SPELT_OUT if total <= REMEMBERED else SPELT_OUT_OF_MANY
        for message in messages:
            if len(message.identifier) <= most:
                for flags in _kinds_of(message):
                    for identifier in message.identifier:
                        by_key.setdefault(identifier | flags, []).append(message)
            else:
                patterns.append(message)
        self.has_patterns = bool(patterns)
        self.patterns, self.all = _Index(patterns), _Index(messages)
        same: dict[tuple[Message, ...], tuple[Message, ...]] = {}
        #: The candidates of each key that is spelt out.
        self.spelt_out: dict[int, tuple[Message, ...]] = {}
        for key, known in by_key.items():
            found = (*known, *self.patterns.of(key)) if patterns else tuple(known)
            self.spelt_out[key] = same.setdefault(found, found)


@lru_cache(maxsize=32)
def _keys(messages: tuple[Message, ...]) -> _Keys:
    return _Keys(messages)


class CanDecider(Decider):
    """One variant's part of a CAN scanner: from key to the function that decodes it."""

    def __init__(self, variant: Variant, direction: GivenWay | None, *, raw: bool) -> None:
        super().__init__(variant, direction, raw=raw)
        #: The keys of frames (None), and of the packets of each transport.
        self._spaces = {
            transport: _keys(tuple(m for m in self.messages if m.transport == transport))
            for transport in (
                None,
                *dict.fromkeys(m.transport for m in self.messages if m.transport is not None),
            )
        }
        #: The candidates of each key that is spelt out.
        self.spelt_out = self._spaces[None].spelt_out

    @property
    def transports(self) -> list[Transport]:
        """Transports of the messages that are longer than a frame."""
        return [transport for transport in self._spaces if transport is not None]

    def carried_by(self, key: int) -> Transport | None:
        """Return the transport whose frames have a key, which is without the flag of CAN FD."""
        for transport, keys in self._spaces.items():
            if transport is not None and (keys.all.of(key) or transport.is_own(key)):
                return transport
        return None

    def candidates(self, key: int, transport: Transport | None = None) -> list[Message]:
        """Return the messages whose identifier and flags fit, in order; of a `transport`, those of its packets."""
        keys = self._spaces.get(transport)
        return keys.all.of(key) if keys is not None else []

    @staticmethod
    def matching(key: int, messages: Iterable[Message]) -> list[Message]:
        """Return those of `messages` whose identifier and flags fit."""
        identifier = key & 0x1FFF_FFFF
        return [
            m for m in messages if key & _KINDS in _kinds_of(m) and m.identifier.match(identifier) is not None
        ]

    def lookup(self, key: int, transport: Transport | None = None) -> Decode | None:
        """Return the function that decodes a key; None for one that no message has."""
        keys = self._spaces.get(transport)
        found: Sequence[Message] = keys.spelt_out.get(key, ()) if keys is not None else ()
        if not found and keys is not None and keys.has_patterns:
            found = keys.patterns.of(key)
        return self.decide(found, alone=True) if found else None

    def reason(self, key: int, data: bytes, transport: Transport | None = None) -> str:
        """Why a frame, or a packet of a `transport`, was not decoded."""
        need = self.need_of(key)
        if need:
            self.forget_need()
            return need
        image = key_image(key, data)
        for message in self.candidates(key, transport):
            try:
                message.struct.parse(image, raw=True)
            except LengthError:
                return f"malformed: length {len(data)}, {message.name} has {message.describe_lengths}"
            except WrongCheckError:
                return "malformed: checksum"
            except ContentError as error:
                if error.what and not message.request_fields:
                    return f"malformed: {error.what}"
            except (ConstructError, AcesError):
                continue
        return "unknown"
