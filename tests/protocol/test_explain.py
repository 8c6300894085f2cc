"""What is explained is what happens: the same records as the scanner's, and templates that die exactly when they must."""

from __future__ import annotations

from typing import Any

import pytest
from construct import Array, Byte, Const, Int16ul, Struct, this

from aces_bus import Frame, Unknown
from aces_bus.protocol import Protocol, Sum, Variant
from aces_bus.protocol.declare.examples import parse_packet
from aces_bus.protocol.explain import why_unknown
from aces_bus.protocol.explain.attempt import Attempt
from aces_bus.protocol.explain.template import Template
from aces_bus.protocol.explain.tracer import Tracer
from aces_bus.protocol.lint.examples import example_frame
from aces_bus.testing import LAWS, laws
from aces_bus.testing.trial import ScannedItem, comparable, join_losses
from aces_protocols.hubo.spec import hubo
from aces_protocols.robotis.spec import robotis
from tests.laws.drawn import drawn_arguments
from tests.laws.wires import CASES, MIXED, Case

#: Wires of a protocol, which its cases share.
WIRES = 3
#: Of a protocol that has many dialects, configurations and directions, about three cases; of each the first.
SOME = [case for number, case in enumerate(CASES) if number % -(-case.share // 3) == 0]
FIRST = list({laws.wire_variants(case.wire)[0].name: case for case in reversed(CASES)}.values())[::-1]


def heard_of(attempts: list[Attempt]) -> list[ScannedItem]:
    """Attempts in the form in which scanners and reference are compared."""
    found = [
        ScannedItem(
            number if one.is_can else one.start,
            one.found.size * one.run,
            one.found.message,
            comparable(one.found.fields),
            one.found.reason,
            one.found.protocol,
        )
        for number, one in enumerate(attempts)
    ]
    return found if attempts and attempts[0].is_can else join_losses(found)


def explained(variants: tuple[Variant, ...], direction: Any, scene: Any) -> list[Attempt]:
    tracer = Tracer(variants, direction=direction)
    if isinstance(scene.traffic, bytes):
        return tracer.explain_stream(scene.traffic, idle_at=scene.idle_at, sent_at=scene.sent_at)
    attempts: list[Attempt] = []
    at = 0
    for offset, frame in [*scene.sent_at, (len(scene.traffic), None)]:
        for one in scene.traffic[at:offset]:
            attempts += tracer.explain_frames([one], len(attempts))
        at = offset
        if frame is not None:
            tracer.sent_frame(frame)
    return attempts + tracer.explain_end()


@pytest.mark.parametrize("case", [*SOME, *MIXED], ids=str)
def test_what_is_explained_is_what_scanners_hear(case: Case) -> None:
    """Over drawn wires the attempts are the scanner's records and losses; who is accepted lives, who is not dies."""
    variants = laws.wire_variants(case.wire)
    for seed in range(max(1, WIRES // case.share)):
        (scene,) = drawn_arguments(LAWS[0], case.wire, case.direction, seed, size=100)
        attempts = explained(variants, case.direction, scene)
        scanner = laws.scanner_of(case.wire, case.direction, raw=False)
        assert heard_of(attempts) == laws.scanned_items(scanner, scene)
        for attempt in attempts:
            alive = attempt.steps[-1].alive if attempt.steps else ()
            names = {name.rpartition(".")[2] for name in alive}
            if attempt.found.message is not None:
                assert names == {attempt.found.message}
            elif attempt.found.reason != "pending":
                assert not names, (attempt.verdict, attempt.steps[-1])
            every = [death.template for step in attempt.steps for death in step.died]
            assert len(every) == len(set(every)), "a template dies once"


@pytest.mark.parametrize("case", FIRST, ids=str)
def test_values_read_on_the_way_are_the_records_values(case: Case) -> None:
    """A field that is shown when its last bit comes has the value that the record has in the end."""
    variants = laws.wire_variants(case.wire)
    (scene,) = drawn_arguments(LAWS[0], case.wire, case.direction, 7, size=150)
    for attempt in explained(variants, case.direction, scene):
        fields = attempt.found.fields
        for reading in (r for step in attempt.steps for r in step.read) if fields is not None else ():
            value: Any = fields
            for part in reading.name.split("."):
                value = value[int(part)] if isinstance(value, (list, tuple)) else value[part]
            assert comparable(reading.value) == comparable(value), reading


def test_a_packet_part_by_part() -> None:
    """Length and instruction rule templates out; what is left is read, and the check says whether it was right."""
    tracer = Tracer([robotis.variant()], direction="to device")
    good, bad, *rest = tracer.explain_stream(bytes.fromhex("FF FF 01 04 02 00 32 C6 FF FF 01 02 01 FC"))
    assert [step.what for step in good.steps] == [
        "sync", "sync", "id", "length", "instruction", "start", "count", "check",
    ]  # fmt: skip
    assert {death.template for death in good.steps[3].died} == {"Ping", "Action", "Reset"}
    assert [(r.name, r.value) for step in good.steps for r in step.read] == [
        ("id", 1),
        ("start", 0),
        ("count", 50),
    ]
    assert (good.verdict, good.resumes) == ("Read", 8)
    (last,) = bad.steps[-1].died
    assert (last.template, last.why, last.detail) == ("Ping", "check", "FB, not FC")
    assert (bad.verdict, bad.start, bad.resumes) == ("malformed: checksum", 8, 9)
    (skipped,) = rest
    assert (skipped.start, skipped.run, skipped.verdict) == (9, 5, "skipped")


def test_a_request_decides_between_replies() -> None:
    """Of replies that look alike all live to the last byte; the request that was seen is named."""
    tracer = Tracer([hubo.variant()])
    reply = "1C5#C8 00 01 00 F4 01 A0 4F"
    frames = [example_frame(parse_packet(text, is_can=True)) for text in ("001#05 24 07", reply, reply)]
    _, told, lost = tracer.explain_frames(frames)
    assert told.verdict == "Parameters1"
    assert told.request is not None
    assert told.request[0] == "GetParameters"
    assert "Parameters2" in {death.template for death in told.steps[-1].died if death.why == "request"}
    assert lost.verdict == "unknown: needs request GetParameters|SendCurrent"
    assert {death.why for death in lost.steps[-1].died} == {"request"}


def test_what_lies_outside_is_left_out() -> None:
    """`wanted` keeps the attempts that touch it; offsets count from `base`."""
    data = bytes.fromhex("FF FF 01 02 01 FB") * 3
    tracer = Tracer([robotis.variant()], direction="to device")
    (one,) = tracer.explain_stream(data, base=100, wanted=range(107, 108))
    assert (one.start, one.resumes, one.steps[0].place) == (106, 112, "106")


def test_long_packets_are_told_by_their_ends() -> None:
    """Of a packet of thousands of bytes the first parts and the last are explained, and the others counted."""
    from construct import GreedyBytes, Int16ul, Struct, this

    from aces_bus.protocol import Sum

    protocol = Protocol("long", link="serial")
    framing = protocol.framing(
        sync=b"\xa5", header=Struct("length" / Int16ul), size=this.length + 4, max_size=60000, check=Sum()
    )
    framing("Blob", payload=Struct("data" / GreedyBytes))
    packet = protocol.encode("Blob", data=bytes(5000))
    (attempt,) = Tracer([protocol.variant()]).explain_stream(packet)
    assert attempt.verdict == "Blob"
    assert len(attempt.steps) < 200
    assert attempt.left_out + len(attempt.steps) == len(packet)
    assert attempt.steps[-1].what == "check"


def test_a_template_never_kills_what_its_construct_takes() -> None:
    """Every worked example of every shipped message lives to its end in its own template."""
    for protocol in (hubo, robotis):
        for message in protocol.declared:
            template = Template(message, message.name)
            for example in message.examples:
                data = example.packet.data
                for size in range(1, len(data) + 1):
                    assert template.death(data[:size], None, None) is None, (message, size)


def test_error_frames_have_no_parts() -> None:
    """A frame that says that the bus had an error is not a message of anybody."""
    (attempt,) = Tracer([hubo.variant()]).explain_frames([Frame(1, b"", is_error_frame=True)])
    assert (attempt.verdict, attempt.steps) == ("error frame", ())


def test_a_whole_packet_that_is_no_message_says_which_bytes() -> None:
    """With the right head and check, and a wrong body: the message, and what is another in it; nothing of other heads."""
    protocol = Protocol("whole", link="serial")
    packet = protocol.framing(
        sync=b"\xa5",
        header=Struct("length" / Byte, "kind" / Byte),
        size=this.length + 3,
        max_size=64,
        check=Sum(),
    )
    packet("One", match={"kind": 1}, payload=Struct("a" / Byte, Const(7, Byte), "b" / Int16ul))
    packet("Two", match={"kind": 2}, payload=Struct("n" / Byte, "b" / Array(this.n, Int16ul)))
    variant = protocol.variant()

    def why(body: str) -> str:
        inner = bytes([len(bytes.fromhex(body))]) + bytes.fromhex(body)
        items = protocol.scanner(include_unknown=True).feed(b"\xa5" + inner + bytes([sum(inner) & 0xFF]))
        (item,) = items
        assert isinstance(item, Unknown)
        assert item.reason == "unknown"
        return why_unknown(item, [variant])

    assert why("01 09 08 01 00") == "One: byte 4 07, not 08"
    assert why("01 09 07 01") == "One: length 8 bytes, not 7"
    assert why("02 02 01 00").startswith("Two: length stream read less")
    assert why("05 01") == ""


def test_a_frame_that_is_no_message_says_which_bytes() -> None:
    """Of frames whose identifier is a message's."""
    protocol = Protocol("framed", link="can")
    protocol.message("State", id=0x10, payload=Struct("a" / Byte, Const(7, Byte)))
    scanner = protocol.scanner(include_unknown=True)
    items = scanner.feed([Frame(0x10, b"\x01\x08"), Frame(0x11, b"\x01\x07")])
    found = [why_unknown(item, [protocol.variant()]) for item in items if isinstance(item, Unknown)]
    assert found[0].startswith("State: ")
    assert "07, not 08" in found[0]
    assert found[1] == ""


def test_without_a_protocol_nothing_explains_an_unknown_frame() -> None:
    """Then there is no message that it could have been."""
    (item,) = hubo.scanner(include_unknown=True).feed([Frame(0x7FF, b"")])
    assert isinstance(item, Unknown)
    assert why_unknown(item, []) == ""
