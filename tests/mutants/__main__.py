"""`make mutants`: plant faults, run the tests that run their lines, name those that no test notices.

1. What is drawn depends on the sources, the seed and the area alone: the same commit gives the same mutants.
2. Tests run in a copy of the tree (build/mutants/tree), in forks of one session; a survivor on a line that runs while
   modules are imported is tried once more in a process of its own.
3. What is called equivalent is in `equivalent.toml`, each with its argument; it counts neither as killed nor as survived.
"""

from __future__ import annotations

import argparse
import ast
import json
import os
import random
import re
import shutil
import subprocess
import sys
import tomllib
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from .lookup import Lines
from .operators import KINDS, ROOT, Mutant, mutants_of
from .serve import MARK

BUILD = ROOT / "build" / "mutants"
#: The copy that tests run in; another name lets two runs stand side by side.
TREE = BUILD / os.environ.get("ACES_MUTANTS_TREE", "tree")
PACKAGES = (
    "aces_bus",
    "protocols/aces_protocols",
    "devices/aces_devices",
    "tools/aces_tools",
    "tools/aces_lab",
)
#: What an area is: files and folders.
AREAS: dict[str, tuple[str, ...]] = {
    "stops": (
        "aces_bus/controller/door.py",
        "aces_bus/controller/guard.py",
        "aces_bus/controller/limiter.py",
        "aces_bus/controller/line.py",
        "aces_bus/controller/supervisor.py",
        "aces_bus/device/stopping.py",
        "aces_bus/robot/run.py",
        "aces_bus/robot/run_end.py",
        "aces_bus/robot/run_faults.py",
        "aces_bus/robot/runner.py",
    ),
    "declare": ("aces_bus/protocol/declare",),
    "plan": ("aces_bus/protocol/plan", "aces_bus/protocol/reference.py"),
    "generate": ("aces_bus/protocol/generate",),
    "live": ("aces_bus/protocol/live",),
    "columns": ("aces_bus/protocol/columns", "aces_bus/frame_table.py"),
    "exchange": ("aces_bus/protocol/exchange", "tools/aces_lab/exchange"),
    "recordings": ("aces_bus/recordings", "tools/aces_lab/formats"),
    "export": ("aces_bus/export",),
    "hardware": ("aces_bus/hardware",),
    "device": ("aces_bus/device",),
    "controller": ("aces_bus/controller", "aces_bus/state", "aces_bus/runtime", "aces_bus/kinematics"),
    "robot": ("aces_bus/robot",),
    "devices": ("devices/aces_devices",),
    "tools": ("tools/aces_tools",),
    "testing": ("aces_bus/testing", "aces_bus/access"),
    "lab": ("tools/aces_lab",),
}
#: What `--area all` draws from, in equal parts: "stops" is drawn by itself.
ALL = tuple(area for area in AREAS if area != "stops")
#: Time that the tests of one mutant may take together (s), as recorded: half of it is the recording's own.
MOST_S = 60.0
#: What they may take with a fault (s), besides three times what was recorded: a loop may have lost its end.
MORE_S = 5.0


@dataclass
class Tried:
    """One mutant and what became of it."""

    area: str
    mutant: Mutant
    tests: list[str]
    is_imported: bool
    limit_s: float
    result: str = ""
    test: str = ""
    why: str = ""


def sources(paths: Iterable[str]) -> Iterator[str]:
    """Yield the Python files of files and folders, in order."""
    for path in paths:
        whole = ROOT / path
        found = [whole] if whole.is_file() else sorted(whole.rglob("*.py"))
        yield from (str(one.relative_to(ROOT)) for one in found)


def mutants_in(paths: Iterable[str]) -> list[Mutant]:
    """All mutants of files and folders."""
    return [one for path in sources(paths) for one in mutants_of(path, (ROOT / path).read_bytes())]


def draw(mutants: list[Mutant], count: int, seed: str) -> list[Mutant]:
    """Draw without repetition: a kind of fault first, each as likely, then one of that kind."""
    random_of = random.Random(seed)
    left = {kind: [one for one in mutants if one.kind == kind] for kind in KINDS}
    drawn: list[Mutant] = []
    while len(drawn) < count and any(left.values()):
        kind = random_of.choice([kind for kind in KINDS if left[kind]])
        drawn.append(left[kind].pop(random_of.randrange(len(left[kind]))))
    return drawn


