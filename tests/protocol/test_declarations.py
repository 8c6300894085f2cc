"""Whatever a spec may say is right in every implementation, or refused when it is imported, by name."""

from __future__ import annotations

import re
from typing import Any

import construct as c
import pytest
from construct import (
    Array,
    Byte,
    Const,
    Enum,
    FlagsEnum,
    GreedyBytes,
    If,
    Int16ul,
    Int24ub,
    Int32ul,
    Padded,
    Padding,
    Pass,
    PrefixedArray,
    StopIf,
    Struct,
    Switch,
    this,
)

import aces_bus.protocol as protocol_words
from aces_bus import Frame, Unknown, as_dict, decode, make_scanner
from aces_bus.errors import CallerError, FieldError, SpecError
from aces_bus.protocol import (
    AsciiNumber,
    BitLayout,
    Check,
    Enumeration,
    IdField,
    Protocol,
    Quantity,
    Sum,
    Xor,
    bits,
)
from aces_bus.protocol.reference import Reference


def can(payload: c.Construct, **more: Any) -> Protocol:
    """A protocol of one message."""
    made = Protocol("declared", link="can")
    made.message("M", id=more.pop("id", 1), payload=payload, **more)
    return made


def everywhere(protocol: Protocol, data: bytes, identifier: int = 1) -> Any:
    """What live, reference and columns make of a frame: its record, or the reason of its loss; they agree."""
    frame = Frame(identifier, data)
    scanner = protocol.scanner(include_unknown=True)
    (record,) = scanner.feed([frame])
    (found,) = Reference([protocol.variant()]).frames([frame])
    tables = decode([frame], protocol, include_unknown=True)
    if isinstance(record, Unknown):
        assert (found.message, found.reason) == (None, record.reason)
        assert "M" not in tables or not len(tables["M"])
        return record.reason
    assert found.message is not None
    assert found.message == type(record).__name__
    assert len(tables[found.message]) == 1
    variant = protocol.variant()
    image = Frame(identifier, data).data
    for raw in (False, True):
        (seen,) = make_scanner([variant], raw=raw).feed([frame])
        built: Any = variant.encoder.build(variant[found.message], as_dict(seen), raw=raw)
        assert bytes(built.data) == image
    return record


# ---------------------------------------------------------------------- words of construct


def test_a_word_that_is_not_known_is_refused() -> None:
    """A class of construct's that nobody has decided about does not pass for one of the user's own."""
    unheard = type("Unheard", (c.Adapter,), {"__module__": "construct.core"})
    with pytest.raises(
        SpecError, match=r"payload.n: Unheard is a word of construct that aces-bus does not know"
    ):
        can(Struct("n" / unheard(Byte)))


