"""Where packets are in a stream: the printed scan function against the reference rule, and the whole scanner at every split.

1. *By z3.* The printed text decides once, at two places of a buffer with up to `LONGEST` symbolic bytes behind, silent or
   not. What it emits, loses and returns is compared with the rule, written once more here from the declared framings.
2. A decision made of the beginning of a buffer stays when more bytes come: proved of the rule. With 1 it follows that no cut
   of a stream of that length changes what the text decides.
3. What a packet holds is free here: the text and the rule are told the same. Whether the content is decoded as declared is
   the business of `decoding`.
4. *By trial.* The scanner itself, with its buffer, running sums and search in large chunks, against the reference: all
   sequences of a few pieces (sync bytes, a size, 0, another byte, packets whole, damaged and cut off), at every split in
   two.
"""

from __future__ import annotations

import itertools
import re
import time
import types
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import z3

from aces_bus.protocol import Check, Extra, Fletcher, Message, Variant, Xor
from aces_bus.protocol.declare.framing import Framing
from aces_bus.protocol.generate.scan import seek_pattern
from aces_bus.protocol.generate.source import load_source
from aces_bus.protocol.live import stream
from aces_bus.testing import Scene, laws
from aces_bus.testing.laws import Way, directions

from .account import Outcome
from .decoding import FailedClaim, Witness, drawn, proof_lengths
from .meaning import check_number_of, covered_cells, head_value, is_value_of
from .stand_ins import code_with_constants, from_bytes
from .symbols import NoAnswer, NotProvable, PathSearch, Refuted, SymbolicBytes, SymbolicInt, concrete
from .witness import by_reference, image_of

#: How many symbolic bytes there are from a place on, and how many of them behind the shortest packet.
LONGEST, BEHIND = 12, 2
#: Places at which the text decides.
PLACES = (0, 5)
#: Where in the stream symbolic buffers are.
BASE = 1_000_003
#: Sequences of pieces that are tried at most.
SEQUENCES = 600

Number = int | SymbolicInt


# ---------------------------------------------------------------------- the rule, once more


class Decision(NamedTuple):
    """What is decided at one place: `size` bytes (0: wait for more) are a packet of a framing, or lost for a reason."""

    size: int
    framing: int | None = None
    reason: str = ""


def decision(framings: Sequence[Framing], data: SymbolicBytes, *, silent: bool) -> Decision:
    """Return what the reference rule decides at the beginning of `data`, on this path."""
    bad = ""
    unclaimed: Decision | None = None
    for number, framing in enumerate(framings):
        verdict, size, reason = candidate_verdict(framing, number, data, silent=silent)
        if verdict == "more" and not silent:
            return Decision(0)
        if verdict == "whole":
            if is_free(f"message_{number}_{size}"):
                return Decision(size, number)
            unclaimed = unclaimed or Decision(size, None, "unknown")
        elif verdict != "dead":
            bad = bad or f"malformed: {reason or 'incomplete'}"
    return unclaimed or Decision(1, None, bad or "skipped")


def is_free(name: str) -> bool:
    """Return a truth that the bytes do not decide here: whether content is a message, or can be unstuffed."""
    return PathSearch.current.decide(z3.Bool(name))


def candidate_verdict(
    framing: Framing, number: int, data: SymbolicBytes, *, silent: bool
) -> tuple[str, int, str]:
    """Return what a framing makes of the candidate at the beginning of `data`: (verdict, size, reason)."""
    start = len(framing.sync)
    if data[:start] != framing.sync[: len(data)]:
        return "dead", 0, ""
    if len(data) < start + bool(framing.not_next):
        return "more", 0, ""
    if framing.not_next and is_value_of(data[start], framing.not_next):
        return "dead", 0, ""
    for head, numbers in framing.match:
        if len(data) <= head.offset:
            return "more", 0, ""
        if not is_value_of(data[head.offset], numbers):
            return "dead", 0, ""
    if framing.is_silent:
        if len(data) > framing.max_size:
            return "bad", 0, "length"
        return packet_verdict(framing, number, data) if silent else ("more", 0, "")
    if framing.end:
        return _ended(framing, number, data)
    size = packet_size(framing, data)
    if size is None:
        return "more", 0, ""
    if not framing.min_size <= size <= framing.max_size or (
        framing.multiple > 1 and size & framing.multiple - 1 != 0
    ):
        return "bad", 0, "length"
    if len(data) < size:
        return "more", 0, ""
    return packet_verdict(framing, number, data[: concrete(size)])