def changed_lines(revision: str) -> dict[str, set[int]]:
    """By file, the lines that are not as they were at a revision."""
    arguments = ["git", "diff", "--unified=0", "--no-color", revision, "--", *PACKAGES]
    shown = subprocess.run(arguments, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    found: dict[str, set[int]] = {}
    path = ""
    for line in shown.splitlines():
        if line.startswith("+++ "):
            path = line[6:] if line.startswith("+++ b/") else ""
        elif path and (at := re.match(r"@@ -\S+ \+(\d+)(?:,(\d+))? @@", line)):
            first, count = int(at[1]), int(at[2] or "1")
            found.setdefault(path, set()).update(range(first, first + count))
    return found


def functions_of(path: str) -> list[tuple[int, int]]:
    """First and last lines of the functions of a file, inner ones last."""
    tree = ast.parse((ROOT / path).read_bytes())
    found = [one for one in ast.walk(tree) if isinstance(one, (ast.FunctionDef, ast.AsyncFunctionDef))]
    return sorted((one.lineno, one.end_lineno or one.lineno) for one in found)


def copy_tree() -> None:
    """Make the copy that tests run in: what git knows of the work tree, as it is now."""
    shutil.rmtree(TREE, ignore_errors=True)
    listed = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    for name in filter(None, listed.split("\0")):
        if (ROOT / name).is_file():
            (TREE / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, TREE / name)
    shared, beside = ROOT.parent / "shared", TREE.parent / "shared"
    if shared.is_dir() and not beside.exists():
        beside.symlink_to(shared)


def environment(**more: str) -> dict[str, str]:
    """The environment of tests in the copy: its packages come first, in programs that they start, too."""
    roots = [TREE, *(TREE / name for name in ("protocols", "devices", "tools"))]
    return {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, roots)), "ACES_SHARE": "1", **more}


def pytest_of(*arguments: str) -> list[str]:
    """The command that runs tests in the copy."""
    plain = ["-n", "0", "-q", "-p", "no:cacheprovider", "--benchmark-disable", "-m", "not slow"]
    return [sys.executable, "-m", "pytest", *plain, *arguments]


