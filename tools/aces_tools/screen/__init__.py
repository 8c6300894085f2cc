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
from aces_bus.hardware.gate import Received

from ..live import silence_s
from .model import Model

if TYPE_CHECKING:
    from aces_bus.hardware import CanGate, DatagramGate, SerialGate
    from aces_bus.protocol.live.scanner import Scanner
    from aces_bus.recordings.filters import CanFilter


def check_screen() -> None:
    """Raise `CallerError` if no screen can be shown: textual is missing, or there is no terminal."""
    if importlib.util.find_spec("textual") is None:
        raise CallerError("the live screen needs textual: pip install 'aces-bus[screen]'")
    # Pictures go to stderr: that is where textual draws.
    is_terminal = all(file is not None and file.isatty() for file in (sys.__stdin__, sys.__stderr__))
    if not is_terminal or os.environ.get("TERM") == "dumb":
        raise CallerError(
            "--screen needs a terminal; without it lines are printed, also into files and pipes"
        )


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
    """Return the application that shows what a gate receives, not yet running; it listens to the gate from now on.

    `scanner` has to be made with `include_unknown`; None, or one without protocols, decodes nothing (CAN only). `filter` is
    applied before anything is counted; `show` is a filter as it can be typed, of words. `record` gives what the head says
    of a recording. `bitrate` and `data_bitrate` in bit/s are what the load is a share of; without them it is the
    protocols' bit rate, and where they have none, bit/s are shown. The screen ends by itself when `end` says so. `colour`
    None: as the terminal has it.
    """
    from aces_bus.hardware import CanGate, DatagramGate, SerialGate

    from ..console import wants_colour
    from .app import LiveScreen
    from .model import Model

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
    gate.on_event(model.emit)
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


# ---------------------------------------------------------------------- streams

#: Bit times of a byte on a serial line: start, eight bits, stop.
BYTE = 10


class ModelFeed:
    """Feeds a model. Times are the host's, of its monotonic clock."""

    def __init__(self, model: Model, *, are_datagrams: bool = False) -> None:
        if model.scanner is None:
            raise CallerError(
                "bytes make rows only where a protocol finds packets in them; name one: -p NAME"
            )
        self._model = model
        self._scanner: Any = model.scanner
        self._are_datagrams = are_datagrams
        self._gap_ns = round(silence_s(self._scanner) * 1e9)
        self._received_ns = 0
        self._is_settled = True

    def feed(self, items: Sequence[Received[Any]]) -> None:
        """Feed the model with items from a gate."""
        feed = self._scanner.datagram if self._are_datagrams else self._scanner.feed
        for item in items:
            self.idle(item.host_ns)
            self._model.feed_records(
                feed(item.content, item.host_ns / 1e9), item.host_ns, BYTE * len(item.content)
            )
            self._received_ns, self._is_settled = item.host_ns, self._are_datagrams

    def idle(self, now_ns: int) -> None:
        """Note that nothing came until now."""
        if not self._is_settled and now_ns - self._received_ns > self._gap_ns:
            self._is_settled = True
            self._model.feed_records(self._scanner.idle(now_ns / 1e9), now_ns)


__all__ = ["check_screen", "make_screen"]