def _ended(framing: Framing, number: int, data: SymbolicBytes) -> tuple[str, int, str]:
    """Judge a candidate that a mark closes."""
    at = data.find(framing.end, len(framing.sync), framing.max_size)
    inside = data[len(framing.sync) : at if at >= 0 else framing.max_size]
    if any(is_value_of(cell, framing.not_inside) for cell in inside if framing.not_inside):
        return "bad", 0, "a byte that no packet has"
    if at < 0:
        return ("more", 0, "") if len(data) < framing.max_size else ("bad", 0, "no end")
    if at == len(framing.sync):
        return "dead", 0, ""
    return packet_verdict(framing, number, data[: at + len(framing.end)])


def packet_size(framing: Framing, data: SymbolicBytes) -> Number | None:
    """Return the size that a packet says of itself: None while its length is not there, 0 where that is no length."""
    affine = framing.affine
    if affine is None:
        return framing.fixed_size
    head, wide = affine.length, affine.wide
    if len(data) < (affine.reach if affine.flags is not None else head.offset + head.size):
        return None
    number: Number = head_value(head, data)
    if affine.flags is not None:
        is_longer = head_value(affine.flags, data) & affine.mask != 0
        return affine.factor * number + affine.constant + (affine.more if is_longer else 0)
    if wide is None or affine.escape is None or number < affine.escape:
        return affine.factor * number + affine.constant
    if number > affine.escape:
        return 0
    if len(data) < wide.offset + wide.size:
        return None
    number = head_value(wide, data)
    return affine.factor * number + affine.constant + wide.size if number >= affine.escape else 0


def packet_verdict(framing: Framing, number: int, packet: SymbolicBytes) -> tuple[str, int, str]:
    """Judge a whole candidate by its length, its check and its stuffing."""
    affine, covered = framing.affine, packet
    if (
        affine is not None
        and affine.flags is not None
        and head_value(affine.flags, packet) & affine.mask != 0
    ):
        covered = packet[: len(packet) - affine.more]
    if len(covered) < framing.min_size:
        return "bad", 0, "length"
    if framing.check is not None and not has_good_check(framing, framing.check, covered):
        return "bad", len(packet), "checksum"
    if framing.stuffing is not None and is_free(f"stuffed_{number}_{len(packet)}"):
        return "bad", 0, "stuffing"
    return "whole", len(packet), ""


def has_good_check(framing: Framing, check: Check, packet: SymbolicBytes) -> bool:
    """Return whether the check of a packet holds, on this path."""
    at = framing.check_at if framing.check_at >= 0 else len(packet) + framing.check_at
    cells = covered_cells(framing.check_over, packet)
    return bool(packet[at : at + check.bytes].number(check.order) == check_number_of(check, cells))


def unread(framing: Framing) -> str:
    """Return what of a framing is not read as arithmetic here; empty where all is."""
    check, stuffing = framing.check, framing.stuffing
    if framing.measure is not None:
        return "a size that bits say"
    if stuffing is not None and not stuffing.is_inside:
        return "packets that are stuffed as a whole"
    if framing.short_end:
        return "two marks that may close packets"
    if check is not None and check.text is not None:
        return "a check written as text"
    if framing.covers_request or framing.check_behind:
        return "a check over the request" if framing.covers_request else "a check behind the end"
    is_seeded = check is not None and any(isinstance(part, Extra) for part in check.over or ())
    return "a check with extra bytes" if is_seeded else ""


# ---------------------------------------------------------------------- the printed text


