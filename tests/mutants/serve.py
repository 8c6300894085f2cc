"""Run tests against planted faults, each in a fork of one collected session: a pytest plugin (`-p tests.mutants.serve`).

1. `ACES_MUTANTS` names a JSON file: a list of `{"file", "source", "tests", "limit_s"}`. Answers are printed, one line each.
2. A fork compiles the changed source and gives its functions to those that are there: what ran at import ran without the
   fault. Who survives here is tried again in a process of its own (`tests.mutants.__main__`).
3. A test that fails in a fork without any fault kills nothing.
"""

from __future__ import annotations

import contextlib
import gc
import json
import mmap
import os
import resource
import signal
import struct
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path
from types import CodeType, FunctionType
from typing import Any, NoReturn

import pytest

#: What begins a line that is an answer.
MARK = "mutant answer: "
#: Status of a fork: all tests passed; one failed.
PASSED, FAILED = 0, 13
#: What a fork may take (bytes of address space): a fault may fill a list for ever.
MEMORY = 6 << 30

Place = tuple[str, str, int]


def _codes(code: CodeType) -> list[CodeType]:
    inner = [one for one in code.co_consts if isinstance(one, CodeType)]
    return [code, *(found for one in inner for found in _codes(one))]


def _place(code: CodeType) -> Place:
    return code.co_filename, code.co_qualname, code.co_firstlineno


def functions_by_place() -> dict[Place, list[FunctionType]]:
    """All functions that there are, by the file, name and line of their code."""
    found: dict[Place, list[FunctionType]] = {}
    for function in gc.get_objects():
        if type(function) is FunctionType:
            found.setdefault(_place(function.__code__), []).append(function)
    return found


def plant(path: str, source: bytes, functions: dict[Place, list[FunctionType]]) -> int:
    """Give functions of this file the code of `source`; returns how many were given another."""
    changed = 0
    for code in _codes(compile(source, path, "exec")):
        for function in functions.get(_place(code), ()):
            if function.__code__.co_freevars == code.co_freevars and function.__code__ != code:
                function.__code__ = code
                changed += 1
    return changed


@dataclass
class Server:
    """One collected session."""

    session: pytest.Session
    items: dict[str, pytest.Item] = field(init=False)
    functions: dict[Place, list[FunctionType]] = field(init=False)
    healthy: dict[str, bool] = field(default_factory=dict[str, bool])

    def __post_init__(self) -> None:
        self.items = {item.nodeid: item for item in self.session.items}
        gc.unfreeze()
        self.functions = functions_by_place()
        gc.collect()
        gc.freeze()

    def answer(self, path: str, source: str, tests: list[str], limit_s: float) -> dict[str, Any]:
        """Run the tests with this source until one fails; says which."""
        left = [item for test in tests for item in self._named(test) if self.healthy.get(item) is not False]
        while True:
            status, test = self._fork(path, source.encode(), left, limit_s)
            if status == "passed":
                return {"status": "survived", "test": "", "ran": len(left)}
            if test in left and not self._is_healthy(test, limit_s):
                left.remove(test)
                continue
            return {"status": status, "test": test, "ran": len(left)}

    def _named(self, test: str) -> list[str]:
        """The tests of a node id: itself, or all of a file or a parametrized function."""
        if test in self.items:
            return [test]
        return [item for item in self.items if item.startswith((f"{test}::", f"{test}["))]

    def _is_healthy(self, test: str, limit_s: float) -> bool:
        if test not in self.healthy:
            self.healthy[test] = self._fork("", b"", [test], limit_s)[0] == "passed"
        return self.healthy[test]

    def _fork(self, path: str, source: bytes, tests: list[str], limit_s: float) -> tuple[str, str]:
        """What became of a fork ("passed", "failed", "timed out", "died"), and the test that it was in."""
        at = mmap.mmap(-1, 8)  # shared with the fork: the number of its test
        child = os.fork()
        if not child:
            self._child(path, source, tests, at, limit_s)
        until = time.monotonic() + 4 * limit_s + 10
        status: int | None = None
        while status is None and time.monotonic() < until:
            found, got = os.waitpid(child, os.WNOHANG)
            if found:
                status = got
            else:
                time.sleep(0.005)
        with contextlib.suppress(ProcessLookupError):  # what its tests started, and what hangs
            os.killpg(child, signal.SIGKILL)
        if status is None:
            os.waitpid(child, 0)
        (number,) = struct.unpack("q", at[:])
        test = tests[number] if number < len(tests) else ""
        if status is None or (os.WIFSIGNALED(status) and os.WTERMSIG(status) == signal.SIGXCPU):
            return "timed out", test
        if os.WIFEXITED(status) and os.WEXITSTATUS(status) in (PASSED, FAILED):
            return ("failed" if os.WEXITSTATUS(status) else "passed"), test
        return "died", test

    def _child(self, path: str, source: bytes, tests: list[str], at: mmap.mmap, limit_s: float) -> NoReturn:
        """Plant the fault, run the tests, leave."""
        status = FAILED
        try:
            os.setsid()
            used = int(time.process_time())  # a fork begins at 0, but not everywhere
            resource.setrlimit(resource.RLIMIT_CPU, (used + int(limit_s) + 2, resource.RLIM_INFINITY))
            resource.setrlimit(resource.RLIMIT_AS, (MEMORY, resource.RLIM_INFINITY))
            null = os.open(os.devnull, os.O_RDWR)
            for number in (0, 1, 2):
                os.dup2(null, number)
            if path:
                plant(path, source, self.functions)
            self.session.testsfailed = 0
            chosen = [self.items[test] for test in tests]
            for number, item in enumerate(chosen):
                at[:] = struct.pack("q", number)
                following = chosen[number + 1] if number + 1 < len(chosen) else None
                item.config.hook.pytest_runtest_protocol(item=item, nextitem=following)
                if self.session.testsfailed:
                    break
            else:
                status = PASSED
        finally:
            os._exit(status)


@pytest.hookimpl(tryfirst=True)
def pytest_runtestloop(session: pytest.Session) -> bool:
    """Answer for each mutant instead of running the tests once."""
    server = Server(session)
    asked = json.loads(Path(os.environ["ACES_MUTANTS"]).read_text(encoding="utf-8"))
    capture: Any = session.config.pluginmanager.getplugin("capturemanager")
    for number, one in enumerate(asked):
        answer = server.answer(one["file"], one["source"], one["tests"], one["limit_s"])
        with capture.global_and_fixture_disabled():
            print(f"{MARK}{json.dumps({'number': number, **answer})}", file=sys.stdout, flush=True)
    return True
