"""A protocol in the form of other tools.

  aces spec export hubo --format dbc -o hubo.dbc       for CAN tools
  aces spec export hubo:D08@hubo2 --format wireshark -o hubo.lua
  aces spec export my_spec.py --format markdown > my_protocol.md
  aces spec export hubo --format c -o hubo.c           hubo.c and hubo.h

What the other format cannot hold is listed on stderr, field by field with the
reason, and in comments of the file. The exit status is still 0 (1 with
--strict).

A DBC has one message an identifier: captured parts (a board's number) become
one message each, opcodes a multiplexer. A dissector goes into Wireshark's
folder of personal Lua plug-ins (Help, About Wireshark, Folders), or
'tshark -X lua_script:hubo.lua'; CAN frames it knows by their identifiers,
streams by port, by 'Decode as', or by the link type USER0. C is C99 with a
struct, pack and unpack for each message, without allocation.

A Python file is executed with your rights: name only what you trust.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence

from aces_bus.errors import CallerError, UnknownNameError
from aces_bus.protocol import Variant
from aces_bus.protocol.exchange import print_dbc
from aces_bus.protocol.exchange.problems import Loss
from aces_tools.console import check_suffix, print_json, say, say_note, write_text
from aces_tools.options import (
    DIRECTION,
    JSON,
    MESSAGE,
    OUTPUT,
    STRICT,
    Arguments,
    Group,
    argument,
    at_least,
)
from aces_tools.protocols_arg import named_protocol

from .export_c import print_c_source
from .export_markdown import print_markdown
from .export_wireshark import Way, print_dissector

SUMMARY = "write a DBC, a Wireshark dissector, C source, a page"

ARGUMENTS: Arguments = (
    argument(
        "protocol",
        metavar="NAME|FILE",
        help="as -p of 'aces decode': NAME, NAME:DIALECT@CONFIGURATION, my_spec.py, car.dbc",
    ),
    argument(
        "--format", required=True, choices=["c", "dbc", "markdown", "wireshark"], help="what is written"
    ),
    OUTPUT,
    JSON.but(help="text and losses as one JSON object on standard output"),
    STRICT.but(help="exit 1 when the format cannot hold all of the spec"),
    Group(
        "dbc, c",
        (
            MESSAGE,
            argument(
                "--expand",
                type=at_least(0),
                default=256,
                metavar="N",
                help="dbc: make messages of at most this many identifiers of one (default: %(default)s)",
            ),
        ),
    ),
    Group(
        "wireshark, for streams",
        (
            argument(
                "--port", type=at_least(0), default=0, metavar="N", help="TCP and UDP port of a serial server"
            ),
            DIRECTION.but(
                help="which way the bytes go (default: what comes from the port is from the device)"
            ),
        ),
    ),
)


def run(arguments: argparse.Namespace) -> int:
    check_suffix("-o", arguments.output, *_SUFFIXES[arguments.format])
    variant = named_protocol(arguments.protocol).variant()
    for name in arguments.message:
        if name not in variant.messages:
            raise UnknownNameError(f"message of {variant.label}", name, variant.messages)
    if arguments.message and arguments.format not in ("dbc", "c"):
        raise CallerError(f"-m is for --format dbc and c; --format {arguments.format} has all messages")
    losses: Sequence[Loss] = ()
    header: str | None = None
    if arguments.format == "c":
        text, header, losses = _c(variant, arguments)
    elif arguments.format == "markdown":
        text = print_markdown(variant)
    elif arguments.format == "dbc":
        text, losses = print_dbc(variant, only=arguments.message, expand=arguments.expand)
    else:
        text, losses = _dissector(variant, arguments)
    output: str | None = arguments.output
    if output is not None:
        _write(output, text, is_dbc=arguments.format == "dbc")
        if header is not None:
            _write(_header_of(output), header, is_dbc=False)
    if arguments.json:
        about = {
            "protocol": variant.label,
            "format": arguments.format,
            "output": output,
            "text": text if output is None else None,
            **({"header": header if output is None else None} if arguments.format == "c" else {}),
            "losses": [{"message": x.message, "field": x.field, "reason": x.reason} for x in losses],
        }
        print_json(about)
    elif output is None:
        sys.stdout.write(text)
    if not arguments.json:
        _report_losses(variant, losses, arguments.format)
    return 1 if arguments.strict and losses else 0


def _report_losses(variant: Variant, losses: Sequence[Loss], form: str) -> None:
    for loss in losses:
        say(f"{variant.name}: {loss}" if not loss.message else f"{variant.name}.{loss}", who="")
    if losses:
        things = "1 thing" if len(losses) == 1 else f"{len(losses)} things"
        say(
            f"{variant.label}: {things} that {_FORMS[form]} cannot say as the spec does (above, and as comments)"
        )


_SUFFIXES = {
    "c": (".c",),
    "dbc": (".dbc",),
    "wireshark": (".lua",),
    "markdown": (".md", ".markdown", ".txt"),
}
_FORMS = {"c": "the C source", "dbc": "a DBC", "wireshark": "the dissector", "markdown": "a page"}


def _header_of(path: str) -> str:
    """Return the header beside a source file."""
    return f"{os.path.splitext(path)[0]}.h"


def _c(variant: Variant, arguments: argparse.Namespace) -> tuple[str, str, list[Loss]]:
    output: str | None = arguments.output
    if output in (None, "-") and not arguments.json:
        raise CallerError("--format c is two files, a source and its header; name the source: -o FILE.c")
    name = os.path.splitext(os.path.basename(output))[0] if output is not None else ""
    made = print_c_source(variant, only=arguments.message, name=name)
    if not made.messages:
        first = f"; first: {made.losses[0]}" if made.losses else ""
        raise CallerError(f"{variant.label}: none of its messages can be said in C{first}")
    return made.source, made.header, made.losses


def _write(path: str, text: str, *, is_dbc: bool) -> None:
    # Other tools read a DBC as Windows-1252, which has what units need.
    encoding = "utf-8"
    if is_dbc:
        try:
            text.encode("cp1252")
            encoding = "cp1252"
        except UnicodeEncodeError:
            say_note(f"{path}: written as UTF-8, as it has characters beyond Windows-1252")
    write_text(path, text, encoding=encoding)


def _dissector(variant: Variant, arguments: argparse.Namespace) -> tuple[str, list[Loss]]:
    direction: Way = arguments.direction or "by port"
    if variant.link == "can" and (arguments.port or arguments.direction):
        raise CallerError(
            "--port and --direction are for streams; CAN frames are recognised by their identifiers"
        )
    if arguments.port > 65535:
        raise CallerError(f"--port {arguments.port}: ports are 1…65535")
    return print_dissector(variant, direction=direction, port=arguments.port)
