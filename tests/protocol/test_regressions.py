"""Faults that the laws found, each as the smallest case that showed it."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from typing import Any

import pytest
from construct import (
    Array,
    Byte,
    Bytes,
    Const,
    Construct,
    Float32l,
    GreedyBytes,
    IfThenElse,
    Int16sl,
    Int16ul,
    Int32ul,
    Int64ub,
    Padded,
    Prefixed,
    PrefixedArray,
    Struct,
    Switch,
    this,
)

from aces_bus import Frame, FrameTable, Unknown, as_dict, decode, make_column_scanner, make_scanner
from aces_bus.errors import CallerError, FieldError, SpecError
from aces_bus.protocol import (
    BitLayout,
    CanScanner,
    Crc,
    Enumeration,
    Flags,
    IdField,
    Insert,
    InvertedSum,
    Multiplexed,
    Protocol,
    Quantity,
    SignMagnitude,
    bits,
)
from aces_bus.protocol.exchange.export_stubs import print_stub
from aces_bus.protocol.live.stream import StreamScanner
from aces_bus.protocol.reference import Reference


def _summed() -> Protocol:
    made = Protocol("summed", link="serial")
    packet = made.framing(
        sync=b"\xff\xff",
        header=Struct("id" / Byte, "length" / Byte),
        size=this.length + 4,
        max_size=259,
        check=InvertedSum(),
    )
    packet("Any", payload=Struct("data" / GreedyBytes))
    return made


def _streaming(made: Protocol, direction: str | None = None) -> StreamScanner:
    scanner = make_scanner([made.variant()], direction=direction, include_unknown=True)  # type: ignore[arg-type]
    assert isinstance(scanner, StreamScanner)
    return scanner


@pytest.mark.slow
@pytest.mark.parametrize("chunk", [1, 7, 500, 100_000])
def test_false_headers_cost_no_more_than_twice_the_input(chunk: int) -> None:
    """The prefix sums of a failed check ended where they began, so that every false header was summed anew."""
    data = b"\xff\xff\x01\xff" * 25_000
    scanner = _streaming(_summed())
    for at in range(0, len(data), chunk):
        scanner.feed(data[at : at + chunk])
    scanner.close()
    assert scanner.check_work <= 2 * len(data)
    assert scanner.counts.balance == 0


def test_a_packet_accepted_from_prefix_sums_is_not_counted_as_read_again() -> None:
    """A packet behind a false header that reaches over it counted three times."""
    inner = b"\xff\xff\x00\x02\x00\xfd"
    scanner = _streaming(_summed())
    scanner.feed(b"\xff\xff\x00\x20" + inner + bytes(40))
    scanner.close()
    assert scanner.counts.records == 1
    assert scanner.check_work <= 2 * scanner.counts.total


def test_closing_again_keeps_what_was_pending() -> None:
    """The second close forgot the bytes that the first had left pending, and the bins no longer summed."""
    scanner = _streaming(_summed())
    scanner.feed(b"\xff\xff\x01")
    scanner.close()
    scanner.feed(b"\xff\xff")
    scanner.close()
    assert scanner.counts.pending == 5
    assert scanner.counts.balance == 0


def test_reference_and_scanner_name_the_same_fault_of_a_stuffed_packet() -> None:
    """Of a packet with a wrong check and impossible stuffing the one said "checksum", the other "stuffing"."""
    made = Protocol("stuffed", link="serial")
    packet = made.framing(
        sync=b"\xff\xff\xfd",
        header=Struct("length" / Byte),
        size=this.length + 4,
        max_size=64,
        stuffing=Insert(b"\xff\xff\xfd", b"\xfd"),
        check=Crc("CRC16-UMTS"),
    )
    packet("Any", payload=Struct("data" / GreedyBytes))
    data = b"\xff\xff\xfd\x06" + b"\xff\xff\xfd\x00" + b"\x12\x34"
    scanner = _streaming(made)
    given = scanner.feed(data) + scanner.close()
    assert given[0].reason == "malformed: checksum"
    assert Reference([made.variant()]).stream(data)[0].reason == "malformed: checksum"


def test_records_in_a_prefixed_array_are_found() -> None:
    """`PrefixedArray` hid its records from the walk that makes their types: `feed` raised KeyError."""
    made = Protocol("arrays", link="can")
    made.message("Things", id=1, payload=Struct("things" / PrefixedArray(Byte, Struct("x" / Byte))))
    (record,) = made.scanner().feed([Frame(1, b"\x02\x07\x08")])
    assert [thing.x for thing in record.things] == [7, 8]


def test_rare_selectors_are_seen_by_the_ambiguity_check() -> None:
    """Multiplexed lengths were tried at random: a selector of 16 bits was never hit, and two messages passed as apart."""
    made = Protocol("rare", link="can")
    made.message("One", id=5, payload=Struct("which" / Int16ul, "a" / Multiplexed("which", 1000, Int16ul)))
    with pytest.raises(SpecError, match="both accept 005#E8030000"):
        made.message("Two", id=5, payload=Struct("b" / Int32ul))


def test_wide_heads_are_tested_against_their_pattern() -> None:
    """A head with more than 4096 possible numbers was not tested at all: any number was accepted."""
    made = Protocol("wide", link="can")
    head = Struct("n" / Int16ul)
    made.message(
        "Range", id=1, prefix=head, match={"n": IdField("n", range(5000))}, payload=Struct("x" / Byte)
    )
    made.message(
        "Scattered",
        id=2,
        prefix=Struct("n" / Int32ul),
        match={
            "n": IdField("a", range(1000)) << 3 | IdField("b", range(7)) | IdField("c", range(1000)) << 15
        },
        payload=Struct("x" / Byte),
    )
    scanner = made.scanner(include_unknown=True)
    given = scanner.feed(
        [
            Frame(1, b"\x87\x13\x01"),
            Frame(1, b"\x88\x13\x01"),
            Frame(2, b"\x06\0\0\0\1"),
            Frame(2, b"\x07\0\0\0\1"),
        ]
    )
    assert [type(item).__name__ for item in given] == ["Range", "Unknown", "Scattered", "Unknown"]


def _asking() -> Protocol:
    made = Protocol("asking", link="can")
    node = IdField("node", range(4))
    ask = made.message("Ask", id=0x10 + node, direction="to device", payload=Struct("which" / Byte))
    for name, which in (("One", 1), ("Two", 2)):
        made.message(
            name,
            id=0x20 + node,
            direction="from device",
            reply_to=ask.where(which=which),
            payload=Struct("value" / Int16ul),
        )
    return made


def test_what_we_send_tells_replies_also_when_only_replies_are_heard() -> None:
    """`sent` looked for requests among the messages of the scanner's own direction, where there are none."""
    scanner = make_scanner([_asking().variant()], direction="from device")
    assert isinstance(scanner, CanScanner)
    scanner.sent(Frame(0x11, b"\x02"))
    assert [type(r).__name__ for r in scanner.feed([Frame(0x21, b"\x05\x00")])] == ["Two"]


