"""Every wire that the laws are tested on: registered protocols, the specs of `tests/specs`, the corners."""

from __future__ import annotations

import importlib
import tomllib
from dataclasses import dataclass
from pathlib import Path

from aces_bus import list_protocols
from aces_bus.protocol import Protocol
from aces_bus.testing import laws
from aces_bus.testing.scenes import Way, Wire
from tests.laws.corners import CORNERS
from tests.specs.catalogue import SPECS

ROOT = Path(__file__).resolve().parents[2]


def registered() -> dict[str, Protocol]:
    """The protocols that are registered: the installed ones, else those that the project file names."""
    installed = list_protocols()
    if installed:
        return {name: point.load() for name, point in installed.items()}
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    found: dict[str, Protocol] = {}
    for name, target in project["entry-points"]["aces_bus.protocols"].items():
        module, _, attribute = target.partition(":")
        found[name] = getattr(importlib.import_module(module), attribute)
    return found


REGISTERED = registered()
PROTOCOLS: dict[str, Protocol] = {**REGISTERED, **SPECS, **CORNERS}


@dataclass(frozen=True)
class Case:
    """A wire and a direction; `share` is how many cases its protocol has, which share the examples."""

    wire: Wire
    direction: Way
    share: int

    def __str__(self) -> str:
        variants = laws.wire_variants(self.wire)
        return f"{'+'.join(v.label for v in variants)}-{(self.direction or 'any').replace(' ', '_')}"


CASES = [
    Case(variant, way, len(laws.wires(protocol)))
    for protocol in PROTOCOLS.values()
    for variant, way in laws.wires(protocol)
]


def _together(direction: Way, *names: str) -> Case:
    return Case(tuple(PROTOCOLS[name].variant() for name in names), direction, 2)


#: Several protocols on one wire: each byte has one owner.
MIXED = [
    _together("from device", "robotis", "minihubo_adc"),
    _together("both", "minihubo_adc", "robotis"),
    _together("both", "dynamixel2", "robotis"),
    _together(None, "ubx", "nmea0183", "mavlink1"),
    _together(None, "slip", "ubx"),
    _together("from device", "modbus_like", "robotis"),
    _together(None, "check_corners", "opaque_corners"),
    _together(None, "mit_motor", "odrive_like"),
    _together("from device", "hubo", "automotive", "odrive_like", "j1939_like"),
]
