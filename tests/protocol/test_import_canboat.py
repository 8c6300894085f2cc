"""canboat's table of NMEA 2000 as a protocol: what it says is taken over, what cannot be said is left out by name."""

from __future__ import annotations

import json
import re
from functools import cache
from math import degrees, radians
from pathlib import Path
from typing import Any

import pytest

from aces_bus import Frame, as_dict
from aces_bus.errors import CallerError, FieldError
from aces_bus.frames import EXTENDED
from aces_bus.protocol import FastPacket, Protocol
from aces_bus.protocol.exchange import load_database
from aces_bus.protocol.exchange.problems import ImportedProtocol
from aces_bus.testing import LAWS, Scene
from tests.laws.drawn import ORACLE, columns_agree, drawn_arguments

BOAT = Path(__file__).parents[1] / "data" / "canboat" / "boat.json"


@cache
def boat() -> ImportedProtocol:
    return load_database(BOAT)


def table(tmp_path: Path, *pgns: Any, **more: Any) -> ImportedProtocol:
    path = tmp_path / "own.json"
    good = {"PGN": 130000, "Id": "good", "Type": "Single", "Fields": [_number("a", 8)]}
    path.write_text(json.dumps({"PGNs": [good, *pgns], **more}, indent=1), encoding="utf-8")
    return load_database(path)


def _number(name: str, width: int, **more: Any) -> dict[str, Any]:
    return {"Id": name, "BitLength": width, "FieldType": "NUMBER", **more}


def decoded(*frames: tuple[int, str]) -> list[Any]:
    scanner = boat().protocol.scanner(include_unknown=True)
    return scanner.feed([Frame(key, bytes.fromhex(data), is_extended_id=True) for key, data in frames])


def test_a_parameter_group_is_recognised_whoever_sends_it() -> None:
    """Priority and source are fields, the destination too where the group is addressed."""
    water, asked = decoded((0x19FD0605, "01 C1 FE 72 9C FF FF FF"), (0x18EAFF10, "00 EE 00"))
    assert as_dict(water) == {
        "priority": 6,
        "source": 5,
        "sid": 1,
        "source_": "Air",
        "full": "Never",
        "temperature": 294.38,
        "heading": -0.0100,
        "reserved": 0xFFFF << 48,
    }
    assert (asked.priority, asked.destination, asked.source, asked.pgn) == (6, 255, 16, 0xEE00)


def test_values_that_are_not_there_are_unknown() -> None:
    """The sentinels of the table, but where a value of that number has a name; what is unknown is sent as the first."""
    (record,) = decoded((0x19FD0605, "FE 3F FF FF FF 7F FF FF"))
    assert (record.sid, record.source_, record.temperature, record.heading) == (None, None, None, None)
    assert record.full == "No"
    sent = boat().protocol.encode("waterTemperature", **as_dict(record))
    assert bytes(sent.data).hex(" ") == "ff 3f ff ff ff 7f ff ff"
    with pytest.raises(FieldError, match="means unknown"):
        boat().protocol.encode("waterTemperature", **dict(as_dict(record), sid=254))


def test_forms_of_a_proprietary_group_are_told_by_their_fixed_values() -> None:
    """The one with more of them goes first; reserved bits beside them are kept."""
    own, other = decoded((0x1CFF1405, "FE 9F 02 07 30 75 09 FF"), (0x1CFF1405, "13 99 01 02 03 04 05 06"))
    assert type(own).__name__ == "ownStatus"
    assert (own.reserved_, own.instance, own.power) == (3, 2, 10000)
    assert list(own.alarms) == ["Too hot", "Low oil"]
    assert type(other).__name__ == "anyProprietary"
    assert (other.bits.manufacturerCode, other.bits.industryCode, other.data) == (
        "Other",
        4,
        bytes(range(1, 7)),
    )
    for record in (own, other):
        again = boat().protocol.encode(type(record).__name__, **as_dict(record))
        assert (again.arbitration_id, bytes(again.data)) == (0x1CFF1405, record.meta.raw)


