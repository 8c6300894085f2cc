"""Hubo's motor boards, driver and twin together: the conformance kit, and what only such boards do."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import pytest

from aces_bus.device import UNKNOWN, Job, Robot, uncoalesced
from aces_bus.device.host import Host
from aces_bus.errors import CallerError, DeviceError, NoReplyError, UnknownNameError
from aces_bus.hardware import ListeningNode
from aces_bus.robot import VirtualRobot, parse_robot
from aces_bus.testing import driver_tests, run_check
from aces_devices.hubo_motor import D08, D08X, D12, D12_THREE, driver
from aces_devices.hubo_motor.parameters import BoardParameters, selector
from aces_devices.hubo_motor.scan import channels_by_length, name_of

test_driver = driver_tests(driver)


OTHERS = {
    "three channels": (D12_THREE, ("declared", "received", "set", "reboot", "actions", "scan")),
    "D08": (D08, ("declared", "received", "set", "reboot", "actions", "scan")),
    "D08X": (D08X, ("declared", "received", "quiet_before")),
}


@pytest.mark.slow
@pytest.mark.parametrize(("robot", "check"), [(name, check) for name in OTHERS for check in OTHERS[name][1]])
def test_other_boards_are_as_good(robot: str, check: str) -> None:
    """The three-channel boards of D12 and the boards of both readings of D08 do what those of the example do."""
    run_check(check, replace(driver, example=OTHERS[robot][0]))


@cache
def robot_of(text: str = D12) -> Robot:
    """An example robot, read once."""
    robot, problems = parse_robot(text, "test.toml")
    assert robot is not None, problems
    return robot


def only(text: str, *boards: str) -> str:
    """An example without its other boards."""
    lines = text.splitlines()
    names = {line.split()[0] for line in lines if line.startswith(("JMC", "EJMC"))} - set(boards)
    return "\n".join(
        line
        for line in lines
        if line.split()[:1] not in [[n] for n in names] and not any(f'"{n}"' in line for n in names)
    )


LIMB = only(D12, "JMC0")
#: Set-points go out as they are given, in one frame.
AT_ONCE = re.sub(r"^(RH[YR] *= {)", r"\1 max_speed = 1000,", LIMB, flags=re.MULTILINE)


def made(text: str = LIMB, rate_hz: float | None = 100, **options: Any) -> VirtualRobot:
    return VirtualRobot(robot_of(text), rate_hz=rate_hz, load=lambda _: driver, **options)


def up(robot: VirtualRobot) -> None:
    """Past the start's hold-off, everything enabled."""
    robot.advance(0.9)
    robot.rig.each("enable").wait()
    robot.advance(0.1)


def references(robot: VirtualRobot, run: Callable[[], object]) -> list[tuple[int, bytes]]:
    """The reference frames that stand on the wire while something happens."""
    (wire,) = robot.wires.values()
    recorder = ListeningNode(wire)
    run()
    return [(now, frame.data) for now, frame in recorder.received if 0x10 <= frame.arbitration_id < 0x40]


# ---------------------------------------------------------------------- enabling and references


def test_no_reference_goes_out_within_the_hold_off() -> None:
    """Enabling waits until 0.8 s after the start; the first reference is where the joints are."""
    with made() as robot:
        job = robot.devices["JMC0"].enable()
        assert references(robot, lambda: robot.advance(0.79)) == []
        assert not job.is_over
        first = references(robot, lambda: robot.advance(0.2))
        assert job.state == "done"
        assert first[0][0] == pytest.approx(800e6, abs=12e6)
        assert first[0][1] == bytes(6)


def test_each_tick_has_one_reference_frame_a_board() -> None:
    """Set-points of both motors, given at any time, are one frame; without new ones the last is repeated."""
    with made() as robot:
        up(robot)

        def run() -> None:
            for n in range(10):
                robot["RHY.position"].set(0.01 * n)
                robot["RHR.position"].set(-0.01 * n)
                robot.advance(0.01)
            robot.advance(0.1)

        frames = references(robot, run)
        assert len(frames) == 20
        assert len({data for _, data in frames[10:]}) == 1


