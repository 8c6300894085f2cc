"""A full 1 Mbit/s bus through a live hubo scanner, for as long as you like: `python -m tests.bench.soak --seconds 600`.

1. A loss is found to the frame: every board counts in its messages, and the scanner's counts must agree.
2. The bus, the sender and the receiver are three processes; what is measured is the receiver: gatekeeper and scanner.

The bus is one of `aces bus serve`, paced, with physics: the sender keeps its mailboxes full, so it is as full as a bus
can be. It ends with 1 when a frame was lost, when memory grew by more than `GROWTH` or when the receiver took more than
`SHARE` of a core.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import struct
import sys
import tempfile
import time
from multiprocessing.synchronize import Event
from pathlib import Path
from typing import Any

#: The share of a core that the receiver may take.
SHARE = 0.40
#: Bytes by which its memory may grow after the first `WARM_S` seconds.
GROWTH = 4 << 20
WARM_S = 10.0
BOARDS = range(8)
BITRATE = 1_000_000


def serve(folder: str, is_over: Event) -> None:
    """The bus."""
    from aces_bus.hardware.served.channel import ServedChannel
    from aces_bus.hardware.served.server import BusServer

    with BusServer([ServedChannel("can0", bitrate=BITRATE)], unix=f"{folder}/bus"):
        is_over.wait()


def send(address: str, is_over: Event, sent: Any) -> None:
    """Encoder positions of eight boards, as fast as the bus takes them; each board counts."""
    import can

    from aces_bus.hardware.served.remote import ServedBus

    bus = can.Bus(address, "aces")
    assert isinstance(bus, ServedBus)
    number = 0
    while not is_over.is_set():
        for board in BOARDS:
            data = struct.pack("<ii", number, -number * 7919 % 0x8000_0000)
            bus.send(can.Message(arbitration_id=0x060 + board, data=data, is_extended_id=False), timeout=10)
        number += 1
        sent.value = number * len(BOARDS)
    bus.shutdown()  # what is in its mailboxes still goes out


class Receiver:
    """What a program does with a bus: a scanner on a gate; and counting."""

    def __init__(self) -> None:
        from aces_bus import make_scanner
        from aces_tools.protocols_arg import parse_protocols

        self.scanner: Any = make_scanner(parse_protocols(["hubo"]), include_unknown=True)
        self.frames = self.messages = self.lost = 0
        self._next: dict[int, int] = {}

    def __call__(self, items: list[Any]) -> None:
        frames = [item.content for item in items]
        self.messages += len(self.scanner.feed(frames))
        self.frames += len(frames)
        following = self._next
        for frame in frames:
            number = int.from_bytes(frame.data[:4], "little")
            expected = following.get(frame.arbitration_id, number)
            self.lost += number - expected
            following[frame.arbitration_id] = number + 1


def memory() -> int:
    """The process's resident bytes; 0 where the system does not say."""
    try:
        return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except OSError:
        return 0


def main() -> int:
    parser = argparse.ArgumentParser(description="A full 1 Mbit/s bus through a live hubo scanner.")
    parser.add_argument("--seconds", type=float, default=60.0, metavar="S", help="how long (60)")
    seconds: float = parser.parse_args().seconds
    from aces_bus.hardware import CanGate

    context = multiprocessing.get_context("spawn")
    is_over, is_closed, sent = context.Event(), context.Event(), context.Value("q", 0)
    with tempfile.TemporaryDirectory() as folder:
        path = f"{folder}/bus"
        server = context.Process(target=serve, args=(folder, is_closed))
        server.start()
        while not os.path.exists(path):
            if not server.is_alive():
                return 2
            time.sleep(0.05)
        address = f"unix:{path}"
        receiver = Receiver()
        with CanGate({"interface": "aces", "channel": address}, listen_only=False) as gate:
            events: list[str] = []
            gate.on_event(lambda event: events.append(str(event)))
            listener = gate.listen(receiver)
            sender = context.Process(target=send, args=(address, is_over, sent))
            sender.start()
            while not receiver.frames:
                if not sender.is_alive():
                    return 2
                time.sleep(0.05)
            began, used = time.monotonic(), time.process_time()
            start = 0
            shown = began
            while (now := time.monotonic()) - began < seconds:
                time.sleep(0.5)
                if not start and now - began >= min(WARM_S, seconds / 2):
                    start = memory()
                if now - shown >= 10:
                    share = (time.process_time() - used) / (now - began)
                    print(
                        f"{now - began:6.0f} s  {receiver.frames:9,} frames  {receiver.lost} lost  "
                        f"{memory() / 1e6:.1f} MB  {share:.1%} of a core",
                        flush=True,
                    )
                    shown = now
            lasted, share = (
                time.monotonic() - began,
                (time.process_time() - used) / (time.monotonic() - began),
            )
            end, frames = memory(), receiver.frames
            is_over.set()
            until = time.monotonic() + 5
            while receiver.frames < sent.value and time.monotonic() < until:
                time.sleep(0.05)
            sender.join(15)
        is_closed.set()
        server.join(15)
    counts, counters = receiver.scanner.counts, gate.counters
    missing = sent.value - receiver.frames
    print(f"frames      {sent.value:,} sent, {receiver.frames:,} received, {frames / lasted:,.0f} /s")
    print(f"lost        {receiver.lost} by the boards' counts, {missing} of those sent")
    print(
        f"            dropped={counters.dropped} ({listener.dropped}) kernel_dropped={counters.kernel_dropped}"
    )
    print(f"messages    {receiver.messages:,}; {counts}")
    print(f"memory      {start / 1e6:.1f} MB after {WARM_S:.0f} s, {end / 1e6:.1f} MB at the end")
    print(f"processor   {share:.1%} of a core, {share * lasted / max(frames, 1) * 1e6:.1f} µs a frame")
    for text in events[:10]:
        print(f"event       {text}")
    is_good = not receiver.lost and not missing and receiver.messages == receiver.frames
    is_good = is_good and end - start <= GROWTH and share <= SHARE
    print("as it should be" if is_good else "NOT AS IT SHOULD BE")
    return 0 if is_good else 1


if __name__ == "__main__":
    sys.exit(main())