@pytest.mark.parametrize(
    ("field", "reason"),
    [
        (c.GreedyRange(Pass), "the items of GreedyRange have no bytes"),
        (c.GreedyRange(Struct()), "the items of GreedyRange have no bytes"),
        (Array(this.a, Struct()), "the items of Array have no bytes"),
        (c.RepeatUntil(lambda *_: False, Pass), "the items of RepeatUntil have no bytes"),
        (c.Compressed(GreedyBytes, "zlib"), "Compressed does not give the same bytes back"),
        (c.Pickled, "Pickled runs what the bytes say"),
        (c.Numpy, "Numpy runs what the bytes say"),
        (c.Lazy(Byte), "Lazy reads when it is looked at"),
        (c.LazyBound(lambda: Padded(2, Byte)), "Padded would skip"),
        (PrefixedArray(Byte, Padded(2, Byte)), "Padded would skip"),
        (c.Sequence(Byte, Padding(2)), "Padded would skip"),
        (c.FixedSized(4, Padded(4, Byte)), "Padded would skip"),
        (c.Default(Padded(4, Byte), 1), "Padded would skip"),
        (c.Rebuild(Padded(4, Byte), 1), "Padded would skip"),
        (c.ExprAdapter(Padded(4, Byte), None, None), "Padded would skip"),
        (Enumeration(Padded(4, Byte), a=1), "Padded would skip"),
        (c.FocusedSeq("q", "p" / Byte, "q" / Byte), "FocusedSeq drops 'p'; use a Struct"),
        (c.BitStruct("x" / c.Nibble, Padding(4)), "has no name, so its bytes would be lost"),
        (c.BitStruct("x" / c.Nibble), "4 bits are read of 0 bytes"),
        (c.BitsInteger(8), "BitsInteger reads bits"),
        (c.GreedyString("utf16"), "text in utf16 has a mark of its byte order"),
        (c.NullTerminated(GreedyBytes, require=False), "NullTerminated takes its end off and needs it"),
        (c.NullStripped(GreedyBytes), "NullStripped loses what it strips"),
        (c.GreedyRange(Byte, discard=True), "GreedyRange discards what it reads"),
        (c.FormatField("<", "?"), "loses bits"),
        (c.Bytes(-1), "-1 bytes"),
        (Array(-1, Byte), "an array of -1"),
        (c.Transformed(Byte, bytes, 1, bytes, 1), "Transformed by a function of its own"),
    ],
)
def test_words_that_cannot_be_kept_are_refused(field: c.Construct, reason: str) -> None:
    """What loses bytes, never ends, runs a program or reads late is refused at import, however deep it stands."""
    with pytest.raises(SpecError, match=f"payload.n.*{reason}"):
        can(Struct("a" / Byte, "n" / field, "rest" / GreedyBytes))


