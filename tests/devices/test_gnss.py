"""Receivers of satellite navigation: what is known, when it is not, and that both protocols say the same."""

from __future__ import annotations

from math import degrees, radians
from typing import Any

import pytest

from aces_bus import as_dict, make_scanner
from aces_bus.device import UNKNOWN, Robot
from aces_bus.errors import CallerError, DeviceError
from aces_bus.protocol import Record
from aces_bus.robot import VirtualRobot, parse_robot
from aces_bus.testing import driver_tests
from aces_devices.gnss.antenna import BEGIN, AntennaMotion, in_circle
from aces_devices.gnss.earth import Origin
from aces_devices.gnss.nmea0183 import driver as sentences_driver
from aces_devices.gnss.ubx import driver as ubx_driver
from aces_protocols.nmea0183.spec import nmea0183
from aces_protocols.ubx.spec import ubx

test_ubx = driver_tests(ubx_driver)
test_nmea0183 = driver_tests(sentences_driver)

DRIVERS = pytest.mark.parametrize("driver", [ubx_driver, sentences_driver], ids=lambda driver: driver.name)
#: What a position's last digit and the twin's noise make of it (m).
NEAR_M = 0.15


def robot_of(text: str) -> Robot:
    robot, problems = parse_robot(text)
    assert robot is not None, problems
    return robot


def values(robot: VirtualRobot) -> dict[str, Any]:
    return {name.partition(".")[2]: one.value for name, one in robot.devices["GNSS"].signals.items()}


@DRIVERS
def test_a_moving_receiver_is_where_it_is(driver: Any) -> None:
    """Place, speed, course and metres from the origin are those of the twin's antenna at its last solution."""
    with VirtualRobot(robot_of(driver.example), load={driver.name: driver}.__getitem__) as robot:
        twin: Any = robot.twins["GNSS"]
        twin.feed = in_circle(20.0, 60.0)
        period = 1 / twin.settings.rate_hz
        robot.advance(15.0 + 0.9 * period)
        found = values(robot)
        truth = twin.feed(15_000_000_000)
        assert (found["north"], found["east"], found["up"]) == pytest.approx(
            (truth.north, truth.east, 0), abs=NEAR_M
        )
        latitude, longitude = twin.origin.place(truth.north, truth.east)
        assert (found["latitude"], found["longitude"]) == pytest.approx(
            (latitude, longitude), abs=NEAR_M / 6e6
        )
        assert found["height"] == pytest.approx(520, abs=NEAR_M)
        assert found["altitude"] == pytest.approx(475, abs=NEAR_M)
        assert (found["velocity_north"], found["velocity_east"]) == pytest.approx((-2.094, 0), abs=0.06)
        assert found["speed"] == pytest.approx(2.094, abs=0.06)
        assert degrees(found["course"]) == pytest.approx(180, abs=3)
        assert found["time"] == pytest.approx(BEGIN.timestamp() + 15, abs=0.01)
        assert (found["fix"], found["quality"], found["satellites"]) == ("fix_3d", "gps", 8)
        assert found["horizontal_accuracy"] == pytest.approx(0.8, abs=0.001)


@DRIVERS
def test_without_a_fix_there_is_no_place(driver: Any) -> None:
    """Indoors the place is unknown with the next solution; time and satellites are said as far as they are known."""
    with VirtualRobot(robot_of(driver.example), load={driver.name: driver}.__getitem__) as robot:
        robot.advance(2.0)
        assert values(robot)["latitude"] is not UNKNOWN
        robot.twins["GNSS"].fault("no_fix")
        robot.advance(0.6)
        found = values(robot)
        for name in (
            "latitude",
            "longitude",
            "height",
            "altitude",
            "north",
            "east",
            "speed",
            "course",
            "velocity_north",
        ):
            assert found[name] is UNKNOWN, name
        assert found["horizontal_accuracy"] is UNKNOWN
        assert (found["fix"], found["quality"], found["satellites"]) == ("none", "none", 0)
        robot.twins["GNSS"].fault("no_fix", on=False)
        robot.advance(1.0)
        assert values(robot)["latitude"] is not UNKNOWN


