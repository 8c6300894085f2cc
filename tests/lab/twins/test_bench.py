"""Benches: what a driver's name and numbers mean, how programs get in, what is kept of what passed, and what ends."""

from __future__ import annotations

import os
import random
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import can
import pytest

import aces_bus
from aces_bus import decode, load_robot
from aces_bus.device import load_driver
from aces_bus.device.drivers import list_drivers
from aces_bus.errors import CallerError, UnknownNameError
from aces_lab.twins import TwinBench, open_bench
from aces_lab.twins.catalogue import CATALOGUE, Injection
from aces_protocols.modbus.spec import modbus
from aces_tools.one_kind import robot_of

serial: Any = pytest.importorskip("serial")

ROOT = Path(__file__).resolve().parents[3]
#: A Modbus request of unit 5 for one input register, and a meter that has it.
ASK = modbus.encode("ReadRegisters", unit=5, function=4, start=0, count=1)
METER: dict[str, Any] = {"registers": {"voltage": {"address": 0, "type": "u16", "table": "input"}}}


def asked(bus: can.BusABC, within_s: float = 5.0, node: int = 3) -> can.Message | None:
    """Ask an ODrive for its bus voltage; its answer, or None."""
    bus.send(can.Message(arbitration_id=node << 5 | 0x17, is_remote_frame=True, is_extended_id=False, dlc=8))
    while (message := bus.recv(within_s)) is not None:
        if message.arbitration_id == node << 5 | 0x17:
            return message
    return None


# ---------------------------------------------------------------------- names and numbers


@pytest.mark.parametrize(
    ("driver", "numbers", "credentials"),
    [
        ("odrive", {"node": 3}, [{"node": 3}]),
        ("odrive", {"id": 3}, [{"node": 3}]),
        ("feetech", {"ids": [1, 2]}, [{"id": 1}, {"id": 2}]),
        ("hubo_ft", {"board": 0x30, "sensor": 1}, [{"board": 0x30, "sensor": 1}]),
        ("modbus", {}, [{"unit": 5}]),
        ("ubx", {}, [{}]),
    ],
)
def test_numbers_are_credentials(
    driver: str, numbers: dict[str, Any], credentials: list[dict[str, int]]
) -> None:
    """A number is given by its name, its plural, or as `id` where there is one kind; none means the driver's example."""
    assert [device.credentials for device in robot_of(driver, numbers).devices.values()] == credentials


@pytest.mark.parametrize(
    ("driver", "numbers", "said", "complaint"),
    [
        ("odrives", {}, {}, "odrive"),
        ("hubo", {}, {}, "several kinds"),
        ("odrive", {"motor": 3}, {}, "node"),
        ("odrive", {"node": 3}, {"baudrate": 1}, "bitrate"),
        ("hubo_ft", {"board": 0x30}, {}, "sensor"),
        ("hubo_ft", {"boards": [1, 2], "sensors": [1]}, {}, "as many"),
        ("feetech", {"id": 1}, {"fd": True}, "no CAN FD"),
        ("odrive", {"node": 3}, {"dialect": "9"}, "dialect"),
    ],
)
def test_what_there_is_not_is_said(
    driver: str, numbers: dict[str, Any], said: dict[str, Any], complaint: str
) -> None:
    """Unknown drivers, numbers and options are refused with what there is."""
    with pytest.raises((CallerError, UnknownNameError), match=complaint):
        robot_of(driver, numbers, **said)


def test_fd_means_the_kind_that_speaks_it() -> None:
    """`fd` takes a driver's kin on CAN FD, and a bus that carries it."""
    with open_bench("damiao", motor=1, fd=True) as motor:
        assert motor.bus_options["fd"] is True
        assert next(iter(motor.robot.devices.values())).driver == "damiao_fd"


# ---------------------------------------------------------------------- CAN


def test_a_program_on_can_and_its_twin() -> None:
    """A python-can bus reaches the twin; what passed is decoded, either way, and kept as a recording."""
    with aces_bus.twin("odrive", node=3, settings={"estimates": "asked"}) as motor:
        answer = asked(motor.bus)
        assert answer is not None
        assert motor.expect("GetBusVoltageCurrent", node=3)
        assert motor.expect("BusVoltageCurrent", node=3, voltage=24.0).current == pytest.approx(0.0, abs=1e-3)
        assert motor.last("BusVoltageCurrent").voltage == 24.0
        assert motor.state.state == "idle"
        motor.state.state = "closed_loop"
        assert motor["ODRIVE1"].state == "closed_loop"
        with pytest.raises(AssertionError, match="no Iq"):
            motor.last("Iq")
        with pytest.raises(CallerError, match="on CAN"):
            _ = motor.port


