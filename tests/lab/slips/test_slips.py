"""Of the slips that bytes can betray, nearly all are told where a recording is at hand."""

from __future__ import annotations

import pytest

from tests.lab.slips.__main__ import main
from tests.lab.slips.table import SLIPS

pytestmark = pytest.mark.slow


def test_slips_are_told(capsys: pytest.CaptureFixture[str]) -> None:
    """85 % at least end with status 1; a spec without a slip ends with 0."""
    assert len(SLIPS) == 85
    assert main([]) == 0, capsys.readouterr().out
