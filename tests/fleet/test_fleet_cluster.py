"""Workers of Dask that die: by a signal, by running out of memory. The dataset is that of one process.

`make fleet` runs this over 200 recordings, and measures.
"""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

from aces_lab import fleet
from aces_lab.fleet.cluster import DaskWorkers
from aces_tools.main import main
from tests.fleet.recordings import dataset_rows, needs_fleet, record, rows_of_one_process, truck

needs_fleet()
if find_spec("distributed") is None or find_spec("psutil") is None:
    pytest.skip("needs Dask: pip install 'aces-bus[fleet]'", allow_module_level=True)

pytestmark = [
    pytest.mark.slow,
    # Workers that die are what this is about: what Dask leaves open then is its own.
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
]
INPUTS = int(os.environ.get("ACES_FLEET_INPUTS", "15"))
#: Of a worker in the test of memory.
LIMIT = 600 << 20


def hog(flag: str) -> None:
    """Take memory until the process is killed for it; once, then it was enough."""
    if os.path.exists(flag):
        return
    Path(flag).touch()
    taken = []
    while True:
        taken.append(bytearray(os.urandom(1 << 20)) * 32)


@pytest.fixture(scope="module")
def client() -> Iterator[Any]:
    """Two workers, which are begun anew when they die."""
    distributed = pytest.importorskip("distributed")

    with (
        distributed.LocalCluster(
            n_workers=2,
            threads_per_worker=1,
            memory_limit=LIMIT,
            host="127.0.0.1",
            dashboard_address="127.0.0.1:0",
            silence_logs=50,
        ) as cluster,
        distributed.Client(cluster, set_as_default=False) as client,
    ):
        yield client


