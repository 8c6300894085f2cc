"""Finding nodes of a device profile: every node is asked what it is; nodes that only send heartbeats are noticed meanwhile.

1. Bounded: 127 nodes, one request each, two more of those that answer.
2. Nodes of other device profiles are left to those who know them.
"""

from __future__ import annotations

from aces_bus.device import Device, Job, Steps
from aces_bus.device.config import DeviceConfig
from aces_bus.device.host import Host
from aces_bus.errors import AcesError

from .sdo import SdoChannel

NODES = range(1, 128)
#: Seconds that a node may take to answer.
ANSWER_S = 0.02


def scan_nodes(host: Host, job: Job, profile: int, driver: str, prefix: str, *, with_silent: bool) -> Steps:
    """Ask each node for its device type and identity; those of `profile` are a `driver`'s, named `prefix` and their number.

    `with_silent`: also nodes that send, and do not answer.
    """
    probes: dict[int, Device] = {node: host.probe("canopen", node=node) for node in NODES}
    found: list[DeviceConfig] = []
    answered: set[int] = set()
    try:
        for node, probe in probes.items():
            job.progress, job.text = node / len(NODES), f"node {node}"
            try:
                answer = yield probe.ask(
                    "SdoUpload",
                    reply=("SdoUploaded", "SdoAborted"),
                    timeout_s=ANSWER_S,
                    retries=0,
                    index=0x1000,
                    subindex=0,
                )
            except AcesError:
                continue
            answered.add(node)
            if type(answer).__name__ == "SdoUploaded" and answer.data[:2] == profile.to_bytes(2, "little"):
                model = yield from _model(probe)
                found.append(_config(host, driver, prefix, node, model, None))
        for node, probe in probes.items() if with_silent else ():
            if probe.last_received is not None and node not in answered:
                doc = "sends, and does not answer SDO: what it is is not known"
                found.append(_config(host, driver, prefix, node, None, doc))
    finally:
        for probe in probes.values():
            host.remove(probe.name)
    return found


def _model(probe: Device) -> Steps:
    """Return vendor and product, as the identity object has them."""
    channel = SdoChannel(probe, ANSWER_S)
    parts: list[str] = []
    for name, subindex in (("vendor", 1), ("product", 2)):
        try:
            data: bytes = yield channel.upload(0x1018, subindex)
        except AcesError:
            continue
        parts.append(f"{name} 0x{int.from_bytes(data, 'little'):X}")
    return ", ".join(parts) or None


def _config(
    host: Host, driver: str, prefix: str, node: int, model: str | None, doc: str | None
) -> DeviceConfig:
    return DeviceConfig(
        name=f"{prefix}{node}", driver=driver, bus=host.name, credentials={"node": node}, model=model, doc=doc
    )
