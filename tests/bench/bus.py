"""`python -m tests.bench bus`: the virtual bus, in one process and across processes, beside python-can's own.

1. Contenders carry the same 8-byte frames in the same run, in turn; ratios are of their fastest rounds.
2. The long bus is simulated twice from one seed; all that its listener received, and when, must hash to the same.
"""

from __future__ import annotations

import hashlib
import logging
import random
import statistics
import struct
import subprocess
import sys
import tempfile
from collections.abc import Iterable
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from time import perf_counter, perf_counter_ns
from typing import Any

import can

from aces_bus import Frame
from aces_bus.hardware import Faults, SimulatedBus, virtual_clock
from aces_bus.hardware.simulated.bus import BusNode
from aces_bus.hardware.simulated.frame_time import frame_bits
from aces_bus.runtime import VirtualClock

from .rows import BenchRow, fastest, optional

_DATA = bytes(range(8))
#: Seconds after which a partner that does not answer is taken for dead.
_PATIENCE_S = 10


def run(*, quick: bool = False) -> Iterable[BenchRow]:
    """All rows; `quick` takes some twenty seconds and is rougher."""
    yield from in_process(rounds=5 if quick else 15, count=2_000 if quick else 5_000)
    yield from across_processes(rounds=6 if quick else 20, count=200 if quick else 500)
    yield from long_bus(seconds=20 if quick else 1_000)


# ---------------------------------------------------------------------- in one process


def in_process(*, rounds: int, count: int) -> Iterable[BenchRow]:
    """A frame is sent and received before the next one: by one other node, and by four."""
    message = can.Message(arbitration_id=0x123, data=_DATA, is_extended_id=False)
    kinds: dict[str, dict[str, Any]] = {
        "python-can's virtual": {"interface": "virtual", "channel": "bench"},
        "aces, no physics": {"interface": "aces", "channel": "bench", "physics": False},
        "aces, physics, virtual clock": {
            "interface": "aces",
            "channel": "bench physics",
            "bitrate": 1_000_000,
        },
    }
    targets = {"aces, no physics": 4.0, "aces, physics, virtual clock": 1.5}
    for receivers in (1, 4):
        with ExitStack() as stack:
            stack.enter_context(virtual_clock("bench physics"))
            contenders = {
                name: partial(
                    _exchange,
                    message,
                    count,
                    *[stack.enter_context(can.Bus(**options)) for _ in range(receivers + 1)],
                )
                for name, options in kinds.items()
            }
            best = {name: count / seconds for name, seconds in fastest(contenders, rounds=rounds).items()}
        peer = best["python-can's virtual"]
        for name, rate in best.items():
            target = targets.get(name) if receivers == 1 else None
            yield BenchRow(
                f"in process, one sends, {receivers} receive{'s' if receivers == 1 else ''}",
                name,
                rate,
                "frames/s",
                rate / peer if name in targets else None,
                f"≥ {target:g} × virtual" if target else "",
                rate / peer >= target if target else None,
            )


def _exchange(message: can.Message, count: int, sender: can.BusABC, *receivers: can.BusABC) -> None:
    send, receive = sender.send, [bus.recv for bus in receivers]
    for _ in range(count):
        send(message)
        for recv in receive:
            if recv(1) is None:
                raise AssertionError("a frame was lost")


# ---------------------------------------------------------------------- across processes

_ECHO = """
import ast, can, logging, sys
logging.disable(logging.CRITICAL)
with can.Bus(**ast.literal_eval(sys.argv[1])) as bus:
    print("ready", flush=True)
    while (message := bus.recv(60)) is not None and message.arbitration_id != 0x7FF:
        if message.arbitration_id == 0x100:
            bus.send(can.Message(arbitration_id=0x101, data=message.data, is_extended_id=False))
"""
_SERVER = """
import sys
from aces_bus.hardware.served.channel import ServedChannel
from aces_bus.hardware.served.server import BusServer
channel = ServedChannel(bitrate=1_000_000, physics=sys.argv[2] == "physics")
server = BusServer([channel], unix=sys.argv[1])
print("ready", flush=True)
server.serve()
"""


def across_processes(*, rounds: int, count: int) -> Iterable[BenchRow]:
    """A frame to another process and one back: the median of the best round of each contender."""
    wire_us = 2 * frame_bits(Frame(0x100, _DATA)).total
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="aces")))
        stack.callback(logging.disable, logging.root.manager.disable)
        logging.disable(logging.CRITICAL)
        contenders: dict[str, dict[str, Any]] = {}
        if optional("msgpack") is not None:
            contenders["python-can's udp_multicast"] = {
                "interface": "udp_multicast",
                "channel": "239.74.163.2",
            }
        for name, mode in (
            ("aces served, no physics", "none"),
            (f"aces served, {wire_us} µs on the wire", "physics"),
        ):
            path = str(folder / f"{mode}.sock")
            server = _start(stack, _SERVER, path, mode)
            stack.callback(server.terminate)
            contenders[name] = {"interface": "aces", "channel": f"unix:{path}"}
        exchanges = {}
        for name, options in contenders.items():
            try:
                bus = stack.enter_context(can.Bus(**options))
            except (can.CanError, OSError):  # a machine without multicast
                continue
            _start(stack, _ECHO, repr(options))
            stack.callback(bus.send, can.Message(arbitration_id=0x7FF, is_extended_id=False))
            exchanges[name] = partial(_round_trip, bus, count)
        best = dict.fromkeys(exchanges, float("inf"))
        for _ in range(rounds):
            for name, exchange in exchanges.items():
                best[name] = min(best[name], exchange())
    peer = best.get("python-can's udp_multicast")
    for name, micros in best.items():
        judged = peer is not None and name == "aces served, no physics"
        ratio = peer / micros if peer is not None and judged else None
        yield BenchRow(
            "across processes, there and back",
            name,
            micros,
            "µs",
            ratio,
            "≥ 3 × lower than udp_multicast" if judged else "",
            ratio >= 3 if ratio is not None else None,
        )