def record(name: str, tests: list[str]) -> None:
    """Run tests in the copy and record which line each of them runs, as `build/mutants/NAME.sqlite`."""
    path = BUILD / f"{name}.sqlite"
    path.unlink(missing_ok=True)
    revision = subprocess.run(
        ["git", "rev-parse", "HEAD"], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout
    path.with_suffix(".root").write_text(str(TREE), encoding="utf-8")
    path.with_suffix(".revision").write_text(revision, encoding="utf-8")
    command = pytest_of("-p", "tests.mutants.lines", *tests)
    subprocess.run(command, cwd=TREE, env=environment(ACES_LINES=str(path)), check=False)


def try_all(tried: list[Tried]) -> None:
    """Run the tests of each mutant in forks of one session; then those that survived in processes of their own."""
    asked = [one for one in tried if one.tests and not one.result]
    files = sorted({test.partition("::")[0] for one in asked for test in one.tests})
    if not files:
        return
    path = BUILD / f"{TREE.name}-asked.json"
    listed = [
        {
            "file": str(TREE / one.mutant.path),
            "source": one.mutant.of((ROOT / one.mutant.path).read_bytes()).decode(),
            "tests": one.tests,
            "limit_s": one.limit_s,
        }
        for one in asked
    ]
    path.write_text(json.dumps(listed), encoding="utf-8")
    arguments = BUILD / f"{TREE.name}-files.txt"
    arguments.write_text("\n".join(files), encoding="utf-8")
    command = pytest_of("-p", "tests.mutants.serve", f"@{arguments}")
    with subprocess.Popen(
        command,
        cwd=TREE,
        env=environment(ACES_MUTANTS=str(path)),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    ) as served:
        assert served.stdout is not None
        said: list[str] = []
        for line in served.stdout:
            said = [*said[-40:], line]
            if MARK not in line:
                continue
            answer: dict[str, Any] = json.loads(line.partition(MARK)[2])
            one = asked[answer["number"]]
            one.result, one.test = answer["status"], answer["test"]
            if one.result == "survived" and one.is_imported:
                confirm(one)
            show(one)
    if any(not one.result for one in asked):
        raise SystemExit(f"the session of the tests has ended early:\n{''.join(said)}")


def confirm(one: Tried) -> None:
    """Try a mutant in a process of its own: what is made while modules are imported is made with the fault there."""
    path = TREE / one.mutant.path
    source = (ROOT / one.mutant.path).read_bytes()
    arguments = BUILD / f"{TREE.name}-tests.txt"
    arguments.write_text("\n".join(one.tests), encoding="utf-8")
    path.write_bytes(one.mutant.of(source))
    try:
        done = subprocess.run(
            pytest_of("-x", f"@{arguments}"),
            cwd=TREE,
            env=environment(),
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            timeout=30 + 4 * one.limit_s,
            check=False,
        )
        if done.returncode:
            failed = re.search(r"^(?:FAILED|ERROR) (\S+)", done.stdout, re.MULTILINE)
            one.result, one.test = "failed", failed[1] if failed else "an import"
    except subprocess.TimeoutExpired:
        one.result = "timed out"
    finally:
        path.write_bytes(source)


def show(one: Tried) -> None:
    """Print a line of what became of a mutant."""
    mutant = one.mutant
    word = {"survived": "SURVIVED", "no test": "SURVIVED, no test runs it"}.get(one.result, one.result)
    where = f"{mutant.path}:{mutant.line} {mutant.scope}".rstrip()
    print(
        f"{word:10} {where}  {mutant.name.partition(' ')[2]}  [{one.test or f'{len(one.tests)} tests'}]",
        flush=True,
    )


def equivalents() -> dict[str, str]:
    """Mutants that change nothing that can be seen, by name, each with its argument."""
    path = Path(__file__).with_name("equivalent.toml")
    found: dict[str, str] = tomllib.loads(path.read_text(encoding="utf-8"))
    return found


def chosen(arguments: argparse.Namespace) -> list[tuple[str, Mutant]]:
    """The mutants that are asked for, each with its area."""
    seed, count = arguments.seed or head()[:8], arguments.count
    if arguments.at:
        path, _, line = arguments.at.partition(":")
        return [("", one) for one in mutants_in([path]) if not line or one.line == int(line)]
    if arguments.since:
        changed = changed_lines(arguments.since)
        of = [one for path, lines in sorted(changed.items()) if path.endswith(".py") and (ROOT / path).exists()
              for one in mutants_in([path]) if one.line in lines]  # fmt: skip
        return [("changed", one) for one in draw(of, count, seed)]
    areas = [name for area in arguments.area for name in (ALL if area == "all" else [area])]
    found: list[tuple[str, Mutant]] = []
    for number, area in enumerate(areas):
        share = count // len(areas) + (number < count % len(areas))
        found += [(area, one) for one in draw(mutants_in(AREAS[area]), share, f"{seed} {area}")]
    return found


def head() -> str:
    """The commit that is checked out."""
    return subprocess.run(
        ["git", "rev-parse", "HEAD"], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout.strip()


def table(tried: list[Tried]) -> str:
    """Count by area: drawn, killed, equivalent, survived; and the share that was killed of those that are faults."""
    lines = [f"{'area':12} drawn killed equivalent survived  share"]
    for area in [*dict.fromkeys(one.area for one in tried), "all"]:
        of = Counter(one.result for one in tried if area in (one.area, "all"))
        drawn, same = of.total(), of["equivalent"]
        survived = of["survived"] + of["no test"]
        killed = drawn - same - survived
        share = killed / (drawn - same) if drawn > same else 1.0
        lines.append(f"{area or 'here':12} {drawn:5} {killed:6} {same:10} {survived:8} {share:6.1%}")
    return "\n".join(lines)


def main() -> int:
    """Draw, try, print; 1 when a mutant survived."""
    parser = argparse.ArgumentParser(prog="make mutants", description=(__doc__ or "").splitlines()[0])
    parser.add_argument(
        "--area", nargs="+", default=["all"], choices=[*AREAS, "all"], help="where (default: all)"
    )
    parser.add_argument("--since", metavar="REVISION", help="on lines that have changed since")
    parser.add_argument("--at", metavar="FILE[:LINE]", help="all mutants of a line or a file")
    parser.add_argument(
        "--count", type=int, default=225, metavar="N", help="how many are drawn (default: 225)"
    )
    parser.add_argument("--seed", help="what to draw from (default: the commit's hash)")
    parser.add_argument("--list", action="store_true", help="print what is drawn, try nothing")
    parser.add_argument(
        "--record", action="store_true", help="record anew which test runs which line (half an hour)"
    )
    parser.add_argument(
        "--also", nargs="+", default=[], metavar="TEST", help="record these tests besides, which are new"
    )
    parser.add_argument(
        "--tests", nargs="+", default=[], metavar="TEST", help="run these tests, whatever lines they run"
    )
    arguments = parser.parse_args()
    BUILD.mkdir(parents=True, exist_ok=True)
    mutants = chosen(arguments)
    if arguments.list:
        for _, listed in mutants:
            print(f"{listed.path}:{listed.line} {listed.name.partition(' ')[2]}")
        return 0
    copy_tree()
    if arguments.record or not (arguments.tests or list(BUILD.glob("*.sqlite"))):
        for old in BUILD.glob("*.sqlite"):
            old.unlink()
        record("lines", [])
    if arguments.also:
        record(f"more-{len(list(BUILD.glob('*.sqlite')))}", arguments.also)
    lines, known = Lines(BUILD), equivalents()
    tried: list[Tried] = []
    for area, mutant in mutants:
        inner = [one for one in functions_of(mutant.path) if one[0] <= mutant.line <= one[1]] or [(0, 0)]
        tests, is_imported = lines.tests_of(mutant.path, mutant.line, *inner[-1])
        if arguments.tests:
            tests = arguments.tests
        tests = list(within(tests, lines.seconds))
        limit_s = MORE_S + 3 * sum(lines.seconds.get(test, 0.1) for test in tests)
        entry = Tried(area, mutant, tests, is_imported, limit_s)
        if mutant.name in known:
            entry.result, entry.why = "equivalent", known[mutant.name]
        elif not tests:
            entry.result = "no test"
            show(entry)
        tried.append(entry)
    try_all(tried)
    print("\n" + table(tried))
    survived = [one for one in tried if one.result in ("survived", "no test")]
    if survived:
        print("\nsurvived:")
        for each in survived:
            show(each)
    return 1 if survived else 0


def within(tests: list[str], seconds: dict[str, float]) -> Iterator[str]:
    """Yield tests as long as their processor time fits in what one mutant may take."""
    used = 0.0
    for test in tests:
        used += seconds.get(test, 0.0)
        if used > MOST_S:
            return
        yield test


if __name__ == "__main__":
    raise SystemExit(main())
