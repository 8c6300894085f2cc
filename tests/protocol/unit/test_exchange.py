"""Imported databases, and pictures: what is compared with the plan."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from aces_bus import (
    Frame,
    FrameTable,
    list_protocols,
    load_protocol,
    make_column_scanner,
    make_scanner,
)
from aces_bus.errors import CallerError
from aces_bus.protocol import (
    Protocol,
)
from aces_bus.protocol.draw.cells import SHARING
from aces_bus.protocol.draw.table import FieldRow
from aces_bus.protocol.draw.text import draw_text, picture
from aces_bus.protocol.exchange import import_dbc as dbc
from aces_bus.protocol.exchange import load_database
from aces_bus.protocol.exchange.export_stubs import print_stub
from aces_bus.protocol.exchange.names import PythonNames
from aces_bus.protocol.generate import load as loading
from aces_bus.protocol.plan import nodes as p
from aces_bus.protocol.plan.flatten import flatten
from aces_lab.exchange import print_dissector
from tests.protocol.imported import decoded, imported
from tests.protocol.test_items import KINDS as KINDS
from tests.protocol.test_items import lists_in_items as lists_in_items
from tests.protocol.test_items import stream as stream
from tests.protocol.test_items import tlv as tlv
from tests.specs.catalogue import SPECS
from tests.tools.conftest import aces as aces

J1939 = 'BA_DEF_ "ProtocolType" STRING ;\nBA_DEF_DEF_ "ProtocolType" "";\nBA_ "ProtocolType" "J1939";\n'
PROTOCOLS: dict[str, Protocol] = {name: load_protocol(name) for name in list_protocols()} | SPECS
every_protocol = pytest.mark.parametrize("protocol", PROTOCOLS.values(), ids=list(PROTOCOLS))
line = Protocol("drawn_line", link="serial")


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("a.dbc", "BO_ 1 M: 8 X\n" * 32_769, "32,769 messages; at most 32,768"),
        (
            "a.dbc",
            "BO_ 1 M: 8 X\n" + ' SG_ s : 0|1@1+ (1,0) [0|0] "" X\n' * 1_001,
            "1,001 signals; at most 1,000",
        ),
        ("a.kcd", "<Message/>" * 32_769, "32,769 messages; at most 32,768"),
        ("a.sym", "ID=001h\n" * 32_769, "32,769 messages; at most 32,768"),
        ("a.arxml", "<CAN-FRAME>" * 32_769, "32,769 messages; at most 32,768"),
    ],
    ids=["dbc", "dbc-signals", "kcd", "sym", "arxml"],
)
def test_more_than_is_read_is_refused_by_number(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, text: str, said: str
) -> None:
    """Before any of it is parsed."""
    monkeypatch.setattr(dbc, "MOST_SIGNALS", 1_000)
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    with pytest.raises(CallerError, match=said):
        load_database(path)


def test_code_is_made_for_the_messages_that_come(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a large database, and for each way to decode: nothing before the first frame, then one message's."""
    made: list[str] = []
    load = loading.load_source

    def counted(source: str, name: str, names: Any) -> dict[str, Any]:
        made.append(name)
        return load(source, name, names)

    monkeypatch.setattr(loading, "load_source", counted)
    body = "".join(f'BO_ {n} M{n}: 8 ECU\n SG_ a : 0|8@1+ (0.5,0) [0|0] "" Gate\n' for n in range(1, 300))
    found = imported(tmp_path, body)
    variant = found.protocol.variant()
    scanner = make_scanner([variant])
    columns = make_column_scanner([variant])
    assert made == []
    frame = Frame(7, b"\3" + bytes(7))
    for _ in range(3):
        (record,) = scanner.feed([frame])
        (table,) = columns.feed(FrameTable.from_frames([frame]))
        assert record.a == table["a"].values[0] == 1.5
    assert len(made) == 2  # the record's type, and what decodes it
    assert all(name.endswith(": M7") for name in made)


