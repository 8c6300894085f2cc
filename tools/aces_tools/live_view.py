"""`--foxglove`: what a command sees and does, live, for who looks on.

1. It is opened before anything else is, and closed last: a wrong port is found before a bus is touched.
2. How to look on is a note; who else can, and what was dropped, is said in any case.
"""

from __future__ import annotations

import argparse
from collections.abc import Generator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from aces_bus.errors import CallerError

from .console import say, say_note

if TYPE_CHECKING:
    from aces_bus.access.foxglove import LiveView
    from aces_bus.controller.events import EventLike
    from aces_bus.device.station import BusEndpoint


#: Events that are worth a look, and those that are more.
_LEVELS: dict[str, Any] = {
    **dict.fromkeys(
        ("opened", "closed", "reopened", "answers", "alarm over", "recovered", "error-active"), "info"
    ),
    **dict.fromkeys(
        (
            "silent",
            "no reply",
            "two devices",
            "alarm",
            "not stopped",
            "bug",
            "lost",
            "bus-off",
            "following error",
        ),
        "error",
    ),
}


@contextmanager
def live_view(arguments: argparse.Namespace, name: str) -> Generator[LiveView | None]:
    """The view that a call asks for, or None. Raises `CallerError` for a missing extra and a port that is taken."""
    if arguments.foxglove is None:
        if arguments.foxglove_origin:
            raise CallerError("--foxglove-origin is for --foxglove: add it")
        yield None
        return
    from aces_bus.access.foxglove import LiveView, parse_live_address

    try:
        parse_live_address(arguments.foxglove)
    except CallerError:
        raise CallerError(
            f"--foxglove {arguments.foxglove}: write PORT or HOST:PORT, such as 8765; before other words --foxglove=8765"
        ) from None
    view = LiveView(arguments.foxglove, name=name, origins=arguments.foxglove_origin, report=say)
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


def show_event(view: LiveView, event: EventLike) -> None:
    """An event of a device or controller."""
    view.event(event.instant, event.kind, event.source, event.detail, _LEVELS.get(event.kind, "warning"))


def show_bus_event(view: LiveView, bus: str, kind: str, detail: str) -> None:
    """What has just happened to a bus."""
    view.event(view.clock.now(), kind, bus, detail, _LEVELS.get(kind, "warning"))


def show_bus(view: LiveView, name: str, side: BusEndpoint[Any], *, is_host: bool) -> None:
    """What passes one side of a bus; before it is opened."""
    from aces_bus.access.foxglove import LiveBus

    bus = LiveBus(view, list(side.variants.values()), name=name, link=side.port.link, is_host=is_host)
    side.watch(bus.passed)
