"""What work costs in calls of Python functions: the same on every machine, however busy it is."""

from __future__ import annotations

import sys
from collections.abc import Callable
from cProfile import Profile


def calls(work: Callable[[], object]) -> int:
    """How many Python functions `work` calls, and those call, on this thread."""
    # Counted in C: a function called back for each of these calls costs more than they do.
    before = sys.getprofile()
    sys.setprofile(None)
    profile = Profile(builtins=False)
    profile.enable()
    try:
        work()
    finally:
        profile.disable()
        sys.setprofile(before)
    return sum(entry.callcount for entry in profile.getstats())


__all__ = ["calls"]