def test_what_we_send_is_noted_by_the_protocol_that_it_is_of() -> None:
    """On a wire of two protocols the first took any packet of the right length for its own request."""

    def asking(name: str, sync: bytes) -> Protocol:
        made = Protocol(name, link="serial")
        packet = made.framing(sync=sync, size=4)
        ask = packet("Ask", direction="to device", payload=Struct("which" / Byte, "pad" / Bytes(2)))
        for reply, which in (("One", 1), ("Two", 2)):
            packet(
                reply,
                direction="from device",
                reply_to=ask.where(which=which),
                payload=Struct("value" / Bytes(3)),
            )
        return made

    first, second = asking("first", b"\xa1"), asking("second", b"\xa2")
    scanner = make_scanner([first.variant(), second.variant()], direction="from device", include_unknown=True)
    assert isinstance(scanner, StreamScanner)
    scanner.sent(b"\xa2\x02\x00\x00")
    given = scanner.feed(b"\xa1abc\xa2abc")
    assert isinstance(given[0], Unknown)
    assert (given[0].reason, type(given[1]).__name__) == ("unknown: needs request Ask", "Two")


def test_a_reply_that_another_protocol_claimed_leaves_no_reason_behind() -> None:
    """The reason "needs request" of a frame that somebody else then claimed was given to the next frame lost."""
    other = Protocol("other", link="can")
    other.message("Mine", id=0x21, payload=Struct("x" / Int16ul))
    scanner = make_scanner([_asking().variant(), other.variant()], include_unknown=True)
    assert isinstance(scanner, CanScanner)
    given = scanner.feed([Frame(0x21, b"\x05\x00"), Frame(0x21, b"\x05")])
    assert type(given[0]).__name__ == "Mine"
    assert given[1].reason == "malformed: length 1, One has 2 bytes"