def test_a_frame_a_channel_is_what_a_user_may_ask_for() -> None:
    """The rule of coalescing can be replaced: one frame a set-point costs twice the references."""
    counts: list[int] = []
    for rules in (None, {"Reference": uncoalesced}):
        with made(rules=rules) as robot:
            up(robot)
            counts.append(len(references(robot, lambda: robot.advance(0.5))))
    assert counts == [50, 100]


def test_what_is_set_while_disabled_is_told_and_never_sent() -> None:
    """A set-point of a board that is not enabled moves nothing, then or later."""
    with made() as robot:
        robot.advance(1.0)
        robot["RHY.position"].set(0.5)
        robot.advance(0.02)
        assert robot.events.count("not sent", "JMC0") == 1
        up(robot)
        robot.advance(0.5)
        assert robot["RHY.position"].value == 0.0


def test_a_board_can_wait_for_all_its_channels() -> None:
    """With `trigger`, a set-point waits for the other channel's, as acesHubo did; single motors are sent at once."""
    with made(AT_ONCE.replace("settings = {", "settings = { trigger = true,")) as robot:
        up(robot)
        robot["RHY.position"].set(0.2)
        before = references(robot, lambda: robot.advance(0.1))
        assert {data for _, data in before} == {bytes(6)}
        robot["RHR.position"].set(-0.05)
        after = references(robot, lambda: robot.advance(0.1))
        assert after[-1][1].hex() == "567c00e03e80"


def test_the_reference_filter_arrives() -> None:
    """hubo-ach's filter, (39 old + new) ÷ 40, smooths a step and ends exactly at it."""
    with made(AT_ONCE.replace("settings = {", "settings = { filter = 40,")) as robot:
        up(robot)
        robot["RHY.position"].set(0.2)
        frames = references(robot, lambda: robot.advance(5.0))
        steps = [int.from_bytes(data[:3], "little") for _, data in frames]
        assert steps[0] == 31830 // 40
        assert steps[-1] == 31830
        assert steps == sorted(steps)


def test_velocity_is_from_instants() -> None:
    """A lost encoder reply does not double the velocity: it is the difference over the time that really passed."""
    with made() as robot:
        up(robot)
        robot["RHY.position"].set(1.9)
        robot.advance(0.2)
        steady = robot["RHY.velocity"].value
        assert 0 < steady <= 6.4
        robot.twins["JMC0"].fault("loses", 2)
        robot.advance(0.02)
        assert robot["RHY.velocity"].value == pytest.approx(steady, rel=0.15)


def test_a_joint_without_its_counts_is_refused() -> None:
    """A board cannot follow positions of a joint whose counts nobody knows, and says which."""
    text = LIMB.replace("gear = [10, 25],    harmonic = 100,", "")
    with pytest.raises(CallerError, match="RHY needs gear or harmonic, and encoder"):
        made(text)


def test_a_board_of_no_known_kind_is_refused() -> None:
    """A sensor board is not a motor board; the kinds that exist are listed."""
    with pytest.raises(UnknownNameError, match="hand"):
        made(LIMB.replace("channels = 2", 'channels = 2, kind = "foot"'))


@pytest.mark.parametrize(
    ("settings", "what"),
    [
        ("status_s = -1", r"status_s = -1: Expected `float` >= 0\.0"),
        ('filter = "long"', "filter = 'long': Expected `float`"),
        ("trigger = 1", "trigger = 1: Expected `bool`"),
        ("stauts_s = 1", "did you mean|status_s"),
    ],
)
def test_settings_that_are_none_are_refused(settings: str, what: str) -> None:
    """A misspelt or impossible setting is named with its board, and nothing starts."""
    with pytest.raises(CallerError, match=what) as failed:
        made(LIMB.replace("settings = { status_s = 0.25,", f"settings = {{ {settings},"))
    assert "JMC0" in str(failed.value)


