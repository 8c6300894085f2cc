"""Devices are fuzzed: each fault that is planted in a twin is found, made small, and shown again by its capture."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from aces_bus.testing.device_fuzz import DeviceFuzzer, example_of, fuzz_device, steps_of
from aces_bus.testing.device_trial import Expectations
from tests.testing.faulty_pumps import FAULTS, WATCHDOG_NS, PlantedFault, pump

LINKS = ("can", "serial")
#: Words until which each must be found; a second's worth, or a few.
WORDS = 12_000


def _planted() -> list[Any]:
    """Each fault on CAN; on a line every third in the short profile, as there words take longer."""
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
    (finding,) = fuzz_device(driver, seed=1, words=WORDS, most=1, expected=fault.expected)
    assert finding.problem.kind == fault.kind
    assert len(finding.steps) <= fault.words
    robot, name = example_of(driver)
    again = DeviceFuzzer(robot, name, expected=fault.expected, load={driver.name: driver}.__getitem__)
    path = finding.save(tmp_path)
    problem, _, _ = again.judged(steps_of(str(path), link))
    assert problem is not None
    assert problem.key == finding.problem.key


@pytest.mark.parametrize("link", LINKS)
def test_a_sound_device_has_no_findings(link: str) -> None:
    """Nothing is found where nothing is, whatever is expected besides."""
    expected = Expectations(rests_ns=2 * WATCHDOG_NS, actions=("turn",))
    assert fuzz_device(pump(link=link), seed=1, words=1500, expected=expected) == []
