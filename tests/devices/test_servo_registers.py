"""Register-mapped devices, on a protocol of no vendor: names, units, coalescing, what is remembered, what is late."""

from __future__ import annotations

from typing import Any

import pytest
from construct import Byte, Bytes, GreedyBytes, GreedyRange, Int16ub, Struct, this

from aces_bus.device import UNKNOWN, Driver, Twin, on
from aces_bus.errors import CallerError, DeviceError, FieldError, UnknownNameError
from aces_bus.protocol import Enumeration, Protocol, Sum
from aces_bus.robot import VirtualRobot, parse_robot
from aces_devices.servos.registers import RegisterCodec, RegisterDevice

gadget = Protocol("gadget", link="serial", baud=115_200, half_duplex=True, broadcast={"id": 0xFF})
packet = gadget.framing(
    sync=b"\xa5", header=Struct("id" / Byte, "length" / Byte), size=this.length + 4, max_size=64, check=Sum()
)
ask = packet.family(Struct("code" / Byte), direction="to device")
Read = ask("Read", code=1, payload=Struct("start" / Byte, "count" / Byte))
Write = ask("Write", code=2, payload=Struct("start" / Byte, "data" / GreedyBytes))
Together = ask(
    "Together",
    code=3,
    match={"id": 0xFF},
    payload=Struct(
        "start" / Byte,
        "size" / Byte,
        "servos" / GreedyRange(Struct("id" / Byte, "data" / Bytes(this._.size))),
    ),
)
Answer = packet(
    "Answer",
    direction="from device",
    match={"id": range(0xFF)},
    reply_to=(Read, Write),
    overrides=("Read", "Write", "Together"),
    payload=Struct("code" / Byte, "data" / GreedyBytes),
)
table = gadget.registers(read=Read, write=Write, sync=Together)
table.add("serial", 0x00, Int16ub, access="read")
table.add("gain", 0x02, Byte, unit="%", range=(0, 100), default=10)
table.add("goal", 0x10, Int16ub, unit="°", scale=0.1, range=(0, 3600))
table.add("mode", 0x12, Enumeration(Byte, off=0, on=1))
table.add("place", 0x20, Int16ub, unit="°", scale=0.1, access="read")


class Gadget(RegisterDevice):
    """Answers with `Answer`; keeps 0x00–0x0F without power; hears at most 20 bytes at once."""

    protocol = gadget
    registers = table
    reply, payload = "Answer", "data"
    eeprom = range(0x10)
    remembers = ("mode",)
    streamed = ("goal",)
    together_bytes, together_overhead = 20, 6

    def setup(self) -> None:
        self.polls = [self.poll("place"), self.poll("goal", "mode", every_s=0.1)]
        self.register_signal("angle", "place", scale=0.5, set="goal", unit="half °", lower=0, upper=180)
        self.register_signal("mode", "mode", set="mode")

    def refusal(self, record: Any) -> str:
        return "it says no" if record.code else ""


class GadgetTwin(Twin):
    """Its place is its goal."""

    protocol = gadget
    no = False

    def setup(self) -> None:
        self.memory = bytearray(0x30)
        self.together = 0

    @on("Read")
    def read(self, request: Any) -> None:
        self.memory[0x20:0x22] = self.memory[0x10:0x12]
        self.reply("Answer", code=0, data=bytes(self.memory[request.start : request.start + request.count]))

    @on("Write")
    def write(self, request: Any) -> None:
        if not self.no:
            self.memory[request.start : request.start + len(request.data)] = request.data
        self.reply("Answer", code=int(self.no), data=b"")

    @on("Together")
    def many(self, request: Any) -> None:
        self.together += 1
        for one in request.servos:
            if one.id == self.credentials["id"]:
                self.memory[request.start : request.start + len(one.data)] = one.data


DRIVER = Driver("gadget", Gadget, GadgetTwin, "", doc="A gadget.", source="this test")


def made(count: int = 2, *, rate_hz: float | None = 50) -> VirtualRobot:
    """G1, G2 … on a line."""
    devices = "\n".join(
        f'G{n} = {{ driver = "gadget", bus = "b", credentials = {{ id = {n} }} }}'
        for n in range(1, count + 1)
    )
    robot, problems = parse_robot(
        f'name = "gadgets"\n[buses]\nb = {{ link = "serial", protocol = "gadget" }}\n[devices]\n{devices}'
    )
    assert robot is not None, problems
    return VirtualRobot(robot, rate_hz=rate_hz, load=lambda name: DRIVER)


def test_a_register_is_a_number_with_a_unit() -> None:
    """Read and written by name, in the sheet's unit; several that stand side by side in one request."""
    with made() as robot:
        device, twin = robot.devices["G1"], robot.twins["G1"]
        device.write("goal", 12.5).wait()
        assert twin.memory[0x10:0x12] == bytes((0, 125))
        assert device.read("goal").wait() == 12.5
        assert device.read("goal", raw=True).wait() == 125
        assert device.read("goal", "mode").wait() == {"goal": 12.5, "mode": "off"}
        assert set(device.read_all().wait()) == set(table)
        assert device.cached("goal") == 12.5
        assert device.cached("serial", raw=True) == 0
        assert made().devices["G1"].cached("goal") is None


