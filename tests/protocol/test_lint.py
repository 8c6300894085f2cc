"""Each rule of `aces spec check` finds what it is for, with its line, and leaves sound specs alone."""

from __future__ import annotations

from pathlib import Path

import pytest
from construct import Byte, Const, GreedyBytes, Int8ul, Int16sb, Int16sl, Int16ul, Int24ul, Struct, this

from aces_bus.protocol import (
    BitLayout,
    Crc,
    Enumeration,
    IdBytes,
    IdField,
    Present,
    Protocol,
    Quantity,
    Reserved,
    SignMagnitude,
    Sum,
    Xor,
    bits,
)
from aces_bus.protocol.declare.examples import parse_packet
from aces_bus.protocol.files import load_file
from aces_bus.protocol.lint import check_protocol
from aces_bus.protocol.lint.fields import is_unit, suggest
from aces_bus.protocol.lint.finding import Finding
from aces_bus.protocol.lint.templates import check_wire
from tests.laws.wires import PROTOCOLS, REGISTERED


def found(protocol: Protocol, rule: str) -> list[Finding]:
    """What a rule says of a protocol."""
    return [one for one in check_protocol(protocol) if one.rule == rule]


def only(protocol: Protocol, rule: str) -> Finding:
    (one,) = found(protocol, rule)
    assert Path(one.place.file).name == "test_lint.py"
    return one


def can() -> Protocol:
    return Protocol("probe", link="can")


def serial() -> Protocol:
    return Protocol("probe", link="serial")


@pytest.mark.parametrize("name", PROTOCOLS)
def test_sound_specs_have_notes_at_most(name: str) -> None:
    """Nothing that ships, and no spec of the tests, has an error or a warning, but for those that are meant to."""
    meant = {"overrides"} if name in ("can_corners", "stream_corners") else set[str]()
    if name in ("canopen", "rmdx"):
        meant = {"direction"}  # hosts have heartbeats, too; a motor's number is answered as it is asked for
    bad = [str(f) for f in check_protocol(PROTOCOLS[name]) if f.level != "note" and f.rule not in meant]
    if name in REGISTERED:
        assert not bad
    else:
        assert not [text for text in bad if ": error:" in text]


# ---------------------------------------------------------------------- fields


def test_units_are_units() -> None:
    """SI with prefixes and exponents, and what sheets write; everything else is a slip of the pen."""
    good = "N·m, 0.1 mA, dBHz, dBW, rad/s², m/s^2, count, turn/s, °C, %, kg·m2, rad s-1, 1/min, µs, Nm, km/h, mgauss, 2 µs"
    bad = "bogus, mm/, kcount, meterz/s, N··, raad, °X, (m/s"
    assert [text for text in good.split(", ") if not is_unit(text)] == []
    assert [text for text in bad.split(", ") if is_unit(text)] == []
    assert suggest("raad") == "rad"


def test_a_unit_that_is_none_is_found_where_it_is_written() -> None:
    """The finding has the line of the field and proposes a unit."""
    p = can()
    p.message("State", id=5, payload=Struct("speed" / Quantity(Int16sl, unit="raad")))
    one = only(p, "unit")
    assert one.level == "warning"
    assert "is it 'rad'?" in one.text
    assert one.place.line == p["State"].place.line


def test_a_range_beyond_the_bits() -> None:
    """A range that the raw number cannot reach is a warning, one that it never meets an error; half a step is neither."""
    p = can()
    p.message(
        "State",
        id=5,
        payload=Struct(
            "wide" / Quantity(Byte, unit="V", scale=0.1, range=(0, 30)),
            "off" / Quantity(Byte, range=(300, 400)),
            "low" / Quantity(SignMagnitude(8), raw_range=(-128, 127)),
            "fits" / Quantity.span(Int16ul, -12.5, 12.5, bits=16),
            "never" / Quantity(Byte, unknown=[0xFFFF]),
        ),
    )
    levels = {one.text.partition(":")[0]: one.level for one in found(p, "range")}
    assert levels == {
        "State.wide": "warning",
        "State.off": "error",
        "State.low": "warning",
        "State.never": "error",
    }


