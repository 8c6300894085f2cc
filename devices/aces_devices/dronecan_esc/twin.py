"""The twin of an ESC with its motor: its throttle of each list, a status twenty times a second, who it is.

1. A list that is too short for its place has nothing for it, and is not obeyed.
2. Without a list for half a second it stops: a choice, as is the motor (4000 rpm at full throttle, 80 ms behind).
"""

from __future__ import annotations

from math import tau
from typing import Any, ClassVar

from aces_bus.device import Twin, on
from aces_bus.runtime.clock import Timer
from aces_devices.wheel_model import TurningWheel
from aces_protocols.dronecan.spec import FORWARD, MOST_ESCS, raw_command

#: Periods of the controller's and the node's status, and without a list for so long it stops (s).
STATUS_S, NODE_STATUS_S, TIMEOUT_S = 0.05, 1.0, 0.5
MOST_RPM, FOLLOWS_S = 4000.0, 0.08
#: Supply (V), current at full throttle (A), temperature (K); choices.
SUPPLY_V, MOST_A, WARM_K = 24.0, 20.0, 305.0
NAME = b"org.aces.twin.esc"


class EscTwin(Twin):
    """One ESC: `throttle` is what it was given last (−8192 … 8191), `rpm` how fast its motor turns."""

    protocol = "dronecan"
    faults: ClassVar = {
        "trip": "its health is `error`, errors are counted, and the motor is not driven while it lasts",
        "jam": "the motor does not turn, and takes three times its current",
    }

    def setup(self) -> None:
        """Boot: not driven."""
        self.index = int(self.config.settings.get("index", 0))
        self.throttle, self.errors = 0, 0
        self.wheel = TurningWheel(self.clock.now())
        self._booted = self.clock.now()
        self._late: Timer | None = None
        self.every(STATUS_S, self._say)
        self.every(NODE_STATUS_S, lambda: self.reply("NodeStatus", delay_ns=0, priority=20, **self.status()))

    @property
    def rpm(self) -> float:
        """Speed of the motor, in turns a minute."""
        return self.wheel.speed(self.clock.now()) * 60 / tau

    def status(self) -> dict[str, Any]:
        """Return the fields of the node's status."""
        health = "error" if "trip" in self.active_faults else "ok"
        uptime = (self.clock.now() - self._booted) // 1_000_000_000
        return {
            "uptime": uptime,
            "state": {"health": health, "mode": "operational", "sub_mode": 0},
            "vendor_code": 0,
        }

    def _drive(self) -> None:
        """Have the motor follow the throttle."""
        if "jam" in self.active_faults:
            self.wheel.block(self.clock.now())
            return
        share = 0.0 if "trip" in self.active_faults else self.throttle / FORWARD
        self.wheel.lead(self.clock.now(), share * MOST_RPM * tau / 60, FOLLOWS_S)

    def _say(self) -> None:
        self._drive()
        if "trip" in self.active_faults:
            self.errors += 1
        share = abs(self.throttle) / FORWARD
        self.reply(
            "EscStatus",
            delay_ns=0,
            priority=16,
            errors=self.errors,
            voltage=SUPPLY_V - 0.5 * share,
            current=MOST_A * share * (3 if "jam" in self.active_faults else 1),
            temperature=WARM_K + 20 * share,
            motor={"speed": round(self.rpm), "power": round(100 * min(1.0, share)), "index": self.index},
        )

    @on(*(raw_command(count) for count in range(1, MOST_ESCS + 1)))
    def take(self, request: Any) -> None:
        """Take its throttle of a list."""
        commands = (request.commands,) if isinstance(request.commands, int) else request.commands
        if self.index < len(commands):
            self.throttle = commands[self.index]
            self._drive()
            if self._late is not None:
                self._late.cancel()
            self._late = self.clock.call_in(round(TIMEOUT_S * 1e9), self._stop)

    def _stop(self) -> None:
        self.throttle = 0
        self._drive()

    @on("GetNodeInfo")
    def tell(self, request: Any) -> None:
        """Answer who it is, with the number of the request: who asked knows its answer by it."""
        if "silent" in self.active_faults:
            return
        node = self.credentials["node"]
        frames = self.variant.encoder.numbered(
            request.meta.frames[0][-1] & 31, "NodeInfo", node=node, host=request.host, priority=request.priority,
            **self.status(), software_major=1, software_minor=2, software_flags=0, software_commit=0, software_crc=0,
            hardware_major=1, hardware_minor=0, unique_id=bytes(15) + bytes([node]), rest=b"\0" + NAME,
        )  # fmt: skip
        self.replies += 1
        self.send_raw(tuple(frames))
