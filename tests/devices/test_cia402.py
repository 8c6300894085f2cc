"""CiA 402 drives: driver and twin over the virtual bus, bytes against the facts, canopen's own classes at either end."""

from __future__ import annotations

import logging
import re
from typing import Any

import pytest

from aces_bus import Frame
from aces_bus.device.stopping import stop_devices, wait_stopped
from aces_bus.errors import CallerError, DeviceError, NotStoppedError
from aces_bus.hardware import CanGate, ListeningNode
from aces_bus.hardware.ports import port_of
from aces_bus.robot import VirtualRobot, connect, parse_robot
from aces_bus.robot.rig import simulate
from aces_bus.runtime.loop import Loop
from aces_bus.testing import driver_tests
from aces_devices.canopen_node.dictionary import object_of
from aces_devices.cia402 import driver
from aces_devices.cia402.dictionary import dictionary_of
from aces_devices.cia402.states import drive_state, emergency_text
from aces_devices.cia402.twin import Cia402Twin
from tests.devices.cia402_drive import ONE, changes, frames, load_cia402, one_drive, running_drive

test_driver = driver_tests(driver)


# ---------------------------------------------------------------------- bytes


def test_enabling_is_the_controlwords_of_the_standard() -> None:
    """0006, 0007, 000F in RPDO 1 with mode and position, one each tick, as the state machine goes on; SYNC follows."""
    with running_drive(enabled=False) as robot:
        recorder = ListeningNode(robot.wires["drives"])
        robot.devices["D"].enable().wait(5)
        sent = changes(frames(recorder, 0x205))
        assert sent == [
            "00 00 00 00 00 00 01",
            "06 00 00 00 00 00 01",
            "07 00 00 00 00 00 01",
            "0F 00 00 00 00 00 01",
        ]
        kinds = [f.arbitration_id for f in recorder.frames()]
        assert kinds.count(0x80) == kinds.count(0x185)
        assert robot["J.state"].value == "operation enabled"


def test_setting_up_is_what_the_facts_have() -> None:
    """Identity is read, the heartbeat written, the node started: the frames of the facts, for node 5."""
    with VirtualRobot(one_drive("heartbeat_ms = 1000"), rate_hz=100, load=load_cia402) as robot:
        recorder = ListeningNode(robot.wires["drives"])
        robot.advance(1.5)
        sent = frames(recorder, 0x605)
        assert sent[0] == "40 00 10 00 00 00 00 00"
        assert "2B 17 10 00 E8 03 00 00" in sent
        assert frames(recorder, 0x000) == ["01 05"]  # once, also with the boot-up message between
        assert frames(recorder, 0x705)[0] == "00"
        assert "05" in frames(recorder, 0x705)


def test_every_worked_example_reaches_the_drive() -> None:
    """Mode 8, controlword 000F, target −1000 and the statusword, byte for byte as in the facts, are sent and received."""
    with running_drive(enabled=False) as robot:
        recorder = ListeningNode(robot.wires["drives"])
        device = robot.devices["D"]
        device.write("0x6060", 8, confirm=True).wait(1)
        device.write("controlword", 0x0F, confirm=True).wait(1)
        device.write("607A", -1000, confirm=True).wait(1)
        device.read("Statusword").wait(1)
        assert frames(recorder, 0x605) == [
            "2F 60 60 00 08 00 00 00",
            "2B 40 60 00 0F 00 00 00",
            "23 7A 60 00 18 FC FF FF",
            "40 41 60 00 00 00 00 00",
        ]
        assert robot.twins["D"].axes[0].objects[0x607A] == -1000
        with pytest.raises(DeviceError, match="refuses object 6065:0: it has another length"):
            device.sdo.download(0x6065, 0, b"\x01").wait(1)
        with pytest.raises(DeviceError, match="refuses object 5FFF:0: the drive has no such object"):
            device.read("5FFF").wait(1)


