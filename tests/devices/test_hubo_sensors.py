"""Hubo's force/torque, tilt, inertial and power boards, their twins, and the pose that feeds those."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from math import radians, sin

import msgspec
import pytest

from aces_bus import Frame, load_robot, make_scanner
from aces_bus.device import UNKNOWN, Robot
from aces_bus.device.twin import World
from aces_bus.errors import CallerError, DeviceError
from aces_bus.hardware import ListeningNode
from aces_bus.robot import VirtualRobot, parse_robot
from aces_bus.runtime import VirtualClock
from aces_bus.testing import driver_tests
from aces_devices.hubo_ft import driver as hubo_ft
from aces_devices.hubo_imu import driver as hubo_imu
from aces_devices.hubo_power import driver as hubo_power
from aces_devices.hubo_sensors.body import BUILD, BodyPose

test_ft = driver_tests(hubo_ft)
test_imu = driver_tests(hubo_imu)
test_power = driver_tests(hubo_power)

DRIVERS = {"hubo_ft": hubo_ft, "hubo_imu": hubo_imu, "hubo_power": hubo_power}


class Still:
    """A joint that stands where it is put."""

    def __init__(self, at: float = 0.0) -> None:
        self.at = at

    def position(self, now: int) -> float:
        return self.at


@cache
def sensors_of(name: str) -> Robot:
    """A shipped robot's sensor and power boards; its motors are away, its joints are `Still`."""
    robot = load_robot(name)
    kept = {n: d for n, d in robot.devices.items() if d.driver in DRIVERS}
    return msgspec.structs.replace(robot, devices=kept)


def assembled(robot: Robot | str, seed: int = 0) -> VirtualRobot:
    if isinstance(robot, str):
        found, problems = parse_robot(robot)
        assert found is not None, problems
        robot = found
    return VirtualRobot(robot, rate_hz=50, load=DRIVERS.__getitem__, seed=seed)


def stand(robot: VirtualRobot, **angles: float) -> None:
    """Put the joints of both legs there."""
    for side in "RL":
        for joint in ("HP", "KN", "AP", "HR", "AR"):
            name = robot.robot.joint(side + joint).name
            robot.simulation.world.joints[name] = Still(angles.get(joint, angles.get(side + joint, 0.0)))


@pytest.fixture
def plus() -> Iterator[VirtualRobot]:
    """The boards of Hubo 2+ on a robot that stands upright."""
    with assembled(sensors_of("hubo2plus")) as robot:
        stand(robot)
        yield robot


@pytest.fixture
def old() -> Iterator[VirtualRobot]:
    """The boards of Hubo 2, dialect D08."""
    with assembled(sensors_of("hubo2")) as robot:
        stand(robot)
        yield robot


def listen(robot: VirtualRobot) -> dict[str, ListeningNode]:
    return {name: ListeningNode(wire) for name, wire in robot.wires.items()}


def frames(recorder: ListeningNode) -> list[str]:
    """What was heard, as candump writes it."""
    return [f"{frame.arbitration_id:03X}#{frame.data.hex().upper()}" for _, frame in recorder.received]


def answer(robot: VirtualRobot, bus: str, frame: str) -> None:
    """A frame as the sheet prints it, from a board."""
    identifier, data = frame.split("#")
    robot.simulation.buses[bus].send(Frame(int(identifier, 16), bytes.fromhex(data)))


# ---------------------------------------------------------------------- worked examples


def test_what_is_asked(plus: VirtualRobot) -> None:
    """Each sensor is asked in each cycle, in the forms of hubo-ach and HuboCan; the power board now and then."""
    plus.advance(0.5)
    heard = listen(plus)
    plus.advance(0.1)
    lower = frames(heard["lower"])
    asked = {frame for frame in lower if frame.startswith("002")}
    assert asked == {"002#0112", "002#0122", "002#0212", "002#0222", "002#030001"}
    assert all(lower.count(frame) == 5 for frame in asked)
    upper = frames(heard["upper"])
    assert {frame for frame in upper if frame[:3] in ("001", "002")} == {"002#0612", "002#0712", "001#0EE0"}
    assert upper.count("001#0EE0") == 2


