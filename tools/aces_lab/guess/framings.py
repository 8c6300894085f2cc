"""How packets of one kind stand in bytes: sync, length, end, stuffing, check; as a guess, and as a protocol declares it.

1. What a guess finds is found by the scanner of a protocol that declares it (`spans_of`): a draft decodes just that.
2. What cannot be declared is not a guess: `SpecError` says so.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple

import construct as construct_library
import numpy as np
from construct import GreedyBytes, Struct, this

from aces_bus.protocol import Check, Crc, Insert, Protocol
from aces_bus.protocol.columns.table import Array
from aces_bus.protocol.declare.checks import Order
from aces_bus.protocol.declare.framing import Framing
from aces_bus.protocol.declare.stuffing import Stuffing
from aces_bus.protocol.record import PlainValue

from .checks import CheckGuess, check_source, checks_of_packets
from .sample import Span

#: Packets of which a check is sought, and the longest stretch of bytes without an end.
PACKETS, LONGEST = 512, 4096

#: What the field of a check in the header is called.
CHECK = "check"

Kind = Literal["length", "fixed", "lines", "enclosed", "silence"]


def _number_format(size: int, order: Order) -> str:
    """Return the construct that reads a number."""
    return "Byte" if size == 1 else f"Int{8 * size}u{order[0]}"


class LengthRule(NamedTuple):
    """Size of a packet in bytes = length + `constant`, with the length `width` bytes at `offset`."""

    offset: int
    width: int
    order: Order
    constant: int

    def sizes(self, data: Array, starts: Array) -> Array:
        """Return the size that each packet says, int64; `data` goes on far enough."""
        places = range(self.width) if self.order == "big" else reversed(range(self.width))
        number = np.zeros(len(starts), np.int64)
        for place in places:
            number = number << 8 | data[starts + self.offset + place]
        return number + self.constant

    @property
    def format(self) -> str:
        """The construct that reads the length."""
        return _number_format(self.width, self.order)


@dataclass(frozen=True)
class FramingGuess:
    """How packets of one kind stand in the bytes; `evidence` says why, a line each.

    `opcode` is where the bytes that say what a packet is are (offset, size), None where none do.
    """

    kind: Kind
    sync: bytes = b""
    length: LengthRule | None = None
    size: int | None = None
    end: bytes = b""
    gap_s: float | None = None
    stuffing: Stuffing | None = None
    not_next: bytes = b""
    check: CheckGuess | None = None
    #: A check in characters at the end of a line.
    written: Check | None = None
    #: Constant bytes behind the check.
    tail: bytes = b""
    opcode: tuple[int, int] | None = None
    max_size: int = 0
    bits: float = 0.0
    #: Packets that the scanner found, their bytes, and the share of the bytes that it looked at.
    packets: int = 0
    bytes: int = 0
    share: float = 0.0
    evidence: tuple[str, ...] = ()

    @property
    def confidence(self) -> float:
        """Between 0 and 1; without a check never above 0.9."""
        sure = 1 - 2.0 ** -max(self.bits / 4, 0.0)
        return float(sure if self.is_checked else 0.9 * sure)

    @property
    def is_checked(self) -> bool:
        """True if the framing's packets have a check."""
        return self.check is not None or self.written is not None

    @property
    def is_check_in_front(self) -> bool:
        """True if the check is in the header, in front of what it covers."""
        return self.check is not None and self.check.offset >= 0

    @property
    def head_end(self) -> int:
        """Bytes up to the end of what is needed to read a packet: sync, length, opcode."""
        ends = [len(self.sync)]
        if self.kind == "lines":
            return ends[0]
        if self.length is not None:
            ends.append(self.length.offset + self.length.width)
        if self.check is not None and self.is_check_in_front:
            ends.append(self.check.offset + self.check.size)
        if self.opcode is not None:
            ends.append(sum(self.opcode))
        return max(ends)

    def head_fields(self) -> Iterator[tuple[str, str]]:
        """Yield the header behind the sync bytes: names, and the constructs by theirs."""
        at = len(self.sync)
        if self.kind == "lines":
            return
        while at < self.head_end:
            if self.length is not None and at == self.length.offset:
                yield "length", self.length.format
                at += self.length.width
            elif self.opcode is not None and at == self.opcode[0]:
                yield "opcode", "Byte" if self.opcode[1] == 1 else "Int16ub"
                at += self.opcode[1]
            elif self.check is not None and at == self.check.offset:
                yield CHECK, _number_format(self.check.size, self.check.check.order)
                at += self.check.size
            else:
                yield f"byte_{at}", "Byte"
                at += 1

    @property
    def stuffing_source(self) -> str:
        """The stuffing as a spec writes it."""
        if isinstance(self.stuffing, Insert):
            return f"Insert({self.stuffing.pattern!r}, {self.stuffing.byte!r})"
        return f"{type(self.stuffing).__name__}()"

    def as_dict(self) -> dict[str, PlainValue]:
        """Return the guess in JSON's kinds."""
        found: dict[str, PlainValue] = {"kind": self.kind, "confidence": round(self.confidence, 2)}
        if self.sync:
            found["sync"] = self.sync.hex(" ").upper()
        if self.length is not None:
            found["length"] = self.length._asdict()
        if self.size is not None:
            found["size"] = self.size
        if self.end:
            found["end"] = self.end.hex(" ").upper()
        if self.gap_s is not None:
            found["gap_s"] = self.gap_s
        if self.stuffing is not None:
            found["stuffing"] = type(self.stuffing).__name__
        if self.check is not None:
            found["check"] = self.check.declared
        if self.written is not None:
            found["check"] = check_source(self.written)
        if self.opcode is not None:
            found["opcode"] = list(self.opcode)
        return {
            **found,
            "packets": self.packets,
            "share": round(self.share, 4),
            "evidence": list(self.evidence),
        }


