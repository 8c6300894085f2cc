"""Which servos are on a line: each id is asked once, those that answer for their model.

A Ping that nobody answers costs 12 bytes of line time, the longest return delay (508 µs) and what the adapter adds: at
57 600 baud and 20 ms all 254 ids take 6 s.
"""

from __future__ import annotations

from typing import Any, ClassVar

from aces_bus.device import Device, DeviceConfig, Host, Job, Robot, Steps
from aces_bus.errors import NoReplyError
from aces_protocols.robotis.spec import SERVOS, control_table

#: The longest return delay: 254 × 2 µs (RX-28 manual).
LONGEST_DELAY_S = 254 * 2e-6
#: What an adapter may add: most collect bytes for up to 16 ms.
ADAPTER_S = 0.016


class _Probe(Device):
    """Whoever answers to an id."""

    protocol: ClassVar[Any] = "robotis"
    silent_after = 1 << 30

    def setup(self) -> None:
        self.garbles = 0

    def garbled(self, reason: str, instant: int) -> None:
        self.garbles += 1


def scan(host: Host, job: Job | None = None, *, adapter_s: float = ADAPTER_S, tries: int = 2) -> Steps:
    """Find the servos on a line at its present speed; the steps end with a `DeviceConfig` each.

    `job.progress` grows with the ids. A servo that answers no reads (status return level 0) has no model. An id that is
    answered by garbled words only is listed too, and its `doc` says so: two servos have it, or the line is bad.
    """
    found: list[DeviceConfig] = []
    taken = {device.credentials.get("id"): device for device in host.devices.values()}
    robot = Robot(name="scan", buses={}, devices={}, joints={}, sensors={})
    variant = next(v for v in host.variants.values() if v.protocol.name == "robotis")
    for number in SERVOS:
        if job is not None:
            job.progress, job.text = number / len(SERVOS), f"id {number}, {len(found)} found"
        known = taken.get(number)
        config = DeviceConfig(
            name=f"S{number}",
            driver="robotis_rx",
            bus=host.name,
            credentials={"id": number},
            channels=1,
        )
        probe = known if known is not None else host.add(_Probe(host, config, robot, variant))
        try:
            yield from _look(host, probe, config, found, adapter_s, tries)
        finally:
            if known is None:
                host.remove(probe.name)
    return found


def _look(
    host: Host, probe: Device, config: DeviceConfig, found: list[DeviceConfig], adapter_s: float, tries: int
) -> Steps:
    import msgspec

    wait_s = LONGEST_DELAY_S + adapter_s + host.port.wire_ns(bytes(8)) / 1e9
    retries = 0
    while True:
        try:
            yield probe.ask("Ping", reply="Status", timeout_s=wait_s, retries=0)
            break
        except NoReplyError:
            garbles = getattr(probe, "garbles", 0)
            if not garbles:
                return
            retries += 1
            if retries > tries:
                doc = "its answers are garbled: two servos with this id, or a bad line"
                found.append(msgspec.structs.replace(config, doc=doc))
                return
    register = control_table["model_number"]
    model: str | None = None
    settings: dict[str, Any] = {}
    try:
        wait_s += host.port.wire_ns(bytes(register.size)) / 1e9
        answer = yield probe.ask(
            "Read",
            reply="Status",
            timeout_s=wait_s,
            retries=tries,
            start=register.address,
            count=register.size,
        )
        if len(answer.parameters) == register.size:
            value = register.decode(answer.parameters)
            model = value if isinstance(value, str) else f"model {value}"
    except NoReplyError:
        settings = {"status_return_level": 0}
    found.append(msgspec.structs.replace(config, model=model, settings=settings))


__all__ = ["scan"]
