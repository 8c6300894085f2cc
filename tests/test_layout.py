"""The shape of the house: who may import whom, what is a package, what no file may say.

1. Imports are read from the syntax tree: one inside a function or under TYPE_CHECKING counts like any other.
2. The table below is the design's; change both together.

A new floor or package fails here until the table has its line.
"""

from __future__ import annotations

import ast
import gc
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.house import KERNEL, SMALLEST
from tests.surface import statements

ROOT = Path(__file__).resolve().parent.parent

#: Import package → its folder, and the packages of ours that it may import.
PACKAGES: dict[str, tuple[Path, set[str]]] = {
    "aces_bus": (ROOT / "aces_bus", set()),
    "aces_protocols": (ROOT / "protocols" / "aces_protocols", {"aces_bus"}),
    "aces_devices": (ROOT / "devices" / "aces_devices", {"aces_bus", "aces_protocols"}),
    "aces_tools": (ROOT / "tools" / "aces_tools", {"aces_bus", "aces_protocols", "aces_devices"}),
    "aces_lab": (ROOT / "tools" / "aces_lab", {"aces_bus", "aces_protocols", "aces_devices", "aces_tools"}),
}

#: What a floor of the core may import of the core, beside itself and what everyone may: errors and frames.
FLOORS: dict[str, set[str]] = {
    "errors": set(),
    "frames": set(),
    "frame_table": set(),  # the same frames as columns
    "plain_text": set(),  # text of others, made harmless for terminals and sheets
    "loopback": set(),  # which addresses are of this machine
    "tracebacks": set(),  # the line of a user's program that an exception came from
    "compiling": set(),  # what modules that may be compiled say of their classes
    "version": set(),
    "python_can": set(),  # frames as messages of python-can
    "_lazy": set(),  # public names imported on use
    "plugins": set(),  # what installed packages bring
    "runtime": set(),
    "protocol": set(),  # no I/O, no clock, no device
    "recordings": {"protocol", "export"},
    "export": {"protocol"},  # tables on disk, whole or kill-safe
    "hardware": {"runtime", "recordings"},  # replays recordings; knows no protocol
    "device": {"runtime", "protocol"},  # one node, whatever the bus
    "state": {"runtime", "device"},
    "kinematics": set(),  # bodies as chains; numbers only
    # touches no frame and no byte; its logs are written by export's durable writers
    "controller": {"runtime", "device", "state", "recordings", "export", "kinematics"},
    "access": {"runtime", "device", "state"},  # states for other programs, by datagrams
    "robot": {
        "runtime",
        "protocol",
        "hardware",
        "device",
        "state",
        "controller",
        "recordings",
        "kinematics",
    },  # floors put together
    "testing": {
        "runtime",
        "protocol",
        "recordings",
        "export",
        "hardware",
        "device",
        "state",
        "controller",
        "robot",
    },
}
EVERYONE = {
    "errors",
    "loopback",
    "frames",
    "frame_table",
    "plain_text",
    "tracebacks",
    "compiling",
    "_lazy",
    "version",
    "python_can",
    "plugins",
}


def module_name(path: Path) -> tuple[str, bool]:
    """The dotted name of a source file, and whether it is a package's `__init__`."""
    for package, (folder, _) in PACKAGES.items():
        if path.is_relative_to(folder):
            parts = [package, *path.relative_to(folder).with_suffix("").parts]
            return (".".join(parts[:-1]), True) if parts[-1] == "__init__" else (".".join(parts), False)
    raise ValueError(path)


