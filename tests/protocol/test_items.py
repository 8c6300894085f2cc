"""Lists of items: tagged ones of several kinds, and groups of one shape. What they mean, everywhere they are shown.

That all ways of reading them agree on any bytes is in `tests/laws` (drawn specs, and the laws over examples/tlv_sensor.py).
"""

from __future__ import annotations

import csv
import io
import runpy
from pathlib import Path
from typing import Any

import pytest
from construct import (
    Array,
    Byte,
    Const,
    Float32b,
    GreedyBytes,
    GreedyRange,
    Int8ub,
    Int16sb,
    Int16ub,
    Int16ul,
    Int32ul,
    PrefixedArray,
    Rebuild,
    Struct,
    len_,
    this,
)

from aces_bus import as_dict, decode
from aces_bus.errors import FieldError, SpecError
from aces_bus.protocol import (
    BitLayout,
    Enumeration,
    Flags,
    Fletcher,
    Items,
    Multiplexed,
    Protocol,
    Quantity,
    Record,
    bits,
)
from aces_bus.protocol.exchange import print_dbc
from aces_bus.protocol.reference import Reference
from tests.tools.conftest import Aces
from tests.tools.conftest import aces as aces

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
KINDS: dict[str, tuple[int, Any]] = {
    "temperature": (1, Quantity(Int16sb, unit="°C", scale=0.01, unknown=[-1])),
    "gyro": (2, Array(2, Quantity(Float32b, unit="rad/s"))),
    "state": (3, Struct("mode" / Enumeration(Byte, off=0, on=1), "faults" / Flags(Byte, hot=0))),
    "text": (4, GreedyBytes),
    "key": (5, Struct(Const(b"\x55"), "number" / Byte)),
}


def stream(payload: Any, name: str = "items") -> Protocol:
    """A protocol of one message, `M`, on a serial line."""
    protocol = Protocol(name, link="serial")
    frame = protocol.framing(sync=b"\xa5", header=Struct("n" / Byte), size=this.n + 2, max_size=257)
    frame("M", payload=payload)
    return protocol


def tlv(**more: Any) -> Protocol:
    given: dict[str, Any] = {"tag": Byte, "size": Byte, "kinds": KINDS, **more}
    return stream(Struct("seq" / Byte, "items" / Items(**given)))


def packet(payload: str) -> bytes:
    data = bytes.fromhex(payload)
    return bytes([0xA5, len(data)]) + data


def read(protocol: Protocol, payload: str) -> dict[str, Any]:
    """The fields of a packet, which the reference accepts, too, and which is built again of them."""
    (record,) = protocol.scanner().feed(packet(payload))
    assert isinstance(record, Record)
    (reference,) = Reference([protocol.variant()]).stream(packet(payload))
    assert reference.message == "M"
    fields = as_dict(record)
    assert protocol.encode("M", **fields) == packet(payload)
    return fields


def test_items_are_generated_and_nothing_of_them_is_lost() -> None:
    """Good items show what their kind declares; an unknown kind and one that does not fit stay bytes, each with its reason,
    and so does an end that is not an item. All of it is built again as it was."""
    protocol = tlv()
    assert protocol.variant()["M"].plan.is_flat
    fields = read(
        protocol, "07  01 02 0866  03 02 01 81  09 01 FF  01 01 00  05 02 54 00  01 02 FFFF  04 00  02 08 00"
    )
    assert fields["seq"] == 7
    assert [(one["kind"], one["data"], one["reason"]) for one in fields["items"]] == [
        ("temperature", 21.5, None),
        ("state", {"mode": "on", "faults": 0x81}, None),
        (9, b"\xff", "unknown"),
        ("temperature", b"\x00", "malformed: data of size 1 are not a temperature"),
        ("key", b"\x54\x00", "malformed: data of size 2 are not a key"),
        ("temperature", None, None),
        ("text", b"", None),
        (None, b"\x02\x08\x00", "malformed: its size says 8, and 3 bytes are left"),
    ]
    assert read(protocol, "00 04")["items"] == [
        {"kind": None, "data": b"\x04", "reason": "malformed: 1 of the 2 bytes before an item's data"}
    ]
    assert read(protocol, "00")["items"] == []