@pytest.mark.parametrize(
    ("field", "good", "bad"),
    [
        (PrefixedArray(Byte, FlagsEnum(Byte, a=1)), b"\x02\x81\x01", b"\x03\x01\x02"),
        (PrefixedArray(Byte, Enum(Byte, a=1)), b"\x02\x81\x01", b"\x02\x01"),
        (c.FixedSized(3, Struct("x" / Byte, "y" / GreedyBytes)), b"\x01\x00\x00", b"\x01"),
        (c.FixedSized(3, Int16ul), None, b"\x01\x02\x03"),
        (c.PaddedString(4, "utf8"), b"ab\0\0", b"\xff\xff\xff\xff"),
        (c.CString("utf8"), b"ab\0", b"ab"),
        (c.NullTerminated(Int16ul), b"\x01\x02\0", b"\x01\x02\x03\0"),
        (c.BitStruct("x" / c.Nibble, "y" / c.Flag, "z" / c.BitsInteger(3)), b"\xfd", None),
        (c.ByteSwapped(Int24ub), b"\x01\x02\x03", None),
        (c.Sequence(Byte, Enum(Byte, a=1), Int16ul), b"\x05\x01\x02\x03", b"\x05"),
        (c.RepeatUntil(lambda x, *_: x == 0, Byte), b"\x02\x01\0", b"\x01\x02"),
        (c.Mapping(Byte, {"x": 1, "y": 2}), b"\x02", b"\x03"),
        (c.OneOf(Byte, (1, 2)), b"\x02", b"\x03"),
        (c.ExprAdapter(Byte, lambda raw, _: 12 // raw, lambda value, _: 12 // value), b"\x03", b"\0"),
        (c.GreedyRange(If(this.a == 9, Byte)), None, b"\x01"),
        (c.Error, None, b"\x01"),
        (
            c.LazyBound(lambda: c.Prefixed(Byte, c.GreedyRange(Int16ul))),
            b"\x04\x01\x02\x03\x04",
            b"\x03\x01\x02\x03",
        ),
    ],
)
def test_words_that_are_kept_are_the_same_everywhere(
    field: c.Construct, good: bytes | None, bad: bytes | None
) -> None:
    """Bytes that a field reads come back; others make the frame malformed, the same in every implementation."""
    protocol = can(Struct("a" / Byte, "n" / field, Const(7, Byte)))
    if good is not None:
        assert everywhere(protocol, b"\x01" + good + b"\x07").a == 1
    if bad is not None:
        assert everywhere(protocol, b"\x01" + bad + b"\x07").startswith("malformed: ")


def test_what_a_construct_raises_is_malformed() -> None:
    """Any exception of somebody's own construct has a bin and a reason, in the head, too; `feed` raises nothing."""

    class Broken(c.Construct):
        def _parse(self, stream: Any, context: Any, path: str) -> Any:
            raise SystemError("broken")

    assert everywhere(can(Struct("n" / Broken())), b"\x01") == "malformed: M cannot be read (SystemError)"
    own = can(Struct("s" / Struct("n" / c.OneOf(Byte, (1,)))))
    assert everywhere(own, b"\x02") == "malformed: M.s.n cannot be read (ValidationError)"


def test_fields_behind_a_stop_are_none() -> None:
    """What a `StopIf` leaves out is None in the record; a frame without it is not too short."""
    protocol = can(Struct("a" / Byte, "stop" / StopIf(this.a == 0), "b" / Int16ul))
    assert everywhere(protocol, b"\x00").b is None
    assert everywhere(protocol, b"\x01\x02\x00").b == 2


# ---------------------------------------------------------------------- choices


KIND = {"accel": 4, "time": 7}


@pytest.mark.parametrize(
    "case", ["nested", "outside", "prefix", "capture", "condition", "number", "computed"]
)
def test_choices_are_the_same_in_raw_mode(case: str) -> None:
    """A choice by name or by number comes out alike in both modes, wherever the enumeration stands."""
    accel, time = Int16ul, Int32ul
    by_name = {"accel": accel, "time": time}
    more: dict[str, Any] = {}
    kind = "kind" / Enumeration(Byte, KIND)
    if case == "nested":
        ident = BitLayout(1, "type" / Enumeration(bits(4), KIND), "n" / bits(4))
        payload = Struct("id" / ident, "d" / Switch(this.id.type, by_name, default=GreedyBytes))
    elif case == "outside":
        inner = Struct("d" / Switch(this._.kind, by_name, default=GreedyBytes))
        payload = Struct(kind, "s" / inner)
    elif case == "prefix":
        more["prefix"] = Struct(kind)
        payload = Struct("d" / Switch(this._.kind, by_name, default=GreedyBytes))
    elif case == "capture":
        more["id"] = 0x100 + IdField("kind", (4, 7), names=KIND)
        payload = Struct(Const(4, Byte), "d" / Switch(this._.kind, by_name, default=GreedyBytes))
    elif case == "condition":
        payload = Struct(kind, "d" / c.IfThenElse(this.kind == "accel", accel, time))
    elif case == "number":
        payload = Struct(kind, "d" / c.IfThenElse(this.kind == 4, accel, time))
    else:
        payload = Struct(kind, "d" / Switch(this.kind & 15, {4: accel, 7: time}, default=GreedyBytes))
    identifier = 0x104 if case == "capture" else 1
    record = everywhere(can(payload, **more), b"\x04\x01\x02", identifier)
    assert (record.s.d if case == "outside" else record.d) == 0x0201


# ---------------------------------------------------------------------- heads, patterns


def test_a_match_of_the_length_holds_when_reading_and_writing() -> None:
    """`match={"length": …}` proves messages apart, so it is enforced: live, in columns, in the reference, when built."""
    wire = Protocol("lengths", link="serial")
    packet = wire.framing(
        sync=b"\xa5",
        header=Struct("kind" / Byte, "length" / Byte),
        size=this.length + 4,
        check=Sum(),
        max_size=40,
    )
    packet("A", match={"kind": {1, 2}, "length": {4, 8}}, payload=Struct("d" / GreedyBytes))
    packet("B", match={"kind": 1, "length": 5}, payload=Struct("e" / c.GreedyRange(Byte)))

    def made(kind: int, size: int) -> bytes:
        head = bytes((kind, size)) + bytes(size)
        return b"\xa5" + head + bytes((sum(head) & 0xFF,))

    data = made(1, 4) + made(1, 5) + made(1, 3) + made(2, 5) + made(2, 8)
    wanted = ["A", "B", None, None, "A"]
    found = wire.scanner(include_unknown=True).feed(data)
    assert [None if isinstance(one, Unknown) else type(one).__name__ for one in found] == wanted
    assert [one.message for one in Reference([wire.variant()]).stream(data)] == wanted
    assert {name: len(table) for name, table in decode(data, wire).items()} == {"A": 2, "B": 1}
    assert wire.encode("A", kind=1, d=bytes(8)) == made(1, 8)
    with pytest.raises(FieldError, match=r"A: a packet of 7 bytes has length 3; this message has 4, 8"):
        wire.encode("A", kind=1, d=bytes(3))
    with pytest.raises(SpecError, match=r"length of C is the length of the packet; match it with numbers"):
        packet(
            "C", match={"kind": 3, "length": 1 + IdField("n", range(3))}, payload=Struct("d" / GreedyBytes)
        )


def test_a_packet_whose_length_has_no_number_is_refused() -> None:
    """A size that the length field cannot say is a FieldError, also where two framings are compared at import."""
    wire = Protocol("short", link="serial")
    first = wire.framing(
        sync=b"\xaa", header=Struct("length" / Byte), size=this.length + 10, max_size=40, name="one"
    )
    first("M", payload=Struct("d" / GreedyBytes))
    with pytest.raises(FieldError, match=r"M: no length gives a packet of 3 bytes"):
        wire.encode("M", d=b"x")
    assert len(wire.encode("M", d=bytes(9))) == 11
    second = wire.framing(
        sync=b"\xaa", header=Struct("length" / Byte), size=2 * this.length + 10, max_size=40
    )
    with pytest.raises(SpecError, match=r"'N' is ambiguous with 'M'"):
        second("N", payload=Struct("d" / GreedyBytes))


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("*{:X}", "writes a check in 2 to 3 characters"),
        ("{}{}", "is not a format of a check's number"),
        ("abc", "has one number in it; 'abc' has 0"),
        ("{:q}", "is not a format of a check's number"),
        ("°{:02X}", "is not a format of a check's number"),
    ],
)
def test_a_check_as_text_has_one_number_and_one_size(text: str, reason: str) -> None:
    """A format that would write checks of several sizes, or none, is refused."""
    with pytest.raises(SpecError, match=reason):
        Xor(text=text)


