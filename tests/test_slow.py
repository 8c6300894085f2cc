"""What tests/slow.toml leaves to `make test-slow` is there to be run."""

from __future__ import annotations

import re

import pytest

from tests.conftest import LEFT, ROOT


@pytest.mark.parametrize("part", LEFT)
def test_every_line_names_a_test(part: str) -> None:
    """A line of a test that was renamed or is gone would leave out nothing, unseen."""
    for file, names in LEFT[part].items():
        text = (ROOT / file).read_text(encoding="utf-8")
        if "globals()" in text:  # a test for each driver without a file of its own
            text += re.sub(
                r"^(\w+) = ", r"test_\1 ", (ROOT / "pyproject.toml").read_text(encoding="utf-8"), flags=re.M
            )
        functions = {name.partition("[")[0] for name in names}
        assert not [name for name in functions if name not in text], file


def test_no_function_is_in_both_parts() -> None:
    """One that is slow as a whole would have no case that is quick."""
    slow = {(file, name) for file, names in LEFT["slow"].items() for name in names}
    assert slow.isdisjoint((file, name) for file, names in LEFT["sampled"].items() for name in names)