def test_names_that_cannot_occur_and_names_with_holes() -> None:
    """A name beyond the bits is an error; a hole in a run of names is worth knowing; scattered names are not a run."""
    p = can()
    p.message(
        "State",
        id=5,
        payload=BitLayout(
            2,
            "mode" / Enumeration(bits(2), a=0, b=1, c=5),
            "kind" / Enumeration(bits(6), a=0, b=1, d=3),
            "code" / Enumeration(bits(8), a=1, b=50, c=200),
        ),
    )
    # Billions apart: what lies between is not walked.
    p.message("Object", id=6, payload=BitLayout(8, "mark" / Enumeration(bits(64), a=0, b=1, c=2**64 - 1)))
    error, hole = sorted(found(p, "enumeration"), key=lambda one: Finding.LEVELS.index(one.level))
    assert (error.level, "c=5 cannot occur: raw numbers are 0…3" in error.text) == ("error", True)
    assert (hole.level, "names 0…3, but not 2" in hole.text) == ("note", True)


@pytest.mark.slow
def test_one_number_the_other_way_round() -> None:
    """Among many little-endian numbers one big-endian one is doubtful; a mixed protocol is left alone."""
    p = can()
    for number in range(5):
        p.message(f"M{number}", id=number, payload=Struct("a" / Int16ul, "b" / Int16sl))
    assert not found(p, "byte-order")
    p.message("Odd", id=9, payload=Struct("a" / Int16sb))
    one = only(p, "byte-order")
    assert "Odd.a: is big-endian, 10 other numbers" in one.text


def test_messages_of_a_helper_have_the_lines_of_its_calls(tmp_path: Path) -> None:
    """Each message is where the helper was called for it; its fields are found in the helper, and so is what it allows."""
    spec = tmp_path / "helped.py"
    spec.write_text(
        "from construct import Byte, Int16ul, Struct\n"
        "from aces_bus.protocol import Protocol, Quantity\n"
        "p = Protocol('helped', link='can')\n"
        "def helper(name, number):\n"
        "    more = Struct('a' / Byte)\n"
        "    return p.message(name, id=number, payload=Struct(\n"
        "        'twice' / Byte,\n"
        "        'b' / Quantity(Byte, unit='lumen')))\n"
        "one = helper('One', 1)\n"
        "more = [helper(f'More{number}', number) for number in (2, 3)]\n"
        "alone = p.message('Alone', id=4, payload=Struct('a' / Byte))\n"
        "def factory():\n"
        "    made = Protocol('made', link='can')\n"
        "    made.message('First', id=1)\n"
        "    made.message('Second', id=2)\n"
        "    return made\n"
        "made = factory()\n"
    )
    module = load_file(str(spec))
    assert [m.place.line for m in module.p.declared] == [9, 10, 10, 11]
    assert module.one.place.of_field("twice").line == 7
    assert [m.place.line for m in module.made.declared] == [14, 15]
    units = [f for f in check_protocol(module.p) if f.rule == "unit"]
    assert {f.place.line for f in units} == {8}


def test_of_three_numbers_one_may_be_the_odd_one() -> None:
    """From three numbers on; one against one is either's right, two against two a mixed protocol."""
    p = can()
    p.message("Two", id=1, payload=Struct("a" / Int16ul, "b" / Int16sb))
    assert not found(p, "byte-order")
    p.message("Third", id=2, payload=Struct("a" / Int16ul))
    assert "Two.b: is big-endian, 2 other numbers" in only(p, "byte-order").text
    p.message("Fourth", id=3, payload=Struct("a" / Int16sb))
    assert not found(p, "byte-order")


def test_one_signed_number_that_is_never_negative() -> None:
    """Among eight unsigned numbers whose range begins at 0 a signed one is doubtful; among fewer it is the sheet's word."""
    p = can()
    for number in range(8):
        assert not found(p, "sign")
        p.message(f"M{number}", id=number, payload=Struct("a" / Quantity(Int16ul, range=(0, 1000))))
        if not number:
            p.message("Odd", id=9, payload=Struct("a" / Quantity(Int16sl, scale=0.1, range=(0, 100))))
            p.message("Both", id=10, payload=Struct("a" / Quantity(Int16sl, range=(-100, 100))))
            p.message("Below", id=11, payload=Struct("a" / Quantity(Int16sl, offset=500, range=(0, 100))))
    assert "Odd.a: is signed, and its range has nothing below 0; 8 other such" in only(p, "sign").text


