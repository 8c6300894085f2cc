"""What a DBC can say of a variant: its messages and signals, with all that is left out or changed.

1. A DBC has one message an identifier. Messages of ours that share one become one, multiplexed by the bytes in which they
   differ (`choose`, as the scanner has it); what bytes do not tell apart is left out, but for the first.
2. What is left out or changed is a `Loss`, field by field; a signal that is there decodes to the number that the record has.
3. Frames of one identifier may differ in length, a message of a DBC has one, and beside it the lengths that there are.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

from ..declare.ambiguity import ordered
from ..declare.bits import BitLayout, runs_of, whole_bits
from ..declare.j1939 import J1939Transport
from ..declare.message import Message
from ..declare.pattern import IdPattern
from ..declare.protocol import Variant
from ..generate.scan import Choice, choose
from ..plan import nodes as p
from ..plan.flatten import fixed_leaves
from .import_statements import KEYWORDS
from .problems import Loss, ProblemText

#: Identifiers of a message that become one message each.
EXPANDED = 256
#: Bits of the widest signal.
WIDEST = 64


@dataclass
class DbcSignal:
    """A signal as a DBC has it; `start` is where DBC counts from: the lowest bit, of big-endian ones the highest."""

    name: str
    start: int
    width: int
    is_big: bool = False
    is_signed: bool = False
    is_float: bool = False
    scale: float = 1
    offset: float = 0
    low: float | None = None
    high: float | None = None
    names: dict[int, str] = field(default_factory=dict)
    unit: str = ""
    comment: str = ""
    #: Name of the multiplexer and its values; whether it is one itself.
    when: tuple[str, tuple[int, ...]] | None = None
    is_selector: bool = False


@dataclass
class Identified:
    """The messages of one identifier, as one message of a DBC."""

    name: str
    id: int
    size: int
    signals: list[DbcSignal]
    is_extended: bool
    is_fd: bool
    is_j1939: bool
    sender: str
    comment: str
    #: Names of the messages that it stands for.
    members: tuple[str, ...]
    #: The lengths of its frames, where the messages that it stands for differ in theirs.
    lengths: tuple[int, ...] = ()


def identified(
    variant: Variant, *, only: Collection[str] = (), expand: int = EXPANDED
) -> tuple[list[Identified], list[Loss]]:
    """Return the messages of a DBC, and what it does not say. `only` names the messages wanted (all when empty);
    `expand` is how many identifiers of a message become messages of the DBC."""
    return _Decider(variant, only, expand).decide()


class _Decider:
    def __init__(self, variant: Variant, only: Collection[str], expand: int) -> None:
        self.variant, self.expand = variant, expand
        self.messages = [m for m in ordered(variant.messages_for(None)) if not only or m.name in only]
        self.losses: list[Loss] = []
        self.taken: set[str] = set()

    def decide(self) -> tuple[list[Identified], list[Loss]]:
        groups: dict[tuple[int, bool, bool], list[Message]] = {}
        for message in self.messages:
            if message.transport is not None and not _is_long_group(message):
                title = message.transport.title
                self._lose(message.name, "", f"carried by {title}, in several frames: left out")
                continue
            if message.remote:
                self._lose(message.name, "", "a remote frame: left out")
                continue
            for identifier in self._identifiers(message):
                groups.setdefault((identifier, message.extended, message.fd), []).append(message)
        found: list[Identified] = []
        decided: dict[tuple[str, ...], tuple[list[DbcSignal], int, list[Message]]] = {}
        for (identifier, is_extended, is_fd), messages in groups.items():
            if is_fd and (identifier, is_extended, False) in groups:
                for message in messages:
                    reason = "CAN FD with identifiers that classic frames have, too: left out there"
                    self._lose(message.name, "", reason)
                continue
            names = tuple(message.name for message in messages)
            if names not in decided:
                decided[names] = _Group(messages, self.losses).signals()
            found.append(self._identified(identifier, *decided[names]))
        return found, list(dict.fromkeys(self.losses))

    def _lose(self, message: str, name: str, reason: str) -> None:
        self.losses.append(Loss(message, name, reason))

    def _identifiers(self, message: Message) -> list[int]:
        pattern = message.identifier
        if (group := _j1939(pattern)) is not None and message.extended:
            return [group]
        if len(pattern) > self.expand:
            reason = f"{len(pattern):,} identifiers, more than {self.expand:,} (--expand): left out"
            self._lose(message.name, "", reason)
            return []
        return sorted(pattern)

    def _identified(
        self, identifier: int, signals: Sequence[DbcSignal], size: int, messages: Sequence[Message]
    ) -> Identified:
        first = messages[0]
        captures = {} if _j1939(first.identifier) is not None else first.identifier.match(identifier) or {}
        name = (
            "_".join([first.name, *map(str, captures.values())])
            if len(messages) == 1
            else f"{self.variant.name}_{identifier:0{8 if first.extended else 3}X}"
        )
        ways = {message.direction for message in messages}
        sender = (
            {"to device": "Host", "from device": "Device"}.get(str(ways.pop()), "") if len(ways) == 1 else ""
        )
        facts = [f"{key} {value}" for key, value in captures.items()]
        facts += [_said(message, is_named=len(messages) > 1) for message in messages]
        return Identified(
            dbc_name(name, self.taken),
            identifier,
            size,
            [replace(signal) for signal in signals],
            first.extended,
            first.fd,
            _j1939(first.identifier) is not None and first.extended,
            sender,
            "\n".join(filter(None, facts)),
            tuple(message.name for message in messages),
            _lengths(messages),
        )


def _lengths(messages: Sequence[Message]) -> tuple[int, ...]:
    """Return the lengths that occur, where they differ between messages."""
    each = {tuple(message.lengths or ()) for message in messages}
    return tuple(sorted({n for lengths in each for n in lengths})) if len(each) > 1 else ()


def _said(message: Message, *, is_named: bool) -> str:
    facts = [ProblemText.clean(message.doc)]
    if message.reply_to:
        facts.append(f"Answers {', '.join(map(str, message.reply_to))}.")
    if message.source:
        facts.append(f"({ProblemText.clean(message.source)})")
    text = " ".join(filter(None, facts))
    return f"{message.name}: {text}" if is_named else text


def _j1939(pattern: IdPattern) -> int | None:
    """Return the identifier that stands for a parameter group of SAE J1939: priority 6, source and destination the
    null address.
    """
    shapes = sorted((capture.shift, len(capture.values)) for capture in pattern.captures)
    if shapes == [(0, 256), (26, 8)]:
        return pattern.constant | 6 << 26 | 0xFE
    if shapes == [(0, 256), (8, 256), (26, 8)]:
        return pattern.constant | 6 << 26 | 0xFE << 8 | 0xFE
    return None


def _is_long_group(message: Message) -> bool:
    """Return whether it is a parameter group of SAE J1939 that its own transport carries: a DBC says it by the length
    alone.
    """
    return (
        isinstance(message.transport, J1939Transport)
        and message.extended
        and _j1939(message.identifier) is not None
    )


def dbc_name(name: str, taken: set[str]) -> str:
    """Return a name that a DBC can have and nothing else in `taken` has; it is taken from now on."""
    made = re.sub(r"\W", "_", name, flags=re.ASCII)
    while made in taken or made in KEYWORDS:
        made += "_"
    taken.add(made)
    return made


class _Group:
    """The messages of one identifier."""

    def __init__(self, messages: Sequence[Message], losses: list[Loss]) -> None:
        self.plans = {message.name: message.plan for message in messages}
        self.messages = {message.name: message for message in messages}
        self.leaves = {name: fixed_leaves(message)[0] for name, message in self.messages.items()}
        self.losses = losses
        self.found: list[DbcSignal] = []
        self.taken: set[str] = set()
        self.kept: list[str] = []
        #: Leaves that have their signal: by message and path, its name.
        self.named: dict[tuple[str, str], str] = {}

    def signals(self) -> tuple[list[DbcSignal], int, list[Message]]:
        self._walk(choose(list(self.plans.values())), None)
        sizes = {self._size(self.plans[name]) for name in self.kept}
        if len(sizes) > 1:
            reason = f"share an identifier and have {min(sizes)} to {max(sizes)} bytes: a reader must take shorter data"
            self._lose("", "", f"{', '.join(self.kept)} {reason}")
        return self.found, max(sizes), [self.messages[name] for name in self.kept]

    def _lose(self, message: str, name: str, reason: str) -> None:
        self.losses.append(Loss(message, name, reason))

    @staticmethod
    def _size(plan: p.MessagePlan) -> int:
        if plan.lengths_by is not None:
            return max(size for _, size in plan.lengths_by[1])
        return min(plan.lengths) if plan.lengths else plan.least

    def _walk(
        self, choice: Choice, when: tuple[str, tuple[int, ...]] | None, tried: frozenset[int] = frozenset()
    ) -> None:
        names = choice.names
        for leaf in self._common(names):
            self._leaf(leaf, names, when)
        if choice.offset is not None and self._is_taken(choice.offset, when):
            # A signal of another level is there: a DBC cannot multiplex by it here.
            tried |= {choice.offset}
            self._walk(choose([self.plans[name] for name in names], tried), when, tried)
            return
        if choice.offset is None:
            first, *others = names
            for other in others:
                how = self._recognised_by(self.messages[first], self.messages[other])
                self._lose(other, "", f"differs from {first} in {how} alone: left out")
            self.kept.append(first)
            self._message(first, when)
            return
        selector = self._selector(names, choice.offset, when)
        branches: dict[Choice, list[int]] = {}
        for value, branch in choice.cases:
            branches.setdefault(branch, []).append(value)
        for branch, values in branches.items():
            if not selector.names.keys() & set(values):
                selector.names.update({value: "_or_".join(branch.names[:1]) for value in values})
            self._walk(branch, (selector.name, tuple(values)), tried | {choice.offset})

    def _is_taken(self, offset: int, when: tuple[str, tuple[int, ...]] | None) -> bool:
        byte = range(8 * offset, 8 * offset + 8)
        return any(
            signal.when != when
            and not signal.is_big
            and signal.start < byte.stop
            and signal.start + signal.width > byte[0]
            for signal in self.found
            if signal.when is None or when is None
        )

    @staticmethod
    def _recognised_by(one: Message, other: Message) -> str:
        if not set(one.lengths or ()) & set(other.lengths or ()):
            return "its length"
        has_request = other.reply_to or other.after or one.reply_to or one.after
        return "its request" if has_request else "bytes that no multiplexer of a DBC can be here"

    def _common(self, names: Sequence[str]) -> list[p.NodePath]:
        """Add leaves without a condition that all messages share, and that have no signal yet."""
        if len(names) < 2:
            return []
        others = [{(leaf.path, leaf.node) for leaf in self.leaves[name]} for name in names[1:]]
        return [
            leaf
            for leaf in self.leaves[names[0]]
            if not leaf.whens
            and (names[0], leaf.path) not in self.named
            and isinstance(leaf.node, p.Scalar)
            and leaf.node.size is not None
            and all((leaf.path, leaf.node) in other for other in others)
        ]

    def _selector(
        self, names: Sequence[str], offset: int, when: tuple[str, tuple[int, ...]] | None
    ) -> DbcSignal:
        """Return the signal of the byte in which messages differ."""
        byte = tuple(range(8 * offset, 8 * offset + 8))
        own = ""
        meant: dict[int, str] = {}
        for name in names:
            for leaf in self.leaves[name]:
                node = leaf.node
                if isinstance(node, p.Scalar) and node.size and node.kind == "uint" and node.place == byte:
                    own = own or leaf.identifier
                    meant |= node.value_names
                elif isinstance(node, p.FromIdentifier) and node.number and node.number.place == byte:
                    head = self._head(name, offset)
                    self._lose(
                        name, leaf.path, f"part of the multiplexer {head}: only there, not as a signal"
                    )
                    self.named[name, leaf.path] = ""
                    own = own or head
        own = own or next(filter(None, (self._head(name, offset) for name in names)), f"byte_{offset}")
        known = next(
            (s for s in self.found if s.start == 8 * offset and s.width == 8 and s.when in (None, when)), None
        )
        if known is None:
            known = DbcSignal(dbc_name(own, self.taken), 8 * offset, 8, when=when)
            self.found.append(known)
        known.is_selector = True
        known.names |= meant
        for name in names:
            for leaf in self.leaves[name]:
                if isinstance(leaf.node, p.Scalar) and leaf.node.size and leaf.node.place == byte:
                    self.named[name, leaf.path] = known.name
        return known

    def _head(self, name: str, offset: int) -> str:
        heads = self.messages[name].heads_written
        return next((h.name for h in heads if h.name and h.offset == offset and h.size == 1), "")

    # ------------------------------------------------------------------ one message

    def _message(self, name: str, when: tuple[str, tuple[int, ...]] | None) -> None:
        message, plan = self.messages[name], self.plans[name]
        if plan.opaque:
            self._lose(name, "", f"not all of its payload is signals: {plan.opaque}")
        is_open = False
        for leaf in self.leaves[name]:
            is_open = is_open or (isinstance(leaf.node, p.Scalar) and leaf.node.size is None)
            if (name, leaf.path) not in self.named:
                self._leaf(leaf, (name,), when)
        if plan.lengths_by is not None:
            self._lose(name, "", f"its length depends on {plan.lengths_by[0].name}")
        elif message.lengths is not None and len(message.lengths) > 1 and not is_open:
            self._lose(name, "", f"{message.describe_lengths} of data: the least is written")
        if isinstance(message.payload, BitLayout) and message.payload.overlapping:
            self._lose(name, "", "its fields share bits, which strict readers refuse: written all the same")
        if message.check is not None:
            offset, size, order = message.check_span
            self._lose(name, str(message.check.field), f"a check ({message.check.describe}): kept as raw")
            bits = whole_bits(offset, size, order)
            self._place(str(message.check.field), bits, DbcSignal("", 0, 0, when=when))
        for counter in message.counters:
            self._lose(name, counter, "a rolling counter: a number like any other")

    def _leaf(self, leaf: p.NodePath, names: Sequence[str], when: tuple[str, tuple[int, ...]] | None) -> None:
        """Add the signals of a leaf that the messages `names` share."""
        name, node = names[0], leaf.node
        if leaf.whens:
            path, condition = leaf.conditions[-1]
            values = condition.values
            selector = self.named.get((name, path), "")
            owner = next((signal for signal in self.found if signal.name == selector), None)
            if owner is None or owner.width > 16:
                self._lose(name, leaf.path, f"multiplexed by {path}, which is not a plain signal: left out")
                return
            if min(values) < 0:
                self._lose(
                    name, leaf.path, f"there while {path} is negative, which no multiplexer is: left out"
                )
                return
            owner.is_selector, when = True, (selector, values)
        base = DbcSignal("", 0, 0, comment=ProblemText.clean(leaf.doc), when=when)
        before = len(self.found)
        match node:
            case p.Scalar():
                self._scalar(leaf, node, base, name, len(names) > 1)
            case p.FromIdentifier():
                if node.number is None:
                    return  # each identifier is a message
                self._captured(leaf, node, base)
            case p.Rest():
                return  # bits without a signal
            case p.FromRequest():
                self._lose(name, leaf.path, "a field of the request: left out")
            case p.TaggedItems() | p.Repeated():
                self._lose(name, leaf.path, "a list of items, which have no fixed places: left out")
            case _:
                self._lose(name, leaf.path, "no fixed place: left out")
        if len(self.found) > before:
            for member in names:
                self.named[member, leaf.path] = self.found[before].name

    def _captured(self, leaf: p.NodePath, node: p.FromIdentifier, base: DbcSignal) -> None:
        bits = node.place
        part, constant = (bits[node.shift :], node.constant >> node.shift) if node.is_alone else (bits, 0)
        base.offset = -constant
        base.names = {raw + constant: text for raw, text in node.value_names.items()}
        if (scale := node.scale) is not None:
            base.scale, base.offset = scale.scale, scale.offset - constant * scale.scale
        base.unit = ProblemText.clean(node.unit)
        self._place(leaf.identifier, part, base)

    def _scalar(self, leaf: p.NodePath, node: p.Scalar, base: DbcSignal, name: str, is_shared: bool) -> None:
        own = (
            leaf.identifier
            if is_shared or base.when is None or len(self.plans) == 1
            else f"{name}_{leaf.identifier}"
        )
        if node.size is None:
            self._lose(name, leaf.path, "bytes of open size: left out")
            return
        bits = node.place
        if node.is_bytes:
            self._lose(name, leaf.path, f"{node.kind}, kept as a raw number, low byte first")
            for index, start in enumerate(range(0, len(bits), WIDEST)):
                part = own if len(bits) <= WIDEST else f"{own}_{index}"
                self._place(part, bits[start : start + WIDEST], replace(base))
            return
        if len(bits) > WIDEST:
            self._lose(name, leaf.path, f"a number of {len(bits)} bits: left out")
            return
        scale = node.scale
        if node.is_magnitude:
            self._lose(name, leaf.path, "sign and magnitude: kept as raw, the top bit is the sign")
        elif flags := node.flag_names:
            self._flags(own, node, flags, base)
            return
        elif not _is_run(bits):
            self._lose(name, leaf.path, "one number in several places: its pieces are kept as raw")
            for first, at, width in runs_of(bits):
                self._place(f"{own}_bit{at}", range(first, first + width), replace(base))
            return
        elif node.kind == "float" and len(bits) not in (32, 64):
            self._lose(name, leaf.path, f"a float of {len(bits)} bits: kept as raw")
        else:
            base.is_signed, base.is_float = node.kind == "int", node.kind == "float"
            base.names = {} if base.is_float else node.value_names
            base.unit = ProblemText.clean(node.unit)
            if scale is not None:
                self._scaled(leaf, scale, base, name)
            if node.by_bit is not None:
                base.unit = ""
                self._lose(name, leaf.path, "two scales, of which its highest bit chooses: kept as raw")
        if node.is_magnitude and not _is_run(bits):
            for first, at, width in runs_of(bits):
                self._place(f"{own}_bit{at}", range(first, first + width), replace(base))
            return
        self._place(own, bits, base)

    def _scaled(self, leaf: p.NodePath, scale: p.Scale, base: DbcSignal, name: str) -> None:
        base.scale, base.offset = scale.scale, scale.offset
        if scale.limits is not None:
            base.low, base.high = scale.limits
        if scale.unknown and base.is_float:
            self._lose(name, leaf.path, "values that mean `not known`: numbers like any other")
        elif isinstance(scale.unknown, range):
            self._lose(
                name, leaf.path, "values that mean `not known`: too many to be named, numbers like any other"
            )
        elif scale.unknown:
            self._lose(name, leaf.path, "values that mean `not known`: named so")
            base.names |= {int(value): "not known" for value in scale.unknown}
        if scale.rounding != "nearest":
            self._lose(name, leaf.path, f"sent numbers are rounded ({scale.rounding}): not said")

    def _flags(self, own: str, node: p.Scalar, flags: dict[int, str], base: DbcSignal) -> None:
        """Add a signal of one bit for each flag, and one for each run of bits without a name."""
        bits = node.place
        for bit, flag in flags.items():
            self._place(f"{own}_{flag}", bits[bit : bit + 1], replace(base))
        rest = [bit for bit in range(len(bits)) if bit not in flags]
        for first, _, width in runs_of(rest):
            for start, at, size in runs_of(bits[first : first + width]):
                self._place(f"{own}_bit{first + at}", range(start, start + size), replace(base))

    def _place(self, own: str, bits: Sequence[int], base: DbcSignal) -> None:
        found = runs_of(bits)
        base.name = dbc_name(own, self.taken)
        base.width = len(bits)
        if len(found) == 1:
            base.start = found[0][0]
        else:
            base.start, base.is_big = bits[-1], True
        self.found.append(base)


def _is_run(bits: Sequence[int]) -> bool:
    """Return whether a DBC can place these bits: one behind the other, in either of its orders."""
    turned = [bit ^ 7 for bit in bits]
    return len(runs_of(bits)) == 1 or all(b == a - 1 for a, b in pairwise(turned))