def test_a_motor_is_not_given_what_it_cannot_follow() -> None:
    """A speed is nothing that such a board takes, and the joint is named."""
    with pytest.raises(CallerError, match="JMC0 cannot be given a speed for RHY"):
        made(LIMB.replace("lower = -1.92", 'command = "speed", lower = -1.92'))


# ---------------------------------------------------------------------- status


def test_alarms_name_the_joint_and_the_bit() -> None:
    """A fault of one motor is told once with its joint, and again when it is over."""
    with made() as robot:
        up(robot)
        robot.twins["JMC0"].fault("motor_fail_0", 2)
        robot.advance(1.0)
        (alarm,) = robot.events.of("alarm")
        assert (alarm.device, alarm.detail) == ("JMC0", "RHR: motor_fail_0")
        assert robot["RHR.errors"].value == ("motor_fail_0",)
        assert robot["RHY.errors"].value == ()
        robot.twins["JMC0"].fault("motor_fail_0", on=False)
        robot.devices["JMC0"].clear_errors().wait()
        robot.advance(0.5)
        assert [event.detail for event in robot.events.of("alarm over")] == ["RHR: motor_fail_0"]


def test_a_rebooted_board_moves_nothing_until_it_is_enabled_again() -> None:
    """Control off although enabled: told as rebooted, references end, values are forgotten; enabled and homed it is back."""
    with made() as robot:
        up(robot)
        robot["RHY.position"].set(0.4)
        robot.advance(1.0)
        robot.twins["JMC0"].reboot()
        robot.advance(0.5)
        assert robot.events.count("rebooted", "JMC0") == 1
        place = robot.simulation.world.joints["RHY"].position(robot.clock.now())
        assert references(robot, lambda: robot.advance(1.0)) == []
        assert robot.simulation.world.joints["RHY"].position(robot.clock.now()) == place
        assert robot["RHY.position"].value == 0.0  # its encoder counts from there
        assert robot.devices["JMC0"].is_enabled is False
        robot.devices["JMC0"].enable().wait()
        with pytest.raises(CallerError, match=r"RHY\.position: is not homed"):
            robot["RHY.position"].set(0.1)
        robot.rig.door.takes_unhomed = True
        robot["RHY.position"].set(0.1)
        robot.advance(1.0)
        assert robot["RHY.position"].value == pytest.approx(0.1, abs=2e-3)


def test_a_lost_home_is_a_reboot() -> None:
    """A home flag that was 6 and is not any more means that the board does not know where its joints are."""
    with made() as robot:
        robot.devices["JMC0"].home().wait(30)
        robot.advance(0.5)
        robot.twins["JMC0"].fault("amnesia", 1)
        robot.advance(0.5)
        (event,) = robot.events.of("rebooted")
        assert event.detail == "RHY lost its home"


def test_a_board_that_switches_itself_off_is_no_reboot() -> None:
    """A failed driver is an alarm: the error says so, and references end."""
    with made() as robot:
        up(robot)
        robot.twins["JMC0"].fault("fet_fault", 0)
        robot.advance(0.5)
        assert robot.events.count("rebooted") == 0
        assert "driver_fault" in robot.events.of("alarm")[0].detail
        assert references(robot, lambda: robot.advance(0.2)) == []
        with pytest.raises(DeviceError, match="driver_fault"):
            robot.devices["JMC0"].enable().wait()


def test_a_board_off_the_bus_is_told_and_comes_back() -> None:
    """Silence is named; values are unknown meanwhile."""
    with made() as robot:
        robot.advance(0.5)
        robot.twins["JMC0"].fault("can_error")
        robot.advance(0.5)
        assert robot.events.count("silent", "JMC0") == 1
        assert robot["RHY.position"].value is UNKNOWN
        robot.twins["JMC0"].fault("can_error", on=False)
        robot.advance(0.5)
        assert robot["RHY.position"].read().value == 0.0


# ---------------------------------------------------------------------- homing


