"""States for other programs, by datagrams of text, as the original had it.

1. Loopback only, and nothing can be set, unless that is asked for.
2. What comes from outside is untrusted: bounded, counted, never raised.
3. Set-points from outside go down where all others do: on the clock's thread, by `State.set`, through the device's limits.

`UdpStates` answers `GET`, `SET` and `SMP`; `Inlet` takes set-points for it and for other services (`aces_lab.zenoh`). See
docs/logging.md.
"""

from __future__ import annotations

from .udp import UdpStates

__all__ = ["UdpStates"]
