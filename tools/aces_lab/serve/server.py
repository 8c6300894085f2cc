"""The socket of a served robot: clients in, answers out, without a thread: `poll` is called every millisecond.

1. A client costs at most `MOST_LINES` messages in a poll, one line and one answer of memory; a client that does not read its
   answers is not served until it does. Nothing that it sends raises from `poll`.
2. Lines of a client wait while its `enable` or `stop` is under way, whose answer says how that ended.
3. A client that is gone loses its joints at once; one that is silent loses them by the desk's dead-man.
"""

from __future__ import annotations

import errno
import os
import select
import socket
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial

import msgspec

from aces_bus.device import Job
from aces_bus.errors import AcesError, CallerError, DeviceError
from aces_bus.plain_text import printable
from aces_bus.robot.rig import Rig

from . import messages
from .desk import PARKING, Desk
from .messages import MOST_BYTES, MOST_NAME, Greeting, JointStatus, ReadValues, ServedAnswer, ServedStatus

#: Clients at a time; messages of one client in a poll.
MOST_CLIENTS, MOST_LINES = 16, 16


class ServedClient:
    """One program that is connected."""

    def __init__(self, stream: socket.socket) -> None:
        stream.setblocking(False)
        self.stream = stream
        self.name = ""
        self.received, self.unsent = bytearray(), bytearray()
        #: Whether the rest of a line that is too long is being left out.
        self.is_skipping = False
        self.job: Job | None = None

    def next_line(self) -> bytes | None:
        """Return the next complete line; None: there is none. Raises `CallerError`, once, for a line that is too long."""
        while True:
            end = self.received.find(b"\n")
            if end < 0:
                is_long = len(self.received) > MOST_BYTES
                if is_long:
                    self.received.clear()
                if is_long and not self.is_skipping:
                    self.is_skipping = True
                    raise CallerError(f"a line of more than {MOST_BYTES} bytes")
                return None
            line = bytes(self.received[:end])
            del self.received[: end + 1]
            if self.is_skipping:
                self.is_skipping = False
            elif end > MOST_BYTES:
                raise CallerError(f"a line of more than {MOST_BYTES} bytes")
            elif line.strip():
                return line


