"""Begin a protocol: a commented spec, a test and a README that pass at once.

  aces spec new gripper --link can          gripper/gripper.py, its test and
                                            its README.md
  aces spec new imu --link serial -o specs  the same in specs/
  cd gripper && pytest                      passes; now put in your device

The spec has two or three messages of an invented sensor, which show the
essentials of the language; docs/language.md has the rest of it. Nothing that
is there already is overwritten.
"""

from __future__ import annotations

import argparse
import keyword
import sys
from importlib.resources import files
from pathlib import Path
from string import Template

from aces_bus.errors import CallerError
from aces_bus.protocol.exchange.names import PythonNames

from ..console import print_json, say_note
from ..options import JSON, OUTPUT, Arguments, argument

LINKS = ("can", "serial", "datagram")
#: What the skeletons call something of their own; packages that a spec's own module must not hide.
# fmt: off
TAKEN = frozenset((
    "Array", "BitLayout", "Byte", "IdField", "Crc", "Enumeration", "Flags", "Frame", "Int16sl", "Int16ul", "Measurement",
    "Node", "Protocol", "Quantity", "Rate", "SAMPLE", "Sample", "SetRate", "State", "StreamScanner", "Struct", "Tare",
    "annotations", "bits", "command", "law_tests", "make_scanner", "packet", "record", "scanner", "this",
))
PACKAGES = frozenset((
    "aces_bus", "aces_devices", "aces_protocols", "aces_tools", "can", "canopen", "construct", "numpy", "pytest", "serial",
))
# fmt: on


SUMMARY = "begin a protocol: a commented spec, a test, a README"

ARGUMENTS: Arguments = (
    argument("name", metavar="NAME", help="the protocol's name: a plain word, such as gripper"),
    argument("--link", required=True, choices=LINKS, help="what carries its frames, packets or datagrams"),
    OUTPUT.but(metavar="DIR", help="the folder (default: ./NAME)"),
    JSON.but(help="the files that were written, as one JSON object"),
)


def run(arguments: argparse.Namespace) -> int:
    name: str = arguments.name
    _check(name)
    folder = Path(arguments.output if arguments.output is not None else name)
    made = {
        folder / file: Template(_skeleton(skeleton)).substitute(name=name)
        for file, skeleton in (
            (f"{name}.py", f"{arguments.link}.py.txt"),
            (f"test_{name}.py", f"{arguments.link}.test.txt"),
            ("README.md", "readme.txt"),
        )
    }
    for path in made:
        if path.exists() or path.is_symlink():
            raise CallerError(
                f"{path}: is there already, and nothing is overwritten; choose another NAME or -o DIR"
            )
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for path, text in made.items():
            with path.open("x", encoding="utf-8", newline="\n") as file:
                file.write(text)
    except OSError as error:
        where = error.filename or folder
        raise CallerError(f"{where}: cannot be written: {error.strerror or error}") from error
    if arguments.json:
        print_json({"name": name, "link": arguments.link, "files": [str(path) for path in made]})
        return 0
    for path in made:
        say_note(f"wrote {path}")
    say_note(f"next: cd {folder} && pytest; then put your device into {name}.py")
    return 0


def _check(name: str) -> None:
    """Raise `CallerError` for what cannot be the name of a module and of a protocol."""
    wrong = ""
    if not (name.isascii() and name.isidentifier()) or name.startswith("_"):
        wrong = "a plain name has ASCII letters, digits and underscores, and begins with a letter"
    elif name != name.lower():
        wrong = f"names of protocols are in lower case: {name.lower()}"
    elif (
        keyword.iskeyword(name)
        or keyword.issoftkeyword(name)
        or name in PythonNames.TAKEN_BY_CODE
        or name in TAKEN
    ):
        wrong = "that is a word of Python or of the spec itself"
    elif name in sys.stdlib_module_names or name in PACKAGES:
        wrong = "a module of that name would hide one that Python needs"
    elif len(name) > 40:
        wrong = "at most 40 characters"
    if wrong:
        raise CallerError(f"{name!r} cannot be the name of a protocol: {wrong}")


def _skeleton(name: str) -> str:
    return (files(__name__.rpartition(".")[0]) / "skeletons" / name).read_text(encoding="utf-8")