def imports_of(source: str, module: str, is_package: bool = False) -> Iterator[tuple[int, str]]:
    """Line and dotted name of all that a module imports; `from a import b` gives `a.b`, as `b` may be a module."""
    package = module.split(".") if is_package else module.split(".")[:-1]
    # Calls that import are inside expressions, which are most of a file: they are looked through where one is named.
    nodes = ast.walk if "import_module" in source or "__import__" in source else statements
    for node in nodes(ast.parse(source)):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield node.lineno, alias.name
        elif isinstance(node, ast.ImportFrom):
            start = package[: len(package) - node.level + 1] if node.level else []
            base = [*start, node.module] if node.module else start
            for alias in node.names:
                yield node.lineno, ".".join([*base, alias.name])
        elif isinstance(node, ast.Call) and node.args and isinstance(node.args[0], ast.Constant):
            called = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
            if called in {"import_module", "__import__"} and isinstance(node.args[0].value, str):
                name = node.args[0].value
                if name.startswith("."):
                    level = len(name) - len(name.lstrip("."))
                    name = ".".join([*package[: len(package) - level + 1], name.lstrip(".")])
                yield node.lineno, name


def faults_of(source: str, module: str, is_package: bool = False) -> list[str]:
    """What the module imports against the tables, one line each."""
    faults: list[str] = []
    package, *rest = module.split(".")
    floor = rest[0] if rest else None
    if package == "aces_bus" and floor is not None and floor not in FLOORS:
        return [f"{module}: aces_bus.{floor} has no line in FLOORS"]
    for line, name in imports_of(source, module, is_package):
        target, *inner = name.split(".")
        if target not in PACKAGES or (target == package != "aces_bus"):
            continue
        if target != package:
            if target not in PACKAGES[package][1]:
                faults.append(f"{module}:{line}: {package} must not import {name}")
        elif floor is not None and inner and inner[0] in FLOORS:
            if inner[0] not in {floor, *EVERYONE, *FLOORS[floor]}:
                faults.append(f"{module}:{line}: aces_bus.{floor} must not import aces_bus.{inner[0]}")
    return faults


@pytest.mark.slow
@pytest.mark.parametrize("package", PACKAGES)
def test_imports_point_one_way(package: str) -> None:
    """No package imports one above it, and no floor of the core a higher floor."""
    folder, _ = PACKAGES[package]
    files = sorted(folder.rglob("*.py")) + sorted(folder.rglob("*.pyi"))
    assert files, f"no sources in {folder}"
    faults: list[str] = []
    gc.disable()  # trees are large and hold no cycles: looking through them for garbage costs more than making them
    try:
        for path in files:
            faults += faults_of(path.read_text(encoding="utf-8"), *module_name(path))
    finally:
        gc.enable()
    assert not faults, "\n".join(faults)


@pytest.mark.parametrize(
    ("module", "source"),
    [
        ("aces_bus.frames", "import aces_protocols"),
        ("aces_bus.protocol.live.can", "from aces_bus.hardware import can"),
        ("aces_bus.protocol.live.can", "from ...hardware.can import Bus"),
        ("aces_bus.protocol.live.can", "from ... import recordings"),
        ("aces_bus.protocol.live.can", "def f():\n    from aces_bus import state"),
        ("aces_bus.protocol.live.can", "if TYPE_CHECKING:\n    import aces_bus.controller"),
        ("aces_bus.protocol.live.can", "import_module('aces_bus.device')"),
        ("aces_bus.protocol.live.can", "importlib.import_module('...device', __package__)"),
        ("aces_bus.novelty.thing", "import os"),
        ("aces_protocols.hubo.spec", "from aces_devices import hubo"),
        ("aces_devices.hubo.driver", "import aces_tools.main"),
    ],
)
def test_a_wrong_import_is_seen(module: str, source: str) -> None:
    """However an import is written, one against the tables is found."""
    assert len(faults_of(source, module)) == 1


@pytest.mark.parametrize(
    ("module", "source"),
    [
        (
            "aces_bus.protocol.live.can",
            "from ..spec import fields\nfrom ...frames import Frame\nimport aces_bus.errors",
        ),
        ("aces_bus.recordings.table", "from ..protocol import Protocol"),
        ("aces_protocols.hubo.spec", "from aces_bus.protocol import Protocol\nfrom .boards import BOARDS"),
        ("aces_tools.decode", "import aces_bus.recordings, aces_protocols.hubo.spec"),
    ],
)
def test_a_right_import_passes(module: str, source: str) -> None:
    """What the tables allow is not reported."""
    assert faults_of(source, module) == []


