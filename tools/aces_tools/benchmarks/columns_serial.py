"""The serial part of `aces bench columns`: a Dynamixel stream into columns, beside dynamixel_sdk."""

from __future__ import annotations

from collections.abc import Callable

from aces_bus.protocol import load_protocol
from aces_bus.protocol.columns.scanner import make_column_scanner

from .live import dynamixel_stream, sdk_packets
from .timing import BenchRow, fastest

#: Chunk size → how many times dynamixel_sdk's rate is wanted.
CHUNKS = {1 << 20: 40.0, 4096: 12.0}


def stream_rows(*, quick: bool) -> list[BenchRow]:
    """Rows for each chunk size; the peer reads a part."""
    data, good = dynamixel_stream(1_000_000)
    whole = data * (8 if quick else 64)
    part = data[:400_000]
    variant = load_protocol("robotis").variant()
    found: dict[int, int] = {}

    def ours(chunk: int) -> Callable[[], object]:
        def run() -> None:
            scanner = make_column_scanner([variant], direction="from device")
            for at in range(0, len(whole), chunk):
                for table in scanner.feed(whole[at : at + chunk]):
                    for column in table.columns():
                        len(column)
            for table in scanner.close():
                for column in table.columns():
                    len(column)
            found[chunk] = scanner.counts.records

        return run

    contenders: dict[str, Callable[[], object]] = {str(chunk): ours(chunk) for chunk in CHUNKS}
    peer = sdk_packets(part)
    if peer is not None:
        contenders["dynamixel_sdk"] = peer
    best = fastest(contenders, rounds=2 if quick else 4)
    base = len(part) / best["dynamixel_sdk"] / 1e6 if peer is not None else None
    subject = f"Dynamixel 1.0 → columns, {len(whole) / 1e6:.0f} MB"
    rows = []
    for chunk, target in CHUNKS.items():
        rate = len(whole) / best[str(chunk)] / 1e6
        ratio = rate / base if base is not None else None
        wanted = good * (len(whole) // len(data))
        label = f"aces, chunks of {chunk:,} bytes, {found[chunk]} of {wanted} good packets"
        is_met = None if ratio is None else ratio >= target and found[chunk] >= wanted
        rows.append(BenchRow(subject, label, rate, "MB/s", ratio, f"≥ {target:g} × dynamixel_sdk", is_met))
    if base is not None:
        rows.append(BenchRow(subject, "dynamixel_sdk", base, "MB/s"))
    return rows