def test_what_has_passed_is_a_recording(tmp_path: Path) -> None:
    """The saved conversation decodes to what was seen."""
    with open_bench("odrive", node=3, settings={"estimates": "asked"}) as motor:
        assert asked(motor.bus) is not None
        (file,) = motor.save(tmp_path / "talk")
        seen = [one for one in motor.frames if type(one.record).__name__ == "BusVoltageCurrent"]
    assert len(seen) == len(decode(str(file), "odrive")["BusVoltageCurrent"]) == 1


def test_faults_of_a_device_by_their_names() -> None:
    """`loses` with any word for its number; off again; unknown ones are refused."""
    with open_bench("odrive", node=3, settings={"estimates": "asked"}) as motor:
        bus = motor.bus
        motor.fault("silent")
        assert asked(bus, 0.02) is None
        motor.fault("silent", on=False)
        assert asked(bus) is not None
        motor.fault("loses", every=1)
        assert asked(bus, 0.02) is None
        with pytest.raises(UnknownNameError, match="late"):
            motor.fault("sulks")
        with pytest.raises(UnknownNameError, match=r"no device of .* named 'other'"):
            motor.fault("silent", device="other")
        with pytest.raises(UnknownNameError, match="did you mean 'state'"):
            motor.state.stat = "idle"


def test_virtual_time_waits_for_nobody() -> None:
    """Half a minute of heartbeats in no time, the same each time."""

    def run() -> list[str]:
        with open_bench("odrive", node=3, time="virtual", settings={"estimates": "asked"}) as motor:
            bus = motor.bus
            motor.wait(30.0)
            assert bus.recv(0.0) is not None
            return [str(one) for one in motor.frames]

    assert run() == run()
    assert len(run()) == 300


def test_virtual_time_is_for_a_bus_of_this_process() -> None:
    """A terminal waits in real time, and so do other programs."""
    given: list[tuple[str, dict[str, Any]]] = [
        ("feetech", {"id": 1}),
        ("odrive", {"node": 1, "shared": True}),
    ]
    for driver, options in given:
        with pytest.raises(CallerError, match="virtual time"):
            open_bench(driver, time="virtual", **options)


def test_who_says_another_bit_rate_is_refused() -> None:
    """A program that names the bus's own rate, or none, is let in; any other is an error of the call."""
    with open_bench("odrive", node=3, bitrate=250_000) as motor:
        can.Bus(**motor.bus_options, bitrate=250_000).shutdown()
        can.Bus(**motor.bus_options).shutdown()
        with pytest.raises(can.CanInitializationError, match="250000"):
            can.Bus(**motor.bus_options, bitrate=500_000)


PROGRAM = """
import can, sys
with can.Bus(interface="aces", channel=sys.argv[1]) as bus:
    bus.send(can.Message(arbitration_id=3 << 5 | 0x17, is_remote_frame=True, is_extended_id=False, dlc=8))
    while (message := bus.recv(20)).arbitration_id != 3 << 5 | 0x17:
        pass
print(message.data.hex())
"""


@pytest.mark.slow
def test_another_process_reaches_a_shared_bus() -> None:
    """`shared`: a program of its own, by the channel alone."""
    with open_bench("odrive", node=3, shared=True) as motor:
        done = subprocess.run(
            [sys.executable, "-c", PROGRAM, motor.channel], capture_output=True, text=True, check=True
        )
        assert done.stdout.strip() == "0000c04100000000"
        assert motor.expect("BusVoltageCurrent", within_s=5.0).voltage == 24.0


def test_a_robot_of_several_buses() -> None:
    """Each bus has its own channel; the short names are for the only one."""
    with open_bench(load_robot("hubo2plus")) as hubo:
        assert sorted(hubo.lines) == sorted(hubo.robot.buses)
        assert len({line.channel for line in hubo.lines.values()}) == len(hubo.lines)
        with pytest.raises(CallerError, match="several buses"):
            _ = hubo.channel


# ---------------------------------------------------------------------- serial lines


