"""The order in which messages are tried: as declared, but a message goes before those it overrides."""

from __future__ import annotations

from collections.abc import Iterable

from .message import Message


def ordered(messages: Iterable[Message]) -> list[Message]:
    """The messages in the order of trial."""
    left = list(messages)
    if not any(message.overrides for message in left):
        return left
    names = {m.name for m in left}
    done: list[Message] = []
    placed: set[str] = set()
    while left:
        # The first one that nothing left has to go before.
        for message in left:
            if not any(message.name in other.overrides for other in left if other is not message):
                break
        else:
            message = left[0]
        left.remove(message)
        done.append(message)
        placed.add(message.name)
    assert placed == names
    return done
