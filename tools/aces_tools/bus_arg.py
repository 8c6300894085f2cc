"""Which bus a command works on, and how it is opened: the options that `sniff`, `send` and `play` share.

    can0                                 a network interface of this machine, or a channel that `aces bus serve` serves
    -i socketcan -c can0 -b 1000000      CAN: python-can's own options, configuration files and CAN_* variables
    -i aces -c unix:can0                 the virtual bus of `aces bus serve`
    --serial /dev/ttyUSB0 --baud 57600   a serial line: a port, socket://host:port, rfc2217://…, a pty
    --udp 14550                          UDP datagrams

1. One bus, of one kind: options of two kinds are refused, and so is a protocol of another kind.
2. Nothing is opened before everything else about the call is known to be right.
3. What the system or a backend says when a bus cannot be opened becomes one line, with the bus's name.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import os
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from glob import glob
from typing import TYPE_CHECKING, Any, Literal

from aces_bus.errors import CallerError, first_names
from aces_bus.loopback import is_loopback
from aces_bus.protocol import Variant
from aces_bus.protocol.record import PlainValue

from .options import Group, argument, at_least, flag

if TYPE_CHECKING:
    from aces_bus.hardware import CanGate, DatagramGate, SerialGate

    from .several_buses import SeveralGates

    AnyGate = CanGate | SerialGate | DatagramGate

Kind = Literal["can", "serial", "datagram"]

#: What python-can's options put into a namespace.
CAN_OPTIONS = ("channel", "interface", "bitrate", "fd", "data_bitrate", "timing", "bus_kwargs")
_COM_PORT = re.compile(r"COM[0-9]+", re.IGNORECASE)
#: The line speed where neither the call nor a protocol says one.
BAUD = 115_200
LOOPBACK = "127.0.0.1"

HELP = (
    "name it with -i INTERFACE -c CHANNEL (python-can's; also in ~/.canrc or CAN_INTERFACE and CAN_CHANNEL),"
    " --serial URL, or --udp [HOST:]PORT"
)


def can_options(title: str) -> Callable[[argparse.ArgumentParser], None]:
    """Return python-can's options of a bus, under a title."""

    def add(parser: argparse.ArgumentParser) -> None:
        from can import cli

        before = set(parser._actions)
        cli.add_bus_arguments(parser, group_title=title)
        for action in set(parser._actions) - before:
            if action.dest == "timing":
                _hush(action)
            elif action.dest == "interface":
                action.metavar = "INTERFACE"  # its thirty choices would fill the help

    return add


#: python-can's options of a bus, and ours of a line.
BUS_ARGUMENTS = (
    can_options("CAN bus (python-can's options)"),
    Group(
        "serial line, datagrams",
        (
            argument("--serial", metavar="URL", help="a port, socket://HOST:PORT, rfc2217://…"),
            argument(
                "--baud",
                type=at_least(1),
                metavar="N",
                help=f"line speed (default: the protocol's, else {BAUD})",
            ),
            flag("--half-duplex", help="one pair of wires for both ways (RS-485), with its echo"),
            argument("--udp", metavar="[HOST:]PORT", help="UDP datagrams, by default of this machine only"),
        ),
    ),
)


def _hush(action: Any) -> None:
    """Keep python-can from printing what --timing means: standard output is ours."""
    kind = type(action)

    class Quiet(kind):  # type: ignore[misc,valid-type]
        def __call__(self, *arguments: Any, **options: Any) -> None:
            with contextlib.redirect_stdout(io.StringIO()):
                super().__call__(*arguments, **options)

    action.__class__ = Quiet


