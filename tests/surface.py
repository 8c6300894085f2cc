"""What the pinned surface lists, and what a file imports of it: read by test_surface.py, test_layout.py and house.py.

1. `golden/surface.txt` has two parts. The *surface* is for users: names with their level, `stable` or `provisional`. The
   *seams* are for the catalogue, the shell, the lab and strangers' plug-ins: modules with names, all provisional.
2. A level is changed by hand in that file; a name that comes is provisional.
3. A module that is imported whole counts by the names that are used of it.
"""

from __future__ import annotations

import ast
import re
from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
GOLDEN = Path("tests", "golden", "surface.txt")
SURFACE_HEAD = "# Surface: what users import"
SEAMS_HEAD = "# Seams: what catalogue, shell, lab and plug-ins import beside it; all are provisional"
#: Level → what it promises.
LEVELS = ("stable", "provisional")


@dataclass
class Pinned:
    """The golden file, read."""

    #: Public module → its names, each with its level.
    surface: dict[str, dict[str, str]] = field(default_factory=dict[str, dict[str, str]])
    #: Module of a seam → its names.
    seams: dict[str, set[str]] = field(default_factory=dict[str, set[str]])
    members: int = 0

    def allows(self, module: str, name: str, *, seams: bool) -> bool:
        """Return whether `from module import name` is one of the surface's (or of the seams', with `seams`)."""
        return name in self.surface.get(module, ()) or (seams and name in self.seams.get(module, ()))


def read_pinned(root: Path = ROOT) -> Pinned:
    """Return what the golden file of a checkout lists."""
    found = Pinned()
    part, module = "", ""
    for line in (root / GOLDEN).read_text(encoding="utf-8").splitlines():
        if line.startswith("#"):
            part = line
        elif line.startswith("aces_"):
            module = line.strip()
        elif line.startswith("      ."):
            found.members += 1
        elif line.startswith("  ") and part == SEAMS_HEAD:
            found.seams.setdefault(module, set()).add(line.strip())
        elif line.startswith("  "):
            level, name = line.split()[:2] if line.split()[0] in LEVELS else ("", line.strip())
            found.surface.setdefault(module, {})[re.split(r"\W", name)[0]] = level
    return found


@cache
def module_path(module: str, root: Path = ROOT) -> Path | None:
    """Return the file of a module of `aces_bus`; None if there is none of this name."""
    path = root.joinpath(*module.split("."))
    if path.with_suffix(".py").is_file():
        return path.with_suffix(".py")
    return path / "__init__.py" if (path / "__init__.py").is_file() else None


def imported_names(source: str, root: Path = ROOT) -> Iterator[tuple[int, str, str]]:
    """Yield line, module and name of all that a source imports of `aces_bus`; the name is "" of a module whose names are not
    used.
    """
    if "aces_bus" not in source:
        return
    tree = ast.parse(source)
    imports = [node for node in statements(tree) if isinstance(node, ast.Import | ast.ImportFrom)]
    used: dict[str, set[str]] = defaultdict(set)
    # What is used of modules is inside expressions, which are most of a file: looked for where one is imported whole.
    for node in ast.walk(tree) if any(_is_of_module(node, root) for node in imports) else ():
        if isinstance(node, ast.Attribute) and (chain := _dotted(node.value)):
            used[chain].add(node.attr)
    for node in imports:
        if isinstance(node, ast.Import):
            for alias in node.names:
                if alias.name.split(".")[0] == "aces_bus":
                    yield from _of_module(node.lineno, alias.name, used[alias.asname or alias.name], root)
        elif not node.level and node.module:
            if node.module.split(".")[0] == "aces_bus":
                for alias in node.names:
                    whole = f"{node.module}.{alias.name}"
                    if module_path(whole, root):
                        yield from _of_module(node.lineno, whole, used[alias.asname or alias.name], root)
                    else:
                        yield node.lineno, node.module, alias.name


def statements(node: ast.AST) -> Iterator[ast.AST]:
    """Yield all statements inside a node, however deep; what is inside an expression is not looked at."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.stmt | ast.ExceptHandler | ast.match_case):
            yield child
            yield from statements(child)


def _is_of_module(node: ast.Import | ast.ImportFrom, root: Path) -> bool:
    """Return whether an import gives a module of `aces_bus` a name."""
    if isinstance(node, ast.Import):
        return any(alias.name.split(".")[0] == "aces_bus" for alias in node.names)
    return (node.module or "").split(".")[0] == "aces_bus" and any(
        module_path(f"{node.module}.{alias.name}", root) is not None for alias in node.names
    )


def _of_module(line: int, module: str, names: Iterable[str], root: Path) -> Iterator[tuple[int, str, str]]:
    """Yield what is used of a module; a name that is a module itself is left to its own import."""
    kept = [name for name in sorted(names) if not module_path(f"{module}.{name}", root)]
    yield from ((line, module, name) for name in kept or [""])


def _dotted(node: ast.expr) -> str:
    """Return a name with dots as it is written, "" for any other expression."""
    if isinstance(node, ast.Name):
        return node.id
    if isinstance(node, ast.Attribute) and (base := _dotted(node.value)):
        return f"{base}.{node.attr}"
    return ""


def outside(pinned: Pinned, source: str, *, seams: bool, root: Path = ROOT) -> list[tuple[int, str, str]]:
    """Return what a source imports of `aces_bus` that is not public, nor a seam where those are allowed."""
    wrong: list[tuple[int, str, str]] = []
    for line, module, name in imported_names(source, root):
        known = module in pinned.surface or (seams and module in pinned.seams)
        if name == "" and known:
            continue
        if name == "*" and module in pinned.surface:
            continue
        if name.startswith("__") and module in pinned.surface:
            continue
        if not pinned.allows(module, name, seams=seams):
            wrong.append((line, module, name))
    return wrong
