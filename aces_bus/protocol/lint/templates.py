"""What is wrong with templates: messages that nothing can be, requests that cannot have been, order that settles nothing;
and on a bus of several protocols, frames and packets that two of them claim.

1. CAN is decided exactly, as in `declare.ambiguity`, over identifier × flags × length × constants; what is claimed of
   streams is proved or left out, and a witness is looked for.
2. A finding about two messages names both places.
3. On a bus frames are recognised by their bytes alone: it does not say which way a frame went.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from construct import Renamed

from ..declare.ambiguity import Conflict, Demands, conflict, demands, needing_context, solved
from ..declare.examples import ExampleFrame
from ..declare.fields import Present
from ..declare.message import Message, Request, share_dialect
from ..declare.pattern import IdPattern
from ..declare.protocol import Variant
from ..protocol import Protocol
from .finding import Finding, Level

#: Patterns of more numbers than this are not walked.
WALKED = 4096


def check_templates(protocol: Protocol) -> Iterator[Finding]:
    """Yield what is wrong or doubtful about the templates of a protocol."""
    variants = protocol.variants()
    hanging = {variant: needing_context(list(variant.messages.values())) for variant in variants}
    for message in protocol.declared:
        yield from _possible(message)
        yield from _somewhere(message, variants)
        yield from _order(message)
        yield from _requests(message, hanging)
        yield from _masks(message)
    yield from _shadows(hanging)
    yield from _directions(variants)
    yield from _without_direction(protocol)
    used = {name for message in protocol.declared for name in message.dialects or ()}
    for name in protocol.dialects:
        if name not in used and len(protocol.dialects) > 1 and used:
            yield Finding(
                "note", "dialect", protocol.place, f"dialect {name!r} has no message that others have not"
            )


def _finding(level: Level, rule: str, message: Message, text: str, *others: Message) -> Finding:
    return Finding(
        level,
        rule,
        message.place,
        f"{message.name}: {text}",
        message.name,
        None,
        tuple(o.place for o in others),
    )


# ---------------------------------------------------------------------- one message


def _possible(message: Message) -> Iterator[Finding]:
    """Yield whether some bytes satisfy the template."""
    lengths = [None] if message.framing is not None else sorted(message.lengths or ())
    if all(_solution(message, length) is None for length in lengths):
        yield _finding(
            "error", "unreachable", message, "no packet is this message: its template contradicts itself"
        )


def _solution(message: Message, length: int | None) -> dict[int, int] | None:
    wanted = demands(message, length)
    if wanted is None:
        return None
    return solved(wanted.fixed, sorted(wanted.choices, key=lambda c: (c.excluded, len(c.values))))


def _somewhere(message: Message, variants: list[Variant]) -> Iterator[Finding]:
    if any(_here(variant, message) is not None for variant in variants):
        return
    conditions = ", ".join(
        f"{c.key} of {c.capture} is {', '.join(sorted(map(str, c.values)))}" for c in message.when
    )
    dialects = ", ".join(sorted(message.dialects)) if message.dialects else ""
    why = " and ".join(filter(None, [f"dialect {dialects}" if dialects else "", conditions]))
    yield _finding(
        "warning",
        "unreachable",
        message,
        f"no shipped dialect and configuration has it (only where {why or 'nowhere'})",
    )


def _here(variant: Variant, message: Message) -> Message | None:
    """Return the message as a variant has it, its identifiers narrowed."""
    found = variant.messages.get(message.name)
    return (
        found
        if found is not None and found.place == message.place and found.dialects == message.dialects
        else None
    )


def _order(message: Message) -> Iterator[Finding]:
    for name in message.overrides:
        others = [m for m in message.protocol.declared if m.name == name]
        if others and all(conflict(message, other) is None for other in others):
            yield _finding(
                "warning",
                "overrides",
                message,
                f"overrides={name!r} settles nothing: no packet is both",
                *others,
            )


def _masks(message: Message) -> Iterator[Finding]:
    """Yield fields that stand in another order than the bits by which they are there, or share a bit."""
    last: dict[str, tuple[int, str]] = {}
    for item in getattr(message.payload, "subcons", ()):
        body = item.subcon if isinstance(item, Renamed) else item
        if not isinstance(body, Present):
            continue
        bit, before = last.get(body.selector, (-1, ""))
        if body.bit <= bit:
            how = "by the same bit as" if body.bit == bit else f"by bit {body.bit}, behind"
            then = "" if body.bit == bit else f" by bit {bit}"
            yield _finding(
                "warning",
                "mask",
                message,
                f"{item.name} is there {how} {before}{then} of {body.selector}:"
                " fields are mostly in the order of their bits",
            )
        last[body.selector] = body.bit, item.name or ""


# ---------------------------------------------------------------------- requests


def _requests(message: Message, hanging: Mapping[Variant, frozenset[str]]) -> Iterator[Finding]:
    if message.within is not None and message.within <= 0:
        yield _finding("error", "request", message, f"within={message.within:g} s: no request is that young")
    every = [("reply_to", r) for r in message.reply_to] + [("after", r) for r in message.after]
    for what, request in every:
        yield from _request(message, what, request)
    if not every:
        return
    for variant, names_hanging in hanging.items():
        here = _here(variant, message)
        if here is None:
            continue
        if not any(_fits(variant, here, request) for _, request in every):
            names = ", ".join(str(request) for _, request in every)
            if message.name in names_hanging:
                yield _finding(
                    "error",
                    "unreachable",
                    message,
                    f"in {variant.label} its request ({names}) cannot have been, so it is never recognised",
                )
            else:
                yield _finding(
                    "note", "request", message, f"in {variant.label} nothing asks for it: there is no {names}"
                )
            return


def _request(message: Message, what: str, request: Request) -> Iterator[Finding]:
    asked = request.message
    if message.direction is not None and message.direction == asked.direction and what == "reply_to":
        yield _finding(
            "warning",
            "direction",
            message,
            f"reply_to={asked.name}, but both go {message.direction}",
            asked,
        )
    if what == "reply_to":
        yield from _answer(message, asked)
    for name, wanted in request.values:
        possible = _values(asked, name)
        if possible is not None and not any(value in possible for value in wanted):
            yield _finding(
                "error",
                "request",
                message,
                f"{what}={request} cannot be: {name} of {asked.name} is never {', '.join(map(str, sorted(wanted)))}",
                asked,
            )


def _answer(message: Message, asked: Message) -> Iterator[Finding]:
    """Yield what is doubtful about an answer and its request: a direction that it lacks, the number of another one."""
    if message.direction is None and asked.direction is not None:
        other = "from device" if asked.direction == "to device" else "to device"
        yield _finding(
            "warning",
            "direction",
            message,
            f"no direction=; {asked.name}, which it answers, goes {asked.direction}: direction={other!r}",
            asked,
        )
    for name in _numbered(message) & _numbered(asked):
        mine = _values(message, name)
        if mine is None or len(mine) != 1 or _values(asked, name) == mine:
            continue
        meant = [
            other
            for other in message.protocol.declared
            if other.direction == asked.direction
            and other is not message
            and share_dialect(other, message)
            and name in _numbered(other)
            and _values(other, name) == mine
        ]
        if (
            _is_one(asked, name)
            and len(meant) == 1
            and not any(r.message is meant[0] for r in message.reply_to)
        ):
            (number,) = mine
            yield _finding(
                "warning",
                "request",
                message,
                f"reply_to={asked.name}, but its {name} {number:#04x} is that of {meant[0].name}",
                asked,
                meant[0],
            )


def _numbered(message: Message) -> set[str]:
    """Return the names of the head fields in front of the payload."""
    return {head.name for head in message.heads_written if head.name is not None}


def _is_one(message: Message, name: str) -> bool:
    values = _values(message, name)
    return values is not None and len(values) == 1


def _values(message: Message, name: str) -> range | frozenset[int] | None:
    """Return what a field of a message may be, as far as its template and width say; None: not known."""
    patterns: list[tuple[str | None, IdPattern]] = [(None, message.identifier)]
    patterns += [(h.name, h.pattern) for h in message.heads_written if h.pattern is not None]
    for own, pattern in patterns:
        if own == name and not pattern.captures:
            return frozenset([pattern.constant])
        for capture in pattern.captures:
            if capture.name == name:
                values = capture.values
                return values if isinstance(values, range) else frozenset(values)
    spans = [field.node.raw_range for field in message.plan.fields if field.name == name]
    return range(spans[0][0], spans[0][1] + 1) if spans and spans[0] is not None else None


def _fits(variant: Variant, message: Message, request: Request) -> bool:
    """Return whether a variant has the request, for a device that may send the message."""
    asked = variant.messages.get(request.message.name)
    if asked is None:
        return False
    shared = set(message.fields) & set(asked.fields)
    for name in shared:
        mine, theirs = _values(message, name), _values(asked, name)
        if name not in message.outer_names & asked.outer_names or mine is None or theirs is None:
            continue
        everyone = variant.protocol.broadcast.get(name)
        if everyone is not None and everyone in theirs:
            continue
        few, many = (mine, theirs) if len(mine) <= len(theirs) else (theirs, mine)
        if len(few) <= 65536 and not any(value in many for value in few):
            return False
    return True


# ---------------------------------------------------------------------- messages that others take


def _shadows(hanging: Mapping[Variant, frozenset[str]]) -> Iterator[Finding]:
    """Yield messages whose every frame is another's, which is tried first."""
    seen: set[tuple[str, str]] = set()
    for variant, names_hanging in hanging.items():
        for first in variant.messages.values():
            for name in first.overrides:
                other = variant.messages.get(name)
                if (
                    other is None
                    or (first.name, name) in seen
                    or first.name in names_hanging
                    or name in names_hanging
                ):
                    continue
                if {first.direction, other.direction} == {"to device", "from device"}:
                    continue
                if _covers(first, other):
                    seen.add((first.name, name))
                    yield _finding(
                        "error",
                        "unreachable",
                        other,
                        f"never reached: every packet of it is {first.name}, which is tried first (overrides=)",
                        first,
                    )


