"""Stores of other machines: object storage (s3fs against moto's server), SFTP (a real sshd), HTTP with ranges."""

from __future__ import annotations

import getpass
import http.server
import re
import shutil
import socket
import subprocess
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, ClassVar

import pytest

from aces_lab import fleet
from aces_lab.fleet import stores
from tests.fleet.recordings import dataset_rows, needs_fleet, record, rows_of_one_process, truck

needs_fleet()
pytestmark = pytest.mark.slow


@pytest.fixture
def drives(tmp_path: Path) -> list[Path]:
    """A recording in each of three formats."""
    folder = tmp_path / "drives"
    folder.mkdir()
    return [record(folder, number) for number in (0, 1, 3)]


def renamed(one: dict[str, list[dict[str, Any]]], before: str) -> dict[str, list[dict[str, Any]]]:
    """The rows of one process with the names that a store gives to the recordings."""
    return {
        name: [{**row, "source": f"{before}{Path(row['source']).name}"} for row in rows]
        for name, rows in one.items()
    }


def test_object_storage(drives: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Read from one bucket and written to another, as pyarrow reads it there; a second run does what has changed."""
    pytest.importorskip("s3fs", reason="needs s3fs: make test-oracles")
    server_of = pytest.importorskip("moto.server", reason="needs moto[server]: make test-oracles")
    server = server_of.ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    host, port = server.get_host_and_port()
    for name, value in {
        "AWS_ENDPOINT_URL": f"http://{host}:{port}",
        "AWS_ACCESS_KEY_ID": "one",
        "AWS_SECRET_ACCESS_KEY": "two",
        "AWS_DEFAULT_REGION": "us-east-1",
    }.items():
        monkeypatch.setenv(name, value)
    try:
        store = stores.load_fsspec().filesystem("s3", skip_instance_cache=True)
        for bucket in ("logs", "lake"):
            store.mkdir(bucket)
        for path in drives:
            store.put_file(str(path), f"logs/2026/{path.stem}/{path.name}")
        dbc = truck(tmp_path)
        run = fleet.decode("s3://logs/2026/**/*", dbc, "s3://lake/truck/")
        assert run.failed == []
        assert sorted(one.uri for one in run.inputs) == sorted(
            f"s3://logs/2026/{path.stem}/{path.name}" for path in drives
        )
        store.get("lake/truck", str(tmp_path / "lake"), recursive=True)
        rows = {
            name: [{**row, "source": Path(row["source"]).name} for row in some]
            for name, some in dataset_rows(tmp_path / "lake").items()
        }
        assert rows == renamed(rows_of_one_process(drives, dbc, tmp_path), "")
        import pyarrow.dataset as ds

        there = ds.dataset("lake/truck/Speed", filesystem=store, partitioning="hive")
        assert there.count_rows() == len(rows["Speed"])
        changed = record(tmp_path, 1, 30)
        store.put_file(str(changed), f"logs/2026/{changed.stem}/{changed.name}")
        again = fleet.decode("s3://logs/2026/**/*", dbc, "s3://lake/truck/")
        assert (again.stood, [one.uri for one in again.inputs]) == (
            2,
            [f"s3://logs/2026/{changed.stem}/{changed.name}"],
        )
        assert fleet.status("s3://lake/truck").states == {"done": 3}
    finally:
        server.stop()


SSHD = """\
Port {port}
ListenAddress 127.0.0.1
HostKey {folder}/host
AuthorizedKeysFile {folder}/user.pub
PidFile {folder}/pid
StrictModes no
UsePAM no
PasswordAuthentication no
Subsystem sftp internal-sftp
"""


@pytest.fixture
def sshd(tmp_path: Path) -> Iterator[tuple[int, Path]]:
    """A server for this user on a port of this machine, and the user's key."""
    program, keygen = shutil.which("sshd", path="/usr/sbin:/usr/bin"), shutil.which("ssh-keygen")
    if program is None or keygen is None:
        pytest.skip("needs sshd: apt-get install openssh-server")
    folder = tmp_path / "ssh"
    folder.mkdir(mode=0o700)
    for name in ("host", "user"):
        subprocess.run([keygen, "-q", "-t", "ed25519", "-N", "", "-f", str(folder / name)], check=True)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    (folder / "config").write_text(SSHD.format(port=port, folder=folder))
    if getpass.getuser() == "root":
        Path("/run/sshd").mkdir(exist_ok=True)
    log = (folder / "log").open("wb")
    process = subprocess.Popen([program, "-D", "-e", "-f", str(folder / "config")], stderr=log)
    try:
        for _ in range(300):
            with socket.socket() as probe:
                if probe.connect_ex(("127.0.0.1", port)) == 0:
                    break
            if process.poll() is not None:
                pytest.skip(f"sshd does not start here: {(folder / 'log').read_text()}")
            time.sleep(0.1)
        yield port, folder / "user"
    finally:
        process.terminate()
        process.wait(10)
        log.close()


def test_sftp(
    drives: list[Path], tmp_path: Path, sshd: tuple[int, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Read over SFTP and written over it, whole files under their names alone."""
    pytest.importorskip("sshfs", reason="needs sshfs: make test-oracles")
    port, key = sshd
    config = stores.load_fsspec().config.conf
    monkeypatch.setitem(config, "sftp", {"client_keys": [str(key)], "known_hosts": None})
    before = f"sftp://{getpass.getuser()}@127.0.0.1:{port}"
    dbc, lake = truck(tmp_path), tmp_path / "lake"
    run = fleet.decode(f"{before}{tmp_path}/drives/*", dbc, f"{before}{lake}")
    assert run.failed == []
    assert dataset_rows(lake) == renamed(
        rows_of_one_process(drives, dbc, tmp_path), f"{before}{tmp_path}/drives/"
    )
    assert fleet.decode(f"{before}{tmp_path}/drives/*", dbc, f"{before}{lake}").stood == 3
    assert not list(lake.rglob(".*"))


class _Ranges(http.server.SimpleHTTPRequestHandler):
    """Files with ranges of their bytes, as servers of files have them; every fifth answer fails."""

    asked: ClassVar[list[str]]
    count = 0

    def send_head(self) -> Any:
        kind = type(self)
        kind.count += 1
        if kind.count % 5 == 4:
            self.send_error(503, "busy")
            return None
        found = re.fullmatch(r"bytes=(\d+)-(\d+)", self.headers.get("Range", ""))
        path = Path(self.translate_path(self.path))
        if found is None or not path.is_file():
            return super().send_head()
        kind.asked.append(f"{path.name} {found[0]}")
        data = path.read_bytes()
        part = data[int(found[1]) : int(found[2]) + 1]
        self.send_response(206)
        self.send_header("Content-Length", str(len(part)))
        self.send_header("Content-Range", f"bytes {found[1]}-{int(found[1]) + len(part) - 1}/{len(data)}")
        self.send_header("Accept-Ranges", "bytes")
        self.end_headers()
        self.wfile.write(part)
        return None

    def log_message(self, format: str, *args: Any) -> None:
        """Nothing."""


def test_http_with_ranges(drives: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Read in ranges from a server that fails now and then, by a pattern of its page; written here."""
    pytest.importorskip("aiohttp", reason="needs aiohttp: make test-oracles")
    monkeypatch.setattr(stores, "BLOCK", 1500)
    monkeypatch.setattr(stores, "WAITS_S", (0.0, 0.0, 0.0))

    class Handler(_Ranges):
        """With counts of its own."""

        asked: ClassVar[list[str]] = []
        count = 0

    root = tmp_path / "drives"
    record(root, 0, 400)  # of several blocks
    server = http.server.ThreadingHTTPServer(
        ("127.0.0.1", 0), lambda *given: Handler(*given, directory=str(root))
    )
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        before = f"http://127.0.0.1:{server.server_port}/"
        dbc = truck(tmp_path)
        run = fleet.decode(f"{before}*", dbc, str(tmp_path / "lake"))
        assert run.failed == []
        assert dataset_rows(tmp_path / "lake") == renamed(rows_of_one_process(drives, dbc, tmp_path), before)
        assert len({line for line in Handler.asked if "drive-000.log" in line}) > 1
        assert fleet.decode(f"{before}*", dbc, str(tmp_path / "lake")).stood == 3
    finally:
        server.shutdown()
        server.server_close()


def test_a_slow_store_costs_time_and_a_stalled_one_a_file(
    drives: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each answer comes late, and of one file none: that one is named, the others are whole, and the next run has it."""
    pytest.importorskip("aiohttp", reason="needs aiohttp: make test-oracles")
    monkeypatch.setattr(stores, "ANSWER_S", 5.0)
    monkeypatch.setattr(stores, "SLOWEST", 1e9)
    monkeypatch.setattr(stores, "WAITS_S", ())
    monkeypatch.setattr("aces_lab.fleet.work.AGAIN_S", 0.0)
    going_on = threading.Event()
    stalled = drives[1].name

    class Handler(_Ranges):
        """Late, and of one file's bytes never."""

        asked: ClassVar[list[str]] = []
        count = 0

        def send_head(self) -> Any:
            type(self).count = 0  # none fails
            time.sleep(0.1)
            if self.path.endswith(stalled) and self.command == "GET":
                going_on.wait(120)
            return super().send_head()

    server = http.server.ThreadingHTTPServer(
        ("127.0.0.1", 0), lambda *given: Handler(*given, directory=str(tmp_path / "drives"))
    )
    threading.Thread(target=server.serve_forever, daemon=True).start()
    before = f"http://127.0.0.1:{server.server_port}/"
    dbc, lake = truck(tmp_path), tmp_path / "lake"
    try:
        run = fleet.decode(f"{before}*", dbc, str(lake))
        assert [(one.state, one.faults) for one in run.failed] == [
            ("missing", [f"{before}{stalled}: the store has not answered for 5 s"])
        ]
        there = [path for path in drives if path.name != stalled]
        assert dataset_rows(lake) == renamed(rows_of_one_process(there, dbc, tmp_path), before)
        going_on.set()
        again = fleet.decode(f"{before}*", dbc, str(lake))
        assert (again.stood, again.failed) == (2, [])
        (tmp_path / "all").mkdir()
        assert dataset_rows(lake) == renamed(rows_of_one_process(drives, dbc, tmp_path / "all"), before)
    finally:
        going_on.set()
        server.shutdown()
        server.server_close()
