"""What a command sees and does, live, for who looks on: the contract of views that other packages open.

1. A view is opened before anything else is, and closed last: a wrong port is found before a bus is touched.
2. Which views there are, their options say (`verbs.OPTIONS_GROUP`): `--foxglove` and `--ros2` are the lab's.
3. What those who look on may command is a controller of the run, with guard and door as every other.
"""

from __future__ import annotations

import argparse
import logging
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from typing import TYPE_CHECKING, Any, Literal, Protocol

from aces_bus import Frame
from aces_bus.errors import CallerError

from .verbs import wanted_options

if TYPE_CHECKING:
    from aces_bus.controller.base import ControllerLike
    from aces_bus.controller.events import EventLike
    from aces_bus.device import Robot
    from aces_bus.device.station import BusEndpoint
    from aces_bus.kinematics.body import Body
    from aces_bus.protocol import Variant
    from aces_bus.robot.run import RunLogger

    Link = Literal["can", "serial", "datagram"]

    class ShownStates(RunLogger, Protocol):
        """A logger of a run that also takes quantities directly."""

        def read(self, reads: Mapping[str, tuple[str, Callable[[], object]]]) -> None:
            """Show these quantities: name → unit, and what reads the value."""
            ...


class ShownRecords(Protocol):
    """Takes records and `Unknown`s as a scanner gave them."""

    def put(self, items: Iterable[Any]) -> None:
        """Show them; never waits."""
        ...


class ShownBus(Protocol):
    """Takes what passes one side of a bus."""

    def passed(self, packet: Frame | bytes, instant: int, is_sent: bool) -> None:
        """Show a frame or piece of bytes, of an instant in ns of the view's clock; never waits."""
        ...


class LiveView(Protocol):
    """Shows events, buses, records and states; instants are ns of its clock, from any thread, and nothing waits."""

    epoch_ns: int

    def now(self) -> int:
        """Return the instant of the view's clock (ns)."""
        ...

    def event(self, instant: int, kind: str, source: str, detail: str = "", level: Any = "info") -> None:
        """Show an event of a bus, device or controller; `level` is info, warning or error."""
        ...

    def records(self, variants: Sequence[Variant], *, scanner: Any = None) -> ShownRecords:
        """Return what shows a scanner's records."""
        ...

    def states(self, rate_hz: float, body: Body | None) -> ShownStates:
        """Return what shows states at a rate, and the transforms of a body."""
        ...

    def bus(
        self,
        variants: Sequence[Variant],
        *,
        name: str,
        link: Link,
        is_host: bool = True,
        direction: Any = None,
    ) -> ShownBus:
        """Return what shows the packets of one side of a bus, decoded."""
        ...

    def lines(self) -> logging.Handler:
        """Return what shows lines of Python's `logging`."""
        ...

    def controllers(
        self, robot: Robot, rate_hz: float, others: Sequence[ControllerLike]
    ) -> Sequence[ControllerLike]:
        """Return controllers that carry out what comes from who looks on; a run has them beside its `others`."""
        ...


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


def wants_view(verb: str, arguments: argparse.Namespace) -> bool:
    """Return whether the call asks to be shown live. Raises `CallerError` for options that do not go together."""
    return any(wanted_options(verb, arguments, "open_view"))


def live_view(verb: str, arguments: argparse.Namespace, name: str) -> AbstractContextManager[LiveView | None]:
    """Open the view that a call asks for, or None.

    Raises `CallerError` for a missing extra, a port that is taken, and two views.
    """
    wanted = list(wanted_options(verb, arguments, "open_view"))
    if len(wanted) > 1:
        raise CallerError("two live views at once: choose one of --foxglove, --ros2 and others")
    if not wanted:
        return nullcontext()
    view: AbstractContextManager[LiveView] = wanted[0].open_view(arguments, name)
    return view


def show_event(view: LiveView, event: EventLike) -> None:
    """Show an event of a device or a controller."""
    view.event(event.instant, event.kind, event.source, event.detail, _LEVELS.get(event.kind, "warning"))


def show_bus_event(view: LiveView, bus: str, kind: str, detail: str) -> None:
    """Show an event of a bus."""
    view.event(view.now(), kind, bus, detail, _LEVELS.get(kind, "warning"))


def show_bus(view: LiveView, name: str, side: BusEndpoint[Any], *, is_host: bool) -> None:
    """Show all traffic of one side of a bus; call this before the bus is opened."""
    bus = view.bus(list(side.variants.values()), name=name, link=side.port.link, is_host=is_host)
    side.watch(bus.passed)