def test_a_program_on_a_terminal_and_its_twin() -> None:
    """A serial port reaches the twin at the line's speed; at another one nothing answers, and the bench says why."""
    with open_bench("modbus", unit=5, settings=METER) as meter:
        meter.state.put("voltage", 230)
        with serial.Serial(meter.port, 9_600, timeout=0.05) as port:
            port.write(ASK)
            assert port.read(7) == b""
            assert "another speed" in meter.text()
            port.baudrate = meter.baud
            port.timeout = 5.0
            port.write(ASK)
            assert port.read(7)[3:5] == (230).to_bytes(2, "big")


def test_a_line_without_a_terminal() -> None:
    """Where there are no terminals, or `tcp` says so, the port is a URL of pyserial."""
    with (
        open_bench("modbus", unit=5, settings=METER, tcp=True) as meter,
        serial.serial_for_url(meter.port, timeout=5.0) as port,
    ):
        port.write(ASK)
        assert len(port.read(7)) == 7


def test_a_line_s_conversation_is_a_recording_with_directions(tmp_path: Path) -> None:
    """The saved log says who said what."""
    with (
        open_bench("modbus", unit=5, settings=METER) as meter,
        serial.Serial(meter.port, meter.baud, timeout=5.0) as port,
    ):
        port.write(ASK)
        assert len(port.read(7)) == 7
        (file,) = meter.save(tmp_path / "talk")
    lines = file.read_text().splitlines()
    assert [line.split()[1] for line in lines[1:]] == [">", "<"]


# ---------------------------------------------------------------------- states, ends


@pytest.mark.parametrize(
    "driver",
    [
        "damiao",
        "robstride",
        "odrive",
        "moteus",
        "vesc",
        "dynamixel",
        "feetech",
        "robotis_rx",
        "modbus",
        "uds",
    ],
)
def test_drawn_states_are_the_same_for_a_seed(driver: str) -> None:
    """What a twin draws is of the dice given to it."""
    with open_bench(driver) as bench:
        (made,) = bench.twins.values()

        def draw(seed: int) -> str:
            made.draw(random.Random(seed))
            values = {**vars(made), **vars(getattr(made, "model", None) or made)}
            names = ("motor", "motion", "numbers", "data", "_turns", "warm")
            return repr(
                [getattr(values[n], "q", getattr(values[n], "at", values[n])) for n in names if n in values]
            )

        def drawn(seed: int) -> str:
            bench.wait(0.002)  # what is drawn does not hang on what was before
            return bench.call(lambda: draw(seed))

        assert drawn(1) == drawn(1) != drawn(2)


def test_nothing_is_left_behind() -> None:
    """Threads and files are gone when a bench is closed, whatever kind of line it had."""
    kinds: list[tuple[str, dict[str, Any]]] = [
        ("odrive", {"node": 1}),
        ("odrive", {"node": 1, "shared": True}),
        ("feetech", {"id": 1}),
    ]
    for driver, options in kinds:
        open_bench(driver, **options).close()  # what is opened for good
        files, threads = len(os.listdir("/proc/self/fd")), threading.active_count()
        for _ in range(3):
            open_bench(driver, **options).close()
        assert (len(os.listdir("/proc/self/fd")), threading.active_count()) == (files, threads)


def test_a_bench_that_cannot_be_made_leaves_nothing() -> None:
    """An error while it is made takes its lines away again."""
    threads = threading.active_count()
    with pytest.raises(CallerError):
        TwinBench(robot_of("feetech", {"id": 1}), pose={"nothing": 1.0})
    assert threading.active_count() == threads


# ---------------------------------------------------------------------- faults on the wire


def hit(name: str, **options: Any) -> tuple[list[can.Message], TwinBench]:
    """Ask an ODrive twice, the first answer hit by a fault; the answers that came."""
    injection = Injection(CATALOGUE[name], frozenset((0,)), seed=1)
    with open_bench(
        "odrive", node=3, time="virtual", settings={"estimates": "asked"}, injection=injection, **options
    ) as motor:
        bus = motor.bus
        for _ in range(2):
            bus.send(
                can.Message(arbitration_id=3 << 5 | 0x17, is_remote_frame=True, is_extended_id=False, dlc=8)
            )
            motor.wait(0.02)
        motor.wait(0.06)
        found = []
        while (message := bus.recv(0.0)) is not None:
            found.append(message)
        return found, motor


