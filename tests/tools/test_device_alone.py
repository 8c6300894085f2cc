"""`aces device -p`: one device by its driver's name and number, without a robot's file."""

from __future__ import annotations

import json
from collections.abc import Iterator

import pytest

from aces_devices.dynamixel import driver
from tests.oracles.serial_lines import served_line
from tests.tools.conftest import Aces

ARM = """
name = "arm"
rate_hz = 100
[buses]
line = { link = "serial", protocol = "dynamixel", baud = 1_000_000 }
[devices]
S1 = { driver = "dynamixel", bus = "line", model = "XL330-M288", credentials = { id = 1 } }
"""


@pytest.fixture
def line() -> Iterator[str]:
    """A pseudo-terminal with one servo, number 1."""
    with served_line(ARM, driver) as served:
        yield served.path


@pytest.mark.slow
def test_a_servo_is_read_by_its_number(aces: Aces, line: str) -> None:
    """Its registers, and where its joint is; a serial line is asked."""
    words = ("device", "-p", "dynamixel", "--model", "XL330-M288", "--id", "1", "--bus", line)
    made = aces(*words, "get", "--json")
    assert made.status == 0, made.err
    found = json.loads(made.out)
    assert "joint.position" in str(found)
    made = aces(*words, "joint.position", "get")
    assert made.status == 0, made.err
    assert "rad" in made.out


def test_what_changes_it_needs_a_word(aces: Aces, line: str) -> None:
    """Nothing is sent without --tx."""
    made = aces("device", "-p", "dynamixel", "--model", "XL330-M288", "--id", "1", "--bus", line, "enable")
    assert made.status == 1
    assert "nothing was sent; add --tx" in made.err


def test_a_twin_moves(aces: Aces) -> None:
    """`joint` is its joint; the door leads it at its usual speed."""
    made = aces(
        *("device", "-p", "dynamixel", "--model", "XL330-M288", "--id", "1", "--virtual"),
        *("joint", "set", "position=0.2", "--enable"),
    )
    assert made.status == 0, made.out + made.err


def test_what_it_has(aces: Aces) -> None:
    """Without an action."""
    made = aces("device", "-p", "dynamixel", "--model", "XL330-M288", "--id", "1")
    assert made.status == 0, made.err
    assert "temperature" in made.out
    assert "position" in made.out


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--id", "1", "get"), "--id is of the devices of one kind"),
        (("-p", "nonesuch", "--id", "1", "get"), "nonesuch"),
        (("-p", "dynamixel", "-r", "so101", "get"), "-p in place of --robot"),
        (("-p", "dynamixel", "--id", "1", "get", "tail"), "tail"),
    ],
)
def test_wrong_calls(aces: Aces, words: tuple[str, ...], said: str) -> None:
    """Found before a bus is opened."""
    made = aces("device", *words)
    assert made.status == 2
    assert said in made.err
