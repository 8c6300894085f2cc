"""Virtual buses, and what is going on on a bus.

  aces bus serve                        can0 at 500 kbit/s, for this user
  aces bus serve can0 can1 -b 1000000 --socketcand
  aces bus serve --faults drop=0.01,corrupt=0.001 --seed 7
  aces bus list                         buses served on this machine, and those
                                        that python-can finds
  aces bus load can0                    frames, load, errors: a line a second
  aces bus load -i socketcan -c can0 -b 500000

Any program with python-can joins: -i aces -c unix:can0, or -i socketcand.
A served bus has bit rate, arbitration, acknowledgement and errors like a real
one; --no-physics has none of them and is the fastest.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import socket
import sys
import threading
import time
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from aces_bus.errors import AcesError, CallerError, UnknownNameError

from .bus_arg import ChosenBus, can_options, chosen_bus
from .console import ENDLESS, counted, print_json, say, say_note
from .options import (
    FOR,
    JSON,
    SEED,
    Arguments,
    Group,
    argument,
    flag,
)
from .patience import Patience

if TYPE_CHECKING:
    from aces_bus.hardware import Faults

#: python-can's backends that `list` does not ask: ours is asked better, and the other is of one process.
_NOT_ASKED = frozenset({"aces", "virtual"})
#: Between two lines of `load`.
INTERVAL_NS = 1_000_000_000
#: socketcand's beacon comes every three seconds.
_BEACON_NS = 3_500_000_000
#: How long `list` looks.
_LOOK_NS = 1_000_000_000
#: Options that belong to some of the actions alone.
_ACTIONS = {
    **dict.fromkeys(
        ("unix", "tcp", "socketcand", "bind_anywhere", "faults", "no_ack", "no_physics"), ("serve",)
    ),
    "once": ("load",),
    "json": ("load", "list"),
}


SUMMARY = "serve virtual buses, list buses, measure the load of a bus"

ARGUMENTS: Arguments = (
    argument(
        "what",
        choices=["serve", "load", "list"],
        metavar="{serve,load,list}",
        help="what to do",
    ),
    argument(
        "channels",
        nargs="*",
        metavar="CHANNEL",
        help="names (default: can0); load: one, or an address",
    ),
    can_options("bit rates of a bus; which bus to measure (python-can's)"),
    Group(
        "serve",
        (
            argument(
                "--unix",
                metavar="PATH",
                help="the socket; of several channels, its folder (default: this user's runtime folder, unless --tcp)",
            ),
            argument("--tcp", metavar="HOST:PORT", help="serve on TCP too, for programs of this machine"),
            argument(
                "--socketcand",
                nargs="?",
                const="",
                metavar="HOST:PORT",
                help="speak the socketcand protocol too (default: 127.0.0.1:29536)",
            ),
            flag("--bind-anywhere", help="let other machines in; anyone who connects may send"),
            argument(
                "--faults",
                metavar="WHAT=CHANCE,…",
                help="drop, corrupt, duplicate, delay: chances from 0 to 1; delay_us: the longest delay",
            ),
            SEED.but(help="of the faults (default: 0)"),
            flag("--no-ack", help="acknowledge nothing: a sender with only listeners gets errors"),
            flag("--no-physics", help="no bit rate, no arbitration, no errors"),
        ),
    ),
    Group(
        "load, list",
        (
            flag("--once", help="load: one second, and every node; then end"),
            JSON.but(help="one JSON object a line"),
        ),
    ),
    FOR.but(
        help="load, serve: end after this time; list: how long to look (default: 1s; from 3.5s on for socketcand's"
        " beacons too)"
    ),
)
#: What `chosen_bus` also asks for.
DEFAULTS: dict[str, Any] = {"serial": None, "udp": None, "baud": None, "half_duplex": False}


def run(arguments: argparse.Namespace) -> int:
    for option, actions in _ACTIONS.items():
        if getattr(arguments, option) not in (None, False) and arguments.what not in actions:
            raise CallerError(f"--{option.replace('_', '-')} belongs to 'aces bus {actions[0]}'")
    if arguments.what == "list" and arguments.channels:
        raise CallerError("'aces bus list' lists all buses; leave the names away")
    if arguments.what == "serve":
        return _serve(arguments)
    if arguments.what == "list":
        return _list(arguments)
    return _load(arguments)


# ---------------------------------------------------------------------- serve


def _serve(arguments: argparse.Namespace) -> int:
    from aces_bus.hardware.served.address import PORT, SOCKETCAND_PORT, ServedAddress
    from aces_bus.hardware.served.channel import ServedChannel
    from aces_bus.hardware.served.server import BusServer

    for option in ("interface", "channel", "timing", "bus_kwargs"):
        if option in arguments:
            raise CallerError(
                f"--{option.replace('_', '-')} names a bus to look at; serve makes one: aces bus serve NAME"
            )
    if arguments.tcp is None and not hasattr(socket, "AF_UNIX"):
        arguments.tcp = "127.0.0.1:0"
    names = list(dict.fromkeys(arguments.channels or ["can0"]))
    channels = [
        ServedChannel(
            name,
            bitrate=getattr(arguments, "bitrate", 500_000),
            data_bitrate=getattr(arguments, "data_bitrate", None),
            fd=getattr(arguments, "fd", False),
            faults=parse_faults(arguments.faults, arguments.seed),
            physics=not arguments.no_physics,
            acknowledge=not arguments.no_ack,
        )
        for name in names
    ]
    unix = arguments.unix if arguments.unix is not None else "" if arguments.tcp is None else None
    tcp = None if arguments.tcp is None else ServedAddress.parse_host(arguments.tcp, PORT)
    socketcand = (
        None
        if arguments.socketcand is None
        else ServedAddress.parse_host(arguments.socketcand, SOCKETCAND_PORT)
    )
    server = BusServer(
        channels, unix=unix, tcp=tcp, socketcand=socketcand, bind_anywhere=arguments.bind_anywhere, said=say
    )
    before = {
        number: signal.signal(number, lambda *_: server.stop()) for number in (signal.SIGINT, signal.SIGTERM)
    }
    timer: threading.Timer | None = None
    try:
        for name in names:
            for address in server.addresses[name]:
                print(f"{name}  -i aces -c {address}")
        if server.socketcand:
            host, _, port = server.socketcand.rpartition(":")
            for name in names:
                print(f"{name}  -i socketcand -c {name} --bus-kwargs host={host.strip('[]')} port={port}")
        if sys.stdout is not None:
            sys.stdout.flush()
        if arguments.duration is None:
            say_note(ENDLESS)
        else:
            timer = threading.Timer(arguments.duration / 1e9, server.stop)
            timer.daemon = True
            timer.start()
        server.serve()
    finally:
        if timer is not None:
            timer.cancel()
        server.close()
        for number, handler in before.items():
            signal.signal(number, handler)
    for channel in server.status()["channels"]:
        say(_summary(channel))
    return 0


def _summary(channel: dict[str, Any]) -> str:
    text = f"{channel['channel']}: {channel['frames']:,} frames"
    if channel["physics"]:
        text += f", {channel['errors']:,} errors, load {_ratio(channel):.1%}"
    return text


def _ratio(channel: dict[str, Any]) -> float:
    duration = channel["now_ns"] - channel["since_ns"]
    return channel["busy_ns"] / duration if duration > 0 else 0.0


def parse_faults(text: str | None, seed: int) -> Faults:
    """`drop=0.01,delay=0.1,delay_us=500` as faults."""
    from aces_bus.hardware import Faults

    chances: dict[str, float] = {}
    for part in (text or "").split(","):
        if not part.strip():
            continue
        name, _, number = (word.strip() for word in part.partition("="))
        if name not in ("drop", "corrupt", "duplicate", "delay", "delay_us"):
            raise UnknownNameError("fault", name, ["drop", "corrupt", "duplicate", "delay", "delay_us"])
        try:
            chances[name] = float(number)
        except ValueError:
            raise CallerError(f"--faults {part.strip()!r}: write {name}=0.01") from None
    delay_us = chances.pop("delay_us", 1000.0)
    if not 0.001 <= delay_us <= 1e9:
        raise CallerError(f"--faults delay_us={delay_us:g}: from 0.001 to 1,000,000,000 µs")
    return Faults(seed=seed, delay_ns=round(delay_us * 1000), **chances)


# ---------------------------------------------------------------------- list


def _list(arguments: argparse.Namespace) -> int:
    import logging

    import can

    from aces_bus.hardware.served.stream import servers

    found = [
        channel | {"socketcand": status.get("socketcand", "")}
        for status in servers()
        for channel in status["channels"]
    ]
    duration: int = _LOOK_NS if arguments.duration is None else arguments.duration
    asked = sorted(can.VALID_INTERFACES - _NOT_ASKED - ({"socketcand"} if duration < _BEACON_NS else set()))
    log = logging.getLogger("can")
    before = log.level
    log.setLevel(logging.CRITICAL)  # what backends say about drivers that are not there
    try:
        configs = can.detect_available_configs(asked, timeout=duration / 1e9)
    finally:
        log.setLevel(before)
    if arguments.json:
        for channel in found:
            print_json({"kind": "served", **channel}, None)
        for config in configs:
            print(json.dumps({"kind": "detected", **config}, default=str))
        return 0
    for channel in found:
        print(_described(channel))
    for config in configs:
        rest = " ".join(
            f"{name}={value}" for name, value in config.items() if name not in ("interface", "channel")
        )
        print(f"-i {config['interface']} -c {config['channel']}" + (f"  {rest}" if rest else ""))
    if not found and not configs:
        say_note("no bus is served and none is detected; serve one: aces bus serve")
    return 0


def _described(channel: dict[str, Any]) -> str:
    rates = f"{channel['bitrate']:,} bit/s" if channel["physics"] else "no physics"
    if channel["physics"] and channel["data_bitrate"]:
        rates += f", data {channel['data_bitrate']:,}"
    nodes = len(channel["members"])
    lines = [f"{channel['channel']}  served: {rates}, {counted(nodes, 'node')}, {channel['frames']:,} frames"]
    lines += [f"  -i aces -c {address}" for address in channel["addresses"]]
    if channel["socketcand"]:
        lines.append(f"  socketcand {channel['socketcand']}")
    return "\n".join(lines)


# ---------------------------------------------------------------------- load


def _load(arguments: argparse.Namespace) -> int:
    if len(arguments.channels) > 1:
        raise CallerError("load looks at one bus; name one channel")
    if arguments.once and arguments.duration is not None:
        raise CallerError("--once measures one second; leave --for away")
    text = arguments.channels[0] if arguments.channels else getattr(arguments, "channel", None)
    address = _served_address(text, getattr(arguments, "interface", None))
    if address is not None:
        measures = _served_load(address, arguments.duration)
    else:
        if arguments.channels:
            arguments.channel = text
        bitrate = getattr(arguments, "bitrate", None)
        if bitrate is None:
            raise CallerError("a load needs the bit rate of the bus: -b 500000")
        data_bitrate = getattr(arguments, "data_bitrate", None)
        measures = _received_load(chosen_bus(arguments), bitrate, data_bitrate, arguments.duration)
    if not arguments.once and arguments.duration is None:
        say_note(f"{ENDLESS}; --once measures one second")
    with Patience() as patience:
        for measure in patience.each(measures):
            if arguments.json:
                print_json(measure, None)
            else:
                print(_line(measure), flush=True)
                if arguments.once:
                    for node in measure["nodes"]:
                        print("  " + _node(node))
            if arguments.once:
                break
    return 0


def _served_address(text: str | None, interface: str | None) -> str | None:
    """Return the address of a served bus, when that is what is meant."""
    from aces_bus.hardware.served.address import ServedAddress
    from aces_bus.hardware.served.stream import served_channels

    if interface not in (None, "aces"):
        return None
    if ServedAddress.is_served(text):
        return text
    known = served_channels()
    if text is None and len(known) == 1:
        return str(*known.values())
    if text in known:
        return str(known[text])
    if interface == "aces" or (text is None and known) or (text and not _is_network(text) and known):
        raise UnknownNameError("served channel", str(text), known)
    return None


def _is_network(name: str) -> bool:
    return os.path.exists(f"/sys/class/net/{os.path.basename(name)}")


def _served_load(text: str, seconds_ns: int | None) -> Iterator[dict[str, Any]]:
    """Yield a measure a second, as the server knows it."""
    from aces_bus.hardware.served.address import ServedAddress
    from aces_bus.hardware.served.stream import ask

    address = ServedAddress.parse(text)

    def look() -> dict[str, Any]:
        try:
            status = ask(address)
        except OSError as error:
            raise CallerError(
                f"{text}: no server answers ({error.strerror or error}); see: aces bus list"
            ) from error
        except AcesError as error:
            raise CallerError(f"{text}: {error}") from error
        for channel in status["channels"]:
            if (
                channel["channel"] == address.channel
                or text in channel["addresses"]
                or len(status["channels"]) == 1
            ):
                return dict(channel)
        raise CallerError(
            f"{text}: say which channel: {', '.join(channel['channel'] for channel in status['channels'])}"
        )

    before = look()
    for _ in _seconds(seconds_ns):
        now = look()
        duration = max(1, now["now_ns"] - before["now_ns"]) / 1e9
        yield {
            "channel": now["channel"],
            "time": time.time(),
            "load": (now["busy_ns"] - before["busy_ns"]) / 1e9 / duration if now["physics"] else None,
            "frames_per_s": (now["frames"] - before["frames"]) / duration,
            "errors_per_s": (now["errors"] - before["errors"]) / duration,
            "nodes": now["members"],
        }
        before = now


def _received_load(
    bus: ChosenBus, bitrate: int, data_bitrate: int | None, seconds_ns: int | None
) -> Iterator[dict[str, Any]]:
    """Yield a measure a second from what a listening node receives, which is without retransmissions and errors."""
    from aces_bus.hardware.simulated.frame_time import INTERMISSION, frame_bits

    pause = INTERMISSION * 1_000_000_000 // bitrate
    gate: Any = bus.gate(listen_only=True)
    bus.start(gate)
    try:
        inbox = gate.subscribe()
        start = time.monotonic_ns()
        for _ in _seconds(seconds_ns):
            busy = frames = errors = 0
            for item in inbox.get(0):
                if item.content.is_error_frame:
                    errors += 1
                else:
                    frames += 1
                busy += frame_bits(item.content).duration_ns(bitrate, data_bitrate) + pause
            now = time.monotonic_ns()
            duration = max(1, now - start) / 1e9
            start = now
            yield {
                "channel": bus.name,
                "time": time.time(),
                "load": busy / 1e9 / duration,
                "frames_per_s": frames / duration,
                "errors_per_s": errors / duration,
                "nodes": [],
                "lost": inbox.dropped,
                "state": gate.state,
            }
    finally:
        gate.stop()


def _seconds(duration: int | None) -> Iterator[int]:
    """Yield a number after each interval, on absolute deadlines; with a duration (ns) the last interval ends with it."""
    from aces_bus.runtime import RealClock

    clock = RealClock()
    due = clock.now()
    end = None if duration is None else due + duration
    number = 0
    while end is None or due < end:
        due = due + INTERVAL_NS if end is None else min(due + INTERVAL_NS, end)
        clock.sleep_until(due)
        number += 1
        yield number


def _line(measure: dict[str, Any]) -> str:
    load = "load    –  " if measure["load"] is None else f"load {measure['load'] * 100:5.1f} %"
    stamp = time.strftime("%H:%M:%S", time.localtime(measure["time"]))
    text = f"{stamp}  {measure['channel']}  {load}  {measure['frames_per_s']:8,.0f} frames/s"
    text += f"  {measure['errors_per_s']:6,.0f} errors/s"
    if measure["nodes"]:
        text += f"  {counted(len(measure['nodes']), 'node')}"
        bad = [
            f"{node['name']} {node['state']}" for node in measure["nodes"] if node["state"] != "error-active"
        ]
        text += f": {', '.join(bad)}" if bad else ""
    if measure.get("lost"):
        text += f"  {measure['lost']:,} frames lost"
    if measure.get("state", "open") != "open":
        text += f"  bus {measure['state']}"
    return text


def _node(node: dict[str, Any]) -> str:
    text = f"{node['name']}: {node['state']}, errors {node['transmit_errors']} sending, {node['receive_errors']} receiving;"
    text += f" {node['sent']:,} sent, {node['received']:,} received"
    for name in ("waiting", "dropped", "rejected"):
        if node[name]:
            text += f", {node[name]:,} {name}"
    return text + (", only listens" if node["listen_only"] else "")