def test_written_pdos_are_the_mapping_of_the_facts() -> None:
    """With pdo = "write" RPDO 1 is 6040 and 607A first: 000F and −1000 make `0F 00 18 FC FF FF` as in the facts."""
    with running_drive('pdo = "write", mode = "cyclic_position"') as robot:
        recorder = ListeningNode(robot.wires["drives"])
        robot["J.position"].set(-1000 / 100_000 * 6.283185307179586)
        robot.advance(0.1)
        assert frames(recorder, 0x205)[-1].startswith("0F 00 18 FC FF FF")
        assert robot["J.position"].value == pytest.approx(-0.0628, abs=1e-3)


# ---------------------------------------------------------------------- motion


def test_profile_position_hands_over_each_target() -> None:
    """Bit 4 rises with the target, falls when it was taken; a target set meanwhile follows."""
    with running_drive() as robot:
        recorder = ListeningNode(robot.wires["drives"])
        robot["J.position"].set(0.5)
        robot["J.position"].set(0.2)
        robot.advance(0.5)
        robot["J.position"].set(1.0)
        robot.advance(3)
        words = [one[:2] for one in changes([f[:5] for f in frames(recorder, 0x205)])]
        assert words[:4] in (["3F", "0F", "3F", "0F"], ["0F", "3F", "0F", "3F"])
        assert robot["J.position"].value == pytest.approx(1.0, abs=1e-4)
        assert robot["J.reached"].value is True


def test_velocity_and_torque_modes_take_their_own_set_points() -> None:
    """A mode's target can be set and nothing else; another mode begins with no speed and no torque."""
    with running_drive() as robot:
        device = robot.devices["D"]
        assert [robot[f"J.{name}"].is_writable for name in ("position", "velocity", "torque")] == [
            True,
            False,
            False,
        ]
        device.set_mode("profile_velocity").wait(2)
        assert [robot[f"J.{name}"].is_writable for name in ("position", "velocity", "torque")] == [
            False,
            True,
            False,
        ]
        robot["J.velocity"].set(0.5)
        robot.advance(1)
        assert robot["J.velocity"].value == pytest.approx(0.5, rel=0.01)
        device.set_mode("cyclic_torque").wait(2)
        assert robot["J.mode"].value == "cyclic_torque"
        robot.advance(0.2)
        assert robot["J.torque"].value == 0
        robot["J.torque"].set(0.25)
        robot.advance(0.1)
        assert robot["J.torque"].value == pytest.approx(0.25)
        with pytest.raises(CallerError, match="no mode 'profile_velocty'"):
            device.set_mode("profile_velocty")


def test_a_mode_that_the_drive_does_not_have_is_told() -> None:
    """Without cyclic torque among the drive's modes: after a second the driver says so."""
    with running_drive() as robot:
        robot.twins["D"].axes[0].objects[0x6502] = 0x3
        with pytest.raises(DeviceError, match="does not go into mode cyclic_torque"):
            robot.devices["D"].set_mode("cyclic_torque").wait(5)


def test_objects_that_no_pdo_has_go_over_sdo() -> None:
    """The target of velocity mode, 6042, is mapped nowhere: it is written as an object."""
    with running_drive('mode = "velocity"', more='command = "speed"') as robot:
        robot["J.velocity"].set(0.3)
        robot.advance(1)
        assert robot["J.velocity"].value == pytest.approx(0.3, rel=0.01)


def test_set_points_of_a_disabled_axis_are_dropped() -> None:
    """Before it is enabled nothing moves, and the dropped set-point is told; enabling holds where it is."""
    with running_drive(enabled=False) as robot:
        robot["J.position"].set(1.0)
        robot.advance(0.05)
        assert "J is not enabled but switch on disabled" in robot.events.of("not sent")[0].detail
        robot.devices["D"].enable().wait(5)
        robot.advance(0.5)
        assert robot["J.position"].value == 0


def test_a_drive_that_is_enabled_already_stays_so() -> None:
    """A second program's set-point, given before the drive was heard, moves it; its first controlword is 000F."""
    with running_drive("watchdog_ms = 0") as robot:
        robot.rig.close()
        second = connect(robot.robot, robot.ports("second"), rate_hz=100, load=load_cia402)
        with second:
            recorder = ListeningNode(robot.wires["drives"])
            second["J.position"].set(0.3)
            robot.advance(2)
            assert frames(recorder, 0x205)[0].startswith("3F 00")
            assert second["J.position"].value == pytest.approx(0.3, abs=1e-3)


