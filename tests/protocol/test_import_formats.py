"""KCD, SYM, EDS and DCF files as protocols."""

from __future__ import annotations

import random
import re
from pathlib import Path

import pytest

from aces_bus import Frame, load_protocol
from aces_bus.errors import CallerError
from aces_bus.protocol.exchange import load_database
from tests.protocol.imported import CAR, EDS, HEAD, decoded, imported, laws_hold

cantools = pytest.importorskip("cantools")


@pytest.mark.parametrize("kind", ["kcd", "sym"])
def test_other_formats_say_the_same(tmp_path: Path, kind: str) -> None:
    """What cantools writes as KCD or SYM decodes as the DBC does."""
    # Floats need a length of 32 or 64 there, too; the extended multiplexers are the DBC's own.
    body = CAR.replace("200 Large: 20", "200 Large: 8").replace("152|8", "56|8")
    dbc = imported(tmp_path, body)
    database = cantools.database.load_file(str(tmp_path / "car.dbc"))
    text = database.as_kcd_string() if kind == "kcd" else database.as_sym_string()
    other = imported(tmp_path, text, f"car.{kind}")
    assert {m.name for m in other.protocol.declared} == {m.name for m in dbc.protocol.declared}
    frames = [Frame(100, bytes([n, 3, n % 7, 255 - n, 0])) for n in range(0, 256, 5)]
    for one, same in zip(decoded(dbc, *frames), decoded(other, *frames), strict=True):
        assert (one.speed, one.gear, one.temperature) == (same.speed, same.gear, same.temperature)


@pytest.mark.parametrize(
    ("kind", "old", "new"),
    [
        ("sym", 'Sig="speed" 0', 'Sig="speed" 4000000000'),
        ("sym", 'Sig="gear" signed 3', 'Sig="gear" signed 400000000'),
        ("sym", "Len=5", "Len=4000000000"),
        ("sym", "ID=064h", "ID=064h-1FFFFFFFh"),
        ("kcd", 'length="5"', 'length="4000000000"'),
        ("kcd", 'offset="16"', 'offset="4000000000"'),
    ],
)
def test_sizes_beyond_measure_are_refused(tmp_path: Path, kind: str, old: str, new: str) -> None:
    """Formats that are read as a whole are refused with the line, before anybody makes room."""
    database = cantools.database.load_string(
        HEAD + CAR.replace("200 Large: 20", "200 Large: 8").replace("152|8", "56|8"), "dbc"
    )
    text = database.as_kcd_string() if kind == "kcd" else database.as_sym_string()
    assert old in text
    imported(tmp_path, text, f"car.{kind}")
    with pytest.raises(CallerError, match=rf"car\.{kind}:\d+: "):
        imported(tmp_path, text.replace(old, new, 1), f"car.{kind}")


def test_mapped_objects_become_fields(tmp_path: Path) -> None:
    """Of any node; types below 20h are bits that mean nothing; what is switched off is listed."""
    pytest.importorskip("canopen")
    found = imported(tmp_path, EDS, "drive.eds")
    assert [p.reason for p in found.problems] == [
        "RPDO1: it is switched off (bit 31 of its COB-ID): left out"
    ]
    word = 0x1234 | 5 << 16 | (-2 & 0x1FFFFF) << 19 | (-3 & 0xFFFF) << 40
    pdo, heartbeat, alarm = decoded(
        found,
        Frame(0x185, word.to_bytes(7, "little")),
        Frame(0x705, b"\x05"),
        Frame(0x085, bytes.fromhex("1023010000000000")),
    )
    assert (pdo.node, pdo.Status_word, pdo.Position, pdo.Other_Current) == (5, 0x1234, -2, -3)
    assert pdo.meta.direction == "from device"
    assert (heartbeat.node, heartbeat.state, alarm.code) == (5, "operational", 0x2310)
    (sync,) = decoded(found, Frame(0x080, b"\x07"))
    assert (sync.meta.message, sync.counter) == ("Sync", b"\x07")
    laws_hold(found, scenes=2)


