"""Build hooks: the compiled modules of the wheel, and the long description.

What virtual time spends itself in is compiled by mypyc where that can be done.

1. One source: a compiled wheel holds the `.py` files, too, and does the same; `aces --version` says which it is.
2. Where no C compiler or no header of Python is found, or compiling fails, the wheel is pure, and the build says why.
3. `ACES_BUILD=pure` never compiles, `ACES_BUILD=compiled` fails where it cannot. An editable install is never compiled.

mypyc compiles against the sources alone: what it imports from other packages is any object to it.

The long description is README.md, whose links between files are plain words: they would lead nowhere on an index.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface
from hatchling.metadata.plugin.interface import MetadataHookInterface

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
#: Folders that hold import packages.
ROOTS = (".", "protocols", "devices", "tools")
COPIED = ("aces_bus", "protocols", "devices", "tools", "stubs")

CONFIG = """[mypy]
python_version = 3.11
explicit_package_bases = true
mypy_path = {root}:{root}/protocols:{root}/devices:{root}/tools:{root}/stubs
ignore_missing_imports = true
ignore_errors = true
"""
#: Of each module that is compiled.
STRICT = "[mypy-{module}]\nignore_errors = false\n"
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

extensions = mypycify(["--config-file", "compiled.ini", *sys.argv[1:]], opt_level="2")
command = build_ext(Distribution({"name": "aces-bus-compiled", "ext_modules": extensions}))
command.build_lib, command.build_temp = "compiled", "objects"
command.ensure_finalized()
command.run()
"""


def cannot() -> str:
    """Return why nothing can be compiled here; "" where it can."""
    compiler = (sysconfig.get_config_var("CC") or "cc").split()[0]
    if os.name == "nt":
        return "compiling is not tried on Windows"
    if shutil.which(compiler) is None:
        return f"there is no C compiler ({compiler})"
    if not Path(sysconfig.get_path("include"), "Python.h").is_file():
        return "Python's headers are not installed (Python.h)"
    return ""


def compile_modules(root: Path, tree: Path) -> dict[Path, str]:
    """Compile in `tree`, a copy of the sources in `root`; return the files made, with their places below an import path.

    Raises `subprocess.CalledProcessError` with what mypyc or the compiler printed.
    """
    for name in COPIED:
        shutil.copytree(
            root / name, tree / name, ignore=shutil.ignore_patterns("__pycache__", "*.so"), dirs_exist_ok=True
        )
    config = CONFIG.format(root=tree)
    for module in MODULES:
        folder = next((r for r in ROOTS if module.startswith(f"{r}/")), "")
        name = module.removeprefix(f"{folder}/").removesuffix(".py").replace("/", ".")
        config += STRICT.format(module=name)
    (tree / "compiled.ini").write_text(config)
    subprocess.run(
        [sys.executable, "-c", COMPILE, *MODULES],
        cwd=tree,
        check=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
    )
    built = tree / "compiled"
    return {path: path.relative_to(built).as_posix() for path in sorted(built.rglob("*.so"))}


class CompiledBuildHook(BuildHookInterface):  # type: ignore[type-arg]
    """Adds the compiled modules to a wheel."""

    PLUGIN_NAME = "custom"

    def dependencies(self) -> list[str]:
        """Return what building needs beside hatchling: mypyc, where it can be used."""
        wanted = self.target_name == "wheel" and os.environ.get("ACES_BUILD") != "pure" and not cannot()
        return ["mypy[mypyc]>=2.4,<3"] if wanted else []

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Compile, or say why not."""
        wish = os.environ.get("ACES_BUILD", "")
        if version == "editable" or self.target_name != "wheel" or wish == "pure":
            return
        reason = cannot()
        if not reason:
            self._tree = tempfile.TemporaryDirectory(prefix="aces-compiled-")
            try:
                made = compile_modules(Path(self.root), Path(self._tree.name).resolve())
                build_data["force_include"].update({str(path): place for path, place in made.items()})
                build_data["pure_python"], build_data["infer_tag"] = False, True
                self.app.display_info(f"{len(MODULES)} modules are compiled")
                return
            except subprocess.CalledProcessError as error:
                reason = "mypyc failed:\n" + "\n".join(
                    error.stdout.decode(errors="replace").splitlines()[-20:]
                )
        if wish == "compiled":
            raise RuntimeError(f"ACES_BUILD=compiled: {reason}")
        self.app.display_warning(f"the wheel is pure Python: {reason}")

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        """Remove what was built on the way."""
        if hasattr(self, "_tree"):
            self._tree.cleanup()


#: A link of Markdown to a file or a heading, and what of it stays.
LINK = re.compile(r"\[((?:[^\[\]]|\[[^\]]*\])+)\]\((?!https?:)[^)]+\)")


class ReadmeHook(MetadataHookInterface):
    """Makes the long description."""

    PLUGIN_NAME = "custom"

    def update(self, metadata: dict[str, Any]) -> None:
        """Set the project's readme."""
        text = Path(self.root, "README.md").read_text(encoding="utf-8")
        metadata["readme"] = {"content-type": "text/markdown", "text": LINK.sub(r"\1", text)}