@dataclass(frozen=True)
class ChosenBus:
    """A bus that is named and not yet open. `options` are python-can's keywords (CAN) or the gate's (others)."""

    kind: Kind
    name: str
    options: Mapping[str, Any] = field(default_factory=dict)

    @property
    def link(self) -> Literal["can", "serial"]:
        """Link as captures name it: every byte stream is `serial`."""
        return "can" if self.kind == "can" else "serial"

    @property
    def described(self) -> str:
        """Name of the bus in messages."""
        return f"{self.name} (interface {self.options.get('interface')})" if self.kind == "can" else self.name

    def on(self, channel: str) -> ChosenBus:
        """Return the same kind of CAN bus, another channel of it; a name that is served on this machine is that served
        channel.
        """
        other = {**self.options, "channel": channel}
        other.pop("name", None)
        if other.get("interface") == "aces" and (address := served_address(channel)):
            other.update(channel=address, name=channel)
        return replace(self, name=channel, options=other)

    def gate(self, *, listen_only: bool, send_rate: float | None = None) -> AnyGate:
        """Return its gatekeeper, not yet started. With `listen_only` the gate has no way to send."""
        if self.kind == "can":
            from aces_bus.hardware import CanGate

            return CanGate(self.options, name=self.name, listen_only=listen_only, send_rate=send_rate)
        if self.kind == "serial":
            from aces_bus.hardware import SerialGate

            return SerialGate(name=self.name, listen_only=listen_only, **self.options)
        from aces_bus.hardware import DatagramGate

        host, port = self.options["address"]
        if listen_only:
            return DatagramGate((host, port), name=self.name, listen_only=True)
        near = LOOPBACK if is_loopback(host) else "0.0.0.0"
        return DatagramGate((near, 0), peer=(host, port), name=self.name)

    def start(self, gate: AnyGate | SeveralGates) -> None:
        """Start its gate; raises `CallerError` for whatever opening raises."""
        try:
            gate.start()
        except CallerError:
            raise
        except Exception as error:  # whatever a backend or the system may raise
            said = " ".join(str(error).split()) or type(error).__name__
            raise CallerError(f"{self.described} cannot be opened: {said}") from error


def chosen_bus(arguments: argparse.Namespace, variants: Sequence[Variant] = ()) -> ChosenBus:
    """Return the bus that the options name; raises `CallerError` when they name none or two, or none for these protocols."""
    if getattr(arguments, "bus", None) is not None:
        _take_name(arguments)
    given = [f"--{name.replace('_', '-')}" for name in CAN_OPTIONS if name in arguments]
    if arguments.serial is not None and arguments.udp is not None:
        raise CallerError("--serial and --udp are two buses; name one")
    if given and (arguments.serial is not None or arguments.udp is not None):
        other = "--serial" if arguments.serial is not None else "--udp"
        raise CallerError(f"{given[0]} is for CAN and {other} is not; name one bus")
    if arguments.serial is None:
        for option in ("baud", "half_duplex"):
            if getattr(arguments, option):
                raise CallerError(f"--{option.replace('_', '-')} is for serial lines; name one: --serial URL")
    if arguments.serial is not None:
        chosen = _serial(arguments, variants)
    elif arguments.udp is not None:
        chosen = _datagrams(arguments.udp)
    else:
        _check_link("can", variants)
        chosen = _can(arguments)
    _check_link(chosen.kind, variants)
    return chosen


_END = re.compile(r"(?P<name>.*?)(?:@(?P<rate>[0-9]+))?(?:\?(?P<options>[^?]*))?")


def chosen_end(text: str, variants: Sequence[Variant] = ()) -> ChosenBus:
    """Return a bus that is named in one word: `can0`, `slcan:/dev/ttyACM0@500000?ttyBaudrate=115200`, `/dev/ttyUSB0@57600`,
    `udp:14550`. Raises `CallerError` as `chosen_bus` does."""
    from can.interfaces import VALID_INTERFACES
    from can.util import cast_from_string

    found = _END.fullmatch(text)
    assert found is not None  # all parts are optional
    name, rate = found["name"], None if found["rate"] is None else int(found["rate"])
    options: dict[str, Any] = {}
    for pair in found["options"].split("&") if found["options"] else ():
        key, sign, value = pair.partition("=")
        if not (key and sign):
            raise CallerError(f"{text!r}: behind ? write option=value, and & between two")
        options[key] = cast_from_string(value)
    arguments = argparse.Namespace(bus=None, serial=None, udp=None, baud=None, half_duplex=False)
    interface, sign, channel = name.partition(":")
    if sign and interface == "udp":
        arguments.udp = channel
    elif sign and interface in VALID_INTERFACES:
        arguments.interface, arguments.channel = interface, channel
    else:
        arguments.bus = name
        _take_name(arguments)
        arguments.bus = None
    if arguments.serial is not None:
        arguments.baud = rate
        arguments.half_duplex = bool(options.pop("half_duplex", False))
    if options and (arguments.serial is not None or arguments.udp is not None):
        raise CallerError(
            f"{text!r}: {', '.join(options)}: options are for CAN; a serial line has half_duplex=true"
        )
    if arguments.serial is None and arguments.udp is None:
        if rate is not None:
            arguments.bitrate = rate
        if options:
            arguments.bus_kwargs = options
    return chosen_bus(arguments, variants)


