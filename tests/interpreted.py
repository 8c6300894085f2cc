"""Tests that replace methods: in what `make compiled` compiles, calls were bound when it was built, and they are skipped."""

from __future__ import annotations

import pytest

from aces_bus.device import host

IS_COMPILED = not host.__file__.endswith(".py")
WHY = "calls within the compiled build cannot be replaced"
replaces_methods = pytest.mark.skipif(IS_COMPILED, reason=WHY)
