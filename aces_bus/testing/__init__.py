"""What tests of protocols, drivers and other plug-ins are made of, as public as the rest.

* `law_tests("my_spec.py")`: every law of a protocol as tests of pytest, in one line. Needs the extra `[testing]`.
* `driver_tests("my_driver")`: every check of a driver and its twin, in one line.
* `reader_tests`, `writer_tests`, `exporter_tests`, `log_tests`, `database_tests`, `verb_tests`, `backend_tests`,
  `store_tests`: the same for the other kinds of plug-ins; docs/plugins.md has an example of each.
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
    from .conformance import driver_tests as driver_tests
    from .plug_ins import backend_tests as backend_tests
    from .plug_ins import database_tests as database_tests
    from .plug_ins import exporter_tests as exporter_tests
    from .plug_ins import log_tests as log_tests
    from .plug_ins import reader_tests as reader_tests
    from .plug_ins import store_tests as store_tests
    from .plug_ins import verb_tests as verb_tests
    from .plug_ins import writer_tests as writer_tests
    from .pytest_laws import law_tests as law_tests

__all__ = [
    "backend_tests",
    "database_tests",
    "driver_tests",
    "exporter_tests",
    "fuzz",
    "law_tests",
    "laws",
    "log_tests",
    "reader_tests",
    "store_tests",
    "verb_tests",
    "writer_tests",
]
#: Where a suite is, when it is not in `plug_ins`.
_ELSEWHERE = {"driver_tests": "conformance", "law_tests": "pytest_laws"}


def __getattr__(name: str) -> Any:
    from importlib import import_module

    if name in ("fuzz", "laws", "strategies"):
        return import_module(f".{name}", __name__)
    if name in __all__:
        return getattr(import_module(f".{_ELSEWHERE.get(name, 'plug_ins')}", __name__), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
