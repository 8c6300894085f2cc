"""The twins of a VESC on CAN and at a serial line: what it does is `VescModel`'s, how its packets travel is theirs."""

from __future__ import annotations

from math import pi
from random import Random
from typing import ClassVar

from aces_bus.device import Twin, on
from aces_bus.protocol import Record
from aces_protocols.vesc.buffers import Buffers, can_pieces
from aces_protocols.vesc_uart.packets import PacketReader, packet_of

from .model import MISBEHAVIOUR, SET_POINTS, SPEED, TRIP, VescModel

#: How often status messages are sent where the robot's file says so (s): the first group's default.
STATUS_S = 0.02


class VescMotorTwin(Twin):
    """What both have in common: a `model`, its faults, and power."""

    faults: ClassVar = MISBEHAVIOUR
    amounts: ClassVar = TRIP
    model: VescModel

    def powered(self, number: int) -> None:
        """Boot the controller `number`; its motor stays where it is."""
        if "model" in self.__dict__:
            self.model.boot()
        else:
            self.model = VescModel(self, number)

    def fault(self, name: str, amount: float | None = None, *, on: bool = True) -> None:
        """See `Twin.fault`."""
        super().fault(name, amount, on=on)
        if name == "hot" and on:
            self.model.motor.temperature = self.active_faults.pop("hot")  # from here on it cools
        self.model.lead()

    def draw(self, dice: Random, share: float = 1.0) -> None:
        """Have its motor turn, either way, and be warm (°C); it turns on from an angle within half a turn."""
        motor, scale = self.model.motor, self.model.scale
        speed = scale.speed(dice.uniform(-SPEED, SPEED) * share)
        self.model.warm = round(dice.uniform(-20.0, 110.0) * share, 1)
        jammed, motor.jammed = motor.jammed, False
        motor.place(self.clock.now(), scale.angle(dice.uniform(-pi, pi) * share))
        motor.v, motor.jammed = speed, jammed

    def power(self, on: bool) -> None:
        """See `Twin.power`; without power the motor runs out."""
        if not on:
            self.model.release()
        super().power(on)

    def stop(self) -> None:
        """End what repeats."""
        self.model.release()
        super().stop()


class VescTwin(VescMotorTwin):
    """A controller on CAN: its `model` is the motor, and what was set."""

    protocol = "vesc"

    def setup(self) -> None:
        """Boot; see `VescModel`."""
        number = self.credentials["receiver"] = self.credentials["id"]
        self.powered(number)
        self.buffers = Buffers(number)
        self.reader = PacketReader("to device")
        if self.config.settings.get("values") == "status":
            self.every(STATUS_S, self.send_status)

    @on(*SET_POINTS)
    def take(self, request: Record) -> None:
        """Take a set-point."""
        self.model.set(request)

    @on("Ping")
    def pong(self, request: Record) -> None:
        """Answer a Ping."""
        self.reply("Pong", host=request.host, hardware="vesc")

    @on("PollPosition")
    def send_position(self, request: Record) -> None:
        """Send the rotor's angle."""
        self.reply("RotorPosition", position=self.model.values["position"])

    def send_status(self) -> None:
        """Send status messages 1, 4 and 5."""
        values = self.model.values
        self.reply("Status", speed=values["speed"], current=values["motor_current"], duty=values["duty"])
        names = ("fet_temperature", "motor_temperature", "input_current", "position")
        self.reply("Status4", **{name: values[name] for name in names})
        self.reply("Status5", tachometer=values["tachometer"], voltage=values["voltage"], reserved=0)

    @on("ShortRequest", "LongRequest", "FillBuffer", "FillBufferFar")
    def take_piece(self, request: Record) -> None:
        """Take a piece of a packet; carry out a packet that is complete."""
        packet = self.buffers.take(request)
        record = None if packet is None else self.reader.read(packet)
        answer = None if record is None else self.model.answer(record)
        if answer is None or request.mode == 2:
            return
        message, fields = answer
        for piece, inside in can_pieces(
            packet_of(message, **fields), host=request.host, receiver=request.host, mode=1
        ):
            self.reply(piece, **inside)


class VescUartTwin(VescMotorTwin):
    """A controller on a serial line."""

    protocol = "vesc_uart"

    def setup(self) -> None:
        """Boot; see `VescModel`."""
        self.powered(0)

    @on("GetSelected", "GetValues", "GetFirmware", "Alive", *SET_POINTS)
    def carry_out(self, request: Record) -> None:
        """Carry out a packet."""
        answer = self.model.answer(request)
        if answer is not None:
            self.reply(answer[0], **answer[1])
