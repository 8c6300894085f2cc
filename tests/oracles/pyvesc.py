"""PyVESC as it can be imported.

The package `pyvesc` cannot be imported any more. pyvesc-fix has it as `pyvesc_fix`, where it still looks for itself as
`pyvesc`, and brings a package `tests`: so it is installed in a folder of its own (Makefile), and imported as `pyvesc`.
"""

from __future__ import annotations

import importlib.util
import sys
from functools import cache
from pathlib import Path
from typing import Any

import pytest


@cache
def pyvesc_module() -> Any:
    """Return PyVESC, or skip."""
    package = Path(sys.prefix) / "pyvesc" / "pyvesc_fix"
    if not package.is_dir():
        pytest.skip("needs pyvesc-fix in a folder of its own: make test-oracles", allow_module_level=True)
    spec = importlib.util.spec_from_file_location(
        "pyvesc", package / "__init__.py", submodule_search_locations=[str(package)]
    )
    assert spec is not None
    assert spec.loader is not None
    made = sys.modules["pyvesc"] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(made)
    return made