def test_quick_stop_stops_a_movement() -> None:
    """Stopping ramps down within what 6085 allows, and the drive is not enabled any more."""
    with running_drive() as robot:
        robot["J.position"].set(1.4)
        robot.advance(0.2)
        moving = robot["J.position"].value
        robot.devices["D"].stop_motion().wait(2)
        robot.advance(0.5)
        assert robot["J.state"].value == "switch on disabled"
        assert 0 < moving <= robot["J.position"].value < 1.0
        robot.devices["D"].enable().wait(5)
        robot.advance(0.5)
        assert robot["J.position"].value < 1.0


def test_a_stop_does_not_wait_for_the_tick() -> None:
    """The controlword leaves at once, in the PDO or, where it is in none, over SDO, instead of transfers that wait."""
    with running_drive() as robot:
        robot["J.position"].set(1.4)
        robot.advance(0.203)
        recorder = ListeningNode(robot.wires["drives"])
        robot.devices["D"].stop_motion()
        robot.advance(0.0005)
        assert [(f.arbitration_id, f.data[:2].hex()) for f in recorder.frames()] == [(0x205, "0200")]
    with running_drive() as robot:
        device: Any = robot.devices["D"]
        device._takers.clear()  # as of a drive that has it in no PDO
        reads = [device.read(0x1008) for _ in range(5)]
        robot.advance(0.0011)
        recorder = ListeningNode(robot.wires["drives"])
        stop = device.stop_motion()
        robot.advance(0.0005)
        assert frames(recorder, 0x605) == ["2B 40 60 00 02 00 00 00"]
        robot.advance(0.3)
        assert {read.state for read in reads[2:]} == {"failed"}
        assert stop.state == "done"
        assert robot["J.state"].value != "operation enabled"


@pytest.mark.parametrize("is_known", [False, True])
def test_a_stop_reaches_a_drive_that_takes_no_pdos(is_known: bool) -> None:
    """Pre-operational, as its heartbeat says or does not say yet: it is stopped, and its statusword is read, over SDO."""
    with running_drive() as robot:
        robot["J.position"].set(1.0)
        robot.advance(0.3)
        twin, axis = robot.twins["D"], robot.twins["D"].axes[0]
        twin.fault("no_heartbeat", on=not is_known)
        twin.node.nmt.state = "PRE-OPERATIONAL"
        robot.advance(0.2)
        assert axis.state == "operation enabled"
        stopping = robot.devices["D"].stop_motion()
        robot.advance(0.15)
        assert axis.state != "operation enabled"
        stopping.wait(0.1)


def test_a_stop_over_sdo_counts_when_the_statusword_says_so() -> None:
    """A drive that acknowledges the controlword and does not obey is named."""
    with running_drive() as robot:
        twin, axis = robot.twins["D"], robot.twins["D"].axes[0]
        twin.node.nmt.state = "PRE-OPERATIONAL"
        axis.written = lambda *_: None
        with pytest.raises(NotStoppedError, match="J stays enabled"):
            wait_stopped(stop_devices(robot.clock, "one", [robot.devices["D"]]))
        assert axis.state == "operation enabled"


def test_stopping_ends_what_leads_the_drive_on() -> None:
    """A stop in the middle of enabling or homing has the last say: the job fails, and the drive stays disabled."""
    with running_drive(enabled=False) as robot:
        device = robot.devices["D"]
        for begin in (device.enable, device.home):
            job = begin()
            robot.advance(0.05)
            device.stop_motion().wait(2)
            robot.advance(1)
            assert job.state == "failed"
            assert robot["J.state"].value != "operation enabled"


