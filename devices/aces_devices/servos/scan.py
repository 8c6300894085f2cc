"""Which servos are on a line: each id is asked once, those that answer for their model.

An unanswered Ping costs its own line time, the longest return delay (508 µs) and what the adapter adds: at 57 600 baud
and 16 ms all ids take 5 s.
"""

from __future__ import annotations

from collections.abc import Callable

import msgspec

from aces_bus.device import Device, Job, Steps
from aces_bus.device.config import DeviceConfig
from aces_bus.device.host import Host
from aces_bus.errors import NoReplyError
from aces_bus.protocol.declare.registers import RegisterMap

#: The longest return delay: 254 × 2 µs (RX-28 manual; ROBOTIS e-manual; the same register in Feetech's servos).
LONGEST_DELAY_S = 254 * 2e-6
#: What an adapter may add: most collect bytes for up to 16 ms.
ADAPTER_S = 0.016


def servo_scan(
    driver: str, registers: RegisterMap, ids: range, *, model: Callable[[bytes], object] | None = None
) -> Callable[..., Steps]:
    """Return the scan of a driver of servos; its steps end with a `DeviceConfig` for each that was found.

    `model` makes a name, or a number, of the register `model_number`, where the map's own field does not do.
    `job.progress` grows with the ids. A servo that answers no reads (status return level 0) has no model. An id that is
    answered by damaged packets only is listed too, and its `doc` says so: two servos have it, or the line is bad.
    """
    protocol = registers.protocol.name

    def scan(host: Host, job: Job | None = None, *, adapter_s: float = ADAPTER_S, tries: int = 2) -> Steps:
        found: list[DeviceConfig] = []
        taken = {device.credentials.get("id"): device for device in host.devices.values()}
        for number in ids:
            if job is not None:
                job.progress, job.text = number / len(ids), f"id {number}, {len(found)} found"
            known = taken.get(number)
            device = known if known is not None else host.probe(protocol, id=number)
            try:
                config = yield from look(host, device, number, adapter_s, tries)
            finally:
                if known is None:
                    host.remove(device.name)
            if config is not None:
                found.append(config)
        return found

    def look(host: Host, device: Device, number: int, adapter_s: float, tries: int) -> Steps:
        """Return the servo with this id; None: there is none."""
        config = DeviceConfig(
            name=f"S{number}", driver=driver, bus=host.name, credentials={"id": number}, channels=1
        )
        wait_s = LONGEST_DELAY_S + adapter_s + host.port.wire_ns(bytes(8)) / 1e9
        garbled = ("garbled", device.name)
        for _ in range(tries):
            before = host.events.counts[garbled]
            try:
                yield device.ask("Ping", reply="Status", timeout_s=wait_s, retries=0)
                break
            except NoReplyError:
                if host.events.counts[garbled] == before:
                    return None
        else:
            doc = "its answers are damaged: two servos with this id, or a bad line"
            return msgspec.structs.replace(config, doc=doc)
        register = registers["model_number"]
        try:
            answer = yield device.ask(
                "Read",
                reply="Status",
                timeout_s=wait_s,
                retries=tries,
                start=register.address,
                count=register.size,
            )
        except NoReplyError:
            return msgspec.structs.replace(config, settings={"status_return_level": 0})
        if len(answer.parameters) != register.size:
            return config
        value = (model or register.decode)(answer.parameters)
        return msgspec.structs.replace(config, model=value if isinstance(value, str) else f"model {value}")

    return scan
