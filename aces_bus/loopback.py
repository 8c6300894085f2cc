"""Which addresses are of this machine alone: what listens there, and what comes from there, is not from elsewhere."""

from __future__ import annotations

import ipaddress


def is_loopback(host: str) -> bool:
    """Return whether an address is of this machine alone. Of names `localhost` is: others mean what a name server says.

    >>> [is_loopback(host) for host in ("localhost", "127.8.9.1", "::1", "0.0.0.0", "127.evil.example.com")]
    [True, True, True, False, False]
    """
    try:
        return ipaddress.ip_address(host.partition("%")[0]).is_loopback
    except ValueError:
        return host.lower() == "localhost"


__all__ = ["is_loopback"]
