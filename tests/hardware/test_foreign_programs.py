"""Other people's programs on a served bus, each in a process of its own: they need no change, only the bus's name."""

from __future__ import annotations

import fcntl
import os
import pty
import queue
import shutil
import signal
import struct
import subprocess
import sys
import tempfile
import termios
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import can
import pytest

from aces_bus.hardware.served.address import ServedAddress
from aces_bus.hardware.served.channel import ServedChannel
from aces_bus.hardware.served.server import BusServer

from .serving import sending

ROOT = Path(__file__).resolve().parents[2]
#: How long anything may take here, in seconds; reached only when something is broken.
PATIENCE = 30.0


@pytest.fixture
def server(monkeypatch: pytest.MonkeyPatch) -> Iterator[BusServer]:
    """A bus at 1 Mbit/s, at `unix:can0` and for socketcand; what is started beside it finds this package."""
    folder = tempfile.mkdtemp(prefix="aces")
    monkeypatch.setenv("XDG_RUNTIME_DIR", folder)
    # python-can imports asammdf wherever it is, for a second of each program's start; none of these needs it.
    (Path(folder) / "asammdf.py").write_text('raise ImportError("left out by a test")\n')
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([folder, str(ROOT)]))
    monkeypatch.setenv("PYTHONUNBUFFERED", "1")
    try:
        with BusServer([ServedChannel(bitrate=1_000_000)], unix="", socketcand=("127.0.0.1", 0)) as running:
            yield running
    finally:
        shutil.rmtree(folder, ignore_errors=True)


@pytest.fixture
def bus(server: BusServer) -> Iterator[can.BusABC]:
    """A node of the test's own."""
    with can.Bus("unix:can0", "aces", bitrate=1_000_000) as bus:
        yield bus


class Program:
    """A program, and what it prints; ended with the test."""

    def __init__(self, *arguments: str) -> None:
        self.process = subprocess.Popen(
            [sys.executable, *arguments],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        self._lines: queue.Queue[str | None] = queue.Queue()
        self.seen: list[str] = []
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self._lines.put(line)
        self._lines.put(None)

    def wait_for(self, text: str) -> str:
        """The line that has this text; fails when the program ends without it."""
        end = time.monotonic() + PATIENCE
        while True:
            line = self._lines.get(timeout=max(0.01, end - time.monotonic()))
            if line is None:
                pytest.fail(f"the program ended without {text!r}:\n{''.join(self.seen)}")
            self.seen.append(line)
            if text in line:
                return line

    def end(self) -> int:
        """Ctrl-C, and its status."""
        self.process.send_signal(signal.SIGINT)
        return self.process.wait(PATIENCE)

    def __enter__(self) -> Program:
        return self

    def __exit__(self, *_: object) -> None:
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait(PATIENCE)
        for pipe in (self.process.stdin, self.process.stdout):
            if pipe is not None:
                pipe.close()


BUS = ("-i", "aces", "-c", "unix:can0")


@pytest.mark.slow
def test_python_can_logger(bus: can.BusABC) -> None:
    """`can_logger` shows every frame that is sent on the bus."""
    with Program("-m", "can.logger", *BUS, "-b", "1000000") as logger:
        logger.wait_for("Can Logger (Started")
        for number in range(50):
            bus.send(can.Message(arbitration_id=0x100 + number, data=[number], is_extended_id=False))
        for number in range(50):
            assert f"{0x100 + number:03x}" in logger.wait_for("Rx").lower()
        logger.end()


@pytest.mark.slow
def test_python_can_player(bus: can.BusABC, tmp_path: Path) -> None:
    """`can_player` plays a log onto the bus; every frame arrives, although it ends as soon as it has sent the last."""
    log = tmp_path / "walk.log"
    log.write_text("".join(f"({1000 + n / 1000:.6f}) can0 {n:03X}#{n:02X}55\n" for n in range(100)))
    with Program("-m", "can.player", *BUS, str(log)) as player:
        for number in range(100):
            got = bus.recv(PATIENCE)
            assert got is not None
            assert (got.arbitration_id, bytes(got.data)) == (number, bytes([number, 0x55]))
        assert player.process.wait(PATIENCE) == 0


@pytest.mark.slow
def test_python_can_socketcand_client(server: BusServer, bus: can.BusABC) -> None:
    """`can_logger -i socketcand` in a process of its own, joined to the same bus."""
    host, port = ServedAddress.parse_host(server.socketcand, None)
    options = ("-i", "socketcand", "-c", "can0", "--bus-kwargs", f"host={host}", f"port={port}")
    with Program("-m", "can.logger", *options) as logger:
        logger.wait_for("Can Logger (Started")
        bus.send(can.Message(arbitration_id=0x1ABCDEF0, data=b"\x01\x02"))
        assert "01 02" in logger.wait_for("1abcdef0")
        logger.end()


DBC = """VERSION ""
BU_: X
BO_ 291 Wheel: 8 X
 SG_ Speed : 0|16@1+ (0.25,0) [0|0] "rpm" X
"""


@pytest.mark.slow
def test_cantools_monitor(bus: can.BusABC, tmp_path: Path) -> None:
    """`cantools monitor` on a terminal shows the decoded signal, and ends when told to."""
    pytest.importorskip("cantools")
    pytest.importorskip("curses")
    (tmp_path / "car.dbc").write_text(DBC)
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("4H", 24, 80, 0, 0))
    command = [sys.executable, "-m", "cantools", "monitor", *BUS, str(tmp_path / "car.dbc")]
    wheel = can.Message(
        arbitration_id=291, data=(5000).to_bytes(2, "little") + bytes(6), is_extended_id=False
    )
    with (
        subprocess.Popen(
            command, stdin=theirs, stdout=theirs, stderr=theirs, env={**os.environ, "TERM": "xterm"}
        ) as process,
        sending(bus, wheel, 0.02),
    ):
        os.close(theirs)
        watchdog = threading.Timer(PATIENCE, process.kill)
        watchdog.start()
        screen = ""
        try:
            while "1250.0 rpm" not in screen:
                screen += os.read(ours, 65536).decode("utf-8", "replace")
            assert "Speed" in screen
            os.write(ours, b"q")
            while os.read(ours, 65536):  # until it hangs up
                pass
        except OSError:
            assert "1250.0 rpm" in screen, screen
        finally:
            watchdog.cancel()
            os.close(ours)
        assert process.wait(PATIENCE) == 0


