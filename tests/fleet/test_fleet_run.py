"""A fleet's dataset, decoded by this process: what it holds, what a second run does, what a death in the middle leaves."""

from __future__ import annotations

import gzip
import os
import re
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest

from aces_bus import Frame, FrameTable
from aces_bus.errors import CallerError, UnknownNameError
from aces_bus.recordings import open as parts
from aces_bus.recordings.write import open_writer
from aces_lab import fleet
from aces_lab.fleet import cluster as clusters
from aces_lab.fleet import run as runs
from aces_lab.fleet import stores, work
from aces_lab.fleet.manifest import FleetDataset
from aces_lab.fleet.recipe import FleetProtocol, Recipe
from aces_lab.fleet.stores import Place, StoreError
from tests.fleet.recordings import (
    LATE_S,
    dataset_rows,
    needs_fleet,
    record,
    rows_of_one_process,
    truck,
)

needs_fleet()


@pytest.fixture
def drives(tmp_path: Path) -> list[Path]:
    """A recording in each of five formats."""
    folder = tmp_path / "drives"
    folder.mkdir()
    return [record(folder, number) for number in range(5)]


@pytest.fixture
def dbc(tmp_path: Path) -> str:
    """The truck's database."""
    return truck(tmp_path)


def test_a_dataset_has_the_values_of_one_process(drives: list[Path], dbc: str, tmp_path: Path) -> None:
    """Of five formats, bit for bit, in folders by message and day; the bins add up over the inputs."""
    run = fleet.decode(str(tmp_path / "drives" / "*"), dbc, str(tmp_path / "lake"))
    lake = tmp_path / "lake"
    one = rows_of_one_process(drives, dbc, tmp_path)
    assert dataset_rows(lake) == one
    assert {len(rows) for rows in one.values()} == {len(one["Speed"]), len(one["Brake"])}
    assert [folder.name for folder in sorted((lake / "Speed").iterdir())] == [
        "utc_day=2026-11-22",
        "utc_day=2026-11-23",
    ]
    assert run.stood == 0
    assert [one.state for one in run.inputs] == ["done"] * 5
    total = run.total["can"]
    assert total["total"] == 300 == total["decoded"] + total["unknown"]
    assert total["records"] == len(one["Speed"]) + len(one["Brake"])
    for entry in run.inputs:
        assert entry.size == os.path.getsize(entry.uri)
        assert entry.duration_s is not None
        assert 0.8 < entry.duration_s < 1.2
        assert len(entry.hash) == 40
        assert all((lake / name).is_file() for name in entry.outputs)


def test_other_programs_open_it(drives: list[Path], dbc: str, tmp_path: Path) -> None:
    """polars and DuckDB read the folder of a message as one table, by day; the manifest is a table, too."""
    polars = pytest.importorskip("polars")
    duckdb = pytest.importorskip("duckdb")
    lake = tmp_path / "lake"
    fleet.decode([str(path) for path in drives], dbc, str(lake), names=True)
    rows = dataset_rows(lake)["Speed"]
    days = {str(row["time"])[:10] for row in rows}
    assert len(days) == 2
    frame = polars.read_parquet(lake / "Speed" / "**" / "*.parquet", hive_partitioning=True)
    assert sorted(frame["speed"].to_list()) == sorted(row["speed"] for row in rows)
    assert {str(day) for day in frame["utc_day"].unique()} == days
    question = f"select count(*), count(distinct utc_day) from '{lake}/Speed/**/*.parquet' where speed >= 0"
    assert duckdb.sql(question).fetchall() == [(len(rows), 2)]
    question = f"select sum(size) from '{lake}/_fleet/manifest.parquet' where state = 'done'"
    assert duckdb.sql(question).fetchall() == [(sum(map(os.path.getsize, drives)),)]


