"""`aces sniff --screen`: the same bus, scanner and recording as the lines, and the same summary at the end.

1. A wrong call raises before anything is opened or written.
2. Events are told on the screen while it is there, and on stderr when it has gone.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING

from aces_bus.errors import CallerError

from ..live import LivePatience, Told, losses
from . import check_screen, run_screen

if TYPE_CHECKING:
    from ..recorder import RecordingFile
    from ..sniff import Sniffing

#: Options that say something about lines.
OF_LINES = ("where", "unknown", "count", "format", "output", "quiet")


def run_on_screen(sniffing: Sniffing) -> int:
    """One run; the exit status. Raises `CallerError` for a wrong call, a missing terminal, a bus that does not open."""
    arguments, bus = sniffing.arguments, sniffing.bus
    for option in OF_LINES:
        if getattr(arguments, option):
            raise CallerError(f"--{option} is about lines, and --screen prints none; press / there to filter")
    if len(sniffing.messages) > 1:
        raise CallerError("--screen takes one --message; press / there to filter")
    if bus.kind != "can" and not arguments.protocol:
        raise CallerError("--screen shows the packets of a protocol, and no bare bytes; name one: -p NAME")
    check_screen()
    gate = bus.gate(listen_only=True)
    told, recorder = Told(gate), sniffing._recorder()
    until = None if sniffing.duration is None else time.monotonic_ns() + sniffing.duration
    with LivePatience() as patience:

        def opened() -> None:
            try:
                if recorder is not None:
                    recorder.start(gate, sniffing.name, sniffing.epoch_ns, sniffing._stated)
                bus.start(gate)
            except BaseException:
                if recorder is not None:
                    recorder.abandon()
                raise

        def is_over() -> bool:
            is_late = until is not None and time.monotonic_ns() >= until
            return patience.is_over or is_late or (recorder is not None and recorder.failure is not None)

        try:
            status = run_screen(
                gate,
                sniffing.scanner,
                filter=sniffing.filter,
                title=" ".join(arguments.protocol),
                record=None if recorder is None else _said(recorder),
                bitrate=bus.options.get("bitrate"),
                data_bitrate=bus.options.get("data_bitrate"),
                open_gate=opened,
                show=sorted(sniffing.messages),
                end=is_over,
                colour=arguments.color,
            )
        except KeyboardInterrupt:
            status = 0
        told.tell(last=True)
        sniffing._close(recorder)
        sniffing.total.count(sniffing.scanner.counts)
        dropped = gate.counters.dropped - (recorder.dropped if recorder is not None else 0)
        sniffing.lost = losses(gate, dropped)
        sniffing._summarise()
    return sniffing.status or status


def _said(recorder: RecordingFile) -> Callable[[], str]:
    """What the head says of a recording."""
    return lambda: f"{recorder.path} {recorder.recorded:,}"


__all__ = ["run_on_screen"]
