"""What clients send to a served robot, and where its socket is.

1. A message is a line of JSON, `{"do": "set", "values": {"elbow": 0.4}}`; every line gets one line as its answer, in order:
   `{"ok": …}` or `{"error": "…"}`. At its end the server sends `{"over": "why"}`. Nothing of a message is ever run.
2. A line has at most `MOST_BYTES`; fields that a message has not are errors.
3. The socket lies in a folder that is its user's alone (mode 0700), and both ends check the other's user (SO_PEERCRED).
"""

from __future__ import annotations

import os
import socket
import stat
import struct
from contextlib import suppress
from pathlib import Path

import msgspec

from aces_bus.errors import CallerError

#: The longest line (bytes), and the longest name of a client (characters).
MOST_BYTES, MOST_NAME = 1 << 16, 64
#: The longest path of a Unix socket (bytes, sun_path of unix(7) without its final zero).
MOST_PATH = 107


class ClientMessage(msgspec.Struct, frozen=True, tag_field="do", forbid_unknown_fields=True):
    """One request of a client."""


class AttachMessage(ClientMessage, frozen=True, tag="attach"):
    """Take a name, by which joints are owned."""

    name: str


class OwnMessage(ClientMessage, frozen=True, tag="own"):
    """Own joints."""

    joints: list[str]


class FreeMessage(ClientMessage, frozen=True, tag="free"):
    """Own joints (None: all) no longer."""

    joints: list[str] | None = None


class SetMessage(ClientMessage, frozen=True, tag="set"):
    """Give set-points by joint; those of other own joints stay."""

    values: dict[str, float]


class HandOverMessage(ClientMessage, frozen=True, tag="hand_over"):
    """Make the client `to` the owner of joints (None: all) of `owner`."""

    owner: str
    to: str
    joints: list[str] | None = None


class EnableMessage(ClientMessage, frozen=True, tag="enable"):
    """Enable the devices of own joints (None: all)."""

    joints: list[str] | None = None


class StopMessage(ClientMessage, frozen=True, tag="stop"):
    """Stop all devices, as `aces stop` does; the server goes on."""


class ParkMessage(ClientMessage, frozen=True, tag="park"):
    """Lead the robot to the pose of its file."""


class StatusMessage(ClientMessage, frozen=True, tag="status"):
    """Ask who owns what, and where it is."""


class ReadMessage(ClientMessage, frozen=True, tag="read"):
    """Ask for the newest values of states, such as elbow.velocity."""

    names: list[str]


AnyMessage = (
    AttachMessage
    | OwnMessage
    | FreeMessage
    | SetMessage
    | HandOverMessage
    | EnableMessage
    | StopMessage
    | ParkMessage
    | StatusMessage
    | ReadMessage
)
#: Values of states, None while they are unknown.
ReadValues = dict[str, float | bool | str | None]


class Greeting(msgspec.Struct, frozen=True):
    """The answer to `attach`: the robot, whether anything is transmitted, and the dead-man (s)."""

    robot: str
    drives: bool
    dead_man_s: float


class JointStatus(msgspec.Struct, frozen=True):
    """A joint: who owns it, whether it is enabled, its set-point, and where it is measured (None: unknown)."""

    owner: str | None
    enabled: bool
    wanted: float | None
    measured: float | None


class ServedStatus(msgspec.Struct, frozen=True):
    """A served robot: the server's process, whether it transmits, who is attached, and the joints."""

    robot: str
    process: int
    drives: bool
    clients: list[str]
    joints: dict[str, JointStatus]


class ServedAnswer(msgspec.Struct, frozen=True, omit_defaults=True):
    """Answer. `error`: why nothing was done; `device`: a device did not do it; `over`: why the server has ended."""

    ok: msgspec.Raw = msgspec.Raw(b"")
    error: str = ""
    device: bool = False
    over: str = ""

    @staticmethod
    def of(content: object) -> ServedAnswer:
        """Return the answer with this content."""
        return ServedAnswer(msgspec.Raw(msgspec.json.encode(content)))


def parse_message(line: bytes) -> AnyMessage:
    """Return the message of a line. Raises `CallerError` for anything that is not one."""
    try:
        return _DECODER.decode(line)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        raise CallerError(f"not a message: {str(error)[:200]}") from None


_DECODER: msgspec.json.Decoder[AnyMessage] = msgspec.json.Decoder(AnyMessage)


def socket_path(robot: str) -> Path:
    """Return where the robot of this name is served. Raises `CallerError` where no folder is this user's alone."""
    given = os.environ.get("XDG_RUNTIME_DIR")
    if not given:
        raise CallerError(
            "XDG_RUNTIME_DIR is not set: a served robot's socket lies there, in a folder of this user alone;"
            " set it to one: mkdir -m 700 ~/.run && export XDG_RUNTIME_DIR=~/.run"
        )
    _check_folder(Path(given), 0o022)
    folder = Path(given, "aces-robots")
    with suppress(FileExistsError):
        folder.mkdir(0o700)
    _check_folder(folder, 0o077)
    if not robot or robot.startswith(".") or "/" in robot or not robot.isprintable():
        raise CallerError(f"{robot!r} cannot be the name of a socket: name the robot with letters and digits")
    path = folder / f"{robot}.sock"
    if len(os.fsencode(path)) > MOST_PATH:
        raise CallerError(
            f"{path}: longer than the {MOST_PATH} bytes of a socket's path; shorten XDG_RUNTIME_DIR"
        )
    return path


def _check_folder(folder: Path, forbidden: int) -> None:
    try:
        found = os.lstat(folder)
    except OSError as error:
        raise CallerError(f"XDG_RUNTIME_DIR: {folder}: {error.strerror}") from error
    if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.getuid() or found.st_mode & forbidden:
        raise CallerError(
            f"XDG_RUNTIME_DIR: {folder} is not a folder of this user alone: it must be owned by the user, mode 0700"
        )


def peer_user(stream: socket.socket) -> int:
    """Return the user (uid) at the other end of a Unix socket. Raises `CallerError` where the system does not say it."""
    option = getattr(socket, "SO_PEERCRED", None)
    if option is None:
        raise CallerError("this system does not say which user is at the other end of a socket (SO_PEERCRED)")
    _, user, _ = struct.unpack("3i", stream.getsockopt(socket.SOL_SOCKET, option, struct.calcsize("3i")))
    return int(user)