def test_the_letters_around_a_check_are_not_its_digits() -> None:
    """Hexadecimal digits mean the same in either case; other characters are themselves, and decimals have no case."""
    check: Check = Xor(text="x={:02X}h")
    wanted = check.encode(b"\xaf")
    assert wanted == b"x=AFh"
    same = {
        stored: check.same(stored, wanted)
        for stored in (b"x=af" + b"h", b"x=aFh", b"X=AFh", b"x=AFH", b"x=AEh")
    }
    assert list(same.values()) == [True, True, False, False, False]
    assert Xor(text="{:03d}").digits is None


# ---------------------------------------------------------------------- what is sent


LIMITED = Quantity(Byte, range=(0, 250), scale=100)
MARKED = Quantity(Byte, unknown=(255,), names={"error": 254}, scale=0.1)


@pytest.mark.parametrize("path", ["generated", "construct", "bits"])
@pytest.mark.parametrize(
    ("value", "sent"),
    [(250, 2), (0, 0), (149.9, 1), (260, "outside 0…250"), (251, "outside 0…250"), (-1, "outside 0…250")],
)
def test_nothing_out_of_range_is_sent(path: str, value: float, sent: int | str) -> None:
    """A value out of range is refused, however it would be rounded."""
    protocol = can(_placed(path, LIMITED))
    _sends(protocol, value, sent)


@pytest.mark.parametrize("path", ["generated", "construct", "bits"])
@pytest.mark.parametrize(
    ("value", "sent"),
    [
        (25.3, 253),
        (None, 255),
        (25.5, "would be sent as 255, which means unknown"),
        (25.46, "would be sent as 255, which means unknown"),
        (0.4, 4),
    ],
)
def test_a_number_is_never_sent_as_unknown(path: str, value: float | None, sent: int | str) -> None:
    """A number that would be read as "not known" is refused; None is sent as it."""
    _sends(can(_placed(path, Quantity(Byte, unknown=(255,), scale=0.1))), value, sent)


