"""Finding devices that have a number each: the same question to every number, in turn."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from aces_bus.device import Job, Steps
from aces_bus.device.config import DeviceConfig
from aces_bus.device.host import Host

#: What `Driver(scan=…)` takes.
Scan = Callable[[Host, Job], Steps]
#: What an answer says of a device beside its number, as `DeviceConfig` takes it; None: it is of another kind.
Known = Callable[[Any], Mapping[str, Any] | None]


def scan_numbers(
    driver: str,
    prefix: str,
    credential: str,
    numbers: Sequence[int],
    message: str,
    *,
    reply: str | tuple[str, ...],
    timeout_s: float,
    retries: int = 1,
    protocol: str | None = None,
    known: Known = lambda answer: {},
    **fields: Any,
) -> Scan:
    """Return a scan in which each number is asked `message` with these fields, which must change nothing.

    The device that answers is called `prefix` and its number. `protocol` is what is spoken, by default the driver's name.
    """

    def scan(host: Host, job: Job) -> Steps:
        found: list[DeviceConfig] = []
        for place, number in enumerate(numbers):
            job.progress, job.text = place / len(numbers), f"{credential} {number}, {len(found)} found"
            who = {credential: number}
            answer = yield from host.answers(
                protocol or driver, who, message, reply=reply, timeout_s=timeout_s, retries=retries, **fields
            )
            more = None if answer is None else known(answer)
            if more is not None:
                name = f"{prefix}{number}"
                found.append(DeviceConfig(name=name, driver=driver, bus=host.name, credentials=who, **more))
        return found

    return scan


__all__ = ["Scan", "scan_numbers"]
