"""`aces bus`: serving, listing, measuring, from the command line; and what may be served how."""

from __future__ import annotations

import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import can
import pytest

from aces_bus import Frame
from aces_bus.errors import AcesError
from aces_bus.hardware import Faults
from aces_bus.hardware.served.channel import ServedChannel
from aces_bus.hardware.served.server import BusServer
from aces_bus.hardware.simulated.frame_time import INTERMISSION, frame_bits
from aces_tools.bus import parse_faults
from aces_tools.bus_arg import chosen_end

from .conftest import Aces
from .live import Opened

pytestmark = pytest.mark.skipif(not hasattr(socket, "AF_UNIX"), reason="no Unix sockets on this system")

ROOT = Path(__file__).resolve().parents[2]
PATIENCE = 30.0
MESSAGE = can.Message(arbitration_id=1, data=bytes(8), is_extended_id=False)
#: What it takes of the bus's time, with the pause behind it.
BITS = frame_bits(Frame(1, bytes(8))).total + INTERMISSION


@contextmanager
def sending(bus: can.BusABC, message: can.Message, period_s: float) -> Generator[None]:
    """A thread that sends the message again and again, and has ended with the block: unlike `send_periodic`'s."""
    stop = threading.Event()

    def send() -> None:
        while not stop.wait(period_s):
            bus.send(message)

    thread = threading.Thread(target=send)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()


@pytest.fixture(autouse=True)
def runtime(monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A runtime folder of the test's own, with a short path."""
    folder = Path(tempfile.mkdtemp(prefix="aces"))
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(folder))
    monkeypatch.setattr("aces_tools.bus.INTERVAL_NS", 300_000_000)
    yield folder
    shutil.rmtree(folder, ignore_errors=True)


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_serving_until_told_to_stop(runtime: Path, number: signal.Signals) -> None:
    """`aces bus serve` says how to join, serves, and on Ctrl-C or SIGTERM ends with a summary, status 0 and no files."""
    command = [sys.executable, "-m", "aces_tools", "bus", "serve", "left", "right", "-b", "250000"]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), str(ROOT / "tools")])}
    with subprocess.Popen(
        [*command, "--socketcand", "127.0.0.1:0"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=environment,
    ) as process:
        watchdog = threading.Timer(PATIENCE, process.kill)
        watchdog.start()
        assert process.stdout is not None
        lines = [process.stdout.readline() for _ in range(4)]
        assert lines[0] == f"left  -i aces -c unix:{runtime}/aces/left.sock\n"
        assert lines[3].startswith("right  -i socketcand -c right --bus-kwargs host=127.0.0.1 port=")
        with can.Bus("unix:left", "aces", bitrate=250_000) as one, can.Bus("unix:left", "aces") as two:
            one.send(can.Message(arbitration_id=1))
            assert two.recv(PATIENCE) is not None
        process.send_signal(number)
        _, err = process.communicate(timeout=PATIENCE)
        watchdog.cancel()
    assert process.returncode == 0
    assert "aces: left: 1 frames, 0 errors, load" in err
    assert "Traceback" not in err
    assert list((runtime / "aces").iterdir()) == []


@pytest.mark.slow
def test_list_names_served_buses(aces: Aces) -> None:
    """Each channel with its rate, nodes and addresses; with --json one object a line."""
    with (
        BusServer(
            [ServedChannel("left"), ServedChannel("right", physics=False)], unix="", tcp=("127.0.0.1", 0)
        ) as server,
        can.Bus("unix:left", "aces"),
    ):
        plain = aces("bus", "list", "--for", "0.2")
        objects = aces("bus", "list", "--for", "0.2", "--json").objects
    assert plain.status == 0
    assert "left  served: 500,000 bit/s, 1 node, 0 frames" in plain.out
    assert "right  served: no physics, 0 nodes, 0 frames" in plain.out
    assert all(
        f"  -i aces -c {address}" in plain.out for some in server.addresses.values() for address in some
    )
    found = {one["channel"]: one for one in objects if one["kind"] == "served"}
    assert found["left"]["addresses"] == server.addresses["left"]


def load_of_traffic(aces: Aces, *how: str) -> dict[str, Any]:
    """The first measure that saw a frame: on a busy machine the sender may not get a turn within one interval."""
    end = time.monotonic() + PATIENCE
    while True:
        result = aces("bus", "load", *how, "--once", "--json")
        assert result.status == 0
        (measure,) = result.objects
        if measure["frames_per_s"] > 0 or time.monotonic() > end:
            assert measure["frames_per_s"] > 0
            return measure


def test_a_load_and_a_served_bus_end_after_their_time(aces: Aces) -> None:
    """--for ends both with status 0, the load with a line for the rest of a second."""
    served = aces("bus", "serve", "short", "--for", "0.05s")
    assert (served.status, "Ctrl-C" in served.err) == (0, False)
    with BusServer([ServedChannel("can0")], unix=""):
        load = aces("bus", "load", "can0", "--for", "0.05s", "--json")
    assert (load.status, len(load.objects)) == (0, 1)


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (["load", "--once", "--for", "1s"], "--once measures one second; leave --for away"),
        (["load", "--faults", "drop=0.1"], "--faults belongs to 'aces bus serve'"),
        (["list", "--once"], "--once belongs to 'aces bus load'"),
        (["list", "can0"], "lists all buses"),
        (["serve", "--json"], "--json belongs to 'aces bus load'"),
    ],
)
def test_an_option_of_another_action_is_refused(aces: Aces, call: list[str], said: str) -> None:
    """What an action would ignore ends with status 2."""
    result = aces("bus", *call)
    assert result.status == 2
    assert said in result.err