@pytest.mark.parametrize("path", ["generated", "construct", "bits"])
@pytest.mark.parametrize(
    ("value", "sent"),
    [(25.3, 253), ("error", 254), (25.4, "means 'error'; give the name"), (25.5, "means unknown")],
)
def test_a_number_is_never_sent_as_a_name(path: str, value: Any, sent: int | str) -> None:
    """A number that would be read as a name is refused; the name is sent."""
    _sends(can(_placed(path, MARKED)), value, sent)


def test_a_float_is_never_sent_as_unknown() -> None:
    """Also where it is the wire's fewer bits that make it the value that means unknown."""
    protocol = can(Struct("v" / Quantity(c.Float32l, unknown=(16777216.0,))))
    _sends(protocol, 16777217.0, "means unknown")
    assert protocol.encode("M", v=16777218.0).data == protocol.encode("M", v=16777217.0 + 1).data


def test_decoded_edges_of_a_range_can_be_sent() -> None:
    """Floats are not exact: the edge of a range as it was decoded is inside, on every step of a span."""
    protocol = can(
        Struct(
            "v" / Quantity.span(Int16ul, -12.5, 12.5, bits=16),
            "w" / Quantity(Byte, scale=0.1, range=(0, 0.3)),
        )
    )
    for raw, small in ((0, 0), (65535, 3), (1, 1)):
        record = everywhere(protocol, raw.to_bytes(2, "little") + bytes((small,)))
        assert (record.v, record.w) == (pytest.approx(-12.5 + raw * 25 / 65535), pytest.approx(small / 10))


@pytest.mark.parametrize("kind", ["int64", "uint8", "float32", "float64"])
@pytest.mark.parametrize("path", ["generated", "construct", "bits"])
def test_numbers_of_numpy_are_numbers(path: str, kind: str) -> None:
    """Quantities, bits and integers take NumPy's scalars."""
    import numpy as np

    _sends(can(_placed(path, Quantity(Byte, scale=2))), np.dtype(kind).type(6), 3)
    if not kind.startswith("float"):
        assert bytes(can(BitLayout(1, "v" / bits(8))).encode("M", v=np.dtype(kind).type(6)).data) == b"\x06"


@pytest.mark.parametrize("value", [1e300, -1e300, float("inf"), float("nan"), 10**400, "1", None])
def test_values_beyond_every_range_are_field_errors(value: Any) -> None:
    """What overflows on its way is a value that does not fit."""
    protocol = can(Struct("v" / Quantity(c.Int64sl, scale=1e-16)))
    with pytest.raises(FieldError, match=r"M: .*v"):
        protocol.encode("M", v=value)


def _placed(path: str, quantity: Quantity) -> c.Construct:
    """The quantity in a payload that is encoded by generated code, by construct, or bit by bit."""
    if path == "generated":
        return Struct("v" / quantity)
    if path == "construct":
        return Struct("v" / quantity, "rest" / c.GreedyRange(Int16ul))
    given = {name: getattr(quantity, name) for name in ("scale", "range", "unknown", "names")}
    return BitLayout(
        2, "v" / Quantity(bits(8, at=4), **given), "low" / bits(4, at=0), "high" / bits(4, at=12)
    )


def _sends(protocol: Protocol, value: Any, sent: int | str) -> None:
    more: dict[str, Any] = {name: 0 for name in ("low", "high") if name in protocol["M"].fields}
    if "rest" in protocol["M"].fields:
        more["rest"] = []
    if isinstance(sent, str):
        with pytest.raises(FieldError, match=f"M: .*v: .*{sent}"):
            protocol.encode("M", v=value, **more)
        return
    data = bytes(protocol.encode("M", v=value, **more).data)
    assert (int.from_bytes(data, "little") >> (4 if "low" in more else 0)) & 0xFF == sent


