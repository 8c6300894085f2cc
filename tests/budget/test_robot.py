"""A robot's budget: what its drivers really send, and never less than what its virtual buses show."""

from __future__ import annotations

from typing import Any

import pytest

from aces_bus import Frame, load_robot
from aces_bus.errors import CallerError, UnknownNameError
from aces_bus.robot import VirtualRobot, parse_robot
from aces_lab.budget import Assumptions, ErrorModel, RobotTraffic, robot_budget, robot_traffic

MS = 1_000_000
PRIORITY = Assumptions(queues={"host": "priority"})  # as the virtual bus's nodes are


@pytest.fixture(scope="module")
def leg() -> RobotTraffic:
    """A leg of the quadruped: three motors that answer each command."""
    return robot_traffic(load_robot("quadruped").part("LF"))


def test_a_tick_is_what_is_sent(leg: RobotTraffic) -> None:
    """Commands that are answered stand for polls; the twin's time to answer is found."""
    (bus,) = leg.buses.values()
    assert (bus.link, bus.bitrate, bus.tick_ns, bus.one_by_one) == ("can", 1_000_000, 2 * MS, False)
    assert [(one.name, one.node, one.after, one.delay_ns, one.period_ns) for one in bus.messages] == [
        ("DM_LF_HAA.Command", "host", "", 0, 2 * MS),
        ("DM_LF_HFE.Command", "host", "", 0, 2 * MS),
        ("DM_LF_KFE.Command", "host", "", 0, 2 * MS),
        ("DM_LF_HAA.Feedback", "DM_LF_HAA", "DM_LF_HAA.Command", 30_000, 2 * MS),
        ("DM_LF_HFE.Feedback", "DM_LF_HFE", "DM_LF_HFE.Command", 30_000, 2 * MS),
        ("DM_LF_KFE.Feedback", "DM_LF_KFE", "DM_LF_KFE.Command", 30_000, 2 * MS),
    ]


def test_the_leg_s_budget(leg: RobotTraffic) -> None:
    """Six frames of 135 bits in 2 ms; twice the rate is twice the share, and assumptions make it later."""
    found = robot_budget(leg)
    (bus,) = found.buses.values()
    assert bus.utilisation == pytest.approx(6 * 0.135 / 2)
    assert found.is_met
    assert bus.round_ns == 6 * 135_000
    twice = robot_budget(leg.at(2)).buses["LF"]
    assert twice.utilisation == pytest.approx(0.81)
    assert twice.is_met
    assert not robot_budget(leg.at(3)).is_met
    for more in (
        Assumptions(jitter_ns=100_000),
        Assumptions(answer_ns=500_000),
        Assumptions(errors=ErrorModel(1, 100 * MS)),
    ):
        later = robot_budget(leg, more).buses["LF"].round_ns
        assert later is not None
        assert later >= bus.round_ns + 100_000
    with pytest.raises(UnknownNameError, match="hist"):
        robot_budget(leg, Assumptions(queues={"hist": "fifo"}))
    with pytest.raises(CallerError, match="rate"):
        robot_traffic(load_robot("quadruped"), rate_hz=-1)