def test_reset_forgets_everything() -> None:
    """A scanner that was reset is as if just made: no counts, no held bytes, no requests."""
    scanner = make_scanner([_asking().variant()], include_unknown=True)
    assert isinstance(scanner, CanScanner)
    scanner.feed([Frame(0x11, b"\x01"), Frame(0x7FF)])
    scanner.reset()
    assert scanner.counts.total == 0
    (lost,) = scanner.feed([Frame(0x21, b"\x05\x00")])
    assert lost.reason == "unknown: needs request Ask"
    stream = _streaming(_summed())
    stream.feed(b"\xff\xff\x01")
    stream.reset()
    (record,) = stream.feed(b"\xff\xff\x00\x02\x00\xfd")
    assert (record.meta.offset, stream.counts.total, stream.buffered) == (0, 6, 0)


def test_frames_that_only_their_direction_tells_apart_cost_themselves() -> None:
    """Without a direction two CAN messages that only it tells apart are unknown, and the others are read."""
    made = Protocol("opposite", link="can")
    made.message("Set", id=1, direction="to device", payload=Struct("x" / Byte))
    made.message("Is", id=1, direction="from device", payload=Struct("y" / Byte))
    made.message("Other", id=2, direction="from device", payload=Struct("z" / Byte))
    found = made.scanner(include_unknown=True).feed([Frame(1, b"\x07"), Frame(2, b"\x08")])
    assert [type(record).__name__ for record in found] == ["Unknown", "Other"]
    assert [(a.name, b.name) for a, b in made.variant().direction_conflicts] == [("Is", "Set")]
    (record,) = made.scanner(direction="from device").feed([Frame(1, b"\x07")])
    assert record.y == 7


def test_a_framing_s_numbers_are_its_messages() -> None:
    """A message of a framing that reads some functions alone encodes no other, and cannot be matched with another."""
    made = Protocol("meter", link="serial")
    framing = made.framing(
        header=Struct("unit" / Byte, "function" / Byte), match={"function": (5, 6)}, size=4
    )
    framing("Any", payload=Struct("x" / Int16ul))
    assert made.encode("Any", unit=1, function=6, x=2) == b"\x01\x06\x02\x00"
    with pytest.raises(FieldError, match="function: 7 does not go with Any"):
        made.encode("Any", unit=1, function=7, x=2)
    with pytest.raises(SpecError, match="Bad has function 7, but its framing reads 5, 6 alone"):
        framing("Bad", match={"function": 7}, payload=Struct("y" / Int16ul))


def test_a_mode_outlives_the_reply_to_its_request() -> None:
    """A request that a reply has consumed is still the mode of what follows: a lidar's nodes behind its descriptor."""
    lidar = Protocol("lidar", link="serial")
    scan = lidar.framing(name="command", sync=b"\xa5", size=2)(
        "Scan", direction="to device", payload=Struct(Const(0x20, Byte))
    )
    lidar.framing(name="node", size=3)(
        "Node", direction="from device", after=scan, payload=Struct("x" / Bytes(3))
    )
    lidar.framing(name="descriptor", sync=b"\xa5\x5a", size=3)(
        "Descriptor", direction="from device", reply_to=scan, overrides="Node", payload=Struct("kind" / Byte)
    )
    stream = lidar.encode("Descriptor", kind=1) + b"abcdef"
    paired = lidar.scanner(direction="both", include_unknown=True)
    paired.feed(lidar.encode("Scan"))
    received = lidar.scanner(direction="from device", include_unknown=True)
    received.sent(lidar.encode("Scan"))
    for scanner in (paired, received):
        kinds = [type(record).__name__ for record in scanner.feed(stream)]
        assert kinds[-3:] == ["Descriptor", "Node", "Node"]


_PAIR = Struct("x" / Byte, "y" / Byte)


