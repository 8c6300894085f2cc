"""Proofs about one message: its generated decoder gives what the declaration says, its encoder gives the bytes back.

1. Every length that a frame or packet can have is one search; every path of it is claimed.
2. A decoder whose record has many choices is run value by value: its own text, cut at the commas of the record. The cut is
   made only where no value uses a name that another one assigns.
"""

from __future__ import annotations

import ast
import linecache
import random
import struct
import types
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any, NamedTuple, cast

import msgspec
import z3

from aces_bus.frames import FD, FD_LENGTHS, key_of
from aces_bus.protocol import Delimited, Message, Variant
from aces_bus.protocol.encoder import USUAL_FAILURES
from aces_bus.testing.laws import Way

from .meaning import Captures, holds, meaning
from .stand_ins import StandIns
from .symbols import (
    NoAnswer,
    NotProvable,
    PathSearch,
    Refuted,
    SymbolicBytes,
    SymbolicInt,
    SymbolicRecord,
    same_value,
)

TRANSPORT = ("time", "channel", "raw", "rx")
#: Records with more conditional values than this are proved value by value.
MOST_CHOICES = 4
#: Longest packets that are looked at, in bytes.
LONGEST = 40


class Witness(NamedTuple):
    """Bytes on which a claim fails: a frame's key and data, or a packet's bytes without stuffing (key None).

    Where they are a whole stream, `way` is the direction in which it is scanned.
    """

    what: str
    key: int | None
    data: bytes
    way: Way = None


class FailedClaim(Exception):
    """A claim failed; the argument is its `Witness`."""

    @property
    def witness(self) -> Witness:
        return self.args[0]  # type: ignore[no-any-return]


