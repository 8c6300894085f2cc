"""Exports read back, by other libraries, to what the live scanner gives."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest
from construct import Array, Byte, Bytes, Float32l, GreedyBytes, Int16sl, Int16ul, Int64ul, Struct
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from aces_bus import Frame, FrameTable, as_dict, load_protocol, make_column_scanner, make_scanner
from aces_bus.export import open_export
from aces_bus.protocol import (
    BitLayout,
    Enumeration,
    Flags,
    IdField,
    Multiplexed,
    Protocol,
    Quantity,
    Text,
    Variant,
    bits,
)
from aces_bus.testing import strategies
from tests.export import reading
from tests.export.reading import Columns
from tests.specs.catalogue import SPECS

CAPTURES = Path(__file__).resolve().parents[2] / "examples" / "captures"

rig = Protocol("rig", link="can")
Node = IdField("node", range(4))
rig.message(
    "State",
    id=0x100 + Node,
    payload=Struct(
        "mode" / Enumeration(Byte, off=0, torque=2),
        "error" / Flags(Byte, hot=0, cold=3),
        "angle" / Quantity(Int16sl, scale=0.01, unit="°"),
        "load" / Float32l,
    ),
    doc="What a motor does.",
)
rig.message("Big", id=0x200, payload=Struct("value" / Int64ul))
rig.message("Raw", id=0x201, length=range(9), payload=Struct("data" / GreedyBytes))
rig.message("Name", id=0x202, payload=Struct("name" / Text(6), "tail" / Bytes(2)))
rig.message(
    "Clash", id=0x203, payload=Struct("time" / Int16ul, "id" / Byte, "channel" / Byte, "rx" / Array(2, Byte))
)
rig.message(
    "Pages",
    id=0x204,
    payload=BitLayout(
        2,
        "page" / bits(2),
        "low" / Multiplexed("page", 0, Quantity(bits(10, at=4), unit="V", scale=0.5)),
        "high" / Multiplexed("page", 1, bits(6, at=8)),
    ),
)
rig.message("Ask", id=0x205, remote=True)
RIG = [rig.variant()]

FRAMES = [
    Frame(0x100, bytes.fromhex("0209640000008fbf"), 1436509052.000001, "can0", is_rx=True),
    Frame(
        0x103, bytes.fromhex("07f10180000080ff"), 1436509052.25, "can1", is_rx=False
    ),  # −inf, and no such mode
    Frame(0x101, bytes.fromhex("000000000000c07f"), None, None),  # NaN
    Frame(0x200, b"\xff" * 8, 1436509053.0, "can0"),
    Frame(0x200, (1 << 63).to_bytes(8, "little"), 1436509053.5, "can0"),
    Frame(0x200, b"\x01" + bytes(7), 1436509053.75, "can0"),
    Frame(0x201, b"", 1436509054.0, "can0"),
    Frame(0x201, b'"\n,\x00;', 1436509054.125, "can0"),
    Frame(0x202, b'a"\n,\xc3\xa9\x00\x01', 1436509055.0, "can0"),
    Frame(0x202, b"\x00" * 8, 1436509055.0, "can0"),
    Frame(0x203, bytes(range(1, 6)), 1436509056.0, "can0"),
    Frame(0x204, b"\xf0\xff", 1436509057.0, "can0"),
    Frame(0x204, b"\x01\xff", 1436509058.0, "can0"),
    Frame(0x204, b"\x02\xff", 1436509059.0, "can0"),
    Frame(0x205, b"", 1436509060.0, "can0", is_remote_frame=True),
    Frame(0x7FF, b"\xde\xad", 1436509061.0, "can0"),
    Frame(0x200, b"\x00", 1436509062.0, "can0"),
]


def written(
    path: Path | str,
    variants: Sequence[Variant],
    traffic: Any,
    *,
    direction: Any = None,
    cuts: Sequence[int] = (),
    **options: Any,
) -> Path:
    """An export of frames or bytes, fed in pieces."""
    scanner = make_column_scanner(variants, direction=direction, include_unknown=True)
    table = FrameTable.from_frames(traffic) if variants[0].link == "can" else None
    with open_export(str(path), variants=variants, **options) as export:
        for start, end in zip([0, *cuts], [*cuts, len(traffic)], strict=True):
            if start < end:
                piece: Any = table.take(slice(start, end)) if table is not None else traffic[start:end]
                export.write(scanner.feed(piece))
        export.write(scanner.close())
    return Path(str(path).rstrip("/"))


def same(one: Any, other: Any) -> bool:
    """Equal, and NaN equal to itself."""
    if isinstance(one, float) and isinstance(other, float):
        return one == other or (math.isnan(one) and math.isnan(other))
    return bool(one == other)


def differing(
    found: dict[str, Columns], wanted: dict[str, Columns], equal: Callable[[Any, Any], bool] = same
) -> list[Any]:
    """Where columns are not what they should be; the dataset of losses is left out."""
    faults: list[Any] = (
        [set(found) - {"_lost"} ^ set(wanted)] if set(found) - {"_lost"} != set(wanted) else []
    )
    for name, columns in wanted.items():
        mine = found.get(name, {})
        if set(mine) != set(columns):
            faults.append((name, set(mine) ^ set(columns)))
            continue
        for column, values in columns.items():
            if len(values) != len(mine[column]):
                faults.append((name, column, len(mine[column]), len(values)))
            faults += [
                (name, column, a, b) for a, b in zip(mine[column], values, strict=False) if not equal(a, b)
            ]
    return faults


def as_csv(value: Any) -> str | None:
    """What a cell says."""
    if value is None or value in ("", b""):
        return None
    if isinstance(value, bytes):
        return value.hex()
    if isinstance(value, bool):
        return str(value).lower()
    return json.dumps(value, separators=(",", ":")) if isinstance(value, (list, dict)) else str(value)


def equal_csv(cell: Any, value: Any) -> bool:
    if isinstance(value, (int, float)) and not isinstance(value, bool) and cell is not None:
        return same(float(cell), float(value))
    return bool(cell == as_csv(value))


def equal_npz(read: Any, value: Any) -> bool:
    """Bytes and texts come as bytes."""
    return read == value.encode() if isinstance(value, str) and isinstance(read, bytes) else same(read, value)


def equal_sqlite(read: Any, value: Any) -> bool:
    """NaN is NULL, large numbers are digits, booleans numbers."""
    if isinstance(value, float) and math.isnan(value):
        return read is None
    if isinstance(value, int) and value >= 1 << 63:
        return bool(read == str(value))
    return same(read, value)


READERS: dict[str, tuple[Callable[[Path], dict[str, Columns]], Callable[[Any, Any], bool]]] = {
    ".parquet": (reading.read_parquet, same),
    ".arrow": (reading.read_ipc, same),
    ".npz": (reading.read_npz, equal_npz),
    ".sqlite": (reading.read_sqlite, equal_sqlite),
}
SETS: dict[str, tuple[list[Variant], Any, Any]] = {
    "rig": (RIG, FRAMES, None),
    "hubo": ([load_protocol("hubo").variant()], "hubo2plus.log", None),
    "robotis": ([load_protocol("robotis").variant()], "robotis_session.bin", "both"),
    "minihubo_adc": ([load_protocol("minihubo_adc").variant()], "adc.bin", None),
}


def traffic_of(name: str) -> tuple[list[Variant], Any, Any]:
    variants, traffic, direction = SETS[name]
    if isinstance(traffic, str):
        path = CAPTURES / traffic
        if traffic.endswith(".log"):
            from aces_bus import open_recording

            with open_recording(path, link="can") as capture:
                return variants, list(capture), direction
        return variants, path.read_bytes(), direction
    return variants, traffic, direction


@pytest.mark.parametrize("suffix", READERS)
@pytest.mark.parametrize("name", SETS)
def test_what_is_written_is_what_the_live_scanner_gives(name: str, suffix: str, tmp_path: Path) -> None:
    """Every value of every message, read back by another library, is the record's."""
    variants, traffic, direction = traffic_of(name)
    cuts = range(7, len(traffic), 1 + len(traffic) // 5)
    path = written(tmp_path / f"out{suffix}", variants, traffic, direction=direction, cuts=list(cuts))
    read, equal = READERS[suffix]
    found, wanted = read(path), reading.live(variants, traffic, direction)
    assert wanted
    assert differing(found, wanted, equal) == []


@pytest.mark.parametrize("name", SETS)
def test_csv_folders_say_the_same(name: str, tmp_path: Path) -> None:
    """Cells are names, hexadecimal digits, and seconds with nine places."""
    variants, traffic, direction = traffic_of(name)
    found = reading.read_csv(written(f"{tmp_path}/out.csv/", variants, traffic, direction=direction))
    wanted = reading.live(variants, traffic, direction)
    for columns in wanted.values():
        columns["time"] = [
            None if ns is None else f"{ns // 10**9}.{ns % 10**9:09d}" for ns in columns["time"]
        ]
    assert differing(found, wanted, equal_csv) == []


@pytest.mark.parametrize("name", SETS)
def test_mcap_holds_the_records(name: str, tmp_path: Path) -> None:
    """A topic a message, records as JSON in the order of the capture; names where asked for."""

    pytest.importorskip("mcap")
    variants, traffic, direction = traffic_of(name)
    path = written(tmp_path / "out.mcap", variants, traffic, direction=direction, names=True)
    found = reading.read_mcap(path)
    scanner: Any = make_scanner(variants, direction=direction)
    wanted: dict[str, list[Any]] = {}
    for record in [*scanner.feed(traffic), *scanner.close()]:
        topic = f"/{record.meta.protocol}/{record.meta.message}"
        wanted.setdefault(topic, []).append(
            in_json(as_dict(record), names_of(type(record).__name__, variants))
        )
    got = {
        topic: [{k: v for k, v in one.items() if k != "meta"} for _, one in messages]
        for topic, messages in found.items()
        if topic != "/_lost"
    }
    assert got == wanted
    times = [time for messages in found.values() for time, _ in messages]
    assert len(times) == sum(map(len, found.values()))


def names_of(message: str, variants: Sequence[Variant]) -> set[str]:
    return {name for name, kind in reading.kinds(variants)[message].items() if kind.names is not None}


def in_json(value: Any, names: set[str], path: str = "") -> Any:
    """A record's value as JSON has it."""
    if isinstance(value, dict):
        return {k: in_json(v, names, f"{path}.{k}".strip(".")) for k, v in value.items()}
    if isinstance(value, list):
        return [in_json(v, names, f"{path}.{k}".strip(".")) for k, v in enumerate(value)]
    if isinstance(value, bytes):
        return value.hex()
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, int) and not isinstance(value, bool):
        return str(int(value)) if path in names else int(value)
    return value


