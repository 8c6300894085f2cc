"""What a test leaves open: sockets, files and threads, found while ACES_COLLECT is set (`make test-leaks`).

1. Garbage is collected when a test's fixtures are gone, so that what it left open warns there and not in another test.
2. Open files are counted too: a number from `os.open`, or an object that something still refers to, warns nowhere.
   A test whose fixtures outlive it (of a module or the session) is not judged by them: they may open at any time.
3. A thread that ends by itself gets a moment to do so.

pytest reports a warning in a destructor as one of the code that happens to run then. As an error it is one of the test.
"""

from __future__ import annotations

import gc
import os
import threading
import time
import warnings
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

IS_CHECKED = bool(os.environ.get("ACES_COLLECT"))
#: Seconds that a thread, or the other end of a connection, may take to be gone.
MOMENT_S = 2.0
FILES = Path("/proc/self/fd")

_before = pytest.StashKey[tuple[set[str], set[threading.Thread]]]()


def open_files() -> set[str]:
    """The files of this process, each by its number and what it is: `7 socket:[4711]`. Empty where /proc is absent."""
    found: set[str] = set()
    for number in os.listdir(FILES) if FILES.is_dir() else ():
        try:
            found.add(f"{number} {os.readlink(FILES / number)}")
        except OSError:  # the one that listed them
            continue
    return found


@contextmanager
def watched(item: pytest.Item) -> Generator[None]:
    """Note what is open before a test's fixtures are made."""
    item.stash[_before] = open_files(), set(threading.enumerate())
    yield


def _is_judged_by_files(item: Any) -> bool:
    info = getattr(item, "_fixtureinfo", None)
    scopes = (
        {made.scope for all_made in info.name2fixturedefs.values() for made in all_made} if info else set()
    )
    return not scopes - {"function"}


def check(item: pytest.Item) -> None:
    """Fail for what the test has left open."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", ResourceWarning)
        gc.collect()
    gc.freeze()  # what survives is cached for good: looking through it after each of thousands of tests takes an hour
    left = [str(one.message) for one in caught if issubclass(one.category, ResourceWarning)]
    files, threads = item.stash[_before]
    if _is_judged_by_files(item):
        end = time.monotonic() + MOMENT_S
        while True:
            more = sorted(open_files() - files)
            running = [thread for thread in threading.enumerate() if thread not in threads]
            if not (more or running) or time.monotonic() > end:
                break
            time.sleep(0.01)
        left += [f"file {one}" for one in more]
        left += [f"thread {thread.name}" for thread in running]
    if left:
        pytest.fail(f"left open by this test: {'; '.join(left)}", pytrace=False)