def test_a_package_may_import_its_own_modules() -> None:
    """In an `__init__` one dot is the package itself."""
    assert [name for _, name in imports_of("from .frames import Frame", "aces_bus", True)] == [
        "aces_bus.frames.Frame"
    ]
    assert faults_of("from .frames import Frame\nfrom .protocol import Protocol", "aces_bus", True) == []


#: Imports that go back on purpose, from a file into a folder, with the reason. They are inside functions or for types only.
BACK: dict[tuple[str, str], str] = {
    (
        "aces_bus.protocol.declare.protocol",
        "aces_bus.protocol",
    ): "a variant makes its own scanner, encoder and tables",
    ("aces_bus.protocol.declare.message", "aces_bus.protocol.plan"): "a message has its plan",
}


def folder_of(module: str, is_package: bool) -> str:
    return module if is_package else module.rpartition(".")[0]


def file_graph() -> tuple[dict[str, set[str]], dict[str, str]]:
    """Which module imports which, names taken from where they are defined and not from the package that exports them; and
    the folder of each module.
    """
    kinds = {
        name: (path, is_package)
        for folder, _ in PACKAGES.values()
        for path in sorted(folder.rglob("*.py"))
        for name, is_package in [module_name(path)]
    }
    imported = {
        module: [name for _, name in imports_of(path.read_text(encoding="utf-8"), module, is_package)]
        for module, (path, is_package) in kinds.items()
    }
    exported = {
        module: {name.rpartition(".")[2]: name for name in imported[module]}
        for module, (_, is_package) in kinds.items()
        if is_package
    }

    def definer(name: str) -> str | None:
        for _ in range(10):
            if name in kinds:
                return name
            base, _, last = name.rpartition(".")
            if not base:
                return None
            name = exported.get(base, {}).get(last, base) if base in kinds else base
        return None

    folders = {module: folder_of(module, is_package) for module, (_, is_package) in kinds.items()}
    graph: dict[str, set[str]] = {module: set() for module in kinds if module not in PACKAGES}
    for module in graph:
        for name in imported[module]:
            target = definer(name)
            if target in graph and target != module:
                if not any(module == one and target.startswith(f"{into}.") for one, into in BACK):
                    graph[module].add(target)
    return graph, folders


@pytest.mark.slow
def test_no_circle_between_folders() -> None:
    """No file imports, through others, a file that imports it, unless all of them are in one folder."""
    graph, folders = file_graph()
    reach: dict[str, set[str]] = {}
    for module in graph:
        seen: set[str] = set()
        queue = [module]
        while queue:
            queue += (new := graph[queue.pop()] - seen)
            seen |= new
        reach[module] = seen
    circles = sorted(
        f"{one} → {other}"
        for one in graph
        for other in graph[one]
        if one in reach[other] and folders[one] != folders[other]
    )
    assert not circles, "\n".join(circles)


#: What the kernel may import beside itself: what it is made of, and its records, counts and encoder.
KERNEL_NEEDS = {"construct", "msgspec", "anycrc"}
KERNEL_KNOWS = ("_lazy", "compiling", "protocol.record", "protocol.counts", "protocol.encoder")
#: Module of the kernel → what else it imports, only when it is needed.
KERNEL_EXCEPTIONS = {
    "frames": "can",  # only its type: what scanners take beside our frames
    "protocol.live.find": "numpy",  # searches long pieces of a stream
    "protocol.live.can": "aces_bus.frame_table",  # takes frames as columns
}


