"""What every test may use: Hypothesis profiles, the shared recordings, golden files.

1. A random test says how to repeat it: Hypothesis prints the blob, and keeps failing examples in `.hypothesis`.
2. A test that lacks its material skips and says which; it never passes by finding nothing.
"""

from __future__ import annotations

import difflib
import os
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

ROOT = Path(__file__).resolve().parent.parent
GOLDEN = ROOT / "tests" / "golden"

# No deadline and no health check of speed: both fail on a busy machine, not on a fault.
settings.register_profile(
    "short", max_examples=12, deadline=None, print_blob=True, suppress_health_check=[HealthCheck.too_slow]
)
settings.register_profile(
    "long", parent=settings.get_profile("short"), max_examples=int(os.environ.get("ACES_EXAMPLES", "2000"))
)
PROFILE = os.environ.get("HYPOTHESIS_PROFILE", "short")
settings.load_profile(PROFILE)

# Programs, and files that tests read; none of them is a test or holds a doctest.
collect_ignore = ["pristine.py", "bench/framings.py", "bench/soak.py", "socketcan/run.py"]
collect_ignore_glob = ["golden/*", "data/*"]

Golden = Callable[[str, str], None]


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--update-golden",
        action="store_true",
        help="write the golden files anew; runs only tests that have one",
    )


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if PROFILE != "long":
        skip = pytest.mark.skip(reason="takes minutes: HYPOTHESIS_PROFILE=long, or `make test-long`")
        for item in items:
            if item.get_closest_marker("long"):
                item.add_marker(skip)
    if config.getoption("--update-golden"):
        others = [item for item in items if "golden" not in getattr(item, "fixturenames", ())]
        config.hook.pytest_deselected(items=others)
        items[:] = [item for item in items if "golden" in getattr(item, "fixturenames", ())]


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
