"""Declared specs: examples, ambiguity, ranges, fields that may be absent, checks."""

from __future__ import annotations

import ast
import random
import struct
from collections.abc import Callable
from functools import cache, reduce
from operator import xor
from pathlib import Path
from typing import Any

import construct as c
import pytest
from construct import (
    Byte,
    Const,
    Construct,
    ExprAdapter,
    GreedyBytes,
    GreedyRange,
    Int16ub,
    Int16ul,
    LazyBound,
    StopIf,
    Struct,
    Switch,
    core,
    this,
)

from aces_bus import Frame, Unknown, as_dict, load_protocol, make_scanner, open_recording
from aces_bus.protocol import (
    Enumeration,
    FastPacket,
    IdField,
    IsoTp,
    Present,
    Protocol,
    Sum,
)
from aces_bus.protocol.against import check_recordings
from aces_bus.protocol.against.losses import GROUPS
from aces_bus.protocol.against.suggest import suggest_examples
from aces_bus.protocol.declare import vocabulary
from aces_bus.protocol.declare.checks import xor_of
from aces_bus.protocol.declare.examples import Example, as_examples, parse_packet
from aces_bus.protocol.declare.packet import can_image
from aces_bus.protocol.exchange import print_source
from aces_bus.protocol.exchange.dbc_signals import identified
from aces_bus.protocol.generate.load import print_decoders, print_records
from aces_bus.protocol.lint.examples import agree, example_frame, failure
from aces_bus.protocol.live.stream import StreamScanner
from aces_bus.protocol.plan.flatten import (
    _numbers,  # pyright: ignore[reportPrivateUsage]  # a plan of a stream's head
    flatten,
)
from aces_bus.testing import Scene
from aces_bus.testing.packets import draw_packet
from aces_bus.testing.source import spread
from aces_protocols.hubo.spec import hubo
from aces_protocols.robotis.spec import robotis
from tests.laws.drawn import ORACLE
from tests.laws.wires import PROTOCOLS
from tests.protocol.test_against import one_message as one_message
from tests.protocol.test_transports import frames_of as frames_of
from tests.specs.catalogue import SPECS

EXAMPLES = Path(__file__).resolve().parents[3] / "examples" / "captures"
_PAIR = Struct("x" / Byte, "y" / Byte)
GENERATED = ["canopen", "hubo", "hubovia", "minihubo_adc", "pololu_qik", "robotis"]
Declare = Callable[[Protocol], None]


#: What random values of a sound spec must never look like.
DRAWN = {"byte-order", "sign", "check", "counter"}


@pytest.mark.slow
@pytest.mark.parametrize("name", ["hubo", "robotis", *SPECS])
def test_random_values_are_no_quantities(name: str) -> None:
    """Messages with any values at all are not said to have another byte order, sign or check."""
    protocol = {"hubo": hubo, "robotis": robotis, **SPECS}[name]
    variant = protocol.variant()
    traffic: list[Any] = []
    for number, message in enumerate(list(variant.messages.values())[:8]):
        source = spread(number, 1 << 14)
        traffic += [one for _ in range(40) for one in draw_packet(message, source.branch(), variant).as_sent]
    if protocol.link != "can":
        traffic = [b"".join(traffic)]
    found = [one for one in check_recordings(variant, [traffic], direction="both") if one.rule in DRAWN]
    assert [str(one) for one in found if "malformed" not in one.text] == []


def test_memory_does_not_grow_with_what_is_unknown() -> None:
    """However many identifiers nobody declared there are, a bounded number of them is told apart."""
    from aces_bus.protocol.against.recording import RecordingCheck

    check = RecordingCheck(one_message(Struct("x" / Byte)))
    check.read([Frame(n, b"", None, is_extended_id=True) for n in range(3000)])
    (losses,) = check._losses.values()  # pyright: ignore[reportPrivateUsage]
    assert len(losses.groups) == GROUPS
    assert any("more identifiers" in one.text for one in check.observations())


