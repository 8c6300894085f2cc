"""Speed controllers (ESCs) on DroneCAN: a throttle each, all in one frame; speed, current, voltage, temperature back.

1. One list has the throttles of all controllers of a bus: one that is stopped, silent or not enabled has 0 in it, and the
   others keep theirs. What this program does not know, it sends 0 to.
2. A controller has no state "enabled": it obeys every list. Nothing is sent before `enable`, and a controller that was
   silent or has booted (its time begins anew) has to be enabled again.
3. There is no acknowledgement, and DroneCAN states no time-out: lists are repeated in each tick, and what a controller does
   without them is its firmware's affair.

Sources: as the spec's.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from math import tau
from typing import Annotated, Any, ClassVar
from weakref import WeakKeyDictionary

import msgspec
from msgspec import Meta

from aces_bus.device import Device, Driver, HostLoss, Job, Steps, Ticket
from aces_bus.device.coalesce import OutgoingMessage, Setpoint
from aces_bus.device.host import Host
from aces_bus.device.host_loss import Outcome
from aces_bus.device.settings import described, settings_of
from aces_bus.errors import CallerError, DeviceError
from aces_protocols.dronecan.spec import FORWARD, MOST_ESCS, raw_command

from .twin import STATUS_S, EscTwin

#: How long an answer of several frames may take (s), and how long a status is fresh.
ANSWER_S, STALE_S = 0.2, 0.5
#: Priorities of throttles and of questions: 0 is the highest, 31 the lowest.
URGENT, ASIDE = 8, 24
#: The controllers of each bus, in their order.
_BUSES: WeakKeyDictionary[Host, list[DronecanEsc]] = WeakKeyDictionary()


class EscSettings(msgspec.Struct, frozen=True, kw_only=True):
    """The driver's own keys in a robot file."""

    index: Annotated[
        int,
        Meta(ge=0, lt=MOST_ESCS, description="its place in the list of throttles (a parameter of the ESC)"),
    ] = 0


def one_list(wants: Sequence[Setpoint]) -> Iterable[OutgoingMessage]:
    """Send one list for all controllers of the bus."""
    for want in wants:
        esc: DronecanEsc = want.device
        if esc.is_silent:
            esc.let_go()  # it may have booted: it is not to turn at once when it is back
        else:
            esc.throttle = int(want.value)
    first: DronecanEsc = wants[0].device
    yield OutgoingMessage(
        first, first.command, first.list_fields(), [w for w in wants if not w.device.is_silent]
    )


