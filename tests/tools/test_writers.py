"""The three writers, on what scanners of many protocols give."""

from __future__ import annotations

import csv
import io
import json
import math
from typing import Any

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from aces_bus import Frame, Unknown, as_dict, list_protocols, load_protocol, make_scanner
from aces_bus.plain_text import cell_text
from aces_bus.protocol import FlagSet, Protocol, Variant
from aces_bus.testing import strategies
from aces_tools.output import Writer
from aces_tools.output.columns import beside, column_output
from aces_tools.output.csv import CsvOutput, cell
from aces_tools.output.jsonl import JsonLines
from aces_tools.output.shape import Plans, RecordLeaf, plain_of, plans_of, record_leaves
from aces_tools.output.text import TextOutput, Times, make_paint, no_paint, printable
from aces_tools.output.value_text import decimals
from tests.laws.drawn import wires_of
from tests.specs.catalogue import SPECS

PROTOCOLS: dict[str, Protocol] = {name: load_protocol(name) for name in list_protocols()} | SPECS
#: One variant of each, in one direction: writers know neither dialects nor configurations.
CASES = [next(iter(wires_of(protocol))) for protocol in PROTOCOLS.values()]
#: A writer knows no protocols either: the cases share the examples.
EXAMPLES = max(3, settings().max_examples // 4)


def items_of(variant: Variant, way: Any, scene: Any) -> list[Any]:
    """Everything that a scanner makes of a scene's traffic."""
    scanner = make_scanner([variant], direction=way, include_unknown=True)
    return [*scanner.feed(scene.traffic), *scanner.close()]


def plain(value: Any) -> Any:
    """What JSON must read back, but for the last digit of scaled integers: the slow, obvious way."""
    if isinstance(value, FlagSet):
        return [*value, *([hex(value.unknown)] if value.unknown else [])]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, bytes):
        return value.hex()
    if isinstance(value, dict):
        return {name: plain(inner) for name, inner in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(inner) for inner in value]
    return value


def is_nearly(one: Any, other: Any) -> bool:
    """Whether two plain values are the same, but for the last digit of floats."""
    if isinstance(one, float) and isinstance(other, float):
        return one == other or math.isclose(one, other, rel_tol=1e-14, abs_tol=1e-9)
    if isinstance(one, dict) and isinstance(other, dict):
        return list(one) == list(other) and is_nearly([*one.values()], [*other.values()])
    if isinstance(one, list) and isinstance(other, list):
        return len(one) == len(other) and all(map(is_nearly, one, other))
    return type(one) is type(other) and bool(one == other)


@pytest.mark.parametrize(("variant", "way"), CASES, ids=str)
@settings(max_examples=EXAMPLES)
@given(data=st.data())
def test_writers_say_what_records_hold(variant: Variant, way: Any, data: st.DataObject) -> None:
    """Whatever came over the wire, each of the three formats has all of it, as the slow and obvious ways have it."""
    items = items_of(variant, way, data.draw(strategies.scenes(variant, way, size=200)))
    printed_functions_give_what_the_slow_ways_give(variant, items)
    record_lines_say_what_records_hold(variant, items)
    text_is_safe_and_whole(variant, items)
    rows_have_the_columns_of_the_header(variant, items, data.draw(st.sampled_from(sorted(variant.messages))))


def printed_functions_give_what_the_slow_ways_give(variant: Variant, items: list[Any]) -> None:
    """Lines of all three formats, by functions printed from the plan, are to the byte what walking the plan for each record
    makes of them."""
    plans, link = plans_of([variant]), "can" if variant.link == "can" else "serial"
    text, slow_text = TextOutput(plans, None), TextOutput(plans, None, paint=lambda style, one: one)
    lines, rows = JsonLines(plans, None), CsvOutput(plans, None, only=None, links=frozenset({link}))
    for writer in (text, slow_text, lines, rows):
        writer.begin("x", link, 0.0)
    assert text.items(items) == slow_text.items(items)
    for item in items:
        if isinstance(item, Unknown):
            continue
        plan = plans[type(item)]
        line, row = lines.items([item]).decode(), rows.items([item]).decode()
        fields = {one.name: plain_of(one.node)(getattr(item, one.name)) for one in plan.fields}
        made = msgspec.json.format(msgspec.json.encode(fields), indent=0).decode()
        assert line.endswith(f', "fields": {made}}}\n')
        leaves = [leaf for leaf in record_leaves(plan) if not leaf.is_inside or leaf.get(item) is not None]
        found = [tuple(cells[-3:]) for cells in csv.reader(io.StringIO(row, newline=""))]
        made_cells = [(leaf.path, slow_cell(leaf, item), leaf.node.unit) for leaf in leaves]
        assert found == (made_cells or [("", "", "")])


