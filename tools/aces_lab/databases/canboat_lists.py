"""Lists of NMEA 2000 whose items say their own kind: values by key, and parameters of other groups (PGN 126208).

1. An item costs itself: one that cannot be read is bytes, with the reason; all items are built again as the same bytes.
2. Where the bytes do not say how long an item is, all that is left is one item.

Sources: canboat `docs/canboat.json`, schema 2 (LookupFieldTypeEnumerations; DYNAMIC_FIELD_KEY, DYNAMIC_FIELD_LENGTH,
DYNAMIC_FIELD_VALUE, FIELD_INDEX, VARIABLE), and canboat's `analyzer/tests`: keyvalue-wide-field, pgn-dynamic-units-si,
pgn-126208-request-130817, pgn-130823-directory.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, BinaryIO

import construct as c

from aces_bus.errors import FieldError
from aces_bus.protocol import ItemList
from aces_bus.protocol.record import FieldValue, PlainValue

#: The reason of an item whose key or parameter is not known.
UNKNOWN = "unknown"


class KeyedItems(ItemList):
    """Items of a key, a length in bytes and a value: key and length are the bits of one little-endian number, the key
    lowest.

    `kinds` are the values that are known, by name: key, size in bytes, construct.
    """

    def __init__(
        self, key_bits: int, length_bits: int, kinds: Mapping[str, tuple[int, int, c.Construct]]
    ) -> None:
        super().__init__()
        self.key_bits, self.head = key_bits, (key_bits + length_bits) // 8
        self.kinds = kinds
        self.names = {key: name for name, (key, _, _) in kinds.items()}

    def _parse(self, stream: BinaryIO, context: c.Container, path: str) -> c.ListContainer:
        data: bytes = c.stream_read_entire(stream, path)
        items, at = c.ListContainer(), 0
        while at < len(data):
            word = int.from_bytes(data[at : at + self.head], "little")
            key, size = word & (1 << self.key_bits) - 1, word >> self.key_bits
            start = at + self.head
            if start + size > len(data):
                reason = f"malformed: {len(data) - at} bytes are left of an item"
                items.append(c.Container(kind=None, data=data[at:], reason=reason))
                break
            items.append(self._item(key, data[start : start + size], context, path))
            at = start + size
        return items

    def _item(self, key: int, inside: bytes, context: c.Container, path: str) -> c.Container:
        name = self.names.get(key)
        if name is None:
            return c.Container(kind=key, data=inside, reason=UNKNOWN)
        _, wanted, construct = self.kinds[name]
        if len(inside) != wanted:
            reason = f"malformed: {len(inside)} bytes, and {name} has {wanted}"
            return c.Container(kind=name, data=inside, reason=reason)
        value = construct._parsereport(io.BytesIO(inside), context, f"{path} -> {name}")
        return c.Container(kind=name, data=value, reason=None)

    def _build(self, obj: Any, stream: BinaryIO, context: c.Container, path: str) -> Any:
        for item in obj:
            kind, value = item["kind"], item["data"]
            if kind is None:
                stream.write(bytes(value))
                continue
            if isinstance(kind, str) and kind not in self.kinds:
                raise FieldError(f"{path}: no key named {kind!r}")
            key = self.kinds[kind][0] if isinstance(kind, str) else int(kind)
            inside = value
            if item.get("reason") is None and key in self.names:
                inside = _built(self.kinds[self.names[key]][2], value, context, path)
            word = key | len(inside) << self.key_bits
            if not 0 <= key < 1 << self.key_bits or word >= 1 << 8 * self.head:
                raise FieldError(f"{path}: key {key} with {len(inside)} bytes does not fit {self.head} bytes")
            stream.write(word.to_bytes(self.head, "little") + bytes(inside))
        return obj


#: A field of a group: name, size in bytes, construct (None: a size that only its own bytes say), and its only raw value.
Parameter = tuple[str, int, c.Construct | None, int | None]


class GroupParameters(ItemList):
    """Parameters of the group that the field `pgn` names: the number of a field in its order, and its value in whole bytes.

    `kind` is the number, `data` the value by its name. `groups` gives the forms of a group; those that the values exclude
    are not asked further. Where the remaining forms have other fields there, all that is left is one unknown item.
    """

    def __init__(self, groups: Callable[[int], Sequence[Sequence[Parameter]]]) -> None:
        super().__init__()
        self.groups = groups

    def _forms(self, context: Any) -> list[Sequence[Parameter]]:
        return list(self.groups(context.get("pgn")))

    @staticmethod
    def _known(forms: Sequence[Sequence[Parameter]], number: int) -> Parameter | None:
        """Return the field of this number, where all forms that have it agree about its size."""
        found = [form[number - 1] for form in forms if 0 < number <= len(form)]
        if not found or found[0][2] is None or any(one[1] != found[0][1] for one in found):
            return None
        return found[0]

    @staticmethod
    def _left(forms: list[Sequence[Parameter]], number: int, raw: bytes) -> list[Sequence[Parameter]]:
        value = int.from_bytes(raw, "little")
        return [f for f in forms if number <= len(f) and f[number - 1][3] in (None, value)]

    def _parse(self, stream: BinaryIO, context: c.Container, path: str) -> c.ListContainer:
        data: bytes = c.stream_read_entire(stream, path)
        forms, items, at = self._forms(context), c.ListContainer(), 0
        while at < len(data):
            number = data[at]
            known = self._known(forms, number)
            if known is None or at + 1 + known[1] > len(data):
                reason = (
                    UNKNOWN if known is None else f"malformed: {len(data) - at - 1} bytes, not {known[1]}"
                )
                items.append(c.Container(kind=number, data=data[at + 1 :], reason=reason))
                break
            name, size, construct, _ = known
            raw = data[at + 1 : at + 1 + size]
            assert construct is not None
            value = construct._parsereport(io.BytesIO(raw), context, f"{path} -> {name}")
            items.append(c.Container(kind=number, data=c.Container({name: value}), reason=None))
            forms, at = self._left(forms, number, raw), at + 1 + size
        return items

    def _build(self, obj: Any, stream: BinaryIO, context: c.Container, path: str) -> Any:
        forms = self._forms(context)
        for item in obj:
            number, value = int(item["kind"]), item["data"]
            known = self._known(forms, number)
            if item.get("reason") is None and known is not None and isinstance(value, Mapping):
                assert known[2] is not None
                value = _built(known[2], next(iter(value.values()), None), context, path)
                forms = self._left(forms, number, value)
            if not isinstance(value, (bytes, bytearray)) or not 0 <= number <= 255:
                raise FieldError(
                    f"{path}: {number} is no parameter of this group that is known; give its bytes"
                )
            stream.write(bytes([number]) + bytes(value))
        return obj


def _built(construct: c.Construct, value: FieldValue, context: c.Container, path: str) -> bytes:
    content = io.BytesIO()
    try:
        construct._build(value, content, context, path)
    except (FieldError, c.ConstructError):
        raise
    except Exception:  # whatever a construct raises for a value of another shape
        raise FieldError(f"{path}: {value!r} is not a value of this field") from None
    return content.getvalue()


def camel(text: str) -> str:
    """Return words as one name, as the table has its ids: `Rudder Angle` is `rudderAngle`."""
    words = "".join(ch if ch.isascii() and ch.isalnum() else " " for ch in text).split()
    made = "".join(word[:1].upper() + word[1:] for word in words)
    made = made[:1].lower() + made[1:]
    return made if made[:1].isalpha() else f"key{made}"


def field_types(table: Mapping[str, Any]) -> Iterator[tuple[str, list[dict[str, PlainValue]]]]:
    """Yield the tables of what each key of a list has as its value: name, and entries that are like fields."""
    for listed in table.get("LookupFieldTypeEnumerations") or ():
        entries = listed.get("EnumFieldTypeValues") if isinstance(listed, dict) else None
        if isinstance(entries, list):
            yield str(listed.get("Name")), [entry for entry in entries if isinstance(entry, dict)]