def test_a_few_messages_without_a_direction_were_forgotten() -> None:
    """One message of many, or a small family of very many; where several of few have none, it is not a rule there."""
    p = can()
    for number in range(8):
        p.message(f"M{number}", id=number, direction="from device")
    p.message("One", id=0x20)
    assert "no direction=, which all 8 others have" in only(p, "direction").text
    p.message("Two", id=0x21)
    assert not found(p, "direction")
    for number in range(0x30, 0x3C):
        p.message(f"M{number}", id=number, direction="to device")
    assert [one.message for one in found(p, "direction")] == ["One", "Two"]


def test_bits_that_belong_to_nobody_are_noted() -> None:
    """The bits of a layout without a field are named by byte and bit."""
    p = can()
    p.message("State", id=5, payload=BitLayout(2, "a" / bits(4), "b" / bits(4, 12)))
    assert "byte 0 bits 7…4 + byte 1 bits 3…0" in only(p, "gap").text


def test_what_a_comment_allows_is_left_out() -> None:
    """`# aces: allow RULE` on the line, or above it, says that it is meant; errors cannot be allowed."""
    p = can()
    p.message("A", id=1, payload=Struct("x" / Quantity(Byte, unit="bogus")))  # aces: allow unit
    # aces: allow unit, gap
    p.message("B", id=2, payload=Struct("x" / Quantity(Byte, unit="bogus")))
    p.message("C", id=3, payload=Struct("x" / Quantity(Byte, unit="bogus")))
    p.message("D", id=4, payload=Struct("x" / Enumeration(Byte, a=256)))  # aces: allow enumeration
    assert [one.message for one in found(p, "unit")] == ["C"]
    assert len(found(p, "enumeration")) == 1


# ---------------------------------------------------------------------- checks


@pytest.mark.parametrize(
    ("check", "level", "says"),
    [
        (lambda: Xor(over=slice(4, 4)), "error", "covers nothing"),
        (lambda: Xor(over=slice(1, None)), "error", "covers its own bytes (the last byte"),
        (lambda: Sum(over=slice(1, -2)), "warning", "leaves out byte"),
        (lambda: Sum(over=slice(2, -1)), "note", "leaves out byte 1"),
        (lambda: Sum(over=[slice(1, -1), slice(1, 2)]), "warning", "covers some bytes twice"),
        (lambda: Sum(), None, ""),
    ],
)
def test_what_a_check_covers(check: object, level: str | None, says: str) -> None:
    """A check over nothing, over itself, or with a hole is found; the usual one is not."""
    p = serial()
    assert callable(check)
    framing = p.framing(
        sync=b"\xa5", header=Struct("length" / Byte), size=this.length + 3, max_size=258, gap=1, check=check()
    )
    framing("Data", payload=Struct("kind" / Byte, "data" / GreedyBytes))
    assert [one.level for one in found(p, "check-range")] == ([level] if level else [])
    assert all(says in one.text for one in found(p, "check-range"))


def test_a_check_over_what_never_changes() -> None:
    """A check that covers only constants cannot fail."""
    p = serial()
    framing = p.framing(sync=b"\xa5", size=4, check=Sum(over=slice(1, 2)))
    framing("Beat", payload=Struct(Const(7, Byte), "count" / Byte))
    assert found(p, "check-constant")


def test_a_check_of_a_message() -> None:
    """On CAN too: over its own byte, over too little; over the identifier and all other bytes it is sound."""
    payload = Struct("crc" / Byte, "a" / Int16ul)
    p = can()
    p.message("Own", id=1, payload=payload, check=Crc("CRC8-SAE-J1850", field="crc", over=slice(0, None)))
    p.message("Few", id=2, payload=payload, check=Crc("CRC8-SAE-J1850", field="crc", over=slice(1, 2)))
    over = [IdBytes(2), slice(1, None)]
    p.message("Right", id=3, payload=payload, check=Crc("CRC8-SAE-J1850", field="crc", over=over))
    assert {one.message: one.level for one in found(p, "check-range")} == {"Own": "error", "Few": "warning"}


# ---------------------------------------------------------------------- framings, sizes