def test_a_place_of_a_vehicle_is_asked_in_the_world() -> None:
    """A vehicle's twin says where it is to whoever asks: it need not know the receiver."""
    with VirtualRobot(robot_of(ubx_driver.example)) as robot:
        robot.simulation.world.shared["place"] = lambda now: AntennaMotion(north=3.0, up=1.0, velocity_up=0.5)
        robot.advance(1.0)
        found = values(robot)
        assert (found["north"], found["east"], found["up"]) == pytest.approx((3, 0, 1), abs=NEAR_M)
        assert found["velocity_down"] == pytest.approx(-0.5, abs=0.05)


def heard(robot: VirtualRobot, *records: tuple[str, dict[str, Any]]) -> None:
    """Have the host receive messages as if a receiver had sent them."""
    host = robot.rig.hosts["gnss"]
    for name, fields in records:
        for record in host.scanner.feed(next(iter(host.variants.values())).encoder.encode(name, **fields)):
            host.deliver(record, host.clock.now())


def test_a_time_counts_when_all_of_it_is_certain() -> None:
    """A date without a time of day, or a second that may be another, is not a time; fractions may be negative."""
    with VirtualRobot(robot_of(ubx_driver.example)) as robot:
        twin: Any = robot.twins["GNSS"]
        twin.power(False)
        robot.advance(0.1)
        scanner = ubx.scanner(direction="from device")
        (record,) = scanner.feed(ubx["NavPvt"].examples[0].packet.data)
        pvt = as_dict(record)
        heard(robot, ("NavPvt", pvt))
        assert values(robot)["time"] == pytest.approx(BEGIN.timestamp() - 1234e-9, abs=5e-7)
        for valid in (["date"], ["time"], ["date", "time"]):
            heard(robot, ("NavPvt", {**pvt, "valid": valid}))
            assert values(robot)["time"] is UNKNOWN, valid
        heard(robot, ("NavPvt", {**pvt, "flags": {**pvt["flags"], "carrier": "fixed"}}))
        assert values(robot)["quality"] == "rtk_fixed"
        heard(robot, ("NavPvt", {**pvt, "flags3": {**pvt["flags3"], "invalid_position": 1}}))
        assert values(robot)["latitude"] is UNKNOWN


def test_rmc_alone_has_a_place() -> None:
    """A receiver that sends nothing but RMC is located all the same; of one that sends GGA, RMC moves nothing."""
    with VirtualRobot(robot_of(sentences_driver.example)) as robot:
        robot.twins["GNSS"].power(False)
        robot.advance(0.1)
        scanner = nmea0183.scanner()
        records = [scanner.feed(nmea0183[name].examples[0].packet.data)[0] for name in ("RMC", "GGA")]
        rmc, gga = map(as_dict, records)
        heard(robot, ("RMC", rmc))
        found = values(robot)
        assert (degrees(found["latitude"]), degrees(found["longitude"])) == pytest.approx(
            (53.450657, -2.24041)
        )
        assert found["speed"] == pytest.approx(0.023664, abs=1e-6)
        assert (found["course"], found["velocity_north"]) == (UNKNOWN, UNKNOWN)
        assert found["time"] == 1615026967.0
        heard(robot, ("GGA", gga), ("RMC", rmc))
        assert degrees(values(robot)["latitude"]) == pytest.approx(48.1173)
        heard(robot, ("RMC", {**rmc, "status": "void"}))
        assert (values(robot)["latitude"], values(robot)["time"]) == (UNKNOWN, UNKNOWN)