@pytest.mark.slow
def test_dead_workers_lose_and_double_nothing(client: Any, tmp_path: Path) -> None:
    """One is killed with -9, another by its nanny for memory; then one input changes: that one is done again."""
    folder = tmp_path / "drives"
    folder.mkdir()
    inputs = [record(folder, number, 60 + number % 50) for number in range(INPUTS)]
    dbc, lake = truck(tmp_path), tmp_path / "lake"
    workers = [info["pid"] for info in _infos(client)]
    hogs: list[Any] = []

    def harm(progress: fleet.FleetProgress) -> None:
        if progress.done == max(1, INPUTS // 4):
            os.kill(workers[0], signal.SIGKILL)
        if progress.done == INPUTS // 2:
            hogs.append(client.submit(hog, str(tmp_path / "flag"), pure=False, priority=10))

    run = fleet.decode(str(folder / "*"), dbc, str(lake), cluster=client, progress=harm)
    for future in hogs:
        future.result(timeout=120)  # its second attempt: the first was killed
    assert [one for one in run.inputs if one.state != "done"] == []
    assert len(run.inputs) == INPUTS
    assert {info["pid"] for info in _infos(client)}.isdisjoint(workers[:1])
    one = rows_of_one_process(inputs, dbc, tmp_path)
    assert dataset_rows(lake) == one
    total = fleet.status(str(lake)).total["can"]
    assert total["total"] == sum(60 + number % 50 for number in range(INPUTS))
    assert total["total"] == total["decoded"] + total["unknown"]
    changed = record(folder, 7, 33)
    again = fleet.decode(str(folder / "*"), dbc, str(lake), cluster=client)
    assert (again.stood, [entry.uri for entry in again.inputs]) == (INPUTS - 1, [str(changed)])
    (tmp_path / "again").mkdir()
    assert dataset_rows(lake) == rows_of_one_process(inputs, dbc, tmp_path / "again")


def _infos(client: Any) -> list[dict[str, Any]]:
    """The workers' processes."""
    found: list[dict[str, Any]] = list(client.run(lambda: {"pid": os.getpid()}).values())
    return found


@pytest.mark.slow
def test_an_input_that_kills_its_workers_is_named(
    client: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The others are decoded; of it the manifest says why not, and the next run tries it again."""
    folder = tmp_path / "drives"
    folder.mkdir()
    for number in range(3):
        record(folder, number)
    bad = record(folder, 4)
    monkeypatch.setattr("aces_lab.fleet.run.decode_input", dying_input)
    # Dask's default is three more workers for each: minutes of starting programs.
    monkeypatch.setattr(client.cluster.scheduler, "allowed_failures", 0)
    run = fleet.decode(str(folder / "*"), truck(tmp_path), str(tmp_path / "lake"), cluster=client)
    assert [(one.uri, one.state, one.faults) for one in run.failed] == [
        (str(bad), "missing", [f"{bad}: its workers died: too little memory?"])
    ]
    monkeypatch.undo()
    again = fleet.decode(str(folder / "*"), truck(tmp_path), str(tmp_path / "lake"), cluster=client)
    assert (again.stood, [one.state for one in again.inputs]) == (3, ["done"])


def dying_input(data: bytes) -> bytes:
    """As the work on an input that is too large for any worker."""
    if b"drive-004" in data:
        os.kill(os.getpid(), signal.SIGKILL)
    from aces_lab.fleet.work import decode_input

    return decode_input(data)


@pytest.mark.slow
def test_what_is_started_here_listens_on_loopback_alone() -> None:
    """Scheduler, workers, nannies and their pages; and the scheduler takes no client without the cluster's key."""
    distributed = pytest.importorskip("distributed")
    psutil = pytest.importorskip("psutil")

    workers = DaskWorkers(processes=1)
    try:
        me = psutil.Process()
        listening = [
            connection.laddr
            for process in [me, *me.children(recursive=True)]
            for connection in process.net_connections("inet")
            if connection.status == psutil.CONN_LISTEN
        ]
        assert len(listening) >= 4
        assert {address.ip for address in listening} == {"127.0.0.1"}
        address = workers.client.scheduler.address
        assert address.startswith("tls://127.0.0.1:")
        with pytest.raises((OSError, TypeError)):
            distributed.Client(address.replace("tls", "tcp"), timeout=3, set_as_default=False)
    finally:
        workers.close()


def _as_the_page_says(folder: Path) -> dict[str, str]:
    """Certificates made, and variables set, as docs/fleets.md says: DASK_… by name."""
    openssl = shutil.which("openssl")
    if openssl is None:
        pytest.skip("needs openssl")
    page = (Path(__file__).parents[2] / "docs" / "fleets.md").read_text()
    [call] = re.findall(r"\$ openssl (.*)", page)
    subprocess.run([openssl, *call.split()], cwd=folder, check=True, capture_output=True)
    [several] = re.findall(r"for who in (.*); do", page)
    found: dict[str, str] = {}
    for name, value in re.findall(r"(DASK_[\w${}]+)=(\S+)", page):
        for who in several.split() if "${who}" in name else [""]:
            found[name.replace("${who}", who)] = value.replace("$PWD", str(folder))
    return found


def test_a_scheduler_of_ones_own_with_certificates(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """As docs/fleets.md says: who has them decodes without a warning; who has none, or no TLS, is refused in one line."""
    distributed = pytest.importorskip("distributed")
    from dask import config

    variables = _as_the_page_says(tmp_path)
    assert len(variables) == 8
    inputs = [record(tmp_path, number) for number in (0, 1)]
    dbc, lake = truck(tmp_path), tmp_path / "lake"

    def decoded(address: str) -> tuple[int, list[str]]:
        call = ["decode", *map(str, inputs), "-p", dbc, "-o", str(lake), "--cluster", address]
        capfd.readouterr()
        return main(call), capfd.readouterr().err.splitlines()

    stated = config.merge(config.config, config.collect_env(variables))
    with config.set(stated):
        cluster = distributed.LocalCluster(
            n_workers=1,
            threads_per_worker=1,
            processes=False,
            host="tls://127.0.0.1",
            protocol="tls://",
            dashboard_address="127.0.0.1:0",
            silence_logs=50,
        )
    with cluster:
        address = cluster.scheduler_address
        assert address.startswith("tls://127.0.0.1:")
        with config.set({"distributed.comm.timeouts.connect": "5s"}):
            status, said = decoded(address)
            assert status == 2
            assert said == [
                f"aces: {address}: needs certificates, and DASK_DISTRIBUTED__COMM__TLS__CA_FILE is not set (docs/fleets.md)"
            ]
            status, said = decoded(address.replace("tls", "tcp"))
            assert (status, len(said)) == (2, 1)
        with config.set(stated):
            status, said = decoded(address)
        assert (status, len(said)) == (0, 1)
        assert said[0].startswith("frames=120 decoded=")
    assert dataset_rows(lake) == rows_of_one_process(inputs, dbc, tmp_path)


def test_a_scheduler_that_others_reach_is_warned_of(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """Before anything is sent to it."""
    from dask import config

    log = record(tmp_path, 0)
    with config.set({"distributed.comm.timeouts.connect": "1s"}):
        call = ["decode", str(log), "-p", truck(tmp_path), "-o", str(tmp_path / "lake")]
        assert main([*call, "--cluster", "tcp://0.0.0.0:1"]) == 2
    said = capfd.readouterr().err.splitlines()
    assert said[0].startswith(
        "aces: tcp://0.0.0.0:1 is not tls://: all that reach this scheduler can run programs"
    )
    assert said[1].startswith("aces: tcp://0.0.0.0:1: no worker answers: ")
