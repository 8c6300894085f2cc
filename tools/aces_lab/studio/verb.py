"""Look at a recording or a bus in the browser, and draw a protocol of it.

  aces studio walk.log -p hubo          traffic and bits of a recording
  aces studio can0 -p car.dbc           of a bus, live; nothing is sent
  aces studio drive.log -o car.py       draw fields over bits: the spec is saved
                                        in car.py, checked, and diffed
  aces studio walk.log --port 8123 --no-browser
                                        print the page's address alone

The page is served to this machine alone, and needs no network. Its address
has a token, which the browser exchanges for a cookie: give it to nobody.
The page reads and writes only what the command line names. Every view shows
the command line that gives the same.

Ctrl-C ends it.
"""

from __future__ import annotations

import argparse
import os
import webbrowser

from aces_bus.errors import CallerError
from aces_tools.bus_arg import chosen_end
from aces_tools.console import check_not_read, check_suffix, say
from aces_tools.options import DIRECTION, OUTPUT, PROTOCOL, Arguments, argument, at_least, flag
from aces_tools.protocols_arg import parse_protocols

SUMMARY = "look at a bus and draw a protocol, in the browser"

ARGUMENTS: Arguments = (
    argument(
        "items",
        nargs="+",
        metavar="RECORDING|BUS",
        help="recordings of one bus or line, or a bus: can0, unix:can0, /dev/ttyUSB0@57600, udp:14550",
    ),
    PROTOCOL,
    DIRECTION,
    OUTPUT.but(metavar="draft.py", help="the spec that is drawn: begun, or read if it is there already"),
    argument("--port", type=at_least(0), default=0, metavar="N", help="default: one that is free"),
    flag("--no-browser", help="print the address, and open no browser"),
)


def run(arguments: argparse.Namespace) -> int:
    from .capture import Capture
    from .draft import Draft
    from .feeding import Feeder, of_bus, of_recordings
    from .server import Server, Studio, bound_socket, require_nicegui

    require_nicegui()
    check_suffix("-o", arguments.output, ".py")
    variants = parse_protocols(arguments.protocol)
    names: list[str] = arguments.items
    missing = [name for name in names if not os.path.isfile(name)]
    if missing and len(names) > 1:
        raise CallerError(f"{missing[0]}: no such file; name recordings, or one bus")
    bus = chosen_end(names[0], variants) if missing else None
    if bus is not None and bus.kind != "can" and not variants:
        raise CallerError(f"{bus.name}: bytes without a protocol have no packets; name one: -p NAME")
    gate = None if bus is None else bus.gate(listen_only=True)
    studio = Studio(
        Capture(is_live=bus is not None),
        variants,
        recordings=names if bus is None else (),
        protocols=arguments.protocol,
        bus="" if bus is None else names[0],
    )
    if arguments.output is not None:
        check_not_read(arguments.output, names)
        studio.draft = Draft(arguments.output, studio.recordings)
    listener = bound_socket(arguments.port)
    with listener:
        server = Server(studio, listener)
        if bus is None:
            fill = of_recordings(names, variants, arguments.direction)
        else:
            fill = of_bus(bus, variants, gate)
            assert gate is not None
            bus.start(gate)
        feeder = Feeder(studio.capture, fill)
        feeder.start()
        try:
            say(f"studio: {server.url}")
            if not arguments.no_browser:
                webbrowser.open(server.url)
            server.run()
        finally:
            feeder.stop()
            if gate is not None:
                gate.stop()
    return 0