def test_nested_records_whose_names_read_alike() -> None:
    """`a` in two shapes and a field `a_0` were one class, in payloads through construct and in flat ones."""
    made = Protocol("alike", link="can")
    shapes = Switch(this.k, {0: _PAIR}, default=Struct("z" / Byte))
    made.message(
        "Opaque", id=1, payload=Struct("k" / Byte, "a" / shapes, "a_0" / Struct("z" / Byte, "w" / Byte))
    )
    made.message(
        "Flat",
        id=2,
        payload=Struct("a_b" / Struct("c" / Byte), "a" / Struct("b" / Struct("d" / Byte, "e" / Byte))),
    )
    opaque, flat = made.scanner().feed([Frame(1, bytes(5)), Frame(2, b"\1\2\3")])
    assert as_dict(opaque) == {"k": 0, "a": {"x": 0, "y": 0}, "a_0": {"z": 0, "w": 0}}
    assert as_dict(flat) == {"a_b": {"c": 1}, "a": {"b": {"d": 2, "e": 3}}}


def test_names_with_underscores_have_tables_of_their_own() -> None:
    """The names of `A.b_c` and of `A_b.c` were one table in the generated module: the second one's."""
    made = Protocol("tables", link="can")
    made.message("A", id=1, payload=BitLayout(1, "b_c" / Enumeration(bits(8), one=1)))
    made.message("A_b", id=2, payload=BitLayout(1, "c" / Enumeration(bits(8), two=1)))
    first, second = made.scanner().feed([Frame(1, b"\1"), Frame(2, b"\1")])
    assert (first.b_c, second.c) == ("one", "two")
    assert made.encode("A", b_c="one").data == made.encode("A_b", c="two").data == b"\1"


def test_a_frame_never_gets_more_bytes_than_it_has() -> None:
    """The quick encoder appended an open field without asking whether the frame had room."""
    made = Protocol("room", link="can")
    made.message("Open", id=1, payload=Struct("a" / Byte, "rest" / GreedyBytes))
    assert len(made.encode("Open", a=1, rest=bytes(7)).data) == 8
    with pytest.raises(CallerError, match="9 bytes of data"):
        made.encode("Open", a=1, rest=bytes(8))


def test_a_signed_selector_of_a_layout() -> None:
    """Its raw value was compared without its sign in generated decoders."""
    made = Protocol("signed", link="can")
    made.message(
        "Signed",
        id=1,
        payload=BitLayout(1, "s" / bits(3, signed=True), "a" / Multiplexed("s", -2, bits(5))),
    )
    (record,) = made.scanner().feed([Frame(1, b"\x56")])
    assert (record.s, record.a) == (-2, 10)


def test_a_scaled_number_of_64_bits_is_sent_exactly() -> None:
    """An integer factor went through a float, which has 53 bits."""
    from construct import Int64ul

    from aces_bus.protocol import Quantity

    made = Protocol("exact", link="can")
    made.message("Exact", id=1, payload=Struct("n" / Quantity(Int64ul, scale=2, offset=1)))
    raw = (1 << 64) - 3
    assert bytes(made.encode("Exact", n=2 * raw + 1).data) == raw.to_bytes(8, "little")


@pytest.mark.parametrize(
    ("scale", "offset"), [(0.01, 0), (0.1, -40.0), (-0.25, 0.3), (3, 7), (1e-7, 1e6), (0.001, 5)]
)
def test_a_truncated_number_comes_back(scale: float, offset: float) -> None:
    """A quotient a rounding error below its integer was truncated to the one before: 0.29 at 0.01 was sent as 28."""
    from construct import Int16sl

    made = Protocol("truncated", link="can")
    quantity = Quantity(Int16sl, scale=scale, offset=offset, rounding="truncate")
    made.message("Speed", id=1, payload=Struct("n" / quantity))
    encode = made.variant().encoder.encode
    for raw in range(-(1 << 15), 1 << 15, 7):
        value = quantity.to_physical(raw)
        assert quantity.to_raw(value) == raw
        assert bytes(encode("Speed", n=value).data) == raw.to_bytes(2, "little", signed=True)
    for beside, wanted in ((29.9, 29), (28.999999, 28), (-29.9, -29), (-28.999999, -28)):
        if abs(scale) > 1e-3:
            assert quantity.to_raw(beside * scale + offset) == wanted
            assert encode("Speed", n=beside * scale + offset).data[0] == wanted & 0xFF