@pytest.mark.slow
@settings(max_examples=12, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
@given(data=st.data())
def test_drawn_frames_and_streams(data: st.DataObject, tmp_path_factory: pytest.TempPathFactory) -> None:
    """Whatever occurs on a wire, cut anywhere, is in Parquet and NumPy files what the live scanner makes of it."""
    protocol = data.draw(st.sampled_from(sorted(SPECS.values(), key=lambda one: one.name)))
    variant = data.draw(st.sampled_from(protocol.variants()))
    direction: Any = "from device" if variant.direction_conflict else None
    scene = data.draw(strategies.scenes(variant, direction, size=300))
    cuts = [cut for cut in data.draw(st.lists(st.integers(0, 300), max_size=9)) if cut < len(scene.traffic)]
    traffic = scene.traffic
    wanted = reading.live([variant], traffic, direction)
    folder = tmp_path_factory.mktemp("drawn")
    for suffix in (".parquet", ".npz"):
        path = written(
            folder / f"out{suffix}", [variant], traffic, direction=direction, cuts=sorted(set(cuts))
        )
        read, equal = READERS[suffix]
        assert differing(read(path), too_wide_is_none(wanted, variant), equal) == []


def too_wide_is_none(wanted: dict[str, Columns], variant: Variant) -> dict[str, Columns]:
    """Integers of no stated width are left empty beyond 64 bits, as the export says in its notes."""
    what = reading.held([variant])
    return {
        message: {
            column: [
                None
                if what[message].get(column) == "integer"
                and value is not None
                and not -(1 << 63) <= value < 1 << 63
                else value
                for value in values
            ]
            for column, values in columns.items()
        }
        for message, columns in wanted.items()
    }
