"""Specs drawn at random, held against `bit_arithmetic`: live, columns, the reference, and what is built again.

    python -m tests.laws.drawn_specs --count 20000 --seed 7

prints how many were refused by the language, and the first failures with their seed and their spec as Python source.

1. A seed gives the same spec and the same bytes everywhere.
2. A refusal is an `AcesError`; any other exception is a fault, as is any difference.
"""

from __future__ import annotations

import argparse
import sys
import traceback
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from random import Random
from typing import Any

from aces_bus import Frame, FrameTable, Unknown, make_column_scanner, make_scanner
from aces_bus.errors import AcesError, FieldError
from aces_bus.protocol import Variant
from aces_bus.protocol.reference import Reference
from tests.laws import bit_arithmetic as plain
from tests.laws.bit_arithmetic import Node
from tests.laws.spec_drawing import Told, built, draw


class Difference(AssertionError):
    """Two that should agree do not."""


def check(seed: int, frames: int = 16) -> str:
    """Hold the spec of `seed` against plain arithmetic: what came of it. Raises `Difference`, or whatever fell out."""
    drawn = draw(seed)
    try:
        protocol = built(drawn.source)
        variants = {
            name: protocol.variant(dialect=name) if name else protocol.variant() for name in drawn.messages
        }
        for variant in variants.values():
            make_scanner([variant])
    except AcesError as error:
        return f"refused: {type(error).__name__}"
    random = Random(f"bytes of {seed}")
    accepted = 0
    for name, messages in drawn.messages.items():
        if drawn.framing is None:
            accepted += _frames(variants[name], messages, drawn.is_fd, random, frames)
        else:
            accepted += _stream(variants[name], messages, drawn.framing, random, frames)
    return "accepted" if accepted else "nothing accepted"


def _bytes(node: Node, random: Random) -> bytes:
    """Bytes that the payload might take: of the right shape more often than not."""
    kind = node["kind"]
    if kind == "struct":
        out = b""
        for _, item in node["items"]:
            if item["kind"] == "mux" and random.random() < 0.5:
                continue
            if item["kind"] == "groups" and isinstance(item["count"], str):
                count = random.randint(0, 3)  # what stands before it is its count
                out = out[:-1] + bytes([count]) + b"".join(_bytes(item["item"], random) for _ in range(count))
                continue
            out += _bytes(item, random)
        return out
    if kind == "groups":
        count = random.randint(0, 3)
        before = count.to_bytes(*node["count"]) if node["count"] else b""
        return before + b"".join(_bytes(node["item"], random) for _ in range(count))
    if kind == "items":
        return b"".join(_item(node, random) for _ in range(random.randint(0, 3)))
    if kind == "const":
        return bytes(node["bytes"])
    if kind == "array":
        return b"".join(_bytes(node["item"], random) for _ in range(node["count"]))
    if kind == "mux":
        return _bytes(node["body"], random)
    if kind == "switch":
        return _bytes(random.choice([*node["cases"].values(), node["default"]]), random)
    size = random.randint(0, 3) if kind == "rest" else node["size"]
    if kind == "number" and node["type"] == "float" and random.random() < 0.3:
        special = random.choice(("7f800000", "ff800000", "7fc00000", "3f800000", "3f000000", "80000000"))
        raw = {2: special[:4], 4: special, 8: special + "00000000"}[size]
        data = bytes.fromhex(raw)
        return data if node["order"] == "big" else data[::-1]
    wish = random.random()
    if wish < 0.4:
        return bytes(random.randint(0, 3) for _ in range(size))
    return bytes([random.choice((0, 0xFF))]) * size if wish < 0.5 else random.randbytes(size)


def _item(node: Node, random: Random) -> bytes:
    """An item of a list, or something like it."""
    _, number, body = random.choice(node["kinds"])
    data = _bytes(body, random)
    if random.random() < 0.2:
        number, data = random.randint(0, 9), random.randbytes(random.randint(0, 3))
    elif random.random() < 0.1:
        data = data[:-1]
    tag, size = number.to_bytes(*node["tag"]), b""
    if node["size"]:
        said = len(data) + node["counted"] + (random.randint(-3, 3) if random.random() < 0.1 else 0)
        size = max(0, said).to_bytes(*node["size"])
    head: bytes = size + tag if node["size_first"] else tag + size
    return head + data


