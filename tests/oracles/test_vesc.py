"""PyVESC, unmodified, with our twin of a VESC at a pseudo-terminal."""

from __future__ import annotations

import importlib
from collections.abc import Generator
from contextlib import contextmanager
from typing import Any

import pytest

from aces_bus.device import Robot
from aces_bus.robot import parse_robot
from aces_devices.vesc.twin import VescUartTwin
from aces_protocols.vesc_uart.spec import vesc_uart
from tests.oracles.pyvesc import pyvesc_module
from tests.oracles.served import PATIENCE_S, wait_until
from tests.oracles.terminals import Terminal, twins_at_a_terminal

pyvesc: Any = pyvesc_module()
messages: Any = importlib.import_module("pyvesc.VESC.messages")
pytestmark = pytest.mark.filterwarnings("ignore:isSet:DeprecationWarning")

LINE = """
name = "cart"
rate_hz = 50
[buses]
line = { link = "serial", protocol = "vesc_uart" }
[devices]
V = { driver = "vesc_uart", bus = "line" }
"""


def robot_of_one() -> Robot:
    """A VESC at a line."""
    robot, problems = parse_robot(LINE)
    assert robot is not None, problems
    return robot


@contextmanager
def a_motor(*, heartbeat: bool = False) -> Generator[tuple[Any, VescUartTwin, Terminal]]:
    """PyVESC's motor at a terminal, and the twin. It decodes what is there: packets arrive at once here, as by USB."""
    with twins_at_a_terminal(robot_of_one(), "line", whole=True) as made:
        twin = made.twins["V"]
        assert isinstance(twin, VescUartTwin)
        motor = pyvesc.VESC(made.port.path, start_heartbeat=heartbeat, timeout=PATIENCE_S)
        with motor:
            yield motor, twin, made


def test_pyvesc_reads_our_twin() -> None:
    """Version and values are what the twin has, each by its name."""
    with a_motor() as (motor, twin, made):
        assert motor.get_firmware_version().startswith("6.5.")
        with made.port.lock:
            twin.model.motor.drive(made.line.clock.now(), 1 / 6)
            twin.model.warm = 44.4
        wait_until(lambda: motor.get_rpm() > 6500)
        values = motor.get_measurements()
        assert (values.v_in, values.temp_fet, values.temp_motor) == (48.2, 44.4, 44.4)
        assert values.rpm == pytest.approx(100 * 60 / 6.283185307 * 7, rel=0.03)
        assert values.duty_cycle_now == pytest.approx(100 / 600, abs=0.002)
        assert values.mc_fault_code == b"\0"


def test_what_pyvesc_sets_the_twin_does() -> None:
    """Duty, current, speed, position and the heartbeat arrive as what they mean."""
    seen: list[Any] = []
    with a_motor(heartbeat=True) as (motor, twin, made):
        with made.port.lock:
            alive = twin.model.keep_alive

            def keep_alive() -> None:
                seen.append("alive")
                alive()

            twin.model.keep_alive = keep_alive  # type: ignore[method-assign]
        motor.set_duty_cycle(0.25)
        motor.get_rpm()
        with made.port.lock:
            assert (twin.model.mode, twin.model.given) == ("duty", 0.25)
        wait_until(lambda: seen.count("alive") > 3)
        with made.port.lock:
            assert twin.model.mode == "duty"  # its heartbeat keeps it


#: A message of PyVESC, what it is here, and what PyVESC leaves as numbers of steps.
SENT: list[tuple[str, tuple[Any, ...], str, dict[str, Any]]] = [
    ("SetDutyCycle", (-0.25,), "SetDuty", {"duty": -0.25}),
    ("SetCurrent", (5.0,), "SetCurrent", {"current": 5.0}),
    ("SetCurrentBrake", (5.0,), "SetBrakeCurrent", {"current": 5.0}),
    ("SetPosition", (90.0,), "SetPosition", {"position": 90.0}),
    ("SetRPM", (3000,), "SetSpeed", {"speed": 3000}),
    ("Alive", (), "Alive", {}),
]


@pytest.mark.parametrize(("theirs", "values", "ours", "fields"), SENT, ids=[one[0] for one in SENT])
def test_what_pyvesc_sends_we_read(
    theirs: str, values: tuple[Any, ...], ours: str, fields: dict[str, Any]
) -> None:
    """Each message, and our encoder's bytes are the same."""
    data: bytes = pyvesc.encode(getattr(messages, theirs)(*values))
    (record,) = vesc_uart.scanner(direction="to device").feed(data)
    assert (type(record).__name__, {name: getattr(record, name) for name in fields}) == (ours, fields)
    assert vesc_uart.encode(ours, **fields) == data