class _SymbolicSums:
    """Running sums that reach anywhere: `end` is any number, so that the text takes both of its ways."""

    def __init__(self, check: Check) -> None:
        self.check = check
        self.end = SymbolicInt(z3.BitVec("sums_end", 32))

    def compute(self, buffer: SymbolicBytes, base: Number, start: Number, end: Number) -> SymbolicInt:
        return check_number(self.check, buffer[start - base : end - base])

    def fail(self, fresh: SymbolicBytes, start: Number) -> None:
        """Do nothing: what is remembered of a failure changes no number."""


def check_number(check: Check, data: SymbolicBytes) -> SymbolicInt:
    """Return a check's number over bytes."""
    number = SymbolicInt.of(check_number_of(check, list(data)))
    assert number is not None
    return number


class _Counted:
    """What the text counts its work in."""

    work: Number = 0


class PrintedScan:
    """The printed scan function of a scanner over symbolic stand-ins for the names that it calls."""

    def __init__(self, scanner: stream.StreamScanner) -> None:
        self.framings = scanner.framings
        #: What was emitted: (framing, bytes of the packet, its offset), or lost: (offset, size, reason).
        self.emitted: list[tuple[int, SymbolicBytes, Number]] = []
        self.lost: list[tuple[Number, Number, str]] = []
        names: dict[str, object] = {
            "from_bytes": from_bytes,
            "xor": partial(check_number, Xor()),
            "fletcher": partial(check_number, Fletcher()),
            "asked": lambda: range(len(self.framings)),  # of each candidate the rule says the same
            "seek": lambda buffer, at: None,  # one decision ends before what it would find
        }
        for number, framing in enumerate(self.framings):
            if why := unread(framing):
                raise NotProvable(f"{framing.name}: {why}")
            names |= self._names(number, framing)
        space = load_source(scanner.source, "aces stream proof", names)
        for name, function in list(space.items()):
            if isinstance(function, types.FunctionType) and function.__globals__ is space:
                space[name] = types.FunctionType(code_with_constants(function.__code__)[0], space)
        self.scan: Callable[..., Number] = space["scan"]
        #: Why a packet's check fails, where that is a function of its own.
        self.failures: dict[int, Callable[[SymbolicBytes], str | None]] = {
            number: space[f"check_{number}"]
            for number in range(len(self.framings))
            if f"check_{number}" in space
        }

    def _names(self, number: int, framing: Framing) -> dict[str, object]:
        def judge(buffer: SymbolicBytes, at: Number, silent: bool) -> tuple[str, Number, str]:
            verdict, size, reason = candidate_verdict(framing, number, buffer[at:], silent=silent)
            return verdict, at + size, f"malformed: {reason}"

        def decode(
            data: SymbolicBytes,
            offset: Number,
            time: object,
            channel: object,
            packet: SymbolicBytes,
            rx: object,
        ) -> tuple[int, SymbolicBytes, Number] | None:
            return (number, packet, offset) if is_free(f"message_{number}_{len(packet)}") else None

        def unstuff(packet: SymbolicBytes) -> SymbolicBytes | None:
            return None if is_free(f"stuffed_{number}_{len(packet)}") else packet

        names: dict[str, object] = {
            f"judge_{number}": judge,
            f"packet_{number}": decode,
            f"unstuff_packet_{number}": unstuff,
        }
        check = framing.check
        if check is not None:

            def failure(buffer: SymbolicBytes, base: Number, start: Number, end: Number) -> str | None:
                return None if has_good_check(framing, check, buffer[start:end]) else "malformed: checksum"

            names[f"sums_{number}"] = _SymbolicSums(check)
            names[f"failure_{number}"] = failure
            names[f"crc_{number}"] = partial(check_number, check)
        return names

    def decides(self, data: SymbolicBytes, at: int, *, silent: bool, search: PathSearch) -> None:
        """Claim on one path that the text decides at one place as the rule does."""
        self.emitted, self.lost = [], []
        want = decision(self.framings, data[at:], silent=silent)
        try:
            reached = self.scan(
                data, BASE, at, at + 1, silent, None, self.emitted.append, self._lose, _Counted()
            )
        except (NotProvable, Refuted):
            raise
        except Exception as error:
            search.fail(f"the scan function raises {type(error).__name__}: {error}")
        packets = [] if want.framing is None else [(want.framing, data[at : at + want.size], BASE + at)]
        lost = [(BASE + at, want.size, want.reason)] if want.size and want.framing is None else []
        shown = f"{len(self.emitted)} packets, lost {[reason for *_, reason in self.lost]}"
        if [p[0] for p in self.emitted] != [p[0] for p in packets]:
            search.fail(f"{shown}; the rule: {_text(want)}")
        if [reason for *_, reason in self.lost] != [reason for *_, reason in lost]:
            search.fail(f"{shown}; the rule: {_text(want)}")
        claims = [_same(reached, at + want.size)]
        for mine, theirs in zip(self.emitted, packets, strict=True):
            claims += [mine[1].same(theirs[1]), _same(mine[2], theirs[2])]
        for loss, meant in zip(self.lost, lost, strict=True):
            claims += [_same(loss[0], meant[0]), _same(loss[1], meant[1])]
        search.claim(z3.And(*claims), f"other bytes; the rule: {_text(want)}")
        search.accepted += 1

    def checks(self, data: SymbolicBytes, number: int, search: PathSearch) -> None:
        """Claim on one path that the printed check of a packet says what the rule says."""
        verdict, size, reason = candidate_verdict(self.framings[number], number, data, silent=False)
        if size == len(data) and (verdict == "whole" or reason == "checksum"):
            said = self.failures[number](data)
            if said != (f"malformed: {reason}" if reason else None):
                search.fail(f"check: {said}; the rule: {reason or verdict}")

    def _lose(self, offset: Number, size: Number, reason: str) -> None:
        self.lost.append((offset, size, reason))


