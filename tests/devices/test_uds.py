"""ECUs by UDS, and their twins."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from aces_bus.device import UNKNOWN
from aces_bus.device.stopping import stop_devices
from aces_bus.errors import CallerError, DeviceError, NoReplyError, UnknownNameError
from aces_bus.robot import VirtualRobot, parse_robot
from aces_bus.testing import driver_tests
from aces_devices.uds import driver
from aces_devices.uds.table import IdentifierEntry, UdsValue, identifiers_of
from aces_devices.uds.twin import UdsRefusal

test_uds = driver_tests(driver)


def noted(note: Callable[[Any], object], value: Any, now: int) -> None:
    """Listen to a signal: note its value, not when."""
    note(value)


def car(settings: str = "", more: str = "") -> VirtualRobot:
    """An engine's ECU, in virtual time."""
    robot, problems = parse_robot(f"""
name = "car"
rate_hz = 20
[buses]
can = {{ link = "can", protocol = "uds", bitrate = 500_000 }}
[devices.ENGINE]
driver = "uds"
bus = "can"
credentials = {{ ecu = 0 }}
[devices.ENGINE.settings]
{settings}
[devices.ENGINE.settings.identifiers]
speed = {{ identifier = 0xF40C, type = "u16", unit = "rpm", scale = 0.25 }}
limit = {{ identifier = 0x0110, type = "u16", access = "read-write", unit = "rpm", lower = 0, upper = 8000 }}
name = {{ identifier = 0x0111, type = "text", count = 20, access = "read-write" }}
{more}
""")
    assert robot is not None, problems
    return VirtualRobot(robot, rate_hz=20)


@pytest.mark.parametrize(
    ("kind", "options", "value", "data"),
    [
        ("u8", {"offset": -40}, 83, "7B"),
        ("s16", {"scale": 0.5, "offset": 1}, -61.5, "FF 83"),
        ("u16", {"order": "low first"}, 0x1234, "34 12"),
        ("float", {}, 12.5, "41 48 00 00"),
        ("text", {"count": 5}, "oven", "6F 76 65 6E 00"),
        ("bytes", {"count": 2}, "DE AD", "DE AD"),
        ("u8", {"names": {"eco": 0, "sport": 1}}, "sport", "01"),
        ("u8", {"names": {"eco": 0}}, 7, "07"),
    ],
)
def test_values_are_numbers_texts_and_names(
    kind: Any, options: dict[str, Any], value: Any, data: str
) -> None:
    """Types, order, scale and offset, names: both ways."""
    one = UdsValue("x", IdentifierEntry(identifier=1, type=kind, **options))
    assert (one.data(value), one.value(bytes.fromhex(data))) == (bytes.fromhex(data), value)


def test_a_wrong_table_is_named(tmp_path: Path) -> None:
    """Device, value and what is wrong; what does not fit is refused, and nothing cut off."""
    for entries, text in (
        ({"x": {"identifier": 70_000, "type": "u8"}}, "D: value x: Expected `int` <= 65535"),
        ({"x": {"identifier": 1, "type": "u8", "units": ""}}, "unknown field `units`"),
        ({"x": {"identifier": 1, "type": "float", "names": {"a": 1}}}, "names are of whole numbers"),
        ({n: {"identifier": 1, "type": "u8"} for n in "xy"}, "x and y have the same identifier, 0x0001"),
    ):
        with pytest.raises(CallerError, match=text):
            identifiers_of("D", None, entries)
    one = UdsValue("x", IdentifierEntry(identifier=1, type="u8", names={"eco": 0}))
    for value in (256, -1, "much"):
        with pytest.raises(CallerError, match="value x: "):
            one.data(value)
    path = tmp_path / "ecu.toml"
    path.write_text('[identifiers]\na = { identifier = 1, type = "u8" }\n', encoding="utf-8")
    assert identifiers_of("D", str(path), {"b": {"identifier": 2, "type": "u8"}}).keys() == {"a", "b"}


