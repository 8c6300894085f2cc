"""canopen's client, unmodified, against the twin of a CiA 401 module on a served bus: NMT, SDO, PDOs, heartbeat, EMCY.

Its times are real ones: what is asserted is order and content, with limits that a slow machine keeps.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from importlib.resources import files
from typing import Any, NamedTuple

import pytest

from aces_bus.frames import message_to_frame
from aces_protocols.canopen.spec import canopen as shipped
from tests.oracles.foreign import oracle
from tests.oracles.served import PATIENCE_S, ServedTwins, served, wait_until

canopen = oracle("canopen", "canopen")
NODE = 9
ROBOT = f"""
name = "plant"
[buses]
io = {{ link = "can", protocol = "canopen", bitrate = 500_000 }}
[devices.M]
driver = "cia401"
bus = "io"
credentials = {{ node = {NODE} }}
[devices.M.settings.channels]
full = {{ kind = "digital_input", number = 10 }}
valve = {{ kind = "digital_output", number = 1 }}
level = {{ kind = "analog_input", number = 1, unit = "m", scale = 0.001 }}
heater = {{ kind = "analog_output", number = 2, unit = "V", scale = 0.001 }}
"""


class Bench(NamedTuple):
    """The twin's side, and canopen's node."""

    side: ServedTwins
    network: Any
    node: Any

    @property
    def twin(self) -> Any:
        return self.side.twins["M"]


@pytest.fixture
def bench() -> Iterator[Bench]:
    with served(ROBOT) as side:
        network = canopen.Network()
        network.connect(interface="aces", channel=side.channel)
        try:
            with (files("aces_devices.cia401") / "module.eds").open() as eds:
                node = canopen.RemoteNode(NODE, canopen.import_od(eds, NODE))
            network.add_node(node)
            node.sdo.RESPONSE_TIMEOUT = PATIENCE_S
            yield Bench(side, network, node)
        finally:
            network.disconnect()


def test_objects_over_sdo(bench: Bench) -> None:
    """What canopen reads is what the twin has; what it writes the twin has; what it may not is refused by its code."""
    node, side, twin = bench.node, bench.side, bench.twin
    assert node.sdo[0x1000].raw == 0x000F0191
    side.call(lambda: (twin.put("full", True), twin.put("level", -1.5)))
    assert (node.sdo[0x6000][2].raw, node.sdo[0x6401][1].raw) == (0b10, -1500)
    node.sdo[0x6200][1].raw = 0b1
    node.sdo[0x6411][2].raw = -2500
    assert (twin.take("valve"), twin.take("heater")) == (True, -2.5)
    assert (node.sdo[0x6200][1].raw, node.sdo[0x6411][2].raw) == (0b1, -2500)
    with pytest.raises(canopen.SdoAbortedError, match="0x06010002"):
        node.sdo[0x6000][1].raw = 1
    with node.sdo.open(0x1008, 0, "r", block_transfer=True) as stream:
        assert stream.read() == "aces-bus module"


def test_pdos_both_ways(bench: Bench) -> None:
    """canopen's own PDO objects: an input's change arrives, outputs that it transmits are taken; ours is what it prints."""
    node, side, twin = bench.node, bench.side, bench.twin
    node.tpdo.read()
    node.rpdo.read()
    node.sdo[0x6423].raw = True
    node.nmt.state = "OPERATIONAL"
    wait_until(lambda: twin.node.nmt.state == "OPERATIONAL")
    received: list[tuple[Any, Any]] = []
    node.tpdo[1].add_callback(lambda pdo: received.append(("digital", [one.raw for one in pdo])))
    node.tpdo[2].add_callback(lambda pdo: received.append(("analog", [one.raw for one in pdo])))
    side.call(lambda: (twin.put("full", True), twin.put("level", 1.5)))
    wait_until(lambda: len(received) == 2)
    assert received == [("digital", [0, 0b10]), ("analog", [1500, 0, 0, 0])]
    node.rpdo[1][0].raw = 0b1
    node.rpdo[1].transmit()
    node.rpdo[2][1].raw = 2500
    node.rpdo[2].transmit()
    wait_until(lambda: twin.take("heater") == 2.5)
    assert twin.take("valve") is True
    sent = [message_to_frame(one) for one in side.frames()]
    pdos = [one for one in shipped.scanner().feed(sent) if "pdo" in type(one).__name__]
    assert [(type(one).__name__, one.data.hex()) for one in pdos] == [
        ("Tpdo1", "0002"),
        ("Tpdo2", "dc05000000000000"),
        ("Rpdo1", "0100"),
        ("Rpdo2", "0000c409"),
    ]


def test_outputs_are_safe_when_the_host_is_gone(bench: Bench) -> None:
    """canopen's heartbeat stops: outputs take what it has written as their error values, and it has the emergency."""
    node, twin, network = bench.node, bench.twin, bench.network
    node.sdo[0x6207][1].raw = 0b100
    node.sdo[0x6206][1].raw = 0b0111_1111
    node.sdo[0x1017].raw = 100
    node.nmt.state = "OPERATIONAL"
    node.nmt.wait_for_heartbeat(PATIENCE_S)
    node.sdo[0x6200][1].raw = 0b1000_0011
    node.sdo[0x1016][1].raw = 127 << 16 | 5000
    beat = network.send_periodic(0x77F, b"\x05", 0.05)
    time.sleep(0.3)
    assert twin.numbers[0x6200, 1] == 0b1000_0011
    node.sdo[0x1016][1].raw = 127 << 16 | 50
    beat.stop()
    emergency = node.emcy.wait(0x8130, timeout=PATIENCE_S)
    assert emergency.register == 0x11
    wait_until(lambda: node.nmt.state == "PRE-OPERATIONAL")
    assert node.sdo[0x6200][1].raw == 0b1000_0100
    node.nmt.state = "STOPPED"
    wait_until(lambda: twin.node.nmt.state == "STOPPED")