def _covers(first: Message, other: Message) -> bool:
    """Return whether every packet of `other` is one of `first`; False when that is not proved."""
    plan = first.plan
    if plan.opaque or plan.split is not None or first.check is not None or first.framing is not other.framing:
        return False
    if (first.extended, first.remote) != (other.extended, other.remote) or not (
        set(other.formats) <= set(first.formats)
    ):
        return False
    if first.framing is None:
        if len(other.identifier) > WALKED or any(first.identifier.match(n) is None for n in other.identifier):
            return False
        if not set(other.lengths or ()) <= set(first.lengths or ()):
            return False
        lengths: list[int | None] = [*(other.lengths or ())]
    else:
        theirs = other.plan
        if theirs.least < plan.least if plan.lengths is None else plan.lengths != theirs.lengths:
            return False
        lengths = [None]
    both = [(demands(first, length), demands(other, length)) for length in lengths]
    return all(mine is not None and others is not None and _implied(mine, others) for mine, others in both)


def _implied(wanted: Demands, given: Demands) -> bool:
    if any(given.fixed.get(bit) != value for bit, value in wanted.fixed.items()):
        return False
    for choice in wanted.choices:
        number = _number(choice.bits, given.fixed)
        if number is not None:
            if (number in choice.values) is choice.excluded:
                return False
        elif not any(
            allowed.bits == choice.bits
            and not allowed.excluded
            and not choice.excluded
            and len(allowed.values) <= 65536
            and all(value in choice.values for value in allowed.values)
            for allowed in given.choices
        ):
            return False
    return True