def test_the_kernel_needs_little() -> None:
    """The kernel imports the standard library, construct, msgspec, anycrc and itself."""
    faults: list[str] = []
    for path in sorted((ROOT / "aces_bus").rglob("*.py")):
        name = ".".join(path.relative_to(ROOT / "aces_bus").with_suffix("").parts).removesuffix(".__init__")
        if not is_within(name, KERNEL):
            continue
        for module in imported(path, name):
            top, _, rest = module.partition(".")
            allowed = top in sys.stdlib_module_names or top in KERNEL_NEEDS
            if top == "aces_bus":
                allowed = is_within(rest, (*KERNEL, *KERNEL_KNOWS))
            if not allowed and module.removesuffix(".typing") != KERNEL_EXCEPTIONS.get(name):
                faults.append(f"{name} imports {module}")
    assert not faults, "\n".join(faults)


def is_within(name: str, rooms: tuple[str, ...]) -> bool:
    return any(name == room or name.startswith(f"{room}.") for room in rooms)


def imported(path: Path, name: str) -> Iterator[str]:
    """Yield the modules that a file of `aces_bus` imports, wherever."""
    package = ["aces_bus", *name.split(".")][: None if path.name == "__init__.py" else -1]
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            start = package[: len(package) - node.level + 1] if node.level else []
            base = ".".join([*start, *([node.module] if node.module else [])])
            # `from ..plan import nodes` imports a module, `from ..plan.nodes import Node` a name.
            named = [f"{base}.{alias.name}" for alias in node.names]
            folder = ROOT.joinpath(*base.split("."))
            yield from named if base.startswith("aces_bus") and folder.is_dir() else [base]


def test_the_smallest_use_loads_little() -> None:
    """A CAN message declared, scanned and encoded loads at most 45 modules of ours, neither python-can nor NumPy."""
    done = subprocess.run(
        [sys.executable, "-c", SMALLEST], capture_output=True, text=True, check=True, cwd=ROOT
    )
    number, *others = done.stdout.split()
    assert int(number) <= 45
    assert others == ["False", "False"]


def test_source_roots_are_folders_not_packages() -> None:
    """No `__init__.py` directly inside a source root; each import package carries `py.typed`."""
    roots = ["protocols", "devices", "tools", "tests", "examples"]
    assert [root for root in roots if (ROOT / root / "__init__.py").exists()] == []
    assert [name for name, (folder, _) in PACKAGES.items() if not (folder / "py.typed").exists()] == []


def test_benchmarks_are_out_of_the_wheel() -> None:
    """What measures lives in `tests/bench`: no package that is installed has a folder or a script of benchmarks."""
    found = [
        path.relative_to(ROOT).as_posix()
        for folder, _ in PACKAGES.values()
        for path in folder.rglob("*.py")
        if "benchmarks" in path.parts or path.stem.startswith("bench_")
    ]
    assert found == []


def test_the_core_names_nothing_of_the_rings_outside() -> None:
    """No text of the core, a place of a plug-in for instance, leads to a module of catalogue, shell or lab."""
    outside = re.compile(r"[\"'](?:aces_protocols|aces_devices|aces_tools|aces_lab)[.:]")
    found = [
        f"{path.relative_to(ROOT).as_posix()}: {match[0]}"
        for path in PACKAGES["aces_bus"][0].rglob("*.py")
        for match in outside.finditer(path.read_text(encoding="utf-8"))
    ]
    assert found == []


#: All that stands at the top of the repository.
TOP = {
    *(
        ".ci",
        ".gitattributes",
        ".gitignore",
        "CONTRIBUTING.md",
        "LICENSE",
        "Makefile",
        "README.md",
        "SECURITY.md",
        "aces_bus",
    ),
    *(
        "changelog.d",
        "constraints.txt",
        "devices",
        "docs",
        "examples",
        "hatch_build.py",
        "protocols",
        "pyproject.toml",
        "stubs",
        "tests",
        "tools",
    ),
}