def test_homing_finds_the_true_zero() -> None:
    """After a search the encoder says what the joint's angle is; before, it counts from where the power came."""
    with made(homed=False) as robot:
        robot.advance(0.5)
        joint = robot.simulation.world.joints["RHY"]
        assert robot["RHY.position"].value == 0.0
        assert abs(joint.position(robot.clock.now())) > 1e-3
        job = robot.devices["JMC0"].home()
        robot.advance(0.3)
        assert 0 < job.progress < 1
        assert job.wait(30) == ["RHY", "RHR"]
        robot.advance(0.3)
        assert robot["RHY.home"].value == "homed"
        assert robot["RHY.homed"].value is True
        up(robot)
        robot["RHY.position"].set(0.3)
        robot.advance(1.0)
        assert joint.position(robot.clock.now()) == pytest.approx(0.3, abs=2e-3)


def test_a_twin_that_has_found_its_home_stays_there() -> None:
    """The reference before the search was of another zero: after it the drive holds at 0, though nobody sends one."""
    with made(homed=False) as robot:
        up(robot)
        channel = robot.twins["JMC0"].channels[0]
        robot.rig.door.takes_unhomed = True
        robot["RHY.position"].set(0.1)
        robot.advance(0.5)
        assert channel.reference > 1000
        assert robot.devices["JMC0"].home("RHY").wait(30) == ["RHY"]
        assert channel.reference == 0.0
        robot.advance(0.3)
        assert robot["RHY.position"].value == pytest.approx(0.0, abs=2e-3)


@pytest.mark.slow
def test_no_board_of_the_bus_is_sent_references_after_a_home_command() -> None:
    """hubo-ach sends none for 3 s after a home command; a homed joint's set-point is 0 then."""
    with made(only(D12, "JMC0", "JMC1")) as robot:
        up(robot)
        robot["RHP.position"].set(0.1)
        robot["RHY.position"].set(0.2)
        robot.advance(0.5)
        robot.devices["JMC0"].home("RHY")
        robot.advance(0.005)
        assert references(robot, lambda: robot.advance(2.9)) == []
        robot.advance(4.0)
        assert robot["RHY.position"].value == pytest.approx(0.0, abs=1e-3)
        assert robot["RHP.position"].value == pytest.approx(0.1, abs=1e-3)
        assert len(references(robot, lambda: robot.advance(0.1))) == 20


@pytest.mark.parametrize("fault", ["jam", "no_switch", "no_index"])
def test_a_home_search_that_fails_says_why(fault: str) -> None:
    """A blocked motor, a switch that never closes, an index that never comes: no home within the time, with the reason."""
    with made(LIMB.replace("settings = {", "settings = { home_timeout_s = 6,")) as robot:
        robot.advance(0.5)
        robot.twins["JMC0"].fault(fault, 1)
        job = robot.devices["JMC0"].home("RHY")
        with pytest.raises(DeviceError, match=r"JMC0: no home within 6 s: RHY \(home flag 0") as failed:
            job.wait(30)
        assert fault != "jam" or "jam" in str(failed.value)
        robot.twins["JMC0"].fault(fault, on=False)
        assert robot.devices["JMC0"].home("RHY").wait(30) == ["RHY"]


def test_an_old_board_is_tried_again() -> None:
    """D08 tells a failed search by 10; the driver tries legs twice, then fails; a search that ends well is told by 5."""
    with made(only(D08, "JMC0")) as robot:
        robot.advance(0.5)
        (wire,) = robot.wires.values()
        recorder = ListeningNode(wire)
        robot.twins["JMC0"].fault("jam", 1)
        with pytest.raises(DeviceError, match="RHY found no home in 2 tries"):
            robot.devices["JMC0"].home("RHY").wait(60)
        assert sum(frame.data[:2] == b"\x00\x11" for frame in recorder.frames()) == 2
        robot.twins["JMC0"].fault("jam", on=False)
        assert robot.devices["JMC0"].home().wait(60) == ["RHY", "RHR"]
        robot.advance(0.5)
        assert robot["RHY.homed"].value is True
        now = robot.clock.now()
        joints = robot.simulation.world.joints
        assert [joints[name].position(now) for name in ("RHY", "RHR")] == pytest.approx([0, 0], abs=1e-4)