@pytest.mark.parametrize(
    ("board", "bus", "frame", "values"),
    [
        ("FT_RF", "lower", "041#85FFC801C909", {"RFFT.mx": -1.23, "RFFT.my": 4.56, "RFFT.fz": 250.5}),
        (
            "IMU_0",
            "lower",
            "053#6AFF4B002EFB2C01",
            {
                "IMU0.roll": radians(-1.5),
                "IMU0.pitch": radians(0.75),
                "IMU0.roll_rate": radians(-12.34),
                "IMU0.pitch_rate": radians(3),
            },
        ),
        (
            "FT_RF",
            "lower",
            "051#7D00CEFFEE02",
            {"TILT_R.roll": radians(1.25), "TILT_R.pitch": radians(-0.5), "TILT_R.az": 9.80665},
        ),
        (
            "JMC14",
            "upper",
            "06E#C012D2045717",
            {"JMC14.voltage": 48, "JMC14.current": 12.34, "JMC14.power": 597.5},
        ),
    ],
)
def test_worked_answers(
    plus: VirtualRobot, board: str, bus: str, frame: str, values: dict[str, float]
) -> None:
    """The sheet's bytes are these values, in SI units."""
    plus.advance(0.3)
    plus.twins[board].fault("silent")
    plus.advance(0.05)
    answer(plus, bus, frame)
    plus.advance(0.001)
    for name, value in values.items():
        assert plus[name].last == pytest.approx(value), name
    assert plus["JMC14.voltage"].unit == "V"


@pytest.mark.parametrize(
    ("board", "bus", "action", "sent"),
    [
        ("FT_RF", "lower", "null", ["001#308100", "001#308104"]),
        ("FT_RH", "upper", "null", ["001#358100"]),
        ("IMU_0", "lower", "null", ["001#3281"]),
        ("FT_LF", "lower", "init", ["001#31FAAA"]),
        ("FT_LF", "lower", "set_period", ["001#310114"]),  # the robot's 50 Hz are 20 ms
        ("JMC14", "upper", "alarm", ["001#0E8201"]),
        ("JMC14", "upper", "quiet", ["001#0E8200"]),
        ("JMC14", "upper", "beep", ["001#0E8303"]),
    ],
)
def test_worked_commands(plus: VirtualRobot, board: str, bus: str, action: str, sent: list[str]) -> None:
    """Null, set-up and sounds are the sheet's bytes."""
    plus.advance(0.1)
    heard = listen(plus)
    getattr(plus.devices[board], action)().wait()
    plus.advance(0.005)
    commands = [f for f in frames(heard[bus]) if f.startswith("001") and f != "001#0EE0"]
    assert commands == sent


def test_the_period_is_told_back(plus: VirtualRobot) -> None:
    """A board of D12 answers with the period that it took."""
    assert plus.devices["FT_RF"].set_period(7).wait().period == 7
    assert plus.twins["FT_RF"].period_ms == 7


# ---------------------------------------------------------------------- D08


def test_one_frame_asks_all_of_d08(old: VirtualRobot) -> None:
    """Four boards on the lower bus want what one request brings: it is sent once a tick, and all are heard."""
    old.advance(0.1)
    heard = listen(old)
    old.advance(0.1)
    lower = frames(heard["lower"])
    assert lower.count("002#00") == 5
    for identifier in ("041", "042", "051", "052", "053", "054"):
        assert sum(frame.startswith(identifier) for frame in lower) == 5
    assert not old.events.last


def test_what_asks_all_is_not_sent_again_for_one(old: VirtualRobot) -> None:
    """One board's lost reply does not make the others answer twice, as if there were two of each."""
    old.advance(0.1)
    heard = listen(old)
    old.twins["FT_RF"].fault("loses", 3)
    old.advance(0.5)
    assert frames(heard["lower"]).count("002#00") <= 26  # once a tick of 50 Hz
    assert old.events.count("duplicate reply") == 0


def test_who_is_silent_in_d08(old: VirtualRobot) -> None:
    """Each board is missed by itself, though all are asked together; the others stay fresh."""
    old.advance(0.2)
    old.twins["FT_RF"].fault("silent")
    old.advance(0.5)
    assert [event.device for event in old.events.of("silent")] == ["FT_RF"]
    assert old["RFFT.fz"].value is UNKNOWN
    assert old["LFFT.fz"].value is not UNKNOWN
    old.twins["FT_RF"].fault("silent", on=False)
    old.advance(0.2)
    assert old["RFFT.fz"].value is not UNKNOWN


