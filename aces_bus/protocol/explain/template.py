"""One message as a template that is compared part by part: what it expects where, and the first part that rules it out.

1. `death` of a prefix says what no continuation can mend; it never contradicts the construct, which judges the whole.
2. Positions come from the plan. Where stuffing moves bytes, only the framing is judged before the end.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from contextlib import suppress
from functools import reduce
from operator import getitem
from typing import Any

from construct import ConstructError

from ...errors import AcesError
from ..declare.delimited import Delimited
from ..declare.framing import Framing, Judgement, Verdict
from ..declare.message import Message
from ..declare.packet import ContentError, LengthError, NotThisError, WrongCheckError, error_text
from ..declare.pattern import describe_values
from ..draw.cells import Mark, marks_of
from ..plan import nodes as p
from ..record import FieldValue

#: The value of a constant behind its name.
_VALUE = re.compile(r" 0x[0-9a-f]{2}$")


class Template:
    """A message of a variant, for comparison; `name` tells it from those of other protocols."""

    def __init__(self, message: Message, name: str) -> None:
        self.message, self.name = message, name
        self.plan = message.plan
        self.framing: Framing | None = message.framing
        self.is_moved = self.framing is not None and self.framing.stuffing is not None
        stuffing = self.framing.stuffing if self.framing is not None else None
        self._is_inserted = stuffing is not None and stuffing.is_inside
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
        """Say why no packet that begins with `data` is this message: (class, detail).

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
                if self._is_computed(head.name):
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

    def last_part(self, image: bytes, request: Mapping[str, FieldValue] | None) -> tuple[str, str] | None:
        """Say why a whole packet or frame is not this message after all."""
        try:
            self.message.struct.parse(image, raw=True, request=request)
        except NotThisError as error:
            return "template", error_text(error)
        except LengthError as error:
            return "length", error_text(error)
        except WrongCheckError:
            return "check", "its own check does not hold"
        except (ContentError, ConstructError, AcesError) as error:
            return "content", error_text(error)
        return None

    def _is_computed(self, name: str | None) -> bool:
        return self.framing is not None and name in self.framing.derived

    def _dead(self, data: bytes) -> tuple[str, str]:
        assert self.framing is not None
        sync = self.framing.sync
        for at, byte in enumerate(sync[: len(data)]):
            if data[at] != byte:
                return "sync", f"{byte:02X}, not {data[at]:02X}"
        if len(data) > len(sync) and data[len(sync)] in self.framing.not_next:
            return "sync", f"{data[len(sync)]:02X} cannot follow it"
        for head, numbers in self.framing.match:
            if len(data) > head.offset and data[head.offset] not in numbers:
                return head.name or "header", f"{data[head.offset]:02X} is none of this framing"
        return "end", "nothing is between sync and end"

    def _bad(self, data: bytes, reason: str) -> tuple[str, str]:
        framing = self.framing
        assert framing is not None
        if reason != "checksum" or framing.check is None:
            if reason == "length":
                return "length", f"packets have {framing.min_size}…{framing.max_size} bytes"
            return "framing", reason
        if framing.covers_request:
            return "check", "it covers the request, and does not hold with the one that is awaited"
        try:
            wanted, given = framing.checks_of(data, self.message.check_extra)
            return "check", f"{wanted.hex(' ').upper()}, not {given.hex(' ').upper()}"
        except (ValueError, AcesError):
            return "check", reason

    # ------------------------------------------------------------------ what is where

    def label(self, at: int, size: int | None, prefix: bytes = b"") -> str:
        """Return what byte `at` of a packet is to it; "" where it does not say. `prefix` are the bytes up to it, where
        known.
        """
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
        """Return whether byte `at` of the wire is byte `at` of the plan, whatever is stuffed."""
        if not self.is_moved or self.framing is None:
            return True
        return at < (self.framing.head_end if self._is_inserted else len(self.framing.sync))

    def cell(self, at: int, size: int | None) -> str:
        """Return the same, short: constants as their digits."""
        if self._is_in_place(at):
            for constant in self.plan.constants:
                if constant.offset == at and constant.mask == 0xFF:
                    return f"{constant.value:02X}"
        return self.label(at, size)

    def _payload_name(self) -> str:
        heads = {head.name for head in self.message.heads}
        names = [name for name in self.plan.opaque_names if name not in heads]
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
        for leaf in self.plan.leaves:
            if places := _bytes_of(leaf.node):
                yield leaf.path, places
            elif (start := leaf.node.open_from) is not None:
                yield leaf.path, [*range(start, start + 512)]

    def _delimited(self, prefix: bytes) -> tuple[str, list[tuple[str, Any, str]]]:
        """Return to which field between separators the last byte belongs, and the field that it completes."""
        split, payload = self.plan.split, self.message.payload
        assert split is not None
        assert isinstance(payload, Delimited)
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

    def _field_ends(self) -> dict[int, list[p.NodePath]]:
        """Return by the byte that completes them the fields with a fixed place."""
        found: dict[int, list[p.NodePath]] = {}
        for leaf in self.plan.leaves if not self.is_moved else ():
            places = _bytes_of(leaf.node)
            if places and not leaf.field.when:
                found.setdefault(max(places), []).append(leaf)
        return found

    def readings(self, data: bytes) -> list[tuple[str, Any, str]]:
        """Return (name, value, unit) of the fields that the last byte of `data` completes."""
        if self.plan.split is not None and not self.is_moved and len(data) > self.plan.split.start:
            return self._delimited(data)[1]
        ended = self._ends.get(len(data) - 1)
        if ended is None:
            return []
        # What has not come yet is as the template demands, else zero.
        filled = bytearray(max(len(data), self.plan.least))
        for choice in self.plan.one_of:
            number, size = choice.number, choice.number.size or 0
            filled[number.offset : number.offset + size] = choice.values[0].to_bytes(size, number.order)
        for constant in self.plan.constants:
            filled[constant.offset] |= constant.value
        filled[: len(data)] = data
        values: Any = self.message.struct.look(bytes(filled), len(filled) - self.plan.tail)
        found: list[tuple[str, Any, str]] = []
        for leaf in ended:
            with suppress(LookupError):
                found.append((leaf.path, reduce(getitem, leaf.way, values), leaf.node.unit))
        return found


def _bytes_of(node: p.Node) -> list[int]:
    return sorted({bit // 8 for bit in node.number_place})