def test_what_cannot_be_said_is_left_out_by_name() -> None:
    """With the line of its PGN and the reason."""
    said = {one.reason.partition(":")[0]: str(one).partition(": ")[2] for one in boat().losses}
    assert said["PGN onCondition"] == "PGN onCondition: a field that is there on a condition: left out"
    assert said["PGN half"] == "PGN half: its fields end inside a byte, 4 bits behind one: left out"
    assert said["PGN rest"] == "PGN rest: an entry for all unknown PGNs: left out"
    assert said["PGN mixed"].startswith(
        "PGN mixed: of the type Mixed, which is neither one frame nor a fast packet"
    )
    assert said["PGN transferred"].startswith("PGN transferred: its frames are those of J1939 transport")
    (half,) = (one for one in boat().losses if "half" in one.reason)
    assert '"half"' in BOAT.read_text(encoding="utf-8").splitlines()[half.line - 1]
    assert boat().protocol["ownStatus"].place.line == 45


def whole(protocol: Protocol, pgn: int, data: str) -> Any:
    """What a packet of a group decodes to, in one frame or as a fast packet, and that it is built again as it was."""
    key = 3 << 26 | (pgn | (255 if pgn >> 8 & 0xFF < 240 else 0)) << 8 | 19
    body = bytes.fromhex(data)
    if pgn in (61184, 65304):
        frames = [Frame(key, body, is_extended_id=True)]
    else:
        parts = FastPacket().split(key | EXTENDED, body, 0, b"")
        frames = [Frame(identifier & 0x1FFF_FFFF, part, is_extended_id=True) for identifier, part in parts]
    (record,) = protocol.scanner().feed(frames)
    again = protocol.encode(type(record).__name__, **as_dict(record))
    sent = again if isinstance(again, list) else [again]
    assert [bytes(frame.data) for frame in sent] == [bytes(frame.data) for frame in frames]
    return record


def plain(data: Any) -> Any:
    """The data of an item: its fields by name, where it has several."""
    return (
        as_dict(data) if hasattr(data, "__struct_fields__") else dict(data) if hasattr(data, "keys") else data
    )


def items(record: Any) -> list[tuple[Any, Any]]:
    """The kind and the data of the items that are good, of the others the reason."""
    return [(item.kind, item.data if item.reason is None else item.reason) for item in record.list]


def test_values_by_key_are_items() -> None:
    """Key and length of one number, a key alone in front of other fields, a length alone; what is unknown costs itself."""
    protocol = boat().protocol
    record = whole(protocol, 130831, "07 0B 20 10 27 0C 40 01 00 00 00 00 11 02 0B 10 55 99 19 AA FF")
    assert items(record) == [
        ("rudderAngle", 1.0),
        ("rudderAngle_", 1),
        ("state", "Perhaps"),
        ("rudderAngle", "malformed: 1 bytes, and rudderAngle has 2"),
        (0x999, "unknown"),
        (None, "malformed: 1 bytes are left of an item"),
    ]
    record = whole(protocol, 65304, "0B 00 05 F0 D8 FF FF")
    assert (record.list[0].kind, as_dict(record.list[0].data)) == (
        "rudderAngle",
        {"operation": 5, "value": -1.0},
    )
    record = whole(protocol, 130832, "01 04 07 00 AA BB 02 08 00")
    assert [(entry.kind, entry.value) for entry in record.list] == [(7, b"\xaa\xbb"), (8, b"")]


def test_parameters_of_a_group_function_have_the_fields_of_their_group() -> None:
    """By their number, in whole bytes; the values exclude other forms; what is not known is bytes."""
    record = whole(boat().protocol, 126208, "01 14 FF 00 03 01 FE 07 03 04 06 2A 00")
    assert [(kind, as_dict(data)) for kind, data in items(record)] == [
        (1, {"manufacturerCode": "Own"}),
        (3, {"industryCode": 4}),
        (6, {"power": -19958}),
    ]
    unknown = whole(boat().protocol, 126208, "01 14 FF 00 01 09 FE 07")
    assert items(unknown) == [(9, "unknown")]
    record = whole(boat().protocol, 130834, "14 FF 00 01 02 03")
    assert (record.pgn, record.trailing) == (0xFF14, b"\1\2\3")
    said = [str(problem) for problem in boat().problems if "trailing" in str(problem)]
    assert [text.partition("PGN ")[2] for text in said] == [
        "read: a field that is there on a condition: bytes from maker on are in trailing"
    ]