def _take_name(arguments: argparse.Namespace) -> None:
    """Turn a bus named without an option into the option that it stands for; raise `CallerError` for two names."""
    text: str = arguments.bus
    other = "--channel" if "channel" in arguments else "--udp" if arguments.udp is not None else None
    other = "--serial" if arguments.serial is not None else other
    if other is not None:
        raise CallerError(f"{text} and {other} name two buses; name one")
    if text.startswith("/dev/") or "://" in text or _COM_PORT.fullmatch(text):
        arguments.serial = text
    else:
        arguments.channel = text


def served_address(channel: str) -> str | None:
    """Return the address of a channel that is served on this machine, by its name or address; None of any other."""
    from aces_bus.hardware.served.address import ServedAddress
    from aces_bus.hardware.served.stream import served_channels

    return channel if ServedAddress.is_served(channel) else served_channels().get(channel)


def buses_here() -> list[str]:
    """Return the names of this machine's CAN buses: those that are served, then network interfaces that are called so."""
    from aces_bus.hardware.served.stream import served_channels

    return [*served_channels(), *sorted(map(os.path.basename, glob("/sys/class/net/*can*")))]


def near_buses(channel: str) -> str:
    """Return what buses there are on this machine, the one that may have been meant first; for messages about one that
    is not.
    """
    from difflib import get_close_matches

    from aces_bus.hardware.served.stream import served_channels

    near = get_close_matches(channel, buses_here(), n=1)
    return f"served: {first_names(served_channels())}" + (f"; did you mean {near[0]}?" if near else "")


def _named(channel: str) -> Mapping[str, PlainValue]:
    """Return python-can's keywords of a channel that is named without an interface; raise `CallerError` if
    there is none.
    """
    address = served_address(channel)
    if address is not None:
        return {"interface": "aces", "channel": address, "name": channel}
    if os.path.exists(f"/sys/class/net/{os.path.basename(channel)}"):
        return {"interface": "socketcan", "channel": channel}
    raise CallerError(
        f"{channel!r} is not a network interface of this machine, and not served ({near_buses(channel)});"
        f" {HELP}, or serve one: aces bus serve {channel}"
    )


def _check_link(kind: Kind, variants: Iterable[Variant]) -> None:
    for variant in variants:
        if (variant.link == "can") != (kind == "can"):
            if kind == "can":
                raise CallerError(
                    f"{variant.name} is not spoken on CAN but on a {variant.link} link; name one: --serial URL or --udp"
                    " [HOST:]PORT"
                )
            raise CallerError(f"{variant.name} is spoken on CAN; name a CAN bus: -i INTERFACE -c CHANNEL")


def _can(arguments: argparse.Namespace) -> ChosenBus:
    from can import CanError
    from can.util import load_config

    options: dict[str, Any] = {}
    for name in CAN_OPTIONS:
        if name in arguments:
            value = getattr(arguments, name)
            options.update(value if name == "bus_kwargs" else {name: value})
    try:
        whole: Mapping[str, Any] = load_config(config=dict(options))
    except (CanError, ValueError, OSError) as error:
        if "interface" in options:
            raise CallerError(f"the bus is not understood: {' '.join(str(error).split())}") from error
        if options.get("channel") is None:
            raise CallerError(f"no bus is named; {HELP}") from None
        options.update(_named(str(options["channel"])))
        whole = options
    interface, channel = whole.get("interface"), whole.get("channel")
    options["interface"] = interface
    if channel is not None:
        options["channel"] = channel
    # What the user typed names the bus everywhere: `--filter`, `-p can0=…` and recordings go by it.
    return ChosenBus("can", str(options.get("name") or channel or interface), options)


def _serial(arguments: argparse.Namespace, variants: Sequence[Variant]) -> ChosenBus:
    baud: int | None = arguments.baud
    if baud is None:
        speeds = {variant.protocol.baud for variant in variants if variant.protocol.baud is not None}
        baud = speeds.pop() if len(speeds) == 1 else BAUD
    options = {"url": arguments.serial, "baud": baud, "half_duplex": bool(arguments.half_duplex)}
    return ChosenBus("serial", arguments.serial, options)


def _datagrams(text: str) -> ChosenBus:
    host, _, port = text.rpartition(":")
    if not port.isdecimal() or not 0 < int(port) < 65_536:
        raise CallerError(f"--udp {text!r}: write PORT or HOST:PORT, such as 14550 or 0.0.0.0:14550")
    address = (host or LOOPBACK, int(port))
    return ChosenBus("datagram", f"udp {address[0]}:{address[1]}", {"address": address})