def _same(one: Number, other: Number) -> z3.BoolRef:
    first, second = SymbolicInt.of(one), SymbolicInt.of(other)
    assert first is not None
    assert second is not None
    width = max(first.width, second.width)
    return first.wide(width) == second.wide(width)


def _text(want: Decision) -> str:
    if not want.size:
        return "wait"
    return (
        f"a packet of {want.size} bytes" if want.framing is not None else f"{want.size} lost, {want.reason}"
    )


def _stays(framings: Sequence[Framing], data: SymbolicBytes, search: PathSearch) -> None:
    """Claim on one path that what the rule decides of all but the last byte stays decided."""
    before = decision(framings, data[:-1], silent=False)
    if before.size and decision(framings, data, silent=False) != before:
        search.fail(f"{_text(before)} until another byte comes")


def prove_scan(scanner: stream.StreamScanner, search: PathSearch) -> None:
    """Prove the printed scan function; `search.reached` tells how far. Raise `FailedClaim` with a witness."""
    framings = scanner.framings
    least = [framing.min_size for framing in framings if framing.min_size <= LONGEST]
    printed = PrintedScan(scanner)
    for size in range(1, max([*least, LONGEST - BEHIND]) + BEHIND + 1):
        claims: list[tuple[int, Callable[[SymbolicBytes], None]]] = [
            (at, partial(printed.decides, at=at, silent=silent, search=search))
            for at in PLACES
            for silent in (False, True)
        ]
        claims.append((0, partial(_stays, framings, search=search)))
        claims += [(0, partial(printed.checks, number=n, search=search)) for n in printed.failures]
        for at, claim in claims:
            data = SymbolicBytes.named("byte", at + size)
            try:
                search.run(partial(claim, data))
            except Refuted as refuted:
                found = [refuted.model.eval(cell, model_completion=True) for cell in data.cells]
                raise FailedClaim(
                    Witness(str(refuted), None, bytes(cell.as_long() for cell in found))
                ) from None
        search.reached = size