def _number(bits: tuple[int, ...], fixed: Mapping[int, int]) -> int | None:
    return sum(fixed[bit] << i for i, bit in enumerate(bits)) if fixed.keys() >= set(bits) else None


# ---------------------------------------------------------------------- direction


def _directions(variants: list[Variant]) -> Iterator[Finding]:
    known: set[tuple[str, str]] = set()
    for variant in variants:
        if variant.link != "can":
            if (clash := variant.direction_conflict) is not None:
                yield _finding(
                    "note",
                    "direction",
                    clash[0],
                    f"bytes alone do not tell it from {clash[1].name}: a raw capture needs --direction to|from|both",
                    clash[1],
                )
                return
            continue
        for message, other in variant.direction_conflicts:
            if (message.name, other.name) not in known:
                known.add((message.name, other.name))
                yield _finding(
                    "warning",
                    "direction",
                    message,
                    f"frames alone do not tell it from {other.name}: both are unknown without --direction to|from|both",
                    other,
                )


#: Where so many messages say which way they go, one (or so few of all: a family) that does not was forgotten.
MANY, FEW = 8, 0.1


def _without_direction(protocol: Protocol) -> Iterator[Finding]:
    without = [message for message in protocol.declared if message.direction is None]
    others = len(protocol.declared) - len(without)
    if others >= MANY and len(without) <= max(1, FEW * others):
        for message in without:
            yield _finding("warning", "direction", message, f"no direction=, which all {others} others have")