def test_the_matrices_of_the_feet(old: VirtualRobot) -> None:
    """Digits are coupled; the matrix of the robot's file makes N·m and N of them, its first row already negated."""
    old.advance(0.1)
    for twin in old.twins.values():
        twin.fault("silent")
    old.advance(0.05)
    answer(old, "lower", "041#85FFC801C909")  # −123, 456, 2505
    old.advance(0.001)
    assert old["RFFT.mx_digits"].last == -123
    assert old["RFFT.mx"].last == pytest.approx(-(-0.0722 * -123 + 0.0002 * 456 + 0.0007 * 2505))
    assert old["RFFT.my"].last == pytest.approx(0.0012 * -123 + 0.0740 * 456 - 0.0014 * 2505)
    assert old["RFFT.fz"].last == pytest.approx(-0.0562 * -123 + 0.0469 * 456 + 0.3234 * 2505)


def test_digits_have_no_unit(old: VirtualRobot) -> None:
    """A hand without a matrix and an IMU have digits alone: nothing passes for N or rad."""
    old.advance(0.1)
    names = {name for name in old.rig.signals if name.startswith(("RHFT", "IMU0", "TILT_R"))}
    assert names == {
        *(f"RHFT.{axis}_digits" for axis in ("mx", "my", "fz")),
        *(f"{owner}.{axis}" for owner in ("IMU0", "TILT_R") for axis in ("acc1", "acc2", "gyro1", "gyro2")),
    }
    assert {old[name].unit for name in names} == {""}


def test_null_is_sent_thrice_in_d08(old: VirtualRobot) -> None:
    """As its programs did; the weight on the foot is zero afterwards."""
    old.advance(0.1)
    assert old["RFFT.fz"].value == pytest.approx(BUILD.weight / 2, abs=3)
    heard = listen(old)
    old.devices["FT_RF"].null().wait()
    old.advance(0.001)
    assert frames(heard["lower"]).count("001#308100") == 3
    old.advance(0.1)
    assert abs(old["RFFT.fz"].value) < 3


def test_set_up_of_d08(old: VirtualRobot) -> None:
    """NameInfo of a hand's board is the genuine frame; of another board nothing is known, and nothing sent."""
    heard = listen(old)
    record = old.devices["FT_RH"].init().wait()
    assert record.period == 10
    assert "001#35010A0038721200" in frames(heard["upper"])
    with pytest.raises(DeviceError, match="nothing is known of the NameInfo"):
        old.devices["FT_RF"].init().wait()
    old.devices["FT_RH"].set_period().wait()
    old.advance(0.001)
    assert "001#35820A" in frames(heard["upper"])
    old.devices["FT_RF"].null().wait()
    offsets = old.devices["FT_RF"].offsets().wait()
    assert offsets["da"].fz == 0
    assert offsets["ad"].fz > 500


# ---------------------------------------------------------------------- units, signs


def test_signs_of_the_file() -> None:
    """The right foot of DRC-Hubo measures its moments the other way round."""
    with assembled(sensors_of("drc_hubo")) as robot:
        stand(robot)
        robot.advance(0.1)
        robot.twins["FT_RF"].fault("silent")
        robot.advance(0.04)
        answer(robot, "lower", "041#85FFC801C909")
        robot.advance(0.001)
        values = [robot[f"RFFT.{axis}"].last for axis in ("mx", "my", "fz")]
        assert values == pytest.approx([1.23, -4.56, 250.5])


