"""What happens to devices while a command runs, as lines on stderr.

1. What is over within a moment is not said: on a busy machine an answer is late now and then, and nothing was lost.
2. A line says who, where and what to look at; the same again and again is counted instead.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Mapping
from typing import TYPE_CHECKING

from .console import say

if TYPE_CHECKING:
    from aces_bus.device import DeviceEvent, Robot
    from aces_bus.robot import Rig

#: What nobody needs to be told: it was asked for, or is as it should be.
EXPECTED = frozenset({"opened", "closed", "error-active"})
#: How long a device must be silent before that is said (ns).
MOMENT = 600_000_000
#: Late answers that are said: more than so many, and more than this share of all.
FEW, SHARE = 3, 0.1

HINTS: Mapping[str, str] = {
    "error-passive": "does anybody else hear this bus? Look at bit rate, wires, terminators",
    "bus-off": "the controller left the bus after too many errors; look at bit rate, wires, terminators",
    "duplicate reply": "`aces scan` shows who is there",
}


class Happenings:
    """Listens to a rig from when it is made; `tell` prints what has come since.

    `robot` is the whole robot: its other devices, which other programs talk to, are not unknown.
    """

    def __init__(self, rig: Rig, robot: Robot) -> None:
        self.rig, self.robot = rig, robot
        self._queue: deque[DeviceEvent] = deque(maxlen=4096)
        #: Kinds that are kept back until `last`, and what has been: somebody may know better why they happen.
        self.holding: set[str] = set()
        self._held: list[DeviceEvent] = []
        #: Who has fallen silent, and that has not been said yet.
        self._silent: dict[str, DeviceEvent] = {}
        self._said_silent: set[str] = set()
        #: The buses that are lost.
        self._lost: set[str] = set()
        self._others = {
            frozenset(f"{name} {value:#04x}" for name, value in config.credentials.items())
            for config in robot.devices.values()
        }
        rig.on_event(self._queue.append)

    def tell(self, *, last: bool = False, without: Collection[str] = ()) -> None:
        """Print what has happened, `without` some kinds; with `last` also what was held back."""
        while self._queue:
            event = self._queue.popleft()
            if event.kind in self.holding:
                self._held.append(event)
            elif event.kind not in EXPECTED and event.kind not in without:
                self._sort(event)
        if last:
            self.holding.clear()
            for event in self._held:
                self._sort(event)
            self._held.clear()
        now = self.rig.clock.now()
        for name, event in list(self._silent.items()):
            if now - event.instant > MOMENT or last:
                del self._silent[name]
                self._said_silent.add(name)
                if "silent" not in without:
                    say(f"{name}: silent: {event.detail}; {self._look_at(name)}")
        if last:
            self._tell_late()

    def drop(self, kind: str) -> None:
        """Say nothing of what was held back of a kind."""
        self._held = [event for event in self._held if event.kind != kind]

    def _sort(self, event: DeviceEvent) -> None:
        who = event.device
        if event.kind == "silent":
            self._silent[who] = event
        elif event.kind == "answers":
            if self._silent.pop(who, None) is None and who in self._said_silent:
                self._said_silent.discard(who)
                say(f"{who}: answers again")
        elif event.kind == "late reply":
            pass  # counted by the rig; see `_tell_late`
        elif event.kind == "lost":
            self._lost.add(event.bus)
            say(f"{event.bus}: lost: {event.detail}; it is opened again as soon as it is there")
        elif event.kind == "not sent" and event.bus in self._lost:
            pass  # of course
        elif not (event.kind == "unknown device" and self._is_known(event.detail)):
            self._lost -= {event.bus} if event.kind == "reopened" else set()
            hint = HINTS.get(event.kind)
            detail = f": {event.detail}" if event.detail else ""
            say(f"{event.source}: {event.kind}{detail}{f'; {hint}' if hint else ''}")

    def _is_known(self, detail: str) -> bool:
        """Whether an unknown device ("Encoder of board 0x01, sensor 0x02, which …") is another device of the robot."""
        numbers = set(detail.partition(" of ")[2].partition(", which")[0].split(", "))
        return any(numbers <= other for other in self._others)

    def _look_at(self, name: str) -> str:
        """What to look at when a device does not answer."""
        config = self.robot.devices.get(name)
        if config is None:
            return "is it powered?"
        numbers = ", ".join(f"{key} {value:#04x}" for key, value in config.credentials.items())
        return f"is it powered, on bus {config.bus}, and {numbers}? `aces scan` shows who is there"

    def _tell_late(self) -> None:
        answered = sum(host.counts.answered for host in self.rig.hosts.values())
        for (kind, who), number in self.rig.events.counts.items():
            if kind == "late reply" and number > FEW and number > SHARE * answered:
                say(
                    f"{who}: {number} answers came late, {answered} in time; is the bus or this machine busy?"
                )


__all__ = ["Happenings"]
