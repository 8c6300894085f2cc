"""What `aces spec guess` gets right of traffic whose specs are known: `make guess-score`, or `python -m tests.bench.guess`.

    python -m tests.bench.guess                    both tables, and what went wrong, by name
    python -m tests.bench.guess --seed 7 --only drawn
    python -m tests.bench.guess --shared FOLDER    also recordings made by others, where they are there

1. Nothing of the specs is seen by what is scored; known protocols are not tried (as with --no-known).
2. A border between two neighbouring bits of a payload counts where both bits change in the recording: what never changed
   nobody can divide. All other figures are of whole fields, by the bits of each that change.
3. READ (Marchetti and Stabili, "READ: Reverse Engineering of Automotive Data Frames", IEEE Transactions on Information
   Forensics and Security 14(4), 2019) is coded here from its published rule, and gets the same rows.
"""

from __future__ import annotations

import argparse
import random
import warnings
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from aces_bus import Frame, load_protocol, open_recording
from aces_lab.guess import checks_of, fields_of
from tests.bench.guess_scores import FIELDS, Scores, Truth, table
from tests.bench.guess_streams import score_stream, streams_of_others, streams_of_specs
from tests.bench.twin_traffic import twin_traffic

Array = Any
SHARED = Path(__file__).resolve().parents[2].parent / "shared" / "captures"
#: Rows below which nothing is scored.
LEAST_ROWS = 64


# ---------------------------------------------------------------------- READ


def read_of(rows: Array) -> tuple[set[int], list[tuple[int, ...]]]:
    """READ's fields of rows, uint8 (n, size): the borders (before the bit of that number in the order of the frame, the
    highest bit of the first byte being 0), and its counters as runs of such numbers.

    Phase one: the rate of flips of each bit, its magnitude = ceil(log10(rate)); a field ends where the magnitude falls.
    Phase two: in a field, bits whose rates double up to one flip in each frame are a counter; bits that flip in half of all
    frames are a check.
    """
    bits = np.unpackbits(rows, axis=1)
    rates = (bits[1:] ^ bits[:-1]).mean(axis=0)
    with np.errstate(divide="ignore"):
        magnitude = np.where(rates > 0, np.ceil(np.log10(rates)), -np.inf)
    borders = {at for at in range(1, len(rates)) if magnitude[at] < magnitude[at - 1]}
    borders |= {at for at in range(1, len(rates)) if (rates[at] > 0) != (rates[at - 1] > 0)}
    counters: list[tuple[int, ...]] = []
    edges = [0, *sorted(borders), len(rates)]
    for start, end in pairwise(edges):
        at = start
        while at < end:
            stop = at
            # A counter: rates double from bit to bit, and the last flips always.
            while stop + 1 < end and rates[stop] > 0 and abs(rates[stop + 1] / rates[stop] - 2) < 0.2:
                stop += 1
            if stop > at and rates[stop] > 0.95:
                counters.append(tuple(range(at, stop + 1)))
                borders |= {at, stop + 1} & set(range(1, len(rates)))
                at = stop + 1
                continue
            stop = at
            while stop < end and abs(rates[stop] - 0.5) < 0.05:
                stop += 1
            if stop - at >= 4:
                borders |= {at, stop} & set(range(1, len(rates)))
                at = stop
                continue
            at += 1
    return borders, counters


# ---------------------------------------------------------------------- fields


def frame_order(position: int) -> int:
    """The number of a bit in the order of the frame, of its number 8 × byte + bit."""
    return position ^ 7


def borders_of(fields: Iterable[Sequence[int]], size: int) -> set[int]:
    """Bits of the frame (in its order) that belong to another field than the bit before."""
    owner = np.full(8 * size, -1)
    for number, positions in enumerate(fields):
        for position in positions:
            owner[frame_order(position)] = number
    return {at for at in range(1, 8 * size) if owner[at] != owner[at - 1]}


