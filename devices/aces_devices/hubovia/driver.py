"""HuboVia: joints of a Hubo 2 through its Windows control PC, which takes angles by UDP and answers nothing.

1. A device is one motor, known by its number; its joint's direction and zero make the motor's angle: goal = direction ×
   position + zero, as everywhere.
2. The angle goes out in whole degrees and hundredths, rounded to the nearest hundredth of all, with its carry.
3. Each new set-point is sent once, with the next tick: nothing says that it came. `stop_motion` ends what is waiting;
   the PC carries out what it has received.
"""

from __future__ import annotations

from functools import partial
from math import degrees
from typing import Any, ClassVar

from aces_bus.device import Device, Driver, HostLoss, Ticket
from aces_bus.device.config import Joint
from aces_bus.errors import CallerError
from aces_bus.protocol.record import FieldValue

from .twin import MotorTwin

#: What three bytes hold.
MOST = 32767.99


def angle_bytes(angle: float) -> dict[str, Any]:
    """Return an angle in degrees as the datagram has it.

    >>> angle_bytes(-87.73), angle_bytes(45.499999), angle_bytes(-0.001)["negative"]
    ({'negative': 1, 'degrees': 87, 'hundredths': 0.73}, {'negative': 0, 'degrees': 45, 'hundredths': 0.5}, 0)
    >>> angle_bytes(29.996)["degrees"], angle_bytes(29.996)["hundredths"]
    (30, 0.0)
    """
    hundredths = round(abs(angle) * 100)
    whole, rest = divmod(hundredths, 100)
    return {"negative": int(angle < 0 and hundredths > 0), "degrees": whole, "hundredths": rest / 100}


class HuboviaJoint(Device):
    """Signals: position (rad, set only) of its joint."""

    protocol = "hubovia"
    when_host_is_lost = HostLoss(
        "goes on", "hubovia: the PC carries out what it has received, and answers nothing"
    )
    actions: ClassVar = {"repeat": "send the last set-point once more: a datagram may have been lost"}

    def setup(self) -> None:
        """Add the position of the joint."""
        if len(self.joints) > 1:
            names = ", ".join(joint.name for joint in self.joints)
            raise CallerError(f"{self.name}: one motor moves one joint, not {names}")
        self.last: dict[str, FieldValue] | None = None
        for joint in self.joints:
            motor = self.credentials["motor"]
            if joint.motor not in (None, motor):
                raise CallerError(f"{self.name} is motor {motor}; its joint {joint.name} says {joint.motor}")
            self.add_signal(
                "position",
                unit="rad",
                owner=joint.name,
                set="Joint.angle",
                from_si=partial(self._angle, joint),
                lower=joint.lower,
                upper=joint.upper,
                doc="where the PC is to move it; where it is, is not reported",
                source="acesHubo huboVia",
            )

    def _angle(self, joint: Joint, position: float) -> dict[str, Any]:
        angle = degrees(joint.direction * position + (joint.zero or 0.0))
        if abs(angle) > MOST:
            self.emit_event("limited", f"{joint.name}: {angle:g}° does not fit into a datagram")
            angle = MOST if angle > 0 else -MOST
        self.last = angle_bytes(angle)
        return self.last

    def repeat(self) -> Ticket | None:
        """Send the last set-point once more; nothing when there was none."""
        return None if self.last is None else self.send("Joint", angle=self.last)

    def stop_motion(self) -> None:
        """Forget the set-point that waits. The protocol has no message that stops what has begun."""
        self.drop("Joint")


EXAMPLE = """
name = "hubovia"
rate_hz = 50

[buses]
pc = { link = "datagram", protocol = "hubovia" }

[devices]
VIA_RSP = { driver = "hubovia", bus = "pc", credentials = { motor = 30 }, channels = 1 }
VIA_LSR = { driver = "hubovia", bus = "pc", credentials = { motor = 35 }, channels = 1 }

[joints]
RSP = { device = "VIA_RSP", channel = 0, motor = 30, lower = -2.0, upper = 2.0 }
LSR = { device = "VIA_LSR", channel = 0, motor = 35, direction = -1, zero = 0.1 }
"""

driver = Driver(
    "hubovia",
    device=HuboviaJoint,
    twin=MotorTwin,
    example=EXAMPLE,
    doc="A motor of a Hubo 2, by UDP through its Windows control PC.",
    source="acesHubo huboVia, hubovia.ops",
)