def latest_seen(robot: VirtualRobot, bus: str, seconds: float, tick_ns: int) -> dict[Any, int]:
    """When the frames of each identifier ended at the latest, from the tick before (ns)."""
    seen: dict[Any, int] = {}

    def received(frame: Frame, instant: int) -> None:
        key = frame.arbitration_id, frame.is_extended_id
        seen[key] = max(seen.get(key, 0), instant % tick_ns)

    robot.wires[bus].attach("listener", received, listen_only=True)
    robot.advance(seconds)
    return seen


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "bus", "rate_hz"),
    [("quadruped", "LF", 500.0), pytest.param("hubo2plus", "lower", 200.0, marks=pytest.mark.slow)],
)
def test_a_virtual_robot_takes_no_longer(name: str, bus: str, rate_hz: float) -> None:
    """Enabled, with a set-point for each joint in each tick: no frame of any identifier ends after its bound."""
    robot = load_robot(name).part(bus)
    traffic = robot_traffic(robot)
    budget = robot_budget(traffic, PRIORITY).buses[bus]
    assert budget.is_met
    bounds: dict[Any, int] = {}
    for one in budget.messages:
        key = one.sent.identifier, one.sent.extended
        bounds[key] = max(bounds.get(key, 0), one.response_ns or 0)
    with VirtualRobot(robot, rate_hz=rate_hz) as made:
        made.rig.each("enable").wait()
        host = made.rig.hosts[bus]
        joints = [
            made.rig[joint.name]
            for joint in robot.joints.values()
            if joint.active and joint.device in host.members
        ]

        def hold(now: int) -> None:
            for joint in joints:
                joint.set(joint.last if isinstance(joint.last, float) else 0.0)

        host.before_set_points.insert(0, hold)
        made.advance(0.1)
        seen = latest_seen(made, bus, 0.4, budget.traffic.tick_ns)
        assert made.rig.hosts[bus].counts.polls_carried == 0
    assert len(seen) > 5
    assert set(seen) <= set(bounds)
    for key, latest in seen.items():
        assert latest <= bounds[key], key
    assert max(seen.values()) > 0.6 * (budget.round_ns or 0)


def test_a_line_that_asks_one_by_one_is_a_chain() -> None:
    """Six servos answer one request behind one another; a silent one holds the line up; more ticks have no room."""
    traffic = robot_traffic(load_robot("so101").part("follower"))
    (bus,) = robot_budget(traffic).buses.values()
    assert bus.traffic.half_duplex
    assert bus.traffic.one_by_one
    assert bus.is_met
    assert bus.round_ns is not None
    assert bus.silent_ns is not None
    assert 260_000 + 140_000 + 6 * 370_000 < bus.round_ns < 10 * MS < bus.silent_ns
    slow = robot_budget(traffic, Assumptions(answer_ns=8 * MS)).buses["follower"]
    assert [one.name for one in slow.missed if not one.sent.after]
    assert not robot_budget(traffic.at(2)).is_met


@pytest.mark.slow
def test_what_has_no_room_in_a_tick_is_named() -> None:
    """Twenty-one servos that are asked one by one take more than 10 ms: those that wait for the next tick are said."""
    traffic = robot_traffic(load_robot("minihubo_1"), rate_hz=100)
    (bus,) = robot_budget(traffic).buses.values()
    carried = [one.name for one in bus.messages if one.is_carried and not one.sent.after]
    assert 5 < len(carried) < 30
    assert not bus.is_met
    assert robot_budget(robot_traffic(load_robot("minihubo_1"), rate_hz=50)).is_met


def test_what_devices_send_by_themselves_is_found() -> None:
    """A receiver's packet five times a second, without a tick; datagrams have no bit rate, and no number."""
    traffic = robot_traffic(load_robot("rover").part("gnss"))
    (bus,) = robot_budget(traffic).buses.values()
    (message,) = bus.messages
    assert (message.name, message.sent.is_ticked, message.sent.period_ns) == ("GNSS.NavPvt", False, 200 * MS)
    assert message.response_ns == message.wire_ns == pytest.approx(100 * 10 / 38_400 * 1e9, abs=1)
    (pc,) = robot_budget(robot_traffic(load_robot("hubovia"))).buses.values()
    assert (pc.utilisation, pc.messages) == (None, ())


def test_can_fd_data_takes_the_data_bitrate() -> None:
    """With `data_bitrate` in the robot's file, the data of CAN FD frames is counted at that rate."""
    used = {}
    for more in ("", ", data_bitrate = 5_000_000"):
        robot, problems = parse_robot(
            'name = "x"\nrate_hz = 100\n[buses]\n'
            f'can = {{ link = "can", protocol = "moteus", bitrate = 1_000_000{more} }}\n'
            '[devices]\nM1 = { driver = "moteus", bus = "can", credentials = { id = 1 } }\n'
            '[joints]\nKNEE = { device = "M1" }\n'
        )
        assert robot is not None, problems
        traffic = robot_traffic(robot)
        assert traffic.buses["can"].data_bitrate == (5_000_000 if more else None)
        used[more] = robot_budget(traffic).buses["can"].utilisation or 0
    assert used[""] > 1.8 * used[", data_bitrate = 5_000_000"] > 0
