"""The front door: what is public, under which name, and that one name means one thing.

1. The public surface is what packages list in `__all__`, beside two files: the errors and the strategies of tests.
   `golden/surface.txt` pins it, with the parameters of callables and a level.
   `pytest tests/test_surface.py --update-golden` rewrites it: read the difference before committing it.
2. The seams are what the catalogue, the shell and the lab import beside it, and what `PLUG_INS` adds for strangers.
3. A name with an underscore in front is the own of its package: of a floor of `aces_bus`, or of an import package beside it.
"""

from __future__ import annotations

import ast
import inspect
import pkgutil
import re
from collections import defaultdict
from collections.abc import Callable, Container, Iterator
from enum import Enum
from functools import cache
from importlib import import_module
from pathlib import Path
from types import FunctionType, MethodType, ModuleType
from typing import Any

import pytest
from msgspec import NODEFAULT

import aces_bus
from aces_bus.errors import CallerError
from tests.interpreted import looks_at_parameters
from tests.surface import SEAMS_HEAD, SURFACE_HEAD, Pinned, module_path, outside, read_pinned
from tests.test_layout import PACKAGES, imports_of, module_name

ROOT = Path(__file__).resolve().parent.parent

#: Seams that only strangers' plug-ins need: module → names, with the contract that they belong to.
PLUG_INS: dict[str, dict[str, str]] = {
    "aces_bus.device.coalesce": {"per_device": "a driver's rules for its messages"},
    "aces_bus.device.config": dict.fromkeys(("Home", "Input", "Park"), "a robot that a program makes"),
    "aces_bus.kinematics.body": dict.fromkeys(("Fixed", "Prismatic"), "a body, `aces_bus.bodies`"),
    "aces_bus.state.estimators": dict.fromkeys(("Estimation", "Estimator"), "an estimator of one's own"),
    "aces_bus.testing.plug_ins": dict.fromkeys(
        (
            *("backend_tests", "database_tests", "exporter_tests", "log_tests"),
            *("reader_tests", "store_tests", "verb_tests", "writer_tests"),
        ),
        "tests of each kind of plug-in",
    ),
}
#: Pages for who writes plug-ins: they show seams, too.
FOR_PLUG_INS = ("docs/plugins.md",)

#: Public names that more than one module defines, with the reason.
TWICE: dict[str, str] = {
    "decode": "a recording's, and a fleet's",
    "is_wanted": "each module that adds options to a verb has one",
    "open_view": "so has each that opens a live view",
    "pytest_addoption": "each plug-in of pytest has one",
    "run": "each verb of the command line has one",
}


@cache
def sources() -> list[tuple[str, bool, str]]:
    """Each module of ours: its name, whether it is a package's `__init__`, its text."""
    return [
        (*module_name(path), path.read_text(encoding="utf-8"))
        for folder, _ in PACKAGES.values()
        for path in sorted(folder.rglob("*.py"))
    ]


def packages() -> list[str]:
    """Return the modules whose names users import: the packages that list any, and two files."""
    found = ["aces_bus", "aces_bus.errors", "aces_bus.testing.strategies"]
    for one in pkgutil.walk_packages(aces_bus.__path__, "aces_bus."):
        if one.ispkg and "._" not in one.name and getattr(import_module(one.name), "__all__", None):
            found.append(one.name)
    return found


def parameters(thing: Callable[..., Any]) -> str:
    """What a callable takes, without annotations; defaults only where they are the same on every machine."""
    if fields := getattr(thing, "__struct_fields__", ()):
        # Its signature would look for types that only checkers import.
        defaults: tuple[Any, ...] = getattr(thing, "__struct_defaults__", ())
        given = [NODEFAULT] * (len(fields) - len(defaults)) + list(defaults)
        pairs = zip(fields, given, strict=True)
        return f"({', '.join(name if value is NODEFAULT else f'{name}=…' for name, value in pairs)})"
    try:
        signature = inspect.signature(thing)
    except (TypeError, ValueError, NameError):  # NameError: of types that only checkers import
        return "(…)"
    parts: list[str] = []
    star = False
    for one in signature.parameters.values():
        if one.kind is one.KEYWORD_ONLY and not star:
            star = True
            parts.append("*")
        star = star or one.kind is one.VAR_POSITIONAL
        prefix = "*" if one.kind is one.VAR_POSITIONAL else "**" if one.kind is one.VAR_KEYWORD else ""
        parts.append(f"{prefix}{one.name}{'' if one.default is one.empty else '=…'}")
    return f"({', '.join(part for part in parts if part != 'self')})"


