"""What the tests of the command share: running it, and a protocol and recordings of their own."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from aces_tools.main import main
from tests.tools.live import Node, Opened


class Result(NamedTuple):
    """What a run left behind."""

    status: int
    out: str
    err: str

    @property
    def objects(self) -> list[dict[str, Any]]:
        """The record lines on stdout."""
        return [json.loads(line) for line in self.out.splitlines()]

    @property
    def summary(self) -> dict[str, int]:
        """The numbers of the last line on stderr."""
        return {name: int(number) for name, number in re.findall(r"(\w+)=(\d+)", self.err.splitlines()[-1])}

    @property
    def messages(self) -> list[str]:
        """What was said on stderr before the summary."""
        return [line.removeprefix("aces: ") for line in self.err.splitlines() if line.startswith("aces: ")]


Aces = Callable[..., Result]


@pytest.fixture
def aces(capsys: pytest.CaptureFixture[str]) -> Aces:
    """`aces("decode", file, …)` runs the command in this process."""

    def run(*arguments: str | Path) -> Result:
        capsys.readouterr()
        status = main([str(argument) for argument in arguments])
        out, err = capsys.readouterr()
        assert "Traceback" not in err
        return Result(status, out, err)

    return run


SPEC = """
from construct import Array, Byte, GreedyBytes, Int16sb, Int16sl, Int32sl, Float32l, Struct
from aces_bus.protocol import (
    BitLayout, IdField, Enumeration, Flags, Multiplexed, Protocol, Quantity, Split, Text, bits,
)

arm = Protocol(
    "arm", link="can", bitrate=1_000_000, dialects={"old": "before 2012", "new": "since"}, dialect="new",
    configurations={
        "two": {"channels": {0: 2, 1: 2, 2: 3}},
        "three": {"channels": {0: 3, 1: 3, 2: 3}},
    },
    doc="An arm for tests.", source="no sheet",
)
Board = IdField("board", range(4))
channels = arm.configured("channels", by="board")
Encoder = arm.message("Encoder", id=0x060 + Board, direction="from device", when=channels(2),
    payload=Struct("position" / Array(2, Quantity(Int32sl, unit="count"))), doc="Positions of both motors.",
    source="sheet 7.1")
Encoder3 = arm.message("Encoder3", id=0x060 + Board, direction="from device", when=channels(3),
    payload=Struct("position" / Array(3, Quantity(Int16sl, unit="count"))))
State = arm.message("State", id=0x300 + Board, direction="from device", dialect="new", payload=Struct(
    "mode" / Enumeration(Byte, off=0, torque=2), "error" / Flags(Byte, hot=0, cold=3),
    "angle" / Quantity(Int16sb, scale=0.01, unit="°", range=(-100, 100)), "load" / Float32l))
Command = arm.family(id=0x001, prefix=Struct("board" / Byte, "opcode" / Byte), direction="to device")
Get = Command("Get", opcode=0x24, payload=Struct("selector" / Byte))
Stop = Command("Stop", opcode=0x0F)
Gains = arm.message("Gains", id=0x1C0 + Board, direction="from device", reply_to=Get.where(selector=7),
    payload=Struct("kp" / Int16sl, "ki" / Int16sl))
Limits = arm.message("Limits", id=0x1C0 + Board, direction="from device", reply_to=Get.where(selector=1),
    payload=Struct("lower" / Int16sl, "upper" / Int16sl))
Raw = arm.message("Raw", id=0x400, length=range(9), payload=Struct("data" / GreedyBytes))
Pages = arm.message("Pages", id=0x500, payload=BitLayout(4, "page" / bits(2),
    "low" / Multiplexed("page", 0, Quantity(bits(10, at=8), unit="V", scale=0.5)),
    "high" / Multiplexed("page", 1, bits(6, at=8)), "split" / Split((4, 2), (28, 4))))
Wide = arm.message("Wide", id=0x1FFF0001, extended=True, fd=True, length=12, payload=Struct("words" / Array(3, Int32sl)))
Name = arm.message("Name", id=0x600, payload=Struct("name" / Text(8)))
Ask = arm.message("Ask", id=0x700, remote=True, direction="to device")

line = Protocol("line", link="serial", baud=115200, doc="A line for tests.")
packet = line.framing(sync=b"\\xaa", size=4)
Sample = packet("Sample", direction="from device", payload=Struct("value" / Quantity(Int16sb, unit="mV"), "number" / Byte))
"""

#: Time stamps 10 ms apart; what each line is to the protocol `arm` stands behind it.
LOG = """\
(1436509052.000000) can0 060#0A000000F6FFFFFF
(1436509052.010000) can0 062#010002000300
(1436509052.020000) can0 300#02090064000080BF
(1436509052.030000) can0 301#01800000FFFFFF7F
(1436509052.040000) can0 7FF#DEADBEEF
(1436509052.050000) can0 060#0102
not a line of a log
(1436509052.060000) can0 1C0#0100FFFF
(1436509052.070000) can0 001#002407
(1436509052.080000) can0 1C0#0100FFFF
(1436509052.090000) can0 20000004#0004000000000000
(1436509052.100000) can1 400#
(1436509052.110000) can1 700#R
"""


@pytest.fixture
def spec(tmp_path: Path) -> Path:
    """A file that declares the protocols `arm` (CAN) and `line` (serial)."""
    path = tmp_path / "my_spec.py"
    path.write_text(SPEC, encoding="utf-8")
    return path


@pytest.fixture
def arm(spec: Path) -> str:
    """What -p takes for the protocol on CAN."""
    return f"{spec}:arm"


@pytest.fixture
def line(spec: Path) -> str:
    """What -p takes for the protocol on a serial line."""
    return f"{spec}:line"


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """A candump log with one line of each kind."""
    path = tmp_path / "walk.log"
    path.write_text(LOG, encoding="utf-8")
    return path


@pytest.fixture
def node() -> Iterator[Node]:
    """Another node of a virtual bus."""
    made = Node()
    yield made
    made.close()


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch) -> Iterator[Opened]:
    """Set once the command has opened its bus."""
    made = Opened(monkeypatch)
    yield made
    made.join()


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """A command that ends waits for its gate's reader, which looks up so often."""
    for module in ("can", "gate", "serial", "datagram"):
        monkeypatch.setattr(f"aces_bus.hardware.{module}.POLL_S", 0.02)


@pytest.fixture
def pty() -> Iterator[tuple[int, str]]:
    """The far end of a serial line, and the name of the near one."""
    tty = pytest.importorskip("tty")
    far, near = os.openpty()
    tty.setraw(near)
    yield far, os.ttyname(near)
    for end in (far, near):
        os.close(end)