def slow_cell(leaf: RecordLeaf, item: Any) -> str:
    """A value as it is read from a cell."""
    value = leaf.get(item)
    if isinstance(value, float) and math.isfinite(value):
        value = plain_of(leaf.node)(value)
    made = cell(value, plain_of(leaf.node))
    return "" if made is None else cell_text(made) if isinstance(made, str) else str(made)


def record_lines_say_what_records_hold(variant: Variant, items: list[Any]) -> None:
    """One line an item, and reading the line gives the record's values, whatever came over the wire."""
    writer = JsonLines(plans_of([variant]), None)
    writer.begin("x", "can" if variant.link == "can" else "serial")
    lines = writer.items(items).decode().split("\n")
    assert lines.pop() == ""
    assert len(lines) == len(items)
    for line, item in zip(lines, items, strict=True):
        read = json.loads(line)
        if isinstance(item, Unknown):
            assert (read["reason"], read["raw"], read["message"]) == (item.reason, item.meta.raw.hex(), None)
        else:
            assert is_nearly(read["fields"], plain(as_dict(item)))
            assert (read["message"], read["protocol"]) == (item.meta.message, item.meta.protocol)
            assert list(read["fields"]) == list(as_dict(item))
        if variant.link == "can":
            assert (read["id"], read["extended"], read["fd"]) == (
                *(item.meta.identifier, item.meta.extended, item.meta.fd),
            )
        else:
            assert (read["offset"], read["size"]) == (item.meta.offset, item.meta.size)


def text_is_safe_and_whole(variant: Variant, items: list[Any]) -> None:
    """Without a terminal one item is one line; nothing printed is a control character; a width is kept, word by word."""
    link = "can" if variant.link == "can" else "serial"
    plain_writer = TextOutput(plans_of([variant]), None)
    plain_writer.begin("x", link)
    text = plain_writer.items(items).decode()
    assert text.replace("\n", "").isprintable()
    assert text.count("\n") == (len(items) + 1 if items else 0)
    narrow = TextOutput(plans_of([variant]), None, width=80)
    narrow.begin("x", link)
    cut = narrow.items(items).decode()
    assert cut.split() == text.split()
    coloured = TextOutput(plans_of([variant]), None, width=80, paint=make_paint())
    coloured.begin("x", link)
    marked = coloured.items(items).decode()
    for before, after in STYLE_MARKS:
        marked = marked.replace(before, "").replace(after, "")
    assert marked == cut


def _marks() -> list[tuple[str, str]]:
    from aces_tools.output.text import STYLES

    paint = make_paint()
    pairs = [tuple(paint(style, "\0").split("\0")) for style in STYLES if style != "value"]
    return sorted({(a, b) for a, b in pairs}, key=lambda pair: -len(pair[0]))


STYLE_MARKS = _marks()


def rows_have_the_columns_of_the_header(variant: Variant, items: list[Any], name: str) -> None:
    """Every row of both forms of CSV has as many cells as the header, whatever the values."""
    link = "can" if variant.link == "can" else "serial"
    for only in (None, name):
        kept = [item for item in items if only is None or type(item).__name__ == only]
        writer = CsvOutput(plans_of([variant]), None, only=only, links=frozenset({link}))
        text = (writer.begin("x", link) + writer.items(kept)).decode()
        head, *rows = list(csv.reader(io.StringIO(text, newline="")))
        assert all(len(row) == len(head) for row in rows)
        assert len(set(head)) == len(head)
        if only is not None:
            assert len(rows) == len(kept)


# ---------------------------------------------------------------------- text by example

mixed = Protocol("mixed_text", link="can")