def test_stopping_ends_a_home_search() -> None:
    """`stop_motion` cancels the job and switches control off; the joint stays where it was."""
    with made() as robot:
        robot.advance(0.5)
        job = robot.devices["JMC0"].home()
        robot.advance(0.2)
        robot.devices["JMC0"].stop_motion()
        robot.advance(0.05)
        place = robot.simulation.world.joints["RHY"].position(robot.clock.now())
        robot.advance(2.0)
        assert robot.simulation.world.joints["RHY"].position(robot.clock.now()) == place
        with pytest.raises(DeviceError, match="cancelled"):
            job.wait(1)


# ---------------------------------------------------------------------- what is stored


def test_parameters_are_read_beside_the_currents() -> None:
    """Blocks and currents share an identifier; with currents polled, all blocks are read right, and put together."""
    text = LIMB.replace("current_s = 0.5", "current_s = 0.02")
    with made(text) as robot:
        robot.advance(0.5)
        board = robot.devices["JMC0"]
        board.set_limits("RHY", lower=-1.0, upper=1.5).wait()
        stored = board.parameters().wait()
        assert isinstance(stored, BoardParameters)
        hip = stored.channels["RHY"]
        assert (hip.kp, hip.ki, hip.kd, hip.resolution) == (200, 0, 500, 4000)
        assert (hip.lower_limit, hip.lower_limit_enabled) == (-159154, True)
        assert (hip.upper_limit, hip.upper_limit_enabled) == (238732, True)
        assert hip.home_offset == round(0.2 * 159154.943) - 1 or hip.home_offset == int(0.2 * 159154.943)
        assert stored.channels["RHR"].lower_limit_enabled is False
        assert (stored.number, stored.board_type) == (0, 2)
        robot.advance(0.5)
        assert robot["RHY.current"].value == 0.0
        assert not robot.rig.hosts["upper"].unknown


def test_parameters_are_written_and_the_others_kept() -> None:
    """A command that writes several at once carries the stored values of those that were not given."""
    with made() as robot:
        robot.advance(0.3)
        board = robot.devices["JMC0"]
        board.set_parameters("RHR", home_offset=-70000, dead_zone=3, search_mode="switch").wait()
        board.set_parameters(jam_time=250, max_error=5000).wait()
        board.set_gains("RHR", kp=150, kd=400).wait()
        stored = board.parameters().wait()
        roll = stored.channels["RHR"]
        assert (roll.home_offset, roll.dead_zone, roll.search_mode, roll.search_limit) == (
            -70000,
            3,
            "switch",
            60,
        )
        assert (roll.kp, roll.kd) == (150, 400)
        assert (stored.jam_time, stored.saturation_time, stored.max_error) == (250, 500, 5000)
        assert stored.channels["RHY"].kp == 200


def test_parameters_survive_a_reboot_and_not_defaults() -> None:
    """What is stored outlives the power; loading the defaults, once confirmed, does not spare it."""
    with made() as robot:
        robot.advance(0.3)
        board = robot.devices["JMC0"]
        board.set_gains("RHY", kp=90, kd=80).wait()
        robot.twins["JMC0"].reboot()
        assert board.parameters().wait().channels["RHY"].kp == 90
        with pytest.raises(CallerError, match="confirm"):
            board.initialise(False)
        board.initialise(True)
        assert board.parameters().wait().channels["RHY"].kp == 200


def test_a_board_gets_another_number() -> None:
    """After SetBoardNumber driver and board go on under the new one, which the robot must know as of the same kind."""
    spare = 'JMC4 = { driver = "hubo_motor", bus = "upper", credentials = { board = 0x04 }, channels = 2, active = false }'
    with made(LIMB.replace("[joints]", f"{spare}\n[joints]")) as robot:
        robot.advance(0.3)
        board = robot.devices["JMC0"]
        with pytest.raises(CallerError, match="0x2f"):
            board.set_board_number(0x30, True)
        with pytest.raises(CallerError, match="kind"):
            board.set_board_number(0x05, True)
        board.set_board_number(0x04, True)
        robot.advance(0.5)
        assert robot["RHY.position"].value is not UNKNOWN
        assert board.credentials["board"] == 4