def test_values_and_codes_are_signals() -> None:
    """Several frames, a value of the standard, the codes that are confirmed; what the ECU has not is refused by name."""
    with car(more='other = { identifier = 0xF40A, type = "u8" }') as robot:
        engine: Any = robot.devices["ENGINE"]
        twin: Any = robot.twins["ENGINE"]
        twin.put("name", "a name of 20 letters")
        del twin.by_number[0xF40A]
        robot.advance(3.0)
        assert robot["ENGINE.name"].value == "a name of 20 letters"
        assert robot["ENGINE.speed"].value == 1726
        assert robot["ENGINE.other"].value is UNKNOWN
        assert robot.events.of("alarm")[-1].detail == "refuses read_data: out_of_range"
        assert (robot["ENGINE.codes"].value, robot["ENGINE.trouble"].value) == (1, "P0301-00")
        assert engine.read_codes("pending").wait() == {
            "P0301-00": ["failed", "pending", "confirmed"], "P0420-00": ["pending"],
        }  # fmt: skip
        assert set(engine.read_codes("all").wait()) == {"P0301-00", "P0420-00"}
        assert (robot["ENGINE.codes"].value, engine.read("speed").wait()) == (1, 1726)
        engine.clear_codes().wait()
        robot.advance(3.0)
        assert robot["ENGINE.trouble"].value == "none"


def test_nothing_is_written_before_a_session_and_a_key() -> None:
    """In the default session set-points are refused; a wrong key is, and the right one unlocks; out of limits is limited."""
    with car("level = 1") as robot:
        engine: Any = robot.devices["ENGINE"]
        twin: Any = robot.twins["ENGINE"]
        robot["ENGINE.limit"].set(3000)
        robot.advance(1.0)
        assert (twin.take("limit"), robot.events.of("not sent")[-1].device) == (0, "ENGINE")
        with pytest.raises(CallerError, match=r"level 1 needs key_of\(level, seed\)"):
            engine.write("limit", 1).wait()
        engine.key_of = lambda level, seed: seed
        with pytest.raises(DeviceError, match="unlocking level 1: refused: invalid_key"):
            engine.enable().wait()
        with pytest.raises(DeviceError, match="invalid_key"):
            engine.write("limit", 1).wait()
        assert twin.take("limit") == 0
        engine.key_of = lambda level, seed: bytes(byte ^ 0xFF for byte in seed)
        engine.enable().wait()
        robot["ENGINE.limit"].set(9000)
        robot.advance(1.0)
        assert (twin.take("limit"), robot["ENGINE.limit"].value) == (8000, 8000)
        engine.write("name", "a long name").wait()
        assert twin.take("name") == "a long name"
        engine.disable().wait()
        assert (twin.session, twin.unlocked) == ("default", 0)


def test_keys_are_not_guessed() -> None:
    """After three wrong ones none is taken for 10 s, and a key without its seed never is."""
    with car("level = 3") as robot:
        engine: Any = robot.devices["ENGINE"]
        engine.key_of = lambda level, seed: b"no"
        engine.change_session("extended").wait()
        with pytest.raises(DeviceError, match="sequence_error"):
            _key(engine, b"")
        for reason in ("invalid_key", "invalid_key", "too_many_attempts", "delay_not_over"):
            with pytest.raises(DeviceError, match=reason):
                engine.unlock(3).wait()
        robot.advance(10.0)
        engine.key_of = lambda level, seed: bytes(byte ^ 0xFF for byte in seed)
        engine.unlock(3).wait()
        engine.unlock(3).wait()  # it is unlocked: the seed is zero, and no key is sent
        assert engine.unlocked == 3


def _key(engine: Any, key: bytes) -> None:
    answer = engine.ask("AccessSecurity", reply=("Security", "Refused"), step=4, data=key).wait()
    if type(answer).__name__ == "Refused":
        raise DeviceError(answer.reason)


def test_a_session_is_kept_and_ends_with_its_tester() -> None:
    """It lasts as long as the device lives; 5 s after the last request the ECU is in the default session, locked."""
    with car() as robot:
        engine: Any = robot.devices["ENGINE"]
        twin: Any = robot.twins["ENGINE"]
        engine.polls = ()
        robot.rig.hosts["can"].slots.clear()
        engine.enable().wait()
        robot.advance(20.0)
        assert (twin.session, robot["ENGINE.session"].last) == ("extended", "extended")
        engine.session = "default"  # as if its program had ended
        robot.advance(2.5)
        assert twin.session == "extended"
        robot.advance(5.0)
        assert twin.session == "default"


def test_a_session_that_the_ecu_has_left_is_noticed() -> None:
    """Its refusal says so; the device has to be enabled anew."""
    with car() as robot:
        engine: Any = robot.devices["ENGINE"]
        twin: Any = robot.twins["ENGINE"]
        engine.enable().wait()
        twin.fault("forgets")
        with pytest.raises(DeviceError, match="service_not_in_this_session"):
            engine.write("limit", 1).wait()
        assert (engine.session, robot.events.count("rebooted", "ENGINE")) == ("default", 1)
        twin.fault("forgets", on=False)
        engine.enable().wait()
        engine.reset().wait()
        robot.advance(1.0)
        assert (engine.session, twin.session, engine.is_silent) == ("default", "default", False)