@pytest.mark.parametrize(
    ("value", "text"),
    [(1e-5, "0.00001"), (1e17, "100000000000000000"), (-1.5e-7, "-0.00000015"), (3, "3.0"), (0.1, "0.1")],
)
def test_small_and_large_numbers_are_written_in_digits(value: float, text: str) -> None:
    """A number in characters has no exponent, and reads back as it was."""
    assert AsciiNumber().to_raw(value) == text
    assert AsciiNumber().build(value) == text.encode()
    assert AsciiNumber().to_physical(text) == value


@pytest.mark.parametrize("value", [1e40, 1e-40, float("inf"), float("nan"), "1"])
def test_numbers_that_characters_cannot_say_are_refused(value: Any) -> None:
    """What is not a number of the field's form is a FieldError."""
    with pytest.raises(FieldError):
        AsciiNumber().build(value)


def test_names_that_a_scale_makes_equal_to_numbers_are_refused() -> None:
    """Columns know a named number by its scaled value: where a neighbour has the same, the spec is refused."""
    with pytest.raises(
        SpecError, match=r"'none' \(9223372036854775809\) cannot be distinguished from 9223372036854775808"
    ):
        Quantity(c.Int64ul, scale=0.5, names={"none": 2**63 + 1})
    exact = can(Struct("v" / Quantity(c.Int64ul, unit="s", names={"none": 2**63 + 1})))
    for number, value in ((2**63, 2**63), (2**63 + 1, "none"), (2**63 + 2, 2**63 + 2)):
        frame = Frame(1, number.to_bytes(8, "little"))
        (record,) = exact.scanner().feed([frame])
        assert (record.v, decode([frame], exact)["M"]["v"].to_list()) == (value, [value])


def test_a_time_that_is_none_has_no_nanoseconds() -> None:
    """Adapters give NaN where they have no time; NumPy's floats are times."""
    import numpy as np

    protocol = can(Struct("v" / Byte))
    times = [float("nan"), float("inf"), np.float64(1.5)]
    found = [
        record.meta.time_ns
        for t in times
        for record in protocol.scanner().feed([Frame(1, b"\1", timestamp=t)])
    ]
    assert found == [None, None, 1_500_000_000]


# ---------------------------------------------------------------------- order and ambiguity


def test_over_names_messages() -> None:
    """`overrides=` may name a later message; a name that never comes is refused before anything is read or sent."""
    made = Protocol("over", link="can")
    made.message("First", id=1, overrides="Later", payload=Struct(Const(1, Byte), "x" / Byte))
    made.message("Later", id=1, payload=Struct("y" / Int16ul))
    assert type(made.scanner().feed([Frame(1, b"\1\2")])[0]).__name__ == "First"
    made.message("Typing", id=2, overrides="Frist", payload=Struct("x" / Byte))
    with pytest.raises(
        SpecError, match=r"test_declarations.py:\d+: Typing overrides 'Frist', and no message has that name"
    ):
        made.scanner()
    with pytest.raises(SpecError, match=r"overrides= names messages, as text; 3 does not"):
        made.message("Number", id=3, overrides=3)  # type: ignore[arg-type]


def test_over_goes_in_no_circle() -> None:
    """No order of trial is right where messages are over each other, however far around."""
    made = Protocol("circle", link="can", dialects={"old": "", "new": ""})
    made.message("A", id=1, overrides="C", payload=Struct("x" / Byte))
    made.message("B", id=1, overrides="A", payload=Struct("x" / Byte))
    with pytest.raises(
        SpecError, match=r"overrides= goes in a circle: 'C' is before 'B' .* which is before 'C'|circle"
    ):
        made.message("C", id=1, overrides="B", payload=Struct("x" / Byte))
    with pytest.raises(SpecError, match=r"message 'D' cannot override itself"):
        made.message("D", id=1, overrides="D", payload=Struct("x" / Byte))


