"""States over zenoh, so that a controller runs on another machine. Needs the extra `[zenoh]`."""

from __future__ import annotations

from .publisher import ENDPOINT, Publisher
from .remote import RemoteStates

__all__ = ["ENDPOINT", "Publisher", "RemoteStates"]
