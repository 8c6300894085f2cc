"""A driver and its twin in one small file: an ODrive motor controller (the catalogue has a whole one).

First what the documentation says (the spec), then what the device is to a robot (the driver), then what a simulated one does
(the twin). The robot below has two of them on one bus; it runs in virtual time, moves, and loses a reply on the way.

Source: odriverobotics/ODrive docs/can-protocol.rst, firmware 0.5.x.
"""

from __future__ import annotations

from math import tau
from typing import Any, ClassVar

from construct import Float32l, Int32ul, Struct

from aces_bus.device import Device, Driver, Job, Poll, Steps, Ticket, Twin, on, signal
from aces_bus.errors import DeviceError
from aces_bus.protocol import Enumeration, IdField, Protocol, Quantity
from aces_bus.robot import VirtualRobot, parse_robot

# ---------------------------------------------------------------------- the spec

my_wheel = Protocol(
    "my_wheel", link="can", bitrate=250_000, doc="ODrive CAN Simple", source="can-protocol.rst"
)
Node = IdField("node", range(0x3F)) << 5
Estimate = Struct("position" / Quantity(Float32l, unit="rev"), "velocity" / Quantity(Float32l, unit="rev/s"))
State = Enumeration(Int32ul, idle=1, closed_loop=8)

my_wheel.message("GetEstimates", id=Node + 0x09, remote=True, direction="to device")
my_wheel.message("Estimates", id=Node + 0x09, direction="from device", payload=Estimate)
my_wheel.message("SetState", id=Node + 0x07, direction="to device", payload=Struct("state" / State))
my_wheel.message(
    "SetVelocity",
    id=Node + 0x0D,
    direction="to device",
    payload=Struct(
        "velocity" / Quantity(Float32l, unit="rev/s"), "torque_feed_forward" / Quantity(Float32l, unit="N·m")
    ),
)

# ---------------------------------------------------------------------- the driver


class ODrive(Device):
    """One axis: position and velocity are read, velocity is set."""

    protocol = my_wheel
    polls = (Poll("GetEstimates", reply="Estimates"),)
    streams = ("SetVelocity",)  # repeated in each tick: it feeds the axis' watchdog
    provides = (
        signal("position", unit="rad", of="Estimates.position", scale=tau),
        signal(
            "velocity",
            unit="rad/s",
            of="Estimates.velocity",
            set="SetVelocity.velocity",
            scale=tau,
            lower=-20,
            upper=20,
        ),
    )
    actions: ClassVar = {"enable": "closed loop: follow set-points", "disable": "let go of the motor"}

    def completed(self, message: str, fields: dict[str, Any]) -> dict[str, Any]:
        return {**fields, "torque_feed_forward": 0.0}

    def enable(self) -> Ticket:
        return self.send("SetState", state="closed_loop")

    def disable(self) -> Ticket:
        self.drop("SetVelocity")
        return self.send_now("SetState", state="idle")

    stop_motion = disable


# ---------------------------------------------------------------------- the twin


class ODriveTwin(Twin):
    """A motor that has its velocity at once, while it is in closed loop."""

    protocol = my_wheel

    def setup(self) -> None:
        self.position = self.velocity = 0.0
        self.state, self.since = "idle", self.clock.now()

    def move(self) -> None:
        now = self.clock.now()
        self.position += self.velocity * (now - self.since) / 1e9
        self.since = now

    @on("SetState")
    def change(self, request: Any) -> None:
        self.move()
        self.state, self.velocity = request.state, 0.0

    @on("SetVelocity")
    def drive(self, request: Any) -> None:
        self.move()
        self.velocity = request.velocity if self.state == "closed_loop" else 0.0

    @on("GetEstimates")
    def answer(self, request: Any) -> None:
        self.move()
        self.reply("Estimates", position=self.position, velocity=self.velocity)


# ---------------------------------------------------------------------- a robot of two

ROBOT = """
name = "two wheels"
rate_hz = 100
[buses]
wheels = { link = "can", protocol = "my_wheel" }
[devices]
LEFT  = { driver = "my_wheel", bus = "wheels", credentials = { node = 1 } }
RIGHT = { driver = "my_wheel", bus = "wheels", credentials = { node = 2 } }
"""

driver = Driver(
    "my_wheel", ODrive, ODriveTwin, ROBOT, doc="ODrive motor controllers", source="can-protocol.rst, 0.5.x"
)


def main() -> None:
    robot, _ = parse_robot(ROBOT)
    assert robot is not None
    with VirtualRobot(robot, rate_hz=robot.rate_hz, load={"my_wheel": driver}.__getitem__) as wheels:
        wheels.rig.each("enable").wait()
        wheels["LEFT.velocity"].set(6.0)
        wheels["RIGHT.velocity"].set(99.0)  # more than the driver allows
        wheels.advance(1.0)
        print(wheels["LEFT.position"], wheels["RIGHT.velocity"])

        wheels.twins["RIGHT"].fault("silent")
        wheels.advance(0.5)
        print(wheels["RIGHT.velocity"], wheels["LEFT.velocity"])

        def turn(job: Job) -> Steps:
            left = wheels.devices["LEFT"]
            record = yield left.ask("GetEstimates", reply="Estimates")
            if record.position > 100:
                raise DeviceError("too far")
            yield 100_000_000  # ns
            yield wheels.rig.stop_motion()
            return record.position

        print(Job(wheels.clock, "turn", turn).wait())
        for event in wheels.events.last:
            print(event)


if __name__ == "__main__":
    main()