def test_sentences_and_packets_of_one_solution_agree() -> None:
    """A receiver that is set to send sentences besides sends both of the same epoch."""
    with VirtualRobot(robot_of(ubx_driver.example)) as robot:
        device: Any = robot.devices["GNSS"]
        twin: Any = robot.twins["GNSS"]
        seen: list[Record] = []
        scanner = make_scanner([ubx.variant(), nmea0183.variant()], direction="from device")
        port = twin.twins.port
        send = port.send

        def noted(packet: bytes) -> bool:
            seen.extend(scanner.feed(packet))
            return bool(send(packet))

        port.send = noted
        twin.feed = in_circle(10, 30)
        for number in (0, 4, 8):
            device.ask(
                "CfgMsg", reply=("Ack", "Nak"), message_group=0xF0, message_number=number, rate=1
            ).wait(2)
        robot.advance(1.0)
        solutions: dict[str, dict[str, Any]] = {}
        for record in seen:
            name, fields = type(record).__name__, as_dict(record)
            if name == "NavPvt":
                second = f"{fields['hour']:02}{fields['minute']:02}{fields['second']:02}"
                fields["time"] = f"{second}.{fields['nano'] // 10_000_000:02}"
            if "time" in fields:
                solutions.setdefault(fields["time"], {})[name] = fields
        whole = [found for found in solutions.values() if len(found) == 4]
        assert len(whole) >= 4
        for found in whole:
            pvt, gga, rmc, zda = (found[name] for name in ("NavPvt", "GGA", "RMC", "ZDA"))
            assert (gga["lat"], gga["lon"]) == pytest.approx((pvt["lat"], pvt["lon"]), abs=2e-7)
            assert (gga["lat"], gga["lon"]) == (rmc["lat"], rmc["lon"])
            assert gga["altitude"] == pytest.approx(pvt["height_msl"] / 1e3, abs=0.06)
            assert rmc["speed"] * 1852 / 3600 == pytest.approx(pvt["ground_speed"] / 1e3, abs=0.001)
            assert (zda["year"], zda["month"], zda["day"]) == (2024, 3, 15)
            assert rmc["date"] == "150324"


def test_what_a_receiver_does_not_have_is_refused() -> None:
    """A rate beyond its own, a message or setting that it does not know: Nak, and the action says which."""
    text = ubx_driver.example.replace("rate_hz = 5, configure = true", "rate_hz = 100")
    with VirtualRobot(robot_of(text)) as robot:
        device: Any = robot.devices["GNSS"]
        with pytest.raises(DeviceError, match=r"GNSS refuses CfgRate \(period = 10, "):
            device.configure().wait(5)
        for fields in (
            {"message_group": 0x66, "message_number": 1, "rate": 1},
            {"message_group": 1, "message_number": 0x99, "rate": 2},
        ):
            answer = device.ask("CfgMsg", reply=("Ack", "Nak"), **fields).wait(2)
            assert type(answer).__name__ == "Nak"
        assert device.version().wait(2).hardware == "00190000"
        assert device.rate().wait(2).period == 10
        robot.rig.hosts["gnss"].port.send(bytes.fromhex("B5620624000 02A84".replace(" ", "")))
        robot.advance(0.1)


def test_metres_are_those_of_the_ellipsoid() -> None:
    """A degree of latitude is 110.574 km at the equator and 111.694 km at a pole; there and back is the same place."""
    for latitude, metres in ((0.0, 110_574), (90.0, 111_694)):
        here = Origin(radians(latitude), 0.0)
        north, _ = here.metres(radians(latitude + 0.001), 0.0)
        assert north * 1000 == pytest.approx(metres, abs=2)
    here = Origin(radians(-33.9), radians(151.2), 50.0)
    assert here.metres(*here.place(1234.0, -567.0)) == pytest.approx((1234, -567))


def test_an_origin_is_on_the_earth() -> None:
    """What is not a place is refused by name."""
    text = ubx_driver.example.replace("[48.0, 11.0, 520.0]", "[148.0, 11.0]")
    with pytest.raises(CallerError, match=r"148\.0, 11\.0\] is not a place on the Earth"):
        VirtualRobot(robot_of(text))
