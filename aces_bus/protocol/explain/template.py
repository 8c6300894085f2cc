"""One message as a template that is compared word by word: what it expects where, and the first word that rules it out.

1. `death` of a prefix says what no continuation can mend; it never contradicts the construct, which judges the whole.
2. Positions come from the plan. Where stuffing moves bytes, only the framing is judged before the end.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator, Mapping
from typing import Any

from construct import ConstructError

from ...errors import AcesError
from ..declare.bits import FLOATS
from ..declare.fields import FlagSet
from ..declare.framing import Framing, Judgement, Verdict
from ..declare.message import Message
from ..declare.packet import ContentError, LengthError, NotThisError, WrongCheckError
from ..declare.pattern import describe_values
from ..draw import Mark, marks_of
from ..plan import nodes as p
from ..plan.flatten import flatten

#: The value of a constant behind its name.
_VALUE = re.compile(r" 0x[0-9a-f]{2}$")


class Template:
    """A message of a variant, for comparison; `name` tells it from those of other protocols."""

    def __init__(self, message: Message, name: str) -> None:
        self.message, self.name = message, name
        self.plan = flatten(message)
        self.framing: Framing | None = message.framing
        self.is_moved = self.framing is not None and self.framing.stuffing is not None
        self.marks: list[Mark] = marks_of(message)
        self._ends = self._field_ends()
        #: What bytes are that only construct takes apart.
        self._opaque = "" if not self.plan.opaque else self._payload_name()
        self._owners: dict[int, str] = {}
        for label, places in self._labels():
            for place in places:
                self._owners.setdefault(place, label)

    # ------------------------------------------------------------------ what rules it out

    def death(self, data: bytes, judged: Judgement | None, size: int | None) -> tuple[str, str] | None:
        """Why no packet that begins with `data` is this message: (class, detail).

        `judged` is the framing's verdict (streams), `size` the packet's size where it is known.
        """
        if judged is not None and judged.verdict is Verdict.DEAD:
            return self._dead(data)
        for head in self.message.heads_written:
            end = head.offset + head.size
            if self.is_moved and not (self._is_inserted and self.framing and end <= self.framing.head_end):
                break  # stuffing has moved it
            if (
                head.pattern is not None
                and end <= len(data)
                and head.pattern.match(head.number(data)) is None
            ):
                if self._is_length(head.name):
                    continue
                number = head.number(data)
                if head.is_text and head.is_constant:
                    wanted = f"{head.wanted}, not {data[head.offset : end].hex(' ').upper()}"
                elif head.is_constant or not head.is_own:
                    wanted = f"{head.wanted}, not 0x{number:0{2 * head.size}X}"
                else:
                    wanted = f"{describe_values(head.pattern.captures[0].values)}, not {number}"
                return head.name or f"byte {head.offset}", wanted
        if not self.is_moved:
            for constant in self.plan.constants:
                at = constant.offset
                if at < len(data) and data[at] & constant.mask != constant.value:
                    return f"byte {at}", f"{constant.value:02X}, not {data[at]:02X}"
            if size is not None and self.framing is not None:
                lengths = self.plan.lengths
                if (lengths is not None and size not in lengths) or size < self.plan.least:
                    has = (
                        ", ".join(map(str, lengths)) if lengths is not None else f"{self.plan.least} or more"
                    )
                    return "length", f"{has} bytes, not {size}"
        if judged is not None and judged.verdict is Verdict.BAD:
            return self._bad(data, judged.reason)
        return None

    def last_word(self, image: bytes, request: Mapping[str, Any] | None) -> tuple[str, str] | None:
        """Why a whole packet or frame is not this message after all."""
        try:
            self.message.struct.parse(image, raw=True, request=request)
        except NotThisError as error:
            return "template", _said(error)
        except LengthError as error:
            return "length", _said(error)
        except WrongCheckError:
            return "check", "its own check does not hold"
        except (ContentError, ConstructError, AcesError) as error:
            return "content", _said(error)
        return None

    def _is_length(self, name: str | None) -> bool:
        framing = self.framing
        return framing is not None and framing.affine is not None and name == framing.affine.length.name

    def _dead(self, data: bytes) -> tuple[str, str]:
        assert self.framing is not None
        sync = self.framing.sync
        for at, byte in enumerate(sync[: len(data)]):
            if data[at] != byte:
                return "sync", f"{byte:02X}, not {data[at]:02X}"
        if len(data) > len(sync) and data[len(sync)] in self.framing.not_next:
            return "sync", f"{data[len(sync)]:02X} cannot follow it"
        return "end", "nothing is between sync and end"

    def _bad(self, data: bytes, reason: str) -> tuple[str, str]:
        framing = self.framing
        assert framing is not None
        if reason != "checksum" or framing.check is None:
            if reason == "length":
                return "length", f"packets have {framing.min_size}…{framing.max_size} bytes"
            return "framing", reason
        try:
            whole = data if self._is_inserted else framing.logical(data)
            end = len(whole) - len(framing.end) - framing.check_size
            covered = framing.check.covered(whole, len(framing.sync), end, extra=self.message.check_extra)
            wanted = framing.check.encode(covered)
            return (
                "check",
                f"{wanted.hex(' ').upper()}, not {whole[end : end + framing.check_size].hex(' ').upper()}",
            )
        except (ValueError, AcesError):
            return "check", reason

    @property
    def _is_inserted(self) -> bool:
        from ..declare.stuffing import Insert

        return self.framing is not None and isinstance(self.framing.stuffing, Insert)

    # ------------------------------------------------------------------ what stands where

    def label(self, at: int, size: int | None, prefix: bytes = b"") -> str:
        """What byte `at` of a packet is to it; "" where it does not say. `prefix` are the bytes up to it, where known."""
        if size is not None:
            for mark in self.marks:
                if mark.offset < 0 and size + mark.offset <= at < size + mark.offset + mark.size:
                    return mark.label.partition(":")[0]
        if not self._is_in_place(at):
            return ""
        if self.plan.split is not None and at >= self.plan.split.start and at == len(prefix) - 1:
            return self._delimited(prefix)[0]
        return _VALUE.sub("", self._owners.get(at, self._opaque if at >= self.message.payload_start else ""))

    def _is_in_place(self, at: int) -> bool:
        """Whether byte `at` of the wire is byte `at` of the plan, whatever is stuffed."""
        if not self.is_moved or self.framing is None:
            return True
        return at < (self.framing.head_end if self._is_inserted else len(self.framing.sync))

    def cell(self, at: int, size: int | None) -> str:
        """The same, short: constants as their digits."""
        if self._is_in_place(at):
            for constant in self.plan.constants:
                if constant.offset == at and constant.mask == 0xFF:
                    return f"{constant.value:02X}"
        return self.label(at, size)

    def _payload_name(self) -> str:
        heads = {head.name for head in self.message.heads}
        names = [
            field.name
            for field in self.plan.fields
            if isinstance(field.node, p.Opaque) and field.name not in heads
        ]
        return names[0] if len(names) == 1 else "payload"

    def _labels(self) -> Iterator[tuple[str, list[int]]]:
        for mark in self.marks:
            if mark.offset >= 0:
                yield (
                    mark.label.partition(" ")[0] if mark.label.startswith("sync") else mark.label,
                    [*range(mark.offset, mark.offset + mark.size)],
                )
        for head in self.message.heads_written:
            if head.name is not None:
                yield head.name, [*range(head.offset, head.offset + head.size)]
        for name, node in _leaves(self.plan.fields, ""):
            places = _bytes_of(node)
            if places:
                yield name, places
            elif isinstance(node, p.Scalar) and node.size is None:
                yield name, [*range(node.offset, node.offset + 512)]

    def _delimited(self, prefix: bytes) -> tuple[str, list[tuple[str, Any, str]]]:
        """To which field between separators the last byte belongs, and the field that it completes."""
        split, payload = self.plan.split, self.message.payload
        assert split is not None
        texts = prefix[split.start :].split(split.separator)
        index = len(texts) - 1 - split.lead
        names = [field.name for field in payload.fields]
        if texts[-1]:
            return ("" if index < 0 else names[index] if index < len(names) else "more"), []
        if not 0 < index <= len(names):
            return "separator", []
        field, text = payload.fields[index - 1].subcon, texts[-2].decode("latin-1")
        value = field.to_physical(text) if field.accepts(text) else text
        return "separator", [(names[index - 1], value, field.unit)]

    # ------------------------------------------------------------------ what was read

    def _field_ends(self) -> dict[int, list[tuple[str, p.Node, str]]]:
        """By the byte that completes them: the fields with a fixed place."""
        found: dict[int, list[tuple[str, p.Node, str]]] = {}
        if self.is_moved:
            return found
        for field in self.plan.fields:
            if field.when is not None:
                continue
            for name, node in _leaves([field], ""):
                places = _bytes_of(node)
                if places:
                    found.setdefault(max(places), []).append((name, node, getattr(node, "unit", "")))
        return found

    def readings(self, data: bytes) -> list[tuple[str, Any, str]]:
        """(name, value, unit) of the fields that the last byte of `data` completes."""
        if self.plan.split is not None and not self.is_moved and len(data) > self.plan.split.start:
            return self._delimited(data)[1]
        return [
            (name, value_of(node, data), unit)
            for name, node, unit in self._ends.get(len(data) - 1, ())
            if _is_readable(node)
        ]


def _is_readable(node: p.Node) -> bool:
    return isinstance(node, p.Scalar) or (isinstance(node, p.FromIdentifier) and node.number is not None)


def _leaves(fields: Any, prefix: str) -> Iterator[tuple[str, p.Node]]:
    for field in fields:
        yield from _inside(field.node, f"{prefix}{field.name}")


def _inside(node: p.Node, name: str) -> Iterator[tuple[str, p.Node]]:
    if isinstance(node, p.NestedRecord):
        yield from _leaves(node.fields, f"{name}.")
    elif isinstance(node, p.Many):
        for index, item in enumerate(node.items):
            yield from _inside(item, f"{name}.{index}")
    else:
        yield name, node


def _bytes_of(node: p.Node) -> list[int]:
    if isinstance(node, p.Scalar):
        if node.bits:
            return sorted({bit // 8 for bit in node.bits})
        if node.size is not None:
            return [*range(node.offset, node.offset + node.size)]
    if isinstance(node, p.FromIdentifier) and node.number is not None:
        return _bytes_of(node.number)
    return []


# ---------------------------------------------------------------------- values


def value_of(node: p.Node, data: bytes) -> Any:
    """The value of a field of fixed place, as a record shows it."""
    if isinstance(node, p.FromIdentifier):
        assert node.number is not None
        number = _bits(node.number, data)
        return _stepped(captured(node, number), node.steps)
    assert isinstance(node, p.Scalar)
    if node.kind in ("bytes", "text"):
        assert node.size is not None
        raw = data[node.offset : node.offset + node.size]
        return raw if node.kind == "bytes" else raw.decode("latin-1").rstrip("\0")
    if node.kind == "float":
        if node.bits:
            width = len(node.bits)
            value: Any = struct.unpack(FLOATS[width], _bits(node, data).to_bytes(width // 8, "big"))[0]
        else:
            size = node.size or 4
            order = "<" if node.order == "little" else ">"
            raw = data[node.offset : node.offset + size]
            value = struct.unpack(order + {2: "e", 4: "f", 8: "d"}[size], raw)[0]
        return _stepped(value, node.steps)
    number = _bits(node, data)
    width = len(node.bits)
    if node.kind == "int" and number >> width - 1:
        number -= 1 << width
    return _stepped(number, node.steps)


def captured(node: p.FromIdentifier, number: int) -> int:
    """The raw capture in a number."""
    if node.is_alone:
        return number - node.constant >> node.shift
    return number >> node.shift & ((1 << node.width) - 1)


def stepped(node: p.FromIdentifier, raw: int) -> Any:
    """A raw capture as a record shows it."""
    return _stepped(raw, node.steps)


def _bits(node: p.Scalar, data: bytes) -> int:
    number = 0
    for index, bit in enumerate(node.bits):
        number |= (data[bit // 8] >> bit % 8 & 1) << index
    return number


def _stepped(value: Any, steps: tuple[p.Step, ...]) -> Any:
    for step in steps:
        if isinstance(step, p.Magnitude):
            limit = (1 << step.width - 1) - 1
            value = -(value & limit) if value > limit else value & limit
        elif isinstance(step, p.ValueNames):
            value = dict(step.values).get(value, value)
        elif isinstance(step, p.FlagBits):
            value = type("FlagSet", (FlagSet,), {"bits": dict(step.bits), "__slots__": ()})(value)
        else:
            value = _scaled(value, step)
    return value


def _scaled(value: Any, step: p.Scale) -> Any:
    if step.unknown and value in step.unknown:
        return None
    names = dict(step.names)
    if value in names:
        return names[value]
    if step.offset:
        return value * step.scale + step.offset
    return value * step.scale if step.scale != 1 else value


def _said(error: BaseException) -> str:
    lines = [line for line in str(error).splitlines() if line and not line.startswith("Error in path")]
    return " ".join(" ".join(lines).split()) or type(error).__name__


__all__ = ["Template", "captured", "stepped", "value_of"]