@pytest.mark.parametrize("patience", [0.3, 9.0])
def test_patience_is_had(patience: float) -> None:
    """An ECU that asks for it is waited for, however often it asks, and asked nothing else meanwhile."""
    with car("codes_every_s = 0") as robot:
        engine: Any = robot.devices["ENGINE"]
        twin: Any = robot.twins["ENGINE"]
        robot.rig.hosts["can"].slots.clear()
        twin.fault("pending", patience)
        asked = engine.read("speed")
        robot.advance(patience / 2)
        requests = twin.requests
        assert not asked.is_over
        assert asked.wait(20) == 1726
        assert (twin.requests, robot.events.count("no reply")) == (requests, 0)


def test_one_that_is_busy_is_asked_again() -> None:
    """It has not done what was asked: so nothing is done twice. What never answers is not sent again."""
    with car() as robot:
        engine: Any = robot.devices["ENGINE"]
        twin: Any = robot.twins["ENGINE"]
        engine.enable().wait()
        twin.fault("busy")
        job = engine.write("limit", 77)
        robot.advance(0.12)
        twin.fault("busy", on=False)
        job.wait()
        assert twin.take("limit") == 77
        twin.fault("silent")
        requests = twin.requests
        robot.rig.hosts["can"].slots.clear()
        with pytest.raises(NoReplyError):
            engine.write("limit", 78).wait()
        assert twin.requests == requests + 1


def test_a_late_answer_passes_for_no_other() -> None:
    """An ECU that answers later than it is waited for: no value of another identifier is taken, and none is wrong."""
    for late_s in (0.16, 0.2, 0.31):
        with car(more='last = { identifier = 0x0112, type = "u16" }') as robot:
            twin: Any = robot.twins["ENGINE"]
            twin.put("limit", 111)
            twin.put("last", 222)
            seen: dict[str, set[Any]] = {"limit": set(), "last": set()}
            for name, values in seen.items():
                robot[f"ENGINE.{name}"].listeners.append(partial(noted, values.add))
            twin.fault("late", late_s)
            robot.advance(4.0)
            assert seen["limit"] <= {111, UNKNOWN}
            assert seen["last"] <= {222, UNKNOWN}
            assert robot.events.count("late reply", "ENGINE")


def test_a_stop_ends_a_routine_and_the_session() -> None:
    """Routines run when they are started; a stop ends them and the session at once, and is loud when it cannot."""
    with car("routines = { learn = 0x0201 }") as robot:
        engine: Any = robot.devices["ENGINE"]
        twin: Any = robot.twins["ENGINE"]
        calls: list[Any] = []

        def carry_out(action: str, routine: int, data: bytes) -> bytes:
            calls.append((action, routine, data))
            return b"\x01"

        twin.carry_out = carry_out
        with pytest.raises(UnknownNameError, match="learn"):
            engine.start_routine("lern")
        with pytest.raises(DeviceError, match="results learn: refused: service_not_in_this_session"):
            engine.routine_results("learn").wait()
        assert engine.start_routine("learn", "A5 5A").wait() == b"\x01"
        assert engine.routine_results("learn").wait() == b"\x01"
        twin.fault("pending", 3.0)
        waiting = engine.read("speed")
        robot.advance(0.1)
        twin.fault("pending", on=False)
        twin._busy_until = 0
        stop_devices(robot.clock, "all", robot.devices.values()).wait(5)
        assert not waiting.is_over
        assert (twin.started, twin.session, engine.session) == (set(), "default", "default")
        assert calls == [("start", 0x201, b"\xa5\x5a"), ("results", 0x201, b""), ("stop", 0x201, b"")]
        robot.advance(6.0)
        engine.start_routine("learn").wait()
        twin.fault("silent")
        with pytest.raises(DeviceError):
            stop_devices(robot.clock, "all", robot.devices.values()).wait(10)


