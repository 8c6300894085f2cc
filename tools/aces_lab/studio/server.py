"""The web server of the studio, on loopback; and what all pages share.

1. The socket is bound before anything is printed, and to this machine alone.
2. No path comes from a page: recordings, protocols and the draft are those of the command line.
3. A page is built anew for each browser tab; what a tab sorts, filters or marks is its own.
"""

from __future__ import annotations

import socket
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Any

from aces_bus.errors import CallerError
from aces_bus.protocol import Variant

from .capture import Capture
from .gate import PageGate

if TYPE_CHECKING:
    from .draft import Draft

HOST = "127.0.0.1"
#: Connections at once: browsers open six for each page.
MOST_CONNECTIONS = 128


@dataclass
class Studio:
    """What the command line named: the capture, the protocols that decode it, the draft."""

    capture: Capture
    variants: Sequence[Variant] = ()
    #: Recordings as they were typed, -p as they were typed, and the name of the bus.
    recordings: Sequence[str] = ()
    protocols: Sequence[str] = ()
    bus: str = ""
    draft: Draft | None = None

    @property
    def title(self) -> str:
        """Names of what is looked at."""
        return self.bus or ", ".join(name.replace("\\", "/").rpartition("/")[2] for name in self.recordings)


def require_nicegui() -> None:
    """Raise `CallerError` naming the extra when the page's library is missing."""
    try:
        for library in ("nicegui", "uvicorn"):
            import_module(library)
    except ImportError as missing:
        raise CallerError(
            f"the studio needs NiceGUI: pip install 'aces-bus[studio]' ({missing})"
        ) from missing


def bound_socket(port: int) -> socket.socket:
    """Return a socket that listens on loopback; port 0 takes one that is free. Raises `CallerError` when it is taken."""
    try:
        return socket.create_server((HOST, port), backlog=64)
    except (OSError, OverflowError) as error:
        raise CallerError(
            f"--port {port} cannot be served ({error}); --port 0 takes one that is free"
        ) from None


class Server:
    """Serves a studio at a bound socket until `run` is interrupted. `url` leads a browser in."""

    def __init__(self, studio: Studio, listener: socket.socket) -> None:
        import uvicorn
        from fastapi import FastAPI
        from nicegui import ui

        from .page import add_page

        self._listener = listener
        port = int(listener.getsockname()[1])
        application = FastAPI(docs_url=None, redoc_url=None, openapi_url=None)
        add_page(studio)
        options: dict[str, Any] = {"dark": None, "message_history_length": 50, "show_welcome_message": False}
        ui.run_with(application, title="aces studio", favicon="🚌", reconnect_timeout=30.0, **options)
        self.gate = PageGate(application, port)
        self.url = f"http://{HOST}:{port}/?token={self.gate.token}"
        self._server = uvicorn.Server(
            uvicorn.Config(
                self.gate,
                log_level="error",
                access_log=False,
                limit_concurrency=MOST_CONNECTIONS,
                ws_max_size=1 << 20,
                server_header=False,
                timeout_graceful_shutdown=1,
            )
        )

    def run(self) -> None:
        """Serve until Ctrl-C or SIGTERM."""
        try:
            self._server.run(sockets=[self._listener])
        except KeyboardInterrupt:  # uvicorn raises the signal again once it has ended
            pass
        finally:
            self._listener.close()
