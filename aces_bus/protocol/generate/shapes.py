"""Prints what finds the shape of a packet whose fields are there by bits, and how long it is.

1. A level of deciding bits is one printed function with a table: what each value leads to is made when it first comes.
2. Memory is bounded: when `MOST` values have come, the tables begin anew.
3. Printing a shape's decoder and compiling it costs as much as a dozen packets by construct, so construct decodes rare
   shapes.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ..declare.framing import BitSize, FieldSize
from ..declare.shapes import MOST, DecidingBits, PayloadShape, ShapeLevel, Shapes
from .source import load_source

#: How often a value comes before something is printed for what it leads to.
RARE = 12


def by_shape(
    shapes: Shapes, arguments: str, label: str, make: Callable[[PayloadShape, int], Any], rare: Any
) -> Any:
    """Return a function of a packet `data` and the other `arguments` that calls what `make` gives for the packet's shape
    and its number, or `rare` as long as the shape is rare; it gives None for a packet that is too short.
    """
    passed = arguments.replace("=None", "")

    def printed(level: ShapeLevel) -> str:
        return (
            f"def choose({arguments}):\n{_found(level, 'data', '', 'len(data)')}    return found({passed})\n"
        )

    return _Tables(shapes, label, printed, make, rare).root


def measure_of(measure: BitSize | FieldSize, label: str) -> Callable[[bytes, int, int], int | None]:
    """Return a function of a buffer, where in it a packet begins, and where the buffer ends: how long the packet is, None
    while the bytes that say it are not there.
    """
    if isinstance(measure, BitSize):
        terms = [f"table_{n}[buffer[i + {offset}]]" for n, (offset, _) in enumerate(measure.tables)]
        source = (
            "def measure(buffer, i, end):\n"
            f"    return {' + '.join([str(measure.constant), *terms])} if end - i >= {measure.reach} else None\n"
        )
        tables = {f"table_{n}": table for n, (_, table) in enumerate(measure.tables)}
        found: Callable[[bytes, int, int], int | None] = load_source(source, label, tables)["measure"]
        return found
    shapes = measure.shapes
    assert shapes is not None
    around = shapes.message.payload_start + measure.behind

    def printed(level: ShapeLevel) -> str:
        return (
            "def choose(buffer, i, end):\n"
            f"{_found(level, 'buffer', 'i + ', 'end - i')}"
            "    return found if found.__class__ is int else found(buffer, i, end)\n"
        )

    def size(shape: PayloadShape, number: int) -> int:
        assert shape.size is not None
        return shape.size + around

    root = _Tables(shapes, label, printed, size).root
    if callable(root):
        return root  # type: ignore[no-any-return]
    return lambda buffer, i, end: root


class _Tables:
    """The printed functions of the levels of one message, each with its table."""

    def __init__(
        self,
        shapes: Shapes,
        label: str,
        printed: Callable[[ShapeLevel], str],
        make: Callable[[PayloadShape, int], Any],
        rare: Any = None,
    ) -> None:
        self._shapes, self._label, self._printed, self._make = shapes, label, printed, make
        self._rare = rare
        self._count = 0
        self._first: dict[Any, Any] = {}
        self.root = self._of(shapes.root, self._first)

    def _of(self, found: ShapeLevel | PayloadShape, table: dict[Any, Any]) -> Any:
        """Return the function of a level, which looks into `table`, or what is made of a shape."""
        if isinstance(found, PayloadShape):
            return self._make(found, self._count)
        level = found
        seen: dict[tuple[int, ...], int] = {}

        def grow(data: bytes) -> Any:
            key = level.key(data)
            if self._rare is not None and (count := seen.get(key, 0)) < RARE:
                if len(seen) >= MOST:
                    seen.clear()
                seen[key] = count + 1
                return self._rare
            made = self._of(self._shapes.after(level, key), {})
            if self._count >= MOST:
                self._count = 0
                self._first.clear()
            self._count += 1
            number, *more = key
            table[key if more else number] = made
            return made

        names = {"table": table, "grow": grow}
        return load_source(self._printed(level), f"{self._label}, level {self._count}", names)["choose"]


def _found(level: ShapeLevel, data: str, start: str, left: str) -> str:
    """Return the lines that set `found` to what the deciding numbers of a packet lead to, and return None where these are
    not there: of whether there are `left` bytes enough is asked where nothing looks at the last of them. (A shape's decoder
    asks for its own length.)
    """
    parts = [_number(bits, data, start) for bits in level.bits]
    key = parts[0] if len(parts) == 1 else f"({', '.join(parts)})"
    is_short = (
        ""
        if not left or f"[{start}{level.reach - 1}]" in key
        else f"    if {left} < {level.reach}:\n        return None\n"
    )
    whole = f"{data}[{start.removesuffix(' + ')} : {start}{level.reach}]" if start else data
    return (
        f"{is_short}"
        "    try:\n"
        f"        found = table[{key}]\n"
        "    except KeyError:\n"
        f"        found = grow({whole})\n"
        "    except IndexError:\n"
        "        return None\n"
    )


def _number(bits: DecidingBits, data: str, start: str) -> str:
    parts = []
    for index in range(bits.size):
        shift = 8 * (index if bits.order == "little" else bits.size - 1 - index)
        if mask := bits.mask >> shift & 0xFF:
            byte = f"{data}[{start}{bits.offset + index}]" + (f" & {mask:#x}" if mask != 0xFF else "")
            parts.append(
                (f"({byte}) << {shift}" if mask != 0xFF else f"{byte} << {shift}") if shift else byte
            )
    return " | ".join(parts)
