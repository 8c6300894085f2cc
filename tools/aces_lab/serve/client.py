"""A robot that another program serves, as a client in Python sees it.

1. Every call sends a message and waits for its answer; it raises what the server refuses.
2. Whoever leaves, or gives no set-points for the server's dead-man, loses its joints: they stand still.
"""

from __future__ import annotations

import os
import socket
import threading
from collections.abc import Mapping
from contextlib import suppress
from typing import Self, TypeVar

import msgspec

from aces_bus.errors import CallerError, DeviceError
from aces_bus.plain_text import printable

from .messages import MOST_BYTES, Greeting, ReadValues, ServedAnswer, ServedStatus, peer_user, socket_path

T = TypeVar("T")

#: How long an answer may take (s): enabling a robot takes its time.
PATIENCE_S = 30.0


class ServedRobot:
    """A robot that `aces robot serve` holds. A context manager: at its end own joints stand still, and are free.

    with ServedRobot("arm", "wave") as robot:
        robot.own("shoulder", "elbow")
        robot.set({"shoulder": 0.4})          # and again, at least every robot.dead_man_s seconds
        robot.hand_over("grasp", "shoulder")

    `name` is what others call it; without one it looks, stops, parks, and owns nothing. Calls may come from any thread.
    Raises `CallerError` where the robot is not served, or by another user, and where the name is taken.
    """

    def __init__(self, robot: str, name: str = "", *, patience_s: float = PATIENCE_S) -> None:
        path = socket_path(robot)
        self._lock = threading.Lock()
        self._received = bytearray()
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            self._socket.settimeout(patience_s)
            try:
                self._socket.connect(os.fspath(path))
            except OSError as error:
                raise CallerError(
                    f"{robot} is not served: {path}: {error.strerror or error}; start it: aces robot serve {robot}"
                ) from error
            if peer_user(self._socket) != os.getuid():
                raise CallerError(f"{path} is served by another user")
            self.robot, self.name = robot, name
            #: Silence (s) after which own joints stand still and are free; whether the server transmits.
            self.dead_man_s, self.drives = 0.0, False
            if name:
                said = self._ask("attach", Greeting, name=name)
                self.dead_man_s, self.drives = said.dead_man_s, said.drives
        except BaseException:
            self._socket.close()
            raise

    # ------------------------------------------------------------------ joints

    def own(self, *joints: str) -> None:
        """Own these joints. Raises `CallerError` naming the owner of a joint that has one; then none is owned."""
        self._ask("own", bool, joints=list(joints))

    def free(self, *joints: str) -> None:
        """Have own joints (none named: all) stand still, and nobody own them."""
        self._ask("free", bool, joints=list(joints) or None)

    def set(self, values: Mapping[str, float]) -> None:
        """Give set-points (rad, m, or the unit of what a joint takes), and keep those of the other own joints.

        Raises `CallerError` where one of them cannot be taken; then none is.
        """
        self._ask("set", bool, values=dict(values))

    def hand_over(self, to: str, *joints: str, owner: str = "") -> list[str]:
        """Make another client the owner of joints (none named: all) of `owner` (default: this client), and return them.

        They go on as they are; the other client's dead-man begins.
        """
        asked = list(joints) or None
        return self._ask("hand_over", list[str], owner=owner or self.name, to=to, joints=asked)

    # ------------------------------------------------------------------ the robot

    def enable(self, *joints: str) -> None:
        """Enable the devices of own joints (none named: all), and wait. Raises `DeviceError` with who was not enabled."""
        self._ask("enable", bool, joints=list(joints) or None)

    def stop(self) -> None:
        """Stop all devices, and wait until they have. Nobody owns anything then. Raises `DeviceError` with who has not."""
        self._ask("stop", bool)

    def park(self) -> list[str]:
        """Begin to lead the robot to the pose of its file, whoever owned its joints; those that are led."""
        return self._ask("park", list[str])

    def status(self) -> ServedStatus:
        """Return who is attached, and of each joint owner, whether it is enabled, set-point and measured position."""
        return self._ask("status", ServedStatus)

    def read(self, *names: str) -> ReadValues:
        """Return the newest values of states, such as "elbow" and "elbow.velocity"; None: unknown."""
        return self._ask("read", ReadValues, names=list(names))

    # ------------------------------------------------------------------ messages

    def _ask(self, what: str, kind: type[T], **fields: object) -> T:
        """Send a message and return its answer. Raises what the server refuses, `DeviceError` where there is none."""
        line = msgspec.json.encode({"do": what, **fields}) + b"\n"
        if len(line) > MOST_BYTES:
            raise CallerError(f"{what}: a message of more than {MOST_BYTES} bytes")
        with self._lock:
            try:
                self._socket.sendall(line)
                answer = self._next_answer()
            except OSError as error:
                answer = ServedAnswer(over=str(error))
                with suppress(OSError, msgspec.MsgspecError):  # it may have said why
                    answer = self._next_answer()
        if answer.over:
            raise DeviceError(f"{self.robot} is not served any more: {printable(answer.over)}")
        if answer.error:
            error_class = DeviceError if answer.device else CallerError
            raise error_class(f"{self.robot}: {printable(answer.error)}")
        return msgspec.json.decode(answer.ok, type=kind)

    def _next_answer(self) -> ServedAnswer:
        while (end := self._received.find(b"\n")) < 0:
            data = self._socket.recv(MOST_BYTES)
            if not data:
                raise ConnectionError("its server is gone")
            self._received += data
        line = bytes(self._received[:end])
        del self._received[: end + 1]
        return msgspec.json.decode(line, type=ServedAnswer)

    def close(self) -> None:
        """Leave: own joints stand still, and are free."""
        self._socket.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
