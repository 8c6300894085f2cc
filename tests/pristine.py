"""The pristine check: what a user gets from the wheel alone, in an empty environment, away from the repository.

1. Nothing of the repository is reachable while the installed package runs: other folder, no PYTHONPATH, only the
   core dependencies.
2. Each failure names the step, the command and its output, and ends with status 1.

An editable install hides a file that the wheel lacks, a dependency that only the development tools bring, and an entry
point that nothing installs. Sources go through the sdist, as an index would hand them out: sdist → wheel → empty
environment → import, `aces`. Run by `make check`; not a test that pytest collects.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
import tomllib
import zipfile
from pathlib import Path
from typing import Any, NoReturn

ROOT = Path(__file__).resolve().parent.parent
#: What a user imports, said here again so that a package dropped from pyproject.toml is missed.
PACKAGES = (
    "aces_bus",
    "protocols/aces_protocols",
    "devices/aces_devices",
    "tools/aces_tools",
    "tools/aces_lab",
)
SHIPPED = {".py", ".pyi", ".typed", ".toml"}
#: What it puts where shells and man look.
INSTALLED = {
    "share/bash-completion/completions/aces",
    "share/zsh/site-functions/_aces",
    "share/fish/vendor_completions.d/aces.fish",
    "share/man/man1/aces.1",
    "share/man/man1/aces-spec-check.1",
}

# Runs inside the empty environment: every package comes from there and has its docstring.
IMPORTS = """
import importlib, pathlib, sys
inside = pathlib.Path(sys.prefix).resolve()
for name in {packages!r}:
    module = importlib.import_module(name)
    where = pathlib.Path(module.__file__).resolve()
    assert inside in where.parents, f"{{name}} was imported from {{where}}, not from the wheel"
    assert module.__doc__, f"{{name}} has no docstring"
"""


def fail(step: str, detail: str) -> NoReturn:
    sys.stdout.flush()
    print(f"pristine: FAILED: {step}\n{detail.rstrip()}", file=sys.stderr)
    raise SystemExit(1)


def run(step: str, *command: str | Path, cwd: Path, timeout_s: float = 60) -> str:
    """Run a command away from the caller's Python settings and return its standard output."""
    words = [str(word) for word in command]
    environment = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
    environment.pop("VIRTUAL_ENV", None)
    environment["ACES_BUILD"] = "pure"  # the compiled wheel takes minutes; `make release` builds it
    environment["PYTHONUTF8"] = "1"  # so that output can be read back whatever the locale
    print(f"pristine: {step}", flush=True)
    try:
        done = subprocess.run(
            words,
            cwd=cwd,
            env=environment,
            capture_output=True,
            encoding="utf-8",
            errors="replace",
            timeout=timeout_s,
        )
    except subprocess.TimeoutExpired:
        fail(step, f"$ {' '.join(words)}\nno end after {timeout_s:g} s")
    except OSError as error:
        fail(step, f"$ {' '.join(words)}\n{error}")
    if done.returncode:
        fail(step, f"$ {' '.join(words)}\n{done.stdout}{done.stderr}\nexit status {done.returncode}")
    return done.stdout


def the_one(step: str, folder: Path, pattern: str) -> Path:
    found = sorted(folder.glob(pattern))
    if len(found) != 1:
        fail(step, f"expected one {pattern}, found {[path.name for path in found]}")
    return found[0]


def check_contents(wheel: Path, sources: list[Path]) -> None:
    """The wheel holds the import packages whole, and nothing else that could land in site-packages."""
    step = "look into the wheel"
    print(f"pristine: {step}", flush=True)
    names = set(zipfile.ZipFile(wheel).namelist())
    data = {name.partition(".data/data/")[2] for name in names if ".data/data/" in name}
    if missing := sorted(INSTALLED - data):
        fail(step, "the wheel does not install " + ", ".join(missing))
    top = {name.split("/")[0] for name in names if ".dist-info/" not in name and ".data/" not in name}
    wanted = {source.name for source in sources}
    if top != wanted:
        fail(step, f"top level names are {sorted(top)}, not {sorted(wanted)}")
    expected = {
        path.relative_to(source.parent).as_posix()
        for source in sources
        for path in source.rglob("*")
        if path.suffix in SHIPPED and "__pycache__" not in path.parts
    }
    expected |= {f"{name}/py.typed" for name in wanted}
    if missing := sorted(expected - names):
        fail(step, "the wheel lacks\n  " + "\n  ".join(missing) + "\n(ignored by .gitignore, perhaps)")


def check(temporary: Path) -> None:
    project: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    sources = [ROOT / package for package in PACKAGES]
    protocols: list[str] = list(project["project"]["entry-points"]["aces_bus.protocols"])

    built, environment, elsewhere = temporary / "built", temporary / "empty", temporary / "elsewhere"
    elsewhere.mkdir()
    pip = ("-m", "pip", "--disable-pip-version-check", "--quiet")

    run("build the sdist", sys.executable, "-m", "hatchling", "build", "-t", "sdist", "-d", built, cwd=ROOT)
    sdist = the_one("build the sdist", built, "*.tar.gz")
    run(
        "build the wheel from the sdist",
        *(sys.executable, *pip, "wheel", "--no-deps", "--wheel-dir", built, sdist),
        cwd=elsewhere,
        timeout_s=600,
    )
    wheel = the_one("build the wheel from the sdist", built, "*.whl")
    check_contents(wheel, sources)

    run("make an empty environment", sys.executable, "-m", "venv", environment, cwd=elsewhere, timeout_s=300)
    scripts = environment / ("Scripts" if os.name == "nt" else "bin")
    python, aces = scripts / "python", scripts / "aces"
    run("install the wheel", python, *pip, "install", wheel, cwd=elsewhere, timeout_s=600)
    run("look for conflicts", python, *pip, "check", cwd=elsewhere)
    imports = IMPORTS.format(packages=[source.name for source in sources])
    run("import the packages", python, "-I", "-W", "error::SyntaxWarning", "-c", imports, cwd=elsewhere)

    version = wheel.name.split("-")[1]
    if version not in (printed := run("aces --version", aces, "--version", cwd=elsewhere)):
        fail("aces --version", f"printed {printed!r}, the wheel says {version}")
    if not run("aces --help", aces, "--help", cwd=elsewhere).strip():
        fail("aces --help", "printed nothing")
    printed = run("aces protocols", aces, "protocols", cwd=elsewhere)
    if missing := sorted(set(protocols) - set(re.findall(r"\w+", printed))):
        fail("aces protocols", f"does not name {', '.join(missing)}; it printed\n{printed}")


def main() -> None:
    with tempfile.TemporaryDirectory(prefix="aces-pristine-", ignore_cleanup_errors=True) as temporary:
        check(Path(temporary).resolve())
    print("pristine: ok")


if __name__ == "__main__":
    main()