#: Packets of canboat's `analyzer/tests` (keyvalue-wide-field, pgn-dynamic-units, pgn-126208-request-130817,
#: pgn-130823-directory), and what its analyzer prints of their lists.
CANBOAT: list[tuple[int, str, list[Any]]] = [
    (
        130824,
        "7D 99 7E 20 CB 00 7C 20 00 05 32 21 A8 46 33 21 B5 4D 12 D1 F4 03 50 21 56 5E 51 21 95 0A 21 6B F5 6C 21 56 2C"
        " 6D 21 56 2B FF",
        [2.03, 128.0, radians(103.6), radians(114.0), None, 1135.0, 1109.4, None],
    ),
    (61184, "66 99 10 03 D2 04 00 00", [44_424_000 / 3_600_000]),
    (61184, "66 99 EC ED 2D 75", [299.97]),
    (61184, "66 99 00 10 C8 00", [720_000 / 3600]),
    (130845, "41 9F FF 00 FF FF 00 00 00 02 88 13", [{"operation": "Reply", "value": 0.5}]),
    (
        126208,
        "00 01 FF 01 FF FF FF FF FF FF 03 01 13 01 03 04 04 4B 23",
        [{"manufacturerCode": "Navico"}, {"industryCode": "Marine Industry"}, {"featureId": 9035}],
    ),
]


@pytest.mark.shared
def test_lists_of_canboat_s_own_samples(shared_captures: Path) -> None:
    """All entries of the table but those of unknown groups and of the ISO transport are taken over; values are canboat's."""
    loaded = load_database(shared_captures / "nmea2000" / "canboat.json")
    assert (len(loaded.protocol.declared), len(loaded.losses)) == (597, 14)
    reasons = {problem.reason.partition(": ")[2] for problem in loaded.losses}
    assert reasons == {
        "an entry for all unknown PGNs: left out",
        "its frames are those of J1939 transport, which are put together: left out",
    }
    for pgn, data, wanted in CANBOAT:
        given = whole(loaded.protocol, pgn, data).list
        found = [None if item.reason is not None else plain(item.data) for item in given]
        for value, right in zip(found, wanted, strict=True):
            assert value == (pytest.approx(right, abs=1e-3) if isinstance(right, float) else right)
    directory = whole(
        loaded.protocol,
        130823,
        "13 99 FF 00 05 01 00 0A 00 55 02 BC 2F 00 96 50 C0 FF 04 02 26 00 00 04 02 27 00 00",
    )
    assert [(entry.type, entry.dataType, entry.value.hex()) for entry in directory.list] == [
        (0, "Yanmar Fuel Level Tank1 Stbd", "bc2f009650c0ff"),
        (2, "Current Set", "00"),
        (2, "Current Drift", "00"),
    ]


