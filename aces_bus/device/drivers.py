"""The registry of drivers: what is installed, by name, imported on use.

1. Lazy: listing imports no driver. Loud: an unknown name lists those that exist. Singular: two claims on one name raise,
   with both places.
2. Ours are registered as others' are: entry points of the group `aces_bus.devices`, each naming a `Driver`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.metadata import EntryPoint, entry_points

from ..errors import SpecError, UnknownNameError
from .device import Device
from .host import Host
from .ticket import Job, Steps
from .twin import Twin

GROUP = "aces_bus.devices"


@dataclass(frozen=True)
class Driver:
    """A driver: the device's class, its twin's, and what tests and tools need to know of both.

    `example` is a small robot file (TOML) with devices of this driver in each of their models and dialects; the
    conformance tests run on it. `scan` finds such devices on a bus: a generator function `scan(host, job)` as in `Job`, that
    asks through `host.probe(…)` and returns a list of `DeviceConfig`; None: they cannot be found. `virtual` False: it runs
    on real time only, with buses of its own. `settings` describes the keys of `settings` in robot files.
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

    def __post_init__(self) -> None:
        if not hasattr(self.device, "protocol"):
            raise SpecError(
                f"driver {self.name!r}: {self.device.__name__} does not say what it speaks: protocol = …"
            )

    @property
    def protocol(self) -> str:
        """The name of the protocol that its devices speak."""
        own = self.device.protocol
        return own if isinstance(own, str) else own.name


def list_drivers() -> dict[str, EntryPoint]:
    """The installed drivers, by name, without importing them. Raises `SpecError` when two packages claim a name."""
    found: dict[str, EntryPoint] = {}
    for point in entry_points(group=GROUP):
        other = found.get(point.name)
        if other is not None and other.value != point.value:
            raise SpecError(
                f"two packages claim the driver name {point.name!r}: {other.value} and {point.value}"
            )
        found[point.name] = point
    return dict(sorted(found.items()))


def load_driver(name: str) -> Driver:
    """The installed driver `name`; raises `UnknownNameError` with the names that exist.

    What was loaded once is kept: looking through all that is installed takes milliseconds.
    """
    kept = _loaded.get(name)
    if kept is not None:
        return kept
    known = list_drivers()
    if name not in known:
        raise UnknownNameError("driver", name, known)
    try:
        driver = known[name].load()
    except (ImportError, AttributeError) as error:
        raise SpecError(f"driver {name!r} ({known[name].value}) cannot be loaded: {error}") from error
    if not isinstance(driver, Driver):
        raise SpecError(f"{known[name].value} is not a Driver but {type(driver).__name__}")
    if driver.name != name:
        raise SpecError(f"{known[name].value} calls itself {driver.name!r} and is registered as {name!r}")
    _loaded[name] = driver
    return driver


_loaded: dict[str, Driver] = {}