def test_a_second_run_does_what_is_missing_or_changed(drives: list[Path], dbc: str, tmp_path: Path) -> None:
    """Nothing of what stands; a new input and a changed one alone; a touched one is only read; another recipe is all."""
    lake = tmp_path / "lake"

    def again(**options: Any) -> tuple[int, list[str]]:
        run = fleet.decode(str(tmp_path / "drives" / "*"), dbc, str(lake), **options)
        return run.stood, sorted(Path(one.uri).name for one in run.inputs)

    assert again()[0] == 0
    before = {
        path: path.stat().st_mtime_ns for path in lake.rglob("*/*.parquet") if "_fleet" not in str(path)
    }
    assert again() == (5, [])
    record(tmp_path / "drives", 7)
    changed = record(tmp_path / "drives", 3, count=50)
    os.utime(drives[0], (1, 1))
    assert again() == (3, ["drive-000.log", "drive-003.mf4", "drive-007.asc"])
    stood = [path for path in before if path.exists()]
    assert all(path.stat().st_mtime_ns == before[path] for path in stood)
    assert 0 < len(before) - len(stood) <= 4  # the parts of what has changed
    inputs = [*drives[:3], changed, drives[4], tmp_path / "drives" / "drive-007.asc"]
    assert dataset_rows(lake) == rows_of_one_process(inputs, dbc, tmp_path)
    assert again(message="speed") == (0, [path.name for path in sorted(inputs)])
    assert set(dataset_rows(lake)) == {"Speed"}
    total = fleet.status(str(lake)).total["can"]
    assert total["filtered"] > 0
    assert total["total"] == 350 == total["decoded"] + total["unknown"] + total["filtered"]


