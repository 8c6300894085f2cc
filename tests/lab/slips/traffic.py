"""Recordings of the six devices: smooth quantities in plain `struct`, from the sheets and not from the specs."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator
from pathlib import Path

import anycrc

#: Cycles of 20 ms.
CYCLES = 1500
_DVB_S2, _XMODEM = anycrc.Model("CRC8-DVB-S2"), anycrc.Model("CRC16-XMODEM")


def wave(cycle: int, period: float, size: float, middle: float = 0.0) -> float:
    """A quantity that swings, with a smaller swing on top."""
    at = 2 * math.pi * cycle / period
    return middle + size * (0.8 * math.sin(at) + 0.2 * math.sin(7.3 * at + 1))


def _can(lines: Iterator[tuple[float, int, bytes, str]]) -> bytes:
    return "".join(
        f"({1000 + t:.6f}) can0 {i:03X}#{d.hex().upper()} {way}\n" for t, i, d, way in lines
    ).encode()


def _rmd() -> Iterator[tuple[float, int, bytes, str]]:
    """The host asks two motors in turn; it sends (T) the requests and receives (R) the answers."""
    for cycle in range(CYCLES):
        for motor in (1, 2):
            t, c = cycle * 0.02 + motor * 0.005, cycle + 300 * motor
            heat = int(wave(c, 900, 15, 45))
            amps, speed = int(100 * wave(c, 170, 12)), int(wave(c, 230, 700))
            asked: list[tuple[bytes, bytes]] = [
                (
                    struct.pack("<B7x", 0x9C),
                    struct.pack("<BBhhh", 0x9C, heat, amps, speed, int(wave(c, 410, 900))),
                ),
                (
                    struct.pack("<B3xi", 0xA2, int(100 * wave(c, 230, 700))),
                    struct.pack("<BBhhH", 0xA2, heat, amps, speed, int(wave(c, 390, 30_000, 32_768))),
                ),
                (struct.pack("<B7x", 0x92), struct.pack("<B3xi", 0x92, int(100 * wave(c, 610, 4000)))),
            ]
            if not cycle % 5:
                volts, flags = (
                    int(10 * wave(c, 500, 4, 48)),
                    0b00100 * (c % 300 < 40) | 0b10000 * (c % 500 < 30),
                )
                asked += [
                    (
                        struct.pack("<B7x", 0x9A),
                        struct.pack("<BBBBHH", 0x9A, heat, 0, int(c % 400 > 90), volts, flags),
                    ),
                    (struct.pack("<B7x", 0xB1), struct.pack("<B3xI", 0xB1, cycle * 20 + 77)),
                ]
                gain = (1, 2, 4, 5, 7)[cycle // 5 % 5]
                asked.append(
                    (
                        struct.pack("<BB6x", 0x30, gain),
                        struct.pack("<BB2xf", 0x30, gain, wave(c, 800, gain, 3 * gain)),
                    )
                )
            for number, (question, answer) in enumerate(asked):
                yield t + 0.0006 * number, 0x140 + motor, question, "T"
                yield t + 0.0006 * number + 0.0003, 0x240 + motor, answer, "R"


def _drive() -> Iterator[tuple[float, int, bytes, str]]:
    for cycle in range(CYCLES):
        for node in (3, 4):
            t, c, key = cycle * 0.02 + node * 0.001, cycle + 200 * node, node << 5
            place, speed, amps = wave(c, 400, 3), wave(c, 300, 5), wave(c, 150, 8)
            yield t, key | 0x09, struct.pack("<ff", place, speed), "R"
            yield t + 1e-4, key | 0x14, struct.pack("<ff", amps, amps + wave(c, 37, 0.2)), "R"
            numbers = int(1000 * wave(c, 300, 5)), int(1000 * wave(c, 210, 2))
            yield t + 2e-4, key | 0x0C, struct.pack("<fhh", place + 0.01, *numbers), "T"
            if not cycle % 5:
                error = (1 << 25) * (c % 700 < 25) | (1 << 10) * (c % 500 < 20) | (1 << 6) * (c % 900 < 30)
                state = 1 if cycle < 100 else 3 if cycle < 200 else 8
                life = cycle // 5 % 128
                yield (
                    t + 3e-4,
                    key | 1,
                    struct.pack("<IBBBx", error, state, 0, int(c % 90 > 40) | life << 1),
                    "R",
                )
                yield t + 4e-4, key | 0x17, struct.pack("<ff", wave(c, 700, 1.5, 24), wave(c, 150, 2, 3)), "R"
            if cycle in (100, 200):
                yield t + 5e-4, key | 7, struct.pack("<I", 3 if cycle == 100 else 8), "T"


def _crsf() -> Iterator[bytes]:
    def packet(kind: int, data: bytes) -> bytes:
        body = bytes([kind]) + data
        return bytes([0xC8, len(body) + 1]) + body + bytes([_DVB_S2.calc(body)])

    for c in range(CYCLES):
        word = 0
        for channel in range(16):
            word |= int(wave(c + 40 * channel, 200 + 23 * channel, 800, 992)) << 11 * channel
        yield packet(0x16, word.to_bytes(22, "little"))
        angles = (int(10_000 * wave(c, 90 + 40 * n, 1.2 - 0.3 * n)) for n in range(3))
        yield packet(0x1E, struct.pack(">hhh", *angles))
        if not c % 3:
            place = int(1e7 * (48.1 + 1e-4 * wave(c, 900, 1))), int(1e7 * (-11.5 + 2e-4 * wave(c, 700, 1)))
            course = int(100 * wave(c, 500, 100, 180)), int(wave(c, 800, 60, 350)) + 1000
            yield packet(
                0x02,
                struct.pack(">iiHHHB", *place, int(10 * wave(c, 300, 20, 40)), *course, 9 + c // 200 % 5),
            )
            used = 300 + c // 2
            volts, amps = int(10 * (25.2 - c / 500)), int(10 * wave(c, 120, 9, 20))
            yield packet(
                0x08, struct.pack(">HH", volts, amps) + used.to_bytes(3, "big") + bytes([99 - c // 40])
            )
            link = int(wave(c, 200, 25, 70)), int(wave(c, 300, 15, 84)), int(wave(c, 250, 8, 2))
            yield packet(0x14, struct.pack(">BBbBBB", *link, c // 90 % 2, 1 + c // 400 % 2, 1 + c // 300 % 3))
        if not c % 30:
            yield packet(0x21, (b"ACRO\0\0", b"ANGLE\0", b"RTH\0\0\0")[c // 500])


def _blocks() -> Iterator[bytes]:
    def block(kind: int, data: bytes) -> bytes:
        body = struct.pack("<HH", kind, len(data) + 8) + data
        return b"$@" + struct.pack("<H", _XMODEM.calc(body)) + body

    for c in range(CYCLES):
        tow, week = struct.pack("<I", 345_600_000 + 100 * c), struct.pack("<H", 2288)
        never = c < 60
        place = (
            (-2e10, -2e10, -2e10)
            if never
            else (0.84 + 1e-6 * wave(c, 900, 3), 0.201 + 1e-6 * wave(c, 800, 3), wave(c, 600, 40, 520))
        )
        mode = 0 if never else 1 + c // 500
        seen = 6 + c // 100 % 7
        yield block(
            4007,
            tow
            + week
            + struct.pack(
                "<BBdddfB3x", mode, int(never), *place, abs(wave(c, 300, 12)), 0 if never else seen
            ),
        )
        speeds = (wave(c, 300, 9), wave(c, 260, 7), wave(c, 140, 1))
        yield block(5908, tow + week + struct.pack("<Hfff", int(wave(c, 500, 30, 90)), *speeds))
        group, size = [], 8 + 2 * (c > 900)  # a later firmware has more in a group
        for n in range(seen):
            azimuth = int(wave(c + 90 * n, 1200, 170, 180))
            values = n + 3, int(wave(c + 50 * n, 900, 35, 45)), azimuth, int(4 * wave(c + 30 * n, 400, 9, 40))
            group.append(struct.pack("<BBHH", *values) + bytes(size - 6))
        yield block(4013, tow + week + bytes([seen, size]) + b"".join(group))
        if not c % 5:
            yield block(5911, tow + struct.pack("<q4x", int(1e12 * (3e-4 + 1e-7 * c))))


def _groups() -> Iterator[bytes]:
    for c in range(CYCLES):
        fields = 0b0001111 | 0b0110000 * (not c % 4) | 0b1000000 * (not c % 3)
        body = struct.pack("<BH", 1, fields) + struct.pack("<QI", 7_000_000_000 + 20_000_000 * c, 1000 + c)
        body += struct.pack("<fff", wave(c, 500, 150), wave(c, 300, 40), wave(c, 260, 60))
        body += struct.pack("<fff", wave(c, 90, 2), wave(c, 120, 1.5), wave(c, 150, 1))
        if fields & 0b10000:
            body += struct.pack("<f", wave(c, 900, 6, 35))
        if fields & 0b100000:
            body += struct.pack("<f", wave(c, 1100, 0.4, 98.5))
        if fields & 0b1000000:
            body += struct.pack("<H", (1, 3, 0x101)[c // 400 % 3])
        yield b"\xfa" + body + struct.pack(">H", _XMODEM.calc(body))


def _trace() -> Iterator[bytes]:
    for c in range(CYCLES):
        flags = 0x21 | 0x04 | 0x10 | 0x08 * (c % 4 == 0)
        body = b"ECU1" + (struct.pack(">I", 0x51 + c // 400) if flags & 8 else b"")
        body += struct.pack(">I", 120_000 + 200 * c)
        text = b"speed %d" % int(wave(c, 300, 40, 60))
        body += (
            bytes([0x41 if c % 3 else 0x31, 1 + c % 3]) + (b"DRV\0" if c % 2 else b"NAV\0") + b"MAIN" + text
        )
        yield b"DLS\x01" + struct.pack(">BBH", flags, c & 0xFF, len(body) + 4) + body


def record(folder: Path) -> dict[str, Path]:
    """Write a recording of each device; return them by the name of its spec."""
    made = {
        "rmd": ("log", _can(_rmd())),
        "drive": ("log", _can(_drive())),
        "crsf": ("bin", b"".join(_crsf())),
        "blocks": ("bin", b"".join(_blocks())),
        "groups": ("bin", b"".join(_groups())),
        "trace": ("bin", b"".join(_trace())),
    }
    found: dict[str, Path] = {}
    for name, (ending, data) in made.items():
        found[name] = folder / f"{name}.{ending}"
        found[name].write_bytes(data)
    return found
