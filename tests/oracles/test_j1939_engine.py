"""can-j1939, unmodified: its unit hears and asks our twin of an engine, and is an engine for our driver.

1. Its times are real ones: what is asserted is order and content, with limits that a slow machine keeps.
2. It reads faults, names, numbers and sessions by itself; numbers of EEC1 and ET1 are read by struct.
"""

from __future__ import annotations

import struct
import time
from collections.abc import Generator
from contextlib import contextmanager
from typing import Any

import can
import pytest

from aces_bus.device import Robot
from aces_bus.errors import DeviceError
from aces_bus.robot import connect, parse_robot
from aces_devices.j1939_engine import EXAMPLE
from tests.oracles.foreign import oracle
from tests.oracles.served import PATIENCE_S, port_on, served, wait_until

j1939: Any = oracle("j1939", "can-j1939")
TOOL, ENGINE = 0xF9, 0x10
CHANNEL: dict[str, Any] = {"interface": "aces", "channel": "engine", "physics": False}
FAULTS = {(110, 0): 3, (100, 1): 1, (0x7F005, 31): 126}
pytestmark = pytest.mark.slow


@contextmanager
def application(address: int, **channel: Any) -> Generator[Any]:
    """Their control unit with one application at an address."""
    unit = j1939.ElectronicControlUnit()
    unit.connect(**channel)
    name = j1939.Name(identity_number=7, manufacturer_code=666, function=1, industry_group=1)
    made = j1939.ControllerApplication(name, address, bypass_address_claim=True)
    unit.add_ca(controller_application=made)
    try:
        yield made
    finally:
        unit.stop()
        unit.disconnect()


def test_it_hears_and_asks_our_twin() -> None:
    """Speed and temperature, faults in a session with their lamps, the vehicle's number, the name, a refusal."""
    with served(EXAMPLE) as made, application(TOOL, interface="aces", channel=made.channel) as theirs:
        groups: dict[int, bytes] = {}
        faults: list[Any] = []

        def take(priority: int, pgn: int, source: int, timestamp: float, data: Any) -> None:
            if source == 0:
                groups[pgn] = bytes(data)

        theirs.subscribe(take)
        j1939.Dm1(theirs).subscribe(lambda source, lamps, found, _: faults.append((source, lamps, found)))
        twin: Any = made.twins["ENGINE"]

        def begin() -> None:
            twin.pedal = 0.5
            twin.active.update(FAULTS)

        made.call(begin)
        wait_until(lambda: struct.unpack_from("<H", groups.get(0xF004, bytes(8)), 3)[0] * 0.125 > 1400)
        rpm = struct.unpack_from("<H", groups[0xF004], 3)[0] * 0.125
        assert rpm == pytest.approx(made.call(lambda: twin.rpm), abs=30)
        wait_until(lambda: 0xFEEE in groups)
        assert groups[0xFEEE][0] - 40 == pytest.approx(made.call(lambda: twin.coolant_c), abs=1)
        wait_until(lambda: [found for source, _, found in faults if source == 0 and len(found) == 3])
        _, lamps, found = next(one for one in faults if one[0] == 0 and len(one[2]) == 3)
        assert {(fault["spn"], fault["fmi"]): fault["oc"] for fault in found} == FAULTS
        lamp = j1939.DtcLamp
        assert (lamps["rsl"], lamps["awl"], lamps["mil"]) == (lamp.ON, lamp.ON, lamp.OFF)

        # Its receiver loses a session that begins right behind another one, if it is busy: it asks again.
        for _ in range(10):
            theirs.send_request(0, 65260, 0)
            end = time.monotonic() + 3
            while 65260 not in groups and time.monotonic() < end:
                time.sleep(0.01)
            if 65260 in groups:
                break
        assert groups[65260] == f"{twin.vin}*".encode()
        seen: dict[int, bytes] = {}
        with can.Bus(interface="aces", channel=made.channel) as listener:
            theirs.send_request(0, 60928, 0)
            theirs.send_request(0, 65242, 0)
            while not {0x18EEFF00, 0x18E8FF00} <= set(seen):
                message = listener.recv(PATIENCE_S)
                assert message is not None
                seen[message.arbitration_id] = bytes(message.data)
        name = j1939.Name(bytes=seen[0x18EEFF00])
        assert (name.identity_number, name.manufacturer_code, name.industry_group) == (1000, 666, 1)
        assert seen[0x18E8FF00] == bytes([1, 0xFF, 0xFF, 0xFF, TOOL, *(65242).to_bytes(3, "little")])


def robot_of_theirs() -> Robot:
    robot, problems = parse_robot(EXAMPLE.replace("ecu = 0,", f"ecu = {ENGINE},"))
    assert robot is not None, problems
    return robot


def test_our_driver_reads_and_asks_their_unit() -> None:
    """What it sends is in our signals in SI units; its number and hours come when we ask, in a session and in a frame."""
    with application(ENGINE, **CHANNEL) as theirs, port_on(CHANNEL) as port:

        def answer(source: int, destination: int, pgn: int) -> None:
            if pgn == 65260:
                theirs.send_pgn(0, 0xFE, 0xEC, 6, list(b"THEIR NUMBER 0123*"))
            elif pgn == 65253:
                theirs.send_pgn(0, 0xFE, 0xE5, 6, [*struct.pack("<I", 72_000), 255, 255, 255, 255])
            elif pgn != 60928:  # that is answered by itself
                theirs.send_pgn(0, 0xE8, 0xFF, 6, [1, 255, 255, 255, source, *pgn.to_bytes(3, "little")])

        theirs.subscribe_request(answer)
        lamps = {"rsl": j1939.DtcLamp.ON}
        faults = [{"spn": spn, "fmi": fmi, "oc": count} for (spn, fmi), count in FAULTS.items()]
        j1939.Dm1(theirs).start_send(lambda: (dict(lamps), [dict(fault) for fault in faults]), 0.5)
        with connect(robot_of_theirs(), {"truck": port}) as rig:
            device: Any = rig.devices["ENGINE"]

            def value(name: str) -> Any:
                return rig.clock.call(lambda: device.signals[f"ENGINE.{name}"].last)

            def has_come() -> bool:
                theirs.send_pgn(
                    0, 0xF0, 0x04, 3, [0xFF, 0xFF, 165, *struct.pack("<H", 12_000), 255, 255, 255]
                )
                theirs.send_pgn(0, 0xFE, 0xEF, 6, [255, 255, 255, 100, 255, 255, 255, 255])
                return bool(value("speed") == pytest.approx(157.0796) and value("oil_pressure") == 400_000)

            wait_until(has_come)
            assert value("torque") == pytest.approx(0.4)
            wait_until(lambda: value("fault_count") == 3)
            assert {(spn, fmi): count for spn, fmi, count in device.faults} == FAULTS
            assert (value("red_stop"), value("malfunction")) == (1, 0)
            assert rig.clock.call(device.vin).wait(PATIENCE_S) == "THEIR NUMBER 0123"
            assert rig.clock.call(device.hours).wait(PATIENCE_S) == pytest.approx(3600 * 3600)
            assert rig.clock.call(device.identity).wait(PATIENCE_S)["manufacturer"] == 666
            with pytest.raises(DeviceError, match="refused"):
                rig.clock.call(lambda: device.job("odd", lambda job: device._group("VehiclePower"))).wait(
                    PATIENCE_S
                )