def check_seek(framings: Sequence[Framing]) -> Witness | None:
    """Return bytes in which the search for a next packet is wrong, of all of up to 6 sync bytes and another byte.

    The pattern names no other bytes, so that one stands for all of them.
    """
    seek = re.compile(seek_pattern(framings), re.DOTALL).search
    syncs = [framing.sync for framing in framings]
    alphabet = sorted({*b"".join(syncs), other_byte(framings)})
    for size in range(7):
        for cells in itertools.product(alphabet, repeat=size):
            data = bytes(cells)
            found = seek(data, 1)
            opens = (at for at in range(1, size) if any(_opens(sync, data[at:]) for sync in syncs))
            if (found.start() if found else None) != next(opens, None):
                return Witness("the search for a next packet", None, data)
    return None


def _opens(sync: bytes, data: bytes) -> bool:
    return data[: len(sync)] == sync[: len(data)]


# ---------------------------------------------------------------------- the whole scanner, on pieces


def other_byte(framings: Sequence[Framing]) -> int:
    """Return a byte that plays no part in marks, sizes and matches; where all do, one with which no packet begins."""
    used = {*b"".join(f.sync + f.end + f.not_inside for f in framings)}
    matched = [(head, numbers) for f in framings for head, numbers in f.match if len(numbers) < 200]
    beginning = {byte for head, numbers in matched if not head.offset for byte in numbers}
    for taken in (used.union(*(numbers for _, numbers in matched)), used | beginning):
        for byte in range(0x5A, 0x15A):
            if byte & 0xFF not in taken:
                return byte & 0xFF
    raise NotProvable("packets begin with any byte")


def stream_pieces(scanner: stream.StreamScanner) -> list[bytes]:
    """Return what streams are put together from, the most telling first: bytes that play a part, and packets."""
    framings = scanner.framings
    (variant,) = scanner.variants
    messages = [m for m in variant.messages_for(scanner.direction) if m.framing is not None]
    packets = [found for framing in framings if (found := _shortest(framing, messages)) is not None]
    first = packets[:1]
    sizes = [
        bytes([number & 0xFF])
        for framing, packet in zip(framings, packets, strict=False)
        if framing.affine is not None and (number := framing.affine.invert(len(packet))) is not None
    ]
    bytes_alone = [bytes([byte]) for framing in framings for byte in framing.sync + framing.end]
    bytes_alone += [*sizes, b"\0", bytes([other_byte(framings)])]
    damaged = [packet[:-1] + bytes([packet[-1] ^ 1]) for packet in first]
    return list(dict.fromkeys([*packets[:4], *damaged, *(packet[:-1] for packet in first), *bytes_alone]))


def _shortest(framing: Framing, messages: Sequence[Message]) -> bytes | None:
    """Return the shortest of some packets of a framing."""
    found: list[bytes] = []
    for message in messages:
        if message.framing is framing:
            found += [example.packet.data for example in message.examples]
            sizes = proof_lengths(message)[0]
            images = (image_of(message, w) for w in drawn(message, sizes, 40))
            found += [image for image in images if by_reference(message, image) is not None]
    return min(found, key=len, default=None)


def piece_sequences(pieces: Sequence[bytes]) -> tuple[int, Iterator[bytes]]:
    """Return of how many pieces all sequences are tried, and these sequences."""
    most = 1
    while sum(len(pieces) ** n for n in range(1, most + 2)) <= SEQUENCES:
        most += 1
    chosen = (itertools.product(pieces, repeat=n) for n in range(1, most + 1))
    return most, (b"".join(parts) for parts in itertools.chain.from_iterable(chosen))


def differing(scanner: stream.StreamScanner, data: bytes) -> str:
    """Return how scanner and reference differ on a stream, split in two anywhere; empty where they agree."""
    scene = Scene(data)
    want = laws.reference_items(scanner.variants, scanner.direction, scene)
    usual = stream.WORTH
    try:
        for stream.WORTH in (usual, 1):  # as small chunks are scanned, and as large ones are
            for cut in range(len(data)):
                scanner.reset()
                got = laws.scanned_items(scanner, scene, (cut,) if cut else ())
                if got != want:
                    mine, theirs = ("; ".join(map(str, items)) or "nothing" for items in (got, want))
                    return f"cut at {cut}: {mine} instead of {theirs}"
    finally:
        stream.WORTH = usual
    return ""


