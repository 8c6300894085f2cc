"""What is skipped in the compiled build (`make test-compiled`): tests that replace methods, as its calls were bound when it
was built, and tests that look at types of parameters, which it does not keep.
"""

from __future__ import annotations

import pytest

from aces_bus.device import host

IS_COMPILED = not host.__file__.endswith(".py")
WHY = "calls within the compiled build cannot be replaced"
replaces_methods = pytest.mark.skipif(IS_COMPILED, reason=WHY)
looks_at_parameters = pytest.mark.skipif(
    IS_COMPILED, reason="the compiled build keeps no types of parameters"
)
