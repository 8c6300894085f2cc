"""The size and shape of the house, as figures: `python tests/house.py [FOLDER]`; test_house.py holds budgets.

1. Everything is read from the syntax tree, but what the smallest use loads (a process of its own) and D401 (ruff).
2. Imports count wherever they stand: inside a function and under TYPE_CHECKING, too.
"""

from __future__ import annotations

import ast
import json
import re
import subprocess
import sys
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from tests.surface import outside, read_pinned

#: Import package → its folder.
PACKAGES = {
    "aces_bus": "aces_bus",
    "aces_protocols": "protocols/aces_protocols",
    "aces_devices": "devices/aces_devices",
    "aces_tools": "tools/aces_tools",
    "aces_lab": "tools/aces_lab",
}
#: What ring 0, the kernel, consists of.
KERNEL = (
    "errors",
    "frames",
    *(f"protocol.{room}" for room in ("declare", "plan", "generate", "live", "reference")),
)
#: Folders of benchmarks, which no count includes.
BENCHMARKS = ("tools/aces_tools/benchmarks", "aces_bus/testing/bench.py")
OPENINGS = ("What", "Whether", "How", "Where")
#: Declares, scans and encodes one CAN message.
SMALLEST = """
import sys
from construct import Int16sl, Struct
from aces_bus import Frame
from aces_bus.protocol import Protocol
demo = Protocol("demo", link="can", source="none")
demo.message("M", id=0x10, payload=Struct("x" / Int16sl), source="none")
assert [r.x for r in demo.scanner().feed([Frame(0x10, b"\\x01\\x00")])] == [1]
demo.encode("M", x=2)
print(sum(name.split(".")[0].startswith("aces_") for name in sys.modules), "can" in sys.modules, "numpy" in sys.modules)
"""


class House:
    """The sources of a checkout, parsed once."""

    def __init__(self, root: Path) -> None:
        self.root = root
        #: Module → its syntax tree; packages are named without `__init__`.
        self.trees: dict[str, ast.Module] = {}
        self.texts: dict[str, str] = {}
        for package, folder in PACKAGES.items():
            for path in sorted((root / folder).rglob("*.py")):
                if path.relative_to(root).as_posix().startswith(BENCHMARKS):
                    continue
                parts = [package, *path.relative_to(root / folder).with_suffix("").parts]
                name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
                self.texts[name] = path.read_text(encoding="utf-8")
                self.trees[name] = ast.parse(self.texts[name])
        self.is_package = {name for name in self.trees if (root / self._path(name)).with_suffix("").is_dir()}

    @staticmethod
    def _path(name: str) -> Path:
        package, *rest = name.split(".")
        return Path(PACKAGES[package], *rest)

    # ------------------------------------------------------------------ size

    def statements(self) -> dict[str, int]:
        """Return AST statements, docstrings left out, by import package, of the kernel, and of all."""
        found: dict[str, int] = defaultdict(int)
        for name, tree in self.trees.items():
            number = sum(isinstance(node, ast.stmt) and not _is_text(node) for node in ast.walk(tree))
            package, _, rest = name.partition(".")
            found[package] += number
            found["all"] += number
            if package == "aces_bus" and any(rest == room or rest.startswith(f"{room}.") for room in KERNEL):
                found["kernel"] += number
        return dict(found)

    def any_words(self) -> int:
        """Return how often the word `Any` stands in the sources."""
        return sum(len(re.findall(r"\bAny\b", text)) for text in self.texts.values())

    # ------------------------------------------------------------------ shape

    def imports(self, name: str) -> Iterator[str]:
        """Yield the modules of ours that a module imports."""
        package = name.split(".") if name in self.is_package else name.split(".")[:-1]
        for node in ast.walk(self.trees[name]):
            if isinstance(node, ast.Import):
                yield from (known for alias in node.names if (known := self._known(alias.name)))
            elif isinstance(node, ast.ImportFrom):
                start = package[: len(package) - node.level + 1] if node.level else []
                base = ".".join([*start, *([node.module] if node.module else [])])
                for alias in node.names:
                    if known := self._known(f"{base}.{alias.name}"):
                        yield known

    def _known(self, name: str) -> str | None:
        while name and name not in self.trees:
            name = name.rpartition(".")[0]
        return name or None

    def knot(self) -> list[str]:
        """Return the largest set of modules of `aces_bus` that import one another, directly or not."""
        inside = {name for name in self.trees if name.startswith("aces_bus")}
        graph = {name: {other for other in self.imports(name) if other in inside} - {name} for name in inside}
        return max(_strong(graph), key=len, default=[])

    def node_readers(self) -> list[str]:
        """Return the modules that import classes of plan nodes, or ask a node's class."""
        nodes = "aces_bus.protocol.plan.nodes"
        classes = {node.name for node in self.trees[nodes].body if isinstance(node, ast.ClassDef)}
        found: list[str] = []
        for name, tree in self.trees.items():
            if name == nodes or nodes not in set(self.imports(name)):
                continue
            aliases = {
                alias.asname or alias.name
                for node in ast.walk(tree)
                if isinstance(node, ast.ImportFrom)
                for alias in node.names
                if alias.name in classes or alias.name == "nodes"
            }
            for node in ast.walk(tree):
                asked: ast.expr | ast.pattern | None = None
                if (
                    isinstance(node, ast.Call)
                    and isinstance(node.func, ast.Name)
                    and node.func.id == "isinstance"
                ):
                    asked = node.args[1]
                elif isinstance(node, ast.MatchClass):
                    asked = node.cls
                if asked is not None and any(
                    isinstance(part, ast.Name) and part.id in aliases for part in ast.walk(asked)
                ):
                    found.append(name)
                    break
        return found

    def lone_bases(self) -> list[str]:
        """Return the classes that exactly one class inherits from."""
        defined: dict[str, str] = {}
        heirs: dict[str, int] = defaultdict(int)
        for name, tree in self.trees.items():
            for node in ast.walk(tree):
                if isinstance(node, ast.ClassDef):
                    defined[node.name] = name
                    for base in node.bases:
                        inner = base.value if isinstance(base, ast.Subscript) else base
                        word = inner.attr if isinstance(inner, ast.Attribute) else getattr(inner, "id", "")
                        heirs[word] += 1
        return sorted(f"{module}.{word}" for word, module in defined.items() if heirs[word] == 1)

    def inside_tests(self) -> list[str]:
        """Return the test files that import something of `aces_bus` that is neither public nor a seam."""
        pinned = read_pinned(self.root)
        return [
            path.relative_to(self.root).as_posix()
            for path in sorted((self.root / "tests").rglob("test_*.py"))
            if outside(pinned, path.read_text(encoding="utf-8"), seams=True, root=self.root)
        ]

    def public_names(self) -> int:
        """Return how many names the golden surface lists, members not counted."""
        return sum(len(names) for names in read_pinned(self.root).surface.values())

    def seams(self) -> int:
        """Return how many names the catalogue, the shell, the lab and plug-ins may import beside the public ones."""
        return sum(len(names) for names in read_pinned(self.root).seams.values())

    def members(self) -> int:
        """Return how many members the public names have."""
        return read_pinned(self.root).members

    # ------------------------------------------------------------------ voice

    def docstrings(self) -> dict[str, int]:
        """Return how many functions have a docstring, and how many begin with a riddle (`OPENINGS`)."""
        found = {"functions with a docstring": 0, **dict.fromkeys(OPENINGS, 0)}
        for tree in self.trees.values():
            for node in ast.walk(tree):
                if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and (
                    text := ast.get_docstring(node)
                ):
                    found["functions with a docstring"] += 1
                    if (word := text.split()[0]) in found:
                        found[word] += 1
        return found

    def not_imperative(self) -> int:
        """Return how many docstrings ruff's D401 complains of."""
        ruff = Path(sys.executable).with_name("ruff")
        folders = [str(self.root / folder) for folder in PACKAGES.values() if (self.root / folder).exists()]
        done = subprocess.run(
            [ruff, "check", "--isolated", "--select", "D401", "--output-format", "json", *folders],
            capture_output=True,
            text=True,
            check=False,
        )
        return len(json.loads(done.stdout))

    def modules_of_smallest_use(self) -> str:
        """Return how many of our modules the smallest use loads, and whether python-can and NumPy are among the rest."""
        done = subprocess.run(
            [sys.executable, "-c", SMALLEST], capture_output=True, text=True, check=True, cwd=self.root
        )
        return done.stdout.strip()


