"""Robotis' DynamixelSDK, unmodified, on a pseudo-terminal with our twins: what it sends we decode, what it reads they say.

1. Real time: only content and order are asserted. The kit's patience, a constant of its port module, is longer here.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from aces_bus import Unknown
from aces_devices.dynamixel import driver
from tests.oracles.foreign import oracle
from tests.oracles.serial_lines import OpenLine, served_line

sdk: Any = oracle("dynamixel_sdk", "dynamixel-sdk")
port_module: Any = oracle("dynamixel_sdk.port_handler", "dynamixel-sdk")

PAIR = """
name = "pair"
rate_hz = 50
[buses]
line = { link = "serial", protocol = "dynamixel", baud = 1_000_000 }
[devices]
D1 = { driver = "dynamixel", bus = "line", model = "XM430-W350", credentials = { id = 1 } }
D2 = { driver = "dynamixel", bus = "line", model = "XL330-M288", credentials = { id = 2 } }
[joints]
J1 = { device = "D1", zero = 3.141592653589793 }
J2 = { device = "D2", zero = 3.141592653589793 }
"""
#: How long the kit waits for an answer (ms); half of it, as it doubles the latency of an adapter.
PATIENCE_MS = 5_000
TORQUE, LED, GOAL_VELOCITY, GOAL, POSITION, VOLTAGE, TEMPERATURE = 64, 65, 104, 116, 132, 144, 146


@pytest.fixture
def line(monkeypatch: pytest.MonkeyPatch) -> Iterator[OpenLine]:
    monkeypatch.setattr(port_module, "LATENCY_TIMER", PATIENCE_MS / 2)
    with served_line(PAIR, driver) as line:
        yield line


@pytest.fixture
def port(line: OpenLine) -> Iterator[Any]:
    opened = sdk.PortHandler(line.path)
    opened.baudrate = 1_000_000
    assert opened.openPort()
    yield opened
    opened.closePort()


def names(line: OpenLine) -> list[str]:
    found = line.records()
    assert [one for one in found if isinstance(one, Unknown)] == []
    return [type(one).__name__ for one in found]


def test_it_finds_moves_and_reads_our_twins(line: OpenLine, port: Any) -> None:
    """Ping, read, write, refusals and held-back writes; each of its packets is one of our messages."""
    kit = sdk.PacketHandler(2.0)
    assert kit.ping(port, 1) == (1020, 0, 0)
    assert kit.ping(port, 2) == (1200, 0, 0)
    assert kit.read4ByteTxRx(port, 1, POSITION) == (2048, 0, 0)
    assert kit.write1ByteTxRx(port, 1, TORQUE, 1) == (0, 0)
    assert kit.write4ByteTxRx(port, 1, GOAL, 2100) == (0, 0)
    assert kit.read1ByteTxRx(port, 1, TEMPERATURE) == (line.twins["D1"]["present_temperature"], 0, 0)  # type: ignore[index]
    result, error = kit.write4ByteTxRx(port, 1, GOAL, 5000)
    assert (result, kit.getRxPacketError(error)) == (
        0,
        "[RxPacketError] The data value exceeds the limit value!",
    )
    result, error = kit.write2ByteTxRx(port, 1, VOLTAGE, 1)
    assert (result, error) == (0, sdk.protocol2_packet_handler.ERRNUM_ACCESS)
    assert kit.regWriteTxRx(port, 1, LED, 1, [1]) == (0, 0)
    assert kit.read1ByteTxRx(port, 1, LED)[0] == 0
    assert (
        kit.action(port, sdk.BROADCAST_ID) == 0
    )  # to one servo it is answered, and the kit does not wait for that
    assert kit.read1ByteTxRx(port, 1, LED)[0] == 1
    assert kit.reboot(port, 1) == (0, 0)
    assert kit.read1ByteTxRx(port, 1, TORQUE)[0] == 0
    assert kit.clearMultiTurn(port, 1) == (0, 0)
    assert kit.factoryReset(port, 2, 0x02) == (0, 0)
    sent = [type(one).__name__ for one in line.records("to device") if type(one).__name__ != "Unknown"]
    assert sent == [
        *("Ping", "Ping", "Read", "Write", "Write", "Read", "Write", "Write", "RegWrite", "Read", "Action"),
        *("Read", "Reboot", "Read", "Clear", "FactoryReset"),
    ]
    assert names(line).count("Status") == len(sent) - 1


def test_it_asks_and_tells_many_at_once(line: OpenLine, port: Any) -> None:
    """Sync and bulk, plain and fast: goals arrive, positions and temperatures are those of the twins."""
    kit = sdk.PacketHandler(2.0)
    for number in (1, 2):
        assert kit.write1ByteTxRx(port, number, TORQUE, 1) == (0, 0)
    write = sdk.GroupSyncWrite(port, kit, GOAL, 4)
    for number, goal in ((1, 2000), (2, 2100)):
        assert write.addParam(number, list(goal.to_bytes(4, "little")))
    assert write.txPacket() == 0
    read = sdk.GroupSyncRead(port, kit, GOAL, 4)
    assert read.addParam(2)
    assert read.addParam(1)
    assert read.txRxPacket() == 0
    assert [read.getData(number, GOAL, 4) for number in (1, 2)] == [2000, 2100]
    assert read.fastSyncRead() == 0
    assert [read.getData(number, GOAL, 4) for number in (1, 2)] == [2000, 2100]
    together = sdk.GroupBulkWrite(port, kit)
    assert together.addParam(1, GOAL, 4, list((2050).to_bytes(4, "little")))
    assert together.addParam(2, LED, 1, [1])
    assert together.txPacket() == 0
    bulk = sdk.GroupBulkRead(port, kit)
    assert bulk.addParam(1, GOAL, 4)
    assert bulk.addParam(2, LED, 1)
    assert bulk.txRxPacket() == 0
    assert (bulk.getData(1, GOAL, 4), bulk.getData(2, LED, 1)) == (2050, 1)
    assert bulk.fastBulkRead() == 0
    assert (bulk.getData(1, GOAL, 4), bulk.getData(2, LED, 1)) == (2050, 1)
    assert names(line) == [
        *("Write", "Status", "Write", "Status", "SyncWrite", "SyncRead", "Status", "Status"),
        *(
            "FastSyncRead",
            "FastSyncStatus",
            "BulkWrite",
            "BulkRead",
            "Status",
            "Status",
            "FastBulkRead",
            "FastStatus",
        ),
    ]


def test_it_finds_all_by_a_broadcast(line: OpenLine, port: Any) -> None:
    """Both twins answer in turn, and the kit lists them with model and firmware."""
    found, result = sdk.PacketHandler(2.0).broadcastPing(port)
    assert (result, found) == (0, {1: [1020, 46], 2: [1200, 46]})
    assert names(line) == ["Ping", "Status", "Status"]
