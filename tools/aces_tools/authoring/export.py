"""A protocol in the form of other tools.

  aces spec export hubo --to dbc -o hubo.dbc       for CAN tools
  aces spec export hubo:D08@hubo2 --to wireshark -o hubo.lua
  aces spec export my_spec.py --to markdown > my_protocol.md

What the other form cannot say is said on stderr, field by field with the
reason, and stands as comments in the file; the exit status is 0 all the same
(1 with --strict).

A DBC has one message an identifier: captured parts (a board's number) become
one message each, opcodes a multiplexer. A dissector goes into Wireshark's
folder of personal Lua plug-ins (Help, About Wireshark, Folders), or
'tshark -X lua_script:hubo.lua'; CAN frames it knows by their identifiers,
streams by port, by 'Decode as', or by the link type USER0.

A Python file is executed with your rights: name only what you trust.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Sequence

from aces_bus.errors import CallerError, UnknownNameError
from aces_bus.protocol import Variant
from aces_bus.protocol.exchange import Loss

from ..console import check_suffix, say
from ..protocols_arg import named_protocol


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "protocol",
        metavar="NAME|FILE",
        help="as -p takes it: NAME, NAME:DIALECT@CONFIGURATION, my_spec.py, car.dbc",
    )
    parser.add_argument("--to", required=True, choices=sorted(PRINTERS), help="the form")
    parser.add_argument("-o", "--output", metavar="FILE", help="write there instead of on stdout")
    parser.add_argument("--json", action="store_true", help="text and losses as one JSON object on stdout")
    parser.add_argument("--strict", action="store_true", help="exit 1 when anything could not be said")
    dbc = parser.add_argument_group("dbc")
    dbc.add_argument(
        "-m",
        "--message",
        action="append",
        default=[],
        metavar="NAME",
        help="only this message; may be repeated",
    )
    dbc.add_argument(
        "--expand",
        type=_number,
        default=256,
        metavar="N",
        help="at most so many identifiers of a message become messages (default: %(default)s)",
    )
    wireshark = parser.add_argument_group("wireshark, for streams")
    wireshark.add_argument(
        "--port", type=_number, default=0, metavar="N", help="the TCP and UDP port of a serial server"
    )
    wireshark.add_argument(
        "--direction",
        choices=("to", "from", "both"),
        help="who speaks (default: what comes from the port is from the device)",
    )


def run(arguments: argparse.Namespace) -> int:
    check_suffix("-o", arguments.output, *_SUFFIXES[arguments.to])
    variant = named_protocol(arguments.protocol).variant()
    for name in arguments.message:
        if name not in variant.messages:
            raise UnknownNameError(f"message of {variant.label}", name, variant.messages)
    if arguments.message and arguments.to != "dbc":
        raise CallerError(f"-m is for --to dbc; --to {arguments.to} has all messages")
    text, losses = PRINTERS[arguments.to](variant, arguments)
    output: str | None = arguments.output
    if output is not None:
        _write(output, text, is_dbc=arguments.to == "dbc")
    if arguments.json:
        about = {
            "protocol": variant.label,
            "to": arguments.to,
            "output": output,
            "text": text if output is None else None,
            "losses": [{"message": x.message, "field": x.field, "reason": x.reason} for x in losses],
        }
        print(json.dumps(about, ensure_ascii=False, indent=2))
    elif output is None:
        sys.stdout.write(text)
    if not arguments.json:
        _tell(variant, losses, arguments.to)
    return 1 if arguments.strict and losses else 0


def _tell(variant: Variant, losses: Sequence[Loss], form: str) -> None:
    for loss in losses:
        say(f"{variant.name}: {loss}" if not loss.message else f"{variant.name}.{loss}", who="")
    if losses:
        things = "1 thing" if len(losses) == 1 else f"{len(losses)} things"
        say(
            f"{variant.label}: {things} that {_FORMS[form]} cannot say as the spec does (above, and as comments)"
        )


_SUFFIXES = {"dbc": (".dbc",), "wireshark": (".lua",), "markdown": (".md", ".markdown", ".txt")}
_FORMS = {"dbc": "a DBC", "wireshark": "the dissector", "markdown": "a page"}


def _write(path: str, text: str, *, is_dbc: bool) -> None:
    # Other tools read a DBC as Windows-1252, which has what units need.
    encoding = "utf-8"
    if is_dbc:
        try:
            text.encode("cp1252")
            encoding = "cp1252"
        except UnicodeEncodeError:
            say(f"{path}: written as UTF-8, as it has characters beyond Windows-1252")
    try:
        with open(path, "w", encoding=encoding, newline="\n") as file:
            file.write(text)
    except OSError as error:
        raise CallerError(f"{path}: cannot be written: {error.strerror or error}") from error
    say(f"wrote {path}")


def _number(text: str) -> int:
    if not text.isdecimal() or len(text) > 6:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number in 0…999999")
    return int(text)


# ---------------------------------------------------------------------- forms


def _dbc(variant: Variant, arguments: argparse.Namespace) -> tuple[str, list[Loss]]:
    from aces_bus.protocol.exchange.export_dbc import print_dbc

    return print_dbc(variant, only=arguments.message, expand=arguments.expand)


def _wireshark(variant: Variant, arguments: argparse.Namespace) -> tuple[str, list[Loss]]:
    from aces_bus.protocol.exchange.export_wireshark import Way, print_dissector

    ways: dict[str, Way] = {"to": "to device", "from": "from device", "both": "both"}
    direction: Way = ways.get(arguments.direction or "", "by port")
    if variant.link == "can" and (arguments.port or arguments.direction):
        raise CallerError("--port and --direction are for streams; CAN frames are told by their identifiers")
    if arguments.port > 65535:
        raise CallerError(f"--port {arguments.port}: ports are 1…65535")
    return print_dissector(variant, direction=direction, port=arguments.port)


def _markdown(variant: Variant, arguments: argparse.Namespace) -> tuple[str, list[Loss]]:
    from aces_bus.protocol.exchange.export_markdown import print_markdown

    return print_markdown(variant), []


PRINTERS: dict[str, Callable[[Variant, argparse.Namespace], tuple[str, list[Loss]]]] = {
    "dbc": _dbc,
    "wireshark": _wireshark,
    "markdown": _markdown,
}