@pytest.mark.parametrize(
    ("more", "payload"),
    [
        ({}, "00 01 02 0064 03 02 00 00"),
        ({"size_first": True}, "00 02 01 0064 02 03 00 00"),
        ({"size_first": True, "counts": "item"}, "00 04 01 0064 04 03 00 00"),
        ({"size_first": True, "counts": "tag and data"}, "00 03 01 0064 03 03 00 00"),
        ({"tag": Int16ul, "size": Int16ub}, "00 0100 0002 0064 0300 0002 00 00"),
        ({"size": None}, "00 01 0064 03 00 00"),
    ],
)
def test_tag_and_size_stand_as_the_sheet_says(more: dict[str, Any], payload: str) -> None:
    """Either first, of any width and order; the size counts the data, the tag too, or all; or there is none."""
    items = read(tlv(**more), payload)["items"]
    assert [(one["kind"], one["data"]) for one in items] == [
        ("temperature", 1),
        ("state", {"mode": "off", "faults": 0}),
    ]


def test_without_sizes_what_is_unknown_takes_the_rest() -> None:
    """Where the next item begins is then not known; one that is cut short keeps its kind."""
    protocol = tlv(size=None)
    assert [(one["kind"], one["reason"]) for one in read(protocol, "00 05 54 00 09 01 00 64")["items"]] == [
        ("key", "malformed: data of size 2 are not a key"),
        (9, "unknown"),
    ]
    (item,) = read(protocol, "00 01 07")["items"]
    assert (item["kind"], item["data"], item["reason"]) == (
        "temperature", b"\x07", "malformed: data of size 1 are not a temperature")  # fmt: skip
    with pytest.raises(
        FieldError, match=r"items\.0: without a size only the last item may have data of any length"
    ):
        protocol.encode("M", seq=0, items=[{"kind": 9, "data": b"12"}, {"kind": "temperature", "data": 1}])


def test_a_size_smaller_than_what_it_counts_ends_the_list() -> None:
    """A size that does not even count itself can say nothing of where the next item begins."""
    protocol = tlv(size_first=True, counts="item")
    for size in ("00", "01"):
        (item,) = read(protocol, f"00 {size} 01 00 64")["items"]
        assert item["kind"] is None
        assert item["reason"] == f"malformed: its size says {int(size)}, and 4 bytes are left"


@pytest.mark.parametrize(
    ("items", "reason"),
    [
        ([{"kind": "wind", "data": 1}], r"items\.0: no value named 'wind' \(there are: temperature, gyro"),
        ([{"kind": 300, "data": b""}], r"items\.0: kind 300 is outside 0…255"),
        (
            [{"kind": 9, "data": [1]}],
            r"items\.0: the data of an unknown or malformed item are bytes, not \[1\]",
        ),
        (
            [{"kind": 9, "data": bytes(300)}],
            r"items\.0: 300 bytes of data are more than the size of an item can say",
        ),
        ([{"data": 1}], r"items\.0: an item is \{'kind': …, 'data': …\}"),
        (
            [{"kind": None, "data": b"1"}, {"kind": 9, "data": b""}],
            r"only the last item may be bytes without a kind",
        ),
        ([{"kind": "temperature", "data": 1e9}], r"temperature"),
        ([{"kind": "state", "data": b"\x00\x00"}], r"state"),
    ],
)
def test_items_that_cannot_be_sent_are_refused(items: list[dict[str, Any]], reason: str) -> None:
    """By their place in the list; bytes for a kind that has fields are not sent by mistake."""
    with pytest.raises(FieldError, match=reason):
        tlv().encode("M", seq=0, items=items)


@pytest.mark.parametrize(
    ("more", "reason"),
    [
        ({"tag": Enumeration(Byte, a=1)}, "the tag of items is a plain unsigned number"),
        ({"size": Int16sb}, "the size of items is a plain unsigned number"),
        ({"counts": "bytes"}, "counts is 'data', 'tag and data' or 'item'"),
        ({"size": None, "size_first": True}, "are for items with a size"),
        ({"kinds": {}}, "Items needs kinds="),
        ({"kinds": {"a": Byte}}, r"kinds are written \{name: \(number, construct\)\}"),
        ({"kinds": {"a": (1, Byte), "b": (1, Byte)}}, "1 has two names"),
        ({"kinds": {"a": (256, Byte)}}, "kind 'a' has the number 256, past 255"),
        ({"kinds": {"two words": (1, Byte)}}, "cannot be a field name"),
    ],
)
def test_a_list_that_cannot_be_read_is_refused_with_its_line(more: dict[str, Any], reason: str) -> None:
    """When the spec is imported."""
    with pytest.raises(SpecError, match=reason) as refused:
        tlv(**more)
    assert "test_items.py:" in str(refused.value)