def members_of(thing: type, exported: Container[object]) -> dict[str, Any]:
    """What a class has itself, and from those bases of ours that are not public names themselves."""
    found: dict[str, Any] = {}
    for base in reversed(thing.__mro__):
        if base is thing or (base.__module__.startswith("aces_bus.") and base not in exported):
            found.update(vars(base))
    return found


def lines_of(name: str, thing: Any, exported: Container[object]) -> Iterator[str]:
    """A public name, and if it is a class of ours its public members."""
    if isinstance(thing, ModuleType):
        yield f"{name}: module"
    elif inspect.isclass(thing):
        yield f"{name}{'' if issubclass(thing, (BaseException, Enum)) else parameters(thing)}"
        for member, value in sorted(members_of(thing, exported).items()):
            if not member.startswith("_"):
                value = value.__func__ if isinstance(value, classmethod | staticmethod) else value
                called = isinstance(value, FunctionType | MethodType)
                yield f"    .{member}{parameters(value) if called else ''}"
    else:
        yield f"{name}{parameters(thing) if callable(thing) else ''}"


@looks_at_parameters
def test_the_public_surface(golden: Callable[[str, str], None]) -> None:
    """Nothing becomes public, changes its parameters or goes without the golden file saying so; the same for seams."""
    levels = read_pinned().surface
    text = [SURFACE_HEAD]
    modules = [import_module(package) for package in packages()]
    exported = [getattr(module, name) for module in modules for name in module.__all__]
    classes = {one for one in exported if inspect.isclass(one)}
    for module in modules:
        text += ["", module.__name__]
        for name in module.__all__:
            level = levels.get(module.__name__, {}).get(name) or "provisional"
            first, *members = lines_of(name, getattr(module, name), classes)
            text += [f"  {level} {first}", *(f"  {line}" for line in members)]
    text += ["", SEAMS_HEAD]
    for place, names in sorted(seams().items()):
        text += ["", place, *(f"  {name}" for name in sorted(names))]
    golden("surface.txt", "\n".join(text) + "\n")


def seams() -> dict[str, set[str]]:
    """Return what catalogue, shell and lab import that is not public, and what plug-ins need: module → names."""
    public = {module: set(import_module(module).__all__) for module in packages()}
    pinned = Pinned({module: dict.fromkeys(names, "") for module, names in public.items()})
    found: dict[str, set[str]] = {module: set(names) for module, names in PLUG_INS.items()}
    for package, (folder, _) in PACKAGES.items():
        for path in sorted(folder.rglob("*.py")) if package != "aces_bus" else ():
            for line, module, name in outside(pinned, path.read_text(encoding="utf-8"), seams=False):
                if module_path(module) is None or name in ("", "*"):
                    pytest.fail(f"{path}:{line}: import names of {module}, or a module that there is")
                found.setdefault(module, set()).add(name)
    return found


def pages_and_examples() -> list[Path]:
    """Return what users read: README, pages, READMEs of the catalogue, and examples."""
    pages = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").rglob("*.md")]
    pages += [page for folder, _ in PACKAGES.values() for page in folder.rglob("*.md")]
    return sorted([*pages, *(ROOT / "examples").rglob("*.py")])


def test_pages_and_examples_import_only_the_surface() -> None:
    """What users read imports public names alone, never a seam."""
    pinned, wrong = read_pinned(), list[str]()
    for path in pages_and_examples():
        seams = path.relative_to(ROOT).as_posix() in FOR_PLUG_INS
        for line, module, name in outside(pinned, code_of(path), seams=seams):
            wrong.append(f"{path.relative_to(ROOT).as_posix()}:{line}: {module}.{name}")
    assert not wrong, "\n".join(wrong)


