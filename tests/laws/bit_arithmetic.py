"""What a spec means, worked out with plain arithmetic on Python's integers.

1. Nothing here is shared with aces_bus: no import of it, no construct, no NumPy. What it reads is a description made of
   dicts, lists and tuples, drawn beside the spec (see `drawn_specs`).
2. It is meant to be read at a glance; how long it takes does not matter.

A node of a payload is a dict with a `kind`: struct, number, bytes, rest, const, array, layout, mux, switch, items, groups.
"""

from __future__ import annotations

import struct
from typing import Any

Node = dict[str, Any]


class Misfit(Exception):
    """These bytes are not the message."""


class Seen:
    """What was met on the way: a value that need not survive being built again, by its reason."""

    def __init__(self) -> None:
        self.negative_zero = self.nan = False
        #: The number behind each value that shows a name.
        self.numbers: dict[str, float] = {}


class Item(dict[str, Any]):
    """An item of a list; `name` is that of its kind, where it has one."""

    name: str | None = None


class Tagged(list[Item]):
    """Items of several kinds."""


class Groups(list[Any]):
    """Groups of one shape."""


def read_message(payload: Node, data: bytes, *, raw: bool, seen: Seen | None = None) -> dict[str, Any]:
    """The fields of a payload that must take all of `data`; raises `Misfit`."""
    seen = seen if seen is not None else Seen()
    value, at = _read(payload, data, 0, {}, raw, seen, "")
    if at != len(data):
        raise Misfit
    fields: dict[str, Any] = value
    return fields


def _take(data: bytes, at: int, size: int) -> bytes:
    if at + size > len(data):
        raise Misfit
    return data[at : at + size]


def _read(
    node: Node, data: bytes, at: int, raws: dict[str, Any], raw: bool, seen: Seen, path: str
) -> tuple[Any, int]:
    kind = node["kind"]
    if kind == "struct":
        values: dict[str, Any] = {}
        mine: dict[str, Any] = {}
        for name, item in node["items"]:
            value, at = _read(item, data, at, mine, raw, seen, f"{path}.{name}" if path else str(name))
            if name is not None:
                values[name] = value
                mine[name] = mine.pop("", None)
        return values, at
    if kind == "const":
        if _take(data, at, len(node["bytes"])) != node["bytes"]:
            raise Misfit
        return node["bytes"], at + len(node["bytes"])
    if kind == "bytes":
        return _take(data, at, node["size"]), at + node["size"]
    if kind == "rest":
        return data[at:], len(data)
    if kind == "number":
        chunk = _take(data, at, node["size"])
        if node["order"] == "big":
            chunk = chunk[::-1]
        pattern = sum(byte << 8 * place for place, byte in enumerate(chunk))
        number, value = _meant(pattern, 8 * node["size"], node, raw, seen, path)
        raws[""] = number
        return value, at + node["size"]
    if kind == "array":
        items = []
        for index in range(node["count"]):
            value, at = _read(node["item"], data, at, {}, raw, seen, f"{path}.{index}")
            items.append(value)
        return items, at
    if kind == "mux":
        if raws.get(node["selector"]) not in node["when"]:
            return None, at
        return _read(node["body"], data, at, raws, raw, seen, path)
    if kind == "switch":
        case = node["cases"].get(raws[node["on"]], node["default"])
        return (None, at) if case is None else _read(case, data, at, {}, raw, seen, path)
    if kind == "items":
        return _items(node, data[at:], raw, seen), len(data)
    if kind == "groups":
        count, found = node["count"], Groups()
        if isinstance(count, tuple):
            chunk = _take(data, at, count[0])
            at += count[0]
            count = int.from_bytes(chunk, count[1])
        elif count is not None:
            count = raws[count]
        while at < len(data) if count is None else len(found) < count:
            value, at = _read(node["item"], data, at, {}, raw, seen, f"{path}.{len(found)}")
            found.append(value)
        return found, at
    assert kind == "layout"
    chunk = _take(data, at, node["size"])
    return _layout(node, chunk, raw, seen, path), at + node["size"]


