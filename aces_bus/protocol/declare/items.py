"""Lists of tagged items: each has a tag that says what its data are, and most have a size.

1. Every byte of the list is in exactly one item. One that cannot be read costs itself: its bytes stay, with the reason.
2. The list takes all bytes that there are: nothing comes behind it in its payload.
3. An item that was read is built again as the same bytes, whatever was wrong with it.

An item is a container of `kind` (the name, or the tag where it has none; None where the bytes are too few to say), `data`
(what the kind declares; bytes where that is not known or does not fit) and `reason` (None for a good item, else "unknown" or
"malformed: <why>").
"""

from __future__ import annotations

import copy
import io
from collections.abc import Callable, Mapping
from operator import index
from typing import Any, BinaryIO, ClassVar, Literal

import construct as c

from ...errors import FieldError, SpecError
from ..record import FieldValue
from .fields import WireNumber, is_raw, named_number, names_by_value, wire_number
from .place import caller


class ItemList(c.Construct):
    """Items up to the end of the payload, by a construct of your own: subclass it, with `_parse` and `_build`.

    `_parse` gives a list of containers with `kind`, `data` and `reason`, as `Items` does: None for a good item, else why it
    was not read. The data of good items may be containers of values by name. `values` are these names, each with its number,
    its unit ("" for none) and the names of its values, {} for none; None says that it is measured, and always a float. A
    table has a column of each, `FIELD.NAME`: the first one in each packet.

        class Runs(ItemList):
            values = {"position": (1, "turn", None), "mode": (0, "", {0: "stopped", 10: "position"})}
    """

    values: ClassVar[Mapping[str, tuple[int, str, Mapping[int, str] | None]]] = {}

    def _sizeof(self, context: object, path: str) -> int:
        raise c.SizeofError("depends on the items", path=path)


#: What the size of an item counts.
Counted = Literal["data", "tag and data", "item"]
UNKNOWN = "unknown"


