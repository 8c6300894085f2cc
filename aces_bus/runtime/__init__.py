"""Clocks and what runs on them."""

from __future__ import annotations

from .clock import Clock, EventClock, RealClock, Timer
from .loop import Loop
from .tasks import Task, Tasks, ThreadTasks, VirtualTasks
from .virtual import VirtualClock

__all__ = [
    "Clock",
    "EventClock",
    "Loop",
    "RealClock",
    "Task",
    "Tasks",
    "ThreadTasks",
    "Timer",
    "VirtualClock",
    "VirtualTasks",
]
