"""A robot's real buses: the gates that its file or its user names, and a loop for what they hear."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from ..device.config import Bus, Robot
from ..device.drivers import Driver, load_driver
from ..device.port import Port
from ..errors import CallerError
from ..hardware.can import CanGate
from ..hardware.datagram import DatagramGate
from ..hardware.ports import port_of
from ..hardware.serial import SerialGate
from ..protocol import Protocol
from ..runtime import Loop
from .rig import spoken_on


def is_half_duplex(bus: Bus, protocol: Protocol) -> bool:
    """Whether all on a robot's bus share one pair of wires."""
    return protocol.half_duplex if bus.half_duplex is None else bus.half_duplex


def gate_of(
    bus: Bus, protocol: Protocol, options: Mapping[str, Any] | None = None
) -> CanGate | SerialGate | DatagramGate:
    """The gate of a robot's bus. `options` are python-can's (CAN), `channel` and `baud` (serial), or `channel` HOST:PORT.

    They take precedence over what the file says; a datagram bus with `bind` (HOST:PORT) waits there for whoever speaks
    first. Raises `CallerError` when neither says where the bus is.
    """
    chosen = dict(options or {})
    channel = chosen.pop("channel", None) or bus.channel
    bind = chosen.pop("bind", None)
    if channel is None and bind is None:
        raise CallerError(f"bus {bus.name}: which channel? The robot's file does not say; give one")
    if bus.link == "can":
        rate = bus.bitrate or protocol.bitrate
        whole = {"channel": channel, **({"interface": bus.interface} if bus.interface else {})}
        if rate:
            whole["bitrate"] = rate
        return CanGate({**whole, **chosen}, name=bus.name)
    if bus.link == "serial":
        baud = int(chosen.pop("baud", None) or bus.baud or protocol.baud or 115_200)
        half = is_half_duplex(bus, protocol)
        return SerialGate(str(channel), baud=baud, half_duplex=half, name=bus.name, **chosen)
    if bind is not None:
        return DatagramGate(_address(bus, bind), name=bus.name)
    return DatagramGate(peer=_address(bus, str(channel)), name=bus.name)


def _address(bus: Bus, text: str) -> tuple[str, int]:
    host, _, port = text.rpartition(":")
    if not host or not port.isdigit():
        raise CallerError(f"bus {bus.name}: {text!r} is not HOST:PORT")
    return host, int(port)


def open_gates(
    robot: Robot,
    loop: Loop,
    options: Mapping[str, Mapping[str, Any]] | None = None,
    *,
    load: Callable[[str], Driver] = load_driver,
) -> dict[str, Port]:
    """A port for each bus of a robot that has active devices; `options` by bus, see `gate_of`. Nothing is opened yet."""
    ports: dict[str, Port] = {}
    for name, protocol in spoken_on(robot, load).items():
        bus = robot.buses[name]
        gate = gate_of(bus, protocol, (options or {}).get(name))
        ports[name] = port_for(gate, bus, loop)
    return ports


def port_for(gate: CanGate | SerialGate | DatagramGate, bus: Bus, loop: Loop) -> Any:
    """The port of a bus's gate, which knows what words cost."""
    more: dict[str, Any] = {}
    if isinstance(gate, CanGate):
        more["bitrate"] = bus.bitrate
    elif isinstance(gate, SerialGate):
        more = {"baud": gate.baud, "half_duplex": gate.half_duplex}
    return port_of(gate, loop, **more)