def shown_by(scanner: stream.StreamScanner, data: bytes) -> Witness | None:
    """Return a stream that shows that the scanner is not the reference, from bytes on which its text is not the rule.

    Some differences show only when more bytes come.
    """
    for tail in (b"", data, bytes(2 * LONGEST)):
        if how := differing(scanner, data + tail):
            return Witness(how, None, data + tail, scanner.direction)
    return None


# ---------------------------------------------------------------------- a wire


@dataclass(frozen=True)
class StreamJob:
    """The scanners of one variant, in every direction that differs."""

    variant: Variant
    patience: float = 10.0

    def prove(self, seconds: float) -> list[Outcome]:
        """Prove them, as far as it goes; printed texts that are equal once."""
        texts: dict[str, Outcome] = {}
        return [self._proved(way, seconds, texts) for way in directions(self.variant)]

    def lost(self, reason: str) -> list[Outcome]:
        """Return that nothing was proved."""
        found = [self._outcome(way) for way in directions(self.variant)]
        for outcome in found:
            outcome.add("scanner", "unknown", reason)
        return found

    def _outcome(self, way: Way) -> Outcome:
        return Outcome(self.variant.label, f"stream, {way or 'any direction'}")

    def _proved(self, way: Way, seconds: float, texts: dict[str, Outcome]) -> Outcome:
        outcome, start = self._outcome(way), time.process_time()
        scanner = stream.StreamScanner([self.variant], direction=way, include_unknown=True, raw=True)
        if scanner.source in texts:
            outcome.parts = [claim for claim in texts[scanner.source].parts if claim.what == "scan"]
        else:
            texts[scanner.source] = outcome
            self._scan(outcome, scanner, PathSearch(seconds))
        if outcome.witness is None:
            self._scanner(outcome, scanner)
        outcome.seconds = time.process_time() - start
        return outcome

    def _scan(self, outcome: Outcome, scanner: stream.StreamScanner, search: PathSearch) -> None:
        """Prove the printed text."""
        reason = ""
        try:
            found = check_seek(scanner.framings) if all(f.sync for f in scanner.framings) else None
            if found is not None:
                raise FailedClaim(found)
            prove_scan(scanner, search)
        except FailedClaim as failed:
            found = failed.witness
            outcome.witness = shown_by(scanner, found.data)
            if outcome.witness is not None:
                outcome.add("scan", "refuted", f"{found.what}; {outcome.witness.what}")
                return
            reason = f"{found.what} ({found.data.hex()}), which running it does not confirm"
            search.reached = -1
        except (NoAnswer, NotProvable) as refused:
            reason = str(refused)
        finally:
            outcome.paths = search.paths
        if search.reached > 0:
            more = f", then {reason}" if reason else ""
            outcome.add("scan", "bounded", f"all strings of up to {search.reached} bytes{more}")
        else:
            outcome.add("scan", "unknown", reason)

    def _scanner(self, outcome: Outcome, scanner: stream.StreamScanner) -> None:
        """Try the whole scanner on sequences of pieces; where z3 could not say, this is what is known of the text, too."""
        pieces = stream_pieces(scanner)
        most, tried = piece_sequences(pieces)
        for data in tried:
            if how := differing(scanner, data):
                outcome.witness = Witness(how, None, data, scanner.direction)
                outcome.add("scanner", "refuted", how)
                return
        said = f"all sequences of up to {most} of {len(pieces)} pieces, split in two anywhere"
        by_trial = [claim for claim in outcome.parts if claim.status == "unknown"]
        outcome.parts = [claim for claim in outcome.parts if claim.status != "unknown"]
        outcome.add("scanner", "bounded", "".join(f"not by z3 ({one.reason}): " for one in by_trial) + said)