def test_calls_that_are_wrong_raise_at_once() -> None:
    """Unknown, read-only, out of range, the wrong way round, and what keeps its value without power."""
    with made() as robot:
        device = robot.devices["G1"]
        with pytest.raises(UnknownNameError, match="did you mean 'goal'"):
            device.read("gaol")
        with pytest.raises(CallerError, match="can only be read"):
            device.write("place", 1)
        with pytest.raises(FieldError, match="goal"):
            device.write("goal", 361)
        with pytest.raises(FieldError, match="mode"):
            device.write("mode", "sideways")
        with pytest.raises(CallerError, match="comes before"):
            device.read("place", "goal")
        with pytest.raises(CallerError, match="confirm=True"):
            device.write("gain", 50)
        device.write("gain", 50, confirm=True).wait()
        assert robot.twins["G1"].memory[2] == 50


def test_a_refusal_is_an_error_with_its_reason() -> None:
    """What the device refuses was not written, and is not remembered as if it were."""
    with made() as robot:
        robot.twins["G1"].no = True
        with pytest.raises(DeviceError, match=r"G1: writing mode = 'on': refused: it says no"):
            robot.devices["G1"].write("mode", "on").wait()
        robot.advance(0.3)
        assert robot["G1.mode"].value == "off"
        assert robot.events.count("rebooted") == 0


def test_set_points_of_all_go_out_together() -> None:
    """One packet a register and tick; a receiver's buffer of 20 bytes takes four goals, the fifth needs another packet."""
    with made(5) as robot:
        robot.advance(0.1)
        for n in range(1, 6):
            robot[f"G{n}.angle"].set(10.0 * n)
        robot.advance(0.03)
        assert robot.twins["G1"].together == 2
        robot.advance(0.1)
        assert [robot[f"G{n}.angle"].value for n in range(1, 6)] == [10, 20, 30, 40, 50]
        assert robot.twins["G1"].together == pytest.approx(12, abs=2)  # repeated in each tick
        robot.devices["G1"].drop("goal")
        for n in range(2, 6):
            robot.devices[f"G{n}"].drop("Together")
        robot.advance(0.03)
        before = robot.twins["G1"].together
        robot.advance(0.1)
        assert robot.twins["G1"].together == before


def test_a_set_point_that_is_not_repeated_is_read_back() -> None:
    """It goes out once, and again when it turns out not to have arrived; one that never stays is told."""
    with made() as robot:
        robot.advance(0.2)
        robot["G1.mode"].set("on")
        robot.advance(0.3)
        assert robot["G1.mode"].value == "on"
        assert robot.twins["G1"].together == 1
        robot.twins["G2"]._handlers["Together"] = lambda request: None
        robot["G2.mode"].set("on")
        robot.advance(1.0)
        assert robot.events.count("limited", "G2") == 1
        assert "mode was set to 1 and stays 0" in robot.events.of("limited")[0].detail


def test_what_was_forgotten_betrays_a_reboot() -> None:
    """A register that only changes when it is written has another value: nothing that was known is true any more."""
    with made() as robot:
        robot.devices["G1"].write("mode", "on").wait()
        robot["G1.angle"].set(20)
        robot.advance(0.3)
        robot.twins["G1"].reboot()
        robot.advance(0.3)
        assert robot.events.count("rebooted", "G1") == 1
        assert robot.events.of("rebooted")[0].detail == "mode is 0, was set to 1"
        assert robot.devices["G1"].goals == {}
        robot.advance(0.3)
        assert robot.events.count("rebooted", "G1") == 1


def test_an_answer_of_another_size_is_no_value() -> None:
    """What comes late, for another request, is told and changes nothing."""
    with made(1, rate_hz=0) as robot:
        device = robot.devices["G1"]
        robot.twins["G1"].fault("silent")
        job = device.read("place")
        robot.advance(0.001)
        robot.twins["G1"].fault("silent", on=False)
        robot.twins["G1"].reply("Answer", code=0, data=b"\x12\x34\x56")
        robot.advance(0.004)
        assert robot.events.count("late reply", "G1") == 1
        assert robot["G1.angle"].value is UNKNOWN
        assert job.wait() == 0


def test_only_plain_numbers_have_codecs() -> None:
    """A register of bytes is named when a driver is made of its table."""
    odd = Protocol("odd", link="serial")
    frame = odd.framing(sync=b"\x01", size=4)
    frame("R", payload=Struct("all" / Bytes(3)))
    registers = odd.registers(read="R", write="R")
    registers.add("blob", 0, Bytes(4))
    with pytest.raises(CallerError, match="blob is not a plain number"):
        RegisterCodec(registers, "blob")
