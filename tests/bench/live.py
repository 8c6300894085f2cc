"""`python -m tests.bench live`: one frame at a time and one chunk at a time, beside the libraries people use today.

CAN frames are python-can messages that already exist; peers and scanner decode the same ones to physical values. The
serial stream is Dynamixel 1.0, status packets of 8 and 9 bytes, 1 % garbage bytes and 0.1 % bad checksums, in chunks of
4096 bytes.
"""

from __future__ import annotations

import random
import struct
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

import can
from construct import Array, Compiled, Int16sl, Int32sl, Struct

from aces_bus.protocol import BitLayout, CanScanner, Enumeration, IdField, Protocol, Quantity, bits
from aces_bus.protocol.generate.load import decoders_of
from aces_protocols.robotis.spec import robotis

from .rows import BenchRow, fastest, optional

BATCH = 64
CHUNK = 4096

_DBC = """VERSION ""
BU_: X
BO_ 96 Encoder: 8 X
 SG_ position_0 : 0|32@1- (6.283185307e-06,0) [0|0] "rad" X
 SG_ position_1 : 32|32@1- (6.283185307e-06,0) [0|0] "rad" X
BO_ 64 ForceTorque: 6 X
 SG_ mx : 0|16@1- (0.01,0) [0|0] "Nm" X
 SG_ my : 16|16@1- (0.01,0) [0|0] "Nm" X
 SG_ fz : 32|16@1- (0.1,0) [0|0] "N" X
BO_ 80 Imu: 8 X
 SG_ roll : 0|16@1- (0.01,0) [0|0] "deg" X
 SG_ pitch : 16|16@1- (0.01,0) [0|0] "deg" X
 SG_ roll_rate : 32|16@1- (0.01,0) [0|0] "deg/s" X
 SG_ pitch_rate : 48|16@1- (0.01,0) [0|0] "deg/s" X
BO_ 256 Engine: 8 X
 SG_ speed : 0|16@1+ (0.25,0) [0|0] "rpm" X
 SG_ coolant : 16|8@1+ (1,-40) [0|0] "degC" X
 SG_ throttle : 24|8@1+ (0.4,0) [0|0] "%" X
 SG_ torque : 32|12@1- (0.5,0) [0|0] "Nm" X
 SG_ gear : 44|4@1+ (1,0) [0|0] "" X
 SG_ load : 48|10@1+ (0.1,0) [0|0] "%" X
 SG_ fault : 58|1@1+ (1,0) [0|0] "" X
 SG_ idle : 59|5@1+ (1,0) [0|0] "" X
VAL_ 256 gear 0 "park" 1 "reverse" 2 "neutral" 3 "drive" ;
"""


def hubo_like() -> Protocol:
    """Three messages of Hubo's boards: two 32-bit encoders, force/torque, inertial unit (facts §6.2, §7.1)."""
    protocol = Protocol("bench_hubo", link="can")
    protocol.message(
        "Encoder",
        id=0x060 + IdField("board", range(0x30)),
        payload=Struct("position" / Array(2, Quantity(Int32sl, scale=6.283185307e-06, unit="rad"))),
    )
    cent = Quantity(Int16sl, scale=0.01)
    protocol.message(
        "ForceTorque",
        id=0x040 + IdField("sensor", range(8)),
        payload=Struct("mx" / cent, "my" / cent, "fz" / Quantity(Int16sl, scale=0.1, unit="N")),
    )
    protocol.message(
        "Imu",
        id=0x050 + IdField("sensor", range(8)),
        payload=Struct("roll" / cent, "pitch" / cent, "roll_rate" / cent, "pitch_rate" / cent),
    )
    return protocol


def car_like() -> Protocol:
    """One message with eight signals, as cars send them."""
    protocol = Protocol("bench_car", link="can")
    protocol.message(
        "Engine",
        id=0x100,
        payload=BitLayout(
            8,
            "speed" / Quantity(bits(16), scale=0.25, unit="rpm"),
            "coolant" / Quantity(bits(8), offset=-40, unit="°C"),
            "throttle" / Quantity(bits(8), scale=0.4, unit="%"),
            "torque" / Quantity(bits(12, signed=True), scale=0.5, unit="N·m"),
            "gear" / Enumeration(bits(4), park=0, reverse=1, neutral=2, drive=3),
            "load" / Quantity(bits(10), scale=0.1, unit="%"),
            "fault" / bits(1),
            "idle" / bits(5),
        ),
    )
    return protocol


