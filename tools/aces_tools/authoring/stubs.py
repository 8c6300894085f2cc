"""The types of a protocol's records, for editors and type checkers.

  aces spec stubs robotis           print the stub
  aces spec stubs robotis -o        write records.pyi beside the spec, and
                                    records.py, the module that goes with it
  aces spec stubs my_spec.py -o     the same: my_spec_records.pyi and .py
  aces spec stubs robotis --check   exit 1, with the difference, when they are
                                    not what -o would write

With both files there, `from aces_protocols.robotis.records import Status` is
the type of these records in every dialect and configuration, for isinstance
and match (`case Status(error=error):`). Check both files in.

A Python file is executed with your rights: name only what you trust.
"""

from __future__ import annotations

import argparse
import difflib
import sys
from pathlib import Path
from typing import NamedTuple

from aces_bus import list_protocols
from aces_bus.errors import CallerError
from aces_bus.protocol import Protocol
from aces_bus.protocol.exchange.export_stubs import print_module, print_stub
from aces_bus.protocol.files import load_file, python_file

from ..console import say, write_text
from ..options import OUTPUT, Arguments, argument, flag
from ..protocols_arg import named_protocol

BESIDE = "beside the spec"


SUMMARY = "write the types of records, for editors and type checkers"

ARGUMENTS: Arguments = (
    argument(
        "protocol", metavar="NAME|FILE", help="an installed protocol, or a Python file that declares one"
    ),
    OUTPUT.but(nargs="?", const=BESIDE, metavar="FILE.pyi", help=f"write there (without FILE: {BESIDE})"),
    flag("--check", help="only compare with the files that exist"),
)


def run(arguments: argparse.Namespace) -> int:
    home = _home(arguments.protocol)
    stub = print_stub(home.protocol, home.variable)
    given: str | None = arguments.output
    if given is None and not arguments.check:
        sys.stdout.write(stub)
        return 0
    stem = "records" if home.file.stem == "spec" else f"{home.file.stem}_records"
    path = home.file.with_name(f"{stem}.pyi") if given in (None, BESIDE) else Path(str(given))
    if path.suffix != ".pyi":
        raise CallerError(f"-o {path}: a stub's name ends in .pyi")
    texts = {path: stub, path.with_suffix(".py"): home.module(path)}
    command = f"aces spec stubs {arguments.protocol} -o" + ("" if given in (None, BESIDE) else f" {given}")
    if arguments.check:
        return _check(texts, command)
    for file, text in texts.items():
        write_text(str(file), text)
    return 0


def _check(texts: dict[Path, str], command: str) -> int:
    status = 0
    for file, text in texts.items():
        try:
            stored = file.read_text(encoding="utf-8")
        except FileNotFoundError:
            stored = ""
        except (OSError, UnicodeDecodeError) as error:
            raise CallerError(f"{file}: cannot be read: {error}") from error
        if stored != text:
            status = 1
            lines = difflib.unified_diff(
                stored.splitlines(), text.splitlines(), str(file), "from the spec", lineterm=""
            )
            for line in lines:
                print(line)
    if status:
        say(f"stale; to write them anew: {command}")
    return status


class _Home(NamedTuple):
    """Where a protocol comes from: the file of its spec, the module and the variable that name it."""

    protocol: Protocol
    file: Path
    imported: str
    variable: str

    def module(self, path: Path) -> str:
        """Return the module at `path`: it imports the spec from beside itself, else by its full name."""
        is_beside = path.resolve().parent == self.file.parent
        in_package = (self.file.parent / "__init__.py").exists()
        imported = f".{self.file.stem}" if is_beside and in_package else self.imported
        return print_module(self.protocol, imported, self.variable)


def _home(text: str) -> _Home:
    name = named_protocol(text)
    if name.dialect is not None or name.configuration is not None:
        raise CallerError(f"{text}: stubs are of all dialects and configurations; leave them out")
    protocol = name.protocol
    points = list_protocols()
    if text not in points and not python_file(name.source)[0]:
        raise CallerError(
            f"{text}: stubs lie beside a Python file that declares the protocol; make one of the database:"
            f" aces spec import {name.source} > {Path(name.source).stem}.py"
        )
    if text in points:
        module_name, _, variable = points[text].value.partition(":")
        module = sys.modules[module_name]
    else:
        module = load_file(text[: text.lower().rindex(".py") + 3])
        module_name = module.__name__
        variable = next(key for key, value in vars(module).items() if value is protocol)
        if module_name.startswith("aces_spec_"):
            module_name = Path(str(module.__file__)).stem
    return _Home(protocol, Path(str(module.__file__)).resolve(), module_name, variable)