def test_a_stop_counts_when_it_is_the_stop_that_was_answered() -> None:
    """A late "extended" is no "default"; a refusal is named, and so is an ECU that says that it is in another session."""
    with car("timeout_s = 0.05\nevery_s = 100.0\ncodes_every_s = 0.0") as robot:
        engine: Any = robot.devices["ENGINE"]
        twin: Any = robot.twins["ENGINE"]
        robot.advance(1.0)
        twin.fault("late", 0.2)
        begun = engine.change_session("extended")
        robot.advance(0.19)
        assert begun.state == "failed"
        twin.fault("late", on=False)
        twin.fault("silent")
        stop = engine.stop_motion()
        robot.advance(0.04)
        assert engine.session == "default"
        assert stop.state == "waiting"
        assert "Session 03" in robot.events.of("late reply")[-1].detail
        robot.advance(0.1)
        assert stop.state == "failed"
        twin.fault("silent", on=False)
        assert engine.is_engaged
        stop_devices(robot.clock, "all", [engine]).wait(5)
        assert (twin.session, engine.is_engaged) == ("default", False)
        engine.enable().wait()
        answered, twin._change_session = twin._change_session, _refuse
        with pytest.raises(
            DeviceError, match=r"NOT switched off: ENGINE .*ChangeSession: refused: conditions_not"
        ):
            stop_devices(robot.clock, "all", [engine]).wait(5)
        twin._change_session = lambda request: (
            "Session",
            {"session": request.session, "answers_within": 0.05, "patience": 5.0},
        )
        twin.session = "extended"
        with pytest.raises(DeviceError, match=r"NOT switched off: ENGINE .*it says that it is in session 03"):
            stop_devices(robot.clock, "all", [engine]).wait(5)
        twin._change_session = answered
        stop_devices(robot.clock, "all", [engine]).wait(5)
        assert not [event for event in robot.events.of("alarm") if "read_data" in event.detail]


def _refuse(request: Any) -> Any:
    raise UdsRefusal("conditions_not_correct")


@pytest.mark.parametrize("after_s", [0.0, 0.001, 0.002])
def test_a_routine_is_not_started_behind_a_stop(after_s: float) -> None:
    """Whenever the stop comes while a session is begun for it: nothing runs afterwards."""
    with car("routines = { learn = 0x0201 }") as robot:
        engine: Any = robot.devices["ENGINE"]
        twin: Any = robot.twins["ENGINE"]
        twin.carry_out = lambda action, routine, data: b""
        robot.advance(1.0)
        engine.start_routine("learn")
        robot.advance(after_s)
        stop_devices(robot.clock, "all", robot.devices.values()).wait(5)
        robot.advance(0.5)
        assert (twin.started, twin.session) == (set(), "default")


def test_a_download_arrives() -> None:
    """Pieces of as many bytes as the ECU takes, in order; where it may not go, it is refused and nothing is written."""
    with car() as robot:
        engine: Any = robot.devices["ENGINE"]
        twin: Any = robot.twins["ENGINE"]
        data = bytes(range(256)) * 9
        engine.enable().wait()
        with pytest.raises(
            DeviceError, match="downloading 2304 bytes to 0x100: refused: service_not_in_this"
        ):
            engine.download(0x100, data).wait()
        engine.change_session("programming").wait()
        job = engine.download(0x100, data)
        job.wait(60)
        assert bytes(twin.memory[0x100 : 0x100 + len(data)]) == data
        assert not any(twin.memory[:0x100])
        with pytest.raises(DeviceError, match="refused: out_of_range"):
            engine.download(0xFF00, data).wait(60)


BOTH = """
name = "car"
rate_hz = 20
[buses]
can = { link = "can", protocol = "uds", bitrate = 500_000 }
[devices]
ENGINE = { driver = "uds", bus = "can", credentials = { ecu = 0 } }

[devices.OBD]
driver = "obd2"
bus = "can"
protocol = "obd2"
credentials = { ecu = 0 }
settings = { values = ["monitor_status"] }
"""


def test_one_ecu_answers_by_both() -> None:
    """The same codes and values by UDS and OBD-II; what is cleared by one is gone for the other."""
    robot, problems = parse_robot(BOTH)
    assert robot is not None, problems
    with VirtualRobot(robot, rate_hz=20) as both:
        engine: Any = both.devices["ENGINE"]
        both.advance(3.0)
        assert (both["ENGINE.codes"].value, both["OBD.codes"].value) == (1, 1)
        both.twins["ENGINE"].fault("misfire")
        both.advance(3.0)
        assert (both["ENGINE.trouble"].value, both["OBD.codes"].value) == ("P0301-00, P0302-00", 2)
        both.twins["ENGINE"].fault("misfire", on=False)
        engine.clear_codes().wait()
        both.advance(3.0)
        assert (both["ENGINE.codes"].value, both["OBD.codes"].value) == (0, 0)