@pytest.mark.parametrize("name", ["hubo2plus", "drc_hubo", "hubo2"])
def test_what_is_fed_is_read(name: str) -> None:
    """Through signs, matrices, digits and back: a feed of one's own comes out of the signal, within the noise."""
    with assembled(sensors_of(name), seed=3) as robot:
        robot.twins["FT_RF"].feed = lambda now: (5.0, -7.0, 300.0)
        robot.twins["FT_RF"].tilt_feed = lambda now: (0.1, -0.2, 0.9)
        robot.twins["IMU_0"].feed = lambda now: (0.05, -0.02, sin(now / 1e9), 0.5)
        robot.advance(0.2)
        assert robot["RFFT.mx"].value == pytest.approx(5, abs=0.6)
        assert robot["RFFT.my"].value == pytest.approx(-7, abs=0.6)
        assert robot["RFFT.fz"].value == pytest.approx(300, abs=4)
        if name == "hubo2":
            assert robot["IMU0.acc1"].value == pytest.approx(750 * sin(0.05), abs=10)
            assert robot["TILT_R.acc2"].value == pytest.approx(-150, abs=12)
            return
        assert robot["TILT_R.roll"].value == pytest.approx(0.1, abs=0.003)
        assert robot["TILT_R.pitch"].value == pytest.approx(-0.2, abs=0.003)
        assert robot["TILT_R.az"].value == pytest.approx(0.9 * 9.80665, abs=0.2)
        imu = [robot[f"IMU0.{axis}"].value for axis in ("roll", "pitch", "roll_rate", "pitch_rate")]
        assert imu == pytest.approx([0.05, -0.02, sin(0.18), 0.5], abs=0.01)


def test_a_matrix_asks_for_digits() -> None:
    """In D12 too: the request is that of digits, the answer is read as digits."""
    text = hubo_ft.example
    with assembled(text) as robot:
        heard = listen(robot)
        robot.advance(0.1)
        assert "002#0611" in frames(heard["lower"])
        assert robot["RHFT.fz"].unit == "N"
        assert robot["RHFT.fz_digits"].value is not UNKNOWN


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        (("signs = [-1, -1, 1]", "signs = [-1, -1]"), "3 axes need as many signs"),
        (("[0, 0, 0.1]]", "[0, 0, 0]]"), "must have an inverse"),
        ((", [0, 0, 0.1]]", "]"), "a matrix of 3 rows"),
    ],
)
def test_what_cannot_be_is_refused(change: tuple[str, str], complaint: str) -> None:
    """Too few signs, a matrix that is none."""
    with pytest.raises(CallerError, match=complaint):
        assembled(hubo_ft.example.replace(*change))


# ---------------------------------------------------------------------- the twins


def test_standing_shares_the_weight(plus: VirtualRobot) -> None:
    """Upright, half of it is on each foot and nothing tilts; the hands carry nothing."""
    plus.advance(0.2)
    for foot in ("RFFT", "LFFT"):
        assert plus[f"{foot}.fz"].value == pytest.approx(BUILD.weight / 2, abs=1)
        assert plus[f"{foot}.my"].value == pytest.approx(0, abs=0.1)
    for name in ("RHFT.fz", "TILT_L.roll", "IMU0.pitch"):
        assert plus[name].value == pytest.approx(0, abs=1)


def test_leaning_moves_the_weight(plus: VirtualRobot) -> None:
    """Hips and ankles rolled to the left put the weight on the left foot; pitched forward, before the ankles."""
    stand(plus, AR=0.1, HR=-0.1)
    plus.advance(0.2)
    left, right = plus["LFFT.fz"].value, plus["RFFT.fz"].value
    assert left > 1.5 * right
    assert left + right == pytest.approx(BUILD.weight, abs=2)
    stand(plus, AP=-0.1, HP=0.1)
    plus.advance(0.2)
    assert plus["LFFT.my"].value == pytest.approx(-BUILD.weight / 2 * 0.6 * sin(0.1), rel=0.05)
    stand(plus, AR=0.4, HR=-0.4)
    plus.advance(0.2)
    assert plus["RFFT.fz"].value == pytest.approx(0, abs=1)
    assert plus["LFFT.mx"].value > 10


def test_an_ankle_tilts_its_foot(plus: VirtualRobot) -> None:
    """A single ankle's angle is shared by its foot, the other and the pelvis; a crouch tilts nothing."""
    stand(plus, RAP=0.2)
    plus.advance(0.2)
    assert plus["TILT_R.pitch"].value == pytest.approx(0.1, abs=0.003)
    assert plus["TILT_L.pitch"].value == pytest.approx(-0.1, abs=0.003)
    assert plus["IMU0.pitch"].value == pytest.approx(-0.1, abs=0.003)
    stand(plus, HP=-0.4, KN=0.8, AP=-0.4)
    plus.advance(0.2)
    for name in ("TILT_R.pitch", "TILT_L.pitch", "IMU0.pitch"):
        assert plus[name].value == pytest.approx(0, abs=0.003), name