def test_sizes_that_cannot_be() -> None:
    """Fields that make packets of another size than the framing's, or than any length says, are errors."""
    p = serial()
    fixed = p.framing(sync=b"\xaa", size=4)
    fixed("Right", payload=Struct(Const(1, Byte), "a" / Int16ul))
    fixed("Long", payload=Struct(Const(2, Byte), "a" / Int24ul))
    pairs = p.framing(
        sync=b"\xbb", header=Struct("words" / Byte), size=2 * this.words + 2, max_size=512, gap=1
    )
    pairs("Even", payload=Struct(Const(1, Byte), "a" / Int8ul))
    pairs("Odd", payload=Struct(Const(2, Byte), "a" / Int16ul))
    errors = [one.message for one in found(p, "size") if one.level == "error"]
    assert errors == ["Long", "Odd"]


def test_a_length_that_counts_otherwise() -> None:
    """A `max_size` that the length cannot say, and a shortest packet far above head and check, are doubtful."""
    p = serial()
    p.framing(sync=b"\xaa", header=Struct("length" / Byte), size=this.length + 9, max_size=300, gap=1)(
        "M", payload=Struct("data" / GreedyBytes)
    )
    texts = [one.text for one in found(p, "size")]
    assert any("max_size=300, but 'length' says at most 264 bytes" in text for text in texts)
    assert any("with length = 0 a packet has 9 bytes, 7 more" in text for text in texts)


def test_notes_on_framings() -> None:
    """No gap and no check are worth knowing."""
    p = serial()
    p.framing(sync=b"\xaa", header=Struct("length" / Byte), size=this.length + 2, max_size=100)(
        "M", payload=Struct("data" / GreedyBytes)
    )
    assert only(p, "gap").level == "note"
    assert only(p, "unchecked").level == "note"


# ---------------------------------------------------------------------- templates


def test_messages_that_nothing_can_be() -> None:
    """What `not_next` rules out, and what no configuration has, is unreachable."""
    p = serial()
    framing = p.framing(
        sync=b"\xff\xff", not_next=b"\xff", header=Struct("id" / Byte, "length" / Byte), size=this.length + 4,
        max_size=259, gap=1,
    )  # fmt: skip
    framing("Never", match={"id": 0xFF}, payload=Struct("data" / GreedyBytes))
    assert (only(p, "unreachable").message, only(p, "unreachable").level) == ("Never", "error")
    q = Protocol("probe", link="can", configurations={"small": {"kinds": {0: "a", 1: "b"}}})
    kinds = q.configured("kinds", by="node")
    q.message("Nowhere", id=0x100 + IdField("node", range(4)), when=kinds("c"), payload=Struct("a" / Byte))
    assert "no shipped dialect and configuration" in only(q, "unreachable").text


def test_messages_that_others_always_take() -> None:
    """With `overrides=`, a message whose every frame is another's is never reached; one that has more is."""
    p = can()
    p.message("Special", id=5, payload=Struct(Const(1, Byte), "a" / Byte))
    p.message("General", id=5, overrides="Special", payload=Struct("kind" / Byte, "a" / Byte))
    one = only(p, "unreachable")
    assert (one.message, one.level) == ("Special", "error")
    assert one.others == (p["General"].place,)
    q = can()
    q.message("General", id=5, payload=Struct("kind" / Byte, "a" / Byte))
    q.message("Special", id=5, overrides="General", payload=Struct(Const(1, Byte), "a" / Byte))
    assert not found(q, "unreachable")


def test_precedence_that_settles_nothing() -> None:
    """`overrides=` of a message that shares no packet is doubtful."""
    p = can()
    p.message("A", id=5, payload=Struct("a" / Byte))
    p.message("B", id=6, overrides="A", payload=Struct("a" / Byte))
    assert [(one.message, one.level) for one in found(p, "overrides")] == [("B", "warning")]


def test_requests_that_cannot_have_been() -> None:
    """A value that the request's field never has, the same direction, an age below 0."""
    p = can()
    ask = p.message(
        "Ask", id=1, direction="to device", payload=BitLayout(1, "what" / bits(2), "rest" / bits(6))
    )
    p.message("Answer", id=2, direction="from device", reply_to=ask.where(what=7), payload=Struct("a" / Byte))
    p.message("Echo", id=3, direction="to device", reply_to=ask, payload=Struct("a" / Byte))
    p.message("Late", id=4, direction="from device", reply_to=ask, within=-1, payload=Struct("a" / Byte))
    assert {one.message for one in found(p, "request") if one.level == "error"} == {"Answer", "Late"}
    assert only(p, "direction").message == "Echo"


