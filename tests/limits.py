"""A disk that is full, for tests: files may be no larger than so many bytes."""

from __future__ import annotations

import os
import signal
import sys
import tempfile
from collections.abc import Generator
from contextlib import contextmanager

import pytest


@contextmanager
def small_disk(size: int) -> Generator[None]:
    """No file of this process and of those that it starts may grow beyond so many bytes: the system refuses, as a full disk
    does. Skips without `resource`.

    No bytecode is written meanwhile: Python keeps what was cut off, and no later import could read it.
    """
    resource = pytest.importorskip("resource")
    tempfile.gettempdir()  # looked for by writing: without room, it would be the folder that the tests run in
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "dont_write_bytecode", True)
        patch.setitem(os.environ, "PYTHONDONTWRITEBYTECODE", "1")
        before = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
        try:
            yield
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
            signal.signal(signal.SIGXFSZ, before)
