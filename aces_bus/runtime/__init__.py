"""Clocks and what runs on them."""

from __future__ import annotations

from .clock import RealClock
from .tasks import ThreadTasks
from .virtual import VirtualClock

__all__ = ["RealClock", "ThreadTasks", "VirtualClock"]
