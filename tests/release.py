"""What is handed out: sdist, wheel, and what is in them, in `dist/`. `make release` runs it; nothing is uploaded.

1. sdist and pure wheel are built twice, in folders of their own, and have to be the same bytes: times are those of the last
   commit (`SOURCE_DATE_EPOCH`).
2. The compiled wheel is built where there is a compiler; its bytes depend on that.
3. `twine check --strict` reads the long description; an SBOM (CycloneDX, JSON) lists what the wheel brings with it.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
DIST = ROOT / "dist"


def run(*command: str | Path, cwd: Path = ROOT, **environment: str) -> str:
    """Run a command; its output is shown where it fails, and the release ends."""
    words = [str(word) for word in command]
    done = subprocess.run(
        words,
        cwd=cwd,
        env={**os.environ, **environment},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    if done.returncode:
        raise SystemExit(f"release: $ {' '.join(words)}\n{done.stdout}")
    return done.stdout


def built(folder: Path, source: Path, *, kind: str, wish: str) -> Path:
    """Build one distribution of the sources into `folder`."""
    epoch = run("git", "log", "-1", "--format=%ct").strip()
    run(
        *(sys.executable, "-m", "build", f"--{kind}", "--outdir", folder, source),
        SOURCE_DATE_EPOCH=epoch,
        ACES_BUILD=wish,
    )
    [made] = folder.glob("*.tar.gz" if kind == "sdist" else "*.whl")
    return made


def digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def bill_of_materials(wheel: Path, temporary: Path) -> Path:
    """Write what the wheel brings into an empty environment, as CycloneDX."""
    place = temporary / "empty"
    run(sys.executable, "-m", "venv", place)
    python = place / "bin" / "python"
    run(python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", wheel)
    bill = DIST / f"{wheel.name.split('-py3')[0]}.cdx.json"
    run(
        *(sys.executable, "-m", "cyclonedx_py", "environment", python),
        *("--output-reproducible", "--of", "JSON", "--output-file", bill),
    )
    parts = {part["name"]: part["version"] for part in json.loads(bill.read_text())["components"]}
    if "aces-bus" not in parts or "construct" not in parts:
        raise SystemExit(f"release: {bill.name} does not list aces-bus and what it needs: {sorted(parts)}")
    print(f"{bill.name}: {len(parts)} components")
    return bill


def main() -> None:
    shutil.rmtree(DIST, ignore_errors=True)
    DIST.mkdir()
    with tempfile.TemporaryDirectory(prefix="aces-release-", ignore_cleanup_errors=True) as name:
        temporary = Path(name).resolve()
        for kind in ("sdist", "wheel"):
            first, second = (built(temporary / f"{kind}{n}", ROOT, kind=kind, wish="pure") for n in (1, 2))
            if digest(first) != digest(second):
                raise SystemExit(f"release: {first.name} is not the same when it is built again")
            shutil.copy2(first, DIST)
            print(f"{first.name}: {first.stat().st_size:,} bytes, built twice, sha256 {digest(first)}")
        [wheel] = DIST.glob("*.whl")
        run(sys.executable, "-m", "twine", "check", "--strict", *DIST.iterdir())
        bill_of_materials(wheel, temporary)
        if "--compiled" in sys.argv:
            compiled = built(temporary / "compiled", ROOT, kind="wheel", wish="compiled")
            shutil.copy2(compiled, DIST)
            print(f"{compiled.name}: {compiled.stat().st_size:,} bytes")
    print(f"release: ok, in {DIST.relative_to(ROOT)}/; nothing was uploaded")


if __name__ == "__main__":
    main()
