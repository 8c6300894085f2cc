"""Bugs planted in copies of foreign packages, and whether `--aces-faults all` finds them: `python -m tests.oracles.planted`.

1. A copy is made of the installed package, in a temporary folder, and has one bug; nothing of it is kept.
2. A bug counts when the program's test (test_twin_fixture.py) passes with it, and is found when a run under faults fails
   that does not fail with the package as it is.
"""

from __future__ import annotations

import argparse
import importlib
import importlib.util
import io
import shutil
import sys
import tempfile
import time
from collections.abc import Generator
from contextlib import contextmanager, redirect_stdout
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import pytest

TESTS = Path(__file__).with_name("test_twin_fixture.py")


class Bug(NamedTuple):
    """A bug: in which file of a package, what is written there, what instead, and what that is."""

    file: str
    now: str
    instead: str
    what: str


#: Package → its test, and the bugs.
BUGS: dict[str, tuple[str, tuple[Bug, ...]]] = {
    "robstride": (
        "test_robstride",
        (
            Bug("client.py", "'<f'", "'>f'", "byte order of parameters, both ways"),
            Bug("client.py", "msg_motor_id != expected_motor_id", "False", "anybody's answer is taken"),
            Bug("client.py", "resp_param_id != param_id", "False", "an answer about another parameter is taken"),
            Bug("client.py", "self.bus.recv(self.recv_timeout)", "self.bus.recv()", "no time-out"),
            Bug("client.py", "raise Exception('No response from motor received')", "return resp", "no answer is none"),
            Bug("client.py", "65535 * 8 * math.pi) - 4 * math.pi", "-65535 * 8 * math.pi) + 4 * math.pi", "sign"),
            Bug("client.py", "angle = (float(angle_raw)", "angle = (float(min(angle_raw, 0xA000))", "range cut off"),
            Bug("client.py", "float(temp_raw) / 10", "float(temp_raw & 0xFF) / 10", "high byte lost"),
        ),
    ),
    "damiao_motor": (
        "test_damiao_motor",
        (
            Bug("core/motor.py", '"pos": uint_to_float(', '"pos": abs(1) * abs_of(', "sign of the position lost"),
            Bug("core/motor.py", "t_rotor = float(data[7])", "t_rotor = float(data[7] & 0x3F)", "mask too narrow"),
            Bug("core/controller.py", "self._motors_by_feedback.get(logical_id)",
                "next(iter(self._motors_by_feedback.values()))", "anybody's feedback is taken"),
            Bug("core/motor.py", "if time.time() >= deadline:", "if False:", "no time-out"),
            Bug("core/motor.py", "pos_u = float_to_uint(pos,", "pos_u = float_to_uint(abs(pos),",
                "sign of the command lost"),
            Bug("core/motor.py", "kp_u & 0xFF,", "kp_u & 0x7F,", "a bit of the stiffness lost"),
            Bug("core/motor.py", "pos_int = (data[1] << 8)", "pos_int = (min(data[1], 0x90) << 8)", "range cut off"),
        ),
    ),
    "dynamixel_sdk": (
        "test_dynamixel_sdk",
        (
            Bug("protocol2_packet_handler.py", "self.updateCRC(0, rxpacket, wait_length - 2) == crc", "True",
                "CRC ignored"),
            Bug("protocol2_packet_handler.py", "txpacket[PKT_ID] == rxpacket[PKT_ID]", "True",
                "anybody's answer is taken"),
            Bug("port_handler.py", "if self.getTimeSinceStart() > self.packet_timeout:", "if False:", "no time-out"),
            Bug("protocol2_packet_handler.py", "        port.clearPort()\n", "", "what is old is not thrown away"),
            Bug("protocol2_packet_handler.py", "result = COMM_RX_CORRUPT", "result = COMM_SUCCESS",
                "damage is success"),
            Bug("protocol2_packet_handler.py", "DXL_MAKEWORD(data[0], data[1]),",
                "DXL_MAKEWORD(data[0] & 0x7F, data[1]),",
                "a bit lost in reading"),
            Bug("protocol2_packet_handler.py", "data_write = [DXL_LOBYTE(DXL_LOWORD(data)),",
                "data_write = [DXL_LOBYTE(DXL_LOWORD(data)) & 0x7F,", "a bit lost in writing"),
            Bug("protocol2_packet_handler.py",
                "                    del rxpacket[0: idx]\n                    rx_length -= idx\n",
                "                    result = COMM_RX_CORRUPT\n                    break\n",
                "does not look for the next header"),
        ),
    ),
    "pymodbus": (
        "test_pymodbus",
        (
            Bug("framer/rtu.py", "if not FramerRTU.check_CRC(data[used_len:crc_start], crc_val):", "if False:",
                "CRC ignored"),
            Bug("transaction/transaction.py", "while count_retries <= self.retries:", "while count_retries < 1:",
                "no retry"),
            Bug("framer/base.py", "if exp_devid and dev_id != exp_devid:",
                "dev_id = exp_devid or dev_id\n            if False:",
                "anybody's answer is taken"),
            Bug("client/mixin.py", 'if word_order == "little":', 'if word_order == "big":', "order of words"),
            Bug("pdu/register_message.py", 'struct.unpack(">H", data[i : i + 2])',
                'struct.unpack("<H", data[i : i + 2])', "byte order of what is read"),
            Bug("pdu/register_message.py", "self.address, self.registers[0])",
                "self.address, self.registers[0] & 0xFF7F)", "a bit lost in writing"),
            Bug("client/serial.py", "if waitingbytes := self._in_waiting():", "if waitingbytes := 0:",
                "what is old is not thrown away"),
        ),
    ),
}  # fmt: skip
#: Bugs that no fault of the catalogue shows.
MISSED = {"pymodbus": {"what is old is not thrown away"}}
#: Appended where a bug needs it.
MORE = {"abs_of(": "\n\ndef abs_of(*values):\n    return abs(uint_to_float(*values))\n"}