def test_nothing_else_stands_at_the_top() -> None:
    """A test that writes where it is started leaves files there, which are then committed by accident."""
    assert {path.relative_to(ROOT).parts[0] for path in tracked_files() if path.exists()} == TOP


#: A function's docstring whose first word makes the sentence a riddle. `tests/house.py` counts them by the syntax tree.
RIDDLE = re.compile(r"(?:\bdef\b[^\n]*|\n *\) ->[^\n]*):\n +\"\"\"((?:What|Whether|How|Where)\b[^\n]*)")


def test_no_docstring_of_a_function_is_a_riddle() -> None:
    """A function's docstring says what it does or returns: it does not begin with What, Whether, How or Where."""
    riddles = [
        f"{path.relative_to(ROOT).as_posix()}: {found[1]}"
        for folder, _ in PACKAGES.values()
        for path in folder.rglob("*.py")
        for found in RIDDLE.finditer(path.read_text(encoding="utf-8"))
    ]
    assert not riddles, "\n".join(riddles)


# ---- what no file may say -----------------------------------------------------------------------------------------

#: The first folder of a checkout's path is nobody's business either, unless every system has one of that name.
COMMON = {"bin", "dev", "etc", "lib", "media", "mnt", "opt", "proc", "run", "srv", "sys", "usr", "var"}
#: A slash that begins a path. Each pattern begins with a plain character, for which all files are searched quickly.
SLASH = r"/(?<![\w.~$)}/-]/)"
PRIVATE = [
    SLASH + r"(?:home|Users|root|tmp)/\w",
    r":(?<=\b[A-Z]:)\\Users\\",
    r"--(?:extra-)?index-url\b",
]


def private(root: Path) -> re.Pattern[str]:
    """Paths that mean something on one machine only, the checkout's own among them."""
    patterns = list(PRIVATE)
    if len(root.parts) > 1 and root.parts[1] not in COMMON:
        patterns.append(SLASH + re.escape(f"{root.parts[1]}/") + r"\w")
    return re.compile("|".join(patterns))


def tracked_files() -> list[Path]:
    """The files that git tracks; outside of a repository (an sdist) this cannot be told."""
    try:
        listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        pytest.skip("not a git checkout")
    if not listed.stdout:
        pytest.skip("git tracks nothing here yet")
    return [ROOT / name for name in listed.stdout.decode().split("\0") if name]


@pytest.mark.slow
def test_no_file_names_a_path_of_one_machine() -> None:
    """No tracked text file contains a path of somebody's machine or the address of a package index."""
    pattern, seen, faults = private(ROOT), 0, list[str]()
    for path in tracked_files():
        try:
            text = path.read_text(encoding="utf-8")
        except (UnicodeDecodeError, FileNotFoundError, IsADirectoryError):
            continue  # binary, or deleted and not yet committed
        seen += 1
        for found in pattern.finditer(text):
            number = text.count("\n", 0, found.start()) + 1
            faults.append(f"{path.relative_to(ROOT).as_posix()}:{number}: {found[0]}…")
    assert seen > 10
    assert not faults, "\n".join(faults)


@pytest.mark.parametrize(
    ("line", "wrong"),
    [
        ("open('{}')".format("/".join(["", "home", "ann", "x.log"])), True),
        ("see {}".format("/".join(["", "tmp", "x"])), True),
        ("at {}".format("/".join(["", "elsewhere", "checkout"])), True),
        ("at {}".format("\\".join(["C:", "Users", "ann"])), True),
        ("#!/usr/bin/env bash", False),
        ("candump can0 > walk.log; cat /dev/ttyUSB0", False),
        ("https://example.org/home/page and docs/home/page", False),
    ],
)
def test_private_paths_are_told_from_others(line: str, wrong: bool) -> None:
    """Home and temporary folders and the checkout's own place are found; addresses and system files are not."""
    assert bool(private(Path("/elsewhere/aces-bus")).search(line)) is wrong