def test_columns_have_the_first_item_of_each_kind() -> None:
    """A column for each value of each kind, absent where a packet has none; the list itself loses nothing."""
    protocol = tlv()
    data = (
        packet("00 01 02 0064 01 02 00C8 03 02 01 01")
        + packet("01 09 00 01 01 00")
        + packet("02 01 02 FFFF 04 01 41")
    )
    table = decode(data, protocol)["M"]
    assert table.names == (
        "seq", "items", "items.temperature", "items.gyro.0", "items.gyro.1", "items.state.mode", "items.state.faults",
        "items.text", "items.key.number")  # fmt: skip
    assert table["items.temperature"].to_list() == [1, None, None]
    assert table["items.temperature"].kind.unit == "°C"
    assert table["items.state.mode"].to_list() == ["on", None, None]
    assert table["items.gyro.1"].to_list() == [None] * 3
    assert table["items.text"].to_list() == [None, None, b"A"]
    assert [[one["kind"] for one in items] for items in table["items"].to_list()] == [
        ["temperature", "temperature", "state"], [9, "temperature"], ["temperature", "text"]]  # fmt: skip


def test_multiplexed_data_of_an_item() -> None:
    """A selector inside an item's data decides about its length, too."""
    body = Struct(
        "which" / Byte, "one" / Multiplexed("which", 1, Byte), "two" / Multiplexed("which", 2, Int16ub)
    )
    protocol = tlv(kinds={"a": (1, body)})
    assert protocol.variant()["M"].plan.is_flat
    items = read(protocol, "00 01 02 01 07 01 03 02 0102 01 02 02 07")["items"]
    assert [one["data"] for one in items] == [
        {"which": 1, "one": 7, "two": None}, {"which": 2, "one": None, "two": 258}, b"\x02\x07"]  # fmt: skip
    assert decode(packet("00 01 02 02 07 01 03 02 0102"), protocol)["M"]["items.a.two"].to_list() == [258]


GROUP = Struct("id" / Byte, "level" / Quantity(Int16sb, unit="dB", scale=0.5))


@pytest.mark.parametrize(
    ("payload", "data", "count"),
    [
        (Struct("groups" / GreedyRange(GROUP)), "01 0004 02 FFFE", None),
        (Struct("groups" / PrefixedArray(Byte, GROUP)), "02 01 0004 02 FFFE", None),
        (Struct("count" / Byte, "groups" / Array(this.count, GROUP)), "02 01 0004 02 FFFE", 2),
        (
            Struct("count" / Rebuild(Int8ub, len_(this.groups)), "groups" / Array(this.count, GROUP)),
            "02 01 0004 02 FFFE",
            2,
        ),
        (
            Struct(
                "head" / BitLayout(1, "flag" / bits(1), "count" / bits(5)),
                "groups" / Array(this.head.count, GROUP),
            ),
            "C4 01 0004 02 FFFE",
            None,
        ),
    ],
)
def test_groups_of_one_shape(payload: Struct, data: str, count: int | None) -> None:
    """To the end, or as many as a number says, wherever it stands: generated, a column of lists for each value."""
    protocol = stream(payload)
    assert protocol.variant()["M"].plan.is_flat
    fields = read(protocol, data)
    assert fields["groups"] == [{"id": 1, "level": 2}, {"id": 2, "level": -1}]
    assert fields.get("count") == count
    table = decode(packet(data) * 2, protocol)["M"]
    assert table["groups.id"].to_list() == [[1, 2], [1, 2]]
    assert table["groups.level"].to_list() == [[2, -1], [2, -1]]
    assert table["groups.level"].kind.unit == "dB"
    assert not protocol.scanner().feed(packet(data + "00")), "half a group"


