"""`aces decode -o TABLES`: the same rows, counts, warnings and statuses as record lines, in files of tables."""

from __future__ import annotations

import json
import os
import signal
import sqlite3
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import pytest

from aces_bus.errors import CaptureError
from aces_bus.protocol import Variant
from aces_tools import console, decoding
from aces_tools.protocols_arg import parse_protocols

from .conftest import LOG, SPEC, Aces, Result

pq = pytest.importorskip("pyarrow.parquet")
pa = pytest.importorskip("pyarrow")


@pytest.fixture(scope="module")
def spec(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The protocols of the other tests of the command, declared once for all tests here."""
    path = tmp_path_factory.mktemp("spec") / "my_spec.py"
    path.write_text(SPEC, encoding="utf-8")
    return path


_KNOWN: dict[tuple[str, ...], list[Variant]] = {}


@pytest.fixture(autouse=True)
def declared_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Declaring and compiling a protocol takes longer than all else here."""

    def parse(texts: list[str]) -> list[Variant]:
        if tuple(texts) not in _KNOWN:
            _KNOWN[tuple(texts)] = parse_protocols(texts)
        return _KNOWN[tuple(texts)]

    monkeypatch.setattr(decoding, "parse_protocols", parse)


EXAMPLES = Path(__file__).resolve().parents[2] / "examples" / "captures"


def rows(path: Path) -> dict[str, list[dict[str, Any]]]:
    """A folder of Parquet files, by message; times in ns."""
    found = {}
    for file in sorted(path.iterdir()):
        table = pq.read_table(file)
        place = table.schema.get_field_index("time")
        table = table.set_column(place, "time", table["time"].cast(pa.int64()))
        found[file.stem] = table.to_pylist()
    return found


def both(
    aces: Aces, tmp_path: Path, *arguments: str | Path
) -> tuple[Result, Result, dict[str, list[dict[str, Any]]]]:
    """The same call with record lines and with tables."""
    live = aces("decode", *arguments, "--format", "jsonl", "--unknown", "show")
    out = tmp_path / "out.parquet"
    columns = aces("decode", *arguments, "-o", out, "--unknown", "show", "--names")
    assert columns.out == ""
    return live, columns, rows(out)


OPTIONS: list[list[str]] = [
    [],
    ["--strict"],
    ["--message", "Encoder"],
    ["--message", "Encoder,State", "--where", "board=0"],
    ["--where", "board=0", "--where", "kp>0"],
    ["--where", "position<0"],
    ["--where", "position!=10"],
    ["--where", "position.1<=2"],
    ["--where", "mode=torque"],
    ["--where", "mode=2"],
    ["--where", "mode!=torque"],
    ["--where", "error=hot"],
    ["--where", "error!=9"],
    ["--where", "error=9"],
    ["--where", "angle=1"],
    ["--where", "load=nan"],
    ["--where", "load<0"],
    ["--where", "load!=-1.0"],
    ["--where", "data=none"],
    ["--where", "data="],
    ["--where", "kp!=none"],
    ["--where", "meta.channel=can1"],
    ["--where", "meta.channel!=can1"],
    ["--where", "meta.direction=to"],
    ["--where", "meta.time>1436509052.035"],
    ["--where", "meta.time!=none"],
    ["--where", "meta.identifier>=0x1C0"],
    ["--where", "meta.remote=true"],
    ["--where", "meta.extended=false"],
    ["--where", "meta.is_rx=none"],
    ["--where", "meta.offset=none"],
    ["--where", "meta.size>1"],
    ["--filter", "060:7FF"],
    ["--filter", "060~7FF"],
    ["--filter", "can1"],
    ["--filter", "can0,060:7FF", "--filter", "can7"],
    ["--filter", "#FFFFFFFF,7FF:7FF"],
    ["--filter", "1C0:7FF", "--message", "Gains"],
    ["--from", "0.02"],
    ["--to", "0.05"],
    ["--from", "0.01", "--to", "0.09", "--filter", "can0,000:000"],
    ["--from", "1436509052.03", "--to", "1436509052.1", "--where", "board=0"],
    ["--from", "0.08", "--to", "0.09", "--message", "Gains"],
]


@pytest.mark.slow
@pytest.mark.parametrize("options", OPTIONS, ids=" ".join)
def test_both_ways_agree(options: list[str], aces: Aces, log: Path, arm: str, tmp_path: Path) -> None:
    """What is counted, said, kept and left out does not hang on the way, nor does the status."""
    live, columns, found = both(aces, tmp_path, log, log, "-p", arm, *options)
    assert (columns.status, columns.err) == (live.status, live.err)
    wanted: dict[str, list[float]] = {}
    for item in live.objects:
        wanted.setdefault(item["message"] or "_lost", []).append(item["time"])
    assert {name: len(some) for name, some in found.items()} == {
        name: len(some) for name, some in wanted.items()
    }
    assert {name: [row["source"] for row in some] for name, some in found.items()} == {
        name: [o["source"] for o in live.objects if (o["message"] or "_lost") == name] for name in wanted
    }


def test_the_rows_are_the_records(aces: Aces, log: Path, arm: str, tmp_path: Path) -> None:
    """Values, reasons and bytes are those of the record lines."""
    live, _, found = both(aces, tmp_path, log, "-p", arm)
    for item in live.objects:
        row = found[item["message"] or "_lost"].pop(0)
        assert row["time"] == round(item["time"] * 1000) * 1_000_000
        assert (row["channel"], row["id"], row["extended"]) == (item["channel"], item["id"], item["extended"])
        if item["message"] is None:
            assert (row["reason"], row["raw"].hex()) == (item["reason"], item["raw"])
        elif item["message"] == "Encoder":
            assert [row["position.0"], row["position.1"]] == item["fields"]["position"]
        elif item["message"] == "State":
            assert row["mode"] == str(item["fields"]["mode"])
    assert not any(found.values())


@pytest.mark.parametrize(
    ("files", "options"),
    [
        (["hubo2plus.log"], ["-p", "hubo"]),
        (["hubo2plus.log"], ["-p", "hubo:D08"]),
        (["hubo2plus.log"], ["-p", "hubo", "-p", "hubo:D08"]),
        (["robotis_session.bin"], ["-p", "robotis", "--direction", "both"]),
        (["robotis_session.dxconf.txt"], ["-p", "robotis", "--direction", "from"]),
        (["robotis_session.bin"], ["-p", "robotis", "--direction", "both", "--where", "error=0"]),
        (["robotis_session.bin"], ["-p", "robotis", "--direction", "both", "--where", "meta.offset<500"]),
        (["robotis_session.bin"], ["-p", "robotis", "--direction", "both", "--where", "parameters=00"]),
        (["robotis_session.bin"], ["-p", "robotis", "--direction", "both", "--from", "1"]),
        (["adc.bin"], ["-p", "minihubo_adc"]),
        (["adc.bin", "hubo2plus.log"], ["-p", "minihubo_adc", "-p", "hubo", "--strict"]),
    ],
)
def test_examples(files: list[str], options: list[str], aces: Aces, tmp_path: Path) -> None:
    """So it is for the example captures: CAN, streams, both."""
    live, columns, found = both(aces, tmp_path, *[EXAMPLES / name for name in files], *options)
    assert (columns.status, columns.err) == (live.status, live.err)
    numbers: dict[str, int] = {}
    for item in live.objects:
        name = item["message"] or "_lost"
        numbers[name] = numbers.get(name, 0) + 1
    mine: dict[str, int] = {}
    for name, some in found.items():
        bare = name.split(".")[0] if name.split(".")[-1].isdigit() else name.split(".")[-1]
        mine[bare] = mine.get(bare, 0) + len(some)
    assert mine == numbers


@pytest.mark.parametrize(
    ("suffix", "is_folder"),
    [
        (".parquet", True),
        (".arrow", True),
        (".feather", True),
        (".npz", False),
        (".sqlite", False),
        (".mcap", False),
    ],
)
def test_suffixes_choose_the_format(
    suffix: str, is_folder: bool, aces: Aces, log: Path, arm: str, tmp_path: Path
) -> None:
    """`-o` alone says what is wanted, and the losses are counted without being written."""
    out = tmp_path / f"out{suffix}"
    result = aces("decode", log, "-p", arm, "-o", out)
    assert (result.status, result.out) == (0, "")
    assert result.summary["decoded"] == 8
    assert out.is_dir() is is_folder
    assert not is_folder or "_lost" not in {path.stem for path in out.iterdir()}


def test_csv_with_a_slash_is_a_folder(aces: Aces, log: Path, arm: str, tmp_path: Path) -> None:
    """`-o out.csv/` is columns, `-o out.csv` rows as before."""
    assert aces("decode", log, "-p", arm, "-o", f"{tmp_path}/out.csv/").status == 0
    assert "State" in {path.stem for path in (tmp_path / "out.csv").iterdir()}
    assert aces("decode", log, "-p", arm, "-o", tmp_path / "rows.csv").status == 0
    assert (tmp_path / "rows.csv").read_text().startswith("source,")


def test_a_format_may_be_named(aces: Aces, log: Path, arm: str, tmp_path: Path) -> None:
    """--format says what a name leaves open; one that promises something else is refused, and not written."""
    assert aces("decode", log, "-p", arm, "-o", tmp_path / "a", "--format", "sqlite").status == 0
    base = sqlite3.connect(tmp_path / "a")
    assert base.execute('SELECT count(*) FROM "Encoder"').fetchone() == (1,)
    base.close()
    assert aces("decode", log, "-p", arm, "-o", tmp_path / "b.log", "--format", "jsonl").status == 0
    assert json.loads((tmp_path / "b.log").read_text().splitlines()[0])["message"] == "Encoder"
    for name, form in (("c.parquet", "jsonl"), ("c.csv", "jsonl"), ("c.jsonl", "text"), ("c.npz", "parquet")):
        refused = aces("decode", log, "-p", arm, "-o", tmp_path / name, "--format", form)
        assert refused.status == 2
        assert f"the suffix says {name[2:]}, and --format {form}" in refused.err
        assert not (tmp_path / name).exists()


def test_one_message_is_a_file(aces: Aces, log: Path, arm: str, tmp_path: Path) -> None:
    """With a single --message there is no folder, also where none came."""
    out = tmp_path / "one.parquet"
    assert aces("decode", log, "-p", arm, "--message", "Encoder", "-o", out).status == 0
    assert pq.read_table(out)["position.1"].to_pylist() == [-10]
    assert aces("decode", log, "-p", arm, "--message", "Limits", "-o", out).status == 0
    assert pq.read_table(out).num_rows == 0


@pytest.mark.parametrize("jobs", ["1", "2"])
def test_a_folder_is_of_parquet(aces: Aces, log: Path, arm: str, tmp_path: Path, jobs: str) -> None:
    """`-o DIR/` is a folder of tables, as with --cluster: new or there already, also of a single message."""
    (tmp_path / "there").mkdir()
    for where in (f"{tmp_path}/new/", f"{tmp_path}/there"):
        result = aces("decode", log, "-p", arm, "-o", where, "--message", "Encoder", "--jobs", jobs)
        assert result.status == 0, result.err
        (table,) = [pq.read_table(path) for path in Path(where).rglob("*.parquet") if path.is_file()]
        assert table["position.1"].to_pylist() == [-10]


def test_signals_choose_columns(aces: Aces, log: Path, arm: str, tmp_path: Path) -> None:
    """Globs on Message.field: other columns are dropped, messages without one are filtered."""
    out = tmp_path / "out.parquet"
    result = aces("decode", log, "-p", arm, "--signals", "Encoder.position.*,State.*o*", "-o", out)
    assert result.summary["filtered"] == 5
    found = rows(out)
    transport = ["time", "channel", "id", "extended", "rx"]
    assert {name: list(some[0])[5:] for name, some in found.items()} == {
        "Encoder": ["position.0", "position.1"],
        "State": ["board", "mode", "error", "load"],
    }
    assert list(found["State"][0])[:5] == transport


def test_windows_keep_context(aces: Aces, log: Path, arm: str) -> None:
    """A reply inside the window is told by the request before it; --to is without its instant; lines know it too."""
    result = aces("decode", log, "-p", arm, "--format", "jsonl", "--from", "0.08", "--to", "0.09")
    assert [item["message"] for item in result.objects] == ["Gains"]
    assert result.summary["filtered"] == 11


def test_windows_need_times(aces: Aces, line: str, tmp_path: Path) -> None:
    """Raw bytes have no times: all is filtered, and that is said."""
    raw = tmp_path / "a.bin"
    raw.write_bytes(b"\xaa\x01\x02\x03" * 3)
    for more in (["--format", "jsonl"], ["-o", tmp_path / "a.npz"]):
        result = aces("decode", raw, "-p", line, "--from", "0", *more)
        assert "--from and --to need times: 3 items have none, and are filtered" in result.messages
        assert (result.summary["decoded"], result.summary["filtered"]) == (0, 12)


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        (["--format", "parquet"], "--output"),
        (["--format", "npz", "-o", "-"], "--output"),
        (["--format", "parkett", "-o", "x"], "parkett"),
        (["--signals", "Encoder.*"], "--signals is for tables"),
        (["--names"], "--names is for tables"),
        (["--float32", "-o", "x.jsonl"], "--float32 is for tables"),
        (["--signals", "Nobody.*", "-o", "x.parquet"], "fits no column"),
        (["--from", "soon", "-o", "x.parquet"], "not a time"),
        (["--from", "-1", "-o", "x.parquet"], ""),
        (["--from", "5", "--to", "4"], "not later"),
        (["--message", "Nobody", "-o", "x.parquet"], "Nobody"),
        (["--where", "nothing=1", "-o", "x.parquet"], "nothing"),
        (["--jobs", "2x", "-o", "x.parquet"], ""),
    ],
)
def test_wrong_calls(
    options: list[str],
    complaint: str,
    aces: Aces,
    log: Path,
    arm: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A wrong call is one line and status 2, and nothing is written."""
    monkeypatch.chdir(tmp_path)
    before = set(tmp_path.iterdir())
    result = aces("decode", log, "-p", arm, *options)
    assert result.status == 2
    assert complaint in result.err
    assert result.err.count("\n") == 1
    assert set(tmp_path.iterdir()) - before <= {tmp_path / "x.jsonl"}


def test_the_output_is_none_of_the_files(aces: Aces, log: Path, arm: str) -> None:
    """A recording is never overwritten by what is in it."""
    result = aces("decode", log, "-p", arm, "-o", log, "--format", "sqlite")
    assert result.status == 2
    assert log.read_text() == LOG


def test_a_file_that_cannot_be_read(aces: Aces, log: Path, arm: str, tmp_path: Path) -> None:
    """The others are decoded and written, the status is 2; where none can be read, an earlier output still stands."""
    out = tmp_path / "out.parquet"
    result = aces("decode", tmp_path / "absent.log", log, "-p", arm, "-o", out)
    assert result.status == 2
    assert result.summary["decoded"] == 8
    before = sorted(out.iterdir())
    assert aces("decode", tmp_path / "absent.log", "-p", arm, "-o", out).status == 2
    assert sorted(out.iterdir()) == before
    assert {path.name for path in tmp_path.iterdir()} == {"walk.log", "out.parquet"}


def test_what_was_read_before_an_error_is_written(
    aces: Aces, arm: str, log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A recording that breaks off: one line, status 2, and all that came before is counted and in the tables."""
    from aces_bus.recordings.base import CanRecording

    whole = CanRecording.tables

    def broken(self: CanRecording) -> Any:
        yield from whole(self)
        raise CaptureError(f"{self.name}: reading stopped: the disk is gone")

    monkeypatch.setattr(CanRecording, "tables", broken)
    out = tmp_path / "out.parquet"
    result = aces("decode", log, "-p", arm, "-o", out)
    assert result.status == 2
    assert "reading stopped" in result.err
    assert result.summary["decoded"] == 8
    assert sum(len(some) for some in rows(out).values()) == 8


@pytest.mark.slow
def test_numbers_are_written_without_pandas(tmp_path: Path) -> None:
    """It is installed for others, and takes longer to load than a small recording to decode."""
    program = (
        "import sys; from aces_tools.main import main; "
        f"status = main(['decode', {str(EXAMPLES / 'hubo2plus.log')!r}, '-p', 'hubo', '-o', 'walk.parquet', '-q']); "
        "sys.exit('pandas is loaded' if 'pandas' in sys.modules else status)"
    )
    subprocess.run([sys.executable, "-c", program], check=True, cwd=tmp_path)
    assert pq.read_table(tmp_path / "walk.parquet" / "Encoder.parquet").num_rows


@pytest.mark.slow
def test_standard_input(arm: str, tmp_path: Path) -> None:
    """A pipe is decoded into tables as well; Ctrl-C is its usual end, and what came is written."""
    if os.name != "posix":
        pytest.skip("pipes and signals of a Unix shell")
    running = subprocess.Popen(
        [sys.executable, "-m", "aces_tools", "decode", "-p", arm, "-o", str(tmp_path / "o.npz"), "-"],
        stdin=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    assert running.stdin is not None
    assert running.stderr is not None
    running.stdin.write(b"rubbish\n" + LOG.encode())
    running.stdin.flush()
    assert b"rubbish" in running.stderr.readline()  # it has read what came
    running.send_signal(signal.SIGINT)
    # A signal between Python's last look and the system call interrupts no read: then the pipe's end does.
    later = threading.Timer(20, running.stdin.close)
    later.start()
    said = running.stderr.read().decode()
    later.cancel()
    running.stdin.close()
    assert running.wait(60) == 0
    running.stderr.close()
    assert said.splitlines()[-1].startswith("frames=12 decoded=8 ")
    assert {path.name for path in tmp_path.iterdir()} >= {"o.npz"}


@pytest.mark.parametrize("end", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("is_second", [False, True])
def test_an_interrupted_file_is_not_written(
    aces: Aces,
    arm: str,
    log: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    is_second: bool,
    end: signal.Signals,
) -> None:
    """Ctrl-C or SIGTERM on a file, also twice: status 130, the summary of what was read, and what was there before."""
    from aces_bus.recordings.base import CanRecording

    out = tmp_path / "out.npz"
    out.write_bytes(b"before")
    whole = CanRecording.tables

    def interrupted(self: CanRecording) -> Any:
        yield from whole(self)
        os.kill(os.getpid(), end)
        time.sleep(0)
        if is_second:
            raise KeyboardInterrupt

    monkeypatch.setattr(CanRecording, "tables", interrupted)
    result = aces("decode", log, "-p", arm, "-o", out)
    assert result.status == 130
    assert f"interrupted: {out} is not written" in result.messages
    assert result.summary["decoded"] == 8
    assert out.read_bytes() == b"before"
    assert len(list(tmp_path.iterdir())) == 2


def test_a_bar_is_shown_on_a_terminal(
    aces: Aces, arm: str, log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Large files on a terminal show how far and how fast; the summary is still the last line."""
    import io

    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    monkeypatch.setattr(console, "LARGE", 0)
    monkeypatch.setenv("TERM", "xterm")
    stderr = Terminal()
    monkeypatch.setattr(sys, "stderr", stderr)
    aces("decode", log, "-p", arm, "-o", tmp_path / "out.npz")
    shown = stderr.getvalue()
    assert "frames/s" in shown
    assert shown.splitlines()[-1].endswith(
        "frames=12 decoded=8 unknown=2 malformed=1 filtered=0 errors=1 lines_unreadable=1"
    )


def test_two_protocols_that_claim_one_frame(aces: Aces, tmp_path: Path) -> None:
    """It is warned once, of the first such frame, as with record lines."""
    spec = tmp_path / "two.py"
    spec.write_text(
        "from construct import Byte, Struct\nfrom aces_bus.protocol import Protocol\n"
        "one = Protocol('one', link='can')\none.message('A', id=2, payload=Struct('x' / Byte))\n"
        "one.message('B', id=1, payload=Struct('x' / Byte))\n"
        "two = Protocol('two', link='can')\ntwo.message('A', id=2, payload=Struct('y' / Byte))\n"
        "two.message('C', id=1, payload=Struct('y' / Byte))\n"
    )
    log = tmp_path / "a.log"
    log.write_text("(1.0) can0 002#01\n(1.1) can0 001#01\n" * 3)
    live, columns, found = both(aces, tmp_path, log, "-p", f"{spec}:one", "-p", f"{spec}:two")
    assert columns.err == live.err
    assert len([one for one in columns.messages if "both claim identifier 0x002" in one]) == 1
    assert set(found) == {"one.A", "B"}
