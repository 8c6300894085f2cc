"""Find the devices on a bus, and write a robot's file of them.

  aces discover -p hubo --bus can0 -i socketcan > found.toml
  aces discover -p robotis --bus /dev/ttyUSB0 --baud 1000000
  aces discover -r hubo2plus             are all devices of the robot there?
  aces discover -r hubo2plus --virtual   the same, with simulated devices

Each possible device is asked in turn, by requests that only read: nothing is
set, nothing moves. On a bus in use this adds traffic. The file has what devices
report about themselves; gears, limits and names of joints are for you to add.

  aces discover -p hubo --bus unix:can0 > found.toml
  aces device JMC3 get -r found.toml

'aces scan' is another name of this verb.
"""

from __future__ import annotations

import argparse
import os
from contextlib import ExitStack
from typing import Any

from msgspec.structs import replace

from aces_bus import load_protocol
from aces_bus.device import Driver, Job, Robot, load_driver
from aces_bus.device.config import Bus
from aces_bus.device.drivers import list_drivers
from aces_bus.device.host import Host
from aces_bus.device.station import credential_text
from aces_bus.errors import AcesError, CallerError
from aces_bus.protocol.files import adopt_protocol, python_file

from .console import StatusLine, check_suffix, print_json, say, write_text
from .options import JSON, OUTPUT, PROTOCOL, Arguments
from .patience import Patience
from .robot_arg import (
    ROBOT_OR_TWINS,
    bus_options,
    channel_of,
    check_channels,
    chosen_pose,
    chosen_robot,
    open_host,
    use_driver_files,
)

#: Seconds of the bus's time that a scan may take at most.
LONGEST_S = 600

SUMMARY = "find the devices on a bus, and write a robot's file of them"

EPILOG = """\
exit status: 0; 1 when a device is missing, none was found, or the search of a
bus was not completed; 2 a wrong call, or a bus that cannot be opened
"""


ARGUMENTS: Arguments = (
    PROTOCOL.but(
        action="store",
        default=None,
        metavar="NAME[:DIALECT]|FILE.py",
        help="without a robot: the protocol on the bus; of a Python file with its --driver",
    ),
    OUTPUT.but(metavar="FILE.toml", help="write the robot's file there (default: standard output)"),
    JSON.but(help="what was found, as JSON"),
    ROBOT_OR_TWINS,
)


def run(arguments: argparse.Namespace) -> int:
    check_suffix("--output", arguments.output, ".toml")
    robot = _robot(arguments)
    if arguments.output is not None and arguments.robot_given:
        raise CallerError(
            "--output is for what --protocol finds: the robot that --robot names has a file already"
        )
    scanners = _scanners(robot)
    found: list[Any] = []
    is_whole = True
    with ExitStack() as stack:
        patience = stack.enter_context(Patience())
        for name, host in open_hosts(robot, arguments, stack).items():
            for driver in scanners:
                if driver.protocol in host.variants and not patience.is_over:
                    these = scan_bus(name, host, driver, patience)
                    is_whole = is_whole and these is not None
                    found += these or []
    expected = {(c.bus, tuple(sorted(c.credentials.items()))): c for c in robot.devices.values() if c.active}
    there = {(c.bus, tuple(sorted(c.credentials.items()))) for c in found}
    # After an interrupted search it is not known what is missing.
    missing = [config.name for key, config in expected.items() if key not in there and not patience.is_over]
    if arguments.json:
        listed = [
            {
                "bus": c.bus,
                "driver": c.driver,
                "credentials": c.credentials,
                "channels": c.channels,
                "model": c.model,
                "kind": c.kind,
            }
            for c in found
        ]
        print_json({"found": listed, "missing": missing})
    elif expected:
        for config in found:
            key = (config.bus, tuple(sorted(config.credentials.items())))
            name = expected[key].name if key in expected else "not in the robot's file"
            print(f"{config.bus}: {config.driver} {credential_text(config.credentials)}  {name}")
        for name in missing:
            config = robot.devices[name]
            print(
                f"{config.bus}: {config.driver} {credential_text(config.credentials)}  {name} does not answer"
            )
    elif found:
        _write(robot, found, arguments)
    else:
        options = bus_options(robot, arguments)["bus"]
        say(
            f"no device answers on {options.get('channel')}: is it powered, and is the bit rate or baud right?"
        )
    say(f"found={len(found)} missing={len(missing)}" + (" (interrupted)" if patience.is_over else ""), who="")
    return 1 if missing or not found or not is_whole else 0