def _items(node: Node, data: bytes, raw: bool, seen: Seen) -> Tagged:
    """Tagged items up to the end: whatever cannot be read is bytes, with the reason."""
    found = Tagged()
    (tag_size, tag_order), size = node["tag"], node["size"]
    head = tag_size + (size[0] if size else 0)
    while data:
        if len(data) < head:
            reason = f"malformed: {len(data)} of the {head} bytes before an item's data"
            found.append(Item(kind=None, data=data, reason=reason))
            break
        first, second = data[:tag_size], data[tag_size:head]
        if node["size_first"]:
            first, second = data[head - tag_size : head], data[: head - tag_size]
        tag = int.from_bytes(first, tag_order)
        name, body = next(((n, b) for n, number, b in node["kinds"] if number == tag), (None, None))
        end = len(data)
        if size:
            said = int.from_bytes(second, size[1])
            end = head + said - node["counted"]
            if end < head or end > len(data):
                reason = f"malformed: its size says {said}, and {len(data)} bytes are left"
                found.append(Item(kind=None, data=data, reason=reason))
                break
        elif body is not None and (width := width_of(body)) is not None:
            end = min(end, head + width)
        inside, data = data[head:end], data[end:]
        item = Item(kind=tag if raw or name is None else name, data=inside, reason="unknown")
        item.name = name
        if body is not None:
            item["reason"] = f"malformed: data of size {len(inside)} are not a {name}"
            try:
                value, at = _read(body, inside, 0, {}, raw, seen, f"in {tag}")
                if at == len(inside):
                    item |= {"data": value, "reason": None}
            except Misfit:
                pass
        found.append(item)
    return found


def width_of(node: Node) -> int | None:
    """The bytes of a node that always has as many."""
    match node["kind"]:
        case "struct":
            widths = [width_of(item) for _, item in node["items"]]
            return None if None in widths else sum(width or 0 for width in widths)
        case "array":
            width = width_of(node["item"])
            return None if width is None else width * int(node["count"])
        case "const":
            return len(node["bytes"])
        case "number" | "bytes" | "layout":
            return int(node["size"])
        case _:
            return None