@pytest.mark.parametrize("size", [2, 3, 4, 8])
@pytest.mark.parametrize("signed", [False, True])
def test_a_layouts_only_field_keeps_its_byte_order(size: int, *, signed: bool) -> None:
    """A field that filled a layout of order "msb" was taken for little-endian bytes, live and in columns."""
    made = Protocol("full", link="can")
    made.message("Full", id=1, payload=BitLayout(size, "a" / bits(8 * size, signed=signed), order="msb"))
    data = bytes(range(0x81, 0x81 + size))
    wanted = int.from_bytes(data, "big", signed=signed)
    (record,) = made.scanner().feed([Frame(1, data)])
    assert record.a == wanted
    assert decode([Frame(1, data)], made)["Full"]["a"].values.tolist() == [wanted]
    assert bytes(made.encode("Full", a=wanted).data) == data
    assert made["Full"].payload.parse(data).a == wanted


def test_what_a_prefixed_does_not_use_up_is_not_lost() -> None:
    """Bytes behind the content were dropped without a word: what was read could not be built again."""
    made = Protocol("prefixed", link="can")
    made.message("Text", id=1, payload=Struct("pair" / Prefixed(Byte, Struct("a" / Byte, "b" / Byte))))
    scanner = made.scanner(include_unknown=True)
    whole, longer = scanner.feed([Frame(1, b"\x02\x05\x06"), Frame(1, b"\x03\x05\x06\x07")])
    assert as_dict(whole) == {"pair": {"a": 5, "b": 6}}
    assert isinstance(longer, Unknown)


def test_what_loses_bytes_is_found_inside_choices() -> None:
    """Padding in a branch, a case or a prefixed part was not seen."""
    hidden: Construct = Padded(2, Byte)
    for field in (
        Prefixed(Byte, Struct("x" / hidden)),
        Switch(this.kind, {1: Struct("x" / hidden)}),
        IfThenElse(this.kind == 1, Byte, Struct("x" / hidden)),
    ):
        with pytest.raises(SpecError, match="Padded would skip or repeat bytes"):
            Protocol("hidden", link="can").message("M", id=1, payload=Struct("kind" / Byte, "field" / field))


def _live_and_columns(made: Protocol, *frames: Frame) -> list[dict[str, Any]]:
    """The fields of the frames, live; the reference and the columns say the same."""
    variant = made.variant()
    records = [as_dict(record) for record in make_scanner([variant]).feed(frames)]
    columns = make_column_scanner([variant])
    found: list[dict[str, Any]] = [{} for _ in frames]
    for table in [*columns.feed(FrameTable.from_frames(frames)), *columns.close()]:
        for kind in table.kinds:
            for row, value in zip(table.row.tolist(), table[kind.name].to_list(), strict=True):
                found[row][kind.name] = value
    for fields, reference, flat in zip(records, Reference([variant]).frames(frames), found, strict=True):
        assert str(as_plain(reference.fields)) == str(as_plain(fields))
        for path, value in flat.items():
            inside: Any = fields
            for step in path.split("."):
                if inside is not None:
                    inside = inside[int(step)] if isinstance(inside, list) else inside[step]
            assert inside == value or str(inside) == str(value)
    return records


def as_plain(value: Any) -> Any:
    """Containers as dicts and lists."""
    if isinstance(value, dict):
        return {name: as_plain(item) for name, item in value.items() if not name.startswith("_")}
    return [as_plain(item) for item in value] if isinstance(value, (list, tuple)) else value


def _one(payload: Construct, **more: Any) -> Protocol:
    made = Protocol("one", link="can")
    made.message("M", id=1, payload=payload, **more)
    return made


def _selecting() -> BitLayout:
    return BitLayout(1, "kind" / bits(2), "level" / Multiplexed("kind", 3, bits(6, at=2)))


@pytest.mark.parametrize(
    ("payload", "data", "way"),
    [
        (Struct("a" / _selecting(), "b" / _selecting()), "5457", ("b", "level")),
        (Struct("a" / Array(2, _selecting())), "5457", ("a", 1, "level")),
        (Struct("kind" / Byte, "b" / _selecting()), "0057", ("b", "level")),
        (
            Struct(
                "kind" / Byte, "b" / Multiplexed("kind", 1, _selecting()), "c" / Multiplexed("kind", 1, Byte)
            ),
            "015700",
            ("b", "level"),
        ),
    ],
)
def test_a_selector_is_the_one_of_its_own_layout(payload: Construct, data: str, way: tuple[Any, ...]) -> None:
    """Selectors were remembered by their bare names, so that one of the same name elsewhere decided."""
    found: Any = _live_and_columns(_one(payload), Frame(1, bytes.fromhex(data)))[0]
    for step in way:
        found = found[step]
    assert found == 21