@pytest.mark.parametrize(
    ("name", "identifiers"),
    [
        ("loses", [0x77]),
        ("twice", [0x77, 0x77, 0x77]),
        ("stale", [0x77, 0x77, 0x77]),
        ("wrong_number", [0x97, 0x77]),
        ("others", [0x97, 0x77, 0x77]),
        ("short", [0x77, 0x77]),
        ("silent", []),
    ],
)
def test_what_a_fault_does_to_an_answer(name: str, identifiers: list[int]) -> None:
    """Each fault of CAN, on the first of two answers."""
    found, motor = hit(name)
    assert [message.arbitration_id for message in found] == identifiers
    if name == "stale":
        assert found[0].data == found[2].data != found[1].data
    if name == "short":
        assert [len(message.data) for message in found] == [7, 8]
    assert f"[{name}" in motor.text()


def test_bus_off_is_an_error_of_the_program_s_bus() -> None:
    """The program's controller goes bus-off; its twin does not."""
    injection = Injection(CATALOGUE["bus_off"], frozenset((0,)))
    options: dict[str, Any] = {"settings": {"estimates": "asked"}, "injection": injection}
    with open_bench("odrive", node=3, **options) as motor, motor.bus as bus:
        assert asked(bus, 0.02) is None
        with pytest.raises(can.CanOperationError, match="bus-off"):
            asked(bus)


@pytest.mark.parametrize(
    "name",
    [
        name
        for name, fault in CATALOGUE.items()
        if "serial" in fault.links and fault.effect and name != "overdue"
    ],
)
def test_what_a_fault_does_to_bytes(name: str) -> None:
    """Each fault of a serial line changes what is read, or when; the second answer is as it should be."""
    injection = Injection(CATALOGUE[name], frozenset((0,)), seed=1)
    with (
        open_bench("modbus", unit=5, settings=METER, injection=injection) as meter,
        serial.Serial(meter.port, meter.baud, timeout=0.1) as port,
    ):
        port.write(ASK)
        first = port.read(64)
        for _ in range(100):
            if f"[{name}" in meter.text():  # the answer has passed, or did not
                break
            first += port.read(64)
        first += port.read(64)
        took_s = meter.frames[-1].time_s - meter.frames[0].time_s
        if name == "reboot":
            meter.wait(0.5)
            port.reset_input_buffer()
        port.timeout = 0.1 if name == "silent" else 5.0
        port.write(ASK)
        second = port.read(7)
    good = bytes.fromhex("0504020000") + second[5:]
    changed = {"silent": (b"", b""), "reboot": (b"", good), "loses": (b"", good), "split": (good, good)}
    if name == "late":
        assert took_s > 0.02
        assert (first, second) == (good, good)
    elif name in changed:
        assert (first, second) == changed[name]
    else:
        assert first != good
        assert second == good


def test_an_overdue_answer_comes_before_the_right_one() -> None:
    """The answer before, with other numbers, stands before the second answer; the first has none before it."""
    injection = Injection(CATALOGUE["overdue"])
    with open_bench(
        "odrive", node=3, time="virtual", settings={"estimates": "asked"}, injection=injection
    ) as motor:
        for command in (0x17, 0x14):
            motor.bus.send(
                can.Message(
                    arbitration_id=3 << 5 | command, is_remote_frame=True, is_extended_id=False, dlc=8
                )
            )
            motor.wait(0.02)
        names = [type(one.record).__name__ for one in motor.frames if one.is_answer]
    assert names == ["BusVoltageCurrent", "BusVoltageCurrent", "Iq"]


@pytest.mark.parametrize("name", list_drivers())
def test_every_twin_says_how_true_it_is(name: str) -> None:
    """The page of a driver's twin has what it does, what that was held against, and what it does not do."""
    room = list_drivers()[name].value.partition(":")[0].split(".")[1]
    page = ROOT / "devices" / "aces_devices" / room / "README.md"
    if not page.exists():
        pytest.skip(f"{room} has no page: its manifest says what it was held against")
    said = page.read_text().partition("## Fidelity")[2]
    assert all(f"- {word}" in said for word in ("As the sources say:", "Held against:", "Not done:"))


def test_every_fault_is_said_and_every_driver_has_a_robot() -> None:
    """The catalogue says what each does and what it breaks; the drivers' own error states are by name."""
    assert all(fault.what and fault.assumption for fault in CATALOGUE.values())
    assert "overload" in load_driver("feetech").twin.faults