def test_a_bad_input_is_a_line_of_the_manifest(drives: list[Path], dbc: str, tmp_path: Path) -> None:
    """What is not a recording, damaged or not there is named; the others are decoded; what could be read stands."""
    (tmp_path / "drives" / "letter.txt").write_text("dear all\n")
    packed = gzip.compress(record(tmp_path, 9, 4000, ".log").read_bytes())
    cut = tmp_path / "drives" / "cut.log.gz"
    cut.write_bytes(packed[: len(packed) // 2])
    lake = tmp_path / "lake"
    inputs = [str(tmp_path / "drives" / "*"), str(tmp_path / "nowhere.log")]
    run = fleet.decode(inputs, dbc, str(lake))
    faults = {Path(one.uri).name: (one.state, one.faults[0]) for one in run.failed}
    assert sorted(faults) == ["cut.log.gz", "letter.txt", "nowhere.log"]
    assert faults["letter.txt"][0] == "unreadable"
    assert "not a CAN capture" in faults["letter.txt"][1]
    assert faults["nowhere.log"] == ("missing", f"{tmp_path}/nowhere.log: no such file")
    assert faults["cut.log.gz"][0] == "done"
    assert "ends too early" in faults["cut.log.gz"][1]
    assert dataset_rows(lake) == rows_of_one_process([*drives, cut], dbc, tmp_path)
    again = fleet.decode(inputs, dbc, str(lake))
    assert (again.stood, [Path(one.uri).name for one in again.inputs]) == (7, ["nowhere.log"])
    found = fleet.status(str(lake))
    assert found.states == {"done": 6, "unreadable": 1}
    assert sorted(Path(one.uri).name for one in found.faulty) == ["cut.log.gz", "letter.txt"]


class Killed(BaseException):
    """The process is gone: nothing that it meant to do afterwards happens."""


@pytest.mark.slow
def test_a_death_at_any_moment_loses_and_doubles_nothing(
    drives: list[Path], dbc: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Cut off at each access to the store, with changed contents behind it: the next run makes the dataset whole."""
    lake, inputs = tmp_path / "lake", drives[:2]
    fleet.decode([str(path) for path in inputs], dbc, str(lake))
    record(tmp_path / "drives", 1, count=40)
    wanted = rows_of_one_process(inputs, dbc, tmp_path)
    assert dataset_rows(lake) != wanted
    shutil.copytree(lake, tmp_path / "old")
    deaths = 0
    while True:
        left = deaths
        with monkeypatch.context() as patch:
            for name in ("put", "write", "remove"):
                whole = getattr(Place, name)

                def dying(self: Place, *given: Any, whole: Callable[..., Any] = whole) -> Any:
                    nonlocal left
                    left -= 1
                    if left < 0:
                        raise Killed
                    return whole(self, *given)

                patch.setattr(Place, name, dying)
            try:
                fleet.decode([str(path) for path in inputs], dbc, str(lake))
            except Killed:
                deaths += 1
            else:
                break
        fleet.decode([str(path) for path in inputs], dbc, str(lake))
        assert dataset_rows(lake) == wanted, f"death before access {left}"
        assert fleet.status(str(lake)).cut_off == []
        assert not list((lake / "_fleet" / "journal").iterdir())
        shutil.rmtree(lake)
        shutil.copytree(tmp_path / "old", lake)
    assert deaths >= 8


HANGING = """
from construct import Int8ub, Int16ub, Struct
from aces_bus.protocol import Protocol

rig = Protocol("rig", link="can")
ask = rig.message("Ask", id=0x10, payload=Struct("register" / Int8ub))
rig.message("Answer", id=0x11, payload=Struct("value" / Int16ub), reply_to=ask)
rig.message("Beat", id=0x12, payload=Struct("count" / Int8ub))
"""


class Wide(clusters.Here):
    """This process, that says it were four."""

    width = 4
    capacity = 4


@pytest.fixture
def wide(monkeypatch: pytest.MonkeyPatch) -> None:
    """Four workers in this process; what is large is small."""
    monkeypatch.setattr(runs, "open_workers", lambda _: Wide())
    monkeypatch.setattr(runs, "SPLIT", 5_000)
    monkeypatch.setattr(parts, "LEAST", 1_000)
    monkeypatch.setattr(runs, "LEAST", 1_000)
    monkeypatch.setattr(work, "RUN", 170)


def rig_frames() -> Iterator[Frame]:
    """Requests, and replies that hang on them; something in between, and something that nobody knows."""
    for place in range(3000):
        identifier, data = (
            (0x10, bytes([place // 7 % 3])),
            (0x12, bytes([place % 256])),
            (0x13 if place % 100 == 2 else 0x12, b"\0"),
            (0x11, place.to_bytes(2, "big")),
        )[place % 4]
        yield Frame(identifier, data, LATE_S + place / 100, str(place // 8 % 2), is_rx=True)


def long_log(folder: Path, form: str) -> Path:
    """The rig's frames in a recording; of a log a line is nonsense."""
    log = folder / f"long{form.removesuffix('.gz')}"
    with open_writer(log) as writer:
        writer.write(FrameTable.from_frames(list(rig_frames())))
    if log.suffix == ".log":
        lines = log.read_text().splitlines(keepends=True)
        lines.insert(1234, "nonsense\n")
        log.write_text("".join(lines))
    if form.endswith(".gz"):
        packed = folder / f"{log.name}.gz"
        packed.write_bytes(gzip.compress(log.read_bytes()))
        return packed
    return log


@pytest.mark.slow
@pytest.mark.parametrize("form", [".log", ".log.gz", ".blf", ".mf4", ".pcapng"])
def test_a_large_input_is_split(form: str, tmp_path: Path, wide: None) -> None:
    """Of every format the rows of one process, also replies whose request is in another piece; counts and lines add up."""
    spec = tmp_path / "rig.py"
    spec.write_text(HANGING)
    log = long_log(tmp_path, form)
    one = rows_of_one_process([log], str(spec), tmp_path)
    assert len(one["Answer"]) == 750
    [entry] = fleet.decode(str(log), str(spec), str(tmp_path / "lake")).inputs
    assert dataset_rows(tmp_path / "lake") == one
    assert len(set(re.findall(r"-p[0-9]+", " ".join(entry.outputs)))) >= 4
    assert entry.counts == {"total": 3000, "decoded": 2970, "unknown": 30, "records": 2970}
    nonsense = [f"{log}:1235: not a line of candump: 'nonsense'"] if ".log" in form else []
    assert (entry.faults, entry.lines_unreadable) == (nonsense, len(nonsense))
    assert entry.rows == {"Ask": 750, "Beat": 1470, "Answer": 750}
    assert not list((tmp_path / "lake" / "_fleet" / "journal").iterdir())
    assert fleet.decode(str(log), str(spec), str(tmp_path / "lake")).stood == 1


def test_a_damaged_input_is_split(tmp_path: Path, wide: None) -> None:
    """What can be read of it stands once, and the fault is said once."""
    spec = tmp_path / "rig.py"
    spec.write_text(HANGING)
    log = long_log(tmp_path, ".log.gz")
    log.write_bytes(log.read_bytes()[:-4000])
    [entry] = fleet.decode(str(log), str(spec), str(tmp_path / "lake")).inputs
    assert dataset_rows(tmp_path / "lake") == rows_of_one_process([log], str(spec), tmp_path)
    assert [fault for fault in entry.faults if "nonsense" not in fault] == [entry.faults[0]]
    assert "ends too early" in entry.faults[0]
    assert 0 < entry.counts["total"] < 3000


@pytest.mark.slow
@pytest.mark.parametrize(
    ("form", "options"),
    [
        (".blf", {"where": ["value>1000 or count=3 or register=1", "meta.channel!=9"]}),
        (".log", {"filter": ["010:7FE"]}),
        (".log", {"start": "3.5", "stop": "1795392014.5"}),
        (".mf4", {"start": "2026-11-23T00:00:02+00:00", "filter": ["011:7FF"], "where": ["value<2000"]}),
    ],
)
def test_rows_are_chosen_as_in_one_process(
    form: str, options: dict[str, Any], tmp_path: Path, wide: None, capfd: pytest.CaptureFixture[str]
) -> None:
    """By conditions, filters and time, in one piece and in several; what is left out is counted as there."""
    spec = tmp_path / "rig.py"
    spec.write_text(HANGING)
    log = long_log(tmp_path, form)
    flags = {"start": "--from", "stop": "--to", "where": "--where", "filter": "--filter"}
    given = [
        text
        for name, some in options.items()
        for one in ([some] if isinstance(some, str) else some)
        for text in (flags[name], one)
    ]
    one = rows_of_one_process([log], str(spec), tmp_path, *given)
    line = capfd.readouterr().err.splitlines()[-1]
    assert 0 < sum(map(len, one.values())) < 2970
    split = fleet.decode(str(log), str(spec), str(tmp_path / "split"), **options)
    assert len(split.inputs[0].outputs) > 3
    assert dataset_rows(tmp_path / "split") == one
    assert split.total["can"].line("can") == line
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(runs, "open_workers", lambda _: clusters.Here())
        whole = fleet.decode(str(log), str(spec), str(tmp_path / "whole"), **options)
    assert dataset_rows(tmp_path / "whole") == one
    assert whole.total["can"].line("can") == line


def test_a_changed_filter_is_another_run(drives: list[Path], dbc: str, tmp_path: Path) -> None:
    """The same one stands; instants are the same however they are written."""
    lake, inputs = str(tmp_path / "lake"), [str(path) for path in drives]
    midnight = "2026-11-23T00:00:00"
    assert fleet.decode(inputs, dbc, lake, where="speed>100", start=f"{midnight}+00:00").stood == 0
    assert fleet.decode(inputs, dbc, lake, where="speed>100", start="1795392000").stood == 5
    assert {str(row["time"])[:10] for row in dataset_rows(tmp_path / "lake")["Speed"]} == {"2026-11-23"}
    assert fleet.decode(inputs, dbc, lake, where="speed>101", start="1795392000").stood == 0
    assert fleet.decode(inputs, dbc, lake).stood == 0
    assert dataset_rows(tmp_path / "lake") == rows_of_one_process(drives, dbc, tmp_path)


def test_frames_without_a_time_are_noted(dbc: str, tmp_path: Path) -> None:
    """Where a time is asked for they are left out, counted and said."""
    log = tmp_path / "timeless.trc"
    log.write_text("(1795392000.5) can0 064#0102030405060708\n  can0  064   [8]  01 02 03 04 05 06 07 08\n")
    [entry] = fleet.decode(str(log), dbc, str(tmp_path / "lake"), stop="1").inputs
    assert entry.counts == {"total": 2, "decoded": 1, "records": 1, "filtered": 1}
    assert entry.notes == ["--from and --to need times: 1 items have none, and are filtered"]


def test_a_recording_without_dates_has_durations(dbc: str, tmp_path: Path) -> None:
    """Times that do not count from 1970 are in a dataset of their own, without days."""
    log = tmp_path / "bench.log"
    log.write_text("(1.5) can0 064#0102030405060708\n")
    fleet.decode(str(log), dbc, str(tmp_path / "lake"))
    [row] = dataset_rows(tmp_path / "lake")["Speed.relative"]
    assert row["time"].total_seconds() == 1.5


def test_what_a_fleet_refuses(drives: list[Path], dbc: str, tmp_path: Path) -> None:
    """Before anything is read: other folders, names that do not exist, clusters that are none."""
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "letter.txt").write_text("dear")
    log, lake = str(drives[0]), str(tmp_path / "lake")
    with pytest.raises(CallerError, match=r"holds other files \(letter.txt\)"):
        fleet.decode(log, dbc, str(tmp_path / "mine"))
    with pytest.raises(UnknownNameError, match="Spead"):
        fleet.decode(log, dbc, lake, message="Spead")
    with pytest.raises(UnknownNameError, match="spead"):
        fleet.decode(log, dbc, lake, where="spead>3")
    with pytest.raises(CallerError, match="has no mask"):
        fleet.decode(log, dbc, lake, filter="123")
    with pytest.raises(CallerError, match="--filter is for CAN frames"):
        fleet.decode(log, "robotis", lake, filter="123:7FF")
    with pytest.raises(CallerError, match="--to 14:05:00: a time of day is one of this machine's zone"):
        fleet.decode(log, dbc, lake, stop="14:05")
    with pytest.raises(CallerError, match="is not a cluster; write here, local:4"):
        fleet.decode(log, dbc, lake, cluster="locl:4")
    with pytest.raises(CallerError, match="no dataset of a fleet"):
        fleet.status(str(tmp_path / "nothing"))
    with pytest.raises(CallerError, match="Protocol not known"):
        fleet.decode("gopher://old/drive.log", dbc, lake)


def test_a_recipe_is_used_as_it_was_sent(drives: list[Path], dbc: str, tmp_path: Path) -> None:
    """One that somebody changed in the dataset decodes nothing."""
    lake = tmp_path / "lake"
    fleet.decode(str(drives[0]), dbc, str(lake))
    [recipe] = (lake / "_fleet" / "recipes").iterdir()
    data = Recipe.of([FleetProtocol.of(dbc)]).encoded()
    assert recipe.read_bytes() == data
    assert Recipe.decoded(data, recipe.stem).protocols[0].files["truck.dbc"]
    with pytest.raises(CallerError, match="was changed: it is not used"):
        Recipe.decoded(data.replace(b"hide", b"show") + b" ", recipe.stem)
    FleetDataset(str(lake)).check()


@pytest.mark.parametrize(
    "name", ["../victim.txt", "/victim.txt", "Speed/../../victim.txt", "victim.txt", "OTHER"]
)
@pytest.mark.parametrize("where", ["manifest", "placing", "done"])
def test_a_stranger_s_dataset_removes_no_file(where: str, name: str, dbc: str, tmp_path: Path) -> None:
    """A manifest or journal that names a file outside the dataset, or another input's part, is refused; all files stay."""
    folder, lake, victim = tmp_path / "drives", tmp_path / "lake", tmp_path / "victim.txt"
    folder.mkdir()
    first, second = record(folder, 0), record(folder, 1)
    run = fleet.decode([str(first), str(second)], dbc, str(lake))
    victim.write_text("mine")
    if name == "OTHER":
        victim = lake / run.inputs[1].outputs[0]
        name = run.inputs[1].outputs[0]
    elif name.startswith("/"):
        name = str(victim)
    entry = msgspec.structs.replace(run.inputs[0], outputs=[*run.inputs[0].outputs, name], hash="")
    dataset = FleetDataset(str(lake))
    if where == "manifest":
        dataset.write_manifest({entry.uri: entry})
    else:
        dataset.note(msgspec.structs.replace(entry, state=where))
    record(folder, 0, count=50)
    for look in (lambda: fleet.decode(str(folder / "*"), dbc, str(lake)), lambda: fleet.status(str(lake))):
        with pytest.raises(CallerError, match=r"no run can have placed; nothing was removed"):
            look()
    assert victim.exists()


@pytest.mark.parametrize("link", ["Speed", "_fleet", "_fleet/work"])
def test_links_that_lead_out_of_a_dataset_are_refused(link: str, dbc: str, tmp_path: Path) -> None:
    """Nothing is removed, and no folder swept, behind a link in the dataset that leads elsewhere."""
    folder, lake, elsewhere = tmp_path / "drives", tmp_path / "lake", tmp_path / "elsewhere"
    folder.mkdir()
    path = record(folder, 0)
    fleet.decode(str(path), dbc, str(lake))
    if (lake / link).exists():
        (lake / link).rename(elsewhere)
    else:
        elsewhere.mkdir()
    (elsewhere / "work").mkdir(exist_ok=True)
    (elsewhere / "work" / "mine.txt").write_text("mine")
    (lake / link).symlink_to(elsewhere)
    before = sorted(path.name for path in elsewhere.rglob("*") if path.is_file())
    record(folder, 0, count=50)
    try:
        run = fleet.decode(str(path), dbc, str(lake))
    except CallerError as error:
        faults = [str(error)]
    else:
        faults = run.failed[0].faults
    assert "a link leads out of the dataset" in faults[0]
    assert set(before) <= {path.name for path in elsewhere.rglob("*")}


def test_a_store_that_fails_and_is_slow(
    drives: list[Path], dbc: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What fails for a moment is tried again and gives the same; what fails for good is an input that is missing."""
    monkeypatch.setattr(stores, "WAITS_S", (0.0, 0.0))
    monkeypatch.setattr("aces_lab.fleet.work.AGAIN_S", 0.0)
    fsspec = stores.load_fsspec()
    memory = fsspec.filesystem("memory")
    for path in drives[:3]:
        memory.pipe_file(f"/{tmp_path.name}/{path.name}", path.read_bytes())
    lake, asked, broken = f"memory://{tmp_path.name}-lake", 0, ""
    opened = type(memory)._open

    def failing(self: Any, path: str, *given: Any, **options: Any) -> Any:
        nonlocal asked
        asked += 1
        if asked % 3 == 1 or (broken and path.endswith(broken)):
            raise TimeoutError("the store is busy")
        return opened(self, path, *given, **options)

    monkeypatch.setattr(type(memory), "_open", failing)
    broken = drives[1].name
    run = fleet.decode(f"memory://{tmp_path.name}/*", dbc, lake)
    assert [(one.state, one.faults) for one in run.failed] == [
        ("missing", [f"memory://{tmp_path.name}/{broken}: the store is busy"])
    ]
    broken = ""
    again = fleet.decode(f"memory://{tmp_path.name}/*", dbc, lake)
    assert (again.stood, len(again.inputs), again.failed) == (2, 1, [])
    monkeypatch.undo()
    memory.get(f"/{tmp_path.name}-lake", str(tmp_path / "lake"), recursive=True)
    one = rows_of_one_process(drives[:3], dbc, tmp_path)
    for rows in one.values():
        for row in rows:
            row["source"] = f"memory://{tmp_path.name}/{Path(row['source']).name}"
    assert dataset_rows(tmp_path / "lake") == one
    memory.rm(f"/{tmp_path.name}-lake", recursive=True)


def test_who_may_reach_a_scheduler_is_said() -> None:
    """Of what is neither TLS nor this machine's own."""
    assert clusters.exposure("local:4") is None
    assert clusters.exposure("tls://scheduler:8786") is None
    assert clusters.exposure("tcp://127.0.0.1:8786") is None
    assert clusters.exposure("tcp://[::1]:8786") is None
    for address in ("tcp://scheduler:8786", "tcp://10.0.0.7:8786", "ucx://node:8786"):
        said = clusters.exposure(address)
        assert said is not None
        assert said.startswith(f"{address} is not tls://")


def test_names_of_files(tmp_path: Path) -> None:
    """A name with brackets is a file where there is one; a folder is refused with a pattern that would do."""
    odd = tmp_path / "walk[1].log"
    odd.write_text("(1.5) can0 064#01\n")
    assert [one.uri for one in Place(str(odd)).files()] == [str(odd)]
    with pytest.raises(StoreError, match=r"is a folder; name its files"):
        list(Place(str(tmp_path)).files())


def test_a_worker_that_is_ending_takes_away_its_own_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What vanishes while the work of killed workers is swept away is not missed; the rest goes, too."""
    dataset = FleetDataset(str(tmp_path / "lake"))
    work = tmp_path / "lake" / "_fleet" / "work"
    for name in ("parts-a", "parts-b"):
        (work / name).mkdir(parents=True)
    remove = dataset.place.fs.rm

    def rm(path: str, recursive: bool = False) -> None:
        if (work / "parts-a").exists():
            (work / "parts-a").rmdir()
            raise FileNotFoundError("parts-a")
        remove(path, recursive=recursive)

    monkeypatch.setattr(dataset.place.fs, "rm", rm)
    dataset.sweep()
    assert not work.exists()