EDS = """
[FileInfo]
FileName=test.eds
[DeviceInfo]
VendorName=none
[MandatoryObjects]
SupportedObjects=1
1=0x1000
[OptionalObjects]
SupportedObjects=3
1=0x1017
2=0x1800
3=0x1A00
[ManufacturerObjects]
SupportedObjects=2
1=0x2000
2=0x2001
[1000]
ParameterName=Device type
DataType=0x0007
AccessType=ro
DefaultValue=0
PDOMapping=0
[1017]
ParameterName=Producer heartbeat time
DataType=0x0006
AccessType=rw
DefaultValue=0
PDOMapping=0
[2000]
ParameterName=Name
DataType=0x0009
AccessType=rw
DefaultValue=unset
PDOMapping=0
[2001]
ParameterName=Position
DataType=0x0004
AccessType=rw
DefaultValue=0
PDOMapping=1
[1800]
ParameterName=Transmit PDO communication parameter
ObjectType=0x9
SubNumber=3
[1800sub0]
ParameterName=Highest sub-index
DataType=0x0005
AccessType=ro
DefaultValue=2
[1800sub1]
ParameterName=COB-ID
DataType=0x0007
AccessType=rw
DefaultValue=$NODEID+0x180
[1800sub2]
ParameterName=Transmission type
DataType=0x0005
AccessType=rw
DefaultValue=255
[1A00]
ParameterName=Transmit PDO mapping parameter
ObjectType=0x9
SubNumber=2
[1A00sub0]
ParameterName=Number of mapped objects
DataType=0x0005
AccessType=rw
DefaultValue=1
[1A00sub1]
ParameterName=Mapped object 1
DataType=0x0007
AccessType=rw
DefaultValue=0x20010020
"""

NODE = """
import sys, canopen
network = canopen.Network()
network.connect(interface="aces", channel="unix:can0")
node = network.create_node(5, sys.argv[1])
node.tpdo.read(from_od=True)
node.nmt.state = "PRE-OPERATIONAL"
print("ready", flush=True)
for line in sys.stdin:                     # each line: a position to send as a PDO
    print("state", node.nmt.state, flush=True)
    node.tpdo[1]["Position"].raw = int(line)
    node.tpdo[1].transmit()
network.disconnect()
"""


@pytest.mark.slow
def test_a_canopen_master_and_a_node_in_another_process(server: BusServer, tmp_path: Path) -> None:
    """SDO upload and download (expedited and segmented), NMT with heartbeats, and a PDO."""
    canopen: Any = pytest.importorskip("canopen")
    eds = tmp_path / "test.eds"
    eds.write_text(EDS)
    (tmp_path / "node.py").write_text(NODE)
    with Program(str(tmp_path / "node.py"), str(eds)) as program:
        program.wait_for("ready")
        network = canopen.Network()
        network.connect(interface="aces", channel="unix:can0")
        try:
            node = network.add_node(5, str(eds))
            node.sdo.RESPONSE_TIMEOUT = PATIENCE
            name = "a name that takes several segments"
            node.sdo["Name"].raw = name
            assert node.sdo["Name"].raw == name
            node.sdo["Position"].raw = -5
            assert node.sdo["Position"].raw == -5
            node.sdo["Producer heartbeat time"].raw = 20
            node.nmt.state = "OPERATIONAL"
            while node.nmt.wait_for_heartbeat(PATIENCE) != "OPERATIONAL":
                pass
            node.tpdo.read(from_od=True)
            got: list[int] = []
            came = threading.Event()

            def arrived(pdo: Any) -> None:
                got.append(pdo["Position"].raw)
                came.set()

            node.tpdo[1].add_callback(arrived)
            node.tpdo[1].subscribe()
            assert program.process.stdin is not None
            program.process.stdin.write("-123456\n")
            program.process.stdin.flush()
            program.wait_for("state OPERATIONAL")
            assert came.wait(PATIENCE)
            assert got == [-123456]
            program.process.stdin.close()
            assert program.process.wait(PATIENCE) == 0
        finally:
            network.disconnect()
