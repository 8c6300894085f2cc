"""A spec as a DBC: cantools decodes with it what we decode, and whatever it does not say is named.

1. cantools, strict, is the oracle of the text that is printed.
2. Nothing vanishes: each field has a signal, or a loss with its reason, or is what a DBC has elsewhere (identifiers).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from construct import Byte, Struct
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from aces_bus import Frame, FrameTable, Unknown, load_protocol, make_column_scanner, make_scanner
from aces_bus.errors import CallerError
from aces_bus.protocol import IdField, J1939Transport, Protocol, Variant
from aces_bus.protocol.exchange import load_database, print_dbc, print_source
from aces_bus.protocol.exchange.problems import Loss
from aces_bus.protocol.plan import nodes as p
from aces_bus.protocol.plan.flatten import fixed_leaves
from aces_bus.protocol.reference import Reference
from aces_bus.testing.strategies import protocols
from aces_protocols.canopen.spec import canopen
from aces_protocols.hubo.spec import hubo
from aces_protocols.robotis.spec import robotis
from tests.lab.exchange.test_export_wireshark import drawn, value_at
from tests.protocol.test_dbc_equal import databases
from tests.specs.catalogue import SPECS
from tests.tools.test_spec_import import run_source

cantools = pytest.importorskip("cantools")

IS_LONG = settings().max_examples > 100
OTHERS = ("automotive", "database_like", "mit_motor", "j1939_like", *(["odrive_like"] if IS_LONG else []))
VARIANTS = [
    hubo.variant("D12", "hubo2plus"),
    hubo.variant("D08", "hubo2"),
    *(SPECS[name].variants()[-1] for name in OTHERS),
]
#: What ships for CAN: a dialect of the protocol each, on the robot that has most of it.
SHIPPED = [
    VARIANTS[0],
    *(
        hubo.variant(dialect, robot)
        for dialect, robot in (("D08", "hubo2"), ("D08X", "hubo2"), ("D15", "drc_hubo"))
    ),
    canopen.variant(),
]
#: Messages of each but the first that are exported in the short profile: the others take seconds.
SAMPLE = 3


@cache
def dbc_of_hubo() -> tuple[str, list[Loss]]:
    return print_dbc(VARIANTS[0])


#: A message's name and its raw fields, None for what is not a message.
Decoded = tuple[str, Any] | None


def by_scanner(variant: Variant, frames: Sequence[Frame]) -> list[Decoded]:
    records = make_scanner([variant], include_unknown=True, raw=True).feed(frames)
    return [None if isinstance(one, Unknown) else (type(one).__name__, one) for one in records]


def by_reference(variant: Variant, frames: Sequence[Frame]) -> list[Decoded]:
    found = Reference([variant], raw=True).frames(frames)
    return [None if one.message is None else (one.message, one.fields) for one in found]


def check(variant: Variant, seeds: Iterable[int], decode: Any = by_scanner) -> tuple[int, list[Loss]]:
    """Assert that cantools decodes what we decode; how many values were compared, and what the DBC does not say."""
    text, losses = dbc_of_hubo() if variant is VARIANTS[0] else print_dbc(variant)
    shared = {loss.message for loss in losses if "share bits" in loss.reason}
    missing = {loss.message for loss in losses if not loss.field and "left out" in loss.reason}
    database = cantools.database.load_string(text, "dbc", strict=not shared)
    lost = {(loss.message, loss.field) for loss in losses}
    by_id = {(m.frame_id, m.is_extended_frame): m for m in database.messages}
    frames = drawn(variant, seeds)
    compared = 0
    for frame, decoded in zip(frames, decode(variant, frames), strict=True):
        if decoded is None or decoded[0] in shared | missing:
            continue
        name, record = decoded
        message = by_id.get((frame.arbitration_id, frame.is_extended_id))
        if message is None and frame.is_extended_id:  # a J1939 group stands for all its sources
            group = 0x3FF_FF00 if frame.arbitration_id >> 16 & 0xFF >= 240 else 0x3FF_0000
            message = next(m for m in database.messages if (m.frame_id ^ frame.arbitration_id) & group == 0)
        assert message is not None, (frame, record)
        try:
            found = message.decode(frame.data, decode_choices=False, allow_truncated=True)
        except cantools.database.errors.DecodeError:  # a value of a multiplexer that has no signal
            continue
        for leaf in fixed_leaves(variant[name])[0]:
            compared += _compare(leaf, name, record, found, lost)
    return compared, losses


def _compare(
    leaf: p.NodePath, name: str, record: Any, found: dict[str, Any], lost: set[tuple[str, str]]
) -> int:
    node = leaf.node
    if isinstance(node, (p.Rest, p.Opaque)) or (isinstance(node, p.FromIdentifier) and node.number is None):
        return 0
    raw = value_at(record, leaf.path)
    if raw is None:
        return 0
    own = next((n for n in (f"{name}_{leaf.identifier}", leaf.identifier) if n in found), None)
    if (
        own is None
        and isinstance(node, p.Scalar)
        and any(isinstance(step, p.FlagBits) for step in node.steps)
    ):
        bits = {
            n: v
            for n, v in found.items()
            if n.startswith((f"{name}_{leaf.identifier}_", f"{leaf.identifier}_"))
        }
        assert sum(bits.values()) > 0 or not int(raw), (leaf, raw, bits)
        return 1
    if own is None:
        assert (name, leaf.path) in lost, (name, leaf.path, found)
        return 0
    assert isinstance(node, (p.Scalar, p.FromIdentifier))
    if (name, leaf.path) in lost and "float" not in str(node.steps) and not isinstance(raw, (int, float)):
        return 0  # bytes as a number
    if isinstance(node, p.Scalar) and node.kind == "float" and len(node.place) == 16:
        return 0  # kept as raw
    if isinstance(node, p.Scalar) and any(isinstance(step, p.Magnitude) for step in node.steps):
        assert (name, leaf.path) in lost
        return 0
    scale = node.scale
    meant = raw * scale.scale + scale.offset if scale is not None else raw
    assert math.isclose(found[own], meant, rel_tol=1e-9, abs_tol=1e-300) or math.isnan(meant), (
        leaf,
        found[own],
        meant,
    )
    return 1


@pytest.mark.parametrize("variant", VARIANTS, ids=lambda variant: variant.label)
def test_cantools_decodes_what_we_decode(variant: Variant) -> None:
    """On random frames of every message; what has no signal is among the losses."""
    compared, _ = check(variant, range(40 if IS_LONG else 2))
    assert compared > 4


@pytest.mark.slow
@given(protocol=protocols(link="can"), seed=st.integers(0, 2**16))
@settings(max_examples=8, suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large])
def test_protocols_that_nobody_wrote(protocol: Protocol, seed: int) -> None:
    """Random specs: cantools reads what construct reads, or the printer says that there is nothing to say."""
    with suppress(CallerError):  # nothing of it can be said
        check(protocol.variant(), [seed], by_reference)


def test_losses_of_hubo_are_named_field_by_field() -> None:
    """With the reason, in the returned list and in the comments of the file."""
    text, losses = dbc_of_hubo()
    said = [str(loss) for loss in losses]
    assert "Reference.position.0: sign and magnitude: kept as raw, the top bit is the sign" in said
    assert "Parameters2: differs from Parameters1 in its request alone: left out" in said
    assert "InitSensor: differs from InitBoard in its length alone: left out" in said
    assert "Not as in the spec: position.0: sign and magnitude" in text
    assert "Not as in the spec: Parameters2: differs from Parameters1" in text
    assert len(said) == len(set(said))


@pytest.mark.slow
def test_a_message_an_identifier_and_multiplexers_by_opcode() -> None:
    """Captured boards become messages of their own, opcodes values of a multiplexer that are named after the message."""
    database = cantools.database.load_string(dbc_of_hubo()[0], "dbc", strict=True)
    assert database.get_message_by_name("Encoder_3").frame_id == 0x063
    assert database.get_message_by_name("Encoder_3").senders == ["Device"]
    commands = database.get_message_by_frame_id(0x001)
    opcode = commands.get_signal_by_name("opcode")
    assert opcode.is_multiplexer
    assert opcode.choices[0x0F] == "ControlOff"
    assert commands.get_signal_by_name("DeadZone_dead_zone").multiplexer_ids == [0x20, 0x21, 0x22, 0x23]
    assert commands.decode(bytes([3, 0x83, 20]), allow_truncated=True)["Beep_time"] == 2.0


def test_only_some_messages_and_fewer_identifiers() -> None:
    """`only` gives the one that bytes do not tell from others its place; `expand` bounds identifiers, and says so."""
    text, losses = print_dbc(VARIANTS[0], only=["Parameters4"])
    assert "max_pwm" in text
    assert [str(loss) for loss in losses] == ["Parameters4.selector: a field of the request: left out"]
    with pytest.raises(CallerError, match=r"nothing of it can be said in a DBC: Encoder\S*: .*left out"):
        print_dbc(VARIANTS[0], only=["Encoder"], expand=3)
    with pytest.raises(CallerError, match="a DBC is for CAN"):
        print_dbc(robotis.variant())


def test_hostile_text_stays_text() -> None:
    """Quotes, backslashes and line ends in names of values, units and documents do not end a string."""
    from construct import Byte, Struct

    from aces_bus.protocol import Enumeration, Quantity

    nasty = 'a"b\\"; BO_ 5 x: 8 y\n\\'
    protocol = Protocol("nasty", link="can", doc=nasty)
    payload = Struct(
        "mode" / Enumeration(Byte, {nasty: 1, "\\": 2}), "x" / Quantity(Byte, unit=nasty, doc=nasty)
    )
    protocol.message("Only", id=1, payload=payload, doc=nasty, source=nasty)
    text, _ = print_dbc(protocol.variant())
    database = cantools.database.load_string(text, "dbc", strict=True)
    assert [message.name for message in database.messages] == ["Only"]
    assert load_database_text(text).messages.keys() == {"Only"}


def load_database_text(text: str) -> Any:
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "made.dbc"
        path.write_text(text, encoding="utf-8")
        imported = load_database(path)
    assert not imported.losses, imported.problems
    return imported.protocol


@pytest.mark.slow
@given(text=databases())
@settings(max_examples=12)
def test_from_dbc_to_source_to_dbc(text: str) -> None:
    """Each signal is where it was, with its scale, unit, names and multiplexer, or is named."""
    first = load_database_text(text)
    again = run_source(print_source(first))
    made, losses = print_dbc(again.variant())
    second = load_database_text(made)
    lost = {(loss.message, loss.field) for loss in losses}
    assert {m.name for m in first.declared if (m.name, "") not in lost} <= set(second.messages)
    for message in first.declared:
        if (message.name, "") in lost:
            continue
        other = second.messages[message.name]
        assert (other.identifier.constant, other.extended, other.fd) == (
            message.identifier.constant, message.extended, message.fd
        )  # fmt: skip
        mine, theirs = ({x.path: x for x in m.plan.leaves} for m in (message, other))
        for path, leaf in mine.items():
            if (message.name, path) in lost or isinstance(leaf.node, p.Rest):
                continue
            assert theirs[path].node == leaf.node, (path, leaf, theirs[path])
            assert theirs[path].whens == leaf.whens
            assert theirs[path].doc == leaf.doc


# ---------------------------------------------------------------------- there and back


@pytest.mark.slow
@pytest.mark.parametrize("variant", SHIPPED, ids=lambda variant: variant.label)
def test_what_is_exported_reads_back_the_same(variant: Variant) -> None:
    """Of each shipped protocol on CAN, frames of every length: what we read with the exported file is what the spec reads,
    and what cantools reads with it."""
    names = list(variant.messages)
    if variant is SHIPPED[0]:
        text, losses = dbc_of_hubo()
    else:
        names = names if IS_LONG else names[:: len(names) // SAMPLE]
        text, losses = print_dbc(variant, only=names)
    again = load_database_text(text).variant()
    database = cantools.database.load_string(text, "dbc", strict=False)
    lost = {(loss.message, loss.field) for loss in losses}
    gone = {loss.message for loss in losses if not loss.field and "left out" in loss.reason}
    frames = [frame for frame in drawn(variant, range(2)) if not frame.is_remote_frame]
    scanner = make_column_scanner([again], include_unknown=True)
    back: dict[int, tuple[str, dict[str, Any]]] = {}
    for table in scanner.feed(FrameTable.from_frames(frames)) + scanner.close():
        values = {name: table[name].to_list() for name in table.names}
        numbers = {name: table[name].values.tolist() for name in table.names}
        for place, row in enumerate(table.row.tolist()):
            found = {name: numbers[name][place] for name in table.names if values[name][place] is not None}
            # a signal with the name of what we add is read with a _ behind it
            found |= {name[:-1]: value for name, value in found.items() if name.endswith("_")}
            back[row] = table.message, found
    compared = shorter = 0
    for number, (frame, decoded) in enumerate(zip(frames, by_scanner(variant, frames), strict=True)):
        if decoded is None or decoded[0] in gone or decoded[0] not in names:
            continue
        name, record = decoded
        message, found = back[number]
        assert message, (frame, name, found)
        for leaf in fixed_leaves(variant[name])[0]:
            compared += _compare(leaf, name, record, found, lost)
        theirs = database.get_message_by_frame_id(frame.arbitration_id)
        shorter += len(frame.data) < theirs.length
        with suppress(cantools.database.errors.DecodeError):  # a value of a multiplexer that has no signal
            shown = theirs.decode(frame.data, decode_choices=False, allow_truncated=True)
            assert {key: found[key] for key in shown} == shown
    assert compared > 4
    assert shorter or variant is not SHIPPED[0]


LONG_GROUP = """VERSION ""
NS_ :
BS_:
BU_: ECU
BO_ 2566834430 Long: 20 ECU
 SG_ speed : 64|16@1+ (0.125,0) [0|8031.875] "rpm" ECU
 SG_ last : 152|8@1- (1,0) [-128|127] "" ECU
BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved","J1939PG";
BA_DEF_DEF_ "VFrameFormat" "J1939PG";
BA_ "VFrameFormat" BO_ 2566834430 3;
"""


def test_parameter_groups_longer_than_a_frame(tmp_path: Path) -> None:
    """A group that J1939's transport carries has its length in the DBC: cantools decodes its packets, and it comes back."""
    path = tmp_path / "long.dbc"
    path.write_text(LONG_GROUP)
    (variant,) = load_protocol(str(path)).variants()
    assert isinstance(variant["Long"].transport, J1939Transport)
    text, losses = print_dbc(variant)
    assert [loss.field for loss in losses] == ["trailing"]
    (message,) = cantools.database.load_string(text, "dbc").messages
    assert (message.length, message.protocol) == (20, "j1939")
    records = make_scanner([variant], raw=True).feed(drawn(variant, range(5)))
    assert len(records) >= 5
    for record in records:
        found = message.decode(bytes(record.meta.raw), scaling=False)
        assert found == {"speed": record.speed, "last": record.last}
    path.write_text(text)
    (again,) = load_protocol(str(path)).variants()
    assert again["Long"].transport == variant["Long"].transport


def test_a_captured_part_of_a_byte_has_its_names_and_its_unit() -> None:
    """What a byte's constant adds is taken off by the offset; names stand at the whole byte, for one message each."""
    made = Protocol("captures", link="can", source="drawn")
    axis = IdField("axis", (2, 3), names={"left": 2, "right": 3})
    heat = IdField("heat", range(8), unit="K", scale=10, offset=250)
    for name, identifier, capture in (("Moved", 0x100, axis), ("Hot", 0x200, heat)):
        made.message(
            name,
            id=identifier,
            prefix=Struct("op" / Byte),
            match={"op": 0x40 + capture},
            payload=Struct("x" / Byte),
        )
    database = cantools.database.load_string(print_dbc(made.variant())[0], "dbc")
    assert database.decode_message(0x100, b"\x43\x01") == {"axis": "right", "x": 1}
    assert database.decode_message(0x200, b"\x43\x01") == {"heat": 280, "x": 1}
    assert database.get_message_by_name("Hot").get_signal_by_name("heat").unit == "K"
