"""MAVLink dialects as protocols, against pymavlink: its own XML files, its packers and its parser, unmodified.

What pymavlink packs is decoded value for value, for each message of a dialect with drawn values, and what is encoded it
parses to the same; in both versions, signed, cut and whole.
"""

from __future__ import annotations

import random
import struct
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from aces_bus.protocol import Protocol
from aces_bus.protocol.exchange import load_database
from tests.oracles.foreign import oracle

V1 = oracle("pymavlink.dialects.v10.ardupilotmega", "pymavlink")
V2 = oracle("pymavlink.dialects.v20.ardupilotmega", "pymavlink")
DIALECTS = {"v1": V1, "v2": V2}


@cache
def protocol() -> Protocol:
    """The largest of the dialects that are flown; it includes the common one and others."""
    imported = load_database(Path(str(V2.__file__)).with_suffix(".xml"))
    assert not imported.losses
    return imported.protocol


def kinds(dialect: ModuleType) -> list[Any]:
    return [one for number, one in sorted(dialect.mavlink_map.items()) if number >= 0]


def drawn(kind: Any, rng: random.Random) -> dict[str, Any]:
    """Values for the fields of a message, zeros and the largest numbers among them."""
    counts = dict(zip(kind.ordered_fieldnames, kind.array_lengths, strict=True))
    values: dict[str, Any] = {}
    for name, of in zip(kind.fieldnames, kind.fieldtypes, strict=True):
        if of == "char":
            text = bytes(rng.choice(b"abcXYZ019_") for _ in range(max(counts[name], 1)))
            values[name] = text[: rng.randrange(1, len(text) + 1)]
        else:
            items = [_number(of, rng) for _ in range(max(counts[name], 1))]
            values[name] = items if counts[name] else items[0]
    return values


def _number(of: str, rng: random.Random) -> float:
    if of in ("float", "double"):
        number = rng.choice([0.0, 1.5, -2.25, rng.uniform(-1e3, 1e3), 1e30])
        return float(struct.unpack("<f", struct.pack("<f", number))[0]) if of == "float" else number
    width = int(of.strip("uint_"))
    low, high = (0, (1 << width) - 1) if of[0] == "u" else (-(1 << width - 1), (1 << width - 1) - 1)
    return rng.choice([0, 1, low, high, rng.randint(low, high)])


def plain(raw: Any, given: Any) -> Any:
    """A raw value of ours as pymavlink takes it; `given` is its own."""
    return raw.rstrip(b"\0") if isinstance(given, bytes) else list(raw) if isinstance(given, list) else raw


def assert_same(record: Any, name: str, values: dict[str, Any]) -> None:
    assert type(record).__name__ == name
    for field, value in values.items():
        assert plain(getattr(record, field), value) == value, f"{name}.{field}"


@pytest.mark.parametrize("version", ["v1", "v2"])
def test_every_packet_of_pymavlink_is_decoded_value_for_value(version: str) -> None:
    """All messages of the dialect in one stream that is cut anywhere."""
    rng = random.Random(version)
    sender = DIALECTS[version].MAVLink(None, srcSystem=7, srcComponent=201)
    wanted: list[tuple[str, dict[str, Any], int]] = []
    stream = b""
    for kind in kinds(DIALECTS[version]):
        values = drawn(kind, rng)
        sender.seq = len(wanted) % 256
        wanted.append((kind.msgname, values, sender.seq))
        stream += kind(**values).pack(sender)
    scanner = protocol().scanner(dialect=version, raw=True)
    records: list[Any] = []
    while stream:
        size = rng.randrange(1, 700)
        records += scanner.feed(stream[:size])
        stream = stream[size:]
    assert scanner.counts.unknown == 0
    assert len(records) == len(wanted)
    for record, (name, values, sequence) in zip(records, wanted, strict=True):
        assert_same(record, name, values)
        assert (record.system, record.component, record.packet_sequence) == (7, 201, sequence)