#: Collisions of two protocols that are named one by one.
SHOWN = 8


def check_wire(variants: Sequence[Variant], level: Level = "error", where: str = "") -> Iterator[Finding]:
    """Yield the collisions of protocols on one bus, in the order in which they are tried; `where` names the bus."""
    for index, first in enumerate(variants):
        for second in variants[index + 1 :]:
            is_one_channel = None in (first.channel, second.channel) or first.channel == second.channel
            if first.link == second.link and first.protocol is not second.protocol and is_one_channel:
                yield from _collisions(first, second, level, where)


def _collisions(first: Variant, second: Variant, level: Level, where: str) -> Iterator[Finding]:
    clashes: list[Conflict] = []
    for message in first.messages.values():
        for other in second.messages.values():
            if message.framing is not None or not message.identifier.is_apart(other.identifier):
                clash = conflict(message, other)
                if clash is not None:
                    clashes.append(clash)
    clashes.sort(key=lambda clash: clash.witness is None)  # those with a packet to show first
    shown = SHOWN if first.link == "can" else 1
    for number, clash in enumerate(clashes[:shown], 1):
        one, other = clash.one, clash.other
        if one.protocol is not first.protocol:
            one, other = other, one
        more = len(clashes) - shown if number == min(shown, len(clashes)) else 0
        and_more = f" (and {more} more pair{'s' if more > 1 else ''} of messages)" if more > 0 else ""
        yield Finding(
            "warning" if clash.witness is None else level,
            "collision",
            other.place,
            f"{second.label} {other.name} collides with {first.label} {one.name} ({one.place}){where}:"
            f" {clash.how}{and_more}; {_advice(first)}",
            other.name,
            witness_of(clash),
            (one.place,),
        )


def _advice(first: Variant) -> str:
    if first.link == "can":
        return (
            "give each a channel of its own (-p can0=NAME); else the one that is named first is tried first"
        )
    return "they need lines of their own; else the one that is named first is tried first"


def witness_of(clash: Conflict) -> str | None:
    """Return a conflict's packet or frame, as `aces spec explain` takes it."""
    if clash.witness is None:
        return None
    if clash.identifier is None:
        return f"hex:{clash.witness.hex().upper()}"
    one = clash.one
    return str(ExampleFrame(clash.witness, clash.identifier, one.extended, one.remote, one.fd)).replace(
        " ", ""
    )
