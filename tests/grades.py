"""Functions to be read as a stranger and graded: `python tests/grades.py [SEED …]`.

1. 40 functions a seed, of all packages, drawn by the seed alone; the seeds are three parts of the commit's hash.
2. Grades: A reads at once, B reads well, C has to be read twice, D has to be run to be understood. The grader did not
   write them. What is wanted: no D, at most two C in each forty.
"""

from __future__ import annotations

import ast
import random
import subprocess
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from tests.house import PACKAGES, House

NUMBER = 40


def functions(house: House) -> list[tuple[str, str]]:
    """Return place and source of every function that does something, in the order of modules and lines."""
    found: list[tuple[str, str]] = []
    for name, tree in house.trees.items():
        lines = house.texts[name].splitlines()
        package, *rest = name.split(".")
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and _does_something(node):
                first = min([node.lineno, *(decorator.lineno for decorator in node.decorator_list)])
                place = f"{'/'.join([PACKAGES[package], *rest])}:{first} {node.name}"
                found.append((place, "\n".join(lines[first - 1 : node.end_lineno])))
    return found


def _does_something(node: ast.FunctionDef | ast.AsyncFunctionDef) -> bool:
    """Return whether a function has a statement besides its docstring, `...` and `pass`."""
    return any(
        not isinstance(part, ast.Pass)
        and not (isinstance(part, ast.Expr) and isinstance(part.value, ast.Constant))
        for part in node.body
    )


def seeds_of(root: Path) -> list[str]:
    """Return three seeds: parts of the hash of the checked-out commit."""
    done = subprocess.run(["git", "rev-parse", "HEAD"], cwd=root, capture_output=True, text=True, check=True)
    digits = done.stdout.strip()
    return [digits[:12], digits[12:24], digits[24:36]]


def main() -> None:
    """Print the functions that each seed draws."""
    root = Path(__file__).resolve().parents[1]
    every = functions(House(root))
    for seed in sys.argv[1:] or seeds_of(root):
        print(f"======== seed {seed}: {NUMBER} of {len(every)} functions")
        for number, (place, source) in enumerate(random.Random(seed).sample(every, NUMBER), 1):
            print(f"\n-------- {number}. {place}\n{source}")


if __name__ == "__main__":
    main()
