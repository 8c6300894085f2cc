"""The releases that tests run with are pinned, all of them, and inside the ranges that users get."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from tests.steady import counts_of

ROOT = Path(__file__).resolve().parents[1]


def test_every_tool_is_pinned_inside_its_range() -> None:
    """What [dev], [oracles] and [docs] ask for has one release in constraints.txt, which pyproject.toml allows."""
    pinned: dict[str, str] = {}
    for line in (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines():
        if line and not line.startswith("#"):
            name, _, version = line.partition("==")
            assert re.fullmatch(r"[\w.+]+", version), f"not a pin: {line}"
            pinned[canonicalize_name(name)] = version
    assert "aces-bus" not in pinned
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = project["optional-dependencies"]
    waiting, wanted = (
        [*project["dependencies"], *extras["dev"], *extras["oracles"], *extras["docs"]],
        list[Requirement](),
    )
    while waiting:
        one = Requirement(waiting.pop())
        if one.name == "aces-bus":
            waiting += [inner for extra in one.extras for inner in extras[extra]]
        else:
            wanted.append(one)
    assert len(wanted) > 20
    for one in wanted:
        assert one.specifier.contains(pinned[canonicalize_name(one.name)]), one


def test_counts_are_read_from_the_last_line() -> None:
    """`make test-steady` compares what pytest counted."""
    output = (
        "..s [100%]\n8 passed in a docstring\n2 failed, 8814 passed, 132 skipped in 880.52s (0:14:40)\n\n"
    )
    assert counts_of(output) == {"failed": 2, "passed": 8814, "skipped": 132}
    assert counts_of("killed\n") == {}
