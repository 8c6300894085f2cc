"""The packets, framings and checks that `aces spec guess` finds in streams, against the specs of these."""

from __future__ import annotations

import random
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

from construct import Byte, Struct, this

from aces_bus import load_protocol
from aces_bus.protocol import Fletcher, Protocol
from aces_bus.protocol.declare.framing import Framing, Verdict
from aces_bus.testing.packets import draw_packet
from aces_bus.testing.source import Dice
from aces_lab.guess import FramingGuess, StreamTraffic
from aces_lab.guess.framings import framing_check
from tests.bench.guess_scores import STREAMS, Scores
from tests.bench.twin_traffic import twin_traffic

#: Packets that are drawn of a spec without a twin.
DRAWN = 400


def true_packets(chunks: Sequence[tuple[bytes, float | None]], protocol: Any) -> Iterator[tuple[int, int]]:
    """Packets by the rule of the protocol's own framings, also those that it has no message for."""
    data = b"".join(chunk for chunk, _ in chunks)
    silences: set[int] = set()
    offset = 0
    for (chunk, time), (_, following) in pairwise([*chunks, (b"", None)]):
        offset += len(chunk)
        if time is None or following is None or following - time > 0.001:
            silences.add(offset)
    extras = {framing: framing.extras_of(protocol.messages.values()) for framing in protocol.framings}
    at = 0
    while at < len(data):
        end = (
            min((one for one in silences if one > at), default=len(data)) if len(silences) > 1 else len(data)
        )
        verdicts = (framing.judge(data[:end], at, extras=extras[framing]) for framing in protocol.framings)
        size = next((one.size for one in verdicts if one.verdict is Verdict.WHOLE), 0)
        if size:
            yield at, at + size
        at += size or 1


def score_stream(
    name: str, chunks: Sequence[tuple[bytes, float | None]], protocol: Any, framing: Framing | None
) -> Scores:
    """The packets of a stream against those that its own protocol's scanner finds."""
    scores = Scores(name, STREAMS)
    traffic = StreamTraffic()
    for data, time in chunks:
        traffic.add(data, time)
    guess = traffic.guess(known=False)
    truth = set(true_packets(chunks, protocol))
    said = {(span.start, span.end) for line in guess.spans for span in line}
    # Marks in front of a packet belong to neither.
    scores.by["packets"].add(len(truth & said), len(said), len(truth))
    if len(truth & said) < 0.95 * len(truth):
        scores.wrong.append(f"{name}: {len(truth & said)} of {len(truth)} packets; {len(said)} said")
    data = b"".join(chunk for chunk, _ in chunks)
    if len({data[start:end] for start, end in truth}) < 8:
        return scores  # Of a few packets again and again nothing says which bytes are a check.
    best = max(guess.framings, key=lambda one: one.packets, default=None)
    if framing is not None:
        _score_framing(scores, best, framing)
    elif best is not None:
        scores.by["check"].add(best.check is not None, 1, 1)
    return scores


def _score_framing(scores: Scores, best: FramingGuess | None, framing: Framing) -> None:
    name = scores.name
    if framing.sync:
        right = best is not None and best.sync == framing.sync
        scores.by["sync"].add(right, best is not None and bool(best.sync), 1)
        if not right:
            scores.wrong.append(f"{name}: sync {best.sync.hex() if best else None}, is {framing.sync.hex()}")
    if framing.affine is not None:
        head = framing.affine.length
        rule = best.length if best is not None else None
        right = rule is not None and (rule.offset, rule.width, rule.constant) == (
            head.offset,
            head.size,
            framing.affine.constant,
        )
        scores.by["length"].add(right, rule is not None, 1)
        if not right:
            scores.wrong.append(
                f"{name}: length {rule}, is {head.size} bytes at {head.offset} plus {framing.affine.constant}"
            )
    if framing.check is not None or (best is not None and best.is_checked):
        made = framing_check(best) if best is not None else None
        probe = b"\x31\x32\x33\x34\x35\x36\x37\x38\x39"
        right = (
            made is not None
            and framing.check is not None
            and (made.compute(probe) == framing.check.compute(probe) and made.order == framing.check.order)
        )
        scores.by["check"].add(right, best is not None and best.is_checked, int(framing.check is not None))
        if not right:
            is_ = framing.check.describe if framing.check is not None else None
            scores.wrong.append(f"{name}: check {made.describe if made else None}, is {is_}")


def drawn_packets(protocol: Protocol, seed: int = 1) -> bytes:
    """Packets of a spec, valid and otherwise at random."""
    dice = Dice(seed)
    picker = random.Random(seed)
    messages = list(protocol.messages.values())
    return b"".join(draw_packet(picker.choice(messages), dice).image for _ in range(DRAWN))


SERIAL_TWINS = (
    ("robotis_rx", "robotis"),
    ("feetech", "feetech"),
    ("dynamixel", "dynamixel"),
    ("modbus", "modbus"),
    ("nmea0183", "nmea0183"),
    ("ubx", "ubx"),
    ("vesc_uart", "vesc_uart"),
    ("minihubo_adc", "minihubo_adc"),
)


def streams_of_specs() -> Iterator[tuple[str, Sequence[tuple[bytes, float | None]], Any, Framing | None]]:
    """Twins on serial lines, and packets drawn of specs that have none."""
    from tests.specs.cobs import cobs
    from tests.specs.mavlink1 import mavlink1
    from tests.specs.slip import slip
    from tests.specs.xbus_like import xbus_like

    for driver, name in SERIAL_TWINS:
        protocol = load_protocol(name)
        for wire, _, heard in twin_traffic(driver):
            framings = protocol.framings
            yield f"twin {driver} {wire}", heard, protocol, framings[0] if len(framings) == 1 else None
    for protocol in (load_protocol("ubx"), load_protocol("vesc_uart"), cobs, slip, mavlink1, xbus_like):
        data = drawn_packets(protocol)
        yield f"drawn {protocol.name}", [(data, None)], protocol, protocol.framings[0]


def streams_of_others(
    shared: Path,
) -> Iterator[tuple[str, Sequence[tuple[bytes, float | None]], Any, Framing | None]]:
    """Recordings made by others; of MIP's the framing as its maker describes it."""
    mip = Protocol("mip", link="serial")
    whole = mip.framing(
        sync=b"\x75\x65",
        header=Struct("set" / Byte, "length" / Byte),
        size=this.length + 6,
        max_size=261,
        check=Fletcher(over=slice(0, -2)),
    )
    if (shared / "streams/mip-imu.part.bin").exists():
        data = (shared / "streams/mip-imu.part.bin").read_bytes()
        yield "streams/mip-imu.part.bin", [(data, None)], mip, whole
    for path, name in (
        ("streams/ubx-nav.bin", "ubx"),
        ("streams/ubx-mon.bin", "ubx"),
        ("streams/ubx-rxm.bin", "ubx"),
        ("streams/nmea-gnss.txt", "nmea0183"),
        ("streams/nmea-maritime.txt", "nmea0183"),
        ("streams/nmea-lowercase-check.txt", "nmea0183"),
        ("adc/minihubo_adc_part1.bin", "minihubo_adc"),
        ("robotis/positioning.to-servo.truncated.bin", "robotis"),
    ):
        if (shared / path).exists():
            protocol = load_protocol(name)
            yield path, [((shared / path).read_bytes(), None)], protocol, protocol.framings[0]