class DronecanEsc(Device):
    """Signals of the joint: duty (set, −1 … 1), velocity; of the controller: voltage, current, temperature, errors, …"""

    protocol = "dronecan"
    rules: ClassVar = {raw_command(count): one_list for count in range(1, MOST_ESCS + 1)}
    streams = tuple(rules)
    actions: ClassVar = {
        "enable": "take set-points from now on",
        "disable": "end set-points, and send 0",
        "info": "ask for name and versions",
    }
    asking: ClassVar = ("info",)
    when_host_is_lost = HostLoss(
        "unknown", "DroneCAN's DSDL states no time-out of RawCommand; firmware has one, or not"
    )
    attributes: ClassVar = Device.attributes | {"settings", "throttle", "command"}

    @property
    def sends_every_s(self) -> float | None:
        """Seconds from one of its messages to the next."""
        return STATUS_S

    def setup(self) -> None:
        """Add the signals. Raises `CallerError` for two controllers with one place in the list, and for several joints."""
        self.settings = settings_of(self.name, EscSettings, self.config.settings)
        if len(self.joints) > 1:
            raise CallerError(f"{self.name}: an ESC turns one motor, not {len(self.joints)}")
        others = _BUSES.setdefault(self.host, [])
        for other in others:
            if other.settings.index == self.settings.index:
                raise CallerError(
                    f"{self.name}: {other.name} has index {self.settings.index} already; give it another one"
                )
        others.append(self)
        #: What the list has for it now: −8192 … 8191.
        self.throttle = 0
        self.takes_set_points = False
        self._alarms: set[str] = set()
        self._uptime = 0
        joint = self.joint = self.joints[0] if self.joints else None
        direction, ratio = (joint.direction, joint.ratio or 1.0) if joint else (1, 1.0)
        places = [
            EscSettings(**config.settings).index
            for config in self.robot.devices_on(self.config.bus)
            if config.driver == self.config.driver
        ]
        self.command = raw_command(1 + max([1, self.settings.index, *places]))  # a list of one is a number
        most = (joint.max_duty if joint else None) or 1.0
        known: dict[str, Any] = {"stale_s": STALE_S, "source": "equipment/esc/1034.Status"}
        owner = joint.name if joint else self.name
        self.add_signal(
            "duty", owner=owner, set=f"{self.command}.commands.{self.settings.index}", lower=-most, upper=most,
            from_si=lambda duty: round(FORWARD * direction * duty), doc="throttle, −1 … 1",
            source="equipment/esc/1030.RawCommand",
        )  # fmt: skip
        self.add_signal(
            "velocity", owner=owner, unit="rad/s", of="EscStatus.motor.speed",
            to_si=lambda rpm: direction * rpm * tau / 60 / ratio, doc="of the joint", **known,
        )  # fmt: skip
        self.is_enabled = self.add_signal(
            "enabled",
            owner=owner,
            read_from=["EscStatus"],
            doc="whether set-points are taken; see the action enable",
            **known,
        )
        for name, unit in (("voltage", "V"), ("current", "A"), ("temperature", "K")):
            self.add_signal(
                name, unit=unit, of=f"EscStatus.{name}", doc="as the controller measures it", **known
            )
        self.add_signal("errors", of="EscStatus.errors", doc="errors since its motor started", **known)
        self.add_signal(
            "power",
            of="EscStatus.motor.power",
            to_si=lambda share: share / 100,
            doc="share of its power",
            **known,
        )
        self.add_signal(
            "health",
            of="NodeStatus.state.health",
            stale_s=3.0,
            doc="ok, warning, error, critical",
            source="protocol/341.NodeStatus",
        )

    # ------------------------------------------------------------------ up

    def received(self, record: Any, instant: int) -> None:
        """Take a status. Emit an alarm where its index is not the one of the robot's file."""
        name = type(record).__name__
        if name == "EscStatus":
            self.is_enabled.update(self.takes_set_points, instant)
            alarms = (
                set() if record.motor.index == self.settings.index else {f"its index is {record.motor.index}"}
            )
            self._tell(alarms | (self._alarms & {"error", "critical"}))
        elif name in ("NodeStatus", "NodeInfo"):
            if record.uptime < self._uptime:
                self.let_go()  # it has booted
            self._uptime = record.uptime
            kept = {alarm for alarm in self._alarms if alarm.startswith("its index")}
            self._tell(kept | ({str(record.state.health)} & {"error", "critical"}))
            if {"error", "critical"} & self._alarms:
                self.let_go()

    def _tell(self, alarms: set[str]) -> None:
        self.emit_alarms(alarms, self._alarms)
        self._alarms = alarms

    # ------------------------------------------------------------------ down

    def list_fields(self) -> dict[str, Any]:
        """Return the list of throttles of all controllers of this bus, as they are now."""
        commands = [0] * int(self.command.removeprefix("RawCommand"))
        for esc in _BUSES[self.host]:
            commands[esc.settings.index] = esc.throttle
        return {"priority": URGENT, "commands": commands}

    def let_go(self) -> None:
        """End set-points: its throttle is 0 from the next list on."""
        self.takes_set_points, self.throttle = False, 0
        self.drop(self.command)

    def enable(self) -> Job:
        """Take set-points. Fails with `DeviceError` when the node reports an error, or has another place in the list."""

        def steps(job: Job) -> Steps:
            self.let_go()
            yield from self._ask_info()
            if self._alarms:
                raise DeviceError(f"{self.name}: {', '.join(sorted(self._alarms))}")
            self.takes_set_points = self.is_driven = True

        return self.lead("enable", steps)

    def disable(self) -> Ticket:
        """End set-points, and send 0."""
        return self.stop_motion()

    def stop_motion(self) -> Ticket:
        """Send a list with 0 for this controller, and what the others have."""
        self.end_led()
        self.let_go()
        return self.send_now(self.command, **self.list_fields())

    @property
    def stop_leaves(self) -> Outcome:
        """The motor is not driven: whether it is braked is a parameter of the ESC."""
        return "limp"

    def _ask_info(self) -> Steps:
        return (yield self.ask("GetNodeInfo", reply="NodeInfo", timeout_s=ANSWER_S, priority=ASIDE))

    def info(self) -> Job:
        """Read {"name": "org.example.esc", "software": "1.2", "hardware": "1.0", "unique_id": "…"}."""

        def steps(job: Job) -> Steps:
            found = yield from self._ask_info()
            return {
                "name": found.rest[1 + found.rest[0] :].decode("utf-8", "replace") if found.rest else "",
                "software": f"{found.software_major}.{found.software_minor}",
                "hardware": f"{found.hardware_major}.{found.hardware_minor}",
                "unique_id": found.unique_id.hex().upper(),
            }

        return self.job("info", steps)


EXAMPLE = """
name = "dronecan_esc"
rate_hz = 50

[buses]
arms = { link = "can", protocol = "dronecan", bitrate = 1_000_000 }

[devices]
FRONT = { driver = "dronecan_esc", bus = "arms", credentials = { node = 20, host = 10 }, settings = { index = 0 } }
BACK = { driver = "dronecan_esc", bus = "arms", credentials = { node = 21, host = 10 }, settings = { index = 3 } }

[joints]
ROTOR_FRONT = { device = "FRONT", type = "continuous", command = "duty" }
ROTOR_BACK = { device = "BACK", type = "continuous", command = "duty", direction = -1, max_duty = 0.8 }
"""

driver = Driver(
    "dronecan_esc",
    device=DronecanEsc,
    twin=EscTwin,
    example=EXAMPLE,
    doc="Speed controllers (ESCs) on DroneCAN (UAVCAN v0).",
    source="DroneCAN DSDL uavcan/equipment/esc, uavcan/protocol",
    settings=described(EscSettings),
)

__all__ = ["EXAMPLE", "DronecanEsc", "EscSettings", "driver"]