def test_suggested_examples_hold() -> None:
    """What is suggested is the source of an example that holds, for every message that the recording has."""
    capture = open_recording(EXAMPLES / "robotis_session.bin", link="serial")
    found = suggest_examples(robotis, [capture], direction="both")
    names = [one.message.name for one in found]
    assert names == ["Ping", "Read", "Write", "RegWrite", "Action", "SyncWrite", "Status"]
    for one in found:
        (example,) = as_examples([ast.literal_eval(one.source.rstrip(","))], one.message.place, is_can=False)
        assert example == one.example
        assert failure(one.message, example) is None
        assert one.count > 0


def test_every_word_of_construct_is_decided() -> None:
    """Each public class of construct is known, looked into or refused: a new one cannot slip through."""
    classes = {
        value if isinstance(value, type) else type(value)
        for value in (*vars(c).values(), *vars(core).values())
        if isinstance(value, c.Construct) or (isinstance(value, type) and issubclass(value, c.Construct))
    }
    groups = (vocabulary.LEAVES, vocabulary.WALKED, frozenset(vocabulary.REFUSED))
    assert {kind.__name__ for kind in classes if sum(kind in group for group in groups) != 1} == set()
    assert frozenset().union(*groups) <= classes


def test_an_example_of_a_stream() -> None:
    """A packet with a wrong check is not this message; the right one holds."""
    for text, holds in (("A5 01 07 08", True), ("A5 01 07 09", False)):
        p = Protocol("probe", link="serial")
        framing = p.framing(
            sync=b"\xa5", header=Struct("length" / Byte), size=this.length + 3, max_size=258, check=Sum()
        )
        made = framing("A", payload=Struct("x" / Byte), examples=[(text, {"x": 7})])
        assert (failure(made, made.examples[0]) is None) is holds


def test_an_example_with_its_request() -> None:
    """A reply that hangs on a request is recognised with it; a request that is none, or the wrong one, is said."""
    p = Protocol("probe", link="can")
    ask = p.message("Ask", id=1, payload=Struct("what" / Byte))
    for name, what in (("A", 1), ("B", 2)):
        p.message(name, id=2, reply_to=ask.where(what=what), payload=Struct("x" / Int16ul))
    a, b = p["A"], p["B"]
    packet, fields = parse_packet("002#0102", is_can=True), {"x": 0x201, "what": 1}
    assert failure(a, Example(packet, fields, parse_packet("001#01", is_can=True))) is None
    assert failure(a, Example(packet, {"x": 0x201})) is None, "without its request it cannot be recognised"
    assert "is none of Ask(what=2)" in (
        failure(b, Example(packet, {}, parse_packet("001#01", is_can=True))) or ""
    )
    assert "answers none" in (failure(ask, Example(parse_packet("001#01", is_can=True), {}, packet)) or "")


@pytest.mark.parametrize(
    "name", [name for name, p in PROTOCOLS.items() if any(m.examples for m in p.declared)]
)
def test_scanners_and_encoders_agree_with_the_examples(name: str) -> None:
    """What is generated reads and writes each worked example as its source has it, in some dialect and configuration."""
    protocol = PROTOCOLS[name]
    for message in protocol.declared:
        for example in message.examples:
            assert failure(message, example) is None
            assert any(_scanned(variant, message, example) for variant in protocol.variants()), message


@cache
def _scanner(variant: Any, direction: Any) -> Any:
    return make_scanner([variant], direction=direction)


