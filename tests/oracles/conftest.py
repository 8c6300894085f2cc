"""What foreign programs change for the whole process is put back."""

from __future__ import annotations

from collections.abc import Generator
from typing import Any

import can
import pytest


@pytest.fixture(autouse=True)
def python_can_as_it_was() -> Generator[None]:
    """mjbots' moteus makes CAN FD the default of every bus that the process opens later (`can.rc`)."""
    rc: Any = can.rc
    before = dict(rc)
    yield
    can.rc = rc
    rc.clear()
    rc.update(before)