def _declare() -> None:
    from construct import Byte, Bytes, GreedyBytes, Int16sb, Struct

    from aces_bus.protocol import Flags, Quantity
    from aces_bus.protocol import Text as TextField

    mixed.message(
        "State",
        id=0x10,
        direction="from device",
        payload=Struct(
            "angle" / Quantity(Int16sb, scale=0.1, unit="°", unknown=(0x7FFF,)),
            "error" / Flags(Byte, hot=0),
            "n" / Byte,
        ),
    )
    mixed.message("Name", id=0x11, direction="to device", payload=Struct("name" / TextField(8)))
    mixed.message("Blob", id=0x12, payload=Struct("head" / Bytes(2), "rest" / GreedyBytes))
    mixed.message("Empty", id=0x13, length=0)
    mixed.message("Level", id=0x14, payload=Struct("height" / Quantity(Int16sb, scale=0.01, unit="m")))


_declare()


def shown(*frames: Frame, width: int | None = None, encoding: str = "utf-8", **options: Any) -> list[str]:
    """The lines of frames, without the title."""
    scanner = mixed.scanner(include_unknown=True)
    writer = TextOutput(plans_of([mixed.variant()]), None, width=width, encoding=encoding, **options)
    items = scanner.feed(frames)
    writer.begin("x.log", "can", items[0].meta.time)
    return writer.items(items).decode(encoding).split("\n")[1:-1]


def test_a_line() -> None:
    """Time, channel, identifier, direction, message, fields with units: what a person wants to see, in columns."""
    assert shown(
        Frame(0x10, bytes([0, 123, 1, 7]), 2.5, "can0"), Frame(0x7FF, b"\xde\xad", 2.75, "can0")
    ) == [
        "    0.000000  can0  010 ← State  angle=12.3 °  error={hot}  n=7",
        "    0.250000  can0  7FF   unknown  DE AD",
    ]


def test_values_inside_what_construct_decodes_have_their_units() -> None:
    """In records, in lists of records and layouts, at any depth: as those of flat messages."""
    from construct import Byte, GreedyRange, Int8sl, Struct, VarInt

    from aces_bus.protocol import BitLayout, Quantity, bits

    deep = Protocol("deep", link="can")
    payload = Struct(
        "n" / VarInt,
        "s" / Struct("a" / Quantity(Int8sl, unit="m"), "b" / BitLayout(1, "t" / Quantity(bits(4), unit="s"))),
        "l" / GreedyRange(Struct("i" / Quantity(Byte, unit="A"), "k" / Byte)),
    )
    deep.message("M", id=1, payload=payload)
    assert not deep["M"].plan.is_flat
    record = deep.scanner().feed([Frame(1, bytes([1, 5, 2, 7, 8, 9, 10]))])
    writer = TextOutput(plans_of([deep.variant()]), None)
    writer.begin("x.log", "can", None)
    said = "s={a=5 m, b={t=2 s, reserved=0}}  l=[{i=7 A, k=8}, {i=9 A, k=10}]"
    assert said in writer.items(record).decode()


def test_columns_settle() -> None:
    """Fields of a message stand below each other once the widest has been seen."""
    lines = shown(*(Frame(0x10, bytes([0, n, 0, n]), 0.0, "can0") for n in (250, 1, 20)))
    assert [line.index("n=") for line in lines] == [lines[0].index("n=")] * 3


def test_what_is_not_known_says_so() -> None:
    """A value that means `not known` is not a number."""
    (line,) = shown(Frame(0x10, bytes.fromhex("7FFF0001"), 0.0, "can0"))
    assert "angle=unknown  " in line


def test_control_characters_are_escaped() -> None:
    """A text cannot move the cursor, nor can the name of an interface."""
    (line,) = shown(Frame(0x11, b"\x1b[2J\r\n\x00\x00", 0.0, "can\x1b[1m"))
    assert 'name="\\x1b[2J\\r\\n"' in line
    assert "can\\x1b[1m" in line


def test_missing_times_and_channels_keep_the_columns() -> None:
    """Frames without a time stand in line with those that have one."""
    lines = shown(Frame(0x13, b"", 1.0, "can0"), Frame(0x13, b""))
    assert [line.index("013") for line in lines] == [lines[0].index("013")] * 2


def test_transmitted_frames_are_marked() -> None:
    """Where the log says which way a frame went on the bus, the line does."""
    lines = shown(Frame(0x13, b"", 1.0, "can0", is_rx=False), Frame(0x13, b"", 1.0, "can0", is_rx=True))
    assert ["  tx  " in lines[0], "  rx  " in lines[1]] == [True, True]


