"""A DDS domain that reaches this machine alone: its sockets, writers and readers of bytes.

1. The configuration is given whole, so that `CYCLONEDDS_URI` has no say. Multicast is off; peers are asked by unicast, at
   127.0.0.1 or where the call says.
2. Cyclone DDS binds the sockets that it receives with to all addresses. They are bound to the interface before anything is
   written or read (SO_BINDTODEVICE), so that the kernel drops what comes by another; where that fails, so does opening.
3. A write never waits: what a reader does not take at once is dropped and counted.

*Facts* (cyclonedds 11.0.1): `DataWriter.write` takes 0.2 ms for 35 joints, 98 % of it in Python's serialiser; the function
below it takes bytes. *Source* of ports: DDSI-RTPS 2.5 §9.6.2.3, 7400 + 250 × domain and up. ROS 2's user data (`enclave=`,
`typehash=`) are those of rmw_cyclonedds_cpp of Jazzy.
"""

from __future__ import annotations

import os
import re
import socket
import sys
from collections.abc import Collection, Iterator, Sequence
from contextlib import suppress
from xml.sax.saxutils import quoteattr

from aces_bus.errors import CallerError

from .messages import HASHES, Library, cyclonedds, dds_type

#: ROS 2's own bound of ROS_DOMAIN_ID where ports of clients begin at 32768 (docs.ros.org, "The ROS_DOMAIN_ID").
MOST_DOMAIN = 101
#: Participants of one machine that are asked.
PARTICIPANTS = 32
#: Messages that are taken at once, and that wait.
AT_ONCE = 16
#: cyclonedds gives numbers of writers as signed in one place and unsigned in another.
_HANDLE = (1 << 64) - 1
_HOST = re.compile(r"[A-Za-z0-9.:-]{1,253}")


def configuration(interface: str, peers: Collection[str]) -> str:
    """Return Cyclone's configuration for one interface ("": loopback) and unicast peers."""
    chosen = f"name={quoteattr(interface)}" if interface else 'address="127.0.0.1"'
    found = "".join(f"<Peer address={quoteattr(peer)}/>" for peer in peers or ("127.0.0.1",))
    return (
        '<CycloneDDS><Domain Id="any"><General><AllowMulticast>false</AllowMulticast><Interfaces>'
        f'<NetworkInterface {chosen} multicast="false"/></Interfaces></General><Discovery>'
        "<ParticipantIndex>auto</ParticipantIndex>"
        f"<MaxAutoParticipantIndex>{PARTICIPANTS - 1}</MaxAutoParticipantIndex><Peers>{found}</Peers></Discovery>"
        "</Domain></CycloneDDS>"
    )


