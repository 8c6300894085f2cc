"""Where buses are served: sockets, folders, addresses, and who may come."""

from __future__ import annotations

import socket
import stat
from pathlib import Path
from typing import Any

import can
import pytest

from aces_bus.errors import CallerError
from aces_bus.hardware import Faults
from aces_bus.hardware.served.address import ServedAddress
from aces_bus.hardware.served.channel import ServedChannel
from aces_bus.hardware.served.stream import servers

from .serving import Open, message, received, serve, with_unix_sockets

pytestmark = with_unix_sockets


def test_sockets_are_the_users_alone_and_go(runtime: Path) -> None:
    """Folder 0700, socket 0600, both without leftovers; a file that is not ours any more stays."""
    with serve() as server:
        folder = runtime / "aces"
        path = folder / "can0.sock"
        assert stat.S_IMODE(folder.stat().st_mode) == 0o700
        assert stat.S_IMODE(path.stat().st_mode) == 0o600
        assert server.addresses == {"can0": [f"unix:{path}"]}
    assert list(folder.iterdir()) == []
    with serve():
        path.unlink()
        path.write_text("another's")
    assert path.read_text() == "another's"


def test_dead_sockets_are_replaced_and_living_ones_not(runtime: Path) -> None:
    """A second server on a path is refused; what a killed one has left is not an obstacle; a file is never removed."""
    path = str(runtime / "bus.sock")
    with socket.socket(socket.AF_UNIX) as dead:
        dead.bind(path)
    with serve(unix=path), pytest.raises(CallerError, match="is served already"):
        serve(unix=path)
    Path(path).write_text("a file")
    with pytest.raises(CallerError, match="is not a socket"):
        serve(unix=path)
    with pytest.raises(CallerError, match="longer than"):
        serve(unix=str(runtime / ("x" * 120)))
    with pytest.raises(CallerError, match="cannot be served"):
        serve(unix=str(runtime / "no" / "such" / "folder.sock"))


def test_other_machines_are_not_let_in() -> None:
    """An address that others reach takes an explicit word."""
    for host in ("0.0.0.0", "::"):
        with pytest.raises(CallerError, match="--bind-anywhere"):
            serve(unix=None, tcp=(host, 0))
        with pytest.raises(CallerError, match="--bind-anywhere"):
            serve(unix=None, socketcand=(host, 0))
    with serve(unix=None, tcp=("0.0.0.0", 0), bind_anywhere=True):
        pass


def test_a_runtime_folder_of_somebody_else(runtime: Path) -> None:
    """A folder in which others may write is not used."""
    (runtime / "aces").mkdir()
    (runtime / "aces").chmod(0o777)
    with pytest.raises(CallerError, match="this user alone"):
        serve()


@pytest.mark.parametrize("timeout", [0.0, -1.0, float("nan"), float("inf")])
def test_a_time_out_that_is_none(timeout: float) -> None:
    """It is refused, also where no server would be asked."""
    with pytest.raises(CallerError, match="a time-out of"):
        servers(timeout)


def test_servers_are_found(opened: Open, runtime: Path) -> None:
    """`detect_available_configs` lists served channels; the notes of dead servers are cleared."""
    note = runtime / "aces" / "server-dead.json"
    with serve(ServedChannel("left"), ServedChannel("right"), tcp=("127.0.0.1", 0)):
        note.write_text('{"pid": 999999999, "addresses": {"x": ["unix:/nowhere.sock"]}}')
        (runtime / "aces" / "server-bad.json").write_text("{")
        found = {config["channel"] for config in can.detect_available_configs("aces")}
        assert {f"unix:{runtime}/aces/{name}.sock" for name in ("left", "right")} <= found
        for name in ("left", "right"):
            opened(f"unix:{name}")
        (status,) = servers()
        assert [len(channel["members"]) for channel in status["channels"]] == [1, 1]
    assert not note.exists()
    assert servers() == []


def test_several_channels_on_one_port(opened: Open, runtime: Path) -> None:
    """The address says which; channels are apart; `--unix` with several names a folder."""
    folder = runtime / "both"
    with serve(ServedChannel("a"), ServedChannel("b"), unix=str(folder), tcp=("127.0.0.1", 0)) as server:
        assert sorted(path.name for path in folder.iterdir()) == ["a.sock", "b.sock"]
        one, same, other = (opened(server.addresses[name][1]) for name in "aab")
        one.send(message(7))
        assert received(same)[0].arbitration_id == 7
        assert other.recv(0.01) is None
        with pytest.raises(can.CanInitializationError, match="say which channel: a, b"):
            opened(server.addresses["a"][1].rpartition("/")[0])


@pytest.mark.parametrize(
    ("text", "again"),
    [
        ("unix:/run/x.sock", "unix:/run/x.sock"),
        ("tcp:127.0.0.1:29537/can0", "tcp:127.0.0.1:29537/can0"),
        ("tcp:[::1]:5/can1", "tcp:[::1]:5/can1"),
        ("tcp:localhost:5", "tcp:localhost:5"),
        ("tcp:localhost", None),
        ("tcp:localhost:65536", None),
        ("tcp:localhost:٣", None),
        ("udp:localhost:5", None),
        ("unix:", None),
    ],
)
def test_addresses(text: str, again: str | None) -> None:
    """An address reads as it is written; what is none is refused."""
    if again is None:
        with pytest.raises(CallerError):
            ServedAddress.parse(text)
    else:
        assert str(ServedAddress.parse(text)) == again


@pytest.mark.parametrize(
    "settings",
    [
        {"name": ""},
        {"name": "a/b"},
        {"name": "x" * 65},
        {"bitrate": 5},
        {"data_bitrate": 2_000_000},
        {"fd": True, "data_bitrate": 5},
        {"physics": False, "faults": Faults(drop=0.5)},
    ],
)
def test_impossible_channels_are_refused(settings: dict[str, Any]) -> None:
    """Before anything is opened."""
    with pytest.raises(CallerError):
        ServedChannel(**settings)
