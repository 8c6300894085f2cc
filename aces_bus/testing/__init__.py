"""What tests of protocols and devices are made of: docs/fuzzing.md and docs/devices.md show how to use each.

* `law_tests("my_spec.py")`: every law of a protocol as tests of pytest, in one line. Needs the extra `[testing]`.
* `driver_tests(driver)`: every promise of a driver and its twin, in the same way. Needs the extra `[testing]`.
* `plug_ins`: the same for the other kinds of plug-ins, as seams; docs/plugins.md names each.
* `strategies`: Hypothesis strategies that draw raw fields, packets, and whole wires of a protocol, valid by construction
  and then damaged. Needs the extra `[testing]`.
* `LAWS`: the nine laws that every protocol obeys; one is called with a wire, a direction and a `Scene`. Needs nothing beyond
  the core.
* `Fuzzer`: the quick loop behind `aces fuzz`, with its own generator and its own shrinking. Needs nothing beyond the core.
* `plugin`: options of pytest, for `law_tests`.

Nothing is imported before it is used: pytest loads `plugin` in projects that have nothing to do with a protocol.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from .._lazy import lazy_names

if TYPE_CHECKING:
    from .conformance import driver_tests, run_check
    from .fuzz import Fuzzer
    from .laws import LAWS
    from .pytest_laws import law_tests
    from .scenes import Scene

__all__ = [
    "LAWS",
    "Fuzzer",
    "Scene",
    "driver_tests",
    "law_tests",
    "run_check",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        ".conformance": "driver_tests run_check",
        ".fuzz": "Fuzzer",
        ".laws": "LAWS",
        ".pytest_laws": "law_tests",
        ".scenes": "Scene",
    },
)
