"""The published tests of plug-ins, run over all of ours."""

from __future__ import annotations

import io
import struct
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from aces_bus import FrameTable
from aces_bus.export.open import table_formats
from aces_bus.plugins import installed_points
from aces_bus.recordings.open import formats
from aces_bus.recordings.write import open_writer, writer_formats
from aces_bus.testing.plug_ins import (
    backend_tests,
    database_tests,
    exporter_tests,
    log_tests,
    reader_tests,
    store_tests,
    verb_tests,
    writer_tests,
)
from tests.recordings.formats import FRAMES, SAMPLES


def _written(form: str) -> bytes:
    file = io.BytesIO()
    with open_writer(file, form) as writer:
        writer.write(FrameTable.from_frames(FRAMES))
    return file.getvalue()


def _pcap() -> bytes:
    """A packet of SocketCAN in the oldest header."""
    frame = struct.pack(">IBxxx8s", 0x123, 2, b"\x01\x02")
    return (
        struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, 227)
        + struct.pack("<IIII", 1, 0, 16, 16)
        + frame
    )


READ = {
    **{sample.format: (sample.content, sample.frames) for sample in SAMPLES if sample.frames},
    "blf": (_written("blf"), 4),
    "mf4": (_written("mf4"), 4),
    "pcap": (_pcap(), 1),
    "slog": (next(one.content for one in SAMPLES if one.format == "slog"), 2),
}
EDS = b"""[FileInfo]
FileName=a.eds
FileVersion=1
[DeviceInfo]
VendorName=Nobody
ProductName=Pump
[MandatoryObjects]
SupportedObjects=0
[OptionalObjects]
SupportedObjects=2
1=0x1800
2=0x1A00
[ManufacturerObjects]
SupportedObjects=1
1=0x2000
[2000]
ParameterName=Flow
ObjectType=0x7
DataType=0x0003
AccessType=ro
PDOMapping=1
[1800]
ParameterName=TPDO
ObjectType=0x9
SubNumber=2
[1800sub0]
ParameterName=n
ObjectType=0x7
DataType=0x0005
AccessType=ro
DefaultValue=1
[1800sub1]
ParameterName=COB-ID
ObjectType=0x7
DataType=0x0007
AccessType=rw
DefaultValue=$NODEID+0x180
[1A00]
ParameterName=Mapping
ObjectType=0x9
SubNumber=2
[1A00sub0]
ParameterName=n
ObjectType=0x7
DataType=0x0005
AccessType=rw
DefaultValue=1
[1A00sub1]
ParameterName=1
ObjectType=0x7
DataType=0x0007
AccessType=rw
DefaultValue=0x20000010
"""
DBC = b"""VERSION ""
NS_ :
BS_:
BU_: A
BO_ 256 M: 8 A
 SG_ x : 0|16@1- (0.5,0) [0|0] "V" A
"""
MAVLINK = b"""<?xml version="1.0"?><mavlink><messages><message id="0" name="HEARTBEAT"><description>alive</description>
<field type="uint32_t" name="mode">mode</field><field type="uint8_t" name="kind">kind</field></message></messages></mavlink>
"""
DATABASES = {"a.dbc": DBC, "a.eds": EDS, "a.xml": MAVLINK}


def _case(make: Callable[[str], Callable[[str, Path], None]], name: str) -> list[Any]:
    """Each check of one plug-in's suite, with its test: as a package of others would have it in one line."""
    test = make(name)
    (mark,) = test.pytestmark  # type: ignore[attr-defined]
    return [pytest.param(test, check, id=f"{name}-{check}") for check in mark.args[1]]


def _cases() -> list[Any]:
    found: list[Any] = []
    for name in formats():
        if name in READ:
            content, frames = READ[name]
            found += _case(partial(reader_tests, sample=content, frames=frames), name)
    for name in writer_formats():
        found += _case(writer_tests, name)
    for name in table_formats():
        found += _case(exporter_tests, name)
    for name in ("text", "csv", "sqlite", "parquet", "mcap"):
        found += _case(log_tests, name)
    for name, sample in DATABASES.items():
        found += _case(partial(database_tests, sample=sample), name)
    return found


@pytest.mark.parametrize(("test", "check"), _cases())
def test_ours_pass_the_published_tests(test: Callable[[str, Path], None], check: str, tmp_path: Path) -> None:
    """Each reader, writer, exporter, log and database that is installed passes what is asked of a stranger's."""
    test(check, tmp_path)


def test_every_reader_has_a_sample() -> None:
    """A reader without a sample here says why."""
    elsewhere = {"raw": "any bytes are one", "sqlite": "a file of SQLite's own", "dxconf": "of a serial line"}
    assert set(formats()) == {*READ, *elsewhere}


@pytest.mark.slow
@pytest.mark.parametrize(
    "verb", [point.name.replace(".", " ") for point in installed_points("aces_bus.verbs")]
)
def test_our_verbs_pass_the_published_tests(verb: str, tmp_path: Path) -> None:
    """Each verb and action passes what is asked of a stranger's."""
    for case in _case(verb_tests, verb):
        case.values[0](case.values[1], tmp_path)


@pytest.mark.parametrize("check", ["passed", "reopened"])
@pytest.mark.parametrize("interface", ["virtual", "aces"])
def test_backends_pass_the_published_tests(interface: str, check: str, tmp_path: Path) -> None:
    """Our backend, and python-can's virtual one, pass what is asked of a stranger's."""
    ends = {"interface": interface, "channel": "plug_ins"}
    backend_tests(ends, ends)(check, tmp_path)


@pytest.mark.parametrize("check", ["kept", "moved", "missing"])
@pytest.mark.parametrize("store", ["file", "memory"])
def test_stores_pass_the_published_tests(store: str, check: str, tmp_path: Path) -> None:
    """This machine's files and fsspec's memory pass what is asked of a stranger's store."""
    pytest.importorskip("fsspec")
    store_tests(str(tmp_path / "store") if store == "file" else "memory://plug_ins")(check, tmp_path)
