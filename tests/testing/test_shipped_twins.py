"""Twins that ship, fuzzed: what was found in them once, and a long search that finds nothing but what is declared."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pytest

from aces_bus.device import load_driver
from aces_bus.device.drivers import list_drivers
from aces_lab.device_fuzz.fuzzer import DeviceFuzzer, example_of, fuzz_device
from aces_lab.device_fuzz.tester import SentStep

#: Behind each frame (ns): an answer has come, and a heartbeat.
PAUSE_NS = 120_000_000
#: Driver, and the messages that once broke its twin.
ONCE: tuple[tuple[str, tuple[tuple[str, Mapping[str, Any]], ...]], ...] = (
    ("damiao", (("WriteInteger", {"register": "master_id", "value": 1 << 24}),)),
    (
        "damiao",
        (
            ("WriteInteger", {"register": "control_mode", "value": 0}),
            ("Velocity", {"velocity": 0}),
        ),
    ),
    ("dynamixel", (("FastSyncRead", {"start": 0, "count": 56_064, "ids": [1, 2]}),)),
    ("dynamixel", (("FastBulkRead", {"areas": [{"id": 1, "start": 0, "count": 1024}]}),)),
    (
        "moteus",
        (("Query", {"subframes": [{"kind": "read_error", "data": {"register": "mode", "error": 0}}]}),),
    ),
    ("odrive", (("SetNodeId", {"new_node": 1 << 24}),)),
    ("vesc", (("SetBrakeCurrent", {"current": 16_777.216}), ("SetDuty", {"duty": 1.0}))),
    ("vesc", (("SetDuty", {"duty": 0.5}), ("SetBrakeCurrent", {"current": 16_777.216}))),
    ("cia401", (("SdoDownloadSegment", {"last": 0, "unused": 0, "toggle": 0, "data": bytes(7)}),)),
    ("cia401", (("SdoUploadSegment", {"toggle": 0}),)),
)


@pytest.mark.parametrize(
    ("name", "messages"), ONCE, ids=lambda one: one if isinstance(one, str) else one[-1][0]
)
def test_what_broke_a_twin_once(name: str, messages: Any, caplog: pytest.LogCaptureFixture) -> None:
    """It is refused or left without an answer, and the twin goes on."""
    driver = load_driver(name)
    robot, first = example_of(driver)
    # The first device that has such messages: not every firmware has.
    fuzzer = next(
        made
        for device in dict.fromkeys((first, *robot.devices))
        if messages[0][0] in (made := DeviceFuzzer(robot, device)).variant.messages
    )
    tester = fuzzer.judged([])[1].tester
    steps = [SentStep(tester.packet(tester.ear, message, fields), PAUSE_NS) for message, fields in messages]
    problem, _, _ = fuzzer.judged(steps)
    assert problem is None
    assert caplog.records == []  # canopen logs what its server raises


def test_what_a_device_was_asked_to_repeat_is_no_second_answer() -> None:
    """A motor board that sends its encoders every 5 ms since it was asked to, and is asked wherever between two of them."""
    fuzzer = DeviceFuzzer(*example_of(load_driver("hubo_d15")))
    tester = fuzzer.judged([])[1].tester
    packet = tester.packet(tester.ear, "SendEncoderD15", {"mode": "continuous"})
    for away_ns in range(0, 5_000_000, 200_000):
        problem, _, _ = fuzzer.judged([SentStep(packet, PAUSE_NS + away_ns)])
        assert problem is None


@pytest.mark.parametrize("request_bytes", ["09 01 00 00 00 00 3D 42", "09 6D C6 0D"])
def test_nothing_is_sent_into_an_answer_on_a_half_duplex_line(request_bytes: str) -> None:
    """Both are refused: one at once, one when 30 ms of silence have ended it. The next request waits for that."""
    fuzzer = DeviceFuzzer(*example_of(load_driver("robotiq_ft300")))
    problem, trial, _ = fuzzer.judged([SentStep(bytes.fromhex(request_bytes), 0)] * 2)
    assert problem is None
    assert trial.tester.counts["Refusal"] == 2


#: What devices are meant to do: driver → what is left out, and why.
DECLARED: Mapping[str, tuple[str, ...]] = {
    # A node that was stopped, or reset and not set up again, answers no SYNC and sends no PDOs.
    "cia401": ("Nmt",),
    "cia402": ("Nmt",),
    # Another speed of the line, and another number.
    "dynamixel": ("FactoryReset",),
    "robotis_rx": ("Reset",),
    # A refusal names the service that was asked, which may be any.
    "uds": ("Other",),
    # Answers are single bytes without a sender: behind garbage one may be taken for that to another request.
    "pololu_qik": ("SetConfiguration",),
}


@pytest.mark.long
@pytest.mark.parametrize("name", list_drivers())
def test_a_shipped_twin_has_no_findings(name: str) -> None:
    """A thousand packets at the first device of its example, with what it is meant to do left out."""
    driver = load_driver(name)
    robot, device = example_of(driver)
    variant = DeviceFuzzer(robot, device).variant if driver.virtual else None
    if variant is None or not variant.messages_for("to device"):
        pytest.skip("nothing is sent to it")
    found = fuzz_device(driver, seed=1, packets=1000, leave_out=DECLARED.get(name, ()))
    assert found == []
