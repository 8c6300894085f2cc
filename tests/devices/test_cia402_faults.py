"""CiA 402 drives in trouble: faults, warnings, reboots, silence, and a host that is gone."""

from __future__ import annotations

import pytest

from aces_bus.device import UNKNOWN
from aces_bus.errors import CallerError, DeviceError
from aces_bus.hardware import ListeningNode
from aces_bus.robot import VirtualRobot, parse_robot
from tests.devices.cia402_drive import ONE, frames, load_cia402, one_drive, running_drive


def test_a_following_error_is_a_fault_until_it_is_acknowledged() -> None:
    """A blocked joint: EMCY 8611 is an alarm, the state is fault, enabling says what to do, resetting helps."""
    with running_drive() as robot:
        device, twin = robot.devices["D"], robot.twins["D"]
        twin.fault("jammed")
        robot["J.position"].set(1.0)
        robot.advance(1)
        assert robot["J.state"].value == "fault"
        assert robot["D.error"].value == "0x8611, following error"
        assert "0x8611" in robot.events.of("alarm")[0].detail
        with pytest.raises(
            DeviceError, match="J is in fault \\(0x8611, following error\\); reset_fault first"
        ):
            device.enable().wait(5)
        twin.fault("jammed", on=False)
        device.reset_fault().wait(5)
        assert robot["D.error"].value == ""
        assert robot.events.count("alarm over", "D") == 1
        robot.advance(0.5)
        assert robot["J.state"].value == "switch on disabled"
        device.enable().wait(5)


def test_a_fault_stays_while_its_cause_is_there() -> None:
    """Over-voltage cannot be acknowledged away; resetting fails and names it."""
    with running_drive() as robot:
        robot.twins["D"].fault("over_voltage")
        robot.advance(0.1)
        with pytest.raises(DeviceError, match="J stays in fault: 0x3210, voltage inside"):
            robot.devices["D"].reset_fault().wait(5)
        robot.twins["D"].fault("over_voltage", on=False)
        robot.devices["D"].reset_fault().wait(5)


def test_a_hot_drive_warns() -> None:
    """The warning bit is a signal, the emergency an alarm; both go."""
    with running_drive() as robot:
        robot.twins["D"].fault("hot")
        robot.advance(0.1)
        assert robot["J.warning"].value is True
        assert robot["D.error"].value == "0x4210, device temperature"
        robot.twins["D"].fault("hot", on=False)
        robot.advance(0.1)
        assert robot["J.warning"].value is False


def test_a_reboot_is_told_and_leaves_the_drive_disabled() -> None:
    """After its boot-up message the node is set up again; nothing that was known stays, nothing moves."""
    with running_drive() as robot:
        robot["J.position"].set(0.5)
        robot.advance(2)
        robot.twins["D"].reboot()
        robot.advance(0.004)
        assert robot["J.position"].value is UNKNOWN or robot["J.state"].value != "operation enabled"
        robot.advance(1)
        assert robot.events.count("rebooted", "D") == 1
        assert robot["J.state"].value == "switch on disabled"
        assert robot["J.position"].value == pytest.approx(0.5, abs=1e-3)
        robot.devices["D"].enable().wait(5)


def test_a_node_without_sync_falls_silent_by_its_heartbeat() -> None:
    """A drive that sends by itself is missed when neither PDOs nor heartbeats come."""
    with running_drive('pdo = "write", sync = false, heartbeat_ms = 100') as robot:
        assert not [f for f in (ListeningNode(robot.wires["drives"]).frames()) if f.arbitration_id == 0x80]
        robot.twins["D"].fault("silent")
        robot.advance(1)
        assert "no heartbeat for" in robot.events.of("silent")[0].detail
        assert robot["J.position"].is_stale
        robot.twins["D"].fault("silent", on=False)
        robot.advance(1)
        assert robot.events.count("answers", "D") == 1
        assert robot["J.position"].value == 0


def test_a_lost_heartbeat_alone_makes_the_network_state_unknown() -> None:
    """PDOs go on; the state of the node is stale."""
    with running_drive("heartbeat_ms = 100") as robot:
        robot.twins["D"].fault("no_heartbeat")
        robot.advance(1)
        assert robot["D.network"].value is UNKNOWN
        assert robot["J.state"].value == "operation enabled"


def test_a_stopped_node_is_not_expected_to_answer() -> None:
    """After NMT stop no PDO comes and nobody complains; after start they come again."""
    with running_drive(enabled=False) as robot:
        robot.devices["D"].nmt("stop").wait(1)
        robot.advance(1)
        assert robot["D.network"].value == "stopped"
        assert robot["J.position"].is_stale
        assert robot.events.count("silent") == 0
        robot.devices["D"].nmt("start").wait(1)
        robot.advance(0.2)
        assert robot["J.position"].value == 0
        with pytest.raises(CallerError, match="no command 'go'"):
            robot.devices["D"].nmt("go")


def test_a_refused_set_up_is_an_alarm_with_what_to_do() -> None:
    """A drive that refuses SDO cannot be set up; that is told with the object and the reason, again and again not."""
    with VirtualRobot(one_drive(), rate_hz=100, load=load_cia402) as robot:
        robot.twins["D"].fault("refuses")
        robot.advance(1)
        assert "cannot be set up: D refuses object 1000:0" in robot.events.of("alarm")[0].detail
        robot.twins["D"].fault("refuses", on=False)
        robot.advance(3)
        assert robot.devices["D"].is_set_up