@pytest.mark.parametrize("version", ["v1", "v2"])
def test_every_packet_of_ours_is_the_one_of_pymavlink_and_is_parsed_by_it(version: str) -> None:
    """The raw values of a record, encoded again: byte for byte what pymavlink packs of the same values."""
    rng = random.Random(3)
    dialect, variant = DIALECTS[version], protocol().variant(version)
    sender = dialect.MAVLink(None, srcSystem=1, srcComponent=2)
    for kind in kinds(dialect):
        values = drawn(kind, rng)
        counts = dict(zip(kind.ordered_fieldnames, kind.array_lengths, strict=True))
        fields = {
            name: value.ljust(max(counts[name], 1), b"\0") if isinstance(value, bytes) else value
            for name, value in values.items()
        }
        fields = {
            name: bytes(value)
            if isinstance(value, list) and _is_bytes(variant, kind.msgname, name)
            else value
            for name, value in fields.items()
        }
        packet = variant[kind.msgname].struct.build({"system": 1, "component": 2, **fields}, raw=True)
        assert packet == kind(**values).pack(sender), kind.msgname
        sender.seq = 0
        parsed = dialect.MAVLink(None).decode(bytearray(packet))
        assert parsed.get_type() == kind.msgname


def _is_bytes(variant: Any, message: str, field: str) -> bool:
    node = next(one.node for one in variant[message].plan.walk() if one.path == field)
    return getattr(node, "kind", "") == "bytes"


def test_signed_packets_are_decoded_and_their_signature_kept() -> None:
    """Among unsigned ones, whole, in pieces and with a damaged one; the signature is not verified."""
    rng = random.Random(5)
    signing = V2.MAVLink(None, srcSystem=1, srcComponent=1)
    signing.signing.sign_outgoing = True
    signing.signing.secret_key = bytes(range(32))
    signing.signing.link_id, signing.signing.timestamp = 3, 123_456_789
    open_ = V2.MAVLink(None, srcSystem=1, srcComponent=1)
    wanted, stream = [], b""
    for number, kind in enumerate(kinds(V2)[:60]):
        values = drawn(kind, rng)
        packet = kind(**values).pack(signing if number % 2 else open_)
        stream += packet
        wanted.append((kind.msgname, values, packet[-13:] if number % 2 else b""))
    for size in (len(stream), 1, 37):
        scanner = protocol().scanner(raw=True)
        records: list[Any] = []
        for at in range(0, len(stream), size):
            records += scanner.feed(stream[at : at + size])
        assert scanner.counts.unknown == 0
        for record, (name, values, signature) in zip(records, wanted, strict=True):
            assert_same(record, name, values)
            assert record.trailing == signature
            assert record.incompat_flags == bool(signature)
    (heartbeat,) = protocol().scanner().feed(bytes.fromhex(
        "FD 09 01 00 05 01 01 00 00 00 00 00 00 00 02 03 51 03 03 77 CC 03 15 CD 5B 07 00 00 D6 60 97 10 88 99"
    ))  # fmt: skip
    again = {name: getattr(heartbeat, name) for name in heartbeat.__struct_fields__ if name[0] != "_"}
    assert protocol().encode("HEARTBEAT", **again) == heartbeat.meta.raw


def test_a_recorded_stream_comes_as_columns_and_with_units(tmp_path: Path) -> None:
    """Positions in degrees, unknown values as unknown; of a recording and a dialect by their paths."""
    import aces_bus

    sender = V2.MAVLink(None, srcSystem=1, srcComponent=1)
    stream = b""
    for number in range(300):
        stream += V2.MAVLink_global_position_int_message(
            number, 480_000_000 + number, 110_000_000, 1500, 0, 1, -2, 3, 0xFFFF if number % 2 else 9000
        ).pack(sender)
        stream += V2.MAVLink_heartbeat_message(2, 3, 0x51, number, 4, 3).pack(sender)
    path = tmp_path / "flight.bin"
    path.write_bytes(stream)
    xml = str(Path(str(V2.__file__)).with_name("standard.xml"))
    decoded = aces_bus.decode(path, xml)
    position = decoded["GLOBAL_POSITION_INT"]
    assert len(position) == len(decoded["HEARTBEAT"]) == 300
    assert position["lat"].values[10] == pytest.approx(48.000001)
    assert decoded.counts.unknown == 0
    (record,) = protocol().scanner().feed(stream[: stream.index(b"\xfd", 1)])
    assert record.hdg == 90.0
    assert record.alt == 1500


def test_dialects_of_pymavlink_are_imported_whole() -> None:
    """What a file says and a spec cannot is a note; messages are as many as pymavlink has of it."""
    folder = Path(str(V2.__file__)).parent
    for name in ("minimal", "standard", "csAirLink", "python_array_test"):  # the largest is tested above
        imported = load_database(folder / f"{name}.xml")
        assert not imported.problems, name
        theirs = oracle(f"pymavlink.dialects.v20.{name}", "pymavlink").mavlink_map
        assert {m.name for m in imported.protocol.variant("v2").messages.values()} == {
            one.msgname for number, one in theirs.items() if number >= 0
        }