def test_a_dcf_knows_its_node(tmp_path: Path) -> None:
    """Its identifiers are those of that node; what is set counts, not the default."""
    pytest.importorskip("canopen")
    text = EDS.replace("DefaultValue=0x80000200", "DefaultValue=0x80000200\nParameterValue=0x0000027F")
    found = imported(tmp_path, "[DeviceComissioning]\nNodeID=0x10\nBaudrate=250\n" + text, "drive.dcf")
    assert found.problems == ()
    assert found.protocol.bitrate == 250_000
    identifiers = {m.name: m.identifier.constant for m in found.protocol.declared}
    assert (identifiers["TPDO1"], identifiers["RPDO1"], identifiers["Heartbeat"]) == (0x190, 0x27F, 0x710)
    assert found.protocol["RPDO1"].direction == "to device"


def test_a_dcf_whose_node_is_no_number_is_read_without_it(tmp_path: Path) -> None:
    """The section of its node is left out by name, and the rest of the file is a protocol."""
    path = tmp_path / "bad.dcf"
    path.write_text(
        "[DeviceInfo]\nProductName=x\n[DeviceComissioning]\nNodeID=abc\n"
        "[1000]\nParameterName=Device type\nObjectType=0x7\nDataType=0x0007\nAccessType=ro\n",
        encoding="utf-8",
    )
    imported = load_database(path)
    assert imported.protocol["Heartbeat"].identifier.match(0x705) == {"node": 5}
    (lost,) = imported.losses
    assert lost.excerpt == "[DeviceComissioning]"
    assert "cannot be read" in lost.reason


@pytest.mark.slow
def test_damaged_eds_files_never_raise_anything_else(tmp_path: Path) -> None:
    """Cut anywhere, bytes changed, lines dropped: a protocol with problems, or one clear error."""
    pytest.importorskip("canopen")
    rng = random.Random(9)
    path = tmp_path / "damaged.eds"
    whole = (EDS + "[DeviceComissioning]\nNodeID=4\nBaudrate=500\n").encode()
    for _ in range(60):
        data = bytearray(whole)
        for _ in range(rng.randint(1, 8)):
            at = rng.randrange(len(data))
            if rng.randrange(3):
                data[at] = rng.choice(b"0123456789abcdefx$[]=;\n -")
            else:
                del data[at : at + rng.randrange(30)]
        path.write_bytes(bytes(data))
        try:
            found = load_database(path)
        except CallerError:
            continue
        decoded(found, Frame(0x185, bytes(7)), Frame(0x184, bytes(8)), Frame(0x204, bytes(4)))


def test_a_damaged_eds(tmp_path: Path) -> None:
    """Lines and objects that cannot be read cost themselves."""
    pytest.importorskip("canopen")
    text = EDS.replace("DataType=6\n", "DataType=six\n") + "[6041]\nParameterName=Again\n"
    text = text.replace("VendorName=Nobody\n", "VendorName=Nobody\nnonsense\n", 1)
    found = imported(tmp_path, text, "drive.eds")
    said = [problem.reason.partition(":")[0] for problem in found.losses]
    assert "an object that cannot be read" in said
    assert "a section that is there already" in said
    assert "not of the form key=value, or there twice" in said
    (pdo,) = decoded(found, Frame(0x185, bytes(7)))
    assert pdo.x6041_0 == 0
    assert pdo.Position == 0


@pytest.mark.parametrize(
    ("name", "wanted"),
    [
        ("hubo:D08", "load_protocol('hubo').variant(dialect='D08')"),
        ("hubo:D08@hubo2", "load_protocol('hubo').variant(dialect='D08', configuration='hubo2')"),
        ("folder/common.xml:v1", "load_protocol('folder/common.xml').variant(dialect='v1')"),
    ],
)
def test_a_program_is_told_how_it_asks_for_a_dialect(name: str, wanted: str) -> None:
    """What `-p` takes as one word is a protocol and its variant."""
    with pytest.raises(CallerError, match=re.escape(wanted)):
        load_protocol(name)
    with pytest.raises(CallerError, match="no protocol named 'nowhere:D08'"):
        load_protocol("nowhere:D08")