def _is_text(node: ast.stmt) -> bool:
    return (
        isinstance(node, ast.Expr)
        and isinstance(node.value, ast.Constant)
        and isinstance(node.value.value, str)
    )


def _strong(graph: dict[str, set[str]]) -> list[list[str]]:
    """Return the strongly connected components of a graph (Tarjan, without recursion)."""
    index: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    found: list[list[str]] = []
    for root in graph:
        work = [(root, iter(sorted(graph[root])))] if root not in index else []
        if work:
            index[root] = low[root] = len(index)
            stack.append(root)
        while work:
            node, rest = work[-1]
            for other in rest:
                if other not in index:
                    index[other] = low[other] = len(index)
                    stack.append(other)
                    work.append((other, iter(sorted(graph[other]))))
                    break
                if other in stack:
                    low[node] = min(low[node], index[other])
            else:
                work.pop()
                if work:
                    low[work[-1][0]] = min(low[work[-1][0]], low[node])
                if low[node] == index[node]:
                    at = stack.index(node)
                    found.append(stack[at:])
                    del stack[at:]
    return found


def main() -> None:
    """Print every figure of a checkout."""
    house = House(Path(sys.argv[1]).resolve() if sys.argv[1:] else Path(__file__).resolve().parents[1])
    for ring, number in house.statements().items():
        print(f"statements {ring}: {number:,}")
    print(f"our modules of the smallest use, python-can, NumPy: {house.modules_of_smallest_use()}")
    print(f"public names: {house.public_names()}, members {house.members():,}, seams: {house.seams()}")
    print(f"knot of imports: {len(house.knot())} files")
    print(f"files that ask nodes for their class: {len(house.node_readers())}")
    print(f"bases with one subclass: {len(house.lone_bases())}")
    print(f"test files that import the inside: {len(house.inside_tests())}")
    print(f"Any: {house.any_words():,}")
    for word, number in house.docstrings().items():
        print(f"docstrings, {word}: {number:,}")
    print(f"D401: {house.not_imperative():,}")


if __name__ == "__main__":
    main()
