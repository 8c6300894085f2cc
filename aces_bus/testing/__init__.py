"""What tests of protocols are made of, as public as the rest: docs/fuzzing.md shows how to use each.

* `law_tests("my_spec.py")`: every law of a protocol as tests of pytest, in one line. Needs the extra `[testing]`.
* `strategies`: Hypothesis strategies that draw raw fields, packets, frames, whole wires of a protocol, valid by construction
  and then damaged; and whole protocols. Needs the extra `[testing]`.
* `laws`: the nine laws that every protocol obeys, one function each. Needs nothing beyond the core.
* `fuzz`: the quick loop behind `aces fuzz`, with its own generator and its own shrinking. Needs nothing beyond the core.
* `plugin`: options of pytest, for `law_tests`.

Nothing is imported before it is used: pytest loads `plugin` in projects that have nothing to do with a protocol.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from . import fuzz as fuzz
    from . import laws as laws
    from .pytest_laws import law_tests as law_tests

__all__ = ["fuzz", "law_tests", "laws"]


def __getattr__(name: str) -> Any:
    from importlib import import_module

    if name == "law_tests":
        return import_module(".pytest_laws", __name__).law_tests
    if name in ("fuzz", "laws", "strategies"):
        return import_module(f".{name}", __name__)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
