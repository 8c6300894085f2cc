"""What is wrong with framings and checks: sizes that cannot be, checks that prove nothing, lines that never end.

1. What a check covers is found by asking it with packets whose bytes are their own positions.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from ..declare.checks import Check, Covered
from ..declare.framing import Framing
from ..declare.message import Message
from ..plan.nodes import MessagePlan
from ..protocol import Protocol
from .finding import Finding, Level


def check_framings(protocol: Protocol) -> Iterator[Finding]:
    """Yield what is wrong or doubtful about the framings and checks of a protocol."""
    for framing in protocol.framings:
        messages = [m for m in protocol.declared if m.framing is framing]
        yield from _sizes(framing)
        yield from _gap(framing)
        if len(protocol.framings) > 1:
            yield from _waits(framing, messages)
        if framing.check is not None:
            yield from _framing_check(framing, framing.check, messages)
        elif protocol.link != "can" and not any(m.check is not None for m in messages):
            yield _of(
                framing, "note", "unchecked", "packets have no check: what looks like one is taken for one"
            )
        if not messages:
            yield _of(framing, "warning", "unreachable", "no message is declared with this framing")
    for message in protocol.declared:
        if message.framing is not None:
            yield from _message_size(message, message.framing)
        if message.check is not None:
            yield from _message_check(message, message.check)


def _of(framing: Framing, level: Level, rule: str, text: str) -> Finding:
    return Finding(level, rule, framing.place, f"framing {framing.name}: {text}")


def _on(message: Message, level: Level, rule: str, text: str) -> Finding:
    return Finding(level, rule, message.place, f"{message.name}: {text}", message.name)


# ---------------------------------------------------------------------- sizes


def _sizes(framing: Framing) -> Iterator[Finding]:
    affine = framing.affine
    if affine is None:
        return
    most = affine.largest
    if framing.max_size > most:
        yield _of(
            framing,
            "warning",
            "size",
            f"max_size={framing.max_size}, but {affine.length.name!r} says at most {most} bytes",
        )
    elif framing.max_size < most and affine.length.size == 1:
        yield _of(
            framing,
            "note",
            "size",
            f"max_size={framing.max_size}: of the sizes that {affine.length.name!r} can say, up to {most},"
            " longer ones are malformed",
        )
    # A length that counts more than the packet has, or less than its head, says that the constant is off.
    shortest = affine.constant
    if shortest > framing.min_size + 1:
        yield _of(
            framing,
            "warning",
            "size",
            f"with {affine.length.name} = 0 a packet has {shortest} bytes, {shortest - framing.min_size} more than"
            " its head and check: is the constant in size= right?",
        )


def _message_size(message: Message, framing: Framing) -> Iterator[Finding]:
    plan = message.plan
    sizes = plan.lengths
    stuffed = framing.stuffing is not None
    if plan.least > framing.max_size:
        yield _on(
            message,
            "error",
            "size",
            f"takes at least {plan.least} bytes; packets have at most {framing.max_size}",
        )
        return
    if framing.fixed_size is not None:
        if (sizes is not None and framing.fixed_size not in sizes) or plan.least > framing.fixed_size:
            took = ", ".join(map(str, sizes)) if sizes is not None else f"at least {plan.least}"
            yield _on(
                message,
                "error",
                "size",
                f"its fields make packets of {took} bytes; its framing says {framing.fixed_size}",
            )
    elif framing.affine is not None and sizes is not None and not stuffed:
        affine = framing.affine
        for size in sizes:
            number, rest = divmod(size - affine.constant, affine.factor)
            if rest or not 0 <= number < 1 << 8 * affine.length.size:
                yield _on(
                    message,
                    "error",
                    "size",
                    f"its fields make packets of {size} bytes, which no {affine.length.name!r} says",
                )
    yield from _begins(message, framing, plan)


def _begins(message: Message, framing: Framing, plan: MessagePlan) -> Iterator[Finding]:
    """Yield whether the byte behind the sync may be what the template demands."""
    if not framing.not_next:
        return
    first = len(framing.sync)
    for constant in plan.constants:
        if constant.offset == first and constant.mask == 0xFF and constant.value in framing.not_next:
            yield _on(
                message,
                "error",
                "unreachable",
                f"begins with {constant.value:02X}, which not_next= rules out",
            )


def _gap(framing: Framing) -> Iterator[Finding]:
    if framing.gap is not None and framing.gap <= 0:
        yield _of(framing, "error", "gap", f"gap={framing.gap:g} s: a pause takes time")
    elif framing.gap is None and framing.protocol.link == "serial" and framing.fixed_size is None:
        yield _of(
            framing,
            "note",
            "gap",
            "has no gap= (seconds): a packet that was cut off holds what follows it until"
            f" {framing.max_size} bytes have come",
        )


def _waits(framing: Framing, messages: list[Message]) -> Iterator[Finding]:
    """Yield whether any byte may begin a packet for which other framings have to wait."""
    if framing.sync or framing.match or framing.is_silent or framing.end:
        return
    unasked = [message.name for message in messages if not (message.reply_to or message.after)]
    if unasked and framing.max_size > 1:
        yield _of(
            framing,
            "note",
            "waits",
            f"has neither sync= nor match=, and {unasked[0]} no reply_to=: any byte may begin its packets, so what"
            f" other framings read waits until {framing.max_size} bytes or a pause have come",
        )


# ---------------------------------------------------------------------- checks


def _covered(over: Iterable[Covered], size: int) -> list[int]:
    """Return the positions that a check covers in a packet of `size` bytes."""
    places = list(range(size))
    return [place for part in over if isinstance(part, slice) for place in places[part]]


def _elsewhere(check: Check) -> bool:
    """Return whether a check covers something beside the packet's bytes."""
    return any(not isinstance(part, slice) for part in check.over or ())