def _expected(
    messages: list[Told],
    key: int,
    data: bytes,
    *,
    raw: bool,
    seen: plain.Seen | None = None,
) -> tuple[str, dict[str, Any]] | None:
    for name, payload, keys in messages:
        if keys is not None and key not in keys:
            continue
        try:
            return name, plain.read_message(payload, data, raw=raw, seen=seen)
        except plain.Misfit:
            continue
    return None


_FD = (*range(9), 12, 16, 20, 24, 32, 48, 64)


def _frames(variant: Variant, messages: list[Told], is_fd: bool, random: Random, count: int) -> int:
    cases: list[tuple[int, bytes]] = []
    for _ in range(count):
        payload = random.choice(messages)[1]
        data = _bytes(payload, random)
        if random.random() < 0.15:
            data = (
                data[: random.randint(0, len(data))] if random.random() < 0.5 else data + random.randbytes(1)
            )
        if not is_fd or len(data) not in _FD:
            data = data[:8]
        cases.append((random.randint(0, 3), data))
    frames = [
        Frame(0x100 + node, data, timestamp=float(n), is_fd=is_fd) for n, (node, data) in enumerate(cases)
    ]
    wanted = []
    for raw in (False, True):
        wanted = [_expected(messages, node, data, raw=raw) for node, data in cases]
        wanted = [
            None if one is None else (one[0], {"node": node, **one[1]})
            for one, (node, _) in zip(wanted, cases, strict=True)
        ]
        scanner = make_scanner([variant], include_unknown=True, raw=raw)
        records = scanner.feed(frames)
        for (_, data), one, record in zip(cases, wanted, records, strict=True):
            _same("live", data, one, record)
        for (_, data), one, found in zip(
            cases, wanted, Reference([variant], raw=raw).frames(frames), strict=True
        ):
            _agree(
                "reference",
                data,
                one,
                None if found.message is None else (found.message, dict(found.fields or {})),
            )
        _columns(variant, cases, frames, wanted, raw)
    for (node, data), one in zip(cases, wanted, strict=True):
        if one is not None:
            _built(variant, messages, node, data, one)
    return sum(one is not None for one in wanted)


def _columns(variant: Variant, cases: list[Any], frames: list[Frame], wanted: list[Any], raw: bool) -> None:
    scanner: Any = make_column_scanner([variant], raw=raw)
    tables = [*scanner.feed(FrameTable.from_frames(frames)), *scanner.close()]
    by_row = dict(enumerate(wanted))
    _tables(tables, by_row, {row: data for row, (_, data) in enumerate(cases)}, lambda table: table.row)


def _tables(
    tables: list[Any], wanted: dict[int, Any], raws: dict[int, bytes], rows_of: Callable[[Any], Any]
) -> None:
    """Hold tables against what is wanted, by row of the capture or by offset."""
    seen: set[int] = set()
    for table in tables:
        rows = rows_of(table).tolist()
        for path in (kind.name for kind in table.kinds):
            for row, value in zip(rows, table[path].to_list(), strict=True):
                one, raw = wanted.get(row), raws.get(row, b"").hex(" ")
                if one is None or one[0] != table.message:
                    raise Difference(f"columns: {raw} is {one}, not {table.message}")
                if path != "mark" and not _equal(_at(one[1], path), value):
                    raise Difference(f"columns: {path} of {raw}: {value!r}, wanted {_at(one[1], path)!r}")
        seen.update(rows)
    missing = {row for row, one in wanted.items() if one is not None} - seen
    if missing:
        raise Difference(f"columns: left out: {[raws[row].hex(' ') for row in missing]}")


def _at(value: Any, path: str) -> Any:
    steps = path.split(".")
    for place, step in enumerate(steps):
        if value is None:
            return None
        if isinstance(value, plain.Groups):
            return [_at(group, ".".join(steps[place:])) for group in value]
        if isinstance(value, plain.Tagged):
            good = (item for item in value if item.name == step and item["reason"] is None)
            value = next((item["data"] for item in good), None)
        else:
            value = value[int(step)] if isinstance(value, list) else value[step]
    return value


