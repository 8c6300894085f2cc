"""The first hour's script and the first page have the same commands; running it installs, so `make first-hour` does."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SCRIPT = (ROOT / "tests" / "tools" / "first_hour.sh").read_text(encoding="utf-8")


def commands_of_script() -> tuple[list[str], list[str]]:
    """What is typed as the page has it, and what is left out."""
    typed, left_out = [], []
    for line in re.sub(r"^STATUS=\d+ ", "", SCRIPT, flags=re.MULTILINE).splitlines():
        words = shlex.split(line, comments=True) if line.startswith(("says ", "left_out ")) else []
        if words and words[0] == "left_out":
            assert words[2], f"{words[1]}: why?"
            left_out.append(words[1])
        elif words and not line.rstrip().endswith("# instead"):
            typed.append(words[2])
    return typed, left_out


def test_script_and_page_have_the_same_commands() -> None:
    """In the page's order; a command that is left out is there with its reason."""
    page = (ROOT / "README.md").read_text(encoding="utf-8")
    shown = [re.sub(r"\s+#.*$", "", line) for line in re.findall(r"^\$ (.*)$", page, re.MULTILINE)]
    typed, left_out = commands_of_script()
    assert [one for one in shown if one not in left_out] == typed
    assert set(left_out) <= set(shown)
