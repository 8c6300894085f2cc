"""The catalogue: every spec of this folder is in it."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.specs.catalogue import SPECS

FOLDER = Path(__file__).parent


def test_every_spec_is_listed() -> None:
    """A spec beside the catalogue and not in it would be tested by nobody."""
    files = {
        p.stem
        for p in FOLDER.glob("*.py")
        if not p.stem.startswith("test_") and p.stem not in ("catalogue", "cases")
    }
    assert files == set(SPECS)


@pytest.mark.parametrize("name", SPECS)
def test_every_message_says_what_it_is(name: str) -> None:
    """Messages carry a line of explanation; protocols too."""
    assert SPECS[name].doc
    assert [m.name for m in SPECS[name].declared if not m.doc] == []