def _built(
    variant: Variant, messages: list[Told], node: int, data: bytes, one: tuple[str, dict[str, Any]]
) -> None:
    """What is built from raw values is the bytes; from physical values, bytes that mean the same."""
    name, raws = one
    seen = plain.Seen()
    read = _expected(messages, node, data, raw=False, seen=seen)
    assert read is not None
    if not seen.negative_zero and not seen.nan:
        built: Any = variant.encoder.build(variant[name], raws, raw=True)
        again = bytes(built.data)
        if again != data:
            raise Difference(f"built from raw values: {again.hex(' ')}, wanted {data.hex(' ')}")
    fields = {"node": node, **read[1]}
    try:
        again = bytes(variant.encoder.encode(name, **fields).data)
    except FieldError:
        return  # out of range, or an unknown value that this field cannot say
    back = _expected(messages, node, again, raw=False)
    if back is None or back[0] != name or not _equal({"node": node, **back[1]}, fields, loose=True):
        raise Difference(f"encoded from {fields}: {again.hex(' ')} means {back}")


def _stream(
    variant: Variant, messages: list[Told], framing: dict[str, Any], random: Random, count: int
) -> int:
    data = b"".join(_packet(framing, messages, random) for _ in range(count))
    wanted = []
    for offset, packet, inside in plain.packets(framing, data):
        key = inside[0] if messages[0][2] is not None else -1
        payload = inside[framing["head"] :]
        wanted.append((offset, len(packet), key, payload))
    expected: list[tuple[int, int, tuple[str, dict[str, Any]] | None]] = []
    for raw in (False, True):
        expected = [(o, size, _expected(messages, key, payload, raw=raw)) for o, size, key, payload in wanted]
        scanner: Any = make_scanner([variant], include_unknown=True, raw=raw)
        records = []
        at = 0
        while at < len(data):
            step = random.choice((1, 7, 100, len(data)))
            records += scanner.feed(data[at : at + step])
            at += step
        records += scanner.close()
        found = [r for r in records if not isinstance(r, Unknown)]
        said = [(o, size, one) for o, size, one in expected if one is not None]
        places = [(o, size) for o, size, _ in said]
        if (mine := [(r.meta.offset, r.meta.size) for r in found]) != places:
            raise Difference(f"live: packets at {mine}, wanted {places} in {data.hex(' ')}")
        for record, (o, size, one) in zip(found, said, strict=True):
            _same("live", data[o : o + size], one, record)
        if scanner.counts.balance != 0:
            raise Difference(f"live: the bins do not add up: {scanner.counts}")
        reference = [f for f in Reference([variant], raw=raw).stream(data) if f.message is not None]
        if (theirs := [(f.offset, f.size) for f in reference]) != places:
            raise Difference(f"reference: packets at {theirs}, wanted {places} in {data.hex(' ')}")
        for one_found, (o, size, one) in zip(reference, said, strict=True):
            _agree(
                "reference", data[o : o + size], one, (str(one_found.message), dict(one_found.fields or {}))
            )
        columns: Any = make_column_scanner([variant], raw=raw)
        tables = [*columns.feed(data), *columns.close()]
        by_offset = {o: one for o, _, one in said}
        _tables(tables, by_offset, {o: data[o : o + size] for o, size, _ in said}, lambda table: table.key)
    for (o, size, told), (_, _, key, payload) in zip(expected, wanted, strict=True):
        if told is None:
            continue
        name, raws = told
        seen = plain.Seen()
        _expected(messages, key, payload, raw=False, seen=seen)
        if not seen.negative_zero and not seen.nan:
            built: Any = variant.encoder.build(variant[name], raws, raw=True)
            again = bytes(built)
            if again != data[o : o + size]:
                raise Difference(f"built: {again.hex(' ')}, wanted {data[o : o + size].hex(' ')}")
    return sum(one is not None for *_, one in expected)


