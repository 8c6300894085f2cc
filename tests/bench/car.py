"""A mid-sized car that never was: its DBC and its traffic, the same for everybody who measures.

1. Everything comes from one seed: the same file on every machine.

The proportions are those of public car databases: 60 messages of 8 bytes, 7.6 signals each on average, two thirds
Intel (little-endian), a third signed, most of them scaled, some with value tables, five messages multiplexed.
"""

from __future__ import annotations

import random
from pathlib import Path

import numpy as np

from aces_bus import FrameTable
from aces_bus.frame_table import Channels

MESSAGES = 60
#: The log starts here, in ns: any fixed instant does.
START = 1_700_000_000_000_000_000


def car_dbc(seed: int = 60) -> str:
    """The text of the database."""
    rng = random.Random(seed)
    lines = ['VERSION ""', "", "BU_: ECU TESTER", ""]
    tables: list[str] = []
    for number in range(MESSAGES):
        identifier = 0x100 + 11 * number
        lines.append(f"BO_ {identifier} Message{number:02}: 8 ECU")
        is_big = number % 3 == 2
        is_multiplexed = number % 12 == 5
        bit = 0
        if is_multiplexed:
            lines.append(
                f' SG_ Mode{number:02} M : {_start(0, is_big)}|8@{_order(is_big)}+ (1,0) [0|3] "" TESTER'
            )
            for page in range(4):
                for place in range(3):
                    at = 8 + 16 * place
                    lines.append(
                        f" SG_ Page{page}Value{place}_{number:02} m{page} : {_start(at, is_big)}|16@{_order(is_big)}"
                        f'{rng.choice("+-")} ({rng.choice(("0.1", "0.01", "1"))},0) [0|0] "V" TESTER'
                    )
            lines.append("")
            continue
        signal = 0
        while bit < 64:
            width = min(rng.choice((1, 2, 4, 8, 8, 10, 12, 16, 16)), 64 - bit)
            name = f"Signal{signal}_{number:02}"
            sign = "-" if width > 4 and rng.random() < 0.35 else "+"
            scale, offset = (
                rng.choice(
                    (
                        ("1", "0"),
                        ("0.1", "0"),
                        ("0.01", "0"),
                        ("0.5", "-40"),
                        ("0.0625", "0"),
                        ("0.00390625", "-100"),
                    )
                )
                if width > 4
                else ("1", "0")
            )
            unit = rng.choice(("km/h", "rpm", "%", "degC", "Nm", "V")) if width > 4 else ""
            lines.append(
                f" SG_ {name} : {_start(bit, is_big)}|{width}@{_order(is_big)}{sign} ({scale},{offset}) [0|0]"
                f' "{unit}" TESTER'
            )
            if width == 2:
                tables.append(f'VAL_ {identifier} {name} 0 "off" 1 "on" 2 "fault" 3 "not available" ;')
            bit += width
            signal += 1
        lines.append("")
    return "\n".join([*lines, *tables, ""])


def _order(is_big: bool) -> int:
    return 0 if is_big else 1


def _start(bit: int, is_big: bool) -> int:
    """Where DBC says a signal starts: the lowest bit (Intel) or the highest one (Motorola), in its own numbering."""
    return bit if not is_big else 8 * (bit // 8) + 7 - bit % 8


def car_traffic(count: int, first: int = 0, seed: int = 1) -> FrameTable:
    """Frames `first` to `first + count` of the car's bus: random data, 0.25 ms apart, identifiers in a fixed order."""
    rng = np.random.default_rng((seed, first))
    numbers = np.arange(first, first + count)
    which = numbers % 997 * 31 % MESSAGES
    data = rng.integers(0, 256, (count, 8), np.uint8)
    data[which % 12 == 5, 0] %= 4  # the mode of a multiplexed message: one that it has
    return FrameTable(
        START + numbers * 250_000,
        np.zeros(count, np.uint16),
        (0x100 + 11 * which).astype(np.uint32),
        np.zeros(count, np.uint8),
        np.full(count, 8, np.uint8),
        data,
        Channels(["can0"]),
    )


def write_car_log(path: Path, count: int, piece: int = 100_000) -> int:
    """Write the traffic as a candump log; the number of bytes."""
    size = 0
    with open(path, "wb") as file:
        for first in range(0, count, piece):
            table = car_traffic(min(piece, count - first), first)
            text = table.data.tobytes().hex().upper()
            rows = zip(table.time.tolist(), table.id.tolist(), range(0, len(text), 16), strict=True)
            lines = [
                f"({ns // 1_000_000_000}.{ns // 1000 % 1_000_000:06}) can0 {identifier:03X}#{text[at : at + 16]}\n"
                for ns, identifier, at in rows
            ]
            size += file.write("".join(lines).encode())
    return size
