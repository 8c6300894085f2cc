"""`protocol.decode(capture)`: a whole capture as tables, and these as Arrow, pandas and polars."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest
from construct import Byte, Float32l, GreedyBytes, Int16sl, Struct

import aces_bus
from aces_bus import Frame, FrameTable, as_dict, load_protocol, open_recording
from aces_bus.errors import CallerError, CaptureError, UnknownNameError
from aces_bus.protocol import BitLayout, Enumeration, Multiplexed, Protocol, Quantity, bits
from aces_bus.recordings.base import Chunk

EXAMPLES = Path(__file__).resolve().parents[2] / "examples" / "captures"

lamp = Protocol("lamp", link="can")
lamp.message(
    "State",
    id=0x10,
    payload=Struct(
        "mode" / Enumeration(Byte, off=0, on=1), "level" / Quantity(Int16sl, scale=0.1, unit="lx")
    ),
    doc="What it does.",
)
lamp.message("Raw", id=0x11, length=range(9), payload=Struct("data" / GreedyBytes))
lamp.message("Float", id=0x12, payload=Struct("value" / Float32l))
lamp.message(
    "Pages",
    id=0x13,
    payload=BitLayout(
        2,
        "page" / bits(2),
        "low" / Multiplexed("page", 0, bits(10, at=4)),
        "high" / Multiplexed("page", 1, bits(6, at=8)),
    ),
)
FRAMES = [
    Frame(0x10, b"\x01\x05\x00", 1.5e9, "can0"),
    Frame(0x11, b"ab", 1.5e9 + 1, "can1"),
    Frame(0x7F, b"", 1.5e9 + 2),
    Frame(0x10, b"\x07\xff\xff", None, None),
    Frame(0x13, b"\xf0\xff", 1.5e9 + 3, "can0"),
    Frame(0x13, b"\x01\x41", 1.5e9 + 4, "can0"),
]

packets = Protocol("packets", link="serial")
frame = packets.framing(sync=b"\xaa", size=3)
frame("Sample", payload=Struct("value" / Int16sl))


def test_a_capture_becomes_tables() -> None:
    """Messages by name, in declared order, with the counts of the whole."""
    decoded = lamp.decode(FRAMES)
    assert list(decoded) == ["State", "Raw", "Pages"]
    assert decoded["State"]["level"].to_list() == [0.5, -0.1]
    assert decoded["State"]["mode"].to_list() == ["on", 7]
    assert (decoded.counts.total, decoded.counts.decoded, decoded.counts.unknown) == (6, 5, 1)
    assert "Float" not in decoded
    assert len(decoded["Float"]) == 0
    assert decoded["Float"]["value"].values.dtype == np.float64
    assert repr(decoded) == "<lamp: State: 2, Raw: 1, Pages: 2>"


@pytest.mark.parametrize(
    "capture",
    [
        FrameTable.from_frames(FRAMES),
        [FrameTable.from_frames(FRAMES[:3])],
        (frame for frame in FRAMES),
        [
            can.Message(
                timestamp=frame.timestamp or 0,
                arbitration_id=frame.arbitration_id,
                data=frame.data,
                is_extended_id=False,
            )
            for frame in FRAMES
        ],
    ],
    ids=["table", "tables", "generator", "python-can"],
)
def test_anything_that_gives_frames(capture: Any) -> None:
    """Tables, frames of either kind, lists and generators."""
    decoded = lamp.decode(capture)
    assert decoded["State"]["level"].values[0] == 0.5
    assert decoded.counts.balance == 0


def test_long_iterables_are_decoded_in_pieces() -> None:
    """More frames than go into one table keep their order and their channels."""
    frames = [
        Frame(0x10, b"\x00" + (n % 9).to_bytes(2, "little"), n / 100, f"can{n % 3}") for n in range(40_000)
    ]
    table = lamp.decode(iter(frames))["State"]
    assert table.row.tolist() == list(range(40_000))
    assert [table.channels.names[number] for number in table.channel[:3].tolist()] == ["can0", "can1", "can2"]
    assert np.array_equal(table["level"].values, (np.arange(40_000) % 9) * 0.1)


def test_streams() -> None:
    """Bytes, chunks with their time and direction, serial captures."""
    data = b"\xaa\x01\x00\xff\xaa\x02\x00"
    for capture in (
        data,
        [data[:2], data[2:]],
        [Chunk(data, 12.5)],
        open_recording(io.BytesIO(data), link="serial"),
    ):
        decoded = packets.decode(capture)
        assert decoded["Sample"]["value"].to_list() == [1, 2]
        assert decoded.counts.skipped == 1
    timed = packets.decode([Chunk(data[:4], 12.5), Chunk(data[4:], 13.0)])
    assert timed["Sample"].time.tolist() == [12_500_000_000, 13_000_000_000]


def test_one_message_and_the_losses() -> None:
    """`message` keeps some messages, `include_unknown` adds what was not decoded; counts stay those of the whole."""
    decoded = lamp.decode(FRAMES, message="Raw", include_unknown=True)
    assert list(decoded) == ["Raw", ""]
    assert decoded[""]["reason"].to_list() == ["unknown"]
    assert decoded.counts.decoded == 5
    assert list(lamp.decode(FRAMES, message=["Raw", "State"])) == ["State", "Raw"]


@pytest.mark.parametrize(
    ("call", "complaint"),
    [
        (lambda: lamp.decode(FRAMES, message="Lamp"), "no message of lamp named 'Lamp'"),
        (lambda: lamp.decode(FRAMES)["Lamp"], "no message of lamp named 'Lamp'"),
        (lambda: lamp.decode("walk.log"), "aces_bus.decode"),
        (lambda: lamp.decode([b"abc"]), "cannot decode a bytes"),
        (lambda: lamp.decode(open_recording(io.BytesIO(b"abc"), link="serial")), "a capture on serial"),
        (lambda: load_protocol("robotis").decode(b"\xff\xff"), "direction"),
        (lambda: aces_bus.decode("walk.log", "hubbo"), "did you mean 'hubo'"),
    ],
)
def test_wrong_calls(call: Any, complaint: str) -> None:
    """What cannot be decoded is refused with what would work."""
    with pytest.raises(CallerError, match=complaint):
        call()


@pytest.mark.slow
def test_a_path_is_opened_at_the_top() -> None:
    """`aces_bus.decode` opens a recording and decodes it with a protocol or its name."""
    found = aces_bus.decode(EXAMPLES / "hubo2plus.log", "hubo")
    assert found.counts.total == 1243
    with open_recording(EXAMPLES / "hubo2plus.log", link="can") as capture:
        scanner: Any = load_protocol("hubo").scanner()
        records = [one for one in scanner.feed(list(capture)) if type(one).__name__ == "Encoder"]
    table = found["Encoder"]
    assert [as_dict(one)["position"] for one in records] == [
        list(pair) for pair in zip(table["position.0"].to_list(), table["position.1"].to_list(), strict=True)
    ]
    session = aces_bus.decode(EXAMPLES / "robotis_session.bin", load_protocol("robotis"), direction="both")
    assert session.counts.records == sum(map(len, session.values())) == 144
    with pytest.raises(CaptureError, match="no such file"):
        aces_bus.decode(EXAMPLES / "absent.log", "hubo")
    with pytest.raises(UnknownNameError):
        aces_bus.decode(EXAMPLES / "hubo2plus.log", "hubo", dialect="D99")


def test_values_may_stay_raw() -> None:
    """With `raw`, live and as columns, a message has the numbers on the wire."""
    frame = Frame(0x10, bytes.fromhex("01 0A 00"))
    (record,) = lamp.scanner(raw=True).feed([frame])
    assert (record.mode, record.level) == (1, 10)
    (record,) = lamp.scanner().feed([frame])
    assert (record.mode, record.level) == ("on", 1.0)
    table = lamp.decode([frame], raw=True)["State"]
    assert (table["mode"].to_list(), table["level"].to_list()) == ([1], [10])


def test_a_python_file_is_a_protocol(tmp_path: Path) -> None:
    """`aces_bus.decode` and `load_protocol` take a spec by its path, of several by path and name; raw where asked."""
    spec, log = tmp_path / "beacon.py", tmp_path / "beacon.log"
    spec.write_text(
        "from construct import Byte, Struct\n"
        "from aces_bus.protocol import Protocol, Quantity\n"
        "beacon = Protocol('beacon', link='can')\n"
        "beacon.message('State', id=0x10, payload=Struct('level' / Quantity(Byte, scale=0.5, unit='V')))\n"
    )
    log.write_text("(1.0) can0 010#05\n")
    assert aces_bus.decode(log, str(spec))["State"]["level"].to_list() == [2.5]
    assert aces_bus.decode(log, f"{spec}:beacon", raw=True)["State"]["level"].to_list() == [5]
    assert load_protocol(str(spec)) is load_protocol(f"{spec}:beacon")
    with pytest.raises(UnknownNameError, match="lantern"):
        aces_bus.decode(log, f"{spec}:lantern")
    with pytest.raises(CallerError, match="no such file"):
        aces_bus.decode(log, str(tmp_path / "absent.py"))


def test_a_database_is_a_protocol_and_losses_are_told(tmp_path: Path) -> None:
    """`aces_bus.decode` takes a DBC by its path; what cannot be read of it is a warning, of the recording a count."""
    pytest.importorskip("cantools")
    database = tmp_path / "car.dbc"
    database.write_text(
        'VERSION ""\nBU_: X\nBO_ 256 Engine: 8 X\n SG_ Speed : 0|16@1+ (0.25,0) [0|0] "rpm" X\nBO_ nonsense\n'
    )
    log = tmp_path / "drive.log"
    log.write_text("(1.0) can0 100#0400000000000000\nnonsense\n")
    with pytest.warns(UserWarning, match=r"car\.dbc: 1 of \d+ statements was left out; first: line 5"):
        found = aces_bus.decode(log, str(database))
    assert found["Engine"]["Speed"].values.tolist() == [1.0]
    assert (found.capture.lines_unreadable, found.capture.problems[0].line) == (1, 2)


# ---------------------------------------------------------------------- frames of other libraries


def test_pandas() -> None:
    """Dates, categories, nullable integers, objects as records have them; units in `attrs`."""
    pandas = pytest.importorskip("pandas")
    decoded = lamp.decode(FRAMES)
    frame = decoded.to_pandas("State")
    assert list(frame.columns) == ["time", "channel", "id", "extended", "rx", "mode", "level"]
    assert frame["time"].iloc[0] == pandas.Timestamp(1_500_000_000, unit="s", tz="UTC")
    assert frame["time"].isna().tolist() == [False, True]
    assert frame["channel"].tolist()[0] == "can0"
    assert frame["channel"].isna().tolist() == [False, True]
    assert frame["rx"].isna().all()
    assert frame["mode"].tolist() == [1, 7]
    assert frame.attrs["columns"]["level"] == {"unit": "lx"}
    assert (frame.attrs["message"], frame.attrs["doc"]) == ("State", "What it does.")
    assert decoded.to_pandas("State", names=True)["mode"].tolist() == ["on", "7"]
    assert decoded.to_pandas("State", float32=True)["level"].dtype == np.float32
    assert decoded.to_pandas("Raw")["data"].tolist() == [b"ab"]
    pages = decoded.to_pandas("Pages")
    assert str(pages["low"].dtype) == "UInt16"
    assert pages["low"].isna().tolist() == [False, True]
    assert pages["high"].tolist()[1] == 0x41 & 0x3F
    assert len(decoded.to_pandas("Float")) == 0
    assert (
        str(lamp.decode([Frame(0x12, bytes(4), 2.5)]).to_pandas("Float")["time"].dtype) == "timedelta64[ns]"
    )


def test_arrow_and_polars() -> None:
    """The columns of the files, in memory."""
    pytest.importorskip("pyarrow")
    decoded = lamp.decode(FRAMES)
    table = decoded.to_arrow("State", names=True)
    assert table["mode"].to_pylist() == ["on", "7"]
    assert table.schema.field("level").metadata == {b"unit": b"lx"}
    assert decoded.to_arrow("Raw")["data"].to_pylist() == [b"ab"]
    assert str(decoded.to_arrow("Raw").schema.field("data").type) == "binary"
    assert decoded.to_arrow("Pages")["low"].null_count == 1
    assert decoded.to_arrow("Float").num_rows == 0
    polars = pytest.importorskip("polars")
    frame = decoded.to_polars("State")
    assert frame["level"].to_list() == [0.5, -0.1]
    assert frame.schema["time"] == polars.Datetime("ns", "UTC")
    assert decoded.to_polars("Raw")["data"].to_list() == [b"ab"]


@pytest.mark.parametrize(
    ("module", "method", "said"),
    [
        ("pyarrow", "to_arrow", r"aces-bus\[columns\]"),
        ("pandas", "to_pandas", "install pandas"),
        ("polars", "to_polars", "install polars"),
    ],
)
def test_missing_libraries(module: str, method: str, said: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each says what to install."""
    import sys

    decoded = lamp.decode(FRAMES)
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(CallerError, match=said):
        getattr(decoded, method)("State")