def test_homing_sets_the_offset_and_says_when_it_fails() -> None:
    """Method 17 runs to the negative switch, whose count is 607C afterwards; without a switch the job fails by name."""
    with running_drive() as robot:
        device = robot.devices["D"]
        device.write("Home offset", -20_000, confirm=True).wait(1)
        job = device.home(method=17)
        robot.advance(0.3)
        assert job.text == "J searches"
        job.wait(30)
        robot.advance(0.1)
        assert robot["J.position"].value == pytest.approx(-20_000 / 100_000 * 6.283185, abs=1e-3)
        assert robot["J.mode"].value == "profile_position"
        assert robot["J.state"].value == "operation enabled"
        robot.twins["D"].fault("no_home")
        with pytest.raises(
            DeviceError, match="J has not found home: homing error \\(0xFF01, device specific"
        ):
            device.home().wait(30)


def test_long_objects_are_read_and_written_in_segments() -> None:
    """The device's name has 14 bytes; reading it takes two segments."""
    with running_drive(enabled=False) as robot:
        recorder = ListeningNode(robot.wires["drives"])
        assert robot.devices["D"].read("Device name").wait(1) == "aces-bus drive"
        assert [one[:2] for one in frames(recorder, 0x605)] == ["40", "60", "70"]
        found = robot.devices["D"].identity().wait(1)
        assert found["type"] == 0x20192
        assert found["name"] == "aces-bus drive"


def test_writing_wants_a_word() -> None:
    """A write without confirm=true is refused before anything is sent; so is a value that does not fit."""
    with running_drive(enabled=False) as robot:
        device = robot.devices["D"]
        with pytest.raises(CallerError, match="confirm=true"):
            device.write("607A", 5)
        with pytest.raises(CallerError, match="is not a value of Target position"):
            device.write("607A", 1 << 40, confirm=True)
        with pytest.raises(CallerError, match="did you mean 'target position'"):
            device.read("Target positon")


def test_files_that_are_none_are_refused(tmp_path: Any) -> None:
    """A missing file, and one without a statusword, are named."""
    with pytest.raises(CallerError, match=r"nowhere\.eds: No such file"):
        dictionary_of(str(tmp_path / "nowhere.eds"), 5)
    other = tmp_path / "other.eds"
    other.write_text(
        "[DeviceInfo]\nVendorName=none\n[1000]\nParameterName=Device type\nObjectType=7\nDataType=7\nAccessType=ro\n"
    )
    with pytest.raises(CallerError, match="no statusword"):
        dictionary_of(str(other), 5)
    other.write_text("[1000]\nCompactSubObj=1\n[1000Name]\nNrOfEntries=999999999\n")
    with pytest.raises(CallerError, match="NrOfEntries = 999999999 is more than a device has"):
        dictionary_of(str(other), 6)
    text = ONE.replace("SETTINGS", "sync = true").replace("MORE", 'command = "position"')
    robot, _ = parse_robot(text, "one.toml")
    assert robot is not None
    with pytest.raises(CallerError, match="needs its counts"):
        VirtualRobot(robot, load=load_cia402)


def test_statuswords_and_codes() -> None:
    """0637 of the facts is enabled, remote, reached; codes name their group."""
    assert drive_state(0x0637) == "operation enabled"
    assert emergency_text(0x2310) == "0x2310, current, output side"
    assert object_of(dictionary_of(None, 5), "6099:2")[:2] == (0x6099, 2)


def _two_axes() -> str:
    """Our drive's file with a second axis: its objects 0x800 higher, and PDOs 3 and 4 each way."""
    from importlib.resources import files

    text = (files("aces_devices.cia402") / "drive.eds").read_text("utf-8")
    more: list[str] = []
    for part in re.split(r"(?m)^(?=\[)", text):
        head = re.match(r"\[([0-9A-F]{4})(sub[0-9A-F]+)?\]", part)
        if head is None:
            continue
        index = int(head[1], 16)
        step = 0x800 if index >= 0x6000 else 2 if 0x1400 <= index < 0x1B00 else 0
        if step:
            moved = f"[{index + step:04X}{head[2] or ''}]" + part[part.index("]") + 1 :]
            for base in (0x180, 0x280, 0x200, 0x300):
                moved = moved.replace(f"$NODEID+0x{base:X}\n", f"$NODEID+0X{base + 0x200:X}\n")
            more.append(moved.replace("0X", "0x"))
    return text + "".join(more)


