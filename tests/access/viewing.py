"""A viewer of foreign make: the package `websockets` speaks Foxglove's protocol by hand, as its page describes it.

*Source*: the protocol's text (https://github.com/foxglove/ws-protocol), subprotocol foxglove.sdk.v1: texts are JSON with
`op`; binary messages are opcode 1, subscription (u32), log time (u64, ns), payload.
"""

from __future__ import annotations

import json
import socket
import struct
import time
from collections.abc import Callable
from types import TracebackType
from typing import Any, Self

import pytest

#: How long anything may take (s), on any machine.
WAIT_S = 60.0


def free_port() -> int:
    """A port of this machine where nobody listens."""
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])


class Viewer:
    """Connects as soon as it can, and subscribes to every topic that `wants` names; a context manager."""

    def __init__(
        self, address: str, *, origin: str | None = None, wants: Callable[[str], bool] = lambda topic: True
    ) -> None:
        self.address, self.origin, self.wants = address, origin, wants
        #: By topic.
        self.channels: dict[str, dict[str, Any]] = {}
        self.messages: dict[str, list[tuple[int, dict[str, Any]]]] = {}
        #: What else was said.
        self.texts: list[dict[str, Any]] = []
        self._topics: dict[int, str] = {}
        self._next = 1

    def __enter__(self) -> Self:
        client = pytest.importorskip("websockets.sync.client")
        end = time.monotonic() + WAIT_S
        while True:
            try:
                self._way = client.connect(
                    self.address,
                    subprotocols=["foxglove.sdk.v1"],
                    origin=self.origin,
                    max_size=None,
                    compression=None,
                    open_timeout=WAIT_S,
                )
                self._ws = self._way.__enter__()
                return self
            except ConnectionRefusedError:
                if time.monotonic() > end:
                    raise
                time.sleep(0.05)

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._way.__exit__(kind, value, trace)

    def say(self, **what: Any) -> None:
        """Send a text."""
        self._ws.send(json.dumps(what))

    def say_bytes(self, data: bytes) -> None:
        """Send a binary message."""
        self._ws.send(data)

    def until(self, is_enough: Callable[[], object], again: Callable[[], object] | None = None) -> None:
        """Take what comes until it is enough; `again` is done whenever nothing comes. Fails after `WAIT_S`."""
        end = time.monotonic() + WAIT_S
        while not is_enough():
            assert time.monotonic() < end, f"{sorted(self.channels)}, {self.texts[-3:]}"
            try:
                self._take(self._ws.recv(timeout=0.1))
            except TimeoutError:
                if again is not None:
                    again()

    def to_the_end(self) -> None:
        """Take what comes until the server closes."""
        from websockets.exceptions import ConnectionClosed

        try:
            while True:
                self._take(self._ws.recv(timeout=WAIT_S))
        except ConnectionClosed:
            pass

    def has(self, topic: str, number: int = 1) -> bool:
        """Whether so many messages of a topic have come."""
        return len(self.messages.get(topic, ())) >= number

    def _take(self, one: str | bytes) -> None:
        if isinstance(one, bytes):
            opcode, subscription, instant = struct.unpack_from("<BIQ", one)
            assert opcode == 1
            message = json.loads(one[13:])
            self.messages.setdefault(self._topics[subscription], []).append((instant, message))
            return
        said = json.loads(one)
        self.texts.append(said)
        if said["op"] == "advertise":
            for channel in said["channels"]:
                self.channels[channel["topic"]] = channel
                if self.wants(channel["topic"]):
                    self._subscribe(channel["topic"])
        elif said["op"] == "status" and said["message"].startswith("Unknown channel ID: "):
            # foxglove-sdk 0.30 names a channel to its clients a moment before it knows it: ask again.
            number = int(said["message"].rpartition(" ")[2])
            self._subscribe(next(t for t, channel in self.channels.items() if channel["id"] == number))

    def _subscribe(self, topic: str) -> None:
        self._topics[self._next] = topic
        self.say(op="subscribe", subscriptions=[{"id": self._next, "channelId": self.channels[topic]["id"]}])
        self._next += 1

    def schema(self, topic: str) -> dict[str, Any]:
        """A topic's JSON schema."""
        channel = self.channels[topic]
        assert (channel["encoding"], channel["schemaEncoding"]) == ("json", "jsonschema")
        found: dict[str, Any] = json.loads(channel["schema"])
        return found
