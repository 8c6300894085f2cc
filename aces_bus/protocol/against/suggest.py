"""Worked examples out of a recording, for the author to confirm: bytes that a device sent, and what the spec makes of them.

1. The bytes are the recording's; the fields are the spec's own reading, which the author holds against the sheet. Until then
   they prove nothing.
2. An example that is suggested holds: it is read, written and recognised as `aces spec check` asks it.
"""

from __future__ import annotations

import json
import math
from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from ...frame_table import FrameTable
from ..columns.decode import capture_pieces
from ..declare.examples import Example, ExampleFrame
from ..declare.fields import FlagSet
from ..declare.message import GivenWay, Message, Way, way_of
from ..declare.protocol import Variant
from ..lint.examples import failure, read_example
from ..live.scanner import make_scanner
from ..protocol import Protocol
from ..record import Meta, Record, Unknown, field_names, plain_value
from ..record_plans import message_of

#: Candidates of a message that are kept, and requests of a kind and channel.
CANDIDATES, REQUESTS = 6, 8
#: Digits of floats: more than examples are compared by.
DIGITS = 9


@dataclass(frozen=True)
class SuggestedExample:
    """An example of a message, of which the recordings have `count`; `source` is how a spec writes it among `examples`."""

    message: Message
    example: Example
    count: int

    @property
    def source(self) -> str:
        """`("001#05 24 07", {"board": 5}),`"""
        example = self.example
        shown = [example.packet] if example.request is None else [example.packet, example.request]
        first, *request = (_literal(packet.data if _is_text(packet) else str(packet)) for packet in shown)
        if example.frames:
            first = _literal([str(frame) for frame in example.frames])
        return f"({', '.join([first, _literal(example.fields), *request])}),"


def _is_text(packet: ExampleFrame) -> bool:
    """Return whether a packet reads better as characters."""
    return packet.identifier is None and str(packet).startswith(("b'", 'b"'))


@dataclass
class _Candidates:
    """The messages of one kind that may become an example: those of which most fields say something."""

    count: int = 0
    best: list[
        tuple[int, ExampleFrame, Mapping[str, Any], tuple[ExampleFrame, ...], tuple[ExampleFrame, ...]]
    ] = field(default_factory=list)


def suggest_examples(
    spec: Protocol | Variant | Sequence[Variant],
    captures: Iterable[Any],
    *,
    direction: GivenWay | None = None,
    each: int = 1,
) -> list[SuggestedExample]:
    """Return up to `each` examples of every message that recordings have, in declared order; replies with
    their requests.

    The arguments and errors are those of `check_recordings`. Of all messages of a kind those are taken of which most fields
    are neither 0 nor empty, nor equal to one another.
    """
    variants = _variants(spec)
    found: dict[tuple[str | None, str], _Candidates] = {}
    for capture in captures:
        asked: dict[tuple[str | None, str], deque[ExampleFrame]] = {}
        for record in _records(variants, capture, way_of(direction)):
            _take(record, found, asked)
    suggested: list[SuggestedExample] = []
    for variant in variants:
        for message in variant.messages.values():
            candidates = found.get((variant.name, message.name))
            if candidates is not None:
                suggested += list(_holding(variant, message, candidates))[:each]
    return suggested


def _variants(spec: Protocol | Variant | Sequence[Variant]) -> Sequence[Variant]:
    if isinstance(spec, Protocol):
        return [spec.variant()]
    return [spec] if isinstance(spec, Variant) else spec


def _records(variants: Sequence[Variant], capture: Any, direction: Way | None) -> Iterator[Record]:
    scanners: dict[Way | None, Any] = {}
    for traffic, stated, _ in capture_pieces(capture, variants[0]):
        way = direction or stated
        if way not in scanners:
            scanners[way] = make_scanner(list(variants), direction=way)
        yield from scanners[way].feed(traffic.frames() if isinstance(traffic, FrameTable) else traffic)
    for scanner in scanners.values():
        yield from scanner.close()


