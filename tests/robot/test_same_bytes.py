"""The same seed is the same run to the last byte: whatever the hash seed, and in the compiled build too."""

from __future__ import annotations

import os
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

from hatch_build import ROOTS
from tests.compiled import BUILD, ROOT

#: What a run depends on.
COMPARED = ("aces_bus", "protocols", "devices", "tools")

#: A fifth of a second of the complete Hubo 2+: what was on each bus and when, and the log.
PROGRAM = """
import hashlib, sys, tempfile
from pathlib import Path
from aces_bus.hardware import ListeningNode
from tests.bench.virtual import hubo_run, is_compiled

with tempfile.TemporaryDirectory() as folder:
    log = Path(folder) / "log.csv"
    run = hubo_run(0.2, log, seed=3)
    listeners = [ListeningNode(wire) for wire in run.world.wires.values()]
    with run:
        run.do("enable")
        run.run(0.2)
    text = "".join(f"{at} {frame}\\n" for one in listeners for at, frame in one.received)
    digest = hashlib.sha256(text.encode() + log.read_bytes()).hexdigest()
    print(len(text.splitlines()), len(log.read_bytes()), digest, "compiled" if is_compiled() else "interpreted")
"""


@cache
def outcome(root: Path, hash_seed: int) -> tuple[list[str], str]:
    """Frames, bytes of the log and the digest of both; and whether it was compiled."""
    paths = os.pathsep.join(str(root / name) for name in ROOTS)
    done = subprocess.run(
        [sys.executable, "-P", "-c", PROGRAM],  # -P: not from the folder that pytest was started in
        env={**os.environ, "PYTHONPATH": paths, "PYTHONHASHSEED": str(hash_seed)},
        capture_output=True,
        text=True,
        timeout=300,
        check=True,
    )
    *found, kind = done.stdout.split()
    return found, kind


@pytest.mark.slow
def test_another_hash_seed_is_the_same_run() -> None:
    """Frames, instants and log of the complete robot hang on no order of sets."""
    first, _ = outcome(ROOT, 1)
    assert int(first[0]) > 10_000
    assert outcome(ROOT, 2)[0] == first


def test_the_compiled_build_is_the_same_run() -> None:
    """What `make compiled` makes of these sources puts the same frames on the buses and the same log on disk."""
    if not BUILD.is_dir():
        pytest.skip("there is no compiled build: `make compiled` makes it")
    if changed := [name for name in COMPARED if not is_same(name)]:
        pytest.skip(
            f"the compiled build is of other sources ({', '.join(changed)}): `make compiled` makes it anew"
        )
    found, kind = outcome(BUILD, 1)
    assert kind == "compiled"
    assert found == outcome(ROOT, 1)[0]


def is_same(name: str) -> bool:
    """Whether the build's copy of a folder is what the sources have now."""
    source, copy = ROOT / name, BUILD / name
    files, copies = (
        {path.relative_to(root): path.read_bytes() for path in root.rglob("*.py")} for root in (source, copy)
    )
    return files == copies
