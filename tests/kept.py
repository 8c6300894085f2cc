"""Failures of drawn tests as files: the long profile writes them, every profile replays them first.

    # tests/recordings/test_serial.py::test_a_raw_file_is_its_bytes
    # AssertionError: assert b'' == b'\xa1\xb2'
    data = b'\xa1\xb2'

1. A file says the test and its arguments as Python writes them: readable, and good for any release of Hypothesis.
2. What `st.data()` drew is `Drawn([…])`: the same values in the same order.
3. An argument that Python does not write as something it reads back is not kept, and the failure says so.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Generator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from hypothesis.errors import UnsatisfiedAssumption

from aces_bus import Frame

FAILURES = Path(__file__).resolve().parent / "data" / "failures"


class Drawn:
    """What a test got from `st.data()`; `more` draws on, without it the values given are drawn again."""

    def __init__(self, values: list[Any], more: Any = None) -> None:
        self.values = values
        self._more = more
        self._next = 0

    def __repr__(self) -> str:
        return f"Drawn({self.values!r})"

    def draw(self, strategy: Any, label: Any = None) -> Any:
        """The next value."""
        if self._more is not None:
            value = self._more.draw(strategy, label)
            self.values.append(value)
            return value
        if self._next == len(self.values):
            raise UnsatisfiedAssumption("the test draws more than it did when this was kept")
        self._next += 1
        return self.values[self._next - 1]


#: What the files may name besides literals.
NAMES = {"Drawn": Drawn, "Frame": Frame, "inf": float("inf"), "nan": float("nan")}


def _read(text: str) -> Any:
    return eval(text, {"__builtins__": {}}, dict(NAMES))  # files of this repository


def _is_readable(text: str) -> bool:
    try:
        return "\n" not in text and repr(_read(text)) == text
    except Exception:
        return False


def replay(test: Callable[..., Any], node: str, fixtures: Mapping[str, Any], folder: Path = FAILURES) -> int:
    """Run a test of Hypothesis with the arguments that once broke it; how many files there were."""
    handle: Any = getattr(test, "hypothesis", None)
    files = [
        path for path in sorted(folder.glob("*.txt")) if path.read_text("utf-8").startswith(f"# {node}\n")
    ]
    for path in files:
        lines = (line.partition(" = ") for line in path.read_text("utf-8").splitlines() if line[:1] != "#")
        try:
            handle.inner_test(**fixtures, **{name: _read(value) for name, _, value in lines})
        except UnsatisfiedAssumption:
            pass
        except Exception as error:
            error.add_note(f"kept in {path}")
            raise
    return len(files)


@contextmanager
def keeping(
    test: Callable[..., Any], node: str, fixtures: Mapping[str, Any], folder: Path = FAILURES
) -> Generator[None]:
    """Write the arguments of the last failing call of a test of Hypothesis (the smallest) when it fails."""
    handle: Any = getattr(test, "hypothesis", None)
    if handle is None:
        yield
        return
    inner: Callable[..., Any] = handle.inner_test
    last: dict[str, str] = {}

    def noted(*args: Any, **arguments: Any) -> None:
        for name, value in arguments.items():
            if name not in fixtures and type(value).__name__ == "DataObject":
                arguments[name] = Drawn([], value)
        drawn = {name: value for name, value in arguments.items() if name not in fixtures}
        before = {name: repr(value) for name, value in drawn.items() if not isinstance(value, Drawn)}
        try:
            inner(*args, **arguments)
        except UnsatisfiedAssumption:
            raise
        except Exception:
            last.clear()
            last.update({name: before.get(name) or repr(value) for name, value in drawn.items()})
            raise

    handle.inner_test = noted
    try:
        yield
    except Exception as error:
        if last:
            error.add_note(_write(node, error, last, folder))
        raise
    finally:
        handle.inner_test = inner


def _write(node: str, error: Exception, arguments: Mapping[str, str], folder: Path) -> str:
    odd = [name for name, text in arguments.items() if not _is_readable(text)]
    if odd:
        return f"not kept as a file: {', '.join(odd)} cannot be read back; make it an @example"
    first = f"{type(error).__name__}: {error}".splitlines()[0]
    values = "".join(f"{name} = {text}\n" for name, text in arguments.items())
    stem = re.sub(r"\W+", "-", node.removeprefix("tests/").replace(".py", "")).strip("-")[:80]
    path = folder / f"{stem}-{hashlib.sha256(values.encode()).hexdigest()[:8]}.txt"
    folder.mkdir(parents=True, exist_ok=True)
    path.write_text(f"# {node}\n# {first}\n{values}", encoding="utf-8")
    return f"kept in {path}: `make test` replays it from now on"


__all__ = ["FAILURES", "NAMES", "Drawn", "keeping", "replay"]