def test_a_frame_shown_as_ambiguous_is_one() -> None:
    """Where construct alone reads a payload, the frame shown is accepted by both; without one the text says undecided."""
    made = can(Struct("n" / Byte, "d" / Array(this.n, Byte)))
    with pytest.raises(SpecError, match=r"'N' is ambiguous with 'M' .*both accept 001#00;"):
        made.message("N", id=1, payload=Struct("n" / Byte, "d" / Array(this.n, Int16ul)))
    with pytest.raises(
        SpecError, match=r"'N' is ambiguous with 'M' .*: undecided: their templates do not tell them apart"
    ):
        made.message("N", id=1, payload=Struct("n" / c.OneOf(Byte, (200,)), "x" / GreedyBytes))


# ---------------------------------------------------------------------- words of another kind

#: The language as somebody without a type checker writes it.
UNTYPED: Any = protocol_words


@pytest.mark.parametrize(
    ("declared", "reason"),
    [
        (
            lambda: UNTYPED.Enumeration(Byte, {1: "a"}),
            "names are written name=number or {name: number}, not {1: 'a'}",
        ),
        (lambda: UNTYPED.Quantity(Byte, names={1: "a"}), "names are written"),
        (lambda: UNTYPED.Quantity(Byte, scale="x"), "a scale is a number, not 'x'"),
        (lambda: UNTYPED.Quantity(Byte, offset=float("inf")), "an offset finite"),
        (lambda: UNTYPED.Quantity(Byte, range=(1,)), "a range is"),
        (lambda: UNTYPED.Quantity(Byte, range=(float("nan"), 1)), "an empty range"),
        (lambda: UNTYPED.Quantity(Byte, unknown=255), "unknown lists raw values, as in"),
        (lambda: UNTYPED.Quantity(GreedyBytes), "Quantity takes a number, not GreedyBytes"),
        (lambda: UNTYPED.Flags(Byte, {1: 2}), "flags are written name=bit"),
        (lambda: can(Struct(), id=-1), "-1 is negative"),
        (lambda: can(Struct(), id="7"), "'7' is not a number, set of numbers or pattern"),
        (lambda: can(Struct(), id=1.5), "1.5 is not a number, set of numbers or pattern"),
        (
            lambda: UNTYPED.Protocol("w", link="serial").framing(sync="x", end=b"\n", max_size=9),
            "sync is bytes",
        ),
        (
            lambda: Protocol("w", link="serial").framing(sync=b"x", size=9, not_inside=b"y"),
            "not_inside is for",
        ),
        (
            lambda: Protocol("w", link="serial").framing(end=b"\r\n", max_size=9, not_inside=b"\r"),
            "not_inside has a byte with which the end",
        ),
    ],
)
def test_words_of_another_kind_are_refused(declared: Any, reason: str) -> None:
    """What is not a number, no name or no bytes is refused with what is wanted, not with a traceback from inside."""
    with pytest.raises(SpecError, match=rf"test_declarations\.py:\d+: .*{re.escape(reason)}"):
        declared()


# ---------------------------------------------------------------------- threads


def test_a_scanner_is_for_one_thread() -> None:
    """Asked to, a scanner notices a call that comes while another is under way; calls in turn are as ever."""
    scanner = can(Struct("v" / Byte)).scanner(check_thread=True)

    def frames() -> Any:
        yield Frame(1, b"\1")
        scanner.feed([])  # as another thread would, in the middle

    with pytest.raises(
        CallerError, match=r"feed was called while feed in .* was under way: a scanner is for one thread"
    ):
        scanner.feed(frames())
    assert [record.v for record in scanner.feed([Frame(1, b"\2")])] == [2]
    assert scanner.close() == []


def test_a_message_over_nothing_is_not_compared_with_all_others() -> None:
    """Declaring ten thousand messages of a database is linear: none goes through those before it."""

    class Declared(list[Any]):
        def __iter__(self) -> Any:
            raise AssertionError("all messages are gone through")

    protocol = Protocol("many", link="can")
    protocol.declared = Declared()
    for number in range(3):
        protocol.message(f"M{number}", id=number, payload=Struct("a" / Byte))
    assert len(protocol.declared) == 3