def test_layouts_that_overlay_keep_their_own_words() -> None:
    """Two multiplexed layouts of different size at one offset shared a variable: the second overwrote the first."""
    payload = Struct(
        "sel" / Byte,
        "m0" / Multiplexed("sel", 2, BitLayout(3, "b0" / bits(5), "b2" / bits(5, at=19))),
        "m1" / Multiplexed("sel", 1, BitLayout(1, "b0" / bits(1, at=1), "b1" / bits(2))),
    )
    (fields,) = _live_and_columns(_one(payload), Frame(1, bytes.fromhex("02629960")))
    assert fields["m0"]["b2"] == 12


def test_numbers_that_have_no_literal_are_numbers() -> None:
    """Infinity and NaN were printed into generated code as the names `inf` and `nan`."""
    made = _one(
        Struct(
            "v" / Quantity(Int16ul, range=(0, math.inf), scale=0.5),
            "f" / Quantity(Float32l, unknown=[math.nan, -math.inf], range=(-math.inf, 5)),
        )
    )
    sent = made.encode("M", v=1000, f=2.0)
    frames = [
        Frame(1, bytes(sent.data)),
        *(Frame(1, bytes.fromhex(f"0200{end}")) for end in ("0000c07f", "000080ff")),
    ]
    first, nan, infinite = _live_and_columns(made, frames[0]) + _live_and_columns(made, *frames[1:])
    assert first == {"v": 1000.0, "f": 2.0}
    assert nan == infinite == {"v": 1.0, "f": None}


class _Half(float):
    """A float whose text is not a Python."""

    def __repr__(self) -> str:
        return "one half"


def test_values_of_other_types_enter_generated_code_as_they_are() -> None:
    """A scale of NumPy's, an enumeration of names by a class, were printed by their `repr`."""
    payload = Struct(
        "v" / Quantity(Byte, scale=_Half(0.5), offset=_Half(0.25), range=(_Half(0), _Half(100))),
        "e" / Enumeration(Byte, {'"""\n': 1}),
    )
    made = _one(payload, doc='"""\\\0 a\r', source='"\n')
    assert _live_and_columns(made, Frame(1, b"\x02\x01")) == [{"v": 1.25, "e": '"""\n'}]
    assert bytes(made.encode("M", v=1.25, e=1).data) == b"\x02\x01"


@pytest.mark.parametrize(
    "name",
    ["Record", "Part", "Any", "FlagSet", "Struct", "flags", "re", "data", "q", "v0", "from_bytes", "tuple"],
)
def test_a_message_may_have_any_name(name: str) -> None:
    """Names of messages and of nested records hid what generated code calls."""
    made = Protocol("named", link="can")
    for identifier, one in ((1, name), (2, "Other"), (3, "Other_flags"), (4, "decode_Other")):
        made.message(
            one,
            id=identifier,
            payload=Struct(
                "v0" / Quantity(Int16ul, scale=0.5),
                "flags" / BitLayout(2, "data" / Flags(bits(3), a=0), "q" / Quantity(bits(3), unknown=[7])),
                "re" / Array(2, Enumeration(Byte, a=1)),
            ),
        )
    frames = [Frame(identifier, bytes.fromhex("020039000103")) for identifier in (1, 2, 3, 4)]
    wanted: dict[str, Any] = {"v0": 1.0, "flags": {"data": 1, "q": None, "reserved": 0}, "re": ["a", 3]}
    assert _live_and_columns(made, *frames) == [wanted] * 4
    records = make_scanner([made.variant()]).feed(frames)
    assert [record.meta.message for record in records] == [name, "Other", "Other_flags", "decode_Other"]
    assert bytes(made.encode(name, **wanted).data) == frames[0].data


def test_captures_of_alike_names_stay_apart() -> None:
    """`A` with a capture `B_c` and `A_B` with a capture `c` shared the function that writes it."""
    made = Protocol("alike", link="can")
    made.message("A", id=0x100 + IdField("B_c", range(4)), payload=Struct("x" / Byte))
    made.message("A_B", id=0x200 + IdField("c", range(8)), payload=Struct("x" / Byte))
    assert made.encode("A_B", c=7, x=1).arbitration_id == 0x207
    with pytest.raises(FieldError, match="B_c: 7 is not one of"):
        made.encode("A", B_c=7, x=1)


