"""The row decoder of whole recordings against the generated decoder, which is proved: field by field, on all values.

1. All numbers of a field's own bits up to 16 bits, beyond them each bit, corners and drawn numbers; all other bits at 0, at
   1, and drawn. Constants and heads stay those of the message.
2. Values are compared as records show them, to the last bit of a float64.
"""

from __future__ import annotations

import math
import random
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from aces_bus.protocol import Message, Variant
from aces_bus.protocol.columns.rows import PacketRows, RowDecoder
from aces_bus.protocol.generate.load import decoders_of
from aces_bus.protocol.plan.nodes import NodePath

from .account import Outcome
from .decoding import Witness, drawn, proof_lengths
from .witness import Value, by_reference, image_of, value_in_record

Bytes = NDArray[np.uint8]

#: Bits of a field of which every number is tried.
MOST_BITS = 16


@dataclass(frozen=True)
class ColumnsJob:
    """The columns of one message, and of others with the same functions."""

    variant: Variant
    message: Message
    count: int
    patience: float = 10.0

    def prove(self, seconds: float) -> list[Outcome]:
        """Compare them with the decoder; nothing where that makes them, record by record."""
        outcome = check_columns(self.variant, self.message)
        if outcome is None:
            return []
        outcome.count = self.count
        return [outcome]

    def lost(self, reason: str) -> list[Outcome]:
        """Return that nothing was compared."""
        outcome = Outcome(self.variant.label, self.message.name, count=self.count)
        outcome.add("columns", "unknown", reason)
        return [outcome]


def check_columns(variant: Variant, message: Message) -> Outcome | None:
    """Compare the columns of one message with its decoder; None where they are made by the decoder, record by record."""
    outcome = Outcome(variant.label, message.name)
    plan = message.plan
    chance = random.Random(message.name)
    base = accepted_packet(message)
    for raw in (True, False):
        decoder = RowDecoder(plan, raw=raw, message=message)
        if decoder.reason:
            return None
        if base is None or plan.is_checked or plan.lists:
            why = (
                "no packet was drawn"
                if base is None
                else "a check of its own"
                if plan.is_checked
                else "a list"
            )
            outcome.add("columns", "unknown", why)
            return outcome
        for leaf in plan.columns:
            bits = leaf.node.place
            if not bits or max(bits) >= 8 * len(base.data):
                continue
            rows = field_rows(base, bits, chance, all_others=raw)
            wrong = _differing(variant, message, decoder, rows, base, leaf, raw)
            if wrong is not None:
                outcome.witness = wrong
                outcome.add("columns", "refuted", f"{leaf.path}: another value than the decoder's")
                return outcome
            if len(bits) > MOST_BITS:
                outcome.add(
                    "columns", "sampled", f"fields of more than {MOST_BITS} bits: corners and drawn numbers"
                )
    outcome.add("columns", "bounded", "each field's own bits, all others at 0, at 1 and drawn")
    return outcome


def accepted_packet(message: Message) -> Witness | None:
    """Return a packet of the message, the longest of some that were drawn."""
    found = [
        w
        for w in drawn(message, proof_lengths(message)[0], 300)
        if by_reference(message, image_of(message, w))
    ]
    return max(found, key=lambda w: len(w.data), default=None)


def field_rows(base: Witness, bits: tuple[int, ...], chance: random.Random, *, all_others: bool) -> Bytes:
    """Return packets in which a field has many numbers; uint8 (n, size)."""
    width = len(bits)
    if width <= MOST_BITS:
        numbers = list(range(1 << width))
    else:
        numbers = [1 << at for at in range(width)] + [(1 << width) - 1 - (1 << at) for at in range(width)]
        numbers += [0, (1 << width) - 1] + [chance.getrandbits(width) for _ in range(2000)]
    size = len(base.data)
    blocks = []
    for others in (bytes(size), b"\xff" * size, chance.randbytes(size))[0 if all_others else 2 :]:
        block = np.tile(np.frombuffer(others, np.uint8), (len(numbers), 1))
        for weight, at in enumerate(bits):
            column = np.array([number >> weight & 1 for number in numbers], np.uint8)
            block[:, at // 8] = (block[:, at // 8] & ~np.uint8(1 << at % 8)) | column << np.uint8(at % 8)
        blocks.append(block)
    return np.concatenate(blocks)


def with_constants(message: Message, data: Bytes, base: Witness) -> Bytes:
    """Return the packets with sync, heads and constants as the message has them."""
    for at in range(len(message.framing.sync) if message.framing is not None else 0):
        data[:, at] = base.data[at]
    for head in message.heads_written:
        if head.pattern is not None:
            stop = head.offset + head.size
            data[:, head.offset : stop] = np.frombuffer(base.data[head.offset : stop], np.uint8)
    for offset, wanted in message.constants:
        data[:, offset : offset + len(wanted)] = np.frombuffer(wanted, np.uint8)
    return data


def _differing(
    variant: Variant,
    message: Message,
    decoder: RowDecoder,
    data: Bytes,
    base: Witness,
    leaf: NodePath,
    raw: bool,
) -> Witness | None:
    """Return the first packet on which column and decoder differ; packets that are not the message must be refused by
    both.
    """
    data = with_constants(message, data, base)
    key = base.key or 0
    lengths = np.full(len(data), data.shape[1], np.int64)
    rows = PacketRows(np.ascontiguousarray(data), lengths, np.full(len(data), key, np.uint32))
    rows = rows.reaching(decoder.extent)
    taken = decoder.accepts(rows)
    kind = next(candidate for candidate in decoder.kinds if candidate.name == leaf.path)
    values = decoder.column(kind, rows).to_list()
    decode = decoders_of(variant, raw)[message.name]
    for index in range(len(data)):
        packet = data[index].tobytes()
        record = decode(packet, key, None, None, packet, None)
        accepted = taken is None or bool(taken[index])
        if accepted is not (record is not None):
            return Witness("accepted by one alone", base.key, packet)
        if record is not None and not _equal(value_in_record(record, leaf.path), values[index]):
            return Witness(f"{leaf.path}: {values[index]!r} in the column", base.key, packet)
    return None


def _equal(one: Value, other: Value) -> bool:
    if isinstance(one, float) and isinstance(other, float) and math.isnan(one):
        return math.isnan(other)
    return bool(one == other)
