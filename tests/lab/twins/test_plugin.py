"""The plug-in, as pytest loads it: what it costs, what it leaves alone, what a failing test says, and runs under faults."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

LOADED = """
import sys, time
import pytest
before = set(sys.modules)
start = time.perf_counter()
import aces_bus.testing.plugin, aces_lab.twins.plugin
print((time.perf_counter() - start) * 1e3)
print(*sorted({name.partition(".")[0] for name in set(sys.modules) - before}))
"""

TESTS = """
import time, can, pytest

def ask(bus, wait=1.0):
    bus.send(can.Message(arbitration_id=3 << 5 | 0x17, is_remote_frame=True, is_extended_id=False, dlc=8))
    end = time.monotonic() + wait
    while (left := end - time.monotonic()) > 0:
        message = bus.recv(left)
        if message is not None and message.arbitration_id == 3 << 5 | 0x17:
            return message
    raise TimeoutError("no answer")

def motor_of(aces_twin):
    return aces_twin("odrive", node=3, settings={"estimates": "asked"})
"""


def run(folder: Path, test: str, *options: str) -> str:
    """What pytest says of a test file in a folder of its own."""
    (folder / "test_it.py").write_text(TESTS + test)
    command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "-q", *options, "test_it.py"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    return done.stdout + done.stderr


def test_loading_it_is_quick_and_imports_nothing_else() -> None:
    """Both plug-ins of ours: at most 20 ms, and no module of another package than ours."""
    quickest = 1e9
    for _ in range(5):
        done = subprocess.run([sys.executable, "-c", LOADED], capture_output=True, text=True, check=True)
        took, modules = done.stdout.splitlines()
        assert set(modules.split()) <= {"aces_bus", "aces_lab"}
        quickest = min(quickest, float(took))
    assert quickest < 20.0


def test_a_failing_test_prints_and_keeps_its_conversation(tmp_path: Path) -> None:
    """The frames are decoded behind the traceback, and the capture that is named is there."""
    said = run(
        tmp_path,
        "\ndef test_it(aces_twin):\n    motor = motor_of(aces_twin)\n    assert ask(motor.bus).dlc == 7\n",
    )
    assert "-> GetBusVoltageCurrent(node=3)" in said
    assert "<- BusVoltageCurrent(node=3, voltage=24.0" in said
    found = re.search(r"aces decode (\S+) -p odrive", said)
    assert found is not None
    assert (tmp_path / found[1]).read_text().count("\n") >= 2


def test_tests_without_it_are_as_they_were(tmp_path: Path) -> None:
    """Under faults a test that has no twin runs once, and a failure of it has no section of ours."""
    said = run(
        tmp_path, "\ndef test_it():\n    assert False\n\ndef test_two():\n    pass\n", "--aces-faults", "all"
    )
    assert "1 failed, 1 passed" in said
    assert "aces" not in said.partition("short test summary")[0]


BROKEN = """
def test_it(aces_twin):
    motor = motor_of(aces_twin)
    bus = motor.bus
    for _ in range(2):
        assert ask(bus).dlc == 8
"""


def test_faults_find_an_assumption_and_the_least_that_breaks_it(tmp_path: Path) -> None:
    """A frame that is short is taken for good: named, with the answer that was hit; a lost one is refused, as expected."""
    said = run(tmp_path, BROKEN, "--aces-faults", "loses,short", "--aces-places", "2")
    assert "an answer is a byte short: number 1" in said
    assert "the assumption that broke: an answer is as long as it should be" in said
    assert "[short]" in said
    assert "1 failed, 1 passed, 2 xfailed" in said


HANGS = """
def test_it(aces_twin):
    bus = motor_of(aces_twin).bus
    while True:
        try:
            ask(bus, 0.01)
            return
        except TimeoutError:
            pass
"""


def test_a_program_without_a_time_out_hangs_and_is_ended(tmp_path: Path) -> None:
    """A loop that waits for ever is ended after --aces-patience, and said to hang."""
    said = run(tmp_path, HANGS, "--aces-faults", "silent", "--aces-patience", "1")
    assert "silent: it hangs; assumed: the device is there" in said


def test_what_has_to_survive_a_fault_is_declared(tmp_path: Path) -> None:
    """`survives`: an error of its own is then a failure; `without`: the fault is not tried."""
    test = "\n@pytest.mark.aces_faults({})\ndef test_it(aces_twin):\n    ask(motor_of(aces_twin).bus)\n"
    assert "1 failed" in run(tmp_path, test.format('survives=["loses"]'), "--aces-faults", "loses")
    assert "1 passed in" in run(tmp_path, test.format('without=["loses"]'), "--aces-faults", "loses")


def test_unknown_faults_are_refused_and_help_lists_them(tmp_path: Path) -> None:
    """A wrong name says which there are."""
    assert "wrong_number" in run(tmp_path, "", "--aces-faults", "help")
    assert "no fault named" in run(tmp_path, "", "--aces-faults", "sulks")


MANY = """
import os, threading, time

@pytest.mark.parametrize("number", range(100))
@pytest.mark.parametrize("driver", ["odrive", "feetech"])
def test_many(aces_twin, driver, number):
    aces_twin(driver, id=1)

def test_nothing_is_left():
    assert threading.active_count() == 1
    left = [os.readlink(f"/proc/self/fd/{n}") for n in os.listdir("/proc/self/fd") if os.path.exists(f"/proc/self/fd/{n}")]
    assert not [name for name in left if "pts" in name or "ptmx" in name or "socket" in name]
"""


def test_two_hundred_tests_leave_nothing(tmp_path: Path) -> None:
    """Threads and terminals of a hundred tests on CAN and a hundred on a terminal are gone at the end."""
    said = run(tmp_path, MANY)
    assert "201 passed" in said