@pytest.mark.parametrize(
    ("payload", "complaint"),
    [
        (
            Struct("a" / Byte, "p" / Bytes(6), "b" / Multiplexed("a", 2, Int16ul)),
            "with field 'b' M has 9 bytes of data, and its frames have 8 at most",
        ),
        (Struct("a" / SignMagnitude(8), "b" / Multiplexed("a", 2, Byte)), "selector 'a' is a SignMagnitude"),
        (
            Struct("s" / Struct("a" / Quantity(Byte, scale=0.5), "b" / Multiplexed("a", 2, Byte))),
            "selector 'a' is a Quantity",
        ),
        (Struct("a" / Byte, "b" / Array(2, Multiplexed("a", 2, Byte))), "makes a named field"),
        (Struct("\ufb01" / Byte), "Python reads '\ufb01' as 'fi'"),
    ],
)
def test_what_no_frame_can_mean_is_refused(payload: Construct, complaint: str) -> None:
    """Branches without room, and selectors that the implementations took for different numbers, were accepted."""
    with pytest.raises(SpecError, match=re.escape(complaint)):
        _one(payload)


@pytest.mark.parametrize(
    ("make", "complaint"),
    [
        (lambda: Enumeration(Quantity(Byte, scale=2), one=1), "Enumeration takes a number of the wire"),
        (lambda: Quantity(Enumeration(Byte, one=1)), "Quantity takes a number of the wire"),
        (lambda: Flags(Quantity(Byte), one=1), "Flags takes a number of the wire"),
        (lambda: SignMagnitude(bits(5, signed=True)), "takes an unsigned integer"),
        (lambda: Enumeration(Float32l, one=1), "Enumeration takes an integer"),
        (lambda: Quantity(Bytes(2), scale=2), "takes a number, not Bytes"),
        (lambda: Quantity(Byte, unknown=[math.nan]), "an integer is never nan"),
    ],
)
def test_fields_over_what_is_no_number_are_refused(make: Callable[[], Any], complaint: str) -> None:
    """Adapters upon adapters that no generated code can carry out failed in `feed`."""
    with pytest.raises(SpecError, match=complaint):
        make()


def test_a_packet_of_nothing_is_not_built() -> None:
    """What stands between two ends is not a packet; the encoder made one that no scanner read."""
    made = Protocol("ended", link="serial")
    frame = made.framing(sync=b"\xaa", end=b"\n", max_size=80)
    with pytest.raises(SpecError, match="with nothing before its end a packet of Empty is none"):
        frame("Empty", payload=Struct())
    frame("Any", payload=Struct("data" / GreedyBytes))
    assert made.encode("Any", data=b"1") == b"\xaa1\n"
    with pytest.raises(FieldError, match="would not be read"):
        made.encode("Any", data=b"")


def test_a_branch_that_fits_for_some_values_is_there_for_those() -> None:
    """Columns read behind the end of the frame where a value's fields do not fit."""
    found = _live_and_columns(
        _one(
            Struct("a" / Byte, "b" / Multiplexed("a", (1, 2), Bytes(7)), "c" / Multiplexed("a", (2, 4), Byte))
        ),
        Frame(1, bytes(range(1, 9))),
    )
    assert found == [{"a": 1, "b": bytes(range(2, 9)), "c": None}]


def test_a_name_of_a_signed_magnitude_is_not_an_index() -> None:
    """A magnitude below zero took its name from the end of the table of names."""
    made = _one(Struct("e" / Enumeration(SignMagnitude(8), {"low": -3, "other": 125})))
    assert _live_and_columns(made, Frame(1, b"\x83"), Frame(1, b"\x84")) == [{"e": "low"}, {"e": -4}]