@pytest.mark.parametrize("how", [["can0"], ["-c", "unix:can0"], ["-i", "aces", "-c", "can0"], []])
def test_load_of_a_served_bus(aces: Aces, how: list[str]) -> None:
    """By its name, its address, or as the only one there is: load, frames/s and nodes, as the server counts them."""
    with (
        BusServer([ServedChannel(bitrate=125_000)]),
        can.Bus("unix:can0", "aces") as sender,
        can.Bus("unix:can0", "aces", listen_only=True),
        can.Bus("unix:can0", "aces"),
        sending(sender, MESSAGE, 0.002),
    ):
        measure = load_of_traffic(aces, *how)
    assert measure["frames_per_s"] < 970, "more than the bus can carry"
    assert measure["load"] == pytest.approx(measure["frames_per_s"] * BITS / 125_000, rel=0.05)
    assert [node["listen_only"] for node in measure["nodes"]] == [False, True, False]
    assert measure["nodes"][2]["received"] > 0


def test_load_as_text(aces: Aces) -> None:
    """One line, and with --once one for each node."""
    with BusServer([ServedChannel(physics=False)]), can.Bus("unix:can0", "aces"):
        result = aces("bus", "load", "can0", "--once")
    first, second = result.out.splitlines()
    assert "can0  load    –           0 frames/s       0 errors/s  1 node" in first
    assert second.startswith(f"  unix pid {os.getpid()}: error-active, errors 0 sending, 0 receiving; 0 sent")