@dataclass
class Found:
    """What came of a test: whether it passed plainly, and by which faults it failed, each with what was printed."""

    passed: bool = False
    faults: dict[str, str] = field(default_factory=dict[str, str])
    seconds: float = 0.0

    def pytest_runtest_logreport(self, report: Any) -> None:
        """Note a report."""
        under = next((value for name, value in report.user_properties if name == "aces_fault"), None)
        if under is None:
            self.passed = report.passed if report.when == "call" else self.passed
        elif report.failed:
            self.faults[under[0]] = "\n".join(text for _, text in report.sections)


@contextmanager
def copied(package: str, bug: Bug | None) -> Generator[None]:
    """Have a package imported from a copy with a bug, or from one without."""
    spec = importlib.util.find_spec(package)
    assert spec is not None
    assert spec.origin is not None
    with tempfile.TemporaryDirectory(prefix="planted") as folder:
        copy = Path(folder, package)
        shutil.copytree(Path(spec.origin).parent, copy, ignore=shutil.ignore_patterns("__pycache__"))
        if bug is not None:
            text = (copy / bug.file).read_text(encoding="utf-8")
            assert bug.now in text, f"{package}: {bug.file} has no {bug.now!r} any more"
            text = text.replace(bug.now, bug.instead)
            text += next((more for word, more in MORE.items() if word in bug.instead), "")
            (copy / bug.file).write_text(text, encoding="utf-8")
        sys.path.insert(0, folder)
        try:
            _forget(package)
            yield
        finally:
            sys.path.remove(folder)
            _forget(package)


def _forget(package: str) -> None:
    for name in [
        name for name in sys.modules if name.partition(".")[0] == package or "test_twin_fixture" in name
    ]:
        del sys.modules[name]
    importlib.invalidate_caches()


def run(package: str, bug: Bug | None, *, seed: int = 0, places: int = 4) -> Found:
    """Run a package's test under all faults, with a bug or without."""
    found = Found()
    options = [
        "--aces-faults",
        "all",
        "--aces-seed",
        str(seed),
        "--aces-places",
        str(places),
        "--aces-patience",
        "5",
    ]
    command = [
        "-q",
        "-p",
        "no:cacheprovider",
        "-n",
        "0",
        *options,
        f"{TESTS}::{BUGS[package][0]}",
    ]
    start = time.monotonic()
    with copied(package, bug), redirect_stdout(io.StringIO()):
        pytest.main(command, plugins=[found])
    found.seconds = time.monotonic() - start
    return found


def main() -> int:
    """Run all bugs, or those of some packages; print what found each, and with `--shown` its conversation."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("packages", nargs="*", default=list(BUGS), help="which (default: all)")
    parser.add_argument("--shown", action="store_true", help="print the conversations, too")
    arguments = parser.parse_args()
    count = caught = 0
    for package in arguments.packages:
        usual = run(package, None)
        print(
            f"{package}, as it is: passes {usual.passed}, fails under {', '.join(usual.faults) or 'none'}",
            flush=True,
        )
        for bug in BUGS[package][1]:
            found = run(package, bug)
            by = [name for name in found.faults if name not in usual.faults]
            count += 1
            caught += found.passed and bool(by)
            said = "found by " + ", ".join(by) if by else "NOT FOUND"
            plain = "" if found.passed else " (fails plainly)"
            print(f"  {package}: {bug.what}: {said}{plain}, {found.seconds:.0f} s", flush=True)
            if arguments.shown and by:
                print(found.faults[by[0]])
    print(f"{caught} of {count} found")
    missed = sum(len(MISSED.get(package, ())) for package in arguments.packages)
    return caught < count - missed


if __name__ == "__main__":
    sys.exit(main())