def test_selectors_leave_room_for_the_boards_own_blocks() -> None:
    """6 × channel + n, and 5 more from channel 3 on: 20, 21 and 22 stay free (facts, section 8)."""
    used = [selector(channel, block) for channel in range(5) for block in range(1, 7)]
    assert used[:3] == [1, 2, 3]
    assert selector(3, 1) == 24
    assert not {20, 21, 22} & set(used)
    assert len(set(used)) == 30


def test_reading_parameters_of_an_absent_board_ends() -> None:
    """Three tries, then a `NoReplyError` that names the board."""
    with made() as robot:
        robot.twins["JMC0"].power(False)
        robot.advance(0.1)
        with pytest.raises(NoReplyError, match="JMC0"):
            robot.devices["JMC0"].parameters().wait(5)


def test_limits_in_the_board_hold_whatever_is_sent() -> None:
    """A limit that is enabled in the board stops a reference, and the status says which end it was."""
    with made() as robot:
        up(robot)
        robot.devices["JMC0"].set_limits("RHY", lower=-0.1, upper=0.1).wait()
        robot["RHY.position"].set(0.5)
        robot.advance(1.5)
        assert robot["RHY.position"].value == pytest.approx(0.1, abs=2e-3)
        assert robot["RHY.errors"].value == ("above_maximum",)


def test_clearing_errors_does_not_lose_the_zero_by_accident() -> None:
    """The command that clears errors sets encoders to zero: away from zero it must be asked for."""
    with made() as robot:
        up(robot)
        robot["RHY.position"].set(0.3)
        robot.advance(1.0)
        board = robot.devices["JMC0"]
        with pytest.raises(DeviceError, match=r"RHY at 0\.299"):
            board.clear_errors().wait()
        place = robot.simulation.world.joints["RHY"].position(robot.clock.now())
        board.clear_errors(zero=True).wait()
        robot.advance(0.5)
        assert abs(robot["RHY.position"].value) < 1e-3
        assert robot.simulation.world.joints["RHY"].position(robot.clock.now()) == pytest.approx(
            place, abs=1e-3
        )


# ---------------------------------------------------------------------- modes, sounds, compliance


def test_beeps_and_alarms_are_heard() -> None:
    """Beeps in steps of 0.1 s, alarms by number; what no board can do is refused."""
    with made() as robot:
        board, twin = robot.devices["JMC0"], robot.twins["JMC0"]
        board.beep(0.3)
        board.alarm(3)
        robot.advance(0.1)
        assert [seconds for _, seconds in twin.beeps] == pytest.approx([0.3])
        assert [sound for _, sound in twin.alarms] == ["sound_3"]
        with pytest.raises(CallerError, match=r"25\.5"):
            board.beep(60)
        with pytest.raises(CallerError, match="0 to 4"):
            board.alarm(9)


def test_an_old_board_says_what_it_cannot_do() -> None:
    """Actions of D12 are not listed for D08, and refused with the dialect."""
    with made(only(D08, "JMC0")) as robot:
        board = robot.devices["JMC0"]
        assert "parameters" not in board.actions
        assert "home" in board.actions
        with pytest.raises(CallerError, match="D08"):
            board.parameters()
        with pytest.raises(CallerError, match="torque"):
            board.set_control_mode("current")


def test_a_board_says_what_it_is() -> None:
    """The question tells the period of the host's rate; the answer repeats it. A file that knows too little is told."""
    with made() as robot:
        record = robot.devices["JMC0"].board_info().wait()
        assert record.period == 10
        assert "board_info" in robot.devices["JMC0"].actions
    with made(only(D08, "JMC0")) as robot:
        record = robot.devices["JMC0"].board_info().wait()
        assert (record.period, list(record.limit)) == (10, [10, 10])
    with made(only(D08, "JMC0").replace(", z_phase = 3909", "")) as robot:
        assert "board_info" not in robot.devices["JMC0"].actions
        with pytest.raises(CallerError, match="z_phase"):
            robot.devices["JMC0"].board_info()


