"""The live screen of `aces sniff --screen`: every identifier with its rate, its changes, its decoded values.

1. Nothing of textual is imported before a screen is run.

    model    rows, channels, counts: pure          view     which rows, in which order
    values   decoded values as text                paint    rows as pieces of text for a width
    head     the lines above the table             detail   everything about one row
    app      the application (textual)
"""

from __future__ import annotations

import importlib.util
import os
import sys
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from aces_bus.errors import CallerError

if TYPE_CHECKING:
    from aces_bus.hardware import CanGate, DatagramGate, SerialGate
    from aces_bus.protocol import Scanner
    from aces_bus.recordings import CanFilter


def check_screen() -> None:
    """Raises `CallerError` where no screen can be shown: textual is missing, or there is no terminal."""
    if importlib.util.find_spec("textual") is None:
        raise CallerError("the live screen needs textual: pip install 'aces-bus[screen]'")
    # Pictures go to stderr: that is where textual draws.
    is_terminal = all(file is not None and file.isatty() for file in (sys.__stdin__, sys.__stderr__))
    if not is_terminal or os.environ.get("TERM") == "dumb":
        raise CallerError(
            "--screen needs a terminal; without it lines are printed, also into files and pipes"
        )


def run_screen(
    gate: CanGate | SerialGate | DatagramGate,
    scanner: Scanner | None,
    *,
    filter: CanFilter | None = None,
    title: str = "",
    record: Callable[[], str] | None = None,
    bitrate: int | None = None,
    data_bitrate: int | None = None,
    open_gate: Callable[[], object] | None = None,
    show: Sequence[str] = (),
    end: Callable[[], bool] | None = None,
    colour: bool | None = None,
) -> int:
    """Show what a gate hears, until the user quits; the exit status. The gate is opened, and closed at the end.

    `scanner` has to be made with `include_unknown`; None, or one without protocols, decodes nothing (CAN only). `filter` is
    applied before anything is counted; `show` is a filter as it can be typed, of words. `record` gives what the head says
    of a recording. `bitrate` and `data_bitrate` in bit/s are what the load is a share of; without them it is the
    protocols' bit rate, and where they have none, bit/s are shown. `open_gate` opens the gate instead of
    `gate.start()`. The screen ends by itself when `end` says so. `colour` None: as the terminal has it.

    Raises `CallerError` before anything is opened, where no screen can be shown (`check_screen`), and whatever opening
    the gate raises.
    """
    check_screen()
    screen = make_screen(
        gate,
        scanner,
        filter=filter,
        title=title,
        record=record,
        bitrate=bitrate,
        data_bitrate=data_bitrate,
        show=show,
        end=end,
        colour=colour,
    )
    try:
        if open_gate is not None:
            open_gate()
        elif gate.state == "new":
            gate.start()
        screen.run()
    finally:
        gate.stop()
    return int(screen.return_code or 0)


def make_screen(
    gate: CanGate | SerialGate | DatagramGate,
    scanner: Scanner | None,
    *,
    filter: CanFilter | None = None,
    title: str = "",
    record: Callable[[], str] | None = None,
    bitrate: int | None = None,
    data_bitrate: int | None = None,
    show: Sequence[str] = (),
    end: Callable[[], bool] | None = None,
    colour: bool | None = None,
) -> Any:
    """The application of `run_screen`, not yet running; it listens to the gate from now on."""
    from aces_bus.hardware import CanGate, DatagramGate, SerialGate

    from ..console import wants_colour
    from .app import LiveScreen
    from .model import Model
    from .stream import ModelFeed

    if isinstance(gate, SerialGate):
        bitrate = gate.baud
    elif bitrate is None:  # what the protocols' sheets say, where it is one
        rates = {variant.protocol.bitrate for variant in getattr(scanner, "variants", ())}
        bitrate = rates.pop() if len(rates) == 1 else None
    model = Model(scanner, name=gate.name, bitrate=bitrate, data_bitrate=data_bitrate)
    feed = idle = None
    if isinstance(gate, CanGate):
        inbox: Any = gate.subscribe(filter=filter)
    else:
        stream = ModelFeed(model, are_datagrams=isinstance(gate, DatagramGate))
        feed, idle = stream.feed, stream.idle
        inbox = gate.subscribe()
    gate.on_event(model.tell)
    made = LiveScreen(
        model,
        gate,
        inbox,
        title=title,
        recording=record,
        feed=feed,
        idle=idle,
        end=end,
        has_colour=wants_colour(colour, True),
    )
    made.view.look_for(" ".join(show))
    return made


__all__ = ["check_screen", "make_screen", "run_screen"]