def _round_trip(bus: can.BusABC, count: int) -> float:
    """The median of `count` round trips, in µs."""
    times = []
    message = can.Message(arbitration_id=0x100, data=_DATA, is_extended_id=False)
    for _ in range(count):
        start = perf_counter_ns()
        bus.send(message)
        while True:
            got = bus.recv(_PATIENCE_S)
            if got is None:
                raise AssertionError("the other process does not answer")
            if got.arbitration_id == 0x101:
                break
        times.append(perf_counter_ns() - start)
    return statistics.median(times) / 1e3


def _start(stack: ExitStack, program: str, *arguments: str) -> subprocess.Popen[str]:
    process = subprocess.Popen([sys.executable, "-c", program, *arguments], stdout=subprocess.PIPE, text=True)
    stack.callback(_end, process)
    assert process.stdout is not None
    if process.stdout.readline() != "ready\n":
        raise AssertionError("a program of the benchmark did not start")
    return process


def _end(process: subprocess.Popen[str]) -> None:
    try:
        process.wait(_PATIENCE_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
    if process.stdout is not None:
        process.stdout.close()


# ---------------------------------------------------------------------- a long bus


@dataclass(frozen=True)
class Simulated:
    """What a simulation was: wall time, frames, load, and the hash of everything received."""

    wall_s: float
    frames: int
    load: float
    digest: str


def simulate_bus(seconds: float, seed: int, *, load: float = 0.7) -> Simulated:
    """A 1 Mbit/s bus with ten senders, jitter, data and bit errors from a seed, in virtual time."""
    rng = random.Random(seed)
    clock = VirtualClock()
    wire = SimulatedBus(clock, bitrate=1_000_000, faults=Faults(seed=seed, corrupt=0.0002))
    received: list[bytes] = []
    digest = hashlib.blake2b(digest_size=16)
    pack = struct.Struct("<qI").pack

    def listen(frame: Frame, now: int) -> None:
        received.append(pack(now, frame.arbitration_id) + frame.data)
        if len(received) >= 4096:
            digest.update(b"".join(received))
            received.clear()

    wire.attach("listener", listen)
    senders = 10
    period = round(
        senders * 115_700 / load
    )  # an 8-byte frame takes 115.7 bits, on average, with the pause behind it

    def sender(number: int, node: BusNode) -> None:
        bytes_of, jitter, identifier = rng.randbytes, rng.random, 0x100 + number

        def send() -> None:
            node.send(Frame(identifier, bytes_of(8)))
            clock.call_in(round(period * (0.8 + 0.4 * jitter())), send)

        clock.call_in(round(period * jitter()), send)

    for number in range(senders):
        sender(number, wire.attach(f"sender {number}"))
    start = perf_counter()
    clock.advance_to(round(seconds * 1e9))
    wall = perf_counter() - start
    digest.update(b"".join(received))
    return Simulated(wall, wire.load.frames, wire.load.ratio(clock.now()), digest.hexdigest())


def long_bus(*, seconds: float) -> Iterable[BenchRow]:
    """So many seconds of a bus in virtual time; a fifth of it, twice from one seed and once from another."""
    part = seconds / 5
    first, again, other = simulate_bus(part, 1), simulate_bus(part, 1), simulate_bus(part, 2)
    whole = simulate_bus(seconds, 1)
    subject = f"{seconds:,.0f} s of 1 Mbit/s at {whole.load:.0%} load, virtual time"
    share = whole.wall_s / seconds
    yield BenchRow(
        subject, f"{whole.frames:,} frames, wall time / bus time", share, "×", None, "< 0.1", share < 0.1
    )
    costs = [run.wall_s / run.frames * 1e6 for run in (whole, first)]
    growth = costs[0] / min(costs[1], again.wall_s / again.frames * 1e6)
    yield BenchRow(
        subject,
        f"cost per frame, beside {part:,.0f} s",
        costs[0],
        "µs/frame",
        growth,
        "linear: ≤ 1.25 ×",
        growth <= 1.25,
    )
    same = first.digest == again.digest != other.digest
    yield BenchRow(subject, f"same seed, same bus: {first.digest[:8]}", float(same), "", None, "1", same)