def _packet(framing: dict[str, Any], messages: list[Told], random: Random) -> bytes:
    """A packet, or something like it, or noise."""
    if random.random() < 0.2:
        return random.choice(
            (random.randbytes(random.randint(1, 6)), framing["sync"], framing["end"], framing["sync"][:1])
        )
    _, payload, keys = random.choice(messages)
    sync, check, length = framing["sync"], framing["check"], framing["length"]
    body = _bytes(payload, random)[:60]
    if random.random() < 0.1:
        body += b"\x00"
    mark = bytes([min(keys) if random.random() < 0.95 else 9]) if keys is not None else b""
    head = mark
    if length is not None:
        size = len(sync) + framing["head"] + len(body) + (check["size"] if check else 0)
        number = max(0, (size - length[4]) // length[3])
        head += (number % (1 << 8 * length[1])).to_bytes(length[1], length[2])
    inside = head + body
    if check:
        number = plain.check_number(check, inside)
        number ^= random.random() < 0.1
        inside += number.to_bytes(check["size"], check["order"])
    if framing["slip"]:
        inside = plain.stuffed(inside)
    return bytes(sync + inside + framing["end"])


def _same(who: str, data: bytes, wanted: tuple[str, dict[str, Any]] | None, record: Any) -> None:
    if isinstance(record, Unknown):
        _agree(who, data, wanted, None, record.reason)
        return
    fields = {
        name: getattr(record, name) for name in type(record).__struct_fields__ if not name.startswith("_")
    }
    wanted_fields = None if wanted is None else wanted
    if wanted_fields is not None and "mark" in fields and "mark" not in wanted_fields[1]:
        fields.pop("mark")
    _agree(who, data, wanted, (type(record).__name__, fields))


def _agree(
    who: str,
    data: bytes,
    wanted: tuple[str, dict[str, Any]] | None,
    found: tuple[str, dict[str, Any]] | None,
    why: str = "",
) -> None:
    if (wanted is None) != (found is None) or (
        wanted is not None
        and found is not None
        and (wanted[0] != found[0] or not _equal(wanted[1], found[1]))
    ):
        raise Difference(f"{who}: {data.hex(' ')}: {found} {why}\nwanted {wanted}")


def _equal(one: Any, other: Any, *, loose: bool = False) -> bool:
    """Whether values are the same: NaN is NaN, lists and tuples are lists, nested records are dicts."""
    if isinstance(one, dict):
        if not isinstance(other, dict):
            names = getattr(other, "__struct_fields__", None)
            if names is None:
                return False
            other = {name: getattr(other, name) for name in names}
        other = {name: value for name, value in other.items() if not str(name).startswith("_")}
        return set(one) == set(other) and all(_equal(one[name], other[name], loose=loose) for name in one)
    if isinstance(one, (list, tuple)):
        return (
            isinstance(other, (list, tuple))
            and len(one) == len(other)
            and all(_equal(a, b, loose=loose) for a, b in zip(one, other, strict=True))
        )
    if one is None or other is None or isinstance(one, (str, bytes)) or isinstance(other, (str, bytes)):
        return type(one) is type(other) and bool(one == other)
    if one != one or other != other:
        return bool(one != one and other != other)
    return bool(one == other) or (loose and abs(one - other) <= 1e-3 * max(1.0, abs(one)))


@dataclass
class Outcome:
    """How a run of specs went."""

    counts: Counter[str] = field(default_factory=Counter)
    #: (seed, what happened).
    failures: list[tuple[int, str]] = field(default_factory=list)


def run(seeds: Iterable[int], report: Callable[[int, str], None] | None = None) -> Outcome:
    """Check the specs of these seeds; `report` is given each failure when it is found."""
    outcome = Outcome()
    for seed in seeds:
        try:
            outcome.counts[check(seed)] += 1
        except Exception as error:
            where = (
                ""
                if isinstance(error, Difference)
                else "".join(traceback.format_tb(error.__traceback__)[-2:])
            )
            what = f"{type(error).__name__}: {error}\n{where}"
            outcome.failures.append((seed, what))
            if report is not None:
                report(seed, what)
            outcome.counts["failed"] += 1
    return outcome


def main(arguments: list[str] | None = None) -> int:
    """The command line: 0 when nothing differed."""
    parser = argparse.ArgumentParser(description="hold drawn specs against plain bit arithmetic")
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1, help="the first seed is a million times this")
    parser.add_argument("--first", type=int, default=0, help="leave out so many")
    given = parser.parse_args(arguments)
    start = 1_000_000 * given.seed

    def report(seed: int, what: str) -> None:
        print(f"---- seed {seed}\n{draw(seed).source}\n{what}", flush=True)

    outcome = run(range(start + given.first, start + given.count), report)
    print(", ".join(f"{number} {what}" for what, number in sorted(outcome.counts.items())))
    return 1 if outcome.failures else 0


if __name__ == "__main__":
    sys.exit(main())