def test_a_mapping_that_cannot_work_says_how_to_change_it() -> None:
    """The drive sends its statusword on events where SYNC is expected: named, with the settings that help."""
    with VirtualRobot(one_drive(), rate_hz=100, load=load_cia402) as robot:
        robot.twins["D"].node.set_data(0x1800, 2, b"\xff")
        robot.advance(0.5)
        detail = robot.events.of("alarm")[0].detail
        assert "PDO 1 is sent by transmission type 255, not at each SYNC" in detail
        assert 'pdo = "write"' in detail


# ---------------------------------------------------------------------- the watch over the host


def test_an_enabled_drive_watches_over_the_host() -> None:
    """Enabling writes object 1016 (node 127, 500 ms) before the first controlword; heartbeats come; stopping ends it."""
    with running_drive(enabled=False) as robot:
        recorder = ListeningNode(robot.wires["drives"])
        robot.devices["D"].enable().wait(5)
        robot.advance(2)
        assert "23 16 10 01 F4 01 7F 00" in frames(recorder, 0x605)
        first = [
            f.arbitration_id for f in recorder.frames() if f.arbitration_id == 0x605 or f.data[:1] == b"\x06"
        ]
        assert first[0] == 0x605
        assert set(frames(recorder, 0x77F)) == {"05"}
        assert len(frames(recorder, 0x77F)) >= 4 * 3
        assert robot["J.state"].value == "operation enabled"
        assert robot.devices["D"].host_loss.after_s == 0.5
        robot.devices["D"].stop_motion().wait(2)
        assert "23 16 10 01 00 00 7F 00" in frames(recorder, 0x605)
        before = len(frames(recorder, 0x77F))
        robot.advance(2)
        assert len(frames(recorder, 0x77F)) <= before + 1
        assert robot.events.count("alarm") == 0


def test_a_drive_without_its_host_goes_into_fault_and_is_enabled_anew() -> None:
    """No heartbeat for 500 ms: it disables itself with emergency 8130; acknowledged and enabled, it works again."""
    with running_drive() as robot:
        recorder = ListeningNode(robot.wires["drives"])
        device, axis = robot.devices["D"], robot.twins["D"].axes[0]
        port = device.host.port
        send = port.send
        port.send = lambda frame, *a, **k: (
            True if getattr(frame, "arbitration_id", 0) == 0x77F else send(frame, *a, **k)
        )
        robot.advance(0.3)
        assert axis.state == "operation enabled"
        robot.advance(0.4)
        assert axis.state == "fault"
        assert frames(recorder, 0x085) == ["30 81 11 00 00 00 00 00"]
        assert "heartbeat" in robot["D.error"].value
        port.send = send
        robot.advance(1)
        assert robot["D.network"].value == "pre_operational"
        device.stop_motion().wait(2)  # over SDO: it takes no PDOs
        device.reset_fault().wait(5)
        device.enable().wait(5)
        robot.advance(1)
        assert robot["J.state"].value == "operation enabled"


@pytest.mark.parametrize(
    ("option", "state"), [(2, "switch on disabled"), (3, "switch on disabled"), (0, "fault")]
)
def test_what_a_drive_does_without_its_host_is_its_own_affair(option: int, state: str) -> None:
    """Object 6007 as it is there counts (disable, quick stop); only "nothing" is made a fault."""
    with running_drive(enabled=False) as robot:
        device = robot.devices["D"]
        device.write("6007", option, confirm=True).wait(1)
        device.enable().wait(5)
        device.host.close()
        robot.advance(2)
        axis = robot.twins["D"].axes[0]
        axis.advance(robot.clock.now())
        assert axis.state == state


def test_one_heartbeat_a_bus() -> None:
    """Two drives, one of them stopped: one heartbeat goes on, as often as the shorter watch wants."""
    text = ONE.replace("SETTINGS", "counts_per_turn = 100_000").replace(", MORE", "")
    text += 'K = { device = "E", channel = 0, lower = -1, upper = 1 }\n'
    text = text.replace(
        "[joints]",
        'E = { driver = "cia402", bus = "drives", credentials = { node = 6 },'
        " settings = { counts_per_turn = 1000, watchdog_ms = 200 } }\n[joints]",
    )
    robot, problems = parse_robot(text, "two.toml")
    assert robot is not None, problems
    with VirtualRobot(robot, rate_hz=100, load=load_cia402) as two:
        two.advance(0.5)
        for name in ("D", "E"):
            two.devices[name].enable().wait(5)
        recorder = ListeningNode(two.wires["drives"])
        two.advance(2)
        assert 38 <= len(frames(recorder, 0x77F)) <= 42
        two.devices["D"].stop_motion().wait(2)
        two.advance(2)
        assert two["K.state"].value == "operation enabled"
        assert len(frames(recorder, 0x77F)) > 70


def test_a_watch_that_cannot_be_had_is_an_error_with_the_way_out() -> None:
    """All entries of 1016 watch others: enabling fails and says so; watchdog_ms = 0 does without."""
    with running_drive(enabled=False) as robot:
        device = robot.devices["D"]
        for entry in (1, 2):
            device.write(f"1016:{entry}", (entry << 16) + 100, confirm=True).wait(1)
        with pytest.raises(
            DeviceError, match=r"all 2 entries of object 1016 watch other nodes.*watchdog_ms = 0"
        ):
            device.enable().wait(5)
        assert robot.twins["D"].axes[0].state == "switch on disabled"
    with running_drive("watchdog_ms = 0") as robot:
        recorder = ListeningNode(robot.wires["drives"])
        robot.advance(1)
        assert frames(recorder, 0x77F) == []
    with pytest.raises(CallerError, match="host_node = 5 is the node's own number"):
        VirtualRobot(one_drive("host_node = 5"), rate_hz=100, load=load_cia402)