def test_load_of_another_bus_is_heard(aces: Aces) -> None:
    """For any bus of python-can the load is computed from what is heard and the bit rate that is given."""
    with can.Bus("load", "virtual") as bus, sending(bus, MESSAGE, 0.002):
        measure = load_of_traffic(aces, "-i", "virtual", "-c", "load", "-b", "125000")
    assert measure["frames_per_s"] < 970
    assert measure["load"] == pytest.approx(measure["frames_per_s"] * BITS / 125_000, rel=0.01)
    assert (measure["lost"], measure["state"]) == (0, "open")


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["serve", "--bitrate", "5"], "5 bit/s; CAN has"),
        (["serve", "a/b"], "not a name of a channel"),
        (["serve", "--data-bitrate", "2000000"], "--fd"),
        (["serve", "--faults", "dropp=1"], "did you mean 'drop'"),
        (["serve", "--faults", "drop=much"], "write drop=0.01"),
        (["serve", "--faults", "drop=2"], "not a chance"),
        (["serve", "--faults", "drop=0.1", "--no-physics"], "without physics"),
        (["serve", "--tcp", "0.0.0.0:0"], "--bind-anywhere"),
        (["serve", "--tcp", "nowhere:x"], "is not a HOST:PORT"),
        (["serve", "-i", "socketcan"], "serve makes one"),
        (["load", "-i", "socketcan", "-c", "can0"], "-b 500000"),
        (["load", "unix:nobody", "--once"], "no server answers"),
        (["load", "-i", "aces", "-c", "nobody"], "no served channel named 'nobody'"),
        (["load", "a", "b"], "name one channel"),
        (["fly"], "no argument of 'aces bus' named 'fly'"),
    ],
)
def test_complaints(aces: Aces, arguments: list[str], complaint: str) -> None:
    """What cannot be done is one line that says why, and status 2."""
    result = aces("bus", *arguments)
    assert result.status == 2
    assert complaint in result.err
    assert result.err.count("\n") == 1


def test_a_path_that_is_served_is_refused(aces: Aces) -> None:
    """The second server of a name says how to join the first."""
    with BusServer([ServedChannel()]):
        result = aces("bus", "serve")
    assert result.status == 2
    assert "is served already; join it (-i aces -c unix:" in result.err


def test_faults_are_read_as_written() -> None:
    """Chances by name, the longest delay in microseconds, and the seed."""
    assert parse_faults(None, 3) == Faults(seed=3)
    assert parse_faults("drop=0.01, delay=0.5,delay_us=20", 1) == Faults(
        seed=1, drop=0.01, delay=0.5, delay_ns=20_000
    )
    for wrong in ("delay_us=0", "drop", "=1"):
        with pytest.raises(AcesError):
            parse_faults(wrong, 0)


def test_the_benchmark_s_bus_is_the_same_twice() -> None:
    """One seed, one bus; another seed, another; and it has the load that it is named for."""
    from tests.bench.bus import simulate_bus

    first, again, other = simulate_bus(0.2, 1), simulate_bus(0.2, 1), simulate_bus(0.2, 2)
    assert first.digest == again.digest != other.digest
    assert (first.frames, first.load) == (again.frames, again.load)
    assert 0.65 < first.load < 0.75


def test_a_served_bus_is_called_what_the_user_typed(
    aces: Aces, opened: Opened, arm: str, tmp_path: Path
) -> None:
    """`can0` names a served bus in filters, protocols, lines and recordings, which can-utils reads; never its socket."""
    record = tmp_path / "walk.log"
    with (
        BusServer([ServedChannel("can0", physics=False), ServedChannel("can1", physics=False)]),
        can.Bus("unix:can0", "aces") as sender,
    ):
        data = bytes.fromhex("0A000000F6FFFFFF")
        opened.then(lambda: sender.send(can.Message(arbitration_id=0x060, data=data, is_extended_id=False)))
        found = aces(
            "sniff", "can0", "-p", f"can0={arm}", "--filter", "can0,060:7F0", "--record", record, "-n", 1,
            "--format", "jsonl", "--for", "10s",
        )  # fmt: skip
    (one,) = found.objects
    assert (one["channel"], one["fields"]) == ("can0", {"board": 0, "position": [10, -10]})
    assert found.summary["filtered"] == 0
    (line,) = record.read_text(encoding="utf-8").splitlines()
    assert line.split()[1:][:2] == ["can0", "060#0A000000F6FFFFFF"]
    assert "unix:" not in found.out + found.err


def test_another_channel_of_a_served_bus_is_found_by_name() -> None:
    """`aces play -c can0 --map a=can1` plays onto the served can1, not onto a bus inside the program."""
    with BusServer([ServedChannel("can0"), ServedChannel("can1")]) as server:
        one = chosen_end("can0")
        other = one.on("can1")
    assert (one.name, one.options["channel"]) == ("can0", server.addresses["can0"][0])
    assert (other.name, other.options["channel"], other.options["name"]) == (
        "can1",
        server.addresses["can1"][0],
        "can1",
    )