class RobotServer:
    """The clients of a desk. `drives` False: nothing is transmitted. `report` gets a sentence about who comes and goes.

    Raises `CallerError` for a robot that is served already, and a path that cannot be had.
    """

    def __init__(
        self,
        path: os.PathLike[str],
        desk: Desk,
        *,
        drives: bool,
        report: Callable[[str], object] = lambda text: None,
    ) -> None:
        self.path, self.desk, self.drives, self.report = os.fspath(path), desk, drives, report
        self.clients: list[ServedClient] = []
        self._listener = _listener(self.path)
        self._rig: Rig | None = None

    # ------------------------------------------------------------------ clients

    def poll(self, rig: Rig) -> None:
        """Serve who is there, on any one thread that is not the buses'; never waits, and raises nothing."""
        self._rig = rig
        files: list[socket.socket] = [self._listener, *(client.stream for client in self.clients)]
        blocked = [client.stream for client in self.clients if client.unsent]
        try:
            readable, writable, _ = select.select(files, blocked, (), 0)
        except (OSError, ValueError) as error:  # a file number that select does not take
            self.report(f"serve: {_text_of(error)}")
            return
        if self._listener in readable:
            self._accept()
        for client in list(self.clients):
            if client.stream in writable:
                self._send(client)
            if client.stream in readable and len(client.received) <= MOST_BYTES:
                self._receive(client)
            if client in self.clients:
                self._serve(client)

    def _accept(self) -> None:
        with suppress(OSError):
            stream, _ = self._listener.accept()
            try:
                user = messages.peer_user(stream)
                if user != os.getuid():
                    raise CallerError(f"this robot is served for user {os.getuid()} only")
                if len(self.clients) >= MOST_CLIENTS:
                    raise CallerError(f"{MOST_CLIENTS} clients are connected already")
            except CallerError as error:
                self.report(f"serve: a client was refused: {error}")
                stream.setblocking(False)
                with suppress(OSError):
                    stream.send(msgspec.json.encode(ServedAnswer(error=str(error))) + b"\n")
                stream.close()
                return
            self.clients.append(ServedClient(stream))

    def _receive(self, client: ServedClient) -> None:
        try:
            data = client.stream.recv(MOST_BYTES)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if data:
            client.received += data
        else:
            self._lose(client, "is gone")

    def _lose(self, client: ServedClient, why: str) -> None:
        if client in self.clients:
            self.clients.remove(client)
        client.stream.close()
        if client.name:
            self.desk.lost(client.name, why)
            self.report(f"{client.name}: {why}")

    def _send(self, client: ServedClient) -> None:
        try:
            sent = client.stream.send(client.unsent)
        except BlockingIOError:
            return
        except OSError:
            self._lose(client, "is gone")
            return
        del client.unsent[:sent]

    def _answer(self, client: ServedClient, answer: ServedAnswer) -> None:
        client.unsent += msgspec.json.encode(answer) + b"\n"
        self._send(client)

    def _serve(self, client: ServedClient) -> None:
        """Carry out what a client has sent, line by line."""
        for _ in range(MOST_LINES):
            if client.job is not None:
                if not client.job.is_over:
                    self.desk.keep(client.name)
                    return
                job, client.job = client.job, None
                self._answer(client, ServedAnswer.of(True) if job.error is None else _refusal(job.error))
            if client.unsent or client not in self.clients:
                return
            answer: ServedAnswer | None
            try:
                line = client.next_line()
                if line is None:
                    return
                answer = self._carry_out(client, messages.parse_message(line))
            except AcesError as error:
                answer = _refusal(error)
            except Exception as error:  # a fault of ours is not to end what the others do
                self.report(f"serve: {_text_of(error)}")
                answer = ServedAnswer(error=f"a fault of the server: {_text_of(error)}")
            if answer is not None:
                self._answer(client, answer)

    # ------------------------------------------------------------------ messages

    def _carry_out(self, client: ServedClient, request: messages.AnyMessage) -> ServedAnswer | None:
        """Return the answer; None: it follows when the client's job is over. Raises `AcesError`."""
        desk = self.desk
        match request:
            case messages.AttachMessage(name):
                self._attach(client, name)
                return ServedAnswer.of(Greeting(desk.robot.name, self.drives, desk.dead_man_s))
            case messages.StatusMessage():
                return ServedAnswer.of(self._status())
            case messages.ReadMessage(names):
                return ServedAnswer.of(self._values(names))
            case messages.StopMessage():
                self._stop(client)
                return None
            case messages.ParkMessage():
                return ServedAnswer.of(desk.park())
            case messages.HandOverMessage(owner, to, joints):
                if to not in self._names:
                    raise CallerError(
                        f"{to!r} is not attached (there are: {', '.join(self._names) or 'none'})"
                    )
                return ServedAnswer.of(desk.hand_over(owner, to, joints))
            case _:
                pass
        if not client.name:
            raise CallerError("attach first, with a name")
        match request:
            case messages.OwnMessage(joints):
                desk.own(client.name, joints)
            case messages.FreeMessage(joints):
                desk.free(client.name, joints)
            case messages.SetMessage(values):
                desk.set(client.name, values)
            case messages.EnableMessage(joints):
                self._enable(client, joints)
                return None
            case _:
                raise CallerError(f"{type(request).__name__} is not carried out")
        return ServedAnswer.of(True)

    @property
    def _names(self) -> list[str]:
        return [client.name for client in self.clients if client.name]

    def _attach(self, client: ServedClient, name: str) -> None:
        if client.name:
            raise CallerError(f"it is attached as {client.name}")
        if not name.strip() or not name.isprintable() or len(name) > MOST_NAME or name == PARKING:
            raise CallerError(f"a name has 1 to {MOST_NAME} printable characters, and is not {PARKING!r}")
        if name in self._names:
            raise CallerError(f"another client is attached as {name}")
        client.name = name
        self.report(f"{printable(name)}: attached")

    @property
    def rig(self) -> Rig:
        """The rig of the run."""
        assert self._rig is not None
        return self._rig

    def _begin(self, client: ServedClient, begin: Callable[[], Job], finished: Callable[[], object]) -> None:
        """Begin a job of the robot's, whose end is the answer. `finished` is called when it has succeeded."""
        if not self.drives:
            raise CallerError("this server transmits nothing: start it with --tx")
        client.job = self.rig.clock.call(begin)

        def over(job: Job) -> None:
            if job.error is None:
                finished()

        client.job.then(over)

    def _enable(self, client: ServedClient, names: Sequence[str] | None) -> None:
        desk, rig = self.desk, self.rig
        mine = desk.of(client.name)
        joints = mine if names is None else desk.joints(names)
        if not joints:
            raise CallerError("own the joints that are to be enabled first")
        for joint in joints:
            if joint not in mine:
                raise CallerError(f"{joint} is not owned by {client.name}: own it first")
        devices = {rig.device(joint).name: rig.device(joint) for joint in joints}
        together = [joint.name for device in devices.values() for joint in device.joints]
        for joint in together:
            other = desk.owners.get(joint, client.name)
            if other != client.name:
                raise CallerError(f"{joint} is owned by {other}, and would be enabled, too")
        self._begin(client, lambda: rig.each("enable", devices.values()), partial(desk.enabled, together))

    def _stop(self, client: ServedClient) -> None:
        if self.drives:
            self.desk.drop()
            who = client.name or "a client"
            self.report(f"stopped by {who}; own joints and enable them to go on")
        self._begin(client, self.rig.stop_motion, lambda: None)

    def _values(self, names: Sequence[str]) -> ReadValues:
        found = {name: self.rig[name].value for name in names}
        return {
            name: value if isinstance(value, int | float | str) else None for name, value in found.items()
        }

    def _status(self) -> ServedStatus:
        desk = self.desk
        measured = self._values([joint for joint, state in desk.state_of.items() if "." not in state])
        joints: dict[str, JointStatus] = {}
        for joint in desk.state_of:
            value = measured.get(joint)
            joints[joint] = JointStatus(
                desk.owners.get(joint),
                joint in desk.live,
                desk.wanted.get(joint),
                value if isinstance(value, int | float) else None,
            )
        return ServedStatus(desk.robot.name, os.getpid(), self.drives, self._names, joints)

    # ------------------------------------------------------------------ the end

    def close(self, reason: str = "") -> None:
        """Say that it is over, and serve nobody any more."""
        for client in list(self.clients):
            self._answer(client, ServedAnswer(over=reason or "its run has ended"))
        for client in self.clients:
            client.stream.close()
        self.clients.clear()
        self._listener.close()
        with suppress(OSError):
            os.unlink(self.path)


def _text_of(error: Exception) -> str:
    return f"{type(error).__name__}: {error}"


def _refusal(error: AcesError) -> ServedAnswer:
    """Return the answer for what was not done; `device`: a device did not do it."""
    return ServedAnswer(error=str(error), device=isinstance(error, DeviceError))


def _listener(path: str) -> socket.socket:
    """Return a socket that listens at `path`, in place of what a killed server has left there."""
    made = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        made.setblocking(False)
        try:
            made.bind(path)
        except OSError as error:
            if error.errno != errno.EADDRINUSE or _is_served(path):
                raise
            os.unlink(path)
            made.bind(path)
        os.chmod(path, 0o600)
        made.listen(MOST_CLIENTS)
    except OSError as error:
        made.close()
        served = "it is served already" if error.errno == errno.EADDRINUSE else error.strerror
        raise CallerError(f"{path}: {served}") from error
    return made


def _is_served(path: str) -> bool:
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        try:
            probe.connect(path)
        except OSError:
            return False
    return True