def test_what_has_no_flat_form_goes_through_construct() -> None:
    """A list that something follows, a list in a list, groups of several sizes: slower, and read all the same."""
    group = Struct("n" / Byte, "data" / Array(this.n, Byte))
    protocol = stream(Struct("groups" / GreedyRange(group)))
    assert not protocol.variant()["M"].plan.is_flat
    assert read(protocol, "01 07 02 08 09")["groups"] == [{"n": 1, "data": [7]}, {"n": 2, "data": [8, 9]}]
    nested = tlv(kinds={"a": (1, GreedyRange(Byte))})
    assert nested.variant()["M"].plan.opaque == "lists of items inside one another"
    assert read(nested, "00 01 02 07 08 02 00")["items"] == [
        {"kind": "a", "data": [7, 8], "reason": None},
        {"kind": 2, "data": b"", "reason": "unknown"},
    ]


def lists_in_items() -> Protocol:
    """Items that hold lists: groups behind a field, as many as counted, other items, and what is not a list."""
    signal = Struct("id" / Byte, "level" / Quantity(Byte, unit="dB", scale=0.5))
    return tlv(
        kinds={
            "sky": (1, Struct("time" / Byte, "satellites" / GreedyRange(signal))),
            "counted": (2, PrefixedArray(Byte, signal)),
            "more": (3, Items(tag=Byte, size=Byte, kinds={"volt": (7, Quantity(Byte, unit="V"))})),
            "plain": (4, Quantity(Byte, unit="A")),
            "deep": (5, GreedyRange(PrefixedArray(Byte, Byte))),
        }
    )


NESTED = "00 01 05 09 03 08 04 0A  02 03 01 05 06  03 03 07 01 0C  04 01 63  05 03 01 02 00"


def test_lists_inside_items_have_columns() -> None:
    """Read by construct, and every kind's values are columns all the same; what is two lists deep is one value."""
    protocol = lists_in_items()
    assert protocol.variant()["M"].plan.opaque == "lists of items inside one another"
    table = decode(packet(NESTED) * 2, protocol)["M"]
    found = {column.kind.name: column.to_list()[1] for column in table.columns()}
    assert {"seq": found.pop("seq"), "items": found.pop("items")} == read(protocol, NESTED)
    assert found == {
        "items.sky.time": 9,
        "items.sky.satellites": [{"id": 3, "level": 4.0}, {"id": 4, "level": 5.0}],
        "items.sky.satellites.id": [3, 4],
        "items.sky.satellites.level": [4.0, 5.0],
        "items.counted": [{"id": 5, "level": 3.0}],
        "items.counted.id": [5],
        "items.counted.level": [3.0],
        "items.more": [{"kind": "volt", "data": 12, "reason": None}],
        "items.more.volt": 12,
        "items.plain": 99,
    }
    assert table["items.sky.satellites.level"].kind.unit == "dB"
    (record,) = protocol.scanner().feed(packet(NESTED))
    assert protocol.encode("M", **as_dict(record)) == packet(NESTED)


def test_a_bad_item_costs_itself_among_lists_too() -> None:
    """Half a group: the item is bytes with the reason, its columns are absent."""
    table = decode(packet("00 01 04 09 03 08 04 04 01 63"), lists_in_items())["M"]
    assert table["items.sky.time"].to_list() == [None]
    assert table["items.plain"].to_list() == [99]


def test_tools_see_lists_inside_items(tmp_path: Path, aces: Aces) -> None:
    """Units in lines, conditions on what is inside."""
    (tmp_path / "nested.py").write_text(
        "from construct import Byte, GreedyRange, Struct, this\n"
        "from aces_bus.protocol import Items, Protocol, Quantity\n"
        'p = Protocol("nested", link="serial")\n'
        'packet = p.framing(sync=b"\\xa5", header=Struct("length" / Byte), size=this.length + 2, max_size=257)\n'
        'group = Struct("id" / Byte, "level" / Quantity(Byte, unit="dB", scale=0.5))\n'
        'kinds = {"sky": (1, GreedyRange(group)), "volt": (2, Quantity(Byte, unit="V"))}\n'
        'packet("M", payload=Struct("items" / Items(tag=Byte, size=Byte, kinds=kinds)))\n'
    )
    (tmp_path / "log.bin").write_bytes(bytes.fromhex("A5 07 01 02 03 08 02 01 0C"))
    options = ["decode", str(tmp_path / "log.bin"), "-p", str(tmp_path / "nested.py")]
    shown = aces(*options, "--where", "items.volt>11").out
    assert "items=[sky=[{id=3, level=4.0 dB}], volt=12 V]" in shown
    assert '"data": [{"id": 3, "level": 4.0}]' in aces(*options, "--format", "jsonl").out