def _scanned(variant: Any, message: Any, example: Example) -> bool:
    if message.name not in variant.messages:
        return False
    scanner = _scanner(variant, message.direction if variant.link != "can" else None)
    scanner.reset()
    if variant.link == "can":
        before = [] if example.request is None else [example.request]
        records = scanner.feed(
            [example_frame(packet) for packet in [*before, *(example.frames or (example.packet,))]]
        )
        records = records[len(before) :]
    else:
        if example.request is not None:
            scanner.sent(example.request.data)
        records = scanner.feed(example.packet.data) + scanner.close()
    if [type(record).__name__ for record in records] != [message.name]:
        return False
    values = as_dict(records[0])
    if message.transport is not None:
        # The example has some sequence number.
        packets = (variant.encoder.numbered(number, message.name, **values) for number in range(32))
        shown = [frame.data for frame in example.frames]
        same = any(
            [bytes(frame.data) for frame in (made if isinstance(made, list) else [made])] == shown
            for made in packets
        )
    else:
        made = variant.encoder.encode(message.name, **values)
        same = (
            made == example.packet.data if variant.link != "can" else bytes(made.data) == example.packet.data
        )
        if str(example.packet).startswith("b"):
            # Numbers as characters may have more or fewer decimals than we would write, if they read the same.
            again = as_dict(scanner.feed(made)[0])
            same = all(agree(again[field], value) for field, value in values.items())
    return same and agree(values, example.fields)


def test_masks_that_never_repeat_cost_no_memory_without_end() -> None:
    """Each value of sixteen bits is decoded, by two tables of eight bits each."""
    from aces_bus.protocol.generate.shapes import ByBitsDecoder

    made = Protocol("many", link="serial")
    packet = made.framing(sync=b"$", header=Struct("m" / Int16ul), size="fields", max_size=40)
    packet("M", payload=Struct(*(f"x{n}" / Present("m", n, Byte) for n in range(16))))
    scanner = made.scanner()
    for mask in random.Random(3).sample(range(1 << 16), 3000):
        fields = random.Random(mask).randbytes(mask.bit_count())
        (record,) = scanner.feed(b"$" + struct.pack("<H", mask) + fields)
        values = iter(fields)
        for n in range(16):
            assert getattr(record, f"x{n}") == (next(values) if mask >> n & 1 else None)
    printed = ByBitsDecoder(made["M"], raw=False)
    printed.print()
    assert [len(found) for found in printed.module.bound.values() if isinstance(found, list)] == [256, 256]


def test_a_long_range_of_shifted_identifiers_is_met_exactly() -> None:
    """Of 5,000 identifiers, 32 apart, each is the message's, and none between, before or behind them is."""
    spec = Protocol("wide", link="can")
    node = IdField("node", range(0, 10_000, 2))
    message = spec.message("M", id=(node << 4) | 5, extended=True, payload=Struct("a" / Byte))
    numbers: Any = _numbers(message.identifier)
    assert numbers == range(5, 9_998 * 16 + 6, 32)
    assert [*numbers] == sorted(message.identifier)
    scanner = spec.scanner(include_unknown=True)
    for identifier, found in (
        *((5, 0), (5 | 2 << 4, 2), (5 | 5_000 << 4, 5_000), (5 | 9_998 << 4, 9_998)),
        *((5 | 1 << 4, None), (5 | 10_000 << 4, None), (4, None), (6 | 2 << 4, None), (0, None)),
    ):
        frame = Frame(identifier, b"\1", is_extended_id=True)
        (item,) = scanner.feed([frame])
        assert (None if isinstance(item, Unknown) else item.node) == found, hex(identifier)
        ORACLE(spec.variant(), None, Scene((frame,)))


@pytest.mark.parametrize(
    "nested",
    [
        LazyBound(lambda: _PAIR),
        GreedyRange(Struct("a" / Byte, "stop" / StopIf(this.a == 0), "b" / Byte)),
        ExprAdapter(Byte, lambda number, context: {"a": number}, lambda value, context: value["a"]),
        ExprAdapter(Byte, lambda number, context: {number: 1, "class": 2}, lambda value, context: 0),
    ],
    ids=["lazy", "stopped half way", "adapted", "no names"],
)
def test_nested_records_that_no_walk_foresees(nested: Construct) -> None:
    """Their types were looked up by path and fields; what was not listed raised, and the frame was lost."""
    made = Protocol("nested", link="can")
    message = made.message("Nested", id=1, payload=Struct("n" / nested, "rest" / GreedyBytes))
    for data in (b"\x01\x02", b"\x01\x00", b"\x00", b"\x05\x06\x00"):
        (record,) = made.scanner(include_unknown=True).feed([Frame(1, data)])
        try:
            message.struct.parse(can_image(1, data))
        except Exception:
            assert isinstance(record, Unknown)
        else:
            assert as_dict(record)["n"] is not None


