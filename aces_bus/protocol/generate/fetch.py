"""How a decode function gets its numbers: one `struct` call for each byte order, bit fields by the bytes they share.

1. What is fetched here are numbers of the wire; what a record shows of them, `decode` prints.
"""

from __future__ import annotations

from collections.abc import Sequence

import msgspec

from ..declare.bits import runs_of
from ..plan import nodes as p
from .source import FunctionSetup, NameScope, compact


class FetchedBytes(msgspec.Struct, frozen=True):
    """Bytes [start, end) fetched under a local name: as one unsigned integer, or (not `is_unsigned`) as the value itself."""

    name: str
    start: int
    end: int
    order: str
    is_unsigned: bool = True


class Fetch(FunctionSetup):
    """The numbers of a message, as expressions of a function's `data`, and the lines that fetch them.

    `names` are the function's; what the module needs goes into `setup`.
    """

    def __init__(self, plan: p.MessagePlan, names: NameScope, setup: list[str]) -> None:
        self.plan, self.names, self.setup = plan, names, setup
        #: The names of numbers that are fetched already.
        self.named: dict[p.Scalar, str] = {}
        #: By offset and size: the name of the little-endian number of each layout that has bits of no field.
        self.layouts: dict[tuple[int, int], str] = {}
        self.ranges: list[FetchedBytes] = []
        #: The lines that fetch, and whether one of them takes data of the right length only.
        self.unpacks: list[str] = []
        self.is_exact = False

    def prepare(self) -> None:
        """Plan the fetching: one `struct` call for each byte order gets every number, bit fields by the bytes they share."""
        leaves = self.plan.leaves
        present = [leaf.node for leaf in leaves if isinstance(leaf.node, p.Scalar) and not leaf.whens]
        whole: list[p.Scalar] = []
        taken: list[tuple[int, int]] = []
        for s in dict.fromkeys(present):
            end = s.offset + (s.size or 0)
            # Of numbers that share bytes, one is fetched so; the others read for themselves.
            if s.size is not None and s.format and not any(a < end and s.offset < b for a, b in taken):
                whole.append(s)
                taken.append((s.offset, end))
        chunks: list[tuple[int, int, str, p.Scalar | None]] = [
            (s.offset, s.offset + (s.size or 0), s.order if s.size != 1 else "", s) for s in whole
        ]
        loose = [s for s in dict.fromkeys(present) if s.bits and s not in whole]
        for start, end, order in clusters(loose):
            size = end - start
            if (size > 4 and size < 8) or size > 8 or any(a < end and start < b for a, b in taken):
                continue
            chunks.append((start, end, order if size > 1 else "", None))
            taken.append((start, end))
        if sum(end - start == 1 for start, end, _, _ in chunks) == len(chunks) and len(chunks) < 4:
            chunks = [c for c in chunks if c[3] is not None and c[3].kind == "int"]
        orders = {order for _, _, order, _ in chunks} - {""}
        for order in sorted(orders, reverse=True) or ([""] if chunks else []):
            mine = [c for c in chunks if c[2] == order or (c[2] == "" and order == max(orders, default=""))]
            self._unpack_call(sorted(mine, key=lambda c: c[0]), order)
        for start, end, order in clusters(
            [s for s in loose if self._range_with(s) is None and not in_one_byte(s)]
        ):
            if sum(start <= s.bits[0] // 8 < end for s in loose) > 1:
                name = self.names.new(f"word{len(self.ranges)}")
                self.ranges.append(FetchedBytes(name, start, end, order or "little"))
                self.unpacks.append(f'{name} = from_bytes({self._slice(start, end)}, "{order or "little"}")')
        for node in (leaf.node for leaf in leaves):
            if not isinstance(node, p.Rest) or (node.offset, node.size) in self.layouts:
                continue
            name = self.layouts[node.offset, node.size] = self.names.new(f"all{node.offset}")
            end = node.offset + node.size
            self.ranges.append(FetchedBytes(name, node.offset, end, "little"))
            self.unpacks.append(f'{name} = from_bytes({self._slice(node.offset, end)}, "little")')

    def _unpack_call(self, chunks: Sequence[tuple[int, int, str, p.Scalar | None]], order: str) -> None:
        text = ">" if order == "big" else "<"
        at = chunks[0][0]
        names: list[str] = []
        after: list[str] = []
        for start, end, _, scalar in chunks:
            if start > at:
                text += f"{start - at}x"
            at = end
            name = self.names.new(f"v{len(self.ranges)}")
            size = end - start
            if scalar is not None:
                text += scalar.format
                names.append(name)
                self.named[scalar] = name
            elif size == 3:
                text += "BH" if order == "big" else "HB"
                one, other = self.names.new(f"{name}a"), self.names.new(f"{name}b")
                names += [one, other]
                after.append(
                    f"{name} = {one} << 16 | {other}" if order == "big" else f"{name} = {one} | {other} << 16"
                )
            else:
                text += p.FORMATS["uint", size]
                names.append(name)
            is_unsigned = scalar is None or scalar.kind == "uint"
            self.ranges.append(FetchedBytes(name, start, end, order or "little", is_unsigned))
        start = chunks[0][0]
        whole = start == 0 and self.plan.lengths == (at,)
        self.is_exact = self.is_exact or whole
        made = f'Struct("{compact(text)}").{"unpack" if whole else "unpack_from"}'
        helper = self._table(f"_unpack_{self.plan.name}" + ("_be" if order == "big" else ""), made)
        call = f"{helper}(data)" if start == 0 else f"{helper}(data, {start})"
        self.unpacks.append(f"{', '.join(names)}{',' if len(names) == 1 else ''} = {call}")
        self.unpacks += after

    def _range_with(self, scalar: p.Scalar) -> FetchedBytes | None:
        first, last = min(scalar.bits) // 8, max(scalar.bits) // 8
        order = run_order(scalar)
        for span in self.ranges:
            if (
                span.is_unsigned
                and span.start <= first
                and last < span.end
                and (span.order == order or span.end - span.start == 1)
            ):
                return span
        return None

    def _slice(self, start: int, end: int) -> str:
        if start == 0 and self.plan.lengths == (end,):
            return "data"
        return f"data[{start or ''}:{end}]"

    def integer(self, scalar: p.Scalar, *, fetched: bool = True) -> str:
        """Return the unsigned number (the signed one, of whole signed numbers), as an expression; from `data`, unless
        `fetched`.
        """
        if fetched and scalar in self.named:
            return self.named[scalar]
        assert scalar.size is not None
        part = self._range_with(scalar) if fetched else None
        order = run_order(scalar)
        if part is None:
            first, last = min(scalar.bits) // 8, max(scalar.bits) // 8
            text = (
                f"data[{first}]"
                if first == last
                else f'from_bytes({self._slice(first, last + 1)}, "{order}")'
            )
            part = FetchedBytes(text, first, last + 1, order)
        if part.order == "little" or part.end - part.start == 1:
            positions = [b - 8 * part.start for b in scalar.bits]
        else:
            positions = [(part.end - 1 - b // 8) * 8 + b % 8 for b in scalar.bits]
        pieces = []
        for at, to, width in runs_of(positions):
            piece = f"{part.name} >> {at}" if at else part.name
            if at + width < 8 * (part.end - part.start):
                piece = f"{piece} & {(1 << width) - 1:#x}"
            if to:
                piece = f"({piece}) << {to}"
            pieces.append(piece)
        if len(pieces) == 1:
            return pieces[0]
        return " | ".join(f"({piece})" if "&" in piece or ">>" in piece else piece for piece in pieces)

    def number(self, scalar: p.Scalar, name: str) -> str:
        """Return the number of a field, with its sign, as an expression."""
        if scalar.kind == "float" and scalar.bits:
            return self._scattered(scalar)
        if scalar in self.named:
            return self.named[scalar]
        return self._lone(scalar, name) if scalar.kind == "float" else self.whole(scalar)

    def whole(self, scalar: p.Scalar) -> str:
        """Return a whole number with its sign, as an expression."""
        number = self.integer(scalar)
        if scalar.kind != "int":
            return number
        top = 1 << len(scalar.bits) - 1
        return f"(({number}) ^ {top:#x}) - {top:#x}"

    def _lone(self, scalar: p.Scalar, name: str) -> str:
        """Return a float that is not always there."""
        mark = "<" if scalar.order == "little" else ">"
        made = f'Struct("{mark}{p.FORMATS["float", scalar.size or 0]}").unpack_from'
        return f"{self._table(f'_unpack_{self.plan.name}_{name}', made)}(data, {scalar.offset})[0]"

    def _scattered(self, scalar: p.Scalar) -> str:
        """Return a float whose bits are not whole bytes."""
        size = len(scalar.bits) // 8
        helper = self._table(f"_float{8 * size}", f'Struct("<{p.FORMATS["float", size]}").unpack')
        return f'{helper}(({self.integer(scalar)}).to_bytes({size}, "little"))[0]'


def clusters(scalars: Sequence[p.Scalar]) -> list[tuple[int, int, str]]:
    """Byte ranges that the scalars cover, merged where they overlap, with the byte order that suits all in it."""
    spans = sorted(
        (min(s.bits) // 8, max(s.bits) // 8 + 1, "" if in_one_byte(s) else run_order(s)) for s in scalars
    )
    found: list[tuple[int, int, str]] = []
    for start, end, order in spans:
        if found and start < found[-1][1]:
            first, last, other = found[-1]
            if order and other and order != other:
                # Two orders over the same bytes: each reads for itself.
                found.append((start, end, order))
                continue
            found[-1] = (first, max(last, end), other or order)
        else:
            found.append((start, end, order))
    return found


def in_one_byte(scalar: p.Scalar) -> bool:
    bits = scalar.bits
    return bool(bits) and bits[0] // 8 == bits[-1] // 8 and bits == tuple(range(bits[0], bits[0] + len(bits)))


def run_order(scalar: p.Scalar) -> str:
    """Return the byte order in which the field falls into fewer pieces."""
    little = len(scalar.runs)
    size = scalar.size or 0
    big = len(runs_of([(scalar.offset + size - 1 - b // 8) * 8 + b % 8 for b in scalar.bits]))
    return "big" if big < little else "little"