def _robot(arguments: argparse.Namespace) -> Robot:
    """Return the robot of the call, or one without devices on the bus that is named."""
    arguments.robot_given = arguments.protocol is None
    if arguments.protocol is None:
        return chosen_robot(arguments.robot, arguments.driver)
    use_driver_files(arguments.driver)
    if arguments.robot:
        raise CallerError("--robot names the protocols; leave --protocol out")
    if arguments.virtual:
        raise CallerError("--virtual needs a robot whose twins are to be found: --robot NAME")
    name, _, dialect = arguments.protocol.partition(":")
    if python_file(arguments.protocol)[0]:
        name, dialect = adopt_protocol(arguments.protocol), ""
    protocol = load_protocol(name)
    protocol.variant(dialect or None)  # raises for one that does not exist
    if not arguments.bus:
        raise CallerError("which bus? --bus can0 -i socketcan, --bus unix:can0, --bus /dev/ttyUSB0")
    if len(arguments.bus) > 1:
        raise CallerError("one bus at a time: a protocol is looked for on one --bus")
    bus = Bus(
        name="bus",
        link=protocol.link,
        protocol=name,
        dialect=dialect or None,
        bitrate=protocol.bitrate if protocol.link == "can" else None,
        baud=arguments.baud or protocol.baud if protocol.link == "serial" else None,
    )
    return Robot(name="found", buses={"bus": bus}, devices={}, joints={}, sensors={})


def open_hosts(
    robot: Robot, arguments: argparse.Namespace, stack: ExitStack, *, is_locked: bool = True
) -> dict[str, Host]:
    """Open a host without devices for each bus; `is_locked` False: beside the program that drives it."""
    from aces_bus.robot.rig import bus_variants

    hosts: dict[str, Host] = {}
    options: dict[str, dict[str, Any]] = {name: {} for name in robot.buses}
    if arguments.virtual:
        from aces_bus.robot import VirtualRobot

        if arguments.bus or arguments.interface:
            raise CallerError("--virtual has no buses; leave --bus and -i away")
        pose = chosen_pose(robot, arguments.pose)
        virtual = VirtualRobot(robot, seed=arguments.seed, pose=pose)
        stack.enter_context(virtual.simulation)
        ports: dict[str, Any] = virtual.ports("scan")
    else:
        from aces_bus.robot.buses import gate_of, lock_of, port_for
        from aces_bus.runtime.loop import Loop

        loop = stack.enter_context(Loop())
        options = bus_options(robot, arguments)
        check_channels(robot, options)
        active = {config.bus for config in robot.devices.values() if config.active}
        used = [name for name in robot.buses if name in active or not active]
        ports = {}
        for name in used:
            bus = robot.buses[name]
            gate = gate_of(bus, load_protocol(bus.protocol), options[name])
            gate.lock = lock_of(bus, options[name]) if is_locked else None
            ports[name] = port_for(gate, bus, loop)
    for name, port in ports.items():
        hosts[name] = Host(port, bus_variants(robot, name), name=name)
        stack.callback(hosts[name].close)
        open_host(name, hosts[name], channel_of(robot, name, options))
    return hosts


def _scanners(robot: Robot) -> list[Driver]:
    """Return the drivers that can find their devices on the robot's buses; one that cannot be loaded is said, and left
    out.
    """
    wanted = {bus.protocol for bus in robot.buses.values()}
    wanted |= {robot.protocol_of(config)[0] for config in robot.devices.values() if config.active}
    found: list[Driver] = []
    for name in list_drivers():
        try:
            driver = load_driver(name)
        except AcesError as error:
            say(f"{error}; its devices are not looked for")
            continue
        if driver.scan is not None and driver.protocol in wanted:
            found.append(driver)
    if not found:
        raise CallerError(
            f"no driver finds devices that speak {', '.join(sorted(wanted))}; `aces devices NAME` says which do"
        )
    return found


def scan_bus(name: str, host: Host, driver: Driver, patience: Patience) -> list[Any] | None:
    """Return what a driver finds on a bus; None: it was interrupted, or failed."""
    scan = driver.scan
    assert scan is not None
    job = Job(host.clock, f"{driver.name} scan", lambda job: scan(host, job))
    status_line = StatusLine()
    end = host.clock.now() + LONGEST_S * 1_000_000_000
    while not job.is_over and host.clock.now() < end and not patience.is_over:
        host.clock.wait(lambda: job.is_over or patience.is_over, 200_000_000)
        status_line.show(f"{name} {driver.name}: {job.progress:4.0%} {job.text}")
    status_line.clear()
    if not job.is_over:
        host.clock.call(job.cancel)
        if not patience.is_over:
            say(f"{name}: {driver.name} is not through after {LONGEST_S} s")
        return None
    if job.error is not None:
        say(f"{name}: {driver.name}: {job.error}")
        return None
    return [replace(config, bus=name) for config in job.result]


def _write(robot: Robot, found: list[Any], arguments: argparse.Namespace) -> None:
    from aces_bus.robot.file import print_robot

    options = bus_options(robot, arguments)
    stated = {k: v for k, v in options["bus"].items() if k in ("channel", "interface")}
    path, name = python_file(arguments.protocol)
    if path:  # as the robot's file finds it, from its folder
        path = os.path.relpath(path, os.path.dirname(arguments.output or ""))
        stated["protocol"] = f"{path}:{name}" if name else path
    bus = replace(robot.buses["bus"], **stated)
    whole = replace(robot, buses={"bus": bus}, devices={config.name: config for config in found})
    write_text(arguments.output, print_robot(whole), is_quiet=True)
