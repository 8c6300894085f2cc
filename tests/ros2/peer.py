"""A ROS 2 program's place: plain cyclonedds, with types made of rosbags' definitions of Jazzy; ours has no part in it.

`python -m tests.ros2.peer DOMAIN SECONDS` subscribes to `/joint_states` and prints what came as hex, a line a message; with
a topic and type, to that one. `python -m tests.ros2.peer DOMAIN SECONDS command JOINT VALUE` gives set-points.
"""

from __future__ import annotations

import sys
import time
from functools import cache
from importlib import import_module
from typing import Any

import pytest

core: Any = pytest.importorskip("cyclonedds.core", reason="needs the extra ros2")
rosbags: Any = pytest.importorskip("rosbags.typesys", reason="needs rosbags (make test-oracles)")
dds: dict[str, Any] = {
    name: import_module(f"cyclonedds.{name}") for name in ("domain", "pub", "sub", "topic", "idl")
}
types: Any = import_module("cyclonedds.idl.types")
Nodetype: Any = import_module("rosbags.interfaces").Nodetype

JAZZY: Any = rosbags.get_typestore(rosbags.Stores.ROS2_JAZZY)
RELIABLE = core.Qos(core.Policy.Reliability.Reliable(1_000_000_000), core.Policy.History.KeepLast(1000))
#: What a user of Cyclone DDS writes into CYCLONEDDS_URI to stay on his machine.
LOOPBACK = (
    '<CycloneDDS><Domain><General><AllowMulticast>false</AllowMulticast><Interfaces><NetworkInterface address="127.0.0.1"/>'
    "</Interfaces></General><Discovery><ParticipantIndex>auto</ParticipantIndex>"
    '<Peers><Peer address="127.0.0.1"/></Peers></Discovery></Domain></CycloneDDS>'
)


@cache
def idl(name: str) -> Any:
    """cyclonedds' class of a message, made of rosbags' definition."""
    plain: dict[str, Any] = {
        "string": str,
        "byte": types.byte,
        "octet": types.byte,
        **{kind: getattr(types, kind) for kind in ("float64", "int32", "uint32", "uint8")},
    }

    def made(node: Any) -> Any:
        kind, content = node
        if kind == Nodetype.BASE:
            return plain[content[0]]
        if kind == Nodetype.NAME:
            return idl(content)
        inside, size = content
        return types.array[made(inside), size] if kind == Nodetype.ARRAY else types.sequence[made(inside)]

    package, _, title = name.rpartition("/")
    fields = {field: made(node) for field, node in JAZZY.fielddefs[name][1]}
    return dds["idl"].make_idl_struct(title, f"{package.replace('/', '::')}::dds_::{title}_", fields)


def stamped(seconds: int = 0, nanoseconds: int = 0) -> Any:
    """A header of this stamp."""
    return idl("std_msgs/msg/Header")(idl("builtin_interfaces/msg/Time")(seconds, nanoseconds), "")


class Peer:
    """A participant of a domain that this process has opened, or opens."""

    def __init__(self, domain: int, *, opens: bool = False) -> None:
        self._domain = dds["domain"].Domain(domain, LOOPBACK) if opens else None
        self.participant = dds["domain"].DomainParticipant(domain)

    def writer(self, topic: str, message: str) -> Any:
        """A reliable writer of a ROS topic."""
        return dds["pub"].DataWriter(self.participant, self._topic(topic, message), RELIABLE)

    def reader(self, topic: str, message: str) -> Any:
        """A reliable reader of a ROS topic."""
        return dds["sub"].DataReader(self.participant, self._topic(topic, message), RELIABLE)

    def _topic(self, topic: str, message: str) -> Any:
        return dds["topic"].Topic(self.participant, f"rt{topic}", idl(message))


def listen(domain: int, seconds: float, topic: str, message: str) -> None:
    """Print what comes."""
    take: Any = import_module("cyclonedds._clayer").ddspy_take
    mask = core.SampleState.Any | core.ViewState.Any | core.InstanceState.Any
    peer = Peer(domain, opens=True)  # its end would be the reader's
    reader = peer.reader(topic, message)
    print("ready", flush=True)
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        found = take(reader._ref, mask, 100)
        for data, info in found if isinstance(found, list) else ():
            if info.valid_data:
                print(data.hex(), flush=True)
        time.sleep(0.02)


def command(domain: int, seconds: float, joint: str, value: float) -> None:
    """Command a joint."""
    peer = Peer(domain, opens=True)
    writer = peer.writer("/joint_command", "sensor_msgs/msg/JointState")
    print("ready", flush=True)
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        writer.write(idl("sensor_msgs/msg/JointState")(stamped(), [joint], [value], [], []))
        time.sleep(0.05)


def main(domain: int, seconds: float, *more: str) -> None:
    if more[:1] == ("command",):
        command(domain, seconds, more[1], float(more[2]))
    else:
        listen(domain, seconds, *(more or ("/joint_states", "sensor_msgs/msg/JointState")))


if __name__ == "__main__":
    main(int(sys.argv[1]), float(sys.argv[2]), *sys.argv[3:])
