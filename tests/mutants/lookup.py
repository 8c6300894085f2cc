"""Which tests run a line: what `tests.mutants.lines` has recorded, carried over to sources that have changed since.

1. A recording lies beside the sources that it was made of; a line of today is looked up where it was then.
2. A line that is new, or that ran only while modules were imported, has the tests of the lines around it in its function,
   then those of its file.
"""

from __future__ import annotations

import difflib
import subprocess
from collections.abc import Iterable
from functools import cache
from pathlib import Path

import coverage

from .operators import ROOT


class Recording:
    """One recording: the data file, and the revision whose lines it names."""

    def __init__(self, data_file: Path) -> None:
        self.data = coverage.CoverageData(str(data_file))
        self.data.read()
        self.revision = data_file.with_suffix(".revision").read_text(encoding="utf-8").strip()
        root = data_file.with_suffix(".root").read_text(encoding="utf-8").strip()
        self.files = {str(Path(one).relative_to(root)): one for one in self.data.measured_files()}
        self.seconds: dict[str, float] = {}
        for line in data_file.with_suffix(".seconds").read_text(encoding="utf-8").splitlines():
            seconds, _, test = line.partition("\t")
            self.seconds[test] = float(seconds)
        self._by_line = cache(self._tests_by_line)
        self._lines_then = cache(self._carry)

    def _tests_by_line(self, path: str) -> dict[int, list[str]]:
        if path not in self.files:
            return {}
        found = self.data.contexts_by_lineno(self.files[path])
        return {line: list(tests) for line, tests in found.items()}

    def _carry(self, path: str) -> dict[int, int]:
        """Lines of today, and which they were when the recording was made."""
        now = (ROOT / path).read_text(encoding="utf-8").splitlines()
        shown = subprocess.run(
            ["git", "show", f"{self.revision}:{path}"], cwd=ROOT, capture_output=True, text=True, check=False
        )
        then = shown.stdout.splitlines()
        blocks = difflib.SequenceMatcher(None, then, now, autojunk=False).get_matching_blocks()
        return {new + n + 1: old + n + 1 for old, new, size in blocks for n in range(size)}

    def tests_of(self, path: str, lines: Iterable[int]) -> list[str]:
        """The tests that ran one of these lines of today; "" for an import."""
        by_line, then = self._by_line(path), self._lines_then(path)
        found: dict[str, None] = {}
        for line in lines:
            found.update(dict.fromkeys(by_line.get(then.get(line, 0), ())))
        return list(found)

    def tests_of_file(self, path: str) -> list[str]:
        """The tests that ran any line of a file."""
        return list(dict.fromkeys(test for tests in self._by_line(path).values() for test in tests))


class Lines:
    """All recordings in a folder."""

    def __init__(self, folder: Path) -> None:
        self.recordings = [Recording(path) for path in sorted(folder.glob("*.sqlite"))]
        self.seconds: dict[str, float] = {}
        for recording in self.recordings:
            self.seconds.update(recording.seconds)

    def tests_of(self, path: str, line: int, first: int, last: int) -> tuple[list[str], bool]:
        """The tests that run a line, those nearest and cheapest first; and whether it runs while modules are imported, too.

        `first` and `last` are the lines of its function, 0 for what is outside of all.
        """
        found = self._of(path, [line])
        is_imported = not first or "" in found
        if not any(found) and first:
            found = self._of(path, range(first + 1, last + 1))
        if not any(found):
            found = list(dict.fromkeys(test for one in self.recordings for test in one.tests_of_file(path)))
        return self._ordered(path, [test for test in found if test]), is_imported

    def _of(self, path: str, lines: Iterable[int]) -> list[str]:
        lines = list(lines)
        return list(dict.fromkeys(test for one in self.recordings for test in one.tests_of(path, lines)))

    def _ordered(self, path: str, tests: list[str]) -> list[str]:
        """First what is named like the file or its folder, then what is cheap."""
        folder, stem = Path(path).parent.name, Path(path).stem

        def key(test: str) -> tuple[int, float]:
            where = test.partition("::")[0]
            near = (stem in where) + (f"/{folder}" in where or f"_{folder}" in where)
            return -near, self.seconds.get(test, 1.0)

        return sorted(tests, key=key)
