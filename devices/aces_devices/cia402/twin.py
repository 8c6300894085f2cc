"""The twin of a CiA 402 drive: a node with axes that move.

1. It begins as a drive does: a boot-up message, pre-operational, "switch on disabled".
2. An object of axis n is 0x800 × n higher than that of axis 0, which its model knows.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, ClassVar

from aces_bus.device.settings import settings_of

from ..canopen_node.pdo import PdoEntry, offset_of
from ..canopen_node.twin import CanopenTwin
from .dictionary import dictionary_of
from .model import HOT, OVER_VOLTAGE, REGISTERS, AxisModel
from .units import DriveSettings, units_of


class Cia402Twin(CanopenTwin):
    """A drive: state machine, profile and cyclic modes, homing, limits, emergencies, PDOs at SYNC or on a timer."""

    faults: ClassVar = {
        **CanopenTwin.faults,
        "jammed": "the joint is blocked: a following error when it is to move",
        "over_voltage": "too high a voltage inside: a fault, until it is gone and acknowledged",
        "hot": "warns of its temperature",
        "no_home": "homing does not find its switch",
    }

    def setup(self) -> None:
        """Create the node and its axes, as if just switched on."""
        settings = settings_of(self.name, DriveSettings, self.config.settings)
        self.dictionary = dictionary_of(settings.eds, self.credentials["node"])
        now = self.clock.now()
        axes: dict[int, AxisModel] = {}
        for joint in self.joints:
            offset = 0x800 * joint.channel
            units = units_of(self.name, joint, settings)
            old = self.world.joints.get(joint.name)
            made = AxisModel(joint, units, self._numbers(offset), now, self.send_emergency)
            # Switched off, it stays where it was.
            place = old.position(now) if isinstance(old, AxisModel) else self.world.start_of(joint.name)
            if place:
                made.motor.place(now, place)
                made.demand = made.goal = made.motor.q * units.per_rad + units.zero
            made.motor.controller = made.step_at
            made.motor.join(self.world, joint.name)
            axes[offset] = self.world.joints[joint.name] = made
        self.axes = axes
        self.add_node(self.dictionary)  # last: from here on its clock's thread may ask for them
        self._apply_faults()

    def _numbers(self, offset: int) -> dict[int, int]:
        """Return the numbers of an axis in the dictionary."""
        found: dict[int, int] = {}
        for index, entry in self.dictionary.items():
            if index < 0x6000 or offset_of(index) != offset:
                continue
            members = [entry] if hasattr(entry, "data_type") else entry.values()
            for place in members:
                value = place.value if place.value is not None else place.default
                if isinstance(value, int):
                    key = index - offset if place is entry else (index - offset) << 8 | place.subindex
                    found[key] = value
        return found

    # ------------------------------------------------------------------ objects

    def in_order(self, places: Sequence[PdoEntry]) -> Iterable[PdoEntry]:
        """Return targets before the controlword: a rising bit 4 takes what came with it."""
        return sorted(places, key=lambda place: place.index - offset_of(place.index) == 0x6040)

    def take_object(self, index: int, subindex: int, value: int, now: int) -> None:
        """Take an object of an axis that was written."""
        offset = offset_of(index)
        axis = self.axes.get(offset)
        if axis is not None and index >= 0x6000:
            own = index - offset
            axis.written(own if not subindex else own << 8 | subindex, value, now)

    def object_value(self, index: int, subindex: int, now: int) -> Any:
        """Return what the axes know better than the dictionary."""
        if index == 0x1001:
            return self._register()
        offset = offset_of(index)
        axis = self.axes.get(offset)
        return None if axis is None or subindex or index < 0x6000 else axis.read(index - offset, now)

    def _register(self) -> int:
        found = 0
        for axis in self.axes.values():
            for code in (*axis.causes, *((axis.error,) if axis.error else ())):
                found |= REGISTERS.get(code, 1)
        return found

    def lost_host(self, now: int) -> None:
        """React to the loss of the host as object 6007 says."""
        for axis in self.axes.values():
            axis.advance(now)
            axis.lost_connection()

    # ------------------------------------------------------------------ misbehaving

    def fault(self, name: str, amount: float | None = None, *, on: bool = True) -> None:
        """Do what `Twin.fault` does; what the axes must know is passed on to them."""
        super().fault(name, amount, on=on)
        self._apply_faults()

    def _apply_faults(self) -> None:
        faults = self.active_faults
        now = self.clock.now()
        for axis in self.axes.values():
            axis.advance(now)
            axis.motor.jammed = "jammed" in faults
            axis.cannot_home = "no_home" in faults
            axis.cause(OVER_VOLTAGE, "over_voltage" in faults)
            if ("hot" in faults) != axis.is_hot:
                axis.is_hot = "hot" in faults
                self.send_emergency(*((HOT, REGISTERS[HOT]) if axis.is_hot else (0, 0)))

    def power(self, on: bool) -> None:
        """Switch it off, or on again."""
        if not on:
            for axis in self.axes.values():
                axis.advance(self.clock.now())
                axis.state = "not ready to switch on"
                axis.motor.free(self.clock.now())
        super().power(on)
