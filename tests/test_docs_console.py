"""The tutorial is run from its first line to its last: its files are written, its commands typed, its Python entered.

1. A block of Python whose first line is `# NAME.py` is that file; `# NAME.py, continued` goes on in it.
2. A block of console lines is typed as it stands, and must print what stands below each command. `...` stands for
   anything. A command ends with `# exits with N` where its status is not 0.
3. Blocks with `>>>` are doctests, in one namespace; they import the files written before.
"""

from __future__ import annotations

import contextlib
import doctest
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import NamedTuple

import pytest
from hypothesis import settings

from aces_bus.protocol import files
from aces_tools.authoring import check
from aces_tools.main import main

ROOT = Path(__file__).resolve().parents[1]
PAGES = ["docs/tutorial.md"]
_FENCE = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
_FILE = re.compile(r"# (\w+\.py)(, continued)?\n")
_STATUS = re.compile(r"\s+# exits with (\d+)$")


class Block(NamedTuple):
    """A fenced block of a page, and the line that it begins in."""

    kind: str
    text: str
    line: int


class Command(NamedTuple):
    """What is typed, what it is to print, and its exit status."""

    typed: str
    prints: str
    status: int


def blocks_of(page: str) -> Iterator[Block]:
    text = (ROOT / page).read_text(encoding="utf-8")
    for found in _FENCE.finditer(text):
        yield Block(found[1], found[2], text.count("\n", 0, found.start(2)))


def commands_of(block: Block) -> Iterator[Command]:
    """The commands of a console block; lines before the first one belong to nobody."""
    for part in re.split(r"^\$ ", block.text, flags=re.MULTILINE)[1:]:
        typed, _, prints = part.partition("\n")
        status = _STATUS.search(typed)
        yield Command(_STATUS.sub("", typed), prints, int(status[1]) if status else 0)


class Terminal:
    """A folder in which commands are typed."""

    def __init__(self, capsys: pytest.CaptureFixture[str]) -> None:
        self.capsys = capsys

    def run(self, typed: str) -> tuple[str, int]:
        """What a command prints, messages behind results, and its status."""
        name, *arguments = shlex.split(typed)
        if name == "cd":
            os.chdir(arguments[0])
            return "", 0
        if name == "aces":
            files.loaded.clear()  # each command is a process of its own, in life
            for module in [one for one in sys.modules if one.startswith("aces_spec_")]:
                del sys.modules[module]
            self.capsys.readouterr()
            status = main(arguments)
            out, err = self.capsys.readouterr()
            return out + err, status
        if name == "sed":
            return _substitute(*arguments), 0
        assert name in ("python", "pytest"), f"a page may type cd, aces, sed, python and pytest, not {name}"
        command = [sys.executable]
        if name == "pytest":
            command += ["-m", "pytest", "-p", "no:cacheprovider", "--hypothesis-seed=1"]
            command += ["-c", os.devnull, "--rootdir", "."]
            # The package's plug-in, and no others: they take as long to load as the tests take.
            command += ["-p", "_hypothesis_pytestplugin", "-p", "aces_bus.testing.plugin"]
            # In the short profile some of the laws, and once there is a driver, some of the checks of drivers.
            few = "received" if list(Path().glob("*_driver.py")) else "sheets or round_trip"
            command += [] if settings().max_examples > 100 else ["-k", few, "--aces-examples", "2"]
        path = os.pathsep.join(one for one in sys.path if one)
        done = subprocess.run(
            [*command, *arguments],
            capture_output=True,
            text=True,
            encoding="utf-8",
            env={**os.environ, "PYTHONPATH": path, "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"},
            timeout=300,
        )
        return done.stdout + done.stderr, done.returncode


def _substitute(option: str, rule: str, name: str) -> str:
    """`sed -i 's/this/that/' FILE`, of plain texts."""
    assert option == "-i"
    _, this, that, _ = rule.split("/")
    text = Path(name).read_text(encoding="utf-8")
    assert text.count(this) == 1, f"{this!r} is there {text.count(this)} times"
    Path(name).write_text(text.replace(this, that), encoding="utf-8")
    return ""


@contextlib.contextmanager
def imports_of_its_own() -> Generator[None]:
    """Modules that are imported in here are forgotten afterwards."""
    known, path = set(sys.modules), list(sys.path)
    try:
        yield
    finally:
        sys.path[:] = path
        for name in set(sys.modules) - known:
            if not name.startswith("aces_"):
                del sys.modules[name]


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES)
def test_a_page_is_what_happens(
    page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Whoever types what the page shows sees what the page shows."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "200")
    if settings().max_examples <= 100:
        monkeypatch.setattr(check, "SECONDS", 0.2)
    terminal, checker = Terminal(capsys), doctest.OutputChecker()
    options = doctest.ELLIPSIS | doctest.IGNORE_EXCEPTION_DETAIL
    runner, names, typed = doctest.DocTestRunner(optionflags=options), {"__name__": "tutorial"}, 0
    with imports_of_its_own():
        for block in blocks_of(page):
            where = f"{page}:{block.line}"
            if block.kind == "console":
                for command in commands_of(block):
                    shown, status = terminal.run(command.typed)
                    assert status == command.status, f"{where}: {command.typed}\n{shown}"
                    shown = "\n".join(line.rstrip() for line in shown.splitlines())
                    prints = "\n".join(line.rstrip() for line in command.prints.splitlines())
                    assert checker.check_output(f"{prints}\n", f"{shown}\n", doctest.ELLIPSIS), (
                        f"{where}: {command.typed} prints\n{shown}"
                    )
                    typed += 1
            elif found := _FILE.match(block.text):
                with Path(found[1]).open("a" if found[2] else "w", encoding="utf-8") as file:
                    file.write(f"\n{block.text}" if found[2] else block.text)
            else:
                assert block.kind == "python", f"{where}: a block of {block.kind}"
                sys.path.insert(0, os.getcwd())
                test = doctest.DocTestParser().get_doctest(block.text, names, page, where, block.line)
                result = runner.run(test, clear_globs=False)
                names = test.globs
                assert result.failed == 0, where
                assert result.attempted > 0, f"{where}: Python that is neither a file nor a doctest"
    assert typed > 10
