"""Drivers: what a package registers for one kind of device, and those that are installed (see `aces_bus.plugins`)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from ..errors import CallerError, SpecError
from ..plugins import InstalledPoint, Plugins
from ..protocol.files import PROTOCOLS, load_file
from ..protocol.protocol import Protocol
from .device import Device
from .host import Host
from .ticket import Job, Steps
from .twin import Twin


@dataclass(frozen=True)
class Driver:
    """A driver: the device's class, its twin's, and what tests and tools need to know of both.

    `example` is a small robot file (TOML) with devices of this driver in each of their models and dialects; the
    conformance tests run on it. `scan` finds such devices on a bus: a generator function `scan(host, job)` as in `Job`, that
    asks through `host.probe(…)` and returns a list of `DeviceConfig`; None: they cannot be found. `virtual` False: it runs
    on real time only, with buses of its own. `settings` describes the keys of `settings` in robot files. `speaks` is the
    protocol, or its name, where one class of device has several; else the class says it.
    """

    name: str
    device: type[Device]
    twin: type[Twin]
    example: str
    doc: str = ""
    source: str = ""
    scan: Callable[[Host, Job], Steps] | None = None
    virtual: bool = True
    settings: Mapping[str, str] | None = None
    speaks: str | Protocol | None = None

    def __post_init__(self) -> None:
        if self.speaks is None and not hasattr(self.device, "protocol"):
            raise SpecError(
                f"driver {self.name!r}: {self.device.__name__} does not say what it speaks: protocol = …"
            )

    @property
    def spoken(self) -> str | Protocol:
        """The protocol that its devices speak, or the name of an installed one."""
        return self.device.protocol if self.speaks is None else self.speaks

    @property
    def protocol(self) -> str:
        """The name of the protocol that its devices speak."""
        own = self.spoken
        return own if isinstance(own, str) else own.name


#: The drivers that are installed.
DRIVERS = Plugins("aces_bus.devices", "driver", Driver)


def list_drivers() -> dict[str, InstalledPoint]:
    """Return the installed drivers, by name, without importing them."""
    return DRIVERS.points()


def load_driver(name: str) -> Driver:
    """Return the installed driver `name`; raises `UnknownNameError` with the names that exist."""
    return DRIVERS.load(name)


def use_driver_file(path: str) -> list[Driver]:
    """Run a Python file, and have its drivers and their protocols under their names in this program, as if installed.

    A file may have protocols alone: a robot's file may name it then, wherever it is. Raises `CallerError` for a file that
    cannot be run or has neither, `SpecError` for a name that is another's.
    """
    items = vars(load_file(path))
    found = {name: item for name, item in items.items() if isinstance(item, Driver)}
    if not found and not any(isinstance(item, Protocol) for item in items.values()):
        raise CallerError(f"{path}: declares no driver at its top level: NAME = Driver(…)")
    for name, driver in found.items():
        own = driver.spoken
        if not isinstance(own, str):
            PROTOCOLS.add(own.name, own, f"{path}:{own.name}")
        DRIVERS.add(driver.name, driver, f"{path}:{name}")
    return list(found.values())
