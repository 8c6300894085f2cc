"""What other systems lack, nothing needs."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


@pytest.mark.slow
def test_verbs_run_without_what_only_unix_has() -> None:
    """Without Unix sockets, pseudo-terminals and Unix modules every verb has its help, and twins are served at TCP ports."""
    done = subprocess.run(
        [sys.executable, "tests/elsewhere.py"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert (done.returncode, done.stdout) == (0, "every command ran\n"), done.stderr