def test_on_can_the_frame_bounds_the_list() -> None:
    """Items in a CAN FD frame; the DBC says what it cannot hold."""
    protocol = Protocol("dids", link="can")
    protocol.message(
        "M", id=0x7E8, fd=True, payload=Struct("items" / Items(tag=Int16ub, kinds={"speed": (0xF40D, Byte)}))
    )
    frame = protocol.encode("M", items=[{"kind": "speed", "data": 50}])
    (record,) = protocol.scanner().feed([frame])
    assert as_dict(record) == {"items": [{"kind": "speed", "data": 50, "reason": None}]}
    _, losses = print_dbc(protocol.variant())
    assert any("a list of items" in str(one) for one in losses)


def test_tools_see_inside(tmp_path: Path, aces: Aces) -> None:
    """A value of an item is a column of CSV, a signal and a condition, like any other; groups give all their values."""
    spec = EXAMPLES / "tlv_sensor.py"
    made = runpy.run_path(str(spec))["tlv_sensor"]
    capture = tmp_path / "station.bin"
    reports = [made.encode("Report", uptime=n, items=[{"kind": "temperature", "data": n}]) for n in range(3)]
    hours = [{"temperature": 1, "wind": 3}, {"temperature": None, "wind": 5}]
    capture.write_bytes(b"".join([*reports, made.encode("History", hours=hours)]))
    common = (capture, "-p", spec, "--direction", "from")
    found = aces("decode", *common, "-m", "Report", "--format", "csv")
    rows = list(csv.DictReader(io.StringIO(found.out)))
    assert [row["items.temperature"] for row in rows] == ["0.0", "1.0", "2.0"]
    some = aces("decode", *common, "--where", "items.temperature>0.5", "--format", "jsonl")
    assert [line.count("temperature") for line in some.out.splitlines()] == [1, 1]
    both = aces("decode", *common, "--where", "hours.wind=5", "--format", "jsonl")
    assert both.out.count("History") == 1
    text = aces("decode", *common).out
    assert "items=[temperature=2.00 °C]" in text
    assert "hours=[{temperature=1.00 °C, wind=3 m/s}, {temperature=unknown °C, wind=5 m/s}]" in text
    listed = aces("plot", *common, "--list").out
    assert "Report.items.temperature" in listed
    assert "History.hours.wind" in listed
    shown = aces("spec", "show", spec, "Report").out
    assert "items.wind.speed" in shown


def test_satellites_are_as_pyubx2_reads_them(shared_captures: Path) -> None:
    """UBX NAV-SAT: a count, and so many groups with signs and bit fields."""
    pyubx2 = pytest.importorskip("pyubx2", reason="pyubx2, which this is compared with, is not installed")
    quality = BitLayout(4, "quality" / bits(3), "used" / bits(1), "health" / bits(2))
    group = Struct(
        "gnss" / Byte, "sv" / Byte, "cno" / Byte, "elevation" / Quantity(Byte, unit="°"), "azimuth" / Int16ul,
        "residual" / Int16ul, "flags" / quality)  # fmt: skip
    ubx = Protocol("ubx", link="serial")
    frame = ubx.framing(
        sync=b"\xb5\x62", header=Struct("group" / Byte, "number" / Byte, "length" / Int16ul), size=this.length + 8,
        max_size=1024, check=Fletcher())  # fmt: skip
    payload = Struct(
        "itow" / Int32ul,
        "version" / Byte,
        "count" / Byte,
        "reserved" / Int16ul,
        "satellites" / Array(this.count, group),
    )
    frame("Satellites", match={"group": 1, "number": 0x35}, payload=payload)
    data = (shared_captures / "streams" / "ubx-nav.bin").read_bytes()
    table = decode(data, ubx)["Satellites"]
    at = int(table.row[0])
    size = int(table.size[0]) if table.size is not None else 0
    theirs = pyubx2.UBXReader.parse(data[at : at + size])
    assert len(table["satellites.cno"].values[0]) == theirs.numSvs > 0
    for ours, name in (("sv", "svId"), ("cno", "cno"), ("azimuth", "azim"), ("flags.quality", "qualityInd")):
        wanted = [getattr(theirs, f"{name}_{n:02}") for n in range(1, theirs.numSvs + 1)]
        assert table[f"satellites.{ours}"].values[0] == wanted
