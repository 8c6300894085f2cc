"""dronecan, unmodified: its node commands our twins of ESCs and reads them, and is an ESC that our driver commands.

Its times are real ones: what is asserted is order and content, with limits that a slow machine keeps.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Generator
from contextlib import contextmanager
from functools import partial
from typing import Any

import can
import pytest

from aces_bus.robot import connect, parse_robot
from aces_devices.dronecan_esc import EXAMPLE
from aces_protocols.dronecan.spec import MOST_ESCS, raw_command
from aces_protocols.dronecan.spec import dronecan as spec
from tests.oracles.dronecan_bus import BusDriver
from tests.oracles.foreign import oracle
from tests.oracles.served import port_on, served, wait_until

dronecan: Any = oracle("dronecan", "dronecan")
CHANNEL: dict[str, Any] = {"interface": "aces", "channel": "copter", "physics": False}
pytestmark = pytest.mark.slow


@contextmanager
def node_of(number: int, **channel: Any) -> Generator[Any]:
    """A node of dronecan; it runs while it is spun."""
    made = dronecan.node.Node(BusDriver(can.Bus(**channel)), node_id=number)
    try:
        yield made
    finally:
        made.close()


def spun_until(node: Any, is_so: Callable[[], Any]) -> None:
    """Run a node until something is so."""

    def run() -> Any:
        node.spin(0)
        return is_so()

    wait_until(run)


def test_its_node_commands_our_twins_and_reads_them() -> None:
    """Two of a list's throttles are obeyed, each by its place; speed, current, temperature and name are the twins'."""
    with served(EXAMPLE) as made, node_of(10, interface="aces", channel=made.channel) as node:
        found: dict[int, Any] = {}
        alive: dict[int, Any] = {}
        names: list[str] = []
        esc, protocol = dronecan.uavcan.equipment.esc, dronecan.uavcan.protocol
        node.add_handler(
            esc.Status, lambda event: found.update({event.transfer.source_node_id: event.message})
        )
        node.add_handler(
            protocol.NodeStatus, lambda event: alive.update({event.transfer.source_node_id: event.message})
        )

        def turning() -> bool:
            node.broadcast(esc.RawCommand(cmd=[4000, 0, 0, -2000]), priority=8)
            return {20, 21} <= set(found) and abs(found[20].rpm - 1953) < 20 and abs(found[21].rpm + 977) < 20

        spun_until(node, turning)
        assert (found[20].esc_index, found[21].esc_index) == (0, 3)
        twins: Any = made.twins
        assert made.call(lambda: twins["FRONT"].throttle) in (4000, 0)
        assert found[20].current == pytest.approx(20 * 4000 / 8191, rel=0.01)
        assert found[20].temperature == pytest.approx(305 + 20 * 4000 / 8191, abs=0.3)
        assert (found[20].power_rating_pct, found[21].power_rating_pct) == (49, 24)
        spun_until(node, lambda: {20, 21} <= set(alive))
        assert alive[20].health == protocol.NodeStatus().HEALTH_OK

        def answered(event: Any) -> None:
            if event is not None:
                names.append(bytes(event.response.name).decode())

        node.request(protocol.GetNodeInfo.Request(), 21, answered)
        spun_until(node, lambda: names)
        assert names == ["org.aces.twin.esc"]


def test_lists_of_all_lengths_are_its_bytes() -> None:
    """Throttles for 1 to 20 controllers, drawn: its frames are ours, and our scanner has its numbers."""
    dice = random.Random(1)
    for count in range(1, MOST_ESCS + 1):
        wanted = [dice.randrange(-8192, 8192) for _ in range(count)]
        command = dronecan.uavcan.equipment.esc.RawCommand(cmd=wanted)
        transfer = dronecan.transport.Transfer(
            payload=command, source_node_id=10, transfer_priority=8, service_not_message=False
        )
        theirs = [(frame.message_id, bytes(frame.bytes)) for frame in transfer.to_frames()]
        given: Any = wanted[0] if count == 1 else wanted
        ours: Any = spec.encode(raw_command(count), priority=8, host=10, commands=given)
        assert [(frame.arbitration_id, bytes(frame.data)) for frame in ours] == theirs
        (record,) = spec.scanner().feed(ours)
        assert record.commands == (given if count == 1 else tuple(wanted))


def test_our_driver_commands_its_node() -> None:
    """Nothing before `enable`; throttles as we set them, 0 as we stop; what it measures is in our signals in SI units."""
    text = "\n".join(line for line in EXAMPLE.splitlines() if "BACK" not in line)
    robot, problems = parse_robot(text)
    assert robot is not None, problems
    with node_of(20, **CHANNEL) as node, port_on(CHANNEL) as port:
        node.node_info.name = "an ESC of theirs"
        node.node_info.software_version.major = 7
        node.mode = dronecan.uavcan.protocol.NodeStatus().MODE_OPERATIONAL
        esc = dronecan.uavcan.equipment.esc
        lists: list[list[int]] = []
        node.add_handler(esc.RawCommand, lambda event: lists.append(list(event.message.cmd)))
        with connect(robot, {"arms": port}, rate_hz=50) as rig:
            device: Any = rig.devices["FRONT"]

            def value(name: str) -> Any:
                return rig.clock.call(lambda: rig.devices["FRONT"].signals[name].last)

            def has_come() -> bool:
                node.broadcast(
                    esc.Status(
                        error_count=2,
                        voltage=24.5,
                        current=3.5,
                        temperature=310.0,
                        rpm=-1200,
                        power_rating_pct=33,
                    )
                )
                return bool(value("FRONT.voltage") == 24.5)

            def is_over(job: Any) -> bool:
                return has_come() and job.state != "waiting"

            spun_until(node, has_come)
            assert value("ROTOR_FRONT.velocity") == pytest.approx(-125.6637)
            assert (value("FRONT.current"), value("FRONT.temperature"), value("FRONT.errors")) == (
                3.5,
                310.0,
                2,
            )
            assert value("FRONT.power") == pytest.approx(0.33)
            assert lists == []
            for action in ("info", "enable"):
                job = rig.clock.call(getattr(device, action))
                spun_until(node, partial(is_over, job))
                result = job.wait(1)
                if action == "info":
                    assert (result["name"], result["software"]) == ("an ESC of theirs", "7.0")
            rig.clock.call(lambda: device.signals["ROTOR_FRONT.duty"].set(0.5))
            spun_until(node, lambda: has_come() and [4096, 0] in lists)
            rig.clock.call(device.stop_motion)
            spun_until(node, lambda: has_come() and lists[-1] == [0, 0])
