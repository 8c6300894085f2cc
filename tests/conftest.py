"""What every test may use: Hypothesis profiles, the shared recordings, golden files.

1. The short profile draws the same on every machine. The long one draws anew from the seed that `make test-long` prints,
   and keeps what fails as files that both replay first (`tests/kept.py`).
2. A test that lacks its material skips and says which; it never passes by finding nothing.
"""

from __future__ import annotations

import difflib
import gc
import os
import signal
import tomllib
import zlib
from collections import Counter
from collections.abc import Callable, Generator
from pathlib import Path
from typing import Any

import pytest
from _pytest.doctest import DoctestModule
from hypothesis import HealthCheck, settings

from tests import kept, leaks

ROOT = Path(__file__).resolve().parent.parent
GOLDEN = ROOT / "tests" / "golden"

# No deadline and no health check of speed: both fail on a busy machine, not on a fault. Nothing is taken from, or left in,
# a database: what failed elsewhere, or before, changes no result here. All is said here, for defaults differ under CI.
settings.register_profile(
    "short",
    max_examples=12,
    derandomize=True,
    database=None,
    deadline=None,
    print_blob=False,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.register_profile(
    "long",
    parent=settings.get_profile("short"),
    max_examples=int(os.environ.get("ACES_EXAMPLES", "2000")),
    derandomize=False,
)
PROFILE = os.environ.get("HYPOTHESIS_PROFILE", "short")
settings.load_profile(PROFILE)


def _draw_no_constants_of_modules() -> None:
    """Hypothesis mixes in the constants of the modules that happen to be imported: which ones, the other tests decide."""
    try:
        from hypothesis.internal.conjecture import providers
    except ImportError:  # older releases do not
        return
    module: Any = providers
    module._get_local_constants = lambda: module._local_constants


_draw_no_constants_of_modules()

# Programs, and files that tests read; none of them is a test or holds a doctest.
collect_ignore = [
    "pristine.py",
    "steady.py",
    "mutants/lines.py",  # measures from the moment it is imported: everything takes twice as long
    "bench/framings.py",
    "bench/soak.py",
    "bench/run_stops.py",
    "socketcan/run.py",
]
collect_ignore_glob = ["golden/*", "data/*"]

#: What `make test` leaves to `make test-slow`: of each file functions or cases, and functions of which a share stays.
LEFT: dict[str, dict[str, list[str]]] = tomllib.loads(
    (ROOT / "tests" / "slow.toml").read_text(encoding="utf-8")
)
#: Of functions with many cases alike, one case in so many is quick; planted faults meet all of them.
SHARE = int(os.environ.get("ACES_SHARE", "4"))

Golden = Callable[[str, str], None]


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--update-golden",
        action="store_true",
        help="write the golden files anew; runs only tests that have one",
    )


def pytest_configure(config: pytest.Config) -> None:
    if leaks.IS_CHECKED:
        config.addinivalue_line("filterwarnings", "error::ResourceWarning")
    # What a shell starts in the background ignores Ctrl-C, what `nohup` starts a hang-up, and so would every program that a
    # test starts and interrupts.
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    if hasattr(signal, "SIGHUP") and signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:
        signal.signal(signal.SIGHUP, signal.SIG_DFL)


@pytest.hookimpl(wrapper=True)
def pytest_collect_file(file_path: Path) -> Generator[None, Any, Any]:
    """Leave out the doctests of a file without any: looking for them takes longer than reading it."""
    found: list[Any] = yield
    if any(isinstance(one, DoctestModule) for one in found) and b">>>" not in file_path.read_bytes():
        return [one for one in found if not isinstance(one, DoctestModule)]
    return found


def _mark_slow(items: list[pytest.Item]) -> None:
    """Mark what tests/slow.toml leaves to `make test-slow`; of many cases alike by their places, before any are chosen."""
    cases = Counter[str]()
    for item in items:
        file, _, name = item.nodeid.partition("::")
        function = name.partition("[")[0]
        slow = LEFT["slow"].get(file, ())
        if name in slow or function in slow:
            item.add_marker("slow")
        elif function in LEFT["sampled"].get(file, ()):
            place = zlib.crc32(f"{file}::{function}".encode()) + cases[file + function]
            cases[file + function] += 1
            if place % SHARE:
                item.add_marker("slow")


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    _mark_slow(items)
    if PROFILE != "long":
        skip = pytest.mark.skip(reason="takes minutes: HYPOTHESIS_PROFILE=long, or `make test-long`")
        for item in items:
            if item.get_closest_marker("long"):
                item.add_marker(skip)
    if config.getoption("--update-golden"):
        others = [item for item in items if "golden" not in getattr(item, "fixturenames", ())]
        config.hook.pytest_deselected(items=others)
        items[:] = [item for item in items if "golden" in getattr(item, "fixturenames", ())]


def pytest_collection_finish() -> None:
    # What is imported and collected stays to the end: looking through it again and again for garbage costs much time. So
    # does looking after each 700 new objects, as Python does by itself: an eighth of all processor time.
    gc.collect()
    gc.freeze()
    gc.set_threshold(int(os.environ.get("ACES_GC", "20000")), 20, 50)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, Any, Any]:
    """With ACES_COLLECT, a test fails that leaves something open: `make test-leaks`."""
    if not leaks.IS_CHECKED:
        return (yield)
    with leaks.watched(item):
        return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_teardown(item: pytest.Item) -> Generator[None, Any, Any]:
    """Judge what the test has left, once its fixtures are gone."""
    result = yield
    if leaks.IS_CHECKED:
        leaks.check(item)
    return result


@pytest.hookimpl(wrapper=True)
def pytest_pyfunc_call(pyfuncitem: pytest.Function) -> Generator[None, Any, Any]:
    """A drawn test meets first what once broke it; the long profile keeps what breaks it now."""
    test: Any = pyfuncitem.obj
    if not hasattr(test, "hypothesis"):
        return (yield)
    names = pyfuncitem._fixtureinfo.argnames  # pyright: ignore[reportPrivateUsage]  # as pytest itself calls a test
    fixtures = {name: pyfuncitem.funcargs[name] for name in names}
    kept.replay(test, pyfuncitem.nodeid, fixtures)
    if PROFILE != "long":
        return (yield)
    with kept.keeping(test, pyfuncitem.nodeid, fixtures):
        return (yield)


@pytest.fixture(scope="session")
def shared_captures() -> Path:
    """The folder of real recordings beside the repository; skips where it is absent."""
    folder = ROOT.parent / "shared" / "captures"
    if not folder.is_dir():
        pytest.skip("no ../shared/captures beside the repository")
    return folder


@pytest.fixture
def golden(request: pytest.FixtureRequest) -> Golden:
    """`golden(name, text)`: the text equals `tests/golden/NAME`, or the test fails with the diff."""

    def check(name: str, text: str) -> None:
        path = GOLDEN / name
        if request.config.getoption("--update-golden"):
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="utf-8", newline="\n")
            return
        stored = path.read_text(encoding="utf-8") if path.exists() else ""
        if stored != text:
            diff = difflib.unified_diff(
                stored.splitlines(keepends=True), text.splitlines(keepends=True), f"golden/{name}", "now"
            )
            pytest.fail(
                f"tests/golden/{name} differs; if that is meant: make golden\n{''.join(diff)}", pytrace=False
            )

    return check