def proof_lengths(message: Message) -> tuple[list[int], str]:
    """Return the lengths of a message's data that are looked at, and how that is bounded; empty where it is all of them."""
    framing = message.framing
    if framing is None and message.transport is None:
        return list(FD_LENGTHS if message.fd else range(9)), ""
    if framing is None:
        most = message.transport.longest if message.transport is not None else 0
        declared = [size for size in message.lengths or () if size <= LONGEST]
        sizes = sorted({*range(min(most, max([8, *declared])) + 1)})
        is_cut = len(declared) < len(message.lengths or ())
    else:
        most = framing.max_size
        needed = message.payload_start + message.least + framing.check_size + len(framing.end)
        is_open = is_open_ended(message)
        longest = max(LONGEST, needed + LONGEST // 2) if is_open else LONGEST
        sizes = list(range(framing.min_size, min(most, longest) + 1))
        if not is_open and needed > LONGEST:
            sizes = sorted({*sizes, *range(needed - 2, min(most, needed + 3) + 1)})
        sizes = [size for size in sizes if not size % framing.multiple]  # a scanner hands over no others
        is_cut = is_open and most > longest
    return sizes, f"packets of up to {max(sizes)} bytes of {most}" if is_cut else ""


def is_open_ended(message: Message) -> bool:
    """Return whether a message's payload has no greatest size."""
    from aces_bus.protocol.declare.normalise import sizes

    return sizes(message.payload)[1] is None


def base_of(message: Message) -> int:
    """Return the flags in a message's keys."""
    return key_of(0, extended=message.extended, remote=message.remote, fd=message.fd)


class SymbolicPacket:
    """One message of a variant with everything symbolic about it: bytes of one length, the parts of its identifier."""

    def __init__(self, message: Message, size: int, prefix: str = "") -> None:
        self.message, self.size = message, size
        self.data = SymbolicBytes.named("byte", size)
        self.captures = Captures(message, base_of(message), prefix)
        self.key: Any = self.captures.key if message.framing is None else SymbolicInt.of(0)
        self.request = {name: object() for name in message.request_fields} or None
        self.given = list(self.captures.given)
        framing = message.framing
        if framing is not None:
            self.given += [cell == byte for cell, byte in zip(self.data.cells, framing.sync, strict=False)]

    def meaning(self, *, raw: bool, request: Any = None) -> dict[str, Any] | None:
        return meaning(self.message, self.data, self.captures.numbers, raw=raw, key=self.key, request=request)

    def witness(self, what: str, model: z3.ModelRef) -> Witness:
        """Return the bytes of a counterexample."""

        def number(term: Any) -> int:
            return int(model.eval(z3.simplify(term), model_completion=True).as_long())

        data = bytes(number(cell) for cell in self.data.cells)
        if self.message.framing is not None:
            return Witness(what, None, data)
        return Witness(what, number(self.key.term) & 0xFFFF_FFFF, data)


# ---------------------------------------------------------------------- decoders


def source_of(function: types.FunctionType) -> str:
    """Return the generated text that a function is from."""
    return "".join(linecache.getlines(function.__code__.co_filename))


def parts_of_function(function: types.FunctionType) -> list[types.FunctionType]:
    """Return the function itself, or where its record has many choices a function for each of its values; see the module."""
    tree = ast.parse(source_of(function))
    node = next(n for n in tree.body if isinstance(n, ast.FunctionDef) and n.name == function.__name__)
    final = node.body[-1]
    if not isinstance(final, ast.Return) or not isinstance(final.value, ast.Call):
        return [function]
    if sum(isinstance(inner_node, ast.IfExp) for inner_node in ast.walk(final)) <= MOST_CHOICES:
        return [function]
    leaves = list(_leaves(final.value, (), function.__globals__))
    names = [_names(leaf) for _, leaf in leaves]
    assigned = set[str]().union(*(stored for _, stored in names))
    if any(loaded & assigned - stored for loaded, stored in names):
        return [function]
    plain = [leaf for leaf in leaves if not any(isinstance(n, ast.IfExp) for n in ast.walk(leaf[1]))]
    groups = [plain, *([leaf] for leaf in leaves if leaf not in plain)]
    made: list[types.FunctionType] = []
    for group in groups:
        pairs: list[ast.expr] = [
            ast.Tuple([ast.Constant(cast(Any, path)), leaf], ast.Load()) for path, leaf in group
        ]
        value = ast.Call(ast.Name("Piece", ast.Load()), [ast.Tuple(pairs, ast.Load())], [])
        body = [*node.body[:-1], ast.Return(value)]
        part = ast.Module([ast.FunctionDef(node.name, node.args, body, [], lineno=1, col_offset=0)], [])
        code = compile(ast.fix_missing_locations(part), function.__code__.co_filename, "exec")
        inner = next(constant for constant in code.co_consts if isinstance(constant, types.CodeType))
        made.append(types.FunctionType(inner, function.__globals__, function.__name__, function.__defaults__))
    return made


def _leaves(
    node: ast.expr, path: tuple[Any, ...], names: dict[str, Any]
) -> Iterator[tuple[tuple[Any, ...], ast.expr]]:
    """Yield the values of a record with their paths: through nested records and tuples."""
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and not node.keywords:
        kind = names.get(node.func.id)
        if isinstance(kind, type) and issubclass(kind, msgspec.Struct):
            for name, inner in zip(kind.__struct_fields__, node.args, strict=True):
                yield from _leaves(inner, (*path, name), names)
            return
    if isinstance(node, ast.Tuple):
        for index, inner in enumerate(node.elts):
            yield from _leaves(inner, (*path, index), names)
        if not node.elts:
            yield path, node
        return
    yield path, node


def _names(node: ast.expr) -> tuple[set[str], set[str]]:
    """Return the names that an expression uses, and those that it assigns."""
    named = [part for part in ast.walk(node) if isinstance(part, ast.Name)]
    loaded = {part.id for part in named if isinstance(part.ctx, ast.Load)}
    return loaded, {part.id for part in named if isinstance(part.ctx, ast.Store)}


class Piece:
    """Some values of a record, by their paths."""

    def __init__(self, pairs: tuple[tuple[tuple[Any, ...], Any], ...]) -> None:
        self.pairs = pairs


def prove_decoder(
    message: Message,
    function: types.FunctionType,
    search: PathSearch,
    sizes: Sequence[int],
    *,
    raw: bool,
    quick: bool,
) -> None:
    """Prove that a generated decode function gives the declared values; raise `FailedClaim` with a witness.

    A `quick` function may raise `struct.error` where another one refuses.
    """
    message_holds = (lambda data, key: holds(message, data, key)) if message.check is not None else None
    stand_ins = StandIns(message, message_holds)
    marks = {name: object() for name in TRANSPORT}
    runs = [stand_ins.function(piece) for piece in parts_of_function(function)]
    for run in runs:
        run.__globals__["Piece"] = Piece
    for size in sizes:
        for request in [None, "asked"] if message.request_fields else [None]:
            packet = SymbolicPacket(message, size)
            asked = packet.request if request else None
            for run in runs:
                try:
                    search.run(
                        partial(_decoded_as_meant, run, packet, asked, search, marks, raw, quick),
                        packet.given,
                    )
                except Refuted as refuted:
                    raise FailedClaim(packet.witness(str(refuted), refuted.model)) from None
        search.reached = size


def _decoded_as_meant(
    run: Callable[..., Any],
    packet: SymbolicPacket,
    asked: Any,
    search: PathSearch,
    marks: dict[str, object],
    raw: bool,
    quick: bool,
) -> None:
    """Claim on one path that a decode function gives what the declaration says."""
    more = (asked,) if asked is not None else ()
    try:
        got = run(packet.data, packet.key, marks["time"], marks["channel"], marks["raw"], marks["rx"], *more)
    except struct.error:
        if not quick:
            search.fail("the decoder raises struct.error")
        got = None
    except (NoAnswer, NotProvable, Refuted):
        raise
    except Exception as error:
        search.fail(f"the decoder raises {type(error).__name__}: {error}")
    want = packet.meaning(raw=raw, request=asked)
    if (got is None) is not (want is None):
        refuses = "the decoder refuses what the declaration accepts"
        search.fail(refuses if got is None else "the decoder accepts what the declaration refuses")
    if want is not None:
        search.accepted += 1
        _claim_same(search, got, _expected(packet.message, want, packet, marks))


def _expected(
    message: Message, want: dict[str, Any], packet: SymbolicPacket, marks: dict[str, object]
) -> dict[str, Any]:
    found = {name: want[name] for name in message.fields}
    more = {"_time": "time", "_channel": "channel", "_raw": "raw", "_rx": "rx"}
    return {**found, **{name: marks[mark] for name, mark in more.items()}, "_key": packet.key}


def _claim_same(search: PathSearch, got: Any, want: dict[str, Any]) -> None:
    pairs: list[tuple[str, Any, Any]] = []
    if type(got) is Piece:
        for path, value in got.pairs:
            inner: Any = want
            for step in path:
                if type(inner) is SymbolicRecord or not isinstance(inner, dict | list | tuple):
                    search.fail(f"{path}: not there")
                inner = inner[step]
            pairs += _pairs(".".join(map(str, path)), value, inner)
    elif type(got) is SymbolicRecord:
        if list(got.values) != [*list(want)[: len(want) - 5], "_time", "_channel", "_key", "_raw", "_rx"]:
            search.fail(f"fields {list(got.values)} instead of {list(want)}")
        for name, value in got.values.items():
            pairs += _pairs(name, value, want[name])
    else:
        search.fail("not a record")
    claims: list[tuple[str, z3.BoolRef]] = []
    for name, mine, theirs in pairs:
        found = same_value(mine, theirs)
        if isinstance(found, str):
            search.fail(f"{name}: {found}")
        claims.append((name, found))
    try:
        search.claim(z3.And(*[claim for _, claim in claims]), "")
    except Refuted as refuted:
        wrong = [
            name for name, claim in claims if not z3.is_true(refuted.model.eval(claim, model_completion=True))
        ]
        raise Refuted(f"{', '.join(wrong)}: another value than the declaration's", refuted.model) from None


def _pairs(name: str, got: Any, want: Any) -> Iterator[tuple[str, Any, Any]]:
    """Yield pairs of single values in two values of a record; a nested record or list of another shape is one pair."""
    if isinstance(want, dict) and type(got) is SymbolicRecord and list(got.values) == list(want):
        for inner in want:
            yield from _pairs(f"{name}.{inner}", got.values[inner], want[inner])
    elif isinstance(want, list | tuple) and isinstance(got, tuple) and len(got) == len(want):
        for index, (mine, theirs) in enumerate(zip(got, want, strict=True)):
            yield from _pairs(f"{name}.{index}", mine, theirs)
    else:
        yield name, got, want


# ---------------------------------------------------------------------- encoders


def prove_encoder(
    message: Message, function: Callable[[dict[str, Any]], Any], search: PathSearch, sizes: Sequence[int]
) -> None:
    """Prove that the generated encoder gives back the bytes of every packet, or leaves it to construct.

    The fields are those that the declaration reads out of symbolic bytes, in physical units; the length and the check of a
    stream's packet are the framing's.
    """
    stand_ins = StandIns(message)
    assert isinstance(function, types.FunctionType)
    run = stand_ins.function(function)
    framing = message.framing
    tail = framing.check_size + len(framing.end) if framing is not None else 0
    # Length and check in the header are zero here: the framing writes them.
    derived = [head for head in framing.heads if head.name in framing.derived] if framing is not None else []
    start = len(framing.sync) if framing is not None else 0
    taken = 0
    for size in sizes:
        packet = SymbolicPacket(message, size)

        def body(packet: SymbolicPacket = packet, size: int = size) -> None:
            nonlocal taken
            want = packet.meaning(raw=False)
            if want is None:
                return
            fields = {
                name: _given(want[name]) for name in message.fields if name not in message.request_fields
            }
            try:
                identifier, head, rest = run(fields)
            except (NoAnswer, NotProvable, Refuted):
                raise
            except USUAL_FAILURES:
                return  # construct builds it, or refuses it
            built = SymbolicBytes.of(head) + SymbolicBytes.of(rest)  # type: ignore[operator]
            known = packet.data[start : size - tail]
            for own in derived:
                at = own.offset - start
                known = known[:at] + bytes(own.size) + known[at + own.size :]
            if len(built) != len(known):
                search.fail(f"the encoder builds {len(built)} bytes of {len(known)}")
            conditions = [built.same(known)]
            if framing is None:
                number = SymbolicInt.of(identifier)
                if number is None:
                    search.fail("the encoder gives no identifier")
                assert number is not None
                conditions.append((number == (packet.key & 0x1FFF_FFFF)).term)
            search.claim(
                z3.Or(z3.And(*conditions), *search.exempt), "the encoder builds other bytes than were decoded"
            )
            taken += 1

        try:
            search.run(body, packet.given)
        except Refuted as refuted:
            raise FailedClaim(packet.witness(str(refuted), refuted.model)) from None
        search.reached = size
        search.accepted = taken
    if not taken:
        raise NotProvable("the generated encoder leaves every packet to construct")


def _given(value: Any) -> Any:
    """Return a value of the declaration as a caller gives it."""
    return tuple(map(_given, value)) if isinstance(value, list) else value


def decoders(variant: Variant, name: str) -> list[tuple[types.FunctionType, bool, bool]]:
    """Return the decode functions of a message: (function, raw, quick)."""
    from aces_bus.protocol.generate.load import decoders_of

    return [
        (decoders_of(variant, raw, not quick)[name], raw, quick)  # type: ignore[misc]
        for raw in (False, True)
        for quick in (False, True)
    ]


def drawn(message: Message, sizes: Sequence[int], count: int) -> Iterator[Witness]:
    """Draw packets of a message: its constants, and behind them anything; always the same packets."""
    chance = random.Random(f"{message.protocol.name}.{message.name}")
    framing = message.framing
    is_text = isinstance(message.payload, Delimited)
    texts = [example.packet.data for example in message.examples] or [_text_of(message)] if is_text else []
    low = (
        message.payload_start
        + message.least
        + (framing.check_size + len(framing.end) if framing is not None else 0)
    )
    fitting = [size for size in sizes if size >= low] or list(sizes)
    for _ in range(count):
        size = chance.choice(fitting)
        data = bytearray(chance.choice((chance.randbytes(size), bytes(size), b"\xff" * size)))
        for at in range(size):
            if chance.random() < 0.3:
                data[at] = chance.choice((0, 1, 2, 3, 0x7F, 0x80, 0xFF, chance.randrange(256)))
        if texts and message.framing is not None:
            yield Witness("drawn", None, _other_digits(message.framing.logical(chance.choice(texts)), chance))
            continue
        if framing is not None:
            data[: len(framing.sync)] = framing.sync
        for head in message.heads_written:
            if head.pattern is not None and head.offset + head.size <= size:
                number = head.pattern.number(
                    {c.name: chance.choice(list(c.values)) for c in head.pattern.captures}
                )
                data[head.offset : head.offset + head.size] = head.bytes(number)
        for offset, wanted in message.constants:
            data[offset : offset + len(wanted)] = wanted
        key = None
        if framing is None:
            parts = {c.name: chance.choice(tuple(c.values)[:4096]) for c in message.identifier.captures}
            key = message.identifier.number(parts) | base_of(message)
        yield Witness("drawn", key, bytes(data[:size]))


def _text_of(message: Message) -> bytes:
    """Return a packet of delimited text with something in each field."""
    payload, framing = message.payload, message.framing
    assert isinstance(payload, Delimited)
    assert framing is not None
    head = b"".join(
        own.bytes(own.pattern.number({c.name: min(c.values) for c in own.pattern.captures}))
        for own in message.heads_written
        if own.pattern is not None
    )
    texts = (
        next(t for t in ("10.25", "102", "10", "") if field.subcon.accepts(t)) for field in payload.fields
    )
    body = payload.separator * payload.lead + payload.separator.join(text.encode() for text in texts)
    return message.struct.framed(framing, head, body)


def _other_digits(data: bytes, chance: random.Random) -> bytes:
    """Return a text with some of its digits changed."""
    return bytes(
        chance.choice(b"0123456789") if 48 <= byte <= 57 and chance.random() < 0.3 else byte for byte in data
    )


__all__ = [
    "FD",
    "FailedClaim",
    "SymbolicPacket",
    "Witness",
    "decoders",
    "drawn",
    "proof_lengths",
    "prove_decoder",
    "prove_encoder",
]