def test_stopping_ends_an_enabling() -> None:
    """A board that is stopped while it waits for the hold-off stays off."""
    with made() as robot:
        job = robot.devices["JMC0"].enable()
        robot.advance(0.1)
        robot.devices["JMC0"].stop_motion()
        robot.advance(2.0)
        assert job.state == "failed"
        assert robot["RHY.enabled"].value is False


def test_fingers_of_a_drc_hand_are_given_currents() -> None:
    """In hybrid mode the wrist follows positions and the fingers push; in position mode another message goes out."""
    with made(only(D12_THREE, "EJMC1")) as robot:
        up(robot)
        robot["RWR.position"].set(0.2)
        robot["RH1.current"].set(0.05)
        robot.advance(1.0)
        assert robot["RWR.position"].value == pytest.approx(0.2, abs=2e-3)
        assert "current_mode" in robot["RH1.status"].value
        assert robot["RH1.position"].value > 0.5
        robot.devices["EJMC1"].set_control_mode("position")
        robot.advance(0.5)
        assert "current_mode" not in robot["RH1.status"].value
        robot["RWR.position"].set(-0.1)
        robot.advance(1.0)
        assert robot["RWR.position"].value == pytest.approx(-0.1, abs=2e-3)


def test_a_compliant_joint_gives_way_and_becomes_rigid_again() -> None:
    """Compliance sends duties and no references; the joint goes softly toward its set-point; rigid again, it holds it."""
    text = LIMB.replace("settings = {", "settings = { filter = 40,")
    with made(text, rate_hz=200) as robot:
        up(robot)
        board = robot.devices["JMC0"]
        with pytest.raises(UnknownNameError):
            board.home("LKN")
        robot["RHY.position"].set(-0.1)
        robot.advance(0.01)
        board.set_compliance().wait()
        robot["RHY.position"].set(0.3)
        silent = references(robot, lambda: robot.advance(2.0))
        assert silent == []
        soft = robot["RHY.position"].value
        assert 0.2 < soft < 0.3
        assert 0 < robot["RHY.duty"].value <= 8
        board.set_compliance(False).wait(30)
        robot.advance(3.0)
        assert robot["RHY.position"].value == pytest.approx(0.3, abs=2e-3)
        assert robot["RHY.duty"].value == 0


# ---------------------------------------------------------------------- scanning


def test_boards_are_told_apart_by_their_answers() -> None:
    """A scan with a table that is wrong for these boards takes the number of channels from the answers' lengths."""
    from aces_protocols.hubo.spec import hubo

    robot = made(D12)
    robot.simulation.open()
    (port,) = robot.ports("scan").values()
    wrong = {"channels": {0x00: 5, 0x24: 2}, "sensors": {}}
    host = Host(port, [hubo.variant("D12", wrong)])
    host.open()
    found = Job(robot.clock, "scan", lambda job: driver.scan(host, job)).wait(10)  # type: ignore[misc]
    assert [(c.name, c.credentials["board"], c.channels) for c in found] == [
        ("JMC0", 0x00, 2),
        ("JMC1", 0x01, 2),  # one and two channels answer alike
        ("EJMC4", 0x24, 5),
    ]
    assert not host.devices


def test_names_and_lengths() -> None:
    """JMC0 to JMC15, EJMC0 from 0x20; 8, 6 and 4 bytes are two, three and one channel, 6 and 4 together five."""
    assert [name_of(n) for n in (0x0B, 0x23, 0x15)] == ["JMC11", "EJMC3", "BOARD_0x15"]
    assert [channels_by_length(x, "D12") for x in ([8], [6], [4], [6, 4], [])] == [2, 3, 1, 5, None]