def score_fields(
    name: str, rows: Array, truth: Sequence[Truth], prefix: bytes, check: str = "", times: Array | None = None
) -> Scores:
    """The fields of one message against its spec."""
    scores = Scores(name, FIELDS)
    size = rows.shape[1]
    changes = np.bitwise_or.reduce(rows, axis=0) ^ np.bitwise_and.reduce(rows, axis=0)
    varies = np.unpackbits(changes, bitorder="little").astype(bool)
    found = fields_of(rows, times, prefix)
    live = [one for one in truth if any(varies[p] for p in one.positions)]
    # ---- borders
    both = {at for at in range(1, 8 * size) if varies[frame_order(at)] and varies[frame_order(at - 1)]}
    there = borders_of([one.positions for one in truth], size) & both
    said = borders_of([one.positions for one in found], size) & both
    scores.by["boundaries"].add(len(there & said), len(said), len(there))
    read, read_counters = read_of(rows)
    scores.by["boundaries READ"].add(len(there & read & both), len(read & both), len(there))
    for at in sorted(there ^ said):
        what = "missed" if at in there else "made up"
        scores.wrong.append(f"{name}: border at bit {at % 8} of byte {at // 8} {what}")

    # ---- whole fields
    def moving(positions: Iterable[int]) -> frozenset[int]:
        return frozenset(p for p in positions if varies[p])

    wanted = {moving(one.positions): one for one in live}
    guessed = {
        moving(one.positions): one for one in found if one.kind != "constant" and moving(one.positions)
    }
    scores.by["fields"].add(len(wanted.keys() & guessed.keys()), len(guessed), len(wanted))
    still = {p for p in range(8 * size) if not varies[p]}
    constant = {p for one in found if one.kind == "constant" for p in one.positions}
    widened = {p for one in found if one.kind != "constant" for p in one.positions if not varies[p]}
    scores.by["constants"].add(len(constant & still), len(constant), len(still - widened))
    counters = {bits for bits, one in wanted.items() if one.kind == "counter"}
    said_counters = {bits for bits, one in guessed.items() if one.kind == "counter"}
    scores.by["counters"].add(len(counters & said_counters), len(said_counters), len(counters))
    by_read = {frozenset(p ^ 7 for p in run) for run in read_counters}
    scores.by["counters READ"].add(len(counters & by_read), len(by_read), len(counters))
    for bits in counters ^ said_counters:
        what = "missed" if bits in counters else "made up"
        scores.wrong.append(f"{name}: counter at bits {min(bits)}…{max(bits)} {what}")
    for bits, one in wanted.items():
        guess = guessed.get(bits)
        if guess is None or guess.kind == "check":
            continue
        if len({p // 8 for p in bits}) > 1:
            right = guess.order == one.order
            scores.by["order"].add(right, 1, 1)
            if not right:
                scores.wrong.append(f"{name}.{one.name}: order {guess.order}, is {one.order}")
        # A sign shows where there are values on both sides of zero.
        if (
            one.signed is not None
            and one.kind == "number"
            and guess.kind in ("number", "enumeration")
            and len(bits) > 3
        ):
            top = varies[one.positions[-1]]
            if top:
                right = guess.signed == one.signed
                scores.by["sign"].add(right, 1, 1)
                if not right:
                    scores.wrong.append(f"{name}.{one.name}: signed {guess.signed}, is {one.signed}")
    # ---- checks
    checks = checks_of(rows, prefix)
    place = next((min(one.positions) // 8 for one in live if one.kind == "check"), None)
    agreeing = sum(
        one.offset == place and (not check or check in (one.check.describe, one.declared)) for one in checks
    )
    scores.by["checks"].add(agreeing, len(checks), int(place is not None))
    if agreeing != len(checks) or agreeing != int(place is not None):
        scores.wrong.append(
            f"{name}: check {check or 'none'} at {place}, said {[one.declared for one in checks]}"
        )
    return scores


# ---------------------------------------------------------------------- drawn databases


def drawn_database(
    seed: int, messages: int = 12, rows: int = 1500
) -> Iterator[tuple[str, Array, list[Truth], bytes, str]]:
    """Messages of a database drawn at random: names, rows, truth, identifier, check. cantools packs the values."""
    from cantools.database.can import Message, Signal

    from aces_bus.protocol import Crc, Sum, Xor

    dice = random.Random(f"guess {seed}")
    numbers = np.random.default_rng(seed)
    for number in range(messages):
        little = dice.random() < 0.5
        size = 8
        kind = dice.choice(["", "", "", "CRC8-SAE-J1850", "CRC8-AUTOSAR", "xor", "sum", "id"])
        last = size - 1 if kind else size
        signals: list[Any] = []
        truths: list[Truth] = []
        at = 0
        while at < 8 * last - 8:
            if dice.random() < 0.15:
                at += dice.choice([1, 2, 4, 8])
            what = dice.choice(["number"] * 5 + ["flag", "flag", "enumeration", "counter"])
            if what == "counter" and any(one.kind == "counter" for one in truths):
                what = "number"
            length = {
                "number": dice.choice([8, 8, 10, 12, 12, 14, 16, 16, 16, 24]),
                "flag": 1,
                "enumeration": dice.choice([2, 3, 4]),
                "counter": dice.choice([4, 4, 8]),
            }[what]
            if length >= 8 and dice.random() < 0.7:
                at = -(-at // 8) * 8
            if what == "counter":
                at = -(-at // 4) * 4
            if at + length > 8 * last:
                break
            # `at` counts bits in the order of the byte order: from the lowest of byte 0 (little), from its highest (big).
            bits = list(range(at, at + length))
            positions = tuple(bits if little else [bit ^ 7 for bit in reversed(bits)])
            signed = what == "number" and dice.random() < 0.4
            start = at if little else at ^ 7
            name = f"{what}_{at}"
            signals.append(
                Signal(name, start, length, "little_endian" if little else "big_endian", is_signed=signed)
            )
            truths.append(
                Truth(
                    name, positions, "little" if little else "big", signed if what == "number" else None, what
                )
            )
            at += length
        if not signals:
            continue
        identifier = dice.randrange(0x80, 0x7F0)
        message = Message(identifier, f"M{number}", size, signals, strict=True)
        columns = {
            one.name: _walk(numbers, one, truth, rows) for one, truth in zip(signals, truths, strict=True)
        }
        data = np.zeros((rows, size), np.uint8)
        for row in range(rows):
            packed = message.encode(
                {name: int(values[row]) for name, values in columns.items()}, scaling=False, strict=False
            )
            data[row] = np.frombuffer(packed, np.uint8)
        prefix = identifier.to_bytes(4, "big")
        described = ""
        if kind:
            check = {"xor": Xor(), "sum": Sum()}.get(kind) or Crc("CRC8-SAE-J1850" if kind == "id" else kind)
            lead = prefix[2:] if kind == "id" else b""
            for packet in data:
                packet[7] = check.compute(lead + packet[:7].tobytes())
            truths.append(Truth("check", tuple(range(56, 64)), "little", None, "check"))
            described = check.describe
        yield f"drawn {seed}.M{number}", data, truths, prefix, described


def _walk(numbers: Any, signal: Any, truth: Truth, rows: int) -> Array:
    """Values as quantities have them: slow swings with some noise; counters; modes that hold for a while."""
    length = signal.length
    if truth.kind == "counter":
        return np.arange(rows) % (1 << length)
    if truth.kind in ("flag", "enumeration"):
        out: list[int] = []
        values = 1 << length
        value = int(numbers.integers(values))
        hold = numbers.uniform(5, 60)
        while len(out) < rows:
            out += [value] * max(1, int(numbers.exponential(hold)))
            value = int(numbers.integers(values))
        return np.array(out[:rows])
    low, high = (-(1 << length - 1), (1 << length - 1) - 1) if signal.is_signed else (0, (1 << length) - 1)
    time = np.arange(rows)
    swing: Array = sum(
        numbers.uniform(0.2, 1)
        * np.sin(2 * np.pi * time / numbers.uniform(150, 1500) + numbers.uniform(0, 6.3))
        for _ in range(3)
    )
    swing = (swing - swing.min()) / (swing.max() - swing.min())
    share = numbers.uniform(0.3, 0.95)
    middle = 0.5 if signal.is_signed else numbers.uniform(share / 2, 1 - share / 2)
    noise = numbers.normal(0, numbers.uniform(0, 2), rows)
    values = low + (high - low) * (middle + share * (swing - 0.5)) + noise
    return np.clip(np.round(values), low, high).astype(np.int64)


# ---------------------------------------------------------------------- twins and recordings on CAN


def truth_of(message: Any, size: int) -> list[Truth] | None:
    """The fields of a message of a spec by the bits that they have; None where they are not all at fixed places."""
    found: list[Truth] = []
    for leaf in message.plan.leaves:
        node = leaf.node
        place = getattr(node, "place", None)
        if place is None or type(node).__name__ not in ("Scalar", "Rest"):
            if type(node).__name__ == "FromIdentifier":
                continue
            return None
        positions = tuple(place)
        if not positions or max(positions) >= 8 * size or type(node).__name__ == "Rest":
            continue
        signed = node.kind == "int" if node.kind in ("int", "uint") and not node.flags else None
        places = [p // 8 for p in positions]
        order = "big" if places[0] > places[-1] else "little"
        kind = "float" if node.kind == "float" else "number"
        if node.flags:
            found += [
                Truth(f"{leaf.path}.{n}", (p,), "little", None, "flag") for n, p in enumerate(positions)
            ]
            continue
        found.append(Truth(leaf.path, positions, order, signed, kind))
    return found


def can_rows(
    frames: Sequence[Any], protocol: Any, least: int = LEAST_ROWS
) -> Iterator[tuple[str, Array, list[Truth], bytes, str]]:
    """Rows of each identifier that a protocol decodes all as one message with fixed fields."""
    scanner = protocol.scanner(direction="both")
    by: dict[tuple[int, bool], list[bytes]] = {}
    names: dict[tuple[int, bool], Counter[str]] = {}
    for frame in frames:
        for record in scanner.feed([frame]):
            key = frame.arbitration_id, frame.is_extended_id
            names.setdefault(key, Counter())[record.meta.message or ""] += 1
        by.setdefault((frame.arbitration_id, frame.is_extended_id), []).append(bytes(frame.data))
    for key, datas in sorted(by.items()):
        said = names.get(key, Counter())
        sizes = Counter(map(len, datas))
        size, count = sizes.most_common(1)[0]
        if len(said) != 1 or "" in said or not size or count < least or len(sizes) > 1:
            continue
        message = protocol.messages.get(next(iter(said))) if hasattr(protocol, "messages") else None
        truth = truth_of(message, size) if message is not None else None
        if message is None or not truth:
            continue
        rows = np.array([list(data) for data in datas], np.uint8)
        if not (rows != rows[0]).any():
            continue
        yield f"{protocol.name}.{message.name}.{key[0]:X}", rows, truth, key[0].to_bytes(4, "big"), ""


# ---------------------------------------------------------------------- the tables


def messages_of_others(shared: Path) -> Iterator[Scores]:
    """The boat's log of canboat, whose fields canboat's own table knows: five messages of an identifier are enough, as there
    are no more of most."""
    folder = shared / "nmea2000"
    if folder.is_dir():
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # what the table leaves out
            protocol = load_protocol(str(folder / "canboat.json"))
        with open_recording(folder / "candumpSample2.txt") as entries:
            frames = [one for one in entries if isinstance(one, Frame)]
        yield grouped("nmea2000/candumpSample2.txt", can_rows(frames, protocol, least=5))


def grouped(name: str, some: Iterable[tuple[str, Array, list[Truth], bytes, str]]) -> Scores:
    """The messages of one database or bus as one line."""
    total = Scores(name, FIELDS)
    for one in some:
        total.merge(score_fields(one[0], one[1], one[2], one[3], one[4]))
    return total


CAN_TWINS = ("hubo_motor", "hubo_imu", "hubo_ft", "odrive", "moteus", "robstride", "damiao", "vesc")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--databases", type=int, default=10)
    parser.add_argument("--only", choices=["streams", "twins", "drawn"])
    parser.add_argument("--shared", type=Path, default=SHARED)
    parser.add_argument("--wrong", type=int, default=60, help="mistakes that are listed")
    arguments = parser.parse_args()
    wrong: list[str] = []

    def show(title: str, lines: list[Scores]) -> None:
        table(title, lines)
        for line in lines:
            wrong.extend(line.wrong)

    if arguments.only in (None, "streams"):
        show("recordings by others", [score_stream(*one) for one in streams_of_others(arguments.shared)])
        show("fields of recordings by others on CAN", list(messages_of_others(arguments.shared)))
        show("streams of twins and of specs", [score_stream(*one) for one in streams_of_specs()])
    if arguments.only in (None, "twins"):
        lines = []
        for driver in CAN_TWINS:
            for wire, robot, frames in twin_traffic(driver):
                protocol = robot.robot.buses[wire].protocol
                variant = load_protocol(protocol.split(":")[0].split("@")[0])
                lines.append(grouped(f"twin {driver} {wire}", can_rows(frames, variant)))
        show("fields of twins' traffic on CAN", lines)
    if arguments.only in (None, "drawn"):
        seeds = range(arguments.seed, arguments.seed + arguments.databases)
        show("fields of drawn databases", [grouped(f"seed {seed}", drawn_database(seed)) for seed in seeds])
    print(f"\nwrong: {len(wrong)}")
    for line in wrong[: arguments.wrong]:
        print(f"  {line}")


if __name__ == "__main__":
    main()