def test_a_narrow_terminal_gets_several_lines() -> None:
    """Fields are not cut; what does not fit goes below; long bytes are cut between bytes."""
    frames = [Frame(0x10, bytes([0, 123, 1, 7]), 2.5, "can0"), Frame(0x12, bytes(range(8)), 2.5, "can0")]
    lines = shown(*frames, width=44)
    assert max(map(len, lines)) <= 44
    assert " ".join(" ".join(lines).split()) == " ".join(" ".join(shown(*frames)).split())


def test_an_output_without_arrows() -> None:
    """An encoding that lacks a character does not stop anything."""
    (line,) = shown(Frame(0x10, bytes([0, 123, 1, 7]), 2.5, "can0"), encoding="ascii")
    assert "010 < State" in line
    (line,) = shown(Frame(0x10, bytes([0, 123, 1, 7]), 2.5, "can0"), encoding="latin-1")
    assert "12.3 °" in line


def test_absolute_times() -> None:
    """On request the time is the recording's own."""
    (line,) = shown(Frame(0x13, b"", 1436509052.249713), times=Times("absolute"))
    assert line.startswith("1436509052.249713  ")


@pytest.mark.parametrize(
    ("scale", "offset", "wanted"),
    [(0.1, 0, 1), (0.25, 0, 2), (1, 0.5, 1), (0.0625, -40, 4), (300 / 1023, 0, 2), (1e-7, 0, 8), (2, 0, 0)],
)
def test_decimals(scale: float, offset: float, wanted: int) -> None:
    """As many decimals as one raw step has, or so many that it shows."""
    assert decimals(scale, offset) == wanted


@pytest.mark.parametrize(
    ("raw", "written"), [(-662, "-6.62"), (1322, "13.22"), (0, "0.0"), (-32768, "-327.68"), (57, "0.57")]
)
def test_scaled_integers_are_written_as_scale_and_offset_mean_them(raw: int, written: str) -> None:
    """-662 × 0.01 is -6.62 to programs and spreadsheets, not the -6.620000000000001 that floats make of it."""
    plans = plans_of([mixed.variant()])
    (record,) = mixed.scanner().feed([Frame(0x14, raw.to_bytes(2, "big", signed=True))])
    lines, rows = JsonLines(plans, None), CsvOutput(plans, None, only="Level", links=frozenset({"can"}))
    for writer in (lines, rows):
        writer.begin("x", "can")
    assert lines.items([record]).decode().endswith(f'"fields": {{"height": {written}}}}}\n')
    assert rows.items([record]).decode().endswith(f",{written}\n")


def test_printable() -> None:
    """Printable text is left alone, the rest is escaped so that it can be read back."""
    assert printable("µ °C") == "µ °C"
    assert printable("a\tb\x85\u2028") == "a\\tb\\x85\\u2028"


# ---------------------------------------------------------------------- tables

ROWS = [("first", "", "a text of several words that takes room"), ("second", "x", "short")]


def test_a_table_without_limit_is_a_line_a_row() -> None:
    """Columns are aligned, trailing blanks left out, empty columns dropped."""
    assert column_output(("name", "", ""), ROWS, None, no_paint) == [
        "name",
        "first      a text of several words that takes room",
        "second  x  short",
    ]
    assert column_output(("name", "none", ""), [("a", "", "b")], None, no_paint) == ["name", "a     b"]


@pytest.mark.parametrize("width", [20, 40, 60])
def test_a_table_keeps_to_the_width(width: int) -> None:
    """The last column is folded beside the others, or goes below them; no word is lost."""
    lines = column_output(("name", "", ""), ROWS, width, no_paint)
    assert max(map(len, lines)) <= width
    assert " ".join(lines).split() == ["name", *" ".join(map(" ".join, ROWS)).split()]


def test_paragraphs_beside_a_name() -> None:
    """Each begins a line of its own, indented."""
    assert beside("name", ["one two", "three"], 11, "message", no_paint) == ["name  one two", "      three"]


def test_writers_are_interchangeable() -> None:
    """All three fulfil the same protocol."""
    writers: list[Writer] = [
        TextOutput(Plans([]), None),
        JsonLines(Plans([]), None),
        CsvOutput(Plans([]), None, only=None, links=frozenset()),
    ]
    for writer in writers:
        writer.begin("x", "can")
        assert writer.items([]) == b""
