"""What answers a message that was sent: heard, told by its request, printed.

1. A request and its reply are told by one clock, this machine's: an adapter's own does not matter.
2. Where the protocol says which messages answer the one that was sent, only these are replies; otherwise whatever is
   decoded, or, without a protocol, whatever comes.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import msgspec

from aces_bus.frames import Frame
from aces_bus.protocol import Variant, make_scanner
from aces_bus.protocol.declare.message import Message
from aces_bus.recordings import Chunk

from .console import Output
from .live import LivePatience, heard_frame
from .live_text import CandumpLines, Times

#: A frame (CAN), or the bytes of a packet.
Word = Frame | bytes
#: Seconds between two looks at whether the wait is over.
LOOK_S = 0.05


class Replies:
    """Listens to a gate from when it is made; `count` is how many replies were printed."""

    def __init__(self, output: Output, writer: Any, gate: Any, link: str, *, wait_ns: int) -> None:
        self._output, self._writer, self._link = output, writer, link
        self._name: str = gate.name
        self._is_datagrams = gate.items == "datagrams"
        self._inbox = gate.subscribe()
        self._wait_ns = wait_ns
        self._epoch_ns = time.time_ns() - time.monotonic_ns()
        self._scanner: Any = None
        self._expected: frozenset[str] = frozenset()
        self._is_broadcast = False
        self._lines = CandumpLines(Times("z"), encoding=output.encoding)
        self._is_begun = False
        self.count = 0

    def decode(
        self,
        variants: Sequence[Variant],
        variant: Variant | None,
        message: Message | None,
        fields: dict[str, Any],
    ) -> None:
        """Decode what comes; `message` of `variant`, with these fields, is what was asked."""
        messages_for: Any = (
            "from device" if message is not None and message.direction == "to device" else "both"
        )
        self._scanner = make_scanner(variants, direction=messages_for)
        self._expected = answers(variant, message)
        self._is_broadcast = is_broadcast(variant, fields)

    def sent(self, word: Word) -> None:
        """Remember what the reply will be to."""
        self.take(0)
        if self._scanner is None:
            return
        now = (time.monotonic_ns() + self._epoch_ns) / 1e9
        if isinstance(word, Frame):
            self._scanner.sent(msgspec.structs.replace(word, timestamp=now, channel=self._name))
        else:
            self._scanner.sent(word, now)

    def wait(self, patience: LivePatience) -> None:
        """Until the first reply, or until the time is up; of a broadcast all that come in time."""
        until = time.monotonic_ns() + self._wait_ns
        while not patience.is_over and (not self.count or self._is_broadcast):
            left = until - time.monotonic_ns()
            if left <= 0:
                return
            self.take(min(left / 1e9, LOOK_S))

    def take(self, timeout: float) -> None:
        """Print the replies that have come; wait so long (s) for the first."""
        for item in self._inbox.get(timeout):
            if self._scanner is None:
                self._unnamed(item)
                continue
            items = self._decoded(item)
            wanted = [one for one in items if not self._expected or type(one).__name__ in self._expected]
            if not wanted:
                continue
            if not self._is_begun:
                self._is_begun = True
                self._output.write(self._writer.begin(self._name, self._link, wanted[0].meta.time))
            self._print(self._writer.items(wanted), len(wanted))

    def _decoded(self, item: Any) -> list[Any]:
        seconds = (item.host_ns + self._epoch_ns) / 1e9
        found: list[Any]
        if self._link == "can":
            found = self._scanner.feed(
                [msgspec.structs.replace(item.content, timestamp=seconds, channel=self._name)]
            )
        elif self._is_datagrams:
            found = self._scanner.datagram(item.content, seconds)
        else:
            found = self._scanner.feed(item.content, seconds)
        return found

    def _unnamed(self, item: Any) -> None:
        if self._link == "can":
            data = self._lines.frames([heard_frame(item, self._name, self._epoch_ns)])
        else:
            data = self._lines.chunks(
                [Chunk(item.content, (item.host_ns + self._epoch_ns) / 1e9)], self._name
            )
        self._print(data, 1)

    def _print(self, data: bytes, count: int) -> None:
        self._output.write(data)
        self._output.flush()
        self.count += count


def answers(variant: Variant | None, message: Message | None) -> frozenset[str]:
    """The messages that the protocol says answer this one."""
    if variant is None or message is None:
        return frozenset()
    return frozenset(
        other.name
        for other in variant.messages.values()
        if any(request.message.name == message.name for request in (*other.reply_to, *other.after))
    )


def is_broadcast(variant: Variant | None, fields: dict[str, Any]) -> bool:
    """Whether these fields address every device."""
    if variant is None:
        return False
    return any(fields.get(name) == number for name, number in variant.protocol.broadcast.items())


__all__ = ["Replies", "Word", "answers", "is_broadcast"]