def test_a_drive_of_two_axes(tmp_path: Any) -> None:
    """Each joint has its own objects, state and PDOs; one is enabled and moved without the other."""
    path = tmp_path / "two.eds"
    path.write_text(_two_axes())
    text = ONE.replace("SETTINGS", f'counts_per_turn = 100_000, eds = "{path}", pdo = "write"')
    text = (
        text.replace("MORE", 'command = "position"')
        + 'K = { device = "D", channel = 1, command = "speed" }\n'
    )
    robot, problems = parse_robot(text, "two.toml")
    assert robot is not None, problems
    with VirtualRobot(robot, rate_hz=100, load=load_cia402) as running:
        running.advance(0.5)
        device = running.devices["D"]
        device.enable("K").wait(5)
        assert (running["J.state"].value, running["K.state"].value) == (
            "switch on disabled",
            "operation enabled",
        )
        running["K.velocity"].set(0.5)
        running.advance(1)
        assert running["K.velocity"].value == pytest.approx(0.5, rel=0.01)
        assert running["J.position"].value == 0
        device.enable("J").wait(5)
        running["J.position"].set(0.2)
        running.advance(1)
        assert running["J.position"].value == pytest.approx(0.2, abs=1e-3)
        running.twins["D"].axes[0x800].fail(0x8611)
        running.advance(0.1)
        assert (running["J.state"].value, running["K.state"].value) == ("operation enabled", "fault")


def test_an_axis_shows_what_its_own_objects_say(tmp_path: Any) -> None:
    """Both axes' PDOs hold objects of the first alone: of the second, nothing that is polled says anything."""
    path = tmp_path / "two.eds"
    path.write_text(_two_axes())
    text = ONE.replace("SETTINGS", f'counts_per_turn = 100_000, eds = "{path}", pdo = "file"')
    robot, problems = parse_robot(
        text.replace("MORE", 'command = "position"') + 'K = { device = "D", channel = 1 }\n', "two.toml"
    )
    assert robot is not None, problems
    device = VirtualRobot(robot, rate_hz=100, load=load_cia402).devices["D"]
    for name in ("position", "velocity", "torque", "state"):
        assert (f"J.{name}" in device.readable, f"K.{name}" in device.readable) == (True, False)


def test_an_action_without_a_joint_is_every_axis_s(tmp_path: Any) -> None:
    """Enabled, faulted, reset and disabled without a name, both axes of a drive are."""
    path = tmp_path / "two.eds"
    path.write_text(_two_axes())
    text = ONE.replace("SETTINGS", f'counts_per_turn = 100_000, eds = "{path}", pdo = "write"')
    text = text.replace("MORE", 'command = "position"') + 'K = { device = "D", channel = 1 }\n'
    robot, problems = parse_robot(text, "two.toml")
    assert robot is not None, problems

    def states() -> list[Any]:
        return [running[f"{name}.state"].value for name in "JK"]

    with VirtualRobot(robot, rate_hz=100, load=load_cia402) as running:
        running.advance(0.5)
        device = running.devices["D"]
        device.enable().wait(5)
        assert states() == ["operation enabled"] * 2
        for axis in running.twins["D"].axes.values():
            axis.fail(0x8611)
        running.advance(0.1)
        assert states() == ["fault"] * 2
        device.reset_fault().wait(5)
        assert states() == ["switch on disabled"] * 2
        device.enable().wait(5)
        running.twins["D"].axes[0x800].fail(0x8611)
        running.advance(0.1)
        device.reset_fault().wait(5)  # who has none keeps its state
        assert states() == ["operation enabled", "switch on disabled"]


# ---------------------------------------------------------------------- canopen's own classes, in real time