def test_rates_are_those_of_the_pose() -> None:
    """What the pelvis turns between two looks, by the time between; within a millisecond nothing is computed anew."""
    robot = sensors_of("hubo2plus")
    world = World(VirtualClock())
    hips = [Still(), Still()]
    world.joints["RHP"], world.joints["LHP"] = hips
    body = BodyPose(world, robot)
    body.update(0)
    for hip in hips:
        hip.at = 0.02
    body.update(500_000)
    assert body.pitch == 0
    body.update(10_000_000)
    assert body.pitch == pytest.approx(-0.02)
    assert body.pitch_rate == pytest.approx(-2.0)


def test_null_is_the_present_load(plus: VirtualRobot) -> None:
    """What was on the sensor counts for nothing afterwards, until a reboot; the moment and gravity are not mixed in."""
    stand(plus, RAP=0.2)
    plus.advance(0.1)
    plus.devices["FT_RF"].null().wait()
    plus.devices["IMU_0"].null().wait()
    plus.advance(0.1)
    assert plus["RFFT.fz"].value == pytest.approx(0, abs=1.5)
    assert plus["TILT_R.pitch"].value == pytest.approx(0, abs=0.003)
    assert plus["TILT_R.az"].value == pytest.approx(9.81, abs=0.15)
    assert plus["IMU0.pitch"].value == pytest.approx(0, abs=0.003)
    stand(plus)
    plus.advance(0.1)
    assert plus["TILT_R.pitch"].value == pytest.approx(-0.1, abs=0.003)
    plus.twins["FT_RF"].reboot()
    plus.advance(0.1)
    assert plus["RFFT.fz"].value == pytest.approx(BUILD.weight / 2, abs=1)


def test_saturation_is_an_alarm(plus: VirtualRobot) -> None:
    """At the end of 16 bits nothing is known but that it is more: told once, and when it is over."""
    twin = plus.twins["FT_RF"]
    twin.fault("saturated")
    plus.advance(0.3)
    assert abs(plus["RFFT.fz"].value) >= 3276.7
    assert [(e.device, e.detail) for e in plus.events.of("alarm")] == [("FT_RF", "saturated")]
    twin.fault("saturated", on=False)
    plus.advance(0.1)
    assert plus.events.count("alarm over", "FT_RF") == 1
    twin.feed = lambda now: (0.0, 0.0, 1e6)
    plus.advance(0.1)
    assert plus["RFFT.fz"].value == pytest.approx(3276.7)
    assert plus.events.count("alarm", "FT_RF") == 2


def test_heat_and_drift(plus: VirtualRobot) -> None:
    """Heat moves the zero at once, drift as time goes on; a null helps against both."""
    plus.advance(0.1)
    before = plus["LFFT.fz"].value
    plus.twins["FT_LF"].fault("hot")
    plus.advance(0.1)
    assert plus["LFFT.fz"].value == pytest.approx(before + 10, abs=1.5)
    plus.twins["FT_LF"].fault("hot", on=False)
    plus.twins["FT_LF"].fault("drift", 60)
    plus.advance(0.5)
    first = plus["LFFT.fz"].value
    plus.advance(1.0)
    assert plus["LFFT.fz"].value - first == pytest.approx(0.01 * 3276.7, abs=1.5)
    plus.devices["FT_LF"].null().wait()
    plus.advance(0.02)
    assert plus["LFFT.fz"].value == pytest.approx(0, abs=2)


def test_noise_is_the_seeds() -> None:
    """The same seed draws the same noise, another does not; averaging in D08 halves it."""

    def drawn(seed: int) -> list[float]:
        with assembled(sensors_of("hubo2plus"), seed=seed) as robot:
            values: list[float] = []
            robot["RFFT.fz"].listeners.append(lambda value, instant: values.append(value))
            robot.advance(0.4)
            return values

    one = drawn(1)
    assert len(set(one)) > 3
    assert one == drawn(1) != drawn(2)


# ---------------------------------------------------------------------- power


