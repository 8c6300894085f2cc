"""Feetech's servo kit (feetech-servo-sdk), unmodified, on a pseudo-terminal with our twins.

1. Real time: only content and order are asserted. The kit's patience, a constant of its port module, is longer here.
"""

from __future__ import annotations

from typing import Any

import pytest

from aces_bus import Unknown
from aces_devices.feetech import driver
from tests.oracles.foreign import oracle
from tests.oracles.serial_lines import OpenLine, served_line

sdk: Any = oracle("scservo_sdk", "feetech-servo-sdk")
port_module: Any = oracle("scservo_sdk.port_handler", "feetech-servo-sdk")

LINE = """
name = "pair"
rate_hz = 50
[buses]
line = {{ link = "serial", protocol = "feetech", baud = 1_000_000 }}
[devices]
F1 = {{ driver = "feetech", bus = "line", model = "{model}", credentials = {{ id = 1 }} }}
F2 = {{ driver = "feetech", bus = "line", model = "{model}", credentials = {{ id = 2 }} }}
[joints]
J1 = {{ device = "F1", zero = 1.5707963267948966 }}
J2 = {{ device = "F2", zero = 1.5707963267948966 }}
"""
#: How long the kit waits for an answer (ms); half of it, as it doubles the latency of an adapter.
PATIENCE_MS = 5_000
P_GAIN, HOMING, TORQUE, GOAL, SPEED, POSITION, VOLTAGE = 21, 31, 40, 42, 46, 56, 62
#: The kit's byte orders.
STS, SCS = 0, 1


@pytest.fixture(autouse=True)
def patience(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(port_module, "LATENCY_TIMER", PATIENCE_MS / 2)


def opened(line: OpenLine) -> Any:
    port = sdk.PortHandler(line.path)
    assert port.openPort()
    return port


def names(line: OpenLine) -> list[str]:
    found = line.records()
    assert [one for one in found if isinstance(one, Unknown)] == []
    return [type(one).__name__ for one in found]


def test_it_moves_and_reads_sts_servos() -> None:
    """Ping, registers of one and of many; each of its packets is one of our messages."""
    with served_line(LINE.format(model="STS3215"), driver) as line:
        port, kit = opened(line), sdk.PacketHandler(STS)
        assert kit.ping(port, 1) == (777, 0, 0)
        assert kit.read2ByteTxRx(port, 2, POSITION) == (1024, 0, 0)
        assert kit.write1ByteTxRx(port, 1, P_GAIN, 16) == (0, 0)
        assert kit.write2ByteTxRx(port, 2, HOMING, sdk.SCS_TOSCS(-347, 11)) == (0, 0)
        assert kit.read2ByteTxRx(port, 2, POSITION) == (1371, 0, 0)
        assert kit.write1ByteTxRx(port, 1, TORQUE, 1) == (0, 0)
        assert kit.regWriteTxRx(port, 1, GOAL, 2, [0, 8]) == (0, 0)
        assert kit.read2ByteTxRx(port, 1, GOAL)[0] == 1024
        assert kit.action(port, sdk.BROADCAST_ID) == 0
        assert kit.read2ByteTxRx(port, 1, GOAL)[0] == 2048
        write = sdk.GroupSyncWrite(port, kit, GOAL, 2)
        for number, goal in ((1, 1100), (2, 1200)):
            assert write.addParam(number, [sdk.SCS_LOBYTE(goal), sdk.SCS_HIBYTE(goal)])
        assert write.txPacket() == 0
        read = sdk.GroupSyncRead(port, kit, GOAL, 2)
        assert read.addParam(2)
        assert read.addParam(1)
        assert read.txRxPacket() == 0
        assert [read.getData(number, GOAL, 2) for number in (1, 2)] == [1100, 1200]
        with line.lock:
            line.twins["F1"].fault("overload")
        assert (
            kit.getRxPacketError(kit.read1ByteTxRx(port, 1, VOLTAGE)[2]) == "[RxPacketError] Overload error!"
        )
        port.closePort()
        sent = [name for name in names(line) if name != "Status"]
        assert sent == [
            *(
                "Ping",
                "Read",
                "Read",
                "Write",
                "Write",
                "Read",
                "Write",
                "RegWrite",
                "Read",
                "Action",
                "Read",
            ),
            *("SyncWrite", "SyncRead", "Read"),
        ]


def test_it_moves_and_reads_scs_servos() -> None:
    """The other byte order: model, position and goal are those of the twins."""
    with served_line(LINE.format(model="SCS0009"), driver) as line:
        port, kit = opened(line), sdk.PacketHandler(SCS)
        assert kit.ping(port, 1) == (1284, 0, 0)
        assert kit.read2ByteTxRx(port, 1, POSITION) == (307, 0, 0)
        assert kit.write1ByteTxRx(port, 1, TORQUE, 1) == (0, 0)
        assert kit.write2ByteTxRx(port, 1, GOAL, 512) == (0, 0)
        with line.lock:
            assert line.twins["F1"]["goal_position"] == 512  # type: ignore[index]
        port.closePort()
        assert names(line) == ["Ping", "Status", *["Read", "Status"] * 2, *["Write", "Status"] * 2]