def test_what_has_no_bytes_is_decoded_and_built() -> None:
    """Nested records of constants alone, and lists of nothing, were not Python."""
    made = _one(Struct("n" / Struct(Const(b"\x01")), "e" / Array(0, Byte), "x" / Byte))
    assert _live_and_columns(made, Frame(1, b"\x01\x05")) == [{"n": {}, "e": [], "x": 5}]
    assert bytes(made.encode("M", n={}, e=[], x=5).data) == b"\x01\x05"
    assert bytes(_one(Struct("e" / Array(0, Byte), "x" / Byte)).encode("M", e=(), x=5).data) == b"\x05"


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"current": 400}, "Set: current: 400 A is outside -327.68…327.67 A"),
        ({"limit": -2}, "Set: limit: -2 V is outside 0…4294967295 V"),
        ({"share": 3}, "Set: share: 3 is outside -1…1"),
        ({"inner": {"speed": 5000}}, "Set: inner -> speed: 5000 m/s is outside -3276.8…3276.7 m/s"),
        ({"step": 16}, "Set: step: 16 is outside 0…15"),
    ],
)
def test_what_is_out_of_range_is_named_in_its_unit(fields: dict[str, Any], said: str) -> None:
    """Field, value, unit and range as the spec's reader knows them, not the raw number."""
    made = Protocol("ranges", link="serial")
    framing = made.framing(sync=b"\xaa", end=b"\x55", max_size=64)
    layout = BitLayout(2, "current" / Quantity(bits(16, signed=True), unit="A", scale=0.01))
    payload = Struct(
        "limit" / Quantity(Int32ul, unit="V"),
        "share" / Quantity(Int16sl, scale=1e-3, range=(-1, 1)),
        "inner" / Struct("speed" / Quantity(Int16sl, unit="m/s", scale=0.1)),
        "more" / layout,
        "bits" / BitLayout(1, "step" / bits(4)),
    )
    made.message("Set", framing=framing, payload=payload)
    good: dict[str, Any] = {
        "limit": 1,
        "share": 0,
        "inner": {"speed": 1},
        "more": {"current": 1},
        "bits": {"step": 1},
    }
    given: dict[str, Any] = (
        {"more": fields} if "current" in fields else {"bits": fields} if "step" in fields else fields
    )
    said = said.replace("current:", "more -> current:").replace("step:", "bits -> step:")
    with pytest.raises(FieldError, match=re.escape(said)):
        made.encode("Set", **{**good, **given})


def test_stubs_keep_nested_records_apart() -> None:
    """Classes of a stub were named by a path that two nested records may share."""
    made = Protocol("nested", link="can")
    made.message(
        "M", id=1, payload=Struct("a" / Struct("b" / Struct("x" / Byte)), "a_b" / Struct("y" / Byte))
    )
    made.message("M_a", id=2, payload=Struct("b" / Struct("z" / Byte)))
    made.message("Odd", id=4, payload=Struct("e" / Enumeration(Byte, {"one\n": 1})), doc="a\0\rb")
    text = print_stub(made, "nested")
    compile(text, "stub", "exec")
    classes = re.findall(r"^class (\w+)", text, re.MULTILINE)
    assert len(classes) == len(set(classes)) == 8
    made.message("Record", id=3)
    with pytest.raises(SpecError, match="cannot name a message so"):
        print_stub(made, "nested")


def test_a_scale_of_one_keeps_every_bit() -> None:
    """With an offset, construct multiplied by 1.0 where generated code does not: 64 bits became 53."""
    made = _one(Struct("v" / Quantity(Int64ub, scale=1.0, offset=-7)))
    assert _live_and_columns(made, Frame(1, (1 << 60 | 1).to_bytes(8, "big"))) == [{"v": (1 << 60) - 6}]


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("long", 1 << 64, "long: n: 18446744073709551616 is outside 0…18446744073709551615"),
        ("short", -129, "short: n: -129 is outside -128…127"),
        ("short", "x", "short: n: 'x' is not a number that fits"),
        ("list", [{"kind": "k6", "data": -1}], "list: n.0 -> k6: -1 is outside 0…18446744073709551615"),
        ("list", [{"kind": "one", "data": []}], r"list: n.0 -> one: \[\] is not a number that fits"),
    ],
)
def test_a_number_that_does_not_fit_is_said_with_its_bounds(name: str, value: Any, said: str) -> None:
    """It was construct's own sentence: struct '<Q' error during building."""
    from construct import Int8sb, Int64ul

    from aces_bus.protocol import Enumeration, Items

    made = Protocol("unfit", link="can")
    made.message("long", id=1, payload=Struct("n" / Int64ul))
    made.message("short", id=2, payload=Struct("n" / Int8sb))
    kinds = {"k6": (6, Int64ul), "one": (7, Enumeration(Byte, {"a": 1}))}
    made.message("list", id=3, payload=Struct("n" / Items(tag=Byte, size=Byte, kinds=kinds)))
    with pytest.raises(FieldError, match=said):
        made.encode(name, n=value)
