"""The compiled build: the same sources, the modules that virtual time spends itself in compiled by mypyc.

1. It is a copy of the repository in a folder of its own (`build/compiled`); nothing is compiled in the source tree.
2. `hatch_build.py` has the list, and compiles; what is not listed is imported from its source as ever. What is compiled
   checks the types that it declares.
3. The bytes on the wires are the same; `tests/robot/test_same_bytes.py` shows it.

`make compiled` makes it; `build/compiled/aces` is the command, and `make test-compiled` runs the tests there. It needs a C
compiler and the headers of Python.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
from pathlib import Path

from hatch_build import ROOTS, compile_modules

ROOT = Path(__file__).resolve().parent.parent
BUILD = ROOT / "build" / "compiled"
#: What is copied: all that the tests look at.
COPIED = (
    *("aces_bus", "protocols", "devices", "tools", "stubs", "tests", "examples", "docs", "changelog.d"),
    *("pyproject.toml", "hatch_build.py", "README.md", "CONTRIBUTING.md", "Makefile", "constraints.txt"),
)


def copy_sources() -> None:
    """The tree as it is, without what was made in it."""
    shutil.rmtree(BUILD, ignore_errors=True)
    BUILD.mkdir(parents=True)
    for name in COPIED:
        source = ROOT / name
        if source.is_dir():
            shutil.copytree(source, BUILD / name, ignore=shutil.ignore_patterns("__pycache__", "*.so"))
        else:
            shutil.copy2(source, BUILD / name)


COMMAND = """#!/bin/sh
PYTHONPATH="{build}:{build}/protocols:{build}/devices:{build}/tools" exec "{python}" -m aces_tools "$@"
"""


def main() -> None:
    copy_sources()
    with tempfile.TemporaryDirectory(prefix="aces-compiled-") as tree:
        found = compile_modules(ROOT, Path(tree).resolve())
        for path, place in found.items():
            parts = Path(place).parts
            root = next((r for r in ROOTS if len(parts) > 1 and (BUILD / r / parts[0]).is_dir()), ".")
            shutil.move(path, BUILD / root / place)
    command = BUILD / "aces"
    command.write_text(COMMAND.format(build=BUILD, python=sys.executable))
    command.chmod(0o755)
    print(f"{len(found)} compiled files in {BUILD}")


if __name__ == "__main__":
    main()