def messages(shapes: Sequence[tuple[int, int]], count: int) -> list[Any]:
    """Python-can messages of the given (identifier, length), random data."""
    rng = random.Random(7)
    found = []
    for number in range(count):
        identifier, size = shapes[number % len(shapes)]
        data = rng.randbytes(size)
        found.append(
            can.Message(
                arbitration_id=identifier,
                data=data,
                is_extended_id=False,
                timestamp=1e9 + number / 1e3,
                channel="can0",
            )
        )
    return found


def _batches(items: Sequence[Any], size: int) -> Iterator[Sequence[Any]]:
    for at in range(0, len(items), size):
        yield items[at : at + size]


def can_rows(
    subject: str, protocol: Protocol, shapes: Sequence[tuple[int, int, str, str]], *, rounds: int, count: int
) -> list[BenchRow]:
    """Rows of one kind of frames; `shapes` are (identifier, length, message, bare struct format)."""
    frames = messages([(identifier, size) for identifier, size, _, _ in shapes], count)
    cantools = optional("cantools")
    decoders = decoders_of(protocol.variant(), False, False)
    work = [
        (
            bytes(frame.data),
            frame.arbitration_id,
            decoders[shapes[n % len(shapes)][2]],
            struct.Struct(shapes[n % len(shapes)][3]).unpack,
        )
        for n, frame in enumerate(frames)
    ]
    scanner = CanScanner([protocol.variant()])

    def bare() -> None:
        for data, _, _, unpack in work:
            unpack(data)

    def codec_alone() -> None:
        for data, key, decode, _ in work:
            decode(data, key, None, None, data, None)

    def in_batches() -> None:
        for batch in _batches(frames, BATCH):
            scanner.feed(batch)

    def one_by_one() -> None:
        for frame in frames:
            scanner.feed((frame,))

    def without_lists() -> None:
        for frame in frames:
            if scanner.take(frame) is None:
                scanner.feed((frame,))

    contenders: dict[str, Callable[[], object]] = {
        "struct, bare": bare,
        "aces codec": codec_alone,
        f"aces feed, {BATCH} at once": in_batches,
        "aces feed, one by one": one_by_one,
        "aces take, one by one": without_lists,
    }
    if cantools is not None:
        decode = cantools.database.load_string(_DBC, "dbc", strict=False).decode_message
        known = [(frame, shapes[n % len(shapes)][0] & 0x7F0) for n, frame in enumerate(frames)]

        def peer() -> None:
            for frame, identifier in known:
                decode(identifier, frame.data)

        contenders["cantools"] = peer
    best = {
        name: seconds / len(frames) * 1e6
        for name, seconds in fastest(contenders, rounds=rounds, one_thread=True).items()
    }
    rows = []
    peer_time = best.get("cantools")
    targets = {
        "aces codec": 6.0,
        f"aces feed, {BATCH} at once": 4.0,
        "aces feed, one by one": 2.5,
        "aces take, one by one": 3.2,
    }
    for name in ("cantools", "struct, bare", *targets):
        if name not in best:
            continue
        ratio = peer_time / best[name] if peer_time is not None and name != "cantools" else None
        target = targets.get(name)
        rows.append(
            BenchRow(
                subject,
                name,
                best[name],
                "µs/frame",
                ratio,
                f"≥ {target:g} × cantools" if target else "",
                ratio >= target if ratio is not None and target else None,
            )
        )
    over = best["aces codec"] / best["struct, bare"]
    rows.append(BenchRow(subject, "aces codec / bare struct", over, "×", None, "≤ 3 ×", over <= 3))
    return rows


# ---------------------------------------------------------------------- serial


def dynamixel_stream(size: int) -> tuple[bytes, int]:
    """A status stream of about `size` bytes, and how many packets in it are good."""
    rng = random.Random(11)
    out = bytearray()
    good = 0
    while len(out) < size:
        body = bytes([rng.randrange(1, 30), 4 + rng.randrange(2), 0]) + rng.randbytes(3)
        body = body[: body[1] + 1]
        check = ~sum(body) & 0xFF
        if rng.random() < 0.001:
            check ^= 0x55
        else:
            good += 1
        out += b"\xff\xff" + body + bytes([check])
        if rng.random() < 0.085:
            out.append(rng.randrange(0xFE))  # 1 % of the bytes, none of them a header
    return bytes(out), good