def test_declaring_compares_only_what_may_clash(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The work grows with the number of messages, not with its square."""
    from aces_bus.protocol.declare import ambiguity

    asked = 0
    unresolved = ambiguity.unresolved

    def counted(one: Any, other: Any) -> Any:
        nonlocal asked
        asked += 1
        return unresolved(one, other)

    monkeypatch.setattr(ambiguity, "unresolved", counted)
    body = "".join(f"BO_ {0x98FE0000 | n << 8} M{n}: 8 ECU\n" for n in range(200))
    body += "".join(f"BO_ {n} S{n}: 8 ECU\n" for n in range(1, 200))
    assert len(imported(tmp_path, body + J1939).protocol.declared) == 399
    assert asked <= 399


def test_the_collector_is_as_it_was(tmp_path: Path) -> None:
    """Loading pauses the garbage collector, also where it fails."""
    import gc

    path = tmp_path / "none.dbc"
    for _ in range(2):
        with pytest.raises(CallerError):
            dbc.load_dbc(str(path))
        assert gc.isenabled()


def test_a_plain_name_stays() -> None:
    """Only what cannot be a Python name changes."""
    assert [PythonNames.of(n) for n in ("Speed", "1st gear", "_x", "a-b", "", "__", "größe")] == [
        "Speed",
        "n1st_gear",
        "x_",
        "a_b",
        "unnamed",
        "unnamed_",
        "gr__e",
    ]


def test_a_large_database_is_quick(tmp_path: Path) -> None:
    """Messages are told apart by a glance at their identifiers, and compiled when they are first seen."""
    body = "".join(f'BO_ {n} M{n}: 8 ECU\n SG_ a : 0|8@1+ (0.5,0) [0|0] "" Gate\n' for n in range(1, 400))
    from aces_bus.protocol.declare import ambiguity

    ambiguity.conflict.cache_clear()  # of what other tests have declared
    found = imported(tmp_path, body)
    assert len(found.protocol.declared) == 399
    assert ambiguity.conflict.cache_info().currsize < 60_000
    (record,) = decoded(found, Frame(7, b"\x03" + bytes(7)))
    assert record.a == 1.5


def test_a_container_is_listed(tmp_path: Path) -> None:
    """AUTOSAR's messages of several messages are none that we hold; nor is one without identifier and length of ours."""
    from cantools.database import Database
    from cantools.database.can import Message

    from aces_bus.protocol.exchange.import_build import build

    inner = Message(1, "Inner", 8, [], header_id=5)
    database = Database([Message(2, "Outer", 64, [], contained_messages=[inner], is_fd=True), inner])
    protocol, problems = build(database, "car", "car.arxml", lambda message, signal: 3)
    assert [m.name for m in protocol.declared] == ["Inner"]
    assert [str(p) for p in problems] == ["line 3: message Outer: a container of other messages: left out"]


def test_drawings_and_tables_see_lists_inside_items() -> None:
    """A panel for each group, a line a value, with the place in its group."""
    plan = lists_in_items().variant()["M"].plan
    picture = "\n".join(draw_text(plan))
    assert "data of items.sky, tag 1, each of data.satellites:" in picture
    rows = {row.name: row for row in FieldRow.table(plan)}
    level = rows["items.sky.satellites.level"]
    assert (level.place, level.unit, level.scale) == ("byte 1 of each in tag 1", "dB", "0.5")
    assert rows["items"].type == "items, by construct"


def test_drawings_tables_and_types_see_inside() -> None:
    """The picture has a panel a kind, the table and the stub a line a value, the dissector a tree an item."""
    protocol = tlv()
    message = protocol.variant()["M"]
    picture = "\n".join(draw_text(message.plan))
    assert "data of items.gyro, tag 2:" in picture
    rows = {row.name: row for row in FieldRow.table(message.plan)}
    assert rows["items.temperature"].place == "byte 0…1 of tag 1"
    assert (rows["items.temperature"].unit, rows["items.state.mode"].names) == ("°C", "0=off, 1=on")
    stub = print_stub(protocol, "m")
    assert 'kind: Literal["temperature", "gyro", "state", "text", "key"] | int | None' in stub
    assert "items: tuple[_M_items, ...]" in stub
    source, losses = print_dissector(protocol.variant())
    assert losses == []
    assert all(f'"m.items.{name}"' in source for name in ("temperature", "state.mode", "key.number"))


ROW = re.compile(r"^ *(\S+) │(.*)│$")


Rows = dict[int, list[tuple[int, str]]]


def cells(lines: list[str]) -> list[Rows]:
    """Of each picture of what is always there: of each byte that has a row of its own, the cells: (bits, text), bit 7
    first."""
    found: list[Rows] = [{}]
    is_always = True
    for line in lines:
        if line == "":
            is_always = False  # pictures of multiplexed fields follow
        elif line == SHARING:
            found.append({})
            is_always = True
        elif line.endswith(":"):
            break
        row = ROW.match(line)
        if is_always and row is not None and row[1].isdecimal():
            found[-1][int(row[1])] = [((len(text) + 1) // 9, text.strip()) for text in row[2].split("│")]
    return found


@every_protocol
def test_every_message_can_be_drawn(protocol: Protocol) -> None:
    """A picture fits 79 columns, its frame is closed, and each byte has eight bits; each bit is where the plan has it.

    The cell at a bit's place names the bit's field, and the bit's number where the field has several cells.
    """
    for message in protocol.declared:
        lines = picture(message)
        assert max(map(len, lines)) <= 79, message
        assert all(line == line.rstrip() for line in lines), message
        assert all(len(line) == 79 for line in lines if line[6:7] in ("│", "┌", "├", "└")), message
        pictures = cells(lines)
        for rows in pictures:
            assert all(sum(width for width, _ in row) == 8 for row in rows.values()), message
        for name, scalar in scalars(flatten(message).fields, ""):
            if not any(isinstance(step, p.FlagBits) for step in scalar.steps):
                assert any(is_drawn(name, scalar, rows) for rows in pictures), (message, name)


def is_drawn(name: str, scalar: p.Scalar, rows: Rows) -> bool:
    """Whether all bits of a field are where the plan has them."""
    for index, position in enumerate(scalar.bits):
        row = rows.get(position // 8)
        if row is None:
            continue  # a long message has one row for a whole number
        at = 7
        for width, text in row:
            if at - width < position % 8 <= at:
                shown = text.partition("…")[0].partition(" ")[0]
                if not shown or not any(n.startswith(shown) for n in (name, name.rpartition(".")[2])):
                    return False
                numbers = re.search(r" (\d+)(?:…(\d+))?$", text)
                if numbers and int(numbers[1]) - (at - position % 8) != index:
                    return False
                if not numbers and width != len(scalar.bits):
                    return False
                break
            at -= width
    return True


def scalars(fields: tuple[p.PlanField, ...], prefix: str) -> Iterator[tuple[str, p.Scalar]]:
    """Integers that are always there, by their names in pictures."""
    for field in fields:
        if field.when is not None:
            continue
        if isinstance(field.node, p.NestedRecord):
            yield from scalars(field.node.fields, f"{prefix}{field.name}.")
        elif isinstance(field.node, p.Many):
            for index, item in enumerate(field.node.items):
                if isinstance(item, p.Scalar):
                    yield f"{prefix}{field.name}.{index}", item
        elif isinstance(field.node, p.Scalar):
            yield prefix + field.name, field.node
