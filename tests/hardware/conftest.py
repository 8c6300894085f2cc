"""What tests of served buses share: a runtime folder of their own, and clients that are closed at the end."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import can
import pytest

from aces_bus.hardware.served.remote import ServedBus

from .serving import PATIENCE, Open


@pytest.fixture
def runtime(monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A runtime folder of the test's own, with a path short enough for sockets."""
    folder = Path(tempfile.mkdtemp(prefix="aces"))
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(folder))
    yield folder
    shutil.rmtree(folder, ignore_errors=True)


@pytest.fixture
def opened(runtime: Path) -> Iterator[Open]:
    """Opens clients and closes them at the end."""
    with ExitStack() as stack:

        def open_bus(channel: str = "unix:can0", **more: Any) -> ServedBus:
            options: dict[str, Any] = {"timeout": PATIENCE, **more}
            bus = can.Bus(channel, "aces", **options)
            assert isinstance(bus, ServedBus)
            return stack.enter_context(bus)

        yield open_bus