def test_answers_that_lack_a_direction_or_have_the_number_of_another_request() -> None:
    """Both are seen from what they answer; an answer of several numbers is left alone."""
    made = Protocol("asked", link="can")
    ask = made.family(id=0x140, direction="to device", prefix=Struct("command" / Byte))
    tell = made.family(id=0x240, prefix=Struct("command" / Byte))
    speed = ask("GetSpeed", command=1, payload=Struct("zero" / Reserved(7)))
    angle = ask("GetAngle", command=2, payload=Struct("zero" / Reserved(7)))
    tell("Speed", command=1, reply_to=speed, payload=Struct("speed" / Int16ul))
    tell("Angle", command=2, reply_to=speed, direction="from device", payload=Struct("angle" / Int16ul))
    tell("Any", command={3, 4}, reply_to=angle, direction="from device", payload=Struct("x" / Int16ul))
    said = [finding.text for finding in check_protocol(made) if finding.level != "note"]
    assert said == [
        "Speed: no direction=; GetSpeed, which it answers, goes to device: direction='from device'",
        "Angle: reply_to=GetSpeed, but its command 0x02 is that of GetAngle",
    ]


def test_fields_in_another_order_than_their_bits() -> None:
    """Two flags of a mask swapped, or one bit twice; each mask for itself."""
    made = Protocol("masked", link="can")
    payload = Struct(
        "mask" / Byte,
        "more" / Byte,
        "a" / Present("mask", 0, Byte),
        "b" / Present("mask", 2, Byte),
        "c" / Present("more", 0, Byte),
        "d" / Present("mask", 1, Byte),
        "e" / Present("more", 0, Byte),
    )
    made.message("M", id=1, payload=payload)
    assert [finding.text for finding in check_protocol(made) if finding.rule == "mask"] == [
        "M: d is there by bit 1, behind b by bit 2 of mask: fields are mostly in the order of their bits",
        "M: e is there by the same bit as c of more: fields are mostly in the order of their bits",
    ]


def test_a_reply_that_is_never_recognised() -> None:
    """A reply that only its request tells, in a dialect that has no such request, cannot be."""
    p = Protocol("probe", link="can", dialects={"old": "", "new": ""})
    ask = p.message("Ask", id=1, dialect="old", direction="to device", payload=Struct("what" / Byte))
    p.message("A", id=2, direction="from device", reply_to=ask.where(what=1), payload=Struct("a" / Byte))
    p.message("B", id=2, direction="from device", reply_to=ask.where(what=2), payload=Struct("b" / Byte))
    errors = {one.message for one in found(p, "unreachable") if one.level == "error"}
    assert errors == {"A", "B"}


# ---------------------------------------------------------------------- several protocols


def test_protocols_on_one_bus_collide_with_a_witness() -> None:
    """Two protocols that claim a frame are found, exactly, and the witness is a frame of both."""
    one = Protocol("one", link="can")
    one.message("State", id=0x100 + IdField("node", range(8)), payload=Struct("a" / Int16ul))
    other = Protocol("other", link="can")
    other.message("Apart", id=0x110, payload=Struct("b" / Int16ul))
    other.message("Alike", id=0x105, payload=Struct(Const(3, Byte), "c" / Byte))
    variants = [one.variant(), other.variant()]
    (clash,) = check_wire(variants)
    assert (clash.rule, clash.level, clash.message) == ("collision", "error", "Alike")
    assert clash.witness is not None
    image = parse_packet(clash.witness, is_can=True).image
    assert one["State"].struct.parse(image, raw=True)["node"] == 5
    assert other["Alike"].struct.parse(image, raw=True)["c"] is not None
    apart = [one.variant().on("can0"), other.variant().on("can1")]
    assert not list(check_wire(apart))


def test_streams_on_one_line_collide_once() -> None:
    """Of two protocols with one sync the clearest pair is shown, the others are counted; other links never collide."""
    robotis, adc, hubo = (REGISTERED[name].variant() for name in ("robotis", "minihubo_adc", "hubo"))
    (clash,) = check_wire([robotis, adc, hubo])
    assert clash.witness is not None
    assert clash.witness.startswith("hex:FFFF")
    assert "more pairs of messages" in clash.text