def framing_check(guess: FramingGuess) -> Check | None:
    """Return the check of a framing as a declaration takes it; None where there is none, or none that can be said.

    Constant bytes behind a CRC become part of a longer one: x⁸ times the polynomial, and the bytes as its final value.
    """
    found = guess.check
    if found is None:
        return guess.written
    check = found.check
    if guess.is_check_in_front:
        made = _with_over(check, [slice(found.covers[0][0], None)])
        made.field = CHECK
        return made
    over = [slice(start, stop) for start, stop in found.covers]
    if guess.stuffing is not None and guess.end:
        over = [slice(run.start, (run.stop or 0) - len(guess.end)) for run in over]
    if not guess.tail:
        return _with_over(check, over)
    if not isinstance(check, Crc) or check.order != "big":
        return None
    width, poly, init, refin, refout, xorout = check.parameters
    if refin or refout:
        return None
    more = 8 * len(guess.tail)
    if width + more > 64:
        return None
    return Crc(
        width=width + more,
        poly=poly << more,
        init=init << more,
        xorout=xorout << more | int.from_bytes(guess.tail, "big"),
        over=[slice(run.start, (run.stop or 0)) for run in over],
        order="big",
    )


def _with_over(check: Check, over: list[slice]) -> Check:
    from copy import copy

    made = copy(check)
    constants = [part for part in check.over or () if isinstance(part, bytes)]
    made.over = (*constants, *over)
    return made


def declare_framing(protocol: Protocol, guess: FramingGuess, name: str) -> Framing:
    """Return the framing in a protocol, as the draft declares it; raises `SpecError` where the language cannot say it."""
    fields = [name / getattr(construct_library, construct) for name, construct in guess.head_fields()]
    more: dict[str, Any] = {"header": Struct(*fields)} if fields else {}
    if guess.length is not None:
        more["size"] = this.length + guess.length.constant
    elif guess.size is not None:
        more["size"] = guess.size
    elif guess.kind == "silence":
        more["end"] = "silence"
    else:
        more["end"] = guess.end
    check = framing_check(guess)
    if check is not None:
        more["check"] = check
    if guess.gap_s is not None:
        more["gap"] = guess.gap_s
    if guess.not_next:
        more["not_next"] = guess.not_next
    return protocol.framing(
        name=name, sync=guess.sync, stuffing=guess.stuffing, max_size=guess.max_size or None, **more
    )


def spans_of(
    guesses: Sequence[FramingGuess], lines: Iterable[Iterable[tuple[bytes, float | None]]]
) -> list[list[Span]]:
    """Return the packets that a draft with these framings decodes in the chunks of each line, offsets from its first
    byte on.
    """
    protocol = Protocol("draft", link="serial")
    names: dict[str, int] = {}
    for number, guess in enumerate(guesses):
        name = f"Packet{number}"
        declare_framing(protocol, guess, f"framing {number}")(name, payload=Struct("data" / GreedyBytes))
        names[name] = number
    scanner = protocol.scanner()
    gap = min((guess.gap_s for guess in guesses if guess.gap_s is not None), default=None)
    found: list[list[Span]] = []
    for line in lines:
        scanner.reset()
        records: list[Any] = []
        last: float | None = None
        for data, time in line:
            if gap is not None and time is not None and last is not None and time - last > gap:
                records += scanner.idle()
            records += scanner.feed(data)
            last = time
        records += scanner.idle() if gap is not None else []
        records += scanner.close()
        placed = ((record.meta, names.get(record.meta.message or "")) for record in records)
        found.append(
            [
                Span(meta.offset, meta.offset + meta.size, number)
                for meta, number in placed
                if number is not None
            ]
        )
    return found


def with_check(guess: FramingGuess, packets: Sequence[bytes], least_share: float = 0.9) -> FramingGuess:
    """Return the guess with the check at the end of its packets, if there is one."""
    for check in sorted(checks_of_packets(packets, least_share=least_share), key=lambda found: -found.bits):
        behind = -check.offset - check.size
        tails = Counter(packet[len(packet) - behind :] for packet in packets)
        tail, count = tails.most_common(1)[0]
        if check.covers[-1][1] is None or (behind and count < 0.9 * len(packets)):
            continue
        words = [check.evidence]
        if tail:
            words.append(f"{tail.hex(' ').upper()} behind the check of {count} packets")
        return replace(
            guess, check=check, tail=tail, bits=guess.bits + check.bits, evidence=(*guess.evidence, *words)
        )
    first = len(guess.sync)
    for check in (
        checks_of_packets(packets, least_share=least_share, in_front=True)
        if first and not guess.stuffing
        else ()
    ):
        if check.offset >= first and check.size in (1, 2, 4):
            return replace(
                guess, check=check, bits=guess.bits + check.bits, evidence=(*guess.evidence, check.evidence)
            )
    return guess
