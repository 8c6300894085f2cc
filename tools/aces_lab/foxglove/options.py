"""`--foxglove` of sniff, sim, run and play: what the command sees and does, live, for Foxglove.

1. How to look on is a note; who else can, and what was dropped, is said in any case.
"""

from __future__ import annotations

import argparse
from collections.abc import Generator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from aces_bus.errors import CallerError
from aces_tools.console import say, say_note
from aces_tools.options import Arguments, argument, several

if TYPE_CHECKING:
    from .live import FoxgloveView

ARGUMENTS: Arguments = (
    argument(
        "--foxglove",
        nargs="?",
        const="",
        metavar="[HOST:]PORT",
        help="show it live to Foxglove, at this port of this machine (default: 8765); needs 'aces-bus[foxglove]'",
    ),
    several(
        "--foxglove-origin",
        metavar="ORIGIN",
        help="let web pages of ORIGIN look on, beside Foxglove's own and this machine's, such as http://lab:8080",
    ),
)


def is_wanted(arguments: argparse.Namespace) -> bool:
    """Return whether the call says `--foxglove`. Raises `CallerError` for an origin without it."""
    if arguments.foxglove is None and arguments.foxglove_origin:
        raise CallerError("--foxglove-origin is for --foxglove: add it")
    return arguments.foxglove is not None


@contextmanager
def open_view(arguments: argparse.Namespace, name: str) -> Generator[FoxgloveView]:
    """Open the view. Raises `CallerError` for a missing extra and a port that is taken."""
    from .live import FoxgloveView, parse_live_address

    try:
        parse_live_address(arguments.foxglove)
    except CallerError:
        raise CallerError(
            f"--foxglove {arguments.foxglove}: write PORT or HOST:PORT, such as 8765; before other words --foxglove=8765"
        ) from None
    view = FoxgloveView(arguments.foxglove, name=name, origins=arguments.foxglove_origin, report=say)
    try:
        say_note(f"live view: {view.address} (in Foxglove: Open connection, Foxglove WebSocket)")
        if not view.is_local:
            say(
                f"live view: every program that reaches {view.host} sees it: nothing is encrypted, and there is no log-in"
            )
        yield view
    finally:
        view.close()
        if view.dropped or view.published:
            (say if view.dropped else say_note)(str(view))
