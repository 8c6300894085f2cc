"""States for other programs: by datagrams of text, as the original had it, and over zenoh.

1. Loopback only, and nothing can be set, unless that is asked for.
2. What comes from outside is untrusted: bounded, counted, never raised.
3. Set-points from outside go down where all others do: on the clock's thread, by `State.set`, through the device's limits.

`UdpStates` answers `GET`, `SET` and `SMP`; `Publisher` and `RemoteStates` (extra `[zenoh]`) let a controller run on another
machine. See docs/logging.md.
"""

from __future__ import annotations

from .inlet import AccessEvent, Inlet
from .remote import RemoteStates
from .udp import UdpStates
from .zenoh import ENDPOINT, Publisher

__all__ = ["ENDPOINT", "AccessEvent", "Inlet", "Publisher", "RemoteStates", "UdpStates"]