class DdsDomain:
    """One participant of a domain; `close` ends it. Raises `CallerError` where it cannot be opened as rule 2 demands."""

    def __init__(self, domain: int, interface: str = "", peers: Collection[str] = ()) -> None:
        if not 0 <= domain <= MOST_DOMAIN:
            raise CallerError(f"--domain {domain}: give a number from 0 to {MOST_DOMAIN}")
        if interface and interface not in (names := [name for _, name in socket.if_nameindex()]):
            raise CallerError(f"--ros2-interface {interface}: this machine has {', '.join(names)}")
        for peer in peers:
            if not _HOST.fullmatch(peer):
                raise CallerError(f"--ros2-peer {peer!r}: give a host's name or address")
        if peers and not interface:
            raise CallerError("--ros2-peer needs --ros2-interface: by which interface is it reached?")
        if sys.platform != "linux":
            raise CallerError(
                "--ros2 needs Linux: elsewhere other machines cannot be kept out of its sockets"
            )
        core, made = cyclonedds("core"), cyclonedds("domain")
        self.domain, self.interface = domain, interface
        before = set(_sockets())
        try:
            self._domain = made.Domain(domain, configuration(interface, peers))
        except core.DDSException as error:
            raise CallerError(f"DDS domain {domain} cannot be opened by this program: {error}") from None
        self._entities: list[Library] = [self._domain]
        try:
            self._keep_in(interface or "lo", before)
            self.participant = made.DomainParticipant(domain, core.Qos(core.Policy.Userdata(b"enclave=/;")))
            self._entities.append(self.participant)
        except core.DDSException as error:
            self.close()
            raise CallerError(f"DDS domain {domain} has no participant to spare: {error}") from None
        except BaseException:
            self.close()
            raise

    def _keep_in(self, device: str, before: Collection[int]) -> None:
        """Bind the sockets that this domain receives with to an interface. Raises `CallerError` when there is none."""
        found = 0
        for number in [number for number in _sockets() if number not in before]:
            with suppress(OSError), socket.socket(fileno=os.dup(number)) as one:
                if one.family != socket.AF_INET or one.type != socket.SOCK_DGRAM:
                    continue
                address, port = one.getsockname()
                if address == "0.0.0.0" and 0 <= port - (7400 + 250 * self.domain) < 250:
                    one.setsockopt(socket.SOL_SOCKET, socket.SO_BINDTODEVICE, device.encode() + b"\0")
                    found += 1
        if found < 2:
            raise CallerError(
                f"DDS: its sockets cannot be bound to {device}, so that other machines would reach them;"
                " Linux 5.7 or later lets programs do that"
            )

    def writer(self, topic: str, message: str, depth: int = 10) -> DdsWriter:
        """Return what publishes a ROS topic."""
        return DdsWriter(self, topic, message, depth)

    def reader(self, topic: str, message: str) -> DdsReader:
        """Return what takes a ROS topic."""
        return DdsReader(self, topic, message)

    def endpoint(self, topic: str, message: str, depth: int) -> tuple[Library, Library]:
        """Return topic and quality of service of an endpoint: reliable, volatile, the newest `depth` messages kept."""
        core = cyclonedds("core")
        made = cyclonedds("topic").Topic(self.participant, f"rt{topic}", dds_type(message))
        quality = core.Qos(
            core.Policy.Reliability.Reliable(0),
            core.Policy.History.KeepLast(depth),
            core.Policy.Userdata(f"typehash=RIHS01_{HASHES[message]};".encode()),
        )
        self._entities.append(made)
        return made, quality

    def keep(self, entity: Library) -> None:
        """Keep an entity until the domain is closed."""
        self._entities.append(entity)

    def close(self) -> None:
        """Leave the domain; twice does nothing."""
        entities, self._entities = self._entities, []
        for entity in reversed(entities):
            entity.__del__()


class DdsWriter:
    """Publishes a topic as bytes. `dropped` counts what was not taken at once."""

    def __init__(self, domain: DdsDomain, topic: str, message: str, depth: int) -> None:
        self.topic, self.message = topic, message
        made, quality = domain.endpoint(topic, message, depth)
        self._writer = cyclonedds("pub").DataWriter(domain.participant, made, quality)
        domain.keep(self._writer)
        self._write = cyclonedds("_clayer").ddspy_write
        self.sent = self.dropped = 0

    def write(self, data: bytes) -> None:
        """Send a message: encapsulation header and CDR."""
        if self._write(self._writer._ref, data + bytes(-len(data) % 4)) < 0:
            self.dropped += 1
        else:
            self.sent += 1


class DdsReader:
    """Takes a topic's messages, each with a number that tells its writers apart."""

    def __init__(self, domain: DdsDomain, topic: str, message: str) -> None:
        self.topic, self.message = topic, message
        made, quality = domain.endpoint(topic, message, AT_ONCE)
        self._reader = cyclonedds("sub").DataReader(domain.participant, made, quality)
        domain.keep(self._reader)
        self._take = cyclonedds("_clayer").ddspy_take
        core = cyclonedds("core")
        self._mask = core.SampleState.Any | core.ViewState.Any | core.InstanceState.Any
        self._type = dds_type(message)

    def take(self) -> Iterator[tuple[Library, int]]:
        """Yield the messages that have come, None for one that cannot be read, with its writer's number."""
        found = self._take(self._reader._ref, self._mask, AT_ONCE)
        for data, info in found if isinstance(found, list) else ():
            if not info.valid_data:
                continue
            try:
                message = self._type.deserialize(data)
            except Exception:  # whatever the library's reader raises for bytes of others
                message = None
            yield message, info.publication_handle & _HANDLE

    def writers(self) -> Sequence[int]:
        """Return the numbers of the writers that are there."""
        return [number & _HANDLE for number in self._reader.get_matched_publications()]


def _sockets() -> Iterator[int]:
    """Yield the file descriptors of this process that are sockets."""
    for name in os.listdir("/proc/self/fd"):
        with suppress(OSError):
            if os.readlink(f"/proc/self/fd/{name}").startswith("socket:"):
                yield int(name)