def _framing_check(framing: Framing, check: Check, messages: list[Message]) -> Iterator[Finding]:
    place = check.place if check.place.file == framing.place.file else framing.place

    def finding(level: Level, rule: str, text: str) -> Finding:
        return Finding(level, rule, place, f"check of {framing.name}: {text}")

    start, tail = len(framing.sync), framing.check_size + len(framing.end)
    sizes = _likely_sizes(framing, messages)
    spans = {size: _covered(framing.check_over, size) for size in sizes}
    if not any(spans.values()) and not _elsewhere(check):
        yield finding(
            "error", "check-range", "covers nothing, so it is always the same number and cannot fail"
        )
        return
    own: set[int] = set()
    for size, span in spans.items():
        at = framing.check_at if framing.check_at >= 0 else size + framing.check_at
        own = set(range(at, at + check.size))
        if own & set(span):
            yield finding(
                "error",
                "check-range",
                f"covers its own bytes ({_listed(own & set(span), size)} of {size}): no packet can hold it",
            )
            return
        if len(set(span)) < len(span):
            yield finding("warning", "check-range", f"covers some bytes twice, of {size}")
            return
    longest = max(sizes)  # also the last whose own bytes were looked at
    left = set(range(start, longest - tail)) - set(spans[longest]) - own
    if left and check.over is not None:
        leading = left == set(range(start, max(left) + 1))
        yield finding(
            "note" if leading else "warning",
            "check-range",
            f"leaves out {_listed(left, longest)}: a fault there goes unseen",
        )
    if not _elsewhere(check) and messages and all(_is_constant(m, spans, tail) for m in messages):
        yield finding("warning", "check-constant", "covers only bytes that never change, so it cannot fail")


def _likely_sizes(framing: Framing, messages: list[Message]) -> list[int]:
    if framing.fixed_size is not None:
        return [framing.fixed_size]
    found = {framing.max_size}
    for message in messages:
        plan = message.plan
        found |= set(plan.lengths or (plan.least, plan.least + 8))
    return sorted(size for size in found if framing.min_size <= size <= framing.max_size)


def _is_constant(message: Message, spans: dict[int, list[int]], tail: int) -> bool:
    plan = message.plan
    if plan.lengths is None or len(plan.lengths) != 1:
        return False
    fixed = {constant.offset for constant in plan.constants if constant.mask == 0xFF}
    size = plan.lengths[0]
    return set(spans.get(size, range(size))) - set(range(size - tail, size)) <= fixed


def _message_check(message: Message, check: Check) -> Iterator[Finding]:
    start, size, _ = message.check_span
    own = set(range(start, start + size))
    lengths = sorted(message.lengths or message.plan.lengths or (message.plan.least,))
    longest = lengths[-1]
    covered = _covered(message.check_over, longest - message.behind)
    if not covered and not _elsewhere(check):
        yield _on(message, "error", "check-range", "its check covers nothing, so it cannot fail")
    elif own & set(covered):
        yield _on(
            message,
            "error",
            "check-range",
            f"its check covers its own bytes ({_listed(own & set(covered), longest)}): no frame can hold it",
        )
    else:
        left = set(range(longest - message.behind)) - own - set(covered)
        framing = message.framing
        if framing is not None and framing.check is not None:  # it sees faults, too
            left -= set(_covered(framing.check_over, longest))
        if left:
            yield _on(
                message,
                "note" if framing is not None and left == set(range(max(left) + 1)) else "warning",
                "check-range",
                f"its check leaves out {_listed(left, longest)}: a fault there goes unseen",
            )
        fixed = {constant.offset for constant in message.plan.constants if constant.mask == 0xFF}
        if set(covered) <= fixed and not (_elsewhere(check) and len(message.identifier) > 1):
            yield _on(
                message,
                "warning",
                "check-constant",
                "its check covers only what never changes, so it cannot fail",
            )


def _listed(places: set[int], size: int) -> str:
    """Name places: `byte 2`, `bytes 0…3`, `the last 2 bytes`."""
    low, high = min(places), max(places)
    if len(places) == 1:
        return "the last byte" if high == size - 1 else f"byte {low}"
    if high - low + 1 != len(places):
        return "bytes " + ", ".join(map(str, sorted(places)[:8]))
    return f"the last {len(places)} bytes" if high == size - 1 else f"bytes {low}…{high}"
