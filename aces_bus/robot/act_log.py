"""The record of who did what to a robot: enabling, stops, owners of set-points, limits, e-stops and trips, a line each.

1. It is only appended to: several programs may write one file, and what another wrote is never touched.
2. A line is with the system when `note` returns, so that it survives `kill -9` of the program; not a loss of power.
3. What happens in each tick is not in it. A write that fails is counted, and stops nothing.

Each line is a JSON object: `time` (UTC), `what`, `who` (device, input, controller or robot), `detail`, `owner` (who gives
the device's set-points), `program`, `pid` and `user`.
"""

from __future__ import annotations

import json
import os
import stat
import sys
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any, Final

from ..errors import CallerError
from .rig import Rig

if TYPE_CHECKING:
    from .runner import Runner

#: Events that are written; all acts are.
KINDS: Final = frozenset(
    ("estop", "estop clear", "reduced", "full speed", "trip", "not stopped", "following error", "refused")
)
#: The longest text that a line repeats.
LONGEST: Final = 1000


class ActLog:
    """An append-only record of what was done to a robot; see the module. A context manager: it closes its file.

    Raises `CallerError` for a path that cannot be appended to.
    """

    def __init__(self, path: str | os.PathLike[str], program: str = "") -> None:
        self.path = os.fspath(path)
        self.program = program or os.path.basename(sys.argv[0] or "python")
        #: How many lines were written; why the last that was not could not be.
        self.written, self.failure = 0, ""
        try:
            self._file = os.open(
                self.path, os.O_RDWR | os.O_APPEND | os.O_CREAT | os.O_NONBLOCK | os.O_CLOEXEC, 0o644
            )
        except OSError as error:
            raise CallerError(f"{self.path}: {error.strerror}") from error
        status = os.fstat(self._file)
        if not stat.S_ISREG(status.st_mode):
            os.close(self._file)
            raise CallerError(f"{self.path}: is not a file that can be appended to")
        # A line that another program could not finish stays by itself.
        is_cut = status.st_size > 0 and os.pread(self._file, 1, status.st_size - 1) != b"\n"
        self._begin = b"\n" if is_cut else b""
        self._owned: Any = lambda who: ""
        self._user = _user()

    def keep(self, robot: Rig | Runner) -> ActLog:
        """Write what is done to a rig, or in a run, from now on."""
        rig = robot if isinstance(robot, Rig) else robot.rig
        door, devices = rig.door, rig.devices

        def owned(who: str) -> str:
            device = devices.get(who)
            owners = door.owners if device is not None else {}
            return (
                ", ".join(dict.fromkeys(owners[name] for name in device.signals if name in owners))
                if device
                else ""
            )

        self._owned = owned
        rig.events.acts.append(self.note)
        if isinstance(robot, Rig):
            robot.on_event(self._happened)
        else:
            robot.handlers.append(self._happened)
        return self

    def _happened(self, event: Any) -> None:
        if event.kind in KINDS:
            self.note(event.kind, event.source, event.detail)

    def note(self, what: str, who: str = "", detail: str = "") -> None:
        """Append one line."""
        line = {
            "time": datetime.now(UTC).isoformat(timespec="microseconds"),
            "what": what,
            "who": who,
            "detail": detail[:LONGEST],
            "owner": self._owned(who),
            "program": self.program,
            "pid": os.getpid(),
            "user": self._user,
        }
        data = (
            self._begin
            + json.dumps({key: value for key, value in line.items() if value != ""}).encode()
            + b"\n"
        )
        try:
            if os.write(self._file, data) != len(data):
                raise OSError(0, "the line was cut: no room")
        except OSError as error:
            self.failure, self._begin = error.strerror or str(error), b"\n"
            return
        self.written, self._begin = self.written + 1, b""

    def close(self) -> None:
        """Close the file; nothing is written any more."""
        if self._file >= 0:
            file, self._file = self._file, -1
            os.close(file)

    def __enter__(self) -> ActLog:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __str__(self) -> str:
        lost = f"; not whole: {self.failure}" if self.failure else ""
        return f"{self.path}: {self.written} lines of who did what{lost}"


def _user() -> str:
    """Return the user's name, or number where the system has no name for it."""
    import getpass

    try:
        return getpass.getuser()
    except (OSError, KeyError, ImportError):
        return str(os.getuid()) if hasattr(os, "getuid") else "unknown"
