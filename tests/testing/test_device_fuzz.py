"""Devices are fuzzed: each fault that is planted in a twin is found, made small, and shown again by its capture."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from aces_bus import make_scanner
from aces_bus.device import Driver, load_driver, on
from aces_bus.errors import CallerError, DeviceError, NotStoppedError, UnknownNameError
from aces_bus.robot import VirtualRobot
from aces_bus.runtime import VirtualClock
from aces_lab.device_fuzz.fuzzer import DeviceFuzzer, capture_steps, example_of, fuzz_device
from aces_lab.device_fuzz.live import LiveDeviceFuzzer
from aces_lab.device_fuzz.trial import Expectations, TwinTrial
from tests.testing.faulty_pumps import (
    FAULTS,
    WATCHDOG_NS,
    AnswersAnothersNumber,
    HangsOnABoundary,
    PlantedFault,
    PumpTwin,
    pump,
)

LINKS = ("can", "serial")
#: Packets until which each must be found; a second's worth, or a few.
PACKETS = 12_000


def _planted() -> list[Any]:
    """Each fault on CAN; on a line every third in the short profile, as there packets take longer."""
    return [
        pytest.param(
            fault,
            link,
            id=f"{fault}-{link}",
            marks=[pytest.mark.slow] if link == "serial" and number % 3 else [],
        )
        for number, fault in enumerate(FAULTS)
        for link in LINKS
    ]


@pytest.mark.parametrize(("fault", "link"), _planted())
def test_a_planted_fault_is_found_small_and_again(fault: PlantedFault, link: str, tmp_path: Path) -> None:
    """It is found by what it does, in no more steps than it takes; a fresh twin breaks when its capture is played."""
    driver = pump(fault.twin, link)
    (finding,) = fuzz_device(driver, seed=1, packets=PACKETS, most=1, expected=fault.expected)
    assert finding.problem.kind == fault.kind
    assert len(finding.steps) <= fault.packets
    robot, name = example_of(driver)
    again = DeviceFuzzer(robot, name, expected=fault.expected, load={driver.name: driver}.__getitem__)
    path = finding.save(tmp_path)
    problem, _, _ = again.judged(capture_steps(str(path), link))
    assert problem is not None
    assert problem.key == finding.problem.key


@pytest.mark.parametrize("link", LINKS)
def test_a_sound_device_has_no_findings(link: str) -> None:
    """Nothing is found where nothing is, whatever is expected besides."""
    expected = Expectations(rests_ns=2 * WATCHDOG_NS, actions=("turn",))
    assert fuzz_device(pump(link=link), seed=1, packets=1500, expected=expected) == []


def test_the_same_seed_finds_the_same(tmp_path: Path) -> None:
    """To the byte of its capture."""
    one, other = (fuzz_device(pump(HangsOnABoundary), seed=1, packets=2000, most=1)[0] for _ in range(2))
    assert one.stem == other.stem
    assert one.save(tmp_path / "a.log").read_bytes() == other.save(tmp_path / "b.log").read_bytes()


@pytest.mark.slow
def test_what_is_left_out_is_not_sent() -> None:
    """A message, or one with some values of a field, however its frame was made; what there is not is named."""
    driver = pump(HangsOnABoundary)
    for left_out in ("Configure", "Configure.value=0xFFFF"):
        assert fuzz_device(driver, seed=1, packets=1500, leave_out=[left_out]) == []
    assert fuzz_device(driver, seed=1, packets=500, only=["Ask", "Read"]) == []
    for wrong in ("Configura", "Configure.valve=1"):
        with pytest.raises(UnknownNameError):
            fuzz_device(driver, leave_out=[wrong])
    with pytest.raises(CallerError, match=r"Configure\.address=0\.\.8"):
        fuzz_device(driver, leave_out=["Configure=3"])


def test_a_judge_of_ones_own() -> None:
    """What it says is wrong is a finding under its name."""

    def is_fast(trial: TwinTrial) -> str | None:
        return "it is fast" if vars(trial.twin)["speed"] > 2000 else None

    (found,) = fuzz_device(
        pump(), seed=1, packets=3000, most=1, expected=Expectations(judges={"too fast": is_fast})
    )
    assert found.problem.kind == "too fast"
    assert [type(record).__name__ for record in found.records()] == ["SetSpeed"]


# ---------------------------------------------------------------------- as a real device


def live(driver: Driver, **options: Any) -> tuple[VirtualRobot, LiveDeviceFuzzer]:
    """A pump that plays the real one, in virtual time, and the search on its bus."""
    robot, name = example_of(driver)
    load = {driver.name: driver}.__getitem__
    world = VirtualRobot(robot, load=load)
    world.simulation.open()
    return world, LiveDeviceFuzzer(robot, name, world.ports("fuzz"), seed=1, load=load, **options)


def sent_messages(fuzzer: LiveDeviceFuzzer) -> list[str]:
    """What went to the device, by name."""
    variant = fuzzer.device.variant
    scanner: Any = make_scanner([variant], direction="to device", include_unknown=True)
    packets = [packet for _, packet in fuzzer.tap.sent]
    return [
        type(record).__name__
        for packet in packets
        for record in scanner.feed([packet] if variant.link == "can" else packet)
    ]


@pytest.mark.parametrize("link", LINKS)
def test_a_real_device_is_only_asked(link: str) -> None:
    """By the messages of its polls, or damaged ones that can be nothing else; at the end it is stopped."""
    _, fuzzer = live(pump(HangsOnABoundary, link))
    fuzzer.open()
    assert fuzzer.run(200) is None
    assert set(sent_messages(fuzzer)) <= {"Ask", "Unknown"}
    assert "SetSpeed" in fuzzer.left_out
    if link == "can":
        assert {frame.arbitration_id for _, frame in fuzzer.tap.sent} == {0x103}
    fuzzer.stop()
    assert sent_messages(fuzzer)[-2:] == ["SetSpeed", "Ask"]  # the stop, and whether it has


def test_what_is_allowed_by_name_is_sent() -> None:
    """A message that was named, and nothing else of this device; all of it with allow_motion. Never another's number."""
    _, fuzzer = live(pump(), only=["Configure"])
    fuzzer.open()
    assert fuzzer.run(100) is None
    assert set(sent_messages(fuzzer)) <= {"Ask", "Configure", "Unknown"}
    _, fuzzer = live(pump(), allow_motion=True)
    fuzzer.open()
    assert fuzzer.run(200) is None
    assert {"SetSpeed", "Begin", "Data"} <= set(sent_messages(fuzzer))
    assert {frame.arbitration_id & 0xF for _, frame in fuzzer.tap.sent} == {3}


