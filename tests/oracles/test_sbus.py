"""rfrx: its reader, unmodified, on a pseudo-terminal with our twin of a receiver, and its decoder on frames of ours.

1. Channels alone are compared: rfrx reads the flags from the other end of their byte (see the README of the spec).
"""

from __future__ import annotations

import random
from typing import Any

from aces_bus import decode
from aces_devices.sbus import EXAMPLE, driver
from aces_protocols.sbus.spec import CHANNELS, sbus
from tests.oracles.foreign import oracle
from tests.oracles.serial_lines import served_line

theirs: Any = oracle("rfrx.sbus", "rfrx")


def test_it_decodes_what_we_encode() -> None:
    """The numbers of 16 channels, in 500 drawn frames; our scanner and our columns have the same."""
    dice, data, wanted = random.Random(1), b"", list[list[int]]()
    for _ in range(500):
        raw = [dice.randrange(2048) for _ in range(CHANNELS)]
        packet = sbus.encode("Channels", channels=[880 + 0.625 * number for number in raw], flags=[])
        assert theirs.SbusDecoder(packet).chans == raw
        data, wanted = data + packet, [*wanted, raw]
    assert [list(record.channels) for record in sbus.scanner(raw=True).feed(data)] == wanted
    assert decode(data, sbus, raw=True)["Channels"]["channels.15"].to_list() == [raw[15] for raw in wanted]


def test_its_reader_reads_our_twin() -> None:
    """Frame after frame from a serial port; the sticks are where the twin has them."""
    seen: list[list[int]] = []

    class Reader(theirs.SbusReader):  # type: ignore[misc]
        """Ends after ten frames."""

        def process(self, frame: Any) -> None:
            """Keep the channels."""
            seen.append(frame.chans)
            self.running = len(seen) < 10

    with served_line(EXAMPLE, driver) as line:
        twin: Any = line.twins["RC"]
        with line.lock:
            twin.sticks = [-1.0, 1.0, 0.5, *[0.0] * 13]
        Reader(line.path, retry=True, timeout=30)
    # 512 µs are 819.2 steps from 992
    assert seen[-1] == [173, 1811, 1402, *[992] * 13]