def _take(
    record: Record,
    found: dict[tuple[str | None, str], _Candidates],
    asked: dict[tuple[str | None, str], deque[ExampleFrame]],
) -> None:
    if isinstance(record, Unknown):
        return
    meta, message = record.meta, message_of(type(record))
    name = message.name
    packet = _packet(meta)
    candidates = found.setdefault((meta.protocol, name), _Candidates())
    candidates.count += 1
    asked.setdefault((meta.channel, name), deque(maxlen=REQUESTS)).append(packet)
    fields = {field_name: _plain(getattr(record, field_name)) for field_name in field_names(type(record))}
    worth = len({repr(value) for value in _values(fields) if value not in (0, None, b"", "")})
    if len(candidates.best) == CANDIDATES and worth <= candidates.best[-1][0]:
        return
    requests = tuple(
        reversed(
            [
                packet
                for request in (*message.reply_to, *message.after)
                for packet in asked.get((meta.channel, request.message.name), ())
            ]
        )
    )
    shown = {field_name: value for field_name, value in fields.items() if _is_literal(value)}
    candidates.best.append((worth, packet, shown, requests, _frames(message, meta)))
    candidates.best.sort(key=lambda candidate: -candidate[0])
    del candidates.best[CANDIDATES:]


def _packet(meta: Meta) -> ExampleFrame:
    if meta.identifier is None:
        return ExampleFrame(meta.raw)
    return ExampleFrame(meta.raw, meta.identifier, meta.extended, meta.remote, meta.fd)


def _frames(message: Message, meta: Meta) -> tuple[ExampleFrame, ...]:
    """Return the frames that a transport carried a packet in, where they have its identifier."""
    is_fd = message.transport is not None and message.transport.fd
    return tuple(ExampleFrame(data, meta.identifier, meta.extended, fd=is_fd) for data in meta.frames)


def _holding(variant: Variant, message: Message, candidates: _Candidates) -> Iterator[SuggestedExample]:
    seen: set[ExampleFrame] = set()
    for _, packet, fields, requests, frames in candidates.best:
        if packet in seen:
            continue
        seen.add(packet)
        alone = Example(packet, fields, frames=frames)
        # A request is only in the way where the reply is recognised without.
        is_clear = not requests or read_example(variant, message, alone).message == message.name
        for example in (
            [alone]
            if is_clear
            else [*(Example(packet, fields, request, frames) for request in requests), alone]
        ):
            if failure(message, example) is None:
                yield SuggestedExample(message, example, candidates.count)
                break


def _plain(value: Any) -> Any:
    """Return a value as examples have it: flags as their names, short floats."""
    if isinstance(value, FlagSet):
        return int(value) if value.unknown else list(value)
    value = plain_value(value)
    if isinstance(value, list):
        return [_plain(inner) for inner in value]
    if isinstance(value, dict):
        return {name: _plain(inner) for name, inner in value.items()}
    if isinstance(value, float) and math.isfinite(value):
        return float(f"{value:.{DIGITS}g}")
    return value


def _values(value: Any) -> Iterator[Any]:
    """Yield the single values of nested ones."""
    if isinstance(value, Mapping):
        for inner in value.values():
            yield from _values(inner)
    elif isinstance(value, list):
        for inner in value:
            yield from _values(inner)
    else:
        yield value


def _is_literal(value: Any) -> bool:
    return all(
        inner is None
        or isinstance(inner, (bool, int, str, bytes))
        or (isinstance(inner, float) and math.isfinite(inner))
        for inner in _values(value)
    )


def _literal(value: Any) -> str:
    """Return a value as Python source."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{_literal(name)}: {_literal(inner)}" for name, inner in value.items()) + "}"
    if isinstance(value, list):
        return f"[{', '.join(map(_literal, value))}]"
    if isinstance(value, str):
        return json.dumps(value)
    return repr(value)
