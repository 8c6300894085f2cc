"""A system that has not what only Unix has: `python tests/elsewhere.py` runs the commands below as they run there.

1. Modules (`fcntl`, `termios`, …), socket families and calls that Windows lacks are taken away before anything is imported.
2. It shows that nothing needs them; it does not show Windows itself: no serial port, no file lock, no console of its own.
"""

from __future__ import annotations

import contextlib
import importlib.abc
import io
import os
import signal
import socket
import sys
import tempfile
from typing import Any

MODULES = {"fcntl", "termios", "resource", "pwd", "grp", "pty", "tty", "syslog"}
NAMES: dict[Any, tuple[str, ...]] = {
    socket: ("AF_UNIX", "AF_CAN", "AF_PACKET", "SO_PEERCRED", "SO_BINDTODEVICE"),
    os: (
        *(
            "openpty",
            "fork",
            "forkpty",
            "getuid",
            "geteuid",
            "getgid",
            "mkfifo",
            "killpg",
            "setsid",
            "getpgid",
        ),
        *(
            "sched_setscheduler",
            "sched_getaffinity",
            "sched_setaffinity",
            "posix_fallocate",
            "pidfd_open",
            "O_NOFOLLOW",
        ),
    ),
    signal: (
        *(
            "SIGUSR1",
            "SIGUSR2",
            "SIGHUP",
            "SIGQUIT",
            "SIGTSTP",
            "SIGXCPU",
            "SIGALRM",
            "SIGPIPE",
            "SIGKILL",
            "SIGCONT",
        ),
        *("SIGCHLD", "SIGWINCH", "pthread_sigmask", "pthread_kill", "setitimer", "sigwait"),
    ),
}
CONTROLLER = """
from aces_bus.controller import controller
@controller(rate_hz=100, writes=["RKN"])
def bend(t):
    return {"RKN": 0.1 * min(t, 1)}
"""
WALK = "examples/captures/hubo2plus.log"


class _Gone(importlib.abc.MetaPathFinder):
    def find_spec(self, name: str, path: Any = None, target: Any = None) -> None:
        if name in MODULES:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)


def _pair(*_: Any) -> tuple[socket.socket, socket.socket]:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        one = socket.create_connection(listener.getsockname())
        return one, listener.accept()[0]


def take_away() -> None:
    """Leave what every system has."""
    for name in MODULES:
        sys.modules.pop(name, None)
    sys.meta_path.insert(0, _Gone())
    for module, names in NAMES.items():
        for name in names:
            with contextlib.suppress(AttributeError):
                delattr(module, name)
    socket.socketpair = _pair  # type: ignore[assignment]  # as the standard library makes it there


def main() -> None:
    """Run the commands; the first that fails ends it, with what it printed."""
    take_away()
    from aces_tools.main import main as aces
    from aces_tools.verbs import verbs

    def run(*words: str) -> str:
        out, err = io.StringIO(), io.StringIO()
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            status = aces(list(words))
        if status:
            raise SystemExit(f"aces {' '.join(words)}: status {status}\n{out.getvalue()}{err.getvalue()}")
        return out.getvalue()

    for name in sorted(verbs()):
        run(*name.split(), "--help")
    with tempfile.TemporaryDirectory() as folder:
        bend = os.path.join(folder, "bend.py")
        with open(bend, "w", encoding="utf-8") as file:
            file.write(CONTROLLER)
        assert "Encoder" in run("decode", WALK, "-p", "hubo")
        run("decode", WALK, "-p", "hubo", "-o", os.path.join(folder, "walk.sqlite"))
        run("convert", WALK, os.path.join(folder, "walk.csv"))
        run("plot", WALK, "-p", "hubo", "Encoder.position.0")
        run("spec", "check", "odrive")
        run("robot", "check", "hubo2plus")
        run("run", "-r", "hubo2plus", bend, "--virtual", "--for", "0.2s")
        assert "tcp:127.0.0.1:" in run("sim", "-r", "hubo2plus", "--for", "0.3s")
        assert "socket://127.0.0.1:" in run("sim", "-r", "so101", "--for", "0.3s")
        assert "tcp:127.0.0.1:" in run("bus", "serve", "--for", "0.3s")
    print("every command ran")


if __name__ == "__main__":
    main()