class Items(c.Construct):
    """Tagged items up to the end of the payload, of any kinds in any order and number.

    `tag` is the number that says what an item is: `Byte`, `Int16ub`, … `kinds` are the items that are known, by name: the
    number of each, and a construct of its data. `size` is the number that says how long an item is; without one each kind
    ends where its construct ends, and an unknown item takes all that is left. `counts` says what the size counts: the
    data alone, the tag and the data, or the whole item with the size itself; `size_first` that it stands before the tag.

        Items(tag=Byte, size=Byte, kinds={"temperature": (1, Quantity(Int16sb, unit="°C", scale=0.01))})

    Raises `SpecError` for a tag or size that is not a plain unsigned number, and for kinds that share a number.
    """

    def __init__(
        self,
        *,
        tag: c.Construct,
        kinds: Mapping[str, tuple[int, c.Construct]],
        size: c.Construct | None = None,
        counts: Counted = "data",
        size_first: bool = False,
    ) -> None:
        super().__init__()
        self.place = caller()
        self.tag = self._unsigned(tag, "tag")
        self.size = None if size is None else self._unsigned(size, "size")
        if counts not in ("data", "tag and data", "item"):
            raise SpecError(f"{self.place}: counts is 'data', 'tag and data' or 'item', not {counts!r}")
        if size is None and (counts != "data" or size_first):
            raise SpecError(f"{self.place}: counts and size_first are for items with a size")
        for name, kind in kinds.items():
            given: Any = kind
            if not (isinstance(given, tuple) and len(kind) == 2 and isinstance(given[1], c.Construct)):
                raise SpecError(
                    f"{self.place}: kinds are written {{name: (number, construct)}}, not {{{name!r}: {kind!r}}}"
                )
        if not kinds:
            raise SpecError(f"{self.place}: Items needs kinds={{name: (number, construct)}}")
        #: The number of each kind, and the name of each number.
        self.numbers: dict[str, int] = {name: number for name, (number, _) in kinds.items()}
        self.names = names_by_value(self.numbers, self.place)
        for name, number in self.numbers.items():
            if not 0 <= number <= self.tag.limits[1]:
                raise SpecError(
                    f"{self.place}: kind {name!r} has the number {number}, past {self.tag.limits[1]}"
                )
        #: The constructs of the data, by name.
        self.data: dict[str, c.Construct] = {name: data for name, (_, data) in kinds.items()}
        width = 0 if self.size is None else self.size.size
        #: Bytes before the data, and where among them tag and size stand.
        self.head = self.tag.size + width
        self.tag_at = width if size_first else 0
        self.size_at = 0 if size_first else self.tag.size
        #: How much more than the data the size counts, in bytes.
        self.counted = {"data": 0, "tag and data": self.tag.size, "item": self.head}[counts]

    def _unsigned(self, con: c.Construct, what: str) -> WireNumber:
        number = wire_number(con)
        if number is None or number.kind != "uint":
            raise SpecError(
                f"{self.place}: the {what} of items is a plain unsigned number such as Byte or Int16ub, not {con!r}"
            )
        return number

    @property
    def subcons(self) -> list[c.Construct]:
        """Constructs of the data."""
        return list(self.data.values())

    def changed(self, change: Callable[[str, c.Construct], c.Construct]) -> Items:
        """Return the same list with the constructs of its data changed."""
        made = copy.copy(self)
        made.data = {name: change(name, data) for name, data in self.data.items()}
        return made

    def fixed_size(self, name: str | None) -> int | None:
        """Return the bytes of a kind's data, where it has no other number of bytes."""
        try:
            return None if name is None else int(self.data[name].sizeof())
        except Exception:  # it depends on a field, by whatever program
            return None

    # ------------------------------------------------------------------ reading

    def _parse(self, stream: BinaryIO, context: c.Container, path: str) -> c.ListContainer:
        data: bytes = c.stream_read_entire(stream, path)
        items, at = c.ListContainer(), 0
        while at < len(data):
            item, size = self._item(data[at:], context, path)
            items.append(item)
            at += size
        return items

    def _item(self, rest: bytes, context: c.Container, path: str) -> tuple[c.Container, int]:
        """Return the first item of what is left, and how many bytes it takes."""
        if len(rest) < self.head:
            reason = f"malformed: {len(rest)} of the {self.head} bytes before an item's data"
            return c.Container(kind=None, data=rest, reason=reason), len(rest)
        tag = _read(rest, self.tag_at, self.tag)
        name = self.names.get(tag)
        kind = tag if name is None or is_raw(context) else name
        if self.size is not None:
            said = _read(rest, self.size_at, self.size)
            stop = self.head + said - self.counted
            if not self.head <= stop <= len(rest):
                reason = f"malformed: its size says {said}, and {len(rest)} bytes are left"
                return c.Container(kind=None, data=rest, reason=reason), len(rest)
        else:
            fixed = self.fixed_size(name)
            stop = len(rest) if fixed is None else min(self.head + fixed, len(rest))
        inside = rest[self.head : stop]
        if name is None:
            return c.Container(kind=kind, data=inside, reason=UNKNOWN), stop
        content = io.BytesIO(inside)
        value: FieldValue = None
        try:
            value = self.data[name]._parsereport(content, context, f"{path} -> {name}")
            is_whole = not content.read(1)
        except Exception:  # whatever a construct raises, construct's own or a user's
            is_whole = False
        if is_whole:
            return c.Container(kind=kind, data=value, reason=None), stop
        reason = f"malformed: data of size {len(inside)} are not a {name}"
        return c.Container(kind=kind, data=inside, reason=reason), stop

    # ------------------------------------------------------------------ building

    def _build(self, obj: Any, stream: BinaryIO, context: c.Container, path: str) -> Any:
        items = list(obj)
        for number, item in enumerate(items):
            where = f"{path}.{number}"
            stream.write(self._bytes(item, context, where, is_last=number == len(items) - 1))
        return obj

    def _bytes(self, item: Any, context: c.Container, path: str, *, is_last: bool) -> bytes:
        if not isinstance(item, Mapping) or not {"kind", "data"} <= item.keys():
            raise FieldError(f"{path}: an item is {{'kind': …, 'data': …}}, not {item!r}")
        kind, value, reason = item["kind"], item["data"], item.get("reason")
        if kind is None:
            if not is_last:
                raise FieldError(f"{path}: only the last item may be bytes without a kind")
            return _plain(value, path)
        tag = named_number(kind, self.numbers, path) if isinstance(kind, str) else index(kind)
        if not 0 <= tag <= self.tag.limits[1]:
            raise FieldError(f"{path}: kind {tag} is outside 0…{self.tag.limits[1]}")
        name = self.names.get(tag)
        fixed = self.fixed_size(name)
        if name is None or reason is not None:
            inside = _plain(value, path)
        else:
            inside = self._built(name, value, context, path)
        if self.size is None:
            if not is_last and len(inside) != fixed:
                raise FieldError(f"{path}: without a size only the last item may have data of any length")
            return tag.to_bytes(self.tag.size, self.tag.order) + inside
        said = len(inside) + self.counted
        if said > self.size.limits[1]:
            raise FieldError(f"{path}: {len(inside)} bytes of data are more than the size of an item can say")
        head = bytearray(self.head)
        head[self.tag_at : self.tag_at + self.tag.size] = tag.to_bytes(self.tag.size, self.tag.order)
        head[self.size_at : self.size_at + self.size.size] = said.to_bytes(self.size.size, self.size.order)
        return bytes(head) + inside

    def _built(self, name: str, value: Any, context: c.Container, path: str) -> bytes:
        content = io.BytesIO()
        try:
            self.data[name]._build(value, content, context, f"{path} -> {name}")
        except (FieldError, c.ConstructError):
            raise
        except Exception:  # whatever a construct raises for a value of another shape
            raise FieldError(f"{path}: {value!r} is not a value of {name}") from None
        return content.getvalue()

    def _sizeof(self, context: c.Container, path: str) -> int:
        raise c.SizeofError("depends on the items", path=path)


def _read(data: bytes, at: int, number: WireNumber) -> int:
    return int.from_bytes(data[at : at + number.size], number.order)


def _plain(value: FieldValue, path: str) -> bytes:
    if not isinstance(value, (bytes, bytearray, memoryview)):
        raise FieldError(f"{path}: the data of an unknown or malformed item are bytes, not {value!r}")
    return bytes(value)
