"""`decode(capture, protocol)`: a whole capture as tables, and these as Arrow, pandas and polars."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest
from construct import Byte, Float32l, GreedyBytes, Int8ub, Int16sl, Int16ub, PaddedString, Struct

from aces_bus import Frame, FrameTable, as_dict, decode, load_protocol, open_recording
from aces_bus.errors import AcesError, CallerError, CaptureError, UnknownNameError
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
    decoded = decode(FRAMES, lamp)
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
    decoded = decode(capture, lamp)
    assert decoded["State"]["level"].values[0] == 0.5
    assert decoded.counts.balance == 0


def test_long_iterables_are_decoded_in_pieces() -> None:
    """More frames than go into one table keep their order and their channels."""
    frames = [
        Frame(0x10, b"\x00" + (n % 9).to_bytes(2, "little"), n / 100, f"can{n % 3}") for n in range(40_000)
    ]
    table = decode(iter(frames), lamp)["State"]
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
        decoded = decode(capture, packets)
        assert decoded["Sample"]["value"].to_list() == [1, 2]
        assert decoded.counts.skipped == 1
    timed = decode([Chunk(data[:4], 12.5), Chunk(data[4:], 13.0)], packets)
    assert timed["Sample"].time.tolist() == [12_500_000_000, 13_000_000_000]


def test_one_message_and_the_losses() -> None:
    """`message` keeps some messages, `include_unknown` adds what was not decoded; counts stay those of the whole."""
    decoded = decode(FRAMES, lamp, message="Raw", include_unknown=True)
    assert list(decoded) == ["Raw", ""]
    assert decoded[""]["reason"].to_list() == ["unknown"]
    assert decoded.counts.decoded == 5
    assert list(decode(FRAMES, lamp, message=["Raw", "State"])) == ["State", "Raw"]


@pytest.mark.parametrize(
    ("call", "complaint"),
    [
        (lambda: decode(FRAMES, lamp, message="Lamp"), "no message of lamp named 'Lamp'"),
        (lambda: decode(FRAMES, lamp)["Lamp"], "no message of lamp named 'Lamp'"),
        (lambda: decode("walk.log", lamp), "no such file"),
        (lambda: decode([b"abc"], lamp), "cannot decode a bytes"),
        (lambda: decode(open_recording(io.BytesIO(b"abc"), link="serial"), lamp), "a capture on serial"),
        (lambda: decode(b"\xff\xff", load_protocol("robotis")), "direction"),
        (lambda: decode("walk.log", "hubbo"), "did you mean 'hubo'"),
    ],
)
def test_wrong_calls(call: Any, complaint: str) -> None:
    """What cannot be decoded is refused with what would work."""
    with pytest.raises(CallerError, match=complaint):
        call()


@pytest.mark.slow
def test_a_path_is_opened_at_the_top() -> None:
    """`aces_bus.decode` opens a recording and decodes it with a protocol or its name."""
    found = decode(EXAMPLES / "hubo2plus.log", "hubo")
    assert found.counts.total == 1243
    with open_recording(EXAMPLES / "hubo2plus.log", link="can") as capture:
        scanner: Any = load_protocol("hubo").scanner()
        records = [one for one in scanner.feed(list(capture)) if type(one).__name__ == "Encoder"]
    table = found["Encoder"]
    assert [as_dict(one)["position"] for one in records] == [
        list(pair) for pair in zip(table["position.0"].to_list(), table["position.1"].to_list(), strict=True)
    ]
    session = decode(EXAMPLES / "robotis_session.bin", load_protocol("robotis"), direction="both")
    assert session.counts.records == sum(map(len, session.values())) == 144
    with pytest.raises(CaptureError, match="no such file"):
        decode(EXAMPLES / "absent.log", "hubo")
    with pytest.raises(UnknownNameError):
        decode(EXAMPLES / "hubo2plus.log", "hubo", dialect="D99")


def test_values_may_stay_raw() -> None:
    """With `raw`, live and as columns, a message has the numbers on the wire."""
    frame = Frame(0x10, bytes.fromhex("01 0A 00"))
    (record,) = lamp.scanner(raw=True).feed([frame])
    assert (record.mode, record.level) == (1, 10)
    (record,) = lamp.scanner().feed([frame])
    assert (record.mode, record.level) == ("on", 1.0)
    table = decode([frame], lamp, raw=True)["State"]
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
    assert decode(log, str(spec))["State"]["level"].to_list() == [2.5]
    assert decode(log, f"{spec}:beacon", raw=True)["State"]["level"].to_list() == [5]
    assert load_protocol(str(spec)) is load_protocol(f"{spec}:beacon")
    with pytest.raises(UnknownNameError, match="lantern"):
        decode(log, f"{spec}:lantern")
    with pytest.raises(CallerError, match="no such file"):
        decode(log, str(tmp_path / "absent.py"))


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
        found = decode(log, str(database))
    assert found["Engine"]["Speed"].values.tolist() == [1.0]
    assert (found.recordings[0].lines_unreadable, found.recordings[0].problems[0].line) == (1, 2)


# ---------------------------------------------------------------------- frames of other libraries


def test_pandas() -> None:
    """Dates, categories, nullable integers, objects as records have them; units in `attrs`."""
    pandas = pytest.importorskip("pandas")
    decoded = decode(FRAMES, lamp)
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
        str(decode([Frame(0x12, bytes(4), 2.5)], lamp).to_pandas("Float")["time"].dtype) == "timedelta64[ns]"
    )


def test_arrow_and_polars() -> None:
    """The columns of the files, in memory."""
    pytest.importorskip("pyarrow")
    decoded = decode(FRAMES, lamp)
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

    decoded = decode(FRAMES, lamp)
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(CallerError, match=said):
        getattr(decoded, method)("State")


def test_several_recordings_are_one(tmp_path: Path) -> None:
    """Frames of several files come by time; bytes of several come one after the other, a packet over both among them."""
    first, second = tmp_path / "first.log", tmp_path / "second.log"
    first.write_text("(2.0) can0 060#78000000FCFFFFFF\n(4.0) can0 060#7A000000FCFFFFFF\nodd line\n")
    second.write_text("(3.0) can1 060#79000000FCFFFFFF\n")
    walk = decode([first, str(second)], "hubo", configuration="hubo2plus")
    table = walk["Encoder"]
    assert table["position.0"].values.tolist() == [120, 121, 122]
    assert [table.channels.names[number] for number in table.channel] == ["can0", "can1", "can0"]
    assert [one.lines_unreadable for one in walk.recordings] == [1, 0]

    data = (EXAMPLES / "robotis_session.bin").read_bytes()
    parts = tmp_path / "a.bin", tmp_path / "b.bin"
    parts[0].write_bytes(data[:101])
    parts[1].write_bytes(data[101:])
    both, whole = (decode(source, "robotis", direction="both") for source in (list(parts), data))
    assert both.counts == whole.counts
    assert {name: len(table) for name, table in both.items()} == {n: len(t) for n, t in whole.items()}


def test_a_decoded_recording_is_saved(tmp_path: Path) -> None:
    """`save` writes what other libraries read, all messages or the only one; a suffix of no format is refused."""
    pytest.importorskip("pyarrow")
    import pyarrow.parquet as pq

    walk = decode(EXAMPLES / "hubo2plus.log", "hubo")
    walk.save(tmp_path / "walk.parquet")
    assert pq.read_table(tmp_path / "walk.parquet" / "Encoder.parquet").num_rows == 350
    decode(EXAMPLES / "hubo2plus.log", "hubo", message="Encoder").save(tmp_path / "encoder.parquet")
    found = pq.read_table(tmp_path / "encoder.parquet")["position.0"].to_pylist()
    assert found == walk["Encoder"]["position.0"].to_list()
    with pytest.raises(CallerError, match="its suffix says no format"):
        walk.save(tmp_path / "walk.txt")


def test_signals_are_drawn() -> None:
    """A unit is a pair of axes; each line has the values of its column, broken where frames pause; names are texts."""
    pyplot = pytest.importorskip("matplotlib.pyplot")
    pyplot.switch_backend("agg")
    spec = Protocol("lamp", link="can")
    level, hot = Quantity(Int16ub, unit="$lx$"), Quantity(Int8ub, unit="°C")
    spec.message("State", id=0x12, payload=Struct("level" / level, "hot" / hot))
    times = [10.0, 10.1, 10.2, 13.0, 13.1]
    lamps = decode([Frame(0x12, bytes([0, n, 20 + n]), t) for n, t in enumerate(times)], spec)
    upper, lower = lamps.plot("State.level", "State.hot")
    assert (upper.get_ylabel(), lower.get_ylabel(), lower.get_xlabel()) == (r"\$lx\$", "°C", "s")
    [line] = upper.lines
    seconds, values = line.get_xdata(), line.get_ydata()
    assert np.allclose(seconds, [0, 0.1, 0.2, 0.2, 3.0, 3.1])
    assert np.array_equal(values, [0, 1, 2, np.nan, 3, 4], equal_nan=True)
    assert [len(lamps.plot("State")), line.get_label()] == [2, "State.level"]
    upper.figure.canvas.draw()  # no formula in any text
    pyplot.close("all")
    assert np.array_equal(lamps["State"].take(slice(2)).plot("hot")[0].lines[0].get_ydata(), [20, 21])
    pyplot.close("all")
    calls: list[tuple[Callable[[], object], str]] = [
        (lambda: lamps.plot(), "plot takes names of signals"),
        (lambda: lamps.plot("Stat.hot"), "did you mean 'State'"),
        (lambda: lamps["State"].plot("hott"), "did you mean 'hot'"),
    ]
    for wrong, words in calls:
        with pytest.raises(AcesError, match=words):
            wrong()


def page_of(shown: object) -> str:
    """What a notebook shows of it."""
    page: str = getattr(shown, "_repr_html_")()  # noqa: B009  (protected by its name alone)
    return page


def test_tables_and_specs_draw_themselves_in_notebooks() -> None:
    """Notebooks show the first rows with units, and how many more there are; hostile texts stay texts."""
    walk = decode(EXAMPLES / "hubo2plus.log", "hubo")
    shown = page_of(walk["Encoder"])
    assert shown.count("<tr>") == 1 + 30 + 1
    assert "<th>position.0 (count)</th>" in shown
    assert "<td>… 320 more</td>" in shown
    assert "<td>Encoder</td><td>350</td>" in page_of(walk)
    assert "<td>GetBoardInfo</td><td>to device</td>" in page_of(load_protocol("hubo"))
    spec = Protocol("lamp", link="can")
    spec.message(
        "Say", id=0x12, payload=Struct("text" / PaddedString(8, "ascii")), doc="<script>alert(1)</script>"
    )
    table = decode([Frame(0x12, b"<b>&\x1b[2J")], spec)
    for page in (page_of(table["Say"]), page_of(table), page_of(spec)):
        assert "<b>" not in page
        assert "<script" not in page
        assert "\x1b" not in page