def test_a_battery_is_spent(plus: VirtualRobot) -> None:
    """Motion draws current, which the voltage follows; the charge goes with time."""
    plus.advance(0.2)
    rest = plus["JMC14.current"].value

    class Turning(Still):
        """At 10 rad/s."""

        def position(self, now: int) -> float:
            return 10 * now / 1e9

    plus.simulation.world.joints["RSP"] = Turning()
    plus.advance(0.3)
    assert plus["JMC14.current"].value == pytest.approx(rest + 4, abs=0.3)
    assert plus["JMC14.power"].value == pytest.approx(
        plus["JMC14.voltage"].value * plus["JMC14.current"].value, rel=0.01
    )
    charge = plus.twins["JMC14"].charge
    plus.advance(1)
    assert plus.twins["JMC14"].charge < charge < 1


def test_a_low_battery_is_told(plus: VirtualRobot) -> None:
    """Once when it is low, once when it is over."""
    twin = plus.twins["JMC14"]
    twin.fault("low_battery")
    plus.advance(0.5)
    (event,) = plus.events.of("alarm")
    assert event.device == "JMC14"
    assert event.detail.startswith("low battery: 43.2 V, below 44 V")
    twin.fault("low_battery", on=False)
    plus.advance(0.5)
    assert plus.events.count("alarm over", "JMC14") == 1
    twin.feed = lambda now: (47.11, 3.0)
    plus.advance(0.2)
    assert plus["JMC14.voltage"].value == pytest.approx(47.11, abs=0.1)


def test_sounds(plus: VirtualRobot) -> None:
    """The twin sounds as it is told; a sound that is none is refused."""
    power, twin = plus.devices["JMC14"], plus.twins["JMC14"]
    power.alarm(3)
    power.beep(1.5)
    plus.advance(0.01)
    assert twin.sound == "sound_3"
    assert twin.beeping_until == pytest.approx(1.5e9, abs=1e7)
    power.quiet()
    plus.advance(0.01)
    assert twin.sound == "off"
    with pytest.raises(CallerError, match="there is no alarm 5"):
        power.alarm(5)


# ---------------------------------------------------------------------- what the driver does not use


@pytest.mark.parametrize(
    ("mode", "force", "tilt"),
    [
        ("scaled", "ForceTorque", "Tilt"),
        ("digital", "ForceTorqueDigits", "TiltDigits"),
        ("scaled_tilt_digital", "ForceTorque", "TiltDigits"),
        ("digital_tilt_scaled", "ForceTorqueDigits", "Tilt"),
    ],
)
def test_all_forms_of_d12(mode: str, force: str, tilt: str) -> None:
    """One request for force and tilt, in four mixtures, of one board or of all: the twins know them."""
    with assembled(sensors_of("hubo2plus")) as robot:
        robot.rig.close()
        heard = listen(robot)
        node = robot.wires["lower"].attach("bench")
        encoder = robot.devices["FT_RF"].variant.encoder
        requests = [robot.devices["FT_RF"].variant["SensorRequest"]] * 2
        for request, sensor in zip(requests, (1, 0xFF), strict=True):
            node.send(encoder.packet(request, {"sensor": sensor, "mode": mode}))
            robot.advance(0.01)
        scanner = make_scanner([robot.devices["FT_RF"].variant], direction="both")
        records = scanner.feed([frame for _, frame in heard["lower"].received])
        kinds = [type(record).__name__ for record in records]
        assert kinds[:4] == ["SensorRequest", force, tilt, "SensorRequest"]
        assert sorted(kinds[4:]) == sorted([force, force, tilt, tilt])


def test_bench_commands_of_d08(old: VirtualRobot) -> None:
    """Single axes are nulled, averages are quieter, an analogue value shows in its offset."""
    board, twin = old.devices["FT_RF"], old.twins["FT_RF"]
    twin.feed = lambda now: (3.0, 4.0, 100.0)
    old.advance(0.1)
    board.send("NullSensor", what="fz")
    old.advance(0.1)
    assert old["RFFT.fz_digits"].value == pytest.approx(0, abs=12)
    assert abs(old["RFFT.my_digits"].value) > 20
    noise = twin.groups["force"].noise
    board.send("DataType", type="average")
    board.send("DaOut", value=123)
    old.advance(0.01)
    assert twin.groups["force"].noise == noise / 2
    pair = board.ask("OffsetQuery", reply="OffsetPair", axis="fz").wait()
    assert pair.da == 123
    assert pair.ad > 200
    assert board.offsets().wait()["da"].mx == 123