def test_the_first_fault_ends_it_and_a_device_that_does_not_stop_is_named(tmp_path: Path) -> None:
    """With what was sent since it last answered; a hung pump cannot be stopped, which is loud."""
    _, fuzzer = live(pump(HangsOnABoundary), only=["Configure"])
    fuzzer.open()
    found = fuzzer.run(2000)
    assert found is not None
    assert found.problem.kind == "silent"
    assert 0 < len(found.steps) <= 24
    with pytest.raises(NotStoppedError, match="P1"):
        fuzzer.stop()
    robot, name = example_of(pump())
    again = DeviceFuzzer(robot, name, load=lambda _: pump(HangsOnABoundary))
    problem, _, _ = again.judged(capture_steps(str(found.save(tmp_path)), "can"))
    assert problem is not None
    assert problem.kind == "silent"


def test_the_devices_of_the_file_may_speak_besides() -> None:
    """A number that is another device's of this bus is none of its faults; one of nobody is."""
    driver = pump(AnswersAnothersNumber)
    _, fuzzer = live(driver, allow_motion=True)
    fuzzer.open()
    found = fuzzer.run(500)
    assert found is not None
    assert found.problem.kind == "another's"


def test_a_device_that_is_not_there_is_sent_nothing() -> None:
    """It neither answers nor sends: the search does not begin."""
    world, fuzzer = live(pump())
    world.simulation["P1"].power(False)
    with pytest.raises(DeviceError, match="nothing was sent"):
        fuzzer.open()
    assert set(sent_messages(fuzzer)) == {"Ask"}


def test_a_fault_that_needs_an_instant_is_made_small_without_losing_it() -> None:
    """A twin that hangs when it is read 50 to 60 ms after it was configured: what was sent in between is left out."""

    class Slow(PumpTwin):
        @on("Configure")
        def configured(self, request: Any) -> None:
            self.begun = self.clock.now()

        @on("Read")
        def read(self, request: Any) -> None:
            if 50_000_000 <= self.clock.now() - getattr(self, "begun", -(1 << 62)) <= 60_000_000:
                self.fault("silent")

    (finding,) = fuzz_device(pump(Slow), seed=1, packets=12_000, most=1, only=["Configure", "Read", "Ask"])
    assert finding.problem.kind == "silent"
    assert len(finding.steps) <= 4


def test_a_collision_is_no_fault_of_the_device(tmp_path: Path) -> None:
    """An ODrive's estimates and a data frame that asks for them have one identifier: sent at once, both are sent again.

    They pass when one of the ends is error-passive.
    """
    log = tmp_path / "asked.log"
    log.write_text("(0.0) can0 7E6#R\n(0.00064) can0 016#00\n(0.15056) can0 015#R\n(0.15088) can0 009#\n")
    robot, name = example_of(load_driver("odrive"))
    problem, _, _ = DeviceFuzzer(robot, name).judged(capture_steps(str(log), "can"))
    assert problem is None


@pytest.mark.parametrize(("was_off", "kind"), [(True, "bus-off"), (False, "silent")])
def test_silence_behind_a_bus_off_is_no_fault_of_the_device(
    was_off: bool, kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where an end of the bus was off since, it is said so, and not that the device is silent."""
    from aces_lab.device_fuzz import trial

    polls = [SimpleNamespace(message="Query")]
    tester: Any = SimpleNamespace(
        clock=VirtualClock(), polls=polls, was_off=was_off, settle=lambda: None, pass_time=lambda _: None
    )
    monkeypatch.setattr(trial, "missed", lambda *_, **__: 0)
    problem = trial.judged_alive(tester, cast("Any", SimpleNamespace(answers=True)))
    assert problem is not None
    assert problem.kind == kind