def code_of(path: Path) -> str:
    """Return a page's import statements, on their lines; an example is code as it is."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".py":
        return text
    prompt = re.compile(r"^\s*(?:>>> |\.\.\. )?((?:from aces_bus[\w.]* )?import [^;#(]*)")
    return "\n".join(found[1] if (found := prompt.match(line)) else "" for line in text.splitlines())


def test_a_package_lists_what_it_exports() -> None:
    """An `__init__` that binds public names lists them in `__all__`, each once and there."""
    wrong: list[str] = []
    for name, is_package, text in sources():
        if not is_package:
            continue
        tree = ast.parse(text)
        binds = {
            bound.asname or bound.name
            for node in tree.body
            if isinstance(node, ast.ImportFrom) and node.level
            for bound in node.names
            if bound.asname == bound.name  # written so to export it
        } | {
            node.name
            for node in tree.body
            if isinstance(node, ast.FunctionDef | ast.ClassDef) and not node.name.startswith("_")
        }
        listed = getattr(import_module(name), "__all__", None)
        if binds and listed is None:
            wrong.append(f"{name} exports {', '.join(sorted(binds))} without __all__")
        elif listed is not None and len(listed) != len(set(listed)):
            wrong.append(f"{name}: __all__ has a name twice")
        elif listed is not None:
            wrong += [f"{name}.{one} is not there" for one in listed if not hasattr(import_module(name), one)]
    assert not wrong, "\n".join(wrong)


def test_every_module_can_be_imported() -> None:
    """No module needs something that is not there, but for an extra, which it names."""
    wrong: list[str] = []
    for name, _, _ in sources():
        try:
            if not name.endswith("__main__"):
                import_module(name)
        except (CallerError, ImportError) as missing:
            wrong += [f"{name}: {missing}"] if "pip install" not in str(missing) else []
    assert not wrong, "\n".join(wrong)


def test_the_root_is_complete() -> None:
    """`dir(aces_bus)` has every public name, before and after its use."""
    assert set(aces_bus.__all__) <= set(dir(aces_bus))


def test_importing_all_names_binds_no_module() -> None:
    """`from aces_bus.protocol import *` gives classes and functions, no module of ours."""
    names: dict[str, Any] = {}
    exec("from aces_bus.protocol import *", names)
    assert [name for name, value in names.items() if isinstance(value, ModuleType)] == []


def test_one_name_has_one_meaning() -> None:
    """No public class or function is defined under the same name in two modules, but for those above."""
    where: dict[str, list[str]] = defaultdict(list)
    defined = re.compile(r"^(?:class|def|async def) ([a-zA-Z]\w*)", re.MULTILINE)
    for module, _, text in sources():
        for name in defined.findall(text):
            where[name].append(module)
    twice = {name: sorted(set(modules)) for name, modules in where.items() if len(set(modules)) > 1}
    assert sorted(twice) == sorted(TWICE), {name: twice.get(name) for name in set(twice) ^ set(TWICE)}


def owner(module: str) -> str:
    """What a private name belongs to: a floor of the core, a driver, a protocol, the command line."""
    parts = module.split(".")
    return ".".join(parts[:2]) if parts[0] != "aces_tools" and len(parts) > 1 else parts[0]


@pytest.mark.slow
def test_private_modules_stay_at_home() -> None:
    """No module imports a private module or name of another package."""
    wrong: list[str] = []
    known = {module: is_package for module, is_package, _ in sources()}
    for folder, _ in PACKAGES.values():
        for path in sorted(folder.rglob("*.py")):
            module, is_package = module_name(path)
            for line, name in imports_of(path.read_text(encoding="utf-8"), module, is_package):
                parts = name.split(".")
                private = next(
                    (i for i, part in enumerate(parts) if part.startswith("_") and part[:2] != "__"), None
                )
                if private is None or parts[0] not in PACKAGES or parts[:2] == ["aces_bus", "_lazy"]:
                    continue
                if owner(".".join(parts)) != owner(module) and ".".join(parts[:private]) in known:
                    wrong.append(f"{module}:{line} imports {name}")
    assert not wrong, "\n".join(wrong)
