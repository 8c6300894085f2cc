"""Databases that others made, proved and held beside cantools: `python -m tests.lab.prove.databases FOLDER [NAME …]`.

FOLDER is `tests/files/dbc` of the source distribution of cantools; nothing is fetched here. The table of a run is kept in
`tests/lab/prove/databases.txt`.

1. Every message is proved as `aces spec prove FILE` proves it.
2. Frames that were drawn, and each witness, are decoded by the reference and by cantools, in raw numbers. Where they differ,
   the bits that the database names are added up here, by neither.
"""

from __future__ import annotations

import sys
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import cantools.database
import cantools.errors

from aces_bus.protocol import Variant
from aces_lab.prove.account import summary
from aces_lab.prove.apart import ApartJob
from aces_lab.prove.decoding import Witness, drawn, proof_lengths
from aces_lab.prove.run import jobs_of, prove_all
from aces_lab.prove.witness import by_reference, image_of
from aces_tools.protocols_arg import named_protocol

#: Multiplexed, cascaded, signed, float, FD, 29-bit, Motorola, with gaps, with choices, generated and written by hand.
NAMES = (
    "abs", "attributes", "big_numbers", "choices", "emc32", "fd_test", "floating_point", "foobar",
    "issue_184_extended_mux_cascaded", "j1939", "long_names", "motohawk", "msxii_system_can", "multiplex",
    "multiplex_2", "open_actuator", "padding_bit_order", "signed", "socialledge", "vehicle",
)  # fmt: skip
#: Frames of a message that are decoded by both.
FRAMES = 60


def bits_added(signal: cantools.database.Signal, data: bytes) -> int:
    """Return the number whose bits the database names: from the lowest (Intel), or from the highest on (Motorola)."""
    at, number = signal.start, 0
    for weight in range(signal.length):
        bit = data[at // 8] >> at % 8 & 1
        if signal.byte_order == "little_endian":
            number |= bit << weight
            at += 1
        else:
            number = number << 1 | bit
            at = at - 1 if at % 8 else at + 15
    return number - (1 << signal.length) if signal.is_signed and number >> signal.length - 1 else number


def differences(
    variant: Variant, database: cantools.database.Database, more: Sequence[tuple[str, Witness]]
) -> list[str]:
    """Return where the reference and cantools read a frame differently, and what the bits add up to."""
    frames: list[tuple[str, Witness]] = []
    for name, message in variant.messages.items():  # most numbers of a selector have no signals
        count = 10 * FRAMES if database.get_message_by_name(name).is_multiplexed() else FRAMES
        frames += [(name, found) for found in drawn(message, proof_lengths(message)[0], count)]
    lines: list[str] = []
    refused: Counter[str] = Counter()
    for name, frame in [*more, *frames]:
        message = variant.messages[name]
        ours = by_reference(message, image_of(message, frame))
        if ours is None:
            continue
        foreign = database.get_message_by_name(name)
        try:
            theirs = foreign.decode(frame.data, decode_choices=False, scaling=False)
        except cantools.errors.Error as error:
            refused[f"{name}: refused by cantools ({str(error).partition(',')[0]} …), read here"] += 1
            continue
        assert isinstance(theirs, dict)
        for signal in foreign.signals:
            mine, other = ours.get(signal.name), theirs.get(signal.name)
            if not signal.is_float and mine != other:
                truth = bits_added(signal, frame.data)
                lines.append(
                    f"{name}.{signal.name} {frame.data.hex()}: {mine!r} here, {other!r} in cantools, {truth} by its bits"
                )
    return [*lines, *(f"{count} × {text}" for text, count in refused.items())]


def main(folder: Path, names: Sequence[str]) -> int:
    """Print a line for each database, and where cantools differs."""
    print(f"{'database':36} messages  seconds  account")
    for name in names or NAMES:
        path, started = folder / f"{name}.dbc", time.monotonic()
        variant = named_protocol(str(path)).variant()
        jobs = jobs_of([variant])
        outcomes = [one for found in prove_all(jobs, 2) for one in found]
        apart = [one for found in prove_all([ApartJob(variant)], 1) for one in found]
        used = time.monotonic() - started
        print(
            f"{name:36} {len(variant.messages):8} {used:8.1f}  {summary(outcomes)}; apart: {summary(apart)}",
            flush=True,
        )
        witnesses = [(one.message, one.witness) for one in outcomes if one.witness is not None]
        database = cantools.database.load_file(str(path), strict=False)
        assert isinstance(database, cantools.database.Database)
        said = differences(variant, database, witnesses)
        for text in said[:3]:
            print(f"  {text}")
        if len(said) > 3:
            print(f"  and {len(said) - 3} more")
    return 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), sys.argv[2:]))