def test_the_laws_hold() -> None:
    """On drawn frames: round trip, oracle and columns, accounting, …"""
    variant = boat().protocol.variant()
    for law in LAWS:
        for seed in range(3):
            if not law.streams_only:
                law(variant, "both", *drawn_arguments(law, variant, "both", seed))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("{", "own.json: not JSON that can be read"),
        ("[]", "own.json: not a table of canboat: it has no list PGNs"),
        ('{"PGNs": 3}', "own.json: not a table of canboat: it has no list PGNs"),
        ('{"PGNs": []}', "own.json: no PGN in it can be used"),
        ("[" * 100_000, "own.json: not JSON that can be read"),
    ],
)
def test_files_that_are_refused(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "own.json"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(CallerError, match=said):
        load_database(path)


@pytest.mark.parametrize(
    ("pgn", "said"),
    [
        (3, "a PGN has a number below"),
        ({"PGN": 1 << 18, "Fields": []}, "a PGN has a number below"),
        ({"PGN": 7, "Id": "b", "Type": "Single", "Fields": [3]}, "a field without an Id"),
        ({"PGN": 7, "Id": "b", "Type": "Single", "Fields": [_number("a", 0)]}, "a field of 0 bits"),
        ({"PGN": 7, "Id": "b", "Type": "Single", "Fields": [_number("a", 72)]}, "PGN b: "),
        ({"PGN": 7, "Id": "b", "Type": "Single", "Fields": [_number("a", 8, Match=300)]}, "a is never 300"),
        ({"PGN": 7, "Id": "b", "Type": "Single", "Fields": [{"Id": "a", "FieldType": "TENSOR"}]}, "the type TENSOR"),
        ({"PGN": 130000, "Id": "b", "Type": "Single", "Fields": [_number("a", 8)]}, "is ambiguous with 'good'"),
        (
            {"PGN": 7, "Id": "b", "Type": "Single", "RepeatingFieldSet1StartField": 1, "RepeatingFieldSet1Size": 1,
             "Fields": [_number("a", 8), _number("b", 8)]},
            "fields behind a list",
        ),
    ],
)  # fmt: skip
def test_a_group_that_cannot_be_costs_itself(tmp_path: Path, pgn: Any, said: str) -> None:
    imported = table(tmp_path, pgn)
    (problem,) = imported.losses
    assert said in problem.reason
    assert set(imported.protocol.messages) == {"good"}


# ---------------------------------------------------------------------- fast packets


def packet(message: str, **fields: Any) -> list[Frame]:
    """The frames of a packet of ours, as a scanner gets them."""
    made = boat().protocol.encode(message, priority=3, source=9, **fields)
    return [Frame(one.arbitration_id, bytes(one.data), is_extended_id=True) for one in made]


def test_a_fast_packet_is_one_message() -> None:
    """Interleaved with those of another sender; what is behind the known fields is kept."""
    frames = packet("wide", latitude=48.5, satellites=7, date=20_000)
    assert [bytes(one.data).hex(" ") for one in frames] == [
        "00 0b 00 80 10 2c ee 10",
        "01 bb 06 07 20 4e ff ff",
    ]
    others = [Frame(one.arbitration_id + 1, bytes(one.data), is_extended_id=True) for one in frames]
    scanner = boat().protocol.scanner()
    mixed = [one for pair in zip(frames, others, strict=True) for one in pair]
    records = scanner.feed(mixed)
    assert [record.source for record in records] == [9, 10]
    assert records[0].latitude == pytest.approx(48.5)
    assert (records[0].satellites, records[0].date, records[0].trailing) == (7, 20_000, b"")
    longer = packet("wide", latitude=None, satellites=None, date=None, trailing=b"newer")
    (record,) = scanner.feed(longer)
    assert (record.latitude, record.satellites, record.date, record.trailing) == (None, None, None, b"newer")


def test_repeated_groups_are_lists() -> None:
    """As many as are counted, bytes behind them kept; or up to the end."""
    groups = [{"prn": n, "used": "Yes", "snr": None if n == 2 else 30.5} for n in range(5)]
    (record,) = boat().protocol.scanner().feed(
        packet("satellites", sid=1, bits={"mode": "Perhaps"}, count=5, list=groups, trailing=b"\xff")
    )  # fmt: skip
    assert record.bits.mode == "Perhaps"
    assert [(one.prn, one.used, one.snr) for one in record.list[1:3]] == [(1, "Yes", 30.5), (2, "Yes", None)]
    assert (len(record.list), record.trailing) == (5, b"\xff")
    (record,) = boat().protocol.scanner().feed(
        packet("levels", instance=2, list=[{"level": 50.0}, {"level": None}, {"level": -1.0}])
    )  # fmt: skip
    assert [one.level for one in record.list] == [50.0, None, -1.0]
    assert boat().protocol["levels"].plan.is_flat


def test_texts_say_their_length() -> None:
    """Those of a fixed length, and those that begin with it; what follows them is found."""
    name = {"encoding": 1, "text": "Nautilus"}
    (record,) = boat().protocol.scanner().feed(packet("product", code=7, model="N1", name=name, depth=2.5))
    assert (record.model, record.name.text, record.depth) == ("N1", "Nautilus", 2.5)


@pytest.mark.parametrize(
    "raw", [b"N1\xff\xff\xff\xff", b"N1@@@@", b"N1\0\0\0\0", b"N1\0@x\xff", b"N1@\0x\xff"]
)
def test_a_text_of_fixed_length_ends_at_its_padding(tmp_path: Path, raw: bytes) -> None:
    """At 0xFF, "@" or 0, whichever comes first, as canboat's table says: live, in columns and by the reference."""
    text = {"Id": "model", "Name": "Model", "FieldType": "STRING_FIX", "BitLength": 48, "BitOffset": 0}
    protocol = table(tmp_path, {"PGN": 130001, "Id": "name", "Type": "Single", "Fields": [text]}).protocol
    frames = [Frame(0x0DFBD109, raw, is_extended_id=True)]
    (record,) = protocol.scanner().feed(frames)
    assert record.model == "N1"
    ORACLE(protocol.variant(), None, Scene(tuple(frames)))
    columns_agree(protocol.variant(), None, Scene(tuple(frames)))
    sent: Any = protocol.encode("name", priority=3, source=9, model="N1")
    assert bytes(sent.data)[:6] == b"N1\xff\xff\xff\xff"
    with pytest.raises(FieldError, match="which ends there"):
        protocol.encode("name", priority=3, source=9, model="N@1")


# ---------------------------------------------------------------------- packets by the transport of ISO 11783


def by_iso(group: int, data: bytes, source: int = 9) -> list[Frame]:
    """The frames of a broadcast announcement and its data."""
    count = -(-len(data) // 7)
    head = bytes([0x20, *len(data).to_bytes(2, "little"), count, 0xFF]) + group.to_bytes(3, "little")
    pieces = (data[7 * n : 7 * n + 7].ljust(7, b"\xff") for n in range(count))
    numbered = [bytes([n]) + piece for n, piece in enumerate(pieces, 1)]
    return [
        Frame(0x18ECFF00 | source, head, 0.0, is_extended_id=True),
        *(Frame(0x18EBFF00 | source, one, 0.1 * n, is_extended_id=True) for n, one in enumerate(numbered, 1)),
    ]


def test_a_fast_packet_may_come_by_the_transport_of_iso_11783() -> None:
    """The same message, whichever way it comes, with those of another source between: live, reference and columns."""
    frames = packet("wide", latitude=48.5, satellites=7, date=20_000)
    fast = b"".join(bytes(one.data)[2 - bool(n) :] for n, one in enumerate(frames))[:11]
    pairs = zip(by_iso(126999, fast), by_iso(126999, fast[::-1], source=10), strict=True)
    mixed = [one for pair in pairs for one in pair]
    records = boat().protocol.scanner().feed(mixed)
    assert [(type(one).__name__, one.source, one.meta.raw) for one in records] == [
        ("wide", 9, fast),
        ("wide", 10, fast[::-1]),
    ]
    assert (records[0].priority, records[0].latitude) == (6, pytest.approx(48.5))
    for scene in (Scene(tuple(mixed)), Scene((*mixed, *frames))):
        ORACLE(boat().protocol.variant(), None, scene)
        columns_agree(boat().protocol.variant(), None, scene)


def test_a_packet_to_one_address_is_put_together_with_what_steers_it() -> None:
    """Request to send, clear to send, data, one of it again, end of message: in protocols of the table as by hand."""
    (wide,) = boat().protocol.scanner().feed(packet("wide", latitude=48.5, satellites=7, date=20_000))
    data, group = wide.meta.raw, (126999).to_bytes(3, "little")
    to, back = 0x18EC0709, 0x18EC0907
    pieces = [bytes([n + 1]) + data[7 * n : 7 * n + 7].ljust(7, b"\xff") for n in range(2)]
    frames = [
        (to, bytes([16, 11, 0, 2, 1, *group])),
        (back, bytes([17, 1, 1, 255, 255, *group])),
        (0x18EB0709, pieces[0]),
        (back, bytes([17, 1, 2, 255, 255, *group])),
        (0x18EB0709, pieces[0]),
        (0x18EB0709, pieces[1]),
        (back, bytes([19, 11, 0, 2, 255, *group])),
    ]
    traffic = tuple(Frame(key, one, 0.01 * n, is_extended_id=True) for n, (key, one) in enumerate(frames))
    scanner = boat().protocol.scanner()
    (record,) = scanner.feed(traffic)
    assert (type(record).__name__, record.source, record.meta.raw) == ("wide", 9, data)
    assert scanner.counts.reasons == {
        "control: clear to send": 2,
        "control: end of message": 1,
        "malformed: repeated": 1,
    }
    ORACLE(boat().protocol.variant(), None, Scene(traffic))
    columns_agree(boat().protocol.variant(), None, Scene(traffic))


def test_what_is_too_long_for_a_fast_packet_goes_by_iso_11783() -> None:
    """And a group that is never a fast packet, both ways."""
    groups = [{"prn": n % 250, "used": "Yes", "snr": 30.5} for n in range(100)]
    frames = packet("satellites", sid=1, bits={"mode": "No"}, count=100, list=groups, trailing=b"")
    assert {one.arbitration_id >> 16 & 0xFF for one in frames} == {0xEC, 0xEB}
    (record,) = boat().protocol.scanner().feed(frames)
    assert (len(record.list), record.list[99].prn) == (100, 99)
    frames = packet("commanded", name=1 << 60, address=7)
    assert [bytes(one.data)[:2].hex() for one in frames] == ["2009", "0100", "0210"]
    (record,) = boat().protocol.scanner().feed(frames)
    assert (record.name, record.address, record.trailing) == (1 << 60, 7, b"")


def test_a_count_that_is_not_known_is_of_no_item() -> None:
    """All ones; of another count that the packet is too short for, the reason says its name."""
    head = bytes.fromhex("010f")
    scanner = boat().protocol.scanner(include_unknown=True)
    (record,) = scanner.feed(by_iso(129500, head + b"\xff" + bytes(6)))
    assert (record.count, list(record.list), record.trailing) == (255, [], bytes(6))
    sent = packet(
        "satellites", **{k: v for k, v in as_dict(record).items() if k not in ("priority", "source")}
    )
    (again,) = scanner.feed(sent)
    assert (again.count, again.meta.raw) == (255, record.meta.raw)
    lost = scanner.feed(by_iso(129500, head + b"\xfe" + bytes(6)))
    assert {one.reason for one in lost} == {
        "malformed: length 9, too short for the items of satellites.list that count counts"
    }
    scene = Scene((*by_iso(129500, head + b"\xff" + bytes(6)), *by_iso(129500, head + b"\xfe" + bytes(6))))
    ORACLE(boat().protocol.variant(), None, scene)
    columns_agree(boat().protocol.variant(), None, scene)


# ---------------------------------------------------------------------- canboat's own table and goldens

_GOLDEN = re.compile(r'([^=;:"]+?) = (?:[^=;]*?) ?\(bytes = "([0-9A-F ]*)"(?:, bits = "([01]+)")?\)')


@pytest.mark.slow
@pytest.mark.shared
def test_canboats_goldens_are_decoded_value_for_value(shared_captures: Path) -> None:
    """Each field's bytes, as canboat's analyzer prints them, are the raw value that we have."""
    folder = shared_captures / "nmea2000"
    path = folder / "canboat.json"
    protocol = load_database(path).protocol
    tables = {one["Id"]: one["Fields"] for one in json.loads(path.read_text("utf-8"))["PGNs"]}
    records: list[Any] = []
    for block in (folder / "recombine-frames.in").read_text().split("\n\n"):
        scanner = protocol.scanner(raw=True)
        for line in block.splitlines():
            if line and line[0] != "#":
                _, priority, pgn, source, _, _, *data = line.split(",")
                key = int(priority) << 26 | int(pgn) << 8 | int(source)
                records += scanner.feed([Frame(key, bytes.fromhex("".join(data)), is_extended_id=True)])
    goldens = [
        (int(line.split()[4]), _GOLDEN.findall(line.partition(":  ")[2]))
        for line in (folder / "recombine-frames.out").read_text().splitlines()
    ]
    assert len(records) >= 6
    for record in records:
        of_group = [fields for pgn, fields in goldens if pgn == record.meta.identifier >> 8 & 0x3FFFF]
        least = 2 if type(record).__name__ == "navicoBoatSpeedPolarTable" else 6
        assert max(_agreeing(record, fields, tables[type(record).__name__]) for fields in of_group) >= least


@pytest.mark.slow
@pytest.mark.shared
def test_canboats_golden_by_iso_11783_is_decoded_value_for_value(shared_captures: Path) -> None:
    """Each satellite, as canboat's analyzer has it; what has no announcement, or a wrong one, is no packet."""
    folder = shared_captures / "nmea2000"
    protocol = load_database(folder / "canboat.json").protocol
    frames = []
    for line in (folder / "iso-tp-test.in").read_text().split():
        when, priority, pgn, source, destination, _, *data = line.split(",")
        key = int(priority) << 26 | int(pgn) << 8 | int(destination) << 8 | int(source)
        frames.append(
            Frame(
                key,
                bytes.fromhex("".join(data)),
                float(when[17:-1]) + 60 * int(when[14:16]),
                is_extended_id=True,
            )
        )
    (record,) = protocol.scanner().feed(frames)
    columns_agree(protocol.variant(), None, Scene(tuple(frames)))
    golden = json.loads((folder / "iso-tp-test.out").read_text())["fields"]
    assert (type(record).__name__, record.satsInView) == ("gnssSatsInView", golden["Sats in View"])
    for ours, theirs in zip(record.list, golden["list"], strict=True):
        assert (ours.prn, ours.snr, ours.status, ours.gnssSystem) == (
            theirs["PRN"],
            theirs.get("SNR"),
            theirs["Status"]["name"],
            theirs["GNSS System"]["name"],
        )
        for mine, angle in ((ours.elevation, theirs["Elevation"]), (ours.azimuth, theirs["Azimuth"])):
            assert degrees(mine) == pytest.approx(angle, abs=0.051)


def _agreeing(record: Any, golden: list[tuple[str, str, str]], table: list[dict[str, Any]]) -> int:
    """How many fields of a record are those of a golden line; 0 where one is not."""
    fields = {**as_dict(record), **as_dict(record).get("bits", {})}
    count = 0
    for name, raw, bits in golden:
        one = next((field for field in table if field["Name"] == name.strip()), {})
        if one.get("Id") not in fields:
            continue  # a fixed value, or one in a list
        data, value = bytes.fromhex(raw), fields[one["Id"]]
        number = int.from_bytes(data, "little", signed=bool(one.get("Signed")))
        if value != (data if isinstance(value, bytes) else int(bits, 2) if bits else number):
            return 0
        count += 1
    return count


@pytest.mark.slow
@pytest.mark.shared
def test_canboats_table_is_imported_but_for_what_is_named(shared_captures: Path) -> None:
    """Nearly all of it; and every message that is flat reads what it wrote."""
    imported = load_database(shared_captures / "nmea2000" / "canboat.json")
    assert len(imported.protocol.declared) > 570
    assert len(imported.losses) < 40
    assert imported.statements == len(imported.protocol.declared) + len(imported.losses)


@pytest.mark.slow
def test_a_table_that_would_cost_beyond_measure_is_cut(tmp_path: Path) -> None:
    """Forms of one group, fields, names: what is too much is left out by name, and the rest stands."""
    forms = [
        {"PGN": 61440, "Id": f"form{n}", "Type": "Single", "Fields": [_number("a", 8, Match=n)]}
        for n in range(130)
    ]
    wide = {"PGN": 61441, "Id": "wide", "Type": "Fast", "Fields": [_number(f"f{n}", 1) for n in range(1800)]}
    beside = {
        "PGN": 61442,
        "Id": "b",
        "Type": "Single",
        "Fields": [_number("a", 3, Match=1), _number("b", 13)],
    }
    imported = table(tmp_path, *forms, wide, beside)
    said = {one.reason.partition(": ")[2] for one in imported.losses}
    assert said == {
        "more than 128 forms of PGN 61440: left out",
        "1,800 fields: left out",
        "b has 13 bits beside a fixed value: left out",
    }
    assert len(imported.protocol.declared) == 129