class _Port:
    """What dynamixel_sdk needs of a serial port, over bytes in memory."""

    def __init__(self, data: bytes) -> None:
        self.data, self.at, self.is_using = data, 0, False

    def readPort(self, size: int) -> bytes:
        self.at += size
        return self.data[self.at - size : self.at]

    def isPacketTimeout(self) -> bool:
        return self.at >= len(self.data)


def sdk_packets(data: bytes) -> Callable[[], int] | None:
    """How many good packets dynamixel_sdk finds in `data`, as a function; None where it is not installed."""
    sdk = optional("dynamixel_sdk")
    if sdk is None:
        return None
    handler = sdk.PacketHandler(1.0)

    def run() -> int:
        port = _Port(data)
        count = 0
        while port.at < len(data):
            count += handler.rxPacket(port)[1] == 0
        return count

    return run


def serial_rows(*, rounds: int, size: int) -> list[BenchRow]:
    """Dynamixel 1.0 records beside dynamixel_sdk."""
    data, good = dynamixel_stream(size)
    found: dict[str, int] = {}

    def ours() -> None:
        scanner = robotis.scanner(direction="from device")
        for at in range(0, len(data), CHUNK):
            scanner.feed(data[at : at + CHUNK])
        scanner.close()
        found["aces"] = scanner.counts.records

    contenders: dict[str, Callable[[], object]] = {"aces records": ours}
    sdk = sdk_packets(data)
    if sdk is not None:
        count = sdk

        def peer() -> None:
            found["sdk"] = count()

        contenders["dynamixel_sdk"] = peer
    best = {
        name: len(data) / seconds / 1e6
        for name, seconds in fastest(contenders, rounds=rounds, one_thread=True).items()
    }
    subject = f"Dynamixel 1.0, {len(data) / 1e6:.1f} MB in {CHUNK}-byte chunks"
    rows = []
    if sdk is not None:
        rows.append(
            BenchRow(
                subject,
                f"dynamixel_sdk, {found['sdk']} of {good} good packets",
                best["dynamixel_sdk"],
                "MB/s",
            )
        )
    ratio = best["aces records"] / best["dynamixel_sdk"] if sdk is not None else None
    met = None if ratio is None else ratio >= 3 and found["aces"] >= good
    rows.append(
        BenchRow(
            subject,
            f"aces records, {found['aces']} of {good} good packets",
            best["aces records"],
            "MB/s",
            ratio,
            "≥ 3 × dynamixel_sdk, none lost",
            met,
        )
    )
    return rows


def construct_rows(*, rounds: int, count: int) -> list[BenchRow]:
    """construct itself, interpreted and compiled, on the encoder frame: what the generated decoder replaces."""
    plain = Struct("position" / Array(2, Int32sl))
    quick: Compiled = plain.compile()
    rng = random.Random(3)
    data = [rng.randbytes(8) for _ in range(count)]
    decode = decoders_of(hubo_like().variant(), False, False)["Encoder"]

    def each(call: Callable[[bytes], object]) -> Callable[[], object]:
        def run() -> None:
            for item in data:
                call(item)

        return run

    best = fastest(
        {
            "construct": each(plain.parse),
            "construct, compiled": each(quick.parse),
            "aces codec": each(lambda item: decode(item, 0x60, None, None, item, None)),
        },
        rounds=rounds,
        one_thread=True,
    )
    base = best["construct, compiled"]
    return [
        BenchRow(
            "construct on 2 × int32",
            name,
            seconds / count * 1e6,
            "µs/frame",
            base / seconds if name == "aces codec" else None,
        )
        for name, seconds in best.items()
    ]


def run(*, quick: bool = False) -> Iterable[BenchRow]:
    """All rows; `quick` takes a few seconds and is rougher."""
    rounds, count, size = (5, 4_000, 200_000) if quick else (30, 20_000, 2_000_000)
    hubo_shapes = [(0x060, 8, "Encoder", "<2i"), (0x040, 6, "ForceTorque", "<3h"), (0x050, 8, "Imu", "<4h")]
    yield from can_rows(
        "Hubo: 2 × int32, 3 × int16, 4 × int16", hubo_like(), hubo_shapes, rounds=rounds, count=count
    )
    yield from can_rows(
        "car: 8 signals", car_like(), [(0x100, 8, "Engine", "<H2B2H")], rounds=rounds, count=count
    )
    yield from serial_rows(rounds=max(3, rounds // 6), size=size)
    yield from construct_rows(rounds=max(3, rounds // 6), count=count // 4)