def _layout(node: Node, chunk: bytes, raw: bool, seen: Seen, path: str) -> dict[str, Any]:
    def bit(byte: int, place: int) -> int:
        return chunk[byte] >> place & 1

    values: dict[str, Any] = {}
    numbers: dict[str, int | None] = {}
    owned: set[tuple[int, int]] = set()
    always: set[tuple[int, int]] = set()
    for field in node["fields"]:
        name = field["name"]
        found = []
        for part in field["parts"]:
            # (byte, bit) of the field's bits, lowest first.
            places: list[tuple[int, int]] = []
            for first, width in part["pieces"]:
                if field["order"] == "lsb":
                    places += [divmod(n, 8) for n in range(first, first + width)]
                else:
                    places += [(n // 8, 7 - n % 8) for n in reversed(range(first, first + width))]
            if field["mux"] is None:
                always.update(places)
            elif numbers.get(field["mux"][0]) not in field["mux"][1]:
                continue
            owned.update(places)
            pattern = sum(bit(*place) << weight for weight, place in enumerate(places))
            number, value = _meant(
                pattern, len(places), part, raw, seen, f"{path}.{name}" if path else str(name)
            )
            numbers[name] = number
            found.append(value)
        values[name] = None if not found else found if len(field["parts"]) > 1 else found[0]
    if len(always) < 8 * node["size"]:
        everywhere = [(byte, place) for byte in range(node["size"]) for place in range(8)]
        values["reserved"] = sum(
            bit(*place) << weight for weight, place in enumerate(everywhere) if place not in owned
        )
    return values


def _meant(pattern: int, width: int, node: Node, raw: bool, seen: Seen, path: str) -> tuple[Any, Any]:
    """(the number by which others are chosen, what the record shows) of an unsigned bit pattern."""
    number: Any = pattern
    kind = node["type"]
    if kind == "int" and pattern >= 1 << width - 1:
        number = pattern - (1 << width)
    elif kind == "float":
        number = struct.unpack({16: "<e", 32: "<f", 64: "<d"}[width], pattern.to_bytes(width // 8, "little"))[
            0
        ]
        seen.nan |= number != number
    chosen = number
    if kind == "magnitude":
        half = 1 << width - 1
        number = pattern if pattern < half else half - pattern
        seen.negative_zero |= pattern == half
    meaning = node["meaning"]
    if raw or meaning is None:
        return chosen, number
    if meaning[0] == "names":
        by_number = {one: name for name, one in meaning[1].items()}
        if number in by_number:
            seen.numbers[path] = number
            return chosen, by_number[number]
        return chosen, number
    if meaning[0] == "flags":
        return chosen, number
    _, scale, offset, unknown, names = meaning
    if isinstance(unknown, range):
        if number in unknown:
            return chosen, None
        unknown = ()
    for one in unknown:
        if one == number or (one != one and number != number):
            return chosen, None
    physical = number * scale if scale != 1 else number
    physical = physical + offset if offset else physical
    for name, one in names.items():
        if one == number:
            seen.numbers[path] = physical
            return chosen, name
    return chosen, physical


# ---------------------------------------------------------------------- streams


def packets(framing: dict[str, Any], data: bytes) -> list[tuple[int, bytes, bytes]]:
    """(offset, packet, payload) of every packet in a stream that has ended: header first, check and end taken off."""
    found = []
    at = 0
    while at < len(data):
        packet = _packet(framing, data, at)
        if packet is None:
            at += 1
            continue
        found.append((at, *packet))
        at += len(packet[0])
    return found


def _packet(framing: dict[str, Any], data: bytes, at: int) -> tuple[bytes, bytes] | None:
    sync, end, check = framing["sync"], framing["end"], framing["check"]
    if data[at : at + len(sync)] != sync:
        return None
    head = at + len(sync)
    least = len(sync) + framing["head"] + (check["size"] if check else 0) + len(end)
    if end:
        stop = data.find(end, head)
        if stop <= head:  # none, or one end mark behind the other: no packet is in between
            return None
        size = stop + len(end) - at
    elif framing["length"] is None:
        size = framing["size"]
    else:
        first, width, order, factor, constant = framing["length"]
        field = data[at + first : at + first + width]
        if len(field) < width:
            return None
        size = factor * int.from_bytes(field, order) + constant
    if not least <= size <= framing["most"] or at + size > len(data):
        return None
    packet = data[at : at + size]
    inside = packet[len(sync) : len(packet) - len(end)]
    if framing["slip"]:
        plain = _unslip(inside)
        if plain is None or len(plain) < framing["head"] + (check["size"] if check else 0):
            return None
        inside = plain
    if check:
        body, stored = inside[: len(inside) - check["size"]], inside[len(inside) - check["size"] :]
        if int.from_bytes(stored, check["order"]) != check_number(check, body):
            return None
        inside = body
    return packet, inside


def _unslip(data: bytes) -> bytes | None:
    out = bytearray()
    rest = iter(data)
    for byte in rest:
        if byte == 0xDB:
            meant = {0xDC: 0xC0, 0xDD: 0xDB}.get(next(rest, -1))
            if meant is None:
                return None
            byte = meant
        out.append(byte)
    return bytes(out)


def check_number(check: dict[str, Any], covered: bytes) -> int:
    """A check over these bytes: sum, inverted or negated sum, xor, or the CRC of a polynomial, bit by bit."""
    kind = check["kind"]
    if kind == "xor":
        number = 0
        for byte in covered:
            number ^= byte
        return number
    if kind.endswith("sum"):
        size: int = 1 << 8 * check["size"]
        total = sum(covered) % size
        return (
            total if kind == "sum" else size - 1 - total if kind == "inverted sum" else (size - total) % size
        )
    number, top = int(check["start"]), 1 << 8 * check["size"] - 1
    for byte in covered:
        number ^= byte << 8 * check["size"] - 8
        for _ in range(8):
            number = (number << 1 ^ int(check["polynomial"]) if number & top else number << 1) & (2 * top - 1)
    return number


def stuffed(data: bytes) -> bytes:
    """As SLIP writes it."""
    return data.replace(b"\xdb", b"\xdb\xdd").replace(b"\xc0", b"\xdb\xdc")


__all__ = ["Misfit", "Node", "Seen", "check_number", "packets", "read_message", "stuffed"]