def test_canopens_own_drive_class_drives_the_twin() -> None:
    """`BaseNode402` enables the twin and reads its position, over python-can, in real time."""
    canopen = pytest.importorskip("canopen")
    from canopen.profiles import p402

    logging.getLogger("canopen").setLevel(logging.CRITICAL)
    with Loop() as loop:
        gate = CanGate({"interface": "aces", "channel": "cia402 twin"}, name="drives")
        simulation = simulate(one_drive(), {"drives": port_of(gate, loop)}, load=load_cia402)
        with simulation:
            network = canopen.Network()
            network.NOTIFIER_CYCLE = 0.01
            network.connect(interface="aces", channel="cia402 twin")
            try:
                drive: Any = p402.BaseNode402
                node = drive(5, dictionary_of(None, 5))
                network.add_node(node)
                node.nmt.state = "PRE-OPERATIONAL"
                assert node.sdo[0x1008].raw == "aces-bus drive"
                for number in (1, 2):
                    node.rpdo[number].read()
                    node.tpdo[number].read()
                node.setup_402_state_machine(read_pdos=False)
                node.nmt.state = "OPERATIONAL"
                for word in (6, 7, 15):
                    node.sdo[0x6040].raw = word
                assert node.sdo[0x6041].raw & 0x6F == 0x27
                network.sync.transmit()
                assert loop.wait(lambda: node.statusword & 0x6F == 0x27, 1_000_000_000)
                assert node.state == "OPERATION ENABLED"
            finally:
                network.disconnect()


@pytest.mark.slow
def test_driver_and_twin_meet_in_real_time() -> None:
    """On two gates of one bus, each with the loop's thread: set up, enabled, moved, without a sleep."""
    robot = one_drive()
    with Loop() as loop:
        gates = [CanGate({"interface": "aces", "channel": "cia402 real"}, name=f"gate {n}") for n in (1, 2)]
        with (
            simulate(robot, {"drives": port_of(gates[0], loop)}, load=load_cia402),
            connect(robot, {"drives": port_of(gates[1], loop)}, rate_hz=100, load=load_cia402) as rig,
        ):
            device: Any = rig.devices["D"]
            assert loop.wait(lambda: device.is_set_up, 3_000_000_000)
            loop.call(device.enable).wait(3)
            loop.call(lambda: rig["J.position"].set(0.05))
            assert loop.wait(lambda: abs((rig["J.position"].value or 0) - 0.05) < 1e-3, 3_000_000_000)
        assert not loop.failures


def test_a_twins_axes_are_there_before_its_node_speaks(monkeypatch: pytest.MonkeyPatch) -> None:
    """The node's first timer may run on the clock's thread, in life, before `setup` has ended."""
    known: list[bool] = []
    add_node = Cia402Twin.add_node

    def recorded(self: Cia402Twin, dictionary: Any) -> None:
        known.append(len(self.axes) == 1)
        add_node(self, dictionary)

    monkeypatch.setattr(Cia402Twin, "add_node", recorded)
    with VirtualRobot(one_drive(), rate_hz=100, load=load_cia402) as robot:
        robot.twins["D"].reboot()
    assert known == [True, True]


def test_the_driver_speaks_to_a_bare_node_of_canopen() -> None:
    """What no twin of ours answers: a plain `LocalNode` gives the driver's SDO what canopen's own client reads."""
    canopen = pytest.importorskip("canopen")
    from aces_devices.canopen_node.network import StationNetwork

    robot = VirtualRobot(
        one_drive('sync = false, pdo = "file"', 'command = "position"'), rate_hz=100, load=load_cia402
    )
    port = robot.ports("bare")["drives"]
    node = canopen.LocalNode(5, dictionary_of(None, 5))
    network = StationNetwork(robot.clock, lambda identifier, data: port.send(Frame(identifier, data)))
    network[5] = node
    port.open(lambda frame, now: network.notify(frame.arbitration_id, bytearray(frame.data), now / 1e9))
    robot.rig.open()
    device: Any = robot.devices["D"]
    assert device.sdo.upload(0x1008).wait(5) == b"aces-bus drive"
    device.sdo.download(0x6081, 0, (1234).to_bytes(4, "little")).wait(5)
    assert node.sdo[0x6081].raw == 1234
    robot.rig.close()