def test_a_switch_over_names_works_in_raw_mode() -> None:
    """A case under a name was not found by its number, which is what raw mode has: the laws compared two readings."""
    kind = Enumeration(Byte, short=1, long=2)
    made = Protocol("chosen", link="can")
    for number, keys in ((1, ("short", "long")), (2, (1, 2))):
        cases = Switch(this.kind, {keys[0]: Byte, keys[1]: Int16ul}, default=GreedyBytes)
        made.message(f"M{number}", id=number, payload=Struct("kind" / kind, "data" / cases))
        image = can_image(number, b"\x02\x34\x12")
        assert made[f"M{number}"].struct.parse(image).data == 0x1234
        assert made[f"M{number}"].struct.parse(image, raw=True).data == 0x1234
        (record,) = made.scanner().feed([Frame(number, b"\x02\x34\x12")])
        assert (record.kind, record.data) == ("long", 0x1234)
        assert bytes(made.encode(f"M{number}", kind="long", data=0x1234).data) == b"\x02\x34\x12"


def test_exclusive_or_of_any_length() -> None:
    """Folding gives what going through the bytes gives."""
    for size in (*range(70), 255, 256, 257, 1000):
        data = bytes((7 * n * n + size) % 256 for n in range(size))
        assert xor_of(data) == reduce(xor, data, 0)


def test_a_recording_does_not_contradict_and_suggests() -> None:
    """Frames that steer or came twice say nothing against a spec; a packet becomes an example."""
    protocol = Protocol("car", link="can")
    uds = IsoTp(to_device=0x7E0, from_device=0x7E8)
    payload = Struct("service" / Const(0x62, Byte), "did" / Int16ub, "data" / GreedyBytes)
    protocol.message("Data", transport=uds, direction="from device", payload=payload)
    packets = [protocol.encode("Data", did=k, data=bytes(range(k, k + 12))) for k in range(20)]
    frames = [
        frame
        for packet in packets
        for frame in (packet[0], *frames_of(0x7E0, "30 00 00"), *packet[1:], packet[-1])
    ]
    recorded = [Frame(f.arbitration_id, bytes(f.data), 0.01 * n) for n, f in enumerate(frames)]
    assert [one for one in check_recordings(protocol.variant(), [recorded]) if one.level != "note"] == []
    (suggested,) = suggest_examples(protocol, [recorded])
    assert len(suggested.example.frames) == 3
    assert failure(suggested.message, suggested.example) is None
    assert "7E8#10 0F 62 00" in suggested.source


def test_sources_have_transports_and_databases_leave_them_out() -> None:
    """What is printed as a spec says what carries a message; a DBC says that it does not have it."""
    protocol = Protocol("boat", link="can")
    protocol.message(
        "Packet",
        transport=FastPacket(timeout_s=2.0),
        id=0x0DF80505,
        extended=True,
        payload=Struct("a" / Byte),
    )
    assert "transport=FastPacket(timeout_s=2.0)" in print_source(protocol)
    _, losses = identified(protocol.variant())
    assert [str(loss) for loss in losses if "fast packet" in str(loss)]


Golden = Callable[[str, str], None]


@pytest.mark.parametrize("name", GENERATED)
def test_generated_source_is_golden(name: str, golden: Golden) -> None:
    """What the printers print for our protocols changes only on purpose."""
    variant = load_protocol(name).variant()
    golden(
        f"{name}/records.py.txt",
        print_records(variant.label, [flatten(m) for m in variant.messages.values()]),
    )
    golden(f"{name}/decoders.py.txt", print_decoders(variant))
    golden(f"{name}/encoders.py.txt", variant.encoder.source)
    if variant.link != "can":
        golden(f"{name}/scanner.py.txt", StreamScanner([variant], direction="from device").source)
