"""What tests of protocols are made of, as public as the rest.

* `strategies`: Hypothesis strategies that draw raw fields, packets, frames and whole wires of a protocol, valid by
  construction and then damaged. Needs the extra `[testing]`.
* `laws`: the nine laws that every protocol obeys, one function each. Needs nothing beyond the core.
* `longrun`: `python -m aces_bus.testing.longrun NAME` runs all laws on one protocol for a long time.

Import what you use: `from aces_bus.testing import laws, strategies`.
"""

from __future__ import annotations

from . import laws as laws

__all__ = ["laws"]
