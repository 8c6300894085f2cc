"""The compiled build: the same sources, the modules that virtual time spends itself in compiled by mypyc.

1. It is a copy of the repository in a folder of its own (`build/compiled`); nothing is compiled in the source tree.
2. What is not listed is imported from its source as ever. What is compiled checks the types that it declares.
3. The bytes on the wires are the same; `tests/robot/test_same_bytes.py` shows it.

`make compiled` makes it; `build/compiled/aces` is the command, and `make test-compiled` runs the tests there. It needs a C
compiler and the headers of Python.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
BUILD = ROOT / "build" / "compiled"
#: What is copied: all that the tests look at.
COPIED = (
    *("aces_bus", "protocols", "devices", "tools", "stubs", "tests", "examples", "docs", "changelog.d"),
    *("pyproject.toml", "README.md", "CONTRIBUTING.md", "Makefile", "constraints.txt"),
)
SOURCE_ROOTS = (".", "protocols", "devices", "tools")
#: What is compiled: what a frame in virtual time passes through. Classes that others inherit from say so by `mypyc_attr`.
MODULES = (
    "aces_bus/runtime/virtual.py",
    "aces_bus/runtime/clock.py",
    "aces_bus/hardware/simulated/frame_time.py",
    "aces_bus/hardware/simulated/bus.py",
    "aces_bus/protocol/live/decide.py",
    "aces_bus/protocol/live/context.py",
    "aces_bus/device/ticket.py",
    "aces_bus/device/host.py",
    "aces_bus/device/twin.py",
    "aces_bus/device/unanswered.py",
    "aces_bus/device/poll.py",
    "aces_bus/device/polling.py",
    "aces_bus/device/signals.py",
    "aces_bus/device/motor.py",
    "aces_bus/device/station.py",
    "aces_bus/device/device.py",
    "aces_bus/device/gathering.py",
    "aces_bus/device/declared.py",
    "aces_bus/controller/limiter.py",
    "aces_bus/controller/line.py",
    "aces_bus/controller/door.py",
    "aces_bus/controller/guard.py",
    "devices/aces_devices/hubo_motor/channel.py",
    "devices/aces_devices/joint_model.py",
    "devices/aces_devices/hubo_motor/axis.py",
    "devices/aces_devices/hubo_sensors/body.py",
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


COMPILE = """
import inspect, sys

class Signature(inspect.Signature):  # of `help`: mypyc 2.4 has **fields for positional where a float has a default
    def __init__(self, parameters=None, **more):
        try:
            super().__init__(parameters, **more)
        except ValueError:
            super().__init__(parameters, __validate_parameters__=False)

inspect.Signature = Signature
from mypyc.build import mypycify
from setuptools import Distribution
from setuptools.command.build_ext import build_ext
from pathlib import Path

extensions = mypycify(["--config-file", "pyproject.toml", "--cache-dir", "../mypy_cache", *sys.argv[1:]], opt_level="2")
command = build_ext(Distribution({"name": "aces-bus-compiled", "ext_modules": extensions}))
command.build_lib, command.build_temp = "compiled", "objects"
command.ensure_finalized()
command.run()
"""


COMMAND = """#!/bin/sh
PYTHONPATH="{build}:{build}/protocols:{build}/devices:{build}/tools" exec "{python}" -m aces_tools "$@"
"""


def main() -> None:
    copy_sources()
    subprocess.run([sys.executable, "-c", COMPILE, *MODULES], cwd=BUILD, check=True)
    found = sorted((BUILD / "compiled").rglob("*.so"))
    for path in found:
        name = path.relative_to(BUILD / "compiled")
        root = next(
            (r for r in SOURCE_ROOTS if (BUILD / r / name.parts[0]).is_dir() and len(name.parts) > 1), "."
        )
        shutil.move(path, BUILD / root / name)
    shutil.rmtree(BUILD / "compiled")
    shutil.rmtree(BUILD / "objects", ignore_errors=True)
    command = BUILD / "aces"
    command.write_text(COMMAND.format(build=BUILD, python=sys.executable))
    command.chmod(0o755)
    print(f"{len(found)} compiled files in {BUILD}")


if __name__ == "__main__":
    main()
