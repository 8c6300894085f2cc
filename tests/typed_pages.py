"""The Python of pages, as programs that pyright reads: what a page shows is typed as users' own code would be.

python tests/typed_pages.py [PYTHON]     # of the environment that has the packages; run by `make types`
"""

from __future__ import annotations

import doctest
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PAGES = ("docs/python.md",)
FOLDER = ROOT / "build" / "typed"
#: What a prompt shows and a program would not say.
HEAD = "# pyright: reportUnusedExpression=false\n"


def program_of(page: str) -> str:
    """The examples of a page, one after another, as one program."""
    text = (ROOT / page).read_text(encoding="utf-8")
    return HEAD + doctest.script_from_examples(re.sub(r"^```.*$", "", text, flags=re.MULTILINE))


def main() -> int:
    FOLDER.mkdir(parents=True, exist_ok=True)
    paths: list[str] = []
    for page in PAGES:
        path = FOLDER / f"{Path(page).stem}_page.py"
        path.write_text(program_of(page), encoding="utf-8")
        paths.append(str(path))
    python = sys.argv[1] if len(sys.argv) > 1 else sys.executable
    return subprocess.run(
        ["pyright", "--project", ".", "--warnings", "--pythonpath", python, *paths], cwd=ROOT
    ).returncode


if __name__ == "__main__":
    sys.exit(main())
