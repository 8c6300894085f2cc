"""What a driver's author is told of mistakes, and what a declaration gives without being asked."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from aces_bus.device import Device, Driver, Poll, Twin, on, signal
from aces_bus.errors import AcesError, SpecError
from aces_bus.robot import VirtualRobot
from aces_bus.testing import run_check
from tests.bench.virtual import is_compiled
from tests.device.fan import FAN, RPM, Fan, FanTwin, fan, robot_of


def made(driver: Driver, text: str = "") -> VirtualRobot:
    """A robot with these fans."""
    robot = robot_of(text or driver.example)
    return VirtualRobot(robot, rate_hz=robot.rate_hz, load={"fan": driver}.__getitem__)


def with_class(**attributes: Any) -> Driver:
    """The fan's driver with another declaration."""
    return replace(FAN, device=type("Other", (Fan,), attributes))


def test_a_handler_does_not_replace_a_method() -> None:
    """A twin's handler called as a method of its base, or as what every twin has, is refused when the class is made."""

    def handler(self: Any, request: Any) -> None: ...

    for name, said in (
        ("stop", "Wrong.stop is called with each Ask, and would replace Twin.stop; choose another name"),
        ("reply", "would replace Twin.reply"),
        ("clock", "Wrong.clock: every instance has an attribute 'clock', which hides the method"),
        ("setup", "would replace FanTwin.setup"),
    ):
        with pytest.raises(TypeError, match=said):
            type("Wrong", (FanTwin,), {name: on("Ask")(handler)})
    again: Any = type("Right", (FanTwin,), {"answer": on("Ask")(handler)})
    assert again._hearing["Ask"] == "answer"


def test_an_action_does_not_replace_a_method() -> None:
    """The same of a device's actions: `send` is how it sends, not something that it does."""
    with pytest.raises(TypeError, match=r"Wrong.send is an action, and would replace Device.send"):
        type("Wrong", (Device,), {"actions": {"send": "say it"}, "send": lambda self: None})
    with pytest.raises(TypeError, match=r"Wrong.name: every instance has an attribute 'name'"):
        type("Wrong", (Device,), {"name": lambda self: None})


@pytest.mark.skipif(is_compiled(), reason="compiled bases keep their attributes elsewhere")
def test_the_names_that_are_taken_are_all_of_them() -> None:
    """What every device and twin has is what its base sets."""
    robot = made(FAN)
    device, twin = robot.devices["A"], robot.twins["A"]
    public = {name for name in vars(device) if not name.startswith("_")}
    assert public - {"polls"} == Device.attributes
    assert {name for name in vars(twin) if not name.startswith("_")} == Twin.attributes | {"left", "right"}


@pytest.mark.parametrize(
    ("driver", "text", "said"),
    [
        (
            with_class(provides=(signal("left", of="State.lft"),)),
            "",
            "no field of fan's State named 'lft'; did you mean 'left'",
        ),
        (
            with_class(provides=(signal("left", set="Set.lft"),)),
            "",
            "no field of fan's Set named 'lft'; did you mean 'left'",
        ),
        (with_class(provides=(signal("left", of="Stat.left"),)), "", "did you mean 'State'"),
        (
            with_class(polls=(Poll("Ask", reply="Stat"),)),
            "",
            "awaited by A, named 'Stat'; did you mean 'State'",
        ),
        (with_class(polls=(Poll("Aks", reply="State"),)), "", "did you mean 'Ask'"),
        (FAN, FAN.example.replace("node", "nod"), "line A: it cannot be asked"),
        (
            FAN,
            FAN.example.replace('"can"', '"serial"'),
            "A speaks fan, which is for link can; its bus line has link",
        ),
    ],
)
def test_a_mistake_is_named(driver: Driver, text: str, said: str) -> None:
    """A name that does not exist, missing credentials, another kind of bus: said at once, with what there is."""
    with pytest.raises(AcesError) as found:
        made(driver, text)
    assert said in str(found.value)


def test_a_driver_that_speaks_nothing() -> None:
    """A device's class without a protocol is refused where the driver is made."""
    with pytest.raises(SpecError, match="Mute does not say what it speaks"):
        Driver("mute", type("Mute", (Device,), {}), FanTwin, "")


@pytest.mark.parametrize(("every_s", "stale_s"), [(None, 0.1), (0.01, 0.1), (0.5, 2.5)])
def test_a_value_is_stale_after_five_polls(every_s: float | None, stale_s: float) -> None:
    """Where nobody says otherwise a value is fresh for five polls, at least 0.1 s."""
    robot = made(with_class(polls=(Poll("Ask", reply="State", every_s=every_s),)))
    assert robot["A.left"].stale_after_ns == round(stale_s * 1e9)


def test_what_a_set_point_waits_for() -> None:
    """A frame of two set-points waits for both, and the device says for which."""
    with made(FAN) as robot:
        device = robot.devices["A"]
        assert device.waited_for() == []
        robot["A.left"].set(100 * RPM)
        robot.advance(0.1)
        assert device.waited_for() == ["Set.right"]
        assert robot.twins["A"].left == 0
        robot["A.right"].set(100 * RPM)
        robot.advance(0.1)
        assert device.waited_for() == []
        assert robot.twins["A"].left == 100


def test_polls_of_one_tick_are_one_miss() -> None:
    """Three polls that miss together are not silence yet; when the next ones miss too, it is."""
    polls = tuple(Poll("Ask", reply="State", every_s=0.05) for _ in range(3))
    with made(with_class(polls=polls)) as robot:
        robot.advance(0.2)
        robot.twins["A"].fault("silent")
        robot.advance(0.3)
        event = robot.events.of("silent")[0]
        assert event.device == "A"
        since = robot.devices["A"].missing_since
        assert event.instant - since > 75_000_000


def yes_and_no() -> Driver:
    """A fan whose right channel is a lamp: on or off."""

    def setup(device: Any) -> None:
        device.add_signal(
            "lamp",
            of="State.right",
            set="Set.right",
            to_si=lambda raw: raw != 0,
            from_si=lambda yes: int(yes),
        )
        device.add_signal("level", of="State.left", set="Set.left", lower=0, upper=3)

    return with_class(provides=(), setup=setup)


@pytest.mark.parametrize("check", ["received", "set", "limits"])
def test_yes_and_no_and_whole_numbers_are_tested(check: str) -> None:
    """The conformance kit sets no to yes, and whole numbers to whole numbers."""
    run_check(check, yes_and_no())


def test_a_lamp_that_stays_dark_is_found() -> None:
    """A yes that arrives nowhere fails the check."""

    def change(self: Any, request: Any) -> None:
        self.left = request.left

    lazy: Any = type("Lazy", (FanTwin,), {"change": change})
    with pytest.raises(AssertionError, match=r"lamp was set from False to True and is False"):
        run_check("set", replace(yes_and_no(), twin=lazy))
    assert fan.name == "fan"
